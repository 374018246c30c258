"""Evaluates the tables of the evaluator `lut` without a daemon, and with the same bits.

All arithmetic is in single precision. It rounds each sum and product, in the order of
core/models/lut.c, so it gives the daemon's bits on every machine.
"""

from __future__ import annotations

import os
import zlib
from bisect import bisect_right
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import wire
from .errors import ArgumentError, TableError
from .values import Array, Info, Medium, in_short, span

LAYOUT = 4  # proto/PROTOCOL.md, "table"

# Positions of a table's words: first 16 numbers, then one entry for each octave of the argument of
# R, of the cdf, and of the radius (by u and by 1 - u), then the pieces.
_R_OCTAVES = 16
_CDF_OCTAVES = _R_OCTAVES + 256
_RADIUS_OCTAVES = _CDF_OCTAVES + 256
_COMPLEMENT_OCTAVES = _RADIUS_OCTAVES + 128
_PIECES = _COMPLEMENT_OCTAVES + 128
_TERMS = 4
_SAMPLE_WORDS = 1856  # behind the pieces; gather_at_home() needs them
_PIECES_MAX = 65536

_MANTISSA_BITS = 23
_CUTS_MAX = 11

# The edges of the bands of radii for which a table holds model errors, in mean free paths, and how
# close to an edge a radius counts as the edge, relative (PROTOCOL.md, T8).
_BAND_EDGES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)
_EDGE_WIDTH = 1e-7

_Function = Callable[[Array], Array]

_ZERO = np.float32(0)
_ONE = np.float32(1)
_HALF = np.float32(0.5)
_INFINITY = np.float32(np.inf)
_TWO_OVER_LN_2 = np.float32(2.88539008)
_2_TO_THE_24 = np.float32(2.0**24)


class TableErrors(NamedTuple):
    """The relative errors of values of a table, for the radii of one call."""

    numerical_error_constant: float  # constant part of the numerical error
    numerical_error_per_mm: float  # this number times r is added to the constant part
    model_error: float  # of the model against radiative transport; NaN if it was not measured


class _Numbers(NamedTuple):
    """The first words. Those whose names start with near hold for radii below the first piece, and
    far for radii beyond the last piece."""

    first_mm: np.float32
    last_mm: np.float32
    scale: np.float32
    ring_scale: np.float32
    pdf_scale: np.float32
    near_power: np.float32
    near_R: np.float32
    near_log: np.float32
    near_cdf: np.float32
    near_cdf_log: np.float32
    far: np.float32
    limit: np.float32
    first_u: np.float32
    near_radius: np.float32


class Table:
    """Looks up one medium's R, cdf, pdf, 2 pi r R, and the radius for a given cdf.

    model, moments and notes are names if the daemon's lists were given, else ids.
    """

    def __init__(self, data: bytes, info: Info | None = None):
        """data: exactly one frame, as a daemon sent it or save() wrote it."""
        fixed, self.parameters, self.words = frame_of(data, info)
        if (fixed.sigma_a, fixed.sigma_s) == (0, 0):
            raise TableError("a surface, not the table of one medium: use Surface")
        self.data: bytes = data  # the frame
        self.layout: int = fixed.layout
        self.model_id: int = fixed.model
        self.moments_id: int = fixed.moments
        self.model: str | int = name_in(info, "model", fixed.model)
        self.moments: str | int = name_in(info, "moments", fixed.moments)
        self.notes: tuple[str | int, ...] = _notes(info, fixed.notes)
        self.medium = Medium(fixed.sigma_a, fixed.sigma_s, fixed.g, fixed.eta)
        self._sigma_t_prime = fixed.sigma_a + fixed.sigma_s * (1 - fixed.g)
        self.albedo: float = fixed.albedo  # integral of 2 pi r R(r) over all radii
        # numerical_error() and errors() have the errors at given radii.
        self.numerical_error_constant: float = fixed.numerical_error
        self.numerical_error_per_mm: float = fixed.numerical_error_per_mm
        self.reach_mm: float = fixed.reach  # Further away R is less exact than the two above say.
        self._reach_growth: float = fixed.reach_growth
        if not (self.reach_mm > 0 and self._reach_growth >= 0):
            raise TableError("a table that does not say up to which radius its error holds")
        self.model_error: float = fixed.model_error  # at all radii; 0 or, if not measured, NaN
        self._model_errors: tuple[float, ...] = fixed.model_errors
        self._numerical_errors: tuple[float, ...] = fixed.numerical_errors
        if not all(0 <= one <= fixed.numerical_error for one in self._numerical_errors):
            raise TableError("a table whose errors by band are not from 0 to its largest error")
        self.pieces_from_mm: float = fixed.pieces_from  # below this radius: an asymptotic formula
        self.pieces_to_mm: float = fixed.pieces_to  # from this radius on: an asymptotic formula
        self.radius_least_mm: float = fixed.radius_least  # the least radius that the model covers
        self.radius_most_mm: float = fixed.radius_most  # the largest radius that it covers
        _check(self.words)
        # Copies in the machine's byte order, for arithmetic.
        self._entries = self.words.astype(np.int32)
        self._c = self.words.view("<f4").astype(np.float32)
        if (float(self._c[0]), float(self._c[1])) != (self.pieces_from_mm, self.pieces_to_mm):
            raise TableError(
                "a damaged table: the radii of its pieces differ from those that it states"
            )
        self._n = _Numbers(*self._c[: len(_Numbers._fields)])

    def __repr__(self) -> str:
        medium = ", ".join(f"{key} {value:.6g}" for key, value in self.medium._asdict().items())
        return in_short(
            f"<Table: {self.model}; {medium}",
            f"albedo {self.albedo:.4g}, numerical error {self.numerical_error_constant:.2g}, "
            f"model_error {span(self._model_errors)}, {len(self.data)} bytes>",
        )

    # ---- files -----------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the table into a file, which `dipole eval --table` and libdipole can read, too."""
        Path(path).write_bytes(self.data)

    @classmethod
    def load(cls, source: str | os.PathLike[str] | bytes, info: Info | None = None) -> Table:
        """Loads a file, or bytes, that holds exactly one table. info: that of a client; the table
        then has names instead of ids."""
        tables = cls.load_all(source, info)
        if len(tables) != 1:
            raise TableError(f"{len(tables)} tables: use load_all()")
        return tables[0]

    @classmethod
    def load_all(
        cls, source: str | os.PathLike[str] | bytes, info: Info | None = None
    ) -> list[Table]:
        """Loads a file, or bytes, that holds one or more tables, for example one per channel."""
        if isinstance(source, (bytes, bytearray, memoryview)):
            data = bytes(source)
        else:
            data = Path(source).read_bytes()
        tables: list[Table] = []
        while data or not tables:
            end = _frame_bytes(data)
            tables.append(cls(data[:end], info))
            data = data[end:]
        return tables

    # ---- evaluating ------------------------------------------------------------------------------

    def R(self, r: Any) -> Array:
        """Returns R in 1/mm^2 per unit of power that entered, as float32 and in the shape of r. r:
        radii in mm, from 0 to infinity."""
        return self._evaluate(r, self._inside_R, self._outside_R)

    def cdf(self, r: Any) -> Array:
        """Returns the power that leaves within r over all power that leaves, from 0 to 1."""
        return self._evaluate(r, self._inside_cdf, self._outside_cdf)

    def pdf(self, r: Any) -> Array:
        """Returns the probability density of radii in 1/mm: 2 pi r R over the albedo."""
        return self._evaluate_ring(r, self._n.pdf_scale)

    def ring(self, r: Any) -> Array:
        """Returns 2 pi r R, the power that leaves per mm of radius, in 1/mm. It is finite even
        where R is infinite at r = 0."""
        return self._evaluate_ring(r, self._n.ring_scale)

    def radius(self, u: Any) -> Array:
        """Returns the radii in mm with cdf(r) = u: random u give radii that are distributed as the
        light. u: from 0 to 1; 1 gives infinity. All radii are 0 if the medium does not scatter."""
        numbers = _floats(u)
        if not np.all((numbers >= 0) & (numbers <= 1)):
            raise ArgumentError("u: from 0 to 1")
        ends = (self._n.first_u, _ONE)
        radii = _look_up(numbers, self._inside_radius, self._outside_radius, *ends)
        return radii.reshape(np.shape(u))

    def numerical_error(self, r: Any) -> Array:
        """Returns how far R at r (mm) may be from the model's exact formula, relative. That of the
        other values is not larger, except that cdf and pdf may be off by numerical_error_constant."""
        radii = np.asarray(r, np.float64)
        growth = np.zeros_like(radii)  # At infinity, 0 times infinity would be NaN.
        if self.numerical_error_per_mm > 0:
            growth = self.numerical_error_per_mm * radii
        beyond = self._beyond_reach(np.where(np.isfinite(radii), radii, 0))
        bands = np.searchsorted(_BAND_EDGES[1:-1], radii * self._sigma_t_prime)
        error: Array = np.asarray(self._numerical_errors)[bands] + growth + beyond
        return error

    def errors(self, r: Any, wanted: Sequence[str] = ("R",)) -> TableErrors:
        """Returns the errors of quantities at the radii of a call, r (mm): those that a daemon
        states for an eval with evaluator lut at these radii. wanted: names of quantities that a
        table holds: R, albedo, cdf, pdf, 2_pi_r_R, S."""
        for name in wanted:
            if name not in ("R", "albedo", "cdf", "pdf", "2_pi_r_R", "S"):
                raise ArgumentError(f"wanted: {name!r}: a table does not hold it")
        radii = self._radii(r)
        finite = radii[np.isfinite(radii)].astype(np.float64)
        numerical_error = self._numerical_error(finite, wanted)
        if finite.size > 0 and not {"R", "pdf", "2_pi_r_R", "S"}.isdisjoint(wanted):
            numerical_error += float(self._beyond_reach(finite.max()))
        model_error = self._model_error(finite, wanted)
        return TableErrors(numerical_error, self.numerical_error_per_mm, model_error)

    def _beyond_reach(self, r: Array) -> Array:
        """Returns what the error of R at finite radii beyond the reach has in addition (T7)."""
        logarithm = np.log(np.maximum(r / self.reach_mm, 1))
        exponent = self._reach_growth * logarithm * logarithm
        return np.where(exponent < 7, np.expm1(np.minimum(exponent, 7)), np.inf)

    def _numerical_error(self, radii: Array, wanted: Sequence[str]) -> float:
        """Returns the numerical error of the wanted quantities at finite radii up to the reach (T7)."""
        if radii.size > 0 and not {"cdf", "pdf"}.isdisjoint(wanted):
            return self.numerical_error_constant
        of_R = radii.size > 0 and not {"R", "2_pi_r_R", "S"}.isdisjoint(wanted)
        errors = [] if of_R and "albedo" not in wanted else [self._numerical_errors[-1]]
        if of_R:
            ends = np.array([radii.min() * (1 + _EDGE_WIDTH), radii.max() * (1 - _EDGE_WIDTH)])
            first, last = np.searchsorted(_BAND_EDGES[1:-1], ends * self._sigma_t_prime)
            errors += self._numerical_errors[first : max(first, last) + 1]
        return max(errors)

    def _model_error(self, radii: Array, wanted: Sequence[str]) -> float:
        """Returns the largest model error of the wanted quantities at finite radii (T8)."""
        if self.model_error == 0:
            return 0.0
        of_albedo = self._model_errors[-1]
        errors = []
        if "albedo" in wanted:
            errors.append(of_albedo)
        if radii.size > 0:
            of_R = self._model_error_of_R(float(radii.min()), float(radii.max()))
            if not {"R", "2_pi_r_R", "S"}.isdisjoint(wanted):
                errors.append(of_R)
            if "pdf" in wanted:
                errors.append((of_R + of_albedo) / (1 - of_albedo) if of_albedo < 1 else np.nan)
        return float(np.max(errors)) if errors else np.nan  # NaN if one of them is NaN

    def _model_error_of_R(self, least_mm: float, most_mm: float) -> float:
        """Returns the largest model error of R in the bands that hold these radii."""
        starts = [edge * (1 - _EDGE_WIDTH) for edge in _BAND_EDGES]
        first = bisect_right(starts, least_mm * self._sigma_t_prime) - 1
        most = most_mm * self._sigma_t_prime
        end = sum(edge * (1 + _EDGE_WIDTH) < most for edge in _BAND_EDGES)
        if first < 0 or end == len(_BAND_EDGES):
            return np.nan
        first = min(first, len(_BAND_EDGES) - 2)
        return float(np.max(self._model_errors[first : max(end, first + 1)]))

    def _evaluate_ring(self, r: Any, scale: np.float32) -> Array:
        """Returns r R times a scale, for example 2 pi."""
        return self._evaluate(
            r, lambda x: self._inside_ring(x, scale), lambda x: self._outside_ring(x, scale)
        )

    def _evaluate(self, r: Any, inside: _Function, outside: _Function) -> Array:
        values = _look_up(self._radii(r), inside, outside, self._n.first_mm, self._n.last_mm)
        return values.reshape(np.shape(r))

    def _radii(self, r: Any) -> Array:
        """Returns the radii in single precision. The model has to cover them."""
        radii = _floats(r)
        wide = radii.astype(np.float64)
        if not np.all((wide >= 0) & (wide >= self.radius_least_mm) & (wide <= self.radius_most_mm)):
            least = max(self.radius_least_mm, 0.0)
            raise ArgumentError(f"r: from {least:g} to {self.radius_most_mm:g} mm")
        return radii

    # ---- inside ----------------------------------------------------------------------------------

    def _piece(self, octaves: int, x: Array) -> Array:
        """Evaluates the polynomial of the piece that holds x >= 0. The exponent of x and the
        leading bits of its mantissa select the piece. octaves: position of the first entry."""
        bits = x.view(np.int32)
        entry = self._entries[octaves + (bits >> _MANTISSA_BITS)]
        shift = entry & 31
        mantissa = bits & ((1 << _MANTISSA_BITS) - 1)
        index = mantissa >> shift
        rest = mantissa - (index << shift)
        unit = ((127 - shift) << _MANTISSA_BITS).astype(np.int32).view(np.float32)
        t = rest.astype(np.float32) * unit
        at = _PIECES + _TERMS * ((entry >> 5) + index)
        c0 = self._c[at]
        # A minus sign means that the polynomial counts from the piece's right end.
        w = np.where(np.signbit(c0), _ONE - t, t)
        value: Array = np.abs(c0) + w * (self._c[at + 1] + w * (self._c[at + 2] + w * self._c[at + 3]))
        return value

    def _inside_R(self, r: Array) -> Array:
        return self._piece(_R_OCTAVES, r) * self._n.scale

    def _inside_ring(self, r: Array, scale: np.float32) -> Array:
        return _times_radius(self._piece(_R_OCTAVES, r), r, scale)

    def _inside_cdf(self, r: Array) -> Array:
        value = self._piece(_CDF_OCTAVES, r)
        return np.where(value < 1, value, _ONE)

    def _inside_radius(self, u: Array) -> Array:
        """Looks up the radius by the smaller one of u and 1 - u. The difference 1 - u is exact."""
        near = np.where(u <= _HALF, u, _ONE - u)
        by_u = self._piece(_RADIUS_OCTAVES, near)
        return np.where(u <= _HALF, by_u, self._piece(_COMPLEMENT_OCTAVES, near))

    # ---- outside: below the first piece, and beyond the last one ---------------------------------

    def _octaves_below(self, r: Array) -> Array:
        """Returns log2(first_mm / r)."""
        octaves: Array = _log2(self._n.first_mm.reshape(1)) - (_log2(r * _2_TO_THE_24) - np.float32(24))
        return octaves

    def _near_flat(self, r: Array) -> Array:
        """Returns R over the scale near 0, for an R that does not grow like 1/r there."""
        if not self._n.near_log > 0:
            return np.full_like(r, self._n.near_R)
        rising = np.where(r > 0, self._octaves_below(r), _INFINITY)
        return self._n.near_R + self._n.near_log * rising

    def _near_R_at(self, r: Array) -> Array:
        """Returns R near 0. The order of operations lets no intermediate value overflow or
        underflow unless the result does."""
        if not self._n.near_power > 0:
            return self._near_flat(r) * self._n.scale
        if not self._n.limit > 0:
            return np.zeros_like(r)
        nearest = self._n.near_R * (self._n.scale / r)
        return np.where(r < 1, nearest, self._n.near_R / r * self._n.scale)

    def _near_ring(self, r: Array, scale: np.float32) -> Array:
        """Returns r R near 0, with `scale` in place of the scale of R."""
        if self._n.near_power > 0:
            return np.full_like(r, self._n.near_R * scale)
        return np.where(r > 0, _times_radius(self._near_flat(r), r, scale), _ZERO)

    def _near_cdf_factor(self, r: Array) -> Array:
        """Returns the cdf divided by r^2 near r = 0, for an R that does not grow like 1/r there."""
        rising = np.where(r > 0, self._octaves_below(r), _ZERO)
        return self._n.near_cdf + self._n.near_cdf_log * rising

    def _near_cdf_at(self, r: Array) -> Array:
        if self._n.near_power > 0:
            return self._n.near_cdf * r
        return self._near_cdf_factor(r) * r * r

    def _near_radius_at(self, u: Array) -> Array:
        """Returns the radius with cdf u near 0. The cdf is r^2 times a factor that changes only
        with ln r, so four rounds of fixed-point iteration suffice."""
        if self._n.near_power > 0:
            return self._n.near_radius * u
        root = np.sqrt(u)
        r = self._n.near_radius * root
        for _ in range(4):
            r = root / np.sqrt(self._near_cdf_factor(r))
        return r

    def _outside_R(self, r: Array) -> Array:
        ratio = self._n.last_mm / r
        far = self._n.far * ratio * ratio * ratio
        return np.where(r < self._n.first_mm, self._near_R_at(r), far * self._n.scale)

    def _outside_ring(self, r: Array, scale: np.float32) -> Array:
        ratio = self._n.last_mm / r
        far = self._n.far * self._n.last_mm * ratio * ratio
        return np.where(r < self._n.first_mm, self._near_ring(r, scale), far * scale)

    def _outside_cdf(self, r: Array) -> Array:
        return np.where(r < self._n.first_mm, self._near_cdf_at(r), self._n.limit)

    def _outside_radius(self, u: Array) -> Array:
        return np.where(u < 1, self._near_radius_at(u), _INFINITY if self._n.limit > 0 else _ZERO)


def _look_up(
    x: Array, inside: _Function, outside: _Function, least: np.float32, most: np.float32
) -> Array:
    """Returns inside(x) where least <= x < most, and outside(x) elsewhere."""
    with np.errstate(all="ignore"):
        values = inside(x)
        beyond = (x < least) | (x >= most)
        if beyond.any():
            values[beyond] = outside(x[beyond])
    assert values.dtype == np.float32
    return values


def _floats(values: Any) -> Array:
    """Makes a flat copy in single precision. Adding 0 turns -0 into 0."""
    flat: Array = np.array(values, np.float32).reshape(-1) + _ZERO
    return flat


def _times_radius(piece: Array, r: Array, scale: np.float32) -> Array:
    """Returns piece * r * scale, in an order in which no intermediate value underflows unless the
    result does."""
    product: Array = piece * (r * scale) if scale > 1 else piece * r * scale
    return product


def _log2(x: Array) -> Array:
    """Returns log2 of normal numbers, computed as in core/models/lut.c: the exponent plus the log2
    of the mantissa m, which is 2 artanh(s) / ln 2 with s = (m - 1) / (m + 1)."""
    bits = x.view(np.int32)
    exponent = ((bits >> _MANTISSA_BITS & 0xFF) - 127).astype(np.float32)
    m = (bits & 0x7FFFFF | 0x3F800000).astype(np.int32).view(np.float32)
    s = (m - _ONE) / (m + _ONE)
    t = s * s
    series = np.full_like(x, _ONE / np.float32(13))
    for odd in (11, 9, 7, 5, 3):
        series = series * t + _ONE / np.float32(odd)
    return exponent + _TWO_OVER_LN_2 * (s + s * t * series)


# ---- bytes ---------------------------------------------------------------------------------------


def _frame_bytes(data: bytes) -> int:
    """Returns the length of the frame at the start of the data."""
    if len(data) < wire.HEADER.bytes + wire.TABLE_REPLY.bytes:
        raise TableError("not a table: too short")
    header = wire.HEADER.unpack(data)
    known = (header.magic, header.version) == (wire.MAGIC, wire.VERSION)
    if not known or header.type != wire.MESSAGES["table"] | wire.REPLY:
        raise TableError("not a table: it does not start as one")
    end: int = wire.HEADER.bytes + header.payload_bytes
    if len(data) < end:
        raise TableError("a table whose end is missing")
    return end


def _payload_of(data: bytes) -> bytes:
    if _frame_bytes(data) != len(data):
        raise TableError("a table with something behind it")
    payload = data[wire.HEADER.bytes :]
    if len(payload) < wire.TABLE_REPLY.bytes:
        raise TableError("not a table: too short")
    return payload


def frame_of(data: bytes, info: Info | None) -> tuple[Any, dict[str | int, float], Array]:
    """Reads exactly one frame with a table or a surface: returns the fixed part, the parameters of
    the request by name, or by id without info, and the words, which are read-only."""
    payload = _payload_of(data)
    fixed = wire.TABLE_REPLY.unpack(payload)
    if fixed.layout != LAYOUT:
        raise TableError(
            f"a table of layout {fixed.layout}, but this module reads layout {LAYOUT}: fetch "
            "it again, from a daemon of this module's version"
        )
    words_at = wire.TABLE_REPLY.bytes + fixed.parameter_count * wire.PARAMETER.bytes
    if len(payload) != words_at + 4 * fixed.word_count:
        raise TableError("a table whose size does not fit its counts")
    if zlib.crc32(memoryview(payload)[words_at:]) != fixed.checksum:
        raise TableError("a table whose checksum is wrong: it is damaged")
    parameters = {}
    for at in range(wire.TABLE_REPLY.bytes, words_at, wire.PARAMETER.bytes):
        one = wire.PARAMETER.unpack(payload, at)
        parameters[name_in(info, "parameter", one.parameter)] = one.value
    return fixed, parameters, np.frombuffer(payload, "<u4", fixed.word_count, words_at)


def _check(words: Array) -> None:
    """Checks that the pieces of every entry lie within the words."""
    pieces = (len(words) - _PIECES - _SAMPLE_WORDS) // _TERMS
    if len(words) % _TERMS or not 1 <= pieces <= _PIECES_MAX:
        raise TableError("a damaged table: it has too few or too many words")
    entries = words[_R_OCTAVES:_PIECES].astype(np.int64)
    cuts = _MANTISSA_BITS - (entries & 31)
    fits = (cuts >= 0) & (cuts <= _CUTS_MAX)
    if not np.all(fits) or not np.all((entries >> 5) + (1 << cuts) <= pieces):
        raise TableError("a damaged table: an entry points outside of it")


def name_in(info: Info | None, kind: str, number: int) -> str | int:
    """Returns the name of an entry of a daemon's list, or without info its id."""
    if info is not None:
        for choice in info.choices[kind].values():
            if choice.id == number:
                return choice.name
    return number


def _notes(info: Info | None, notes: int) -> tuple[str | int, ...]:
    bits = [1 << i for i in range(32) if notes >> i & 1]
    return tuple(name_in(info, "note", bit) for bit in bits)
