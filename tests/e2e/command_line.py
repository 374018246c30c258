"""Runs `dipole`, the command line, and reads what it writes."""

import atexit
import csv
import fcntl
import functools
import io
import json
import os
import pty
import select
import socket
import struct
import subprocess
import tempfile
import termios
import threading
import time
from pathlib import Path

from daemons import BUILD, Daemon, environment
from dipole import wire
from frames import EVAL, frame

PROGRAM = BUILD / "dipole"
TIMEOUT_S = 300.0

OK, FAILED, USAGE, BAD_ROWS = 0, 1, 2, 3

COMMANDS_WITH_MODELS = ("eval", "plot", "points", "sample", "invert", "fit", "table")
NAMES_ITS_MODEL = ("--model", "--tolerance", "--help")


@functools.cache
def shared() -> Daemon:
    """Returns the daemon that commands ask which name none: a private one each would start and solve
    for itself."""
    one = Daemon()
    atexit.register(one.close)
    return one


def of_better(arguments: tuple[str, ...]) -> list[str]:
    """Returns a command line of the model better unless it says how the model is chosen. Most tests
    are about what is asked and written, and better has formulas that take microseconds."""
    said = any(argument.split("=")[0] in NAMES_ITS_MODEL for argument in arguments)
    if said or arguments[:1] not in [(name,) for name in COMMANDS_WITH_MODELS]:
        return list(arguments)
    return [arguments[0], "--model", "better", *arguments[1:]]


def dipole(
    *arguments: str,
    stdin: str | bytes = b"",
    env: dict[str, str] | None = None,
    status: int = OK,
    quiet: bool = True,
    cwd: Path | None = None,
    usual: bool = False,
) -> subprocess.CompletedProcess[str]:
    """Runs a command, by default with the shared daemon, and checks its exit status. quiet: also
    checks that a command that succeeds writes nothing to standard error. usual: leaves the choice
    of the model to the command; see of_better()."""
    run = subprocess.run(
        [str(PROGRAM), *(arguments if usual else of_better(arguments))],
        input=stdin.encode() if isinstance(stdin, str) else stdin,
        capture_output=True,
        env=environment(**{"DIPOLED": shared().url(), **(env or {})}),
        timeout=TIMEOUT_S,
        check=False,
        cwd=cwd,
    )
    text = subprocess.CompletedProcess(
        run.args, run.returncode, run.stdout.decode(), run.stderr.decode()
    )
    assert "Sanitizer" not in text.stderr and "runtime error:" not in text.stderr, text.stderr
    assert text.returncode == status, f"{arguments}: {text.returncode}: {text.stderr}"
    if status == OK and quiet:
        assert text.stderr == ""
    return text


def eval_rows(*arguments: str, quiet: bool = True) -> list[dict[str, str]]:
    """Returns the rows of `dipole eval --format csv`."""
    return read_csv(dipole("eval", "--format", "csv", *arguments, quiet=quiet).stdout)


def eval_json(*arguments: str, quiet: bool = True) -> dict:
    """Returns the object of `dipole eval --format json`."""
    return json.loads(dipole("eval", "--format", "json", *arguments, quiet=quiet).stdout)


def points(text: str | bytes, *arguments: str, status: int = OK) -> str:
    """Returns the output of `dipole points` for a CSV text."""
    return dipole("points", *arguments, stdin=text, status=status).stdout


def read_csv(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text, newline="")))


class Terminal:
    """Runs a command with a terminal as some of its standard streams. `on` lists their file
    descriptors. `seen` collects what the command writes to the terminal; its other outputs are
    pipes."""

    def __init__(
        self, *arguments: str, on=(0, 1, 2), size=(24, 80), stdin=subprocess.DEVNULL, **env: str
    ):
        self.fd, other = pty.openpty()
        fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", *size, 0, 0))
        variables = environment(**{"TERM": "xterm-256color", "DIPOLED": shared().url(), **env})
        if "NO_COLOR" not in env:
            variables.pop("NO_COLOR", None)
        ends = {0: stdin, 1: subprocess.PIPE, 2: subprocess.PIPE} | dict.fromkeys(on, other)
        session = {}
        if 0 in on:  # so that Ctrl-C comes from this terminal
            session["start_new_session"] = True
            session["preexec_fn"] = lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0)
        self.process = subprocess.Popen(
            [str(PROGRAM), *of_better(arguments)], 0, None, *ends.values(), env=variables, **session
        )
        os.close(other)
        self.seen = ""

    def read(self) -> bool:
        """Reads what has been written to the terminal. Returns whether more may come."""
        if not select.select([self.fd], [], [], 0.05)[0]:
            return True
        try:
            data = os.read(self.fd, 65536)
        except OSError:  # Linux reports this when the other end is closed.
            return False
        self.seen += data.decode().replace("\r\n", "\n")
        return bool(data)

    def read_until(self, condition) -> None:
        """Reads the terminal until a condition holds for all text seen so far."""
        deadline = time.monotonic() + TIMEOUT_S
        while not condition(self.seen):
            assert time.monotonic() < deadline and self.read(), self.seen

    def end(self) -> tuple[int, str]:
        """Reads until the end. Returns the exit status and what the command wrote to a pipe as its
        standard output."""
        deadline = time.monotonic() + TIMEOUT_S
        while self.read():
            assert time.monotonic() < deadline, self.seen
        output = self.process.communicate(timeout=TIMEOUT_S)[0]
        os.close(self.fd)
        return self.process.returncode, (output or b"").decode()


class Proxy:
    """A proxy between a client and a daemon. It can change the client's eval requests, or those of
    another type, and, if on_reply is given, the daemon's replies. on_eval(number, request_id) returns None to pass a
    request on, bytes to answer it in the daemon's place, or False to close the connection.
    on_reply(type, payload) returns the payloads of the replies that the client gets."""

    def __init__(self, url: str, on_eval, on_reply=lambda type, payload: [payload], type: int = EVAL):
        self._type = type
        self._daemon_path = url.removeprefix("unix:")
        self._on_eval = on_eval
        self._on_reply = on_reply
        self._folder = tempfile.TemporaryDirectory(prefix="dipole-proxy-")
        self.url = f"unix:{self._folder.name}/s"
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(self.url.removeprefix("unix:"))
        self._listener.listen()
        self._listener.settimeout(TIMEOUT_S)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Proxy":
        return self

    def __exit__(self, *_) -> None:
        self._thread.join(TIMEOUT_S)
        self._listener.close()
        self._folder.cleanup()
        assert not self._thread.is_alive()

    def _serve(self) -> None:
        client, _ = self._listener.accept()
        with client, socket.socket(socket.AF_UNIX) as daemon:
            daemon.connect(self._daemon_path)
            lock = threading.Lock()  # keeps the frames of proxy and daemon apart
            back = threading.Thread(target=self._pass_back, args=(daemon, client, lock))
            back.start()
            try:
                self._pass_on(client, daemon, lock)
            except OSError:
                pass  # the client is gone
            for end in (daemon, client):
                try:
                    end.shutdown(socket.SHUT_RDWR)
                except OSError:
                    pass
            back.join()

    def _pass_on(self, client, daemon, lock) -> None:
        evals = 0
        stream = client.makefile("rb")
        while head := stream.read(wire.HEADER.bytes):
            header = wire.HEADER.unpack(head)
            payload = stream.read(header.payload_bytes)
            answer = None
            if header.type == self._type:
                answer = self._on_eval(evals, header.request_id)
                evals += 1
            if answer is None:
                daemon.sendall(head + payload)
            elif answer is False:
                return
            else:
                with lock:
                    client.sendall(answer)

    def _pass_back(self, daemon, client, lock) -> None:
        stream = daemon.makefile("rb")
        try:
            while head := stream.read(wire.HEADER.bytes):
                header = wire.HEADER.unpack(head)
                for payload in self._on_reply(header.type, stream.read(header.payload_bytes)):
                    with lock:
                        client.sendall(frame(header.type, header.request_id, payload))
        except OSError:
            pass  # the client is gone


def busy(request_id: int, retry_after_ms: int = 1, status: str = "busy") -> bytes:
    """Makes the error frame of a daemon at its limit, or with another status."""
    code = next(code for code, name in wire.STATUSES.items() if name == status)
    error = wire.ERROR.pack(
        status=code, zero=0, retry_after_ms=retry_after_ms, index=0, field="", allowed=""
    )
    return frame(wire.TYPE_ERROR, request_id, error)
