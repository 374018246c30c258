"""From diffuse albedos and mean free paths to media: requests and answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from . import packing, wire
from .answers import name_of
from .errors import ArgumentError, DipoleError, ProtocolError
from .values import Info

_ARRAYS = 3  # sigma_a, sigma_s, albedo


@dataclass(frozen=True)
class Inversion:
    """Media with given albedos, in the shape of what was given. NaN where there is none."""

    model: str
    moments: str
    sigma_a: np.ndarray  # 1/mm
    sigma_s: np.ndarray  # 1/mm; sigma_s (1 - g) is sigma_s'
    g: float
    eta: float
    albedo: np.ndarray  # that these media have under the model
    albedo_least: float  # what the model can reach with this g and eta
    albedo_most: float
    missing: int  # how many there are not

    @property
    def media(self) -> np.ndarray:
        """[..., 4]: sigma_a, sigma_s, g, eta, as eval() takes them when it is [C, 4]."""
        g = np.full_like(self.sigma_a, self.g)
        eta = np.full_like(self.sigma_a, self.eta)
        return np.stack([self.sigma_a, self.sigma_s, g, eta], axis=-1)


class Query(NamedTuple):
    """What a reply has to fit, and what it does not repeat."""

    shape: tuple[int, ...]
    count: int
    model: int
    moments: int
    given: int
    g: float
    eta: float


class Answer:
    """The answer to an invert request, as it comes."""

    message = "invert"

    def __init__(self, query: Query):
        self.query = query
        self.ended = False  # it is whole, or an error took a part's place
        self.error: DipoleError | None = None
        self.arrays = np.empty((_ARRAYS, query.count))
        self.reach: tuple[float, float] | None = None
        self.missing = 0
        self._next_part = 0
        self._next_medium = 0

    @property
    def is_new(self) -> bool:
        """Whether nothing of it has come yet."""
        return self._next_part == 0 and not self.ended

    def fresh(self) -> Answer:
        """The same, of which nothing has come."""
        return Answer(self.query)

    def refuse(self, error: DipoleError) -> None:
        """An error takes the place of the next part."""
        self.ended = True
        self.error = error

    def add(self, payload: bytes) -> None:
        """Takes the payload of the next reply."""
        fixed = _fixed(payload)
        query = self.query
        count = fixed.medium_count
        if len(payload) != wire.INVERT_REPLY.bytes + _ARRAYS * 8 * count:
            raise ProtocolError("an invert reply whose size does not fit its count")
        if (fixed.model, fixed.moments, fixed.given) != query[2:5]:
            raise ProtocolError("an invert reply that does not answer the request")
        if (fixed.part, fixed.medium_first) != (self._next_part, self._next_medium):
            raise ProtocolError("an invert reply that is not the next part")
        left = query.count - self._next_medium
        self.ended = fixed.part + 1 == fixed.part_count
        if not 0 < count <= left or self.ended != (count == left):
            raise ProtocolError("an invert reply with another number of media than the request")
        reach = (fixed.albedo_least, fixed.albedo_most)
        if fixed.missing_count > count or self.reach not in (None, reach):
            raise ProtocolError("parts of an invert reply that do not belong together")
        values = np.frombuffer(payload, "<f8", _ARRAYS * count, wire.INVERT_REPLY.bytes)
        begin = self._next_medium
        self.arrays[:, begin : begin + count] = values.reshape(_ARRAYS, count)
        self.reach = reach
        self.missing += fixed.missing_count
        self._next_part += 1
        self._next_medium += count


def request(
    info: Info,
    model: str | int,
    albedo: Any,
    length: Any,
    given: str | int,
    g: float,
    eta: float,
    moments: str | int,
) -> tuple[bytes, Query]:
    """The payload of an invert request, see Client.invert(), and what its answer has to fit."""
    try:
        albedos, lengths = np.broadcast_arrays(
            np.asarray(albedo, "<f8"), np.asarray(length, "<f8")
        )
    except ValueError as error:
        raise ArgumentError(f"albedo, length: {error}") from error
    query = Query(
        albedos.shape,
        albedos.size,
        packing.id_of(info, "model", model),
        packing.id_of(info, "moments", moments),
        packing.id_of(info, "length", given),
        float(g),
        float(eta),
    )
    fixed = wire.INVERT_REQUEST.pack(
        model=query.model,
        moments=query.moments,
        given=query.given,
        medium_count=query.count,
        g=query.g,
        eta=query.eta,
    )
    return b"".join([fixed, albedos.tobytes(), lengths.tobytes()]), query


def result(answer: Answer, info: Info) -> Inversion:
    """What a whole answer says; or its error, raised."""
    if answer.error is not None:
        raise answer.error
    query = answer.query
    answer.arrays.setflags(write=False)
    sigma_a, sigma_s, albedo = answer.arrays.reshape(_ARRAYS, *query.shape)
    return Inversion(
        model=name_of(info, "model", query.model),
        moments=name_of(info, "moments", query.moments),
        sigma_a=sigma_a,
        sigma_s=sigma_s,
        g=query.g,
        eta=query.eta,
        albedo=albedo,
        albedo_least=answer.reach[0],
        albedo_most=answer.reach[1],
        missing=answer.missing,
    )


def is_last(payload: bytes) -> bool:
    """Whether an invert reply is the last one of its answer."""
    fixed = _fixed(payload)
    return fixed.part + 1 >= fixed.part_count


def _fixed(payload: bytes) -> Any:
    if len(payload) < wire.INVERT_REPLY.bytes:
        raise ProtocolError("an invert reply that is too short")
    return wire.INVERT_REPLY.unpack(payload)
