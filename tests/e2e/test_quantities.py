"""The quantities of a profile besides R, from the daemon and on the command line.
tests/accuracy/test_distributions.c tests that they agree with R."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from command_line import Proxy, dipole, eval_json, eval_rows
from dipole import Medium, wire
from frames import changed_choices

WANTED = ("R", "albedo", "cdf", "dR_dr", "ln_R", "pdf")


def test_logarithm_goes_on_where_R_has_underflowed(client):
    r = np.array([1e3, 1e4, 1e5, np.inf])
    answer = client.eval("better", Medium(0.1, 1.0), r, wanted=WANTED)
    assert np.all(answer.R[0, 1:] == 0) and np.all(answer.dR_dr[0, 1:] == 0)
    assert np.all(np.diff(answer.ln_R[0]) < 0)
    assert np.isfinite(answer.ln_R[0, :3]).all() and answer.ln_R[0, 3] == -np.inf
    # Far away, ln R falls by mu_tr for each mm, here sqrt(0.1 * 3 * 1.1^2 / (2 * 0.1 + 1)).
    mu_tr = np.sqrt(0.1 * 3 * 1.1**2 / 1.2)
    slope = (answer.ln_R[0, 2] - answer.ln_R[0, 1]) / (r[2] - r[1])
    assert slope == pytest.approx(-mu_tr, rel=1e-3)


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
        expected = getattr(answer, name)[0]
        assert report["units"][name] == unit
        # As many digits as the precision needs.
        assert np.array(channel[name], expected.dtype).tolist() == expected.tolist()
        assert np.array([row[name] for row in rows], expected.dtype).tolist() == expected.tolist()
        assert table[:, column] == pytest.approx(expected, rel=1e-4)


def sums_for_quantities(type: int, payload: bytes) -> bytes:
    """Changes a reply to hello: the id of the quantity pdf becomes the sum of the bits of R and
    cdf."""

    def change(choice):
        is_pdf = wire.KINDS[choice.kind] == "quantity" and choice.name == "pdf"
        return choice._replace(id=wire.QUANTITY_R | wire.QUANTITY_CDF) if is_pdf else choice

    return changed_choices(type, payload, change)


@pytest.mark.parametrize("want", ["R", "pdf"])
def test_a_daemon_whose_quantities_are_not_bits(daemon, want):
    """The command must not look for an array that the answer lacks."""
    arguments = ["--sigma-a", "0.1", "--sigma-s", "1", "--r", "0.5,2"]
    with Proxy(daemon().url(), lambda number, request_id: None, sums_for_quantities) as proxy:
        rows = eval_rows(*arguments, "--want", want, "--connect", proxy.url)
    expected = eval_rows(*arguments, "--want", "R" if want == "R" else "R,cdf")
    assert rows == expected
