"""What `--help` of dipole and dipoled says, taken apart."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

_OPTION = re.compile(r"  --([a-z][a-z0-9-]*)(?: ([A-Z[]\S*))?(?: +(\S.*))?$")
_COMMAND = re.compile(r"  ([a-z][a-z0-9-]*) +(\S.*)$")


@dataclass(frozen=True)
class Entry:
    """An option or a command: its name, what its value is called (None: it has none) and what is
    said about it."""

    name: str
    value: str | None
    about: str


@dataclass
class Section:
    """A heading with what stands indented below it: options, commands, or lines as they are."""

    title: str
    options: list[Entry] = field(default_factory=list)
    commands: list[Entry] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)


@dataclass
class Help:
    """usage: without `Usage:`; paragraphs: in their order; sections: likewise."""

    usage: str = ""
    paragraphs: list[str] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)

    def options(self) -> list[Entry]:
        return [option for section in self.sections for option in section.options]

    def commands(self) -> list[Entry]:
        return [command for section in self.sections for command in section.commands]


def ask(program: Path, *arguments: str) -> str:
    """What a program writes to standard output."""
    run = subprocess.run([program, *arguments], capture_output=True, text=True, check=True)
    return run.stdout


def of(program: Path, *command: str) -> Help:
    """The help of a program or of one of its commands."""
    return parse(ask(program, *command, "--help"))


def parse(text: str) -> Help:
    told = Help()
    for block in re.split(r"\n\n+", text.strip("\n")):
        lines = block.splitlines()
        usage = re.match(r"usage: (.*)", block, re.IGNORECASE | re.DOTALL)
        if usage:
            told.usage = " ".join(usage[1].split())
        elif len(lines) > 1 and lines[1].startswith("  ") and not lines[0].startswith(" "):
            told.sections.append(_section(lines[0].rstrip(":"), lines[1:]))
        else:
            told.paragraphs.append(" ".join(line.strip() for line in lines))
    return told


def _section(title: str, lines: list[str]) -> Section:
    section = Section(title)
    for pattern, found in ((_OPTION, section.options), (_COMMAND, section.commands)):
        if title.lower().startswith("example"):
            break
        entries = _entries(pattern, lines)
        if entries is not None:
            found += entries
            return section
    section.lines = [line[2:] for line in lines]
    return section


def _entries(pattern: re.Pattern, lines: list[str]) -> list[Entry] | None:
    """The entries that the lines are, continued by those that are indented more; None: they are
    something else."""
    entries: list[Entry] = []
    for line in lines:
        match = pattern.match(line)
        if match:
            name, *value, about = match.groups()
            entries.append(Entry(name, value[0] if value else None, about or ""))
        elif entries and line.startswith("    "):
            last = entries.pop()
            about = f"{last.about} {line.strip()}".strip()
            entries.append(Entry(last.name, last.value, about))
        else:
            return None
    return entries
