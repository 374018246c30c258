"""Runs make and other programs, independently of the make that runs the tests."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from daemons import BUILD, REPOSITORY, environment, finished

TIMEOUT_S = 600.0


def run(*command: str | Path, env: dict[str, str] | None = None, cwd: Path | None = None) -> str:
    """Runs a program, which must succeed and write nothing to standard error. Returns its standard
    output."""
    done = finished(*command, cwd=cwd or REPOSITORY, env={**environment(), **(env or {})}, timeout=TIMEOUT_S)
    assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
    assert "warning" not in done.stderr.lower(), f"{command}: {done.stderr}"
    return done.stdout


def make(target: str, **variables: str | Path) -> None:
    """Makes a target of the Makefile for the build under test."""
    # The flags and the job server of a make that runs the tests must not reach this one.
    kept = {k: "" for k in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES") if k in os.environ}
    # The rules of the Makefile name the build folder relative to the repository.
    build = BUILD.relative_to(REPOSITORY) if BUILD.is_relative_to(REPOSITORY) else BUILD
    given = [f"{name}={value}" for name, value in {"BUILD": build, **variables}.items()]
    run("make", "--no-print-directory", target, *given, env=kept)


def needs(*programs: str) -> None:
    """Skips a test if one of these programs is not installed."""
    for program in programs:
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")


def npm_install(folder: Path, packages: dict[str, str]) -> Path:
    """Installs packages of npm, by name and version, into a folder that keeps them, and returns it.
    Skips the test if they cannot be had."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        pytest.skip("node and npm are not installed")
    folder.mkdir(parents=True, exist_ok=True)
    if not all((folder / "node_modules" / name).is_dir() for name in packages):
        wanted = [f"{name}@{version}" for name, version in packages.items()]
        options = ["--no-audit", "--no-fund", "--ignore-scripts", "--omit=optional"]
        try:
            fetched = finished("npm", "install", *options, *wanted, cwd=folder, timeout=TIMEOUT_S)
            failure = fetched.stderr.strip()[-200:] if fetched.returncode else ""
        except subprocess.TimeoutExpired:
            failure = "it takes too long"
        if failure:
            pytest.skip(f"npm cannot install {' '.join(wanted)}: {failure}")
    return folder
