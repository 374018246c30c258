"""Reads what `dipole` gives gnuplot to draw, and what gnuplot has drawn."""

import os
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from command_line import dipole

FAKE = """#!/bin/sh
[ "$*" = "-d -" ] && cat >"$0.script" && echo drawn
"""


def script(folder: Path, *arguments: str, **how) -> tuple[dict[str, str], dict[str, np.ndarray]]:
    """Runs a command with a gnuplot that draws nothing. Returns the variables that it was to draw by,
    and the data of each curve by its title: lines of a place, what is shown there, its error, and
    the two of the lower panel."""
    fake = folder / "fake" / "gnuplot"
    fake.parent.mkdir(exist_ok=True)
    fake.write_text(FAKE)
    fake.chmod(0o755)
    env = {"PATH": f"{fake.parent}:{os.environ['PATH']}"}
    dipole(*arguments, "--plot", str(folder / "r.svg"), env=env, **how)
    assert (folder / "r.svg").read_text() == "drawn\n"
    text = Path(f"{fake}.script").read_text()
    names = {name: plain(value) for name, value in re.findall(r"(?m)^([\w\[\]]+) = (.*)$", text)}
    blocks = re.search(r"\$data << END\n(.*?)END\n", text, re.S)[1].split("\n\n\n")[:-1]
    curves = {
        names[f"T[{i + 1}]"]: np.array([line.split() for line in block.splitlines()], np.float64)
        for i, block in enumerate(blocks)
    }
    return names, curves


def plain(text: str) -> str:
    """Returns a text without its quotes, and without the octal numbers that stand for characters."""
    return re.sub(r"\\0([0-7]{3})", lambda octal: chr(int(octal[1], 8)), text.strip("\"'"))


def svg_texts(path: Path) -> list[str]:
    texts = ElementTree.parse(path).getroot().iter("{http://www.w3.org/2000/svg}text")
    return ["".join(text.itertext()).strip() for text in texts]
