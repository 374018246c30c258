"""Starts a dipoled, reads its log, stops it, and checks that it ended well."""

import functools
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import dipole
import dipole.library

START_S = 30.0
# What nothing takes on the slowest machine that works: whoever waits longer has found a fault.
HANG_S = 120.0

REPOSITORY = Path(__file__).resolve().parents[2]
# A daemon refuses variables DIPOLED_* that it does not know, so DIPOLED_BUILD goes no further.
_build = os.environ.pop("DIPOLED_BUILD", None) or os.environ.get("TESTED_BUILD")
BUILD = Path(_build or REPOSITORY / "build").resolve()
os.environ["TESTED_BUILD"] = str(BUILD)
PROGRAM = BUILD / "dipoled"
COUNTING_PROGRAM = BUILD / "dipoled-counting"


@functools.cache
def sanitized(*kinds: str) -> bool:
    """Returns whether the build has one of these sanitizers, or any if none is named. A sanitizer
    makes the daemon slower and its memory larger."""
    code = PROGRAM.read_bytes()
    return any(f"__{kind}_init".encode() in code for kind in kinds or ("asan", "tsan"))


# Python loads no library that needs a sanitizer.
dipole.library.PATH = str((REPOSITORY / "build" if sanitized() else BUILD) / "libdipole.so")

# What makes a program say at its end which memory nobody can free any more, with exit status 23.
LEAKS = {} if sanitized() else {"LD_PRELOAD": str(BUILD / "leaks/scan.so")}

# How long a daemon may take to stop. It finishes a running preparation first, which takes 0.1 s,
# 1.4 s for transport that absorbs nothing, and up to 70 times as long under a sanitizer.
END_S = 60.0 if sanitized() else 10.0


def environment(**variables: str) -> dict[str, str]:
    """Returns this process's environment without options of dipoled, and with the given
    variables."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith("DIPOLED")}
    return {**kept, **variables}


def read_log_line(line: str) -> dict[str, str]:
    """Reads a log line key=value key=value, in which values with blanks are quoted or escaped."""
    return dict(pair.split("=", 1) for pair in line.split() if "=" in pair)


class Daemon:
    """A running dipoled. Without `listen`, it listens on a Unix socket and on a free TCP port. env:
    additional environment variables. listen: addresses. quiet: the daemon logs nothing, so its
    address is the one in `listen`. prefix: a program that starts the daemon. pass_fds: file
    descriptors that it inherits. counting: allocations() and
    fail_allocation() work."""

    def __init__(
        self,
        *options: str,
        env: dict[str, str] | None = None,
        listen: list[str] | None = None,
        quiet: bool = False,
        prefix: list[str] | None = None,
        pass_fds: tuple[int, ...] = (),
        counting: bool = False,
    ):
        self.folder = Path(tempfile.mkdtemp(prefix="dipoled-"))
        self._allocations = self.folder / "allocations"
        if listen is None:
            listen = [f"unix:{self.folder}/s", "tcp:127.0.0.1:0"]
        command = [*(prefix or []), str(COUNTING_PROGRAM if counting else PROGRAM)]
        for url in listen:
            command += ["--listen", url]
        self._lines: list[str] = []
        self._changed = threading.Condition()
        self._ended = False  # whether the log is complete
        self._stopping = False
        self._killed = False
        self._quiet = quiet
        self.process = subprocess.Popen(
            [*command, *options],
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env=environment(**{**LEAKS, **(env or {})}, ALLOCATIONS_FILE=str(self._allocations)),
            pass_fds=pass_fds,
            text=True,
            errors="replace",
        )
        self._reader = threading.Thread(target=self._read_log, daemon=True)
        self._reader.start()
        try:
            self.urls = self._wait_until_connected(listen) if quiet else self._wait_until_ready()
        except BaseException:
            self.kill()
            raise

    def _wait_until_ready(self) -> list[str]:
        assert self.has_line("event=ready", START_S), "not ready:\n" + "\n".join(self.log)
        lines = map(read_log_line, self.log)
        return [line["url"] for line in lines if line.get("event") == "listening"]

    def _wait_until_connected(self, urls: list[str]) -> list[str]:
        def answers() -> bool:
            try:
                dipole.Connection(urls[0]).close()
                return True
            except dipole.ConnectError:
                return False

        assert eventually(answers, START_S)
        return urls

    # ---- the log ---------------------------------------------------------------------------------

    def _read_log(self) -> None:
        for line in self.process.stderr:
            with self._changed:
                self._lines.append(line.rstrip("\n"))
                self._changed.notify_all()
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    @property
    def log(self) -> list[str]:
        """Returns the lines that the daemon has logged so far."""
        with self._changed:
            return list(self._lines)

    def has_line(self, text: str, timeout_s: float = HANG_S) -> bool:
        """Waits for a line with this text in the log. Returns False after the timeout or at the end
        of the log."""
        with self._changed:

            def found() -> bool:
                return any(text in line for line in self._lines)

            self._changed.wait_for(lambda: found() or self._ended, timeout_s)
            return found()

    # ---- connecting ------------------------------------------------------------------------------

    def url(self, scheme: str = "unix") -> str:
        """Returns the first address of this scheme at which the daemon says that it listens."""
        return next(url for url in self.urls if url.startswith(scheme + ":"))

    def connect(self, scheme: str = "unix") -> dipole.Connection:
        """Opens a dipole.Connection, which sends no hello."""
        return dipole.Connection(self.url(scheme))

    def client(self, scheme: str = "unix", **how) -> dipole.Client:
        """Opens a dipole.Client."""
        return dipole.Client(self.url(scheme), **how)

    # ---- looking at it ---------------------------------------------------------------------------

    def resident_bytes(self, name: str = "VmRSS") -> int:
        """Returns the resident memory of the daemon; VmHWM: the most that it has been."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        line = next(line for line in status.splitlines() if line.startswith(f"{name}:"))
        return int(line.split()[1]) * 1024

    def allocations(self) -> int:
        """Returns how often the daemon has called malloc, calloc or realloc so far."""
        return int.from_bytes(self._allocations.read_bytes()[:8], "little")

    def fail_allocation(self, number: int) -> bool:
        """Lets a later call of malloc, calloc or realloc fail, the next one for 1, none for 0. Returns
        whether the one that was named before is still to come. The daemon's libraries go on."""
        with self._allocations.open("r+b") as file:
            file.seek(8)
            waits = any(file.read(8))
            file.seek(8)
            file.write(number.to_bytes(8, "little"))
        return waits

    # ---- ending it -------------------------------------------------------------------------------

    def terminate(self, how: signal.Signals = signal.SIGTERM) -> None:
        """Sends the daemon a signal to stop, and does not wait for its end."""
        self._stopping = True
        self.process.send_signal(how)
        # The signal is sent again if the log does not show it: gcc 12's thread sanitizer loses a
        # signal that arrives just when libuv's loop begins to wait.
        for _ in range(5):
            if self._quiet or not sanitized("tsan") or self.has_line("event=stopping", 1.0):
                break
            if self.process.poll() is None:
                self.process.send_signal(how)

    def pause(self) -> None:
        """Stops the daemon by SIGSTOP, and waits until none of its threads runs. SIGCONT lets it go
        on."""
        self.process.send_signal(signal.SIGSTOP)
        tasks = Path(f"/proc/{self.process.pid}/task")

        def stands() -> bool:
            states = [(one / "stat").read_text().rpartition(")")[2].split()[0] for one in tasks.iterdir()]
            return set(states) == {"T"}

        assert eventually(stands)

    def stand(self, seconds: float) -> None:
        """Lets a time pass in which the daemon cannot work."""
        self.pause()
        time.sleep(seconds)
        self.process.send_signal(signal.SIGCONT)

    def kill(self) -> None:
        """Kills the daemon. close() then does not check its end."""
        self._killed = True
        self.process.kill()
        self.wait()
        shutil.rmtree(self.folder, ignore_errors=True)

    def wait(self, timeout_s: float = END_S) -> int:
        """Waits until the daemon has ended and its log has been read; returns its exit status."""
        status = self.process.wait(timeout_s)
        self._reader.join(timeout_s)
        return status

    def close(self) -> None:
        """Stops the daemon. Checks that it was still running, ends in time and with status 0, and
        that neither a sanitizer nor the daemon itself has reported a fault."""
        if self._killed:
            return
        if not self._stopping:
            died = self.process.poll()
            assert died is None, f"dipoled ended with {died}:\n" + "\n".join(self.log)
            self.terminate()
        try:
            status = self.wait()
        except subprocess.TimeoutExpired:
            log = "\n".join(self.log)
            self.kill()
            raise AssertionError(f"dipoled did not stop in {END_S} s:\n{log}") from None
        log = "\n".join(self.log)
        shutil.rmtree(self.folder, ignore_errors=True)
        assert status == 0, f"dipoled ended with {status}:\n{log}"
        faults = ("Sanitizer", "runtime error:", "event=fault")
        assert not any(fault in log for fault in faults), log


def finished(*command: str | Path, **how) -> subprocess.CompletedProcess[str]:
    """Runs a program to its end, with this process's environment() and no input unless `how` says
    otherwise. Returns its status, and what it wrote as text."""
    usual = {"env": environment(), "timeout": 3 * HANG_S, "capture_output": True, "text": True, "check": False}
    if "input" not in how:
        usual["stdin"] = subprocess.DEVNULL
    return subprocess.run([*map(str, command)], **{**usual, **how})


def run(*options: str, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Runs dipoled with options that make it end by itself."""
    return finished(PROGRAM, *options, env=environment(**(env or {})), timeout=END_S)


def eventually(condition, timeout_s: float = HANG_S, interval_s: float = 0.005) -> bool:
    """Waits until a condition holds, and looks less often the longer it waits. Returns False if it
    does not hold before the timeout."""
    begun = time.monotonic()
    while not condition():
        waited_s = time.monotonic() - begun
        if waited_s > timeout_s:
            return False
        time.sleep(max(interval_s, min(0.05, waited_s / 10)))
    return True


NOWHERE = ("no socket", "refused", "no such host", "several")


@contextmanager
def nowhere(why: str, folder: Path) -> Iterator[str]:
    """Yields an address where no daemon is, of a kind in NOWHERE."""
    with socket.socket() as closed:  # bound, so that nobody else gets the port
        closed.bind(("127.0.0.1", 0))
        refused = f"tcp:127.0.0.1:{closed.getsockname()[1]}"
        yield {
            "no socket": f"unix:{folder}/none",
            "refused": refused,
            "no such host": "tcp:no-such-host.invalid:4817",
            "several": f"unix:{folder}/none,{refused}",
        }[why]
