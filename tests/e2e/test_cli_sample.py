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
    assert list(table[0]) == [
        *["model", "channel", "sigma_a", "sigma_s", "g", "eta", "u", "cdf", "r", "pdf", "albedo"]
    ]
    for name, known in {"u": expected.u, **{n: expected.values[n][0] for n in wanted[:3]}}.items():
        np.testing.assert_array_equal(column(table, name).astype(known.dtype), known)
    assert set(column(table, "albedo")) == {expected.albedo[0]}


def test_many_random_numbers_come_in_pieces(client):
    table = rows(*MEDIUM, "--count", "131073", "--seed", "3", "--first", "5", "--wanted", "r")
    expected = client.sample("better", SKIN, draw=Draw(131073, "random", seed=3, first=5))
    np.testing.assert_array_equal(column(table, "u"), expected.u)
    np.testing.assert_array_equal(column(table, "r"), expected.r[0])


@pytest.mark.parametrize("command", ["sample", "eval"])
def test_transport_by_table_whether_it_is_named_or_not(command):
    """No help text says one thing while the command does another."""

    def ask(*options):
        run = dipole(command, *MEDIUM, "--format", "json", *options, usual=True)
        return json.loads(run.stdout)

    named = ask("--model", "transport")
    assert ask() == named and named["evaluator"] == "lut"
    assert ask("--model", "transport", "--tolerance", "1e-7")["evaluator"] == "f64"
    assert ask("--model", "better")["evaluator"] == "f64"
    assert "(default: f64; lut for transport)" in dipole(command, "--help").stdout
    if command == "eval":
        both = ask("--model", "transport,better")
        assert [model["evaluator"] for model in both["models"]] == ["lut", "f64"]
        text = dipole("eval", *MEDIUM, "--model", "transport,better").stdout
        assert "; evaluator f64, lut for transport, moments exact" in text


def test_listed_numbers(client):
    table = rows("--medium", "skin1", "--u", "0,0.25,0.5,1")
    expected = client.sample("better", client.media()["skin1"], [0, 0.25, 0.5, 1])
    assert [row["channel"] for row in table] == ["red"] * 4 + ["green"] * 4 + ["blue"] * 4
    np.testing.assert_array_equal(column(table, "r"), expected.r.reshape(-1))
    np.testing.assert_array_equal(column(table, "pdf"), expected.pdf.reshape(-1))
    assert table[3]["r"] == "inf"


def test_json_and_table_say_the_same():
    arguments = ["sample", "--medium", "skin1", "--count", "5", "--draw", "stratified"]
    whole = json.loads(dipole(*arguments, "--format", "json").stdout)
    text = dipole(*arguments).stdout
    assert (whole["draw"], whole["seed"], whole["model"]) == ("stratified", 1, "better")
    assert whole["units"]["r"] == "mm" and whole["units"]["pdf"] == "1/mm"
    assert len(whole["u"]) == 5 and len(whole["channels"]) == 3
    for channel in whole["channels"]:
        assert f"r {channel['channel']}" in text
        for r in channel["r"]:
            assert f"{r:.6g}" in text
    assert "numbers: stratified, seed 1" in text


def test_defaults():
    assert dipole("sample", *MEDIUM).stdout == dipole(
        "sample", *MEDIUM, "--count", "10", "--draw", "random", "--seed", "1", "--wanted", "r,pdf"
    ).stdout


test_wrong_command_lines_say_what_to_do = says(USAGE, ["sample"], [
    ([], "give --medium NAME, or --sigma-a and --sigma-s"),
    ([*MEDIUM, "--u", "0.5", "--count", "3"], "--u gives the numbers one by one: leave"),
    ([*MEDIUM, "--u", "0.5", "--seed", "3"], "--u gives the numbers one by one: leave"),
    ([*MEDIUM, "--u", "half"], "--u: 'half' is no number"),
    ([*MEDIUM, "--count", "-1"], "--count: '-1' is no whole number"),
    ([*MEDIUM, "--seed", "x"], "--seed: 'x' is no whole number"),
    ([*MEDIUM, "--draw", "lots"], "--draw: 'lots' is unknown; this daemon has list, regular"),
    ([*MEDIUM, "--draw", "list"], "--draw list: give the numbers with --u"),
    ([*MEDIUM, "--model", "best"], "--model: 'best' is unknown; this daemon has classical"),
    ([*MEDIUM, "--wanted", "colour"], "--wanted: 'colour' is unknown; this daemon has R"),
    ([*MEDIUM, "--evaluator", "f16"], "--evaluator: 'f16' is unknown; this daemon has f64"),
    ([*MEDIUM, "--moments", "fat"], "--moments: 'fat' is unknown; this daemon has exact"),
    ([*MEDIUM, "--format", "xml"], "--format xml: it is one of table,csv,json"),
    ([*MEDIUM, "--deadline-ms", "4294967296"], "--deadline-ms: give at most 4294967295"),
    ([*MEDIUM, "skin1"], "'skin1' is one argument too many"),
])


test_what_the_daemon_refuses = says(FAILED, ["sample"], [
    ([*MEDIUM, "--u", "0.5,1.5"], "bad-value: u number 2 of 2: allowed: 0 to 1"),
    ([*MEDIUM, "--count", "0"], "sample_count: allowed: 1 to 2^52 (--count)"),
    ([*MEDIUM, "--draw", "regular", "--seed", "3"], "seed: allowed: 0 unless the draw is random or"),
    ([*MEDIUM, "--draw", "regular", "--first", "3"], "0 unless the draw is random (--first)"),
    ([*MEDIUM, "--g", "1"], "bad-value: g: allowed: "),
    ([*MEDIUM, "--model", "gaussians"], "model: allowed: a model that covers all radii"),
    (["--sigma-a", "0,-1", "--sigma-s", "1"], "sigma_a of medium 2 of 2: allowed: "),
])


def test_too_late():
    arguments = ["--count", "5000000", "--model", "beam+single", "--deadline-ms", "30"]
    run = dipole("sample", *MEDIUM, *arguments, status=FAILED)
    assert "deadline_ms: allowed: more" in run.stderr and run.stdout == ""
