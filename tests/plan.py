"""How many daemons, and how much network, a farm of N render nodes needs: `make plan`.

    plan.py [--mix small=.7,tile=.25,...] [--rate 10] [--cores 16] [--wait-ms 5] [--write FILE]
    plan.py --check

It starts daemons of this build and measures what a request of each kind costs: processor time of
the daemon, and bytes. From that it simulates queues. A connection belongs to one worker, so each
worker has a queue of its own (M/G/1: requests come at random, and services are those of the mix).
Profiles are prepared, and photons walk, on other threads: they take cores and wait in no worker's
queue. Workers take turns with large requests, so that small ones wait for less than the simulation
says.

--check measures the capacity of three daemons that share one core, under the whole mix, and compares
it with the simulated one. A measurement counts answers per second of processor time that the daemons
got, so that other programs on the machine do not change it."""

import argparse
import math
import os
import re
import socket
import struct
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

sys.path[:0] = [str(Path(__file__).resolve().parent / "e2e")]

import dipole
import numpy as np
from daemons import Daemon
from dipole import wire
from dipole.connection import frame_pieces

SKIN = dipole.Medium(0.032, 0.74, 0.0, 1.3)
SKIN3 = [SKIN, dipole.Medium(0.17, 0.88), dipole.Medium(0.48, 1.01)]
MIX = {"small": 0.7, "tile": 0.25, "bulk": 0.02, "texture": 0.02, "new": 0.01, "fit": 0.0, "mc": 0.0}
BUSY_MOST = 0.7  # share of the cores' time that a plan uses
HEADERS_BYTES = 66  # of Ethernet, IP and TCP, for each segment
SEGMENT_BYTES = 1448
NODES = [10**3, 10**4, 10**5, 10**6]
TOLERANCE = 0.2
TRIES = 3


# ---- requests ------------------------------------------------------------------------------------


def lut(client: dipole.Client, media, count: int) -> None:
    r = np.geomspace(0.01, 10.0, count).astype("f4")
    client.eval("transport", media, r, evaluator="lut", parameters={"tolerance": 0.01})


def texture(client: dipole.Client) -> None:
    spread = np.linspace(0.5, 2.0, 65536).astype("f4")
    r = np.full(65536, 0.7, "f4")
    client.varying("better", sigma_a=0.03 * spread, sigma_s=spread, g=0.0, eta=1.3, r=r)


def fit(client: dipole.Client) -> None:
    client.fit("transport", [0.5, 1.0, 2.0, 4.0], [0.1, 0.05, 0.01, 0.001], [0.001] * 4, eta=1.4)


# What each kind asks, given a client and a number that differs from request to request. `new` is a
# small one whose medium no request has had.
KINDS = {
    "small": lambda client, _: lut(client, SKIN3, 16),
    "tile": lambda client, _: lut(client, SKIN3, 4096),
    "bulk": lambda client, _: lut(client, SKIN3, 65536),
    "texture": lambda client, _: texture(client),
    "new": lambda client, number: lut(client, dipole.Medium(0.03 + 1e-5 * number, 0.9), 16),
    "fit": lambda client, _: fit(client),
    "mc": lambda client, _: client.mc(SKIN, dipole.Grid(0.0, 4.0, 21), photons=100_000),
}
IN_BACKGROUND = ("new", "mc")
BATCH = {"small": 64, "tile": 32, "bulk": 2, "texture": 2, "new": 4, "fit": 32, "mc": 1}


class Maker:
    """Makes the frames of requests by a client that sends them once."""

    def __init__(self, address: str):
        self._client = dipole.Client(address)
        self._kept: dict[str, bytes] = {}
        self._number = 0

    def close(self) -> None:
        self._client.close()

    def _make(self, kind: str) -> bytes:
        made: list[bytes] = []
        begin = self._client._session.exchange.begin

        def kept(request) -> int:
            type = wire.MESSAGES[request.message]
            made.append(b"".join(frame_pieces(type, 7, request.payload, 0)))
            return begin(request)

        self._client._session.exchange.begin = kept
        KINDS[kind](self._client, self._number)
        self._client._session.exchange.begin = begin
        assert len(made) == 1
        return made[0]

    def frame(self, kind: str) -> bytes:
        """Returns a frame. A new medium is put into a copy of the first frame."""
        self._number += 1
        if kind not in self._kept:
            self._kept[kind] = self._make(kind)
        if kind != "new":
            return self._kept[kind]
        at = self._kept[kind].rindex(struct.pack("<d", 0.9)) - 8
        sigma_a = struct.pack("<d", 0.03 + 1e-7 * self._number)
        return self._kept[kind][:at] + sigma_a + self._kept[kind][at + 8 :]


class Line:
    """A connection that sends frames and counts the answers, whose values it does not look at."""

    def __init__(self, address: str):
        host, port = address.removeprefix("tcp:").rsplit(":", 1)
        self._socket = socket.create_connection((host, int(port)), 60)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._got = bytearray()

    def close(self) -> None:
        self._socket.close()

    def send(self, frames: bytes) -> None:
        self._socket.sendall(frames)

    def take(self, count: int) -> None:
        """Waits for so many answers."""
        at = 0
        while count > 0:
            if len(self._got) - at >= wire.HEADER.bytes:
                header = wire.HEADER.unpack(bytes(self._got[at : at + wire.HEADER.bytes]))
                assert header.type != wire.TYPE_ERROR, "the daemon refuses a request"
                end = at + wire.HEADER.bytes + header.payload_bytes
                if len(self._got) >= end:
                    is_report = header.type == wire.MESSAGES["mc"] | wire.REPLY and (
                        wire.MC_REPLY.unpack(bytes(self._got[at + wire.HEADER.bytes : end])).state
                        == wire.MC_UNDER_WAY
                    )
                    count -= not is_report
                    at = end
                    continue
            del self._got[:at]
            at = 0
            some = self._socket.recv(1 << 20)
            assert some, "the daemon closed the connection"
            self._got += some
        del self._got[:at]


# ---- measuring -----------------------------------------------------------------------------------


class Cost(NamedTuple):
    """What a request costs a daemon."""

    core_s: float
    received_bytes: float
    sent_bytes: float


def core_s(daemons: list[Daemon]) -> float:
    """Returns the processor time that daemons have taken so far."""
    return sum(time.clock_gettime((~one.process.pid << 3) | 2) for one in daemons)


def bytes_moved(daemons: list[Daemon]) -> np.ndarray:
    counts = np.zeros(2)
    for one in daemons:
        with one.client("tcp") as client:
            statistics = client.statistics()
            counts += statistics["received_bytes"], statistics["sent_bytes"]
    return counts


def load(daemons: list[Daemon], maker: Maker, kinds: list[str], seconds: float) -> Cost:
    """Asks daemons one batch after the other over four connections each. kinds: in their order,
    again and again. Returns the mean cost of a request."""
    lines = [Line(one.url("tcp")) for one in daemons for _ in range(4)]
    position = answered = 0
    start_bytes = start_s = 0.0
    end_s = time.monotonic() + seconds
    with ThreadPoolExecutor(len(lines)) as senders:
        warm = False
        while time.monotonic() < end_s or not answered:
            batches = []
            for line in lines:
                frames, room = [], 1.0
                while room > 0:
                    kind = kinds[position % len(kinds)]
                    position += 1
                    frames.append(maker.frame(kind))
                    room -= 1 / BATCH[kind]
                batches.append(len(frames))
                senders.submit(line.send, b"".join(frames))
            for line, count in zip(lines, batches):
                line.take(count)
            if not warm:  # The first round prepares what the others need.
                warm, start_bytes, start_s = True, bytes_moved(daemons), core_s(daemons)
            else:
                answered += sum(batches)
    taken_s = core_s(daemons) - start_s
    moved = bytes_moved(daemons) - start_bytes
    for line in lines:
        line.close()
    return Cost(taken_s / answered, *(moved / answered))


def begin(workers: int = 1) -> Daemon:
    options = ("--workers", str(workers), "--mc-threads", "1")
    return Daemon(*options, listen=["tcp:127.0.0.1:0"])


def measure(mix: dict[str, float], seconds: float) -> dict[str, Cost]:
    """Returns the cost of each kind in the mix."""
    costs = {}
    for kind in (kind for kind, share in mix.items() if share > 0):
        one = begin()
        maker = Maker(one.url("tcp"))
        try:
            costs[kind] = load([one], maker, [kind], seconds)
        finally:
            maker.close()
            one.close()
    return costs


# ---- simulating ----------------------------------------------------------------------------------


def waits_of(gaps_s: np.ndarray, services_s: np.ndarray) -> np.ndarray:
    """Returns how long each request waits for one server, first come, first served (Lindley 1952:
    W' = max(0, W + service - gap)). gaps_s: the time from the request before to each."""
    sums = np.concatenate([[0.0], np.cumsum(services_s[:-1] - gaps_s[1:])])
    return sums - np.minimum.accumulate(sums)


def draw(mix: dict[str, float], costs: dict[str, Cost], count: int, seed: int) -> np.ndarray:
    """Returns the times for which requests of the mix keep a worker. What is in the background takes
    a small request's time there."""
    kinds = list(costs)
    shares = np.array([mix[kind] for kind in kinds])
    times = [costs["small" if kind in IN_BACKGROUND else kind].core_s for kind in kinds]
    return np.random.default_rng(seed).choice(times, count, p=shares / shares.sum())


def simulated_capacity(mix: dict[str, float], costs: dict[str, Cost]) -> float:
    """Returns how many requests a second three daemons answer on one core, as many at a time as
    clients have under way: each daemon has a queue of its own, which never becomes empty."""
    rng = np.random.default_rng(5)
    kinds, shares = list(costs), np.array([mix[kind] for kind in costs])
    times = np.array([costs[kind].core_s for kind in kinds])
    served = rng.choice(times, (3, 100_000), p=shares / shares.sum())
    return served.shape[1] * 3 / served.sum()


class Plan(NamedTuple):
    """A farm of some nodes."""

    nodes: int
    requests_per_s: float
    cores: int
    busy: float
    daemons: int
    wait_s: float
    in_bits_per_s: float
    out_bits_per_s: float


def on_the_wire(payload_bytes: float) -> float:
    """Returns the bits on the wire, with the headers of its segments and an acknowledgement."""
    segments = max(1.0, payload_bytes / SEGMENT_BYTES)
    return 8 * (payload_bytes + segments * HEADERS_BYTES + HEADERS_BYTES)


def rate_of_a_worker(services_s: np.ndarray, wait_s: float) -> tuple[float, float]:
    """Returns the largest rate of requests at which 99 of 100 wait for less, and that wait."""
    gaps = np.random.default_rng(7).exponential(1.0, len(services_s))
    least, most, wait = 0.0, BUSY_MOST / services_s.mean(), 0.0
    for _ in range(30):
        rate = most if least == 0.0 and wait == 0.0 else (least + most) / 2
        wait = float(np.quantile(waits_of(gaps / rate, services_s), 0.99))
        if wait <= wait_s:
            least = rate
            if rate == most:
                break
        else:
            most = rate
    return least, float(np.quantile(waits_of(gaps / least, services_s), 0.99))


def plan(
    mix: dict[str, float], costs: dict[str, Cost], nodes: int, rate: float, cores: int, wait_s: float
) -> Plan:
    total = sum(mix.values())
    mean = {
        field: sum(mix[kind] * getattr(costs[kind], field) for kind in costs) / total
        for field in Cost._fields
    }
    services_s = draw(mix, costs, 200_000, 3)
    of_worker, wait = rate_of_a_worker(services_s, wait_s)
    asked = nodes * rate
    background_s = mean["core_s"] - services_s.mean()
    needed = asked / of_worker + max(0.0, asked * background_s / BUSY_MOST)
    count = max(1, math.ceil(needed))
    daemons = math.ceil(count / cores)
    return Plan(
        nodes, asked, count, asked * mean["core_s"] / count, daemons, wait,
        asked * on_the_wire(mean["received_bytes"]), asked * on_the_wire(mean["sent_bytes"]),
    )  # fmt: skip


# ---- saying --------------------------------------------------------------------------------------


def costs_table(mix: dict[str, float], costs: dict[str, Cost]) -> str:
    lines = [
        "| kind | share | core time | bytes to the daemon | bytes from it |",
        "|---|---|---|---|---|",
    ]
    for kind, cost in costs.items():
        lines.append(
            f"| {kind} | {mix[kind] / sum(mix.values()):.3g} | {cost.core_s * 1e6:.3g} us | "
            f"{cost.received_bytes:.0f} | {cost.sent_bytes:.0f} |"
        )
    return "\n".join(lines)


def plans_table(plans: list[Plan], cores: int) -> str:
    lines = [
        f"| nodes | requests/s | cores | daemons of {cores} cores | 99 % wait less than | "
        "network to, from the daemons |",
        "|---|---|---|---|---|---|",
    ]
    for one in plans:
        lines.append(
            f"| {one.nodes:,} | {one.requests_per_s:,.0f} | {one.cores:,} | {one.daemons:,} | "
            f"{one.wait_s * 1e3:.2f} ms | "
            f"{one.in_bits_per_s / 1e9:.3g}, {one.out_bits_per_s / 1e9:.3g} Gbit/s |"
        )
    return "\n".join(lines)


def check(mix: dict[str, float], seconds: float) -> bool:
    """Compares measured and simulated capacity. Returns whether they agree."""
    costs = measure(mix, seconds)
    expected = simulated_capacity(mix, costs)
    smallest = min(share for share in mix.values() if share > 0)
    kinds = [kind for kind, share in mix.items() for _ in range(round(share / smallest))]
    np.random.default_rng(9).shuffle(kinds)
    daemons = [begin() for _ in range(3)]
    maker = Maker(daemons[0].url("tcp"))
    try:
        for one in daemons:
            for task in os.listdir(f"/proc/{one.process.pid}/task"):
                os.sched_setaffinity(int(task), {min(os.sched_getaffinity(0))})
        measured = 1 / load(daemons, maker, kinds, 3 * seconds).core_s
    finally:
        maker.close()
        for one in daemons:
            one.close()
    print(
        f"three daemons on one core: {measured:,.0f} requests/s measured, {expected:,.0f} "
        f"simulated, {measured / expected - 1:+.1%}"
    )
    return abs(measured / expected - 1) <= TOLERANCE


def read_mix(text: str) -> dict[str, float]:
    mix = dict.fromkeys(MIX, 0.0)
    for part in text.split(","):
        kind, _, share = part.partition("=")
        if kind not in mix:
            raise argparse.ArgumentTypeError(f"{kind}: it is one of {', '.join(mix)}")
        mix[kind] = float(share)
    if mix["small"] <= 0:
        raise argparse.ArgumentTypeError("small: its share is above 0")
    return mix


def main() -> int:
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("--mix", type=read_mix, default=MIX, help="KIND=SHARE,...: " + ", ".join(KINDS))
    options.add_argument("--rate", type=float, default=10.0, help="requests of a node in a second")
    options.add_argument("--nodes", type=lambda text: [int(float(one)) for one in text.split(",")], default=NODES)
    options.add_argument("--cores", type=int, default=16, help="of a daemon's machine")
    options.add_argument("--wait-ms", type=float, default=5.0, help="for which 99 of 100 requests may wait")
    options.add_argument("--seconds", type=float, default=1.0, help="of each measurement")
    options.add_argument("--write", type=Path, help="a file whose part between the marks `plan` to replace")
    options.add_argument("--check", action="store_true", help="compare with three daemons")
    given = options.parse_args()
    if given.check:
        return 0 if any(check(given.mix, given.seconds) for _ in range(TRIES)) else 1
    costs = measure(given.mix, given.seconds)
    plans = [
        plan(given.mix, costs, nodes, given.rate, given.cores, given.wait_ms / 1e3)
        for nodes in given.nodes
    ]
    text = f"{costs_table(given.mix, costs)}\n\n{plans_table(plans, given.cores)}"
    print(text)
    if given.write is not None:
        before = given.write.read_text()
        marked = re.compile(r"(<!-- plan -->\n).*?(<!-- end of plan -->)", re.S)
        after, count = marked.subn(lambda match: match[1] + "\n" + text + "\n\n" + match[2], before)
        assert count == 1
        given.write.write_text(after)
    return 0


if __name__ == "__main__":
    sys.exit(main())
