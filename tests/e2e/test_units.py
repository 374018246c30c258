"""The systemd units have no faults, and confine the daemon."""

import re
from pathlib import Path

import pytest
from daemons import PROGRAM, REPOSITORY
from installing import make, needs, run


SERVICES = ["dipoled.service", "dipoled@.service"]


@pytest.fixture(scope="module")
def units(tmp_path_factory) -> Path:
    """Returns the units as they are installed, changed so that they start the daemon under test."""
    root = tmp_path_factory.mktemp("units")
    make("install", DESTDIR=root, UNITDIR="/units")
    start = re.compile(r"^ExecStart=/\S+/dipoled$", re.M)
    for name in SERVICES:
        service = root / "units" / name
        text, count = start.subn(f"ExecStart={PROGRAM}", service.read_text())
        assert count == 1
        service.write_text(text)
    return root / "units"


def test_systemd_finds_no_fault(units):
    needs("systemd-analyze")
    env = {"SYSTEMD_UNIT_PATH": f"{units}:"}
    paths = [units / name for name in (*SERVICES, "dipoled.socket")]
    assert run("systemd-analyze", "verify", "--man=no", *paths, env=env) == ""


@pytest.mark.parametrize("name", SERVICES)
def test_the_service_is_confined(units, name):
    """systemd's own scale of exposure goes up to 10, for a service that may do everything."""
    needs("systemd-analyze")
    limit = "--threshold=20"  # The scale is in tenths: 2.0.
    run("systemd-analyze", "security", "--offline=yes", limit, units / name)


def test_the_socket_is_where_a_daemon_of_root_listens(units):
    """The unit listens at the socket of a daemon that root starts, so that clients need not know
    who has started it. A port would be open to everybody on the machine."""
    listens = re.findall(r"^ListenStream=(.*)$", (units / "dipoled.socket").read_text(), re.M)
    main = (REPOSITORY / "server/main.c").read_text()
    assert listens == [f"/run/{re.search(r'#define DEFAULT_SOCKET .(.*).$', main, re.M)[1]}"]


def test_the_socket_is_for_the_members_of_a_group(units):
    socket = (units / "dipoled.socket").read_text()
    assert re.findall(r"^Socket(?:Mode|Group)=(.*)$", socket, re.M) == ["0660", "dipole"]
    users = (REPOSITORY / "server/dipoled.sysusers").read_text()
    assert re.findall(r"^[^#].*$", users, re.M) == ["g dipole -"]


def test_instances_differ_from_the_one_daemon_in_their_places_alone(units):
    """An instance has its own socket, folder and options, and is confined like the one daemon."""
    one, instance = ((units / name).read_text().splitlines() for name in SERVICES)
    settings = [{line for line in text if re.match(r"\w+=", line)} for text in (one, instance)]
    assert settings[1] - settings[0] == {
        "Description=Subsurface-scattering profiles for clients, instance %i",
        "After=network.target",
        "Environment=DIPOLED_LISTEN=unix:%t/dipoled-%i/dipoled.sock",
        "EnvironmentFile=-/etc/default/dipoled-%i",
        "Group=dipole",
        "RuntimeDirectory=dipoled-%i",
        "UMask=0117",  # the group may connect
    }
    assert {line.split("=")[0] for line in settings[0] - settings[1]} == {
        "Description", "Requires", "After", "EnvironmentFile", "RuntimeDirectory", "UMask", "Also",
    }  # fmt: skip
    assert not any("#@" in line or "#!" in line for line in one + instance)
