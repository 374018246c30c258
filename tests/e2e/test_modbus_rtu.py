"""Modbus RTU over a pseudo terminal: the same registers as over TCP, silence, noise, other devices,
broadcasts, adapters with echo and RTS, and a device that is missing or goes away."""

import contextlib
import os
import pty
import select
import shutil
import socket
import struct
import subprocess
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from daemons import eventually, read_log_line, run, sanitized
from modbus_master import (
    AT, BAD_ADDRESS, BAD_FUNCTION, READ_HOLDING, TCP, WRITE_REGISTER, WRITE_REGISTERS, Rtu, Tcp,
    as_words, checksum, exception, input_block, words,
)

READ_ONE = struct.pack(">BHH", READ_HOLDING, 0, 1)


class Line:
    """A pseudo terminal: the master's end, and the name of the daemon's end."""

    def __init__(self):
        self.fd, self.slave = pty.openpty()
        tty.setraw(self.slave)
        self.device = os.ttyname(self.slave)

    def close(self) -> None:
        for fd in (self.fd, self.slave):
            if fd is not None:
                os.close(fd)
        self.fd = self.slave = None


@pytest.fixture
def line():
    one = Line()
    yield one
    one.close()


@pytest.fixture
def start(daemon, line):
    """Returns a function that starts a daemon on the line, and over TCP. It returns the master on
    the line, and the daemon."""

    def on_line(settings: str = "19200,N,7", *options: str):
        one = daemon("--modbus", f"rtu:{line.device},{settings}", *TCP, *options)
        return Rtu(line.fd), one

    return on_line


def test_the_same_answers_as_over_tcp(start):
    master, one = start()
    with Tcp(one) as tcp:
        assert master.read(1200, 60, 7) == tcp.read(1200, 60, 7)
        block = input_block(3, radii=[0.5, 1.0, 2.0])
        answer = master.write_read(100, block, 300, 115, 7)
        assert as_words(answer[:4]) == [2, 3]
        assert answer == tcp.read(300, 115, 7)
        expected = tcp.write_read(100, block, 300, 115, 8)
        assert answer == expected
        master.write(0, words(*range(100)), 7)
        assert as_words(tcp.read(0, 100, 7)) == list(range(100))
        master.write_one(5, 77, 7)
        assert as_words(tcp.read(5, 1, 7)) == [77]
        assert master.ask(b"\x11", 7) == tcp.ask(b"\x11", 7)


def test_exceptions(start):
    master, _ = start()
    for pdu, code in [
        (struct.pack(">BHH", READ_HOLDING, 9900, 1), BAD_ADDRESS),
        (struct.pack(">BHH", WRITE_REGISTER, AT["ETA"], 1), BAD_ADDRESS),
        (b"\x07", BAD_FUNCTION),
        (b"\x41\x01\x02", BAD_FUNCTION),
    ]:
        with exception(code):
            master.ask(pdu, 7)


def test_unit_1_unless_it_is_said(start):
    master, _ = start("9600,E")
    assert master.read(1200, 2, 1) == b"DIPL"
    master.send(master.frame(2, READ_ONE))
    assert master.is_silent()


def test_requests_for_others_are_not_answered(start):
    master, one = start()
    for unit in (1, 6, 8, 247):
        master.send(master.frame(unit, struct.pack(">BHH", WRITE_REGISTER, 0, unit)))
        assert master.is_silent(0.05)
        assert master.read(0, 1, 7) == b"\0\0"  # The next request is answered, too.


def test_a_refused_request_is_in_the_log(start):
    """With the device that it came from."""
    master, one = start()
    with exception(2):
        master.read(60000, 1, 7)
    device = one.url("modbus-rtu").removeprefix("modbus-rtu:").split(",")[0]
    asked = f"function=3 exception=2 address=60000 unit=7 device={device}"
    assert one.has_line(f"event=modbus-request-refused {asked}")


# ---- where a frame begins ------------------------------------------------------------------------


def crc_state_to_all_ones(data: bytes) -> bytes:
    """Returns two bytes after which the checksum is in its initial state again. A frame behind them
    is then valid both by itself and together with the data."""
    state = int.from_bytes(checksum(data), "little")
    for value in range(65536):
        if checksum_from(value) == 0xFFFF:
            return struct.pack("<H", value ^ state)
    raise AssertionError("no such bytes")


def checksum_from(state: int) -> int:
    """Returns the state of the checksum after 16 more bits."""
    for _ in range(16):
        state = state >> 1 ^ (0xA001 if state & 1 else 0)
    return state


def frame_of_another_with_one_in_it(inner: bytes) -> tuple[bytes, bytes]:
    """Makes a write to unit 9 whose last bytes are a whole frame. Returns the bytes before that
    frame, and the frame."""
    head = struct.pack(">BBHHB", 9, WRITE_REGISTERS, 0, len(inner) // 2, len(inner))
    return head + crc_state_to_all_ones(head), inner


def test_the_tail_of_a_frame_of_another_is_no_frame(start):
    """The end of a frame to another device is never taken for a request: not if that frame is
    whole, has a pause within it, lacks its first bytes, or is damaged."""
    master, one = start()
    write = master.frame(7, struct.pack(">BHH", WRITE_REGISTER, 3, 99))
    head, tail = frame_of_another_with_one_in_it(write)
    assert checksum(head + tail[:-2]) == tail[-2:]
    with Tcp(one) as tcp:

        def ended(data: bytes, bad: bool) -> None:
            """Sends bytes and, if they are no frame, waits until a silence has ended them."""
            before = tcp.statistic("modbus_bad_frames")
            master.send(data)
            assert eventually(lambda: tcp.statistic("modbus_bad_frames") == before + bad)

        for before in (head, head[3:], head[:4] + b"\x55" + head[5:], b"\x55"):
            ended(before + tail, before != head)
            assert as_words(master.read(3, 1, 7)) == [0]
        ended(head, True)
        ended(tail, False)
        assert as_words(master.read(3, 1, 7)) == [0]
    master.send(write)
    assert master.receive() == (7, write[1:-2])
    assert as_words(master.read(3, 1, 7)) == [99]


# ---- broadcasts and other forms of requests ------------------------------------------------------


def test_broadcasts_are_carried_out_and_not_answered(start):
    master, one = start()
    with Tcp(one) as tcp:

        def carried_out(pdu: bytes, seen: Callable[[], bool]) -> bool:
            master.send(master.frame(0, pdu))
            return eventually(seen) and master.is_silent()

        number, coils = struct.pack(">BHH", WRITE_REGISTER, 3, 99), struct.pack(">BHHBB", 15, 0, 4, 1, 0b1011)
        assert carried_out(number, lambda: as_words(tcp.read(3, 1, 7)) == [99])
        assert carried_out(coils, lambda: tcp.ask(struct.pack(">BHH", 1, 0, 4), 7) == b"\1\x0b")
        commit = struct.pack(">BHH", WRITE_REGISTER, AT["COMMIT"], 4)
        assert carried_out(commit, lambda: tcp.job(7)[:2] == (2, 4))
    for pdu in (READ_ONE, struct.pack(">BHH", WRITE_REGISTER, 9900, 1), b"\x11"):
        master.send(master.frame(0, pdu))
        assert master.is_silent(0.05)


def test_wrong_checksums_and_what_is_unfinished(start):
    """The next request is answered once a silence has ended what was wrong. A single byte may be the
    beginning of an echo, unless other bytes have shown that there is none."""
    master, one = start()
    good = master.frame(7, READ_ONE)
    with Tcp(one) as tcp:
        assert master.read(0, 1, 7) == b"\0\0"
        bad = 0
        for several in [[good[:-1] + bytes([good[-1] ^ 1])], [good[:-3]], [bytes(300), b"\x07"], [b"\xff" * 3000]]:
            for data in several:
                assert tcp.statistic("modbus_bad_frames") == bad
                master.send(data)
                assert eventually(lambda: tcp.statistic("modbus_bad_frames") > bad)  # noqa: B023
                bad += 1
            assert master.read(0, 1, 7) == b"\0\0"


# ---- devices that are missing --------------------------------------------------------------------


def test_a_device_that_goes_away_and_comes_back(daemon, tmp_path):
    """The device of a link, as udev makes it, disappears and comes back. It is away for so long
    that a search with growing pauses alone would find it late."""
    first = Line()
    link = tmp_path / "tty"
    link.symlink_to(first.device)
    one = daemon("--modbus", f"rtu:{link},19200,N")
    assert Rtu(first.fd).read(1200, 2, 1) == b"DIPL"
    link.unlink()
    first.close()
    assert one.has_line("event=modbus-device-lost")
    time.sleep(4.5)
    second = Line()
    link.symlink_to(second.device)
    assert one.has_line("event=modbus-device-back", 3)
    assert Rtu(second.fd).read(1200, 2, 1) == b"DIPL"
    lines = [read_log_line(text)["event"] for text in one.log if f"device={link}" in text]
    assert lines == ["modbus-device-lost", "modbus-device-missing", "modbus-device-back"]
    second.close()


@pytest.mark.parametrize("there", ["nothing", "no terminal"])
def test_a_device_that_is_missing_at_the_start(daemon, tmp_path, there):
    """If a device is missing at the start, one log line says so, everything else is served, and the
    line is opened when the device appears."""
    link = tmp_path / "tty"
    if there == "no terminal":
        link.write_text("")
    one = daemon("--modbus", f"rtu:{link},19200,N,7", *TCP)
    with Tcp(one) as tcp:
        assert tcp.read(1200, 2) == b"DIPL"
    time.sleep(1.2)
    assert sum("event=modbus-device-missing" in text for text in one.log) == 1
    link.unlink(missing_ok=True)
    line = Line()
    link.symlink_to(line.device)
    assert one.has_line(f"event=listening url=modbus-rtu:{link},19200,N,7")
    assert Rtu(line.fd).read(1200, 2, 7) == b"DIPL"
    line.close()


def test_stopping_while_devices_are_missing(daemon):
    """As many as there may be, with all that their options take."""
    rates = [1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600]
    settings = [*map(str, rates), "1200,O2,247,rts=low,rts-delay-ms=1000", *["9600,N1"] * 20]
    lines = [f"--modbus=rtu:/nonexistent/{i},{one}" for i, one in enumerate(settings)]
    daemon(*lines).terminate()
    assert "--modbus can be given 32 times at most" in run(*lines, lines[0]).stderr


def test_stopping_while_the_device_is_away(daemon, line):
    one = daemon("--modbus", f"rtu:{line.device},19200,N")
    line.close()
    assert one.has_line("event=modbus-device-lost")
    one.terminate()


def test_stopping_answers_what_has_arrived(start):
    master, one = start()
    master.send(master.frame(7, struct.pack(">BHH", WRITE_REGISTER, AT["COMMIT"], 9)))
    one.terminate()
    assert master.receive() == (7, struct.pack(">BHH", WRITE_REGISTER, AT["COMMIT"], 9))


# ---- settings ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "stop_bits", "baud"),
    [("", 1, 19200), (",9600", 1, 9600), (",1200,N", 2, 1200), (",9600,N1", 1, 9600),
     (",9600,O2,3", 2, 9600), (",115200,O,247", 1, 115200)],
)  # fmt: skip
def test_speed_and_stop_bits(daemon, line, settings, stop_bits, baud):
    """Unless the option says otherwise, lines have even parity, or a second stop bit in place of
    parity, as the standard says. A pseudo terminal does not keep the parity."""
    one = daemon("--modbus", f"rtu:{line.device}{settings}")
    state = termios.tcgetattr(line.slave)
    assert bool(state[2] & termios.CSTOPB) == (stop_bits == 2)
    assert state[4] == state[5] == getattr(termios, f"B{baud}")
    assert one.has_line(f"stop_bits={stop_bits} rts=unused")
    unit = int((*settings.split(","), *"111")[3])
    assert Rtu(line.fd).read(1200, 2, unit) == b"DIPL"


# ---- adapters with echo --------------------------------------------------------------------------


class Adapter(Rtu):
    """A master on a line whose adapter returns to the daemon all bytes that the daemon writes.
    delay_s: how much later. written: what the daemon has written."""

    def __init__(self, line: Line, delay_s: float = 0.0):
        self.line, self.delay_s = line, delay_s
        self.written = b""
        ours, self._theirs = socket.socketpair()
        self._ours = ours
        super().__init__(ours.fileno())
        self._ended = False
        self._thread = threading.Thread(target=self._return_all, daemon=True)
        self._thread.start()

    def send(self, data: bytes) -> None:
        assert os.write(self.line.fd, data) == len(data)

    def _return_all(self) -> None:
        while not self._ended:
            if select.select([self.line.fd], [], [], 0.05)[0]:
                data = os.read(self.line.fd, 1024)
                self.written += data
                time.sleep(self.delay_s)
                os.write(self.line.fd, data)
                self._theirs.sendall(data)

    def close(self) -> None:
        self._ended = True
        self._thread.join()
        self._ours.close()
        self._theirs.close()


@pytest.fixture(params=[0.0, 0.02], ids=["at once", "late"])
def echo(daemon, line, request) -> Iterator[tuple[Adapter, Tcp]]:
    """Starts a daemon on a line with echo. Returns a master on this line, and one over TCP."""
    one = daemon("--modbus", f"rtu:{line.device},19200,N,7", *TCP)
    adapter = Adapter(line, request.param)
    with Tcp(one) as tcp:
        yield adapter, tcp
    adapter.close()
    assert sum("event=modbus-echo" in text for text in one.log) == 1


def test_echo_of_function_6_at_first(echo):
    """The echo of an answer to function 6 is not taken for a repeated request, although its bytes
    are the same."""
    adapter, tcp = echo
    for value in (77, 77, 78):
        before = len(adapter.written), tcp.statistic("modbus_transactions")
        adapter.write_one(5, value, 7)
        assert adapter.is_silent(0.3)
        assert len(adapter.written) == before[0] + 8
        # The request for the statistic counts, too.
        assert tcp.statistic("modbus_transactions") == before[1] + 2
    assert as_words(tcp.read(5, 1, 7)) == [78]


def test_echo_of_other_functions(echo):
    """The echo of an answer to function 3 gets no exception."""
    adapter, _ = echo
    for _ in range(3):
        assert adapter.read(1200, 60, 7)[:4] == b"DIPL"
        adapter.write(0, words(1, 2), 7)
        adapter.write_one(0, 5, 7)
        assert adapter.read(0, 2, 7) == words(5, 2)
        with exception(BAD_ADDRESS):
            adapter.read(9900, 1, 7)
        block = input_block(3, radii=[0.5, 1.0, 2.0])
        assert as_words(adapter.write_read(100, block, 300, 20, 7)[:4]) == [2, 3]
    assert adapter.is_silent(0.3)
    one_round = (5 + 120) + 8 + 8 + (5 + 4) + 5 + (5 + 40)
    assert len(adapter.written) == 3 * one_round


def test_an_echo_and_the_repeated_request_in_one_piece(daemon, line):
    """The master repeats its request, and the adapter delivers the repeated request together with
    the echo."""
    daemon("--modbus", f"rtu:{line.device},19200,N,7")
    master = Rtu(line.fd)
    write = master.frame(7, struct.pack(">BHH", WRITE_REGISTER, 5, 1))
    master.send(master.frame(7, READ_ONE))
    answer = master.receive_bytes(7)
    master.send(answer + write)
    for _ in range(3):
        assert master.receive_bytes(8) == write
        master.send(write + write)
    assert master.receive_bytes(8) == write
    master.send(write)
    assert master.is_silent(0.2)


@pytest.mark.parametrize("first", ["function 6", "function 3"])
def test_a_master_that_repeats_its_request_is_no_echo(start, first):
    """A request that the master repeats, at once or slowly, is answered again: it is no echo."""
    master, one = start()
    if first == "function 3":
        master.read(0, 1, 7)
    with Tcp(one) as tcp:
        before = tcp.statistic("modbus_transactions")
        for _ in range(100):
            master.write_one(5, 77, 7)
        for _ in range(3):
            assert master.is_silent(0.15)
            master.write_one(5, 77, 7)
        assert tcp.statistic("modbus_transactions") == before + 104
    assert master.is_silent()


# ---- what drivers do -----------------------------------------------------------------------------

# A pseudo terminal has neither RTS nor errors. This library between the daemon and the kernel notes
# each request to a driver, with its time, and answers as a driver would.
DRIVER = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <linux/serial.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <time.h>
#include <unistd.h>

static void note(const char *what, unsigned a, unsigned b, unsigned c) {
  struct timespec now;
  FILE *file = fopen(getenv("DRIVER_NOTES"), "a");
  clock_gettime(CLOCK_MONOTONIC, &now);
  fprintf(file, "%lld.%09ld %s %u %u %u\n", (long long)now.tv_sec, now.tv_nsec, what, a, b, c);
  fclose(file);
}

int ioctl(int fd, unsigned long request, ...) {
  va_list arguments;
  va_start(arguments, request);
  void *argument = va_arg(arguments, void *);
  va_end(arguments);
  if (request == TIOCSRS485) {
    const struct serial_rs485 *wanted = argument;
    note("rs485", wanted->flags, wanted->delay_rts_before_send, wanted->delay_rts_after_send);
    errno = ENOTTY;
    return getenv("DRIVER_RS485") != NULL ? 0 : -1;
  }
  if (request == TIOCMBIS || request == TIOCMBIC) {
    note(request == TIOCMBIS ? "set" : "clear", *(const unsigned *)argument, gettid(), 0);
    return 0;
  }
  int (*next)(int, unsigned long, ...) = (int (*)(int, unsigned long, ...))dlsym(RTLD_NEXT, "ioctl");
  return next(fd, request, argument);
}
"""
RS485_ENABLED, RTS_ON_SEND, RTS_AFTER_SEND = 1, 2, 4


class Driver:
    """The environment of a daemon that uses this driver, and the driver's notes."""

    def __init__(self, folder: Path):
        self.notes = folder / "notes"
        source, library = folder / "driver.c", folder / "driver.so"
        source.write_text(DRIVER)
        options = ["-shared", "-fPIC", "-o", str(library), str(source), "-ldl"]
        subprocess.run(["cc", *options], check=True)
        self.environment = {"LD_PRELOAD": str(library), "DRIVER_NOTES": str(self.notes)}

    def read(self) -> list[tuple[float, str, list[int]]]:
        """Returns the notes: time, request, and numbers."""
        with contextlib.suppress(FileNotFoundError):
            lines = [line.split() for line in self.notes.read_text().splitlines()]
            return [(float(at), what, list(map(int, numbers))) for at, what, *numbers in lines]
        return []


@pytest.fixture
def driver(tmp_path):
    if sanitized() or shutil.which("cc") is None:
        pytest.skip("the driver is loaded before the daemon, which sanitizers do not allow")
    return Driver(tmp_path)


@pytest.mark.parametrize("level", ["high", "low"])
def test_rts_by_the_driver(daemon, line, driver, level):
    one = daemon("--modbus", f"rtu:{line.device},19200,E,7,rts={level},rts-delay-ms=3",
                 env={**driver.environment, "DRIVER_RS485": "1"})  # fmt: skip
    assert one.has_line("rts=by-driver")
    Rtu(line.fd).write_one(5, 77, 7)
    flags = RS485_ENABLED | (RTS_ON_SEND if level == "high" else RTS_AFTER_SEND)
    assert [note[1:] for note in driver.read()] == [("rs485", [flags, 3, 3])]


@pytest.mark.parametrize("level", ["high", "low"])
def test_rts_by_hand(daemon, line, driver, level):
    """RTS is on from before the first character of an answer until after the last. A thread sets it and
    takes it back that does nothing else: the worker may be at other work, and never sleeps."""
    one = daemon("--modbus", f"rtu:{line.device},1200,E,7,rts={level},rts-delay-ms=50",
                 env=driver.environment)  # fmt: skip
    assert one.has_line("rts=by-hand")
    master = Rtu(line.fd)
    sends, listens = ("set", "clear") if level == "high" else ("clear", "set")
    ((_, what, (rts, opener, *_)),) = driver.read()[1:]
    assert (what, rts) == (listens, termios.TIOCM_RTS)
    for _ in range(2):
        before = len(driver.read())
        assert master.read(1200, 2, 7) == b"DIPL"
        arrived = time.clock_gettime(time.CLOCK_MONOTONIC)
        assert eventually(lambda: len(driver.read()) == before + 2)
        began, ended = driver.read()[before:]
        assert (began[1], ended[1]) == (sends, listens)
        assert began[2][1] == ended[2][1] != opener
        assert began[0] + 0.05 <= arrived
        wire_s = 9 * 11 / 1200
        assert ended[0] - began[0] >= 0.05 + wire_s + 0.05
    for _ in range(2):  # the second arrives while RTS is on
        before = len(driver.read())
        master.send(master.frame(7, READ_ONE))
        assert eventually(lambda: len(driver.read()) > before)  # noqa: B023
    assert [master.receive() for _ in range(2)] == [(7, b"\3\2\0\0")] * 2


def test_stopping_sends_the_answer_and_takes_rts_back(daemon, line, driver):
    one = daemon("--modbus", f"rtu:{line.device},1200,E,7,rts=high,rts-delay-ms=50",
                 env=driver.environment)  # fmt: skip
    master = Rtu(line.fd)
    master.send(master.frame(7, READ_ONE))
    assert eventually(lambda: driver.read()[-1][1] == "set")
    one.terminate()
    assert master.receive() == (7, b"\3\2\0\0")
    one.close()
    began, ended = driver.read()[2:4]
    assert (began[1], ended[1]) == ("set", "clear")
    assert ended[0] - began[0] >= 0.05 + 7 * 11 / 1200 + 0.05


def test_a_line_without_rts(daemon, line):
    """With the option rts=high, a line that has no RTS is not served, because no master could hear
    the daemon."""
    one = daemon("--modbus", f"rtu:{line.device},19200,E,7,rts=high")
    assert one.has_line("event=modbus-device-missing")


@pytest.mark.parametrize("more", ["one byte of the echo", "another request"])
def test_bytes_arrive_while_rts_is_on(daemon, line, driver, more):
    """The first byte of an answer that could be an echo is sent alone. What arrives meanwhile ends
    that, once."""
    one = daemon("--modbus", f"rtu:{line.device},1200,E,7,rts=high,rts-delay-ms=50",
                 env=driver.environment)  # fmt: skip
    master = Rtu(line.fd)
    master.send(master.frame(7, b"\x06\x00\x05\x00\x4d"))
    assert eventually(lambda: len(driver.read()) >= 3)
    byte = os.read(line.fd, 1)
    master.send(byte if more == "one byte of the echo" else master.frame(7, b"\x06\x00\x05\x00\x4e"))
    assert eventually(lambda: len(driver.read()) >= 6)  # RTS is off, on for the rest, and off again
    os.set_blocking(line.fd, False)
    time.sleep(1)  # longer than any probe
    assert one.process.poll() is None
