"""Client.tissue(): the media of a tissue at wavelengths."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .errors import naming
from .message import call
from .session import Session
from .values import Medium


async def tissue(
    session: Session,
    wavelengths_nm: Any,
    name: str | int | None = None,
    properties: Mapping[str, float] | None = None,
    *,
    haemoglobin: str | int = "prahl",
    deadline_ms: int = 0,
) -> list[Medium]:
    """Returns the medium that a tissue is at each wavelength, for eval(), which takes up to
    info.limits["max_media"] of them at a time, and for other calls.

    wavelengths_nm: one, or up to 1024. name: of a tissue of info.choices["tissue"], whose sources
    stand there. properties: what differs from it, by names of info.choices["property"], such as
    {"hbo2_uM": 56, "hb_uM": 24, "water_fraction": 0.65, "a_per_mm": 4.6, "b": 1.42}; without a name, all
    there is: a_per_mm and b have to be given, and other amounts are 0. haemoglobin: the table of
    its absorption, "prahl" or "ucl". They differ by up to 31 %: say with results which one it was.
    Refused is a wavelength at which a spectrum or the scattering law is not known."""
    with naming("wavelengths_nm: one number, or an array [N]"):
        wavelengths = np.asarray(wavelengths_nm, "<f8").reshape(-1)
    given = {
        "tissue": 0 if name is None else name,
        "haemoglobin": haemoglobin,
        "property": properties,
        "wavelength": wavelengths,
    }
    found = await call(session, "tissue", given, deadline_ms=deadline_ms)
    return [Medium(*map(float, one)) for one in found["media"]]
