"""A text in the Markdown that this project writes, as a manual page: headings, paragraphs, lists,
tables, and code between fences."""

from __future__ import annotations

import re

from roff import Page

_HEADING = re.compile(r"(#+) (.*)")
_ITEM = re.compile(r"( *)([-*]|\d+\.) +(.*)")


def title(text: str) -> str:
    """The first heading."""
    return next(m[2] for m in map(_HEADING.match, text.splitlines()) if m)


def write(text: str, page: Page) -> None:
    """All but the first heading."""
    lines = re.sub(r"<!--.*?-->\n?", "", text, flags=re.DOTALL).splitlines()
    page.heading("Description")
    _Writer(lines, page).run()


class _Writer:
    def __init__(self, lines: list[str], page: Page):
        self._lines = lines
        self._page = page
        self._at = 0
        self._is_titled = False
        self._indents: list[int] = []  # of the lists that are open

    def run(self) -> None:
        while self._at < len(self._lines):
            line = self._lines[self._at]
            if not line.strip():
                self._at += 1
            elif heading := _HEADING.match(line):
                self._heading(len(heading[1]), heading[2])
            elif line.startswith("```"):
                self._fence()
            elif line.lstrip().startswith("|"):
                self._table()
            elif item := _ITEM.match(line):
                self._item(item)
            else:
                self._paragraph()
        self._close_lists(-1)

    def _heading(self, depth: int, text: str) -> None:
        self._close_lists(-1)
        self._at += 1
        if depth == 1 and not self._is_titled:
            self._is_titled = True
        elif depth <= 2:
            self._page.heading(text)
        else:
            self._page.subheading(text)

    def _fence(self) -> None:
        end = self._at + 1
        while end < len(self._lines) and not self._lines[end].startswith("```"):
            end += 1
        self._page.example(self._lines[self._at + 1 : end])
        self._at = end + 1

    def _table(self) -> None:
        self._close_lists(-1)
        rows = []
        while self._at < len(self._lines) and self._lines[self._at].lstrip().startswith("|"):
            cells = re.split(r"(?<!\\)\|", self._lines[self._at].strip().strip("|"))
            self._at += 1
            if not all(re.fullmatch(r"\s*:?-+:?\s*", cell) for cell in cells):
                rows.append([cell.strip().replace(r"\|", "|") for cell in cells])
        self._page.table(rows)

    def _item(self, item: re.Match) -> None:
        indent, mark = len(item[1]), item[2]
        self._close_lists(indent)
        if not self._indents or indent > self._indents[-1]:
            if self._indents:
                self._page.indent()
            self._indents.append(indent)
        self._at += 1
        self._page.item(mark if mark[0].isdigit() else r"\(bu", f"{item[3]} {self._rest()}".strip())

    def _paragraph(self) -> None:
        if not self._lines[self._at].startswith(" "):
            self._close_lists(-1)
        self._page.paragraph(self._rest())

    def _rest(self) -> str:
        """The lines up to the end of a paragraph, joined."""
        lines = []
        while self._at < len(self._lines):
            line = self._lines[self._at]
            if not line.strip() or _HEADING.match(line) or _ITEM.match(line):
                break
            if line.startswith("```") or line.lstrip().startswith("|"):
                break
            lines.append(line.strip())
            self._at += 1
        return " ".join(lines)

    def _close_lists(self, indent: int) -> None:
        """Those that are indented more than this."""
        while self._indents and self._indents[-1] > indent:
            self._indents.pop()
            if self._indents:
                self._page.outdent()
