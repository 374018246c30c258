"""`dipole bake`: what a file says of its error is what a program finds that reads nothing but the file,
with the profile R(r) of the medium that the file names."""

import json
import math
import subprocess
from pathlib import Path

import numpy as np
import PyOpenColorIO
import pytest
from command_line import PROGRAM, dipole
from daemons import environment

rng = np.random.default_rng(43)
MEDIA = [
    {"scattered": float(rng.uniform(0.3, 0.999)), "path": float(rng.uniform(0.2, 3)), "g": g, "eta": eta}
    for g, eta in ((0, 1), (0, 1.4), (0.8, 1.33), (0.8, 1.5))
]
NAMES = [f"{one['scattered']:.3f} g {one['g']} eta {one['eta']}" for one in MEDIA]


def bake(kind: str, medium: dict[str, float], *more: str) -> dict:
    sigma_t = 1 / medium["path"]
    coefficients = {
        "--sigma-a": sigma_t * (1 - medium["scattered"]), "--sigma-s": sigma_t * medium["scattered"],
        "--g": medium["g"], "--eta": medium["eta"],
    }  # fmt: skip
    arguments = [text for name, value in coefficients.items() for text in (name, repr(value))]
    return json.loads(dipole("bake", kind, *arguments, "--format", "json", *more).stdout)


def edge_of(client, file: dict, channel: int):
    """The edge response, by the line spread: the integral of R over lines, then over distances."""
    medium = [file[name][channel] for name in ("sigma_a", "sigma_s", "g", "eta")]
    path = 1 / (medium[0] + medium[1] * (1 - medium[2]))
    r = np.geomspace(1e-5, 200, 3000) * path
    found = client.eval("transport", [medium], r, evaluator="f64", wanted=["R", "albedo"])
    R = np.maximum(np.asarray(found.quantities["R"])[0], 1e-300)
    x = np.concatenate([[0], np.geomspace(1e-4, 100, 1000) * path])
    t = np.linspace(0, 14, 700)  # along the line y = x sinh t
    far = x[1:, None] * np.cosh(t)
    values = np.where(far < r[-1], np.exp(np.interp(np.log(far), np.log(r), np.log(R))), 0)
    spread = 2 * np.trapz(values * far, t, axis=1)
    steps = np.diff(x) * (spread + np.concatenate([spread[:1], spread[:-1]])) / 2
    half = np.concatenate([[0], np.cumsum(steps)])
    assert 2 * half[-1] == pytest.approx(file["colour"][channel], rel=2e-3)
    half /= 2 * half[-1]
    return lambda at: 0.5 + np.sign(at) * np.interp(np.abs(at), x, half)


@pytest.mark.parametrize("medium", MEDIA, ids=NAMES)
def test_a_kernel_blurs_an_edge_as_it_says(client, medium):
    taps = int(rng.choice([11, 17, 25, 33]))
    file = bake("kernel", medium, "--taps", str(taps))
    rows = np.array(file["rows"])
    weights, offsets = rows[:, 0], rows[:, 3]
    assert len(rows) == taps and weights.sum() == pytest.approx(1, abs=1e-7)
    # Light behind an edge, seen by taps that take what lies half the way to their neighbours.
    middles = (offsets[1:] + offsets[:-1]) / 2
    ends = np.concatenate([[2 * offsets[0] - middles[0]], middles, [2 * offsets[-1] - middles[-1]]])
    x = np.linspace(-3, 3, 6001) * offsets[-1] / 2
    lit = np.clip((x[:, None] - ends[:-1]) / np.diff(ends), 0, 1) @ weights
    found = np.abs(lit - edge_of(client, file, 0)(x)).max()
    assert 0.9 * file["edge_error"][0] - 2e-4 < found <= file["edge_error"][0]
    assert weights.max() == pytest.approx(file["step"][0], rel=1e-6)


@pytest.mark.parametrize("medium", MEDIA, ids=NAMES)
def test_burleys_profile_meets_an_edge_as_it_says(client, medium):
    file = bake("burley", medium)
    d = file["rows"][0][0]
    # The edge of (e^-r/d + e^-r/3d) / (8 pi d r), from its line spread (K0(x/d) + K0(x/3d)) / 4 pi d.
    x = np.concatenate([[0], np.geomspace(1e-4, 60, 1500) * d])
    t = np.linspace(0, 14, 900)
    along = np.cosh(t)
    spread = np.array([np.trapz(np.exp(-at / d * along) + np.exp(-at / (3 * d) * along), t) for at in x[1:]])
    spread /= 4 * np.pi * d
    steps = np.diff(x) * (spread + np.concatenate([spread[:1], spread[:-1]])) / 2
    half = np.concatenate([[0], np.cumsum(steps)])
    assert half[-1] == pytest.approx(0.5, abs=1e-3)
    found = np.abs(0.5 + half - edge_of(client, file, 0)(x)).max()
    assert found == pytest.approx(file["edge_error"][0], rel=0.1, abs=5e-4)


@pytest.mark.parametrize("medium", MEDIA, ids=NAMES)
def test_gaussians_meet_an_edge_as_they_say(client, medium):
    file = bake("gaussians", medium, "--count", str(rng.integers(2, 13)))
    rows = np.array(file["rows"])
    shares, variances = rows[:, 0], rows[:, 3]
    assert shares.min() >= 0 and shares.sum() == pytest.approx(1, abs=1e-7)
    x = np.concatenate([[0], np.geomspace(1e-3, 60, 1500) * medium["path"] / (1 - medium["g"])])
    error = np.vectorize(math.erf)(x[:, None] / np.sqrt(2 * variances))
    found = np.abs(0.5 + error @ shares / 2 - edge_of(client, file, 0)(x)).max()
    assert 0.9 * file["edge_error"][0] - 4e-4 < found <= file["edge_error"][0]


@pytest.mark.parametrize("medium", MEDIA, ids=NAMES)
def test_a_profile_is_interpolated_as_it_says(client, medium):
    """By texels that a sampler interpolates along the root of r, against R and its integral."""
    file = bake("profile", medium, "--size", str(rng.integers(16, 200)))
    r, R, cdf = np.array(file["rows"])[:, [0, 1, 4]].T
    u = np.sqrt(r / r[0])
    assert u == pytest.approx(np.arange(1, 2 * len(r), 2)) and file["beyond"][0] == pytest.approx(1 - cdf[-1])
    between = r[0] * ((u[1:] + u[:-1]) / 2) ** 2
    fine = np.unique(np.concatenate([np.geomspace(1e-4 * r[0], r[-1], 6000), r, between]))
    coefficients = [file[name][0] for name in ("sigma_a", "sigma_s", "g", "eta")]
    true = np.asarray(client.eval("transport", [coefficients], fine, evaluator="f64", wanted=["R"]).quantities["R"])[0]
    ring = 2 * np.pi * fine * true / file["colour"][0]
    within = np.concatenate([[0], np.cumsum(np.diff(fine) * (ring[1:] + ring[:-1]) / 2)]) + ring[0] * fine[0]
    middles = np.searchsorted(fine, between)
    off = np.abs((r[1:] * R[1:] + r[:-1] * R[:-1]) / 2 / (between * true[middles]) - 1).max()
    assert off == pytest.approx(file["R_error"][0], rel=0.1)
    off = np.abs((cdf[1:] + cdf[:-1]) / 2 - within[middles]).max()
    assert off == pytest.approx(file["cdf_error"][0], rel=0.1, abs=3e-5)


def sphere(R, r, radius: float, cosines):
    """What a sphere returns at places, by sums over its whole surface; r: chords of known R. A ring has
    the light A + B cos phi, where that is positive."""
    polar = np.concatenate([np.geomspace(1e-5, 0.1, 250), np.linspace(0.1, np.pi, 401)[1:]])
    chord = 2 * radius * np.sin(polar / 2)
    weight = np.exp(np.interp(np.log(chord), np.log(r), np.log(R))) * np.sin(polar)
    cosine = np.asarray(cosines)[:, None]
    A, B = cosine * np.cos(polar), np.sqrt(1 - cosine**2) * np.sin(polar)
    end = np.arccos(np.clip(-A / np.maximum(B, 1e-300), -1, 1))
    ring = (A * end + B * np.sin(end)) / np.pi
    return np.trapz(weight * ring, polar, axis=1) / np.trapz(weight, polar)


@pytest.mark.parametrize("medium", MEDIA, ids=NAMES)
def test_a_sphere_is_lit_as_the_table_says(client, medium):
    file = bake("lut", medium, "--size", "16")
    rows = np.array(file["rows"]).reshape(16, 16, 5)
    coefficients = [file[name][0] for name in ("sigma_a", "sigma_s", "g", "eta")]
    r = np.geomspace(1e-5, 1e3, 3000) * medium["path"]
    found = client.eval("transport", [coefficients], r, evaluator="f64", wanted=["R"])
    R = np.maximum(np.asarray(found.quantities["R"])[0], 1e-300)
    for row in rows:
        assert sphere(R, r, 1 / row[0, 1], row[:, 0]) == pytest.approx(row[:, 2], abs=3e-3)
    # Half the way between texels, along one axis and along both.
    between = [(rows[:, 1:] + rows[:, :-1]) / 2, (rows[1:] + rows[:-1]) / 2]
    between.append((between[0][1:] + between[0][:-1]) / 2)
    error = max(
        np.abs(sphere(R, r, 1 / places[0, 1], places[:, 0]) - places[:, 2]).max() for one in between for places in one
    )
    assert error == pytest.approx(file["value_error"][0], rel=0.1, abs=1e-3)


def pixels(file: Path):
    """What ImageMagick reads, [height][width][red, green, blue], 0 to 1."""
    size = subprocess.run(["identify", "-format", "%w %h", file], check=True, capture_output=True).stdout
    command = ["convert-im6.q16", file, "-set", "colorspace", "sRGB", "-depth", "16", "-endian", "LSB", "rgb:-"]
    raw = subprocess.run(command, check=True, capture_output=True).stdout
    width, height = map(int, size.split())
    return np.frombuffer(raw, "<u2").reshape(height, width, 3) / 65535


@pytest.mark.parametrize("kind, formats", [("lut", ["pfm", "png"]), ("profile", ["pfm"]), ("colour-map", ["png"])])
def test_pictures_have_the_rows(kind, formats, tmp_path):
    of = ["colour-map"] if kind == "colour-map" else [kind, "--medium", "skin1"]
    arguments = ["bake", *of, "--size", "16", "--format"]
    rows = np.array(json.loads(dipole(*arguments, "json").stdout)["rows"])
    if kind == "lut":  # the top row is the last one
        rows = rows[:, 2:].reshape(16, 16, 3)[::-1]
    elif kind == "profile":
        rows = np.array([rows[:, 4:], rows[:, 1:4]])
    else:
        rows = np.repeat(rows[None], 3, axis=2)
    for format in formats:
        file = tmp_path / f"picture.{format}"
        command = [str(PROGRAM), *arguments, format]
        run = subprocess.run(command, capture_output=True, check=True, env=environment())
        file.write_bytes(run.stdout)
        assert b"_error " in run.stderr
        assert pixels(file) == pytest.approx(np.clip(rows, 0, 1), abs=1.1 / 65535)
    if "pfm" in formats:  # its values are floats
        values = np.frombuffer((tmp_path / "picture.pfm").read_bytes()[-rows.size * 4 :], "<f4")
        assert values.reshape(rows.shape) == pytest.approx(rows[::-1], rel=1e-6)


MAPS = [("beam", 0, 1.33), ("diffuse", 0.8, 1), ("beam", 0.9, 1.4), ("diffuse", -0.3, 1.6)]


@pytest.mark.parametrize("light, g, eta", MAPS)
def test_a_map_of_colours_shows_them(client, light, g, eta, tmp_path):
    asked = ["--g", str(g), "--eta", str(eta), "--light", light, "--size", "128"]
    text = dipole("bake", "colour-map", *asked, "--format", "spi1d").stdout
    head, values, tail = text.replace("}", "{").split("{")
    assert head.split() == "Version 1 From 0 1 Length 128 Components 1".split()
    albedos = np.array(values.split(), float)
    stated = float(tail.split("colour_error ")[1].split()[0])
    cube = dipole("bake", "colour-map", *asked, "--format", "cube").stdout
    assert [float(line.split()[0]) for line in cube.splitlines() if line[0].isdigit()] == list(albedos)
    for name, written in (("map.spi1d", text), ("map.cube", cube)):
        (tmp_path / name).write_text(written)
        transform = PyOpenColorIO.FileTransform(str(tmp_path / name), interpolation=PyOpenColorIO.INTERP_LINEAR)
        loaded = PyOpenColorIO.Config.CreateRaw().getProcessor(transform).getDefaultCPUProcessor()
        places = [0.2, 0.5, 0.9]
        assert loaded.applyRGB(places) == pytest.approx(np.interp(places, np.linspace(0, 1, 128), albedos), abs=1e-5)
    # What media of the interpolated albedos show, by the inverse of the daemon's own map.
    colours = np.concatenate([np.linspace(0.02, 0.98, 2000), 1 - np.geomspace(0.0199, 1e-6, 2000)])
    true = client.varying("transport", colour=colours, length=1.0, given="extinction-path", light=light, g=g,
                          eta=eta, coefficients="scattered", evaluator="f64", tolerance=1e-4)
    wanted = np.linspace(0.02, 0.9999, 4000)
    shown = np.interp(np.interp(wanted, np.linspace(0, 1, 128), albedos), true.coefficients["scattered"], colours)
    found = np.abs(shown - wanted).max()
    assert found == pytest.approx(stated, rel=0.1, abs=3e-5)


def scattered(light: str):
    """The function that `dipole bake formula` writes, and the error that it states."""
    text = dipole("bake", "formula", "--light", light, "--format", "python").stdout
    names: dict = {}
    exec(text, names)
    return names["scattered"], float(text.split("colour_error ")[1].split()[0])


@pytest.mark.parametrize("light", ["beam", "diffuse"])
def test_the_formula_shows_colours_as_it_says(client, light):
    formula, stated = scattered(light)
    colours = np.concatenate([np.linspace(0.003, 0.98, 2000), 1 - np.geomspace(0.0199, 1e-6, 500)])
    wanted, worst = np.linspace(0.005, 0.995, 199), 0.0
    for eta in (1.3, 1.36, 1.45, 1.54, 1.6):
        for g in (0, 0.1, 0.35, 0.65, 0.82, 0.9):
            true = client.varying("transport", colour=colours, length=1.0, given="extinction-path", light=light,
                                  g=g, eta=eta, coefficients="scattered", evaluator="f64")
            shown = np.interp(formula(wanted, g, eta), true.coefficients["scattered"], colours)
            worst = max(worst, np.abs(shown - wanted).max())
    assert worst == pytest.approx(stated, rel=0.1)
