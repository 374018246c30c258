"""Client.tissue(): the media of a tissue at wavelengths."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from . import wire
from .arguments import id_of, parameters_of
from .errors import ProtocolError, naming
from .exchange import Once, Request
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
    info = session.info
    with naming("wavelengths_nm: one number, or an array [N]"):
        wavelengths = np.asarray(wavelengths_nm, "<f8").reshape(-1)
    fixed = {
        "tissue": 0 if name is None else id_of(info, "tissue", name),
        "haemoglobin": id_of(info, "haemoglobin", haemoglobin),
    }
    listed = parameters_of(info, properties, kind="property")
    payload = wire.PAYLOADS["tissue_request"].pack(
        fixed, property=listed, wavelength=wavelengths.tobytes()
    )

    def read(reply: bytes) -> list[Medium]:
        found, parts = wire.PAYLOADS["tissue_reply"].unpack(reply)
        if (found.haemoglobin, len(parts["media"])) != (fixed["haemoglobin"], wavelengths.size):
            raise ProtocolError("media of another tissue")
        return [Medium(*map(float, one)) for one in parts["media"]]

    return await session.call(Request("tissue", payload, lambda: Once(read), deadline_ms))
