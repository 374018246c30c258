"""The manual pages: complete, without a formatter's warning, and the same each time."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from daemons import BUILD, REPOSITORY
from installing import make, needs, run

sys.path.insert(0, str(REPOSITORY / "clients/packaging"))

import markdown  # noqa: E402  (needs the path above)
from roff import Page  # noqa: E402

SECTIONS = {"dipoled": 8, "dipole": 1, "libdipole": 3, "dipole-protocol": 7}


@pytest.fixture(scope="module")
def folder() -> Path:
    make("manuals")
    return BUILD / "manuals"


def pages(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.[1-9]"))


def shown(page: Path) -> str:
    """A page as somebody reads it, on lines that are long enough for names to stay whole."""
    env = {"MANWIDTH": "200", "LC_ALL": "C.UTF-8", "MAN_KEEP_FORMATTING": ""}
    return run("man", "-P", "cat", "-l", page, env=env)


def hear_warnings(page: Path) -> None:
    """Fails where the formatter says anything, for paper or for a narrow terminal."""
    env = {"LC_ALL": "C.UTF-8", "MANWIDTH": "80"}
    run("man", "--warnings", "-E", "UTF-8", "-l", "-Tutf8", "-Z", page, env={"LC_ALL": "C.UTF-8"})
    run("man", "--warnings", "-P", "cat", "-l", page, env=env)


def test_there_is_a_page_for_each(folder):
    names = {page.name for page in pages(folder)}
    wanted = {f"{name}.{section}" for name, section in SECTIONS.items()}
    if (REPOSITORY / "proto/REGISTERS.md").exists():
        wanted.add("dipole-registers.7")
    assert names == wanted


def test_no_page_makes_the_formatter_warn(folder):
    needs("man")
    for page in pages(folder):
        hear_warnings(page)


def test_pages_can_be_found_by_their_names(folder):
    needs("lexgrog")
    for page in pages(folder):
        assert run("lexgrog", page).startswith(f'{page}: "{page.stem} - ')


def test_the_same_sources_give_the_same_pages(folder, tmp_path):
    version = re.search(r"^VERSION := (\S+)", (REPOSITORY / "Makefile").read_text(), re.M)[1]
    for program in ("dipoled", "dipole"):
        (tmp_path / program).symlink_to(BUILD / program)
    run(sys.executable, REPOSITORY / "clients/packaging/manuals.py", tmp_path, version)
    again = {page.name: page.read_bytes() for page in pages(tmp_path / "manuals")}
    assert again == {page.name: page.read_bytes() for page in pages(folder)}


@pytest.mark.parametrize("program, section", [("dipoled", 8), ("dipole", 1)])
def test_pages_of_programs_hold_what_help_says(folder, program, section):
    """Every word of it, but for headings' case."""
    needs("man")
    text = shown(folder / f"{program}.{section}").lower()
    helps = [run(BUILD / program, "--help")]
    if program == "dipole":
        commands = re.findall(r"^  ([a-z]+) +[A-Z]", helps[0], re.M)
        assert len(commands) > 5
        helps += [run(BUILD / program, name, "--help") for name in commands if name != "help"]
    said = " ".join(helps).lower().replace("`", "")
    missing = {word for word in said.split() if word not in text} - {"usage:"}
    assert {word for word in missing if word.rstrip(":.") not in text} == set()


def test_the_page_of_the_library_holds_its_functions(folder):
    needs("man")
    text = shown(folder / "libdipole.3")
    functions = re.findall(r"\b(dipole_\w+)\(", (REPOSITORY / "clients/c/dipole.h").read_text())
    assert len(functions) > 20
    assert [name for name in functions if f"{name}(" not in text] == []
    assert "/*" not in text.split("DECLARATIONS")[0] and "#ifndef" not in text
    assert "extern" not in text


def test_the_pages_of_texts_hold_their_words(folder):
    needs("man")
    for page in folder.glob("dipole-*.7"):
        name = page.stem.removeprefix("dipole-").upper()
        source = (REPOSITORY / f"proto/{name}.md").read_text()
        words = set(re.findall(r"\b[a-z_]{4,}\b", re.sub(r"<!--.*?-->|```.*", "", source)))
        page_text = shown(page).replace("\n", " ").lower()  # headings are in capitals
        folded = re.sub(r"\s+", "", page_text)
        assert {word for word in words if word not in page_text and word not in folded} == set()


MARKDOWN = """# Of everything

Text with `code`, **bold**, *italic*, a [link](https://example.org/x) and a \\ and 3 - 2 ^ 1.

## Part
- one
  goes on
- **two.** more
  - two a
  - two b

  paragraph
1. first
2. second

### Below
| name | meaning |
|---|---|
| `a_b` | .starts with a dot |
| _ | a × b |

| address | name | type | access | meaning |
|---|---|---|---|---|
| 0x0010 | `sigma_a_of_the_first_channel` | f32 | read, write | what it says, at some length |
| 0x0012 | `g` | f32 | read, write | mean cosine of the scattering angle |

| address | registers | name | type | access | unit | meaning |
|---|---|---|---|---|---|---|
| 0x0010 to 0x00ff | 2 for each | `sigma_a_all` | f32 | read, write | 1/mm | so wide that it is a list |

```c
.line 'as it is' \\n
```
"""


def test_each_form_of_markdown(tmp_path):
    needs("man")
    page = Page("everything", 7, "of everything", "1.2.3", "2026-01-01")
    assert markdown.title(MARKDOWN) == "Of everything"
    markdown.write(MARKDOWN, page)
    path = tmp_path / "everything.7"
    path.write_text(page.text())
    hear_warnings(path)
    text = shown(path)
    for words in (
        "everything - of everything",
        "Text with code, bold, italic, a link <https://example.org/x> and a \\ and 3 - 2 ^ 1.",
        "PART",
        "•  one goes on",
        "•  two. more",
        "•  two b",
        "1.  first",
        "2.  second",
        "a_b    .starts with a dot",
        "_      a × b",
        "0x0010    sigma_a_of_the_   f32    read, write   what it says, at",
        "0x0010 to 0x00ff",
        "registers: 2 for each; name: sigma_a_all; type: f32; access: read, write; unit: 1/mm;",
        ".line 'as it is' \\n",
    ):
        assert words in text, words
    assert "**" not in text and "`" not in text and "|" not in text
