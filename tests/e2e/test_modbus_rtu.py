"""Modbus RTU over a pseudo terminal: the same registers as over TCP, silence, noise, other devices,
broadcasts, and a device that goes away."""

from __future__ import annotations

import os
import pty
import struct
import tty

import pytest
from lists import MODELS
from modbus_master import (
    AT, BAD_ADDRESS, BAD_FUNCTION, READ_HOLDING, TCP, WRITE_REGISTER, Rtu, Tcp, as_words, exception,
    input_block, words,
)

READ_ONE = struct.pack(">BHH", READ_HOLDING, 0, 1)


class Line:
    """A pseudo terminal: the master's end, and the name of the slave's."""

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
    """Starts a daemon on the line, and over TCP; the master on the line, and the daemon."""

    def on_line(settings: str = "19200,N,7", *options: str):
        one = daemon("--modbus", f"rtu:{line.device},{settings}", *TCP, *options)
        return Rtu(line.fd), one

    return on_line


def test_the_address_is_logged(start, line):
    _, one = start()
    assert f"modbus-rtu:{line.device},19200,N,7" in one.urls


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
        (struct.pack(">BHH", READ_HOLDING, 5000, 1), BAD_ADDRESS),
        (struct.pack(">BHH", WRITE_REGISTER, AT["ETA"], 1), BAD_ADDRESS),
        (b"\x07", BAD_FUNCTION),
        (b"\x41\x01\x02", BAD_FUNCTION),
    ]:
        with exception(code):
            master.ask(pdu, 7)


def test_device_identification(start):
    master, one = start()
    pdu = bytes([43, 14, 4, 0])
    master.send(master.frame(7, pdu))
    with Tcp(one) as tcp:
        expected = master.frame(7, bytes([43]) + tcp.ask(pdu, 7))
    assert master.receive_bytes(len(expected)) == expected


def test_a_slow_model(start):
    master, _ = start()
    block = input_block(1, (0.0333, 0.74, 0, 1.3), [1.0], model=MODELS["transport"], evaluator=1)
    assert as_words(master.write_read(100, block, 300, 2, 7)) == [1, 0]
    assert master.wait(7)[:2] == (2, 1)


def test_unit_1_unless_it_is_said(start):
    master, _ = start("9600,E")
    assert master.read(1200, 2, 1) == b"DIPL"
    master.send(master.frame(2, READ_ONE))
    assert master.is_silent()


@pytest.mark.parametrize("settings", ["1200,N", "9600,E", "115200,O,247"])
def test_settings(start, settings):
    master, _ = start(settings)
    unit = int((settings.split(",") + ["1"])[2])
    assert master.read(1200, 2, unit) == b"DIPL"


def test_requests_for_others_are_not_answered(start):
    master, one = start()
    for unit in (1, 6, 8, 247):
        master.send(master.frame(unit, struct.pack(">BHH", WRITE_REGISTER, 0, unit)))
        assert master.is_silent(0.05)
        assert master.read(0, 1, 7) == b"\0\0"  # and the next request is not lost


def test_behind_the_traffic_of_others(start):
    """As adapters deliver it: in one piece."""
    master, _ = start()
    request = master.frame(9, struct.pack(">BHH", READ_HOLDING, 0, 2))
    answer = master.frame(9, bytes([READ_HOLDING, 4]) + bytes(4))
    refusal = master.frame(9, bytes([0x83, 2]))
    echo = master.frame(9, struct.pack(">BHH", WRITE_REGISTER, 1, 2))
    for before in (request + answer, request + refusal, echo + echo, b"\xff\x00\x17", request):
        master.send(before + master.frame(7, READ_ONE))
        assert master.receive() == (7, b"\3\2\0\0")


def test_broadcasts_are_carried_out_and_not_answered(start):
    master, _ = start()
    master.send(master.frame(0, struct.pack(">BHH", WRITE_REGISTER, 3, 99)))
    assert master.is_silent()
    assert as_words(master.read(3, 1, 7)) == [99]
    master.send(master.frame(0, struct.pack(">BHHBB", 15, 0, 4, 1, 0b1011)))
    assert master.is_silent()
    assert master.ask(struct.pack(">BHH", 1, 0, 4), 7) == b"\1\x0b"
    master.send(master.frame(0, struct.pack(">BHH", WRITE_REGISTER, AT["COMMIT"], 4)))
    assert master.is_silent()
    assert master.job(7)[:2] == (2, 4)
    for pdu in (READ_ONE, struct.pack(">BHH", WRITE_REGISTER, 5000, 1), b"\x11"):
        master.send(master.frame(0, pdu))
        assert master.is_silent(0.05)


def test_a_request_in_pieces(start):
    """What comes within the gap belongs together."""
    master, _ = start("19200,N,7", "--modbus-gap-ms", "1000")
    frame = master.frame(7, struct.pack(">BHHB", 16, 0, 3, 6) + words(1, 2, 3))
    for byte in frame:
        master.send(bytes([byte]))
    assert master.receive() == (7, struct.pack(">BHH", 16, 0, 3))


def test_wrong_checksums_and_what_is_unfinished(start):
    master, one = start()
    good = master.frame(7, READ_ONE)
    with Tcp(one) as tcp:
        wrong = [good[:-1] + bytes([good[-1] ^ 1]), good[:-3], b"\x07", bytes(300), b"\xff" * 3000]
        for number, data in enumerate(wrong, 1):
            master.send(data)
            assert master.is_silent(0.05)
            assert master.read(0, 1, 7) == b"\0\0"
            assert tcp.statistic("modbus_bad_frames") >= number


def test_read_only(start):
    master, _ = start("19200,N,7", "--modbus-read-only")
    with exception(BAD_FUNCTION):
        master.write_one(0, 1, 7)
    assert master.read(1200, 2, 7) == b"DIPL"


def test_a_device_that_goes_away_and_comes_back(daemon, tmp_path):
    """By a link, as udev makes them: it is looked for, less and less often, and found again."""
    first = Line()
    link = tmp_path / "tty"
    link.symlink_to(first.device)
    one = daemon("--modbus", f"rtu:{link},19200,N")
    assert Rtu(first.fd).read(1200, 2, 1) == b"DIPL"
    link.unlink()
    first.close()
    assert one.has_line("event=modbus-device-lost", 10)
    second = Line()
    link.symlink_to(second.device)
    assert one.has_line("event=modbus-device-back", 20)
    assert Rtu(second.fd).read(1200, 2, 1) == b"DIPL"
    assert sum("modbus-device-" in text for text in one.log) == 2
    second.close()


def test_stopping_while_the_device_is_away(daemon, line):
    one = daemon("--modbus", f"rtu:{line.device},19200,N")
    line.close()
    assert one.has_line("event=modbus-device-lost", 10)
    one.terminate()


def test_stopping_answers_what_has_arrived(start):
    master, one = start()
    master.send(master.frame(7, struct.pack(">BHH", WRITE_REGISTER, AT["COMMIT"], 9)))
    one.terminate()
    assert master.receive() == (7, struct.pack(">BHH", WRITE_REGISTER, AT["COMMIT"], 9))
