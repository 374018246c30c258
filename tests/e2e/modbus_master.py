"""Modbus masters that build every byte themselves, over TCP and over a serial line, and the map of
registers as proto/registers.def has it."""

import contextlib
import os
import re
import select
import socket
import struct
import subprocess
import time
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pytest
from daemons import REPOSITORY, Daemon
from lists import EVALUATORS, MODELS, entries, read_list

TCP = "--modbus", "tcp:127.0.0.1:0"

READ_COILS, READ_INPUTS, READ_HOLDING, READ_INPUT = 1, 2, 3, 4
WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS = 5, 6, 15, 16
REPORT_ID, MASK_WRITE, WRITE_READ, DEVICE_ID = 17, 22, 23, 43
BAD_FUNCTION, BAD_ADDRESS, BAD_VALUE, BUSY, NO_UNIT = 1, 2, 3, 6, 11

BAD_VALUE_STATUS, BUSY_STATUS, DEADLINE_STATUS, BAD_ADDRESS_STATUS = 6, 10, 12, 13  # `error`
IDLE, IS_BUSY, DONE, ERROR = range(4)  # values of the register `status`
MIRROR = 2000


def addresses() -> dict[str, int]:
    """Returns the PDU addresses by the fields' identifiers."""
    lists = "".join(
        f"#define REGISTERS_{kind}(ident, address, ...) @ident=address@\n"
        for kind in ("FIELD", "STATISTIC")
    )
    text = subprocess.run(
        ["cc", "-E", "-P", "-I.", "-x", "c", "-"],
        input=f'{lists}#include "proto/registers.def"\n',
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    fields = {
        ident: sum(map(int, re.findall(r"\d+", address)))  # such as (4420) + 1
        for ident, address in re.findall(r"@ *(\w+) *= *([\d+() ]+)@", text)
    }
    for number, ident, _, _ in entries("PARAMETER"):
        fields[f"PARAMETER_{ident}"] = 104 if number == "1" else 216 + 2 * int(number)
    return fields


AT = addresses()
BLOCKS = {
    int(number): (int(first), int(length))
    for number, first, length in re.findall(
        r"^REGISTERS_(?:BLOCK|SWAPPED)\((\d+), \w+, (\d+), (\d+),", read_list("proto/registers.def"), re.M
    )
}


class Exception_(Exception):
    """The slave answered with an exception."""

    def __init__(self, code: int):
        super().__init__(f"exception {code:02x}")
        self.code = code


class Lost(Exception):
    """The slave closed the connection."""


@contextlib.contextmanager
def exception(code: int) -> Iterator[None]:
    """Checks that a request within the with block gets this exception."""
    with pytest.raises(Exception_) as refused:
        yield
    assert refused.value.code == code


# ---- numbers -------------------------------------------------------------------------------------


def words(*values: int) -> bytes:
    """Registers."""
    return struct.pack(f">{len(values)}H", *values)


def floats(*values: float) -> bytes:
    """float32, ABCD."""
    return struct.pack(f">{len(values)}f", *values)


def swapped(data: bytes) -> bytes:
    """Exchanges the two words of each float."""
    return np.frombuffer(data, ">u2").reshape(-1, 2)[:, ::-1].tobytes()


def as_floats(data: bytes) -> np.ndarray:
    """float32, ABCD."""
    return np.frombuffer(data, ">f4").astype("f4")


def as_doubles(data: bytes) -> np.ndarray:
    """float64, most significant word first."""
    return np.frombuffer(data, ">f8").astype("f8")


def as_words(data: bytes) -> list[int]:
    """Registers."""
    return [int(word) for word in np.frombuffer(data, ">u2")]


def write_read_pdu(address: int, data: bytes, read_address: int, count: int) -> bytes:
    """Makes the PDU of function 23, which writes and then reads registers."""
    registers = read_address, count, address, len(data) // 2
    return struct.pack(">BHHHHB", WRITE_READ, *registers, len(data)) + data


# ---- masters -------------------------------------------------------------------------------------


class Job(NamedTuple):
    """The head of the output block."""

    status: int
    done: int
    error: int
    error_address: int
    sequence: int
    count: int
    model: int
    evaluator: int


class Master:
    """The base of both masters. Each of them has its own exchange(unit, pdu)."""

    def exchange(self, unit: int, pdu: bytes) -> bytes:
        raise NotImplementedError

    def ask(self, pdu: bytes, unit: int = 1) -> bytes:
        """Sends a request. Returns the answer's PDU without the function code; raises
        Exception_."""
        answer = self.exchange(unit, pdu)
        if answer[0] == pdu[0] | 0x80:
            assert len(answer) == 2
            raise Exception_(answer[1])
        assert answer[0] == pdu[0]
        return answer[1:]

    def read(self, address: int, count: int, unit: int = 1, function: int = READ_HOLDING) -> bytes:
        """Reads registers, at most 125 with one request."""
        data = b""
        for first in range(0, count, 125):
            some = min(125, count - first)
            answer = self.ask(struct.pack(">BHH", function, address + first, some), unit)
            assert answer[0] == len(answer) - 1 == 2 * some
            data += answer[1:]
        return data

    def write(self, address: int, data: bytes, unit: int = 1) -> None:
        """Writes registers with function 16."""
        count = len(data) // 2
        answer = self.ask(
            struct.pack(">BHHB", WRITE_REGISTERS, address, count, len(data)) + data, unit
        )
        assert answer == struct.pack(">HH", address, count)

    def write_read(
        self, address: int, data: bytes, read_address: int, count: int, unit: int = 1
    ) -> bytes:
        """Writes and then reads registers with function 23."""
        answer = self.ask(write_read_pdu(address, data, read_address, count), unit)
        assert answer[0] == len(answer) - 1 == 2 * count
        return answer[1:]

    def write_one(self, address: int, value: int, unit: int = 1) -> None:
        """Writes one register with function 6."""
        data = struct.pack(">HH", address, value)
        assert self.ask(bytes([WRITE_REGISTER]) + data, unit) == data

    def job(self, unit: int = 1) -> Job:
        """The head of the output block."""
        return Job(*as_words(self.read(AT["STATUS"], 8, unit)))

    def wait(self, unit: int = 1, timeout_s: float = 30.0) -> Job:
        """Waits until the unit is not busy and returns the head of the output block."""
        deadline = time.monotonic() + timeout_s
        while (job := self.job(unit)).status == IS_BUSY:
            assert time.monotonic() < deadline
            time.sleep(0.001)  # The daemon has the processor meanwhile.
        return job

    def statistic(self, name: str) -> int:
        """Reads a statistic of register block 7."""
        return struct.unpack(">I", self.read(AT[name.upper()], 2))[0]


class Tcp(Master):
    """A master over TCP. slave: a daemon, or the HOST:PORT that its log gives for Modbus."""

    def __init__(self, slave: Daemon | str, timeout_s: float = 20.0, source: str | None = None):
        address = slave if isinstance(slave, str) else slave.url("modbus-tcp")
        host, port = address.removeprefix("modbus-tcp:").rsplit(":", 1)
        self.socket = socket.create_connection(
            (host.strip("[]"), int(port)), timeout_s, (source, 0) if source else None
        )
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.transaction = 0

    def __enter__(self) -> "Tcp":
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def own_address(self) -> str:
        """Returns the HOST:PORT from which this master is connected, as the daemon sees it."""
        return "{}:{}".format(*self.socket.getsockname())

    def frame(self, unit: int, pdu: bytes) -> bytes:
        """Makes the frame of a request, with the next transaction number."""
        self.transaction = (self.transaction + 1) & 0xFFFF
        return struct.pack(">HHHB", self.transaction, 0, 1 + len(pdu), unit) + pdu

    def receive_bytes(self, count: int) -> bytes:
        """Receives exactly count bytes."""
        data = bytearray()
        while len(data) < count:
            try:
                some = self.socket.recv(count - len(data))
            except ConnectionResetError:
                raise Lost from None
            if not some:
                raise Lost
            data += some
        return bytes(data)

    def receive(self) -> tuple[int, int, bytes]:
        """Receives an answer: transaction, unit, PDU."""
        transaction, protocol, length, unit = struct.unpack(">HHHB", self.receive_bytes(7))
        assert protocol == 0 and 3 <= length <= 254
        return transaction, unit, self.receive_bytes(length - 1)

    def exchange(self, unit: int, pdu: bytes) -> bytes:
        self.socket.sendall(self.frame(unit, pdu))
        transaction, answered_by, answer = self.receive()
        assert (transaction, answered_by) == (self.transaction, unit)
        return answer

    def is_closed(self) -> bool:
        """Returns whether the slave closes the connection without sending another answer."""
        try:
            self.receive_bytes(1)
            return False
        except Lost:
            return True


def checksum(data: bytes) -> bytes:
    """Returns the CRC-16 of Modbus, low byte first."""
    sum = 0xFFFF
    for byte in data:
        sum ^= byte
        for _ in range(8):
            sum = sum >> 1 ^ (0xA001 if sum & 1 else 0)
    return struct.pack("<H", sum)


class Rtu(Master):
    """A master on a serial line. fd: the master's end of the line."""

    def __init__(self, fd: int, timeout_s: float = 20.0):
        self.fd = fd
        self.timeout_s = timeout_s

    @staticmethod
    def frame(unit: int, pdu: bytes) -> bytes:
        """Makes a frame: unit, PDU, checksum."""
        data = bytes([unit]) + pdu
        return data + checksum(data)

    def send(self, data: bytes) -> None:
        """Sends bytes without adding anything."""
        assert os.write(self.fd, data) == len(data)

    def receive_bytes(self, count: int) -> bytes:
        """Receives exactly count bytes."""
        data = b""
        deadline = time.monotonic() + self.timeout_s
        while len(data) < count:
            ready, _, _ = select.select([self.fd], [], [], max(0, deadline - time.monotonic()))
            assert ready, f"silence after {data.hex()}"
            data += os.read(self.fd, count - len(data))
        return data

    def receive(self) -> tuple[int, bytes]:
        """Receives an answer: unit, PDU."""
        data = self.receive_bytes(3)
        function = data[1]
        if function >= 0x80:
            more = 2
        elif function in (READ_COILS, READ_INPUTS, READ_HOLDING, READ_INPUT, REPORT_ID, WRITE_READ):
            more = data[2] + 2
        elif function == MASK_WRITE:
            more = 7
        else:
            more = 5
        data += self.receive_bytes(more)
        assert checksum(data[:-2]) == data[-2:]
        return data[0], data[1:-2]

    def is_silent(self, for_s: float = 0.1) -> bool:
        """Returns whether no byte arrives for this time."""
        return not select.select([self.fd], [], [], for_s)[0]

    def exchange(self, unit: int, pdu: bytes) -> bytes:
        self.send(self.frame(unit, pdu))
        answered_by, answer = self.receive()
        assert answered_by == unit
        return answer


# ---- jobs ----------------------------------------------------------------------------------------


def input_block(
    token: int,
    medium=(0.032, 0.74, 0.0, 1.3),
    radii=None,
    grid=None,
    model: int = 2,
    evaluator: int = 2,
    moments: int = 1,
    tolerance: float = 0.0,
) -> bytes:
    """Makes the input registers from `commit` on. r: a list of radii, or a grid as (spacing, count,
    start, stop)."""
    spacing, count, start, stop = grid if grid else (1, len(radii), 0.0, 0.0)
    data = words(token, model, evaluator, moments) + floats(tolerance, *medium)
    data += words(spacing, count) + floats(start, stop)
    return data if grid else data + floats(*radii)


# ---- jobs ----------------------------------------------------------------------------------------

SKIN = (0.032, 0.74, 0.0, 1.3)
SLOW = {"model": MODELS["beam"], "evaluator": EVALUATORS["lut"]}


def slow_medium(number: int) -> tuple[float, ...]:
    """Returns a medium that no request has had."""
    return single((0.032 + 1e-3 * number, 0.74, 0.0, 1.3))


def single(values) -> tuple[float, ...]:
    """Rounds numbers to float32."""
    return tuple(float(np.float32(value)) for value in values)


def run_job(master: Tcp, unit: int, block: bytes):
    """Commits a job, waits for its end, and returns the head of the output block."""
    master.write_read(100, block, 300, 8, unit)
    return master.wait(unit)
