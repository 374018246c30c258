"""Receives answers to eval requests in parts, and puts the parts together."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from dipole import Connection, wire
from frames import EVAL, head_bytes

EVALUATED = EVAL | wire.REPLY


class Part(NamedTuple):
    """The arrays and fields of an eval reply."""

    fixed: Any
    channels: bytes
    # The radii, if they are in the reply, and then each channel's arrays, as bits.
    rows: list[np.ndarray]


def take_apart(payload: bytes) -> Part:
    """Reads a part, and checks that it is a whole reply: every array is there, padded with zero
    bytes."""
    fixed = wire.EVAL_REPLY.unpack(payload)
    value_bytes = np.dtype(wire.EVALUATOR_TYPES[fixed.evaluator]).itemsize
    arrays = fixed.channel_count * sum(1 for q in wire.ELEMENTWISE if fixed.wanted & q)
    arrays += bool(fixed.wanted & wire.QUANTITY_RADIUS)
    start = head_bytes(fixed.channel_count, fixed.wanted.bit_count())
    used = fixed.count * value_bytes
    stride = wire.padded(used)
    assert len(payload) == start + arrays * stride
    rows = []
    for at in range(start, len(payload), stride or 1):
        rows.append(np.frombuffer(payload, f"<u{value_bytes}", fixed.count, at))
        assert payload[at + used : at + stride] == bytes(stride - used)
    return Part(fixed, payload[wire.EVAL_REPLY.bytes : start], rows)


def receive_parts(connection: Connection, request_id: int = 77) -> list[Part]:
    """Receives all parts of the next answer."""
    parts: list[Part] = []
    while not parts or parts[-1].fixed.part + 1 < parts[-1].fixed.part_count:
        reply = connection.receive_frame()
        assert (reply.type, reply.request_id) == (EVALUATED, request_id), reply[:2]
        parts.append(take_apart(reply.payload))
    return parts


def put_together(parts: list[Part]) -> Part:
    """Makes one reply of the parts, which must follow each other and agree."""
    first = parts[0]
    radii = 0
    for number, part in enumerate(parts):
        assert part.fixed.part == number and part.fixed.first == radii
        radii += part.fixed.count
        alike = {"part": 0, "first": 0, "count": 0}
        assert part.fixed._replace(**alike) == first.fixed._replace(**alike)
        assert part.channels == first.channels
        assert part.fixed.count > 0 or part.fixed.part_count == 1
    assert len(parts) == first.fixed.part_count
    rows = [np.concatenate(row) for row in zip(*(part.rows for part in parts), strict=True)]
    whole = {"part": 0, "part_count": 1, "first": 0, "count": radii}
    return Part(first.fixed._replace(**whole), first.channels, rows)


def assert_same(one: Part, other: Part) -> None:
    """Checks that two replies are the same, bit for bit."""
    assert one.fixed == other.fixed
    assert one.channels == other.channels
    for row, other_row in zip(one.rows, other.rows, strict=True):
        np.testing.assert_array_equal(row, other_row)
