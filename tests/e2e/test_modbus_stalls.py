"""Modbus masters that are slow, silent or many: nobody else notices. How much slower another one gets
is measured by `build/bench modbus`."""

from __future__ import annotations

import resource
import select
import socket
import struct
import threading

import numpy as np
import pytest
from daemons import Daemon, sanitized
from modbus_master import TcpMaster

RADII_MM = np.linspace(0.5, 5, 10, dtype=np.float32)
MANY = 2000


def job(master: TcpMaster) -> bytes:
    """A job in one transaction; what it answers but for the sequence number."""
    answer = master.commit(sigma_a=0.032, sigma_s=0.74, r=RADII_MM)
    assert answer[:2] == (2, master.token)
    return struct.pack(f">{len(answer) - 12}H", *answer[12:])


class Trickling(threading.Thread):
    """Sends a byte every 0.4 s."""

    def __init__(self, address: str):
        super().__init__()
        self.master = TcpMaster(address)
        self.ends = threading.Event()
        self.start()

    def run(self) -> None:
        for byte in bytes.fromhex("000100000006010300640010") * 100:
            if self.ends.wait(0.4):
                return
            try:
                self.master.socket.send(bytes([byte]))
            except OSError:  # the daemon has had enough
                return


def never_reads(address: str) -> TcpMaster:
    """Asks for as much as the daemon takes, and reads nothing of it."""
    master = TcpMaster(address)
    master.socket.setblocking(False)
    question = bytes.fromhex("00010000000601030000007d") * 1000
    sent = 0
    while select.select([], [master.socket], [], 0.3)[1]:
        at = sent % len(question)
        sent += master.socket.send(question[at:])
    return master


def test_rude_masters_stall_nobody():
    options = ["--workers", "1", "--modbus-frame-timeout-ms", "60000"]
    with Daemon("--modbus", "tcp:127.0.0.1:0", *options) as one:
        with TcpMaster(one.modbus()) as polite:
            expected = job(polite)
            before = one.resident_bytes()
            trickling = Trickling(one.modbus())
            silent = never_reads(one.modbus())
            with TcpMaster(one.modbus()) as unknown:
                polite.socket.settimeout(0.4)  # libmodbus would have slept 0.5 s for each of these
                for _ in range(100):
                    unknown.send(bytes([99, 0, 0, 0, 0]))
                    assert job(polite) == expected
                    assert unknown.receive() == bytes([99 | 0x80, 1])
            assert trickling.is_alive()
            if not sanitized("asan", "tsan"):
                assert one.resident_bytes() < before + 4_000_000
            trickling.ends.set()
            trickling.join()
            trickling.master.close()
            silent.close()
            assert job(polite) == expected


def test_a_partial_frame_has_an_end():
    with Daemon("--modbus", "tcp:127.0.0.1:0", "--modbus-frame-timeout-ms", "100") as one:
        with TcpMaster(one.modbus()) as master:
            master.socket.send(bytes.fromhex("0001000000"))
            assert master.socket.recv(1) == b""


def test_silence_has_an_end():
    with Daemon("--modbus", "tcp:127.0.0.1:0", "--modbus-idle-timeout-ms", "100") as one:
        with TcpMaster(one.modbus()) as master:
            master.read(3, 0, 1)
            assert master.socket.recv(1) == b""


@pytest.fixture
def many_files():
    """Room for the descriptors of both ends."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < MANY + 200:
        pytest.skip(f"no more than {hard} open files are allowed here")
    most = hard if hard != resource.RLIM_INFINITY else MANY + 200
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(most, MANY + 200)), hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_two_thousand_connections(many_files):
    """Descriptors above 1024, which select() cannot take."""
    limit = ["--max-modbus-connections", str(MANY + 1)]
    with Daemon("--modbus", "tcp:127.0.0.1:0", *limit) as one:
        host, _, port = one.modbus().rpartition(":")
        sockets = []
        try:
            with TcpMaster(one.modbus()) as first:
                expected = job(first)
                for _ in range(MANY - 1):
                    sockets.append(socket.create_connection((host, int(port))))
                with TcpMaster(one.modbus()) as last:
                    assert job(last) == job(first) == expected
            request = bytes.fromhex("000700000006010304b00002")  # the magic
            for connection in sockets:
                connection.sendall(request)
            for connection in sockets:
                assert connection.recv(64)[9:] == b"DIPL"
        finally:
            for connection in sockets:
                connection.close()


def test_one_connection_too_many():
    with Daemon("--modbus", "tcp:127.0.0.1:0", "--max-modbus-connections", "2") as one:
        with TcpMaster(one.modbus()) as first, TcpMaster(one.modbus()) as second:
            expected = job(first)
            with TcpMaster(one.modbus()) as third:
                assert third.socket.recv(1) == b""
            assert job(second) == expected
        assert one.has_line("event=modbus", 5)
