"""Draws what `bench gather` and tests/accuracy/test_gather have measured: gather.py BENCH TEST SVG.

BENCH and TEST are files with the output of these programs. The picture has three parts: error against
time by tolerance and by solid angle, time of a query against the number of points, and the errors of a
sheet and a half plane of light against the number of points on their side."""

from __future__ import annotations

import re
import sys
from pathlib import Path

from pictures import plt, save

SHEETS = re.compile(r"(\d+) points a side: the sheet is off by (\S+), the half plane by (\S+)")


def figures(path: Path) -> dict[str, float]:
    """Returns the figures of a benchmark by name."""
    rows = (line.split("\t") for line in path.read_text().splitlines())
    return {row[0]: float(row[1]) for row in rows if len(row) == 3}


def draw(found: dict[str, float], sheets: list[tuple[float, ...]], path: Path) -> None:
    figure, (errors, times, edges) = plt.subplots(1, 3, figsize=(12, 4.4), layout="constrained")
    tolerances = [key[7:-6] for key in found if re.fullmatch(r"gather\.\de-\d\d\.query", key)]
    by = [found[f"gather.{one}.query"] for one in tolerances]
    worst = [found[f"gather.{one}.worst"] for one in tolerances]
    errors.loglog(by, worst, "o-", label="by tolerance: largest error found")
    errors.loglog(by, list(map(float, tolerances)), "s-", label="by tolerance: promised")
    angles = [one for one in tolerances if f"gather.angle.{one}.query" in found]
    by = [found[f"gather.angle.{one}.query"] for one in angles]
    worst = [found[f"gather.angle.{one}.worst"] for one in angles]
    errors.loglog(by, worst, "^-", label="by solid angle: largest error found")
    errors.set(xlabel="time of a query, us", ylabel="relative error")
    for key, label in (("points", "as many queries as points"), ("million", "a million queries")):
        sizes = [found[f"gather.{key}.1e{power}.query"] for power in range(4, 8)]
        times.semilogx([10.0**power for power in range(4, 8)], sizes, "o-", label=label)
    times.set(xlabel="points", ylabel="time of a query at 1e-2, us", ylim=(0, None))
    points, sheet, half_plane = zip(*sheets)
    edges.loglog(points, sheet, "o-", label="sheet, of the albedo")
    edges.loglog(points, half_plane, "s-", label="half plane, of a quadrature")
    edges.set(xlabel="points on a side of 60 mm", ylabel="relative error")
    for axes in (errors, times, edges):
        axes.legend()
    save(figure, path)


if __name__ == "__main__":
    bench, test, output = (Path(argument) for argument in sys.argv[1:4])
    measured = [tuple(map(float, row.groups())) for row in SHEETS.finditer(test.read_text())]
    draw(figures(bench), measured, output)
