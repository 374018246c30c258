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


# ---- daemons -------------------------------------------------------------------------------------


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
    assert by_option == eval_json(*MEDIUM, "--count", "2")


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
