"""The units for systemd: without faults, and confined."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from daemons import PROGRAM, REPOSITORY
from installing import make, needs, run


@pytest.fixture(scope="module")
def units(tmp_path_factory) -> Path:
    """The units as they are installed, but that they start the daemon under test."""
    root = tmp_path_factory.mktemp("units")
    make("install", DESTDIR=root, UNITDIR="/units")
    service = root / "units/dipoled.service"
    start = re.compile(r"^ExecStart=/\S+/dipoled$", re.M)
    text, count = start.subn(f"ExecStart={PROGRAM}", service.read_text())
    assert count == 1
    service.write_text(text)
    return root / "units"


def test_systemd_finds_no_fault(units):
    needs("systemd-analyze")
    env = {"SYSTEMD_UNIT_PATH": f"{units}:"}
    paths = [units / "dipoled.service", units / "dipoled.socket"]
    assert run("systemd-analyze", "verify", "--man=no", *paths, env=env) == ""


def test_the_service_is_confined(units):
    """By systemd's own scale, on which 10 is a service that may do all."""
    needs("systemd-analyze")
    limit = "--threshold=20"  # 2.0
    run("systemd-analyze", "security", "--offline=yes", limit, units / "dipoled.service")


def test_the_sockets_are_where_a_daemon_of_root_listens(units):
    """So that clients need not know who has started it."""
    listens = re.findall(r"^ListenStream=(.*)$", (units / "dipoled.socket").read_text(), re.M)
    main = (REPOSITORY / "server/main.c").read_text()
    port = re.search(r'#define DEFAULT_TCP "tcp:(.*)"', main)[1]
    name = re.search(r'#define DEFAULT_SOCKET "(.*)"', main)[1]
    assert listens == [f"/run/{name}", port]
