"""`dipole points`: reads rows, and writes the same rows with R, albedo, cdf and status."""

from __future__ import annotations

import os
import re
import select
import subprocess
import time

import numpy as np
import pytest
from command_line import (
    BAD_ROWS, FAILED, PROGRAM, TIMEOUT_S, USAGE, Proxy, Terminal, busy, dipole, eval_rows, points,
    read_csv, scratch,
)
from daemons import environment

HEADER = "sigma_a,sigma_s,g,eta,r"
ROW = "0.01,1,0,1.4,2"


def columns(row: dict[str, str], *names: str) -> list[str]:
    return [row[name] for name in names]


# Rows that share a model, g and eta are evaluated together, each with a medium of its own. The
# coefficients are then rounded otherwise than where one medium is prepared.
ROUNDING = 3e-14


def assert_near(row: dict[str, str], other: dict[str, str], *names: str) -> None:
    for name in names:
        assert float(row[name]) == pytest.approx(float(other[name]), rel=ROUNDING), name


# ---- good rows -----------------------------------------------------------------------------------


def test_errors_stand_in_each_row():
    """A row that is asked for by itself has the errors of an eval, and those of a group share the
    largest. What is not known is empty, and a column that exists is replaced."""
    medium = ["--sigma-a", "0.01", "--sigma-s", "1", "--eta", "1.4", "--r", "2"]
    text = points(f"{HEADER},model_error\n{ROW},9\n", "--errors", "--wanted", "R,dR_dr")
    assert text.splitlines()[0] == f"{HEADER},model_error,R,dR_dr,numerical_error,status"
    for model in ("transport", "better+single"):
        row = read_csv(
            points(f"{HEADER}\n{ROW}\n", "--errors", "--wanted", "R,ln_R", "--model", model,
                   "--evaluator", "f64")
        )[0]  # fmt: skip
        expected = eval_rows(*medium, "--wanted", "R,ln_R", "--model", model, "--evaluator", "f64")[0]
        assert columns(row, "numerical_error", "model_error") == columns(
            expected, "numerical_error", "model_error"
        )
        assert float(row["model_error"]) == 0 or model == "better+single"
    rows = read_csv(
        points(f"{HEADER}\n{ROW}\n1,1,0,1.4,2\n0,-1,0,1.4,2\n", "--errors", "--model", "better",
               "--wanted", "R", status=BAD_ROWS)
    )
    alone = [
        eval_rows("--sigma-a", sigma_a, *medium[2:], "--wanted", "R", "--model", "better")[0]
        for sigma_a in ("0.01", "1")
    ]
    worst = max(float(row["model_error"]) for row in alone)
    assert rows[0]["model_error"] == rows[1]["model_error"]
    assert worst <= float(rows[0]["model_error"]) < 1.1 * worst
    assert 0 < float(rows[0]["numerical_error"]) == float(rows[1]["numerical_error"]) < 1e-12
    assert columns(rows[2], "numerical_error", "model_error") == ["", ""]
    skin = read_csv(points(f"{HEADER}\n{ROW}\n", "--errors", "--model", "skin-red"))[0]
    assert float(skin["model_error"]) > 0 and skin["status"] == "ok"


def test_single_precision_is_double_precision_rounded():
    """Rows in single precision, too, are asked for in groups, each with a medium of its own."""
    lines = [f"{0.001 * (i % 97)},1,{i % 5 / 10},1.4,{(1 + i % 613) / 64}" for i in range(20000)]
    text = "\n".join([HEADER, *lines, ""])
    single, double = (
        read_csv(points(text, "--model", "better", "--wanted", "R", "--evaluator", one, "--errors"))
        for one in ("f32", "f64")
    )
    for one, other in zip(single, double, strict=True):
        error = float(one["numerical_error"])
        assert 2.0**-23 <= error < 1.2e-7
        assert abs(float(one["R"]) / float(other["R"]) - 1) <= error


@pytest.mark.parametrize("evaluator, within", [("f32", 1e-5), ("lut", 1e-4)])
def test_single_precision(evaluator, within):
    text = f"{HEADER}\n{ROW}\n0.01,1,0,1.4,0.1\n"
    double = read_csv(points(text))
    single = read_csv(points(text, "--evaluator", evaluator))
    for one, other in zip(double, single, strict=True):
        assert one["r"] == other["r"]
        assert_near(one, other, "albedo")
        for column in ("R", "cdf"):
            assert one[column] != other[column]
            assert float(one[column]) == pytest.approx(float(other[column]), rel=within)


# ---- what CSV can look like ----------------------------------------------------------------------


def test_carriage_returns_are_kept():
    text = points(f"{HEADER}\r\n{ROW}\r\n\r\n{ROW}\n")
    lines = text.split("\n")
    assert lines[0] == f"{HEADER},R,albedo,cdf,status\r"
    assert lines[1].endswith(",ok\r") and lines[2] == "\r" and lines[3].endswith(",ok")


def test_byte_order_mark():
    text = points(b"\xef\xbb\xbf" + f"{HEADER}\n{ROW}\n".encode())
    assert text == "\ufeff" + points(f"{HEADER}\n{ROW}\n")


def test_quoted_cells_may_hold_lines():
    note = '"two\nlines, # and ""quotes"""'
    text = points(f"note,{HEADER}\n{note},{ROW}\n\"\",{ROW}\n")
    assert text.split("\n", 1)[1].startswith(f"{note},{ROW},")
    rows = read_csv(text)
    assert [row["note"] for row in rows] == ['two\nlines, # and "quotes"', ""]
    assert [row["status"] for row in rows] == ["ok", "ok"]


def test_bytes_that_are_no_text_are_passed_through():
    run = subprocess.run(
        [str(PROGRAM), "points"],
        input=b"note," + HEADER.encode() + b"\n\xff\x00\xfe," + ROW.encode() + b"\n",
        capture_output=True,
        env=environment(),
        timeout=TIMEOUT_S,
        check=True,
    )
    assert run.stdout.splitlines()[1].startswith(b"\xff\x00\xfe," + ROW.encode() + b",")


# ---- bad files -----------------------------------------------------------------------------------


@pytest.mark.parametrize("excess", [0, 1])
def test_the_longest_line(excess):
    note = "x" * (2**20 - len(f",{ROW}\n") + excess)
    run = dipole(
        *["points"],
        stdin=f"note,{HEADER}\n-,{ROW}\n{note},{ROW}\n",
        status=FAILED if excess else 0,
    )
    if excess:
        assert "line 3: the row is longer than 1 MiB" in run.stderr
        assert len(run.stdout.splitlines()) == 2
    else:
        assert len(run.stdout.splitlines()) == 3
        assert len(run.stdout) > 2**20 and run.stdout.endswith(",ok\n")


# ---- many rows -----------------------------------------------------------------------------------


def test_many_rows_keep_their_order():
    count = 20000
    lines = [f"{i},{(i % 7) / 10},1,0,1.4,{i % 11}" for i in range(count)]
    lines[777] = "777,-1,1,0,1.4,0"
    text = points("\n".join([f"id,{HEADER}", *lines]), status=BAD_ROWS)
    rows = read_csv(text)
    assert [int(row["id"]) for row in rows] == list(range(count))
    assert [i for i, row in enumerate(rows) if row["status"] != "ok"] == [777]
    seen = {}
    for row in rows:
        key = (row["sigma_a"], row["r"])
        assert seen.setdefault(key, (row["R"], row["cdf"])) == (row["R"], row["cdf"])


@pytest.mark.parametrize("row", ["0.01,1,0,1.4,{}", "-1,1,0,1.4,{}"])
def test_more_rows_by_themselves_than_may_be_outstanding(row):
    """Rows with derivatives, and those of a group that are wrong, are each asked for alone."""
    want = "dR_dr" if row[0] == "0" else "R"
    lines = [row.format(i + 1) for i in range(9000)]
    text = points("\n".join([HEADER, *lines, ""]), "--model", "better", "--wanted", want,
                  status=0 if row[0] == "0" else BAD_ROWS)
    answered = text.splitlines()[1:]
    assert [one.split(",")[4] for one in answered] == [str(i + 1) for i in range(9000)]
    assert all(one.endswith(",ok") for one in answered) == (row[0] == "0")


def test_memory_is_bounded(tmp_path):
    """Memory stays bounded for rows of 100 kB each, far more than the command holds at a time."""
    path = tmp_path / "wide.csv"
    note = "x" * 100_000
    with path.open("w") as file:
        file.write(f"note,{HEADER}\n")
        for _ in range(600):
            file.write(f"{note},{ROW}\n")
    code = (
        "import resource, subprocess, sys;"
        "status = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode;"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, status)"
    )
    plain = [str(PROGRAM), "media"]
    sizes = {}
    for name, command in (("plain", plain), ("wide", [str(PROGRAM), "points", str(path)])):
        run = subprocess.run(
            ["/usr/bin/python3", "-c", code, *command],
            capture_output=True,
            # The address sanitizer keeps freed memory for a while, unless told otherwise.
            env=environment(ASAN_OPTIONS="quarantine_size_mb=1:thread_local_quarantine_size_kb=64"),
            timeout=TIMEOUT_S,
            check=True,
            text=True,
        )
        kilobytes, status = map(int, run.stdout.split())
        assert status == 0
        sizes[name] = kilobytes
    assert sizes["wide"] - sizes["plain"] < 24_000  # The file has 60,000 kB.


# ---- while it runs -------------------------------------------------------------------------------


def read_until(stream: int, text: bytes, timeout_s: float = 30.0) -> bytes:
    """Reads from a file descriptor until a text comes. Returns all that was read."""
    deadline = time.monotonic() + timeout_s
    got = b""
    while text not in got:
        ready, _, _ = select.select([stream], [], [], max(0, deadline - time.monotonic()))
        assert ready, f"no {text!r} in {got!r}"
        part = os.read(stream, 65536)
        assert part, f"no {text!r} in {got!r}"
        got += part
    return got


def test_rows_come_out_while_others_are_awaited():
    with subprocess.Popen(
        [str(PROGRAM), "points"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment(),
        bufsize=0,
    ) as run:
        run.stdin.write(HEADER.encode() + b"\n")
        read_until(run.stdout.fileno(), b"status\n")
        for _ in range(3):
            run.stdin.write(ROW.encode() + b"\n")
            read_until(run.stdout.fileno(), b",ok\n")
        run.stdin.close()
        assert run.wait(TIMEOUT_S) == 0


def test_a_bar_is_shown_on_a_terminal_when_it_takes_long():
    run = Terminal("points", on=[2], stdin=subprocess.PIPE)
    run.process.stdin.write(HEADER.encode() + b"\n")
    start = time.monotonic()
    while " rows" not in run.seen:
        assert time.monotonic() - start < 30
        run.process.stdin.write(ROW.encode() + b"\n")
        read_until(run.process.stdout.fileno(), b"\n")
        run.read()
    assert time.monotonic() - start > 1.9
    run.process.stdin.close()
    run.process.stdin = None
    assert run.end()[0] == 0
    assert run.seen.endswith("\r\033[K")  # The bar was wiped at the end.


def test_a_busy_daemon_is_asked_again(daemon):
    text = "\n".join([f"id,{HEADER}", *(f"{i},0.01,1,0,1.4,{i}" for i in range(700))])

    def on_eval(number: int, request_id: int):
        return busy(request_id) if number % 3 == 0 and number < 600 else None

    with Proxy(daemon().url(), on_eval) as proxy:
        wanted = ["--wanted", "R,dR_dr"]
        assert points(text, "--connect", proxy.url, *wanted) == points(text, *wanted)


def test_a_daemon_that_goes_away(daemon):
    text = "\n".join([f"id,{HEADER}", *(f"{i},0.01,1,0,1.4,{i}" for i in range(3000))])
    with Proxy(daemon().url(), lambda number, _: False if number == 1500 else None) as proxy:
        options = ["--connect", proxy.url, "--retry-ms", "300", "--wanted", "R,dR_dr"]
        run = dipole("points", *options, stdin=text, status=FAILED)
    assert "connection" in run.stderr
    whole = points(text, "--wanted", "R,dR_dr")
    assert whole.startswith(run.stdout) and len(run.stdout) < len(whole)


# ---- models, media, radii, quantities ------------------------------------------------------------


def test_rows_of_transport_are_not_solved_one_by_one():
    """Stored solutions are the default of every row of transport, whether its model is named or not,
    and whatever its tolerance; no other row has them."""
    text = f"{HEADER},model\n{ROW},\n{ROW},transport\n{ROW},better\n"

    def read(*arguments):
        return read_csv(dipole("points", "--errors", *arguments, stdin=text, usual=True).stdout)

    unnamed, named, better = read()
    option = read("--model", "transport")[0]
    narrow = read_csv(dipole("points", "--errors", "--tolerance", "1e-3", usual=True,
                             stdin=f"{HEADER},model\n0.01,10,0.9,1.4,1,transport\n").stdout)
    assert 2e-4 < float(narrow[0]["numerical_error"]) < 1e-3
    wanted = ("R", "cdf", "numerical_error")
    assert columns(unnamed, *wanted) == columns(named, *wanted) == columns(option, *wanted)
    assert float(named["numerical_error"]) < 2e-5
    assert float(better["numerical_error"]) < 1e-12
    assert all(float(row["numerical_error"]) < 2e-5 for row in read("--evaluator", "f64"))


def test_few_media_of_transport_are_evaluated_one_by_one(client):
    """A surface is made for a g and eta from their 257th medium on. Before that, each row has the
    values of its medium in f32, in any order of rows."""
    own = [(0.01 * (i + 1), 10.0, 0.04 * i, 1.3 + 0.01 * i) for i in range(20)]
    one = [(0.002 * (i + 1), 10.0, 0.5, 1.4) for i in range(260)]
    lines = [",".join(map(str, [*medium, r])) for r in (0.25, 1) for medium in own + one]
    text = "\n".join([HEADER, *lines, ""])
    rows = read_csv(dipole("points", "--errors", stdin=text, usual=True).stdout)
    asked, how = own + one, {"evaluator": "f32", "wanted": ["R", "cdf"]}
    exact = [client.eval("transport", asked[i : i + 1], [0.25, 1], **how) for i in range(280)]
    for i, row in enumerate(rows):
        medium, r = i % 280, i // 280
        alone = (float(row["R"]), float(row["cdf"])) == (
            pytest.approx(exact[medium].R[0, r], rel=1e-7),
            pytest.approx(exact[medium].cdf[0, r], rel=1e-7),
        )
        assert alone or medium >= 276
        assert float(row["R"]) == pytest.approx(exact[medium].R[0, r], rel=3e-4)
    errors = [float(row["numerical_error"]) for row in rows[:280]]
    assert len(set(errors[276:])) == 1 and errors[276] not in errors[:276]


def test_transport_states_the_error_of_its_solutions_whatever_the_tolerance():
    text = f"{HEADER},tolerance\n{ROW},1e-7\n{ROW},1e-6\n"
    fine, tabled = read_csv(points(text, "--errors", "--model", "transport", "--wanted", "R,ln_R"))
    assert fine["status"] == tabled["status"] == "ok"
    assert 1e-7 < float(fine["numerical_error"]) < float(tabled["numerical_error"]) < 5e-6


def test_a_bar_counts_the_rows_that_are_answered(daemon, tmp_path):
    start = time.monotonic()
    lines = [f"0.01,1,{i / 1000},1.4,2" for i in range(100)]
    path = scratch(tmp_path, "rows.csv", "\n".join([HEADER, *lines, ""]))

    def on_eval(number: int, request_id: int):
        return busy(request_id, 50) if number > 40 and time.monotonic() - start < 2.1 else None

    with Proxy(daemon().url(), on_eval) as proxy:
        run = Terminal("points", path, "--model", "transport", "--connect", proxy.url, on=[2])
        status, output = run.end()
    assert status == 0 and output.count(",ok\n") == 100
    shares = re.findall(r"\] +(\d+) %  \S+ rows", run.seen)
    assert shares and 30 < int(shares[0]) < 100


def test_a_tolerance_in_place_of_a_model(client):
    (row,) = read_csv(points(f"{HEADER}\n{ROW}\n", "--tolerance", "0.01"))
    exact = client.eval("transport", (0.01, 1, 0, 1.4), [2.0]).R[0, 0]
    assert row["status"] == "ok" and float(row["R"]) == pytest.approx(exact, rel=0.01)
    absorbing = f"{HEADER}\n0.4,11,0.85,1.4,0.5\n"
    assert list(row) == [*HEADER.split(","), "R", "albedo", "status"]
    (dark,) = read_csv(points(absorbing, "--tolerance", "0.01"))
    assert dark["status"] == "ok"
    (refused,) = read_csv(
        dipole("points", "--tolerance", "1e-5", "--wanted", "R,dR_dr", stdin=f"{HEADER}\n{ROW}\n",
               status=BAD_ROWS).stdout
    )  # fmt: skip
    assert "tolerance: allowed: at least " in refused["status"]
    (model,) = read_csv(points(absorbing, "--tolerance", "0.01", "--model", "transport"))
    assert "cdf" in model


# ---- other forms of CSV, which all commands read -------------------------------------------------

# What cannot be misunderstood, made of text with commas, points and line feeds.
FORMS = {
    "blanks": lambda text: text.replace(",", " ,\t "),
    "quotes behind blanks": lambda text: re.sub("([^,\n]+)", ' "\\1" ', text),
    "semicolons": lambda text: text.replace(",", ";"),
    "tabs": lambda text: text.replace(",", " \t"),
    "returns": lambda text: text.replace("\n", "\r"),
    "returns and feeds": lambda text: "\r\n" + text.replace("\n", "\r\n"),
    "a header that starts with #": lambda text: "# by hand, twice\n# " + text,
    "a header that starts with #, tabs": lambda text: "#" + text.replace(",", "\t"),
    "a header above a comment": lambda text: "# x,y\n#" + text.replace("\n", "\n# in mm\n\n#\n", 1),
    "comments everywhere": lambda text: "#1\n" + text.replace("\n", "\n# so it is\n\n") + "#",
    "Excel's first line": lambda text: "\ufeffsep=;\r\n" + text.replace(",", ";"),
    "all": lambda text: "\ufeff#" + text.replace(",", "; ").replace("\n", "\r"),
}  # fmt: skip
READINGS = "sample,r,R,error\na,1,.0234,.0005\na,2,.00787,.0002\na,4,.00159,.00003\n"
CLOUD = "x,y,z,power\n0,0,0,1.5\n0,2.5,0,0.5\n"


def read_by_all(tmp_path, form) -> list:
    """Returns what three commands make of files in a form."""
    table = points(form(f"{HEADER}\n{ROW}\n0.5,1.25,0,1.4,2\n"))
    mark = next(one for one in ",;\t" if f"r{one}" in re.sub('[ "]', "", table))
    lines = [line for line in re.split("[\r\n]+", table) if mark in line]
    rows = [[float(cell.strip(' "')) for cell in line.split(mark)[:-1]] for line in lines[-2:]]
    fits = read_csv(dipole("fit", "--eta", "1.4", "--format", "csv", stdin=form(READINGS)).stdout)
    paths = [scratch(tmp_path, name, form(CLOUD.replace("2.5", y))) for name, y in zip("pq", "23")]
    medium = ["--sigma-a", "0.01", "--sigma-s", "1", "--model", "better"]
    sums = read_csv(dipole("gather", *paths, *medium).stdout)
    assert [fit.pop("sample") for fit in fits] == ["a"]
    assert [fit.pop("status") for fit in fits] == ["fitted"]
    return [*rows, *fits, *sums]


@pytest.mark.parametrize("form", FORMS)
def test_forms_of_csv(tmp_path, form):
    assert read_by_all(tmp_path, FORMS[form]) == read_by_all(tmp_path, str)
