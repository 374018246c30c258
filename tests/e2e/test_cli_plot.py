"""Pictures of `dipole plot` and `dipole eval --plot`: what gnuplot gets, and text on a terminal.
tests/cli/plot.t has pictures that it draws, and the demonstration."""

import re
import time

import dipole as dipole_module
import numpy as np
import pytest
from command_line import Proxy, Terminal, busy, dipole, eval_rows
from pictures import script

SKIN = ["plot", "--medium", "skin1"]
RINGS = ["--from", "0.05", "--to", "8", "--count", "12"]


# ---- what gnuplot gets ---------------------------------------------------------------------------


def column(rows: list[dict[str, str]], name: str) -> np.ndarray:
    return np.array([float(row[name] or "nan") for row in rows])


def test_curves_and_deviations(tmp_path):
    """The values are those of `dipole eval`, and infinite ones are left out."""
    radii = ["--from", "0.1", "--to", "5", "--count", "9"]
    models = ["--model", "classical,transport", "--wanted", "dR_dr,R", "--log"]
    names, curves = script(tmp_path, *SKIN, *models[:2], *radii, "--error")
    rows = eval_rows("--medium", "skin1", *models, *radii)
    assert (names["heading"], names["log_x"], names["log_y"], names["lower"]) == ("skin1", "1", "1", "1")
    assert names["y_label"] == "R (1/mm^2 per unit of power that entered)"
    assert (names["D[1]"], names["D[4]"], names["C[1]"] == names["C[4]"]) == ("1", "2", True)
    assert list(curves) == [f"{model}, {colour}" for model in ("classical", "transport")
                            for colour in ("red", "green", "blue")]  # fmt: skip
    for title, data in curves.items():
        of = [row for row in rows if f"{row['model']}, {row['channel']}" == title]
        true = [row for row in rows if (row["model"], row["channel"]) == ("transport", of[0]["channel"])]
        R, transport = column(of, "R"), column(true, "R")
        expected = [column(of, "r"), R, 0 * R, 100 * (R / transport - 1)]
        np.testing.assert_allclose(data[:, :4].T, expected, 1e-12, 1e-11)
    names, curves = script(tmp_path, "eval", *SKIN[1:], "--model", "transport", "--r", "0,1,inf")
    assert np.isnan(curves["transport, red"][0, 1]) and names["log_x"] == "0"
    names, curves = script(tmp_path, *SKIN, "--model", "single", "--axes", "linear", "--f", "0,1",
                           "--quantity", "R_f")  # fmt: skip
    assert (names["x_label"], names["y_label"], names["log_y"]) == ("f (1/mm)", "R_f (1)", "0")


@pytest.mark.parametrize("scale", ["logarithmic", "linear"])
def test_monte_carlo_beside_means_of_models(tmp_path, client, scale):
    """The numbers are those of the Python client's mc(), and integrals of its R over the rings."""
    edges = dipole_module.Grid(0.05, 8.0, 13, scale)
    how = ["--channel", "red", "--axes", scale, *RINGS, "--mc", "50000", "--error", "--evaluator", "f64"]
    names, curves = script(tmp_path, *SKIN, "--model", "better,transport", *how)
    assert list(curves) == ["better", "transport", "mc"] and (names["lines"], names["curves"]) == ("2", "3")
    skin = client.media()["skin1"][0]
    at = (np.geomspace if scale == "logarithmic" else np.linspace)(0.05, 8.0, 13)
    areas = np.pi * np.diff(at**2)
    x, weights = np.polynomial.legendre.leggauss(40)
    nodes = at[:-1, None] + np.diff(at)[:, None] * (1 + x) / 2

    def means(model: str) -> np.ndarray:
        values = client.eval(model, skin, nodes.ravel(), wanted="2_pi_r_R").two_pi_r_R
        return (values.reshape(nodes.shape) * weights).sum(axis=1) * np.diff(at) / 2 / areas

    reference = means("transport")
    for model, data in curves.items():
        walked = client.mc(skin, edges, photons=50_000) if model == "mc" else None
        R = walked.R[0] if walked else means(model)
        middle = np.sqrt((at[1:] ** 2 + at[:-1] ** 2) / 2)
        np.testing.assert_allclose(data[:, 0], middle, 1e-12)
        np.testing.assert_allclose(data[:, 1], R, 1e-6)
        np.testing.assert_allclose(data[:, 3], 100 * (R / reference - 1), atol=1e-4)
        if walked:
            np.testing.assert_allclose(data[:, 2], walked.R_error[0], 1e-14)
            np.testing.assert_allclose(data[:, 4], 100 * walked.R_error[0] / reference, 1e-6)
    slab = ["plot", "--sigma-a", "0.1", "--sigma-s", "2", "--eta", "1.4", "--thickness", "1.5"]
    _, curves = script(tmp_path, *slab, "--model", "better-multipole", *RINGS, "--mc", "50000")
    rings = dipole_module.Grid(0.05, 8.0, 13, "logarithmic")
    walked = client.mc((0.1, 2.0, 0.0, 1.4, 1.5), rings, photons=50_000)
    assert (curves["mc"][:, 1] == walked.R[0]).all()


# ---- text ----------------------------------------------------------------------------------------


def shown(*arguments: str, on: int = 1, **how) -> str:
    """Returns the text that a command writes to its terminal."""
    run = Terminal(*arguments, on=[on], **how)
    assert run.end()[0] == 0
    return run.seen


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
