"""Full load for SOAK_S seconds: requests of every kind, and beside them clients of every port that
are killed, leave at any time, do not read, or send garbage, floods of KeyUpdates and half-open
handshakes. Every answer is correct, canaries get the same bits all the time, memory does not grow,
and every port answers at the end."""

import contextlib
import http.client
import os
import random
import socket
import ssl
import struct
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import dipole
from beside import Beside, Bench
from certificates import Authority, Recorder
from command_line import PROGRAM
from daemons import Daemon, environment, eventually, sanitized
from dipole import DipoleError
from frames import EVAL, F32, SKIN, R, eval_payload, frame, statistics
from messages import CALLS, assert_same, call
from modbus_master import AT, Lost, Tcp, input_block
from test_http import address

PATIENCE_S = 300.0
SOAK_S = float(os.environ.get("SOAK_S") or 40)
CACHE_BYTES = 1 << 20  # This is less than all profiles take.
TOTAL_BYTES = 256 << 20
OPTIONS = (
    *("--max-frame-bytes", str(1 << 20), "--max-part-bytes", str(1 << 16)),
    *("--cache-bytes", str(CACHE_BYTES), "--max-total-bytes", str(TOTAL_BYTES)),
)
# The daemon's memory may grow by GROWTH_BYTES beyond its maximum in the first third of the time, or
# beyond what it takes when it has met everything (84 MiB in runs of two minutes), which is later on a
# loaded machine: for gaps in a heap with blocks of all sizes, and for records of a sanitizer.
MET_BYTES = 84 << 20
GROWTH_BYTES = (128 if sanitized() else 24) << 20
ENDLESS = eval_payload(radii=None, radius_count=64_000_000, evaluator=F32, wanted=R)


# By scheme: what `dipole bench` evaluates.
LOADS = {
    "unix": ["--connections", "2", "--large-radii", "250000"],
    "tcp": ["--model", "classical", "--evaluator", "f64"],
    "tls": ["--model", "transport", "--evaluator", "lut", "--in-flight", "24"],
}
# Calls of the Python client that take no seconds.
QUICK = [name for name in CALLS if name not in ("surface", "fit_layers")]


# ---- clients beside the load ---------------------------------------------------------------------


class Player(Beside):
    """Plays rounds of something beside the load. A round gets this object."""

    def __init__(self, daemon: Daemon, ca: str, play: Callable[["Player"], None]):
        super().__init__(lambda: play(self))
        self.refused = 0  # rounds of a canary that the daemon was too busy for
        self.daemon, self.ca, self.play = daemon, ca, play
        self.rng = random.Random(play.__name__)
        self.known: dict[str, object] = {}

    def port(self, scheme: str) -> tuple[str, int]:
        if scheme == "http":
            return address(self.daemon)
        host, _, port = self.daemon.url(scheme).removeprefix(scheme + ":").rpartition(":")
        return host, int(port)

    def client(self, scheme: str) -> dipole.Client:
        ca = {"ca": self.ca} if scheme == "tls" else {}
        return dipole.Client(self.daemon.url(scheme), timeout_s=PATIENCE_S, retry_s=60, **ca)

    def same(self, port: str, answer: bytes) -> None:
        """Checks that a port gives the same bits as at first."""
        assert answer == self.known.setdefault(port, answer), f"{port}: other bits than at first"


def call_any(beside: Player) -> None:
    """Makes a call of the Python client, and begins a long answer that it ends after a part."""
    name = beside.rng.choice(QUICK)
    with beside.client(beside.rng.choice(list(LOADS))) as client:
        found = call(client, name)
        with client.eval_parts("better", SKIN, grid=dipole.Grid(0.1, 10.0, 2_000_000)) as parts:
            next(parts)
    assert_same(found, beside.known.setdefault(name, found))


def babble(beside: Player) -> None:
    """Opens two clients that do not read for a second. Meanwhile, others die or send garbage."""
    with beside.daemon.connect("unix") as one, beside.daemon.connect("tcp") as other:
        for stuck in (one, other):
            stuck.send_bytes(frame(EVAL, 1, ENDLESS) * 8)
        with subprocess.Popen([PROGRAM, "bench", "--seconds=60", "--connect", beside.daemon.url()], env=environment()) as victim:
            while not beside.ended.wait(0.05) and beside.rng.random() < 0.95:
                die_or_babble(beside)
            victim.kill()


def die_or_babble(beside: Player) -> None:
    rng, request = beside.rng, frame(EVAL, 1, eval_payload(radii=None, radius_count=50_000))
    with beside.daemon.connect(rng.choice(["unix", "tcp"])) as rude:
        with contextlib.suppress(DipoleError):
            if rng.random() < 0.3:
                rude.send_bytes(rng.randbytes(rng.randrange(1, 5000)))
                rude.receive_frame()
            else:
                rude.send_bytes(request[: rng.randrange(1, len(request) + 1)])
                if rng.random() < 0.5:
                    rude.half_close()
                    rude.receive_bytes(rng.randrange(1, 1000))


# What a client of a port sends for much work, in one piece.
LARGE_GET = (
    "GET /v1/eval?model=better&evaluator=f32&medium=skin1&spacing=linear&radius_count={}"
    "&radius_start=0&radius_stop=10&wanted=R HTTP/1.1\r\nHost: localhost\r\n\r\n"
)


def opened(beside: Player, scheme: str) -> socket.socket:
    """Connects to a port; through TLS after a handshake."""
    plain = socket.create_connection(beside.port(scheme), 20)
    if scheme != "tls":
        return plain
    try:
        context = ssl.create_default_context(cafile=beside.ca)
        return context.wrap_socket(plain, server_hostname="localhost")
    except OSError:
        plain.close()
        raise


def large(beside: Player, scheme: str) -> bytes:
    count = beside.rng.randrange(1, 100_000)
    if scheme == "http":
        return LARGE_GET.format(min(count, 5000)).encode()
    if scheme == "modbus-tcp":
        medium = 0.001 * (count % 100 + 1), 1.0, 0.0, 1.3
        block = input_block(count % 65535 + 1, medium, radii=[1.0] * 40, model=29)
        pdu = struct.pack(">BHHB", 16, AT["COMMIT"], len(block) // 2, len(block)) + block
        return struct.pack(">HHHB", 1, 0, 1 + len(pdu), 2 + count % 3) + pdu
    media = [(beside.rng.uniform(0.01, 0.05), 0.74, 0.0, 1.3)]  # whose profile has to be prepared
    payload = eval_payload(media, radii=None, radius_count=count, model=beside.rng.choice([2, 5]))
    return frame(EVAL, 1, payload, deadline_ms=count % 20)


def leave(beside: Player) -> None:
    """Clients of one port ask for much, and leave at any time, with a reset or without."""
    rng, scheme = beside.rng, beside.rng.choice(["tcp", "tls", "http", "modbus-tcp"])
    with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
        clients = [stack.enter_context(opened(beside, scheme)) for _ in range(6)]
        for client in clients:
            client.sendall(large(beside, scheme) * rng.randrange(1, 4))
        for client in clients:
            beside.ended.wait(rng.random() * 0.02)
            if rng.random() < 0.5:
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            client.close()


def read_slowly(beside: Player) -> None:
    """Clients that read a few bytes of a large answer at a time, and then nothing more."""
    with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
        clients = []
        for scheme in ("http", "http", "tls", "tcp"):
            clients.append(stack.enter_context(opened(beside, scheme)))
            clients[-1].sendall(large(beside, scheme) * 8)
        for _ in range(40):
            if beside.ended.wait(0.05):
                return
            for client in clients:
                client.recv(512)


def hang_halfway(beside: Player) -> None:
    """A flood of handshakes that stop after nothing, or after a part of a ClientHello."""
    hello = bytes.fromhex("16030100f8010000f40303") + beside.rng.randbytes(240)
    with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
        for _ in range(100):
            one = stack.enter_context(socket.create_connection(beside.port("tls"), 20))
            one.sendall(hello[: beside.rng.randrange(len(hello))])
        beside.ended.wait(beside.rng.random())


def update_keys(beside: Player) -> None:
    """A flood of KeyUpdates on one connection, some of which ask for one in return."""
    context = ssl.create_default_context(cafile=beside.ca)
    with contextlib.suppress(OSError), tempfile.TemporaryDirectory() as folder:
        one = Recorder(beside.port("tls")[1], context, "1.3", Path(folder))
        with one.socket:
            one.socket.settimeout(5)  # for a daemon that does not read
            for i in range(beside.rng.randrange(1, 30_000)):
                if beside.ended.is_set():
                    break
                one.socket.sendall(one.update_of_keys(i % 1000 == 999))


def ask_every_port(beside: Player) -> None:
    """Asks each port once, on a new connection, and compares the bits."""
    for scheme in ("unix", "tcp", "tls"):
        with beside.client(scheme) as client:
            beside.same(scheme, client.eval("better", SKIN, [0.5, 1, 2], evaluator="f64").R.tobytes())
    connection = http.client.HTTPConnection(*beside.port("http"), timeout=PATIENCE_S)
    with contextlib.closing(connection):
        connection.request("GET", "/v1/eval?model=better&medium=skin1&r=0.5,1,2&wanted=R")
        answer = connection.getresponse()
        text = answer.read()
        if answer.status in (429, 503):
            raise ConnectionError
        assert answer.status == 200, text
        beside.same("http", text)
    with Tcp(beside.daemon, PATIENCE_S) as master:
        token = master.job().done % 65535 + 1
        master.write(AT["COMMIT"], input_block(token, radii=[0.5, 1, 2]))
        master.wait()
        beside.same("modbus-tcp", master.read(AT["R"], 6))


def watch_canaries(beside: Player) -> None:
    """An overloaded daemon may refuse, but no answer may have other bits."""
    try:
        ask_every_port(beside)
    except (OSError, DipoleError, Lost, http.client.HTTPException):
        beside.refused += 1


PLAYS = (call_any, call_any, babble, leave, leave, read_slowly, hang_halfway, update_keys, watch_canaries)


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


def test_soak(tmp_path):
    # This setting keeps the address sanitizer from holding on to freed memory.
    asan = os.environ.get("ASAN_OPTIONS", "") + ":quarantine_size_mb=8"
    authority = Authority(tmp_path)
    certificate, key = authority.sign("server")
    ports = ["--certificate", certificate, "--key", key, "--http", "127.0.0.1:0"]
    ports += ["--modbus", "tcp:127.0.0.1:0"]
    folder = str(tmp_path / "s")
    listen = [f"unix:{folder}", "tcp:127.0.0.1:0", "tls:127.0.0.1:0"]
    daemon = Daemon(*OPTIONS, *ports, listen=listen, env={"ASAN_OPTIONS": asan})
    try:
        with contextlib.ExitStack() as stack:
            ca = str(authority.pem)
            loads = [
                stack.enter_context(Bench(daemon.url(scheme), *options, DIPOLED_CA=ca))
                for scheme, options in LOADS.items()
            ]
            beside = [stack.enter_context(Player(daemon, ca, play)) for play in PLAYS]
            resident_bytes = watch(daemon)
        canary = beside[-1]
        ask_every_port(canary)
        with daemon.connect() as watcher:
            assert eventually(lambda: statistics(watcher)["connections_open"] == 1)
            assert eventually(lambda: statistics(watcher)["buffer_bytes"] < 1 << 20)
            now = statistics(watcher)
    finally:
        daemon.close()
    tenths = [resident_bytes[len(resident_bytes) * i // 10 :] for i in range(10)]
    curve = " ".join(f"{tenth[0] / 2**20:.0f}" for tenth in tenths)
    print(f"\nsoak: {SOAK_S:.0f} s, {[int(load.answered) for load in loads]} answers, "
          + ", ".join(f"{one.play.__name__} {one.done}" for one in beside)
          + f", {canary.refused} of the last refused")
    print(f"soak: resident MiB: {curve} {resident_bytes[-1] / 2**20:.0f}")
    print(f"soak: cache_bytes {now['cache_bytes']}, evictions {now['cache_evictions']}")
    assert all(one.done > 0 for one in (*loads, *beside)) and canary.done > canary.refused
    first_third = resident_bytes[: max(len(resident_bytes) // 3, 1)]
    assert max(resident_bytes) <= max(*first_third, MET_BYTES) + GROWTH_BYTES
