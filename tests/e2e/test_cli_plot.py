"""Pictures of `dipole plot` and `dipole eval --plot`: what gnuplot gets, and two that it draws; and
the demonstration, which draws two."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import time
from pathlib import Path

import dipole as dipole_module
import numpy as np
import pytest
from command_line import FAILED, TIMEOUT_S, USAGE, Proxy, Terminal, busy, dipole, eval_rows
from command_line import read_csv, says
from daemons import BUILD, REPOSITORY, environment
from lists import everywhere
from pictures import check_png, plain, script, svg_lines, svg_texts

SKIN = ["plot", "--medium", "skin1"]
RED = [*SKIN, "--channel", "red"]
R_LABEL = "R (1/mm^2 per unit of power that entered)"
COLOURS = ("red", "green", "blue")


def numbers(*arguments: str, quiet: bool = True) -> list[dict[str, str]]:
    """Returns the numbers that a command draws."""
    return read_csv(dipole(*arguments, "--format", "csv", quiet=quiet).stdout)


def column(rows: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name] or "nan") for row in rows])


# ---- what gnuplot gets: axes ---------------------------------------------------------------------


def test_a_panel_for_each_of_the_axes(tmp_path):
    """They stand below each other, with the deviation at last and one legend."""
    arguments = [*RED, "--axes", "linear,semilog,logarithmic,gamma", "--axes-gamma", "3", "--error"]
    panels = script(tmp_path, *arguments, "--count", "30")
    rows = numbers(*arguments, "--count", "30")
    r, R = column(rows, "r"), column(rows, "R")
    shown = [R, R, R, R ** (1 / 3), 100 * column(rows, "deviation")]
    labels = [R_LABEL] * 3 + ["R^(1/3) (R in 1/mm^2)", "deviation from transport (%)"]
    logarithmic = [(False, False), (False, True), (True, True), (False, False), (False, False)]
    assert len(panels) == 5
    for i, panel in enumerate(panels):
        settings = panel.settings
        assert tuple(f"logscale {of}" in settings for of in "xy") == logarithmic[i]
        assert settings["ylabel"] == labels[i] and settings["title"] == "red"
        assert ("key" in settings) == (i == 0)
        (curve,) = panel.curves
        assert curve.title == "better"
        np.testing.assert_allclose(curve.data[:, :2].T, [r, shown[i]], 1e-14)
    assert panels[0].settings["multiplot"].startswith("layout 5,1 columnsfirst margins")
    assert panels[0].settings["multiplot"].endswith('title "skin1')
    assert panels[0].settings["xlabel"].endswith("r (mm)")
    assert "red: sigma_a 0.032/mm, sigma_s 0.74/mm, g 0, eta 1.3" in plain(panels[0].settings["label"])
    assert panels[4].settings["yrange"] == "[-200<*:*<200]"


def test_the_usual_axes_and_their_radii(tmp_path):
    (panel,) = script(tmp_path, *RED)
    assert {"logscale x", "logscale y"} <= set(panel.settings)
    rows = numbers(*RED)
    assert len(rows) == 401 and float(rows[0]["r"]) == 0.01 and float(rows[-1]["r"]) == 10
    assert rows == numbers(*RED, "--axes", "logarithmic")
    assert float(numbers(*SKIN, "--axes", "gamma", "--to", "5")[0]["r"]) == 0
    assert float(numbers(*SKIN, "--axes", "gamma,logarithmic", "--to", "5")[0]["r"]) == 0.005
    linear = numbers(*RED, "--from", "0", "--count", "3")
    assert [row["r"] for row in linear] == ["0", "5", "10"]
    ratios = numbers(*RED, "--from", "0.1", "--count", "3")
    assert column(ratios, "r") == pytest.approx([0.1, 1, 10], rel=1e-14)
    assert [row["r"] for row in numbers(*RED, "--r", "2,1")] == ["2", "1"]


def test_what_lies_beyond_the_axes(tmp_path):
    """A peak of single scattering near 0, infinite R at 0, and the far tail."""
    single = [*RED, "--model", "single"]
    (panel,) = script(tmp_path, *single, "--axes", "linear")
    rows = numbers(*single, "--axes", "linear")
    r, R = column(rows, "r"), column(rows, "R")
    assert R[0] == np.inf and len(panel.curves[0].data) == 400
    highest = float(panel.settings["yrange"].split("<")[-1].strip("]"))
    assert highest == pytest.approx(1.1 * R[r > 0.21].max(), rel=1e-8)
    (panel,) = script(tmp_path, *RED, "--axes", "linear")
    R = column(numbers(*RED, "--axes", "linear"), "R")
    assert float(panel.settings["yrange"].split("<")[-1].strip("]")) == pytest.approx(1.1 * R[0])
    (panel,) = script(tmp_path, *single)
    lowest = float(panel.settings["yrange"].split("<")[0].strip("["))
    assert lowest == pytest.approx(1e-12 * column(numbers(*single), "R")[0])


def test_eval_draws_R(tmp_path):
    """On a logarithmic axis if the radii are in equal ratios; infinite radii and values are left
    out, and a single radius is a point."""
    skin = ["eval", "--medium", "skin1", "--channel", "red"]
    (panel,) = script(tmp_path, *skin, "--wanted", "albedo,R,cdf", "--count", "5")
    assert panel.settings["ylabel"] == R_LABEL and "logscale x" not in panel.settings
    rows = eval_rows(*skin[1:], "--count", "5")
    assert (panel.curves[0].data[:, 1] == column(rows, "R")).all()
    (panel,) = script(tmp_path, *skin, "--from", "0.1", "--log", "--evaluator", "f32")
    assert {"logscale x", "logscale y"} <= set(panel.settings)
    (panel,) = script(tmp_path, *skin, "--model", "transport", "--r", "0,1,2,inf")
    assert panel.curves[0].data[:, 0].tolist() == [1, 2]
    (panel,) = script(tmp_path, *skin, "--r", "1")
    assert "with points" in panel.curves[0].style


# ---- curves and panels ---------------------------------------------------------------------------


def test_few_models_and_channels_share_a_panel(tmp_path):
    (panel,) = script(tmp_path, *SKIN, "--model", "classical,better")
    titles = [f"{model}, {colour}" for model in ("classical", "better") for colour in COLOURS]
    assert [curve.title for curve in panel.curves] == titles
    look = [re.search(r"dt (\d) lc rgb '(.*)'", curve.style).groups() for curve in panel.curves]
    assert [dash for dash, _ in look] == ["1"] * 3 + ["2"] * 3
    colours = [colour for _, colour in look]
    assert colours[:3] == colours[3:] and len(set(colours)) == 3
    (panel,) = script(tmp_path, *SKIN, "--channel", "green,blue")
    assert [curve.style for curve in panel.curves] == [
        f"1:2 with lines lw 2 dt 1 lc rgb '{colour}'" for colour in colours[1:3]
    ]


@pytest.mark.parametrize("channels, layout", [(3, "2,3"), (7, "6,3")])
def test_many_models_have_a_panel_for_each_channel(tmp_path, channels, layout):
    sigma_a = ",".join(str((i + 1) / 10) for i in range(channels))
    asked = ["plot", "--sigma-a", sigma_a, "--sigma-s", "1", "--model", "all", "--error"]
    csv = dipole(*asked, "--count", "5", "--format", "csv", quiet=False)
    models = list(dict.fromkeys(row["model"] for row in read_csv(csv.stdout)))
    assert len(models) > 8 and set(models) <= set(everywhere()) and "transport" in models
    assert "gaussians is left out: " in csv.stderr and "(--from)" in csv.stderr
    panels = script(tmp_path, *asked, quiet=False)
    titles = [f"channel {i // 2 + 1}" for i in range(2 * channels)]
    assert [panel.settings["title"] for panel in panels] == titles
    assert panels[0].settings["multiplot"].startswith(f"layout {layout} columnsfirst")
    for panel in panels:
        assert [curve.title for curve in panel.curves] == models
        assert len({curve.style for curve in panel.curves}) == len(models)
    assert ("and 1 more" in plain(panels[0].settings["label"])) == (channels > 6)
    assert "note: medium-unused: " in plain(panels[0].settings["label"])


def test_sizes(tmp_path):
    arguments = [*SKIN, "--model", "classical,better", "--error"]
    (first, _) = script(tmp_path, *arguments, "--size", "1234x567", to="r.png")
    assert "pngcairo size 1234,567 " in first.settings["terminal"]
    (first, _) = script(tmp_path, *arguments)
    assert first.settings["terminal"].startswith("svg dynamic size 8")


@pytest.mark.parametrize(
    "quantity, label",
    [("cdf", "cdf"), ("2_pi_r_R", "2_pi_r_R (1/mm)"), ("ln_R", "ln_R (ln(1/mm^2))"),
     ("S", "S (1/(mm^2 sr))")],
)  # fmt: skip
def test_quantities(tmp_path, quantity, label):
    radii = ["--count", "25", "--from", "0.5"]
    (panel,) = script(tmp_path, *RED, "--quantity", quantity, "--axes", "linear", *radii)
    assert panel.settings["ylabel"] == label
    direct = eval_rows("--medium", "skin1", "--channel", "red", "--wanted", quantity, *radii)
    assert (panel.curves[0].data[:, 1] == column(direct, quantity)).all()


def test_several_media(tmp_path):
    few = ["--channel", "green", "--count", "9"]
    rows = numbers("plot", "--medium", "marble,wholemilk", *few)
    assert [row["channel"] for row in rows[::9]] == ["marble green", "wholemilk green"]
    for name in ("marble", "wholemilk"):
        mine = [row["R"] for row in rows if row["channel"] == f"{name} green"]
        assert mine == [row["R"] for row in numbers("plot", "--medium", name, *few)]
    (panel,) = script(tmp_path, "plot", "--medium", "marble,wholemilk", *few)
    assert panel.curves[0].title == "better, marble green"
    assert panel.settings["multiplot"].endswith("marble,wholemilk")
    media = ["--medium", "marble,skin1", "--channel", "red,blue", "--r", "1"]
    rows = eval_rows(*media, "--eta", "1.1,1.2,1.3,1.4")
    assert [row["eta"] for row in rows] == ["1.1", "1.2", "1.3", "1.4"]
    run = dipole("eval", *media, "--eta", "1,2,3", status=USAGE)
    assert "--eta has 3 values and --medium has 4" in run.stderr


# ---- the deviation from transport ----------------------------------------------------------------


@pytest.mark.parametrize("quantity", ["R", "dR_dr"])
def test_the_error_is_that_of_direct_evaluation(quantity):
    radii = ["--from", "0.2", "--to", "5", "--count", "30"]
    arguments = [*SKIN, "--quantity", quantity, "--axes", "linear", "--error", *radii]
    rows = numbers(*arguments, "--model", "classical,better")
    assert list(dict.fromkeys(row["model"] for row in rows)) == ["classical", "better"]
    direct = eval_rows(
        *["--medium", "skin1", "--model", "classical,better,transport", "--wanted", quantity, *radii]
    )
    keys = {(row["model"], row["channel"], row["r"]): float(row[quantity]) for row in direct}
    for row in rows:
        transport = keys["transport", row["channel"], row["r"]]
        value = keys[row["model"], row["channel"], row["r"]]
        assert float(row[quantity]) == value
        assert float(row["deviation"]) == value / transport - 1


def test_what_is_compared_with_transport():
    rows = numbers(*SKIN, "--model", "better,transport", "--error", "--count", "5")
    assert {float(row["deviation"]) for row in rows if row["model"] == "transport"} == {0.0}
    # It takes what it can of the parameters.
    arguments = [*SKIN, "--model", "gaussians", "--gaussians", "4", "--from", "0.5", "--to", "3"]
    rows = numbers(*arguments, "--error", "--count", "5")
    assert len(rows) == 15 and np.isfinite(column(rows, "deviation")).all()
    rows = numbers(*SKIN, "--tolerance", "0.01", "--error", "--count", "5")
    assert np.abs(column(rows, "deviation")).max() <= 0.01
    assert len({row["model"] for row in rows}) == 1


def test_no_error_where_transport_does_not_hold():
    """Transport sees sigma_s (1 - g) of a medium beyond its table: that is no truth."""
    media = ["plot", "--sigma-a", "0.05,0.05", "--sigma-s", "50,9.5", "--eta", "1.4"]
    media += ["--model", "better"]
    run = dipole(*media, "--g", "0.995,0.9", "--error", status=FAILED)
    assert "-0.98 to 0.99 with transport" in run.stderr and run.stdout == ""
    assert numbers(*media, "--g", "0.995", "--count", "5")
    medium = ["plot", "--sigma-a", "0.1", "--sigma-s", "1", "--eta", "5"]
    run = dipole(*medium, "--error", status=FAILED)
    assert "transport is left out: bad-value: eta: " in run.stderr
    assert "nothing to compare with: leave --error out" in run.stderr and run.stdout == ""


# ---- Monte Carlo ---------------------------------------------------------------------------------

RINGS = ["--from", "0.05", "--to", "8", "--count", "12"]


@pytest.mark.parametrize("scale", ["logarithmic", "linear"])
def test_monte_carlo_beside_means_of_models(tmp_path, client, scale):
    """The numbers are those of the Python client's ring_means() and mc()."""
    arguments = [*SKIN, "--model", "better,transport", "--axes", scale, *RINGS, "--mc", "50000"]
    arguments += ["--error", "--evaluator", "f64"]
    rows = numbers(*arguments)
    edges = dipole_module.Grid(0.05, 8.0, 13, scale)
    skin = client.media()["skin1"]
    reference = client.ring_means("transport", "skin1", edges)
    middle = np.sqrt((reference.edges[1:] ** 2 + reference.edges[:-1] ** 2) / 2)
    panels = script(tmp_path, *arguments)
    for k, model in enumerate(("better", "transport", "mc")):
        for i, colour in enumerate(COLOURS):
            of = [row for row in rows if (row["model"], row["channel"]) == (model, colour)]
            np.testing.assert_allclose(column(of, "r"), middle, 1e-12)
            deviation = column(of, "deviation")
            curves = [panel.curves[3 * k + i] for panel in panels]
            assert [curve.title for curve in curves] == 2 * [f"{model}, {colour}"]
            if model == "mc":
                walked = client.mc(skin[i], edges, photons=50_000)
                R, error = walked.R[0], walked.R_error[0]
                assert (column(of, "R_error") == error).all()
                assert all("1:2:3 with yerrorbars" in curve.style for curve in curves)
                np.testing.assert_allclose(curves[0].data[:, 1:].T, [R, error], 1e-14)
                of_deviation = error / R * (1 + deviation)
                np.testing.assert_allclose(column(of, "deviation_error"), of_deviation, 1e-9)
                np.testing.assert_allclose(curves[1].data[:, 2], 100 * of_deviation, 1e-9)
            else:
                R = client.ring_means(model, skin[i], edges).R[0]
                assert np.isnan(column(of, "R_error")).all()
            np.testing.assert_allclose(column(of, "R"), R, 1e-12)
            np.testing.assert_allclose(deviation, R / reference.R[i] - 1, atol=1e-9)


def test_the_error_of_means_is_stated(tmp_path, client):
    """Rings so wide that 16 points of a part are too few, and so far that no photon gets there."""
    rings = ["--from", "20", "--to", "200", "--count", "2", "--axes", "linear", "--mc", "10"]
    medium = ["plot", "--sigma-a", "1", "--sigma-s", "1", "--eta", "1.4", "--model", "better"]
    rows = [row for row in numbers(*medium, *rings) if row["model"] == "better"]
    right = client.ring_means("better", (1, 1, 0, 1.4), dipole_module.Grid(20, 200, 3)).R[0]
    off = np.abs(column(rows, "R") / right - 1)
    assert off.max() > 1e-5 and (off <= column(rows, "numerical_error")).all()
    (panel,) = script(tmp_path, *medium, *rings)
    np.testing.assert_array_equal(panel.curves[1].data[:, 1:], [[0, np.nan]] * 2)


def test_monte_carlo_of_a_slab(client):
    medium = ["plot", "--sigma-a", "0.1", "--sigma-s", "2", "--eta", "1.4", "--thickness", "1.5"]
    rows = numbers(*medium, "--model", "better-multipole", *RINGS, "--mc", "50000")
    walked = client.mc((0.1, 2.0, 0.0, 1.4), dipole_module.Grid(0.05, 8.0, 13, "logarithmic"),
                       photons=50_000, thickness=1.5)  # fmt: skip
    assert (column(rows[12:], "R") == walked.R[0]).all()


# ---- files ---------------------------------------------------------------------------------------


def test_pictures_with_and_without_a_name(tmp_path):
    run = dipole(*SKIN, "--plot", "--count", "9", "--plot=a.png", "--plot", cwd=tmp_path, quiet=False)
    assert run.stderr == 2 * "dipole plot: the picture is dipole.svg\n" and run.stdout == ""
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "dipole.svg"]
    check_png(tmp_path / "a.png")
    both = [*SKIN, "--plot", "a.svg", "--format", "csv"]
    assert dipole(*both, cwd=tmp_path).stdout == dipole(*SKIN, "--format", "csv").stdout
    run = dipole("eval", "--plot", "--nonsense", status=USAGE)
    assert "--nonsense: no such option" in run.stderr


def test_the_picture_of_the_readme_is_current(tmp_path):
    """`make figures` draws it with this command."""
    drawn, kept = tmp_path / "a.svg", REPOSITORY / "clients/cli/skin1.svg"
    arguments = ["--model", "classical,better,transport", "--error", "--plot", str(drawn)]
    dipole("plot", "--medium", "skin1", *arguments)
    assert sorted(svg_texts(drawn)) == sorted(svg_texts(kept))
    assert svg_lines(drawn) == svg_lines(kept) == 18


def test_names_are_no_commands(tmp_path):
    """A file name that starts with | is only a name. gnuplot itself would run it as a command."""
    dipole(*SKIN, "--plot", "|touch hit;.svg", cwd=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["|touch hit;.svg"]


def test_a_picture_that_fails_leaves_the_file_as_it_was(tmp_path):
    svg = tmp_path / "r.svg"
    svg.write_text("old")
    for name in (str(svg), "-"):
        run = dipole(*SKIN, "--plot", name, env={"PATH": str(tmp_path)}, status=FAILED)
        assert f"--plot {name}: gnuplot is not installed; install the package gnuplot-nox" in run.stderr
    fake = tmp_path / "gnuplot"
    for does in ("echo 'no fonts today' >&2; exit 3", "exit 0"):
        fake.write_text(f"#!/bin/sh\n{does}\n")
        fake.chmod(0o755)
        path = f"{tmp_path}:{os.environ['PATH']}"
        run = dipole(*SKIN, "--plot", str(svg), env={"PATH": path}, status=FAILED)
        assert ("no fonts today" in run.stderr) == ("fonts" in does) and "gnuplot failed" in run.stderr
    assert svg.read_text() == "old"
    run = dipole(*SKIN, "--plot", str(tmp_path / "none" / "r.svg"), status=FAILED)
    assert "cannot write it: No such file or directory" in run.stderr


# ---- text ----------------------------------------------------------------------------------------


def shown(*arguments: str, on: int = 1, **how) -> str:
    """Returns the text that a command writes to its terminal."""
    run = Terminal(*arguments, on=[on], **how)
    assert run.end()[0] == 0
    return run.seen


def test_text(tmp_path):
    """A drawing that gnuplot makes: panels below each other, a legend, and the caption."""
    first, second = script(tmp_path, *RED, "--axes", "gamma", "--error", "--count", "9", to="-")
    assert first.settings["terminal"] == "dumb nofeed size 80,21 mono noenhanced"
    assert first.settings["title"] == "skin1, red: R^(1/2.2) (R in 1/mm^2)"
    assert second.settings["title"] == "skin1, red: deviation from transport (%)"
    assert first.curves[0].style.startswith("1:2 with linespoints lt 0 pt '*' lc rgb")
    run = dipole(*SKIN, "--axes", "linear", "--r", "0.1,1,2", "--format", "table", "--plot", "-")
    table, _, drawing = run.stdout.partition(f"skin1: {R_LABEL}\n")
    assert "R red" in table and "numerical error" in table
    lines = drawing.splitlines()
    assert len(lines) <= 22 and max(map(len, lines)) <= 80 and not re.search("[ \f]\n", run.stdout)
    frame = [at for at, line in enumerate(lines) if re.search(r"\+-{60,}\+$", line)]
    assert len(frame) == 2
    inside = "\n".join(lines[frame[0] : frame[1]])
    assert all(mark in inside for mark in "*o+")
    legend = " ".join(" ".join(lines[frame[1] + 2 : -4]).split())
    assert legend == "r (mm) +..*..+better, red +..o..+better, green +..+..+better, blue"
    assert lines[-4:] == [
        "",
        "red: sigma_a 0.032/mm, sigma_s 0.74/mm, g 0, eta 1.3",
        "green: sigma_a 0.17/mm, sigma_s 0.88/mm, g 0, eta 1.3",
        "blue: sigma_a 0.48/mm, sigma_s 1.01/mm, g 0, eta 1.3",
    ]
    eval_ = ["eval", "--medium", "skin1", "--count", "60"]
    run = dipole(*eval_, "--plot", "-")
    assert run.stdout.startswith(dipole(*eval_).stdout) and "..*..+better, red" in run.stdout


COLOUR = r"\033\[38;5;(\d+)m"


def test_colours_on_a_terminal():
    text = shown(*SKIN)
    drawing, legend = text.split("r (mm)")
    colours = {mark: colour for colour, mark in re.findall(rf"{COLOUR}\+\.\.([*o+])\.\.\+", legend)}
    assert list(colours) == ["*", "o", "+"] and len(set(colours.values())) == 3
    for mark in "*o":
        drawn = set(re.findall(rf"{COLOUR}{re.escape(mark)}", drawing))
        assert drawn == {colours[mark]}
    assert re.search(COLOUR, shown(*SKIN, NO_COLOR=""))
    for env in ({"NO_COLOR": "1"}, {"TERM": "dumb"}):
        assert shown(*SKIN, **env) == dipole(*SKIN).stdout


@pytest.mark.parametrize("rows, columns", [(50, 132), (24, 50), (5, 10)])
def test_as_large_as_the_terminal(rows, columns):
    lines = shown(*SKIN, size=(rows, columns), NO_COLOR="1").splitlines()
    (frame,) = {len(line) for line in lines if line.endswith("-+")}
    assert max(columns, 32) - 6 <= frame <= max(columns, 32)
    wrapped = sum(max(1, -(-len(line) // columns)) for line in lines)
    assert wrapped <= rows - 1 if rows > 5 else len(lines) > 13


def test_a_bar_with_rate_and_time_left(daemon):
    """A proxy delays the answers of the first models until the bar is due."""
    asked = []

    def on_eval(number: int, request_id: int):
        asked.append(time.monotonic())
        return busy(request_id, 50) if asked[-1] - asked[0] < 2.1 else None

    with Proxy(daemon().url(), on_eval) as proxy:
        arguments = [*SKIN, "--model", "classical,better", "--connect", proxy.url]
        text = shown(*arguments, on=2)
    bar = r"\r\[#{20} {20}\]  50 %  [\d.e+]+ values, [\d.e+]+/s  0:\d\d left\033\[K"
    assert re.match(r"(\rwaiting for the daemon: +\d+ s\033\[K)*" + bar, text)
    assert text.endswith("\r\033[K")


# ---- wrong command lines -------------------------------------------------------------------------

@pytest.mark.parametrize(
    "arguments, said",
    [
        (["plot"], "give --medium NAME, or --sigma-a and --sigma-s"),
        ([*SKIN, "--axes", "log"], "--axes: 'log' is unknown; they are linear, semilog"),
        ([*SKIN, "--axes", ""], "--axes: '' is unknown"),
        ([*SKIN, "--axes", "gamma,linear,gamma"], "--axes: name gamma only once"),
        ([*SKIN, "--axes-gamma", "2"], "--axes-gamma changes nothing but the axes gamma: add"),
        ([*SKIN, "--axes", "gamma", "--axes-gamma", "0"], "--axes-gamma: give a number above 0"),
        ([*SKIN, "--axes", "gamma", "--axes-gamma", "inf"], "--axes-gamma: give a number above 0"),
        ([*SKIN, "--axes", "gamma", "--axes-gamma", "nan"], "--axes-gamma: give a number above 0"),
        ([*SKIN, "--quantity", "colour"], "--quantity: 'colour' is unknown; this daemon has R"),
        ([*SKIN, "--quantity", "albedo"], "--quantity albedo: there is no curve of it over r"),
        ([*SKIN, "--quantity", "r"], "--quantity r: there is no curve of it over r"),
        ([*SKIN, "--size", "900"], "--size 900: write WIDTHxHEIGHT, such as 900x600"),
        ([*SKIN, "--size", "x"], "--size x: write WIDTHxHEIGHT"),
        ([*SKIN, "--size", "900x600x2"], "--size 900x600x2: write WIDTHxHEIGHT"),
        ([*SKIN, "--size", "319x600"], "each side 320 to 8192 pixels"),
        ([*SKIN, "--size", "900x8193"], "each side 320 to 8192 pixels"),
        ([*SKIN, "--error", "--thickness", "1"], "which has no slabs: leave --thickness out"),
        ([*SKIN, "--plot", "r.pdf"], "--plot r.pdf: the name must end in .svg or .png; -"),
        ([*SKIN, "--plot", "-", "--format", "csv"], "--plot - draws onto standard output"),
        ([*SKIN, "--r", "1", "--to", "3"], "--r gives the radii one by one"),
        ([*SKIN, "--axes", "linear", "--log"], "--log needs --from, above 0"),
        ([*SKIN, "--model", "best"], "--model: 'best' is unknown; this daemon has classical, be"),
        ([*SKIN, "--channel", "pink"], "--channel: 'pink' is unknown; it is red, green or blue"),
        ([*SKIN, "--wanted", "R"], "--wanted: no such option"),
        ([*SKIN, "--mc", "0"], "--mc: give a whole number of photons"),
        ([*SKIN, "--mc", "1e3", "--r", "1,2"], "--mc needs rings, not single radii"),
        ([*SKIN, "--mc", "1e3", "--quantity", "cdf"], "--mc compares R: leave --quantity out"),
        ([*SKIN, "--mc", "1e3", "--count", "4097"], "--count: with --mc, give 1 to 4096 rings"),
        ([*SKIN, "--mc", "1e3", "--from", "3", "--to", "2"], "--mc: rings are from --from, 0 or"),
        (["plot", "--medium", "skin1,skin"], "--medium: 'skin' is unknown; this daemon has apple"),
        (["plot", "--medium", "skin1,"], "--medium: '' is unknown; this daemon has apple"),
        (["plot", "--sigma-a", "1", "--sigma-s", "1", "--channel", "red"], "give --medium too"),
        (["eval", "--medium", "skin1", "--plot", "-", "--format", "json"], "where the json goes"),
    ],
)
def test_wrong_command_lines_say_what_to_do(arguments, said):
    run = dipole(*arguments, status=USAGE)
    assert said in run.stderr and "--help` tells more" in run.stderr
    assert run.stdout == ""


test_what_cannot_be_drawn = says(FAILED, [*SKIN], [
    (["--to", "-1"], "bad-value: radius_stop: allowed: "),
    (["--to", "inf"], "bad-value: radius_stop: allowed: "),
    (["--from", "-1", "--axes", "linear"], "radius_start: allowed: "),
    (["--quantity", "dR_dr"], "dR_dr (1/mm^3) is 0, negative or infinite everywhere, which these ax"),
    (["--model", "single", "--r", "0"], "is 0, negative or infinite everywhere"),
])


def test_examples_work(tmp_path):
    text = dipole("plot", "--help").stdout.split("\nExamples\n")[1].replace("\\\n", " ")
    examples = [line.split() for line in text.splitlines()]
    assert len(examples) >= 4
    for words in examples:
        assert words[:2] == ["dipole", "plot"]
        run = dipole(*words[1:], cwd=tmp_path, quiet=False)
        assert (run.stdout == "") == ("--plot" in words)
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"skin1.svg", "dipole.svg", "a.png", "a.svg"}


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
    assert svg_lines(copied_build / "demo" / "skin1.svg") == 9
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
