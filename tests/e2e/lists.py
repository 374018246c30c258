"""The lists of X macros that the daemon is made from, read for comparison: what is added there is
tested without another line here."""

from __future__ import annotations

import re
from typing import NamedTuple

from daemons import REPOSITORY


def read_list(path: str) -> str:
    """A list of X macros without its comments and with its lines joined."""
    text = (REPOSITORY / path).read_text()
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    return re.sub(r"\\\n", " ", text)


def choices(macro: str, path: str = "core/choices.def") -> dict[str, int]:
    """Ids by name of the entries MACRO(id, IDENT, "name", ...)."""
    entries = re.findall(rf'^{macro}\((\d+), [^"]*"(.*?)"', read_list(path), re.M)
    return {name: int(number) for number, name in entries}


class Moments(NamedTuple):
    """A kind of Fresnel moments, and the eta that it holds for."""

    id: int
    eta_min: float
    eta_max: float


MODELS = choices("CORE_MODEL", "core/models.def")
MOMENTS = {
    name: Moments(int(number), float(low), float(high))
    for number, name, low, high in re.findall(
        r'^CORE_MOMENTS\((\d+), \w+, "(.*?)", ([\d.]+), ([\d.]+),',
        read_list("core/choices.def"),
        re.M,
    )
}
EVALUATORS = choices("CORE_EVALUATOR")
