"""Means over rings: a model's values to compare with those of a Monte Carlo job."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from .errors import ArgumentError
from .values import Array, Grid, Media, Query, Result, counted, in_short, span

_OCTAVES_OF_DISC = 16  # into which a disc, a ring that starts at 0, is cut; and the rest of it
_NODES = 16  # of Gauss and Legendre in each part of a ring


class RingMeans(NamedTuple):
    """Means of R over N rings, for C channels."""

    R: Array  # [C, N] 1/mm^2 per unit of power that entered: a ring's power over its area
    edges: Array  # [N + 1] mm
    numerical_error: Array  # [C, N] of the mean against the model's exact formula, relative
    model_error: Array  # [C] of the model against transport, relative; NaN: not measured
    model: str

    def __repr__(self) -> str:
        channels, rings = self.R.shape
        return in_short(
            f"<RingMeans: {self.model}; {counted(channels, 'medium', 'media')}, "
            f"{counted(rings, 'ring', 'rings')}, {span(self.edges)} mm",
            f"R {span(self.R)} 1/mm^2, model_error {span(self.model_error)}>",
        )


class Rings:
    """Rings, and the radii at which 2 pi r R is needed for the means over them.

    A ring is cut into parts whose outer edge is at most twice the inner one, since R may fall by
    orders of magnitude within a ring.
    """

    def __init__(self, edges: Any):
        self.edges = _edges(edges)
        begin, end, ring = [], [], []
        for i, (a, b) in enumerate(zip(self.edges, self.edges[1:])):
            octaves = _OCTAVES_OF_DISC if a == 0 else max(int(np.ceil(np.log2(b / a))), 1)
            cuts = np.geomspace(a or b * 2.0**-octaves, b, octaves + 1)
            cuts = np.concatenate([[0.0], cuts] if a == 0 else [cuts])
            begin.append(cuts[:-1])
            end.append(cuts[1:])
            ring.append(np.full(len(cuts) - 1, i))
        low, high = np.concatenate(begin)[:, None], np.concatenate(end)[:, None]
        nodes, weights = np.polynomial.legendre.leggauss(_NODES)  # type: ignore[no-untyped-call]
        self.r: Array = ((low + high) / 2 + (high - low) / 2 * nodes).reshape(-1)
        self._weights: Array = ((high - low) / 2 * weights).reshape(-1)
        self._first: Array = np.searchsorted(np.concatenate(ring), np.arange(len(begin))) * _NODES

    def query(self, model: Any, media: Media, options: dict[str, Any]) -> Query:
        return Query(model, media, self.r, wanted="2_pi_r_R", **options)

    def means(self, result: Result) -> RingMeans:
        """Makes the means of the result of query()."""
        areas = np.pi * np.diff(self.edges**2)
        error: Array = np.maximum.reduceat(result.numerical_error(self.r), self._first, axis=1)
        powers: Array = np.add.reduceat(result.two_pi_r_R * self._weights, self._first, axis=1)
        return RingMeans(powers / areas, self.edges, error, result.model_error, result.model)


def _edges(edges: Any) -> Array:
    """Makes the edges [N + 1] of rings, which rise, from those of a job or from a Grid."""
    if isinstance(edges, Grid):
        if edges.spacing == "logarithmic":
            edges = np.geomspace(edges.start_mm, edges.stop_mm, edges.count)
        else:
            edges = np.linspace(edges.start_mm, edges.stop_mm, edges.count)
    try:
        array: Array = np.array(edges, np.float64)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"edges: a Grid, or an array [N + 1]: {error}") from error
    good = array.ndim == 1 and array.size > 1 and array[0] >= 0 and np.isfinite(array).all()
    if not good or not (np.diff(array) > 0).all():
        raise ArgumentError("edges: a Grid, or an array [N + 1] of rising radii in mm from 0 on")
    return array
