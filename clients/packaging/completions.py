"""completions.py BUILD: what bash and zsh need to complete the command lines of dipole and dipoled,
into BUILD/completions: commands and options from --help, the names that they take from a daemon."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import completions_bash
import completions_zsh
import helptext

# Which of a daemon's lists an option takes its names from; models, for one, is such a list of
# `dipole info`.
LISTS = {
    "model": "models",
    "fit-model": "models",
    "evaluator": "evaluators",
    "moments": "moments",
    "want": "quantities",
    "quantity": "quantities",
    "draw": "draws",
    "medium": "media",
}
_ENUMERATIONS = [
    re.compile(r"one of ([\w,]+)"),
    re.compile(r"((?:\w[\w-]*, )*\w[\w-]* or \w[\w-]*)(?:$|\.)"),
    re.compile(r"[\w ]*: ((?:\w+, )+\w+)\."),
]


@dataclass(frozen=True)
class Option:
    """value: what it is called; None: there is none. many: several, separated by commas. kind:
    names, file, address or nothing that is known here."""

    name: str
    value: str | None
    about: str
    kind: str
    names: tuple[str, ...] = ()

    @property
    def many(self) -> bool:
        return self.value is not None and "..." in self.value

    @property
    def value_is_optional(self) -> bool:
        return self.value is not None and self.value.startswith("[")


@dataclass(frozen=True)
class Command:
    """name: "" where no command is given yet, and of a program without commands. operand: kind and
    names, as of an option."""

    name: str
    about: str
    options: tuple[Option, ...]
    operand_kind: str = ""
    operand_names: tuple[str, ...] = ()


def daemon_lists(build: Path) -> dict[str, list[str]]:
    """The names in a daemon's lists."""

    def ask(command: str) -> dict:
        words = (command, "--connect", "private:", "--format", "json")
        return json.loads(helptext.ask(build / "dipole", *words))

    lists = {key: value for key, value in ask("info").items() if isinstance(value, list)}
    media = [entry["medium"] for entry in ask("media")["media"]]
    return {key: [entry["name"] for entry in value] for key, value in lists.items()} | {
        "media": media
    }


def enumeration(about: str) -> tuple[str, ...]:
    """The names that an explanation enumerates: table,csv,json; red, green or blue; NAME: a, b."""
    for pattern in _ENUMERATIONS:
        if match := pattern.match(about):
            return tuple(re.split(r", ?| or ", match[1]))
    return ()


def complete(entry: helptext.Entry, lists: dict[str, list[str]]) -> Option:
    names: tuple[str, ...] = ()
    kind = ""
    if entry.value is not None and "FILE" in entry.value:
        kind = "file"
    elif entry.value in ("ADDRESS", "URL"):
        kind = "address"
        names = tuple(dict.fromkeys(re.findall(r"\b(unix:|tcp:|private:)", entry.about)))
    elif entry.value is not None:
        names = tuple(lists.get(LISTS.get(entry.name, ""), ())) or enumeration(entry.about)
        names = ("all", *names) if names and re.search(r"\ball: ", entry.about) else names
        kind = "names" if names else ""
    return Option(entry.name, entry.value, entry.about, kind, names)


def options(told: helptext.Help, lists: dict[str, list[str]]) -> tuple[Option, ...]:
    return tuple(complete(entry, lists) for entry in told.options())


def client_commands(build: Path) -> list[Command]:
    lists = daemon_lists(build)
    main = helptext.of(build / "dipole")
    names = tuple(entry.name for entry in main.commands())
    commands = [Command("", "", (), "names", names)]
    for entry in main.commands():
        if f"dipole {entry.name} COMMAND" in entry.about:
            commands.append(Command(entry.name, entry.about, (), "names", names))
            continue
        told = helptext.of(build / "dipole", entry.name)
        operand = "file" if told.usage.endswith("FILE]") else ""
        commands.append(Command(entry.name, entry.about, options(told, lists), operand))
    return commands


def daemon_command(build: Path) -> Command:
    return Command("", "", options(helptext.of(build / "dipoled"), {}))


def main() -> None:
    build = Path(sys.argv[1]).resolve()
    folder = build / "completions"
    folder.mkdir(exist_ok=True)
    for program, commands in (
        ("dipole", client_commands(build)),
        ("dipoled", [daemon_command(build)]),
    ):
        (folder / program).write_text(completions_bash.write(program, commands))
        (folder / f"_{program}").write_text(completions_zsh.write(program, commands))


if __name__ == "__main__":
    main()
