"""The examples in the README and the guide work, and the links of documents lead somewhere."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from daemons import BUILD, environment, finished

TOP = Path(__file__).parents[2]
sys.path.insert(0, str(TOP / "tests"))

import structure  # noqa: E402  (needs the path above)


def blocks() -> list[str]:
    """Returns the indented blocks of the README, then those of the guide."""
    text = "".join((TOP / name).read_text() for name in ["README.md", "clients/GUIDE.md"])
    found = re.findall(r"(?:^    .*\n(?:\n(?=    ))?)+", text, re.M)
    return [re.sub("^    ", "", block, flags=re.M) for block in found]


def lines_of(program: str) -> list[str]:
    return [line for block in blocks() for line in block.splitlines() if line.startswith(program)]


@pytest.mark.parametrize("name", structure.WORDS)
def test_links_lead_somewhere(name):
    text = re.sub(r"```.*?```", "", (TOP / name).read_text(), flags=re.S)
    for target in re.findall(r"\]\(([^)]+)\)", text):
        assert ((TOP / name).parent / target.partition("#")[0]).exists(), target


@pytest.fixture
def folder(tmp_path):
    """Makes a folder for the examples, with the programs in build/ as in the repository."""
    (tmp_path / "build").symlink_to(BUILD)
    (tmp_path / "clients").symlink_to(TOP / "clients")
    (tmp_path / "samples.csv").write_text("sigma_a,sigma_s,g,eta,r\n0.032,0.74,0,1.3,1\n")
    (tmp_path / "colours.csv").write_text("albedo,mean_free_path\n0.4,1\n")
    (tmp_path / "points.csv").write_text("x,y,z,power\n0,0,0,1\n")
    (tmp_path / "queries.csv").write_text("x,y,z\n0,0,1\n")
    radius = '<input name="subsurface_radius_scale" value="1, .5, .2"/>'
    colour = '<input name="subsurface_color" value=".8, .5, .3"/>'
    material = f"<materialx><open_pbr_surface>{radius}{colour}</open_pbr_surface></materialx>"
    (tmp_path / "material.mtlx").write_text(material)
    return tmp_path


def run(command: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    return finished("sh", "-c", command, cwd=folder, env=environment(**variables))


def test_shell(folder):
    """Some commands read what those before them wrote."""
    commands = lines_of("build/dipole ")
    assert len(commands) >= 10
    for command in commands:
        result = run(command, folder)
        assert result.returncode == 0, (command, result.stderr)
        name = re.search(r"(?:>|--plot) *([\w.]+)", command)
        assert (folder / name[1]).stat().st_size if name else result.stdout, command


def test_python(shared, folder):
    (script,) = [block for block in blocks() if block.startswith("import dipole")]
    (folder / "script.py").write_text(script)
    paths = os.pathsep.join([str(TOP / "clients/python"), os.environ.get("PYTHONPATH", "")])
    command = f"{sys.executable} script.py"
    result = run(command, folder, DIPOLED=shared.url(), PYTHONPATH=paths)
    assert result.returncode == 0, result.stderr
    assert result.stdout.endswith("transport\n")


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed")
def test_modbus(daemon, folder):
    one = daemon("--modbus", "tcp:127.0.0.1:0")
    port = one.url("modbus-tcp").rpartition(":")[2]
    (command,) = lines_of("mbpoll ")
    result = run(command.replace("5020", port), folder)
    assert "123456" in result.stdout, result.stdout + result.stderr


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_http(daemon, folder):
    one = daemon("--http", "127.0.0.1:0")
    address = next(line for line in one.log if "url=http://" in line).split("url=")[1].split()[0]
    commands = lines_of("curl ")
    assert len(commands) >= 4
    for command in commands:
        changed = command.replace("http://127.0.0.1:8017", address).replace("curl", "curl -sf", 1)
        result = run(changed, folder)
        assert result.returncode == 0 and json.loads(result.stdout), command
