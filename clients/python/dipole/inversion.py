"""Client.invert(): finds media from diffuse albedos and mean free paths."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import wire
from .arguments import ids_of, names_of_ids
from .errors import ProtocolError, naming
from .exchange import InParts, Joined, Request
from .session import Session
from .values import Inversion


async def invert(
    session: Session,
    model: str | int,
    albedo: Any,
    length: Any,
    *,
    given: str | int = "mean-free-path",
    light: str | int = "beam",
    specular: bool = False,
    g: float = 0.0,
    eta: float = 1.3,
    moments: str | int = "exact",
    deadline_ms: int = 0,
) -> Inversion:
    """Finds media that have given diffuse albedos under a model.

    albedo: from 0 to 1, of any shape, such as a texture [H, W, 3]. length: mm (for other
    units multiply), of a shape that can be broadcast with that of albedo. Where the model cannot reach an albedo, the medium is
    NaN. options: given names the kind of length, from info.choices["length"]. The default,
    "mean-free-path", is 1 / (sigma_a + sigma_s (1 - g)). light: "beam" or, with transport,
    "diffuse". specular: whether the albedos, which are linear, contain what the surface itself
    reflects. g=0.0 and eta=1.3 hold for all media. moments, deadline_ms: as of a Query.
    """
    info = session.info
    with naming("albedo, length"):
        albedos, lengths = np.broadcast_arrays(np.asarray(albedo, "<f8"), np.asarray(length, "<f8"))
    same = ids_of(info, model=model, moments=moments, given=given) | {"errors": 2}
    fixed = {"specular": bool(specular), "g": float(g), "eta": float(eta), **same}
    fixed |= ids_of(info, light=light)
    payload = wire.PAYLOADS["invert_request"].pack(
        fixed, albedo=albedos.tobytes(), length=lengths.tobytes()
    )

    def read(whole: Joined) -> Inversion:
        reach, *others = {(one.albedo_least, one.albedo_most) for one in whole.replies}
        if others:
            raise ProtocolError("parts of an invert reply that do not belong together")
        made: dict[str, Any] = {name: one.reshape(albedos.shape) for name, one in whole.arrays.items()}
        made |= names_of_ids(info, same, "model", "moments")
        return Inversion(
            **made,
            g=float(g),
            eta=float(eta),
            albedo_least=reach[0],
            albedo_most=reach[1],
            missing=sum(one.missing_count for one in whole.replies),
        )

    def replies() -> InParts[Inversion]:
        return InParts("invert_reply", albedos.size, same, read)

    return await session.call(Request("invert", payload, replies, deadline_ms))
