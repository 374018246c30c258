"""Client.values(): broadcasts media and radii of any shapes, as numpy's functions do."""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple, Unpack

import numpy as np

from . import evaluation, wire
from .arguments import media_array
from .session import Session
from .errors import ArgumentError, naming
from .exchange import Request
from .values import Array, EvaluatorOptions, Info, Media, Query, Result, Stack, shows

# Number of queries that wait for replies at a time: enough to keep the daemon busy all the time.
OUTSTANDING = 64


@shows("models", "values", "numerical_error", "model_error")
class Values(NamedTuple):
    """The values of one quantity. All arrays have the broadcast shape of media and radii."""

    values: Array  # values in the evaluator's precision; units as in Result
    numerical_error: Array  # relative error of each value against the model's exact formula
    model_error: Array  # relative error of the model against transport; NaN: not solved
    models: tuple[str, ...]  # the models used: one, unless the tolerance chose several


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
    under_way: deque[_Part] = deque()
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
        for channel, (places, radii) in enumerate(requested.places):
            found[places] = values[channel, radii]
            numerical_error[places] = errors[channel, radii]
            model_error[places] = result.model_error[channel]
        models.add(result.model)

    await session.each(requests(), take, OUTSTANDING)
    a, b, c = (array.reshape(shape) for array in (found, numerical_error, model_error))
    return Values(a, b, c, tuple(sorted(models)))


# ---- what is requested ---------------------------------------------------------------------------

_NO_LAYERS = "media: values() takes no layers: call eval()"


class _Part(NamedTuple):
    """One query, and where its values go."""

    media: Array  # [C, 5]
    radii: Array  # [N]
    # of each channel: positions in the flattened result, and which radius each of them has
    places: list[tuple[Array, Array]]


def _first_axis(media: Media, r: Any) -> Array:
    """Gives media [C, 5] as many axes that each of them meets each of the radii."""
    array = media_array(media)
    if array.shape[1] > 1:
        raise ArgumentError(_NO_LAYERS)
    return array.reshape(len(array), *(1,) * np.ndim(r), 5)


def _distinct(media: Media) -> tuple[Array, Array]:
    """Returns the distinct media [C, 5], and which of them each medium of a call is."""
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
    distinct, index = np.unique(rows, axis=0, return_inverse=True)
    return distinct, index.reshape(fields[0].shape)


def _plan(info: Info, media: Media, r: Any) -> tuple[tuple[int, ...], Iterator[_Part]]:
    """Returns the shape of the result, and the queries that Client.values() has to send."""
    distinct, index = _distinct(media)
    with naming("r: radii of any shape"):
        radii = np.asarray(r, np.float64)
    try:
        shape = np.broadcast_shapes(index.shape, radii.shape)
    except ValueError as error:
        raise ArgumentError(
            f"media, r: shapes {index.shape} and {radii.shape} do not broadcast. For each medium at "
            "each radius, give the media a further axis: np.array(media)[:, None]"
        ) from error
    every = np.broadcast_to(index, shape).reshape(-1)
    return shape, _parts(info, distinct, every, np.broadcast_to(radii, shape).reshape(-1))


def _parts(info: Info, distinct: Array, index: Array, radii: Array) -> Iterator[_Part]:
    """Yields queries within the daemon's limits: each is for media that have the same radii. index,
    radii: those of each value."""
    limits = info.limits
    # A part of the reply has room for at least 256 radii of each medium, and a frame for radii and media.
    part_bytes = min(limits["max_part_bytes"], limits["max_frame_bytes"]) - wire.EVAL_REPLY.bytes
    medium_bytes = 8 + 13 * wire.QUANTITY_ERROR.bytes + 256 * 8
    most_media = max(min(limits["max_media"], part_bytes // medium_bytes), 1)
    most_radii = max(limits["max_frame_bytes"] // 16, 1)
    order = np.argsort(index, kind="stable")
    bounds = np.searchsorted(index[order], np.arange(len(distinct) + 1))
    alike: dict[bytes, list[tuple[int, Array, Array]]] = defaultdict(list)
    for i in range(len(distinct)):
        places = order[bounds[i] : bounds[i + 1]]
        own, which = np.unique(radii[places], return_inverse=True)
        alike[own.tobytes()].append((i, places, which))
    for shared, media in alike.items():
        listed = np.frombuffer(shared)
        for begin in range(0, len(listed), most_radii):
            for first in range(0, len(media), most_media):
                some = media[first : first + most_media]
                ranges = [(which >= begin) & (which < begin + most_radii) for _, _, which in some]
                yield _Part(
                    distinct[[i for i, _, _ in some]],
                    listed[begin : begin + most_radii],
                    [(at[here], which[here] - begin) for (_, at, which), here in zip(some, ranges)],
                )
