"""`dipole top`: tables, CSV and JSON for each interval, and a terminal on which each table replaces
the one before."""

import json
import os
import re
import signal
import subprocess
import termios

import pytest
from beside import Beside
from command_line import PROGRAM, TIMEOUT_S, Terminal, dipole, read_csv
from daemons import environment, finished
from frames import EVAL, SKIN, ask, eval_payload
from lists import MODELS


@pytest.fixture
def busy(daemon):
    """Returns a daemon with a client that sends eval requests all the time, one in ten of them
    wrong."""
    one = daemon()
    right, wrong = eval_payload([SKIN], [1.0] * 100), eval_payload([SKIN], [-1.0])
    with one.connect() as connection:
        with Beside(lambda: [ask(connection, EVAL, payload) for payload in [right] * 9 + [wrong]]):
            yield one


def top(daemon, *arguments: str) -> str:
    return dipole("top", "--connect", daemon.url(), *arguments).stdout


def records(rows: list[dict]) -> list[dict[str, float]]:
    """Returns the statistics of each interval by their names, and their rates with _per_s."""
    found: dict[str, dict[str, float]] = {}
    for row in rows:
        one = found.setdefault(row["uptime_ms"], {"interval_s": float(row["interval_s"])})
        one[row["statistic"]] = float(row["now"])
        if row["per_s"] not in ("", None):
            one[f"{row['statistic']}_per_s"] = float(row["per_s"])
    return list(found.values())


def check_record(record: dict[str, float]) -> None:
    """Checks a record of the statistics while the busy client asks: nine requests for 100 radii, and a
    wrong one. The numbers of a record need not be of one moment."""
    interval_s = record["interval_s"]
    assert interval_s > 0.15
    evals, errors, radii = (
        record[f"{name}_per_s"] * interval_s
        for name in ("requests_eval", "replies_bad-value", "radii_better")
    )
    assert errors == pytest.approx(evals / 10, abs=2 + 0.01 * evals)
    assert radii == pytest.approx(evals * 90, abs=300 + evals)
    assert record["radii_evaluated_per_s"] * interval_s == pytest.approx(radii, abs=300 + evals)
    assert record["radii_classical_per_s"] == 0
    assert record["connections_open"] == 2 and "connections_open_per_s" not in record
    quantiles = [record[f"latency_eval_short_{q}_us"] for q in ("p50", "p90", "p99", "p999", "max")]
    assert quantiles == sorted(quantiles) and quantiles[0] > 0


@pytest.mark.parametrize("form", ["csv", "json"])
def test_intervals(busy, form):
    text = top(busy, "--format", form, "--interval", "0.2", "--count", "3")
    rows = read_csv(text) if form == "csv" else [json.loads(line) for line in text.splitlines()]
    assert len(records(rows)) == 3
    for record in records(rows):
        check_record(record)
    assert any(record["requests_eval_per_s"] > 0 for record in records(rows))
    assert {f"radii_{model}" for model in MODELS} < {row["statistic"] for row in rows}


def test_tables(busy):
    text = top(busy, "--interval", "0.2", "--count", "2")
    assert "\033" not in text
    assert len(re.findall(r"^dipoled \d.*: up 0:00:\d\d, 2 workers", text, re.M)) == 2
    assert len(re.findall(r"^over the last \d+\.\d s$", text, re.M)) == 2
    assert len(re.findall(r"^latency_eval_short_p99_us +\d+", text, re.M)) == 2
    assert len(re.findall(r"^radii_better +[\d.]+( k| M)? +[\d.]+( k| M)?$", text, re.M)) == 2
    assert len(re.findall(r"^replies_bad-value +\d", text, re.M)) == 2
    assert "classical" not in text
    assert max(map(len, text.splitlines())) <= 80


@pytest.fixture
def watching(daemon):
    """Returns a daemon, and a command that watches it and writes records of JSON."""
    one = daemon()
    options = ["--connect", one.url(), "--interval", "0.05", "--format", "json"]
    options += ["--retry-ms", "300"]
    with subprocess.Popen(
        [str(PROGRAM), "top", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment(),
        text=True,
    ) as process:
        assert json.loads(process.stdout.readline())["statistic"] == "uptime_ms"
        yield one, process


def test_a_daemon_that_ends(watching):
    one, process = watching
    one.terminate()
    assert process.wait(TIMEOUT_S) == 1
    assert process.stderr.read().startswith("dipole top: ")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_well(watching, how):
    """A signal ends the command between two records, so that all records are whole."""
    process = watching[1]
    process.send_signal(how)
    lines = process.stdout.read()
    assert (process.wait(TIMEOUT_S), process.stderr.read()) == (0, "")
    assert lines == "" or lines.endswith("}\n")


LARGE = {"size": (40, 100)}


def watch(terminal: Terminal, count: int) -> str:
    """Reads the terminal until it has shown this many tables, then types Ctrl-C. Checks that the
    command ends well and restores the terminal. Returns the text."""
    before = termios.tcgetattr(terminal.fd)
    terminal.read_until(lambda seen: seen.count("\033[J") >= count)
    os.write(terminal.fd, b"\x03")
    while terminal.read():
        pass
    assert termios.tcgetattr(terminal.fd) == before
    assert terminal.end()[0] == 0
    return terminal.seen


def screens(text: str) -> list[str]:
    """Splits the text of a terminal into its screens."""
    return text.split("\033[H")[1:]


@pytest.mark.parametrize("colour", [True, False])
def test_on_a_terminal(busy, colour):
    variables = {} if colour else {"NO_COLOR": "1"}
    terminal = Terminal("top", "--connect", busy.url(), "--interval", "0.1", **variables, **LARGE)
    text = watch(terminal, 4)
    assert text.startswith("\033[?25l\033[2J")
    # The cursor is visible again, behind the table.
    assert "\033[?25h" in text.rpartition("\033[J")[2]
    shown = screens(text)
    assert "since its start" in shown[0]
    for screen in shown[1:4]:
        assert re.search(r"over the last \d+\.\d s\033\[K\n", screen)
        lines = screen.partition("\033[J")[0].splitlines()
        assert len(lines) > 10 and all(line.endswith("\033[K") for line in lines)
        assert ("\033[1m" in lines[0]) == colour
    rest = re.sub(r"\033\[(H|K|J|2J|\?25l|\?25h|1m|0m)", "", text)
    assert "\033" not in rest
    assert ("\033[1m" in text) == ("\033[0m" in text) == colour


def test_on_a_small_terminal(daemon):
    how = {"size": (8, 30), "NO_COLOR": "1"}
    terminal = Terminal("top", "--connect", daemon().url(), "--interval", "0.1", **how)
    for screen in screens(watch(terminal, 3))[:3]:
        lines = screen.partition("\033[J")[0].replace("\033[K", "").splitlines()
        assert len(lines) == 7 and max(map(len, lines)) <= 30


def shown(seen: str) -> list[str]:
    """Returns the rows of the last screen that was drawn completely."""
    screens = re.sub(r"\033\[(\?25[hl]|K|1m|0m|2J)", "", seen).split("\033[H")
    whole = [screen for screen in screens if screen.endswith("\033[J")]
    return whole[-1].removesuffix("\033[J").splitlines() if whole else []


def test_a_daemon_that_goes_and_comes_back(daemon):
    """The numbers of a daemon that has gone do not stay on the screen."""
    one = daemon(listen=["tcp:127.0.0.1:0"])
    url = one.url("tcp")
    screen = Terminal("top", "--connect", url, "--interval", "0.1")
    screen.read_until(lambda seen: "owed_radii" in seen)
    one.kill()
    screen.read_until(lambda seen: "No reply from " in (shown(seen) or [""])[0])
    gone = shown(screen.seen)
    assert re.match(rf"No reply from {re.escape(url)} for \d+ s", gone[0])
    assert gone[-1].startswith("Trying again")
    assert not any("owed_radii" in row for row in gone)
    other = daemon(listen=[url])
    screen.read_until(lambda seen: any("owed_radii" in row for row in shown(seen)))
    screen.process.send_signal(signal.SIGINT)
    assert screen.end()[0] == 0
    other.close()


def test_a_daemon_that_hangs(daemon):
    one = daemon()
    screen = Terminal("top", "--connect", one.url(), "--interval", "0.1")
    screen.read_until(lambda seen: "owed_radii" in seen)
    one.pause()
    screen.read_until(lambda seen: "No reply from " in (shown(seen) or [""])[0])
    one.process.send_signal(signal.SIGCONT)
    screen.read_until(lambda seen: any("owed_radii" in row for row in shown(seen)))
    screen.process.send_signal(signal.SIGINT)
    assert screen.end()[0] == 0


SERVICE = """mount -t tmpfs none /run || exit 77
"$0/dipole" info | grep " address  *private:" || exit 1
"$0/dipoled" --listen unix:/run/dipoled.sock >/dev/null 2>&1 &
trap "kill $!" EXIT
"$0/dipole" info --connect unix:/run/dipoled.sock >/dev/null || exit 1
for command in "info --format csv" "top --count 1 --interval .1" "bench --seconds .01"; do
  "$0/dipole" $command || exit 1
done
"$0/dipole" info --connect private: | grep " address  *private:" || exit 1
kill -STOP $!
"$0/dipole" info --retry-ms 100 --timeout-ms 100 && exit 1
kill -CONT $!
"""


def test_the_installed_service_is_shown_unless_another_daemon_is_named():
    run = finished("unshare", "-rm", "bash", "-mc", SERVICE, str(PROGRAM.parent))
    if run.returncode == 77 or "unshare failed" in run.stderr:
        pytest.skip("a file system of one's own cannot be mounted here")
    assert run.returncode == 0, run.stderr
    for shown in ("daemon,address,", "dipoled 0.1.0 at ", "dipoled 0.1.0, at "):
        run.stdout = run.stdout.split(f"{shown}unix:/run/dipoled.sock", 1)[1]
    assert "The address is from" not in run.stderr  # of the one that does not answer
    for command in ("info", "top", "bench"):
        assert f"dipole {command}: this is the installed service, unix:/run/dipoled" in run.stderr
