"""Pictures of `dipole eval --plot`, and of the demonstration, which draws two."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from command_line import FAILED, TIMEOUT_S, USAGE, dipole, read_csv
from daemons import BUILD, REPOSITORY, environment
from lists import MODELS, everywhere
from pictures import check_png, places, style, svg_lines, svg_texts

SKIN = ["eval", "--medium", "skin1", "--model", "classical,better", "--count", "50"]


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
    # Labels at decades show that the axis is logarithmic.
    assert "1e-03" in texts and "1e-05" in texts


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
        ["--to", "1e4"],  # R underflows to 0 within this range.
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
    assert "R is 0 or infinite at every radius" in run.stderr
    assert not svg.exists()


def test_names_are_no_commands(tmp_path):
    """A file name that starts with | is only a name. gnuplot itself would run it as a command."""
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


# ---- without a file's name -----------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ["--plot"],
        ["--plot", "--count", "20"],
        ["--count", "20", "--plot"],
        ["--plot", "--plot", "--format", "csv"],
    ],
)
def test_a_picture_without_a_name(tmp_path, arguments):
    run = dipole(*SKIN, *arguments, cwd=tmp_path, quiet=False)
    assert "the picture is dipole.svg" in run.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["dipole.svg"]
    assert len(svg_lines(ElementTree.parse(tmp_path / "dipole.svg").getroot())) == 6
    options = [word for word in arguments if word != "--plot"]
    assert run.stdout == dipole(*SKIN, *options).stdout


def test_pictures_with_and_without_a_name(tmp_path):
    run = dipole(*SKIN, "--plot", "--plot=a.png", "--plot", "b.svg", cwd=tmp_path, quiet=False)
    assert run.stderr == "dipole eval: the picture is dipole.svg\n"
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["a.png", "b.svg", "dipole.svg"]


def test_other_options_still_need_their_values():
    run = dipole("eval", "--medium", status=USAGE)
    assert "--medium: a value is missing" in run.stderr
    run = dipole("eval", "--plot", "--nonsense", status=USAGE)
    assert "--nonsense: no such option" in run.stderr


# ---- many models ---------------------------------------------------------------------------------


def test_all_models_together(tmp_path):
    """The picture has a panel for each channel, each with a line for each model that answers, and
    one legend."""
    arguments = ["eval", "--medium", "skin1", "--model", "all"]
    run = dipole(*arguments, "--format", "csv", "--plot", cwd=tmp_path, quiet=False)
    answered = list(dict.fromkeys(row["model"] for row in read_csv(run.stdout)))
    assert set(answered) == set(everywhere()) and len(answered) > 8
    root = ElementTree.parse(tmp_path / "dipole.svg").getroot()
    groups = svg_lines(root)
    assert len(groups) == 3 * len(answered)
    texts = svg_texts(root)
    for text in ("skin1", "red", "green", "blue"):
        assert texts.count(text) == 1
    assert texts.count("r (mm)") == 3
    legend = [text for text in texts if text in MODELS]
    assert legend == answered
    lowest = max(float(key[1]) for key in places(root, MODELS))
    assert lowest < float(root.get("viewBox").split()[3])  # The legend is not cut off.
    # No two models look the same, and a model looks the same in every panel.
    styles = [style(group) for group in groups]
    assert len(set(styles)) == len(answered)
    assert styles[: len(answered)] == styles[len(answered) : 2 * len(answered)]


@pytest.mark.parametrize("channels", [1, 2, 4, 7])
def test_panels_for_any_number_of_channels(tmp_path, channels):
    sigma_a = ",".join(str((i + 1) / 10) for i in range(channels))
    arguments = ["eval", "--sigma-a", sigma_a, "--sigma-s", "1", "--model", "all"]
    run = dipole(*arguments, "--plot", "--plot", "p.png", cwd=tmp_path, quiet=False)
    assert "the picture is dipole.svg" in run.stderr
    root = ElementTree.parse(tmp_path / "dipole.svg").getroot()
    assert len(svg_lines(root)) == channels * len(everywhere())
    texts = svg_texts(root)
    assert [text for text in texts if re.fullmatch(r"channel \d+", text)] == [
        f"channel {i + 1}" for i in range(channels)
    ]
    check_png(tmp_path / "p.png")


def test_infinite_values_are_left_out(tmp_path):
    """A line starts at the second radius if R is infinite at r = 0. If that is the only radius,
    there is no line."""
    rows = dipole(
        *["eval", "--medium", "skin1", "--model", "all", "--r", "0", "--format", "csv"], quiet=False
    ).stdout
    infinite = next(row["model"] for row in read_csv(rows) if row["R"] == "inf")
    asked = ["eval", "--medium", "skin1", "--model", infinite]
    run = dipole(*asked, "--r", "0", "--plot", cwd=tmp_path, status=FAILED)
    assert "R is 0 or infinite at every radius" in run.stderr
    dipole(*asked, "--r", "0,1,2", "--plot", "r.svg", cwd=tmp_path)
    text = (tmp_path / "r.svg").read_text()
    assert len(svg_lines(ElementTree.fromstring(text))) == 3
    assert "inf" not in "".join(svg_texts(ElementTree.fromstring(text)))
    assert "nan" not in text.lower()


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
    """Copies the programs to a folder, so that the demonstration writes its files there."""
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
    asked = ["--medium", "skin1", "--channel", "red", "--model", "transport,classical,better"]
    radii = ["--from", "0.1", "--to", "10", "--log", "--count"]
    assert dipole("eval", *asked, *radii, "9").stdout in run.stdout
    assert "not measured" not in run.stdout
    rows = read_csv((copied_build / "demo" / "skin1.csv").read_text())
    R = {name: np.array([float(row["R"]) for row in rows
                         if (row["model"], row["channel"]) == (name, "red")])
         for name in asked[-1].split(",")}  # fmt: skip
    r = np.array([float(row["r"]) for row in rows[: len(R["better"])]])
    sentence = run.stdout.splitlines()[-1]
    assert sentence.startswith("In red, from 0.1 to 10 mm, the classical dipole is up to ")
    for name in ("classical", "better"):
        off = 100 * abs(R[name] / R["transport"] - 1)
        assert (f"the {name} dipole is up to {off.max():.0f} % from transport, at {r[off.argmax()]:.2g}"
                f" mm, and from 2 mm on up to {off[r >= 2].max():.0f} %") in sentence
    for suffix in ("svg", "png", "csv"):
        assert f"{copied_build}/demo/skin1.{suffix}" in run.stdout
    check_png(copied_build / "demo" / "skin1.png")
    assert len(svg_lines(ElementTree.parse(copied_build / "demo" / "skin1.svg").getroot())) == 9
    assert list(folder.iterdir()) == []  # The daemon and its socket are gone.


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


def test_the_caption_has_the_media_and_the_notes(tmp_path):
    path = tmp_path / "r.svg"
    asked = ["--sigma-a", "0.01,0.1", "--sigma-s", "10", "--g", "0.9", "--eta", "1.4"]
    dipole("eval", *asked, "--model", "better", "--plot", str(path), quiet=False)
    texts = svg_texts(ElementTree.parse(path).getroot())
    assert "channel 1: sigma_a 0.01/mm, sigma_s 10/mm, g 0.9, eta 1.4" in texts
    assert "channel 2: sigma_a 0.1/mm, sigma_s 10/mm, g 0.9, eta 1.4" in texts
    assert any(text.startswith("similarity: ") for text in texts)
