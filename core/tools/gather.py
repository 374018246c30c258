"""Draws what `bench gather` and tests/accuracy/test_gather have measured: gather.py BENCH TEST SVG.

BENCH and TEST are files with the output of these programs. The picture has three parts: error against
time by tolerance and by solid angle, time of a query against the number of points, and the errors of a
sheet and a half plane of light against the number of points on their side."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

SHEETS = re.compile(r"(\d+) points a side: the sheet is off by (\S+), the half plane by (\S+)")


def figures(path: Path) -> dict[str, float]:
    """Returns the figures of a benchmark by name."""
    rows = (line.split("\t") for line in path.read_text().splitlines())
    return {row[0]: float(row[1]) for row in rows if len(row) == 3}


def block(name: str, rows: list[tuple[float, ...]]) -> str:
    lines = "\n".join(" ".join(f"{number:.6g}" for number in row) for row in rows)
    return f"${name} << EOD\n{lines}\nEOD\n"


def script(found: dict[str, float], sheets: list[tuple[float, ...]]) -> str:
    tolerances = [key[7:-6] for key in found if re.fullmatch(r"gather\.\de-\d\d\.query", key)]
    by = [
        (found[f"gather.{one}.query"], found[f"gather.{one}.worst"], float(one))
        for one in tolerances
    ]
    angle = [
        (found[f"gather.angle.{one}.query"], found[f"gather.angle.{one}.worst"])
        for one in tolerances
        if f"gather.angle.{one}.query" in found
    ]
    sizes = [
        (10.0**power, found[f"gather.points.1e{power}.query"], found[f"gather.million.1e{power}.query"])
        for power in range(4, 8)
    ]
    return (
        block("by", by)
        + block("angle", angle)
        + block("sizes", sizes)
        + block("sheets", sheets)
        + f"""set terminal svg size 1200,440 font "sans,12" background "white"
set multiplot layout 1,3
set grid
set key below vertical
set logscale xy
set format y "10^{{%L}}"
set xlabel "time of a query, us"
set ylabel "relative error"
plot $by using 1:2 with linespoints title "by tolerance: largest error found", \\
     $by using 1:3 with linespoints title "by tolerance: promised", \\
     $angle using 1:2 with linespoints title "by solid angle: largest error found"
unset logscale y
set format y "%g"
set format x "10^{{%L}}"
set yrange [0:*]
set xlabel "points"
set ylabel "time of a query at 1e-2, us"
plot $sizes using 1:2 with linespoints title "as many queries as points", \\
     $sizes using 1:3 with linespoints title "a million queries"
set logscale y
set yrange [*:*]
set format y "10^{{%L}}"
set format x "%g"
set xlabel "points on a side of 60 mm"
set xrange [50:600]
set xtics (60, 120, 240, 480)
set ylabel "relative error"
plot $sheets using 1:2 with linespoints title "sheet, of the albedo", \\
     $sheets using 1:3 with linespoints title "half plane, of a quadrature"
unset multiplot
"""
    )


def main() -> int:
    bench, test, output = (Path(argument) for argument in sys.argv[1:4])
    sheets = [
        tuple(float(number) for number in found.groups())
        for found in SHEETS.finditer(test.read_text())
    ]
    text = script(figures(bench), sheets)
    with output.open("w") as picture:
        subprocess.run(["gnuplot"], input=text, stdout=picture, text=True, check=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
