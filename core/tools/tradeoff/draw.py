"""Draws what `trade-speed costs` has measured: draw.py FOLDER reads FOLDER/tradeoff.csv. A subject
is a model with an evaluator. Written into the folder, as .svg and .png:

    front   error against cost, with a point for each subject and the Pareto front as a line. The
            error in the left panel is the median over radii, in the right panel the largest one;
            both are medians over the media of Figures 1 to 16 of d'Eon 2012.
    map     the cheapest subject within 1 %, 3 % and 10 %, over ratio and eta. The upper panels are
            for all radii, the lower ones for those from one mean free path on.

Standard output lists the subjects on the fronts, and for how many media each one is the cheapest.
"""

from __future__ import annotations

import csv
import itertools
import math
import re
import statistics
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np

CORE = Path(__file__).resolve().parents[2]
# Costs that differ by no more than this factor count as equal; then the error decides.
COST_ALIKE = float(re.search(r"COST_ALIKE (\S+)", (CORE / "choose.h").read_text())[1])
ERROR_ALIKE = 1.01
ERROR_LEAST = 1e-7  # transport's own tolerance; smaller errors cannot be measured


class Subject(NamedTuple):
    """Arrays are [ratio, eta], with NaN for media that are refused."""

    model: str
    evaluator: str
    ns: float  # for a radius; NaN if nothing was measured
    errors: dict[str, np.ndarray]  # by the names of columns

    def __str__(self) -> str:
        return f"{self.model}, {self.evaluator}"


def read(path: Path) -> tuple[list[Subject], list[str], list[str]]:
    """The subjects in the file's order, the ratios and the eta."""
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
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
            for name in ("worst", "median", "worst_from_1_mfp")
        }
        subjects.append(Subject(model, evaluator, number(media[0], "cost_ns"), errors))
    return subjects, ratios, etas


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

WIDTH, HEIGHT = 1640, 860
TOP, BOTTOM, LEFT, RIGHT, GAP = 84, 64, 84, 16, 96
PANELS = {
    "median": "typical: median over radii",
    "worst": "worst over radii from 0.01 to 20 mean free paths",
}
COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7"]  # of evaluators
LETTER_WIDTH, NAME_HEIGHT = 6.4, 13.0
Box = tuple[float, float, float, float]  # left, right, bottom, top


class Point(NamedTuple):
    subject: Subject
    ns: float
    error: float


def points_of(subjects: list[Subject], what: str) -> list[Point]:
    points = []
    for subject in subjects:
        known = [x for x in subject.errors[what].flat if not math.isnan(x)]
        if known and not math.isnan(subject.ns):
            error = max(statistics.median(known), ERROR_LEAST)
            points.append(Point(subject, subject.ns, error))
    return points


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


def named(points: list[Point], front: list[Point]) -> list[Point]:
    """The points that get a name: those of the front first. Tables get none otherwise, as they all
    cost the same and would crowd one column, and a model gets one name for precisions of equal
    cost."""

    def repeats(i: int) -> bool:
        point = points[i]
        return any(
            other.subject.model == point.subject.model
            and max(other.ns, point.ns) < COST_ALIKE * min(other.ns, point.ns)
            for other in points[:i]
        )

    others = [
        point
        for i, point in enumerate(points)
        if point not in front and point.subject.evaluator != "lut" and not repeats(i)
    ]
    return [point for point in points if point in front] + others


def name_places(x: float, y: float, width: float) -> list[Box]:
    """Places for a name around its point, the best one first. They alternate between right and left
    and move further up and down."""
    places = []
    for place in range(192):
        turn = place // 2 % 48
        up = (0.5 if turn % 2 == 0 else -0.5) * (turn + turn % 2) * NAME_HEIGHT
        away = 8 + 4 * (turn // 4) + 60 * (place // 96)
        left = x + away if place % 2 == 0 else x - away - width
        places.append((left, left + width, y + up - NAME_HEIGHT / 2, y + up + NAME_HEIGHT / 2))
    return places


def overlap(a: Box, b: Box) -> bool:
    return a[0] < b[1] and b[0] < a[1] and a[2] < b[3] and b[2] < a[3]


def front_panel(points: list[Point], title: str, number: int, evaluators: list[str]) -> str:
    front = front_of(points)
    ns, errors = [point.ns for point in points], [point.error for point in points]
    axes = (min(ns) / 2, max(ns) * 3), (min(errors) / 2, max(errors) * 2)  # with room for names
    width = (WIDTH - LEFT - RIGHT - GAP) / len(PANELS)
    left = LEFT + (width + GAP) * number
    room: Box = (left, left + width, BOTTOM, HEIGHT - TOP)

    def pixels(point: Point) -> tuple[float, float]:
        shares = [
            math.log(at / low) / math.log(high / low)
            for at, (low, high) in zip((point.ns, point.error), axes)
        ]
        return left + width * shares[0], BOTTOM + (HEIGHT - TOP - BOTTOM) * shares[1]

    def screen(x: float, y: float) -> str:
        return f"screen {x / WIDTH:.5f},{y / HEIGHT:.5f}"

    script = f"unset label\nunset arrow\nset title '{title}'\n"
    for axis, (low, high) in zip("xy", axes):
        script += f"set {axis}range [{low:g}:{high:g}]\n"
    sides = (room[0] / WIDTH, room[1] / WIDTH, room[2] / HEIGHT, room[3] / HEIGHT)
    for side, at in zip("lrbt", sides):
        script += f"set {side}margin at screen {at:.5f}\n"
    taken = [(x - 5, x + 5, y - 5, y + 5) for x, y in map(pixels, points)]
    for point in named(points, front):
        x, y = pixels(point)
        stretch, font = (1.2, 11) if point in front else (1, 9)
        name, colour = point.subject.model, COLOURS[evaluators.index(point.subject.evaluator)]
        places = name_places(x, y, LETTER_WIDTH * len(name) * stretch)
        free = (
            box
            for box in places
            if room[0] < box[0] and box[1] < room[1] and room[2] < box[2] and box[3] < room[3]
            if not any(overlap(box, other) for other in taken)
        )
        box = next(free, places[0])
        taken.append(box)
        right, middle = box[0] > x, (box[2] + box[3]) / 2
        if abs(middle - y) > 2 or min(abs(box[0] - x), abs(box[1] - x)) > 10:
            end = screen(box[0] - 1 if right else box[1] + 1, middle)
            script += f"set arrow from {screen(x, y)} to {end} nohead lw 0.5 lc rgb '#999999'\n"
        script += (
            f"set label '{name}' at {screen(box[0] if right else box[1], middle)} "
            f"{'left' if right else 'right'} tc rgb '{colour}' font ',{font}' front\n"
        )
    blocks = {"front": front} | {
        f"points_{name}": [p for p in points if p.subject.evaluator == name] for name in evaluators
    }
    for name, members in blocks.items():
        rows = "".join(f"{point.ns:.6g} {point.error:.6g}\n" for point in members)
        script += f"${name} << END\n{rows}NaN NaN\nEND\n"
    script += "plot $front using 1:2 with steps lw 1.5 lc rgb '#888888' title 'front'"
    for name, colour in zip(evaluators, COLOURS):
        style = f"points pt 7 ps 0.6 lc rgb '{colour}'"
        script += f", $points_{name} using 1:2 with {style} title '{name}'"
    return script + "\n"


def draw_front(folder: Path, subjects: list[Subject]) -> None:
    evaluators = list(dict.fromkeys(subject.evaluator for subject in subjects))
    script = (
        'set multiplot title "Error against cost: |R / R_transport - 1|, median over the media of '
        "Figures 1 to 16; at least 1e-7, which is what transport is known to\" font ',16'\n"
        "set grid lt 1 lw 0.6 lc rgb '#dddddd'\nset logscale xy\nset format y '%.0e'\n"
        "set xlabel 'ns per radius (one core, arrays of 4096)'\nset ylabel 'relative error of R'\n"
        "set key bottom left Left reverse samplen 1.5 spacing 1.2\n"
    )
    for number, (what, title) in enumerate(PANELS.items()):
        points = points_of(subjects, what)
        script += front_panel(points, title, number, evaluators)
        print(f"front, {title}:")
        for point in front_of(points):
            model, evaluator, *_ = point.subject
            print(f"  {model:18} {evaluator:4} {point.ns:9.3g} ns {point.error:9.2g}")
    draw(folder / "front", (WIDTH, HEIGHT), script + "unset multiplot\n")


# ---- the map -------------------------------------------------------------------------------------

MAP_WIDTH, MAP_HEIGHT = 1500, 900
WITHIN = (0.01, 0.03, 0.1)
RANGES = {"worst": "0.01", "worst_from_1_mfp": "1"}  # and the first radius of each
# Of subjects in the order of their list; transport has shades of grey.
MAP_COLOURS = [
    0x0072B2, 0xE69F00, 0x009E73, 0xCC79A7, 0x56B4E9, 0xD55E00, 0xF0E442, 0x8C564B, 0x9467BD,
    0x2CA02C, 0x17BECF, 0x7F7F7F, 0xAEC7E8, 0xFFBB78, 0x98DF8A, 0xFF9896, 0xC5B0D5,
]  # fmt: skip


def cheapest(
    subjects: list[Subject], what: str, within: float, medium: tuple[int, int]
) -> int | None:
    """The cheapest subject within an error of transport. Among costs that are alike, the nearest to
    transport counts as the cheapest."""
    near = [i for i, one in enumerate(subjects) if one.errors[what][medium] <= within]
    least_ns = min((subjects[i].ns for i in near), default=math.nan)
    alike = [i for i in near if subjects[i].ns <= least_ns * COST_ALIKE]
    return min(alike, key=lambda i: subjects[i].errors[what][medium], default=None)


def draw_map(folder: Path, subjects: list[Subject], ratios: list[str], etas: list[str]) -> None:
    media = list(itertools.product(range(len(ratios)), range(len(etas))))
    panels = {
        (what, within): [cheapest(subjects, what, within, medium) for medium in media]
        for what in RANGES
        for within in WITHIN
    }
    shown = sorted({i for found in panels.values() for i in found if i is not None})
    evaluators = list(dict.fromkeys(subject.evaluator for subject in subjects))

    def colour(i: int) -> int:
        if subjects[i].model == "transport":
            return 0xC7C7C7 - 0x181818 * evaluators.index(subjects[i].evaluator)
        return MAP_COLOURS[shown.index(i) % len(MAP_COLOURS)]

    powers = [x if math.log10(float(x)).is_integer() else "" for x in ratios]
    x_tics = ", ".join(f"'{x}' {i}" for i, x in enumerate(powers))
    y_tics = ", ".join(f"'{eta}' {i}" for i, eta in enumerate(etas))
    script = (
        "set multiplot layout 2,3 margins 0.043,0.96,0.245,0.907 spacing 0.041,0.102 "
        "title 'The cheapest that is near enough to transport at all of these radii' font ',16'\n"
        "unset key\nset xlabel 'σa / σs′' offset 0,0.6\nset ylabel 'η' offset 1,0\n"
        f"set xtics ({x_tics}) out nomirror\nset ytics ({y_tics}) out nomirror\n"
        f"set xrange [-0.5:{len(ratios) - 1}.5]\nset yrange [-0.5:{len(etas) - 1}.5]\n"
    )
    for place, i in enumerate(shown):  # the legend: a square and a name, four to a line
        x, y = 64 + place % 4 * 350, 124 - place // 4 * 24
        script += (
            f"set object rectangle from screen {x / MAP_WIDTH:.5f},{(y - 7) / MAP_HEIGHT:.5f} to "
            f"screen {(x + 22) / MAP_WIDTH:.5f},{(y + 7) / MAP_HEIGHT:.5f} fc rgb {colour(i)} "
            f"fs solid border rgb '#666666'\nset label '{subjects[i]}' at "
            f"screen {(x + 30) / MAP_WIDTH:.5f},{y / MAP_HEIGHT:.5f} left\n"
        )
    for (what, within), found in panels.items():
        title = f"within {100 * within:g} %, r from {RANGES[what]} to 20 mean free paths"
        cells = "".join(
            f"{x} {y} {0xFFFFFF if i is None else colour(i)}\n" for (x, y), i in zip(media, found)
        )
        script += (
            f"$cells << END\n{cells}END\nset title '{title}' offset 0,-0.5\n"
            "plot $cells using 1:2:(0.5):(0.5):3 with boxxyerror fill solid 1 noborder "
            "fillcolor rgb variable notitle\nunset label\nunset object\n"
        )
        counts = " ".join(
            f"{subjects[i].model}/{subjects[i].evaluator} {found.count(i)}"
            for i in shown
            if i in found
        )
        print(f"cheapest {title}, of {len(media)} media: {counts}")
    draw(folder / "map", (MAP_WIDTH, MAP_HEIGHT), script + "unset multiplot\n")


def main() -> None:
    folder = Path(sys.argv[1])
    subjects, ratios, etas = read(folder / "tradeoff.csv")
    draw_front(folder, subjects)
    draw_map(folder, subjects, ratios, etas)


if __name__ == "__main__":
    main()
