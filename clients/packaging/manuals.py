"""manuals.py BUILD VERSION: the manual pages, into BUILD/manuals: from what the programs in BUILD
say of themselves, from the library's header and from the texts on the protocol. The same sources
give the same pages: their date is that of the version."""

from __future__ import annotations

import re
import sys
from email.utils import parsedate_to_datetime
from pathlib import Path

import header
import helptext
import markdown
from roff import Page, escape

HERE = Path(__file__).resolve().parent
TREE = HERE.parents[1]
PROTO = {"dipole-protocol": "PROTOCOL.md", "dipole-registers": "REGISTERS.md"}
SECTIONS = {"dipoled": 8, "dipole": 1, "libdipole": 3, **dict.fromkeys(PROTO, 7)}


def date() -> str:
    """Of the newest version in the changelog."""
    newest = re.search(r"^ -- .*>  (.*)$", (HERE / "debian/changelog").read_text(), re.M)[1]
    return parsedate_to_datetime(newest).date().isoformat()


def pages() -> dict[str, int]:
    """Names and sections; a text that is not there has no page."""
    missing = {name for name, text in PROTO.items() if not (TREE / "proto" / text).exists()}
    return {name: section for name, section in SECTIONS.items() if name not in missing}


def see_also(page: Page, name: str) -> None:
    others = [rf"\fB{escape(other)}\fR({at})" for other, at in pages().items() if other != name]
    page.heading("See also")
    page.raw_paragraph(", ".join(others))


# ---- programs ------------------------------------------------------------------------------------


def lower(sentence: str) -> str:
    """As the second half of `name - what it does`."""
    return sentence[0].lower() + sentence[1:].rstrip(".")


def write_usage(usage: str, page: Page) -> None:
    page.heading("Synopsis")
    name, rest = usage.split(" ", 1)
    page.raw_paragraph(rf"\fB{escape(name)}\fR {escape(rest)}")


def write_entries(section: helptext.Section, page: Page) -> None:
    for option in section.options:
        value = rf" \fI{escape(option.value)}\fR" if option.value else ""
        page.term(rf"\fB\-\-{escape(option.name)}\fR{value}", option.about)
    for command in section.commands:
        page.term(rf"\fB{escape(command.name)}\fR", command.about)
    if section.lines:
        page.example(section.lines)


def is_example(section: helptext.Section) -> bool:
    return section.title.lower() == "examples"


def write_paragraphs(told: helptext.Help, page: Page) -> None:
    """Those about the exit status apart."""
    status = [text for text in told.paragraphs if text.startswith("Exit status: ")]
    page.heading("Description")
    for text in told.paragraphs:
        if text not in status:
            page.paragraph(text)
    for text in status:
        page.heading("Exit status")
        page.paragraph(text.removeprefix("Exit status: ").capitalize())


def write_daemon(build: Path, version: str) -> Page:
    told = helptext.of(build / "dipoled")
    about = told.paragraphs.pop(0).split(": ", 1)[1]
    page = Page("dipoled", 8, lower(about), version, date())
    write_usage(told.usage, page)
    write_paragraphs(told, page)
    for section in sorted(told.sections, key=is_example):
        page.heading(section.title)
        write_entries(section, page)
    return page


class Commands:
    """The commands of dipole: what all say alike is said once."""

    def __init__(self, build: Path):
        self.main = helptext.of(build / "dipole")
        names = [command.name for command in self.main.commands() if command.name != "help"]
        self.of = {name: helptext.of(build / "dipole", name) for name in names}
        self._all = list(self.of.values())

    def own(self, section: helptext.Section) -> helptext.Section:
        """Without the options that all commands have alike."""
        options = [option for option in section.options if not self.in_all(option)]
        return helptext.Section(section.title, options, lines=section.lines)

    def is_shared(self, section: helptext.Section) -> bool:
        """The same in several commands, and long."""
        same = sum(section in told.sections for told in self._all)
        return same > 1 and len(self.own(section).options) > 1

    def in_all(self, option: helptext.Entry) -> bool:
        return all(option in told.options() for told in self._all)

    def paragraphs_of_all(self) -> list[str]:
        return [p for p in self._all[0].paragraphs if all(p in t.paragraphs for t in self._all)]

    def shared_sections(self) -> list[helptext.Section]:
        found: list[helptext.Section] = []
        for told in self._all:
            found += [s for s in told.sections if self.is_shared(s) and s not in found]
        return found

    def options_of_all(self) -> list[helptext.Entry]:
        return [option for option in self._all[0].options() if self.in_all(option)]


def write_command(commands: Commands, name: str, page: Page) -> None:
    told = commands.of[name]
    page.subheading(told.usage)
    for text in told.paragraphs:
        if text not in commands.paragraphs_of_all():
            page.paragraph(text)
    for section in told.sections:
        if is_example(section):
            page.paragraph("**Examples**")
            page.example(section.lines)
        elif commands.is_shared(section):
            page.paragraph(f"**{section.title}**: see below.")
        elif (own := commands.own(section)) == section:
            page.paragraph(f"**{section.title}**")
            write_entries(own, page)
        else:
            page.paragraph(f"**{section.title}**: see below" + ("; here" if own.options else ""))
            write_entries(own, page)


def write_client(build: Path, version: str) -> Page:
    commands = Commands(build)
    about = re.match(r"(.*?)[:.]", commands.main.paragraphs[0])[1]
    page = Page("dipole", 1, lower(about), version, date())
    write_usage(commands.main.usage, page)
    write_paragraphs(commands.main, page)
    for section in commands.main.sections:
        page.heading(section.title)
        write_entries(section, page)
    page.heading("The commands one by one")
    for name in commands.of:
        write_command(commands, name, page)
    for section in commands.shared_sections():
        page.heading(section.title)
        write_entries(section, page)
    page.heading("Options of all commands")
    write_entries(helptext.Section("", commands.options_of_all()), page)
    for text in commands.paragraphs_of_all():
        title, _, rest = text.partition(": ")
        page.heading(title)
        page.paragraph(rest)
    return page


# ---- texts ---------------------------------------------------------------------------------------


def write_library(version: str) -> Page:
    text = (TREE / "clients/c/dipole.h").read_text()
    page = Page("libdipole", 3, header.about(text), version, date())
    page.heading("Synopsis")
    page.example(["#include <dipole.h>", "", "cc ... $(pkg-config --cflags --libs dipole)"], True)
    header.write(text, page)
    return page


def write_text(name: str, version: str) -> Page:
    text = (TREE / "proto" / PROTO[name]).read_text()
    page = Page(name, SECTIONS[name], lower(markdown.title(text)), version, date())
    markdown.write(text, page)
    return page


def write(name: str, build: Path, version: str) -> Page:
    if name in PROTO:
        return write_text(name, version)
    if name == "libdipole":
        return write_library(version)
    return write_daemon(build, version) if name == "dipoled" else write_client(build, version)


def main() -> None:
    build, version = Path(sys.argv[1]).resolve(), sys.argv[2]
    folder = build / "manuals"
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        old.unlink()
    for name, section in pages().items():
        page = write(name, build, version)
        see_also(page, name)
        (folder / f"{name}.{section}").write_text(page.text())


if __name__ == "__main__":
    main()
