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


def test_columns_are_appended():
    text = points(f"{HEADER}\n{ROW}\n")
    header, row = text.splitlines()
    assert header == HEADER + ",R,albedo,cdf,status"
    assert row.startswith(ROW + ",") and row.endswith(",ok")
    expected = eval_rows(
        *["--sigma-a", "0.01", "--sigma-s", "1", "--eta", "1.4", "--r", "2"],
        *["--wanted", "R,albedo,cdf"],
    )[0]
    assert_near(read_csv(text)[0], expected, "R", "albedo", "cdf")


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


def test_columns_in_any_order_with_others_between():
    text = points('note,r,eta,"sigma_s",x,g,sigma_a\n"a, ""b""",2,1.4,"1",,0,0.01\n')
    assert text.splitlines()[0] == 'note,r,eta,"sigma_s",x,g,sigma_a,R,albedo,cdf,status'
    assert text.splitlines()[1].startswith('"a, ""b""",2,1.4,"1",,0,0.01,')
    usual = read_csv(points(f"{HEADER}\n{ROW}\n"))[0]
    assert columns(read_csv(text)[0], "R", "albedo", "cdf", "status") == columns(
        usual, "R", "albedo", "cdf", "status"
    )


def test_model_and_moments_may_be_absent_or_empty():
    rows = read_csv(
        points(
            f"model,moments,{HEADER}\n,,{ROW}\nbetter,exact,{ROW}\n"
            f"classical,exact,{ROW}\nbetter,fit,{ROW}\n"
        )
    )
    values = [columns(row, "R", "albedo", "cdf") for row in rows]
    assert values[0] == values[1]
    assert len({tuple(value) for value in values}) == 3
    assert values[0] == columns(read_csv(points(f"{HEADER}\n{ROW}\n"))[0], "R", "albedo", "cdf")


def test_existing_results_are_replaced_where_they_stand():
    text = points(f"status,R,{HEADER},cdf\nold,,{ROW},0.5\n")
    assert text.splitlines()[0] == f"status,R,{HEADER},cdf,albedo"
    usual = read_csv(points(f"{HEADER}\n{ROW}\n"))[0]
    row = read_csv(text)[0]
    assert columns(row, "R", "albedo", "cdf", "status") == columns(
        usual, "R", "albedo", "cdf", "status"
    )
    assert text == points(text).replace("\r", "")  # nothing is left to do the second time


def test_extremes():
    text = f"{HEADER}\n0,1,0,1.4,0\n0,1,0,1.4,inf\n0.5,0,0,1.4,1\n0.5,1,0,1.4,1e300\n"
    rows = read_csv(points(text))
    assert [row["status"] for row in rows] == ["ok"] * 4
    assert float(rows[0]["R"]) > 0 and rows[0]["albedo"] == "1" and rows[0]["cdf"] == "0"
    assert columns(rows[1], "R", "albedo", "cdf") == ["0", "1", "1"]
    assert columns(rows[2], "R", "albedo", "cdf") == ["0", "0", "0"]
    assert columns(rows[3], "R", "cdf") == ["0", "1"]


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


def test_no_rows():
    assert points(f"{HEADER}\n") == f"{HEADER},R,albedo,cdf,status\n"
    assert points(HEADER) == f"{HEADER},R,albedo,cdf,status\n"


# ---- what CSV can look like ----------------------------------------------------------------------


def test_comments_and_blank_lines_are_copied():
    text = points(f"# media, \"odd\n\n{HEADER}\n#\n{ROW}\n\n  \n{ROW}\n# end")
    lines = text.split("\n")
    assert lines[:3] == ['# media, "odd', "", HEADER + ",R,albedo,cdf,status"]
    assert lines[3] == "#" and lines[5:7] == ["", "  "] and lines[8] == "# end"
    assert lines[4] == lines[7] and lines[4].endswith(",ok")
    assert len(lines) == 9


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


def test_last_line_without_an_end():
    assert points(f"{HEADER}\n{ROW}") == points(f"{HEADER}\n{ROW}\n")


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


def test_file_standard_input_and_dash(tmp_path):
    text = f"{HEADER}\n{ROW}\n"
    path = scratch(tmp_path, "rows.csv", text)
    expected = points(text)
    assert dipole("points", path).stdout == expected
    assert dipole("points", "-", stdin=text).stdout == expected
    assert dipole("points", "--format", "csv", path).stdout == expected


# ---- bad rows ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "row, said",
    [
        ("best,,0.01,1,0,1.4,2", "model: 'best' is unknown: allowed: classical, better"),
        ("Better,,0.01,1,0,1.4,2", "model: 'Better' is unknown"),
        (",exakt,0.01,1,0,1.4,2", "moments: 'exakt' is unknown: allowed: exact, fit"),
        (",,-0.01,1,0,1.4,2", "bad-value: sigma_a: allowed: "),
        (",,inf,1,0,1.4,2", "bad-value: sigma_a: allowed: "),
        (",,0.01,nan,0,1.4,2", "bad-value: sigma_s: allowed: "),
        (",,0,0,0,1.4,2", "allowed: "),
        (",,0.01,1,1,1.4,2", "bad-value: g: allowed: "),
        (",,0.01,1,-1,1.4,2", "bad-value: g: allowed: "),
        (",,0.01,1,0,0,2", "bad-value: eta: allowed: "),
        (",fit,0.01,1,0,2.6,2", "bad-value: eta: allowed: "),
        (",,0.01,1,0,1.4,-2", "bad-value: r: allowed: "),
        (",,0.01,1,0,1.4,nan", "bad-value: r: allowed: "),
        (",,0.01,1,0,1.4,", "r: '' is no number: allowed: "),
        (",,0.01,1,0,1.4,1 2", "r: '1 2' is no number: allowed: "),
        (",,0.01,1,0,1.4,2mm", "r: '2mm' is no number: allowed: "),
        (",,0x1,1,0,1.4,2", "sigma_a: '0x1' is no number: allowed: "),
        (",,1e999,1,0,1.4,2", "sigma_a: '1e999' is no number: allowed: "),
        (',,"0,01",1,0,1.4,2', "sigma_a: '0,01' is no number: allowed: "),
        (',,"0.""",1,0,1.4,2', "sigma_a: '0.\"' is no number: allowed: "),
        (",,0.01,1,0,1.4", "the row: 6 cells: allowed: 7"),
        ("0.01", "the row: 1 cells: allowed: 7"),
        (",,0.01,1,0,1.4,2,3,4", "the row: 9 cells: allowed: 7"),
        ('"a"b,,0.01,1,0,1.4,2', "the row: text after a closing quote"),
    ],
)
def test_a_bad_row_says_why_and_the_others_go_on(row, said):
    good = f"better,exact,{ROW}"
    run = dipole(
        *["points"], stdin=f"model,moments,{HEADER}\n{good}\n{row}\n{good}\n", status=BAD_ROWS
    )
    lines = run.stdout.splitlines()
    assert len(lines) == 4
    assert lines[1] == lines[3] and lines[1].endswith(",ok")
    rows = read_csv(run.stdout)
    assert said in rows[1]["status"]
    assert columns(rows[1], "R", "albedo", "cdf") == ["", "", ""]
    assert lines[2].startswith(row.split(",3,4")[0])
    assert "1 of 3 rows were bad" in run.stderr


def test_cells_beyond_the_header_are_kept_behind_the_results():
    run = points(f"{HEADER}\n{ROW},\"more\",yes\n", status=BAD_ROWS)
    assert run.splitlines()[1].endswith(',"more",yes')
    row = next(iter(read_csv(run)))
    assert "7 cells" in row["status"] and row[None] == ["more", "yes"]


def test_results_of_a_bad_row_are_replaced_too():
    text = f"R,status,{HEADER}\n1,ok,0.01,1,0,1.4,-1\n"
    row = read_csv(points(text, status=BAD_ROWS))[0]
    assert row["R"] == "" and row["status"].startswith("bad-value: r: allowed: ")


# ---- bad files -----------------------------------------------------------------------------------


def test_a_missing_column_is_named_with_those_found():
    run = dipole("points", stdin="model,sigma_a,R,eta,g\n", status=FAILED)
    assert "the column sigma_s is missing; the header has model, sigma_a, R, eta, g;" in run.stderr
    assert "standard input: " in run.stderr and run.stdout == ""


def test_a_column_that_stands_twice(tmp_path):
    path = scratch(tmp_path, "twice.csv", f"{HEADER},r\n{ROW},1\n")
    run = dipole("points", path, status=FAILED)
    assert "the header has the column r twice" in run.stderr and path in run.stderr


@pytest.mark.parametrize("text", ["", "\n", "# a comment\n", "\ufeff"])
def test_no_header(text):
    run = dipole("points", stdin=text, status=FAILED)
    assert "there is no header line; it names the columns: sigma_a, " in run.stderr


def test_no_file():
    run = dipole("points", "/nonexistent/rows.csv", status=FAILED)
    assert "/nonexistent/rows.csv: No such file" in run.stderr


def test_a_folder_instead_of_a_file(tmp_path):
    run = dipole("points", str(tmp_path), status=FAILED)
    assert "Is a directory" in run.stderr


def test_an_open_quote_is_an_error_after_the_rows_before_it():
    run = dipole("points", stdin=f"{HEADER}\n{ROW}\n\"{ROW}\n", status=FAILED)
    assert "line 3: a quote is not closed" in run.stderr
    assert run.stdout.splitlines()[1].endswith(",ok")


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


def test_the_usual_model_is_transport_by_table(client):
    text = f"{HEADER}\n{ROW}\n"
    (row,) = read_csv(dipole("points", stdin=text, usual=True).stdout)
    answer = client.eval("transport", (0.01, 1, 0, 1.4), [2.0], evaluator="lut", wanted=["R", "cdf"])
    assert float(row["R"]) == pytest.approx(answer.R[0, 0], rel=2e-4)
    assert float(row["cdf"]) == pytest.approx(answer.cdf[0, 0], rel=2e-4)
    (named,) = read_csv(dipole("points", "--model", "classical", stdin=text).stdout)
    double = client.eval("classical", (0.01, 1, 0, 1.4), [2.0]).R[0, 0]
    assert float(named["R"]) == pytest.approx(double, rel=ROUNDING)


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
    assert refused["status"].endswith(" without dR_dr")
    (model,) = read_csv(points(absorbing, "--tolerance", "0.01", "--model", "transport"))
    assert "cdf" in model


def test_measured_media_by_name():
    text = "medium,channel,r,eta\nskin1,red,1,\nskin1,blue,1,1.4\nmy own,red,1,1.3\nskin1,,1,\n"
    run = dipole("points", "--wanted", "R", stdin=text, status=BAD_ROWS)
    rows = read_csv(run.stdout)
    known = eval_rows("--medium", "skin1", "--r", "1")[0]
    changed = eval_rows("--medium", "skin1", "--eta", "1.4", "--r", "1")[2]
    assert [rows[0]["R"], rows[1]["R"]] == [known["R"], changed["R"]]
    assert "medium: 'my own' is unknown" in rows[2]["status"]
    assert "channel: '': allowed: red, green, blue" in rows[3]["status"]
    own = f"medium,{HEADER}\nmy own,{ROW}\n"
    assert read_csv(points(own))[0]["status"] == "ok"  # With coefficients, the name is only copied.


def test_quantities():
    text = points(f"{HEADER}\n{ROW}\n", "--wanted", "cdf,pdf")
    assert text.splitlines()[0] == f"{HEADER},cdf,pdf,status"
    (row,) = read_csv(text)
    (known,) = eval_rows("--sigma-a", "0.01", "--sigma-s", "1", "--eta", "1.4", "--r", "2",
                         "--wanted", "cdf,pdf")
    assert_near(row, known, "cdf", "pdf")
    dipole("points", "--wanted", "r", stdin=text, status=USAGE)


def test_inverted_media_go_straight_into_points():
    found = dipole("invert", "--albedo", "0.4,0.2", "--mean-free-path", "1", "--format", "csv").stdout
    rows = read_csv(points(found, "--r", "0.5,2"))
    assert [(row["channel"], row["r"]) for row in rows] == [
        ("1", "0.5"), ("1", "2"), ("2", "0.5"), ("2", "2")
    ]
    assert all(row["status"] == "ok" and float(row["R"]) > 0 for row in rows)
    assert {row["model"] for row in rows} == {"better"}
    measured = dipole("media", "--format", "csv").stdout
    assert len(read_csv(points(measured, "--r", "1"))) == measured.count("\n") - 1
    bad = dipole("points", "--r", "1", stdin=f"{HEADER}\n{ROW}\n", status=FAILED)
    assert "has the column r: leave --r out" in bad.stderr
    by_f = f"{HEADER[:-1]}f\n{ROW}\n"
    bad = dipole("points", "--f", "1", "--wanted", "R_f", stdin=by_f, status=FAILED)
    assert "has the column f: leave --f out" in bad.stderr
    assert read_csv(points(by_f, "--r", "1"))[0]["f"] == "2"


@pytest.mark.parametrize(
    "column, said",
    [
        ("evaluator", "the nearest is the option --evaluator"),
        ("evaluater", "the nearest is the option --evaluator"),
        ("tolerence", "the nearest that is read is tolerance"),
        ("Model", "the nearest that is read is model"),
        ("sigma-a", "the nearest that is read is sigma_a"),
        ("fit_form", "the nearest that is read is fit_from"),
    ],
)
def test_a_column_that_is_nearly_one_that_is_read(column, said):
    run = dipole("points", stdin=f"{HEADER},{column}\n{ROW},1\n", status=FAILED)
    assert f"the column {column} is not read; {said}" in run.stderr and run.stdout == ""


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


@pytest.mark.parametrize(
    "text, said",
    [
        ("x,y,z;power\n0,0,0;1\n", "line 1: the header has commas and semicolons"),
        ("# made\nx y z power\n0 0 0 1\n", "line 2: the header is one cell: separate its columns"),
        ("#\nx,y,z,power\n0,0,0,1\n".encode("utf-16"), "the header has zero bytes, as UTF-16 has: save"),
        ("x;y;z;power\n0;0;0;1,5\n", "'1,5' is no number: write a decimal point"),
        ("x,y,z,power\n0,0205,0,1\n", "column 2: '0205' is no number: write a decimal point"),
        ("x,y,z,power\n0,0,0,1\n#0,0,0,1\n", ":3: column 1: '#0' is no number: below the header, lines"),
        ('x,y,z,power\n0,0,0,1\n0,"0,0,2\n0,0,1,1\n', "line 3: a quote is not closed"),
        ('x,y,z,power\n0,0,"0,1{long}', "line 2: a quote is not closed within 1 MiB"),
        ("x,y,z,power\n0,0,0,{long}", "line 2: the row is longer than 1 MiB"),
        ("x,y,z,power\r0,0,0,1\r0,zero,0,1\r", ":3: column 2: 'zero' is no number"),
        ("x\ty\tz\tpower\n0\t0\t0\t1,234\n", "'1,234' is no number: write a decimal point"),
        ("x,y,z,power\n0,0,0,1,5\n", ":2: more cells than in the header: numbers have a decimal"),
        ('x,y,z,power\n0,"0"1,0,1\n', ":2: text stands after a closing quote"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_csv_is_named(tmp_path, text, said):
    path = scratch(tmp_path, "p.csv", text if text[-1:] != "}" else text.format(long="1" * 2**20))
    run = dipole("gather", path, path, "--sigma-a", "1", "--sigma-s", "1", status=FAILED)
    assert said in run.stderr and run.stdout == ""


def test_samples_whose_names_start_with_a_hash(tmp_path):
    """They vanish from no file, whatever stands above the header."""
    header, rows = READINGS.split("\n", 1)
    for above in ("", "# by hand\n", "#"):
        text = f"{above}{header}\n{rows.replace('a,', '#1,')}{rows}"
        fits = read_csv(dipole("fit", "--eta", "1.4", "--format", "csv", stdin=text).stdout)
        assert [(fit["sample"], fit["status"]) for fit in fits] == [("#1", "fitted"), ("a", "fitted")]


def test_cells_beyond_the_header_that_are_empty_do_no_harm():
    dipole("fit", "--eta", "1.4", stdin=READINGS.replace("\n", ",,\n", 2), usual=False)
    run = dipole("fit", stdin=READINGS.replace(".0234", "0,0234"), status=FAILED)
    assert "line 2: more cells than in the header: numbers have a decimal point" in run.stderr
