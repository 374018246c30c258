"""`dipole sample`: the daemon's radii in every format, and wrong command lines."""

from __future__ import annotations


import numpy as np
from command_line import dipole, read_csv
from dipole import Draw
from frames import SKIN

MEDIUM = ["--sigma-a", "0.032", "--sigma-s", "0.74"]  # skin1, red


def rows(*arguments: str) -> list[dict[str, str]]:
    """Returns the rows of `dipole sample --format csv`."""
    return read_csv(dipole("sample", "--format", "csv", *arguments).stdout)


def column(table: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name]) for row in table])


def test_many_random_numbers_come_in_pieces(client):
    table = rows(*MEDIUM, "--count", "131073", "--seed", "3", "--first", "5", "--wanted", "r")
    expected = client.sample("better", SKIN, draw=Draw(131073, "random", seed=3, first=5))
    np.testing.assert_array_equal(column(table, "u"), expected.u)
    np.testing.assert_array_equal(column(table, "r"), expected.r[0])
