"""Measures which models are nearer to transport in the panels of Figures 1 to 16 of d'Eon 2012, "A
Better Dipole", and draws the README's figure of tissue, which scatters forward, and one of layers.

A daemon of its own computes all values. Written into the folder:

    summary.csv             which model is nearer to transport
    tissue.svg, tissue.csv  R of tissue by transport, by its similarity approximation, by dipoles
    layers.svg, layers.csv, slab.csv  R of skin's two layers and of one medium; a slab's R and T, multipoles
    parts/                  tables of Monte Carlo, which a second run reads

There is a panel for each ratio sigma_a / sigma_s' and eta. Its scattering is isotropic; lengths are in
mean free paths, which are 1 / sigma_t', and R is per squared mean free path and per power that
entered.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "clients" / "python"))

import dipole  # noqa: E402  (needs the path above)
from dipole.mc import unpack_result  # noqa: E402
from pictures import plt, save  # noqa: E402
from reference import ring_means  # noqa: E402

RATIOS = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10)
ETAS = [1 + i / 10 for i in range(11)]
RADII = np.geomspace(0.01, 20, 65)
RADII = np.sqrt(RADII[1:] * RADII[:-1])
MODELS = "transport classical better quantized quantized+single classical+single better+single".split()
TOLERANCES = {"transport": 5e-7, "quantized": 1e-6, "quantized+single": 1e-6}

SEED = 20120101


class Panel(NamedTuple):
    """One medium, R[len(RADII)] and the albedo by each of MODELS."""

    ratio: float
    eta: float
    R: dict[str, np.ndarray]
    albedo: dict[str, float]


# ---- values --------------------------------------------------------------------------------------


def walk(
    client: dipole.Client,
    medium: dipole.Medium,
    edges: dipole.Grid,
    name: str,
    photons: int,
    kept: Path,
    **how: Any,
) -> dipole.McResult:
    """Monte Carlo, from the file `kept` if it is there. how: options of Client.mc()."""
    try:
        return unpack_result(kept.read_bytes())
    except (FileNotFoundError, dipole.ProtocolError):
        pass

    def progress(now: dipole.McProgress) -> None:
        share = 100 * now.photons / now.photons_expected
        print(f"\r\033[KMonte Carlo, {name}: {share:3.0f} % ", end="", file=sys.stderr)

    watched = progress if sys.stderr.isatty() else None
    found = client.mc(medium, edges, photons=photons, progress=watched, **how)
    part = kept.with_suffix(".part")
    part.write_bytes(found.payload)
    part.replace(kept)
    return found


def panels_of(client: dipole.Client, eta: float) -> Iterator[Panel]:
    media = [dipole.Medium(x / (1 + x), 1 / (1 + x), 0, eta) for x in RATIOS]
    found = {
        name: client.eval(name, media, RADII, wanted=["R", "albedo"], tolerance=TOLERANCES.get(name))
        for name in MODELS
    }
    for i, ratio in enumerate(RATIOS):
        R, albedo = ({name: getattr(one, of)[i] for name, one in found.items()} for of in ("R", "albedo"))
        yield Panel(ratio, eta, R, albedo)


# ---- tables --------------------------------------------------------------------------------------


def write_csv(path: Path, names: Sequence[str], rows: Iterator[Sequence[Any]]) -> None:
    """Numbers have the fewest digits that read back to them; NaN is empty."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for row in rows:
            shown = (float(x) if isinstance(x, float) else x for x in row)
            writer.writerow("" if x != x else x for x in shown)


# ---- which model is nearer to transport ----------------------------------------------------------
#
# The deviation of a model at a radius is the larger of R / R_transport and its inverse, so that
# half and double count the same. Over several radii, which are spaced evenly in ln r, it is the
# geometric mean of these factors.

# The abstract says that the better dipole improves upon the classical one and is less accurate than
# quantized diffusion. The other pairs are added.
PAIRS = [
    ("better", "classical"),
    ("better+single", "classical+single"),
    ("better+single", "better"),
    ("quantized", "classical"),
    ("quantized", "better"),
    ("quantized+single", "classical"),
    ("quantized+single", "better"),
    ("quantized+single", "better+single"),
]
# Least and largest ratio, least and largest eta.
GROUPS = [
    (0, 100, 1, 2),
    (0, 0.011, 1, 2),
    (0.011, 0.6, 1, 2),
    (0.6, 100, 1, 2),
    (0, 100, 1, 1.41),
    (0, 100, 1.41, 2),
]
RANGES = [(0.01, 20.0), (0.01, 0.1), (0.1, 1), (1, 5), (5, 20.0)]
ALBEDO = (math.nan, math.nan)  # in place of a range of radii


def deviation(panel: Panel, name: str, radii: tuple[float, float]) -> float:
    """The logarithm of the factor by which a model deviates from transport."""
    if math.isnan(radii[0]):
        return abs(math.log(panel.albedo[name] / panel.albedo["transport"]))
    within = (RADII >= radii[0]) & (RADII <= radii[1])
    return float(np.abs(np.log(panel.R[name] / panel.R["transport"]))[within].mean())


def verdict(
    panels: Sequence[Panel], pair: tuple[str, str], radii: tuple[float, float]
) -> list[Any]:
    """How many panels there are, in how many of them the first model of the pair is nearer, and the
    factors of both models: their medians, then the largest."""
    offs = np.array([[deviation(p, name, radii) for p in panels] for name in pair])
    factors = np.exp([*np.median(offs, axis=1), *offs.max(axis=1)])
    return [len(panels), int((offs[0] < offs[1]).sum()), *map(float, factors)]


def summary_rows(panels: Sequence[Panel]) -> Iterator[Sequence[Any]]:
    """A row for each pair, group of panels and range of radii. For a single radius r_from and r_to
    are equal; for the albedo they are empty. A group is named by what it holds."""
    rings = [(float(r), float(r)) for r in RADII]
    for pair, group in itertools.product(PAIRS, GROUPS):
        held = [
            p
            for p in panels
            if group[0] <= p.ratio <= group[1] and group[2] <= p.eta <= group[3]
        ]
        ratios, etas = [p.ratio for p in held], [p.eta for p in held]
        names = [f"{x:g}" for x in (min(ratios), max(ratios), min(etas), max(etas))]
        for radii in [ALBEDO, *RANGES, *(rings if group is GROUPS[0] else [])]:
            count, nearer, *factors = verdict(held, pair, radii)
            share = f"{nearer / count:.4f}"
            yield [*pair, *names, *radii, count, nearer, share, *(f"{x:.5g}" for x in factors)]


# ---- tissue --------------------------------------------------------------------------------------

DOT_COLOUR = "#555555"
DOT_ERROR_MOST = 0.25  # relative standard error of R; dots with a larger one are omitted


def draw_dots(axes: plt.Axes, r: np.ndarray, values: np.ndarray, error: np.ndarray) -> None:
    """Monte Carlo with its standard errors, where they are small enough."""
    good = (values > 0) & (error < DOT_ERROR_MOST * values)
    R, error = values[good], error[good]
    axes.errorbar(
        r[good], R, error, fmt=".", markersize=3, elinewidth=0.8, color=DOT_COLOUR,
        label="Monte Carlo, ± 1 standard error",
    )  # fmt: skip


TISSUE = dipole.Medium(0.05, 10.0, 0.9, 1.4)
TISSUE_EDGES = dipole.Grid(0.01, 20.0, 33, "logarithmic")  # mm
SIMILAR = dipole.Medium(0.05, 10.0 * (1 - 0.9), 0.0, 1.4)
TISSUE_LINES = [
    ("transport", TISSUE, "transport", "#000000", "-"),
    ("transport", SIMILAR, "transport, isotropic with the same σs′", "#009e73", "--"),
    ("better", TISSUE, "better dipole", "#0072b2", "-"),
    ("classical", TISSUE, "classical dipole", "#d55e00", "-"),
]


def tissue_columns(client: dipole.Client, photons: int, kept: Path) -> dict[str, np.ndarray]:
    """The columns of tissue.csv. All values are means over the same rings."""
    walked = walk(client, TISSUE, TISSUE_EDGES, "tissue", photons, kept, seed=SEED)
    edges = walked.edges
    columns = {"r": np.sqrt(edges[1:] * edges[:-1]), "ring_from": edges[:-1], "ring_to": edges[1:]}
    columns |= {"monte_carlo": walked.R[0], "monte_carlo_error": walked.R_error[0]}
    names = "transport similarity better classical".split()
    for name, (model, medium, *_) in zip(names, TISSUE_LINES):
        columns[name] = ring_means(client, model, medium, edges, evaluator="lut")
    return columns


def draw_tissue(path: Path, columns: dict[str, np.ndarray]) -> None:
    """R, and below it the ratios to transport."""
    a, s, g, eta, _ = TISSUE
    figure, both = plt.subplots(2, sharex=True, figsize=(9, 8), layout="constrained")
    figure.suptitle(f"σa {a:g}/mm, σs {s:g}/mm, g {g:g}, η {eta:g}")
    for axes, over in zip(both, (1, columns["transport"])):
        for name, (_, _, title, colour, dash) in zip(list(columns)[5:], TISSUE_LINES):
            axes.plot(columns["r"], columns[name] / over, dash, color=colour, label=title)
        walked = [columns[name] / over for name in ("monte_carlo", "monte_carlo_error")]
        draw_dots(axes, columns["r"], *walked)
        axes.set(xscale="log", yscale="log", xlim=(TISSUE_EDGES.start_mm, TISSUE_EDGES.stop_mm))
    both[0].set(ylim=(1e-7, 1e2), ylabel="R (1/mm² per power that entered)")
    both[1].set(ylim=(0.1, 5), ylabel="over transport", xlabel="r (mm)")
    both[0].legend(loc="lower left")
    save(figure, path)


# ---- layers --------------------------------------------------------------------------------------

SKIN, WAVES = "skin-medium", ("610 nm", "550 nm", "460 nm")
SKIN_COLOURS = "#d55e00", "#009e73", "#0072b2"
SKIN_R = np.geomspace(0.02, 10, 60)  # mm
SLAB = dipole.Medium(0.05, 10.0, 0.8, 1.4, 2.0)
SLAB_EDGES = dipole.Grid(0.05, 10.0, 33, "logarithmic")  # mm


def layers_columns(
    client: dipole.Client, photons: int, kept: Path
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """R of skin's layers, and of the one medium with the dermis's mean free path that has the same
    albedo; and light on both sides of a slab by Monte Carlo and multipoles."""
    skin, wanted = {"r": SKIN_R}, ["R", "albedo"]
    for name, layers in zip(WAVES, client.media()[SKIN]):
        stack = client.eval("transport", layers, SKIN_R, tolerance=1e-2, wanted=wanted)
        _, s, g, eta, *_ = layers[1]
        length = 1 / (layers[1].sigma_a + s * (1 - g))
        one = client.invert("transport", float(stack.albedo[0]), length, g=g, eta=eta)
        medium = dipole.Medium(float(one.sigma_a), float(one.sigma_s), g, eta)
        skin[name] = stack.R[0]
        skin[f"{name}, one medium"] = client.eval("transport", medium, SKIN_R, wanted=["R"]).R[0]
    walked = walk(client, SLAB, SLAB_EDGES, "slab", photons, kept, seed=SEED)
    edges = walked.edges
    slab = {"r": np.sqrt(edges[1:] * edges[:-1]), "ring_from": edges[:-1], "ring_to": edges[1:]}
    for name, side, model in (("R", 0, "multipole"), ("T", 1, "multipole-transmitted")):
        slab |= {f"{name}": walked.values[0, side], f"{name}_error": walked.errors[0, side]}
        slab[f"{name} {model}"] = ring_means(client, model, SLAB, edges)
    return skin, slab


def draw_layers(path: Path, skin: dict[str, np.ndarray], slab: dict[str, np.ndarray]) -> None:
    figure, both = plt.subplots(1, 2, figsize=(11, 5), layout="constrained")
    for name, colour in zip(WAVES, SKIN_COLOURS):
        both[0].plot(SKIN_R, skin[name], color=colour, label=f"{name}: epidermis and dermis")
        one = skin[f"{name}, one medium"]
        both[0].plot(SKIN_R, one, "--", color=colour, label=f"{name}: one medium, same albedo")
    for model, colour in zip(list(slab)[5::3], SKIN_COLOURS):
        both[1].plot(slab["r"], slab[model], color=colour, label=model)
    walked = [np.concatenate([slab[f"{name}{of}"] for name in "RT"]) for of in ("", "_error")]
    draw_dots(both[1], np.tile(slab["r"], 2), *walked)
    a, s, g, eta, thickness = SLAB
    both[0].set(title=SKIN, ylabel="R (1/mm² per power that entered)")
    both[1].set(title=f"slab of {thickness:g} mm: σa {a:g}/mm, σs {s:g}/mm, g {g:g}, η {eta:g}")
    for axes in both:
        axes.set(xscale="log", yscale="log", xlabel="r (mm)")
        axes.legend(loc="lower left")
    both[0].set(ylim=(1e-6, 30))
    save(figure, path)


# ---- all of it -----------------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("build/figures"), help="folder for figures and data")
    parser.add_argument("--photons", type=int, default=40_000_000, help="for tissue and for a slab")
    options = parser.parse_args()
    parts = options.output / "parts"
    parts.mkdir(parents=True, exist_ok=True)
    with dipole.Client(timeout_s=None) as client:
        panels = [one for eta in ETAS for one in panels_of(client, eta)]
        columns = tissue_columns(client, options.photons, parts / f"walk_tissue_photons_{options.photons}")
        kept = parts / f"walk_slab_photons_{options.photons}"
        skin, slab = layers_columns(client, options.photons, kept)
    for name, table in (("tissue", columns), ("layers", skin), ("slab", slab)):
        write_csv(options.output / f"{name}.csv", list(table), zip(*table.values()))
    draw_tissue(options.output / "tissue.svg", columns)
    draw_layers(options.output / "layers.svg", skin, slab)
    names = (
        "model against ratio_from ratio_to eta_from eta_to r_from r_to panels nearer share "
        "model_median against_median model_worst against_worst"
    ).split()
    write_csv(options.output / "summary.csv", names, summary_rows(panels))


if __name__ == "__main__":
    main()
