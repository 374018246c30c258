"""Every limit of the daemon, at the limit and one beyond it."""

import os
import select
import socket
import threading

import dipole
import numpy as np
import pytest
from daemons import Daemon, eventually, sanitized
from dipole import Frame, wire
from frames import (
    ALBEDO, EVAL, PING, SKIN, STATISTICS, R, ask, assert_closed, assert_daemon_serves,
    assert_error, assert_serves, eval_payload, frame, gather_payload, head_bytes, header,
    read_statistics, serves, statistics, table_payload, tissue_payload, varying_payload,
)
from messages import FOUR, GATHER, PLACES, POINTS_SENT, send_points

PONG = PING | wire.REPLY
EVALUATED = EVAL | wire.REPLY


# ---- frames and media ----------------------------------------------------------------------------


@pytest.fixture
def small_frames(daemon):
    """Returns a connection to a daemon with the smallest possible frames."""
    with daemon("--max-frame-bytes", "4096").connect() as connection:
        yield connection


def test_request_of_the_largest_size(small_frames):
    payload = eval_payload(radii=[1.0] * 501, wanted=R)
    assert len(payload) == 4096
    assert ask(small_frames, EVAL, payload).type == EVALUATED
    assert_serves(small_frames)


def test_frames_behind_one_of_an_odd_length(small_frames):
    """They are read from where it ends."""
    small_frames.send_bytes(frame(PING, 1, b"1234") + frame(EVAL, 2, eval_payload(radii=[1.0])))
    assert_error(small_frames.receive_frame(), "bad-length", "payload_bytes", "multiple of 8", request_id=1)
    reply = small_frames.receive_frame()
    assert reply.payload == ask(small_frames, EVAL, eval_payload(radii=[1.0])).payload


def test_a_frame_that_leaves_the_input_gives_its_memory_back(daemon):
    one = daemon()
    with one.connect() as watcher:
        statistics(watcher)
        before = statistics(watcher)["buffer_bytes"]
        with one.connect() as connection:
            send_points(connection)
            reply = ask(connection, GATHER, gather_payload(POINTS_SENT, FOUR, PLACES[:2900]))
            assert reply.type == GATHER | wire.REPLY
        assert eventually(lambda: statistics(watcher)["buffer_bytes"] <= before)


@pytest.mark.parametrize("radii", [502, 200_000])
def test_request_beyond_the_largest_size(small_frames, radii):
    payload = eval_payload(radii=[1.0] * radii, wanted=R)
    reply = ask(small_frames, EVAL, payload)
    assert_error(reply, "too-large", "payload_bytes", "at most 4096")
    small_frames.send_bytes(header(version=9, payload_bytes=len(payload)) + payload)
    assert_error(small_frames.receive_frame(), "bad-version", "version", "2", request_id=1)
    assert_serves(small_frames)


def test_max_radii_and_max_media(daemon):
    with daemon("--max-radii", "1000", "--max-media", "3").connect() as connection:
        for radii in ({"radii": [1.0] * 1000}, {"radii": None, "radius_count": 1000}):
            assert ask(connection, EVAL, eval_payload(**radii)).type == EVALUATED
        for radii in ({"radii": [1.0] * 1001}, {"radii": None, "radius_count": 1001}):
            reply = ask(connection, EVAL, eval_payload(**radii))
            assert_error(reply, "too-large", "radius_count", "at most 1000 radii")
        assert ask(connection, EVAL, eval_payload([SKIN] * 3)).type == EVALUATED
        reply = ask(connection, EVAL, eval_payload([SKIN] * 4))
        assert_error(reply, "too-large", "medium_count", "at most 3")
        assert_serves(connection)


def test_answers_that_do_not_fit(daemon):
    media = np.full((240, 2), (0.1, 1.0))
    with daemon("--max-frame-bytes", "8192", "--max-part-bytes", "4096").connect() as connection:
        # 2^40 radii in parts of 256 would be 2^32 parts, which nobody can count.
        reply = ask(connection, EVAL, eval_payload(radii=None, radius_count=2**40, wanted=R))
        assert_error(reply, "too-large", "radius_count", f"at most {(2**32 - 1) * 256} radii")
        # These radii fit into a frame, but a part has no room for 256 radii of each medium.
        few = eval_payload([SKIN] * 2, radii=None, radius_count=400, wanted=R)
        assert wire.EVAL_REPLY.unpack(ask(connection, EVAL, few).payload).part_count == 1
        reply = ask(connection, EVAL, eval_payload([SKIN] * 2, radii=None, radius_count=800, wanted=R))
        assert_error(reply, "too-large", "medium_count", "at most 1 media fit into a part")
        # A part has no room for 256 radii of all quantities even of one medium, so that fewer media
        # would not help.
        reply = ask(connection, EVAL, eval_payload(radii=None, radius_count=800, wanted=511))
        assert_error(reply, "too-large", "wanted", "max_part_bytes")
        for message, payload, field in [
            ("varying", varying_payload(media, np.ones(240), wanted=199, coefficients=7), "wanted"),
            ("tissue", tissue_payload(wavelengths=np.linspace(500, 900, 210)), "wavelength_count"),
            ("table", table_payload(), "tolerance"),
        ]:
            assert_error(ask(connection, wire.MESSAGES[message], payload), "too-large", field, "")
        assert_serves(connection)


def test_as_many_slow_ones_as_media_are_allowed(daemon):
    with daemon("--max-media", "2").client() as client:
        assert client.invert("beam", [0.5, 0.6], 1.0).missing == 0
        with pytest.raises(dipole.Refused) as caught:
            client.invert("beam", [0.5, 0.6, 0.7], 1.0)
        assert caught.value.field == "medium_count" and "at most 2" in caught.value.allowed


# ---- connections ---------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["unix", "tcp"])
def test_max_connections(daemon, scheme):
    one = daemon("--max-connections", "4")
    open_ones = [one.connect(scheme) for _ in range(4)]
    for connection in open_ones:
        assert_serves(connection)
    for _ in range(3):
        with one.connect(scheme) as too_many:
            reply = too_many.receive_frame()
            assert_error(reply, "busy", "max_connections", "fewer", request_id=0)
            assert_closed(too_many)
    for connection in open_ones:
        assert_serves(connection)
    open_ones.pop().close()
    assert eventually(lambda: serves(one, scheme))
    for connection in open_ones:
        connection.close()


# ---- memory --------------------------------------------------------------------------------------


class SlowReader:
    """A client that sends pings without reading until no bytes move any more."""

    def __init__(self, daemon: Daemon):
        self.daemon = daemon
        self.connection = daemon.connect()
        self.connection.socket.setblocking(False)
        self.watcher = daemon.connect()
        self.watched_bytes = 0
        self.sent_bytes = 0

    def __enter__(self) -> "SlowReader":
        return self

    def __exit__(self, *_: object) -> None:
        self.connection.close()
        self.watcher.close()

    def statistics(self) -> dict[str, int]:
        """Returns the daemon's statistics, without the bytes sent to the watcher itself."""
        reply = ask(self.watcher, STATISTICS)
        values = read_statistics(reply.payload)
        values["sent_bytes"] -= self.watched_bytes
        self.watched_bytes += wire.HEADER.bytes + len(reply.payload)
        return values

    def send_what_fits(self) -> None:
        """Sends pings until the socket takes no more."""
        pings = frame(PING, 3) * 1000
        try:
            while True:
                offset = self.sent_bytes % len(pings)
                self.sent_bytes += self.connection.socket.send(pings[offset:])
        except BlockingIOError:
            pass

    def queued_bytes(self) -> int:
        """Returns how many bytes of answers the daemon holds for this client."""
        now = self.statistics()
        return now["requests_ping"] * wire.HEADER.bytes - now["sent_bytes"]


@pytest.mark.parametrize("limit", [0, 1, 1000, 1008, 1016, 65536, 1048576])
def test_max_queued_bytes(daemon, limit):
    """Answers are queued until more than the limit waits, so the queue exceeds the limit by less
    than one answer."""
    with SlowReader(daemon("--max-queued-bytes", str(limit))) as slow:

        def observe() -> int:
            slow.send_what_fits()
            return slow.queued_bytes()

        def settled() -> bool:
            first = observe()
            return first > limit and all(observe() == first for _ in range(30))

        assert eventually(settled)
        assert limit < slow.queued_bytes() <= limit + wire.HEADER.bytes
        assert slow.sent_bytes > slow.statistics()["requests_ping"] * wire.HEADER.bytes


def test_slow_reader_costs_bounded_memory_and_loses_nothing(daemon):
    # This setting keeps the address sanitizer from holding on to freed memory.
    one = daemon(env={"ASAN_OPTIONS": os.environ.get("ASAN_OPTIONS", "") + ":quarantine_size_mb=1"})
    request_bytes = frame(EVAL, 1, eval_payload(radii=None, radius_count=100_000))
    with one.connect() as slow, one.connect() as other:
        assert_serves(other)
        before_bytes = one.resident_bytes()
        slow.socket.sendall(request_bytes * 60)  # 96 MB of answers
        assert eventually(lambda: statistics(other)["requests_eval"] > 1)
        for _ in range(50):
            assert_serves(other)
        slack_bytes = (64 if sanitized() else 24) << 20
        assert one.resident_bytes() < before_bytes + slack_bytes
        assert statistics(other)["buffer_bytes"] < 8 << 20
        first = slow.receive_frame()
        assert first.type == EVALUATED
        for _ in range(59):
            assert slow.receive_frame() == first
        assert one.resident_bytes() < before_bytes + slack_bytes
        assert_serves(slow)


def test_one_answer_may_always_be_queued(daemon):
    with daemon("--max-queued-bytes", "0").connect() as connection:
        reply = ask(connection, EVAL, eval_payload(radii=None, radius_count=500_000))
        assert reply.type == EVALUATED and len(reply.payload) > 8_000_000
        connection.send_bytes(frame(PING, 1) * 100)
        assert [connection.receive_frame() for _ in range(100)] == [Frame(PONG, 1, b"")] * 100


TOTAL_BYTES = 1 << 20


def reply_payload_that_takes(free_bytes: int) -> bytes:
    """Makes an eval request whose answer's frame has this length."""
    fixed_bytes = wire.HEADER.bytes + head_bytes(1, 1)
    return eval_payload(radii=None, radius_count=(free_bytes - fixed_bytes) // 8, wanted=R)


def test_max_total_bytes(daemon):
    with daemon("--max-total-bytes", str(TOTAL_BYTES)).connect() as connection:

        def free() -> int:
            return TOTAL_BYTES - statistics(connection)["buffer_bytes"]

        free_bytes = free()
        assert 0 < free_bytes < TOTAL_BYTES and free_bytes % 8 == 0
        assert ask(connection, EVAL, reply_payload_that_takes(free_bytes)).type == EVALUATED
        assert_serves(connection)
        # The daemon keeps a large buffer for a moment, for the next large answer.
        assert eventually(lambda: free() == free_bytes)
        reply = ask(connection, EVAL, reply_payload_that_takes(free_bytes + 8))
        assert_error(reply, "busy", "max_total_bytes", "fewer bytes")
        assert_serves(connection)


def test_request_that_total_bytes_cannot_hold(daemon):
    with daemon("--max-total-bytes", str(TOTAL_BYTES)).connect() as connection:
        payload = eval_payload(radii=[1.0] * (TOTAL_BYTES // 4), wanted=ALBEDO)
        reply = ask(connection, EVAL, payload)
        assert_error(reply, "busy", "payload_bytes", "max_total_bytes")
        assert_serves(connection)
        assert ask(connection, EVAL, eval_payload(radii=[1.0] * 1000)).type == EVALUATED


# ---- time ----------------------------------------------------------------------------------------

PARTIAL = {
    "header": frame(PING, 9)[:10],
    "payload": frame(EVAL, 9, eval_payload())[:100],
    "payload that is skipped": header(version=7, payload_bytes=1000) + bytes(50),
}


@pytest.mark.parametrize("name", PARTIAL)
def test_frame_timeout(daemon, name):
    one = daemon("--frame-timeout-ms", "100")
    with one.connect() as idle, one.connect("tcp") as late:
        assert_serves(idle)
        assert_serves(late)
        late.send_bytes(PARTIAL[name])
        if "skipped" in name:
            assert_error(late.receive_frame(), "bad-version", "version", "2", request_id=1)
        reply = late.receive_frame()
        assert_error(reply, "timeout", "payload_bytes", "frame_timeout_ms", request_id=0)
        assert_closed(late)
        assert_serves(idle)  # This limit does not apply between frames.


def test_dripping_bytes_do_not_prolong_a_frame(daemon):
    with daemon("--frame-timeout-ms", "200").connect() as connection:
        drops = iter(frame(EVAL, 9, eval_payload(radii=[1.0] * 1000)))
        while not select.select([connection.socket], [], [], 0.01)[0]:
            connection.socket.send(bytes([next(drops)]))
        reply = connection.receive_frame()
        assert_error(reply, "timeout", "payload_bytes", "frame_timeout_ms", request_id=0)
        assert_closed(connection)


def test_idle_timeout(daemon):
    one = daemon("--idle-timeout-ms", "400")
    with one.connect() as silent, one.connect() as busy:
        assert_serves(silent)
        while not select.select([silent.socket], [], [], 0.02)[0]:
            assert_serves(busy)
        reply = silent.receive_frame()
        assert_error(reply, "timeout", "idle_timeout_ms", "silence", request_id=0)
        assert_closed(silent)
        assert_serves(busy)


def test_idle_timeout_of_one_that_never_said_anything(daemon):
    with daemon("--idle-timeout-ms", "100").connect("tcp") as silent:
        assert_error(silent.receive_frame(), "timeout", "idle_timeout_ms", "silence", request_id=0)
        assert_closed(silent)


def test_idle_timeout_of_one_that_never_reads(daemon):
    one = daemon("--idle-timeout-ms", "300")
    with one.connect() as stuck:
        stuck.socket.sendall(frame(EVAL, 1, eval_payload(radii=None, radius_count=500_000)) * 2)

        def gone() -> bool:
            with one.connect() as watcher:
                return statistics(watcher)["connections_open"] == 1

        assert eventually(gone)
    assert_daemon_serves(one)


def test_a_client_that_does_not_close_after_its_error(daemon):
    """If a client does not close after its error, the daemon closes the connection and frees its
    place."""
    one = daemon("--max-connections", "2")
    with one.connect() as watcher, one.connect() as rude:
        assert_serves(watcher)
        rude.send_bytes(bytes(24))
        assert_error(rude.receive_frame(), "bad-magic", "magic", "D I P L", request_id=0)
        assert eventually(lambda: statistics(watcher)["connections_open"] == 1)
        rude.socket.setblocking(False)
        assert rude.socket.recv(1, socket.MSG_PEEK) == b""


def test_a_burst_leaves_no_memory_with_a_client_that_goes_on(daemon):
    """A client that is never silent for long keeps what its last answers needed, not what a burst did."""
    one = daemon("--workers", "1")
    payload = eval_payload(radii=[1.0] * 100)
    burst = frame(EVAL, 1, payload) * 1500
    with one.connect() as other, socket.socket(socket.AF_UNIX) as busy:
        left = 1500 * (wire.HEADER.bytes + len(ask(other, EVAL, payload).payload))
        busy.connect(one.url().removeprefix("unix:"))
        sender = threading.Thread(target=busy.sendall, args=(burst,))
        sender.start()
        assert eventually(lambda: statistics(other)["buffer_bytes"] > 600_000)
        while left > 0:
            left -= len(busy.recv(left))
        sender.join()

        def is_trimmed() -> bool:
            busy.sendall(frame(PING, 2, b""))
            busy.recv(wire.HEADER.bytes, socket.MSG_WAITALL)
            return statistics(other)["buffer_bytes"] < 300_000

        assert eventually(is_trimmed, interval_s=0.3)
