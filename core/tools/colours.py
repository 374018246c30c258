"""Measures formulas that make a single-scattering albedo of a colour against transport, and fits a
closed form that knows the interface (core/COLOURS.md).

The error of a formula is the colour that a half space with its albedo has, less the colour that was
asked for. Written into the folder: colour_errors.csv (each formula, light, eta, g and colour),
colours.svg; with `fit` as a second argument also clients/cli/formula.def, the constants of the
closed form. The tables of core/COLOURS.md are made anew."""

from __future__ import annotations

import csv
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "clients" / "python"))

import dipole  # noqa: E402  (needs the path above)
from pictures import plt, save  # noqa: E402

COLOURS = np.array([0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
ALL_G = (0.0, 0.5, 0.8, 0.9, 0.95)
TABLE_G = (0.0, 0.5, 0.9)  # of the table in COLOURS.md
ETAS = (1.0, 1.33, 1.4, 1.5)
LIGHTS = ("beam", "diffuse")
TABLE = [(1.0, "diffuse"), (1.0, "beam"), (1.5, "diffuse"), (1.5, "beam")]
LEAST = 1e-9  # 1 - albedo of formulas that give less


class Transport:
    """Colours of half spaces by s = sqrt((1 - a) / (1 - g a)), a the single-scattering albedo."""

    def __init__(self, client: dipole.Client):
        self.client, self.known = client, {}

    def curve(self, light: str, eta: float, g: float) -> tuple[Any, Any]:
        if (light, eta, g) not in self.known:
            colours = np.concatenate([np.geomspace(1e-4, 0.1, 500), np.linspace(0.1, 0.95, 4000),
                                      1 - np.geomspace(0.05, 1e-5, 2000)])
            found = self.client.varying(
                "transport", colour=colours, length=1.0, given="extinction-path", light=light,
                g=g, eta=eta, evaluator="f64", tolerance=1e-5,
            )  # fmt: skip
            absorbed = found.coefficients["sigma_a"]
            good = np.isfinite(absorbed)
            s = np.sqrt(absorbed[good] / (1 - g * (1 - absorbed[good])))
            order = np.argsort(s)
            self.known[light, eta, g] = (np.concatenate([[0], s[order], [1]]),
                                         np.concatenate([[1], colours[good][order], [0]]))
        return self.known[light, eta, g]

    def colour(self, light: str, eta: float, g: float, absorbed: Any) -> Any:
        absorbed = np.clip(absorbed, LEAST, 1)
        return np.interp(np.sqrt(absorbed / (1 - g * (1 - absorbed))), *self.curve(light, eta, g))

    def s(self, light: str, eta: float, g: float, colours: Any) -> Any:
        s, known = self.curve(light, eta, g)
        return np.interp(colours, known[::-1], s[::-1])


# ---- published formulas: 1 - albedo -------------------------------------------------------------


def similar(reduced: Any, g: float) -> Any:
    """From 1 - reduced albedo."""
    return reduced * (1 - g) / (1 - g * reduced)


def hulst_s(C: Any) -> Any:
    """van de Hulst 1980; Kulla, Conty 2017."""
    return 4.09712 + 4.20863 * C - np.sqrt(9.59217 + 41.6808 * C + 17.7126 * C**2)


def approximation_3(C: Any) -> Any:
    """d'Eon 2021, A Hitchhiker's Guide to Multiple Scattering."""
    root = np.sqrt(0.5667087129883742 + C) * np.sqrt(15.803432476716953 + C)
    top = (-1.0893564101764108 - 2.3011443820100275 * C - 0.8247913150511265 * C**2
           + 0.9234846594011388 * (0.39417098289205227 + C) * root)
    return 1 - top / (0.5461928294878655 + C) ** 2


def chiang(A: Any) -> Any:
    """Chiang, Kutz, Burley 2016."""
    return np.exp(-5.09406 * A + 2.61188 * A**2 - 4.31805 * A**3)


def hyperion(A: Any) -> Any:
    """Burley 2018."""
    return np.exp(-11.43 * A + 15.38 * A**2 - 13.91 * A**3)


def wrenninge(A: Any, g: float) -> Any:
    """Wrenninge, Villemin, Hery 2017: fits of degree 7 in g. Renderers take no more than 1 - 1e-6."""
    def fit(*p: float) -> float:
        return sum(c * g**i for i, c in enumerate(p))
    a = fit(
        1.8260523782, -1.28451056436, -1.79904629312, 9.19393289202, -22.8215585862,
        32.0234874259, -23.6264803333, 7.21067002658
    )
    b = 4.98511194385 + 0.127355959438 * np.exp(fit(
        0, 31.1491581433, -201.847017512, 841.576016723, -2018.09288505, 2731.71560286,
        -1935.41424244, 559.009054474
    ))
    c = fit(
        1.09686102424, -0.394704063468, 1.05258115941, -8.83963712726, 28.8643230661,
        -46.8802913581, 38.5402837518, -12.7181042538
    )
    d = fit(
        0.496310210422, 0.360146581622, -2.15139309747, 17.8896899217, -55.2984010333,
        82.065982243, -58.5106008578, 15.8478295021
    )
    e = 4.23190299701 + 0.00310603949088 * np.exp(fit(
        0, 76.7316253952, -594.356773233, 2448.8834203, -5576.68528998, 7116.60171912,
        -4763.54467887, 1303.5318055
    ))
    f = fit(
        2.40602999408, -2.51814844609, 9.18494908356, -79.2191708682, 259.082868209,
        -403.613804597, 302.85712436, -87.4370473567
    )
    share = A**0.25
    albedo = (1 - share) * a * np.arctan(b * A) ** c + share * d * np.arctan(e * A) ** f
    return np.maximum(1 - albedo, 1e-6)


def jensen(C: Any, eta: float) -> Any:
    """Jensen et al. 2001: 1 - reduced albedo, by bisection."""
    F_dr = -1.44 / eta**2 + 0.71 / eta + 0.668 + 0.0636 * eta if eta > 1 else 0.0
    A = (1 + F_dr) / (1 - F_dr)
    low, high = np.zeros_like(C), np.ones_like(C)
    for _ in range(60):
        middle = (low + high) / 2
        root = np.sqrt(3 * middle)
        above = (1 - middle) / 2 * (1 + np.exp(-4 / 3 * A * root)) * np.exp(-root) > C
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return low


def fresnel(eta: float, inside: Any) -> Any:
    """What is reflected of light that meets the interface from inside, by the cosine there."""
    sine = eta * np.sqrt(1 - inside**2)
    out = np.sqrt(np.maximum(1 - sine**2, 0))
    parallel = ((eta * out - inside) / (eta * out + inside)) ** 2
    across = ((eta * inside - out) / (eta * inside + out)) ** 2
    return np.where(sine < 1, (parallel + across) / 2, 1)


def saunderson(C: Any, eta: float) -> Any:
    """The colour behind an interface, as diffuse light sees it (Saunderson 1942)."""
    if eta == 1:
        return C
    angle = np.linspace(0, np.pi / 2, 200001)
    k2 = np.trapz(fresnel(eta, np.cos(angle)) * np.sin(2 * angle), angle)
    return C / (1 - k2 * (1 - C))


def slopes(x: Any, f: Any) -> Any:
    """Of a spline of Catmull and Rom."""
    ends = [(f[..., 1] - f[..., 0]) / (x[1] - x[0]), (f[..., -1] - f[..., -2]) / (x[-1] - x[-2])]
    inner = (f[..., 2:] - f[..., :-2]) / (x[2:] - x[:-2])
    return np.concatenate([ends[0][..., None], inner, ends[1][..., None]], axis=-1)


def beam_diffusion(C: Any, g: float, eta: float) -> Any:
    """The table of pbrt-v4, by which it inverts colours: 100 albedos, 64 radii, and 100 depths of photon
    beam diffusion (Habel, Christensen, Jarosz 2013) with single scattering; 1 - albedo."""
    rho = (1 - np.exp(-8 * np.arange(100) / 99)) / (1 - np.exp(-8))
    r = np.concatenate([[0], 2.5e-3 * 1.2 ** np.arange(63)])
    s, a = rho[:, None, None], 1 - rho[:, None, None]
    R, path = r[:, None], -np.log(1 - (np.arange(100) + 0.5) / 100)
    reduced = a + s * (1 - g)
    D = (2 * a + s * (1 - g)) / (3 * reduced**2)
    decay, albedo = np.sqrt(a / D), s * (1 - g) / reduced
    # the first two moments of what the interface reflects inside (d'Eon, Irving 2011), eta from 1 on
    first = np.polyval([0.12746, -1.27198, 5.11455, -10.4646, 11.1136, -4.61686], eta)
    second = np.polyval([0.63942, -9.00603, 54.9327, -189.519, 404.557, -547.033], eta)
    second += np.polyval([45.3087, -218.725, 458.843, 0], 1 / eta)
    zr = path / reduced
    zv = -zr - 4 * D * (1 + 3 * second) / (1 - 2 * first)
    dr, dv = np.sqrt(R**2 + zr**2), np.sqrt(R**2 + zv**2)
    er, ev = np.exp(-decay * dr), np.exp(-decay * dv)
    fluence = (er / dr - ev / dv) / (4 * np.pi * D)
    flux = (zr * (1 + decay * dr) * er / dr**3 - zv * (1 + decay * dv) * ev / dv**3) / (4 * np.pi)
    exitance = fluence * 0.25 * (1 - 2 * first) + flux * 0.5 * (1 - 3 * second)
    multiple = ((1 - np.exp(-2 * reduced * (dr + zr))) * albedo**2 * exitance).mean(-1)
    critical = R * np.sqrt(eta**2 - 1)
    depth = critical + path
    d = np.sqrt(R**2 + depth**2)
    cosine = depth / d
    phase = (1 - g * g) / (4 * np.pi * (1 + g * g + 2 * g * cosine) ** 1.5)
    once = np.exp(-d - critical) / d**2 * phase * (1 - fresnel(eta, cosine)) * cosine
    ring = 2 * np.pi * r * (rho[:, None] * once.mean(-1) + multiple)
    steps, slope = np.diff(r), slopes(r, ring)
    parts = (ring[:, 1:] + ring[:, :-1]) / 2 + (slope[:, :-1] - slope[:, 1:]) * steps / 12
    shown = (parts * steps).sum(-1)
    u = np.linspace(0, 1, 200)[:, None]  # the spline of colours by albedo, between its knots
    width, slope = np.diff(rho), slopes(rho, shown)
    fine = (shown[:-1] * (2 * u**3 - 3 * u**2 + 1) + shown[1:] * (3 * u**2 - 2 * u**3)
            + width * (slope[:-1] * (u**3 - 2 * u**2 + u) + slope[1:] * (u**3 - u**2)))
    return 1 - np.interp(C, fine.T.ravel(), (rho[:-1] + u * width).T.ravel())


def formulas(client: dipole.Client, eta: float, g: float) -> dict[str, Any]:
    C = COLOURS
    better = client.invert("better", C, 1.0, eta=eta)
    reduced = better.sigma_a / (better.sigma_a + better.sigma_s)
    return {
        "van de Hulst, with g": similar(hulst_s(C) ** 2, g),
        "d'Eon, approximation 3, with g": similar(approximation_3(C), g),
        "van de Hulst, without g": hulst_s(C) ** 2,
        "Chiang, Kutz, Burley 2016, with g": similar(chiang(C), g),
        "the same, without g": chiang(C),
        "Wrenninge, Villemin, Hery 2017": wrenninge(C, g),
        "Burley 2018, with g": similar(hyperion(C), g),
        "classical dipole, Jensen's F_dr": similar(jensen(C, eta), g),
        "better dipole": similar(reduced, g),
        "pbrt-v4, photon beam diffusion": beam_diffusion(C, g, eta),
        "van de Hulst of Saunderson's colour": similar(hulst_s(saunderson(C, eta)) ** 2, g),
    }


# ---- the closed form ----------------------------------------------------------------------------

FIT_ETAS, FIT_G = np.linspace(1.3, 1.6, 7), np.array([0, 0.2, 0.4, 0.6, 0.7, 0.8, 0.9])
FIT_COLOURS = np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98])
MIDDLE = 1.45


def terms(g: Any, eta: Any) -> Any:
    e = eta - MIDDLE
    return np.stack([np.ones_like(g), g, g * g, e, e * g, e * e], axis=-1)


def form_s(C: Any, constants: Any, g: Any, eta: Any) -> Any:
    a, b, c = (terms(g, eta) @ row for row in constants)
    u, q = 1 + a + b * C, a - c * C
    return 2 * (1 - C) / (u + np.sqrt(u * u - 4 * q * (1 - C)))


def fit(transport: Transport, light: str) -> Any:
    """Returns three rows of constants of the smallest largest error: least squares again and again,
    with more weight where the error is large."""
    eta, g, C = (one.ravel() for one in np.meshgrid(FIT_ETAS, FIT_G, FIT_COLOURS, indexing="ij"))
    s = np.array([transport.s(light, *one) for one in zip(eta, g, C)])
    P = terms(g, eta)
    matrix = np.concatenate([-P * one[:, None] for one in ((1 - s) * s, C * s, C * s * s)], axis=1)
    weight, below, best, least = np.ones_like(C), np.ones_like(C), None, np.inf
    for _ in range(400):
        scale = weight / below
        p = np.linalg.lstsq(matrix * scale[:, None], (C - 1 + s) * scale, rcond=None)[0]
        p = p.reshape(3, -1)
        a, b, c = (P @ row for row in p)
        below = 1 + b * s + c * s * s
        error = np.abs((1 - s) * (1 - a * s) / below - C)
        if error.max() < least:
            best, least = p, error.max()
        weight = weight * (error / error.max() + 0.05) ** 0.15
        weight /= weight.max()
    return np.round(best, 5)


def form_error(transport: Transport, light: str, constants: Any) -> float:
    """The largest error of colour, at other places than those of the fit."""
    C, worst = np.linspace(0.005, 0.995, 199), 0.0
    for eta in (1.3, 1.33, 1.4, 1.425, 1.5, 1.575, 1.6):
        for g in (0.0, 0.1, 0.3, 0.5, 0.75, 0.85, 0.9):
            s = form_s(C, constants, np.full_like(C, g), np.full_like(C, eta))
            worst = max(worst, np.abs(np.interp(s, *transport.curve(light, eta, g)) - C).max())
    return worst


def write_constants(transport: Transport, path: Path) -> None:
    lines = ["/* The closed form of core/COLOURS.md, by `make colour-errors FIT=fit`: for each light",
             " * the largest error of colour and the constants of a1, b and c: of 1, g, g^2, e, e g,",
             " * e^2, e = eta - 1.45. FORMULA(LIGHT, error, a[6], b[6], c[6]) */"]  # fmt: skip
    for light in LIGHTS:
        constants = fit(transport, light)
        error = np.ceil(form_error(transport, light, constants) * 1e5) / 1e5
        rows = ", ".join("({})".format(", ".join(f"{one:.5f}" for one in row)) for row in constants)
        lines.append(f"FORMULA({light.upper()}, {error:.5f}, {rows})")
    path.write_text("\n".join(lines) + "\n")


def read_constants(path: Path) -> dict[str, tuple[float, Any]]:
    found = {}
    line = re.compile(r"^FORMULA\((\w+), ([\d.]+), (.*)\)$", re.MULTILINE)
    for light, error, rows in line.findall(path.read_text()):
        numbers = [float(one) for one in re.findall(r"-?\d+\.\d+", rows)]
        found[light.lower()] = float(error), np.array(numbers).reshape(3, 6)
    return found


# ---- tables and the picture ---------------------------------------------------------------------


def errors(
    client: dipole.Client, transport: Transport, known: dict[str, tuple[float, Any]]
) -> list[tuple]:
    rows = []
    for eta in ETAS:
        for g in ALL_G:
            listed = formulas(client, eta, g)
            for light in LIGHTS:
                for name, absorbed in listed.items():
                    off = transport.colour(light, eta, g, absorbed) - COLOURS
                    rows += [(name, light, eta, g, C, one) for C, one in zip(COLOURS, off)]
                if eta > 1:
                    ones = np.ones_like(COLOURS)
                    s = form_s(COLOURS, known[light][1], g * ones, eta * ones)
                    off = np.interp(s, *transport.curve(light, eta, g)) - COLOURS
                    name = "the closed form below"
                    rows += [(name, light, eta, g, C, one) for C, one in zip(COLOURS, off)]
    return rows


def table(rows: list[tuple]) -> str:
    lines = ["|".join(["formula", *(f"eta {eta:g}, {light}" for eta, light in TABLE)]),
             "|".join(["---"] * (len(TABLE) + 1))]  # fmt: skip
    for name in dict.fromkeys(row[0] for row in rows):
        cells = []
        for eta, light in TABLE:
            of_cell = [row for row in rows if row[:3] == (name, light, eta)]
            off = [abs(row[5]) for row in of_cell if row[3] in TABLE_G]
            cells.append(f"{max(off):.4f}, {np.median(off):.4f}" if off else "-")
        lines.append("|".join([name, *cells]))
    return "\n".join(lines)


def constants_table(known: dict[str, tuple[float, Any]]) -> str:
    lines = ["light, worst error||1|g|g^2|e|e g|e^2", "|".join(["---"] * 8)]
    for light, (error, constants) in known.items():
        for name, row in zip(("a1", "b", "c"), constants):
            lines.append("|".join([f"{light}, {error:.5f}", name, *(f"{one:.5f}" for one in row)]))
    return "\n".join(lines)


def draw(path: Path, rows: list[tuple]) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), sharey=True)
    for axis, (eta, light) in zip(axes, (TABLE[0], TABLE[3])):
        for name in dict.fromkeys(row[0] for row in rows):
            off = [(row[4], row[5]) for row in rows if row[:4] == (name, light, eta, 0.5)]
            if off:
                axis.plot(*zip(*off), label=name)
        axis.set(title=f"eta {eta:g}, {light}, g 0.5", xlabel="colour asked for")
    axes[0].set_ylabel("colour that comes out, less that")
    axes[1].legend(fontsize=6, loc="lower left")
    save(figure, path)


def main() -> None:
    folder, constants = Path(sys.argv[1]), ROOT / "clients" / "cli" / "formula.def"
    folder.mkdir(parents=True, exist_ok=True)
    with dipole.Client() as client:
        transport = Transport(client)
        if sys.argv[2:] == ["fit"]:
            write_constants(transport, constants)
        known = read_constants(constants)
        rows = errors(client, transport, known)
    with open(folder / "colour_errors.csv", "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("formula", "light", "eta", "g", "colour", "error"))
        writer.writerows((*row[:5], f"{row[5]:.6f}") for row in rows)
    draw(folder / "colours.svg", rows)
    document = ROOT / "core" / "COLOURS.md"
    text = document.read_text()
    for mark, made in (("errors", table(rows)), ("constants", constants_table(known))):
        part = re.compile(rf"(?<=<!-- {mark} -->\n).*?(?=\n<!-- end -->)", re.DOTALL)
        text = part.sub(lambda _: made, text)
    document.write_text(text)


if __name__ == "__main__":
    main()
