"""Calls that send a Query: eval, sample, offers, table and surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, TypeVar, Unpack

import numpy as np

from . import wire
from .arguments import id_of, in_precision, layers_of, media_array, name_of, names_of
from .arguments import names_of_ids, parameters_of
from .session import Session
from .connection import frame_pieces
from .errors import ArgumentError, ProtocolError, TableError
from .exchange import InParts, Joined, Once, Request
from .surface import Surface
from .table import Table
from .values import Array, Draw, Errors, Grid, Info, Media, Medium, Offer, Offers, OffersOptions
from .values import Options, Query, Result, SampleOptions, Samples, whole

T = TypeVar("T")


def _packed(
    message: str,
    info: Info,
    query: Query,
    evaluator_id: int,
    wanted: tuple[str, ...],
    listed: Array | None,
    count: int,
    **fields: Any,
) -> tuple[bytes, Shape]:
    """Packs an eval or sample request for `count` radii. listed: the numbers, if there is a list."""
    media = media_array(query.media)
    shape = Shape(
        drawn=message == "sample",
        radii=listed if message == "eval" else None,
        value_type=wire.EVALUATOR_TYPES.get(evaluator_id),
        wanted=_bits(info, wanted, query.model_error),
        medium_count=len(media),
        radius_count=count,
    )
    fixed = {
        "model": _model_id(info, query),
        "evaluator": evaluator_id,
        "moments": id_of(info, "moments", query.moments),
        "wanted": shape.wanted,
        "medium_count": shape.medium_count,
        "layer_count": media.shape[1],
        **fields,
    }
    lists = {"medium": media.tobytes()}
    lists["parameter"] = parameters_of(info, query.parameters, query.tolerance)
    if listed is not None and len(listed):
        lists["u" if shape.drawn else "r"] = listed.data
    return wire.PAYLOADS[f"{message}_request"].pack(fixed, **lists), shape


def _model_id(info: Info, query: Query) -> int:
    return wire.ANY_MODEL if query.model is None else id_of(info, "model", query.model)


def _bits(info: Info, wanted: tuple[str, ...], model_error: bool) -> int:
    bits = {id_of(info, "quantity", name) for name in wanted}
    return sum(bits | {wire.QUANTITIES["model_error"]} if model_error else bits)


def _check_model(query: Query) -> None:
    has_tolerance = query.tolerance is not None or "tolerance" in (query.parameters or ())
    if query.model is None and not has_tolerance:
        raise ArgumentError("model: a name, or None with a tolerance, such as tolerance=0.01")


def _eval_payload(info: Info, query: Query) -> tuple[bytes, Shape]:
    grid, evaluator = query.grid, query.evaluator
    cdf = () if query.model is None else ("cdf",)
    wanted = names_of(query.wanted, ("R", "albedo", *cdf, *(() if grid is None else ("r",))))
    if grid is not None and not isinstance(grid, Grid):
        raise ArgumentError("grid: a Grid, such as Grid(0.1, 10, 100)")
    grid = grid and grid._replace(count=whole(grid.count))
    if evaluator is None:
        evaluator = "f64" if query.model is not None else "lut"
    if grid is not None and query.r is not None:
        raise ArgumentError("r, grid: one of them, not both")
    evaluator_id = id_of(info, "evaluator", evaluator)
    radii = None if grid is not None else in_precision(query.r, "r", "radius", evaluator_id)
    rule = grid or Grid(0.0, 0.0, 0 if radii is None else len(radii))
    how = {
        "spacing": wire.SPACING_LIST if grid is None else id_of(info, "spacing", rule.spacing),
        "radius_count": rule.count,
        "radius_start": rule.start_mm,
        "radius_stop": rule.stop_mm,
    }
    return _packed("eval", info, query, evaluator_id, wanted, radii, rule.count, **how)


def request(info: Info, query: Query, is_streamed: bool = False) -> Request[Result]:
    """Makes the request of eval() or, for is_streamed, eval_parts()."""
    _check_model(query)
    if isinstance(query.r, Grid):
        raise ArgumentError("r: a list of radii; a Grid is given as grid=")
    if query.r is None and query.grid is None and not {*names_of(query.wanted, ("R",))} <= {"albedo", "balance"}:
        raise ArgumentError('r: give radii, or a grid. Only wanted=["albedo", "balance"] needs none')
    payload, shape = _eval_payload(info, query)

    def read(part: Joined) -> Result:
        return Result(radius_first=part.replies[0].first, **_common_fields(part, shape, info))

    return Request("eval", payload, _replies(shape, read, is_streamed), query.deadline_ms)


async def _named(session: Session, query: Query) -> Query:
    """Returns the query with the name of a medium replaced by the medium's channels."""
    media = await session.media_of(query.media)
    return query if media is query.media else replace(query, media=media)


async def eval(session: Session, query: Query) -> Result:
    """Evaluates a Query, or its arguments: eval(model, media, r, tolerance=0.01). The options are
    grid, evaluator, moments, wanted, parameters, tolerance and deadline_ms; help(Query) describes
    them. Waits for the reply. Raises Refused, which names the field at fault, if the daemon
    refuses the query. Its status is "deadline" if the reply would be too late."""
    query = await _named(session, query)
    return await session.call(request(session.info, query))


async def submit(session: Session, query: Query) -> int:
    """Sends a query like eval(), but does not wait. Returns the query's id for collect()."""
    return await session.send(request(session.info, await _named(session, query)))


async def eval_parts(session: Session, query: Query) -> int:
    """Evaluates like eval(), but returns an iterator that gives each part of the reply when it
    arrives, so that a reply may be larger than memory. A part is a Result that begins at radius
    number radius_first. The daemon chooses how many radii a part has. Any step of the iterator may
    raise Refused; the parts before that are valid. The iterator of an AsyncClient is an
    asynchronous one. A client reads the parts while it waits for one of them, or for the reply to
    another call, also those that nobody takes any more: to end a large reply, close the client."""
    query = await _named(session, query)
    return await session.send(request(session.info, query, is_streamed=True))


async def offers(
    session: Session, media: Media, r: Any = None, **options: Unpack[OffersOptions]
) -> Offers:
    """Lists the models and evaluators that could serve eval(None, ...) with the same arguments,
    cheapest first, with the measured error and cost of each."""
    info = session.info
    media = await session.media_of(media)
    query = Query(None, media, r, **options)

    def read(reply: bytes) -> Offers:
        fixed, parts = wire.PAYLOADS["offers_reply"].unpack(reply)
        if fixed.taken > fixed.count:
            raise ProtocolError("an offers reply that takes what it does not offer")
        listed = tuple(
            Offer(name_of(info, "model", model), name_of(info, "evaluator", evaluator), bool(meets), *rest)
            for model, evaluator, meets, *rest in parts["offers"].tolist()
        )
        return Offers(listed, listed[fixed.taken] if fixed.taken < fixed.count else None)

    payload = _eval_payload(info, query)[0]
    made = Request("offers", payload, lambda: Once(read), query.deadline_ms)
    return await session.call(made)


async def table(
    session: Session, model: str | int, medium: Media, **options: Unpack[Options]
) -> Table:
    """Fetches the table that the evaluator "lut" uses for a medium. The Table evaluates it in this
    process, with the daemon's bits. options: moments, parameters, deadline_ms and tolerance
    (relative, at least 1e-6, by default 1e-4), as of a Query."""
    medium = await session.media_of(medium)
    query = Query(model, medium, **options)
    return await _table(session, query, lambda data: Table(data, session.info))


async def surface(
    session: Session,
    model: str | int,
    g: float = 0.0,
    eta: float = 1.3,
    *,
    evaluator: str = "f32",
    **options: Unpack[Options],
) -> Surface:
    """Fetches what all media with this g and eta share. The Surface evaluates transport with a
    medium for each value, and finds the media of colours, in this process and with the bits of
    varying(). options: evaluator, "f32" by default, or "f64"; moments, parameters, tolerance and
    deadline_ms, as of varying()."""
    query = Query(model, Medium(0.0, 0.0, g, eta), **options)
    return await _table(session, query, lambda data: Surface(data, session.info, evaluator))


async def _table(session: Session, query: Query, make: Callable[[bytes], T]) -> T:
    info = session.info
    fixed = {"model": _model_id(info, query), "moments": id_of(info, "moments", query.moments)}
    layers = layers_of(query.media)
    parameters = parameters_of(info, query.parameters, query.tolerance)

    def read(reply: bytes) -> T:
        try:
            return make(b"".join(frame_pieces(wire.MESSAGES["table"] | wire.REPLY, 0, reply)))
        except TableError as error:
            raise ProtocolError(f"a table reply that is not a table: {error}") from error

    payload = wire.PAYLOADS["table_request"].pack(
        fixed, medium=layers.tobytes(), parameter=parameters
    )
    made = Request("table", payload, lambda: Once(read), query.deadline_ms)
    return await session.call(made)


async def sample(
    session: Session,
    model: str | int,
    media: Media,
    u: Any = None,
    *,
    draw: Draw | None = None,
    **options: Unpack[SampleOptions],
) -> Samples:
    """Draws radii with a density in proportion to r R(r): the radius for a number u has cdf u.

    u: N numbers from 0 (0 mm) to 1 (infinity). draw: a rule that makes the numbers, in place of
    u; Draw(1024) makes 1024 random numbers. All channels get the same numbers. options: as of a
    Query, whose `wanted` is ("r", "pdf") by default. "r" is the drawn radii; all other
    quantities are evaluated at these. A model that does not cover all radii is refused.
    """
    info = session.info
    media = await session.media_of(media)
    query = Query(model, media, **options)
    _check_model(query)
    if (u is None) == (draw is None):
        raise ArgumentError("u, draw: give exactly one of them")
    draw = draw and draw._replace(count=whole(draw.count), seed=whole(draw.seed))
    evaluator_id = id_of(info, "evaluator", query.evaluator or "f64")
    listed = in_precision(u, "u", "number", evaluator_id)
    count = len(listed) if draw is None else draw.count
    draw_id = wire.DRAW_LIST if draw is None else id_of(info, "draw", draw.rule)
    seeded = draw_id in (wire.DRAW_STRATIFIED, wire.DRAW_RANDOM)
    how = {
        "draw": draw_id,
        "sample_count": count,
        "sample_first": 0 if draw is None else draw.first,
        "seed": draw.seed if draw is not None and seeded else 0,
    }
    wanted = names_of(query.wanted, ("r", "pdf"))
    payload, shape = _packed("sample", info, query, evaluator_id, wanted, listed, count, **how)

    def read(whole: Joined) -> Samples:
        numbers = listed if draw is None else numbers_of(draw, wire.EVALUATOR_TYPES[evaluator_id])
        return Samples(u=numbers, **_common_fields(whole, shape, info))

    return await session.call(Request("sample", payload, _replies(shape, read), query.deadline_ms))


# ---- replies -------------------------------------------------------------------------------------


class Shape(NamedTuple):
    """The facts about a request with which its reply is checked and read."""

    radii: Array | None  # the listed radii; None for a grid or a sample
    value_type: str | None  # numpy's type of radii and values; None for an unknown evaluator
    wanted: int  # sum of the ids of the quantities
    medium_count: int
    radius_count: int
    drawn: bool = False  # whether this is a sample, in which each channel has its own radii


def _replies(
    shape: Shape, read: Callable[[Joined], T], is_streamed: bool = False
) -> Callable[[], InParts[T]]:
    """Makes what reads the reply to an eval or sample request."""
    payload = "sample_reply" if shape.drawn else "eval_reply"
    same = {
        "evaluator": {one for one, kind in wire.EVALUATOR_TYPES.items() if kind == shape.value_type},
        "wanted": shape.wanted,
        "channel_count": shape.medium_count,
    }
    return lambda: InParts(payload, shape.radius_count, same, read, is_streamed, alike=True)


def _common_fields(joined: Joined, shape: Shape, info: Info) -> dict[str, Any]:
    """Makes the fields that Result and Samples share."""
    fixed, values = joined.replies[0], joined.arrays["values"]
    wanted = [q for q in (wire.DRAWN if shape.drawn else wire.ELEMENTWISE) if fixed.wanted & q]
    arrays = {quantity: values[i :: len(wanted)] for i, quantity in enumerate(wanted)}
    if shape.radii is not None:
        arrays[wire.QUANTITIES["r"]] = shape.radii[fixed.first :][: sum(one.count for one in joined.replies)]
    elif fixed.wanted & wire.QUANTITIES["r"] and not shape.drawn:
        arrays[wire.QUANTITIES["r"]] = joined.arrays["r"]
    for name in ("albedo", "balance"):
        if fixed.wanted & wire.QUANTITIES[name]:
            arrays[wire.QUANTITIES[name]] = joined.heads[0][name]
    errors = joined.heads[0]["errors"].view("<f8").reshape(shape.medium_count, -1, 3)
    quantities = sorted(info.choices["quantity"].values())
    return {
        **names_of_ids(info, fixed, "model", "evaluator", "moments", "notes"),
        "errors": {
            one.name: Errors(*errors[:, i].T)
            for i, one in enumerate(one for one in quantities if one.id & fixed.wanted)
        },
        "quantities": {one.name: arrays[one.id] for one in quantities if one.id in arrays},
    }


# ---- numbers for drawing -------------------------------------------------------------------------


def numbers_of(draw: Draw, value_type: str = "<f8") -> Array:
    """Computes the numbers [count] of a Draw, with the daemon's bits: see core/draw.h."""
    i = np.arange(draw.count, dtype=np.uint64)
    if draw.rule == "random":
        with np.errstate(over="ignore"):
            return _below_1(_random(draw.seed, i + np.uint64(draw.first), value_type), value_type)
    within = 0.5 if draw.rule == "regular" else _random(draw.seed, i, "<f8")
    return _below_1((i.astype("<f8") + within) / draw.count, value_type)


def _random(seed: int, i: Array, value_type: str) -> Array:
    """Returns outputs i of SplitMix64 (Steele, Lea, Flood 2014), scaled to between 0 and 1."""
    with np.errstate(over="ignore"):
        z = np.uint64(seed) + (i + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ z >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ z >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    bits = 52 if value_type == "<f8" else 23
    return ((z >> np.uint64(64 - bits)).astype("<f8") + 0.5) * 2.0**-bits


def _below_1(u: Array, value_type: str) -> Array:
    rounded = u.astype(value_type)
    return np.minimum(rounded, np.nextafter(np.ones((), value_type), np.zeros((), value_type)))
