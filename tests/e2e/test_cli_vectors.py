"""`dipole points` on 3,000 rows for the dipoles whose true values are known."""

from __future__ import annotations

import csv
import math

import pytest
from command_line import dipole, read_csv
from daemons import REPOSITORY

VECTORS = REPOSITORY.parent / "shared" / "vectors" / "dipole.csv"

EPSILON = 2.0**-52
SMALLEST_NORMAL = 2.0**-1022


def mu_tr_per_mm(row: dict[str, str]) -> float:
    """Returns the effective transport coefficient: sqrt(sigma_a / D) with the model's D."""
    sigma_a, sigma_s, g = (float(row[name]) for name in ("sigma_a", "sigma_s", "g"))
    scattering = sigma_s * (1 - g)
    total = sigma_a + scattering
    if row["model"] == "classical":
        return math.sqrt(3 * sigma_a * total)
    return total * math.sqrt(3 * sigma_a / (2 * sigma_a + scattering))


def bound(row: dict[str, str], column: str) -> float:
    """Returns the bound of the relative error: 64 epsilon (1 + mu_tr d_r), where d_r is z_r for the
    albedo."""
    z_r = 1 / (float(row["sigma_a"]) + float(row["sigma_s"]) * (1 - float(row["g"])))
    d_r = z_r if column == "albedo" else math.hypot(float(row["r"]), z_r)
    return 64 * EPSILON * (1 + mu_tr_per_mm(row) * d_r)


def test_every_value_is_within_its_bound():
    if not VECTORS.exists():
        pytest.skip("../shared/vectors/dipole.csv is not there: nothing was compared with it")
    with VECTORS.open(newline="") as file:
        truth = list(csv.DictReader(file))
    rows = read_csv(dipole("points", str(VECTORS)).stdout)
    assert len(rows) == len(truth) == 3000
    for row, true_row in zip(rows, truth, strict=True):
        assert row["status"] == "ok"
        for column in ("R", "albedo", "cdf"):
            value, true_value = float(row[column]), float(true_row[column])
            if true_value == 0:  # 0 stands for a value below the smallest double.
                assert 0 <= value < SMALLEST_NORMAL, (column, true_row)
            else:
                error = abs(value - true_value) / true_value
                assert error <= bound(true_row, column), (column, value, true_row)
