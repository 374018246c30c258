"""What the arguments of calls have in common: names of the daemon's lists, media and parameters."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

import numpy as np

from . import schema, wire
from .errors import ArgumentError, ProtocolError, naming
from .values import Array, Info, Media, Medium, Stack

T = TypeVar("T")


def id_of(info: Info, kind: str, name: str | int) -> int:
    """Finds the id of a choice by its name. Returns an id unchanged: the daemon checks it."""
    if isinstance(name, str):
        return known(kind, name, info.choices[kind]).id
    if not hasattr(name, "__index__"):
        first = next(iter(info.choices[kind]))
        raise ArgumentError(f"{kind}: a name, such as {first}, or an id; not {name!r}")
    return name


def known(kind: str, name: str, choices: Mapping[str, T]) -> T:
    """Returns the choice of that name. If there is none, the error names the nearest one. A property
    may be named without its unit."""
    if kind == "property" and name not in choices:
        whole = [one for one in choices if one.startswith(f"{name}_")]
        name = whole[0] if len(whole) == 1 else name
    if name not in choices:
        near = difflib.get_close_matches(name, choices, 1)
        hint = f". Did you mean {near[0]}?" if near else ""
        raise ArgumentError(f"{kind} {name}: not one of {', '.join(choices)}{hint}")
    return choices[name]


def name_of(info: Info, kind: str, number: int) -> str:
    """Finds the daemon's name for the id of a choice in a reply."""
    for choice in info.choices[kind].values():
        if choice.id == number:
            return choice.name
    raise ProtocolError(f"a reply with {kind} {number}, which the daemon has not listed")


def ids_of(info: Info, **values: Any) -> dict[str, Any]:
    """Returns the numbers of fields: the id for a choice's name, a sum for several."""
    ids = dict(values)
    for field, value in values.items():
        if field in schema.SUMS and not hasattr(value, "__index__"):
            names = [value] if isinstance(value, str) else value
            ids[field] = sum({id_of(info, schema.SUMS[field], name) for name in names})
        elif field in schema.CHOICES:
            ids[field] = id_of(info, schema.CHOICES[field], value)
    return ids


def names_of_ids(info: Info, fixed: Any, *fields: str) -> dict[str, Any]:
    """Returns the daemon's names for the ids in fields of a reply, or of a request, a tuple of them
    for a sum, and other numbers as they are."""
    names = dict(fixed if isinstance(fixed, dict) else fixed._asdict())
    for field, number in names.items():
        if field in schema.SUMS:
            choices = info.choices[schema.SUMS[field]].values()
            names[field] = tuple(one.name for one in choices if one.id & number)
        elif field in schema.CHOICES and field in (fields or names):
            names[field] = name_of(info, schema.CHOICES[field], number)
    return {field: names[field] for field in fields or names}


def _full(media: Any) -> Any:
    """Returns media or layers with a thickness, which is 0 for those that have none."""
    if isinstance(media, np.ndarray):
        return media
    listed = list(media)
    nested = any(isinstance(one, (tuple, list, np.ndarray)) for one in listed)
    return [_full(one) for one in listed] if nested else [*listed, *([0.0] if len(listed) == 4 else [])]


def media_array(media: Media) -> Array:
    """Makes an array [C, L, 5] of one medium or of several, each of L layers."""
    if isinstance(media, Medium) and any(map(np.ndim, media)):
        raise ArgumentError(
            "media: the fields of this Medium are arrays: give a list of Medium, or call values(), "
            "which broadcasts them"
        )
    requested = (
        "media: dipole.Medium(sigma_a, sigma_s, g, eta, thickness), dipole.Stack(medium, ...), or a "
        "list of several of one kind, with as many layers each, or an array [C, 4] or [C, 5]"
    )
    with naming(requested):
        array: Array = np.asarray(_full([media] if isinstance(media, Stack) else media), "<f8")
    if array.ndim == 1:
        array = array[np.newaxis]
    if array.ndim == 2:
        array = array[:, np.newaxis]
    if array.ndim != 3 or array.shape[2] not in (4, 5):
        raise ArgumentError(requested)
    return np.pad(array, ((0, 0), (0, 0), (0, 5 - array.shape[2])))


def layers_of(media: Media) -> Array:
    """Makes an array [L, 5] of an argument that may be only one medium: a Medium or a Stack."""
    if isinstance(media, (tuple, list)) and 2 <= len(media) <= 5 and np.isscalar(media[0]):
        media = Medium(*media)
    array = media_array(media)
    if len(array) != 1:
        raise ArgumentError(
            f"medium: one Medium or one Stack(medium, ...) of layers, not {len(array)} media. Of a "
            'named medium, take one channel: client.media()["skin1"][0] is red'
        )
    layers: Array = array[0]
    return layers


def names_of(wanted: str | Iterable[str] | None, default: tuple[str, ...]) -> tuple[str, ...]:
    """Returns the names of the wanted quantities."""
    if wanted is None:
        return default
    try:
        return (wanted,) if isinstance(wanted, str) else tuple(wanted)
    except TypeError as error:
        raise ArgumentError(f"wanted: names of quantities, or one name: {error}") from error


# Parameters whose values may be names: the kinds of choices that these are.
_NAMED = {"fit_model": "model", "phase": "phase"}


def parameters_of(
    info: Info,
    parameters: Mapping[str, float | str] | None,
    tolerance: float | None = None,
    kind: str = "parameter",
) -> bytes:
    """Packs the parameters, or properties of a tissue. The daemon checks the values."""
    structures = b""
    all_parameters = dict(parameters or {})
    if tolerance is not None:
        if "tolerance" in all_parameters:
            raise ArgumentError("tolerance: as an argument or in parameters, not both")
        all_parameters["tolerance"] = tolerance
    for name, given in all_parameters.items():
        by_name = name in _NAMED and isinstance(given, str)
        value = id_of(info, _NAMED[name], str(given)) if by_name else given
        try:
            number = float(value)
        except (TypeError, ValueError) as error:
            raise ArgumentError(f"{kind} {name}: {value!r} is no number") from error
        parameter = id_of(info, kind, name)
        structures += wire.PARAMETER.pack(parameter=parameter, value=number)
    return structures


def in_precision(numbers: Any, argument: str, noun: str, evaluator_id: int) -> Array:
    """Makes an array [N] of numbers, in the precision of an evaluator. An error message names the
    caller's argument and uses the noun for one number: "r: one radius or an array [N]"."""
    if evaluator_id not in wire.EVALUATOR_TYPES:
        raise ArgumentError(f"evaluator {evaluator_id}: this module does not know its precision")
    with naming(f"{argument}: one {noun} or an array [N]"):
        array = np.asarray([] if numbers is None else numbers, wire.EVALUATOR_TYPES[evaluator_id])
    if array.ndim > 1:
        raise ArgumentError(f"{argument}: one {noun} or an array [N]")
    return np.ascontiguousarray(array.reshape(-1))
