"""The command line by expected output: runs the commands in the files of tests/cli.

A line that starts with "$ " is a command for sh, in an empty folder that the commands of a file share;
REPOSITORY names that of the sources.
What it prints follows: standard output, then lines "! ..." of standard error, then "? N" if the exit
status N is not 0. Runs of blanks are alike, and so are numbers within one in a million. "..." stands
for any text within a line and, alone on a line, for any lines. Lines that start with "## " are
comments. RECORD=1 in the environment writes what the commands print into the files."""

import math
import os
import re
from pathlib import Path

import pytest
from command_line import shared
from daemons import BUILD, REPOSITORY, environment, finished

FOLDER = REPOSITORY / "tests/cli"
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?")


def run(command: str, folder: Path) -> list[str]:
    """Returns what a command prints, as a file has it. Memory that `dipole` loses is an error, too."""
    path = f"{BUILD}/leaks:{BUILD}:{os.environ['PATH']}"
    env = environment(PATH=path, NO_COLOR="1", DIPOLED=shared().url(), REPOSITORY=str(REPOSITORY))
    done = finished("sh", "-c", command, cwd=folder, env=env)
    assert "Sanitizer" not in done.stderr, done.stderr
    lines = done.stdout.splitlines() + [f"! {line}" for line in done.stderr.splitlines()]
    return lines + ([f"? {done.returncode}"] if done.returncode else [])


def same(expected: str, line: str) -> bool:
    """Returns whether a line is as expected: where its numbers are those digits, its columns, too."""
    if NUMBER.findall(expected) != NUMBER.findall(line) or "..." in expected:
        expected, line = " ".join(expected.split()), " ".join(line.split())
    if "..." in expected:
        parts = map(re.escape, expected.split("..."))
        return re.fullmatch(".*".join(parts), line) is not None
    numbers = zip(NUMBER.findall(expected), NUMBER.findall(line))
    return NUMBER.split(expected) == NUMBER.split(line) and all(
        math.isclose(float(a), float(b), rel_tol=1e-6, abs_tol=1e-12) for a, b in numbers
    )


def matches(expected: list[str], lines: list[str]) -> bool:
    if not expected:
        return not lines
    if expected[0].strip() == "...":
        return any(matches(expected[1:], lines[at:]) for at in range(len(lines) + 1))
    return bool(lines) and same(expected[0], lines[0]) and matches(expected[1:], lines[1:])


@pytest.mark.parametrize("file", sorted(FOLDER.glob("*.t")), ids=lambda file: file.stem)
def test_commands(file, tmp_path):
    blocks = re.split(r"^(?=\$ )", file.read_text(), flags=re.M)
    faults, made = [], blocks[:1]
    for block in blocks[1:]:
        lines = [line for line in block.splitlines() if not line.startswith("## ")]
        while lines[-1] == "":
            lines.pop()
        printed = run(lines[0][2:], tmp_path)
        kept = matches(lines[1:], printed)
        comments = [line for line in block.splitlines() if line.startswith("## ")]
        made.append("\n".join([*(lines if kept else [lines[0], *printed]), "", *comments, ""]))
        if not kept:
            faults.append("\n".join([lines[0], "expected:", *lines[1:], "printed:", *printed]))
    if os.environ.get("RECORD"):
        file.write_text("".join(made).rstrip("\n") + "\n")
    else:
        assert not faults, "\n\n".join(faults)
