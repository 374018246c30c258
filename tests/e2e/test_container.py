"""The container image: its files are enough for the daemon, as nobody and without a shell, and
podman builds it."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
from pathlib import Path

import dipole
import pytest
from daemons import BUILD, END_S, PROGRAM, REPOSITORY, eventually, sanitized
from frames import SKIN
from installing import make, needs, run
from test_balancer import free_port

NOBODY = 65534
CONTAINERFILE = (REPOSITORY / "clients/deploy/Containerfile").read_text()

pytestmark = pytest.mark.skipif(sanitized(), reason="the build is sanitized")


def settings(word: str) -> list[str]:
    """Returns the instructions of the Containerfile that begin with this word."""
    lines = CONTAINERFILE.replace("\\\n", " ").splitlines()
    return [line.removeprefix(word).strip() for line in lines if line.startswith(word + " ")]


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    """Returns the image's file system."""
    folder = tmp_path_factory.mktemp("container") / "image"
    run("sh", "clients/packaging/container.sh", BUILD, folder)
    return folder / "root"


def test_there_is_nothing_but_programs_and_libraries(root):
    files = {path.relative_to(root) for path in root.rglob("*") if path.is_file()}
    programs = {path.name for path in files if "bin" in path.parts}
    assert programs == {"dipoled", "dipole"}
    assert all(".so" in path.name for path in files if "bin" not in path.parts)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can change its root")
def test_the_files_are_enough(root):
    """The daemon serves in this file system, as nobody, and the check of its health knows it."""
    assert settings("USER") == [f"{NOBODY}:{NOBODY}"]
    chroot = shutil.which("chroot", path=f"{os.environ['PATH']}:/usr/sbin")
    inside = [chroot, f"--userspec={NOBODY}:{NOBODY}", str(root)]
    place, metrics = f"tcp:127.0.0.1:{free_port()}", f"127.0.0.1:{free_port()}"
    health = json.loads(settings("HEALTHCHECK")[0].partition("CMD")[2])
    health = [word.replace("tcp:127.0.0.1:4817", place) for word in health]
    entry = json.loads(settings("ENTRYPOINT")[0])
    env = {"DIPOLED_LISTEN": place, "DIPOLED_METRICS": metrics}

    def is_healthy() -> bool:
        asked = subprocess.run([*inside, *health], capture_output=True, env={}, timeout=30, check=False)
        return asked.returncode == 0

    assert not is_healthy()
    with subprocess.Popen([*inside, *entry], env=env, stderr=subprocess.DEVNULL) as daemon:
        try:
            assert eventually(is_healthy, 20)
            status = Path(f"/proc/{daemon.pid}/status").read_text()
            assert f"Uid:\t{NOBODY}\t{NOBODY}\t{NOBODY}\t{NOBODY}\n" in status
            with dipole.Client(place) as client, dipole.Client(f"private:{PROGRAM}") as other:
                ours = client.eval("transport", SKIN, [0.5, 1.0, 2.0])
                assert (ours.R == other.eval("transport", SKIN, [0.5, 1.0, 2.0]).R).all()
        finally:
            daemon.send_signal(signal.SIGTERM)
        assert daemon.wait(END_S) == 0


def test_podman_builds_it():
    needs("podman")
    name = f"dipoled-test-{os.getpid()}"
    folder = BUILD / name
    make("container", CONTAINER_FOLDER=folder, CONTAINER_NAME=name)
    try:
        image = json.loads(run("podman", "image", "inspect", name))[0]
        config = image["Config"]
        assert config["User"] == f"{NOBODY}:{NOBODY}"
        assert config["Entrypoint"] == ["/usr/bin/dipoled"]
        assert image["Healthcheck"]["Test"][1] == "/usr/bin/dipole"
        assert set(config["ExposedPorts"]) == {"4817/tcp", "9817/tcp"}
    finally:
        run("podman", "rmi", name)
        run("rm", "-rf", folder)
