"""Modbus masters that are slow, silent or ask for what there is not: nobody else waits for them. By
how much another one's answers take longer is measured by `build/bench modbus`."""

from __future__ import annotations

import select
import threading

import numpy as np
from daemons import sanitized
from modbus_master import AT, DONE, TCP, Tcp, input_block

RADII_MM = np.linspace(0.5, 5, 10, dtype=np.float32)
WAIT_S = 0.4  # libmodbus's own server would have slept 0.5 s for each unknown function


def values(master: Tcp) -> bytes:
    """R of a job in one transaction."""
    answer = master.write_read(AT["COMMIT"], input_block(1, radii=RADII_MM), AT["STATUS"], 32)
    assert answer[:4] == bytes([0, DONE, 0, 1])
    return answer[24:]


class Trickling(threading.Thread):
    """Sends a byte every 0.4 s."""

    def __init__(self, address: str):
        super().__init__()
        self.master = Tcp(address)
        self.ends = threading.Event()
        self.start()

    def run(self) -> None:
        for byte in bytes.fromhex("000100000006010300640010") * 100:
            if self.ends.wait(0.4):
                break
            self.master.socket.sendall(bytes([byte]))
        self.master.socket.close()


def never_reads(address: str) -> Tcp:
    """Asks for as much as the daemon takes, and reads nothing of it."""
    master = Tcp(address)
    question = bytes.fromhex("00010000000601030000007d") * 1000
    sent = 0
    master.socket.setblocking(False)
    while select.select([], [master.socket], [], 0.3)[1]:
        sent += master.socket.send(question[sent % len(question) :])
    return master


def test_rude_masters_stall_nobody(daemon):
    one = daemon(*TCP, "--workers", "1", "--modbus-frame-timeout-ms", "60000")
    address = one.url("modbus-tcp")
    with Tcp(address) as polite:
        expected = values(polite)
        before = one.resident_bytes()
        trickling = Trickling(address)
        with never_reads(address), Tcp(address) as unknown:
            polite.socket.settimeout(WAIT_S)
            for _ in range(100):
                unknown.socket.sendall(unknown.frame(1, bytes([99, 0, 0, 0, 0])))
                assert values(polite) == expected
                assert unknown.receive()[2] == bytes([99 | 0x80, 1])
            assert trickling.is_alive()
            if not sanitized("asan", "tsan"):
                assert one.resident_bytes() < before + 4_000_000
            trickling.ends.set()
            trickling.join()
        assert values(polite) == expected
