"""Client.varying(): values each of which has its own medium."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from . import wire
from .arguments import id_of, ids_of, names_of, names_of_ids, parameters_of
from .session import Session
from .errors import ArgumentError, naming
from .exchange import Joined, pieces, together
from .values import Array, Info, Varying

VALUES_MOST = 1 << 20  # most values of one request: some megabytes

_WANTED = {wire.VARYING_NONE: (), wire.VARYING_RADII: ("R",), wire.VARYING_DRAWN: ("r",)}


def _bits(info: Info, kind: str, names: str | Iterable[str]) -> dict[int, str]:
    """Returns the names by bit, in the order of the bits."""
    return dict(sorted((id_of(info, kind, name), name) for name in names_of(names, ())))


def _given(
    sigma_a: Any, sigma_s: Any, colour: Any, length: Any, r: Any, u: Any
) -> tuple[dict[str, Any], int]:
    """Returns the given arrays by name, and whether the last one is r, u, or neither."""
    coloured = colour is not None or length is not None
    if coloured == (sigma_a is not None or sigma_s is not None):
        raise ArgumentError("sigma_a and sigma_s, or colour and length: give one pair")
    media = {"colour": colour, "length": length} if coloured else {
        "sigma_a": sigma_a, "sigma_s": sigma_s,
    }
    for name, array in media.items():
        if array is None:
            raise ArgumentError(f"{name}: it is missing")
    if r is not None and u is not None:
        raise ArgumentError("r, u: give one of them")
    if r is not None:
        return {**media, "r": r}, wire.VARYING_RADII
    return ({**media, "u": u}, wire.VARYING_DRAWN) if u is not None else (media, wire.VARYING_NONE)


async def varying(
    session: Session,
    model: str | int,
    *,
    sigma_a: Any = None,
    sigma_s: Any = None,
    colour: Any = None,
    length: Any = None,
    given: str | int = "mean-free-path",
    light: str | int = "beam",
    specular: bool = False,
    r: Any = None,
    u: Any = None,
    g: float = 0.0,
    eta: float = 1.3,
    wanted: str | Iterable[str] | None = None,
    coefficients: str | Iterable[str] | None = None,
    evaluator: str | int = "f32",
    moments: str | int = "exact",
    parameters: Mapping[str, float | str] | None = None,
    tolerance: float | None = None,
    deadline_ms: int = 0,
) -> Varying:
    """Evaluates values each of which has a medium of its own, as the points of a texture have. A
    value costs some ten nanoseconds.

    sigma_a, sigma_s: 1/mm. In place of them, colour and length give the media: a colour is a
    diffuse albedo, from 0 to 1; given names the kind of length, as for invert(). light: "beam"
    or "diffuse", the light of the colours. specular: whether the colours contain what the
    surface itself reflects. r: radii in mm; or u: numbers from 0 to 1, for which radii are
    drawn. All of them are arrays of any shapes that can be broadcast with each other. g=0.0 and
    eta=1.3 hold for all values.

    wanted: names of quantities. The default is R, or r for numbers u. coefficients: names from
    info.choices["coefficient"]; the default is sigma_a and sigma_s for colours without r and u.
    evaluator: "f32" or "f64", also the precision of the arrays. A value that cannot be computed is
    NaN; statuses says why. tolerance: of transport, 1e-5 or more, 1e-3 by default. moments,
    parameters, deadline_ms: as of a Query. The number of values is not limited.
    """
    info = session.info
    arrays, numbers = _given(sigma_a, sigma_s, colour, length, r, u)
    coloured = "colour" in arrays
    evaluator_id = id_of(info, "evaluator", evaluator)
    type = wire.EVALUATOR_TYPES.get(evaluator_id, "<f8")
    with naming(", ".join(arrays)):
        listed = np.broadcast_arrays(*(np.asarray(array, type) for array in arrays.values()))
    shape, count = listed[0].shape, listed[0].size
    flat = [np.ascontiguousarray(array).ravel() for array in listed]
    usual = _WANTED[numbers]
    wanted_bits = _bits(info, "quantity", usual if wanted is None else wanted)
    # model_error has no array, and is always requested
    wanted_bits.pop(wire.QUANTITIES["model_error"], None)
    if coefficients is None:
        coefficients = ("sigma_a", "sigma_s") if coloured and numbers == wire.VARYING_NONE else ()
    coefficient_bits = _bits(info, "coefficient", coefficients)
    same = {
        **ids_of(info, model=model, moments=moments),
        "evaluator": evaluator_id,
        "wanted": sum({*wanted_bits, wire.QUANTITIES["model_error"]}),
        "coefficients": sum(coefficient_bits),
    }
    fixed: dict[str, Any] = {**same, "numbers": numbers, "g": float(g), "eta": float(eta)}
    if coloured:
        fixed |= ids_of(info, given=given, light=light, specular=int(specular))
    listed_parameters = parameters_of(info, parameters, tolerance)

    def pack(first: int, end: int) -> bytes:
        some = {name: one[first:end].tobytes() for name, one in zip(arrays, flat)}
        start = {"value_count": end - first, **fixed}
        return wire.PAYLOADS["varying_request"].pack(start, parameter=listed_parameters, **some)

    found: list[Joined] = []
    total = range(0, count, VALUES_MOST)
    await session.each(pieces("varying", total, pack, same, deadline_ms), found.append)
    media, values, statuses = (
        together(found, name) for name in ("coefficients", "values", "statuses")
    )
    replies = [reply for piece in found for reply in piece.replies]
    last = replies[-1]
    faults = set(np.unique(statuses).tolist()) - set(wire.VALUES_COMPUTED)
    return Varying(
        **names_of_ids(info, same, "model", "moments", "evaluator"),
        **names_of_ids(info, last, "notes"),
        g=fixed["g"],
        eta=fixed["eta"],
        quantities={name: one.reshape(shape) for name, one in zip(wanted_bits.values(), values)},
        coefficients={name: one.reshape(shape) for name, one in zip(coefficient_bits.values(), media)},
        statuses=statuses.reshape(shape),
        faults={one.name: one.about for one in info.choices["value"].values() if one.id in faults},
        numerical_error=float(np.max([reply.numerical_error for reply in replies])),
        model_error=float(np.max([reply.model_error for reply in replies])),
        colour_least=last.colour_least,
        colour_most=last.colour_most,
        specular=last.specular,
    )
