"""`dipole mc`: its table for people and for programs, its progress, and Ctrl-C."""

from __future__ import annotations

import json
import math
import signal

import pytest
from command_line import FAILED, Terminal, dipole, read_csv

MEDIUM = ["--sigma-a", "0.1", "--sigma-s", "0.9", "--eta", "1.3"]
SHORT = [*MEDIUM, "--photons", "2e4", "--to", "4", "--rings", "4"]
ENDLESS = ["--sigma-a", "1e-4", "--sigma-s", "10", "--g", "0.9", "--photons", "1e10"]


def mc_json(*arguments: str) -> dict:
    """Returns the object of `dipole mc --format json`."""
    return json.loads(dipole("mc", "--format", "json", *arguments).stdout)


def test_csv_adds_up():
    """The light of the rings and of what lies beside them is all that leaves."""
    rows = read_csv(dipole("mc", *SHORT, "--format", "csv").stdout)
    total = 0.0
    for row in rows:
        if row["quantity"] == "R":
            total += math.pi * (float(row["to"]) ** 2 - float(row["from"]) ** 2) * float(row["value"])
        elif row["quantity"] in ("R_over", "R_under"):
            total += float(row["value"])
    (whole,) = [float(row["value"]) for row in rows if row["quantity"] == "R_total"]
    assert abs(total - whole) < 1e-12


def test_same_seed_same_output_whatever_the_daemon():
    text = dipole("mc", *SHORT, "--seed", "5", "--format", "json").stdout
    env = {"DIPOLED_MC_THREADS": "1", "DIPOLED_ISA": "portable"}
    assert dipole("mc", *SHORT, "--seed", "5", "--format", "json", env=env).stdout == text
    assert dipole("mc", *SHORT, "--seed", "6", "--format", "json").stdout != text


def test_progress_and_ctrl_c():
    run = Terminal("mc", *ENDLESS, on=[2])
    run.read_until(lambda seen: "worst ring" in seen)
    assert "photons" in run.seen and " left" in run.seen and run.seen.startswith("\r[")
    run.process.send_signal(signal.SIGINT)
    run.read_until(lambda seen: "cancelled after" in seen)
    status, output = run.end()
    assert status == FAILED
    assert "CANCELLED: this is what had been walked by then" in output
    assert "R_total" in output


@pytest.mark.parametrize("photons", ["1", "2e6"])
def test_no_bar_is_left_behind(photons):
    run = Terminal("mc", *MEDIUM, "--photons", photons, on=[2])
    status, output = run.end()
    assert status == 0 and "R_total" in output
    assert run.seen == "" or run.seen.endswith("\r\033[K")


def test_a_walk_within_an_aperture_is_what_a_fit_takes():
    """Rings within an aperture give the medium back with it. The totals count all light."""
    given = ["--sigma-a", "0.1", "--sigma-s", "5", "--g", "0.8", "--eta", "1.4", "--photons", "4e5",
             "--from", "0.5", "--to", "6", "--rings", "16", "--log"]  # fmt: skip
    every, some = mc_json(*given)["rows"], mc_json(*given, "--detector-na", "0.5")["rows"]
    assert some[0]["detector_na"] == 0.5 and "detector_na" not in every[0]
    assert (some[16]["quantity"], some[16]["value"]) == ("R_total", every[16]["value"])
    lines = ["r,R,error"]
    for few, many in zip(some[:16], every[:16]):
        assert 0 < few["value"] < 0.5 * many["value"]
        lines.append(f"{math.sqrt(few['from'] * few['to'])},{few['value']},{few['error']}")
    fitted = ["--model", "transport", "--format", "json", "--g", "0.8", "--eta", "1.4"]
    run = dipole("fit", *fitted, "--detector-na", "0.5", stdin="\n".join(lines))
    (found,) = json.loads(run.stdout)["rows"]
    assert abs(found["sigma_a"] - 0.1) < 3 * found["sigma_a_error"]
    assert abs(found["sigma_s_prime"] - 1) < 3 * found["sigma_s_prime_error"]
    assert 0.005 < found["model_error"] < 0.04


def test_radii_give_readings_that_fit_reads_as_they_are():
    """Values at --r are within a few standard errors of transport, and CSV needs no change."""
    medium = ["--sigma-a", "0.02,0.1", "--sigma-s", "10", "--g", "0.9", "--eta", "1.4"]
    run = dipole("mc", *medium, "--r", "3,0.5,1,2", "--photons", "4e6", "--format", "csv")
    rows = read_csv(run.stdout)
    known = read_csv(
        dipole("eval", *medium, "--model", "transport", "--r", "3,0.5,1,2", "--format", "csv").stdout
    )
    assert [row["r"] for row in rows] == ["3", "0.5", "1", "2"] * 2
    for row, one in zip(rows, known, strict=True):
        R, error = float(row["R"]), float(row["error"])
        assert (row["sample"], row["r"]) == (one["channel"], one["r"])
        assert abs(R - float(one["R"])) < 4 * error + 2e-3 * R and error < 0.03 * R
    report = json.loads(dipole("fit", "--format", "json", "--model", "transport",
                               stdin=run.stdout).stdout)  # fmt: skip
    for sample, sigma_a in zip(report["rows"], (0.02, 0.1), strict=True):
        assert sample["status"] == "fitted"
        assert abs(sample["sigma_a"] - sigma_a) < 4 * sample["sigma_a_error"]
