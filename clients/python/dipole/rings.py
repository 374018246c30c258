"""Means over rings: a model's values to compare with those of a Monte Carlo job."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple, Unpack

import numpy as np

from .arguments import media_array
from .session import Session
from .errors import ArgumentError, naming
from .evaluation import eval
from .values import Array, EvaluatorOptions, Grid, Media, Query, counted, in_short, span, whole

_NODES = 16  # number of Gauss-Legendre nodes in each part of a ring
_PARTS_MOST = 1 << 18  # most parts of the rings of all media: from then on none is divided
_EPSILON = np.finfo(np.float64).eps


class RingMeans(NamedTuple):
    """Means of R over N rings, for C channels."""

    R: Array  # [C, N] 1/mm^2 per unit of power that entered: a ring's power over its area
    edges: Array  # [N + 1] mm
    numerical_error: Array  # [C, N] relative error of the mean against the mean of the
    # model's exact formula; inf where R underflows to 0
    model_error: Array  # [C] of the model against transport, relative; NaN: not solved
    model: str

    def __repr__(self) -> str:
        channels, rings = self.R.shape
        return in_short(
            f"<RingMeans: {self.model}; {counted(channels, 'medium', 'media')}, "
            f"{counted(rings, 'ring', 'rings')}, {span(self.edges)} mm",
            f"R {span(self.R)} 1/mm^2, model_error {span(self.model_error)}>",
        )


# What is known of N parts of rings: their powers [C, N], how far these may be off because
# the values and the radii are rounded [C, N], and the error of the model [C].
_Powers = tuple[Array, Array, Array]


async def ring_means(
    session: Session,
    model: str | int | None,
    media: Media,
    edges: Any,
    **options: Unpack[EvaluatorOptions],
) -> RingMeans:
    """Returns a model's means of R over rings, to compare with those of mc().

    edges: mm, a Grid as for mc(), or the edges [N + 1] of its result. The means are integrals of
    2 pi r R over the ring, over the ring's area; the numerical error holds that of the integration,
    for which several queries are sent. The model error is NaN for rings that start at 0: it is
    measured from 0.01 mean free paths on. options: evaluator, moments, parameters, tolerance and
    deadline_ms, as of a Query.
    """
    # A ring is cut into parts whose outer edge is at most twice the inner one, and each part is cut
    # into halves until that changes its power by less than the values' errors do. The sum of the
    # last changes is part of the error: it is far above that of the sum of the halves.
    media = media_array((await session.media_of(media)))
    query = Query(model, media, wanted="2_pi_r_R", **options)
    edges = _edges(edges)
    low, high, ring = _cut(edges, media)
    if model is None:  # The first reply names the model for all others.
        first = await eval(session, replace(query, r=np.append(low[low > 0], high)))
        query = replace(query, model=first.model, evaluator=query.evaluator or "f64")
    power, error = np.zeros((2, len(media), len(edges) - 1))
    whole, rounding, model_error = await _powers(session, query, low, high)
    small = np.zeros(len(low), bool)
    while len(low):
        middle = (low + high) / 2
        ends = np.stack([low, middle, high])
        low, high = ends[:2].T.reshape(-1), ends[1:].T.reshape(-1)
        halves, rounding, worst = await _powers(session, query, low, high)
        model_error = np.maximum(model_error, worst)
        sums, rounded = (x[:, 0::2] + x[:, 1::2] for x in (halves, rounding))
        change = np.abs(sums - whole)
        so_far = power + _by_ring(sums, ring, power.shape)
        least = _EPSILON / 8 * so_far[:, ring]
        was_small, small = small, (change <= np.maximum(rounded, least)).all(axis=0)
        good = (change <= np.maximum(rounded / 16, least)).all(axis=0) | (small & was_small)
        good |= (ends[1] <= ends[0]) | (ends[2] <= ends[1]) | (halves.size > _PARTS_MOST)
        power += _by_ring(sums[:, good], ring[good], power.shape)
        error += _by_ring((change + rounded)[:, good], ring[good], power.shape)
        again = np.repeat(~good, 2)
        low, high, whole = low[again], high[again], halves[:, again]
        ring, small = ring[~good].repeat(2), small[~good].repeat(2)
    dark = (media[:, :, 1] == 0).all(axis=1)[:, None]  # R is 0. Elsewhere a power of 0 has underflowed.
    with np.errstate(divide="ignore", invalid="ignore"):
        relative: Array = np.where(power > 0, error / power, np.where(dark, 0, np.inf))
    areas = np.pi * np.diff(edges) * (edges[1:] + edges[:-1])
    return RingMeans(power / areas, edges, relative, model_error, str(query.model))


def _cut(edges: Array, media: Array) -> tuple[Array, Array, Array]:
    """Cuts rings into parts. Returns their inner edges, their outer edges and their rings. That of
    a disc at the centre is at most a thousandth of a mean free path wide."""
    sigma_t = max(float(media[:, :, :2].sum(axis=2).max(initial=0)), 1e-300)
    low, high, ring = [], [], []
    for i, (a, b) in enumerate(zip(edges, edges[1:])):
        least = a or min(b * 2.0**-16, 1e-3 / sigma_t)
        cuts = np.geomspace(least, b, max(int(np.ceil(np.log2(b / least))), 1) + 1)
        cuts = np.concatenate([[a], cuts[1:-1] if a else cuts[:-1], [b]])
        low.append(cuts[:-1])
        high.append(cuts[1:])
        ring.append(np.full(len(cuts) - 1, i))
    return np.concatenate(low), np.concatenate(high), np.concatenate(ring)


async def _powers(session: Session, query: Query, low: Array, high: Array) -> _Powers:
    # A query states one error for all of its radii: so each has the parts of an octave.
    octaves = np.frexp(high)[1]
    channels = len(np.asarray(query.media))
    powers, errors = np.empty((2, channels, len(low)))
    model_errors = np.zeros(channels)
    for octave in np.unique(octaves):
        at = octaves == octave
        powers[:, at], errors[:, at], one = await _powers_at(session, query, low[at], high[at])
        model_errors = np.maximum(model_errors, one)
    return powers, errors, model_errors


async def _powers_at(session: Session, query: Query, low: Array, high: Array) -> _Powers:
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)  # type: ignore[no-untyped-call]
    width = (high - low)[:, None]
    r = low[:, None] + width * ((1 + nodes) / 2)
    result = await eval(session, replace(query, r=r.reshape(-1)))
    values = result.two_pi_r_R
    evaluated = r.astype(values.dtype)
    ring: Array = values.astype(np.float64).reshape(-1, *r.shape)
    slope = np.gradient(ring, nodes / 2, axis=2) / width
    moved = np.abs(evaluated - r) + _EPSILON * r
    with np.errstate(invalid="ignore"):  # Far out, R is 0 and its relative error may be infinite.
        error = ring * (result.numerical_error(r) + 8 * _EPSILON)
    error = np.where(ring > 0, error, 0) + 2 * np.abs(slope) * moved + np.finfo(values.dtype).tiny
    return (
        (ring * width * (weights / 2)).sum(axis=2),
        (error * width * (weights / 2)).sum(axis=2),
        result.model_error,
    )


def _by_ring(parts: Array, ring: Array, shape: tuple[int, ...]) -> Array:
    """Adds up the parts [C, N] of each ring."""
    sums = np.zeros(shape[::-1])
    np.add.at(sums, ring, parts.T)
    return sums.T


def _edges(edges: Any) -> Array:
    """Makes the edges [N + 1] of rings, which rise, from those of a job or from a Grid."""
    if isinstance(edges, Grid):
        edges = edges._replace(count=whole(edges.count))
        if edges.spacing == "logarithmic":
            edges = np.geomspace(edges.start_mm, edges.stop_mm, edges.count)
        else:
            edges = np.linspace(edges.start_mm, edges.stop_mm, edges.count)
    with naming("edges: a Grid, or an array [N + 1]"):
        array: Array = np.array(edges, np.float64)
    good = array.ndim == 1 and array.size > 1 and array[0] >= 0 and np.isfinite(array).all()
    if not good or not (np.diff(array) > 0).all():
        raise ArgumentError("edges: a Grid, or an array [N + 1] of rising radii in mm from 0 on")
    return array
