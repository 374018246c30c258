"""Queries as payloads, and payloads that hold lists."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from . import wire
from .answers import Query
from .errors import ArgumentError, ProtocolError
from .values import Grid, Info, Medium


def id_of(info: Info, kind: str, name: str | int) -> int:
    """The id of a choice by its name; an id stays as it is, for the daemon to judge."""
    if not isinstance(name, str):
        return name
    choices = info.choices[kind]
    if name not in choices:
        raise ArgumentError(f"{kind} {name}: not one of {', '.join(choices)}")
    return choices[name].id


def query(
    info: Info,
    model: str | int | None,
    media: Medium | Iterable[Sequence[float]] | np.ndarray,
    r: Any,
    grid: Grid | None,
    evaluator: str | int | None,
    moments: str | int,
    wanted: Iterable[str] | None,
    parameters: Mapping[str, float | str] | None,
    tolerance: float | None,
) -> tuple[bytes, Query]:
    """The payload of an eval request, see eval()."""
    if wanted is None:
        wanted = ("R", "albedo", "cdf") if grid is None else ("R", "albedo", "cdf", "r")
    if evaluator is None:
        evaluator = "f64" if model is not None else "lut"
    evaluator_id = id_of(info, "evaluator", evaluator)
    listed_media = media_array(media)
    radii = radii_array(r, grid, evaluator_id)
    radius_count = grid.count if radii is None else len(radii)
    listed_parameters = parameters_list(info, parameters, tolerance)
    wanted_ids = sum({id_of(info, "quantity", name) for name in wanted})
    fixed = wire.EVAL_REQUEST.pack(
        model=wire.ANY_MODEL if model is None else id_of(info, "model", model),
        evaluator=evaluator_id,
        moments=id_of(info, "moments", moments),
        wanted=wanted_ids,
        medium_count=len(listed_media),
        spacing=wire.SPACING_LIST if grid is None else id_of(info, "spacing", grid.spacing),
        parameter_count=len(listed_parameters),
        radius_count=radius_count,
        radius_start=0.0 if grid is None else grid.start_mm,
        radius_stop=0.0 if grid is None else grid.stop_mm,
    )
    listed = memoryview(b"" if radii is None else radii)
    padding = bytes(wire.padded(listed.nbytes) - listed.nbytes)
    payload = b"".join([fixed, listed_media.tobytes(), *listed_parameters, listed, padding])
    value_type = wire.EVALUATOR_TYPES.get(evaluator_id)
    return payload, Query(radii, value_type, wanted_ids, len(listed_media), radius_count)


def parameters_list(
    info: Info, parameters: Mapping[str, float | str] | None, tolerance: float | None
) -> list[bytes]:
    """Parameter structures; their values are the daemon's to judge."""
    structures = []
    all_parameters = dict(parameters or {})
    if tolerance is not None:
        if "tolerance" in all_parameters:
            raise ArgumentError("tolerance: as an argument or in parameters, not both")
        all_parameters["tolerance"] = tolerance
    for name, given in all_parameters.items():
        value = id_of(info, "model", given) if name == "fit_model" else given
        try:
            number = float(value)
        except (TypeError, ValueError) as error:
            raise ArgumentError(f"parameter {name}: {value!r} is no number") from error
        parameter = id_of(info, "parameter", name)
        structures.append(wire.PARAMETER.pack(parameter=parameter, value=number))
    return structures


def media_array(media: Medium | Iterable[Sequence[float]] | np.ndarray) -> np.ndarray:
    array = np.asarray(media if isinstance(media, (tuple, np.ndarray)) else list(media), "<f8")
    if array.ndim == 1:
        array = array[np.newaxis]
    if array.ndim != 2 or array.shape[1] != 4:
        raise ArgumentError("media: a Medium, or several, or an array [C, 4]")
    return array


def radii_array(r: Any, grid: Grid | None, evaluator_id: int) -> np.ndarray | None:
    if grid is not None:
        if r is not None:
            raise ArgumentError("r, grid: one of them, not both")
        return None
    if evaluator_id not in wire.EVALUATOR_TYPES:
        raise ArgumentError(f"evaluator {evaluator_id}: the type of its radii is not known here")
    radii = np.asarray([] if r is None else r, wire.EVALUATOR_TYPES[evaluator_id])
    if radii.ndim > 1:
        raise ArgumentError("r: one radius or an array [N]")
    return np.ascontiguousarray(radii.reshape(-1))


def unpack_list(
    payload: bytes, fixed_structure: wire.Structure, lists: list[tuple[str, wire.Structure]]
) -> tuple[Any, list[list[Any]]]:
    """A payload that is a fixed part followed by lists, whose lengths the fixed part names."""
    if len(payload) < fixed_structure.bytes:
        raise ProtocolError(f"a {fixed_structure.name} that is too short")
    fixed = fixed_structure.unpack(payload)
    counts = [getattr(fixed, count) for count, _ in lists]
    expected = fixed_structure.bytes
    expected += sum(count * entry.bytes for count, (_, entry) in zip(counts, lists))
    if len(payload) != expected:
        raise ProtocolError(f"a {fixed_structure.name} of an unexpected size")
    offset = fixed_structure.bytes
    unpacked = []
    for count, (_, entry) in zip(counts, lists):
        unpacked.append([entry.unpack(payload, offset + i * entry.bytes) for i in range(count)])
        offset += count * entry.bytes
    return fixed, unpacked

