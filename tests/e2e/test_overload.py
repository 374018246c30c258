"""More than can be done: large requests are refused in time, with a hint when to come again; small
ones go on, and nobody suffers from who does not read."""

from __future__ import annotations

import pytest
from daemons import eventually
from dipole import Connection, wire
from frames import EVAL, R, ask, assert_error, assert_serves, eval_payload, frame, statistics
from lists import MODELS
from parted import EVALUATED, put_together, receive_parts

# About a second of work, in one frame.
LONG = eval_payload(model=MODELS["beam+single"], radii=None, radius_count=1_000_000, wanted=R)
# A fraction of a millisecond.
LARGE = eval_payload(radii=None, radius_count=100_000, wanted=R)
# What counts as small, and one radius more.
LARGEST_SMALL = eval_payload(radii=None, radius_count=16384, wanted=R)
SMALLEST_LARGE = eval_payload(radii=None, radius_count=16385, wanted=R)


def start(connection: Connection, watcher: Connection, payload: bytes) -> None:
    """Sends a request and waits until it is being evaluated."""
    before = statistics(watcher)["radii_evaluated"]
    connection.send_bytes(frame(EVAL, 77, payload))
    assert eventually(lambda: statistics(watcher)["radii_evaluated"] > before)


def test_large_requests_are_refused_while_there_is_much_to_do(daemon):
    one = daemon("--workers", "1", "--max-backlog-ms", "1")
    with one.connect() as busy, one.connect() as other:
        start(busy, other, LONG)
        for payload in (LARGE, SMALLEST_LARGE):
            reply = ask(other, EVAL, payload)
            assert_error(reply, "busy", "radius_count", "max_backlog_ms")
            assert 0 < wire.ERROR.unpack(reply.payload).retry_after_ms < 1000
        assert ask(other, EVAL, LARGEST_SMALL).type == EVALUATED
        for _ in range(20):
            assert_serves(other)
        assert statistics(other)["answers_busy"] == 2
        assert receive_parts(busy)[0].fixed.radius_count == 1_000_000
        assert ask(other, EVAL, LARGE).type == EVALUATED


def test_the_default_takes_several(daemon):
    one = daemon("--workers", "1")
    with one.connect() as busy, one.connect() as other:
        start(busy, other, LONG)
        assert ask(other, EVAL, LARGE).type == EVALUATED
        assert receive_parts(busy)[0].fixed.radius_count == 1_000_000


def test_other_workers_have_less_to_do(daemon):
    """A worker's backlog is its own; a connection that comes goes where the fewest are."""
    one = daemon("--workers", "2", "--max-backlog-ms", "1")
    with one.connect() as busy, one.connect() as other:
        start(busy, other, LONG)
        assert ask(other, EVAL, LARGE).type == EVALUATED
        assert receive_parts(busy)[0].fixed.radius_count == 1_000_000


@pytest.mark.parametrize("count", [2**31, 2**40])
def test_who_does_not_read_gives_nobody_a_backlog(daemon, count):
    one = daemon("--workers", "1", "--max-backlog-ms", "1")
    with one.connect() as stuck, one.connect() as other:
        stuck.send_bytes(frame(EVAL, 1, eval_payload(radii=None, radius_count=count, wanted=R)))
        stuck.receive_bytes(1)
        assert eventually(lambda: ask(other, EVAL, LARGE).type == EVALUATED)
        for _ in range(20):
            assert ask(other, EVAL, LARGE).type == EVALUATED


def test_a_request_larger_than_the_backlog_is_taken_when_there_is_none(daemon):
    one = daemon("--workers", "1", "--max-backlog-ms", "1", "--max-frame-bytes", "65536")
    with one.connect() as connection:
        for _ in range(3):  # one after the other on a connection: none is in another's way
            payload = eval_payload(radii=None, radius_count=2_000_000, wanted=R)
            connection.send_bytes(frame(EVAL, 77, payload) * 2)
            for _ in range(2):
                assert put_together(receive_parts(connection)).fixed.radius_count == 2_000_000
