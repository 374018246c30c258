"""`dipole invert`: media with given albedos in every format, and albedos that no medium has."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import BAD_ROWS, FAILED, OK, USAGE, dipole, read_csv, says

GIVEN = ["mean-free-path", "diffuse-mean-free-path", "classical-diffuse-path"]


def rows(*arguments: str, status: int = OK) -> list[dict[str, str]]:
    """Returns the rows of `dipole invert --format csv`."""
    return read_csv(dipole("invert", "--format", "csv", *arguments, status=status).stdout)


@pytest.mark.parametrize("given", GIVEN)
def test_the_daemons_media(client, given):
    how = ["--albedo", "0.1,0.5,0.9", f"--{given}", "1,2,0.5", "--g", "0.8", "--eta", "1.4"]
    table = rows(*how, "--model", "classical")
    expected = client.invert(
        "classical", [0.1, 0.5, 0.9], [1, 2, 0.5], given=given, g=0.8, eta=1.4
    )
    for name in ("sigma_a", "sigma_s", "albedo"):
        values = [float(row[name]) for row in table]
        np.testing.assert_array_equal(values, getattr(expected, name))
    assert [row["status"] for row in table] == ["ok"] * 3
    assert {(row["given"], row["g"], row["eta"]) for row in table} == {(given, "0.8", "1.4")}
    assert [row["channel"] for row in table] == ["1", "2", "3"]
    assert [row["wanted_albedo"] for row in table] == ["0.1", "0.5", "0.9"]


def test_one_value_holds_for_all_channels():
    one = rows("--albedo", "0.3,0.6", "--mean-free-path", "2")
    each = rows("--albedo", "0.3,0.6", "--mean-free-path", "2,2")
    assert one == each and len(one) == 2
    assert len(rows("--albedo", "0.3", "--mean-free-path", "2,3")) == 2


def test_json_and_table_say_the_same():
    arguments = ["invert", "--albedo", "0.25,0.75", "--mean-free-path", "1.5"]
    whole = json.loads(dipole(*arguments, "--format", "json").stdout)
    text = dipole(*arguments).stdout
    assert (whole["model"], whole["given"]) == ("better", "mean-free-path")
    assert whole["units"]["sigma_a"] == "1/mm" and whole["albedo_most"] == 1
    for channel, albedo in zip(whole["channels"], [0.25, 0.75], strict=True):
        assert channel["wanted_albedo"] == albedo and channel["status"] == "ok"
        assert abs(channel["albedo"] / albedo - 1) <= 1e-12
        assert f"{channel['sigma_a']:.9g}" in text and f"{channel['sigma_s']:.9g}" in text
    assert "check: an evaluation of the medium" in text
    assert "albedos within reach: " in text


def test_the_check_is_an_evaluation():
    for row in rows("--albedo", "0.2,0.8", "--mean-free-path", "1", "--g", "0.5"):
        given = ["--sigma-a", row["sigma_a"], "--sigma-s", row["sigma_s"], "--g", row["g"]]
        judged = dipole("eval", *given, "--wanted", "albedo", "--format", "csv")
        assert read_csv(judged.stdout)[0]["albedo"] == row["albedo"]


@pytest.mark.parametrize("format", ["table", "csv", "json"])
def test_some_there_are_not(format):
    how = ["--albedo", "0.05,0.5", "--mean-free-path", "1", "--model", "single"]
    run = dipole("invert", *how, "--format", format, status=BAD_ROWS)
    assert "1 of 2: there is no such medium" in run.stderr
    assert "out of reach" in run.stdout and "0.0757" in run.stderr
    if format == "csv":
        found, missing = read_csv(run.stdout)
        assert found["status"] == "ok" and float(found["sigma_a"]) > 0
        assert missing["status"] == "out of reach"
        assert missing["sigma_a"] == missing["sigma_s"] == missing["albedo"] == ""


def test_white_has_no_diffuse_path():
    (row,) = rows("--albedo", "1", "--diffuse-mean-free-path", "1", status=BAD_ROWS)
    assert row["status"] == "no such length"
    (row,) = rows("--albedo", "1", "--mean-free-path", "1")
    assert (row["sigma_a"], row["sigma_s"], row["albedo"]) == ("0", "1", "1")


BOTH = ["--albedo", "0.5", "--mean-free-path", "1"]


test_wrong_command_lines_say_what_to_do = says(USAGE, ["invert"], [
    ([], "give --albedo, and --mean-free-path in mm"),
    (["--mean-free-path", "1"], "give --albedo, and --mean-free-path in mm"),
    (["--albedo", "0.5"], "give exactly one of --mean-free-path, --diffuse-mean-free-"),
    ([*BOTH, "--diffuse-mean-free-path", "1"], "give exactly one of --mean-free-path, --di"),
    (
        ["--albedo", "0.1,0.2", "--mean-free-path", "1,2,3"],
        "--mean-free-path has 3 values and --albedo has 2: give one value or as many",
    ),
    (["--albedo", "half", "--mean-free-path", "1"], "--albedo: 'half' is no number"),
    ([*BOTH, "--g", "x"], "--g: 'x' is no number"),
    ([*BOTH, "--model", "best"], "--model: 'best' is unknown; this daemon has classical"),
    ([*BOTH, "--moments", "fat"], "--moments: 'fat' is unknown; this daemon has exact"),
    ([*BOTH, "--format", "xml"], "--format xml: it is one of table,csv,json"),
    ([*BOTH, "--deadline-ms", "4294967296"], "--deadline-ms: give at most 4294967295"),
    ([*BOTH, "--sigma-a", "1"], "--sigma-a: no such option"),
])


test_what_the_daemon_refuses = says(FAILED, ["invert"], [
    (["--albedo", "0.1,1.5", "--mean-free-path", "1"], "albedo number 2 of 2: allowed: 0 to 1"),
    (["--albedo", "0.1", "--mean-free-path", "0"], "mm (--mean-free-path)"),
    (["--albedo", "0.1", "--classical-diffuse-path", "-1"], "mm (--classical-diffuse-path)"),
    ([*BOTH, "--g", "1"], "bad-value: g: allowed: "),
    ([*BOTH, "--eta", "0"], "bad-value: eta: allowed: "),
    ([*BOTH, "--model", "skin-red"], "a model whose albedo depends on the medium (--model)"),
    ([*BOTH, "--model", "multipole"], "bad-value: thickness: allowed: "),
    ([*BOTH, "--connect", "unix:/nonexistent", "--retry-ms", "0"], "cannot connect to the socket"),
])


def test_too_late():
    run = dipole("invert", *BOTH, "--model", "beam", "--deadline-ms", "1", status=FAILED)
    assert "deadline_ms: allowed: more" in run.stderr and run.stdout == ""
