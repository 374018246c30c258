"""Answers in parts use no more memory than small answers, and what ends them. test_messages.py has
their bits and sizes."""

import time
from contextlib import nullcontext

import pytest
from daemons import eventually
from dipole import ConnectionLost, wire
from frames import (
    CDF, EVAL, F32, F64, R, ask, assert_closed, assert_daemon_serves, assert_error, assert_serves,
    eval_payload, frame, receive_reply, statistics,
)
from lists import MODELS, PARAMETERS
from messages import receive_answer

EVALUATED = EVAL | wire.REPLY
LUT = 3
# An answer of 16 GB, more than any test reads. Its work is less than max_backlog_ms.
ENDLESS = {"radii": None, "radius_count": 2**31, "wanted": R}


def test_a_slow_profile_is_prepared_once_for_all_parts(daemon):
    one = daemon("--max-frame-bytes", "4096", "--max-part-bytes", "4096")
    gaussians = [(PARAMETERS["gaussians"].id, 6.0)]
    grid = {"radii": None, "radius_count": 3000, "radius_start": 0.5, "radius_stop": 4.0}
    for fields in (
        {"model": MODELS["transport"], "evaluator": F64, "wanted": R},
        {"model": MODELS["transport"], "evaluator": LUT, "wanted": CDF},
        {"model": MODELS["gaussians"], "evaluator": F32, "wanted": R, "parameters": gaussians},
    ):
        with one.connect() as connection:
            before = statistics(connection)["cache_builds"]
            connection.send_bytes(frame(EVAL, 77, eval_payload(**grid, **fields)))
            assert len(receive_answer(connection)[1]) > 3
            assert statistics(connection)["cache_builds"] == before + 1


# ---- readers -------------------------------------------------------------------------------------


def settled(read) -> bool:
    """Returns whether a number has stopped changing."""
    before = read()
    time.sleep(0.05)
    return read() == before


def test_a_reader_that_stops_costs_bounded_memory_and_no_time(daemon):
    one = daemon("--workers", "1")
    with one.connect() as stuck, one.connect() as other:
        stuck.send_bytes(frame(EVAL, 1, eval_payload(**ENDLESS)))
        for _ in range(20):
            assert receive_reply(stuck).type == EVALUATED
        # The daemon evaluates only as much as it queues for this reader.
        assert eventually(lambda: settled(lambda: statistics(other)["radii_evaluated"]))
        limits = 4 * (1 << 20)  # max_queued_bytes, a part that had begun, and more
        for _ in range(20):
            assert statistics(other)["buffer_bytes"] < limits
            assert_serves(other)
        evaluated = statistics(other)["radii_evaluated"]
        number = 20
        for _ in range(20):  # When the client reads again, the answer goes on where it stopped.
            assert wire.PART.unpack(receive_reply(stuck).payload).part == number
            number += 1
        assert eventually(lambda: statistics(other)["radii_evaluated"] > evaluated)
        assert statistics(other)["buffer_bytes"] < limits
    assert_daemon_serves(one)


# ---- ends ----------------------------------------------------------------------------------------


def test_stopping_lets_an_answer_end(daemon):
    one = daemon("--max-frame-bytes", "1048576")
    with one.connect() as connection:
        count = 4_000_000
        payload = eval_payload(radii=None, radius_count=count, wanted=R)
        connection.send_bytes(frame(EVAL, 77, payload))
        first = wire.PART.unpack(receive_reply(connection).payload)
        one.terminate()
        _, parts = receive_answer(connection)
        assert first.count + sum(wire.PART.unpack(part).count for part in parts) == count
        assert_error(connection.receive_frame(), "shutting-down", "daemon", "another one", request_id=0)
        assert_closed(connection)
    assert one.wait() == 0


@pytest.mark.parametrize("reads", [True, False])
def test_stopping_does_not_wait_for_an_answer_without_end(daemon, reads):
    one = daemon("--drain-timeout-ms", "300")
    with one.connect() as connection:
        connection.send_bytes(frame(EVAL, 77, eval_payload(**ENDLESS)))
        connection.receive_frame()
        one.terminate()
        with pytest.raises(ConnectionLost) if reads else nullcontext():
            while reads:
                connection.receive_frame()
        assert one.wait() == 0


def test_an_answer_that_memory_does_not_let_go_on(daemon):
    """When other connections hold the memory, the next part is refused with BUSY. Later requests
    are answered again."""
    total = (7 << 20) // 2
    one = daemon("--max-total-bytes", str(total), "--workers", "1")
    with one.connect() as first, one.connect() as second:
        first.send_bytes(frame(EVAL, 1, eval_payload(**ENDLESS)))
        first.receive_bytes(1)
        with one.connect() as watcher:
            evaluated = lambda: statistics(watcher)["radii_evaluated"]  # noqa: E731
            assert eventually(lambda: settled(evaluated))
            assert statistics(watcher)["buffer_bytes"] > 2 << 20
        second.send_bytes(frame(EVAL, 77, eval_payload(**ENDLESS)))
        assert wire.PART.unpack(receive_reply(second).payload).part == 0
        assert_error(second.receive_frame(), "busy", "max_total_bytes", "fewer bytes")
        first.close()
        assert_serves(second)

        def taken_again() -> bool:
            reply = ask(second, EVAL, eval_payload(radii=None, radius_count=200_000, wanted=R))
            return reply.type == EVALUATED

        assert eventually(taken_again)
