"""Pictures: `dipole eval --plot`, and the demonstration that draws two of them."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from command_line import FAILED, TIMEOUT_S, dipole
from daemons import BUILD, REPOSITORY, environment

SVG = "{http://www.w3.org/2000/svg}"
SKIN = ["eval", "--medium", "skin1", "--model", "classical,better", "--count", "50"]


def svg_lines(root: ElementTree.Element) -> list[ElementTree.Element]:
    """The groups that gnuplot draws the lines of a plot in."""
    groups = []
    for group in root.iter(f"{SVG}g"):
        title = group.find(f"{SVG}title")
        if title is not None and (title.text or "").startswith("gnuplot_plot_"):
            groups.append(group)
    return groups


def svg_texts(root: ElementTree.Element) -> list[str]:
    return ["".join(text.itertext()).strip() for text in root.iter(f"{SVG}text")]


def check_png(path: Path) -> None:
    data = path.read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n") and data.endswith(b"IEND\xaeB`\x82")
    width, height = struct.unpack(">II", data[16:24])
    assert width >= 600 and height >= 400
    assert len(data) > 5000


def test_svg_and_png_in_one_run(tmp_path):
    svg, png = tmp_path / "skin 'one'.svg", tmp_path / "skin.png"
    run = dipole(*SKIN, "--plot", str(svg), "--plot", str(png))
    assert run.stdout == dipole(*SKIN).stdout
    check_png(png)
    root = ElementTree.parse(svg).getroot()
    assert len(svg_lines(root)) == 6
    texts = svg_texts(root)
    assert "skin1" in texts
    assert "r (mm)" in texts and "R (1/mm^2 per unit of power that entered)" in texts
    for model in ("classical", "better"):
        for colour in ("red", "green", "blue"):
            assert f"{model}, {colour}" in texts
    assert "1e-03" in texts and "1e-05" in texts  # decades: the axis is logarithmic


def test_dashes_by_model_and_colours_by_channel(tmp_path):
    svg = tmp_path / "r.svg"
    dipole(*SKIN, "--plot", str(svg))
    styles = []
    for group in svg_lines(ElementTree.parse(svg).getroot()):
        elements = list(group.iter())
        colours = {element.get("stroke") for element in elements} - {None, "none", "black"}
        styles.append(
            (sorted(colours), any(element.get("stroke-dasharray") for element in elements))
        )
    assert len(styles) == 6
    assert styles[0][0] == styles[3][0] and styles[1][0] == styles[4][0]
    assert len({tuple(colours) for colours, _ in styles}) == 3
    assert [dashed for _, dashed in styles] == [False] * 3 + [True] * 3


@pytest.mark.parametrize(
    "arguments",
    [
        ["--from", "0.01", "--to", "100", "--log"],
        ["--r", "1"],
        ["--r", "0,1,2,inf"],
        ["--to", "1e4"],  # R underflows to 0 on the way
        ["--evaluator", "f32"],
    ],
)
def test_what_can_be_drawn(tmp_path, arguments):
    svg = tmp_path / "r.svg"
    dipole("eval", "--sigma-a", "0.1,1", "--sigma-s", "1", *arguments, "--plot", str(svg))
    root = ElementTree.parse(svg).getroot()
    assert len(svg_lines(root)) == 2
    assert "better, channel 1" in svg_texts(root)


def test_nothing_to_draw(tmp_path):
    svg = tmp_path / "r.svg"
    run = dipole("eval", "--sigma-a", "1", "--sigma-s", "0", "--plot", str(svg), status=FAILED)
    assert "R is 0 at every radius" in run.stderr
    assert not svg.exists()


def test_names_are_no_commands(tmp_path):
    """gnuplot would run what stands behind a | in a file name of its own."""
    run = subprocess.run(
        [str(BUILD / "dipole"), *SKIN, "--plot", "|touch hit;.svg"],
        cwd=tmp_path,
        capture_output=True,
        env=environment(),
        timeout=TIMEOUT_S,
        check=True,
    )
    assert run.stderr == b""
    assert [path.name for path in tmp_path.iterdir()] == ["|touch hit;.svg"]


def test_without_gnuplot(tmp_path):
    svg = tmp_path / "r.svg"
    svg.write_text("old")
    run = dipole(*SKIN, "--plot", str(svg), env={"PATH": str(tmp_path)}, status=FAILED)
    assert "gnuplot is not installed; install the package gnuplot-nox" in run.stderr
    assert svg.read_text() == "old"


def test_a_gnuplot_that_fails(tmp_path):
    fake = tmp_path / "gnuplot"
    fake.write_text("#!/bin/sh\necho 'no fonts today' >&2\nexit 3\n")
    fake.chmod(0o755)
    svg = tmp_path / "r.svg"
    path = f"{tmp_path}:{os.environ['PATH']}"
    run = dipole(*SKIN, "--plot", str(svg), env={"PATH": path}, status=FAILED)
    assert "no fonts today" in run.stderr and "gnuplot failed" in run.stderr
    assert not svg.exists()


def test_a_picture_that_cannot_be_written(tmp_path):
    run = dipole(*SKIN, "--plot", str(tmp_path / "none" / "r.svg"), status=FAILED)
    assert "cannot write it: No such file or directory" in run.stderr


# ---- the demonstration ---------------------------------------------------------------------------


def run_demo(build: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["sh", str(REPOSITORY / "clients" / "demo.sh"), str(build)],
        capture_output=True,
        env=environment(TMPDIR=str(folder)),
        timeout=TIMEOUT_S,
        text=True,
        check=False,
    )


@pytest.fixture
def copied_build(tmp_path):
    """The programs alone, so that the demonstration's files do not land in the build folder."""
    build = tmp_path / "build"
    build.mkdir()
    for name in ("dipole", "dipoled"):
        shutil.copy2(BUILD / name, build / name)
    return build


def test_demo(tmp_path, copied_build):
    folder = tmp_path / "temporary"
    folder.mkdir()
    run = run_demo(copied_build, folder)
    assert run.returncode == 0, run.stderr
    assert run.stderr == ""
    table = dipole("eval", "--medium", "skin1", "--model", "classical,better").stdout
    assert table in run.stdout
    for suffix in ("svg", "png", "csv"):
        assert f"{copied_build}/demo/skin1.{suffix}" in run.stdout
    check_png(copied_build / "demo" / "skin1.png")
    assert len(svg_lines(ElementTree.parse(copied_build / "demo" / "skin1.svg").getroot())) == 6
    assert list(folder.iterdir()) == []  # the socket is gone, and so is its daemon


def test_demo_without_programs(tmp_path):
    run = run_demo(tmp_path / "nothing", tmp_path)
    assert run.returncode != 0
    assert "is not there: run make first" in run.stderr


def test_demo_with_a_daemon_that_does_not_start(tmp_path, copied_build):
    (copied_build / "dipoled").write_text("#!/bin/sh\necho 'out of sockets' >&2\nexit 1\n")
    folder = tmp_path / "temporary"
    folder.mkdir()
    run = run_demo(copied_build, folder)
    assert run.returncode != 0
    assert "the daemon ended before it was ready" in run.stderr and "out of sockets" in run.stderr
    assert list(folder.iterdir()) == []
