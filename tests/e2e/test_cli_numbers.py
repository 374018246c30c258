"""Numbers in CSV: the fewest digits that read back to the same double."""

from __future__ import annotations

import math
import random
import struct

import pytest
from command_line import eval_rows, points, read_csv

SMALLEST = 2.0**-1074


def significant_digits(text: str) -> str:
    """Returns the digits of a decimal number without sign, point, exponent and outer zeros."""
    return text.lstrip("-").split("e")[0].replace(".", "").strip("0")


def assert_shortest(text: str, value: float) -> None:
    """Checks that a text has as few digits as Python's repr, which is shortest, and is not
    longer."""
    assert float(text) == value, text
    assert len(significant_digits(text)) == len(significant_digits(repr(value))), text
    assert len(text) <= len(repr(value)), text


def many_numbers(count: int) -> list[float]:
    """Returns positive doubles of all magnitudes, from random bits."""
    source = random.Random(20240229)
    numbers = []
    while len(numbers) < count:
        number = struct.unpack("<d", struct.pack("<Q", source.getrandbits(63)))[0]
        if math.isfinite(number):
            numbers.append(number)
    return numbers


def powers_of_two() -> list[float]:
    return [2.0**exponent for exponent in range(-1074, 1024)]


NUMBERS = {
    "powers of two": powers_of_two(),
    "just above powers of two": [math.nextafter(number, math.inf) for number in powers_of_two()],
    "just below powers of two": [math.nextafter(number, 0) for number in powers_of_two()],
    "powers of ten": [float(f"1e{exponent}") for exponent in range(-323, 309)],
    "nines": [float(f"9.99e{exponent}") for exponent in range(-323, 308)],
    "subnormals": [SMALLEST * n for n in (1, 2, 3, 5, 10, 99, 12345, 2**51 + 1, 2**52 - 1)],
    "round ones": [0.0, 1.0, 0.1, 0.5, 1.3, 10.0, 100.0, 123456.0, 0.001, 1e15, 1e16, 1e22, 1e23],
    "extremes": [1.7976931348623157e308, 2.2250738585072014e-308, 2.225073858507201e-308, SMALLEST],
    "random bits": many_numbers(4000),
    "few digits": [round(random.Random(1).uniform(0, 1000), n % 8) for n in range(1000)],
}


@pytest.mark.parametrize("kind", NUMBERS)
def test_numbers_read_back_and_are_short(kind):
    """The radii that eval prints are those that it was given: any doubles from 0 on."""
    numbers = NUMBERS[kind]
    rows = eval_rows(
        *["--sigma-a", "0", "--sigma-s", "1", "--wanted", "R"],
        *["--r", ",".join(map(repr, numbers))],
    )
    assert len(rows) == len(numbers)
    for row, number in zip(rows, numbers, strict=True):
        assert_shortest(row["r"], number)


def test_negative_numbers_and_infinity():
    rows = eval_rows("--sigma-a", "0", "--sigma-s", "1", "--g", "-0.75,-1e-7", "--r", "-0,inf")
    assert [row["g"] for row in rows] == ["-0.75", "-0.75", "-1e-7", "-1e-7"]
    assert [float(row["r"]) for row in rows] == [0, math.inf] * 2


@pytest.mark.parametrize("evaluator", ["f64", "f32"])
def test_results_of_points_are_short(evaluator):
    source = random.Random(7)
    lines = ["sigma_a,sigma_s,g,eta,r"]
    for _ in range(500):
        lines.append(f"{source.random()},{9 * source.random()},0,1.3,{20 * source.random()}")
    text = "\n".join(lines)
    for row in read_csv(points(text, "--evaluator", evaluator)):
        for column in ("R", "albedo", "cdf"):
            assert_shortest(row[column], float(row[column]))


@pytest.mark.parametrize(
    "written, read",
    [("1", 1), ("1.", 1), (".5", 0.5), ("+2", 2), ("1E3", 1000), ("1e+3", 1000), ("1e-400", 0)]
    + [("inf", math.inf), ("Infinity", math.inf), ("0.1000000000000000055511151231257827", 0.1)],
)
def test_notations_that_are_read(written, read):
    rows = eval_rows("--sigma-a", "0", "--sigma-s", "1", "--r", written)
    assert float(rows[0]["r"]) == read
