"""Writes what `bench limit` has measured into the table of a document: limit.py BENCH DOCUMENT. The
reasons in its last column stay. Fails if a kernel above MOST of its bound has none."""

from __future__ import annotations

import re
import sys
from pathlib import Path

MOST = 1.3
FIGURE = re.compile(r"^limit\.(\S+)\.(\w+)\.(\w+)\.(cycles|bound|memcpy)\t(\S+)", re.MULTILINE)
TABLE = re.compile(r"^\|.*\|\n(\|.*\|\n)+", re.MULTILINE)

bench, document = (Path(argument) for argument in sys.argv[1:])
text = document.read_text()
found = TABLE.search(text)
assert found is not None
old = [[cell.strip() for cell in row.split("|")[1:-1]] for row in found[0].splitlines()]
reasons = {row[0]: row[-1] for row in old}

kernels: dict[str, dict[str, dict[str, float]]] = {}  # figures by kernel and instruction set
for model, evaluator, isa, what, value in FIGURE.findall(bench.read_text()):
    of_isa = kernels.setdefault(f"{model} {evaluator}", {}).setdefault(isa, {})
    of_isa[what] = float(value)

isas = list(next(iter(kernels.values())))
table = [["kernel", *(f"{isa}: cycles (bound)" for isa in isas), "memcpy", "reason"]]
unexplained = []
for kernel, figures in kernels.items():
    reason = reasons.get(kernel, "")
    cells = [f"{one['cycles']:.3g} ({one['bound']:.3g})" for one in figures.values()]
    table.append([kernel, *cells, f"{figures[isas[0]]['memcpy']:.2g}", reason])
    if not reason and any(one["cycles"] > MOST * one["bound"] for one in figures.values()):
        unexplained.append(kernel)
lines = [f"| {' | '.join(row)} |\n".replace("|  |", "| |") for row in table]
lines.insert(1, "|---" * len(table[0]) + "|\n")
document.write_text(text[: found.start()] + "".join(lines) + text[found.end() :])
if unexplained:
    sys.exit(f"{document}: above {MOST} of the bound without a reason: {', '.join(unexplained)}")
