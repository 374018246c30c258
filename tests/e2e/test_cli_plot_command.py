"""Pictures of `dipole plot`, in files and on a terminal."""

from __future__ import annotations

import json
import math
import re
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import dipole as dipole_module
import numpy as np
import pytest
from command_line import FAILED, USAGE, Proxy, Terminal, busy, dipole, eval_rows, read_csv, says
from daemons import REPOSITORY
from lists import everywhere
from pictures import SVG, check_png, path_points, png_size, style, svg_lines, svg_size, svg_texts

SKIN = ["plot", "--medium", "skin1"]
GAMMA = 2.2
UNIT = "1/mm^2 per unit of power that entered"


def draw(tmp_path: Path, *arguments: str, quiet: bool = True) -> ElementTree.Element:
    """Returns the SVG that a command draws."""
    svg = tmp_path / "r.svg"
    assert dipole(*arguments, "--plot", str(svg), quiet=quiet).stdout == ""
    return ElementTree.parse(svg).getroot()


def numbers(*arguments: str, quiet: bool = True) -> list[dict[str, str]]:
    """Returns the numbers that a command draws."""
    return read_csv(dipole(*arguments, "--format", "csv", quiet=quiet).stdout)


def column(rows: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name] or "nan") for row in rows])


# ---- axes ----------------------------------------------------------------------------------------


def assert_straight(pixels: np.ndarray, expected: np.ndarray) -> None:
    """Checks that pixels are a linear function of the expected values."""
    scale, offset = np.polyfit(expected, pixels, 1)
    assert np.abs(scale * expected + offset - pixels).max() < 0.1
    assert abs(scale) * np.ptp(expected) > 100  # The line is not just a dot.


AXES = {
    "linear": (lambda r: r, lambda R: R),
    "semilog": (lambda r: r, np.log10),
    "logarithmic": (np.log10, np.log10),
    "gamma": (lambda r: r, lambda R: R ** (1 / GAMMA)),
}


@pytest.mark.parametrize("axes", AXES)
def test_each_kind_of_axes(tmp_path, axes):
    arguments = [*SKIN, "--channel", "red", "--axes", axes, "--count", "30"]
    root = draw(tmp_path, *arguments)
    points = np.array(path_points(svg_lines(root)[0]))
    rows = numbers(*arguments)
    assert len(points) == len(rows) == 30
    on_r, on_value = AXES[axes]
    assert_straight(points[:, 0], on_r(column(rows, "r")))
    assert_straight(-points[:, 1], on_value(column(rows, "R")))
    texts = svg_texts(root)
    assert "r (mm)" in texts and "skin1" in texts and "red" in texts and "better" in texts
    assert (f"R ({UNIT})" in texts) == (axes != "gamma")
    assert ("R^(1/2.2) (R in 1/mm^2)" in texts) == (axes == "gamma")
    assert ("1e-03" in texts) == ("log" in axes)


def test_the_usual_axes_are_logarithmic(tmp_path):
    rows = numbers(*SKIN, "--channel", "red")
    assert len(rows) == 401
    assert float(rows[0]["r"]) == 0.01 and float(rows[-1]["r"]) == 10
    assert rows == numbers(*SKIN, "--channel", "red", "--axes", "logarithmic")
    points = path_points(svg_lines(draw(tmp_path, *SKIN, "--channel", "red"))[0])
    steps = np.diff([x for x, _ in points])
    assert np.ptp(steps) < 0.1


def test_radii_of_the_axes():
    assert float(numbers(*SKIN, "--axes", "gamma", "--to", "5")[0]["r"]) == 0
    assert float(numbers(*SKIN, "--axes", "gamma,logarithmic", "--to", "5")[0]["r"]) == 0.005
    linear = numbers(*SKIN, "--from", "0", "--count", "3", "--channel", "red")
    assert [row["r"] for row in linear] == ["0", "5", "10"]
    ratios = numbers(*SKIN, "--from", "0.1", "--count", "3", "--channel", "red")
    assert column(ratios, "r") == pytest.approx([0.1, 1, 10], rel=1e-14)
    listed = numbers(*SKIN, "--r", "2,1", "--channel", "red")
    assert [row["r"] for row in listed] == ["2", "1"]


def test_several_axes_and_an_error_below_each_other(tmp_path):
    models = ["classical", "better"]
    axes = ["--axes", "logarithmic,gamma", "--error"]
    root = draw(tmp_path, *SKIN, "--model", "classical,better", *axes)
    lines = svg_lines(root)
    assert len(lines) == 3 * len(models) * 3
    texts = svg_texts(root)
    for label in (f"R ({UNIT})", "R^(1/2.2) (R in 1/mm^2)", "deviation from transport (%)"):
        assert texts.count(label) == 1
    for model in models:
        for colour in ("red", "green", "blue"):
            assert texts.count(f"{model}, {colour}") == 1  # All panels share one legend.
    assert texts.count("r (mm)") == 3  # Each panel has one.
    styles = [style(line) for line in lines]
    assert len(set(styles)) == 6 and styles[:6] == styles[6:12] == styles[12:]
    tops = [min(y for _, y in path_points(line)) for line in lines[::6]]
    assert tops == sorted(tops)
    assert max(y for line in lines for _, y in path_points(line)) < svg_size(root)[1]


def test_a_panel_for_each_channel_of_many_models(tmp_path):
    arguments = [*SKIN, "--model", "all", "--error"]
    csv = dipole(*arguments, "--count", "5", "--format", "csv", quiet=False)
    models = list(dict.fromkeys(row["model"] for row in read_csv(csv.stdout)))
    assert set(models) <= set(everywhere()) and "transport" in models
    assert "gaussians is left out: " in csv.stderr and "(--from)" in csv.stderr
    root = draw(tmp_path, *arguments, quiet=False)
    assert len(svg_lines(root)) == 2 * 3 * len(models)
    texts = svg_texts(root)
    assert texts.count("r (mm)") == 6 and texts.count("deviation from transport (%)") == 1
    for text in ("red", "green", "blue", *models):
        assert texts.count(text) == 1


def test_a_peak_leaves_a_linear_axis(tmp_path):
    """The peak of single scattering near r = 0 does not set the range of a linear axis, because it
    would hide everything else."""
    root = draw(tmp_path, *SKIN, "--model", "single", "--channel", "red", "--axes", "linear")
    tics = [float(text) for text in svg_texts(root) if re.fullmatch(r"[\d.]+", text)]
    rows = numbers(*SKIN, "--model", "single", "--channel", "red", "--axes", "linear")
    r, R = column(rows, "r"), column(rows, "R")
    assert R[0] == math.inf
    assert R[r >= 0.2].max() < 1.1 < R[1]
    values = sorted(tic for tic in tics if tic < 1.1)
    assert R[r >= 0.2].max() / 2 < values[-1] < R[r >= 0.2].max() * 1.1


# ---- quantities ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "quantity, label",
    [
        ("cdf", "cdf"),
        ("pdf", "pdf (1/mm)"),
        ("2_pi_r_R", "2_pi_r_R (1/mm)"),
        ("dR_dr", "dR_dr (1/mm^3)"),
        ("ln_R", "ln_R (ln(1/mm^2))"),
        ("S", "S (1/(mm^2 sr))"),
    ],
)
def test_quantities(tmp_path, quantity, label):
    arguments = [*SKIN, "--channel", "blue", "--quantity", quantity, "--axes", "linear"]
    arguments += ["--count", "25", "--from", "0.5"]
    root = draw(tmp_path, *arguments)
    assert label in svg_texts(root)
    rows = numbers(*arguments)
    values = column(rows, quantity)
    direct = ["--medium", "skin1", "--wanted", quantity, "--count", "25", "--from", "0.5"]
    other = [row for row in eval_rows(*direct) if row["channel"] == "blue"]
    assert (values == column(other, quantity)).all()
    points = np.array(path_points(svg_lines(root)[0]))
    assert_straight(-points[:, 1], values)


def test_gamma(tmp_path):
    arguments = [*SKIN, "--axes", "gamma", "--count", "20", "--format", "csv"]
    rows = read_csv(dipole(*arguments).stdout)
    assert column(rows, "R^(1/2.2)") == pytest.approx(column(rows, "R") ** (1 / 2.2), rel=1e-14)
    rows = read_csv(dipole(*arguments, "--axes-gamma", "3", "--quantity", "cdf").stdout)
    assert column(rows, "cdf^(1/3)") == pytest.approx(column(rows, "cdf") ** (1 / 3), rel=1e-14)
    text = dipole(*arguments[:-1], "json", "--axes-gamma", "3", "--quantity", "cdf").stdout
    assert json.loads(text)["units"]["cdf^(1/3)"] == "cdf"


# ---- the deviation from transport ----------------------------------------------------------------


@pytest.mark.parametrize("quantity", ["R", "dR_dr", "cdf"])
def test_the_error_is_that_of_direct_evaluation(tmp_path, quantity):
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
    root = draw(tmp_path, *arguments, "--model", "better", "--channel", "red")
    points = np.array(path_points(svg_lines(root)[1]))
    mine = [row for row in rows if (row["model"], row["channel"]) == ("better", "red")]
    assert_straight(-points[:, 1], column(mine, "deviation"))


def test_transport_is_drawn_when_named():
    rows = numbers(*SKIN, "--model", "better,transport", "--error", "--count", "5")
    deviations = {float(row["deviation"]) for row in rows if row["model"] == "transport"}
    assert deviations == {0.0}


def test_transport_takes_what_it_can_of_the_parameters():
    arguments = [*SKIN, "--model", "gaussians", "--gaussians", "4", "--from", "0.5", "--to", "3"]
    rows = numbers(*arguments, "--error", "--count", "5")
    assert len(rows) == 15 and np.isfinite(column(rows, "deviation")).all()


def test_the_error_of_what_a_tolerance_chooses():
    rows = numbers(*SKIN, "--tolerance", "0.01", "--error", "--count", "5")
    assert np.abs(column(rows, "deviation")).max() <= 0.01
    assert len({row["model"] for row in rows}) == 1


def test_no_error_where_transport_does_not_hold():
    """Transport sees sigma_s (1 - g) of a medium beyond its table: that is no truth."""
    media = ["plot", "--sigma-a", "0.05,0.05", "--sigma-s", "50,9.5", "--eta", "1.4"]
    media += ["--model", "better"]
    rows = numbers(*media, "--g", "0.99,0.9", "--error", "--count", "5", quiet=False)
    assert {row["channel"] for row in rows if row["deviation"]} == {"2"}
    run = dipole(*media, "--g", "0.99", "--error", status=FAILED)
    assert "transport is not known to hold" in run.stderr and run.stdout == ""
    assert numbers(*media, "--g", "0.99", "--count", "5")


def test_no_transport_no_error():
    medium = ["plot", "--sigma-a", "0.1", "--sigma-s", "1", "--eta", "5"]
    run = dipole(*medium, "--error", status=FAILED)
    assert "transport is left out: bad-value: eta: " in run.stderr
    assert "nothing to compare with: leave --error out" in run.stderr
    assert run.stdout == ""


# ---- media ---------------------------------------------------------------------------------------


def test_several_media(tmp_path):
    few = ["--channel", "green", "--count", "9"]
    rows = numbers("plot", "--medium", "marble,wholemilk", *few)
    assert [row["channel"] for row in rows[::9]] == ["marble green", "wholemilk green"]
    for name in ("marble", "wholemilk"):
        mine = [row["R"] for row in rows if row["channel"] == f"{name} green"]
        assert mine == [row["R"] for row in numbers("plot", "--medium", name, *few)]
    texts = svg_texts(draw(tmp_path, "plot", "--medium", "marble,wholemilk", *few))
    assert "better, marble green" in texts and "better, wholemilk green" in texts
    assert "marble,wholemilk" in texts


def test_eta_of_several_media():
    media = ["--medium", "marble,skin1", "--channel", "red,blue", "--r", "1"]
    rows = eval_rows(*media, "--eta", "1.1,1.2,1.3,1.4")
    assert [row["eta"] for row in rows] == ["1.1", "1.2", "1.3", "1.4"]
    names = ["marble red", "marble blue", "skin1 red", "skin1 blue"]
    assert [row["channel"] for row in rows] == names
    run = dipole("eval", *media, "--eta", "1,2,3", status=USAGE)
    assert "--eta has 3 values and --medium has 4" in run.stderr


def test_the_colours_of_few_channels(tmp_path):
    arguments = [*SKIN, "--channel", "green,blue"]
    two = [style(line) for line in svg_lines(draw(tmp_path, *arguments))]
    three = [style(line) for line in svg_lines(draw(tmp_path, *SKIN))]
    assert two == three[1:]


# ---- files and formats ---------------------------------------------------------------------------


def test_png_svg_and_numbers_in_one_run(tmp_path):
    svg, png = tmp_path / "a.svg", tmp_path / "b.png"
    run = dipole(*SKIN, "--plot", str(svg), "--plot", str(png), "--format", "csv")
    assert run.stdout == dipole(*SKIN, "--format", "csv").stdout
    check_png(png)
    assert len(svg_lines(ElementTree.parse(svg).getroot())) == 3


def test_sizes(tmp_path):
    png = tmp_path / "r.png"
    for size in ("320x320", "1234x567"):
        dipole(*SKIN, "--model", "classical,better", "--error", "--size", size, "--plot", str(png))
        assert png_size(png) == tuple(map(int, size.split("x")))
    root = draw(tmp_path, *SKIN, "--model", "all", "--size", "900x400", quiet=False)
    assert svg_size(root) == (900, 400)
    assert len(svg_lines(root)) == 3 * sum(text in everywhere() for text in svg_texts(root))


def test_a_picture_without_a_name(tmp_path):
    run = dipole(*SKIN, "--plot", cwd=tmp_path, quiet=False)
    assert run.stderr == "dipole plot: the picture is dipole.svg\n" and run.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["dipole.svg"]


def test_a_table_and_a_drawing():
    run = dipole(*SKIN, "--axes", "gamma", "--format", "table", "--count", "3", "--plot", "-")
    table, _, drawing = run.stdout.partition("skin1: R^(1/2.2) (R in 1/mm^2)\n")
    assert "R^(1/2.2) red" in table and "numerical error" in table
    assert "better, blue\n\nred: sigma_a 0.032/mm" in drawing


def test_the_picture_of_the_readme_is_current(tmp_path):
    """`make figures` draws it with this command."""
    drawn, kept = tmp_path / "a.svg", REPOSITORY / "clients/cli/skin1.svg"
    arguments = ["--model", "classical,better,transport", "--error", "--plot", str(drawn)]
    dipole("plot", "--medium", "skin1", *arguments)
    texts = [sorted(svg_texts(ElementTree.parse(path).getroot())) for path in (drawn, kept)]
    assert texts[0] == texts[1]
    assert "red: sigma_a 0.032/mm, sigma_s 0.74/mm, g 0, eta 1.3" in texts[0]


def test_without_gnuplot(tmp_path):
    for name in (str(tmp_path / "r.svg"), "-"):
        run = dipole(*SKIN, "--plot", name, env={"PATH": str(tmp_path)}, status=FAILED)
        assert f"--plot {name}: gnuplot is not installed; install the package gnuplot-nox" in run.stderr


# ---- text ----------------------------------------------------------------------------------------


def inside(lines: list[str]) -> tuple[int, list[str]]:
    """Returns the first panel of a drawing in text: the column where the inside of its frame
    begins, and its rows."""
    first, last = [at for at, line in enumerate(lines) if re.search(r"\+-{10,}\+$", line)][:2]
    left = lines[first].index("+-") + 1
    assert lines[last].index("+-") + 1 == left
    return left, [line[left:-1] for line in lines[first + 1 : last]]


def tics(lines: list[str]) -> list[tuple[int, float]]:
    """Returns the labelled rows inside the first panel, with their labels. Row -1 is the upper
    end."""
    left, rows = inside(lines)
    top = next(at for at, line in enumerate(lines) if re.search(r"\+-{10,}\+$", line))
    labels = [line[: left - 1].strip() for line in lines[top : top + len(rows) + 2]]
    return [(at - 1, float(label)) for at, label in enumerate(labels) if label]


@pytest.mark.parametrize("axes", AXES)
def test_marks_stand_where_the_values_are(axes):
    arguments = [*SKIN, "--channel", "red", "--axes", axes, "--count", "30"]
    lines = dipole(*arguments, "--plot", "-").stdout.splitlines()
    assert len(lines) <= 23 and max(map(len, lines)) <= 80
    _, rows = inside(lines)
    columns = len(rows[0])
    on_r, on_value = AXES[axes]
    marked = tics(lines)
    assert len(marked) >= 3
    labels = np.array([value for _, value in marked])
    values = numbers(*arguments)
    r = on_r(column(values, "r"))
    shown = on_value(column(values, "R"))
    # The labels of gamma axes are powers of the values.
    heights = labels if axes == "gamma" else on_value(labels)
    scale, offset = np.polyfit(heights, [row for row, _ in marked], 1)
    # The first and the last radius are at the sides of the frame.
    x = np.rint((r - r[0]) / (r[-1] - r[0]) * (columns + 1)).astype(int) - 1
    y = scale * shown + offset
    checked = 0
    for at, row in zip(x[1:-1], y[1:-1]):
        if 0.5 < row < len(rows) - 1.5:
            near = [rows[k][c] for k in range(len(rows)) if abs(k - row) <= 1.2
                    for c in range(max(at - 1, 0), min(at + 2, columns))]
            assert "*" in near, (at, row, lines)
            checked += 1
    assert checked >= 8
    assert lines[-3].split() == ["+..*..+better"]
    assert lines[-2:] == ["", "red: sigma_a 0.032/mm, sigma_s 0.74/mm, g 0, eta 1.3"]


def test_curves_have_marks_and_a_legend():
    lines = dipole(*SKIN, "--model", "classical,better").stdout.splitlines()
    assert lines[0].strip() == f"skin1: R ({UNIT})"
    assert set("*o+x#@") <= set("".join(inside(lines)[1]))
    legend = " ".join(lines[-6:-4])
    assert sorted(re.findall(r"\+\.\.(\S)\.\.\+(\w+, \w+)", legend)) == sorted([
        ("*", "classical, red"),
        ("o", "classical, green"),
        ("+", "classical, blue"),
        ("x", "better, red"),
        ("#", "better, green"),
        ("@", "better, blue"),
    ])


def test_panels_follow_each_other_on_a_terminal():
    run = dipole(*SKIN, "--model", "all", "--axes", "gamma", "--error", "--plot", "-", quiet=False)
    titles = [line.strip() for line in run.stdout.splitlines() if "skin1, " in line]
    assert titles == [
        f"skin1, {colour}: {label}"
        for colour in ("red", "green", "blue")
        for label in ("R^(1/2.2) (R in 1/mm^2)", "deviation from transport (%)")
    ]
    assert "\f" not in run.stdout and " \n" not in run.stdout


def test_eval_draws_text_too():
    eval_ = ["eval", "--medium", "skin1", "--count", "60"]
    table = dipole(*eval_).stdout
    run = dipole(*eval_, "--plot", "-")
    assert run.stdout.startswith(table)
    drawing = run.stdout[len(table) :].splitlines()
    assert drawing[0].strip() == f"skin1: R ({UNIT})"
    assert len(inside(drawing)[1]) >= 8 and "..*..+better, red" in drawing[-5]
    assert drawing[-3:] == [
        "red: sigma_a 0.032/mm, sigma_s 0.74/mm, g 0, eta 1.3",
        "green: sigma_a 0.17/mm, sigma_s 0.88/mm, g 0, eta 1.3",
        "blue: sigma_a 0.48/mm, sigma_s 1.01/mm, g 0, eta 1.3",
    ]


def test_the_caption_fits_a_narrow_terminal():
    """A medium with g has a note. Both are broken at blanks."""
    medium = ["--sigma-a", "0.05", "--sigma-s", "9", "--g", "0.9", "--eta", "1.4"]
    lines = shown("plot", *medium, "--model", "better", size=(30, 40), NO_COLOR="1").splitlines()
    assert max(map(len, lines)) <= 40 and len(lines) <= 29
    caption = " ".join(lines[-4:])
    values = "channel 1: sigma_a 0.05/mm, sigma_s 9/mm, g 0.9, eta 1.4"
    assert caption.startswith(f"{values} similarity: ")


def shown(*arguments: str, on: int = 1, **how) -> str:
    """Returns the text that a command writes to its terminal."""
    run = Terminal(*arguments, on=[on], **how)
    assert run.end()[0] == 0
    return run.seen


COLOUR = r"\033\[38;5;(\d+)m"


def plain(text: str) -> str:
    """Returns a text without colours and without blanks at line ends."""
    bare = re.sub(r"\033\[[\d;]*m", "", text)
    assert "\033" not in bare
    return "".join(line.rstrip() + "\n" for line in bare.splitlines()).rstrip("\n") + "\n"


def test_colours_on_a_terminal():
    text = shown(*SKIN)
    assert plain(text) == dipole(*SKIN).stdout
    drawing, legend = text.split("r (mm)")
    colours = {mark: colour for colour, mark in re.findall(rf"{COLOUR}\+\.\.([*o+])\.\.\+", legend)}
    assert list(colours) == ["*", "o", "+"] and len(set(colours.values())) == 3
    for mark in "*o":
        drawn = set(re.findall(rf"{COLOUR}{re.escape(mark)}", drawing))
        assert drawn == {colours[mark]}


@pytest.mark.parametrize("env", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_no_colours(env):
    assert shown(*SKIN, **env) == dipole(*SKIN).stdout


def test_an_empty_no_color_is_none():
    assert re.search(COLOUR, shown(*SKIN, NO_COLOR=""))


@pytest.mark.parametrize("rows, columns", [(50, 132), (24, 80), (20, 50)])
def test_as_large_as_the_terminal(rows, columns):
    lines = shown(*SKIN, size=(rows, columns), NO_COLOR="1").splitlines()
    frame = {len(line) for line in lines if line.endswith("-+")}
    assert len(frame) == 1 and columns - 6 <= frame.pop() <= columns
    assert max(map(len, lines)) <= columns and rows - 2 <= len(lines) <= rows - 1


def test_a_tiny_terminal_gets_what_can_be_read():
    lines = shown(*SKIN, size=(5, 10), NO_COLOR="1").splitlines()
    _, rows = inside(lines)
    assert len(rows) >= 4 and len(rows[0]) >= 16


# ---- long work -----------------------------------------------------------------------------------


def test_a_bar_with_rate_and_time_left(daemon):
    """A proxy delays the answers of the first models until the bar is due."""
    start = time.monotonic()

    def on_eval(number: int, request_id: int):
        return busy(request_id, 50) if time.monotonic() - start < 2.1 else None

    with Proxy(daemon().url(), on_eval) as proxy:
        arguments = [*SKIN, "--model", "classical,better", "--connect", proxy.url]
        text = shown(*arguments, on=2)
    bar = r"\r\[#{20} {20}\]  50 %  [\d.e+]+ values, [\d.e+]+/s  0:0[23] left\033\[K"
    assert re.match(r"(\rwaiting for the daemon: +\d+ s\033\[K)*" + bar, text)
    assert text.endswith("\r\033[K")


# ---- Monte Carlo ---------------------------------------------------------------------------------

RINGS = ["--from", "0.05", "--to", "8", "--count", "12"]


@pytest.mark.parametrize("scale", ["logarithmic", "linear"])
def test_monte_carlo_beside_means_of_models(client, scale):
    """The numbers are those of the Python client's ring_means() and mc()."""
    arguments = [*SKIN, "--model", "better,transport", "--axes", scale, *RINGS, "--mc", "50000"]
    rows = numbers(*arguments, "--error", "--evaluator", "f64")
    edges = dipole_module.Grid(0.05, 8.0, 13, scale)
    skin = client.media()["skin1"]
    reference = client.ring_means("transport", "skin1", edges)
    middle = np.sqrt((reference.edges[1:] ** 2 + reference.edges[:-1] ** 2) / 2)
    for model in ("better", "transport", "mc"):
        for i, colour in enumerate(("red", "green", "blue")):
            of = [row for row in rows if (row["model"], row["channel"]) == (model, colour)]
            np.testing.assert_allclose(column(of, "r"), middle, 1e-12)
            if model == "mc":
                walked = client.mc(skin[i], edges, photons=50_000)
                R, error = walked.R[0], walked.R_error[0]
                assert (column(of, "R_error") == error).all()
            else:
                R = client.ring_means(model, skin[i], edges).R[0]
                assert np.isnan(column(of, "R_error")).all()
            np.testing.assert_allclose(column(of, "R"), R, 1e-12)
            np.testing.assert_allclose(column(of, "deviation"), R / reference.R[i] - 1, atol=1e-9)


def test_monte_carlo_has_points_with_errors(tmp_path):
    """The bars are those of the numbers: one standard error up and down."""
    arguments = [*SKIN, "--channel", "red", *RINGS, "--axes", "linear", "--mc", "20000", "--error"]
    root = draw(tmp_path, *arguments, "--model", "transport")
    assert "mc" in svg_texts(root)
    rows = [row for row in numbers(*arguments) if row["model"] == "mc"]
    expected = 2 * column(rows, "R_error") / column(rows, "R") * (1 + column(rows, "deviation"))
    paths = " ".join(path.get("d", "") for path in svg_lines(root)[3].iter(f"{SVG}path"))
    corners = re.findall(r"([ML])\s*([\d.]+),([\d.]+)", paths)
    bars = {}  # by their place: the lengths of vertical lines
    for (_, x, y), (letter, to_x, to_y) in zip(corners, corners[1:]):
        if letter == "L" and x == to_x:
            bars[float(x)] = max(bars.get(float(x), 0), abs(float(y) - float(to_y)))
    lengths = np.array([length for _, length in sorted(bars.items())])
    assert len(lengths) == len(rows) == 12
    inside = slice(0, 10)  # The bars of the last two may end at the frame.
    assert np.corrcoef(lengths[inside], expected[inside])[0, 1] > 0.99


def test_monte_carlo_of_a_slab(client):
    medium = ["plot", "--sigma-a", "0.1", "--sigma-s", "2", "--eta", "1.4", "--thickness", "1.5"]
    rows = numbers(*medium, "--model", "better-multipole", *RINGS, "--mc", "50000")
    walked = client.mc((0.1, 2.0, 0.0, 1.4), dipole_module.Grid(0.05, 8.0, 13, "logarithmic"),
                       photons=50_000, thickness=1.5)  # fmt: skip
    assert (column(rows[12:], "R") == walked.R[0]).all()


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
    (["--quantity", "dR_dr"], "dR_dr is negative, 0 or infinite at every radius: a log"),
    (["--model", "single", "--r", "0"], "R is 0 or infinite at every radius: a log"),
    (["--r", "inf", "--axes", "linear"], "R is not a finite number at any radius"),
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
