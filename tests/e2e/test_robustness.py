"""A thousand connections, a stop under load, and no free
descriptors. In each case, every valid request gets its correct answer exactly once."""

import contextlib
import functools
import http.client
import os
import random
import resource
import select
import signal
import socket
import ssl
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import dipole
import pytest
from beside import Beside
from certificates import Authority
from daemons import HANG_S, Daemon, eventually, read_log_line, sanitized
from dipole import Connection, ConnectionLost, wire
from frames import EVAL, F32, R, eval_payload, frame, serves, statistics
from messages import (
    PARTS, SAMPLES, Known, assert_answer, every_kind, known_answers, receive_answer, refusal, short_requests,
)
from modbus_master import AT, Lost, Tcp, input_block, write_read_pdu
from test_http import BASES, post
from test_metrics import fetch


def assert_all_right(connection: Connection, known: list[Known], order: list[int], last: bool = False) -> None:
    """Sends these of the known requests at once, and if they are the last ones, ends its side. Checks
    that each gets its correct answer once."""
    connection.send_bytes(b"".join(known[which].frame(i) for i, which in enumerate(order)))
    if last:
        connection.half_close()
    open_ones = dict(enumerate(order))
    while open_ones:
        first, parts = receive_answer(connection)
        assert_answer(known[open_ones.pop(first.request_id)], first, parts)


@pytest.fixture
def descriptors():
    """Raises the limit of this process's file descriptors as far as possible."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (before[1], before[1]))
    yield before[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


# ---- many ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["unix", "tcp"])
def test_a_thousand_connections_at_once(daemon, descriptors, scheme):
    if descriptors < 1100:
        pytest.skip(f"a process may have only {descriptors} file descriptors here")
    one = daemon()
    known = known_answers(one, short_requests(40))
    with contextlib.ExitStack() as all_of_them:
        connections = [all_of_them.enter_context(one.connect(scheme)) for _ in range(1000)]
        for i, connection in enumerate(connections):
            connection.send_bytes(b"".join(known[(i + k) % 40].frame(k) for k in range(4)))
        for i, connection in enumerate(connections):
            for k in range(4):  # Short requests of one connection are answered in their order.
                first, parts = receive_answer(connection)
                assert first.request_id == k
                assert_answer(known[(i + k) % 40], first, parts)
        assert statistics(connections[0])["connections_open"] == 1000
        assert statistics(connections[0])["connections_refused"] == 0
    with one.connect() as watcher:
        assert eventually(lambda: statistics(watcher)["connections_open"] == 1)


def test_a_flood_beyond_max_connections(daemon, descriptors):
    """A thousand connections beyond the limit: each gets BUSY, and the others are served."""
    one = daemon("--max-connections", "8")
    known = known_answers(one, short_requests(40))
    watcher = one.connect()
    assert eventually(lambda: statistics(watcher)["connections_open"] == 1)
    before_bytes = one.resident_bytes()
    with contextlib.ExitStack() as stack:
        stack.enter_context(watcher)
        served = []
        for i in range(7):
            order = random.Random(i).choices(range(len(known)), k=8)
            connection = stack.enter_context(one.connect(("unix", "tcp")[i % 2]))
            act = functools.partial(assert_all_right, connection, known, order)
            served.append(stack.enter_context(Beside(act)))
        assert eventually(lambda: statistics(watcher)["connections_open"] == 8)
        told = 0
        for _ in range(10):
            flood = [one.connect(("unix", "tcp")[i % 2]) for i in range(100)]
            for extra in flood:
                with extra:
                    told += refusal(extra.receive_frame()) == "busy"
            before = [other.done for other in served]
            assert eventually(
                lambda: all(other.failure or other.done > n for other, n in zip(served, before))
            )
        assert told == 1000
        assert statistics(watcher)["connections_refused"] == 1000
        assert statistics(watcher)["connections_open"] == 8
        slack_bytes = (64 if sanitized() else 16) << 20
        assert one.resident_bytes() < before_bytes + slack_bytes
    assert eventually(lambda: serves(one))


@pytest.mark.parametrize("scheme", ["unix", "tcp"])
def test_half_close_with_everything_outstanding(daemon, scheme):
    one = daemon(*PARTS)
    known = known_answers(one, every_kind())
    with one.connect(scheme) as connection:
        assert_all_right(connection, known, list(range(len(known))) * 3, last=True)
        assert connection.receive_eof()


# ---- stopping under load -------------------------------------------------------------------------


def ask_until_told(connection: Connection, known: list[Known], answered: list[int]) -> None:
    """Keeps 64 requests under way until the daemon says that it stops. Answers, and then refusals,
    come in the order of the requests, so that one that is missing or comes twice is found."""
    sent = refused = 0
    while True:
        with contextlib.suppress(ConnectionLost):  # Frames that came before are still read.
            while sent < len(answered) + refused + 64:
                connection.send_bytes(known[sent % len(known)].frame(sent))
                sent += 1
        first, parts = receive_answer(connection)
        assert refusal(first) in ("", "shutting-down")
        if refusal(first) and first.request_id == 0 and answered:
            break
        assert first.request_id == len(answered) + refused
        if refusal(first):
            refused += 1
        else:
            assert_answer(known[first.request_id % len(known)], first, parts)
            answered.append(first.request_id)
    assert connection.receive_eof()


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_stopping_under_load(daemon, how):
    """Requests are answered in their order up to one of them, and all later ones are refused
    together: no answer is lost, and none comes twice."""
    one = daemon(*PARTS)
    known = known_answers(one, every_kind())
    with contextlib.ExitStack() as stack:
        pool = stack.enter_context(ThreadPoolExecutor(8))
        answered: list[list[int]] = [[] for _ in range(8)]
        connections = [stack.enter_context(one.connect(("unix", "tcp")[i % 2])) for i in range(8)]
        loads = [pool.submit(ask_until_told, c, known, a) for c, a in zip(connections, answered)]
        assert eventually(lambda: all(len(a) > 30 or load.done() for a, load in zip(answered, loads)))
        one.terminate(how)
        assert one.wait(30) == 0
        for load in loads:
            load.result()


# ---- out of file descriptors ---------------------------------------------------------------------


def processor_s(daemon: Daemon) -> float:
    """Returns the processor time that a daemon has used."""
    fields = Path(f"/proc/{daemon.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_out_of_file_descriptors(daemon):
    one = daemon(prefix=["prlimit", "--nofile=48:48"])
    began_s = time.monotonic()
    known = known_answers(one, short_requests(40))
    with contextlib.ExitStack() as all_of_them:
        # The system completes a connection before the daemon accepts it, so all of these succeed.
        connections = [
            all_of_them.enter_context(one.connect(("unix", "tcp")[i % 2])) for i in range(80)
        ]
        for i, connection in enumerate(connections):
            connection.send_bytes(known[i % 40].frame(i))
        assert one.has_line("event=accept-paused")
        served = wait_for_answers(connections, known)
        assert 16 <= len(served) < 48
        before_s = processor_s(one)
        start_s = time.monotonic()
        while time.monotonic() - start_s < 1.0:  # Accepted connections are served meanwhile.
            for i in served[:4]:
                assert_all_right(connections[i], known, [i % 40])
            time.sleep(0.05)
        assert processor_s(one) - before_s < (0.9 if sanitized() else 0.4)
        # When some connections close, as many waiting ones are accepted, until all have been
        # served.
        waiting = set(range(80)) - set(served)
        while waiting:
            for i in served:
                connections[i].close()
            served = wait_for_answers([connections[i] for i in sorted(waiting)], known, waiting)
            assert served
            waiting -= set(served)
    assert eventually(lambda: serves(one))
    paused = [line for line in one.log if "event=accept-paused" in line]
    assert 1 <= len(paused) <= 2 + (time.monotonic() - began_s) / 5  # once in 10 s, by 2 listeners


@pytest.mark.parametrize("scheme", ["unix", "tcp", "http", "modbus-tcp", "tls", "metrics", "http metrics"])
def test_probes_are_answered_when_no_descriptor_is_left(daemon, tmp_path, scheme):
    """Nor when clients hold all connections that the port of the probes has."""
    pem, key = Authority(tmp_path).sign("farm")
    options = ["--http", "127.0.0.1:0", "--metrics", "127.0.0.1:0", "--modbus", "tcp:127.0.0.1:0"]
    options += ["--listen", "tls:127.0.0.1:0", "--certificate", pem, "--key", key]
    one = daemon(*options, prefix=["prlimit", "--nofile=96:96"])
    urls = {one["event"]: one["url"] for one in map(read_log_line, one.log) if "url" in one}
    places = []
    for name in scheme.split():
        url = urls["metrics"].removesuffix("/metrics") if name == "metrics" else one.url(name)
        host, _, port = url.partition(":")[2].removeprefix("//").rpartition(":")
        places.append((host, int(port)) if host else port)
    with contextlib.ExitStack() as clients:
        for i in range(120):
            place = places[i % len(places)]
            family = socket.AF_UNIX if isinstance(place, str) else socket.AF_INET
            clients.enter_context(socket.socket(family)).connect(place)
        opened = Path(f"/proc/{one.process.pid}/fd")
        least = 30 if scheme == "metrics" else 85
        assert eventually(lambda: len(list(opened.iterdir())) >= least)
        for path in ("/healthz", "/readyz", "/metrics") * 3:
            assert fetch(one, path)[0] == 200
    assert eventually(lambda: serves(one))


def wait_for_answers(
    connections: list[Connection], known: list[Known], names: set[int] | None = None
) -> list[int]:
    """Receives answers until none has come for half a second. Returns their request ids."""
    by_socket = dict(zip((one.socket for one in connections), connections))
    expected = names if names is not None else set(range(len(connections)))
    answered: list[int] = []
    while by_socket:
        ready = select.select(list(by_socket), [], [], 5.0 if not answered else 0.5)[0]
        if not ready:
            break
        for one in ready:
            first, parts = receive_answer(by_socket.pop(one))
            assert first.request_id in expected
            assert_answer(known[first.request_id % 40], first, parts)
            answered.append(first.request_id)
    return answered


@pytest.mark.skipif(sanitized(), reason="a sanitizer reserves terabytes of addresses")
@pytest.mark.parametrize("kind", ["lut", "mc"])
def test_no_memory_for_the_first_thread_that_prepares(daemon, kind):
    """The daemon has no room for the stack of another thread when it is first asked for what other
    threads do: it answers or refuses, and goes on."""
    one = daemon()
    with one.client() as client:
        client.eval("better", "skin1", [1.0], evaluator="f64")
        status = Path(f"/proc/{one.process.pid}/status").read_text()
        pages_kB = int(next(x for x in status.splitlines() if x.startswith("VmSize:")).split()[1])
        limit = (pages_kB + 4096) * 1024
        resource.prlimit(one.process.pid, resource.RLIMIT_AS, (limit, limit))
        with contextlib.suppress(dipole.Refused):
            if kind == "lut":
                client.eval("better", "skin1", [1.0], evaluator="lut")
            else:
                client.mc(dipole.Medium(0.1, 1.0), dipole.Grid(0, 1, 2), photons=4096)
    with one.client() as client:
        assert client.ping() > 0


ANY = "127.0.0.1:0"


def ask_message(daemon: Daemon, message: str) -> object:
    with daemon.connect() as connection:
        for name in ("points", message) if message == "gather" else (message,):
            connection.send_bytes(frame(wire.MESSAGES[name], 1, SAMPLES[name]))
            first, parts = receive_answer(connection)
            if refusal(first):
                return refusal(first)
    return parts


def ask_http(daemon: Daemon, message: str) -> object:
    for name in ("points", message) if message == "gather" else (message,):
        answer = post(daemon, f"/v1/{name}", **BASES[name])
        if answer.status in (429, 503):
            return "busy"
        assert answer.status == 200, answer.text
    return answer.text


def ask_modbus(daemon: Daemon, unit: int) -> object:
    with Tcp(daemon) as master:
        answer = master.exchange(unit, write_read_pdu(AT["COMMIT"], input_block(1, radii=[1.0]), AT["R"], 2))
    return "busy" if answer[0] & 0x80 else answer


def ask_scpi(daemon: Daemon, query: str) -> object:
    host, port = daemon.url("scpi").removeprefix("scpi:").rsplit(":", 1)
    with socket.create_connection((host, int(port)), HANG_S) as stream, stream.makefile("r") as lines:
        stream.sendall(f"{query}\nSYST:ERR?\n".encode())
        first = lines.readline()  # the error, if the query has no answer
    if not first:
        raise Lost
    return "busy" if first.startswith(("-300,", "-321,")) else first


# What each way into the daemon is asked for. fit_layers makes thousands of allocations, which take
# seconds; statistics change.
ASKED: dict[str, tuple[Callable[[Daemon, Any], object], list[Any]]] = {
    "binary": (ask_message, [name for name in SAMPLES if name != "statistics"]),
    "http": (ask_http, list(BASES)),
    "modbus": (ask_modbus, [1, 2]),
    "scpi": (ask_scpi, ["MED 0.05,9.5,0.9,1.4;:MOD BETTER;:R? 0.5,1"]),
}


@pytest.mark.skipif(sanitized(), reason="the counting daemon is not")
@pytest.mark.parametrize("way", ASKED)
def test_each_allocation_may_fail(daemon, way):
    """Whichever allocation a request makes fails: the client gets the usual answer or BUSY, but if it is
    of the connection, then the usual answer again, and Daemon.close() finds that nothing is lost."""
    one = daemon("--cache-bytes", "0", "--http", ANY, "--modbus", f"tcp:{ANY}", "--scpi", ANY, counting=True)
    descriptors = lambda: len(os.listdir(f"/proc/{one.process.pid}/fd"))
    ask, requests = ASKED[way]
    known = [ask(one, request) for request in requests]
    before = descriptors()
    for request, usual in zip(requests, known):
        number, step = (100, 2000) if request == "fit_layers" else (1, 1)
        waits, unconnected = False, 0
        while not waits:
            one.fail_allocation(number)
            try:
                assert ask(one, request) in (usual, "busy"), (request, number)
            except (ConnectionLost, OSError, Lost, http.client.HTTPException):
                unconnected += 1
            waits = one.fail_allocation(0)
            number += step
        assert ask(one, request) == usual and unconnected <= 1 + (way == "binary" or request == "gather")
    assert eventually(lambda: descriptors() <= before)  # when the last client may not have left yet


# ---- wake-ups ------------------------------------------------------------------------------------

ANSWERS = 20000
GRID = "model=better&wanted=R&evaluator=f32&medium=skin1&spacing=linear&radius_start=.1&radius_stop=9"
REQUESTS = {
    "http": f"GET /v1/eval?{GRID}&radius_count=2000 HTTP/1.1\r\nHost: localhost\r\n\r\n".encode(),
    **dict.fromkeys(
        ["tcp", "tls"], frame(EVAL, 1, eval_payload(radii=None, radius_count=16384, evaluator=F32, wanted=R))
    ),
}


def receive_whole(stream, kind: str) -> None:
    """Reads one answer, which is not refused."""
    if kind == "http":
        assert b" 200 " in stream.readline()
        headers = dict(line.split(b": ") for line in iter(stream.readline, b"\r\n"))
        left = int(headers[b"Content-Length"])
    else:
        header = wire.HEADER.unpack(stream.read(wire.HEADER.bytes))
        assert header.type == EVAL | wire.REPLY
        left = header.payload_bytes
    assert len(stream.read(left)) == left


@pytest.mark.parametrize("kind", REQUESTS)
def test_no_large_answer_waits_for_the_clock(daemon, tmp_path, kind):
    """A connection is alone on its worker, and its socket is emptied while the daemon fills it.
    The daemon counts clients that wait while it sleeps, and Daemon.close() checks that count. With so
    short a timeout the worker's clock ticks every few milliseconds."""
    certificate, key = Authority(tmp_path).sign("server")
    options = ["--http", "127.0.0.1:0", "--certificate", certificate, "--key", key]
    one = daemon(*options, "--drain-timeout-ms", "30", "--workers", "1", listen=["tcp:127.0.0.1:0", "tls:127.0.0.1:0"])
    port = next(int(url.rpartition(":")[2]) for url in one.urls if url.startswith(kind + ":"))
    with socket.create_connection(("127.0.0.1", port), 60) as asking:
        asking.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
        if kind == "tls":
            context = ssl.create_default_context(cafile=str(tmp_path / "ca.pem"))
            asking = context.wrap_socket(asking, server_hostname="localhost")
        with asking.makefile("rb") as stream:
            asking.sendall(REQUESTS[kind] * 8)
            for i in range(ANSWERS):
                receive_whole(stream, kind)
                if i < ANSWERS - 8:
                    asking.sendall(REQUESTS[kind])
        asking.close()
