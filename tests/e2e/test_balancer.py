"""Three daemons behind HAProxy, with the configuration of clients/deploy: clients notice nothing
when a daemon is killed, drained or stopped.

BALANCER_S is for how long test_clients_of_all_kinds() kills and drains: 600 in `make check-nightly`."""

import asyncio
import contextlib
import os
import random
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import dipole
import numpy as np
import pytest
from beside import Beside, Bench
from daemons import BUILD, REPOSITORY, Daemon, eventually, finished
from frames import SKIN
from modbus_master import Lost, Tcp, input_block, write_read_pdu
from test_gather import positions, scene
from test_retry import QUESTIONS, job_bytes, result_bytes

CONFIGURATION = REPOSITORY / "clients/deploy/haproxy.cfg"
BALANCER_S = float(os.environ.get("BALANCER_S", "10"))
MOST = 24
# Half of what close() waits. A daemon that has just started takes 3 s of a processor for the first
# inversion, which others share: clients that it gives up ask another one.
DRAIN = ("--drain-timeout-ms", "5000")

pytestmark = pytest.mark.skipif(shutil.which("haproxy") is None, reason="haproxy is not installed")


def free_port() -> int:
    """Returns a port that nobody uses, and that the kernel gives to no client."""
    while True:
        with socket.socket() as one, contextlib.suppress(OSError):
            one.bind(("127.0.0.1", random.randrange(20000, 32000)))
            return one.getsockname()[1]


class Place(NamedTuple):
    """The ports of a daemon or of the balancer."""

    binary: int
    modbus: int
    metrics: int


class Farm:
    """Three daemons, each at its place, and the balancer's addresses."""

    def __init__(self) -> None:
        self.front, *self.places = (
            Place(free_port(), free_port(), free_port()) for _ in range(4)
        )
        self.address = f"tcp:127.0.0.1:{self.front.binary}"
        self.modbus = f"127.0.0.1:{self.front.modbus}"
        self.daemons = [self.begin(place) for place in self.places]

    @staticmethod
    def begin(place: Place) -> Daemon:
        """Starts a daemon at a place."""
        ports = ("--metrics", f"127.0.0.1:{place.metrics}")
        modbus = ("--modbus", f"tcp:127.0.0.1:{place.modbus}")
        return Daemon(
            *ports, *modbus, *DRAIN, "--max-connections", str(MOST),
            listen=[f"tcp:127.0.0.1:{place.binary}"],
        )  # fmt: skip

    def configuration(self) -> str:
        """Returns the balancer's configuration with these ports."""
        text = CONFIGURATION.read_text()
        text = text.replace("bind :4817", f"bind 127.0.0.1:{self.front.binary}")
        text = text.replace("bind :502", f"bind 127.0.0.1:{self.front.modbus}")
        for number, place in enumerate(self.places, 1):
            for port, own in (4817, place.binary), (502, place.modbus):
                text = text.replace(
                    f"farm{number}:{port} port 9817", f"127.0.0.1:{own} port {place.metrics}"
                )
        assert text.count("127.0.0.1:") == 8
        return text

    def answers(self) -> bool:
        """Returns whether the balancer lets clients of both protocols in."""
        try:
            with dipole.Client(self.address, retry_s=0), Tcp(self.modbus) as master:
                master.job()
                return True
        except (dipole.DipoleError, OSError, Lost):
            return False

    def close(self) -> None:
        for one in self.daemons:
            one.close()


@contextlib.contextmanager
def balanced(folder: Path) -> Iterator[Farm]:
    """Yields three daemons behind a balancer, whose configuration is put into a folder."""
    one = Farm()
    (folder / "haproxy.cfg").write_text(one.configuration())
    command = ["haproxy", "-db", "-f", str(folder / "haproxy.cfg")]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as proxy:
        try:
            assert eventually(one.answers)
            yield one
        finally:
            proxy.terminate()
            one.close()


@pytest.fixture
def farm(tmp_path):
    with balanced(tmp_path) as one:
        yield one


def open_three(address: str) -> bool:
    """Opens three clients at a time, of which each daemon in rotation gets one. Returns whether
    none is refused."""
    with contextlib.ExitStack() as held:
        try:
            for _ in range(3):
                held.enter_context(dipole.Client(address, retry_s=0)).ping()
        except dipole.DipoleError:
            return False
    return True


def test_an_overloaded_daemon_keeps_its_connections_and_gets_no_new_ones(farm):
    address, first = farm.address, farm.daemons[0]
    watcher = first.client("tcp")

    def accepted() -> int:
        return watcher.statistics()["connections_accepted"]

    with contextlib.ExitStack() as held:
        earlier = [held.enter_context(dipole.Client(address, retry_s=0)) for _ in range(3)]
        with contextlib.ExitStack() as full:
            while watcher.statistics()["connections_open"] < MOST:
                full.enter_context(first.connect("tcp"))
            before = accepted()
            assert eventually(lambda: not open_three(address))
            assert eventually(lambda: open_three(address))
            for _ in range(20):  # More connections are refused meanwhile, but not these.
                with first.connect("tcp") as one, contextlib.suppress(OSError, EOFError):
                    one.receive_frame()
                assert open_three(address)
                for client in earlier:
                    client.ping()
            assert accepted() == before
        assert eventually(lambda: open_three(address) and accepted() > before)
    watcher.close()


# ---- clients of all kinds ------------------------------------------------------------------------

JOB = {"medium": SKIN, "edges": dipole.Grid(0.0, 4.0, 5), "photons": 50_000}
POINTS, POSITIONS = scene(20_000), positions(200)
COMMANDS = [
    ["eval", "--medium", "skin1", "--model", "better", "--r", "0.5,1,2", "--format", "csv"],
    ["eval", "--medium", "marble", "--tolerance", "0.01", "--count", "200", "--format", "csv"],
    ["invert", "--albedo", "0.44,0.22", "--mean-free-path", "1.3,0.95", "--format", "csv"],
    ["mc", "--medium", "skin1", "--channel", "red", "--photons", "50000", "--format", "json"],
]


class User(Beside):
    """A client that asks until it is told to end. Each kind has its own ask()."""

    def __init__(self, farm: Farm):
        super().__init__(self.ask)
        self.address = farm.address
        self.modbus = farm.modbus
        self.known: dict[object, object] = {}  # the first answer to each question
        self.answers = self.retries = 0

    def ask(self) -> None:
        raise NotImplementedError

    def count_retries(self, client: dipole.Client | dipole.AsyncClient) -> None:
        restore = client._session._restore

        async def counted(lost):
            self.retries += 1
            await restore(lost)

        client._session._restore = counted

    def check(self, which: object, answer: object) -> None:
        """Compares an answer with the first one to the same question."""
        assert answer == self.known.setdefault(which, answer), f"{type(self).__name__}: {which}"
        self.answers += 1


class Python(User):
    """Queries, several of them under way, tables, fits, Monte Carlo and sums over points, which a
    daemon that comes in another's place does not have."""

    def ask(self) -> None:
        with dipole.Client(self.address) as client:
            self.count_retries(client)
            while not self.ended.is_set():
                under_way = [client.submit(**question) for question in QUESTIONS[:-1]]
                for number, one in enumerate(under_way):
                    self.check(number, result_bytes(client.collect(one)[1]))
                table = client.table("better", dipole.Medium(0.05, 1.0))
                self.check("table", table.R(np.linspace(0.1, 5.0, 100)).tobytes())
                fit = client.fit("better", [0.5, 1.0, 2.0], [0.1, 0.05, 0.01], [0.01] * 3,
                                 eta=1.3)
                self.check("fit", fit.sets.tobytes())
                self.check("mc", job_bytes(client.mc(**JOB)))
                self.check("gather", client.gather("better", [SKIN], POINTS, POSITIONS).M.tobytes())


class Asyncio(User):
    """The same, all at once."""

    def ask(self) -> None:
        asyncio.run(self.ask_async())

    async def ask_async(self) -> None:
        async with dipole.AsyncClient(self.address) as client:
            async def eval(number: int) -> None:
                self.check(number, result_bytes(await client.eval(**QUESTIONS[number])))

            async def mc() -> None:
                self.check("mc", job_bytes(await client.mc(**JOB)))

            async def gather() -> None:
                found = await client.gather("better", [SKIN], POINTS, POSITIONS)
                self.check("gather", found.M.tobytes())

            self.count_retries(client)
            while not self.ended.is_set():
                await asyncio.gather(mc(), gather(), *map(eval, range(len(QUESTIONS))))


class CommandLine(User):
    """`dipole`, one command after the other."""

    def ask(self) -> None:
        for words in COMMANDS:
            said = finished(str(BUILD / "dipole"), *words, "--connect", self.address)
            assert (said.returncode, said.stderr) == (0, ""), said
            self.check(" ".join(words), said.stdout)


class Libdipole(User):
    """`dipole bench`, which compares each answer of libdipole with the first."""

    def ask(self) -> None:
        load = Bench(self.address, "--seconds", "0.3", "--connections", "3")
        load.measure()
        self.answers += load.answered


class Master(User):
    """A Modbus master that writes a medium and reads R with one request, some hundred times a
    second. Modbus has no retries of its own: when the connection ends, the master connects and asks
    again."""

    def ask(self) -> None:
        try:
            with Tcp(self.modbus) as master:
                while not self.ended.wait(0.005):
                    number = self.answers % 7
                    radii = [0.1 * (number + k + 1) for k in range(20)]
                    block = input_block(1 + number, radii=radii)
                    pdu = write_read_pdu(100, block, 312, 2 * len(radii))
                    answer = master.ask(pdu)
                    assert len(answer) == 1 + 4 * len(radii)
                    self.check(number, answer)
        except (Lost, OSError):
            self.retries += 1
            time.sleep(0.02)


def test_clients_of_all_kinds_while_daemons_end(farm, capfd):
    """Every two seconds or so a daemon is killed or drained, and started again a moment later. No
    answer is lost or wrong, and no client that retries says anything of it."""
    dice, killed, drained = random.Random(22), 0, 0
    with contextlib.ExitStack() as stack:
        users = [
            stack.enter_context(kind(farm)) for kind in (Python, Asyncio, CommandLine, Libdipole, Master)
        ]
        assert eventually(lambda: all(one.failure or one.answers > 20 for one in users), 120)
        end_s = time.monotonic() + BALANCER_S
        while time.monotonic() < end_s and not any(one.failure for one in users):
            before = [one.answers for one in users]
            which = dice.randrange(3)
            if killed == drained:
                farm.daemons[which].kill()
                killed += 1
            else:
                farm.daemons[which].close()
                drained += 1
            time.sleep(dice.uniform(0, 1))
            farm.daemons[which] = Farm.begin(farm.places[which])
            time.sleep(1.5)  # HAProxy looks once a second which daemons are there.
            assert eventually(
                lambda: all(one.failure or one.answers > n for one, n in zip(users, before)), 120
            )
    with capfd.disabled():
        print(f"\nbalancer: {killed} daemons killed, {drained} drained", end="")
        for one in users:
            print(f"; {type(one).__name__}: {one.answers} answers, {one.retries} retries", end="")
    assert killed + drained >= BALANCER_S / 60
