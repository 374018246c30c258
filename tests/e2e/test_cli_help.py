"""`dipole`: help, versions, and wrong command lines."""

import pytest
from command_line import FAILED, PROGRAM, dipole
from daemons import BUILD, finished

@pytest.mark.parametrize("command", ["eval", "sample", "invert"])
def test_examples_work(command, tmp_path):
    layer = "1 2 18 .75 .1"
    (tmp_path / "sample.mci").write_text(f"1.0\n1\nslab.mco A\n9\n.01 .1\n9 2 1\n1\n1\n{layer}\n1\n")
    (tmp_path / "colours.csv").write_text("albedo,mean_free_path\n.4,1\n.2,1\n")
    text = dipole(command, "--help").stdout.split("\nExamples\n")[1]
    examples = [line.split(" | ")[0].split() for line in text.splitlines()]
    assert len(examples) >= 3
    for words in examples:
        assert words[0] == "dipole"
        if "--plot" in words:
            at = words.index("--plot")
            del words[at : at + 2]
        # With all models, the command names those that it leaves out.
        assert dipole(*words[1:], quiet="all" not in words, cwd=tmp_path).stdout != ""


EVAL = ["eval", "--sigma-a", "0.1", "--sigma-s", "1"]


OUTPUTS = {
    "version": [PROGRAM, "--version"],
    "help": [PROGRAM, "eval", "--help"],
    "values": [PROGRAM, *EVAL, "--r", "1", "--connect"],
    "table": [PROGRAM, "table", *EVAL[1:], "--output", "-"],
    "top": [PROGRAM, "top", "--count", "1"],
    "daemon's help": [BUILD / "dipoled", "--help"],
    "daemon's version": [BUILD / "dipoled", "--version"],
}


@pytest.mark.parametrize("name", OUTPUTS)
@pytest.mark.parametrize("closing", [">/dev/full", ">&-", ">&- <&-", ">&- 2>&-", "<&- 2>&-"])
def test_output_that_cannot_be_written_is_a_failure(shared, name, closing):
    command = [str(word) for word in OUTPUTS[name]]
    command += [shared.url("tcp")] if command[-1] == "--connect" else []
    run = finished("sh", "-c", f'exec "$@" {closing}', "sh", *command, text=False)
    failed = closing[0] == ">"
    assert run.returncode == (FAILED if failed else 0) and bool(run.stdout) == (not failed)
    assert (b"cannot write" in run.stderr) == (failed and "2>" not in closing)
