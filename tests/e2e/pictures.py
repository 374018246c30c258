"""Reads what `dipole` gives gnuplot to draw, and what gnuplot has drawn."""

from __future__ import annotations

import os
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from command_line import dipole

FAKE = """#!/bin/sh
[ "$*" = "-d -" ] && cat >"$0.script" && echo drawn
"""


@dataclass
class Curve:
    title: str
    style: str  # how it is drawn, with its colour and dash
    data: np.ndarray  # [N, 3]: place, what is shown there, its error; without undefined points


@dataclass
class Panel:
    settings: dict[str, str]  # by their names, such as "title", "logscale y" and "yrange"
    curves: list[Curve]


def script(folder: Path, *arguments: str, to: str = "r.svg", **how) -> list[Panel]:
    """Runs a command with a gnuplot that draws nothing. Returns the panels that it was to draw."""
    fake = folder / "fake" / "gnuplot"
    fake.parent.mkdir(exist_ok=True)
    fake.write_text(FAKE)
    fake.chmod(0o755)
    path = to if to == "-" else str(folder / to)
    env = {"PATH": f"{fake.parent}:{os.environ['PATH']}"}
    run = dipole(*arguments, "--plot", path, env=env, **how)
    assert (run.stdout if to == "-" else Path(path).read_text()).count("drawn\n") == 1
    return read_script(Path(f"{fake}.script").read_text())


def read_script(text: str) -> list[Panel]:
    panels, settings, blocks = [], {}, {}
    for block in re.finditer(r"\$(\w+) << END\n(.*?)END\n", text, re.S):
        data = np.array([line.split() for line in block[2].splitlines()], np.float64)
        blocks[block[1]] = data[~np.isnan(data[:, 0])]
    for line in re.sub(r"\$\w+ << END\n.*?END\n", "", text, flags=re.S).splitlines():
        word, name, value = (*line.split(" ", 2), "", "")[:3]
        if word == "plot":
            found = re.findall(r'\$(\w+) using (.*?) title "(.*?)"', line)
            curves = [Curve(plain(title), style, blocks[name]) for name, style, title in found]
            panels.append(Panel(dict(settings), curves))
        elif name == "logscale":
            names = [f"logscale {value}"] if word == "set" else ["logscale x", "logscale y"]
            settings = {k: v for k, v in settings.items() if k not in names}
            settings |= dict.fromkeys(names, "set") if word == "set" else {}
        elif word == "set":
            settings[name] = plain(value)
        elif word == "unset":
            settings.pop(name, None)
    return panels


def plain(text: str) -> str:
    """Returns a text without its quotes, and without the octal numbers that stand for characters."""
    return re.sub(r"\\0([0-7]{3})", lambda octal: chr(int(octal[1], 8)), text.strip('"'))


def svg_lines(path: Path) -> int:
    """Returns how many curves gnuplot has drawn."""
    return path.read_text().count('<g id="gnuplot_plot_')


def svg_texts(path: Path) -> list[str]:
    texts = ElementTree.parse(path).getroot().iter("{http://www.w3.org/2000/svg}text")
    return ["".join(text.itertext()).strip() for text in texts]


def check_png(path: Path) -> None:
    data = path.read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n") and data.endswith(b"IEND\xaeB`\x82")
    assert len(data) > 5000
