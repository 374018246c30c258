"""`dipole top`: tables, CSV and JSON by interval, and a terminal where the table is shown anew."""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import termios
import threading
import time

import pytest
from command_line import PROGRAM, USAGE, dipole, read_csv
from daemons import environment
from frames import EVAL, SKIN, ask, eval_payload
from lists import MODELS

TIMEOUT_S = 30


@pytest.fixture
def busy(daemon):
    """A daemon with a client that asks all the time: evals, and one in ten of them wrong."""
    one = daemon()
    stop = threading.Event()

    def keep_asking():
        right, wrong = eval_payload([SKIN], [1.0] * 100), eval_payload([SKIN], [-1.0])
        with one.connect() as connection:
            while not stop.is_set():
                for payload in [right] * 9 + [wrong]:
                    ask(connection, EVAL, payload)

    thread = threading.Thread(target=keep_asking)
    thread.start()
    yield one
    stop.set()
    thread.join()


def top(daemon, *arguments: str) -> str:
    return dipole("top", "--connect", daemon.url(), *arguments).stdout


def check_record(record: dict[str, float]) -> None:
    """What must hold while the busy client asks."""
    assert 0.15 < record["interval_s"] < 5
    evals, errors = record["requests_eval_per_s"], record["errors_per_s"]
    assert evals > 10
    assert record["requests_per_s"] == pytest.approx(
        sum(value for name, value in record.items() if re.match("requests_.*_per_s$", name))
    )
    assert errors == record["answers_bad-value_per_s"]
    assert errors == pytest.approx(evals / 10, rel=0.3, abs=20)
    radii = record["radii_better_per_s"]
    assert radii == pytest.approx(evals * 90, rel=0.3)
    assert record["radii_evaluated_per_s"] == pytest.approx(radii, rel=0.05)
    assert record["radii_classical_per_s"] == 0
    assert record["received_bytes_per_s"] > 0 and record["sent_bytes_per_s"] > 0
    assert record["connections_open"] == 2
    # Numbers that rise while they are read one after the other.
    assert record["requests_per_batch"] == pytest.approx(1, rel=0.05)
    quantiles = [record[f"latency_eval_short_{q}_us"] for q in ("p50", "p90", "p99", "p999", "max")]
    assert quantiles == sorted(quantiles) and quantiles[0] > 0


def test_csv(busy):
    text = top(busy, "--format", "csv", "--interval", "0.2", "--count", "3")
    rows = read_csv(text)
    assert len(rows) == 3 and len(text.splitlines()) == 4
    for row in rows:
        check_record({name: float(value) for name, value in row.items()})
    assert {f"radii_{model}_per_s" for model in MODELS} < set(rows[0])
    uptimes = [float(row["uptime_ms"]) for row in rows]
    assert uptimes == sorted(set(uptimes))


def test_json(busy):
    lines = top(busy, "--format", "json", "--interval", "0.2", "--count", "3").splitlines()
    assert len(lines) == 3
    for line in lines:
        check_record(json.loads(line))
    header = top(busy, "--format", "csv", "--interval", "0.2", "--count", "1").splitlines()[0]
    assert list(json.loads(lines[0])) == next(csv.reader(io.StringIO(header)))


def test_tables(busy):
    text = top(busy, "--interval", "0.2", "--count", "2")
    assert "\033" not in text
    assert len(re.findall(r"^dipoled \d.*: up 0:00:\d\d, 2 workers", text, re.M)) == 2
    assert len(re.findall(r"^Each second, over the last \d+\.\d s$", text, re.M)) == 2
    assert len(re.findall(r"^eval_short +\d", text, re.M)) == 2
    assert len(re.findall(r"^better +[\d.]+( k| M)?$", text, re.M)) == 2
    assert len(re.findall(r"^bad-value +[\d.]+( k)?$", text, re.M)) == 2
    assert "classical" not in text
    assert max(map(len, text.splitlines())) <= 100


def test_a_daemon_of_its_own():
    text = dipole("top", "--count", "1", "--interval", "0.1", "--format", "json").stdout
    record = json.loads(text)
    assert record["connections_open"] == 1 and record["requests_statistics_per_s"] > 0


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["--interval", "0"], "--interval: from 0.05 to 86400 seconds"),
        (["--interval", "nan"], "--interval: from"),
        (["--interval", "1e9"], "--interval: from"),
        (["--interval", "soon"], "--interval: 'soon' is no number"),
        (["--count", "0"], "--count: at least 1"),
        (["--format", "xml"], "--format xml: it is one of table,csv,json"),
    ],
)
def test_wrong_command_lines(arguments, said):
    assert said in dipole("top", *arguments, status=USAGE).stderr


def test_a_daemon_that_ends(daemon):
    one = daemon()
    with subprocess.Popen(
        [str(PROGRAM), "top", "--connect", one.url(), "--interval", "0.1", "--format", "json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment(),
        text=True,
    ) as watching:
        assert json.loads(watching.stdout.readline())["connections_open"] == 1
        one.terminate()
        assert watching.wait(TIMEOUT_S) == 1
        assert watching.stderr.read().startswith("dipole top: ")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_well(daemon, how):
    """Between records, which are whole."""
    one = daemon()
    with subprocess.Popen(
        [str(PROGRAM), "top", "--connect", one.url(), "--interval", "0.05", "--format", "json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment(),
        text=True,
    ) as watching:
        watching.stdout.readline()
        watching.send_signal(how)
        lines = watching.stdout.read()
        assert watching.wait(TIMEOUT_S) == 0
        assert watching.stderr.read() == ""
    assert lines == "" or lines.endswith("}\n")


class Terminal:
    """A program on a terminal of its own."""

    def __init__(self, *arguments: str, rows: int = 40, columns: int = 100, **variables: str):
        self.master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        self.before = termios.tcgetattr(slave)
        self.process = subprocess.Popen(
            [str(PROGRAM), *arguments],
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env=environment(**variables),
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
        self.slave = slave
        self.text = ""

    def read_until(self, condition) -> None:
        deadline = time.monotonic() + TIMEOUT_S
        while not condition(self.text):
            assert time.monotonic() < deadline, self.text
            if select.select([self.master], [], [], 0.05)[0]:
                self.text += os.read(self.master, 65536).decode()

    def end(self) -> int:
        """Types Ctrl-C; the exit status. What is still written is read."""
        os.write(self.master, b"\x03")
        status = None
        deadline = time.monotonic() + TIMEOUT_S
        while status is None:
            assert time.monotonic() < deadline, self.text
            status = self.process.poll()
            while select.select([self.master], [], [], 0.02)[0]:
                self.text += os.read(self.master, 65536).decode()
        assert termios.tcgetattr(self.slave) == self.before
        os.close(self.master)
        os.close(self.slave)
        return status


def screens(text: str) -> list[str]:
    """What was shown, one after the other."""
    return text.split("\033[H")[1:]


@pytest.mark.parametrize("colour", [True, False])
def test_on_a_terminal(busy, colour):
    variables = {} if colour else {"NO_COLOR": "1"}
    terminal = Terminal("top", "--connect", busy.url(), "--interval", "0.1", **variables)
    terminal.read_until(lambda text: text.count("\033[J") >= 4)
    assert terminal.end() == 0
    text = terminal.text
    assert text.startswith("\033[?25l\033[2J")
    assert "\033[?25h" in text.rpartition("\033[J")[2]  # the cursor is back, behind the table
    shown = screens(text)
    assert "Each second, since its start" in shown[0]
    for screen in shown[1:4]:
        assert re.search(r"Each second, over the last \d+\.\d s\033\[K\r\n", screen)
        lines = screen.partition("\033[J")[0].split("\r\n")[:-1]
        assert len(lines) > 10 and all(line.endswith("\033[K") for line in lines)
        assert ("\033[1m" in lines[0]) == colour
    rest = re.sub(r"\033\[(H|K|J|2J|\?25l|\?25h|1m|0m)", "", text)
    assert "\033" not in rest
    assert ("\033[1m" in text) == ("\033[0m" in text) == colour


def test_on_a_small_terminal(daemon):
    terminal = Terminal(
        "top", "--connect", daemon().url(), "--interval", "0.1", rows=8, columns=30, NO_COLOR="1"
    )
    terminal.read_until(lambda text: text.count("\033[J") >= 3)
    assert terminal.end() == 0
    for screen in screens(terminal.text)[:3]:
        lines = screen.partition("\033[J")[0].replace("\033[K", "").split("\r\n")[:-1]
        assert len(lines) == 7 and max(map(len, lines)) <= 30


def test_count_on_a_terminal(daemon):
    terminal = Terminal("top", "--connect", daemon().url(), "--interval", "0.1", "--count", "2")
    terminal.read_until(lambda text: "\033[?25h" in text)
    assert len(screens(terminal.text)) == 3  # since its start, and two intervals
    assert terminal.process.wait(TIMEOUT_S) == 0
    os.close(terminal.master)
    os.close(terminal.slave)
