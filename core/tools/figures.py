"""Draws Figures 1 to 17 of d'Eon 2012, "A Better Dipole", with Monte Carlo and transport added, and
the README's figure of tissue, which scatters forward.

A daemon of its own computes all values. Written into the folder:

    figure_NN.svg, figure_NN.csv, figure_NN_albedos.csv
    summary.csv             which model is nearer to transport
    tissue.svg, tissue.csv  R of tissue by transport, by its similarity approximation, by dipoles
    layers.svg, layers.csv, slab.csv  R of skin's two layers and of one medium; a slab's R and T, multipoles
    parts/                  tables of Monte Carlo, which a second run reads

Figure NN from 1 to 16 has ratio number NN of sigma_a / sigma_s', and a panel for each eta. Figure
17 sets the switches of the dipole one by one, for three ratios and three eta. Their scattering is
isotropic; their lengths are in mean free paths, which are 1 / sigma_t', and R is per squared mean
free path and per power that entered.
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

RATIOS = "0.0001 0.0002 0.0005 0.001 0.002 0.005 0.01 0.02 0.05 0.1 0.2 0.5 1 2 5 10".split()
ETAS = [f"{1 + i / 10:.1f}" for i in range(11)]
RINGS = 64
EDGES = dipole.Grid(0.01, 20.0, RINGS + 1, "logarithmic")
MODELS = (
    "classical better quantized quantized+single classical+single better+single grosjean boundary "
    "exitance"
).split()
CURVES = ["monte_carlo", "transport", *MODELS]
COLUMNS = "monte_carlo monte_carlo_error transport transport_error transport_ring".split() + MODELS

SEED = 20120101
TRANSPORT_TOLERANCE = 5e-7
QUANTIZED_TOLERANCE = 1e-6


class Panel(NamedTuple):
    """One medium. Monte Carlo's values, and transport_ring, which compares with them, are means
    over the rings; all others are values at the rings' middles, which are geometric means."""

    ratio: str
    eta: str
    r: np.ndarray  # [RINGS]
    edges: np.ndarray  # [RINGS + 1]
    values: dict[str, np.ndarray]  # arrays [RINGS] by the names in COLUMNS
    albedos: dict[str, float]  # by the same names, without transport_ring


# ---- values --------------------------------------------------------------------------------------


def media_of(ratios: Sequence[str], eta: str) -> list[dipole.Medium]:
    """The media of these ratios, with sigma_t' = 1 per mm."""
    numbers = map(float, ratios)
    return [dipole.Medium(x / (1 + x), 1 / (1 + x), 0, float(eta)) for x in numbers]


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


def panels_of(
    client: dipole.Client, ratios: Sequence[str], eta: str, table: dipole.McResult | None
) -> Iterator[Panel]:
    """The panels of these ratios with all values."""
    media = media_of(ratios, eta)
    grid = client.eval("classical", media[:1], grid=EDGES, wanted=["r"])
    edges = np.array(grid.r)
    r = np.sqrt(edges[1:] * edges[:-1])
    wanted = ["R", "albedo"]
    transport = client.eval("transport", media, r, tolerance=TRANSPORT_TOLERANCE, wanted=wanted)
    rings = client.ring_means("transport", media, edges, tolerance=TRANSPORT_TOLERANCE)
    errors = transport.numerical_error(r)
    models = {
        name: client.eval(
            name, media, r, wanted=wanted,
            tolerance=QUANTIZED_TOLERANCE if "quantized" in name else None,
        )
        for name in MODELS
    }  # fmt: skip
    for i, ratio in enumerate(ratios):
        values = {name: result.R[i] for name, result in models.items()}
        albedos = {name: float(result.albedo[i]) for name, result in models.items()}
        R, albedo = transport.R[i], float(transport.albedo[i])
        values |= {"transport": R, "transport_error": errors[i] * R}
        values["transport_ring"] = rings.R[i]
        albedos |= {"transport": albedo, "transport_error": float(errors[i, 0]) * albedo}
        if table is not None:
            values |= {"monte_carlo": table.R[i], "monte_carlo_error": table.R_error[i]}
            total = table.energies[i].R
            albedos |= {"monte_carlo": total.value, "monte_carlo_error": total.error}
        yield Panel(ratio, eta, r, edges, values, albedos)


# ---- tables --------------------------------------------------------------------------------------


def write_csv(path: Path, names: Sequence[str], rows: Iterator[Sequence[Any]]) -> None:
    """Numbers have the fewest digits that read back to them; NaN is empty."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        for row in rows:
            shown = (float(x) if isinstance(x, float) else x for x in row)
            writer.writerow("" if x != x else x for x in shown)


def figure_rows(figure: int, panels: Sequence[Panel]) -> Iterator[Sequence[Any]]:
    for p in panels:
        for i in range(RINGS):
            values = [p.values[name][i] if name in p.values else math.nan for name in COLUMNS]
            yield [figure, p.ratio, p.eta, p.r[i], p.edges[i], p.edges[i + 1], *values]


def albedo_rows(figure: int, panels: Sequence[Panel]) -> Iterator[Sequence[Any]]:
    for p in panels:
        for name in CURVES:
            albedo = p.albedos.get(name, math.nan)
            error = p.albedos.get(f"{name}_error", math.nan)
            yield [figure, p.ratio, p.eta, name, albedo, error, albedo / p.albedos["transport"]]


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
# Least and largest ratio, least and largest eta. The first group has all panels.
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
        return abs(math.log(panel.albedos[name] / panel.albedos["transport"]))
    within = (panel.r >= radii[0]) & (panel.r <= radii[1])
    return float(np.abs(np.log(panel.values[name] / panel.values["transport"]))[within].mean())


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
    are equal; for the albedo they are empty. A group is named by what it holds of the ratios and
    eta that were computed."""
    rings = [(float(r), float(r)) for r in panels[0].r]
    for pair, group in itertools.product(PAIRS, GROUPS):
        held = [
            p
            for p in panels
            if group[0] <= float(p.ratio) <= group[1] and group[2] <= float(p.eta) <= group[3]
        ]
        if not held:
            continue
        ratios, etas = [float(p.ratio) for p in held], [float(p.eta) for p in held]
        names = [f"{x:g}" for x in (min(ratios), max(ratios), min(etas), max(etas))]
        for radii in [ALBEDO, *RANGES, *(rings if group is GROUPS[0] else [])]:
            count, nearer, *factors = verdict(held, pair, radii)
            share = f"{nearer / count:.4f}"
            yield [*pair, *names, *radii, count, nearer, share, *(f"{x:.5g}" for x in factors)]


# With fewer photons the errors that Monte Carlo states are too uncertain for a check.
# ---- pages ---------------------------------------------------------------------------------------

PAGE_COLUMNS, PAGE_ROWS = 4, 3
DOT_COLOUR = "#555555"
DOT_ERROR_MOST = 0.25  # relative standard error of R; dots with a larger one are omitted

# The curves of Figures 1 to 16, and those of Figure 17: column, title, colour, dash, width.
MODEL_LINES = [
    ("transport", "transport", "#000000", "-", 1.2),
    ("classical", "classical dipole", "#d55e00", "-", 1.8),
    ("better", "better dipole", "#0072b2", "-", 1.8),
    ("quantized", "quantized diffusion", "#009e73", "--", 1.8),
    ("quantized+single", "quantized + single", "#cc79a7", "--", 1.8),
]
SWITCH_LINES = [
    ("transport", "transport", "#000000", "-", 1.2),
    ("classical", "classical dipole", "#d55e00", "-", 1.8),
    ("grosjean", "Grosjean D alone", "#56b4e9", "--", 1.8),
    ("exitance", "exitance alone", "#009e73", "--", 1.8),
    ("boundary", "boundary alone", "#e69f00", "--", 1.8),
    ("better", "all: better dipole", "#0072b2", "-", 1.8),
]
SWITCH_RATIOS, SWITCH_ETAS = ["0.01", "0.1", "1"], ["1.0", "1.3", "2.0"]


class Page(NamedTuple):
    figure: int
    title: str
    lines: list[tuple[str, str, str, str, float]]
    cells: dict[int, Panel]  # cells in row order; the last one holds the legend


def pages_of(panels: dict[tuple[str, str], Panel]) -> Iterator[Page]:
    for number, ratio in enumerate(RATIOS):
        cells = {i: panels[ratio, eta] for i, eta in enumerate(ETAS) if (ratio, eta) in panels}
        yield Page(number + 1, f"Figure {number + 1}, σa / σs′ = {ratio}", MODEL_LINES, cells)
    cells = {
        row * PAGE_COLUMNS + column: panels[ratio, eta]
        for column, eta in enumerate(SWITCH_ETAS)
        for row, ratio in enumerate(SWITCH_RATIOS)
        if (ratio, eta) in panels
    }
    yield Page(len(RATIOS) + 1, "Figure 17, the switches of the dipole", SWITCH_LINES, cells)


def set_logarithmic(page: Page, axes: plt.Axes) -> None:
    R = np.array([p.values["transport"] for p in page.cells.values()])
    top = math.ceil(math.log10(R.max()))
    bottom = max(math.floor(math.log10(R.min())), top - 14)
    axes.set(xscale="log", yscale="log", ylim=(10.0**bottom, 10.0**top))
    axes.set_xlim(EDGES.start_mm, EDGES.stop_mm)


def draw_dots(axes: plt.Axes, r: np.ndarray, values: np.ndarray, error: np.ndarray) -> None:
    """Monte Carlo with its standard errors, where they are small enough."""
    good = (values > 0) & (error < DOT_ERROR_MOST * values)
    R, error = values[good], error[good]
    axes.errorbar(
        r[good], R, error, fmt=".", markersize=3, elinewidth=0.8, color=DOT_COLOUR,
        label="Monte Carlo, ± 1 standard error",
    )  # fmt: skip


def draw_panel(axes: plt.Axes, page: Page, panel: Panel) -> None:
    """A panel's curves, and its albedos as text."""
    labels = [(f"{line[1]} {panel.albedos[line[0]]:.4g}", line[2]) for line in page.lines]
    set_logarithmic(page, axes)
    for name, title, colour, dash, width in page.lines:
        R = np.where(panel.values[name] > 0, panel.values[name], math.nan)
        axes.plot(panel.r, R, dash, lw=width, color=colour, label=title, gid=f"curve {name}")
    if "monte_carlo" in panel.values:
        total, error = panel.albedos["monte_carlo"], panel.albedos["monte_carlo_error"]
        labels.insert(0, (f"Monte Carlo {total:.4g} ± {error:.1g}", DOT_COLOUR))
        # Transport's ratio of the two turns ring means into values at the rings' middles.
        move = panel.values["transport"] / panel.values["transport_ring"]
        R, error = panel.values["monte_carlo"] * move, panel.values["monte_carlo_error"] * move
        draw_dots(axes, panel.r, R, error)
    of_switches = f", σa / σs′ = {panel.ratio}" if page.lines is SWITCH_LINES else ""
    axes.set_title(f"η = {panel.eta}{of_switches}")
    for row, (text, colour) in enumerate(labels):  # from the corner that the curves leave free
        axes.text(0.03, 0.05 + 0.055 * row, text, color=colour, size=7, transform=axes.transAxes)


def draw(path: Path, page: Page) -> None:
    figure, grid = plt.subplots(PAGE_ROWS, PAGE_COLUMNS, figsize=(17, 12.5), layout="constrained")
    figure.suptitle(f"{page.title}: R per squared mean free path")
    figure.supxlabel("r (mean free paths)")
    for cell, axes in enumerate(grid.flat):
        if cell in page.cells:
            draw_panel(axes, page, page.cells[cell])
        else:
            axes.axis("off")
    handles = grid.flat[min(page.cells)].get_legend_handles_labels()
    grid.flat[-1].legend(*handles, loc="upper left", fontsize=11)
    save(figure, path)


# ---- tissue --------------------------------------------------------------------------------------

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
        columns[name] = client.ring_means(model, medium, edges, evaluator="lut").R[0]
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
        slab[f"{name} {model}"] = client.ring_means(model, SLAB, edges).R[0]
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


def some_of(known: Sequence[str]) -> Any:
    """A reader of names, separated by commas."""

    def read(text: str) -> list[str]:
        for name in text.split(","):
            if name not in known:
                raise argparse.ArgumentTypeError(f"{name} is none of {' '.join(known)}")
        return [name for name in known if name in text.split(",")]

    return read


def photons_of(text: str) -> int:
    if not text.isdecimal() or int(text) > 10**10:
        raise argparse.ArgumentTypeError(f"{text}: a whole number up to 1e10 is needed")
    return int(text)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, kind, usual, argument, text in (
        ("--output", Path, Path("build/figures"), "DIR", "folder for figures and data"),
        ("--photons", photons_of, 16_000_000, "N", "photons for each eta; 0: no Monte Carlo"),
        ("--tissue-photons", photons_of, 40_000_000, "N", "photons for tissue; 0: no figure of it"),
        ("--ratios", some_of(RATIOS), RATIOS, "LIST", "ratios sigma_a / sigma_s', such as 0.01,1"),
        ("--etas", some_of(ETAS), ETAS, "LIST", "values of eta, such as 1.0,1.4"),
    ):
        text += " (default: all)" if argument == "LIST" else " (default: %(default)s)"
        parser.add_argument(name, type=kind, default=usual, metavar=argument, help=text)
    options = parser.parse_args()
    parts = options.output / "parts"
    parts.mkdir(parents=True, exist_ok=True)
    panels: dict[tuple[str, str], Panel] = {}
    which = "all" if options.ratios == RATIOS else "_".join(options.ratios)
    with dipole.Client(timeout_s=None) as client:
        for eta in options.etas:
            kept = parts / f"walk_eta_{eta}_photons_{options.photons}_ratios_{which}"
            table = None
            if options.photons > 0:
                first = media_of(options.ratios, eta)[0]
                albedos = [1 / (1 + float(ratio)) for ratio in options.ratios]
                seed = SEED + ETAS.index(eta)
                how = {"albedos": albedos, "seed": seed}
                table = walk(client, first, EDGES, f"eta {eta}", options.photons, kept, **how)
            for panel in panels_of(client, options.ratios, eta, table):
                panels[panel.ratio, eta] = panel
        if options.tissue_photons > 0:
            kept = parts / f"walk_tissue_photons_{options.tissue_photons}"
            columns = tissue_columns(client, options.tissue_photons, kept)
            write_csv(options.output / "tissue.csv", list(columns), zip(*columns.values()))
            draw_tissue(options.output / "tissue.svg", columns)
            kept = parts / f"walk_slab_photons_{options.tissue_photons}"
            skin, slab = layers_columns(client, options.tissue_photons, kept)
            for name, table in (("layers", skin), ("slab", slab)):
                write_csv(options.output / f"{name}.csv", list(table), zip(*table.values()))
            draw_layers(options.output / "layers.svg", skin, slab)
    for page in (page for page in pages_of(panels) if page.cells):
        name, shown = f"figure_{page.figure:02}", list(page.cells.values())
        draw(options.output / f"{name}.svg", page)
        names = ["figure", "ratio", "eta", "r", "ring_from", "ring_to", *COLUMNS]
        write_csv(options.output / f"{name}.csv", names, figure_rows(page.figure, shown))
        names = "figure ratio eta curve albedo error relative_to_transport".split()
        rows = albedo_rows(page.figure, shown)
        write_csv(options.output / f"{name}_albedos.csv", names, rows)
    wanted = [panels[ratio, eta] for ratio in options.ratios for eta in options.etas]
    names = (
        "model against ratio_from ratio_to eta_from eta_to r_from r_to panels nearer share "
        "model_median against_median model_worst against_worst"
    ).split()
    write_csv(options.output / "summary.csv", names, summary_rows(wanted))


if __name__ == "__main__":
    main()
