"""Compiles programs against the installed library, as its users do: pkg-config finds the header,
the library and its options, and no file of this repository is used."""

import csv
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from daemons import LEAKS, REPOSITORY, environment, finished, sanitized
from installing import make, run
from test_readme import blocks

SIDE_MM = 20


class Installed:
    """The files that `make install` has put below a folder."""

    def __init__(self, folder: Path):
        self.folder = folder
        make("install", DESTDIR=folder, PREFIX="/usr/local")
        self._lib = folder / "usr/local/lib"

    def compile(self, compiler: list[str], source: Path, program: Path) -> None:
        """Compiles a program in a folder of its own, with the library's options and those of a
        sanitizer."""
        copy = program.parent / source.name
        shutil.copy(source, copy)
        places = {"PKG_CONFIG_LIBDIR": str(self._lib / "pkgconfig"), "PKG_CONFIG_SYSROOT_DIR": str(self.folder)}
        options = run("pkg-config", "--cflags", "--libs", "dipole", env=places).split()
        assert f"-I{self.folder}/usr/local/include" in options, options
        sanitize = ["-fsanitize=address,undefined"] if sanitized("asan") else []
        sanitize += ["-fsanitize=thread"] if sanitized("tsan") else []
        command = [*compiler, *sanitize, copy.name, "-o", program.name, *options]
        done = finished(*command, cwd=program.parent)
        assert done.returncode == 0 and done.stderr == "", done.stderr

    def run(self, program: Path, *arguments: str) -> str:
        """Runs a program with the installed library and dipoled. Returns its output. Memory that is lost
        is an error."""
        done = self.start(str(program), *arguments, folder=program.parent, **LEAKS)
        assert done.returncode == 0 and done.stderr == "", done.stdout + done.stderr
        return done.stdout

    def start(self, *command: str, folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
        """Runs a command in a folder with the installed library and dipoled. Memory is not zero at first."""
        more = {"PATH": f"{self.folder}/usr/local/bin:{os.environ['PATH']}", "MALLOC_PERTURB_": "165"}
        more["LD_LIBRARY_PATH"] = str(self._lib)
        return finished(*command, cwd=folder, env=environment(**more, **variables))


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Installed:
    return Installed(tmp_path_factory.mktemp("root"))


@pytest.fixture(scope="module")
def irradiance(installed, tmp_path_factory) -> Path:
    """Compiles the example. Returns the program."""
    source = REPOSITORY / "clients/c/examples/irradiance.c"
    program = tmp_path_factory.mktemp("example") / "irradiance"
    warnings = ["-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic"]
    installed.compile(["cc", "-std=c17", "-O2", *warnings], source, program)
    return program


def middles(count: int) -> np.ndarray:
    return (np.arange(count) + 0.5) * (SIDE_MM / count)


def gathered(client, pixels: int, points: int) -> np.ndarray:
    """Computes the sums of the example by numpy: [pixels, pixels, 3]."""
    y, x = (axis.ravel() for axis in np.meshgrid(middles(points), middles(points), indexing="ij"))
    lit = (x < 10) | ((x - 15) ** 2 + (y - 10) ** 2 < 4)
    py, px = np.meshgrid(middles(pixels), middles(pixels), indexing="ij")
    height_mm = SIDE_MM / points / np.sqrt(np.pi) / 2
    r = np.sqrt((px[..., None] - x[lit]) ** 2 + (py[..., None] - y[lit]) ** 2 + height_mm**2)
    R = client.eval("transport", "skin1", r.ravel(), wanted="R").R
    area_mm2 = (SIDE_MM / points) ** 2
    return np.moveaxis(R.reshape(3, *r.shape).sum(axis=-1) * area_mm2, 0, -1)


def test_the_example_gathers_irradiance(installed, irradiance, shared):
    rows = list(csv.DictReader(installed.run(irradiance, shared.url()).splitlines()))
    with shared.client() as client:
        known = gathered(client, 32, 24)
    names = ["red_w_per_mm2", "green_w_per_mm2", "blue_w_per_mm2"]
    values = np.array([[float(row[name]) for name in names] for row in rows])
    np.testing.assert_allclose(values.reshape(32, 32, 3), known, rtol=3e-4)  # its tables and groups: 1e-4 each
    places = [[float(row["x_mm"]), float(row["y_mm"])] for row in rows]
    np.testing.assert_allclose(places[1], [middles(32)[1], middles(32)[0]], rtol=1e-6)


@pytest.mark.parametrize("closing", [">&-", "<&- >&-", ">/dev/full", ">&- 2>&-"])
@pytest.mark.parametrize("scheme", ["private", "tcp"])
def test_the_example_without_an_output(installed, irradiance, shared, closing, scheme):
    address = ["private:"] if scheme == "private" else [shared.url(scheme)]
    words = [f'exec "$@" {closing}', "sh", str(irradiance), *address]
    done = installed.start("sh", "-c", *words, folder=irradiance.parent)
    assert done.returncode == 1 and ("standard output" in done.stderr or "2>" in closing)


def test_calls_that_nothing_else_makes(installed, tmp_path, shared, daemon):
    frugal = daemon("--max-frame-bytes", "65536", "--max-part-bytes", "4096")
    program = tmp_path / "calls"
    compiler = ["cc", "-std=c17", "-Wall", "-Wextra"]
    installed.compile(compiler, REPOSITORY / "tests/e2e/library_calls.c", program)
    installed.run(program, shared.url(), frugal.url())


def test_the_readme(installed, tmp_path, shared):
    (block,) = [block for block in blocks() if block.startswith("#include <dipole.h>")]
    (tmp_path / "readme.c").write_text(block)
    (tmp_path / "built").mkdir()
    program = tmp_path / "built/readme"
    installed.compile(["cc", "-std=c17", "-Wall", "-Wextra"], tmp_path / "readme.c", program)
    lines = installed.run(program).splitlines()
    with shared.client() as client:
        R = client.eval("transport", (0.05, 9.5, 0.9, 1.4), [0.1, 1.0, 5.0], evaluator="lut").R[0]
    assert lines == [f"{r} mm: {value:.6g} 1/mm^2" for r, value in zip((0.1, 1, 5), R)]
