"""The manual pages in the sources are current and complete, and a formatter has no warnings."""

import re
import sys
from pathlib import Path

import pytest
from daemons import BUILD, REPOSITORY
from installing import needs, run

NAMES = {"dipoled.8", "dipole.1", "libdipole.3", "dipole-protocol.7", "dipole-registers.7", "dipole-scpi.7"}
FOLDER = REPOSITORY / "clients/packaging/man"
PAGES = sorted(FOLDER.iterdir())


def shown(page: Path) -> str:
    """Formats a page as a reader sees it, with lines long enough not to break names."""
    env = {"MANWIDTH": "200", "LC_ALL": "C.UTF-8", "MAN_KEEP_FORMATTING": ""}
    return run("man", "-P", "cat", "-l", page, env=env)


def hear_warnings(page: Path) -> None:
    """Checks that the formatter gives no warning, neither for paper nor for a narrow terminal."""
    env = {"LC_ALL": "C.UTF-8", "MANWIDTH": "80"}
    run("man", "--warnings", "-E", "UTF-8", "-l", "-Tutf8", "-Z", page, env={"LC_ALL": "C.UTF-8"})
    run("man", "--warnings", "-P", "cat", "-l", page, env=env)


def test_there_is_a_page_for_each():
    assert {page.name for page in PAGES} == NAMES


def test_pages_are_current(tmp_path):
    needs("pandoc")
    run(sys.executable, REPOSITORY / "clients/packaging/manuals.py", BUILD, tmp_path)
    made = {page.name: page.read_text() for page in tmp_path.iterdir()}
    stale = [page.name for page in PAGES if made.pop(page.name) != page.read_text()]
    assert stale == [] and made == {}, "run `make docs` and commit what it changes"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_page_makes_the_formatter_warn(page):
    needs("man", "lexgrog")
    hear_warnings(page)
    assert run("lexgrog", page).startswith(f'{page}: "{page.stem} - ')


@pytest.mark.parametrize("program, section", [("dipoled", 8), ("dipole", 1)])
def test_pages_of_programs_hold_what_help_says(program, section):
    """A program's manual page has every word of its help text. Only headings differ in case."""
    needs("man")
    text = shown(FOLDER / f"{program}.{section}").lower()
    helps = [run(BUILD / program, "--help")]
    if program == "dipole":
        commands = re.findall(r"^  ([a-z]+) +[A-Z]", helps[0], re.M)
        assert len(commands) > 5
        helps += [run(BUILD / program, name, "--help") for name in commands if name != "help"]
    said = " ".join(helps).lower().replace("`", "")
    missing = {word for word in said.split() if word not in text} - {"usage:"}
    assert {word for word in missing if word.rstrip(":.") not in text} == set()


def test_the_page_of_the_library_holds_its_functions():
    needs("man")
    text = shown(FOLDER / "libdipole.3")
    functions = re.findall(r"\b(dipole_\w+)\(", (REPOSITORY / "clients/c/dipole.h").read_text())
    assert len(functions) > 20
    assert [name for name in functions if f"{name}(" not in text] == []
    assert "/*" not in text.split("DECLARATIONS")[0] and "#ifndef" not in text
    assert "extern" not in text


def test_the_pages_of_texts_hold_their_words():
    needs("man")
    for page in FOLDER.glob("dipole-*.7"):
        name = page.stem.removeprefix("dipole-").upper()
        source = (REPOSITORY / f"proto/{name}.md").read_text()
        words = set(re.findall(r"\b[a-z_]{4,}\b", re.sub(r"<!--.*?-->|```.*", "", source)))
        page_text = shown(page).replace("\n", " ").lower()  # Headings are in capitals.
        folded = re.sub(r"\s+", "", page_text)
        assert {word for word in words if word not in page_text and word not in folded} == set()


def test_tables_and_lists_keep_their_form():
    needs("man")
    text = shown(FOLDER / "dipole-registers.7")
    assert re.search(r"^ +sigma_a\b|name: sigma_a;", text, re.M)  # a row of a wide table
    assert re.search(r"^ +1\. +\S", text, re.M) and re.search(r"^ +• +\S", text, re.M)
    assert "|---|" not in text and "**" not in text
