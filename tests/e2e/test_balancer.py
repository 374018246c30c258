"""Three daemons behind HAProxy, with the configuration of clients/deploy: clients notice nothing
when a daemon is killed, drained or stopped."""

from __future__ import annotations

import contextlib
import re
import shutil
import signal
import socket
import subprocess
import threading
import time

import dipole
import numpy as np
import pytest
from daemons import REPOSITORY, eventually
from frames import SKIN

CONFIGURATION = REPOSITORY / "clients/deploy/haproxy.cfg"
METRICS = ("--metrics", "127.0.0.1:0")
MOST = 24

pytestmark = pytest.mark.skipif(shutil.which("haproxy") is None, reason="haproxy is not installed")


def metrics_port(daemon) -> str:
    return re.search(r"url=http://127\.0\.0\.1:(\d+)/", "\n".join(daemon.log))[1]


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.fixture
def balancer(daemon, tmp_path):
    """Yields the address of a balancer, and its three daemons."""
    farm = [daemon(*METRICS, "--max-connections", str(MOST)) for _ in range(3)]
    port = free_port()
    text = CONFIGURATION.read_text().replace("bind :4817", f"bind 127.0.0.1:{port}")
    for number, one in enumerate(farm, 1):
        place = f"{one.url('tcp').removeprefix('tcp:')} port {metrics_port(one)}"
        text = text.replace(f"farm{number}:4817 port 9817", place)
    assert text.count("127.0.0.1:") == 4
    (tmp_path / "haproxy.cfg").write_text(text)
    command = ["haproxy", "-db", "-f", str(tmp_path / "haproxy.cfg")]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as proxy:
        address = f"tcp:127.0.0.1:{port}"

        def answers() -> bool:
            try:
                with dipole.Client(address, retry_s=0):
                    return True
            except dipole.DipoleError:
                return False

        try:
            assert eventually(answers, 10)
            yield address, farm
        finally:
            proxy.terminate()


class Load(threading.Thread):
    """A client that asks one question after the other, and compares the answers."""

    def __init__(self, address: str, number: int):
        super().__init__()
        self.answers = 0
        self.worst_s = 0.0
        self.error: BaseException | None = None
        self.ended = threading.Event()
        self._address, self._r = address, np.linspace(0.1, 3.0 + number, 500)

    def run(self) -> None:
        try:
            with dipole.Client(self._address) as client:
                expected = client.eval("better", SKIN, self._r).R
                while not self.ended.is_set():
                    start_s = time.monotonic()
                    assert (client.eval("better", SKIN, self._r).R == expected).all()
                    self.worst_s = max(self.worst_s, time.monotonic() - start_s)
                    self.answers += 1
        except BaseException as error:
            self.error = error


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


def test_an_overloaded_daemon_keeps_its_connections_and_gets_no_new_ones(balancer):
    address, farm = balancer
    watcher = farm[0].client()

    def accepted() -> int:
        return watcher.statistics()["connections_accepted"]

    with contextlib.ExitStack() as held:
        earlier = [held.enter_context(dipole.Client(address, retry_s=0)) for _ in range(3)]
        with contextlib.ExitStack() as full:
            while watcher.statistics()["connections_open"] < MOST:
                full.enter_context(farm[0].connect())
            before = accepted()
            assert eventually(lambda: not open_three(address), 10)
            assert eventually(lambda: open_three(address), 10)
            for _ in range(20):  # More connections are refused meanwhile, but not these.
                with farm[0].connect() as one, contextlib.suppress(OSError, EOFError):
                    one.receive_frame()
                assert open_three(address)
                for client in earlier:
                    client.ping()
            assert accepted() == before
        assert eventually(lambda: open_three(address) and accepted() > before, 10)
    watcher.close()


@pytest.mark.parametrize("what", ["killed", "drained", "stopped"])
def test_clients_do_not_notice_that_a_daemon_is(balancer, what):
    address, farm = balancer
    loads = [Load(address, number) for number in range(6)]
    for one in loads:
        one.start()
    try:
        assert eventually(lambda: all(one.answers > 10 for one in loads), 10)
        assert all(one.client().statistics()["connections_accepted"] > 1 for one in farm)
        if what == "killed":
            farm[0].kill()
        elif what == "drained":
            farm[0].terminate()
        else:
            farm[0].process.send_signal(signal.SIGSTOP)
        before = [one.answers for one in loads]
        assert eventually(
            lambda: all(one.error or one.answers > n + 20 for one, n in zip(loads, before)), 15
        )
    finally:
        for one in loads:
            one.ended.set()
        for one in loads:
            one.join(15)
        if what == "stopped":
            farm[0].process.send_signal(signal.SIGCONT)
    assert [one.error for one in loads] == [None] * 6
    assert max(one.worst_s for one in loads) < 8
