"""Answers to evaluations: of one part or many, checked against what was asked, as arrays."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np

from . import wire
from .errors import DipoleError, ProtocolError
from .values import Info, Result


class Query(NamedTuple):
    """What a reply has to fit, and what it does not repeat."""

    radii: np.ndarray | None  # as listed; None for a grid
    value_type: str | None  # numpy's, of radii and values; None: not known here
    wanted: int
    medium_count: int
    radius_count: int
    handed_on: bool = False  # its parts are wanted one by one
    message: str = "eval"  # or "sample": each channel has radii of its own


class Part(NamedTuple):
    """A part of an answer, or all of it."""

    fixed: Any  # the eval_reply structure
    channels: np.ndarray  # [C, 4], the channel structures
    arrays: dict[int, np.ndarray]  # by quantity: the radii [N] and values [C, N]


class Answer:
    """The answer to a query, as it comes."""

    def __init__(self, query: Query):
        self.query = query
        self.ended = False  # nothing more will come: it is whole, or an error took a part's place
        self.ready: deque[Part | DipoleError] = deque()  # all of it, or what is to be handed on
        self._first: Part | None = None
        self._next_part = 0
        self._next_radius = 0
        self._whole: dict[int, np.ndarray] = {}

    @property
    def message(self) -> str:
        """What it answers."""
        return self.query.message

    def fresh(self) -> Answer:
        """The same, of which nothing has come."""
        return Answer(self.query)

    @property
    def is_new(self) -> bool:
        """Whether nothing of it has come yet."""
        return self._next_part == 0 and not self.ended

    def refuse(self, error: DipoleError) -> None:
        """An error takes the place of the next part: there will be nothing whole."""
        self.ended = True
        self.ready.append(error)

    def add(self, payload: bytes) -> None:
        """Takes the payload of the next reply."""
        part = _unpack(payload, self.query.message == "sample")
        self._check(part)
        fixed = part.fixed
        self.ended = fixed.part + 1 == fixed.part_count
        if self._first is None:
            self._first = Part(fixed, part.channels.copy(), {})
        if self.query.handed_on or fixed.part_count == 1:
            self.ready.append(part)
        else:
            self._gather(part)
        self._next_part += 1
        self._next_radius += fixed.radius_count

    def _check(self, part: Part) -> None:
        """A caller who counts on what it asked for must not be mistaken."""
        fixed, query = part.fixed, self.query
        value_type = wire.EVALUATOR_TYPES.get(fixed.evaluator)
        shape = (value_type, fixed.wanted, fixed.channel_count)
        if value_type is None or shape != (query.value_type, query.wanted, query.medium_count):
            raise ProtocolError("an eval reply that does not answer the query")
        left = query.radius_count - self._next_radius
        is_last = fixed.part + 1 == fixed.part_count
        if (fixed.part, fixed.radius_first) != (self._next_part, self._next_radius):
            raise ProtocolError("an eval reply that is not the next part")
        if fixed.radius_count > left or is_last != (fixed.radius_count == left):
            raise ProtocolError("an eval reply with another number of radii than the query")
        if fixed.radius_count == 0 and fixed.part_count != 1:
            raise ProtocolError("a part of an eval reply with no radii")
        if self._first is not None and _said_by_all(part) != _said_by_all(self._first):
            raise ProtocolError("parts of an eval reply that do not belong together")

    def _gather(self, part: Part) -> None:
        count = self.query.radius_count
        begin = part.fixed.radius_first
        for quantity, array in part.arrays.items():
            if begin == 0:
                self._whole[quantity] = np.empty((*array.shape[:-1], count), array.dtype)
            self._whole[quantity][..., begin : begin + part.fixed.radius_count] = array
        if self.ended:
            for array in self._whole.values():
                array.setflags(write=False)
            fixed = part.fixed._replace(radius_count=count, radius_first=0, part=0, part_count=1)
            self.ready.append(Part(fixed, self._first.channels, self._whole))


def name_of(info: Info, kind: str, number: int) -> str:
    """The daemon's name of a choice that a reply has by its number."""
    for choice in info.choices[kind].values():
        if choice.id == number:
            return choice.name
    raise ProtocolError(f"a reply with {kind} {number}, which the daemon has not listed")


def result(answer: Answer, info: Info) -> Result:
    """What is ready of an answer: all of it, or its next part; or its error, raised."""
    part = answer.ready.popleft()
    if isinstance(part, DipoleError):
        raise part
    fixed, channels, arrays = part
    first = fixed.radius_first
    r = arrays.get(wire.QUANTITY_RADIUS)
    if r is None and answer.query.radii is not None:
        r = answer.query.radii[first : first + fixed.radius_count]
    quantities = info.choices["quantity"].values()
    elementwise = arrays.keys() - {wire.QUANTITY_RADIUS}
    notes = info.choices["note"].values()
    return Result(
        model=name_of(info, "model", fixed.model),
        evaluator=name_of(info, "evaluator", fixed.evaluator),
        moments=name_of(info, "moments", fixed.moments),
        r=r,
        R=arrays.get(wire.QUANTITY_R),
        cdf=arrays.get(wire.QUANTITY_CDF),
        dR_dr=arrays.get(wire.QUANTITY_SLOPE),
        ln_R=arrays.get(wire.QUANTITY_LN_R),
        pdf=arrays.get(wire.QUANTITY_PDF),
        two_pi_r_R=arrays.get(wire.QUANTITY_RING),
        S=arrays.get(wire.QUANTITY_S),
        albedo=channels[:, 0] if fixed.wanted & wire.QUANTITY_ALBEDO else None,
        numerical_error_constant=channels[:, 1],
        numerical_error_per_mm=channels[:, 2],
        model_error=channels[:, 3],
        notes=tuple(note.name for note in notes if note.id and fixed.notes & note.id),
        values={one.name: arrays[one.id] for one in quantities if one.id in elementwise},
        radius_first=first,
    )


def is_last(payload: bytes) -> bool:
    """Whether an eval reply is the last one of its answer."""
    fixed = _fixed(payload)
    return fixed.part + 1 >= fixed.part_count


def _said_by_all(part: Part) -> tuple[Any, bytes]:
    """What is the same in all parts of an answer."""
    fixed = part.fixed._replace(radius_count=0, radius_first=0, part=0)
    return fixed, part.channels.tobytes()


def _fixed(payload: bytes) -> Any:
    if len(payload) < wire.EVAL_REPLY.bytes:
        raise ProtocolError("an eval reply that is too short")
    return wire.EVAL_REPLY.unpack(payload)


def _unpack(payload: bytes, drawn: bool) -> Part:
    """Each array is padded to a multiple of 8 bytes, the radii first unless they are drawn, then
    each channel's quantities."""
    fixed = _fixed(payload)
    if fixed.evaluator not in wire.EVALUATOR_TYPES:
        raise ProtocolError(f"an eval reply of evaluator {fixed.evaluator}, not known here")
    value_type = np.dtype(wire.EVALUATOR_TYPES[fixed.evaluator])
    per_channel = [q for q in (wire.DRAWN if drawn else wire.ELEMENTWISE) if fixed.wanted & q]
    wanted_r = bool(fixed.wanted & wire.QUANTITY_RADIUS) and not drawn
    channels_bytes = fixed.channel_count * wire.CHANNEL.bytes
    stride = wire.padded(fixed.radius_count * value_type.itemsize)
    array_count = fixed.channel_count * len(per_channel) + wanted_r
    at = wire.EVAL_REPLY.bytes
    if len(payload) != at + channels_bytes + array_count * stride:
        raise ProtocolError("an eval reply whose size does not fit its counts")
    channels = np.frombuffer(payload, "<f8", channels_bytes // 8, at).reshape(-1, 4)
    values = np.frombuffer(payload, value_type, -1, at + channels_bytes)
    rows = values.reshape(array_count, -1)[:, : fixed.radius_count] if array_count else None
    arrays: dict[int, np.ndarray] = {}
    if wanted_r:
        arrays[wire.QUANTITY_RADIUS] = rows[0]
    for i, quantity in enumerate(per_channel):
        arrays[quantity] = rows[wanted_r + i :: len(per_channel)]
    return Part(fixed, channels, arrays)
