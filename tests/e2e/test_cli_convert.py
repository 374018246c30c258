"""`dipole convert`: from convention to convention and back."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import pytest
from command_line import dipole

SOURCE = Path(__file__).parents[2] / "clients" / "cli" / "conventions.def"
CONVENTIONS = re.findall(r'^CONVENTION\("([a-z-]+)"', SOURCE.read_text(), re.MULTILINE)


def convert(*arguments: str) -> list[dict[str, float]]:
    run = dipole("convert", *arguments, "--format", "csv", quiet=False)
    rows = csv.DictReader(io.StringIO(run.stdout))
    return [{name: float(text or "nan") for name, text in row.items()} for row in rows]


@pytest.mark.parametrize("g", [0, 0.7])
def test_a_medium_goes_through_all_conventions(g):
    """Each step starts from what the last one wrote, so that every convention is left and entered."""
    shared = ["--g", str(g), "--eta", "1.4", "--unit", "2.5"]
    first = rows = convert("--from", "coefficients", "--sigma-a", "0.01,0.2,2", "--sigma-s", "5", *shared)
    source = ["--from", "coefficients", "--sigma-a", "0.01,0.2,2", "--sigma-s", "5"]
    for name in [*CONVENTIONS, "coefficients"]:
        rows = convert(*source, "--to", name, *shared)
        for row, wanted in zip(rows, first, strict=True):
            for coefficient in ("sigma_a", "sigma_s"):
                assert row[coefficient] == pytest.approx(wanted[coefficient], rel=1e-4), (source, name)
        if name != "coefficients":
            colours, lengths = (",".join(repr(row[key]) for row in rows) for key in ("colour", "length"))
            source = ["--from", name, "--colour", colours, "--length", lengths]


def test_a_typed_colour_shows_the_wanted_one():
    """Colours to type for an index of 1.5, by van de Hulst's formula (engines with a walk)."""
    wanted = [round(0.1 * i, 1) for i in range(1, 10)]
    rows = convert("--from", "openpbr", "--colour", ",".join(map(str, wanted)), "--length", "1", "--to", "cycles")
    published = [0.270, 0.438, 0.561, 0.657, 0.736, 0.804, 0.862, 0.913, 0.959]
    assert [row["colour"] for row in rows] == pytest.approx(published, abs=6e-4)
    assert [row["shown"] for row in rows] == pytest.approx(wanted, rel=1e-9)
    typed = convert("--from", "cycles", "--colour", ",".join(repr(row["colour"]) for row in rows), "--length", "1")
    assert [row["shown"] for row in typed] == pytest.approx(wanted, rel=1e-5)
