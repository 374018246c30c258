"""Requests with known answers, and checks that a connection gives these answers bit for bit."""

from __future__ import annotations

import random
from typing import NamedTuple

from daemons import Daemon
from dipole import Connection, Frame, wire
from frames import (
    ALBEDO, BETTER, CDF, CLASSICAL, EVAL, F32, F64, FIT_REQUEST, INVERT, MEDIA, PING, RADIUS,
    READINGS, SAMPLE, SKIN, SPECTRALON, VARYING, R, eval_payload, fit_payload, frame,
    invert_payload, media_bytes, sample_payload, varying_payload,
)
from lists import PARAMETERS

LUT = 3
OFFERS = wire.MESSAGES["offers"]
TABLE = wire.MESSAGES["table"]


# Options of a daemon that answers the largest request of every_kind() in parts.
PARTS = ("--max-frame-bytes", "1048576", "--max-part-bytes", "65536")


class Known(NamedTuple):
    """A request and its only correct answer: the payloads of all its frames."""

    type: int
    payload: bytes
    answer: tuple[bytes, ...]

    def frame(self, request_id: int) -> bytes:
        """Makes the frame of the request."""
        return frame(self.type, request_id, self.payload)


def receive_answer(connection: Connection) -> tuple[Frame, tuple[bytes, ...]]:
    """Receives the next answer. Returns its first frame, and the payloads of all its parts."""
    first = connection.receive_frame()
    parts = [first.payload]
    last = first
    while not is_last(last):
        last = connection.receive_frame()
        assert (last.type, last.request_id) == (first.type, first.request_id), last[:2]
        parts.append(last.payload)
    return first, tuple(parts)


def is_last(reply: Frame) -> bool:
    """Returns whether no further frame belongs to the same answer."""
    if reply.type in (EVAL | wire.REPLY, SAMPLE | wire.REPLY):
        fixed = wire.EVAL_REPLY.unpack(reply.payload)
    elif reply.type == INVERT | wire.REPLY:
        fixed = wire.INVERT_REPLY.unpack(reply.payload)
    elif reply.type == FIT_REQUEST | wire.REPLY:
        fixed = wire.FIT_REPLY.unpack(reply.payload)
    elif reply.type == VARYING | wire.REPLY:
        fixed = wire.VARYING_REPLY.unpack(reply.payload)
    else:
        return True
    return fixed.part + 1 == fixed.part_count


def assert_answer(known: Known, first: Frame, parts: tuple[bytes, ...]) -> None:
    """Checks that an answer is the known one, bit for bit."""
    assert first.type == known.type | wire.REPLY, f"{first.type:#x}: {refusal(first)}"
    assert parts == known.answer, "an answer with other bits"


def refusal(reply: Frame) -> str:
    """Returns the name of the status of an error frame, or "" for any other frame."""
    if reply.type != wire.TYPE_ERROR:
        return ""
    return wire.STATUSES[wire.ERROR.unpack(reply.payload).status]


def known_answers(daemon: Daemon, requests: list[tuple[int, bytes]]) -> list[Known]:
    """Sends requests to a daemon, one at a time, and returns them with their answers."""
    with daemon.connect() as connection:
        answers = []
        for type, payload in requests:
            connection.send_bytes(frame(type, 1, payload))
            first, parts = receive_answer(connection)
            assert first.type == type | wire.REPLY, refusal(first)
            answers.append(Known(type, payload, parts))
        return answers


def short_requests(count: int, seed: int = 7) -> list[tuple[int, bytes]]:
    """Makes different eval requests of a few radii each, for several models, media and
    precisions."""
    rng = random.Random(seed)
    requests = []
    for i in range(count):
        medium = (rng.uniform(0.01, 0.1), rng.uniform(0.5, 2.0), 0.0, 1.3)
        payload = eval_payload(
            [medium, SKIN][: 1 + i % 2],
            [rng.uniform(0.1, 5.0) for _ in range(1 + i % 16)],
            model=(BETTER, CLASSICAL)[i % 2],
            evaluator=(F64, F32)[i // 2 % 2],
            wanted=R | ALBEDO | CDF,
        )
        requests.append((EVAL, payload))
    return requests


def every_kind() -> list[tuple[int, bytes]]:
    """Makes one request of each kind whose answer is always the same."""
    grid = {"radii": None, "radius_stop": 20.0}
    tolerance = PARAMETERS["tolerance"].id
    table = wire.TABLE_REQUEST.pack(model=BETTER, moments=1, parameter_count=0)
    return [
        *short_requests(12),
        (PING, b"8 bytes!"),
        (MEDIA, b""),
        (EVAL, eval_payload([SPECTRALON], [], wanted=ALBEDO)),
        (EVAL, eval_payload([SKIN] * 3, **grid, radius_count=5000, wanted=R | RADIUS)),
        (EVAL, eval_payload([SKIN], **grid, radius_count=300, evaluator=LUT, wanted=R)),
        (EVAL, eval_payload([SKIN], **grid, radius_count=400_000, evaluator=F32, wanted=R)),
        (OFFERS, eval_payload([SKIN], [0.5, 1.0], [(tolerance, 0.3)], model=wire.ANY_MODEL)),
        (TABLE, table + media_bytes([SKIN])),
        (SAMPLE, sample_payload([SKIN, SPECTRALON])),
        (SAMPLE, sample_payload([SKIN] * 2, None, sample_count=3000)),
        (SAMPLE, sample_payload([SKIN], None, sample_count=200_000, evaluator=LUT)),
        (INVERT, invert_payload()),
        (FIT_REQUEST, fit_payload([READINGS, (0.02, 0.008, 0.002)], residuals=1)),
        (VARYING, varying_payload(wanted=R | ALBEDO, coefficients=1)),
        (INVERT, invert_payload([i / 3000 for i in range(1, 3000)], [1.0] * 2999)),
    ]

