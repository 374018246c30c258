"""`dipole points`: its memory, and what it does while it runs. tests/cli/points.t has what it writes."""

import os
import select
import subprocess
import time

from command_line import FAILED, PROGRAM, TIMEOUT_S, Proxy, Terminal, busy, dipole, points
from daemons import environment, finished

HEADER = "sigma_a,sigma_s,g,eta,r"
ROW = "0.01,1,0,1.4,2"


# ---- many rows -----------------------------------------------------------------------------------


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
        # The address sanitizer keeps freed memory for a while, unless told otherwise.
        env = environment(ASAN_OPTIONS="quarantine_size_mb=1:thread_local_quarantine_size_kb=64")
        run = finished("/usr/bin/python3", "-c", code, *command, env=env)
        kilobytes, status = map(int, run.stdout.split())
        assert status == 0
        sizes[name] = kilobytes
    assert sizes["wide"] - sizes["plain"] < 24_000  # The file has 60,000 kB.


# ---- while it runs -------------------------------------------------------------------------------


def read_until(stream: int, text: bytes, timeout_s: float = TIMEOUT_S) -> bytes:
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
    start = time.monotonic()
    run = Terminal("points", on=[2], stdin=subprocess.PIPE)
    run.process.stdin.write(HEADER.encode() + b"\n")
    while " rows" not in run.seen:
        assert time.monotonic() - start < TIMEOUT_S
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
