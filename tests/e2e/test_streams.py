"""Frames arrive in any pieces, several at once, or incomplete."""

from __future__ import annotations

import pytest
from dipole import Frame, wire
from frames import (
    EVAL, PING, ask, assert_closed, assert_daemon_serves, assert_error, eval_payload, frame, header,
)

PONG = PING | wire.REPLY


@pytest.mark.parametrize("cut", [1, 23, 24, 25, 64, 111, 135])
def test_frames_cut_anywhere(connection, cut):
    """Sends two requests in two writes, which cut them in the first header, the first payload or
    the second frame."""
    alone = ask(connection, EVAL, eval_payload()).payload
    requests = frame(EVAL, 6, eval_payload()) + frame(PING, 7, b"8 bytes!")
    connection.send_bytes(requests[:cut])
    connection.send_bytes(requests[cut:])
    replies = {reply.request_id: reply for reply in (connection.receive_frame() for _ in "12")}
    assert replies == {6: Frame(EVAL | wire.REPLY, 6, alone), 7: Frame(PONG, 7, b"8 bytes!")}


def test_two_hundred_requests_in_flight(connection):
    payloads = {i: eval_payload(radii=[0.01 * i] * (i % 7 + 1)) for i in range(200)}
    alone = {i: ask(connection, EVAL, payload).payload for i, payload in payloads.items()}
    connection.send_bytes(b"".join(frame(EVAL, i, payload) for i, payload in payloads.items()))
    replies = {}
    for _ in payloads:
        reply = connection.receive_frame()
        assert reply.type == EVAL | wire.REPLY
        replies[reply.request_id] = reply.payload
    assert replies == alone


def test_request_ids_are_the_clients_affair(connection):
    """The reply has the id of its request, whatever it is. An id that is used twice comes back
    twice."""
    ids = [0, 1, 1, 2**63, 2**64 - 1]
    connection.send_bytes(b"".join(frame(PING, i) for i in ids))
    assert sorted(connection.receive_frame().request_id for _ in ids) == ids


@pytest.mark.parametrize("length", [0, 8, 1016, 1024])
def test_ping_echoes(connection, length):
    payload = bytes(i % 251 for i in range(length))
    assert ask(connection, PING, payload) == Frame(PONG, 77, payload)


WRONG_MAGIC = {
    "one bit": header(magic=wire.MAGIC ^ 1),
    "byte order": header(magic=int.from_bytes(b"LPID", "little")),
    "http": b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "zero bytes": bytes(4096),
}


@pytest.mark.parametrize(
    "first, said",
    [(b"PROXY TCP4 192.0.2.1 192.0.2.2 4000 4817\r\n", "no PROXY header of a balancer"),
     (b"\r\n\r\n\0\r\nQUIT\n\x21\x11\0\x0c" + bytes(12), "no PROXY header of a balancer"),
     (b"\x16\3\1\2\0\1\0\1\xfc\3\3" + bytes(32), "this is TLS"),
     (b"POST /v1/eval HTTP/1.1\r\nHost: a\r\n\r\n", "this is HTTP")],
)  # fmt: skip
def test_other_protocols_are_named(daemon, first, said):
    one = daemon()
    with one.connect("tcp") as connection:
        connection.send_bytes(first)
        assert_error(connection.receive_frame(), "bad-magic", "magic", said, request_id=0)
    assert one.has_line("status=bad-magic", 5) and said in one.log[-1]


@pytest.mark.parametrize("name", WRONG_MAGIC)
def test_wrong_magic_is_told_and_closed(shared, connection, name):
    connection.send_bytes(frame(PING, 3))
    assert connection.receive_frame() == Frame(PONG, 3, b"")
    connection.send_bytes(WRONG_MAGIC[name])
    assert_error(connection.receive_frame(), "bad-magic", "magic", "D I P L", request_id=0)
    assert_closed(connection)
    assert_daemon_serves(shared)


def test_requests_before_a_wrong_magic_are_answered(shared, connection):
    connection.send_bytes(frame(EVAL, 8, eval_payload()) + frame(PING, 9) + b"DIPS" + bytes(20))
    replies = [connection.receive_frame() for _ in range(3)]
    assert {reply.request_id: reply.type for reply in replies} == {
        8: EVAL | wire.REPLY, 9: PONG, 0: wire.TYPE_ERROR
    }
    assert_closed(connection)
    assert_daemon_serves(shared)


REQUEST = frame(EVAL, 4, eval_payload())


@pytest.mark.parametrize("length", [1, 23, 24, 25, 64, len(REQUEST) - 1])
def test_truncated_frame_with_half_close(shared, connection, length):
    connection.send_bytes(REQUEST[:length])
    connection.half_close()
    request_id = 4 if length >= wire.HEADER.bytes else 0
    reply = connection.receive_frame()
    assert_error(reply, "truncated", "payload_bytes", "", request_id=request_id)
    assert_closed(connection)
    assert_daemon_serves(shared)


@pytest.mark.parametrize("length", [1, 24, 64, len(REQUEST) - 1, len(REQUEST)])
def test_truncated_frame_with_full_close(shared, connection, length):
    connection.send_bytes(REQUEST[:length])
    connection.close()
    assert_daemon_serves(shared)


def test_truncated_frame_that_has_been_refused(shared, connection):
    """If a refused frame is cut off, the error about that has the id of the frame."""
    connection.send_bytes(header(type=EVAL, request_id=77, payload_bytes=1 << 30) + bytes(100))
    assert_error(connection.receive_frame(), "too-large", "payload_bytes", "", request_id=77)
    connection.half_close()
    assert_error(connection.receive_frame(), "truncated", "payload_bytes", "", request_id=77)
    assert_closed(connection)
    assert_daemon_serves(shared)


def test_earlier_requests_are_answered_before_the_truncated_one(connection):
    payload = eval_payload(radii=[1.0] * 10_000)
    connection.send_bytes(frame(EVAL, 1, payload) * 5 + REQUEST[:50])
    connection.half_close()
    replies = [connection.receive_frame() for _ in range(6)]
    assert [reply.type for reply in replies[:5]] == [EVAL | wire.REPLY] * 5
    assert_error(replies[5], "truncated", "payload_bytes", "", request_id=4)
    assert_closed(connection)
