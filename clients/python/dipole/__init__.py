"""dipole: requests subsurface-scattering profiles R(r) from a dipoled.

    import dipole

    with dipole.Client("unix:/run/dipoled.sock") as client:
        result = client.eval("better", dipole.Medium(sigma_a=0.032, sigma_s=0.74), r=[0.5, 1, 2])
        print(result.R, result.albedo)

Lengths are in mm, coefficients in 1/mm, R in 1/mm^2 per unit of power that entered the medium.
"""

import sys

if sys.version_info < (3, 11):
    raise ImportError(f"dipole needs Python 3.11 or newer; {sys.executable} is older")
try:
    import numpy
except ModuleNotFoundError as error:
    if error.name != "numpy":
        raise
    raise ImportError(
        f"dipole needs numpy, which {sys.executable} does not have. Debian's package "
        "python3-numpy serves /usr/bin/python3; for another Python, run "
        f"{sys.executable} -m pip install numpy"
    ) from None
del numpy, sys

from .aio import AsyncClient
from .broadcast import Values
from .client import Client, Parts
from .connection import Connection, Frame, Tls
from .errors import AddressError, ArgumentError, ConnectError, ConnectionLost, DipoleError
from .errors import LibraryError, ProtocolError, Refused, TableError
from .gathering import Points, gather_at_home
from .surface import Coefficients, Surface
from .table import Table, TableErrors
from .values import Choice, Draw, Errors, Estimate, Fits, Gathered, Grid, Info, Inversion, LayersFit, McEnergy, McProgress, McResult
from .values import McValue, Medium, Offer, Offers, Query, Result, Samples, Stack, TissueFits, Varying

__version__ = "0.1.0"  # the version of the whole project, as in the Makefile

# fmt: off
__all__ = [
    "AddressError", "ArgumentError", "AsyncClient", "Choice", "Client", "Coefficients",
    "ConnectError",
    "Connection", "ConnectionLost", "DipoleError", "Draw", "Errors", "Estimate", "Fits", "Frame", "Gathered", "Grid",
    "Info",
    "Inversion",
    "McEnergy", "McProgress", "McResult", "McValue", "Medium", "Offer", "Offers", "Parts", "Points",
    "LayersFit", "LibraryError", "ProtocolError",
    "Query", "Refused", "Result", "Samples", "Stack", "Surface", "Table",
    "TableError",
    "TableErrors", "TissueFits", "Tls", "Values", "Varying", "gather_at_home",
]
