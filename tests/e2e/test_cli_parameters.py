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


def test_a_fit_model_by_name_and_by_id():
    model = next(model for model in MODELS if "fit_model" in takes(model))
    asked = [*MEDIUM, "--model", model, "--r", "1", "--fit-model"]
    by_name = eval_rows(*asked, "classical")
    assert by_name == eval_rows(*asked, str(MODELS["classical"]))
    assert by_name != eval_rows(*asked, "better")
    run = dipole("eval", *asked, "best", status=USAGE)
    assert "--fit-model: there is no such model; this daemon has classical, better" in run.stderr


@pytest.mark.parametrize(
    "arguments, status, said",
    [
        (["--cos-in", "x"], USAGE, "--cos-in: 'x' is no number"),
        (["--cos-in", "1.5"], FAILED, "bad-value: cos_in: allowed: 0 to 1 (--cos-in)"),
        (["--cos-out", "nan"], FAILED, "bad-value: cos_out: allowed: a number"),
        (["--thickness", "3"], FAILED, "bad-value: thickness: allowed: nothing"),
        (["--tolerance", "2"], FAILED, "(--tolerance)"),
    ],
)
def test_wrong_parameters(arguments, status, said):
    run = dipole("eval", *MEDIUM, "--r", "1", *arguments, status=status)
    assert said in run.stderr and run.stdout == ""


def test_parameters_are_repeated_in_the_answer():
    asked = [*MEDIUM, "--r", "1", "--wanted", "S", "--cos-in", "0.8", "--cos-out", "0.25"]
    assert eval_json(*asked)["parameters"] == {"cos_in": 0.8, "cos_out": 0.25}
    assert "cos_in 0.8, cos_out 0.25\n" in dipole("eval", *asked).stdout
    assert eval_json(*MEDIUM, "--r", "1")["parameters"] == {}
    assert eval_json(*asked)["units"]["S"] == "1/(mm^2 sr)"


def without_parameters(type: int, payload: bytes) -> bytes:
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


def test_notes_in_every_format():
    asked = [*MEDIUM, "--g", "0,0.5", "--r", "1", "--model", "better"]
    isotropic = [*MEDIUM, "--r", "1"]
    assert {row["notes"] for row in eval_rows(*asked)} == {"similarity"}
    assert {row["notes"] for row in eval_rows(*isotropic)} == {""}
    assert eval_json(*asked)["models"][0]["notes"] == ["similarity"]
    assert eval_json(*isotropic)["models"][0]["notes"] == []
    about = {one["name"]: one["about"] for one in info()["notes"]}
    assert dipole("eval", *asked).stdout.endswith(f"\nnote: similarity: {about['similarity']}\n")
    assert "note:" not in dipole("eval", *isotropic).stdout


def test_a_note_names_the_models_that_it_is_about():
    unlike = next(
        row["model"]
        for row in eval_rows(*MEDIUM, "--g", "0.5", "--r", "1", "--model", "all", quiet=False)
        if "similarity" not in row["notes"]
    )
    asked = ["eval", *MEDIUM, "--g", "0.5", "--r", "1", "--model"]
    lines = dipole(*asked, f"{unlike},better").stdout.splitlines()
    assert [line for line in lines if "similarity" in line][0].endswith(" (better)")
    lines = dipole(*asked, f"{unlike},better,classical").stdout.splitlines()
    assert [line for line in lines if "similarity" in line][0].endswith(f" (all but {unlike})")


def test_model_error_is_shown_where_it_is_a_number(client):
    """That of the albedo counts if it is wanted. Without a solution of transport there is none."""
    medium = ["--sigma-a", "0.03", "--sigma-s", "1", "--r", "1", "--model", "classical", "--wanted", "albedo"]
    (row,) = eval_rows(*medium)
    truth = client.eval("transport", (0.03, 1.0, 0.0, 1.3), [1.0], wanted="albedo").albedo[0]
    off = abs(float(row["albedo"]) / truth - 1)
    assert off - 2e-4 < float(row["model_error"]) < off * 1.01 + 2e-4
    channel = eval_json(*medium)["models"][0]["channels"][0]
    assert channel["model_error"] == float(row["model_error"])
    text = dipole("eval", *medium).stdout
    line = next(line for line in text.splitlines() if line.startswith("classical "))
    assert float(line.split()[-1]) == pytest.approx(channel["model_error"], rel=0.1)
    assert eval_rows(*medium, "--eta", "5")[0]["model_error"] == ""
    assert "not solved" in dipole("eval", *medium, "--eta", "5").stdout


def test_transport_diverges_at_0():
    medium = ["--sigma-a", "0.03", "--sigma-s", "1", "--model", "better", "--wanted", "R"]
    text = dipole("eval", *medium, "--r", "0,1").stdout
    assert "at r > 0: transport diverges at r = 0" in text
    both, only = (eval_rows(*medium, "--r", r)[0]["model_error"] for r in ("0,1", "1"))
    assert both == only != ""
    assert "diverges" in dipole("eval", *medium, "--r", "0").stdout
    assert "diverges" not in dipole("eval", *medium, "--r", "1").stdout


def infinite_at_0(client) -> str:
    """Returns the name of a model whose R at r = 0 is infinite."""
    for model in MODELS:
        if not needs(model) and covers(model, 0.0):
            if np.isinf(client.eval(model, Medium(0.032, 0.74), [0.0]).R[0, 0]):
                return model
    raise AssertionError("no model is infinite at r = 0")


def test_infinity_in_every_format(client):
    model = infinite_at_0(client)
    asked = [*MEDIUM, "--model", model, "--r", "0,1", "--wanted", "R,2_pi_r_R"]
    row = eval_rows(*asked)[0]
    assert row["R"] == "inf" and math.isfinite(float(row["2_pi_r_R"]))
    channel = eval_json(*asked)["models"][0]["channels"][0]
    assert channel["R"][0] == "inf" and isinstance(channel["R"][1], float)
    text = dipole("eval", *asked).stdout
    assert text.split("\n\n")[1].splitlines()[4].split()[:2] == ["0", "inf"]
    line = points(f"model,{HEADER}\n{model},0.032,0.74,0,1.3,0\n").splitlines()[1]
    assert line.split(",")[6] == "inf" and line.endswith(",ok")


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


def test_a_model_that_is_named_is_not_left_out():
    needy = next(model for model in MODELS if needs(model))
    asked = ["eval", *MEDIUM, "--r", "1", "--model"]
    for names in (f"all,{needy}", f"{needy},all", f"better,{needy}"):
        run = dipole(*asked, names, status=FAILED)
        assert run.stdout == "" and "left out" not in run.stderr
        assert ": allowed: " in run.stderr and f"(--{next(iter(needs(needy)))})" in run.stderr
    # A model that is named gets all given parameters, whether it takes them or not.
    run = dipole(*asked, "all,better", *options(needs(needy)), status=FAILED)
    assert "allowed: nothing" in run.stderr


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["--cos-in", "2"], "bad-value: cos_in: allowed: 0 to 1 (--cos-in)"),
        (["--r", "-1", "--thickness", "3"], "bad-value: r: allowed: "),
        (["--eta", "0"], "bad-value: eta: allowed: "),
    ],
)
def test_what_all_models_refuse_is_said_once(arguments, said):
    run = dipole("eval", *MEDIUM, "--model", "all", *arguments, status=FAILED)
    assert run.stdout == "" and "left out" not in run.stderr
    assert len(run.stderr.splitlines()) == 1 and said in run.stderr


def test_a_value_out_of_range_is_not_dropped():
    """If the value of a parameter is out of range, a model that takes it refuses; the parameter is
    not dropped."""
    needy = next(model for model in MODELS if needs(model))
    name = next(iter(needs(needy)))
    wrong = options({name: -1.0})
    run = dipole(
        *["eval", *MEDIUM, "--r", "1", "--model", "all", *wrong, "--format", "csv"], quiet=False
    )
    lines = [line for line in run.stderr.splitlines() if f" {needy} is left out" in line]
    least, most = PARAMETERS[name].least, PARAMETERS[name].most
    words = lines[0].split("allowed: ")[1].split()
    assert [float(words[0]), float(words[2])] == [least, most]
    assert "better" in {row["model"] for row in read_csv(run.stdout)}


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
    for row in (*whole, *rows):
        row.pop("model_error")  # the largest of each part, which has its own comparison
    assert rows == whole
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


def test_an_option_holds_where_the_cell_is_empty():
    needy = next(model for model in MODELS if needs(model))
    name, value = next(iter(needs(needy).items()))
    text = f"model,{HEADER},{name}\n{needy},{ROW},\n{needy},{ROW},{value * 2}\n"
    usual, doubled = read_csv(points(text, *options({name: value})))
    assert usual["status"] == doubled["status"] == "ok" and usual["R"] != doubled["R"]
    assert usual["R"] == read_csv(points(f"model,{HEADER},{name}\n{needy},{ROW},{value}\n"))[0]["R"]
    without = read_csv(points(text, status=BAD_ROWS))
    assert f"bad-value: {name}: allowed: " in without[0]["status"]
    assert without[1] == doubled


@pytest.mark.parametrize(
    "column, cell, said",
    [
        ("cos_in", "2", "bad-value: cos_in: allowed: 0 to 1"),
        ("cos_in", "x", "cos_in: 'x' is no value: allowed: "),
        ("cos_in", "nan", "bad-value: cos_in: allowed: a number"),
        ("thickness", "1", "bad-value: thickness: allowed: nothing"),
        ("fit_model", "best", "fit_model: 'best' is no value: allowed: "),
        ("fit_model", "better", "bad-value: fit_model: allowed: nothing"),
    ],
)
def test_a_wrong_cell_is_the_rows_own_fault(column, cell, said):
    text = f"{HEADER},{column}\n{ROW},\n{ROW},{cell}\n{ROW},\n"
    rows = read_csv(points(text, status=BAD_ROWS))
    assert [row["status"] == "ok" for row in rows] == [True, False, True]
    assert said in rows[1]["status"] and rows[1][column] == cell


def test_a_column_of_models_to_fit():
    model = next(model for model in MODELS if "fit_model" in takes(model))
    head = f"model,{HEADER},fit_model"
    text = f"{head}\n{model},{ROW},classical\n{model},{ROW},{MODELS['classical']}\n{model},{ROW},\n"
    rows = read_csv(points(text))
    assert rows[0]["R"] == rows[1]["R"] != rows[2]["R"]
    assert rows[2]["R"] == read_csv(points(text, "--fit-model", "better"))[2]["R"]


def test_a_parameter_that_stands_twice():
    run = dipole("points", stdin=f"{HEADER},cos_in,cos_in\n{ROW},1,1\n", status=FAILED)
    assert "the header has the column cos_in twice" in run.stderr


# ---- info ----------------------------------------------------------------------------------------


def info() -> dict:
    return json.loads(dipole("info", "--format", "json").stdout)


def test_info_lists_parameters_and_notes():
    report = info()
    listed = {one["name"]: one["id"] for one in report["parameters"]}
    assert listed == {name: one.id for name, one in {**PARAMETERS, **OTHER_PARAMETERS}.items()}
    assert {one["name"]: one["id"] for one in report["notes"]} == NOTES
    table = dipole("info").stdout
    assert "\nparameters\n" in table and "\nnotes\n" in table
    for one in [*report["parameters"], *report["notes"]]:
        assert one["about"] in table
    rows = read_csv(dipole("info", "--format", "csv").stdout)
    for section in ("parameters", "notes"):
        expected = {one["name"]: one["about"] for one in report[section]}
        assert {row["name"]: row["value"] for row in rows if row["section"] == section} == expected
