"""`make figures`: what it draws, how a run resumes, and what it says about the models; `make tradeoff`."""

import csv
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
from daemons import BUILD, finished
from pictures import svg_texts

PROGRAM = Path(__file__).resolve().parents[2] / "core" / "tools" / "figures.py"


def draw(folder: Path) -> None:
    run = finished(
        sys.executable, PROGRAM, "--output", folder, "--photons", "100000",
        env=os.environ | {"DIPOLED": f"private:{BUILD}/dipoled"}
    )
    assert (run.returncode, run.stderr) == (0, "")


def parts(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {
        part.name: (part.stat().st_mtime_ns, part.read_bytes())
        for part in (folder / "parts").iterdir()
    }


@pytest.fixture(scope="module")
def drawn(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("figures") / "out"
    draw(folder)
    return folder


def test_pictures(drawn):
    assert {path.name for path in drawn.glob("*.svg")} == {"tissue.svg", "layers.svg"}
    assert not list(drawn.rglob("*.part"))
    with (drawn / "slab.csv").open(newline="") as file:
        rows = [{name: float(x) for name, x in row.items()} for row in csv.DictReader(file)]
    near = [row for row in rows if 1 < row["r"] < 4]  # mm: there multipoles are near
    assert all(abs(math.log(row["R multipole"] / row["R"])) < 0.3 for row in near) and len(near) > 5


def test_summary(drawn):
    """What core/MODELS.md quotes: in how many of 176 panels which model is nearer, and by how much."""
    with (drawn / "summary.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["panels"] == "176"]
    single = {"model": "better+single", "against": "classical+single"}
    for which, radii, quoted in (
        (single, ("0.01", "0.1"), (20, 1.11, 1.05)),
        (single, ("0.1", "1"), (153, 1.17, 1.45)),
        ({"model": "better", "against": "classical"}, ("1", "5"), (139, 1.20, 1.42)),
        ({"model": "better", "against": "classical"}, ("5", "20.0"), (147, 1.07, 1.37)),
    ):
        [row] = [row for row in rows if row | which == row and (row["r_from"], row["r_to"]) == radii]
        found = [float(row[name]) for name in ("nearer", "model_median", "against_median")]
        assert found == pytest.approx(quoted, abs=0.006)


def test_second_run_walks_what_is_missing(drawn):
    before = parts(drawn)
    damaged, kept = (f"walk_{one}_photons_100000" for one in ("tissue", "slab"))
    assert set(before) == {damaged, kept}
    (drawn / "parts" / damaged).write_bytes(before[damaged][1][:-100])
    draw(drawn)
    after = parts(drawn)
    assert {name for name in before if after[name][0] != before[name][0]} == {damaged}
    assert after[damaged][1] == before[damaged][1]


# ---- `make tradeoff` -----------------------------------------------------------------------------

MEASURED = """
kernel.better.f64.avx2.4096 4e8
kernel.better.f64.libm.4096 9e9
lut.better.f32 9e8
lut.better.table 1e8
lut.better.prepare_f64 9e-9
lut.better.prepare 9e-3
kernel.extended.f64.avx2.4096 2e8
lut.extended.f32 1e8
lut.extended.table 1e8
lut.extended.prepare_f64 9e-9
lut.extended.prepare 9e-3
kernel.transport.f64.avx2.4096 1e7
lut.transport.f32 1e7
lut.transport.table 6e8
lut.transport.prepare_f64 2e-3
lut.transport.prepare 9e-6
lut.transport_solved.prepare 2
"""


def test_tradeoff(tmp_path):
    """The program lists the models that no other is both cheaper and more accurate than: better and
    transport, as long as preparing counts little. For few radii, transport costs more than extended."""
    rows = (line.split() for line in MEASURED.splitlines() if line)
    (tmp_path / "bench.tsv").write_text("".join(f"{name}\t{x}\tunit\n" for name, x in rows))
    told = subprocess.run(
        [sys.executable, PROGRAM.parent / "tradeoff.py", tmp_path / "bench.tsv", tmp_path],
        env=os.environ | {"DIPOLED": f"private:{BUILD}/dipoled"},
        capture_output=True, text=True, check=True,
    ).stdout.splitlines()  # fmt: skip
    fronts: dict[str, list[str]] = {}
    for line in told:
        if line.startswith("front, "):
            front = fronts[line.removeprefix("front, ").removesuffix(":")] = []
        elif line.split()[0] not in front:
            front.append(line.split()[0])
    assert fronts == {
        "a known medium": ["better", "transport"],
        "a new medium, 1,000,000 radii": ["better", "transport"],
        "a new medium, 1,000 radii": ["better", "extended", "transport"],
        "a new medium, 16 radii": ["better", "extended", "transport"],
    }
    names = [text.strip() for text in svg_texts(tmp_path / "front.svg")]
    assert {"better, f32", "transport, table", "dipoles", "extended", "9.0 ms", "0.00032 %"} <= {*names}
    assert (tmp_path / "front.png").stat().st_size > 1000
    costs = (tmp_path / "costs.def").read_text().splitlines()
    kept = (PROGRAM.parents[1] / "costs.def").read_text().splitlines()
    assert costs[:2] + costs[4:6] == kept[:2] + kept[4:6]
    assert [line.split()[2] for line in costs[2:4]] == ["10", "2e+09"]
    assert costs[6].rstrip(" \\") == "  X(2, 2.5, 1.11, 9, 9e+06) /* better */" and len(costs) == 9
