"""`dipole table`, and `dipole eval` with the evaluator lut: from a daemon, and from a file without
a daemon."""

from __future__ import annotations

import re
import subprocess

import dipole as python_client
import pytest
from command_line import FAILED, PROGRAM, TIMEOUT_S, Terminal, dipole, eval_rows
from command_line import scratch
from daemons import environment

MEDIUM = ["--sigma-a", "0.032", "--sigma-s", "0.74"]  # SKIN
MEDIA = ["--sigma-a", "0.032,0.17,0.48", "--sigma-s", "0.74,0.88,1.01"]
RADII = ["--r", "0,1e-40,1e-12,0.001,0.1,1,2.5,30,1e4,1e30,inf"]


def save(tmp_path, *arguments: str) -> str:
    """Writes a file by `dipole table --output`. Returns its path."""
    path = str(tmp_path / "file.table")
    dipole("table", *arguments, "--output", path)
    return path


# ---- dipole table --------------------------------------------------------------------------------


def test_output_is_what_python_reads(client, tmp_path):
    path = save(tmp_path, *MEDIA)
    tables = python_client.Table.load_all(path, client.info)
    assert [table.medium.sigma_a for table in tables] == [0.032, 0.17, 0.48]
    for table in tables:
        assert table.words.tolist() == client.table("better", table.medium).words.tolist()
    run = subprocess.run(
        [str(PROGRAM), "table", "--model", "better", *MEDIA, "--output", "-"],
        capture_output=True,
        env=environment(),
        timeout=TIMEOUT_S,
        check=True,
    )
    with open(path, "rb") as file:
        assert run.stdout == file.read()


def test_binary_does_not_go_to_a_terminal():
    run = Terminal("table", *MEDIUM, "--output", "-", on=[1])
    error = run.process.stderr.read()
    assert run.end()[0] == FAILED and run.seen == ""
    assert b"a terminal cannot show binary tables; name a file" in error


# ---- dipole eval ---------------------------------------------------------------------------------


def assert_same_values(here: list[dict], there: list[dict]) -> None:
    """Compares rows or channels of a file (here) with those of the daemon, errors included."""
    def is_of_model(key: str) -> bool:
        return key.startswith("model_error")

    unnamed = [
        [{k: row[k] for k in row if k != "channel" and not is_of_model(k)} for row in rows]
        for rows in (here, there)
    ]
    assert unnamed[0] == unnamed[1]
    # A table states the model errors of bands of radii.
    for mine, asked in zip(here, there):
        for key in filter(is_of_model, mine):
            assert not float(mine[key] or "nan") < float(asked[key] or "nan") * 0.999, key
    assert all(float(row["numerical_error"]) > 0 for row in here)


@pytest.mark.parametrize("model", ["better", "better+single", "transport"])
def test_a_file_says_the_same_as_the_daemon(tmp_path, model):
    angles = ["--cos-in", "0.8", "--cos-out", "0.1"]
    path = save(tmp_path, *MEDIA, "--model", model, *angles)
    wanted = ["--wanted", "R,cdf,pdf,2_pi_r_R,S,albedo"]
    for radii in (RADII, ["--r", "0.1,1,3"], ["--r", "300"], ["--from", "20", "--to", "70.3"]):
        here = eval_rows("--table", path, *radii, *wanted)
        there = eval_rows(*MEDIA, "--model", model, "--evaluator", "lut", *radii, *wanted, *angles)
        assert_same_values(here, there)
        assert {row["channel"] for row in here} == {"skin1 red", "skin1 green", "skin1 blue"}


def test_a_file_needs_no_daemon(tmp_path):
    path = save(tmp_path, *MEDIUM)
    text = dipole("eval", "--table", path, "--r", "1", env={"DIPOLED": "unix:/nonexistent"}).stdout
    assert re.search("^better .* lut *$", text, re.M)
    with open(path, "rb") as file:
        assert dipole("eval", "--table", "-", "--r", "1", stdin=file.read()).stdout == text
    picture = tmp_path / "picture.svg"
    dipole("eval", "--table", path, "--plot", str(picture))
    assert picture.read_text().startswith("<?xml")


def test_files_that_are_none(tmp_path):
    path = save(tmp_path, *MEDIUM)
    with open(path, "rb") as file:
        data = file.read()
    damaged = data[:-1] + bytes([data[-1] ^ 1])
    for content, said in [
        (b"", "table 1: this is not an intact table: it is too short"),
        (b"sigma_a,sigma_s\n" * 30, "table 1: this is not an intact table: it does not start as"),
        (data[:-8], "table 1: this is not an intact table: its end is missing"),
        (damaged, "table 1: this is not an intact table: its counts or its checksum are wrong"),
        (data + damaged, "table 2: this is not an intact table"),
        (data + b"\n", "table 2: this is not an intact table: it is too short"),
        (data[:24] + b"\1" + data[25:], "this table has layout 1, but this library reads layout 5"),
    ]:
        bad = scratch(tmp_path, "bad", content)
        run = dipole("eval", "--table", bad, "--r", "1", status=FAILED)
        assert said in run.stderr and run.stdout == ""
    run = dipole("eval", "--table", "/nonexistent", status=FAILED)
    assert "cannot read /nonexistent: No such file" in run.stderr


def test_files_of_several_models(client, tmp_path):
    both = client.table("better", (1, 1, 0, 1.3)).data + client.table("burley", (1, 1, 0, 1.3)).data
    path = scratch(tmp_path, "both", both)
    run = dipole("eval", "--table", path, status=FAILED)
    assert "tables 1 and 2 differ in model, moments, parameters or number of layers" in run.stderr
