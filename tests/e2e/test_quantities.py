"""What can be had of a profile beside R agrees with R: its slope, its logarithm, its density."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from command_line import dipole
from dipole import Medium

MEDIA = [Medium(0.032, 0.74), Medium(0.48, 1.01, 0.3, 1.5), Medium(0.0, 2.5, 0.0, 1.0)]
WANTED = ("R", "albedo", "cdf", "dR_dr", "ln_R", "pdf")
RADII = np.geomspace(1e-3, 30.0, 60)


@pytest.mark.parametrize("model", ["classical", "better"])
def test_slope_is_the_difference_quotient(client, model):
    step = 1e-5
    around = client.eval(model, MEDIA, np.concatenate([RADII * (1 - step), RADII * (1 + step)]))
    low, high = around.R[:, : len(RADII)], around.R[:, len(RADII) :]
    quotient = (high - low) / (2 * step * RADII)
    answer = client.eval(model, MEDIA, RADII, wanted=WANTED)
    assert np.all(answer.dR_dr <= 0)
    # Differences lose digits in proportion to R over the step.
    lost = 4e-16 * answer.R / (step * RADII)
    assert np.all(np.abs(answer.dR_dr - quotient) <= 1e-7 * np.abs(quotient) + lost)


@pytest.mark.parametrize("evaluator, epsilon", [("f64", 2.0**-52), ("f32", 2.0**-23)])
def test_logarithm_and_density_follow_R(client, evaluator, epsilon):
    answer = client.eval("better", MEDIA, RADII, evaluator=evaluator, wanted=WANTED)
    R, r = answer.R.astype(np.float64), answer.r.astype(np.float64)
    bound = answer.numerical_error()
    log_bound = 2 * bound + 8 * epsilon * np.abs(answer.ln_R)
    assert np.all(np.abs(answer.ln_R - np.log(R)) <= log_bound)
    density = 2 * np.pi * r * R / answer.albedo[:, np.newaxis]
    assert np.all(np.abs(answer.pdf - density) <= 2.1 * bound * density)


def test_density_integrates_to_the_cdf(client):
    r = np.linspace(0.0, 8.0, 4001)
    answer = client.eval("better", MEDIA, r, wanted=("pdf", "cdf"))
    simpson = (r[1] / 3) * (answer.pdf[:, :-2:2] + 4 * answer.pdf[:, 1:-1:2] + answer.pdf[:, 2::2])
    integral = np.cumsum(simpson, axis=1)
    assert np.max(np.abs(integral - answer.cdf[:, 2::2])) < 1e-8


def test_logarithm_goes_on_where_R_has_underflowed(client):
    r = np.array([1e3, 1e4, 1e5, np.inf])
    answer = client.eval("better", Medium(0.1, 1.0), r, wanted=WANTED)
    assert np.all(answer.R[0, 1:] == 0) and np.all(answer.dR_dr[0, 1:] == 0)
    assert np.all(np.diff(answer.ln_R[0]) < 0)
    assert np.isfinite(answer.ln_R[0, :3]).all() and answer.ln_R[0, 3] == -np.inf
    # Far out ln R falls by mu_tr for each mm: here sqrt(0.1 * 3 * 1.1^2 / (2 * 0.1 + 1)).
    mu_tr = np.sqrt(0.1 * 3 * 1.1**2 / 1.2)
    slope = (answer.ln_R[0, 2] - answer.ln_R[0, 1]) / (r[2] - r[1])
    assert slope == pytest.approx(-mu_tr, rel=1e-3)


def test_without_scattering(client):
    answer = client.eval("better", Medium(0.5, 0.0), [0.0, 1.0, np.inf], wanted=WANTED)
    for values in (answer.R, answer.cdf, answer.dR_dr, answer.pdf):
        assert np.all(values == 0)
    assert np.all(answer.ln_R == -np.inf)


def test_the_command_line_appends_columns(client):
    arguments = ["--sigma-a", "0.1", "--sigma-s", "1", "--r", "0.5,2", "--format", "csv"]
    out = dipole("eval", *arguments, "--want", "pdf,R,ln_R").stdout
    rows = list(csv.DictReader(io.StringIO(out)))
    assert list(rows[0])[-3:] == ["model_error", "ln_R", "pdf"]
    answer = client.eval("better", Medium(0.1, 1.0), [0.5, 2.0], wanted=WANTED)
    for name in ("R", "ln_R", "pdf"):
        assert [float(row[name]) for row in rows] == list(getattr(answer, name)[0])
    assert all(row["cdf"] == "" for row in rows)
