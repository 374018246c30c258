"""`dipole`: help, versions, and wrong command lines."""

from __future__ import annotations

import re
import subprocess

import pytest
from command_line import FAILED, PROGRAM, TIMEOUT_S, USAGE, dipole, says
from daemons import BUILD, environment

COMMANDS = [
    "eval", "plot", "points", "sample", "invert", "fit", "texture", "table", "mc", "media", "info",
    "top", "bench",
]  # fmt: skip


def test_help_lists_the_commands():
    text = dipole("--help").stdout
    assert text == dipole("help").stdout
    for command in COMMANDS:
        assert re.search(rf"^  {command} +\w", text, re.MULTILINE)


def test_without_a_command_it_says_how_to_use_it():
    run = dipole(status=USAGE)
    assert run.stdout == ""
    assert run.stderr == dipole("--help").stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_a_command(command):
    text = dipole(command, "--help").stdout
    assert text == dipole("help", command).stdout
    assert text.startswith(f"Usage: dipole {command} ")
    examples = text.split("\nExamples\n")[1]
    assert f"  dipole {command}" in examples and text.endswith("\n")
    assert "Exit status: 0 " in text
    for option in ("connect ADDRESS", "format FORMAT", "timeout-ms N", "retry-ms N", "help"):
        assert f"\n  --{option}" in text
    assert max(len(line) for line in text.splitlines()) <= 100


@pytest.mark.parametrize("command", ["eval", "sample", "invert"])
def test_examples_work(command):
    text = dipole(command, "--help").stdout.split("\nExamples\n")[1]
    examples = [line.split() for line in text.splitlines()]
    assert len(examples) >= 3
    for words in examples:
        assert words[0] == "dipole"
        if "--plot" in words:
            at = words.index("--plot")
            del words[at : at + 2]
        # With all models, the command names those that it leaves out.
        assert dipole(*words[1:], quiet="all" not in words).stdout != ""


def test_version():
    assert re.fullmatch(r"dipole \d+\.\d+\.\d+\n", dipole("--version").stdout)


EVAL = ["eval", "--sigma-a", "0.1", "--sigma-s", "1"]


test_wrong_command_lines_say_what_to_do = says(USAGE, [], [
    (["evaluate"], "there is no command 'evaluate'; the commands are eval, plot, points, sample,"),
    (["help", "evaluate"], "there is no command 'evaluate'"),
    (["eval"], "give --medium NAME, or --sigma-a and --sigma-s"),
    (["eval", "--sigma-a", "1"], "give --medium NAME, or --sigma-a and --sigma-s"),
    (["eval", "skin1"], "'skin1' is one argument too many"),
    (["points", "a.csv", "b.csv"], "'b.csv' is one argument too many"),
    (["media", "--mediun"], "--mediun: no such option"),
    (["media", "-x"], "-x: no such option"),
    (["eval", "--meduim=skin1"], "--meduim=skin1: no such option; the nearest is --medium"),
    ([*EVAL, "--model", "bettr"], "transport. Is it better?"),
    (["eval", "--sigma-a"], "--sigma-a: a value is missing"),
    (["media", "--format", "xml"], "--format xml: it is one of table,csv,json"),
    (["media", "--format", "able"], "--format able: it is one of table,csv,json"),
    (["points", "--format", "json"], "--format json: only csv"),
    (["media", "--timeout-ms", "-1"], "--timeout-ms: '-1' is no whole number"),
    (["media", "--timeout-ms", "4294967296"], "--timeout-ms: give at most 4294967295"),
    (["media", "--retry-ms", "4294967296"], "--retry-ms: give at most 4294967295"),
    (["media", "--retry-ms", "soon"], "--retry-ms: 'soon' is no whole number"),
    ([*EVAL, "--g", "0x1p-1"], "--g: '0x1p-1' is no number"),
    ([*EVAL, "--g", "0,5,"], "--g: '0,5,' is no number"),
    (["eval", "--sigma-a", "0,05"], "'0,05' is no list of numbers: one of them starts with a 0; writ"),
    ([*EVAL, "--r", "1,-00.5"], "--r: '1,-00.5' is no list of numbers: one of them starts with"),
    (["invert", "--albedo", "07"], "write a decimal point, as in 0.05"),
    (["invert", "--eta", "1,4"], "--eta: '1,4' is no number: write a decimal point, as in 0.05"),
    ([*EVAL, "--g", " 0"], "--g: ' 0' is no number"),
    ([*EVAL, "--eta", "1e999"], "--eta: '1e999' is no number"),
    ([*EVAL, "--to", "1mm"], "--to: '1mm' is no number"),
    ([*EVAL, "--count", "1e3"], "--count: '1e3' is no whole number"),
    ([*EVAL, "--count", "18446744073709551616"], "is no whole number"),
    ([*EVAL, "--medium", "skin1"], "--medium NAME stands for --sigma-a and --sigma-s: leave"),
    ([*EVAL, "--r", "1", "--count", "3"], "--r gives the radii one by one"),
    ([*EVAL, "--log"], "--log needs --from, above 0"),
    ([*EVAL, "--g", "0,0.5", "--eta", "1,1.2,1.4"], "--eta has 3 values and --g has 2"),
    (["eval", "--medium", "skin1", "--eta", "1,2"], "--eta has 2 values and --medium has 3"),
    ([*EVAL, "--deadline-ms", "4294967296"], "--deadline-ms: give at most 4294967295"),
    ([*EVAL, "--deadline-ms", "-1"], "--deadline-ms: '-1' is no whole number"),
    (["eval", "--table", "a", "--deadline-ms", "5"], "--table FILE says what is evaluated"),
    ([*EVAL, "--plot", "r.pdf"], "--plot r.pdf: the name must end in .svg or .png"),
    ([*EVAL, "--plot", ".png"], "--plot .png: the name must end in .svg or .png"),
    ([*EVAL, "--plot", "r.png", "--wanted", "albedo"], "--plot draws R: add R to --wanted"),
    ([*EVAL, "--model", "best"], "--model: 'best' is unknown; this daemon has classical, be"),
    ([*EVAL, "--model", "better,"], "--model: '' is unknown; this daemon has"),
    ([*EVAL, "--moments", "fat"], "--moments: 'fat' is unknown; this daemon has exact, fit"),
    ([*EVAL, "--evaluator", "f16"], "--evaluator: 'f16' is unknown; this daemon has f64, f32"),
    ([*EVAL, "--wanted", "colour"], "--wanted: 'colour' is unknown; this daemon has R, albedo"),
    (["eval", "--medium", "skin"], "--medium: 'skin' is unknown; this daemon has apple, ch"),
    (["points", "--evaluator", "f16"], "--evaluator: 'f16' is unknown; this daemon has f64"),
])


test_what_the_daemon_refuses_or_cannot_be_reached = says(FAILED, ["eval"], [
    (["--sigma-a", "-1", "--sigma-s", "1"], "bad-value: sigma_a: allowed: "),
    (["--sigma-a", "inf", "--sigma-s", "1"], "bad-value: sigma_a: allowed: "),
    (["--sigma-a", "1", "--sigma-s", "nan"], "bad-value: sigma_s: allowed: "),
    (["--sigma-a", "0,-1", "--sigma-s", "1"], "sigma_a of medium 2 of 2: allowed: "),
    ([*EVAL[1:], "--g", "1"], "bad-value: g: allowed: "),
    ([*EVAL[1:], "--eta", "0"], "bad-value: eta: allowed: "),
    ([*EVAL[1:], "--eta", "3", "--moments", "fit"], "bad-value: eta: allowed: "),
    ([*EVAL[1:], "--r", "0,-1"], "bad-value: r number 2 of 2: allowed: "),
    ([*EVAL[1:], "--from", "-1"], "bad-value: radius_start: allowed: "),
    ([*EVAL[1:], "--from", "0", "--log"], "bad-value: radius_start: allowed: "),
    ([*EVAL[1:], "--to", "inf"], "bad-value: radius_stop: allowed: "),
    ([*EVAL[1:], "--count", "99999999999999"], "too-large: radius_count: allowed: "),
    ([*EVAL[1:], "--connect", "localhost"], "write unix:PATH, tcp:HOST:PORT, tls:HOST:PORT or private:"),
    ([*EVAL[1:], "--connect", "unix:/nonexistent", "--retry-ms", "0"],
     "cannot connect to the socket /nonexist"),
    ([*EVAL[1:], "--connect", "private:/nonexistent"], "Install dipoled, or name a running daemon"),
    ([*EVAL[1:], "--tolerance", "1e-9"], "eval: bad-value: tolerance: allowed: at least 3.22e-06"),
    ([*EVAL[1:], "--model", "better,multipole"], "model multipole: bad-value: thickness: allowed: "
     "the thickness of the slab in mm: this model needs it (--thickness)"),
    ([*EVAL[1:], "--model", "multipole,better", "--thickness", "9"], "model better: bad-value: "
     "thickness: allowed: nothing: this model does not take it"),
])


def test_an_address_without_a_daemon_is_explained():
    """The error says where the address comes from, and how to do without it."""
    there = "unix:/nonexistent/d"
    run = dipole("media", "--connect", there, "--retry-ms", "0", status=FAILED)
    assert f"there, start one with `dipoled --listen {there}`" in run.stderr
    assert "Or leave --connect out" in run.stderr
    run = dipole("media", "--retry-ms", "0", status=FAILED, env={"DIPOLED": there})
    assert "from the environment variable DIPOLED" in run.stderr
    assert "Or unset that variable" in run.stderr


def test_a_refused_field_is_named_by_its_option_too():
    run = dipole("eval", *EVAL[1:], "--from", "-1", status=FAILED)
    assert run.stderr.rstrip().endswith("(--from)")


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
    run = subprocess.run(
        ["sh", "-c", f'exec "$@" {closing}', "sh", *command],
        capture_output=True,
        env=environment(),
        timeout=TIMEOUT_S,
        check=False,
    )
    failed = closing[0] == ">"
    assert run.returncode == (FAILED if failed else 0) and bool(run.stdout) == (not failed)
    assert (b"cannot write" in run.stderr) == (failed and "2>" not in closing)
