"""`dipole table`: the file that it writes."""

import dipole as python_client
from command_line import FAILED, PROGRAM, Terminal, dipole
from daemons import finished

MEDIUM = ["--sigma-a", "0.032", "--sigma-s", "0.74"]  # SKIN
MEDIA = ["--sigma-a", "0.032,0.17,0.48", "--sigma-s", "0.74,0.88,1.01"]


def save(tmp_path, *arguments: str) -> str:
    """Writes a file by `dipole table --output`. Returns its path."""
    path = str(tmp_path / "file.table")
    dipole("table", *arguments, "--output", path)
    return path


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
