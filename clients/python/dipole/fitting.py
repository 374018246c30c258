"""Client.fit(): finds sigma_a and sigma_s' of media from readings of their reflectance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from . import exchange, wire
from .errors import ArgumentError, ProtocolError
from .evaluation import id_of, media_array, parameters_list
from .values import Array, Fits, Info, Media

_SETS = wire.FITTED.dtype()
_REQUEST_BYTES = 16 << 20  # larger images are sent in several requests
OUTSTANDING = 2  # requests under way at a time


class Design(NamedTuple):
    """What all sets of readings have in common."""

    head: bytes  # the structures and arrays of a request from fit_design on
    shape: tuple[int, ...]  # of the sets
    values: Array  # [sets, readings]
    errors: Array
    wants_residuals: bool
    g: float | None  # None: not given, so that it is 0
    eta: float
    deadline_ms: int


class Part(NamedTuple):
    """What was found for some of the sets."""

    first: int
    sets: Array
    residuals: Array


class Answer(exchange.Answer[Part]):
    """The answer to one fit request: puts its parts together. first: position of its first set."""

    def __init__(self, first: int, set_count: int, residuals: int):
        super().__init__()
        self._sets = np.empty(set_count, _SETS)
        self._residuals = np.empty((set_count, residuals))
        self._first = first
        self._next_part = 0
        self._next_set = 0

    def _add(self, payload: bytes) -> None:
        if len(payload) < wire.FIT_REPLY.bytes:
            raise ProtocolError("a fit reply that is too short")
        fixed = wire.FIT_REPLY.unpack(payload)
        count, begin, readings = fixed.set_count, self._next_set, self._residuals.shape[1]
        at = wire.FIT_REPLY.bytes + count * wire.FITTED.bytes
        if fixed.reading_count != readings or len(payload) != at + 8 * count * readings:
            raise ProtocolError("a fit reply whose size does not fit its counts")
        if (fixed.part, fixed.set_first) != (self._next_part, begin):
            raise ProtocolError("a fit reply that is not the next part")
        left = len(self._sets) - begin
        is_last = fixed.part + 1 == fixed.part_count
        if not 0 < count <= left or is_last != (count == left) or fixed.fitted_count > count:
            raise ProtocolError("a fit reply with another number of sets than the request")
        self._sets[begin : begin + count] = np.frombuffer(
            payload, _SETS, count, wire.FIT_REPLY.bytes
        )
        residuals = np.frombuffer(payload, "<f8", count * readings, at)
        self._residuals[begin : begin + count] = residuals.reshape(count, readings)
        self._next_part += 1
        self._next_set += count
        self.ended = is_last
        if is_last:
            self.ready.append(Part(self._first, self._sets, self._residuals))


def _arrays(values: Any, errors: Any) -> tuple[Array, Array]:
    try:
        readings = np.asarray(values, "<f8")
        spread = np.broadcast_to(np.asarray(errors, "<f8"), readings.shape)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"values, errors: {error}") from error
    if readings.ndim == 0:
        raise ArgumentError("values: an array [..., N] of the readings at N places")
    return readings, spread


def _place(name: str, given: Any, readings: int) -> Array:
    try:
        return np.ascontiguousarray(np.broadcast_to(np.asarray(given, "<f8"), (readings,)))
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{name}: one number, or an array [{readings}]: {error}") from error


def design(
    info: Info,
    model: str | int,
    at: Any,
    values: Any,
    errors: Any,
    *,
    axis: str | int = "r",
    scale: str | int = "absolute",
    reference: Media | None = None,
    source: Any = 0.0,
    detector: Any = 0.0,
    g: float | None = None,
    eta: float | None = None,
    moments: str | int = "exact",
    parameters: Mapping[str, float | str] | None = None,
    residuals: bool = False,
    deadline_ms: int = 0,
) -> Design:
    """See Client.fit()."""
    if eta is None:
        raise ArgumentError("eta: give the refractive index inside over outside: it has no default")
    readings, spread = _arrays(values, errors)
    count = readings.shape[-1]
    scale_id = id_of(info, "scale", "reference" if reference is not None else scale)
    listed = parameters_list(info, parameters)
    fixed = wire.FIT_DESIGN.pack(
        model=id_of(info, "model", model),
        moments=id_of(info, "moments", moments),
        axis=id_of(info, "axis", axis),
        scale=scale_id,
        reading_count=count,
        parameter_count=len(listed),
        g=float(g or 0.0),
        eta=float(eta),
    )
    medium = b""
    if scale_id == wire.SCALE_REFERENCE:
        if reference is None:
            raise ArgumentError("reference: the medium whose readings the values were divided by")
        known = media_array(reference)
        if len(known) != 1:
            raise ArgumentError("reference: one Medium")
        medium = known.tobytes()
    given = {"at": at, "source": source, "detector": detector}
    places = [_place(name, one, count).tobytes() for name, one in given.items()]
    return Design(
        head=b"".join([fixed, *listed, medium, *places]),
        shape=readings.shape[:-1],
        values=readings.reshape(-1, count),
        errors=spread.reshape(-1, count),
        wants_residuals=residuals,
        g=None if g is None else float(g),
        eta=float(eta),
        deadline_ms=deadline_ms,
    )


def requests(made: Design) -> Iterator[exchange.Request[Part]]:
    """Yields the requests for all sets, one after the other."""
    total, readings = made.values.shape
    each = max(1, _REQUEST_BYTES // (16 * max(readings, 1)))
    for first in range(0, max(total, 1), each):
        count = min(each, total - first)
        fixed = wire.FIT_REQUEST.pack(set_count=count, residuals=int(made.wants_residuals))
        values = made.values[first : first + count].tobytes()
        errors = made.errors[first : first + count].tobytes()
        residuals = readings if made.wants_residuals else 0

        def answer(first: int = first, count: int = count, residuals: int = residuals) -> Answer:
            return Answer(first, count, residuals)

        payload = b"".join([fixed, made.head, values, errors])
        yield exchange.Request("fit", payload, answer, made.deadline_ms)


class Collected:
    """The results of all requests."""

    def __init__(self, info: Info, made: Design):
        self._info = info
        self._made = made
        self._sets = np.empty(len(made.values), _SETS)
        self._residuals = np.empty_like(made.values) if made.wants_residuals else None

    def add(self, part: Part) -> None:
        end = part.first + len(part.sets)
        self._sets[part.first : end] = part.sets
        if self._residuals is not None:
            self._residuals[part.first : end] = part.residuals

    def fits(self) -> Fits:
        self._sets.setflags(write=False)
        residuals = self._residuals
        if residuals is not None:
            residuals = residuals.reshape(*self._made.shape, residuals.shape[-1])
        names = {choice.id: name for name, choice in self._info.choices["fit_status"].items()}
        made = self._made
        return Fits(self._sets.reshape(made.shape), residuals, names, made.g or 0.0, made.eta,
                    made.g is None)
