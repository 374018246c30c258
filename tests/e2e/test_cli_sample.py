"""`dipole sample`: the daemon's radii in every format, and wrong command lines."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import FAILED, USAGE, dipole, read_csv, says
from dipole import Draw
from frames import SKIN

MEDIUM = ["--sigma-a", "0.032", "--sigma-s", "0.74"]  # skin1, red


def rows(*arguments: str) -> list[dict[str, str]]:
    """Returns the rows of `dipole sample --format csv`."""
    return read_csv(dipole("sample", "--format", "csv", *arguments).stdout)


def column(table: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name]) for row in table])


@pytest.mark.parametrize("evaluator", ["f64", "f32", "lut"])
@pytest.mark.parametrize("rule", ["random", "stratified", "regular"])
def test_the_daemons_radii(client, rule, evaluator):
    how = ["--draw", rule, "--count", "50", "--evaluator", evaluator]
    how += [] if rule == "regular" else ["--seed", "18446744073709551615"]
    how += ["--first", "7"] if rule == "random" else []
    table = rows(*MEDIUM, *how, "--wanted", "pdf,r,cdf,albedo", "--model", "classical")
    draw = Draw(50, rule, seed=2**64 - 1, first=7 if rule == "random" else 0)
    wanted = ["r", "pdf", "cdf", "albedo"]
    expected = client.sample("classical", SKIN, draw=draw, evaluator=evaluator, wanted=wanted)
    for name, known in {"u": expected.u, **{n: expected.values[n][0] for n in wanted[:3]}}.items():
        np.testing.assert_array_equal(column(table, name).astype(known.dtype), known)
    assert set(column(table, "albedo")) == {expected.albedo[0]}


def test_many_random_numbers_come_in_pieces(client):
    table = rows(*MEDIUM, "--count", "131073", "--seed", "3", "--first", "5", "--wanted", "r")
    expected = client.sample("better", SKIN, draw=Draw(131073, "random", seed=3, first=5))
    np.testing.assert_array_equal(column(table, "u"), expected.u)
    np.testing.assert_array_equal(column(table, "r"), expected.r[0])


def test_too_late():
    arguments = ["--count", "5000000", "--model", "beam+single", "--deadline-ms", "30"]
    run = dipole("sample", *MEDIUM, *arguments, status=FAILED)
    assert "deadline_ms: allowed: more" in run.stderr and run.stdout == ""
