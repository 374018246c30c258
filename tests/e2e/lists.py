"""Reads the lists of X macros from which the daemon is built, so that tests cover a new entry
without a change here. Asks a daemon what the lists do not say about a model."""

import atexit
import functools
import math
import re
from collections.abc import Sequence
from typing import NamedTuple

import dipole
from daemons import REPOSITORY, Daemon
from frames import SKIN


def read_list(path: str) -> str:
    """Reads a list of X macros, without its comments and with its lines joined."""
    text = (REPOSITORY / path).read_text()
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    return re.sub(r"\\\n", " ", text)


def entries(of: str) -> list[tuple[str, ...]]:
    """The entries of a list of core/choices.def: id, IDENT, name and all that follows."""
    found = re.search(rf"^#define CORE_EACH_{of}\(X, P\)(.*)$", read_list("core/choices.def"), re.M)
    assert found is not None
    return re.findall(r'X\(P, (\d+), (\w+), *"(.*?)", *(.*?)\)(?= *(?:X\(|$))', found[1])


def choices(of: str) -> dict[str, int]:
    """Returns the ids by name of a list of core/choices.def."""
    return {name: int(number) for number, _, name, _ in entries(of)}


class Parameter(NamedTuple):
    """A parameter of requests: its id and its range."""

    id: int
    least: float
    most: float


class Moments(NamedTuple):
    """A kind of Fresnel moments, and the range of eta for which it holds."""

    id: int
    eta_min: float
    eta_max: float


MODELS = {
    name: int(number)
    for number, name in re.findall(r'(?:MODEL|SUM)\((\d+), \w+, "(.*?)"', read_list("core/models.def"))
}
MOMENTS = {
    name: Moments(int(number), *map(float, rest.split(",")[-2:]))
    for number, _, name, rest in entries("MOMENTS")
}
EVALUATORS = choices("EVALUATOR")
_PARAMETERS = {
    name: (Parameter(int(number), *map(float, rest.split(",")[-2:])), rest.strip('"'))
    for number, _, name, rest in entries("PARAMETER")
}
# The parameters of profiles, and those that only mc or fit takes.
MC_PARAMETERS, FIT_PARAMETERS = (
    {name: one for name, (one, about) in _PARAMETERS.items() if re.match(rf"of {kind}\b", about)}
    for kind in ("mc", "fit")
)
OTHER_PARAMETERS = {**MC_PARAMETERS, **FIT_PARAMETERS}
PARAMETERS = {name: one for name, (one, _) in _PARAMETERS.items() if name not in OTHER_PARAMETERS}
NOTES = choices("NOTE")
QUANTITIES = choices("QUANTITY")
BALANCE = QUANTITIES["balance"]  # of transport alone


# ---- what only a daemon can tell -----------------------------------------------------------------


@functools.cache
def asked() -> dipole.Client:
    """Returns a client of a separate daemon, which answers questions about models."""
    daemon = Daemon()
    atexit.register(daemon.close)
    client = daemon.client()
    atexit.register(client.close)
    return client


def some_value(name: str) -> float:
    """Returns a value within a parameter's range."""
    parameter = PARAMETERS[name]
    return min(max(0.5 if parameter.most <= 1 else 2.0, parameter.least), parameter.most)


@functools.cache
def thickness(model: str) -> float:
    """Returns the thickness of media that a model takes: 0, or that of slabs."""
    try:
        asked().eval(model, SKIN, wanted=["albedo"])
    except dipole.Refused as refusal:
        assert refusal.field == "thickness", refusal
        return 8.0
    return 0.0


def medium_for(model: str, medium: Sequence[float] = SKIN) -> dipole.Medium:
    """Returns the medium as a model takes it."""
    return dipole.Medium(*medium[:4], thickness(model))


@functools.cache
def takes(model: str) -> tuple[str, ...]:
    """Returns the names of the parameters that a model takes. The deadline saves solutions: what is
    taken is late, or answered."""
    taken = []
    for name in PARAMETERS:
        try:
            asked().eval(model, medium_for(model), wanted=["albedo"], deadline_ms=30, parameters={name: some_value(name)})
        except dipole.Refused as refusal:
            if refusal.field == name and refusal.allowed == "nothing: this model does not take it":
                continue
        taken.append(name)
    return tuple(taken)


@functools.cache
def covers(model: str, r: float) -> bool:
    """Returns whether a model can be evaluated at a radius, for the medium SKIN."""
    try:
        asked().eval(model, medium_for(model), [r])
    except dipole.Refused as refusal:
        assert refusal.field == "r", refusal
        return False
    return True


@functools.cache
def everywhere() -> tuple[str, ...]:
    """Returns the models of half spaces that can be evaluated at every radius."""
    return tuple(m for m in MODELS if not thickness(m) and covers(m, 0.0) and covers(m, math.inf))
