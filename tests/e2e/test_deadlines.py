"""Deadlines: a request is answered in time or gets the error DEADLINE soon after its deadline.
Other requests do not suffer."""

from __future__ import annotations

import time

import dipole
import numpy as np
import pytest
from daemons import sanitized
from dipole import Connection, Frame, wire
from frames import (
    EVAL, HELLO, MEDIA, PING, SKIN, STATISTICS, R, ask, assert_daemon_serves, assert_error,
    assert_serves, eval_payload, frame, parameters_bytes, statistics,
)
from lists import EVALUATORS, MODELS, PARAMETERS
from parted import EVALUATED, receive_parts, take_apart

PONG = PING | wire.REPLY
TABLE = wire.MESSAGES["table"]
MC = wire.MESSAGES["mc"]

# How late a refusal may come: a busy machine or a sanitizer delays it.
GRACE_S = 0.4 if sanitized() else 0.08


def slow_payload(media: int = 30) -> bytes:
    """Makes a request for new media, each of which takes a tenth of a second to prepare."""
    rng = np.random.default_rng(time.monotonic_ns())
    several = [(rng.uniform(0.01, 0.2), 1.0, 0.0, 1.4) for _ in range(media)]
    return eval_payload(several, [0.5, 1.0], model=MODELS["beam"], evaluator=EVALUATORS["lut"])


def assert_late(reply: Frame, request_id: int = 77) -> None:
    assert_error(reply, "deadline", "deadline_ms", "more", request_id=request_id)


def assert_refused_in_time(ask_late, deadline_ms: int) -> None:
    """Checks that the refusal for which ask_late() waits comes after the deadline, and soon after
    it. Tries again if it was late, because the machine may have been busy."""
    took = []
    for _ in range(6):
        start = time.monotonic()
        ask_late()
        took.append(time.monotonic() - start)
        assert took[-1] >= deadline_ms / 1000 - 0.003
        if took[-1] < deadline_ms / 1000 + GRACE_S:
            return
    raise AssertionError(f"deadline {deadline_ms} ms: {took}")


# ---- deadlines that are met ----------------------------------------------------------------------


@pytest.mark.parametrize("deadline_ms", [5000, 2**31, 2**32 - 1])
def test_any_message_may_have_one(connection, deadline_ms):
    hello = wire.HELLO_REQUEST.pack(version_min=2, version_max=2)
    for type, payload in (
        (HELLO, hello),
        (EVAL, eval_payload()),
        (MEDIA, b""),
        (STATISTICS, b""),
        (PING, b"in time!"),
    ):
        connection.send_bytes(frame(type, 5, payload, deadline_ms))
        reply = connection.receive_frame()
        assert (reply.type, reply.request_id) == (type | wire.REPLY, 5)
        if type not in (HELLO, STATISTICS):
            assert reply.payload == ask(connection, type, payload).payload


def test_a_slow_answer_in_time(daemon):
    with daemon().connect() as connection:
        payload = slow_payload(3)
        connection.send_bytes(frame(EVAL, 77, payload, 60_000))
        in_time = connection.receive_frame()
        assert in_time == ask(connection, EVAL, payload)
        assert in_time.type == EVALUATED


def test_a_large_answer_in_time(daemon):
    one = daemon("--max-frame-bytes", "65536", "--max-part-bytes", "65536")
    with one.connect() as connection:
        payload = eval_payload(radii=None, radius_count=1_000_000, wanted=R)
        connection.send_bytes(frame(EVAL, 77, payload, 60_000) + frame(EVAL, 77, payload))
        first, second = (receive_parts(connection) for _ in range(2))
        assert [part.fixed for part in first] == [part.fixed for part in second]


def test_time_runs_from_the_last_byte_on(connection):
    data = frame(EVAL, 77, eval_payload(), 300)
    for cut in (1, 24, 50, len(data) - 1):
        connection.send_bytes(data[:cut])
        time.sleep(0.35)
        connection.send_bytes(data[cut:])
        assert connection.receive_frame().type == EVALUATED


# ---- deadlines that are missed -------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["unix", "tcp"])
@pytest.mark.parametrize("deadline_ms", [1, 40, 200])
def test_while_a_model_is_prepared(daemon, scheme, deadline_ms):
    one = daemon()
    with one.connect(scheme) as connection:

        def ask_late() -> None:
            connection.send_bytes(frame(EVAL, 77, slow_payload(), deadline_ms))
            assert_late(connection.receive_frame())

        assert_refused_in_time(ask_late, deadline_ms)
        assert_serves(connection)
    assert_daemon_serves(one)


def test_while_a_table_is_built(daemon):
    one = daemon()
    with one.connect() as connection:

        def table_payload() -> bytes:
            medium = (0.1 + 0.01 * (time.monotonic_ns() % 1000) / 1000, 1.0, 0.3, 1.37)
            fixed = wire.TABLE_REQUEST.pack(model=MODELS["transport"], moments=1, parameter_count=1)
            given = parameters_bytes([(PARAMETERS["tolerance"].id, 1e-6)])
            return fixed + np.asarray(medium, "<f8").tobytes() + given

        def ask_late() -> None:
            connection.send_bytes(frame(TABLE, 77, table_payload(), 3))
            assert_late(connection.receive_frame())

        assert_refused_in_time(ask_late, 3)
        reply = ask(connection, TABLE, table_payload())
        assert reply.type == TABLE | wire.REPLY
        assert_serves(connection)


def test_of_two_who_wait_for_the_same(daemon):
    """Two clients wait for the same profile. One misses its deadline; the other gets the answer."""
    one = daemon()
    payload = slow_payload(8)
    with one.connect() as patient, one.connect() as hasty:
        patient.send_bytes(frame(EVAL, 1, payload))
        hasty.send_bytes(frame(EVAL, 2, payload, 50))
        assert_late(hasty.receive_frame(), request_id=2)
        assert_serves(hasty)
        reply = patient.receive_frame()
        assert (reply.type, reply.request_id) == (EVALUATED, 1)
        assert ask(hasty, EVAL, payload).payload == reply.payload


def test_while_much_is_evaluated(daemon):
    """The deadline passes while the values of a single part are evaluated, which takes seconds."""
    one = daemon("--workers", "1")
    payload = eval_payload(
        model=MODELS["beam+single"], radii=None, radius_count=8_000_000, wanted=R
    )
    with one.connect() as connection:

        def ask_late() -> None:
            connection.send_bytes(frame(EVAL, 77, payload, 100))
            assert_late(connection.receive_frame())

        assert_refused_in_time(ask_late, 100)
        assert_serves(connection)


def read_until_late(connection: Connection) -> int:
    """Returns how many parts come before the error that ends the answer."""
    number = 0
    while (reply := connection.receive_frame()).type == EVALUATED:
        assert take_apart(reply.payload).fixed.part == number
        number += 1
    assert_late(reply)
    return number


def test_in_the_middle_of_an_answer_in_parts(daemon):
    one = daemon("--workers", "1")
    payload = eval_payload(radii=None, radius_count=2**31, wanted=R)
    with one.connect() as connection, one.connect() as other:

        def ask_late() -> None:
            connection.send_bytes(frame(EVAL, 77, payload, 150))
            assert read_until_late(connection) > 0

        assert_refused_in_time(ask_late, 150)
        assert_serves(connection)
        assert_serves(other)


def test_while_nobody_reads(daemon):
    """A client that reads late gets the parts that were ready before the deadline, and then the
    error."""
    one = daemon("--workers", "1")
    payload = eval_payload(radii=None, radius_count=2**31, wanted=R)
    with one.connect() as connection, one.connect() as other:
        connection.send_bytes(frame(EVAL, 77, payload, 100))
        time.sleep(0.5)
        evaluated = statistics(other)["radii_evaluated"]
        assert statistics(other)["answers_deadline"] == 1
        assert 0 < read_until_late(connection) < 10
        assert statistics(other)["radii_evaluated"] == evaluated
        assert_serves(connection)


# ---- requests of one connection ------------------------------------------------------------------


def test_behind_a_request_that_takes_long(daemon):
    """The answers of a connection come in order, but each request has its own deadline."""
    with daemon().connect() as connection:
        connection.send_bytes(
            frame(EVAL, 1, slow_payload(8))
            + frame(PING, 2, b"too late", 50)
            + frame(EVAL, 3, eval_payload(), 60_000)
            + frame(EVAL, 4, eval_payload(), 1)
            + frame(PING, 5, b"any time")
        )
        replies = [connection.receive_frame() for _ in range(5)]
        assert [reply.request_id for reply in replies] == [1, 2, 3, 4, 5]
        assert replies[0].type == replies[2].type == EVALUATED
        assert_late(replies[1], request_id=2)
        assert_late(replies[3], request_id=4)
        assert replies[4] == Frame(PONG, 5, b"any time")


def test_the_time_runs_from_the_arrival_behind_a_slow_request(daemon):
    """The deadline of a request counts from its arrival, also while an earlier request of the
    connection runs. A late request gets DEADLINE."""
    with daemon("--workers", "1").connect() as connection:
        slow = eval_payload(radii=None, radius_count=30_000_000, wanted=R)
        connection.send_bytes(frame(EVAL, 76, slow))
        time.sleep(0.01)
        connection.send_bytes(frame(EVAL, 77, eval_payload(), 1))
        connection.send_bytes(frame(EVAL, 78, eval_payload(), 60_000))
        time.sleep(0.01)
        parts = receive_parts(connection, 76)
        assert sum(part.fixed.count for part in parts) == 30_000_000
        assert_late(connection.receive_frame())
        assert connection.receive_frame().type == EVALUATED


def test_one_that_is_missed_does_not_hold_up_the_next(daemon):
    with daemon().connect() as connection:
        start = time.monotonic()
        connection.send_bytes(
            frame(EVAL, 1, slow_payload(60), 50) + frame(EVAL, 2, eval_payload(), 60_000)
        )
        assert_late(connection.receive_frame(), request_id=1)
        assert connection.receive_frame().type == EVALUATED
        assert time.monotonic() - start < 2


def test_many_in_a_row(daemon):
    """The deadline of a request does not affect later requests."""
    one = daemon()
    with one.connect() as connection:
        alone = ask(connection, EVAL, eval_payload()).payload
        for i in range(30):
            connection.send_bytes(
                frame(EVAL, 1, slow_payload(2), 1 + i % 5) + frame(EVAL, 2, eval_payload())
            )
            first, second = connection.receive_frame(), connection.receive_frame()
            if first.type == wire.TYPE_ERROR:
                assert_late(first, request_id=1)
            assert second == Frame(EVALUATED, 2, alone)
    assert_daemon_serves(one)


def test_leaving_before_the_deadline(daemon):
    one = daemon()
    for _ in range(10):
        with one.connect() as leaving:
            leaving.send_bytes(frame(EVAL, 1, slow_payload(3), 30))
    time.sleep(0.1)
    assert_daemon_serves(one)


def test_a_faulty_request_is_told_its_fault(connection):
    connection.send_bytes(frame(EVAL, 77, eval_payload(model=99), 1000))
    assert_error(connection.receive_frame(), "bad-value", "model", "classical")


def test_a_monte_carlo_job_has_to_start_in_time(daemon):
    """The deadline of a Monte Carlo job is for its start. The table may come later."""
    fixed = {
        "spacing": 2,
        "albedo_count": 0,
        "ring_count": 10,
        "radius_start": 0.0,
        "radius_stop": 5.0,
        "thickness": np.inf,
        "seed": 1,
        "photons": 4_000_000,
        "error_total": 0.0,
        "error_rings": 0.0,
    }
    medium = np.asarray((0.1, 1.0, 0.0, 1.3), "<f8").tobytes()
    with daemon().connect() as connection:
        start = time.monotonic()
        connection.send_bytes(frame(MC, 77, wire.MC_REQUEST.pack(**fixed) + medium, 20))
        state = wire.MC_UNDER_WAY
        while state == wire.MC_UNDER_WAY:
            reply = connection.receive_frame()
            assert reply.type == MC | wire.REPLY
            state = wire.MC_REPLY.unpack(reply.payload).state
        assert wire.MC_STATES[state] == "photons"
        assert time.monotonic() - start > 0.02


# ---- clients -------------------------------------------------------------------------------------


def test_python(daemon):
    one = daemon()
    with one.client() as client:
        grid = dipole.Grid(0.0, 10.0, 2**28)
        assert client.eval("better", SKIN, [1.0], deadline_ms=60_000).R[0, 0] > 0
        for ask_late in (
            lambda: client.eval("beam", SKIN, grid=grid, evaluator="f32", deadline_ms=30),
            lambda: list(client.eval_parts("beam", SKIN, grid=grid, deadline_ms=30)),
        ):
            with pytest.raises(dipole.Refused) as caught:
                ask_late()
            assert caught.value.status == "deadline"
        request_id = client.submit("beam", SKIN, grid=grid, evaluator="f32", deadline_ms=30)
        with pytest.raises(dipole.Refused) as caught:
            client.collect()
        assert (caught.value.status, caught.value.request_id) == ("deadline", request_id)
        with pytest.raises(dipole.Refused) as caught:
            client.table("transport", (0.123, 1.0, 0.2, 1.4), tolerance=1e-6, deadline_ms=5)
        assert caught.value.status == "deadline"
        with pytest.raises(dipole.ArgumentError):
            client.eval("better", SKIN, [1.0], deadline_ms=-1)
        assert client.eval("better", SKIN, wanted=["albedo"]).albedo[0] > 0
        assert client.statistics()["answers_deadline"] == 4
