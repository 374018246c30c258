"""`dipole table`, and `dipole eval` with the evaluator lut: from a daemon, and from a file without
a daemon."""

import dipole as python_client
import pytest
from command_line import FAILED, PROGRAM, Terminal, dipole, eval_rows
from daemons import finished

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
    run = finished(PROGRAM, "table", "--model", "better", *MEDIA, "--output", "-", text=False)
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
