"""Draws what `make tradeoff` has measured: draw.py FOLDER reads FOLDER/tradeoff.csv. A subject
is a model with an evaluator. Written into the folder, as .svg and .png:

    front   error against cost per radius, of a known medium, and of a new one that is prepared
            for 1,000,000, 1,000 or 16 radii. Each family of models has a marker, which is open for
            tables; a line joins the precisions of a model. The Pareto front has names; a table has
            all numbers. The error is the median over radii, and over the media of Figures 1 to 16
            of d'Eon 2012 for three eta.

Standard output lists the subjects on the fronts.
"""

from __future__ import annotations

import csv
import itertools
import math
import re
import statistics
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

CORE = Path(__file__).resolve().parents[2]
# Costs that differ by no more than this factor count as equal; then the error decides.
COST_ALIKE = 1.1
ERROR_ALIKE = 1.01
ERROR_LEAST = 1e-7  # transport's own tolerance; smaller errors cannot be measured


class Subject(NamedTuple):
    """Arrays are [ratio, eta], with NaN for media that are refused."""

    model: str
    evaluator: str
    ns: float  # for a radius; NaN if nothing was measured
    prepare_ns: float
    errors: dict[str, np.ndarray]  # by the names of columns

    def __str__(self) -> str:
        return f"{self.model}, {self.evaluator}"


def read(path: Path) -> list[Subject]:
    """The subjects in the file's order."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    if strange := [cell for row in rows for cell in row.values() if re.search(r"[^\w.+-]", cell)]:
        sys.exit(f"{path}: {strange[0]!r} is neither a name nor a number: gnuplot might run it")
    ratios, etas = (list(dict.fromkeys(row[name] for row in rows)) for name in ("ratio", "eta"))

    def number(row: dict[str, str], name: str) -> float:
        return float(row[name] or "nan")

    subjects = []
    for (model, evaluator), group in itertools.groupby(
        rows, lambda row: (row["model"], row["evaluator"])
    ):
        media = list(group)
        errors = {
            name: np.array([number(row, name) for row in media]).reshape(len(ratios), len(etas))
            for name in ("worst", "median")
        }
        cost = number(media[0], "cost_ns"), number(media[0], "prepare_ns")
        subjects.append(Subject(model, evaluator, *cost, errors))
    return subjects


def draw(path: Path, size: tuple[int, int], script: str) -> None:
    """Runs gnuplot; the picture's name has the suffix .svg, and then .png."""
    for suffix, terminal in (
        (".svg", "svg size {},{} dynamic background rgb 'white' font 'sans,14' noenhanced"),
        (".png", "pngcairo size {},{} background rgb 'white' font 'sans,11' noenhanced"),
    ):
        text = f"set terminal {terminal.format(*size)}\nset encoding utf8\n{script}"
        run = subprocess.run(["gnuplot"], input=text.encode(), capture_output=True, check=False)
        if run.returncode != 0:
            sys.exit(f"{path}: gnuplot failed: {run.stderr.decode()}")
        path.with_suffix(suffix).write_bytes(run.stdout)


# ---- the front -----------------------------------------------------------------------------------

WIDTH, HEIGHT = 1640, 1060
TOP, BOTTOM, LEFT, GAP_X, GAP_Y = 84, 64, 84, 84, 104
PANELS_RIGHT, TABLE_LEFT = 1060, 1090
NEW, MANY = "a new medium, {:,} radii", math.inf
PANELS = {"a known medium": MANY} | {NEW.format(n): n for n in (1_000_000, 1_000, 16)}
LETTER_WIDTH, NAME_HEIGHT = 7.2, 17.0
Box = tuple[float, float, float, float]  # left, right, bottom, top


class Family(NamedTuple):
    title: str
    marker: int  # of gnuplot; the one before is the same, but open
    colour: str


# Of the formulas in models.def, and of sums.
FAMILIES = {
    "transport": Family("radiative transport", 7, "#000000"),
    "sum": Family("diffusion and single scattering", 13, "#cc79a7"),
    "dipole": Family("dipoles", 5, "#0072b2"),
    "extended": Family("extended sources", 9, "#d55e00"),
    "cloud": Family("many sources: quantized, multipoles", 11, "#009e73"),
    "single": Family("single scattering", 15, "#56b4e9"),
    "burley": Family("Burley's curves", 7, "#e69f00"),
    "gaussians": Family("Gaussians, fitted to skin", 5, "#8c564b"),
    "gaussian_fit": Family("Gaussians, fitted to a model", 9, "#9467bd"),
}
OTHERS = Family("others", 13, "#7f7f7f")


def families() -> dict[str, Family]:
    """The family of each model that models.def lists."""
    text = (CORE / "models.def").read_text()
    models = re.findall(r'^CORE_MODEL\(\d+, \w+, "([^"]+)",\s*(\w+)', text, re.MULTILINE)
    sums = re.findall(r'^CORE_SUM\(\d+, \w+, "([^"]+)"', text, re.MULTILINE)
    return {name: FAMILIES.get(formula, OTHERS) for name, formula in models} | {
        name: FAMILIES["sum"] for name in sums
    }


class Point(NamedTuple):
    subject: Subject
    ns: float
    error: float


def typical(subject: Subject, what: str) -> float:
    """The median over the media; NaN if there is none."""
    known = [x for x in subject.errors[what].flat if not math.isnan(x)]
    return statistics.median(known) if known else math.nan


def points_of(subjects: list[Subject], radii: float) -> list[Point]:
    """What a radius costs if the medium is prepared for so many."""
    points = (
        Point(one, one.ns + one.prepare_ns / radii, max(typical(one, "median"), ERROR_LEAST))
        for one in subjects
    )
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


def distance(x: float, y: float, box: Box) -> float:
    return math.hypot(max(box[0] - x, 0, x - box[1]), max(box[2] - y, 0, y - box[3]))


def name_places(x: float, y: float, width: float) -> list[Box]:
    """Places for a name around its point, the nearest ones first."""
    places = [
        (left, left + width, middle - NAME_HEIGHT / 2, middle + NAME_HEIGHT / 2)
        for left in np.arange(x - width - 90, x + 90, 6)
        for middle in np.arange(y - 200, y + 200, 5)
    ]
    far = [(distance(x, y, box), box) for box in places]
    return [box for away, box in sorted(far) if away >= 9]


def overlap(a: Box, b: Box) -> bool:
    return a[0] < b[1] and b[0] < a[1] and a[2] < b[3] and b[2] < a[3]


def screen(x: float, y: float) -> str:
    return f"screen {x / WIDTH:.5f},{y / HEIGHT:.5f}"


def steps(front: list[Point], pixels: Any) -> list[Box]:
    """Where the line of the front is: from each point to the right, and then to the next one."""
    boxes = []
    for (x, y), (next_x, next_y) in itertools.pairwise(map(pixels, front)):
        boxes += [(x, next_x, y - 1, y + 1), (next_x - 1, next_x + 1, next_y, y)]
    return boxes


def joins(points: list[Point], pixels: Any) -> list[Box]:
    """Where the lines between the precisions of a model are."""
    boxes = []
    for group in precisions_of(points):
        places = [pixels(point) for point in group]
        x, y = zip(*places)
        boxes.append((min(x), max(x), min(y) - 1, max(y) + 1))
    return boxes


def precisions_of(points: list[Point]) -> list[list[Point]]:
    """The points of each model but those of its table."""
    models: dict[str, list[Point]] = {}
    for point in points:
        if point.subject.evaluator != "lut":
            models.setdefault(point.subject.model, []).append(point)
    return list(models.values())


def leader(x: float, y: float, box: Box) -> list[Box]:
    """Where the line from a point to its name is, from the edge of the marker on."""
    end = min(max(x, box[0]), box[1]), min(max(y, box[2] + 1), box[3] - 1)
    away = math.hypot(end[0] - x, end[1] - y)
    along = [min(7 + 4 * i, away) / away for i in range(int(away / 4) + 1)]
    places = [(x + share * (end[0] - x), y + share * (end[1] - y)) for share in along]
    return [(a - 2, a + 2, b - 2, b + 2) for a, b in places]


def names_script(front: list[Point], room: Box, markers: list[Box], lines: list[Box],
                 pixels: Any) -> str:  # fmt: skip
    """Labels for the points of the front. Precisions of a model next to each other share one."""
    script, taken, names = "", markers + lines, list[Box]()
    for _, group in itertools.groupby(
        front, lambda point: (point.subject.model, point.subject.evaluator == "lut")
    ):
        points = list(group)
        evaluators = " and ".join(sorted(point.subject.evaluator for point in points))
        x, y = pixels(points[0])
        name = f"{points[0].subject.model}, {evaluators.replace('lut', 'table')}"
        places = [
            (box, leader(x, y, box))
            for box in name_places(x, y, LETTER_WIDTH * len(name))
            if room[0] < box[0] and box[1] < room[1] and room[2] < box[2] and box[3] < room[3]
            if not any(overlap(box, other) for other in taken)
        ]
        box, line = next(
            (
                place
                for place in places
                if not any(overlap(a, b) for a in place[1] for b in names + markers)
            ),
            places[0],
        )
        names.append(box)
        taken += [box, *line]
        if distance(x, y, box) > 12:
            end = screen((line[-1][0] + line[-1][1]) / 2, (line[-1][2] + line[-1][3]) / 2)
            script += f"set arrow from {screen(x, y)} to {end} nohead lw 0.8 lc rgb '#888888'\n"
        at = screen(box[0], (box[2] + box[3]) / 2)
        script += f"set label '{name}' at {at} left font ',11' front\n"
    return script


def data_script(points: list[Point], front: list[Point], of: dict[str, Family]) -> str:
    """The data and the plot command."""
    markers: dict[tuple[int, str], list[Point]] = {}
    for point in points:
        is_table = point.subject.evaluator == "lut"
        family = of.get(point.subject.model, OTHERS)
        markers.setdefault((family.marker - is_table, family.colour), []).append(point)
    script, plots = "", []

    def block(name: str, groups: Iterable[list[Point]], style: str) -> None:
        nonlocal script
        rows = ("".join(f"{p.ns:.6g} {p.error:.6g}\n" for p in group) for group in groups)
        script += f"${name} << END\n" + "\n".join(rows) + "NaN NaN\nEND\n"
        plots.append(f"${name} using 1:2 with {style} notitle")

    block("front", [front], "steps lw 1.5 lc rgb '#888888'")
    block("lines", precisions_of(points), "lines lw 1 lc rgb '#aaaaaa'")
    for i, ((marker, colour), group) in enumerate(markers.items()):
        block(f"points{i}", [group], f"points pt {marker} ps 1 lc rgb '{colour}'")
    return script + f"plot {', '.join(plots)}\n"


def front_panel(points: list[Point], title: str, number: int, of: dict[str, Family]) -> str:
    front = front_of(points)
    ns, errors = [point.ns for point in points], [point.error for point in points]
    axes = (min(ns) / 9, max(ns) * 3), (min(errors) / 4, max(errors) * 6)  # with room for names
    width, height = (PANELS_RIGHT - LEFT - GAP_X) / 2, (HEIGHT - TOP - BOTTOM - GAP_Y) / 2
    left = LEFT + (width + GAP_X) * (number % 2)
    bottom = BOTTOM + (height + GAP_Y) * (1 - number // 2)
    room: Box = (left, left + width, bottom, bottom + height)

    def pixels(point: Point) -> tuple[float, float]:
        shares = [
            math.log(at / low) / math.log(high / low)
            for at, (low, high) in zip((point.ns, point.error), axes)
        ]
        return left + width * shares[0], bottom + height * shares[1]

    script = f"unset label\nunset arrow\nset title '{title}'\n"
    for axis, (low, high) in zip("xy", axes):
        script += f"set {axis}range [{low:g}:{high:g}]\n"
    sides = (room[0] / WIDTH, room[1] / WIDTH, room[2] / HEIGHT, room[3] / HEIGHT)
    for side, at in zip("lrbt", sides):
        script += f"set {side}margin at screen {at:.5f}\n"
    markers = [(x - 6, x + 6, y - 6, y + 6) for x, y in map(pixels, points)]
    lines = steps(front, pixels) + joins(points, pixels)
    script += names_script(front, room, markers, lines, pixels)
    if number == 0:
        script += table_script([point.subject for point in points], of)
    return script + data_script(points, front, of)


NOTES = [
    "Markers of tables are open. A line joins the precisions of a model. What has a",
    "name is on the front: nothing else costs less and is nearer to transport.",
    "Times are of one core, for arrays of 4096 radii, without units in ns.",
    "A table is prepared to a tolerance of 1e-4; its error is that of the model.",
]

# The right ends of the table's columns, with their titles.
HEADS = {"ns for a radius": 1366, "prepare": 1510, "error, f64": 1630}
COLUMNS = [
    ("f32", 1270), ("f64", 1318), ("table", 1366), ("f32, f64", 1442), ("table", 1510),
    ("median", 1572), ("worst", 1630),
]  # fmt: skip


def quantity(ns: float) -> str:
    unit, size = (" ms", 1e6) if ns >= 1e6 else (" µs", 1e3) if ns >= 1e3 else ("", 1)
    return f"{ns / size:.{0 if ns / size >= 9.95 else 1}f}{unit}"


def percent(error: float) -> str:
    return f"{100 * error:.2g} %" if error < 0.0995 else f"{100 * error:.0f} %"


def table_rows(subjects: list[Subject]) -> dict[str, list[str]]:
    """The cells of each model: ns per radius by evaluator, preparing, and the errors."""
    rows = {}
    for model in dict.fromkeys(subject.model for subject in subjects):
        own = {one.evaluator: one for one in subjects if one.model == model}
        cheap = [own[name].prepare_ns for name in ("f32", "f64") if name in own]
        best = own.get("f64", next(iter(own.values())))
        rows[model] = [
            *(quantity(own[name].ns) if name in own else "" for name in ("f32", "f64", "lut")),
            quantity(min(cheap)) if cheap else "",
            quantity(own["lut"].prepare_ns) if "lut" in own else "",
            *(percent(max(typical(best, what), ERROR_LEAST)) for what in ("median", "worst")),
        ]
    return rows


def table_script(subjects: list[Subject], of: dict[str, Family]) -> str:
    """Labels with all numbers, by family."""
    rows = table_rows(subjects)
    script, y = "", HEIGHT - 36

    def put(text: str, x: float, how: str = "left") -> None:
        nonlocal script
        shown = text.replace("'", "''")
        script += f"set label '{shown}' at {screen(x, y)} {how} font ',10'\n"

    for name, x in HEADS.items():
        put(name, x, "right")
    y -= 18
    for name, x in COLUMNS:
        put(name, x, "right")
    for family in [*FAMILIES.values(), OTHERS]:
        models = [model for model in rows if of.get(model, OTHERS) == family]
        if not models:
            continue
        y -= 26
        script += (
            f"set label '' at {screen(TABLE_LEFT + 6, y)} point pt {family.marker} ps 1.1 "
            f"lc rgb '{family.colour}'\n"
        )
        put(family.title, TABLE_LEFT + 20, f"left tc rgb '{family.colour}'")
        for model in models:
            y -= 18
            put(model, TABLE_LEFT + 20)
            for cell, (_, x) in zip(rows[model], COLUMNS):
                put(cell, x, "right")
    y -= 36
    for line in NOTES:
        put(line, TABLE_LEFT)
        y -= 18
    return script


def draw_front(folder: Path, subjects: list[Subject]) -> None:
    of = families()
    script = (
        'set multiplot title "Error against cost: |R / R_transport - 1|, median over radii and over '
        'the media of Figures 1 to 16 (at least 1e-7)" font \',15\' offset screen -0.15,0\n'
        "set grid lt 1 lw 0.6 lc rgb '#dddddd'\nset logscale xy\nset format y '%.0e'\n"
        "set format x '%.0s%c'\nset xlabel 'ns per radius, preparing included'\n"
        "set ylabel 'relative error of R'\n"
    )
    for number, (title, radii) in enumerate(PANELS.items()):
        points = points_of(subjects, radii)
        script += front_panel(points, title, number, of)
        print(f"front, {title}:")
        for point in front_of(points):
            model, evaluator, *_ = point.subject
            print(f"  {model:18} {evaluator:4} {point.ns:9.3g} ns {point.error:9.2g}")
    draw(folder / "front", (WIDTH, HEIGHT), script + "unset multiplot\n")


def main() -> None:
    folder = Path(sys.argv[1])
    draw_front(folder, read(folder / "tradeoff.csv"))


if __name__ == "__main__":
    main()
