"""`dipole eval`: the same numbers as a table, as CSV and as JSON, for all kinds of arguments."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from command_line import (
    FAILED, USAGE, Proxy, busy, dipole, eval_json, eval_rows, points, read_csv, says,
)
from daemons import read_log_line
from lists import everywhere
from test_cli_numbers import many_numbers

MEDIUM = ["--sigma-a", "0.01,0.1", "--sigma-s", "10", "--g", "0.9", "--eta", "1.4"]
HEADER = "model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,cdf,numerical_error,model_error,notes"


# ---- numbers -------------------------------------------------------------------------------------


@pytest.mark.parametrize("evaluator", ["f64", "f32", "lut"])
@pytest.mark.parametrize("moments", ["exact", "fit"])
def test_points_says_the_same_as_eval(shared, evaluator, moments):
    """Both commands use one daemon, so that it builds each table once, and for one medium only.
    points asks for media that vary, whose kernels round otherwise, have double precision for single,
    and surfaces for tables."""
    within = {"f64": 3e-14, "f32": 1e-5, "lut": 2e-4}[evaluator]
    of = ["--evaluator", evaluator, "--connect", shared.url()]
    medium = [*MEDIUM[:1], "0.01" if evaluator == "lut" else "0.01,0.1", *MEDIUM[2:]]
    rows = eval_rows(
        *[*medium, "--model", "all", "--r", "0,0.3,1,7.5,inf", "--wanted", "R,albedo,cdf"],
        *[*of, "--moments", moments],
        quiet=False,  # The command names the models that it leaves out.
    )
    assert {row["model"] for row in rows} >= set(everywhere())
    columns = ["model", "sigma_a", "sigma_s", "g", "eta", "r"]
    lines = [",".join(row[column] for column in columns) + f",{moments}" for row in rows]
    text = "\n".join([",".join([*columns, "moments"]), *lines])
    again = read_csv(points(text, *of))
    for row, other in zip(rows, again, strict=True):
        for column in ("R", "albedo", "cdf"):
            assert float(other[column]) == pytest.approx(float(row[column]), rel=within)


def test_extremes():
    rows = eval_rows(*MEDIUM, "--r", "0,inf", "--wanted", "R,cdf")
    assert [row["r"] for row in rows] == ["0", "inf"] * 2
    assert float(rows[0]["R"]) > 0 and rows[0]["cdf"] == "0"
    assert rows[1]["R"] == "0" and rows[1]["cdf"] == "1"


def test_defaults():
    rows = eval_rows("--sigma-a", "0.1", "--sigma-s", "1")
    assert len(rows) == 21
    assert [float(row["r"]) for row in rows] == [i * 0.5 for i in range(21)]
    expected = {"model": "better", "channel": "1", "g": "0", "eta": "1.3", "cdf": ""}
    assert expected.items() <= rows[0].items()
    assert rows == eval_rows(
        *["--sigma-a", "0.1", "--sigma-s", "1", "--g", "0", "--eta", "1.3", "--model", "better"],
        *["--from", "0", "--to", "10", "--count", "21", "--moments", "exact"],
        *["--wanted", "R,albedo", "--evaluator", "f64"],
    )


def test_single_values_hold_for_all_channels():
    rows = eval_rows(*MEDIUM, "--r", "1")
    assert [row["sigma_a"] for row in rows] == ["0.01", "0.1"]
    for column, value in {"sigma_s": "10", "g": "0.9", "eta": "1.4"}.items():
        assert [row[column] for row in rows] == [value, value]


def test_eta_of_a_measured_medium_can_be_replaced():
    usual = eval_rows("--medium", "marble", "--r", "1")
    same = eval_rows("--medium", "marble", "--eta", "1.3", "--r", "1")
    other = eval_rows("--medium", "marble", "--eta", "1.2,1.3,1.5", "--r", "1")
    assert usual == same
    assert [row["eta"] for row in other] == ["1.2", "1.3", "1.5"]
    assert other[1] == usual[1] and other[0]["R"] != usual[0]["R"]


def test_grids():
    linear = eval_json(*MEDIUM, "--from", "1", "--to", "3", "--count", "5")["r"]
    assert linear == [1, 1.5, 2, 2.5, 3]
    grid = ["--from", "0.01", "--to", "100", "--count", "5", "--log"]
    ratios = eval_json(*MEDIUM, *grid)["r"]
    assert ratios[0] == 0.01 and ratios[-1] == 100
    assert ratios == pytest.approx([0.01, 0.1, 1, 10, 100], rel=1e-12)
    grid = ["--from", "0.1", "--to", "0.1", "--count", "1"]
    single = eval_json(*MEDIUM, *grid, "--evaluator", "f32")
    assert single["r"] == [0.1]  # the shortest number that reads back to the single precision radius
    steps = eval_json(*MEDIUM, "--from", "0.023", "--to", "1.863", "--count", "21")["r"]
    assert "0.943" in map(repr, steps) and all(len(repr(r)) <= 5 for r in steps)


def test_models_are_asked_for_once_each():
    rows = eval_rows(*MEDIUM, "--r", "1", "--model", "classical,better,classical")
    assert [row["model"] for row in rows] == ["classical"] * 2 + ["better"] * 2
    every = eval_rows(*MEDIUM, "--r", "1", "--model", "all", quiet=False)
    assert {row["model"] for row in every} >= {"classical", "better"}


# ---- formats -------------------------------------------------------------------------------------


def test_csv():
    text = dipole("eval", *MEDIUM, "--count", "3", "--format", "csv").stdout
    assert text.splitlines()[0] == HEADER
    assert len(text.splitlines()) == 1 + 2 * 3
    for row in read_csv(text):
        assert 0 < float(row["numerical_error"]) < 1e-12
        assert row["cdf"] == ""  # The cdf was not wanted.
        # Empty if it was not measured.
        assert row["model_error"] == "" or float(row["model_error"]) > 0


def test_csv_without_radii():
    rows = eval_rows(*MEDIUM, "--wanted", "albedo")
    assert len(rows) == 2
    assert all(row["r"] == row["R"] == row["cdf"] == "" for row in rows)
    assert all(0 < float(row["albedo"]) < 1 for row in rows)


def test_json_says_the_same_as_csv():
    arguments = [*MEDIUM, "--model", "classical,better", "--wanted", "R,albedo,cdf", "--r", "0,1,inf"]
    report = eval_json(*arguments)
    assert report["units"]["r"] == "mm"
    assert report["units"]["R"] == "1/mm^2 per unit of power that entered"
    assert report["evaluator"] == "f64" and report["moments"] == "exact"
    assert report["r"] == [0, 1, "inf"]
    rows = []
    for model in report["models"]:
        assert model["source"] != ""
        for channel in model["channels"]:
            assert channel["model_error"] is None or channel["model_error"] > 0
            for i, r in enumerate(report["r"]):
                error = channel["numerical_error"]
                if channel["numerical_error_per_mm"] > 0:
                    error += channel["numerical_error_per_mm"] * float(r)
                rows.append(
                    [model["model"], channel["channel"]]
                    + [float(channel[name]) for name in ("sigma_a", "sigma_s", "g", "eta")]
                    + [float(r), channel["R"][i], channel["albedo"], channel["cdf"][i], error]
                )
    expected = [
        [*list(row.values())[:2], *map(float, list(row.values())[2:11])]
        for row in eval_rows(*arguments)
    ]
    assert rows == expected


def test_json_of_a_measured_medium():
    report = eval_json("--medium", "skin1", "--count", "2")
    assert report["medium"] == "skin1"
    channels = report["models"][0]["channels"]
    assert [channel["channel"] for channel in channels] == ["red", "green", "blue"]
    assert [channel["sigma_a"] for channel in channels] == [0.032, 0.17, 0.48]
    assert all("cdf" not in channel and len(channel["R"]) == 2 for channel in channels)


def test_table_is_aligned_and_has_units():
    text = dipole("eval", "--medium", "skin1", "--model", "classical,better").stdout
    title, profiles, channels = text.split("\n\n")
    assert title == (
        "skin1: R in 1/mm^2 per unit of power that entered; evaluator f64, moments exact"
    )
    lines = profiles.splitlines()
    assert lines[0].split() == ["classical"] * 3 + ["better"] * 3
    assert lines[1].split() == ["r", *["R", "red", "R", "green", "R", "blue"] * 2]
    assert lines[2].split() == ["mm"] + ["1/mm^2"] * 6
    assert set(lines[3]) == {"-", " "} and len(lines[3].split()) == 7
    assert len(lines) == 4 + 21
    ends = [match.end() - 1 for match in re.finditer("-+", lines[3])]
    for line in [*lines[:3], *lines[4:]]:
        cells = [(line + " ")[end : end + 2].strip() for end in ends]
        assert len(line) == len(lines[3])
        assert all(cell != "" for cell in cells[1:])  # Columns are aligned.
    rows = eval_rows("--medium", "skin1", "--model", "classical,better")
    first = [float(cell) for cell in lines[5].split()]  # of the second radius
    exact = [float(rows[1]["r"])] + [float(row["R"]) for row in rows[1::21]]
    assert first == pytest.approx(exact, rel=1e-4)
    assert "albedo" in channels and "numerical error" in channels and "model error" in channels
    assert [line.split()[:2] for line in channels.splitlines()[3:9]] == [
        [model, colour] for model in ("classical", "better") for colour in ("red", "green", "blue")
    ]


def test_table_holds_what_is_wanted():
    text = dipole("eval", *MEDIUM, "--r", "2", "--wanted", "cdf").stdout
    assert "cdf 1" in text and "cdf 2" in text and "R 1" not in text and "albedo" not in text
    assert dipole("eval", *MEDIUM, "--wanted", "albedo").stdout.count("better") == 2


# ---- daemons -------------------------------------------------------------------------------------


def test_a_long_list_is_asked_for_in_parts(daemon):
    small = daemon("--max-frame-bytes", "4096").url()
    radii = ",".join(str(i / 16) for i in range(3000))
    arguments = [*MEDIUM, "--wanted", "R,albedo,cdf", "--r", radii]
    for evaluator in ("f64", "f32"):
        whole = eval_rows(*arguments, "--evaluator", evaluator)
        parts = eval_rows(*arguments, "--evaluator", evaluator, "--connect", small)
        for row in (*whole, *parts):
            row.pop("model_error")  # the largest of each part, which has its own comparison
        assert whole == parts
    assert len(whole) == 6000


@pytest.mark.parametrize("evaluator", ["f64", "f32", "lut"])
def test_a_large_grid_comes_in_parts(daemon, evaluator):
    small = daemon("--max-frame-bytes", "65536", "--max-part-bytes", "16384").url()
    arguments = [*MEDIUM, "--wanted", "R,albedo,cdf", "--count", "20000", "--evaluator", evaluator]
    whole = dipole("eval", "--format", "csv", *arguments).stdout
    assert whole == dipole("eval", "--format", "csv", *arguments, "--connect", small).stdout
    assert whole.count("\n") == 1 + 2 * 20000


def test_several_models_and_a_choice_in_parts(daemon):
    small = daemon("--max-frame-bytes", "65536", "--max-part-bytes", "16384").url()
    grid = ["--from", "1", "--to", "5", "--count", "9000"]
    for how in (["--model", "classical,beam,better"], ["--tolerance", "0.1"]):
        arguments = ["--medium", "skin1", *grid, *how]
        assert eval_json(*arguments) == eval_json(*arguments, "--connect", small)


def test_a_deadline():
    slow = [*MEDIUM, "--from", "1", "--to", "4", "--model", "transport"]
    run = dipole("eval", *slow, "--deadline-ms", "1", status=FAILED)
    assert run.stdout == ""
    assert run.stderr.endswith("more milliseconds, or 0 for no limit (--deadline-ms)\n")
    assert "deadline: " in run.stderr
    for enough in ("0", "100000", "4294967295"):
        arguments = [*MEDIUM, "--count", "3", "--deadline-ms", enough]
        assert eval_rows(*arguments) == eval_rows(*MEDIUM, "--count", "3")


def test_the_daemon_is_named_by_option_or_environment(daemon):
    one = daemon()
    by_option = eval_json(*MEDIUM, "--count", "2", "--connect", one.url("tcp"))
    by_variable = dipole(
        *["eval", *MEDIUM, "--count", "2", "--format", "json"], env={"DIPOLED": one.url("unix")}
    )
    with one.client() as client:
        assert client.statistics()["requests_eval"] == 2
    assert by_variable.stdout == dipole("eval", *MEDIUM, "--count", "2", "--format", "json").stdout
    assert by_option["models"] == eval_json(*MEDIUM, "--count", "2")["models"]


def test_a_private_daemon_listens_for_nobody_else(tmp_path):
    path = tmp_path / "socket"
    dipole("media", env={"DIPOLED_LISTEN": f"unix:{path}"})
    assert not path.exists()


def test_a_private_daemon_serves_nothing_else(daemon):
    """An environment that makes another daemon serve other clients does not affect a private
    one."""
    one = daemon("--modbus", "tcp:127.0.0.1:0", "--metrics", "127.0.0.1:0")
    modbus = one.url("modbus-tcp").removeprefix("modbus-")
    line = next(line for line in map(read_log_line, one.log) if line.get("event") == "metrics")
    metrics = line["url"].removeprefix("http://").split("/")[0]
    dipole("media", env={"DIPOLED_MODBUS": modbus})
    dipole("media", env={"DIPOLED_METRICS": metrics, "DIPOLED_HTTP": metrics})


def test_a_busy_daemon_is_asked_again(daemon):
    def on_eval(number: int, request_id: int):
        return busy(request_id) if number < 3 else None

    with Proxy(daemon().url(), on_eval) as proxy:
        rows = eval_rows(*MEDIUM, "--connect", proxy.url)
    assert rows == eval_rows(*MEDIUM)


def test_a_daemon_that_stays_busy_is_given_up(daemon):
    with Proxy(daemon().url(), lambda number, request_id: busy(request_id)) as proxy:
        patience = ["--timeout-ms", "50", "--retry-ms", "300"]
        run = dipole("eval", *MEDIUM, "--connect", proxy.url, *patience, status=1)
    assert "busy" in run.stderr


def test_a_connection_that_is_lost(daemon):
    with Proxy(daemon().url(), lambda number, request_id: False) as proxy:
        run = dipole("eval", *MEDIUM, "--connect", proxy.url, "--retry-ms", "300", status=1)
    assert run.stdout == ""
    said = f"the daemon, or a proxy, closed the connection at {proxy.url} without a reason"
    assert said in run.stderr


def test_radii_are_the_ones_that_the_evaluator_took():
    radii = [number for number in many_numbers(500) if number < 3e38 and number >= 0]
    rows = eval_rows(
        *["--sigma-a", "0", "--sigma-s", "1", "--evaluator", "f32", "--wanted", "cdf"],
        *["--r", ",".join(map(repr, radii))],
    )
    for row, r in zip(rows, radii, strict=True):
        assert np.float32(row["r"]) == np.float32(r) and len(row["r"]) <= 13
        assert math.isfinite(float(row["cdf"]))


def test_spatial_frequencies_are_no_radii(client, tmp_path):
    """R_f has frequencies f in 1/mm, in each form, whether --f gives them or --r."""
    exact = client.eval("better", (0.01, 10, 0.9, 1.4), [0.1, 1], wanted=["R_f"]).R_f[0].tolist()
    medium = ["--sigma-a", "0.01", "--sigma-s", "10", "--g", "0.9", "--eta", "1.4"]
    for options in (["--f", "0.1,1"], ["--wanted", "R_f,albedo", "--r", "0.1,1"]):
        rows = eval_rows(*medium, *options)
        assert [(row["f"], float(row["R_f"])) for row in rows] == list(zip(["0.1", "1"], exact))
        assert "r" not in rows[0] and rows[0]["albedo"]
        report = eval_json(*medium, *options)
        assert (report["f"], report["units"]["f"]) == ([0.1, 1], "1/mm") and "r" not in report
        lines = dipole("eval", *medium, *options).stdout.splitlines()
        assert lines[0].startswith("R_f, the reflectance of striped light; evaluator f64")
        assert lines[3].split() == ["f", "R_f", "1"] and lines[4].split() == ["1/mm", "1"]
        assert not any(" mm" in line or "r = " in line for line in lines)
        assert any("up to f = 1 1/mm" in line for line in lines)
    both = eval_json(*medium, "--wanted", "R,R_f", "--r", "0.1,1")
    assert both["r"] == both["f"] == [0.1, 1] and both["units"]["r"] == "mm"
    picture = tmp_path / "f.svg"
    dipole("plot", *medium, "--quantity", "R_f", "--f", "0.1,1", "--plot", str(picture), quiet=False)
    assert "f (1/mm)" in picture.read_text() and "r (mm)" not in picture.read_text()


def test_rows_of_spatial_frequencies(client):
    exact = client.eval("better", (0.01, 10, 0.9, 1.4), [0.1, 1], wanted=["R_f"]).R_f[0].tolist()
    media = "sigma_a,sigma_s,g,eta{}\n0.01,10,0.9,1.4{}\n"
    rows = read_csv(points(media.format("", ""), "--f", "0.1,1"))
    assert [(row["f"], float(row["R_f"])) for row in rows] == list(zip(["0.1", "1"], exact))
    (row,) = read_csv(points(media.format(",f", ",1"), "--wanted", "R_f"))
    assert (row["status"], float(row["R_f"])) == ("ok", exact[1])
    run = dipole("points", "--wanted", "R_f", stdin=media.format("", ""), status=FAILED)
    assert "the column f is missing" in run.stderr
    run = dipole("points", "--f", "1", stdin=media.format(",f", ",1"), status=FAILED)
    assert "has the column f: leave --f out" in run.stderr


test_frequencies_are_for_R_f = says(USAGE, [], [
    (["eval", *MEDIUM, "--f", "1", "--r", "1"], "--f is for R_f, and --r for all else"),
    (["eval", *MEDIUM, "--f", "1", "--wanted", "R"], "which only R_f has: ask for R_f alone"),
    (["eval", *MEDIUM, "--f", "1", "--to", "2"], "--f gives the frequencies one by one"),
    (["plot", *MEDIUM, "--f", "1"], "which only R_f has"),
    (["points", "--f", "1", "--wanted", "R"], "which only R_f has"),
])  # fmt: skip


def test_the_usual_model_is_transport_by_table(client):
    """As the README advises. --help gives the reason."""
    run = dipole("eval", *MEDIUM, "--r", "0.5,1", "--format", "csv", usual=True)
    rows = read_csv(run.stdout)
    assert {row["model"] for row in rows} == {"transport"}
    media = [(0.01, 10, 0.9, 1.4), (0.1, 10, 0.9, 1.4)]
    answer = client.eval("transport", media, np.float32([0.5, 1]), evaluator="lut")
    assert [np.float32(row["R"]) for row in rows] == answer.R.ravel().tolist()
    said = dipole("eval", "--help").stdout
    assert "If no model is named, it is transport by table" in said


@pytest.mark.parametrize(
    "command",
    [
        ["eval", "--sigma-a", "0.1", "--sigma-s", "1", "--eta", "1.4", "--r", "1"],
        ["sample", "--sigma-a", "0.1", "--sigma-s", "1", "--eta", "1.4"],
        ["table", "--sigma-a", "0.1", "--sigma-s", "1", "--eta", "1.4"],
        ["invert", "--albedo", "0.5", "--mean-free-path", "1", "--eta", "1.4"],
        ["mc", "--sigma-a", "0.1", "--sigma-s", "1", "--eta", "1.4", "--photons", "100"],
    ],
    ids=lambda command: command[0],
)
def test_the_foot_has_the_factor_of_power_launched(command):
    """Rule E8 of the protocol."""
    (line,) = [line for line in dipole(*command).stdout.splitlines() if "launched" in line]
    assert line.endswith(f"= {1 - (0.4 / 2.4) ** 2:.6g} (eta 1.4)")


def test_a_table_knows_measured_media(tmp_path):
    path = str(tmp_path / "skin.table")
    dipole("table", "--medium", "skin1", "--output", path, quiet=False)
    rows = read_csv(dipole("eval", "--table", path, "--r", "1", "--format", "csv").stdout)
    assert [row["channel"] for row in rows] == ["skin1 red", "skin1 green", "skin1 blue"]
