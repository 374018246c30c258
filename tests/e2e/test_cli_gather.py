"""dipole gather: files of points and queries, what is written, and what is said about faults."""

from __future__ import annotations

import csv
import io
import subprocess

import numpy as np
import pytest
from command_line import PROGRAM, Proxy, busy
from daemons import Daemon, environment
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


def write_ply(path, names, columns, types="<f8", before="") -> str:
    """Writes vertices whose properties have these names."""
    kind = {"<f8": "double", "<f4": "float", "<i2": "short"}
    listed = np.core.records.fromarrays(
        np.column_stack(columns).T, dtype=[(name, types) for name in names]
    )
    header = [
        "ply", "format binary_little_endian 1.0", "comment of a test", before,
        f"element vertex {len(listed)}", *(f"property {kind[types]} {name}" for name in names),
        "element face 0", "property list uchar int vertex_indices", "end_header", "",
    ]
    path.write_bytes("\n".join(line for line in header[:-1] if line).encode() + b"\n" + listed.tobytes())
    return str(path)


def read_ply(path) -> np.ndarray:
    head, body = path.read_bytes().split(b"end_header\n", 1)
    types = {"double": "<f8", "float": "<f4", "uchar": "u1"}
    words = [line.split() for line in head.decode().splitlines()]
    properties = [(one[2], types[one[1]]) for one in words if one[0] == "property"]
    return np.frombuffer(body, properties)


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
    rows = list(csv.DictReader(io.StringIO(text)))
    return np.array([[float(row[f"M_{c + 1}"]) for c in range(channels)] for row in rows])


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(PROGRAM), *words], capture_output=True, text=True, env=environment(), timeout=60,
        check=False,
    )


def gather(shared: Daemon, *words: str) -> subprocess.CompletedProcess[str]:
    return run("gather", *words, "--connect", shared.url())


@pytest.mark.parametrize("kind", ["csv", "f8.ply", "f4.ply"])
def test_files_of_points(shared, tmp_path, queries, expected, kind):
    path, columns = tmp_path / f"points.{kind}", [XYZ, POWER]
    if kind == "csv":
        points = write_csv(path, names(3), columns)
    else:
        points = write_ply(path, names(3), columns, types=f"<{kind[:2]}")
    ended = gather(shared, points, queries, "--medium", "skin1", *BETTER, "--tolerance", "1e-3")
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[0] == "x,y,z,M_1,M_2,M_3"
    found = columns_of(ended.stdout, 3)
    if kind == "f4.ply":
        np.testing.assert_allclose(found, expected, rtol=1e-4)
    else:
        assert np.array_equal(found, expected)


def test_queries_of_several_requests_keep_their_places(shared, tmp_path):
    """Both libraries ask for neighbours together; each value is that of its query asked alone."""
    places = RNG.uniform(-5, 5, (40_000, 3))
    points = write_csv(tmp_path / "points.csv", names(1), [XYZ, POWER[:, :1]])
    asked = write_csv(tmp_path / "queries.csv", ["x", "y", "z"], [places])
    ended = gather(shared, points, asked, *MEDIUM, *BETTER, "--tolerance", "1e-3")
    assert ended.returncode == 0, ended.stderr
    with shared.client() as client:
        call = ["better", [SKIN], Points(XYZ, POWER[:, :1])]
        settings = {"evaluator": "f64", "tolerance": 1e-3}
        whole = client.gather(*call, places, **settings).M
        part = client.gather(*call, places[30_000:30_500], **settings).M
    assert np.array_equal(whole[30_000:30_500], part)
    assert np.array_equal(columns_of(ended.stdout, 1), whole)


def test_ply_with_colours(shared, tmp_path, queries, expected):
    points = write_csv(tmp_path / "p.csv", names(3), [XYZ, POWER])
    out = tmp_path / "M.ply"
    words = [points, queries, "--medium", "skin1", *BETTER, "--tolerance", "1e-3"]
    ended = gather(shared, *words, "--output", str(out))
    assert (ended.returncode, ended.stdout) == (0, ""), ended.stderr
    found = read_ply(out)
    for i, axis in enumerate("xyz"):
        assert np.array_equal(found[axis], QUERIES[:, i])
    for c, colour in enumerate(("red", "green", "blue")):
        assert np.array_equal(found[f"M_{c + 1}"], expected[:, c])
        share = expected[:, c] / expected.max()
        srgb = np.where(share <= 0.0031308, 12.92 * share, 1.055 * share ** (1 / 2.4) - 0.055)
        assert np.array_equal(found[colour], np.rint(255 * srgb).astype(int))
    again = gather(shared, points, str(out), "--medium", "skin1", *BETTER, "--tolerance", "1e-3")
    assert np.array_equal(columns_of(again.stdout, 3), expected)


def test_one_channel_other_columns_and_comments(shared, tmp_path, queries):
    points = tmp_path / "p.csv"
    points.write_text('# two\n"power",name,z,y,x\n1,a,0,0,0\n\n# more\n0.5,b,0,0,1\n')
    ended = gather(shared, str(points), queries, *MEDIUM, *BETTER, "--tolerance", "0")
    assert ended.returncode == 0, ended.stderr
    with shared.client() as client:
        found = client.gather(
            "better", [SKIN], Points([[0, 0, 0], [1, 0, 0]], [1, 0.5]), QUERIES, evaluator="f64",
            tolerance=0,
        )
    assert np.array_equal(columns_of(ended.stdout, 1), found.M)


@pytest.mark.parametrize(
    "text, said",
    [
        ("", "it has no header"),
        ("x,y,z\n0,0,0\n", "no column or property power or power_1"),
        ("x,y,power\n", "no column or property z"),
        ("x,y,z,power\n", "it has no points"),
        ("x,y,z,power\n0,0,0,1\n0,zero,0,1\n", ":3: column 2: 'zero' is no number"),
        ("x,y,z,power\n0,0\n", ":2: column 3: '' is no number"),
        ("x,y,z,power\n0,0,0,1\n# no\n0,1e30,0,1\n", "p.csv:4: bad-value: points"),
        ("x,y,z,power\n0,0,0,1\n0,0,0,-1\n", "p.csv:3: bad-value: power"),
        ("x,y,z,power\n0,0,0,nan\n", "p.csv:2: bad-value: power"),
    ],
)
def test_faults_of_points(shared, tmp_path, queries, text, said):
    points = tmp_path / "p.csv"
    points.write_text(text)
    ended = gather(shared, str(points), queries, *MEDIUM, *BETTER)
    assert ended.returncode == 1
    assert said in ended.stderr and ended.stdout == ""


@pytest.mark.parametrize(
    "change, said",
    [
        (lambda data: b"", ":1: this is no PLY file"),
        (lambda data: data.replace(b"binary_little_endian", b"ascii"), "not binary_little_endian"),
        (lambda data: data[:-1], "it ends within vertex 199 of 200"),
        (lambda data: data.replace(b"property double y", b"property list uchar int y"), ":6: a prop"),
        (lambda data: data.replace(b"property double y", b"property wide y"), ":6: a property"),
        (lambda data: data.replace(b"element vertex", b"element points"), "first element is not"),
        (lambda data: data[:60], "the header has no end_header"),
    ],
)
def test_faults_of_ply(shared, tmp_path, queries, change, said):
    path = tmp_path / "p.ply"
    write_ply(path, names(1), [XYZ, POWER[:, :1]])
    path.write_bytes(change(path.read_bytes()))
    ended = gather(shared, str(path), queries, *MEDIUM, *BETTER)
    assert ended.returncode == 1
    assert said in ended.stderr


def test_faults_of_queries_and_of_the_command_line(shared, tmp_path, queries):
    points = write_csv(tmp_path / "p.csv", names(3), [XYZ, POWER])
    bad = tmp_path / "q.csv"
    bad.write_text("x,y,z\n0,0,0\n0,inf,0\n")
    ended = gather(shared, points, str(bad), "--medium", "skin1", *BETTER)
    assert ended.returncode == 1 and "q.csv:3: bad-value: queries" in ended.stderr
    for words, said in (
        ([points], "name two files"),
        ([points, queries], "--medium"),
        ([points, queries, *MEDIUM], "3 powers for each point, and the medium 1 channels"),
        ([points, queries, "--medium", "skin1", "--tolerance", "much"], "tolerance"),
        ([points, queries, "--medium", "skin1", "--model", "none"], "none"),
    ):
        ended = gather(shared, *words)
        assert ended.returncode == 2 and said in ended.stderr, ended.stderr
    ended = gather(shared, str(tmp_path / "none.csv"), queries, *MEDIUM)
    assert ended.returncode == 1 and "No such file" in ended.stderr
    ended = gather(shared, points, queries, "--medium", "skin1", "--tolerance", "0.9")
    assert ended.returncode == 1 and "tolerance" in ended.stderr
    ended = gather(shared, points, queries, "--medium", "skin1", "--output", "/nowhere/M.csv")
    assert ended.returncode == 1 and "/nowhere/M.csv" in ended.stderr


def test_a_daemon_that_dies_before_it_is_asked(tmp_path, queries, expected):
    """The points are sent to the second daemon of the list."""
    points = write_csv(tmp_path / "p.csv", names(3), [XYZ, POWER])
    first, second = Daemon(), Daemon()
    try:
        addresses = f"{first.url()},{second.url()}"
        words = [points, queries, "--medium", "skin1", *BETTER, "--tolerance", "1e-3"]
        first.kill()
        ended = run("gather", *words, "--connect", addresses)
        assert ended.returncode == 0, ended.stderr
        assert np.array_equal(columns_of(ended.stdout, 3), expected)
    finally:
        first.close()
        second.close()


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


@pytest.mark.parametrize("model, evaluator", [("transport", "lut"), ("better+single", "f64")])
def test_no_distance_counts_as_less(shared, tmp_path, model, evaluator):
    """Points are asked for in slices of 1024, and queries at or near a point directly."""
    xyz, power = RNG.uniform(-5, 5, (2100, 3)), RNG.uniform(0, 1, (2100, 2)).astype("<f4")
    queries = np.vstack([xyz[::300], xyz[::300] + 0.02, RNG.uniform(-5, 5, (10, 3))])
    points = write_ply(tmp_path / "p.ply", names(2), [xyz, power])
    asked = write_csv(tmp_path / "q.csv", ["x", "y", "z"], [queries])
    words = [points, asked, "--sigma-a", "0.032,0.1", "--sigma-s", "0.74", "--tolerance", "1e-3",
             "--model", model, "--evaluator", evaluator]  # fmt: skip
    ended = gather(shared, *words)
    assert ended.returncode == 0
    assert f"7 of 24 queries are at a point, where R of {model} is infinite" in ended.stderr
    assert np.isinf(columns_of(ended.stdout, 2)).any(axis=1).sum() == 7
    ended = gather(shared, *words, "--least-distance", "0.1")
    assert (ended.returncode, ended.stderr) == (0, "")
    r = np.maximum(np.linalg.norm(queries[:, None] - xyz, axis=2), 0.1)
    with shared.client() as client:
        media = [(0.032, 0.74, 0, 1.3), (0.1, 0.74, 0, 1.3)]
        R = client.eval(model, media, r.ravel(), evaluator=evaluator).R.reshape(2, *r.shape)
    expected = np.einsum("cqp,pc->qc", R.astype(float), power.astype(float))
    np.testing.assert_allclose(columns_of(ended.stdout, 2), expected, rtol=1.5e-3)
    near = np.linalg.norm(queries[:, None] - xyz, axis=2).min(axis=1) < 0.1
    assert 14 <= near.sum() < 24
    ended = gather(shared, *words, "--least-distance", "-1")
    assert ended.returncode == 2 and "--least-distance: give a number of at least 0" in ended.stderr
