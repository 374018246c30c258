"""Text as the formatters of manual pages want it: man(7) macros, tables by tbl(1)."""

from __future__ import annotations

import re

_ESCAPES = {
    "\\": r"\e",
    "-": r"\-",
    "^": r"\(ha",
    "~": r"\(ti",
    "`": r"\(ga",
    "'": r"\(aq",
    '"': r"\(dq",
}
_INLINE = re.compile(
    r"`(?P<code>[^`]+)`"
    r"|\*\*(?P<bold>.+?)\*\*"
    r"|!?\[(?P<link>[^]]*)\]\((?P<url>[^)]*)\)"
    r"|\*(?P<italic>[^*\s](?:[^*]*[^*\s])?)\*"
)
LINE_COLUMNS = 70  # of text on a terminal with 80
_WRAPPED_COLUMNS = 22  # a column of a table that is wider may be wrapped
_GAP_COLUMNS = 3  # between the columns


def escape(text: str) -> str:
    """Characters that stand for themselves on the page, also in ASCII sources."""
    return "".join(
        _ESCAPES.get(c, c if c.isascii() else rf"\[u{ord(c):04X}]") for c in text
    )


def inline(text: str, font: str = "R") -> str:
    """Escapes text, with `code`, **bold**, *italic* and [links](url) as in Markdown."""
    parts, at = [], 0
    for match in _INLINE.finditer(text):
        parts.append(escape(text[at : match.start()]))
        at = match.end()
        if match["code"] is not None:
            parts.append(rf"\fB{escape(match['code'])}\f{font}")
        elif match["bold"] is not None:
            parts.append(rf"\fB{inline(match['bold'], 'B')}\f{font}")
        elif match["italic"] is not None:
            parts.append(rf"\fI{inline(match['italic'], 'I')}\f{font}")
        else:
            parts.append(inline(match["link"], font))
            if match["url"].startswith("http") and match["url"] != match["link"]:
                parts.append(f" <{escape(match['url'])}>")
    parts.append(escape(text[at:]))
    return "".join(parts)


def _guard(line: str) -> str:
    """A line that starts with a dot would be taken for a macro."""
    return rf"\&{line}" if line.startswith((".", "'")) else line


class Page:
    """A manual page that is being written."""

    def __init__(self, name: str, section: int, about: str, version: str, date: str):
        title = f'.TH "{escape(name.upper())}" {section} {date} "dipoled {version}"'
        # Lines are neither hyphenated nor adjusted: names and formulas stay in one piece.
        self._lines = ["'\\\" t", ".nr HY 0", title, ".nh", ".ad l"]
        self.heading("Name")
        self._lines.append(rf"{escape(name)} \- {escape(about)}")

    def text(self) -> str:
        return "\n".join(self._lines) + "\n"

    def heading(self, title: str) -> None:
        self._lines.append(f".SH {inline(title.upper())}")

    def subheading(self, title: str) -> None:
        self._lines.append(f".SS {inline(title)}")

    def paragraph(self, text: str) -> None:
        self._lines += [".PP", _guard(inline(text))]

    def raw_paragraph(self, roff: str) -> None:
        """Text that is escaped already."""
        self._lines += [".PP", _guard(roff)]

    def term(self, roff_title: str, text: str) -> None:
        """A title, escaped already, and its explanation."""
        self._lines += [".TP", _guard(roff_title), _guard(inline(text)) or r"\&"]

    def item(self, mark: str, text: str) -> None:
        """One of a list; mark: a bullet or a number."""
        self._lines += [f".IP {mark} {3 if mark.startswith(chr(92)) else 4}", _guard(inline(text))]

    def indent(self) -> None:
        self._lines.append(".RS 4")

    def outdent(self) -> None:
        self._lines.append(".RE")

    def example(self, lines: list[str], bold: bool = False) -> None:
        """Lines as they are."""
        self._lines += [".PP", ".RS 4", ".EX"]
        for line in lines:
            shown = _guard(escape(line))
            self._lines.append(rf"\fB{shown}\fR" if bold and line else shown)
        self._lines += [".EE", ".RE"]

    def table(self, rows: list[list[str]]) -> None:
        """Rows of Markdown cells; the first is the heading."""
        columns = max(map(len, rows))
        rows = [row + [""] * (columns - len(row)) for row in rows]
        widths = _widths(rows)
        if widths is None:
            self._rows_as_list(rows)
            return
        layout = " ".join("l" if width is None else f"lw({width}n)" for width in widths)
        self._lines += [".PP", ".TS", "nokeep;", " ".join(["lb"] * columns), f"{layout}."]
        for row in rows:
            cells = [_cell(cell, width) for cell, width in zip(row, widths)]
            self._lines.append("\t".join(cells))
        self._lines.append(".TE")

    def _rows_as_list(self, rows: list[list[str]]) -> None:
        """A table that is too wide: each row by itself, with the headings."""
        for row in rows[1:]:
            told = [f"{title}: {cell}" for title, cell in zip(rows[0][1:], row[1:]) if cell]
            self.term(inline(f"**{row[0]}**"), "; ".join(told))


_BREAK = re.compile(r"(?<=\w)([_/])(?=\w)")  # long names may go on in the next line behind these


def _widths(rows: list[list[str]]) -> list[int | None] | None:
    """How wide the columns of a table are, in characters; of one whose cells need no wrapping, None.
    None for all: the table does not fit."""
    columns = [[_plain(row[i]) for row in rows] for i in range(len(rows[0]))]
    natural = [max(map(len, column)) for column in columns]
    free = LINE_COLUMNS - _GAP_COLUMNS * (len(columns) - 1)
    if sum(natural) <= free:
        return [None] * len(columns)
    wrapped = [i for i, width in enumerate(natural) if width > _WRAPPED_COLUMNS]
    wrapped = wrapped or [len(columns) - 1]
    free -= sum(width for i, width in enumerate(natural) if i not in wrapped)
    for cut in (r"\1", r"\1 "):  # with names in one piece, else with names that are cut
        cells = {i: " ".join(_BREAK.sub(cut, cell) for cell in columns[i]) for i in wrapped}
        least = {i: max(map(len, cells[i].split()), default=0) for i in wrapped}
        spare = free - sum(least.values())
        if spare >= 0:
            wish = sum(natural[i] - least[i] for i in wrapped) or 1
            shares = {i: least[i] + spare * (natural[i] - least[i]) // wish for i in wrapped}
            return [shares.get(i) for i in range(len(columns))]
    return None


def _plain(cell: str) -> str:
    """A cell as it shows, a character for a character."""
    return _shown(inline(cell))


def _shown(roff: str) -> str:
    return re.sub(r"\\(\(..|\[[^]]*\]|.)", "x", re.sub(r"\\f.", "", roff))


def _cell(cell: str, width: int | None) -> str:
    """width: of a column that is wrapped. Names that are longer may be cut there."""
    roff = inline(cell)
    if width is not None and roff:
        words = [
            _BREAK.sub(r"\1\\:", word) if len(_shown(word)) > width else word
            for word in roff.split(" ")
        ]
        return "T{\n" + _guard(" ".join(words)) + "\nT}"
    return rf"\&{roff}" if roff in ("_", "=") or roff.startswith(".") else roff
