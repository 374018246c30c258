"""After SIGTERM the daemon accepts nothing new, answers the requests in flight, and exits with
status 0."""

from __future__ import annotations

import time

import pytest
from daemons import eventually
from dipole import ConnectError, Connection, ConnectionLost, wire
from frames import EVAL, PING, ask, assert_closed, assert_error, assert_serves, eval_payload, frame

LARGE = eval_payload(radii=None, radius_count=200_000)


def refused(url: str) -> bool:
    """Returns whether no daemon listens at an address any more."""
    try:
        with Connection(url) as connection:
            ask(connection, PING)
        return False
    except (ConnectError, ConnectionLost):
        return True


@pytest.mark.parametrize("scheme", ["unix", "tcp"])
def test_requests_in_flight_are_answered(daemon, scheme):
    one = daemon()
    with one.connect(scheme) as connection:
        expected = ask(connection, EVAL, LARGE).payload
        connection.send_bytes(b"".join(frame(EVAL, i, LARGE) for i in range(100, 130)))
        replies = [connection.receive_frame()]  # After the first reply, all requests have arrived.
        one.terminate()
        replies += [connection.receive_frame() for _ in range(29)]
        assert [reply.request_id for reply in replies] == list(range(100, 130))
        assert all(reply.type == EVAL | wire.REPLY for reply in replies)
        assert all(reply.payload == expected for reply in replies)
        last = connection.receive_frame()
        assert_error(last, "shutting-down", "daemon", "another one", request_id=0)
        assert_closed(connection)
    assert one.wait() == 0


def test_every_connection_is_told(daemon):
    one = daemon()
    connections = [one.connect(scheme) for scheme in ("unix", "tcp") * 5]
    for connection in connections:
        assert_serves(connection)
    one.terminate()
    for connection in connections:
        assert_error(connection.receive_frame(), "shutting-down", "daemon", "another one", request_id=0)
        assert_closed(connection)
        connection.close()
    assert one.wait() == 0
    assert refused(one.url("unix")) and refused(one.url("tcp"))


def test_nobody_new_is_served(daemon):
    """A client has not yet read its answers, so the daemon is still running."""
    one = daemon("--drain-timeout-ms", "5000")
    with one.connect() as slow:
        slow.send_bytes(frame(EVAL, 1, LARGE) * 10)
        first = slow.receive_frame()
        one.terminate()
        assert eventually(lambda: refused(one.url("tcp")) and refused(one.url("unix")))
        assert one.process.poll() is None
        assert [slow.receive_frame() for _ in range(9)] == [first] * 9
    assert one.wait() == 0


def test_a_partial_frame_does_not_hold_it_up(daemon):
    one = daemon()
    with one.connect() as connection:
        connection.send_bytes(frame(PING, 4) + frame(EVAL, 5, LARGE)[:50])
        assert connection.receive_frame().request_id == 4
        one.terminate()
        start = time.monotonic()
        last = connection.receive_frame()
        assert last.type == wire.TYPE_ERROR
        assert_closed(connection)
    assert one.wait() == 0
    assert time.monotonic() - start < 5
