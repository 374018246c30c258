"""Drawing radii: requests, answers, and the numbers that they are drawn with."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from . import packing, wire
from .answers import Answer, Query, name_of
from .errors import ArgumentError, DipoleError
from .values import Info, Medium


class Draw(NamedTuple):
    """Numbers u by rule, from 0 to 1, both excluded; i from 0 to count - 1.

    "random": number first + i of the seed; "stratified": (i + number i of the seed) / count;
    "regular": (i + 1/2) / count. The same seed gives the same bits everywhere.
    """

    count: int
    rule: str = "random"
    seed: int = 1
    first: int = 0


@dataclass(frozen=True)
class Samples:
    """Radii drawn for C channels (media), with N numbers, and what was evaluated at them.

    Arrays have the precision of the evaluator, float64 or float32; those that were not wanted
    are None. The arrays are read-only and may be views of one buffer.
    """

    model: str
    evaluator: str
    moments: str
    u: np.ndarray  # [N] the numbers, the same for every channel
    r: np.ndarray | None  # [C, N] mm
    pdf: np.ndarray | None  # [C, N] 1/mm: density of radii; of points: pdf / (2 pi r)
    albedo: np.ndarray | None  # [C] float64, integral of 2 pi r R(r)
    numerical_error_constant: np.ndarray  # [C] of values at radius r: relative, at most this
    numerical_error_per_mm: np.ndarray  # [C] 1/mm: and this times r
    model_error: np.ndarray  # [C] relative, of the model against transport; NaN: not measured
    notes: tuple[str, ...]  # names of remarks that hold for a channel or more, see Info.choices
    values: dict[str, np.ndarray]  # [C, N] all that was wanted, by name: "r", "pdf", "R", ...


def numbers(draw: Draw, value_type: str = "<f8") -> np.ndarray:
    """The numbers of a rule [count], with the daemon's bits. core/draw.h says how they are made."""
    i = np.arange(draw.count, dtype=np.uint64)
    if draw.rule == "random":
        with np.errstate(over="ignore"):
            return _below_1(_random(draw.seed, i + np.uint64(draw.first), value_type), value_type)
    within = 0.5 if draw.rule == "regular" else _random(draw.seed, i, "<f8")
    return _below_1((i.astype("<f8") + within) / draw.count, value_type)


def _random(seed: int, i: np.ndarray, value_type: str) -> np.ndarray:
    """Outputs i of SplitMix64 (Steele, Lea, Flood 2014), as numbers between 0 and 1."""
    with np.errstate(over="ignore"):
        z = np.uint64(seed) + (i + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ z >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ z >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    bits = 52 if value_type == "<f8" else 23
    return ((z >> np.uint64(64 - bits)).astype("<f8") + 0.5) * 2.0**-bits


def _below_1(u: np.ndarray, value_type: str) -> np.ndarray:
    rounded = u.astype(value_type)
    return np.minimum(rounded, np.nextafter(np.ones((), value_type), np.zeros((), value_type)))


def request(
    info: Info,
    model: str | int,
    media: Medium | Iterable[Sequence[float]] | np.ndarray,
    u: Any,
    draw: Draw | None,
    evaluator: str | int,
    moments: str | int,
    wanted: Iterable[str],
    parameters: Mapping[str, float | str] | None,
    tolerance: float | None,
) -> tuple[bytes, Query, np.ndarray | Draw]:
    """The payload of a sample request, see Client.sample(), what its answer has to fit, and its
    numbers, or by which rule they are to be made."""
    if (u is None) == (draw is None):
        raise ArgumentError("u, draw: one of them")
    evaluator_id = packing.id_of(info, "evaluator", evaluator)
    value_type = wire.EVALUATOR_TYPES.get(evaluator_id)
    if value_type is None:
        raise ArgumentError(f"evaluator {evaluator_id}: the type of its numbers is not known here")
    listed = np.asarray([] if u is None else u, value_type)
    if listed.ndim > 1:
        raise ArgumentError("u: one number or an array [N]")
    listed = listed.reshape(-1)
    listed_media = packing.media_array(media)
    listed_parameters = packing.parameters_list(info, parameters, tolerance)
    wanted_ids = sum({packing.id_of(info, "quantity", name) for name in wanted})
    draw_id = wire.DRAW_LIST if draw is None else packing.id_of(info, "draw", draw.rule)
    seeded = draw_id in (wire.DRAW_STRATIFIED, wire.DRAW_RANDOM)
    count = len(listed) if draw is None else draw.count
    fixed = wire.SAMPLE_REQUEST.pack(
        model=packing.id_of(info, "model", model),
        evaluator=evaluator_id,
        moments=packing.id_of(info, "moments", moments),
        wanted=wanted_ids,
        medium_count=len(listed_media),
        draw=draw_id,
        parameter_count=len(listed_parameters),
        sample_count=count,
        sample_first=0 if draw is None else draw.first,
        seed=draw.seed if seeded else 0,
    )
    tail = listed.tobytes()
    tail += bytes(wire.padded(len(tail)) - len(tail))
    payload = b"".join([fixed, listed_media.tobytes(), *listed_parameters, tail])
    query = Query(None, value_type, wanted_ids, len(listed_media), count, message="sample")
    return payload, query, listed if draw is None else draw


def result(answer: Answer, info: Info, given: np.ndarray | Draw) -> Samples:
    """What a whole answer says; or its error, raised."""
    part = answer.ready.popleft()
    if isinstance(part, DipoleError):
        raise part
    fixed, channels, arrays = part
    quantities = info.choices["quantity"].values()
    notes = info.choices["note"].values()
    by_rule = isinstance(given, Draw)
    return Samples(
        model=name_of(info, "model", fixed.model),
        evaluator=name_of(info, "evaluator", fixed.evaluator),
        moments=name_of(info, "moments", fixed.moments),
        u=numbers(given, answer.query.value_type) if by_rule else given,
        r=arrays.get(wire.QUANTITY_RADIUS),
        pdf=arrays.get(wire.QUANTITY_PDF),
        albedo=channels[:, 0] if fixed.wanted & wire.QUANTITY_ALBEDO else None,
        numerical_error_constant=channels[:, 1],
        numerical_error_per_mm=channels[:, 2],
        model_error=channels[:, 3],
        notes=tuple(note.name for note in notes if note.id and fixed.notes & note.id),
        values={one.name: arrays[one.id] for one in quantities if one.id in arrays},
    )
