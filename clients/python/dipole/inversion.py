"""Client.invert(): finds media from diffuse albedos and mean free paths."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import exchange, wire
from .arguments import id_of, name_of
from .session import Session
from .errors import ArgumentError, ProtocolError
from .values import Info, Inversion

_ARRAYS = 3  # sigma_a, sigma_s, albedo


class Answer(exchange.InParts[Inversion]):
    """The answer to an invert request. fixed: the request's structure. shape: of the media. info:
    names the ids."""

    def __init__(self, fixed: dict[str, Any], shape: tuple[int, ...], info: Info):
        super().__init__("invert_reply", fixed["medium_count"])
        self._fixed, self._shape, self._info = fixed, shape, info
        self._arrays = np.empty((_ARRAYS, fixed["medium_count"]))
        self._reach: tuple[float, float] | None = None
        self._missing = 0

    def _check(self, fixed: Any) -> None:
        asked = ("model", "moments", "given")
        if fixed.count == 0 or any(getattr(fixed, name) != self._fixed[name] for name in asked):
            raise ProtocolError("an invert reply that does not answer the request")

    def _take(self, fixed: Any, parts: dict[str, Any], items: slice) -> None:
        reach = (fixed.albedo_least, fixed.albedo_most)
        if fixed.missing_count > fixed.count or self._reach not in (None, reach):
            raise ProtocolError("parts of an invert reply that do not belong together")
        self._arrays[:, items] = list(parts.values())
        self._reach = reach
        self._missing += fixed.missing_count

    def _whole(self) -> Inversion:
        fixed = self._fixed
        assert self._reach is not None
        self._arrays.setflags(write=False)
        sigma_a, sigma_s, albedo = self._arrays.reshape(_ARRAYS, *self._shape)
        return Inversion(
            model=name_of(self._info, "model", fixed["model"]),
            moments=name_of(self._info, "moments", fixed["moments"]),
            sigma_a=sigma_a,
            sigma_s=sigma_s,
            g=fixed["g"],
            eta=fixed["eta"],
            albedo=albedo,
            albedo_least=self._reach[0],
            albedo_most=self._reach[1],
            missing=self._missing,
        )


async def invert(
    session: Session,
    model: str | int,
    albedo: Any,
    length: Any,
    *,
    given: str | int = "mean-free-path",
    g: float = 0.0,
    eta: float = 1.3,
    moments: str | int = "exact",
    deadline_ms: int = 0,
) -> Inversion:
    """Finds media that have given diffuse albedos under a model.

    albedo: from 0 to 1, of any shape, such as a texture [H, W, 3]. length: mm, of a shape that
    can be broadcast with that of albedo. Where the model cannot reach an albedo, the medium is
    NaN. options: given names the kind of length, from info.choices["length"]. The default,
    "mean-free-path", is 1 / (sigma_a + sigma_s (1 - g)). g=0.0 and eta=1.3 hold for all media.
    moments, deadline_ms: as of a Query.
    """
    info = session.info
    try:
        albedos, lengths = np.broadcast_arrays(np.asarray(albedo, "<f8"), np.asarray(length, "<f8"))
    except ValueError as error:
        raise ArgumentError(f"albedo, length: {error}") from error
    fixed = {
        "model": id_of(info, "model", model),
        "moments": id_of(info, "moments", moments),
        "given": id_of(info, "length", given),
        "medium_count": albedos.size,
        "g": float(g),
        "eta": float(eta),
    }
    arrays = {"albedo": albedos.tobytes(), "length": lengths.tobytes()}
    payload = wire.PAYLOADS["invert_request"].pack(fixed, **arrays)

    def answer() -> Answer:
        return Answer(fixed, albedos.shape, info)

    return await session.ask(exchange.Request("invert", payload, answer, deadline_ms))
