"""The Debian packages: their contents, and Debian's rules for them. How they install is tested by
`make check-deb`."""

import re
import shutil
from pathlib import Path

import pytest
from daemons import BUILD, REPOSITORY, sanitized
from installing import make, needs, run

pytestmark = [
    pytest.mark.skipif(sanitized(), reason="the build is sanitized"),
    pytest.mark.skipif(
        shutil.which("dh") is None or shutil.which("dh_python3") is None,
        reason="debhelper and dh-python are not installed",
    ),
]


@pytest.fixture(scope="module")
def packages(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("packages") / "deb"
    make("deb", DEB=folder, REUSE="yes")
    return {path.name.split("_")[0]: path for path in sorted(folder.glob("*.deb"))}


def contents(package: Path) -> set[str]:
    """Returns the files of a package, without its folders."""
    lines = run("dpkg-deb", "--contents", package).splitlines()
    return {line.split()[5].removeprefix(".") for line in lines if not line.startswith("d")}


def field(package: Path, name: str) -> str:
    return run("dpkg-deb", "--field", package, name).strip()


def test_lintian_finds_nothing(packages):
    needs("lintian")
    changes = next(packages["dipoled"].parent.glob("*.changes"))
    run("lintian", "--allow-root", "--fail-on", "error,warning", changes)


def test_all_that_is_installed_is_in_one_package(packages, tmp_path):
    everything = [name for package in packages.values() for name in contents(package)]
    assert len(everything) == len(set(everything))
    of_debian = re.compile(r"/usr/share/doc/[^/]+/(copyright|changelog\.gz)")
    installed = {name for name in everything if not of_debian.fullmatch(name)}
    places = {
        "PREFIX": "/usr",
        "LIBDIR": "/usr/lib/" + run("dpkg-architecture", "-qDEB_HOST_MULTIARCH").strip(),
        "UNITDIR": "/lib/systemd/system",
        "ZSHDIR": "/usr/share/zsh/vendor-completions",
        "PYTHONDIR": "/usr/lib/python3/dist-packages",
    }
    make("install", DESTDIR=tmp_path, **places)
    paths = (path for path in tmp_path.rglob("*") if path.is_symlink() or not path.is_dir())
    names = {f"/{path.relative_to(tmp_path)}" for path in paths}
    assert {name.removesuffix(".gz") for name in installed} == names


def test_versions_and_dependencies(packages):
    version = re.search(r"^VERSION := (\S+)", (REPOSITORY / "Makefile").read_text(), re.M)[1]
    for name, package in packages.items():
        assert field(package, "Version") == version
        assert "${" not in run("dpkg-deb", "--info", package)
        assert {f"/usr/share/doc/{name}/{file}" for file in ("copyright", "changelog.gz")} <= (
            contents(package)
        )
    assert "libuv1" in field(packages["dipoled"], "Depends")
    assert field(packages["libdipole-dev"], "Depends") == f"libdipole0 (= {version})"
    assert field(packages["python3-dipole"], "Architecture") == "all"


def test_the_library_tells_its_symbols(packages):
    symbols = run("dpkg-deb", "--info", packages["libdipole0"], "symbols").splitlines()
    assert symbols[0].startswith("libdipole.so.0 libdipole0 ")
    functions = {line.split("@")[0].strip() for line in symbols if "@DIPOLE_" in line}
    assert len(functions) > 20 and all(re.match(r"dipole_|DIPOLE_", name) for name in functions)
    assert "activate-noawait ldconfig" in run(
        "dpkg-deb", "--info", packages["libdipole0"], "triggers"
    )


def test_the_service_starts_and_modules_are_compiled(packages):
    """The scripts of the packages, which debhelper writes, start the service and compile the
    module."""
    script = run("dpkg-deb", "--info", packages["dipoled"], "postinst")
    made = re.search(r"systemd-sysusers .*dipoled\.conf", script)
    assert made and made.start() < script.index("deb-systemd-invoke")
    assert "enable 'dipoled.service'" in script and "enable 'dipoled.socket'" in script
    assert "py3compile -p python3-dipole" in run(
        "dpkg-deb", "--info", packages["python3-dipole"], "postinst"
    )


def test_the_same_build_gives_the_same_packages(packages, tmp_path):
    make("deb", DEB=tmp_path / "deb", REUSE="yes")
    for package in packages.values():
        assert (tmp_path / "deb" / package.name).read_bytes() == package.read_bytes(), package.name


def test_the_programs_are_stripped_and_nothing_else_is_changed(packages, tmp_path):
    run("dpkg-deb", "--extract", packages["dipole"], tmp_path)
    program = tmp_path / "usr/bin/dipole"
    assert program.stat().st_size < (BUILD / "dipole").stat().st_size
    assert run(program, "--help") == run(BUILD / "dipole", "--help")
