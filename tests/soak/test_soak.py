"""Full load for SOAK_S seconds: requests of every kind, and beside them clients that are killed, do
not read, or send garbage. Every answer is correct, and memory does not grow. And a mixed load for
MIXED_S seconds: clients of every kind of port that leave, do not read, or flood it."""

from __future__ import annotations

import contextlib
import os
import random
import socket
import ssl
import subprocess
import threading
import time

from certificates import Recorder
from daemons import BUILD, Daemon, sanitized
from dipole import DipoleError, wire
from frames import EVAL, F32, STATISTICS, R, ask, eval_payload, frame
from test_robustness import (
    Leavers, Ports, assert_every_port_answers, grid_request, http_request, receive_whole,
)

SOAK_S = float(os.environ.get("SOAK_S") or 40)
MIXED_S = float(os.environ.get("MIXED_S") or 10)
CACHE_BYTES = 1 << 20  # This is less than all profiles take.
TOTAL_BYTES = 256 << 20
OPTIONS = (
    *("--max-frame-bytes", str(1 << 20), "--max-part-bytes", str(1 << 16)),
    *("--cache-bytes", str(CACHE_BYTES), "--max-total-bytes", str(TOTAL_BYTES)),
)
# The daemon's memory may grow by this much beyond its maximum in the first third of the time, when
# it has met everything: for gaps in a heap with blocks of all sizes, and for records of a
# sanitizer.
GROWTH_BYTES = (128 if sanitized() else 24) << 20
PATIENCE_S = 300.0  # for waiting before and after the measured time
ENDLESS = eval_payload(radii=None, radius_count=64_000_000, evaluator=F32, wanted=R)


class Load:
    """A running soak-load, see load.c."""

    def __init__(self, url: str, seed: int):
        self.process = subprocess.Popen(
            [str(BUILD / "soak-load"), url, str(seed), "all"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.last_line = ""
        self._has_begun = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            self.last_line = line.strip()
            if line.startswith("answered="):
                self._has_begun.set()
        self._has_begun.set()

    def wait_until_begun(self) -> None:
        """Waits until it knows all answers and has checked some."""
        assert self._has_begun.wait(PATIENCE_S)
        assert self.process.poll() is None, self.process.stderr.read()

    def end(self) -> dict[str, int]:
        """Ends it, and checks that it found no fault. Returns its counts."""
        self.process.stdin.close()
        status = self.process.wait(PATIENCE_S)
        self._reader.join()
        assert status == 0, self.process.stderr.read()
        return {k: int(v) for k, v in (pair.split("=") for pair in self.last_line.split())}

    def kill(self) -> None:
        """Kills it."""
        self.process.kill()
        self.process.wait()


class Rude:
    """A thread of bad clients of a daemon, until it is told to stop."""

    def __init__(self, daemon: Daemon):
        self.done = 0
        self._daemon = daemon
        self._stop = threading.Event()
        self._rng = random.Random(17)
        self._thread = threading.Thread(target=self._run)
        self.failure: BaseException | None = None

    def __enter__(self) -> Rude:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        if self.failure is not None:
            raise self.failure

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                self._round()
                self.done += 1
        except BaseException as failure:  # The test's own thread raises it.
            self.failure = failure

    def _round(self) -> None:
        """Opens two clients that do not read for a second. Meanwhile, others die or send
        garbage."""
        with self._daemon.connect("unix") as one, self._daemon.connect("tcp") as other:
            for stuck in (one, other):
                stuck.send_bytes(frame(EVAL, 1, ENDLESS) * 8)
            victim = Load(self._daemon.url(), 99)
            while not self._stop.wait(0.05) and self._rng.random() < 0.95:
                self._die_or_babble()
            victim.kill()

    def _die_or_babble(self) -> None:
        request = frame(EVAL, 1, eval_payload(radii=None, radius_count=50_000))
        with self._daemon.connect(self._rng.choice(["unix", "tcp"])) as rude:
            with contextlib.suppress(DipoleError):
                if self._rng.random() < 0.3:
                    rude.send_bytes(self._rng.randbytes(self._rng.randrange(1, 5000)))
                    rude.receive_frame()
                else:
                    rude.send_bytes(request[: self._rng.randrange(1, len(request) + 1)])
                    if self._rng.random() < 0.5:
                        rude.half_close()
                        rude.receive_bytes(self._rng.randrange(1, 1000))


def statistics(connection) -> dict[str, int]:
    """Reads the daemon's statistics over this connection."""
    payload = ask(connection, STATISTICS).payload
    count = wire.LIST_REPLY.unpack(payload).count
    offsets = (wire.LIST_REPLY.bytes + i * wire.VALUE.bytes for i in range(count))
    return dict(wire.VALUE.unpack(payload, offset) for offset in offsets)


def watch(daemon: Daemon) -> list[int]:
    """Reads the daemon's memory twice a second, and checks its limits. Returns all sizes."""
    resident_bytes = []
    end_s = time.monotonic() + SOAK_S
    with daemon.connect() as watcher:
        while time.monotonic() < end_s:
            now = statistics(watcher)
            # The first 128 KiB of each connection do not count in the budget.
            beside_bytes = now["connections_open"] * (128 << 10)
            assert now["buffer_bytes"] <= TOTAL_BYTES + beside_bytes
            assert now["cache_bytes"] <= CACHE_BYTES
            resident_bytes.append(daemon.resident_bytes())
            time.sleep(0.5)
    return resident_bytes


def test_soak():
    # This setting keeps the address sanitizer from holding on to freed memory.
    asan = os.environ.get("ASAN_OPTIONS", "") + ":quarantine_size_mb=8"
    daemon = Daemon(*OPTIONS, env={"ASAN_OPTIONS": asan})
    try:
        loads = [Load(daemon.url(("unix", "tcp")[i % 2]), i) for i in range(3)]
        try:
            for load in loads:
                load.wait_until_begun()
            with Rude(daemon) as rude:
                resident_bytes = watch(daemon)
            counts = [load.end() for load in loads]
        finally:
            for load in loads:
                load.kill()
        with daemon.connect() as watcher:
            now = statistics(watcher)
    finally:
        daemon.close()
    tenths = [resident_bytes[len(resident_bytes) * i // 10 :] for i in range(10)]
    curve = " ".join(f"{tenth[0] / 2**20:.0f}" for tenth in tenths)
    total = {name: sum(count[name] for count in counts) for name in counts[0]}
    print(f"\nsoak: {SOAK_S:.0f} s, {total}, {rude.done} rounds of rudeness")
    print(f"soak: resident MiB: {curve} {resident_bytes[-1] / 2**20:.0f}")
    print(f"soak: cache_bytes {now['cache_bytes']}, evictions {now['cache_evictions']}")
    assert rude.done > 0
    # Whether an answer is late depends on the machine.
    assert all(count > 0 for name, count in total.items() if name != "late"), total
    first_third = resident_bytes[: max(len(resident_bytes) // 3, 1)]
    assert max(resident_bytes) <= max(first_third) + GROWTH_BYTES


# ---- a mixed load --------------------------------------------------------------------------------


class Mixed:
    """Threads that each do one thing again and again, until they are told to stop."""

    def __init__(self, ports: Ports, folder):
        self.ports, self._folder = ports, folder
        self._dice = random.Random(4711)
        self._stop = threading.Event()
        self._known: dict[str, bytes] = {}
        self._leavers = [Leavers(ports, seed) for seed in range(2)]
        self.counts = dict.fromkeys(("compared", "updates", "handshakes", "slow"), 0)
        self.counts["handshakes_lost"] = 0
        acts = [self._compare, self._update_keys, self._shake_half_a_hand, self._read_slowly]
        acts += [leavers.step for leavers in self._leavers]
        self._threads = [threading.Thread(target=self._repeat, args=(act,)) for act in acts]
        self._failures: list[BaseException] = []

    def _repeat(self, act) -> None:
        try:
            while not self._stop.is_set():
                act()
        except BaseException as failure:  # The test's own thread raises it.
            self._failures.append(failure)
            self._stop.set()

    def _compare(self) -> None:
        """A canary: each port gives the same bytes all the time. A good handshake may fall to the
        flood of them, and is tried again."""
        for kind in ("tcp", "tls", "http"):
            try:
                with self.ports.join(kind) as asking, asking.makefile("rb") as stream:
                    asking.sendall(http_request(300) if kind == "http" else grid_request(3000))
                    body = stream.peek(1) and receive_whole(stream, kind)
            except OSError:
                body = b""
            if body == b"" and kind == "tls":
                self.counts["handshakes_lost"] += 1
            else:
                assert self._known.setdefault(kind, body) == body != b""
                self.counts["compared"] += 1

    def _update_keys(self) -> None:
        context = ssl.create_default_context(cafile=str(self._folder / "ca.pem"))
        (self._folder / "keys").unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            recorder = Recorder(self.ports.numbers["tls"], context, "1.3", self._folder)
            recorder.socket.sendall(recorder.flood("answered updates", grid_request(10)))
            recorder.socket.close()
            self.counts["updates"] += 1

    def _shake_half_a_hand(self) -> None:
        """As long as some of these are open, they take the places of others that shake hands."""
        half = []
        for _ in range(16):
            half.append(socket.create_connection(("127.0.0.1", self.ports.numbers["tls"]), 60))
            half[-1].sendall(b"\x16\x03\x01\x02\0\x01\0\x01\xfc\x03\x03"[: self._dice.randrange(11)])
        for one in half:
            one.close()
            self.counts["handshakes"] += 1

    def _read_slowly(self) -> None:
        slow = []
        for kind in ("tcp", "tls", "http", "http") * 4:
            with contextlib.suppress(OSError):
                slow.append(self.ports.join(kind, 4096))
                slow[-1].sendall((http_request(85_000) if kind == "http" else grid_request(200_000)) * 3)
        self._stop.wait(0.5)
        for one in slow:
            one.close()
            self.counts["slow"] += 1

    def run(self) -> None:
        for thread in self._threads:
            thread.start()
        self._stop.wait(MIXED_S)
        self._stop.set()
        for thread in self._threads:
            thread.join()
        for leavers in self._leavers:
            leavers.end()
        if self._failures:
            raise self._failures[0]


def test_mixed_load(tmp_path):
    ports = Ports(tmp_path)
    try:
        mixed = Mixed(ports, tmp_path)
        mixed.run()
        print(f"\nmixed: {MIXED_S:.0f} s, {mixed.counts}")
        assert all(count > 0 for name, count in mixed.counts.items() if name != "handshakes_lost")
        assert_every_port_answers(ports)
    finally:
        ports.daemon.close()
