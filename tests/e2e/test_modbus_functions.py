"""Every Modbus function over TCP, with valid and invalid requests."""

import random
import struct

import pytest
from lists import EVALUATORS, MODELS
from modbus_master import (
    AT, BAD_ADDRESS, BAD_ADDRESS_STATUS, BAD_FUNCTION, BAD_VALUE, BAD_VALUE_STATUS, MASK_WRITE,
    MIRROR, READ_COILS, READ_HOLDING, READ_INPUTS, WRITE_COIL, WRITE_COILS, WRITE_READ,
    WRITE_REGISTER, WRITE_REGISTERS, Exception_, Tcp, as_floats, as_words, floats, swapped, words,
)

NAN, INF = float("nan"), float("inf")


def code_of(master: Tcp, pdu: bytes, unit: int = 1) -> int:
    """Returns the exception that a request gets."""
    with pytest.raises(Exception_) as refused:
        master.ask(pdu, unit)
    return refused.value.code


# ---- plain registers and coils -------------------------------------------------------------------


def bits(values: list[int]) -> bytes:
    data = bytearray((len(values) + 7) // 8)
    for i, value in enumerate(values):
        data[i // 8] |= value << i % 8
    return bytes(data)


def test_scratch_registers_and_coils(master):
    """Reads and writes scratch registers and coils from every address on, with all functions that
    libmodbus's random-test-client uses."""
    dice = random.Random(1)
    for first in range(100):
        count = 100 - first
        values = [dice.randrange(65536) for _ in range(count)]
        coils = [value % 2 for value in values]
        pdu = struct.pack(">BHHB", WRITE_COILS, first, count, (count + 7) // 8) + bits(coils)
        assert master.ask(pdu) == pdu[1:5]
        for function in (READ_COILS, READ_INPUTS):
            answer = master.ask(struct.pack(">BHH", function, first, count))
            assert answer == bytes([(count + 7) // 8]) + bits(coils)
        master.write(first, words(*values))
        assert as_words(master.read(first, count)) == values
        inverse = [value ^ 0xFFFF for value in values]
        assert as_words(master.write_read(first, words(*inverse), first, count)) == inverse


def test_one_coil(master):
    for value in (0xFF00, 0):
        pdu = struct.pack(">BHH", WRITE_COIL, 99, value)
        assert master.ask(pdu) == pdu[1:]
        assert master.ask(struct.pack(">BHH", READ_COILS, 99, 1)) == bytes([1, value > 0])
    assert code_of(master, struct.pack(">BHH", WRITE_COIL, 0, 1)) == BAD_VALUE


def test_mask_write(master):
    master.write_one(7, 0x12)
    pdu = struct.pack(">BHHH", MASK_WRITE, 7, 0xF2, 0x25)
    assert master.ask(pdu) == pdu[1:]
    assert as_words(master.read(7, 1)) == [0x17]  # The specification has this example.
    assert code_of(master, struct.pack(">BHHH", MASK_WRITE, AT["ETA"], 0, 0)) == BAD_ADDRESS
    assert code_of(master, struct.pack(">BHHH", MASK_WRITE, AT["MODEL"], 0, 300)) == BAD_VALUE
    assert code_of(master, struct.pack(">BHHH", MASK_WRITE, 65535, 0, 0)) == BAD_ADDRESS


def test_mask_write_commits(master):
    master.ask(struct.pack(">BHHH", MASK_WRITE, AT["COMMIT"], 0, 9), 30)
    assert master.job(30)[:2] == (2, 9)


# ---- wrong requests ------------------------------------------------------------------------------

FUNCTIONS = [1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23, 43]


@pytest.mark.parametrize("function", [f for f in range(128) if f not in FUNCTIONS])
def test_unknown_functions(master, function):
    for length in (0, 4, 252):
        assert code_of(master, bytes([function]) + bytes(length)) == BAD_FUNCTION


def test_unknown_kinds_of_function_43(master):
    for kind in (0, 13, 15, 255):
        assert code_of(master, bytes([43, kind, 1, 0])) == BAD_FUNCTION


WHOLE = {
    1: struct.pack(">HH", 0, 1),
    2: struct.pack(">HH", 0, 1),
    3: struct.pack(">HH", 0, 1),
    4: struct.pack(">HH", 0, 1),
    5: struct.pack(">HH", 0, 0),
    6: struct.pack(">HH", 0, 1),
    15: struct.pack(">HHB", 0, 9, 2) + bytes(2),
    16: struct.pack(">HHB", 0, 2, 4) + bytes(4),
    17: b"",
    22: struct.pack(">HHH", 0, 1, 1),
    23: struct.pack(">HHHHB", 0, 2, 0, 2, 4) + bytes(4),
    43: bytes([14, 1, 0]),
}


@pytest.mark.parametrize("function", FUNCTIONS)
def test_lengths(master, function):
    """A request with a byte too many, or with any number of bytes too few, is refused."""
    whole = bytes([function]) + WHOLE[function]
    master.ask(whole)
    assert code_of(master, whole + b"\0") == BAD_VALUE
    for length in range(1, len(whole)):
        assert code_of(master, whole[:length]) == BAD_VALUE


@pytest.mark.parametrize(
    "function, most", [(READ_COILS, 2000), (READ_INPUTS, 2000), (READ_HOLDING, 125), (4, 125)]
)
def test_counts_to_read(master, function, most):
    for count in (0, most + 1, most + 2, 65535):
        assert code_of(master, struct.pack(">BHH", function, 0, count)) == BAD_VALUE
    if most == 125:
        assert len(master.ask(struct.pack(">BHH", function, 0, most))) == 1 + 2 * most
    else:  # There are 100 coils.
        assert code_of(master, struct.pack(">BHH", function, 0, most)) == BAD_ADDRESS


def test_counts_to_write(master):
    for count in (0, 124, 65535):
        size = min(2 * count, 246)
        pdu = struct.pack(">BHHB", WRITE_REGISTERS, 0, count, size) + bytes(size)
        assert code_of(master, pdu) == BAD_VALUE
    pdu = struct.pack(">BHHB", WRITE_COILS, 0, 1969, 247) + bytes(246)
    assert code_of(master, pdu) == BAD_VALUE
    for read, write in [(0, 1), (126, 1), (1, 0), (1, 122)]:
        pdu = struct.pack(">BHHHHB", WRITE_READ, 0, read, 0, write, min(2 * write, 242))
        assert code_of(master, pdu + bytes(min(2 * write, 242))) == BAD_VALUE
    # A count that its bytes do not hold.
    for count, size in [(2, 2), (2, 6), (2, 8), (4, 4)]:
        held = bytes(size)
        assert code_of(master, struct.pack(">BHHB", WRITE_REGISTERS, 0, count, size) + held) == BAD_VALUE
        assert code_of(master, struct.pack(">BHHHHB", WRITE_READ, 0, 1, 0, count, size) + held) == BAD_VALUE
        bits_of = struct.pack(">BHHB", WRITE_COILS, 0, 8 * count + 8, size) + held
        assert code_of(master, bits_of) == BAD_VALUE
    # The most that a request can have: zeros into scratch, and 21 registers of the input.
    data = bytes(2 * 121)
    assert code_of(master, struct.pack(">BHHHHB", WRITE_READ, 0, 125, 0, 121, 242) + data) != 1


def test_bits_beyond_the_end(master):
    assert code_of(master, struct.pack(">BHH", READ_COILS, 99, 2)) == BAD_ADDRESS
    assert code_of(master, struct.pack(">BHH", READ_INPUTS, 65535, 1)) == BAD_ADDRESS
    assert code_of(master, struct.pack(">BHH", WRITE_COIL, 100, 0)) == BAD_ADDRESS
    assert code_of(master, struct.pack(">BHHB", WRITE_COILS, 99, 2, 1) + b"\0") == BAD_ADDRESS


# ---- values --------------------------------------------------------------------------------------


def refused(master: Tcp, address: int, data: bytes, unit: int) -> tuple[int, int, int]:
    """Returns the exception, the error and the address that a write gets. Checks that it changed
    nothing else."""
    before = master.read(100, 160, unit)
    with pytest.raises(Exception_) as why:
        master.write(address, data, unit)
    assert master.read(100, 160, unit) == before
    job = master.job(unit)
    return why.value.code, job.error, job.error_address


HALVES = [
    (AT["ETA"], 1, AT["ETA"]),
    (AT["ETA"] + 1, 1, AT["ETA"]),
    (AT["G"] + 1, 3, AT["G"]),
    (AT["SIGMA_A"], 3, AT["SIGMA_S"]),
    (AT["RADII"] + 99, 1, AT["RADII"] + 98),
    (MIRROR + AT["ETA"] + 1, 1, AT["ETA"]),
]


@pytest.mark.parametrize("address, count, at", HALVES)
def test_half_a_float(master, address, count, at):
    assert refused(master, address, bytes(2 * count), 40) == (2, BAD_ADDRESS_STATUS, at)


READ_ONLY = [AT["STATUS"], AT["R"], AT["ERROR_TEXT"], 240, 299, 620, 700, 1200, 1300, 1999]
READ_ONLY += [MIRROR, MIRROR + 99, MIRROR + AT["R"], 65535]


@pytest.mark.parametrize("address", READ_ONLY)
def test_what_is_not_written(master, address):
    at = AT["R"] if address == MIRROR + AT["R"] else address
    assert refused(master, address, bytes(2), 41) == (2, BAD_ADDRESS_STATUS, at)
    assert code_of(master, struct.pack(">BHH", WRITE_REGISTER, address, 0), 41) == BAD_ADDRESS


FLOATS = {
    "SIGMA_A": [-1.0, 2e15, NAN, INF],
    "SIGMA_S": [-1e-30, NAN],
    "G": [1.0, -1.0, NAN],
    "ETA": [0.0, 1e-4, 1001.0, -1.3, NAN],
    "RADIUS_START": [-1.0, INF, NAN],
    "RADIUS_STOP": [-1.0, INF, NAN],
    "RADII": [-1e-38, NAN, -INF],
    "PARAMETER_TOLERANCE": [1.5, -0.5, NAN],
    "THICKNESS": [-2.0, NAN, INF],
    "SAMPLE_U": [1.5], "SAMPLE_DEADLINE_MS": [-1.0], "INVERT_ALBEDO": [1.5], "INVERT_LENGTH": [0.0, 2e14],
    "MC_PHOTONS": [0.0], "MC_ERROR_TOTAL": [1e-10],
}  # fmt: skip


@pytest.mark.parametrize("name, value", [(n, v) for n, vs in FLOATS.items() for v in vs])
def test_floats_out_of_range(master, name, value):
    expected = (3, BAD_VALUE_STATUS, AT[name])
    assert refused(master, AT[name], floats(value), 42) == expected
    text = master.read(AT["ERROR_TEXT"], 40, 42).rstrip(b"\0").decode("ascii")
    optional = name in ("PARAMETER_TOLERANCE", "THICKNESS", "MC_ERROR_TOTAL")
    assert " to " in text and text.endswith(", or -1: not given") == optional
    assert refused(master, MIRROR + AT[name], swapped(floats(value)), 42) == expected


# Values at the ends of their ranges. A tolerance or an albedo of 0 or -1 means none.
GOOD = {
    "ETA": [1000.0],
    "G": [0.99999994, 0.0],
    "RADII": [INF, -0.0],
    "PARAMETER_TOLERANCE": [0.0, -1.0],
    "PARAMETER_SURFACE_ALBEDO": [0.0],
    "THICKNESS": [1e-15, 1e30],
    "PARAMETER_FIT_TO": [1e-30],
}


@pytest.mark.parametrize("name, value", [(n, v) for n, vs in GOOD.items() for v in vs])
def test_floats_at_the_ends(master, name, value):
    for address, data in [(AT[name], floats(value)), (MIRROR + AT[name], swapped(floats(value)))]:
        master.write(address, data, 47)
        assert master.read(address, 2, 47) == data


IDS = {
    "MODEL": [max(MODELS.values()) + 1, 65535],
    "EVALUATOR": [0, max(EVALUATORS.values()) + 1],
    "MOMENTS": [0, 5],
    "SPACING": [0, 4],
    "RADIUS_COUNT": [0, 51],
    "WANTED": [0, 8, 16, 257 + 32, 512, 65535],
    "SAMPLE_DRAW": [0, 5], "SAMPLE_SAMPLE_COUNT": [0, 51], "SAMPLE_CANCEL": [2],
    "INVERT_GIVEN": [5], "INVERT_MEDIUM_COUNT": [51], "MC_RING_COUNT": [0, 51],
}  # fmt: skip


@pytest.mark.parametrize("name, value", [(n, v) for n, vs in IDS.items() for v in vs])
def test_integers_out_of_range(master, name, value):
    assert refused(master, AT[name], words(value), 43) == (3, BAD_VALUE_STATUS, AT[name])
    pdu = struct.pack(">BHH", WRITE_REGISTER, AT[name], value)
    assert code_of(master, pdu, 43) == BAD_VALUE


def test_one_wrong_value_among_many(master):
    """If one value of a request is wrong, nothing is written, and the error has the address of that
    value."""
    expected = (3, BAD_VALUE_STATUS, AT["RADII"] + 6)
    assert refused(master, AT["RADII"], floats(1, 2, 3, NAN, 5), 44) == expected


def test_addresses_are_checked_before_values(master):
    """Addresses are checked first, as in the state diagrams of the specification. The request
    begins with a value out of range and ends with registers that cannot be written."""
    bad = AT["BELOW_THICKNESS"]
    assert refused(master, bad, floats(-5.0, 1.0), 48) == (2, BAD_ADDRESS_STATUS, bad + 2)
    bad = AT["MODEL"]
    half = words(9999) + bytes(8) + floats(1)[:2]
    assert refused(master, bad, half, 48) == (2, BAD_ADDRESS_STATUS, AT["SIGMA_A"])


def test_a_refused_read_changes_nothing(master):
    master.write(AT["SIGMA_A"], floats(0.25), 45)
    before = master.read(300, 360, 45)
    assert code_of(master, struct.pack(">BHH", READ_HOLDING, 650, 20), 45) == BAD_ADDRESS
    assert master.read(300, 360, 45) == before


def test_function_23_that_cannot_be_read_writes_nothing(master):
    pdu = struct.pack(">BHHHHB", WRITE_READ, 9900, 1, AT["SIGMA_A"], 2, 4) + floats(9.0)
    assert code_of(master, pdu, 46) == BAD_ADDRESS
    assert as_floats(master.read(AT["SIGMA_A"], 2, 46))[0] != 9.0
    assert master.job(46).error_address == 9900
