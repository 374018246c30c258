"""packages.py BUILD VERSION SOVERSION FOLDER: Debian packages of what is in BUILD, into FOLDER, in
the place of those that are there. What goes into which package is said by the list `files`; the
rest is in the folder `debian`. The same BUILD gives the same packages: their date is that of the
changelog."""

from __future__ import annotations

import gzip
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from email.utils import parsedate_to_datetime
from pathlib import Path

HERE = Path(__file__).resolve().parent
DEBIAN = HERE / "debian"
TREE = HERE.parents[1]


def run(*command: str | Path, **how) -> str:
    """A program's standard output."""
    return subprocess.run(command, check=True, text=True, stdout=subprocess.PIPE, **how).stdout


def fail(what: str) -> None:
    sys.exit(f"packages.py: {what}")


# ---- what the packages are made from -------------------------------------------------------------


def paragraphs() -> list[dict[str, str]]:
    """Those of debian/control."""
    found = []
    for text in (DEBIAN / "control").read_text().strip().split("\n\n"):
        fields = re.findall(r"^(\S+): (.*(?:\n .*)*)", text, re.M)
        found.append(dict(fields))
    return found


def places(architecture: str) -> dict[str, str]:
    """Where Debian has things."""
    return {
        "PREFIX": "/usr",
        "BINDIR": "/usr/bin",
        "LIBDIR": f"/usr/lib/{architecture}",
        "INCLUDEDIR": "/usr/include",
        "MANDIR": "/usr/share/man",
        "DOCDIR": "/usr/share/doc",
        "UNITDIR": "/lib/systemd/system",
        "BASHDIR": "/usr/share/bash-completion/completions",
        "ZSHDIR": "/usr/share/zsh/vendor-completions",
        "PYTHONDIR": "/usr/lib/python3/dist-packages",
    }


def copyright_text() -> str:
    """Debian's form of LICENSE."""
    title, owner, *rest = (TREE / "LICENSE").read_text().strip().split("\n\n")
    body = "\n .\n".join(
        "\n".join(f" {line}" for line in paragraph.split("\n")) for paragraph in rest
    )
    owner = owner.removeprefix("Copyright (c) ")
    name = "Expat" if title == "MIT License" else fail("debian/copyright knows the MIT licence")
    form = "https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/"
    return f"Format: {form}\n\nFiles: *\nCopyright: {owner}\nLicense: {name}\n{body}\n"


# ---- one package ---------------------------------------------------------------------------------


class Package:
    """A package that is being made, in a staged tree."""

    def __init__(self, fields: dict[str, str], source: dict[str, str], about: dict[str, str]):
        self.name = fields["Package"]
        self._fields = {**source, **fields}
        self._about = about  # version, soversion, architecture, triplet, build
        self._is_native = fields["Architecture"] == "any"
        self.architecture = about["architecture"] if self._is_native else "all"
        self.root = Path(about["stage"]) / self.name

    def make(self, folder: Path) -> Path:
        self._install()
        self._strip()
        self._compress_manuals()
        self._document()
        self._write_control()
        path = folder / f"{self.name}_{self._about['version']}_{self.architecture}.deb"
        run("dpkg-deb", "--root-owner-group", "-Zxz", "--build", self.root, path)
        return path

    def _install(self) -> None:
        self.root.mkdir()
        env = {
            **os.environ,
            **places(self._about["triplet"]),
            "DESTDIR": str(self.root),
            "BUILD": self._about["build"],
            "VERSION": self._about["version"],
            "SOVERSION": self._about["soversion"],
        }
        run("sh", HERE / "install.sh", "install", self.name, env=env)

    def _files(self) -> list[Path]:
        inside = (path for path in sorted(self.root.rglob("*")) if "DEBIAN" not in path.parts)
        return [path for path in inside if path.is_file() and not path.is_symlink()]

    def _elf_files(self) -> list[Path]:
        return [path for path in self._files() if path.read_bytes()[:4] == b"\x7fELF"]

    def _strip(self) -> None:
        for path in self._elf_files():
            run("strip", "--strip-unneeded", "-R", ".comment", "-R", ".note", path)
        for path in self.root.rglob("*.a"):
            run("strip", "--strip-debug", "-R", ".comment", "--enable-deterministic-archives", path)

    def _compress_manuals(self) -> None:
        for path in (self.root / "usr/share/man").rglob("*.[1-9]"):
            _write_gzip(path.with_name(path.name + ".gz"), path.read_bytes())
            path.unlink()

    def _document(self) -> None:
        folder = self.root / "usr/share/doc" / self.name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "copyright").write_text(copyright_text())
        _write_gzip(folder / "changelog.gz", (DEBIAN / "changelog").read_bytes())

    def _write_control(self) -> None:
        control = self.root / "DEBIAN"
        control.mkdir()
        sums = [
            f"{hashlib.md5(path.read_bytes()).hexdigest()}  {path.relative_to(self.root)}\n"
            for path in self._files()
        ]
        self._write_library(control)
        for name in ("postinst", "prerm", "postrm", "triggers"):
            path = DEBIAN / f"{self.name}.{name}"
            if path.exists():
                shutil.copyfile(path, control / name)
                (control / name).chmod(0o644 if name == "triggers" else 0o755)
        (control / "md5sums").write_text("".join(sums))
        (control / "control").write_text(self._control())

    def _write_library(self, control: Path) -> None:
        """What packages need to say that use the library."""
        library = next(self.root.rglob("lib*.so.*.*.*"), None)
        if library is None:
            return
        name = library.name.split(".so.")[0]
        least = f"{self.name} (>= {self._about['version']})"
        (control / "shlibs").write_text(f"{name} {self._about['soversion']} {least}\n")
        with _source_folder(self.name) as folder:
            symbols = control / "symbols"
            names = [f"-p{self.name}", f"-v{self._about['version']}"]
            run("dpkg-gensymbols", "-q", *names, f"-e{library}", f"-O{symbols}", cwd=folder)
            head, rest = symbols.read_text().split("\n", 1)
            symbols.write_text(f"{head}\n* Build-Depends-Package: {name}-dev\n{rest}")

    def _control(self) -> str:
        installed_kib = sum(-(-path.lstat().st_size // 1024) for path in self.root.rglob("*"))
        fields = {
            **self._fields,
            "Version": self._about["version"],
            "Architecture": self.architecture,
            "Installed-Size": str(installed_kib),
        }
        if fields["Source"] == self.name:
            del fields["Source"]
        order = ["Package", "Source", "Version", "Architecture", "Maintainer", "Installed-Size"]
        names = [name for name in order if name in fields]
        names += [name for name in fields if name not in names]
        text = "".join(f"{name}: {fields[name]}\n" for name in names)
        text = text.replace("${version}", self._about["version"])
        return text.replace("${shlibs:Depends}", self._libraries())

    def _libraries(self) -> str:
        """Packages of the libraries that its programs are linked to."""
        programs = [f"-e{path}" for path in self._elf_files()]
        if not programs:
            return ""
        with _source_folder(self.name) as folder:
            told = run("dpkg-shlibdeps", "-O", "--ignore-missing-info", *programs, cwd=folder)
        return re.search(r"shlibs:Depends=(.*)", told)[1]


def _write_gzip(path: Path, data: bytes) -> None:
    path.write_bytes(gzip.compress(data, 9, mtime=0))


class _source_folder(tempfile.TemporaryDirectory):
    """Debian's tools want to run in a source package."""

    def __init__(self, name: str):
        super().__init__(prefix="dipoled-deb-")
        debian = Path(self.name) / "debian"
        debian.mkdir()
        (debian / "control").write_text(f"Source: dipoled\n\nPackage: {name}\nArchitecture: any\n")


def main() -> None:
    build, version, soversion, into = sys.argv[1:]
    newest = re.match(r"(\S+) \((.*?)\)", changelog := (DEBIAN / "changelog").read_text())[2]
    if newest != version:
        fail(f"debian/changelog begins with version {newest}; the Makefile's is {version}")
    date = parsedate_to_datetime(re.search(r"^ -- .*>  (.*)$", changelog, re.M)[1])
    os.environ["SOURCE_DATE_EPOCH"] = str(int(date.timestamp()))
    os.umask(0o022)
    folder = Path(into).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.deb"):
        old.unlink()
    source, *packages = paragraphs()
    with tempfile.TemporaryDirectory(prefix="dipoled-deb-") as stage:
        about = {
            "build": build,
            "version": version,
            "soversion": soversion,
            "stage": stage,
            "architecture": run("dpkg-architecture", "-qDEB_HOST_ARCH").strip(),
            "triplet": run("dpkg-architecture", "-qDEB_HOST_MULTIARCH").strip(),
        }
        for fields in packages:
            print(os.path.relpath(Package(fields, source, about).make(folder)))


if __name__ == "__main__":
    main()
