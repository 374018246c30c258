"""`make figures`: some of the figures, how a run resumes, and what the figures say about the
models."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest
from daemons import BUILD
from pictures import svg_texts

PROGRAM = Path(__file__).resolve().parents[2] / "core" / "tools" / "figures.py"
TIMEOUT_S = 240
RINGS = 64
RATIOS, ETAS = ["0.01", "1"], ["1.0", "1.3", "2.0"]
SELECTION = ["--ratios", ",".join(RATIOS), "--etas", ",".join(ETAS), "--photons", "120000"]
TISSUE = ["--tissue-photons", "100000"]


def draw(folder: Path, *options: str, status: int = 0) -> subprocess.CompletedProcess[str]:
    run = subprocess.run(
        [*(sys.executable, str(PROGRAM), "--output", str(folder)), *TISSUE, *options],
        env=os.environ | {"DIPOLED": f"private:{BUILD}/dipoled"},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert run.returncode == status, run.stderr
    assert status != 0 or run.stderr == ""
    return run


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def parts(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {
        part.name: (part.stat().st_mtime_ns, part.read_bytes())
        for part in (folder / "parts").iterdir()
    }


@pytest.fixture(scope="module")
def drawn(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("figures") / "out"
    draw(folder, *SELECTION)
    return folder


# ---- what a run leaves ---------------------------------------------------------------------------


def test_pages(drawn):
    """Only figures that have wanted panels."""
    sizes = {"07": (3, 5), "13": (3, 5), "17": (6, 6)}
    names = {f"figure_{n}.svg": n for n in sizes}
    assert {path.name for path in drawn.glob("*.svg")} == {*names, "tissue.svg", "layers.svg"}
    assert not list(drawn.rglob("*.part"))
    for name, figure in names.items():
        panels, curves = sizes[figure]
        texts = [text.strip() for text in svg_texts(drawn / name)]
        # The label of Monte Carlo and of transport has the albedo of the medium.
        for start in ("η = ", "Monte Carlo 0.", "transport 0."):
            assert sum(text.startswith(start) for text in texts) == panels
        assert (drawn / name).read_text().count('<g id="curve ') == panels * curves


def test_tables(drawn):
    for figure, ratio in (("07", "0.01"), ("13", "1")):
        rows = rows_of(drawn / f"figure_{figure}.csv")
        assert [(row["ratio"], row["eta"]) for row in rows[::RINGS]] == [(ratio, e) for e in ETAS]
        assert len(rows) == RINGS * len(ETAS)
        for row in rows:
            assert float(row["ring_from"]) < float(row["r"]) < float(row["ring_to"])
            assert float(row["transport_error"]) < 2e-5 * float(row["transport"])
        albedos = rows_of(drawn / f"figure_{figure}_albedos.csv")
        for row in albedos:
            assert 0 < float(row["albedo"]) < 1
            if row["curve"] == "monte_carlo":
                assert abs(float(row["relative_to_transport"]) - 1) < 0.03
                assert 0 < float(row["error"]) < 0.01


# ---- resuming ------------------------------------------------------------------------------------


def test_second_run_walks_what_is_missing(drawn):
    before = parts(drawn)
    walks = {f"walk_eta_{eta}_photons_120000_ratios_0.01_1" for eta in ETAS}
    assert set(before) == walks | {f"walk_{one}_photons_100000" for one in ("tissue", "slab")}
    lost, damaged = (f"walk_eta_{eta}_photons_120000_ratios_0.01_1" for eta in ETAS[1:])
    (drawn / "parts" / lost).unlink()
    (drawn / "parts" / damaged).write_bytes(before[damaged][1][:-100])
    draw(drawn, *SELECTION)
    after = parts(drawn)
    assert {name: content for name, (_, content) in after.items()} == {
        name: content for name, (_, content) in before.items()
    }
    assert {name for name in before if after[name][0] != before[name][0]} == {lost, damaged}
    # Another number of photons is another walk.
    draw(drawn, "--ratios", "1", "--etas", "1.0", "--photons", "8000")
    assert set(parts(drawn)) - set(after) == {"walk_eta_1.0_photons_8000_ratios_1"}


def test_wrong_options(tmp_path):
    for options, said in ((["--ratios", "0.3"], "0.3 is none of 0.0001"), (["--photons", "-1"], "--ph")):
        assert said in draw(tmp_path / "out", *options, status=2).stderr
        assert not (tmp_path / "out").exists()


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
    costs = (tmp_path / "costs.def").read_text()
    assert "CORE_COST_SOLVE(2e+09)" in costs and "CORE_COST_LUT(10)" in costs
    assert "CORE_COST(2, 2.5, 1.11, 9, 9e+06) /* better */" in costs
    kept = (PROGRAM.parents[1] / "costs.def").read_text()
    assert [costs.count(x) == kept.count(x) for x in ("#ifndef", "#undef", "#endif")] == [True] * 3
