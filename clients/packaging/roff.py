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
_WRAPPED_COLUMNS = 22  # a table's cell that is longer gets lines of its own


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
        widths = [max(len(_plain(row[i])) for row in rows) for i in range(columns)]
        wrapped = [False] * columns
        if sum(widths) + 3 * columns > LINE_COLUMNS:
            wrapped = [width > _WRAPPED_COLUMNS for width in widths]
            wrapped[-1] = wrapped[-1] or not any(wrapped)
        layout = " ".join("lx" if wrap else "l" for wrap in wrapped)
        self._lines += [".PP", ".TS", f"{' '.join('lb' for _ in wrapped)}", f"{layout}."]
        for row in rows:
            cells = [_cell(cell, wrap) for cell, wrap in zip(row, wrapped)]
            self._lines.append("\t".join(cells))
        self._lines.append(".TE")


def _plain(cell: str) -> str:
    """A cell as it shows."""
    return re.sub(r"\\(\(..|\[[^]]*\]|f.|.)", lambda m: "" if m[1][0] == "f" else "x", inline(cell))


def _cell(cell: str, wrap: bool) -> str:
    roff = inline(cell)
    if wrap and roff:
        return "T{\n" + _guard(_breakable(roff)) + "\nT}"
    return rf"\&{roff}" if roff in ("_", "=") or roff.startswith(".") else roff


def _breakable(roff: str) -> str:
    """Long names may go on in the next line, after an underscore or a slash."""
    return re.sub(r"(?<=\w)([_/])(?=\w)", r"\1\\:", roff)
