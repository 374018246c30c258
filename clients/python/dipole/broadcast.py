"""Client.values(): broadcasts media and radii of any shapes, as numpy's functions do."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple, Unpack

import numpy as np

from . import evaluation, wire
from .arguments import media_array
from .session import Session
from .errors import ArgumentError, naming
from .exchange import Request
from .values import Array, EvaluatorOptions, Info, Media, Query, Result, Stack, counted, in_short, span

# Number of queries that wait for replies at a time: enough to keep the daemon busy all the time.
OUTSTANDING = 64


class Values(NamedTuple):
    """The values of one quantity. All arrays have the broadcast shape of media and radii."""

    values: Array  # values in the evaluator's precision; units as in Result
    numerical_error: Array  # relative error of each value against the model's exact formula
    model_error: Array  # relative error of the model against transport; NaN: not solved
    models: tuple[str, ...]  # the models used: one, unless the tolerance chose several

    def __repr__(self) -> str:
        return in_short(
            f"<Values: {', '.join(self.models)}; {counted(self.values.size, 'value', 'values')} of "
            f"shape {self.values.shape}, {span(self.values)}",
            f"numerical_error {span(self.numerical_error)}, model_error {span(self.model_error)}>",
        )


class _Media(NamedTuple):
    """The distinct media of a call, and which of them each medium of the call is."""

    distinct: Array  # [C, 5]
    # [...] index in `distinct` of each medium of the call
    index: Array  # type: ignore[assignment]


async def values(
    session: Session,
    model: str | int | None,
    media: Media,
    r: Any,
    quantity: str = "R",
    **options: Unpack[EvaluatorOptions],
) -> Values:
    """Evaluates one quantity for media and radii of any shapes, which are broadcast against each
    other as numpy's functions do.

    media: a Medium whose fields may be arrays, or an array [..., 4] or [..., 5], or the name of a measured
    medium, whose three channels become the first axis. r: radii in mm, of any shape. For
    example, sigma_a of shape [H, W, 1] and r of shape [N] give values [H, W, N]; for an image
    of media, r of shape [H, W] gives each pixel its own radius. quantity: the name of a
    quantity that has a value for each radius. options: as of a Query.

    The number of media and radii is not limited: this method sends as many queries as it needs.
    deadline_ms holds for each query. Equal media are sent once.
    """
    template = Query(model, media, r, wanted=[quantity], **options)
    if isinstance(media, str):
        media = _first_axis((await session.media_of(media)), r)
    shape, queries = _plan(session.info, media, r)
    under_way: deque[Places] = deque()
    found: Array = np.empty(0)
    numerical_error, model_error = np.full((2, math.prod(shape)), np.nan)
    models: set[str] = set()

    def requests() -> Iterator[Request[Result]]:
        for one in queries:
            under_way.append(one)
            query = replace(template, media=one.media, r=one.radii)
            yield evaluation.request(session.info, query)

    def take(result: Result) -> None:
        nonlocal found
        requested, values = under_way.popleft(), result.values[quantity]
        if found.size == 0:
            found = np.empty(len(numerical_error), values.dtype)
        errors = result.numerical_error(requested.radii)
        for channel, places in requested.places:
            found[places] = values[channel]
            numerical_error[places] = errors[channel]
            model_error[places] = result.model_error[channel]
        models.add(result.model)

    await session.each(requests(), take, OUTSTANDING)
    a, b, c = (array.reshape(shape) for array in (found, numerical_error, model_error))
    return Values(a, b, c, tuple(sorted(models)))


def _plan(info: Info, media: Media, r: Any) -> tuple[tuple[int, ...], Iterator[Places]]:
    """Returns the shape of the result, and the queries that Client.values() has to send."""
    one = _media(media)
    with naming("r: radii of any shape"):
        radii = np.asarray(r, np.float64)
    try:
        shape = np.broadcast_shapes(one.index.shape, radii.shape)
    except ValueError as error:
        shapes = f"{one.index.shape} and {radii.shape}"
        raise ArgumentError(
            f"media, r: shapes {shapes} do not broadcast. For each medium at each radius, give the "
            "media a further axis: np.array(media)[:, None]"
        ) from error
    if radii.size == 0 or one.index.size == 0:
        return shape, iter(())
    if _is_product(one.index, radii):
        return shape, _product(info, one, radii, len(shape))
    return shape, _groups(info, one, radii, shape)


def _first_axis(media: Media, r: Any) -> Array:
    """Gives media [C, 5] as many axes that each of them meets each of the radii."""
    array = media_array(media)
    if array.shape[1] > 1:
        raise ArgumentError(_NO_LAYERS)
    return array.reshape(len(array), *(1,) * np.ndim(r), 5)


_NO_LAYERS = "media: values() takes no layers: call eval()"


# ---- what is requested ---------------------------------------------------------------------------


class Places(NamedTuple):
    """One query, and where its values go in the flattened result."""

    media: Array  # [C, 5]
    radii: Array  # [N]
    # (channel, positions [N] in the flattened result); channels may repeat
    places: tuple[tuple[int, Array], ...]


def _media(media: Media) -> _Media:
    form = "media: a Medium, whose fields may be arrays, or an array [..., 4] or [..., 5]"
    if isinstance(media, Stack):
        raise ArgumentError(_NO_LAYERS)
    with naming(form):
        if isinstance(media, tuple) and not isinstance(media[0], tuple):
            fields = [np.asarray(field, np.float64) for field in media]
        else:
            array = np.asarray(media, np.float64)
            fields = list(np.moveaxis(array, -1, 0)) if array.ndim else []
    if len(fields) not in (4, 5):
        raise ArgumentError(form)
    fields += [np.zeros(())] * (5 - len(fields))
    try:
        fields = np.broadcast_arrays(*fields)
    except ValueError as error:
        raise ArgumentError("media: the shapes of its fields do not broadcast") from error
    rows = np.stack([field.reshape(-1) for field in fields], axis=1)
    if len(rows) == 1:
        return _Media(rows, np.zeros(fields[0].shape, np.intp))
    distinct, index = np.unique(rows, axis=0, return_inverse=True)
    return _Media(distinct, index.reshape(fields[0].shape))


def _most_media(info: Info) -> int:
    """Returns how many media a request may have, so that a part of the reply has room for at least
    256 radii of each medium."""
    limits = info.limits
    part_bytes = min(limits["max_part_bytes"], limits["max_frame_bytes"]) - wire.EVAL_REPLY.bytes
    return max(min(limits["max_media"], part_bytes // (8 + 13 * wire.QUANTITY_ERROR.bytes + 256 * 8)), 1)


def _most_radii(info: Info) -> int:
    """Returns how many radii a request may have, so that a frame has room for radii and media."""
    return max(info.limits["max_frame_bytes"] // 16, 1)


def _aligned(shape: tuple[int, ...], dimensions: int) -> tuple[int, ...]:
    return (1,) * (dimensions - len(shape)) + shape


def _is_product(index: Array, radii: Array) -> bool:
    """Returns whether broadcasting combines every medium with every radius."""
    dimensions = max(index.ndim, radii.ndim)
    media_shape, radii_shape = _aligned(index.shape, dimensions), _aligned(radii.shape, dimensions)
    return all(m == 1 or n == 1 for m, n in zip(media_shape, radii_shape))


def _product(info: Info, media: _Media, radii: Array, dimensions: int) -> Iterator[Places]:
    """Yields queries for all media at all radii, as few as the daemon's limits allow."""
    media_shape = _aligned(media.index.shape, dimensions)
    radii_shape = _aligned(radii.shape, dimensions)
    shape = tuple(m * n for m, n in zip(media_shape, radii_shape))
    places = np.arange(media.index.size * radii.size).reshape(shape)
    # Transpose to [medium, radius]: the axes of the media come first.
    first = [i for i in range(dimensions) if media_shape[i] != 1]
    rest = [i for i in range(dimensions) if media_shape[i] == 1]
    places = places.transpose(first + rest).reshape(media.index.size, radii.size)
    index, listed = media.index.reshape(-1), radii.reshape(-1)
    most_media, most_radii = _most_media(info), _most_radii(info)
    for begin in range(0, listed.size, most_radii):
        end = begin + most_radii
        for low in range(0, len(media.distinct), most_media):
            distinct = media.distinct[low : low + most_media]
            rows = np.flatnonzero((index >= low) & (index < low + len(distinct)))
            yield Places(
                distinct,
                listed[begin:end],
                tuple((int(index[row]) - low, places[row, begin:end]) for row in rows),
            )


def _groups(
    info: Info, media: _Media, radii: Array, shape: tuple[int, ...]
) -> Iterator[Places]:
    """Yields queries that evaluate each medium at its own radii."""
    most_radii = _most_radii(info)
    index = np.broadcast_to(media.index, shape).reshape(-1)
    listed = np.broadcast_to(radii, shape).reshape(-1)
    order = np.argsort(index, kind="stable")
    bounds = np.searchsorted(index[order], np.arange(len(media.distinct) + 1))
    for i, medium in enumerate(media.distinct):
        for begin in range(bounds[i], bounds[i + 1], most_radii):
            places = order[begin : min(begin + most_radii, bounds[i + 1])]
            yield Places(medium[np.newaxis], listed[places], ((0, places),))
