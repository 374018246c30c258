"""One unit of dipoled over pymodbus, from version 3.0 on. The other Python examples use it.

A program that shares the unit with other masters may find anything in its registers. So each job
first sets all of them to their defaults, then writes what it depends on."""

from __future__ import annotations

import inspect
import math
import re
import struct
import sys
import time
from collections.abc import Callable
from typing import Any, NoReturn

try:
    from pymodbus.client import ModbusSerialClient, ModbusTcpClient  # type: ignore[import]
except ImportError:
    ModbusTcpClient = None

ERROR, ERROR_TEXT, TEXT_REGISTERS, DEFAULTS = 302, 620, 40, 251
# the exception BUSY, and values of the register `status`
BUSY, IS_BUSY, DONE, UNFITTED = 6, 1, 2, 5
# the register with the name of fit_status, and its length
FIT_STATUS_NAME, NAME_REGISTERS = 8460, 8
PATIENCE_S = 60


def refuse(what: str, about: str | None) -> NoReturn:
    """Ends the program with what is wrong with its command line."""
    print(f"{what}\n\n{about}", file=sys.stderr)
    sys.exit(2)


def arguments(about: str | None, least: int, most: int) -> list[str]:
    """Returns the `least` to `most` words of the command line. --help prints `about`."""
    given = sys.argv[1:]
    if "--help" in given or "-h" in given:
        print(about)
        sys.exit()
    if not least <= len(given) <= most:
        refuse(f"{len(given)} words are given; {least} to {most} are needed", about)
    if not re.fullmatch(r"/.+,\d+|.+:\d+", given[0]):
        refuse(f"{given[0]}: give HOST:PORT or, of a serial line, DEVICE,BAUD", about)
    return given


def numbers(text: str, most: int, about: str | None) -> list[float]:
    """Reads up to `most` finite numbers with commas between them; refuses all else."""
    try:
        found = [float(one) for one in text.split(",")]
    except ValueError:
        found = []
    if not 0 < len(found) <= most or not all(map(math.isfinite, found)):
        what = "a number" if most == 1 else f"up to {most} numbers with commas between them"
        refuse(f"{text}: give {what}, with points in numbers", about)
    return found


class Unit:
    """A unit at HOST:PORT, or on a serial line at DEVICE,BAUD."""

    def __init__(self, where: str, number: int = 1):
        self.client: Any
        if ModbusTcpClient is None:
            sys.exit(
                f"{sys.executable} has no pymodbus: install Debian's python3-pymodbus and run "
                "/usr/bin/python3, or run pip install 'pymodbus[serial]'"
            )
        if where.startswith("/"):
            device, _, baud = where.rpartition(",")
            self.client = ModbusSerialClient(device, baudrate=int(baud), parity="N")
        else:
            host, _, port = where.rpartition(":")
            self.client = ModbusTcpClient(host, port=int(port))
        if not self.client.connect():
            sys.exit(f"nothing replies at {where}")
        # pymodbus has called the number of the unit first unit, then slave, then device_id.
        names = inspect.signature(self.client.read_holding_registers).parameters
        keyword = next((name for name in ("device_id", "slave") if name in names), "unit")
        self.number = {keyword: number}

    def read(self, address: int, count: int) -> bytes:
        """Reads the bytes of registers, in requests of up to 124."""
        data = b""
        for first in range(0, count, 124):
            some = min(124, count - first)
            reply = self.client.read_holding_registers(address + first, count=some, **self.number)
            if reply.isError():
                sys.exit(f"registers {address + first} and up cannot be read: {reply}")
            data += struct.pack(f">{some}H", *reply.registers)
        return data

    def floats(self, address: int, count: int) -> tuple[float, ...]:
        """Reads floats, whose most significant word comes first."""
        return struct.unpack(f">{count}f", self.read(address, 2 * count))

    def text(self, address: int, count: int) -> str:
        """Reads the text of registers."""
        return self.read(address, count).rstrip(b"\0").decode("ascii")

    def fail(self, error: int = ERROR, text: int = ERROR_TEXT) -> None:
        """Ends the program with what the daemon says of the last error."""
        status, address = struct.unpack(">2H", self.read(error, 2))
        sys.exit(f"error {status} at register {address}: {self.text(text, TEXT_REGISTERS)}")

    def write(self, address: int, form: str, *values: float) -> None:
        """Writes values as registers. form: their types, as in the module struct, such as "2H4f".
        While another master's job runs, a commit is refused as busy: this method then writes it
        again until that job has ended."""
        data = struct.pack(f">{form}", *values)
        registers = list(struct.unpack(f">{len(data) // 2}H", data))
        give_up = time.monotonic() + PATIENCE_S
        while (reply := self.client.write_registers(address, registers, **self.number)).isError():
            if getattr(reply, "exception_code", 0) != BUSY or time.monotonic() > give_up:
                if not hasattr(reply, "exception_code"):
                    sys.exit(str(reply))  # nothing came back
                self.fail()
            time.sleep(0.05)

    def token(self, status: int = 300) -> int:
        """Returns a token that differs from that of the last job."""
        done: int = struct.unpack(">H", self.read(status + 1, 1))[0]
        return done % 65535 + 1

    def wait(
        self,
        token: int,
        status: int = 300,
        error_text: int = ERROR_TEXT,
        show: Callable[[], None] = lambda: None,
    ) -> None:
        """Waits until the job with this token is done. Calls show() meanwhile. The register `done`
        follows `status`, then come `error` and `error_address`."""
        while True:
            state, done = struct.unpack(">2H", self.read(status, 2))
            if state != IS_BUSY:
                break
            show()
            time.sleep(0.02)
        if state == UNFITTED:
            sys.exit(f"the fit is no success: {self.text(FIT_STATUS_NAME, NAME_REGISTERS)}")
        if state != DONE:
            self.fail(status + 2, error_text)
        if done != token:
            sys.exit(f"another master's job, {done}, has taken the place of {token}")
