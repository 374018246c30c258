"""Sets speed against error: tradeoff.py BENCH FOLDER reads the figures of `bench kernel lut` from
the file BENCH, and asks a daemon for errors against transport. Written into the folder:

    costs.def   what core/choose.h chooses by
    front       as .svg and .png: error against cost per radius, of a known medium, and of a new one
                that is prepared for 1,000,000, 1,000 or 16 radii. Each family of models has a marker,
                which is open for tables; a line joins the precisions of a model. The Pareto front
                has names; a table has all numbers. The error is the median over radii, and over the
                media of Figures 1 to 16 of d'Eon 2012 for three eta.

A subject is a model with an evaluator. Standard output lists the subjects on the fronts.
"""

from __future__ import annotations

import itertools
import math
import re
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

CORE = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(CORE.parent / "clients" / "python"))

import dipole  # noqa: E402  (needs the path above)
from pictures import plt, save  # noqa: E402  (needs the path above)

# Costs that differ by no more than this factor count as equal; then the error decides.
COST_ALIKE = 1.1
ERROR_ALIKE = 1.01

RATIOS = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10)
MEDIA = [dipole.Medium(x / (1 + x), 1 / (1 + x), 0, e) for x in RATIOS for e in (1, 1.4, 2)]
RADII = np.geomspace(0.01, 20, 128).astype(np.float32)  # mean free paths


class Subject(NamedTuple):
    """Errors are medians over the media; NaN if all are refused."""

    model: str
    evaluator: str
    ns: float  # ns for a radius; NaN: not measured
    prepare_ns: float
    worst: float
    median: float


# The id and the formula of each model that models.def lists; that of sums is "sum".
MODELS = {
    name: (number, formula or "sum")
    for number, name, formula in re.findall(
        r'(?:MODEL|SUM)\((\d+), \w+, "([^"]+)",[\s\\]*([a-z_]*)',
        (CORE / "models.def").read_text(),
    )
}


def costs_of(figures: dict[str, float], model: str) -> dict[str, tuple[float, float]]:
    """What a radius and preparing cost by each evaluator, in ns."""
    prepare = 1e9 * figures[f"lut.{model}.prepare_f64"]
    name = re.compile(rf"kernel\.{re.escape(model)}\.f64\.(?!libm|memcpy)\w+\.4096")
    f64 = max(value for key, value in figures.items() if name.fullmatch(key))
    return {
        "f64": (1e9 / f64, prepare),
        "f32": (1e9 / figures[f"lut.{model}.f32"], prepare),
        "lut": (1e9 / figures[f"lut.{model}.table"], 1e9 * figures[f"lut.{model}.prepare"]),
    }


def errors_of(client: dipole.Client, model: str, evaluator: str) -> tuple[float, float]:
    """The largest and the median error over the radii, of the model and of its values together."""
    found = []
    for medium in MEDIA:
        try:
            answer = client.eval(
                model, medium, RADII, wanted=["R", "model_errors"], evaluator=evaluator
            )
        except dipole.Refused:
            continue
        errors = answer.model_errors[0] + answer.numerical_error(quantity="R")[0]
        found.append((float(errors.max()), float(np.median(errors))))
    worst, median = np.median(found, axis=0) if found else (math.nan, math.nan)
    return float(worst), float(median)


def subjects_of(client: dipole.Client, figures: dict[str, float]) -> list[Subject]:
    """All models of a half space that need a medium alone and have a formula of their own."""
    subjects = []
    for model in MODELS:
        if f"lut.{model}.f32" not in figures or family_of(model).title.startswith("Gaussians"):
            continue
        for evaluator, cost in costs_of(figures, model).items():
            subjects.append(Subject(model, evaluator, *cost, *errors_of(client, model, evaluator)))
    known = {one.model for one in subjects if not math.isnan(one.median)}
    return [one for one in subjects if one.model in known]


def write_costs(path: Path, subjects: list[Subject], solve_ns: float) -> None:
    """Replaces the numbers and the rows of what stands there."""
    old = (CORE / "costs.def").read_text()
    of_lut = float(np.median([one.ns for one in subjects if one.evaluator == "lut"]))
    old = re.sub(r"(?<=LUT_NS )\S+", f"{of_lut:.3g}", old)
    old = re.sub(r"(?<=SOLVE_NS )\S+", f"{solve_ns:.2g}", old)
    lines = [old[old.rindex("\n#define") + 1 :].split("\n")[0].rstrip(" \\")]
    for f64, f32, lut in zip(*(iter(subjects),) * 3):
        numbers = (f64.ns, f32.ns, f64.prepare_ns, lut.prepare_ns)
        listed = ", ".join(f"{x:.3g}" for x in numbers)
        lines.append(f"  X({MODELS[f64.model][0]}, {listed}) /* {f64.model} */")
    rows = "".join(f"{line:99}\\\n" for line in lines[:-1]) + lines[-1] + "\n"
    path.write_text(old[: old.rindex("\n#define") + 1] + rows)


# ---- the front -----------------------------------------------------------------------------------

NEW, MANY = "a new medium, {:,} radii", math.inf
PANELS = {"a known medium": MANY} | {NEW.format(n): n for n in (1_000_000, 1_000, 16)}


class Family(NamedTuple):
    title: str
    marker: str
    colour: str


# By formula.
FAMILIES = {
    "transport": Family("radiative transport", "o", "#000000"),
    "sum": Family("diffusion and single scattering", "D", "#cc79a7"),
    "dipole": Family("dipoles", "s", "#0072b2"),
    "extended": Family("extended sources", "^", "#d55e00"),
    "cloud": Family("many sources: quantized, multipoles", "v", "#009e73"),
    "single": Family("single scattering", "p", "#56b4e9"),
    "burley": Family("Burley's curves", "o", "#e69f00"),
    "gaussians": Family("Gaussians, fitted to skin", "s", "#8c564b"),
    "gaussian_fit": Family("Gaussians, fitted to a model", "^", "#9467bd"),
}


def family_of(model: str) -> Family:
    return FAMILIES[MODELS[model][1]]


class Point(NamedTuple):
    subject: Subject
    ns: float
    error: float


def points_of(subjects: list[Subject], radii: float) -> list[Point]:
    """What a radius costs if the medium is prepared for this many."""
    points = (Point(one, one.ns + one.prepare_ns / radii, one.median) for one in subjects)
    return [point for point in points if not math.isnan(point.ns + point.error)]


def beats(a: Point, b: Point) -> bool:
    """Whether a is cheaper or nearer to transport than b and not worse in the other respect.
    Differences within the variation of measurements count as equal."""
    return (
        a.ns <= b.ns * COST_ALIKE
        and a.error <= b.error * ERROR_ALIKE
        and (a.ns * COST_ALIKE < b.ns or a.error * ERROR_ALIKE < b.error)
    )


def front_of(points: list[Point]) -> list[Point]:
    """The points that no other beats, cheapest first."""
    front = [point for point in points if not any(beats(other, point) for other in points)]
    return sorted(front, key=lambda point: point.ns)


def draw_panel(axes: plt.Axes, points: list[Point], title: str) -> None:
    """Precisions of a model next to each other on the front share a name."""
    front = front_of(points)
    axes.set(title=title, xscale="log", yscale="log")
    axes.set(xlabel="ns per radius, preparing included", ylabel="relative error of R")
    axes.margins(0.2)
    axes.step(*zip(*((p.ns, p.error) for p in front)), where="post", lw=1, color="#888888")
    precise = (point for point in points if point.subject.evaluator != "lut")
    for _, group in itertools.groupby(precise, lambda point: point.subject.model):
        axes.plot(*zip(*((p.ns, p.error) for p in group)), lw=0.8, color="#aaaaaa")
    for subject, ns, error in points:
        _, marker, colour = family_of(subject.model)
        filling = "none" if subject.evaluator == "lut" else colour
        axes.plot(ns, error, marker, ms=5, color=colour, markerfacecolor=filling)
    named = itertools.groupby(front, lambda p: (p.subject.model, p.subject.evaluator == "lut"))
    for i, ((model, _), group) in enumerate(named):
        same = list(group)
        evaluators = " and ".join(sorted(point.subject.evaluator for point in same))
        name = f"{model}, {evaluators.replace('lut', 'table')}"
        place = (-6, -14 - 12 * (i % 3))
        axes.annotate(name, same[0][1:], place, textcoords="offset points", ha="right", size=7)


NOTES = """Markers of tables are open. A line joins the precisions of a model. What has a
name is on the front: nothing else costs less and is nearer to transport.
Times are of one core, for arrays of 4096 radii, without units in ns.
A table is prepared to a tolerance of 1e-4; its error is that of the model."""

HEADS = ["", "f32", "f64", "table", "prepare", "its table", "error", "worst"]


def quantity(ns: float) -> str:
    unit, size = (" ms", 1e6) if ns >= 1e6 else (" µs", 1e3) if ns >= 1e3 else ("", 1)
    return f"{ns / size:.{0 if ns / size >= 9.95 else 1}f}{unit}"


def percent(error: float) -> str:
    return f"{100 * error:.2g} %" if error < 0.0995 else f"{100 * error:.0f} %"


def draw_table(axes: plt.Axes, subjects: list[Subject]) -> None:
    """All numbers, by family: ns per radius by evaluator, preparing, and the errors."""
    rows, colours = [HEADS], ["#000000"]
    for family in FAMILIES.values():
        mine = [one for one in subjects if family_of(one.model) == family]
        rows += [[family.title, *[""] * 7]] if mine else []
        colours += [family.colour] if mine else []
        for model, group in itertools.groupby(mine, lambda one: one.model):
            own = {one.evaluator: one for one in group}
            cheap = [own[name].prepare_ns for name in ("f32", "f64") if name in own]
            best = own.get("f64", next(iter(own.values())))
            each = [quantity(own[name].ns) if name in own else "" for name in ("f32", "f64", "lut")]
            prepare = [quantity(min(cheap)) if cheap else ""]
            prepare.append(quantity(own["lut"].prepare_ns) if "lut" in own else "")
            rows.append([model, *each, *prepare, percent(best.median), percent(best.worst)])
            colours.append("#444444")
    axes.axis("off")
    widths = [0.34, *[0.094] * 7]
    table = axes.table(rows, edges="open", colWidths=widths, bbox=(0, 0.08, 1, 0.92))
    table.auto_set_font_size(False)
    table.set_fontsize(7)
    for (row, column), cell in table.get_celld().items():
        cell.get_text().set(color=colours[row], ha="left" if column == 0 else "right")
    axes.text(0, 0, NOTES, size=7)


def draw_front(folder: Path, subjects: list[Subject]) -> None:
    figure = plt.figure(figsize=(17, 11), layout="constrained")
    figure.suptitle(
        "Error against cost: |R / R_transport - 1|, median over radii and over the media of "
        "Figures 1 to 16"
    )
    grid = figure.add_gridspec(2, 3, width_ratios=(3, 3, 3.6))
    for number, (title, radii) in enumerate(PANELS.items()):
        points = points_of(subjects, radii)
        axes = figure.add_subplot(grid[number // 2, number % 2])
        draw_panel(axes, points, title)
        print(f"front, {title}:")
        for subject, ns, error in front_of(points):
            print(f"  {subject.model:18} {subject.evaluator:4} {ns:9.3g} ns {error:9.2g}")
    draw_table(figure.add_subplot(grid[:, 2]), subjects)
    figure.savefig(folder / "front.png")
    save(figure, folder / "front.svg")


def main() -> None:
    bench, folder = (Path(argument) for argument in sys.argv[1:])
    rows = (line.split("\t") for line in bench.read_text().splitlines())
    figures = {row[0]: float(row[1]) for row in rows if len(row) == 3}
    with dipole.Client(timeout_s=None) as client:
        subjects = subjects_of(client, figures)
    write_costs(folder / "costs.def", subjects, 1e9 * figures["lut.transport_solved.prepare"])
    draw_front(folder, subjects)


if __name__ == "__main__":
    main()
