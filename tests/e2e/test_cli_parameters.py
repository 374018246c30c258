"""Parameters and notes on the command line, and `--model all` when some models refuse the query."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from command_line import BAD_ROWS, FAILED, USAGE, Proxy, dipole, eval_json, eval_rows, points
from command_line import read_csv
from dipole import Medium, wire
from frames import changed_choices
from lists import MODELS, NOTES, OTHER_PARAMETERS, PARAMETERS, covers, needs, some_value, takes

MEDIUM = ["--sigma-a", "0.032", "--sigma-s", "0.74"]  # SKIN
HEADER = "sigma_a,sigma_s,g,eta,r"
ROW = "0.032,0.74,0,1.3,1"


def options(parameters: dict[str, float]) -> list[str]:
    """Returns parameters as options of the command line."""
    words = [[f"--{name.replace('_', '-')}", repr(value)] for name, value in parameters.items()]
    return [word for pair in words for word in pair]


def some_parameters(model: str) -> dict[str, float]:
    """Returns parameters that a model takes, with values that fit together. The range of a fit is
    not among them, nor a tolerance that a fit with so many Gaussians does not meet."""
    apart = ("fit_", "tolerance") if "gaussians" in takes(model) else ()
    given = {name: some_value(name) for name in takes(model) if not name.startswith(apart)}
    return given | {"cos_in": 0.75} | needs(model)


# ---- eval ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["eval", "points"])
def test_every_parameter_is_an_option(command):
    text = dipole(command, "--help").stdout
    for name in PARAMETERS:
        assert f"\n  --{name.replace('_', '-')} " in text


@pytest.mark.parametrize("model", MODELS)
def test_parameters_reach_the_model(client, model):
    given = some_parameters(model)
    rows = eval_rows(
        *[*MEDIUM, "--model", model, "--r", "0.5,2", "--wanted", "R,S,2_pi_r_R,albedo"],
        *[*options(given), "--evaluator", "f64"],
    )
    answer = client.eval(
        model,
        Medium(0.032, 0.74),
        [0.5, 2.0],
        wanted=["R", "S", "2_pi_r_R", "albedo"],
        parameters=given,
    )
    for i, row in enumerate(rows):
        assert float(row["R"]) == answer.R[0, i]
        assert float(row["S"]) == answer.S[0, i]
        assert float(row["2_pi_r_R"]) == answer.two_pi_r_R[0, i]
        assert float(row["albedo"]) == answer.albedo[0]


def without_parameters(type: int, payload: bytes) -> list[bytes]:
    """Changes the reply to hello so that the daemon has no parameters: it turns them into
    statuses."""

    def change(choice):
        is_parameter = wire.KINDS[choice.kind] == "parameter"
        return choice._replace(kind=6, id=choice.id + 1000) if is_parameter else choice

    return changed_choices(type, payload, change)


def test_a_daemon_without_the_parameter(daemon):
    with Proxy(daemon().url(), lambda number, request_id: None, without_parameters) as proxy:
        run = dipole("eval", *MEDIUM, "--cos-in", "1", "--connect", proxy.url, status=USAGE)
    assert "--cos-in: this daemon does not know it" in run.stderr


# ---- notes and infinity --------------------------------------------------------------------------


def test_model_error_is_shown_where_it_is_a_number(client):
    """That of the albedo counts if it is wanted. Without a solution of transport there is none."""
    medium = ["--sigma-a", "0.03", "--sigma-s", "1", "--r", "1", "--model", "classical", "--wanted", "albedo"]
    (row,) = eval_rows(*medium)
    truth = client.eval("transport", (0.03, 1.0, 0.0, 1.3), [1.0], wanted="albedo").albedo[0]
    off = abs(float(row["albedo"]) / truth - 1)
    assert off - 2e-4 < float(row["model_error"]) < off * 1.01 + 2e-4
    (same,) = eval_json(*medium)["rows"]
    assert same["model_error"] == float(row["model_error"])


# ---- all models ----------------------------------------------------------------------------------


def test_models_that_refuse_are_left_out():
    run = dipole("eval", *MEDIUM, "--model", "all", "--r", "0,1", "--format", "csv", quiet=False)
    answered = {row["model"] for row in read_csv(run.stdout)}
    lines = run.stderr.splitlines()
    refusing = [model for model in MODELS if model not in answered]
    assert len(lines) == len(refusing) > 0
    for model, line in zip(refusing, lines):
        assert line.startswith(f"dipole eval: {model} is left out: bad-value: ")
        assert ": allowed: " in line and line.endswith(")") and " (--" in line
    for model in MODELS:
        assert (model in answered) == (not needs(model) and covers(model, 0.0))
        field = next(iter(needs(model)), "r")
        if model in refusing:
            assert f" {field}" in lines[refusing.index(model)]


def test_all_models_take_what_they_can():
    """Each model answers as if it alone had been asked, with the parameters that it takes."""
    given = {"cos_in": 0.5}
    for model in MODELS:
        given |= needs(model)
    assert len(given) > 1
    asked = [*MEDIUM, "--r", "1", "--wanted", "R,S,albedo"]
    rows = eval_rows(*asked, "--model", "all", *options(given))
    assert {row["model"] for row in rows} == set(MODELS) and len(rows) == len(MODELS)
    for row in rows:
        taken = {key: value for key, value in given.items() if key in takes(row["model"])}
        assert [row] == eval_rows(*asked, "--model", row["model"], *options(taken))


def test_other_refusals_end_it(daemon):
    """A refusal because of a daemon's limit ends the command: the model is not at fault."""
    small = daemon("--max-media", "1").url()
    run = dipole(
        *["eval", "--medium", "skin1", "--model", "all", "--r", "1", "--connect", small],
        status=FAILED,
    )
    assert len(run.stderr.splitlines()) == 1
    assert "too-large: medium_count" in run.stderr and "left out" not in run.stderr


def test_a_long_list_that_a_model_refuses_in_its_second_half(daemon):
    """The first half of a list has been answered when a model refuses the second half. No value of
    this model is shown."""
    small = daemon("--max-frame-bytes", "4096").url()
    radii = ",".join(str(1 + i / 500) for i in range(900)) + ",0"
    asked = [*MEDIUM, "--model", "all", "--r", radii, "--wanted", "R,cdf"]
    rows = eval_rows(*asked, "--connect", small, quiet=False)
    whole = eval_rows(*asked, quiet=False)
    # The largest error of a model is that of each part, which has its own comparison.
    rows, whole = (
        [{key: row[key] for key in row if not key.startswith("model_error")} for row in each]
        for each in (rows, whole)
    )
    same = rows == whole  # the difference of thousands of rows takes minutes to write
    assert same
    assert len({row["model"] for row in rows}) * 901 == len(rows)
    limited = {model for model in MODELS if not covers_or_needs(model)}
    assert limited and not limited & {row["model"] for row in rows}


def covers_or_needs(model: str) -> bool:
    return bool(needs(model)) or covers(model, 0.0)


# ---- points --------------------------------------------------------------------------------------


def test_columns_of_parameters(client):
    """Each row of a file has its own parameters. An empty cell means that the row does not have
    one."""
    lines = []
    names = [name for name in PARAMETERS if not name.startswith("fit_")]
    for model in MODELS:
        given = some_parameters(model)
        cells = [repr(given[name]) if name in given else "" for name in names]
        lines.append(",".join([model, ROW, *cells]))
    text = "\n".join([",".join(["model", HEADER, *names]), *lines])
    rows = read_csv(points(text, "--evaluator", "f64"))
    assert [row["status"] for row in rows] == ["ok"] * len(MODELS)
    for row in rows:
        given = {name: float(row[name]) for name in names if row[name]}
        answer = client.eval(row["model"], Medium(0.032, 0.74), [1.0], parameters=given)
        found = [float(row["R"]), float(row["cdf"])]
        assert found == pytest.approx([answer.R[0, 0], answer.cdf[0, 0]], rel=3e-14)
