"""Modbus frames that no master should send: the daemon answers each that can be answered, in order,
closes what has lost its framing, and gives right answers before and after.

$DIPOLED_FUZZ_FRAMES: how many (200000); $DIPOLED_FUZZ_SEED chooses others. Both are printed."""

from __future__ import annotations

import contextlib
import os
import random
import socket
import struct
from collections.abc import Iterator

import dipole
import numpy as np
from daemons import Daemon
from modbus_master import TCP, Tcp, write_read_pdu

FRAMES = int(os.environ.get("DIPOLED_FUZZ_FRAMES", "200000"))
SEED = int(os.environ.get("DIPOLED_FUZZ_SEED", "8502"))
TOGETHER = 16  # frames that are sent before their answers are read
MBAP = struct.Struct(">HHHB")
EXCEPTIONS = {1, 2, 3, 4, 6, 11}
EXACT_BYTES = {1: 5, 2: 5, 3: 5, 4: 5, 5: 5, 6: 5, 22: 7, 17: 1}  # of a PDU
EDGES = [0, 1, 99, 100, 101, 106, 107, 114, 119, 120, 219, 220, 259, 260, 299, 300, 659, 660, 700]
EDGES += [1119, 1200, 1299, 1300, 1339, 2100, 2106, 2219, 2300, 2659, 2660, 0x7FFF, 0xFFFF]
COUNTS = [0, 1, 2, 20, 100, 120, 121, 122, 123, 124, 125, 126, 1968, 1969, 2000, 2001, 0xFFFF]
JOB = struct.pack(">4H5f2H2f", 1, 2, 2, 1, 0.0, 0.032, 0.74, 0.0, 1.3, 2, 4, 0.5, 2.0)


# ---- frames --------------------------------------------------------------------------------------


def word(rng: random.Random, usual: list[int]) -> int:
    return rng.choice(usual) if rng.random() < 0.8 else rng.getrandbits(16)


def head(rng: random.Random) -> bytes:
    return struct.pack(">HH", word(rng, EDGES), word(rng, COUNTS))


def data(rng: random.Random, count: int, most: int) -> bytes:
    """Registers or bits with their byte count, which is sometimes a lie."""
    values = rng.randbytes(min(count, most))
    return bytes([len(values) if rng.random() < 0.8 else rng.getrandbits(8)]) + values


def pdu_of_a_function(rng: random.Random) -> bytes:
    """Of each function's own form, with fields at and beyond their limits."""
    function = rng.choice([1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 17, 43])
    if function == 5:
        return bytes([5]) + struct.pack(">HH", word(rng, EDGES), word(rng, [0, 0xFF00, 1]))
    if function in (15, 16):
        count = word(rng, COUNTS)
        size = (count + 7) // 8 if function == 15 else 2 * count
        first = struct.pack(">BHH", function, word(rng, EDGES), count)
        return first + data(rng, size, 247)
    if function == 22:
        return bytes([22]) + head(rng) + rng.randbytes(2)
    if function == 23:
        count = word(rng, COUNTS)
        written = struct.pack(">HH", word(rng, EDGES), count)
        return bytes([23]) + head(rng) + written + data(rng, 2 * count, 243)
    if function == 17:
        return bytes([17]) + rng.randbytes(rng.choice([0, 0, 0, 1, 5]))
    if function == 43:
        return bytes([43, rng.choice([13, 14, 14, 14]), rng.randint(0, 5), rng.getrandbits(8)])
    return bytes([function]) + head(rng)


def pdu_of_a_job(rng: random.Random) -> bytes:
    """A job that would be right but for some bits."""
    job = bytearray(JOB)
    for _ in range(rng.choice([0, 1, 1, 2, 5])):
        job[rng.randrange(len(job))] ^= 1 << rng.randrange(8)
    job[2:4] = struct.pack(">H", rng.choice([0, 1, 2, 12, 14, 9999]))  # models that are quick
    return write_read_pdu(100, bytes(job), 300, 20)


def pdu(rng: random.Random) -> bytes:
    kind = rng.random()
    if kind < 0.5:
        return pdu_of_a_function(rng)
    if kind < 0.7:
        return pdu_of_a_job(rng)
    if kind < 0.85:
        return bytes([rng.randint(0, 127)]) + rng.randbytes(rng.choice([0, 1, 4, 5, 9, 252]))
    return bytes([rng.choice([3, 16, 23, 43])]) + rng.randbytes(rng.randint(0, 252))


def unit(rng: random.Random) -> int:
    return rng.choice([0, 1, 1, 1, 2, 17, 247, 248, 254, 255])


class Frame:
    """What is sent, and what is known of the answer."""

    def __init__(self, rng: random.Random, transaction: int):
        kind = rng.random()
        self.transaction, self.unit, self.pdu = transaction, unit(rng), pdu(rng)
        self.answered = kind < 0.99
        if self.answered:
            self.bytes = MBAP.pack(transaction, 0, 1 + len(self.pdu), self.unit) + self.pdu
        else:
            self.bytes = self._broken(rng)

    def _broken(self, rng: random.Random) -> bytes:
        """What ends the connection, or leaves it in the middle of a frame."""
        kind = rng.randrange(5)
        if kind == 0:  # protocol
            return MBAP.pack(1, rng.randint(1, 65535), 1 + len(self.pdu), 1) + self.pdu
        if kind == 1:  # length
            return MBAP.pack(1, 0, rng.choice([0, 1, 255, 256, 65535]), 1) + self.pdu
        if kind == 2:
            return MBAP.pack(1, 0, 3, 1) + bytes([rng.randint(128, 255), 0])
        if kind == 3:
            return self.bytes_of_a_part(rng)
        return rng.randbytes(rng.randint(1, 300))

    def bytes_of_a_part(self, rng: random.Random) -> bytes:
        whole = MBAP.pack(1, 0, 1 + len(self.pdu), 1) + self.pdu
        return whole[: rng.randrange(1, len(whole))]


# ---- sending and judging -------------------------------------------------------------------------


def rest(master: Tcp) -> None:
    """Waits for the daemon to close, after this end has."""
    try:
        master.socket.shutdown(socket.SHUT_WR)
        while master.socket.recv(65536):
            pass
    except OSError:  # it was reset
        pass


def check(frame: Frame, answer: tuple[int, int, bytes]) -> bool:
    """True: not an exception."""
    transaction, unit_id, body = answer
    assert (transaction, unit_id) == (frame.transaction, frame.unit), frame.bytes.hex()
    function = frame.pdu[0]
    if body[0] == function | 0x80:
        assert len(body) == 2 and body[1] in EXCEPTIONS, (frame.bytes.hex(), body.hex())
        return False
    assert body[0] == function, (frame.bytes.hex(), body.hex())
    exact = EXACT_BYTES.get(function)
    assert exact is None or len(frame.pdu) == exact, "carried out with a wrong length"
    return True


def batches(rng: random.Random, count: int) -> Iterator[list[Frame]]:
    for begin in range(0, count, TOGETHER):
        yield [Frame(rng, (begin + i) % 65536) for i in range(min(TOGETHER, count - begin))]


def fuzz(slave: Daemon, rng: random.Random, count: int) -> tuple[int, int, int]:
    """How many were carried out, refused, and not to be answered."""
    good = bad = broken = 0
    master = Tcp(slave)
    for batch in batches(rng, count):
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # closed, as it should be
            master.socket.sendall(b"".join(frame.bytes for frame in batch))
        for i, frame in enumerate(batch):
            if not frame.answered:
                rest(master)
                master.socket.close()
                master = Tcp(slave)
                broken += len(batch) - i  # those behind it are lost with the connection
                break
            if check(frame, master.receive()):
                good += 1
            else:
                bad += 1
    master.socket.close()
    return good, bad, broken


def right_answer(slave: Daemon, expected: np.ndarray) -> None:
    with Tcp(slave) as master:
        answer = master.write_read(100, JOB, 300, 20, 99)
    assert struct.unpack(">2H", answer[:4]) == (2, 1)
    np.testing.assert_array_equal(np.frombuffer(answer[24:], ">f4"), expected)


def test_frames_of_no_master(daemon):
    rng = random.Random(SEED)
    print(f"DIPOLED_FUZZ_FRAMES={FRAMES} DIPOLED_FUZZ_SEED={SEED}")
    one = daemon(*TCP)
    with one.client() as client:
        medium = dipole.Medium(*np.array([0.032, 0.74, 0, 1.3], np.float32).astype(float))
        how = {"grid": dipole.Grid(0.5, 2.0, 4), "evaluator": "f32"}
        expected = client.eval("better", medium, **how).R[0]
        right_answer(one, expected)
        good, bad, broken = fuzz(one, rng, FRAMES)
        right_answer(one, expected)
        np.testing.assert_array_equal(client.eval("better", medium, **how).R[0], expected)
    print(f"carried out {good}, refused {bad}, not to be answered {broken}")
    assert min(good, bad, broken) > FRAMES / 50
