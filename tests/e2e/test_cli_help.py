"""`dipole`: help, versions, and wrong command lines."""

import pytest
from command_line import PROGRAM, dipole
from daemons import finished


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


SERVICE = """mount -t tmpfs none /run || exit 77
"$0/dipole" info | grep " address  *private:" || exit 1
"$0/dipoled" --listen unix:/run/dipoled.sock >/dev/null 2>&1 &
trap "kill $!" EXIT
"$0/dipole" info --connect unix:/run/dipoled.sock >/dev/null || exit 1
for command in "info --format csv" "bench --seconds .01"; do
  "$0/dipole" $command || exit 1
done
"$0/dipole" info --connect private: | grep " address  *private:" || exit 1
kill -STOP $!
"$0/dipole" info --retry-ms 100 --timeout-ms 100 && exit 1
kill -CONT $!
"""


def test_the_installed_service_is_shown_unless_another_daemon_is_named():
    run = finished("unshare", "-rm", "bash", "-mc", SERVICE, str(PROGRAM.parent))
    if run.returncode == 77 or "unshare failed" in run.stderr:
        pytest.skip("a file system of one's own cannot be mounted here")
    assert run.returncode == 0, run.stderr
    for shown in ("daemon,address,", "dipoled 0.1.0, at "):
        run.stdout = run.stdout.split(f"{shown}unix:/run/dipoled.sock", 1)[1]
    assert "The address is from" not in run.stderr  # of the one that does not answer
    for command in ("info", "bench"):
        assert f"dipole {command}: this is the installed service, unix:/run/dipoled" in run.stderr
