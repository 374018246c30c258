"""`make install`: the installed files work without the sources, and `make uninstall` removes all of
them."""

import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import eval_rows
from daemons import BUILD, REPOSITORY, environment, finished, sanitized
from installing import make, needs, run
from test_readme import blocks

PREFIX = "/usr/local"

# A program that links to a sanitized library must be sanitized itself.
unsanitized = pytest.mark.skipif(sanitized(), reason="the build is sanitized")


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    """Returns a folder into which everything is installed."""
    root = tmp_path_factory.mktemp("root")
    make("install", DESTDIR=root, PREFIX=PREFIX)
    return root


@pytest.fixture(scope="module")
def prefix(tree) -> Path:
    return Path(f"{tree}{PREFIX}")


def files(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*")}


def test_uninstall_leaves_nothing_behind(tmp_path):
    make("install", DESTDIR=tmp_path, PREFIX=PREFIX)
    assert len(files(tmp_path)) > 20
    make("uninstall", DESTDIR=tmp_path, PREFIX=PREFIX)
    assert files(tmp_path) == set()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root makes groups")
@pytest.mark.parametrize("before", [False, True])
@pytest.mark.parametrize("system", [False, True])
def test_a_group_for_systems_prefix_alone(tmp_path, monkeypatch, system, before):
    """Without DESTDIR, root makes the socket's group where systemd looks for units, unless it is
    there. `make uninstall` removes the group that `make install` has made, and the folders."""
    tools, prefix, group, done = (tmp_path / name for name in ("tools", "prefix", "group", "done"))
    tools.mkdir()
    for name, does in {
        "getent": f"[ -e {group} ]",
        "systemd-sysusers": f"touch {group} {done}",
        "groupdel": f"rm {group} && touch {done}",
        "ldconfig": "true",
    }.items():
        (tools / name).write_text(f"#!/bin/sh\n{does}\n")
        (tools / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tools}:{os.environ['PATH']}")
    if before:
        group.touch()
    variables = {"PREFIX": prefix, **({"SYSTEM_PREFIXES": prefix} if system else {})}
    make("install", **variables)
    assert group.exists() == (system or before)
    make("uninstall", **variables)
    assert group.exists() == before and done.exists() == (system and not before)
    left = files(prefix) if prefix.exists() else set()
    assert not any("dipole" in name for name in left) and (system or not prefix.exists())


def test_uninstall_leaves_others_alone(tmp_path):
    others = ["bin/other", "share/man/man8/other.8", "lib/libother.so", "lib/pkgconfig/other.pc"]
    for name in others:
        path = Path(f"{tmp_path}{PREFIX}") / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("somebody else's")
    before = files(tmp_path)
    make("install", DESTDIR=tmp_path, PREFIX=PREFIX)
    make("uninstall", DESTDIR=tmp_path, PREFIX=PREFIX)
    assert files(tmp_path) == before


def test_files_are_readable_for_all_and_name_no_staging(tree):
    for path in tree.rglob("*"):
        if not path.is_symlink():
            assert path.stat().st_mode & 0o444 == 0o444, path
        if path.is_file() and path.suffix in (".pc", ".service", ".socket", ".8", ".1"):
            text = path.read_text()
            assert str(tree) not in text and not re.search(r"@[A-Z]+@", text), path
    unit = tree / f"{PREFIX[1:]}/lib/systemd/system/dipoled.service"
    assert f"ExecStart={PREFIX}/bin/dipoled\n" in unit.read_text()


def test_no_built_program_is_run(tree, tmp_path):
    """`make install` runs none of the built programs: a cross-build installs programs that this
    machine cannot run."""
    run("cp", "-al", BUILD, tmp_path / "build")
    for program in ("dipoled", "dipole"):
        (tmp_path / "build" / program).unlink()
        (tmp_path / "build" / program).write_text("#!/bin/sh\nexit 1\n")
        (tmp_path / "build" / program).chmod(0o755)
    make("install", BUILD=tmp_path / "build", DESTDIR=tmp_path / "root", PREFIX=PREFIX)
    assert files(tmp_path / "root") == files(tree)
    assert (tmp_path / f"root{PREFIX}/bin/dipole").read_text().endswith("exit 1\n")


# ---- the library ---------------------------------------------------------------------------------

STRICT = ["-Wall", "-Wextra", "-pedantic", "-Werror"]
LANGUAGES = {
    "c": ["cc", "-std=c17", *STRICT],
    "cc": ["c++", "-std=c++17", *STRICT],
}


@pytest.mark.skipif(
    platform.machine() != "x86_64" or not Path("/usr/include/x86_64-linux-gnu/gnu/stubs-32.h").exists(),
    reason="the headers for 32 bits are not installed",
)
def test_programs_compile_for_32_bits():
    files = [
        path
        for folder in ("proto", "server", "clients/c", "clients/cli")
        for path in sorted((REPOSITORY / folder).rglob("*.c"))
        if not {"tools", "examples", "page.c"} & set(path.parts)
    ]
    packages = subprocess.run(
        ["pkg-config", "--cflags", "libmodbus"], capture_output=True, text=True, check=True
    )
    options = ["-m32", "-idirafter", "/usr/include/x86_64-linux-gnu", *packages.stdout.split()]
    options += ["-std=c17", "-Wall", "-Wextra", "-Wno-missing-field-initializers", "-Werror", "-D_GNU_SOURCE", "-DDIPOLED_VERSION=\"\""]
    command = ["gcc", *options, "-I.", "-fsyntax-only", *files]
    done = finished(*command, cwd=REPOSITORY)
    assert done.returncode == 0, done.stderr


def test_the_environment_of_the_readme(tmp_path):
    """As `pip` alone installs nothing for Debian's Python. The packages that build the module are
    those of the system."""
    command = re.search(r"`(python3 -m venv .*?)`", (REPOSITORY / "README.md").read_text())[1]
    command = command.replace("~/", f"{tmp_path}/").replace("python3", sys.executable)
    shutil.copytree(REPOSITORY / "clients/python", tmp_path / "clients/python")
    command = command.replace("pip install", "pip install --quiet --no-build-isolation --no-index")
    subprocess.run(["sh", "-c", command], cwd=tmp_path, check=True)
    program = "import dipole, sys; print(dipole.__file__.startswith(sys.prefix))"
    python = [f"{tmp_path}/dipole/bin/python", "-c", program]
    assert subprocess.run(python, env=environment(PYTHONPATH=""), capture_output=True).stdout == b"True\n"


def pkg_config(tree: Path, *options: str) -> list[str]:
    env = {
        "PKG_CONFIG_LIBDIR": f"{tree}{PREFIX}/lib/pkgconfig",
        "PKG_CONFIG_SYSROOT_DIR": str(tree),
    }
    return run("pkg-config", "--cflags", "--libs", *options, "dipole", env=env).split()


def expected() -> list[float]:
    """Returns what the README's program prints: distances, and R there."""
    medium = ["--sigma-a", "0.05", "--sigma-s", "9.5", "--g", "0.9", "--eta", "1.4"]
    rows = eval_rows(*medium, "--model", "transport", "--evaluator", "lut", "--r", "0.1,1,5", "--wanted", "R")
    column = next(name for name in rows[0] if name.startswith("R"))
    return [float(row[name]) for row in rows for name in ("r", column)]


@unsanitized
@pytest.mark.parametrize("kind", ["shared", "static"])
@pytest.mark.parametrize("language", LANGUAGES)
def test_a_program_builds_and_runs(tree, prefix, tmp_path, language, kind):
    compiler = LANGUAGES[language]
    needs(compiler[0], "pkg-config")
    source = tmp_path / f"program.{language}"
    (program,) = [block for block in blocks() if block.startswith("#include <dipole.h>")]
    source.write_text(program)
    flags = pkg_config(tree, *(["--static"] if kind == "static" else []))
    if kind == "static":
        # Links libdipole from its archive, and the C library as usual.
        flags = ["-l:libdipole.a" if flag == "-ldipole" else flag for flag in flags]
    run(*compiler, source, "-o", tmp_path / "program", *flags)
    needed = "libdipole.so.0" in run("readelf", "-d", tmp_path / "program")
    assert needed == (kind == "shared")
    env = {"LD_LIBRARY_PATH": f"{prefix}/lib", "PATH": f"{prefix}/bin"}
    said = run(tmp_path / "program", env=env, cwd=tmp_path)
    printed = [float(word) for line in said.splitlines() for word in line.split()[::2]]
    assert printed == pytest.approx(expected(), rel=1e-5)


def test_the_library_exports_what_its_header_declares(prefix):
    needs("nm")
    symbols = run("nm", "-D", "--defined-only", prefix / "lib/libdipole.so").splitlines()
    exported = {line.split()[2].split("@")[0] for line in symbols if line.split()[1] != "A"}
    header = re.sub(r"/\*.*?\*/", "", (prefix / "include/dipole.h").read_text(), flags=re.DOTALL)
    declared = set(re.findall(r"\b(dipole_\w+)\(", header))
    assert exported == declared and len(exported) > 20


def test_the_library_has_its_soname(prefix):
    needs("readelf")
    assert "soname: [libdipole.so.0]" in run("readelf", "-d", prefix / "lib/libdipole.so")
    links = [prefix / "lib" / name for name in ("libdipole.so", "libdipole.so.0")]
    assert all(link.is_symlink() and link.exists() for link in links)


# ---- the others ----------------------------------------------------------------------------------


def test_the_programs_find_each_other(prefix, tmp_path):
    """The client starts the private daemon beside it."""
    text = run(prefix / "bin/dipole", "info", env={"PATH": "/nowhere"}, cwd=tmp_path)
    assert "private:" in text


def test_the_python_module(tree, prefix, tmp_path):
    found = list(tree.rglob("dipole/__init__.py"))
    assert len(found) == 1
    program = (
        "import dipole\n"
        "with dipole.Client() as client:\n"
        "    print(*client.eval('better', (0.032, 0.74, 0, 1.3), [0.5, 1.0]).R[0])\n"
        "    print(float(client.table('better', (0.032, 0.74, 0, 1.3)).R(0.5)))\n"
        "print(dipole.__file__)"
    )
    env = {
        "PATH": f"{prefix}/bin",
        "PYTHONPATH": str(found[0].parents[1]),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    *values, by_table, path = run(sys.executable, "-c", program, env=env, cwd=tmp_path).split()
    assert path == str(found[0])
    rows = eval_rows("--sigma-a", "0.032", "--sigma-s", "0.74", "--r", "0.5,1", "--wanted", "R")
    known = [float(value) for row in rows for name, value in row.items() if name.startswith("R")]
    assert list(map(float, values)) == known
    assert float(by_table) == pytest.approx(known[0], rel=1e-4)


def test_python_looks_where_the_module_is_installed(tree):
    """The script prints the folder for modules below a prefix. For the prefixes that Debian's
    Python searches, this folder is in its search path."""
    script = REPOSITORY / "clients/packaging/python_folder.py"
    for place in (PREFIX, "/usr"):
        folder = run(sys.executable, script, place).strip()
        assert folder.startswith(f"{place}/lib/python3")
        if any(path.startswith(f"{place}/lib/") for path in sys.path if "packages" in path):
            assert folder in sys.path
    other = run(sys.executable, script, "/opt/dipole").strip()
    version = ".".join(map(str, sys.version_info[:2]))
    assert other == f"/opt/dipole/lib/python{version}/site-packages"


def test_installing_builds_no_benchmark():
    asked = run("make", "-n", "-B", "install", "DESTDIR=/nowhere", cwd=REPOSITORY)
    assert "dipoled" in asked and "tests/bench" not in asked
