"""dipole gather: files of points and queries, what is written, and what is said about faults."""

import csv
import subprocess

import numpy as np
import pytest
from command_line import PROGRAM, Proxy, busy, read_csv
from daemons import Daemon, finished
from dipole import Client, Points, wire
from frames import SKIN

MEDIUM = ["--sigma-a", "0.032", "--sigma-s", "0.74"]
BETTER = ["--model", "better", "--evaluator", "f64"]
RNG = np.random.default_rng(8)
XYZ = RNG.uniform(-5, 5, (200, 3))
POWER = RNG.uniform(0, 1, (200, 3)).astype("<f4")
QUERIES = RNG.uniform(-5, 5, (20, 3))


def write_csv(path, names, columns) -> str:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        writer.writerows(np.column_stack(columns).tolist())
    return str(path)


def names(channels: int) -> list[str]:
    return ["x", "y", "z", *(f"power_{i + 1}" for i in range(channels))]


@pytest.fixture(scope="module")
def expected(shared) -> np.ndarray:
    with shared.client() as client:
        found = client.gather(
            "better", "skin1", Points(XYZ, POWER), QUERIES, evaluator="f64", tolerance=1e-3
        )
    return found.M


@pytest.fixture
def queries(tmp_path) -> str:
    return write_csv(tmp_path / "queries.csv", ["x", "y", "z"], [QUERIES])


def columns_of(text: str, channels: int) -> np.ndarray:
    return np.array([[float(row[f"M_{c + 1}"]) for c in range(channels)] for row in read_csv(text)])


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return finished(PROGRAM, *words)


def gather(shared: Daemon, *words: str) -> subprocess.CompletedProcess[str]:
    return run("gather", *words, "--connect", shared.url())


def test_points_and_queries_of_several_requests_keep_their_places(shared, tmp_path):
    """Both libraries ask for neighbours together; each value is that of its query asked alone."""
    xyz, places, power = RNG.uniform(-5, 5, (70_000, 3)), RNG.uniform(-5, 5, (40_000, 3)), np.ones((70_000, 1), "<f4")
    points = write_csv(tmp_path / "points.csv", names(1), [xyz, power])
    asked = write_csv(tmp_path / "queries.csv", ["x", "y", "z"], [places])
    ended = gather(shared, points, asked, *MEDIUM, *BETTER, "--tolerance", "0.1")
    assert ended.returncode == 0, ended.stderr
    with shared.client() as client:
        call = ["better", [SKIN], Points(xyz, power)]
        settings = {"evaluator": "f64", "tolerance": 0.1}
        whole = client.gather(*call, places, **settings).M
        part = client.gather(*call, places[30_000:30_500], **settings).M
    assert np.array_equal(whole[30_000:30_500], part)
    assert np.array_equal(columns_of(ended.stdout, 1), whole)


def test_a_daemon_that_dies_before_it_is_asked(daemon, tmp_path, queries, expected):
    """The points are sent to the second daemon of the list."""
    points = write_csv(tmp_path / "p.csv", names(3), [XYZ, POWER])
    first, second = daemon(), daemon()
    words = [points, queries, "--medium", "skin1", *BETTER, "--tolerance", "1e-3"]
    first.kill()
    ended = run("gather", *words, "--connect", f"{first.url()},{second.url()}")
    assert ended.returncode == 0, ended.stderr
    assert np.array_equal(columns_of(ended.stdout, 3), expected)


@pytest.mark.parametrize("client", ["python", "c"])
def test_points_that_are_lost_again_and_again(shared, tmp_path, client):
    """Every fifth request finds no points. A call that gets on is not limited in their number."""
    places = RNG.uniform(-5, 5, (200_000, 3))

    def on_gather(number: int, request_id: int) -> bytes | None:
        return busy(request_id, 0, "unknown-points") if number % 5 == 0 else None

    with Proxy(shared.url(), on_gather, type=wire.MESSAGES["gather"]) as proxy:
        if client == "python":
            with Client(proxy.url) as one:
                found = one.gather("better", [SKIN], Points(XYZ, POWER[:, :1]), places, evaluator="f64").M
        else:
            points = write_csv(tmp_path / "points.csv", names(1), [XYZ, POWER[:, :1]])
            asked = write_csv(tmp_path / "queries.csv", ["x", "y", "z"], [places])
            ended = run("gather", points, asked, *MEDIUM, *BETTER, "--connect", proxy.url)
            assert ended.returncode == 0, ended.stderr
            found = columns_of(ended.stdout, 1)
    assert np.isfinite(found).all() and len(found) == len(places)
