"""Modbus over TCP: masters that are slow, many, not allowed or wrong, and the end of
connections."""

import resource
import select
import socket
import struct
import time

import numpy as np
import pytest
from daemons import eventually
from frames import assert_serves
from modbus_master import (
    AT, BAD_ADDRESS, BAD_FUNCTION, BAD_VALUE, READ_HOLDING, TCP, Exception_, Tcp, as_words,
    exception, floats, input_block, words,
)

READ_ONE = struct.pack(">BHH", READ_HOLDING, 0, 1)
READ_MOST = struct.pack(">BHH", READ_HOLDING, 0, 125)


# ---- framing -------------------------------------------------------------------------------------


def test_one_byte_at_a_time(master):
    for byte in master.frame(80, READ_ONE):
        master.socket.sendall(bytes([byte]))
    assert master.receive()[2] == b"\3\2\0\0"


@pytest.mark.parametrize("count", [2, 17, 500])
def test_pipelined_requests_are_answered_in_order(master, count):
    frames = []
    for i in range(count):
        value = struct.pack(">BHHHHB", 23, 300, 8, 100, 1, 2) + words(i + 1)
        frames.append(master.frame(81, value if i % 3 == 0 else READ_ONE))
    master.socket.sendall(b"".join(frames))
    for i in range(count):
        transaction, _, answer = master.receive()
        assert transaction == i + 1
        if i % 3 == 0:
            assert as_words(answer[2:6]) == [2, i + 1]


BAD_FRAMES = {
    "protocol": "0001 0001 0006 01 03 0000 0001",
    "protocol in its second byte": "0001 0100",
    "length 0": "0001 0000 0000",
    "length 1": "0001 0000 0001 01",
    "length 255": "0001 0000 00ff 01 03",
    "length 65535": "0001 0000 ffff",
    "an answer": "0001 0000 0003 01 83 02",
    "function 0xff": "0001 0000 0006 01 ff 0000 0001",
    "text": b"GET / HTTP/1.1\r\n\r\n".hex(),
}


def test_frames_that_close_the_connection(daemon):
    """The daemon answers the valid request that came before, and then closes."""
    one = daemon(*TCP)
    for number, (name, bad) in enumerate(BAD_FRAMES.items()):
        with Tcp(one) as master:
            assert master.statistic("modbus_bad_frames") == number, name
            good = master.frame(1, READ_ONE)
            master.socket.sendall(good + bytes.fromhex(bad) + bytes(5000))
            assert master.receive()[2] == b"\3\2\0\0", name
            peer = master.own_address()
            assert master.is_closed(), name
        assert one.has_line(f"event=modbus-closed reason=bad-frame peer={peer}"), name
    with Tcp(one) as master:
        assert master.statistic("modbus_bad_frames") == len(BAD_FRAMES)


def test_a_master_that_has_said_all_is_answered(daemon):
    """A master that closes its side right after sending, as nc does, gets its answer."""
    one = daemon(*TCP)
    with Tcp(one) as master:
        master.socket.sendall(
            b"".join(master.frame(1, struct.pack(">BHH", 6, 100, i + 1)) for i in range(40))
        )
        master.socket.shutdown(socket.SHUT_WR)
        for i in range(40):
            assert as_words(master.receive()[2][1:]) == [100, i + 1]
        assert master.is_closed()


# ---- time ----------------------------------------------------------------------------------------


def test_a_frame_that_does_not_arrive(daemon):
    one = daemon(*TCP, "--modbus-frame-timeout-ms", "50")
    for length in range(1, 12, 5):
        with Tcp(one) as master:
            master.socket.sendall(master.frame(1, READ_ONE)[:length])
            peer = master.own_address()
            assert master.is_closed()
        assert one.has_line(f"event=modbus-closed reason=frame-timeout peer={peer}")


def test_a_slow_frame_delays_nobody_and_has_no_more_time(daemon):
    """The time limit of a frame runs from its first byte, and anew for the next one. Unknown functions
    do not delay other masters, as they would in libmodbus's own server, which sleeps for 0.5 s."""
    one = daemon(*TCP, "--modbus-frame-timeout-ms", "2000")
    with Tcp(one) as ahead, Tcp(one) as slow, Tcp(one) as fast:
        whole = ahead.frame(1, READ_ONE)
        ahead.socket.sendall(whole[:5])
        frame = slow.frame(1, struct.pack(">BHHB", 16, 0, 100, 200) + bytes(200))
        with pytest.raises((BrokenPipeError, ConnectionResetError)):
            for byte in frame:
                slow.socket.sendall(bytes([byte]))
                assert fast.read(0, 1) == b"\0\0"
                assert fast.exchange(1, bytes([99, 0, 0])) == bytes([99 | 0x80, BAD_FUNCTION])
                ahead.socket.sendall(whole[5:] + whole[:5])
                assert ahead.receive()[2] == b"\3\2\0\0"
                time.sleep(0.02)
        ahead.socket.sendall(whole[5:])
        assert ahead.receive()[2] == b"\3\2\0\0"


def test_silence(daemon):
    one = daemon(*TCP, "--modbus-idle-timeout-ms", "50")
    with Tcp(one) as master:
        master.read(0, 1)
        assert master.is_closed()


# ---- masters that do not read --------------------------------------------------------------------

MOST_SENT = 2_000_000


def fill(master: Tcp, frames: bytes) -> int:
    """Sends the same frames until the socket takes no more. Returns how many bytes it took."""
    sent = 0
    master.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 16384)
    master.socket.setblocking(False)
    while sent < MOST_SENT and select.select([], [master.socket], [], 0.5)[1]:
        sent += master.socket.send(frames[sent % len(frames) :])
    master.socket.settimeout(20)
    return sent


def test_a_master_that_does_not_read(daemon):
    """The daemon stops reading from such a master, so its memory does not grow, and serves the
    others. When the master reads at last, it gets every answer."""
    one = daemon(*TCP)
    with Tcp(one) as other:
        master = Tcp(one)
        frames = b"".join(master.frame(1, READ_MOST) for _ in range(1000))
        before = one.resident_bytes()
        sent = fill(master, frames)
        assert sent < MOST_SENT
        assert other.read(0, 1) == b"\0\0"
        assert one.resident_bytes() - before < 8_000_000
        answers = np.frombuffer(master.receive_bytes(sent // 12 * 259), np.uint8).reshape(-1, 259)
        transactions = answers[:, 0].astype(int) * 256 + answers[:, 1]
        assert np.array_equal(transactions, np.arange(sent // 12) % 1000 + 1)
        assert (answers[:, 2:] == answers[0, 2:]).all()
        master.socket.close()
        assert other.read(0, 1) == b"\0\0"


def test_a_master_that_never_reads_is_closed(daemon):
    one = daemon(*TCP, "--modbus-idle-timeout-ms", "200")
    with Tcp(one) as master:
        frames = b"".join(master.frame(1, READ_MOST) for _ in range(1000))
        with pytest.raises((BrokenPipeError, ConnectionResetError)):
            while True:
                fill(master, frames)
        with Tcp(one) as other:
            assert eventually(lambda: other.statistic("modbus_connections_open") == 1)


# ---- many ----------------------------------------------------------------------------------------


def test_2000_connections(daemon):
    """The daemon serves connections with file descriptors beyond 1024, which libmodbus's own server
    could not."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 2000
    if hard < 2 * wanted + 200:
        pytest.skip(f"a process may have {hard} file descriptors here")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, wanted + 200), hard))
    one = daemon(*TCP)
    masters = [Tcp(one) for _ in range(wanted)]
    try:
        for i, master in enumerate(masters):
            unit = 1 + i % 247
            assert as_words(master.write_read(i % 100, words(i), i % 100, 1, unit)) == [i]
        assert masters[-1].statistic("modbus_connections_open") == wanted
        assert masters[-1].write_read(100, input_block(1, radii=[1.0]), 300, 8)[:4] == words(2, 1)
    finally:
        for master in masters:
            master.socket.close()


def test_one_too_many(daemon):
    one = daemon(*TCP, "--max-modbus-connections", "3")
    masters = [Tcp(one) for _ in range(3)]
    for master in masters:
        master.read(0, 1)
    with Tcp(one) as late:
        peer = late.own_address()
        assert late.is_closed()
    assert masters[0].statistic("modbus_connections_refused") == 1
    assert one.has_line(f"reason=max-modbus-connections peer={peer}")
    masters[2].socket.close()
    assert eventually(lambda: masters[0].statistic("modbus_connections_open") <= 2)
    with Tcp(one) as again:
        assert again.read(0, 1) == b"\0\0"
    for master in masters[:2]:
        master.socket.close()


# ---- access --------------------------------------------------------------------------------------


def test_who_is_not_allowed(daemon):
    """tests/unit/test_modbus.c tries more networks."""
    one = daemon(*TCP, "--modbus-allow", "10.0.0.0/8")
    with Tcp(one) as master:
        peer = master.own_address()
        assert master.is_closed()
    assert one.has_line(f"event=modbus-refused reason=not-allowed peer={peer}")
    with one.connect() as connection:
        assert_serves(connection)


def test_a_refused_request_is_in_the_log(daemon):
    """With what it asked for, its unit and its peer. The log names no request that is carried out."""
    one = daemon(*TCP)
    with Tcp(one) as master:
        peer = master.own_address()
        master.write(AT["SIGMA_S"], floats(1.0), 9)
        for at, pdu, code in [
            (AT["SIGMA_S"], struct.pack(">BHHBf", 16, AT["SIGMA_S"], 2, 4, -1.0), BAD_VALUE),
            (60000, struct.pack(">BHH", 3, 60000, 1), BAD_ADDRESS),
            ("-", b"\x18", 1), ("-", b"\x2b\x0e\x05\x00", BAD_VALUE),
        ]:
            with exception(code):
                master.ask(pdu, 9)
            asked = f"function={pdu[0]} exception={code} address={at} unit=9 peer={peer}"
            assert one.has_line(f"event=modbus-request-refused {asked}")
    assert sum("event=modbus-request-refused" in line for line in one.log) == 4


WRITES = [
    struct.pack(">BHH", 5, 0, 0), struct.pack(">BHH", 6, 0, 0), struct.pack(">BHHBB", 15, 0, 1, 1, 0),
    struct.pack(">BHHBH", 16, 0, 1, 2, 0), struct.pack(">BHHH", 22, 0, 0, 0),
    struct.pack(">BHHHHBH", 23, 0, 1, 0, 1, 2, 0),
]  # fmt: skip


def test_who_may_write(daemon):
    """--modbus-allow-write is a list within --modbus-allow; everyone may read."""
    one = daemon(*TCP, "--modbus-allow-write", "127.0.0.2", "--modbus-allow-write", "127.0.0.4/30")
    for source, may in [("127.0.0.2", True), ("127.0.0.3", False), ("127.0.0.6", True)]:
        with Tcp(one, source=source) as master:
            assert master.read(1200, 2) == b"DIPL"
            if may:
                master.write(AT["ETA"], floats(1.25), 9)
                assert master.read(AT["ETA"], 2, 9) == floats(1.25)
                continue
            for pdu in WRITES:
                with exception(BAD_FUNCTION):
                    master.ask(pdu)
            assert one.has_line("event=modbus-request-refused function=23 exception=1")


# ---- addresses -------------------------------------------------------------------------------------


def test_addresses_from_the_environment(daemon):
    """Two have the same registers."""
    env = {"DIPOLED_MODBUS": "tcp:127.0.0.1:0;tcp:127.0.0.1:0", "DIPOLED_MODBUS_ALLOW_WRITE": "127.0.0.2"}
    env["DIPOLED_MODBUS_ALLOW"] = "127.0.0.2,127.0.0.1"
    one = daemon(env=env)
    urls = [url for url in one.urls if url.startswith("modbus-tcp:")]
    assert len(set(urls)) == 2
    for url in urls:
        with Tcp(url) as master, pytest.raises(Exception_):
            master.write_one(0, 1)
    with Tcp(urls[0], source="127.0.0.2") as may, Tcp(urls[1]) as other:
        may.write(AT["ETA"], floats(1.25), 9)
        assert other.read(AT["ETA"], 2, 9) == floats(1.25)


# ---- the end -------------------------------------------------------------------------------------


def test_stopping_answers_what_has_arrived(daemon):
    one = daemon(*TCP)
    with Tcp(one) as master, Tcp(one) as partial:
        partial.socket.sendall(partial.frame(1, READ_ONE)[:7])
        assert master.read(0, 1) == b"\0\0"  # The daemon has read the partial frame by now.
        for i in range(300):
            master.socket.sendall(master.frame(1, struct.pack(">BHH", 6, 100, i + 1)))
        one.terminate()
        for i in range(300):
            assert as_words(master.receive()[2][1:]) == [100, i + 1]
        assert master.is_closed() and partial.is_closed()


def test_stopping_with_a_master_that_does_not_read(daemon):
    one = daemon(*TCP, "--drain-timeout-ms", "300")
    with Tcp(one) as master:
        fill(master, b"".join(master.frame(1, READ_MOST) for _ in range(1000)))
        one.terminate()
        one.close()
