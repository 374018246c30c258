"""The same request gives the same bytes: on every instruction set, with any number of workers, and
whatever other requests the daemon has."""

from __future__ import annotations

import functools
import random
import threading
from pathlib import Path

import pytest
from daemons import Daemon, run
from dipole import Connection, wire
from frames import EVAL, ask, frame
from mixes import broad_mix

LEVELS = {
    "portable": set(),
    "sse2": {"sse2"},
    "avx2": {"avx2", "fma"},
    "avx512": {"avx2", "fma", "avx512f", "avx512dq", "avx512vl"},
}


def machine_flags() -> set[str]:
    """Returns the features that the processor states."""
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("flags"):
            return set(line.split(":")[1].split())
    return set()


HAS = [name for name, flags in LEVELS.items() if flags <= machine_flags()]
LACKS = [name for name in LEVELS if name not in HAS]


@functools.cache
def mix() -> list[bytes]:
    return broad_mix(seed=1, sizes={1000: 20, 5003: 5, 70_001: 4})


def answers(daemon: Daemon, payloads: list[bytes]) -> list[bytes]:
    """Returns the reply to each request, sent one after another."""
    with daemon.connect() as connection:
        replies = [ask(connection, EVAL, payload) for payload in payloads]
    assert all(reply.type == EVAL | wire.REPLY for reply in replies)
    return [reply.payload for reply in replies]


@pytest.fixture(scope="module")
def expected(shared) -> list[bytes]:
    """Returns the answers of the shared daemon."""
    return answers(shared, mix())


@pytest.mark.parametrize("isa", HAS)
def test_instruction_set(daemon, expected, isa):
    one = daemon("--isa", isa)
    with one.client() as client:
        assert client.info.instruction_set == isa
    for i, answer in enumerate(answers(one, mix())):
        assert answer == expected[i], f"request {i} of the mix: {mix()[i][:40].hex()}"


def test_best_instruction_set_is_the_default(shared):
    with shared.client() as client:
        assert client.info.instruction_set == HAS[-1]


@pytest.mark.parametrize("isa", [*LACKS, "mmx", "AVX2", ""])
def test_instruction_set_that_is_not_there(isa):
    ended = run("--isa", isa, "--listen", "tcp:127.0.0.1:0")
    assert ended.returncode in (1, 2)
    assert "isa" in ended.stderr


@pytest.mark.parametrize("workers", [1, 5])
def test_number_of_workers(daemon, expected, workers):
    one = daemon("--workers", str(workers))
    with one.client() as client:
        assert client.info.workers == workers
    assert answers(one, mix()) == expected


def ask_all(connection: Connection, payloads: list[bytes], order: list[int], window: int) -> str:
    """Sends requests in this order, several at a time. Returns what is wrong with the answers, or
    ""."""
    waiting: set[int] = set()
    rest = list(order)
    while rest or waiting:
        while rest and len(waiting) < window:
            connection.send_bytes(frame(EVAL, rest[0], payloads[rest[0]]))
            waiting.add(rest.pop(0))
        reply = connection.receive_frame()
        if reply.request_id not in waiting:
            return f"an answer to {reply.request_id}, which was not asked"
        waiting.remove(reply.request_id)
        if reply.payload != ALONE[reply.request_id]:
            return f"another answer to request {reply.request_id} than alone"
    return ""


ALONE: list[bytes] = []


def test_thirty_two_clients_at_once(shared):
    crowd_mix = broad_mix(seed=2, sizes={3000: 10, 20_000: 6, 200_000: 3})
    ALONE[:] = answers(shared, crowd_mix)
    assert max(map(len, ALONE)) >= 200_000 * 4
    outcomes: dict[int, str] = {}
    start = threading.Barrier(32)

    def client(number: int) -> None:
        rng = random.Random(number)
        large = len(crowd_mix) - 1 - number % 9
        order = [*rng.sample(range(len(crowd_mix) - 9), 60), large]
        rng.shuffle(order)
        try:
            with shared.connect("unix" if number % 2 else "tcp") as connection:
                start.wait(30)
                outcomes[number] = ask_all(connection, crowd_mix, order, 1 + number % 8)
        except Exception as error:  # An exception in a thread would be lost.
            outcomes[number] = repr(error)

    threads = [threading.Thread(target=client, args=(number,)) for number in range(32)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert outcomes == {number: "" for number in range(32)}
