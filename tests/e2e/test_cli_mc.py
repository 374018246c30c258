"""`dipole mc`: its table for people and for programs, its progress, and Ctrl-C."""

from __future__ import annotations

import json
import math
import signal

import pytest
from command_line import FAILED, USAGE, Terminal, dipole, eval_rows, read_csv, says

MEDIUM = ["--sigma-a", "0.1", "--sigma-s", "0.9", "--eta", "1.3"]
SHORT = [*MEDIUM, "--photons", "2e4", "--to", "4", "--rings", "4"]
ENDLESS = ["--sigma-a", "1e-4", "--sigma-s", "10", "--g", "0.9", "--photons", "1e10"]


def mc_json(*arguments: str) -> dict:
    """Returns the object of `dipole mc --format json`."""
    return json.loads(dipole("mc", "--format", "json", *arguments).stdout)


def test_table_for_people():
    text = dipole("mc", "--medium", "skin1", "--channel", "red", "--photons", "2e4").stdout
    assert text.startswith("skin1 red: Monte Carlo, R in 1/mm^2 per unit of power that entered\n")
    assert "sigma_a 0.032 1/mm, sigma_s 0.74 1/mm, g 0, eta 1.3, half space" in text
    assert "20480 photons, seed 1" in text
    assert "standard error" in text and "per unit of power that entered" in text
    for share in ("R, total", "beyond the last ring", "absorbed", "unfinished walks"):
        assert share in text
    assert "T, total" not in text and "CANCELLED" not in text
    assert len([line for line in text.splitlines() if "e-" in line and "%" in line]) == 20


def test_slabs_have_two_sides():
    text = dipole("mc", *SHORT, "--thickness", "2").stdout
    assert "slab of 2 mm" in text and "T, total" in text
    rows = read_csv(dipole("mc", *SHORT, "--thickness", "2", "--format", "csv").stdout)
    assert [row["quantity"] for row in rows[:8]] == ["R"] * 4 + ["T"] * 4


def test_csv_and_json_say_the_same():
    rows = read_csv(dipole("mc", *SHORT, "--format", "csv").stdout)
    report = mc_json(*SHORT)
    assert report["ended_by"] == "photons" and report["photons"] == 20480
    assert report["units"]["R"] == "1/mm^2 per unit of power that entered"
    assert report["edges"] == [0, 1, 2, 3, 4]
    (albedo,) = report["albedos"]
    rings = [row for row in rows if row["quantity"] == "R"]
    assert [float(row["value"]) for row in rings] == albedo["R"]
    assert [float(row["error"]) for row in rings] == albedo["R_error"]
    assert [int(row["photons"]) for row in rings] == report["R_photons"]
    assert [float(row["from"]) for row in rings] == report["edges"][:4]
    shares = {row["quantity"]: row for row in rows if row["quantity"] != "R"}
    assert set(shares) <= set(albedo["shares"])
    for name, row in shares.items():
        assert row["from"] == row["photons"] == ""
        assert float(row["value"]) == albedo["shares"][name]["value"]
        assert float(row["error"]) == albedo["shares"][name]["error"]
    area = [math.pi * (b * b - a * a) for a, b in zip(report["edges"], report["edges"][1:])]
    total = sum(a * R for a, R in zip(area, albedo["R"]))
    total += albedo["shares"]["R_over"]["value"]
    assert abs(total - albedo["shares"]["R_total"]["value"]) < 1e-12


def test_same_seed_same_output_whatever_the_daemon():
    text = dipole("mc", *SHORT, "--seed", "5", "--format", "json").stdout
    env = {"DIPOLED_MC_THREADS": "1", "DIPOLED_ISA": "portable"}
    assert dipole("mc", *SHORT, "--seed", "5", "--format", "json", env=env).stdout == text
    assert dipole("mc", *SHORT, "--seed", "6", "--format", "json").stdout != text


def test_many_albedos():
    report = mc_json(*SHORT, "--albedo", "0.5,0.9")
    assert [one["albedo"] for one in report["albedos"]] == [0.5, 0.9]
    assert report["albedos"][1]["R"] == mc_json(*SHORT)["albedos"][0]["R"]
    text = dipole("mc", *SHORT, "--albedo", "0.5,0.9").stdout
    assert "albedo 0.5\n" in text and "albedo 0.9\n" in text and "sigma_a + sigma_s 1 1/mm" in text


def test_a_measured_medium_with_another_g():
    report = mc_json("--medium", "skin1", "--channel", "blue", "--g", "0.8", "--photons", "5000")
    assert report["medium"] == "skin1" and report["channel"] == "blue"
    assert report["sigma_a"] == 0.48 and report["g"] == 0.8
    assert abs(report["sigma_s"] - 1.01 / 0.2) < 1e-12
    several = mc_json("--medium", "skin1,marble", "--channel", "red", "--photons", "5000")
    assert [one["channel"] for one in several["channels"]] == ["skin1 red", "marble red"]
    (row,) = eval_rows("--medium", "skin1", "--channel", "blue", "--g", "0.8", "--r", "1")
    assert (row["g"], float(row["sigma_s"])) == ("0.8", report["sigma_s"])


def test_error_targets():
    rings = mc_json(*MEDIUM, "--to", "3", "--error", "0.05")
    assert rings["ended_by"] == "errors" and rings["error_rings"] <= 0.05
    total = mc_json(*MEDIUM, "--total-error", "0.01")
    assert total["ended_by"] == "errors" and total["error_total"] <= 0.01
    missed = dipole("mc", *SHORT, "--error", "0.001", status=FAILED)
    assert "not enough for the error asked for: the worst ring has" in missed.stderr
    assert "standard error" in missed.stdout


test_wrong_command_lines_say_what_to_do = says(USAGE, ["mc"], [
    ([*MEDIUM, "--r", "1", "--to", "2"], "leave --from, --to, --rings and --log out"),
    ([*MEDIUM, "--r", "0,1"], "--r: give radii above 0"),
    ([], "give --medium NAME, or --sigma-a and --sigma-s"),
    (["--sigma-a", "1"], "give --medium NAME, or --sigma-a and --sigma-s"),
    (["--medium", "skin1", "--channel", "pink"], "--channel: 'pink' is unknown; it is red, green"),
    (["--sigma-a", "1,2", "--sigma-s", "1,2,3"], "--sigma-s has 3 values and --sigma-a has 2: give one"),
    (["--medium", "skin1", "--eta", "1.3,1.4"], "--eta has 2 values and --medium has 3: give one value"),
    (["--medium", "skin", "--channel", "red"], "--medium: 'skin' is unknown; this daemon has"),
    ([*MEDIUM, "--medium", "skin1"], "--medium NAME stands for --sigma-a and --sigma-s"),
    ([*MEDIUM, "--channel", "red"], "--channel is one of a measured medium: give --medium too"),
    ([*MEDIUM, "--log"], "--log needs --from, above 0"),
    ([*MEDIUM, "--photons", "1.5"], "--photons: give a whole number from 1 to 9e15, such as 2000000"),
    ([*MEDIUM, "--photons", "0"], "--photons: give a whole number"),
    ([*MEDIUM, "--rings", "99999999999"], "--rings: give at most"),
])


test_what_the_daemon_refuses = says(FAILED, ["mc", *MEDIUM], [
    (["--g", "1"], "bad-value: g: allowed: between -1 and 1, exclusive (--g)"),
    (["--thickness", "-1"], "bad-value: thickness: allowed: 0, at least"),
    (["--albedo", "0.5,2"], "bad-value: albedo: allowed: 0 to 1 (--albedo)"),
    (["--rings", "4097"], "bad-count: ring_count: allowed: 1 to 4096 (--rings)"),
    (["--from", "-1"], "(--from)"),
    (["--error", "2"], "bad-value: error_rings: allowed: 0 (none), or 1e-9 to 1 (--error)"),
    (["--total-error", "-1"], "(--total-error)"),
    (["--photons", "1e12"], "too-large: photons: allowed: at most 10000000000 (--photons)"),
])


def test_too_many_albedos():
    albedos = ",".join(["0.5"] * 17)
    assert "at most 16" in dipole("mc", *MEDIUM, "--albedo", albedos, status=FAILED).stderr


def test_progress_and_ctrl_c():
    run = Terminal("mc", *ENDLESS, on=[2])
    run.read_until(lambda seen: "worst ring" in seen)
    assert "photons" in run.seen and " left" in run.seen and run.seen.startswith("\r[")
    run.process.send_signal(signal.SIGINT)
    run.read_until(lambda seen: "cancelled after" in seen)
    status, output = run.end()
    assert status == FAILED
    assert "CANCELLED: this is what had been walked by then" in output
    assert "R, total" in output


@pytest.mark.parametrize("photons", ["1", "2e6"])
def test_no_bar_is_left_behind(photons):
    run = Terminal("mc", *MEDIUM, "--photons", photons, on=[2])
    status, output = run.end()
    assert status == 0 and "R, total" in output
    assert run.seen == "" or run.seen.endswith("\r\033[K")


def test_phase_functions():
    given = [*SHORT, "--g", "0.5", "--phase", "two-term", "--phase-share", "0.8"]
    text = dipole("mc", *given, "--phase-g", "-0.2").stdout
    assert "phase function two-term: " in text and ", phase_share 0.8, phase_g -0.2\n" in text
    report = mc_json(*given, "--phase-g", "-0.2")
    assert [report[key] for key in ("phase", "phase_share", "phase_g")] == ["two-term", 0.8, -0.2]
    assert mc_json(*SHORT)["phase"] == "henyey-greenstein"
    refusal = dipole("mc", *given, status=FAILED)
    assert "phase_g" in refusal.stderr
    unknown = dipole("mc", *SHORT, "--phase", "mie", status=USAGE)
    assert "henyey-greenstein, modified, two-term" in unknown.stderr


def test_a_walk_within_an_aperture_is_what_a_fit_takes():
    """Rings within an aperture give the medium back with it. The totals count all light."""
    given = ["--sigma-a", "0.1", "--sigma-s", "5", "--g", "0.8", "--eta", "1.4", "--photons", "4e5",
             "--from", "0.5", "--to", "6", "--rings", "16", "--log"]  # fmt: skip
    every, some = mc_json(*given), mc_json(*given, "--detector-na", "0.5")
    assert some["detector_na"] == 0.5 and "detector_na" not in every
    (all_light,), (seen,) = every["albedos"], some["albedos"]
    assert seen["shares"]["R_total"] == all_light["shares"]["R_total"]
    assert all(0 < few < 0.5 * many for few, many in zip(seen["R"], all_light["R"]))
    text = dipole("mc", *SHORT, "--detector-na", "0.5").stdout
    assert "rings have the light at angles whose sine is at most 0.5 outside\n" in text
    lines = ["r,R,error"]
    edges = zip(some["edges"], some["edges"][1:])
    for (inner, outer), R, error in zip(edges, seen["R"], seen["R_error"]):
        lines.append(f"{math.sqrt(inner * outer)},{R},{error}")
    fitted = ["--model", "transport", "--format", "json", "--g", "0.8", "--eta", "1.4"]
    run = dipole("fit", *fitted, "--detector-na", "0.5", stdin="\n".join(lines))
    (found,) = json.loads(run.stdout)["samples"]
    assert abs(found["sigma_a"] - 0.1) < 3 * found["sigma_a_error"]
    assert abs(found["sigma_s_prime"] - 1) < 3 * found["sigma_s_prime_error"]
    assert 0.005 < found["model_error"] < 0.04
    refusal = dipole("mc", *SHORT, "--detector-na", "1.1", status=FAILED)
    assert "detector_na: allowed: 0.01 to 1" in refusal.stderr


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
    for sample, sigma_a in zip(report["samples"], (0.02, 0.1), strict=True):
        assert sample["status"] == "fitted"
        assert abs(sample["sigma_a"] - sigma_a) < 4 * sample["sigma_a_error"]
    (albedo,) = mc_json(*MEDIUM, "--r", "1", "--photons", "2e4", "--detector-na", "0.5")["albedos"]
    text = dipole("mc", *MEDIUM, "--r", "1", "--photons", "2e4", "--detector-na", "0.5").stdout
    (at_r,) = albedo["at_r"]
    assert at_r["R"] == albedo["R"][0] and at_r["detector_na"] == 0.5
    assert f"{at_r['R']:.5e}" in text
    phase = ["--phase", "modified", "--phase-share", "0.9"]
    for other, column in (["--thickness", "4"], "thickness"), (phase, "phase"):
        run = dipole("mc", *MEDIUM, *other, "--r", "1,2", "--photons", "2e4", "--format", "csv")
        refused = dipole("fit", stdin=run.stdout, status=FAILED)
        assert f"the column {column} is of no medium that can be fitted" in refused.stderr


def test_several_channels_are_as_many_jobs():
    options = ["--photons", "2000", "--rings", "3"]
    both = mc_json("--medium", "skin1", "--channel", "blue,red", "--g", "0.5", *options)
    red, blue = both["channels"]
    assert [red["channel"], blue["channel"]] == ["red", "blue"]
    alone = mc_json("--medium", "skin1", "--channel", "blue", "--g", "0.5", *options)
    assert blue == alone
    text = dipole("mc", "--medium", "skin1", "--format", "csv", *options).stdout
    rows = read_csv(text)
    assert {row["channel"] for row in rows} == {"red", "green", "blue"}
    given = mc_json("--sigma-a", "0.1,0.2", "--sigma-s", "1", "--eta", "1.3,1.4", *options)
    assert [(one["channel"], one["sigma_a"], one["eta"]) for one in given["channels"]] == [
        ("1", 0.1, 1.3), ("2", 0.2, 1.4)
    ]
    table = dipole("mc", "--medium", "skin1", *options).stdout
    assert [line.split(":")[0] for line in table.splitlines() if "Monte Carlo" in line] == [
        "skin1 red", "skin1 green", "skin1 blue"
    ]
