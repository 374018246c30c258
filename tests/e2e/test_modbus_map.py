"""The Modbus register map from outside: discovery, defaults, word orders, units, and the examples
of proto/REGISTERS.md."""

import struct

import numpy as np
import pytest
from daemons import eventually
from messages import read_examples
from modbus_master import (
    AT, BAD_ADDRESS, BAD_VALUE, BLOCKS, DEVICE_ID, MIRROR, NO_UNIT, READ_HOLDING, READ_INPUT,
    REPORT_ID, TCP, Tcp, as_floats, as_words, exception, floats, input_block, swapped, words,
)


# ---- discovery -----------------------------------------------------------------------------------


@pytest.mark.parametrize("function", [READ_HOLDING, READ_INPUT])
def test_discovery(master, function):
    start = master.read(1200, 14, function=function)
    assert start[:4] == b"DIPL"
    version, mirror, most = struct.unpack(">HHH", start[4:10])
    assert (version, mirror, most) == (1, MIRROR, 50)
    assert as_floats(start[12:16])[0] == 123456.0
    assert start[12:].hex() == "47f12000" "200047f1" "f1470020" "0020f147"
    found = {}
    at = 1214
    while (number := as_words(master.read(at, 1, function=function))[0]) != 0xFFFF:
        found[number] = tuple(as_words(master.read(at + 1, 2, function=function)))
        at += 3
    assert found == BLOCKS


def test_all_that_can_be_read_is_the_blocks(master):
    """Functions 3 and 4 can read every block as a whole, and no register outside of blocks."""
    inside = set()
    for first, length in BLOCKS.values():
        inside |= set(range(first, first + length))
        for function in (READ_HOLDING, READ_INPUT):
            assert len(master.read(first, length, 77, function)) == 2 * length
    for first, length in BLOCKS.values():
        for address in (first - 1, first + length):
            if 0 <= address and address not in inside:
                with exception(BAD_ADDRESS):
                    master.read(address, 1)
    for address, count in [(299, 2), (219, 42), (65535, 125)]:
        with exception(BAD_ADDRESS):
            master.read(address, count)


def test_report_server_id(master):
    answer = master.ask(bytes([REPORT_ID]), 5)
    assert answer[0] == len(answer) - 1 and answer[1:3] == b"\x05\xff"
    assert answer[3:].startswith(b"dipoled ")


def objects(answer: bytes) -> dict[int, str]:
    """Returns the objects of an answer to function 43/14."""
    count, data, found = answer[5], answer[6:], {}
    while data:
        found[data[0]] = data[2 : 2 + data[1]].decode()
        data = data[2 + data[1] :]
    assert len(found) == count
    return found


def test_device_identification(master):
    def ask(code: int, number: int) -> bytes:
        return master.ask(bytes([DEVICE_ID, 14, code, number]))

    basic = ask(1, 0)
    assert basic[:5] == bytes([14, 1, 0x82, 0, 0])
    assert set(objects(basic)) == {0, 1, 2}
    regular = objects(ask(2, 0))
    assert set(regular) == {0, 1, 2, 4, 5} and objects(ask(3, 0)) == regular
    for number, text in regular.items():
        assert objects(ask(4, number)) == {number: text}
    assert set(objects(ask(2, 2))) == {2, 4, 5}  # all objects from object 2 on
    # If the object does not exist, the answer begins with the first one.
    assert objects(ask(2, 99)) == regular
    for code, number, expected in [(4, 3, BAD_ADDRESS), (0, 0, BAD_VALUE), (5, 0, BAD_VALUE)]:
        with exception(expected):
            ask(code, number)


def test_statistics_are_the_daemons(daemon):
    one = daemon(*TCP)
    with Tcp(one) as master, one.client() as client:
        master.write_read(100, input_block(1, radii=[1.0]), 300, 8)
        with exception(BAD_ADDRESS):
            master.read(9900, 1)
        counted = client.statistics()
        for name in ("transactions", "exceptions", "evaluations", "connections_open"):
            assert counted[f"modbus_{name}"] == 1
        assert master.statistic("modbus_exceptions") == 1
        assert master.statistic("modbus_evaluations") == 1
        assert master.statistic("modbus_transactions") == 3
        assert master.statistic("batched_requests") == counted["batched_requests"] == 2


# ---- defaults and word orders --------------------------------------------------------------------


def test_both_sides_of_the_mirror(master):
    """A value that is written on one side can be read on the other: floats with their words
    swapped, all else alike."""
    master.write(AT["SIGMA_A"], floats(0.5, 2.0, 0.25, 1.25), 11)
    mirrored = master.read(MIRROR + AT["SIGMA_A"], 8, 11)
    assert mirrored == swapped(floats(0.5, 2.0, 0.25, 1.25))
    master.write(MIRROR + AT["RADII"], swapped(floats(0.5, 7.0)), 11)
    assert as_floats(master.read(AT["RADII"], 4, 11)).tolist() == [0.5, 7.0]
    master.write(MIRROR + AT["MODEL"], words(1, 2), 11)
    assert as_words(master.read(AT["MODEL"], 2, 11)) == [1, 2]


def test_a_job_through_the_mirror(master):
    plain = input_block(3, medium=(0.1, 1.0, 0.5, 1.4), grid=(3, 6, 0.25, 16.0))
    head, medium, shape, ends = plain[:8], plain[8:28], plain[28:32], plain[32:]
    answer = master.write_read(
        MIRROR + 100, head + swapped(medium) + shape + swapped(ends), MIRROR + 300, 24, 12
    )
    expected = master.write_read(100, plain, 300, 24, 13)
    assert answer[:16] == expected[:16]
    assert answer[16:] == swapped(expected[16:])
    for start in ("R", "CDF", "DISTANCES"):
        mirrored = master.read(MIRROR + AT[start], 100, 12)
        assert swapped(mirrored) == master.read(AT[start], 100, 12)


# ---- defaults ------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", [0, MIRROR])
def test_a_register_restores_the_defaults(daemon, side):
    """The register restores all registers that can be written, on both sides of the mirror. The
    results stay."""
    with Tcp(daemon(*TCP)) as master:
        writable = [(0, 260), (MIRROR + 100, 160)]
        fresh = [master.read(*some) for some in writable]
        master.write(0, words(*range(100)))
        master.write_read(100, input_block(7, (0.1, 2.0, 0.5, 1.4), [0.5] * 50, model=1), 300, 8)
        master.write(AT["PARAMETER_COS_IN"], floats(0.5, 0.5, 3.0, 0.5, 4.0, 2.0, 0.1, 5.0))
        master.write_one(AT["WANTED"], 2)
        results = master.read(300, 320)
        master.write_one(side + AT["DEFAULTS"], 1)
        assert [master.read(*some) for some in writable] == fresh
        assert master.read(300, 320) == results and as_words(results[2:4]) == [7]
        master.write_one(AT["DEFAULTS"], 0)
        master.write_one(AT["COMMIT"], 8)
        assert master.job()[:3] == (2, 8, 0)


def test_defaults_come_before_the_rest_of_the_request(master):
    master.write(AT["SIGMA_A"], floats(0.5), 79)
    master.write(AT["WANTED"], words(2, 1), 79)
    assert as_words(master.read(AT["WANTED"], 2, 79)) == [2, 0]
    assert as_floats(master.read(AT["SIGMA_A"], 2, 79)).tolist() == [np.float32(0.032)]


# ---- units ---------------------------------------------------------------------------------------


def test_units_are_apart_and_stay(slave):
    with Tcp(slave) as one, Tcp(slave) as two:
        one.write(0, words(1, 2, 3), 20)
        two.write(0, words(7, 8, 9), 21)
        assert as_words(two.read(0, 3, 20)) == [1, 2, 3]
        assert as_words(one.read(0, 3, 21)) == [7, 8, 9]
    with Tcp(slave) as again:
        assert as_words(again.read(0, 3, 20)) == [1, 2, 3]


def test_units_0_and_255_are_unit_1(master):
    for unit, value in [(0, 10), (255, 11), (1, 12)]:
        master.write_one(50, value, unit)
        for other in (0, 1, 255):
            assert as_words(master.read(50, 1, other)) == [value]


def test_every_unit(master):
    for unit in range(2, 248):
        master.write_one(99, unit * 3, unit)
    for unit in range(2, 248):
        assert as_words(master.read(99, 1, unit)) == [unit * 3]


@pytest.mark.parametrize("unit", range(248, 255))
def test_units_that_are_not_there(master, unit):
    with exception(NO_UNIT):
        master.read(0, 1, unit)


# ---- REGISTERS.md --------------------------------------------------------------------------------

EXAMPLES = read_examples("REGISTERS.md")


def before(name: str) -> list[str]:
    """Returns the examples that come before an example of the same unit."""
    if name.startswith("fit"):
        order = ["fit-eta", "fit-setup", "fit", "fit-again"]
        return order[: order.index(name)]
    return [name.split("-")[0]] if name.endswith("-read") else []


@pytest.mark.parametrize("name", [n[:-8] for n in EXAMPLES if n.endswith("-request")])
def test_examples(daemon, name):
    """The examples in REGISTERS.md get their documented answers. An example whose name ends in
    -read is sent after the job that it reads has ended."""

    def busy(master: Tcp, field: str) -> bool:
        return as_words(master.read(AT[field], 1)) == [1]

    with Tcp(daemon(*TCP)) as master:
        for one in [*before(name), name]:
            master.socket.sendall(EXAMPLES[f"{one}-request"])
            expected = EXAMPLES[f"{one}-reply"]
            assert master.receive_bytes(len(expected)).hex() == expected.hex()
            for field in ("MC_STATUS", "FIT_STATUS"):
                assert eventually(lambda field=field: not busy(master, field))


def test_there_are_examples():
    assert {"job", "discovery", "refused", "sample", "invert", "mc", "fit", "fit-again"} <= {
        name.removesuffix("-request") for name in EXAMPLES
    }
