"""Reads pictures that `dipole` has drawn."""

from __future__ import annotations

import re
import struct
import xml.etree.ElementTree as ElementTree
from pathlib import Path

SVG = "{http://www.w3.org/2000/svg}"


def svg_lines(root: ElementTree.Element) -> list[ElementTree.Element]:
    """Returns the groups in which gnuplot draws the lines of a plot."""
    groups = []
    for group in root.iter(f"{SVG}g"):
        title = group.find(f"{SVG}title")
        if title is not None and (title.text or "").startswith("gnuplot_plot_"):
            groups.append(group)
    return groups


def svg_texts(root: ElementTree.Element) -> list[str]:
    return ["".join(text.itertext()).strip() for text in root.iter(f"{SVG}text")]


def svg_size(root: ElementTree.Element) -> tuple[float, float]:
    width, height = root.get("viewBox").split()[2:]
    return float(width), float(height)


def png_size(path: Path) -> tuple[int, int]:
    data = path.read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n") and data.endswith(b"IEND\xaeB`\x82")
    return struct.unpack(">II", data[16:24])


def check_png(path: Path) -> None:
    width, height = png_size(path)
    assert width >= 600 and height >= 400
    assert path.stat().st_size > 5000


def path_points(group: ElementTree.Element) -> list[tuple[float, float]]:
    """Returns the corners of a line in pixels. They are those of its longest piece, because another
    piece is in the legend."""
    pieces = []
    for path in group.iter(f"{SVG}path"):
        for letter, x, y in re.findall(r"([ML])(-?[\d.]+),(-?[\d.]+)", path.get("d", "")):
            if letter == "M":
                pieces.append([])
            pieces[-1].append((float(x), float(y)))
    return max(pieces, key=len)


def places(root: ElementTree.Element, words) -> list[tuple[str, str]]:
    """Returns the x and y of the texts that are among these words."""
    found = []
    for group in root.iter(f"{SVG}g"):
        text = group.find(f"{SVG}text")
        if text is not None and "".join(text.itertext()).strip() in words:
            match = re.match(r"translate\(([\d.]+),([\d.]+)\)", group.get("transform", ""))
            found.append((match[1], match[2]))
    return found


def style(group: ElementTree.Element) -> tuple:
    """Returns the colour and dashes of a line, which are those of its longest path."""
    longest = max(group.iter(f"{SVG}path"), key=lambda path: len(path.get("d", "")))
    parents = {child: parent for parent in group.iter() for child in parent}
    colour = longest.get("stroke")
    at = longest
    while colour is None and at in parents:
        at = parents[at]
        colour = at.get("stroke")
    return colour, longest.get("stroke-dasharray")
