"""What can be had of a profile beside R agrees with R: its slope, its logarithm, its density."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from command_line import Proxy, dipole, eval_json, eval_rows
from dipole import Medium, wire
from frames import HELLO

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
    assert list(rows[0])[-4:] == ["model_error", "notes", "ln_R", "pdf"]
    answer = client.eval("better", Medium(0.1, 1.0), [0.5, 2.0], wanted=WANTED)
    for name in ("R", "ln_R", "pdf"):
        assert [float(row[name]) for row in rows] == list(getattr(answer, name)[0])
    assert all(row["cdf"] == "" for row in rows)


@pytest.mark.parametrize("evaluator", ["f64", "f32"])
def test_every_format_of_the_command_line_has_them(client, evaluator):
    arguments = ["--sigma-a", "0.1", "--sigma-s", "1", "--r", "0.5,2", "--evaluator", evaluator]
    arguments += ["--want", "dR_dr,ln_R,pdf"]
    answer = client.eval("better", Medium(0.1, 1.0), [0.5, 2.0], evaluator=evaluator, wanted=WANTED)
    report = eval_json(*arguments)
    channel = report["models"][0]["channels"][0]
    rows = eval_rows(*arguments)
    text = dipole("eval", *arguments).stdout.split("\n\n")[1].splitlines()
    assert text[1].split() == ["r", "dR_dr", "1", "ln_R", "1", "pdf", "1"]
    assert text[2].split() == ["mm", "1/mm^3", "ln(1/mm^2)", "1/mm"]
    table = np.array([line.split()[1:] for line in text[4:]], dtype=float)
    for column, (name, unit) in enumerate(zip(["dR_dr", "ln_R", "pdf"], text[2].split()[1:])):
        expected = [float(value) for value in getattr(answer, name)[0]]
        assert report["units"][name] == unit
        assert channel[name] == expected
        assert [float(row[name]) for row in rows] == expected
        assert table[:, column] == pytest.approx(expected, rel=1e-4)


def sums_for_quantities(type: int, payload: bytes) -> bytes:
    """A hello whose quantity pdf is said to be the bits of R and cdf."""
    if type != HELLO | wire.REPLY:
        return payload
    data = bytearray(payload)
    for i in range(wire.HELLO_REPLY.unpack(payload).choice_count):
        at = wire.HELLO_REPLY.bytes + i * wire.CHOICE.bytes
        choice = wire.CHOICE.unpack(payload, at)
        if wire.KINDS[choice.kind] == "quantity" and choice.name == "pdf":
            changed = choice._replace(id=wire.QUANTITY_R | wire.QUANTITY_CDF)
            data[at : at + wire.CHOICE.bytes] = wire.CHOICE.pack(**changed._asdict())
    assert data != payload
    return bytes(data)


@pytest.mark.parametrize("want", ["R", "pdf"])
def test_a_daemon_whose_quantities_are_not_bits(daemon, want):
    """It had the command line look for an array that no answer holds."""
    arguments = ["--sigma-a", "0.1", "--sigma-s", "1", "--r", "0.5,2"]
    with Proxy(daemon().url(), lambda number, request_id: None, sums_for_quantities) as proxy:
        rows = eval_rows(*arguments, "--want", want, "--connect", proxy.url)
    expected = eval_rows(*arguments, "--want", "R" if want == "R" else "R,cdf")
    assert rows == expected
