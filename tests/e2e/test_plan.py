"""The simulation of `make plan` against closed formulas of queues, and its command. That it agrees
with daemons is measured by `make check-plan`."""

import importlib.util
import math
import re

import numpy as np
import pytest
from daemons import BUILD, REPOSITORY, environment, finished

COUNT, RUNS = 400_000, 8


@pytest.fixture(scope="module")
def plan():
    spec = importlib.util.spec_from_file_location("plan", REPOSITORY / "tests/plan.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def times(rate: float, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).exponential(1 / rate, COUNT)


def mean_of_runs(run) -> float:
    return float(np.mean([run(seed) for seed in range(RUNS)]))


@pytest.mark.parametrize("busy", [0.3, 0.7, 0.9])
def test_services_that_are_equally_long(plan, busy):
    """Pollaczek and Khinchine: the mean wait is busy / (2 (1 - busy)) services."""
    mean = mean_of_runs(lambda seed: plan.waits_of(times(busy, seed), np.ones(COUNT)).mean())
    assert mean == pytest.approx(busy / (2 * (1 - busy)), rel=0.05)


@pytest.mark.parametrize("busy", [0.3, 0.7])
def test_services_that_are_random(plan, busy):
    """M/M/1: a wait is longer than t with the probability busy exp(-(1 - busy) t)."""

    def run(seed: int) -> float:
        return np.quantile(plan.waits_of(times(busy, seed), times(1.0, seed + 50)), 0.99)

    assert mean_of_runs(run) == pytest.approx(math.log(100 * busy) / (1 - busy), rel=0.05)


def test_a_plan_keeps_its_limits_and_grows_with_the_farm(plan):
    costs = {"small": plan.Cost(1e-5, 200, 500), "bulk": plan.Cost(1e-3, 300_000, 800_000)}
    mix = {"small": 0.95, "bulk": 0.05}
    plans = [plan.plan(mix, costs, nodes, 10.0, 16, 5e-3) for nodes in (1000, 10_000, 100_000)]
    mean_s = 0.95 * 1e-5 + 0.05 * 1e-3
    for one in plans:
        assert one.busy <= 0.7 and one.wait_s <= 5e-3
        assert one.cores >= one.requests_per_s * mean_s / 0.7
        assert one.daemons == -(-one.cores // 16)
        assert one.out_bits_per_s > 8 * one.requests_per_s * (0.95 * 500 + 0.05 * 800_000)
    assert plans[2].cores == pytest.approx(100 * plans[0].cores, rel=0.3)
    strict = plan.plan(mix, costs, 10_000, 10.0, 16, 1e-3)
    assert strict.cores > plans[1].cores
    # What is in the background takes cores, and lets nobody wait.
    costs["new"] = plan.Cost(7e-3, 200, 500)
    more = plan.plan(mix | {"new": 0.01}, costs, 10_000, 10.0, 16, 5e-3)
    assert more.cores > plans[1].cores + 0.01 / 1.01 * 10_000 * 10 * 7e-3


def test_the_command_prints_both_tables(tmp_path):
    file = tmp_path / "tables.md"
    file.write_text("before\n<!-- plan -->\nold\n<!-- end of plan -->\nbehind\n")
    words = ["--seconds", "0.05", "--nodes", "2e3", "--write", str(file)]
    said = finished(
        "/usr/bin/python3", str(REPOSITORY / "tests/plan.py"), *words,
        env=environment(TESTED_BUILD=str(BUILD), PYTHONPATH=str(REPOSITORY / "clients/python"))
    )
    assert said.returncode == 0, said.stderr
    text = file.read_text()
    assert said.stdout.strip() in text and "old" not in text
    assert text.startswith("before\n") and text.endswith("behind\n")
    assert re.search(r"^\| small \| 0\.7 \| \S+ us \| \d+ \| \d+ \|$", text, re.M)
    assert re.search(r"^\| 2,000 \| 20,000 \| \d+ \| \d+ \| \d\.\d\d ms \|", text, re.M)


def test_the_document_has_the_tables_of_the_command(plan):
    """DEPLOYING.md has a row for each kind and each size, as the command prints them."""
    text = (REPOSITORY / "server/DEPLOYING.md").read_text()
    part = re.search(r"<!-- plan -->\n(.*)<!-- end of plan -->", text, re.S)[1]
    kinds = [kind for kind, share in plan.MIX.items() if share > 0]
    assert re.findall(r"^\| (\w+) \| 0\.", part, re.M) == kinds
    assert re.findall(r"^\| ([\d,]+) \| [\d,]+ \|", part, re.M) == [f"{n:,}" for n in plan.NODES]
