"""manuals.py BUILD FOLDER: writes the manual pages into FOLDER.

The pages are made from what the programs in BUILD say on --help, from the comments in dipole.h and
from the texts in proto/. This script turns each into Markdown, and pandoc turns that into a page.
Equal sources give equal pages: their date is that of the newest version in debian/changelog."""

from __future__ import annotations

import re
import subprocess
import sys
from email.utils import parsedate_to_datetime
from pathlib import Path

HERE = Path(__file__).resolve().parent
TREE = HERE.parents[1]
TEXTS = {"dipole-protocol": "proto/PROTOCOL.md", "dipole-registers": "proto/REGISTERS.md",
         "dipole-scpi": "proto/SCPI.md"}
SECTIONS = {"dipoled": 8, "dipole": 1, "libdipole": 3, **dict.fromkeys(TEXTS, 7)}
OPTION = re.compile(r"  (--[a-z][a-z0-9-]*)(?: ([A-Z[]\S*))?(?: +(\S.*))?$")
COMMAND = re.compile(r"  ([a-z][a-z0-9-]*)() +(\S.*)$")
PUNCTUATION = re.compile(r"([^\w\s])")

# ---- Markdown ------------------------------------------------------------------------------------


def plain(text: str) -> str:
    """Returns text on one line, with its punctuation escaped except in `code`."""
    parts = " ".join(text.split()).split("`")
    escaped = [PUNCTUATION.sub(r"\\\1", part) for part in parts[::2]]
    code = [f"`{part}`" for part in parts[1::2]] + [""]
    return "".join(a + b for a, b in zip(escaped, code))


def indented(lines: list[str]) -> str:
    """Returns a block of lines that are shown unchanged."""
    least = min((len(line) - len(line.lstrip()) for line in lines if line.strip()), default=0)
    return "\n" + "".join(f"    {line[least:]}\n" for line in lines) + "\n"


# ---- the programs --------------------------------------------------------------------------------


def help_of(program: Path, *command: str) -> list[list[str]]:
    """Returns the blocks of a help text, which are separated by empty lines."""
    said = subprocess.run(
        [program, *command, "--help"], stdout=subprocess.PIPE, text=True, check=True
    )
    return [block.splitlines() for block in re.split(r"\n\n+", said.stdout.strip("\n"))]


def entries(lines: list[str]) -> list[tuple[str, str, str]]:
    """Returns names, values and explanations of the options or commands that the lines describe; an
    empty list if they describe something else."""
    found: list[tuple[str, str, str]] = []
    for line in lines:
        match = OPTION.match(line) or COMMAND.match(line)
        if match:
            found.append((match[1], match[2] or "", match[3] or ""))
        elif found and line.startswith("    "):
            name, value, about = found[-1]
            found[-1] = (name, value, f"{about} {line.strip()}".strip())
        else:
            return []
    return found


def is_titled(block: list[str]) -> bool:
    return len(block) > 1 and not block[0].startswith(" ") and block[1].startswith("  ")


def entries_of(blocks: list[list[str]]) -> list[tuple[str, str, str]]:
    return [entry for block in blocks if is_titled(block) for entry in entries(block[1:])]


def show_entries(shown: list[tuple[str, str, str]]) -> str:
    return "".join(
        f"**{plain(name)}**{f' *{plain(value)}*' if value else ''}\n:   {plain(about)}\n\n"
        for name, value, about in shown
    )


def show_blocks(blocks: list[list[str]], level: int, omitted: list = ()) -> str:
    """Returns the blocks of a help text. Its titles become headings of this level. omitted: the
    entries to leave out."""
    text = ""
    for block in sorted(blocks, key=lambda block: "xample" in block[0] and is_titled(block)):
        title = block[0].rstrip(":")
        if usage := re.match(r"usage: +(.*)", " ".join(block), re.IGNORECASE):
            text += f"{'#' * level} Synopsis\n\n`{usage[1]}`\n\n{'#' * level} Description\n\n"
        elif not is_titled(block):
            text += plain(" ".join(block)) + "\n\n"
        elif "xample" in title or not entries(block[1:]):
            text += f"{'#' * level} {plain(title)}\n{indented(block[1:])}"
        elif own := [entry for entry in entries(block[1:]) if entry not in omitted]:
            text += f"{'#' * level} {plain(title)}\n\n{show_entries(own)}"
    return text


def daemon_text(build: Path) -> tuple[str, str]:
    about, *blocks = help_of(build / "dipoled")
    return about[0].split(": ", 1)[1], show_blocks(blocks, 1)


def client_text(build: Path) -> tuple[str, str]:
    """Writes all commands into one page. Options that every command has are described once."""
    blocks = help_of(build / "dipole")
    commands = next(entries(block[1:]) for block in blocks if block[0].startswith("Commands"))
    helps = {name: help_of(build / "dipole", name) for name, _, _ in commands if name != "help"}
    options = [entries_of(blocks) for blocks in helps.values()]
    common = [entry for entry in options[0] if all(entry in others for others in options)]
    text = show_blocks(blocks, 1)
    for name, of_command in helps.items():
        text += f"# Dipole {name}\n\n{show_blocks(of_command, 2, common)}"
    text += f"# Options of all commands\n\n{show_entries(common)}"
    return re.split(r"[:.]", " ".join(blocks[1]))[0], text


# ---- the library ---------------------------------------------------------------------------------


def comment_text(comment: str) -> str:
    """Returns the paragraphs of a C comment; lines that are indented further stay as they are."""
    lines = [re.sub(r"^ ?\*? ?", "", line).rstrip() for line in comment.split("\n")]
    text = ""
    for block in re.findall(r"(?:^  .*\n?)+|(?:^(?!  ).+\n?)+", "\n".join(lines), re.M):
        shown = block.rstrip("\n").split("\n")
        text += indented(shown) if block.startswith("  ") else plain(" ".join(shown)) + "\n\n"
    return text


def library_text() -> tuple[str, str]:
    """Returns the declarations of the header, each with the comment before it."""
    header = (TREE / "clients/c/dipole.h").read_text()
    about, first, rest = re.match(r"/\*\s*\w+: (.*?)([.:\n].*?)\*/\n(.*)", header, re.S).groups()
    rest = re.sub(r"#(ifndef|define) \w+_H\n|#include .*\n", "", rest)
    rest = re.sub(r"#ifdef __cplusplus\n(?:.*\n)*?#endif\n|#endif.*\n", "", rest)
    text = "# Synopsis\n" + indented(
        ["#include <dipole.h>", "", "cc ... $(pkg-config --cflags --libs dipole)"]
    )
    text += f"# Description\n\n{comment_text(first.split(chr(10), 1)[1])}# Declarations\n\n"
    for comment, code in re.findall(r"^/\*((?:.|\n)*?)\*/\n|((?:^(?!/\*).*\n)+)", rest, re.M):
        if section := re.search(r"-{4} (.*?) -{4,}", comment):
            text += f"## {plain(section[1].capitalize())}\n\n"
        elif comment:
            text += comment_text(comment)
        elif code.strip():
            text += indented(code.strip("\n").split("\n"))
    return about, text


# ---- pages ---------------------------------------------------------------------------------------


def text_of(name: str) -> tuple[str, str]:
    """Returns title and rest of a text in proto/, without comments, and headings a level up."""
    text = re.sub(r"<!--.*?-->\n?", "", (TREE / TEXTS[name]).read_text(), flags=re.DOTALL)
    title, text = re.match(r"# ([^\n]*)\n(.*)", text, re.DOTALL).groups()
    return title, "# Description\n" + re.sub(r"^#(#+ )", r"\1", text, flags=re.M)


def page(name: str, build: Path) -> str:
    if name in TEXTS:
        about, text = text_of(name)
    elif name == "libdipole":
        about, text = library_text()
    else:
        about, text = daemon_text(build) if name == "dipoled" else client_text(build)
    others = ", ".join(f"**{n}**({s})" for n, s in SECTIONS.items() if n != name)
    about = plain(about[0].lower() + about[1:].rstrip("."))
    text = f"# Name\n\n{plain(name)} - {about}\n\n{text}\n# See also\n\n{others}\n"
    version, date = re.match(
        r"\S+ \((.*?)\).*?\n -- .*?>  (.*?)\n", (HERE / "debian/changelog").read_text(), re.S
    ).groups()
    fields = {
        "title": name.upper(),
        "section": SECTIONS[name],
        "date": parsedate_to_datetime(date).date(),
        "footer": f"dipoled {version}",
        "hyphenate": "false",
    }
    command = ["pandoc", "--standalone", f"--lua-filter={HERE / 'manuals.lua'}", "--to=man"]
    command += [f"--from={'gfm' if name in TEXTS else 'markdown'}-smart", "--variable=adjusting:l"]
    command += [f"--metadata={key}:{value}" for key, value in fields.items()]
    return subprocess.run(command, input=text, stdout=subprocess.PIPE, text=True, check=True).stdout


def main() -> None:
    build, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    folder.mkdir(exist_ok=True)
    for name, section in SECTIONS.items():
        (folder / f"{name}.{section}").write_text(page(name, build))


if __name__ == "__main__":
    main()
