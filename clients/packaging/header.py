"""A C header as a manual page: its declarations, each with the comment that stands before it."""

from __future__ import annotations

import re

from roff import Page

_COMMENT = re.compile(r"/\*(.*?)\*/[ \t]*\n", re.DOTALL)
_SECTION = re.compile(r"-{4} (.*?) -{4,}")
_GUARDS = re.compile(
    r"#(ifndef|define) \w+_H\n|#include .*\n|#ifdef __cplusplus\n(?:.*\n)*?#endif\n|#endif\n"
)


def about(text: str) -> str:
    """What the first comment says that the header is."""
    return re.match(r"/\*\s*\w+: (.*?)[.:\n]", text)[1]


def write(text: str, page: Page) -> None:
    first = _COMMENT.match(text)
    page.heading("Description")
    _write_comment(first[1].split("\n", 1)[1], page)
    page.heading("Declarations")
    rest = _GUARDS.sub("", text[first.end() :])
    while rest := rest.lstrip("\n"):
        comment = _COMMENT.match(rest)
        rest = rest[comment.end() :] if comment else rest
        section = _SECTION.search(comment[1]) if comment else None
        if section:
            page.subheading(section[1].capitalize())
            continue
        code, rest = _split_code(rest)
        if code:
            page.example(code, bold=True)
        if comment:
            if code:
                page.indent()
            _write_comment(comment[1], page)
            if code:
                page.outdent()


def _split_code(text: str) -> tuple[list[str], str]:
    """The lines up to an empty one or a comment outside of all braces, and what follows."""
    lines: list[str] = []
    depth = 0
    rest = text.split("\n")
    while rest and (depth > 0 or (rest[0].strip() and not rest[0].startswith("/*"))):
        line = rest.pop(0)
        code = re.sub(r"/\*.*?(\*/|$)", "", line)
        depth += code.count("{") - code.count("}")
        lines.append(line)
    return lines, "\n".join(rest)


def _write_comment(comment: str, page: Page) -> None:
    """Paragraphs; lines that are indented more are left as they are."""
    lines = [re.sub(r"^ ?\*? ?", "", line).rstrip() for line in comment.split("\n")]
    while lines:
        if not lines[0]:
            lines.pop(0)
            continue
        literal = lines[0].startswith("  ")
        block = []
        while lines and lines[0] and lines[0].startswith("  ") == literal:
            block.append(lines.pop(0))
        if literal:
            least = min(len(line) - len(line.lstrip()) for line in block)
            page.example([line[least:] for line in block])
        else:
            page.paragraph(" ".join(line.strip() for line in block))
