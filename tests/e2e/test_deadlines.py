"""Deadlines: a request is answered in time or gets the error DEADLINE. Other requests do not suffer.
test_messages.py has the deadlines of all messages."""

import time

import dipole
import numpy as np
import pytest
from daemons import eventually
from dipole import Frame, wire
from frames import (
    EVAL, PING, SKIN, R, ask, assert_daemon_serves, assert_error, assert_serves, eval_payload, frame,
    gather_payload, points_payload, receive_reply, statistics, table_payload,
)
from lists import EVALUATORS, MODELS, PARAMETERS
from messages import receive_answer

PONG = PING | wire.REPLY
TABLE = wire.MESSAGES["table"]
EVALUATED = EVAL | wire.REPLY


def slow_payload(media: int = 30) -> bytes:
    """Makes a request for new media, each of which takes a tenth of a second to prepare."""
    rng = np.random.default_rng(time.monotonic_ns())
    several = [(rng.uniform(0.01, 0.2), 1.0, 0.0, 1.4) for _ in range(media)]
    return eval_payload(several, [0.5, 1.0], model=MODELS["beam"], evaluator=EVALUATORS["lut"])


def assert_late(reply: Frame, request_id: int = 77) -> None:
    assert_error(reply, "deadline", "deadline_ms", "more", request_id=request_id)


def test_time_runs_from_the_last_byte_on(connection):
    """On a busy machine the answer itself may be late: one of some is not."""
    data = frame(EVAL, 77, eval_payload(), 300)

    def is_answered(cut: int) -> bool:
        connection.send_bytes(data[:cut])
        time.sleep(0.35)
        connection.send_bytes(data[cut:])
        return receive_reply(connection).type == EVALUATED

    assert all(any(is_answered(cut) for _ in range(9)) for cut in (1, len(data) - 1))


# ---- deadlines that are missed -------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["unix", "tcp"])
@pytest.mark.parametrize("deadline_ms", [1, 100])
def test_while_a_model_is_prepared(daemon, scheme, deadline_ms):
    """The refusal comes not before its time, and before all media are prepared."""
    one = daemon()
    with one.connect(scheme) as connection:
        start = time.monotonic()
        connection.send_bytes(frame(EVAL, 77, slow_payload(60), deadline_ms))
        assert_late(connection.receive_frame())
        assert time.monotonic() - start >= deadline_ms / 1000 - 0.003
        assert statistics(connection)["cache_entries"] < 60
        assert_serves(connection)
        payload = slow_payload(2)
        connection.send_bytes(frame(EVAL, 77, payload, 60_000))
        assert connection.receive_frame() == ask(connection, EVAL, payload)
    assert_daemon_serves(one)


def test_while_a_table_is_built(shared):
    with shared.connect() as connection:
        for deadline_ms in (3, 0):
            medium = (0.1 + 0.01 * (time.monotonic_ns() % 1000) / 1000, 1.0, 0.3, 1.37)
            payload = table_payload(medium, [(PARAMETERS["tolerance"].id, 1e-6)], model=MODELS["transport"])
            connection.send_bytes(frame(TABLE, 77, payload, deadline_ms))
            reply = connection.receive_frame()
            if deadline_ms:
                assert_late(reply)
        assert reply.type == TABLE | wire.REPLY


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


def test_while_nobody_reads(daemon):
    """A client that reads late gets the parts that were ready before the deadline, and then the
    error."""
    one = daemon("--workers", "1")
    payload = eval_payload(radii=None, radius_count=2**31, wanted=R)
    with one.connect() as connection, one.connect() as other:
        connection.send_bytes(frame(EVAL, 77, payload, 100))
        assert eventually(lambda: statistics(other)["replies_deadline"] == 1)
        evaluated = statistics(other)["radii_evaluated"]
        number = 0
        while (reply := connection.receive_frame()).type == EVALUATED:
            assert wire.PART.unpack(reply.payload).part == number
            number += 1
        assert_late(reply)
        assert 0 < number < 10
        assert statistics(other)["radii_evaluated"] == evaluated
        assert_serves(connection)


# ---- requests of one connection ------------------------------------------------------------------


def test_behind_a_request_that_takes_long(daemon):
    """The answers of a connection come in order, but each request has its own deadline, which counts
    from its arrival."""
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


def test_behind_sums_that_wait_for_a_stack(daemon):
    """The stack is solved for minutes. When its client leaves, nobody waits for it any more."""
    stack = [(0.1, 10.0, 0.9, 1.4, 0.5)] * 6
    points = dipole.Points([[0.0, 0.0, 0.0]], [1.0])
    one = daemon()
    with one.connect() as connection:
        assert ask(connection, wire.MESSAGES["points"], points_payload(points)).type & wire.REPLY
        fields = {"model": MODELS["transport"], "layer_count": 6, "medium_count": 1}
        sums = gather_payload(points, stack, parameters=[(PARAMETERS["tolerance"].id, 1e-8)], **fields)
        for request_id, deadline_ms in (1, 600_000), (2, 30), (3, 500_000):
            connection.send_bytes(frame(wire.MESSAGES["gather"], request_id, sums, deadline_ms))
        assert_late(connection.receive_frame(), request_id=2)
    one.terminate()
    assert one.wait() == 0


def test_the_time_runs_from_the_arrival_behind_an_answer_in_parts(daemon):
    with daemon("--workers", "1", "--max-frame-bytes", "1048576").connect() as connection:
        connection.send_bytes(frame(EVAL, 76, eval_payload(radii=None, radius_count=4_000_000, wanted=R)))
        time.sleep(0.01)
        connection.send_bytes(frame(EVAL, 77, eval_payload(), 1))
        connection.send_bytes(frame(EVAL, 78, eval_payload(), 60_000))
        time.sleep(0.01)
        first, parts = receive_answer(connection)
        assert first.request_id == 76 and sum(wire.PART.unpack(one).count for one in parts) == 4_000_000
        assert_late(connection.receive_frame())
        assert receive_reply(connection).type == EVALUATED


# ---- clients -------------------------------------------------------------------------------------


def test_python(daemon):
    one = daemon()
    with one.client() as client:
        grid = dipole.Grid(0.0, 10.0, 2**28)
        assert client.eval("better", SKIN, [1.0], deadline_ms=60_000).R[0, 0] > 0
        for ask_late in (
            lambda: client.eval("beam", SKIN, grid=grid, evaluator="f32", deadline_ms=30),
            lambda: list(client.eval_parts("beam", SKIN, grid=grid, deadline_ms=30)),
            lambda: client.table("transport", (0.123, 1.0, 0.2, 1.4), tolerance=1e-6, deadline_ms=5),
        ):
            with pytest.raises(dipole.Refused) as caught:
                ask_late()
            assert caught.value.status == "deadline"
        request_id = client.submit("beam", SKIN, grid=grid, evaluator="f32", deadline_ms=30)
        with pytest.raises(dipole.Refused) as caught:
            client.collect()
        assert (caught.value.status, caught.value.request_id) == ("deadline", request_id)
        assert client.eval("better", SKIN, wanted=["albedo"]).albedo[0] > 0
        assert client.statistics()["replies_deadline"] == 4
