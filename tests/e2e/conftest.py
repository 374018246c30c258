"""Fixtures: daemons for one test, and daemons that all tests share."""

import signal
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "clients" / "python"))

from daemons import BUILD, Daemon  # noqa: E402  (needs the path above)
from modbus_master import Tcp  # noqa: E402


# Daemons leave a SIGHUP alone that is ignored, and tests may run under nohup.
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# The files that take longest. They begin first, so that parallel processes end at about the same
# time.
SLOWEST = [
    *("balancer", "page", "messages", "cli", "retry", "cli_bake", "http", "tls", "modbus_jobs", "robustness"),
    *("figures", "python_client", "cache", "readme", "gather", "layers", "mc", "fair_preparation", "overload"),
]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Puts the slowest files first."""
    files = [f"test_{name}" for name in SLOWEST]
    items.sort(key=lambda one: (*files, one.path.stem).index(one.path.stem))


@pytest.fixture(scope="session")
def build() -> Path:
    """Returns the folder of the programs under test: $TESTED_BUILD, else build/."""
    return BUILD


@pytest.fixture
def daemon():
    """Returns a function that starts daemons: daemon(*options, env=..., listen=...). At the end of
    the test, each daemon is stopped and its exit is checked."""
    started: list[Daemon] = []

    def start(*options: str, **how) -> Daemon:
        started.append(Daemon(*options, **how))
        return started[-1]

    yield start
    failures = []
    for one in started:
        try:
            one.close()
        except AssertionError as failure:
            failures.append(failure)
    if failures:
        raise failures[0]


@pytest.fixture(scope="session")
def shared():
    """Returns a daemon with default options, shared by tests that change nothing in it."""
    one = Daemon()
    yield one
    one.close()


@pytest.fixture(params=["unix", "tcp"])
def connection(request, shared):
    """Returns a dipole.Connection to the shared daemon, over each transport in turn."""
    with shared.connect(request.param) as one:
        yield one


@pytest.fixture
def client(shared):
    """Returns a client of the shared daemon."""
    with shared.client() as one:
        yield one


@pytest.fixture(scope="session")
def slave():
    """Returns a daemon with Modbus over TCP, shared by tests that each use unit numbers of their
    own."""
    one = Daemon("--modbus", "tcp:127.0.0.1:0")
    yield one
    one.close()


@pytest.fixture
def master(slave):
    """Returns a Modbus master that is connected to `slave`."""
    with Tcp(slave) as one:
        yield one
