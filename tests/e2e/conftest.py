"""Fixtures: a daemon for one test, or one for all tests that change nothing in it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "clients" / "python"))

from daemons import BUILD, Daemon  # noqa: E402  (needs the path above)
from modbus_master import Tcp  # noqa: E402


# Files that take longest, which begin first: with several processes none then waits for the last.
SLOWEST = ["same_bits", "fuzz", "retry", "robustness", "overload", "cli_plot_command", "mc", "parts"]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Puts the slowest files first."""
    files = [f"test_{name}" for name in SLOWEST]
    items.sort(key=lambda one: (*files, one.path.stem).index(one.path.stem))


@pytest.fixture(scope="session")
def build() -> Path:
    """The folder of the programs under test: $DIPOLED_BUILD, else build/."""
    return BUILD


@pytest.fixture
def daemon():
    """Starts daemons: daemon(*options, env=..., listen=...). At the end of the test each is
    stopped, and its end is checked."""
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
    """A daemon with default options, for tests that change nothing in it."""
    one = Daemon()
    yield one
    one.close()


@pytest.fixture(params=["unix", "tcp"])
def connection(request, shared):
    """A bare connection to the shared daemon, over each transport."""
    with shared.connect(request.param) as one:
        yield one


@pytest.fixture
def client(shared):
    """A client of the shared daemon."""
    with shared.client() as one:
        yield one


@pytest.fixture(scope="session")
def slave():
    """A daemon with Modbus over TCP, shared by tests that each use unit numbers of their own."""
    one = Daemon("--modbus", "tcp:127.0.0.1:0")
    yield one
    one.close()


@pytest.fixture
def master(slave):
    """A Modbus master of that daemon."""
    with Tcp(slave) as one:
        yield one
