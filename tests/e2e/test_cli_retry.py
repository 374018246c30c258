"""`dipole --connect` with several addresses, and `--retry-ms`: daemons that start late, are lost,
or stay busy."""

import re
import socket
import subprocess
import threading
from pathlib import Path

import pytest
from command_line import FAILED, PROGRAM, TIMEOUT_S, Proxy, Terminal, busy, dipole

ARGUMENTS = ("--sigma-a", "0.03", "--sigma-s", "1", "--r", "0.5,1,2")


def test_a_person_is_told_at_once(tmp_path):
    with_wait = ("--connect", f"unix:{tmp_path}/a", "--retry-ms", "400", *ARGUMENTS)
    terminal = Terminal("eval", *with_wait, on=(2,))
    assert terminal.end() == (FAILED, "")
    assert "Trying for another 0.4 s, see --retry-ms." in terminal.seen.splitlines()[0]
    assert "Trying" not in dipole("eval", *with_wait, status=FAILED).stderr
    terminal = Terminal("eval", "--connect", "nowhere", *ARGUMENTS, on=(2,))
    assert terminal.end()[0] != 0 and "Trying" not in terminal.seen


@pytest.mark.parametrize("command", ["eval", "points"])
def test_busy_for_a_limited_time(daemon, command):
    asked = []

    def refuse(number: int, request_id: int) -> bytes:
        asked.append(number)
        return busy(request_id)

    # dR_dr has no kernel for media that vary, so points asks for it by evals.
    arguments = ARGUMENTS if command == "eval" else ("--wanted", "dR_dr")
    rows = "sigma_a,sigma_s,g,eta,r\n0.01,1,0,1.4,2\n"
    counts = []
    for retry_ms in ("0", "200"):
        asked.clear()
        with Proxy(daemon().url(), refuse) as proxy:
            options = ("--connect", proxy.url, "--retry-ms", retry_ms)
            run = dipole(command, *options, *arguments, stdin=rows, status=FAILED)
        assert "busy" in run.stderr
        counts.append(len(asked))
    assert counts[0] == 1 and counts[1] > 1


def test_a_person_is_told_how_long_a_reply_takes(daemon):
    held = threading.Event()

    def hold(number: int, request_id: int) -> None:
        held.wait(TIMEOUT_S)

    with Proxy(daemon().url(), hold) as proxy:
        terminal = Terminal("eval", "--connect", proxy.url, *ARGUMENTS, on=(2,))
        terminal.read_until(lambda seen: re.search("waiting for the daemon: +2 s", seen))
        held.set()
        assert terminal.end()[0] == 0 and terminal.seen.endswith("\r\033[K")


def test_a_host_may_take_its_time():
    """The kernel drops what opens the connection as long as the listener's queue is full."""
    with socket.create_server(("127.0.0.1", 0), backlog=0) as server:
        port = server.getsockname()[1]
        tried = re.compile(f" 0100007F:{port:04X} 02 ")
        with socket.create_connection(("127.0.0.1", port)):
            command = [PROGRAM, "info", "--connect", f"tcp:127.0.0.1:{port}", "--retry-ms", "0"]
            with subprocess.Popen(command, stderr=subprocess.PIPE) as run:
                while run.poll() is None and not tried.search(Path("/proc/net/tcp").read_text()):
                    pass
                for _ in range(2 if run.poll() is None else 0):
                    server.accept()[0].close()
                assert re.search(b"was lost|closed the connection", run.communicate()[1])
