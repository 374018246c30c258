"""Tables: what the evaluator `lut` looks up, to be evaluated here with the daemon's own bits.

All arithmetic is in single precision, one rounded sum or product after the other, in the order of
core/models/lut.c: so it gives the same bits as the daemon, on every machine.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from . import wire
from .errors import ArgumentError, TableError
from .values import Info, Medium

LAYOUT = 1  # of the words: proto/PROTOCOL.md, "table"

# Positions of the words: numbers, then entries by octave of the function's argument, then pieces.
_R_OCTAVES = 16
_CDF_OCTAVES = _R_OCTAVES + 256
_RADIUS_OCTAVES = _CDF_OCTAVES + 256
_COMPLEMENT_OCTAVES = _RADIUS_OCTAVES + 128
_PIECES = _COMPLEMENT_OCTAVES + 128
_TERMS = 4
_PIECES_MAX = 65536

_MANTISSA_BITS = 23
_CUTS_MAX = 11

_ZERO = np.float32(0)
_ONE = np.float32(1)
_HALF = np.float32(0.5)
_INFINITY = np.float32(np.inf)
_TWO_OVER_LN_2 = np.float32(2.88539008)
_2_TO_THE_24 = np.float32(2.0**24)


class Table:
    """One medium's R, cdf, pdf, 2 pi r R, and radii for given cdf, by lookup.

    model, moments and notes are names where a daemon's lists were at hand, else ids.
    """

    def __init__(self, data: bytes, info: Info | None = None):
        """data: a whole frame, the reply of a daemon (or what save() wrote) and nothing more."""
        payload = _payload_of(data)
        fixed = wire.TABLE_REPLY.unpack(payload)
        if fixed.layout != LAYOUT:
            raise TableError(f"a table of layout {fixed.layout}: this module knows layout {LAYOUT}")
        parameters_bytes = fixed.parameter_count * wire.PARAMETER.bytes
        words_at = wire.TABLE_REPLY.bytes + parameters_bytes
        if len(payload) != words_at + 4 * fixed.word_count:
            raise TableError("a table whose size does not fit its counts")
        if zlib.crc32(memoryview(payload)[words_at:]) != fixed.checksum:
            raise TableError("a table whose checksum is wrong: it is damaged")
        self.data: bytes = data  # the frame
        self.layout: int = fixed.layout
        self.model_id: int = fixed.model
        self.moments_id: int = fixed.moments
        self.model: str | int = _name(info, "model", fixed.model)
        self.moments: str | int = _name(info, "moments", fixed.moments)
        self.notes: tuple[str | int, ...] = _notes(info, fixed.notes)
        self.medium = Medium(fixed.sigma_a, fixed.sigma_s, fixed.g, fixed.eta)
        self.parameters: dict[str | int, float] = {}  # those of the request
        for at in range(wire.TABLE_REPLY.bytes, words_at, wire.PARAMETER.bytes):
            one = wire.PARAMETER.unpack(payload, at)
            self.parameters[_name(info, "parameter", one.parameter)] = one.value
        self.albedo: float = fixed.albedo  # integral of 2 pi r R(r) over all radii
        self.numerical_error_constant: float = fixed.numerical_error
        self.numerical_error_per_mm: float = fixed.numerical_error_per_mm
        self.model_error: float = fixed.model_error  # against transport; NaN: not measured
        self.pieces_from_mm: float = fixed.pieces_from  # between these there are pieces; outside,
        self.pieces_to_mm: float = fixed.pieces_to  # known asymptotes
        self.radius_least_mm: float = fixed.radius_least  # the radii that the model covers
        self.radius_most_mm: float = fixed.radius_most
        self.words = np.frombuffer(payload, "<u4", fixed.word_count, words_at)  # read-only
        _check(self.words)
        # In the machine's byte order, which is what arithmetic is done in.
        self._entries = self.words.astype(np.int32)
        self._c = self.words.view("<f4").astype(np.float32)
        if (float(self._c[0]), float(self._c[1])) != (self.pieces_from_mm, self.pieces_to_mm):
            raise TableError("a table whose pieces are not where it says")
        (
            self._first_mm,
            self._last_mm,
            self._scale,
            self._ring_scale,
            self._pdf_scale,
            self._near_power,
            self._near_R,
            self._near_log,
            self._near_cdf,
            self._near_cdf_log,
            self._far,
            self._limit,
            self._first_u,
            self._near_radius,
        ) = self._c[:14]

    # ---- files -----------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the table into a file, which `dipole eval --table` and libdipole read, too."""
        Path(path).write_bytes(self.data)

    @classmethod
    def load(cls, source: str | os.PathLike[str] | bytes, info: Info | None = None) -> Table:
        """The only table in a file, or in bytes. info: of a client, for names instead of ids."""
        tables = cls.load_all(source, info)
        if len(tables) != 1:
            raise TableError(f"{len(tables)} tables: use load_all()")
        return tables[0]

    @classmethod
    def load_all(
        cls, source: str | os.PathLike[str] | bytes, info: Info | None = None
    ) -> list[Table]:
        """All tables of a file, such as one for each channel, which stand one behind the other."""
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

    def R(self, r: Any) -> np.ndarray:
        """R at radii r (mm, from 0 to infinity), 1/mm^2 per unit of power that entered: float32, of
        the shape of r."""
        return self._evaluate(r, self._inside_R, self._outside_R)

    def cdf(self, r: Any) -> np.ndarray:
        """The energy within r over the albedo, from 0 to 1."""
        return self._evaluate(r, self._inside_cdf, self._outside_cdf)

    def pdf(self, r: Any) -> np.ndarray:
        """The density of radii, 2 pi r R over the albedo, 1/mm."""

        def inside(x: np.ndarray) -> np.ndarray:
            return self._inside_ring(x, self._pdf_scale)

        def outside(x: np.ndarray) -> np.ndarray:
            return self._outside_ring(x, self._pdf_scale)

        return self._evaluate(r, inside, outside)

    def ring(self, r: Any) -> np.ndarray:
        """2 pi r R, the power that leaves per mm of radius, 1/mm: finite at r = 0, where R of some
        models is infinite."""

        def inside(x: np.ndarray) -> np.ndarray:
            return self._inside_ring(x, self._ring_scale)

        def outside(x: np.ndarray) -> np.ndarray:
            return self._outside_ring(x, self._ring_scale)

        return self._evaluate(r, inside, outside)

    def radius(self, u: Any) -> np.ndarray:
        """Radii (mm) with cdf(r) = u, for u from 0 to 1 (infinity): for drawing them at random.
        0 where nothing scatters."""
        share = _floats(u)
        if not np.all((share >= 0) & (share <= 1)):
            raise ArgumentError("u: from 0 to 1")
        return self._look_up(
            share, self._inside_radius, self._outside_radius, self._first_u, _ONE
        ).reshape(np.shape(u))

    def numerical_error(self, r: Any) -> np.ndarray:
        """How far a value at r (mm) may be from the model's exact formula, relative; as measured
        between all nodes."""
        radii = np.asarray(r, np.float64)
        growth = np.zeros_like(radii)  # at infinity too, where 0 times infinity would be no number
        if self.numerical_error_per_mm > 0:
            growth = self.numerical_error_per_mm * radii
        return self.numerical_error_constant + growth

    def _evaluate(
        self,
        r: Any,
        inside: Callable[[np.ndarray], np.ndarray],
        outside: Callable[[np.ndarray], np.ndarray],
    ) -> np.ndarray:
        radii = _floats(r)
        wide = radii.astype(np.float64)
        if not np.all((wide >= 0) & (wide >= self.radius_least_mm) & (wide <= self.radius_most_mm)):
            least = max(self.radius_least_mm, 0.0)
            raise ArgumentError(f"r: from {least:g} to {self.radius_most_mm:g} mm")
        values = self._look_up(radii, inside, outside, self._first_mm, self._last_mm)
        return values.reshape(np.shape(r))

    @staticmethod
    def _look_up(
        x: np.ndarray,
        inside: Callable[[np.ndarray], np.ndarray],
        outside: Callable[[np.ndarray], np.ndarray],
        least: np.float32,
        most: np.float32,
    ) -> np.ndarray:
        """All as if they were inside, from least to below most; then those that are not."""
        with np.errstate(all="ignore"):
            values = inside(x)
            beyond = (x < least) | (x >= most)
            if beyond.any():
                values[beyond] = outside(x[beyond])
        assert values.dtype == np.float32
        return values

    # ---- inside ----------------------------------------------------------------------------------

    def _piece(self, octaves: int, x: np.ndarray) -> np.ndarray:
        """The polynomial for x, found by its bits: exponent, then the leading bits of the mantissa.
        x is not negative."""
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
        # A minus sign: the piece is written from its right end.
        w = np.where(np.signbit(c0), _ONE - t, t)
        return np.abs(c0) + w * (self._c[at + 1] + w * (self._c[at + 2] + w * self._c[at + 3]))

    def _inside_R(self, r: np.ndarray) -> np.ndarray:
        return self._piece(_R_OCTAVES, r) * self._scale

    def _inside_ring(self, r: np.ndarray, scale: np.float32) -> np.ndarray:
        return _times_radius(self._piece(_R_OCTAVES, r), r, scale)

    def _inside_cdf(self, r: np.ndarray) -> np.ndarray:
        value = self._piece(_CDF_OCTAVES, r)
        return np.where(value < 1, value, _ONE)

    def _inside_radius(self, u: np.ndarray) -> np.ndarray:
        """By what is next to its end: u, or 1 - u, which is exact."""
        near = np.where(u <= _HALF, u, _ONE - u)
        by_u = self._piece(_RADIUS_OCTAVES, near)
        return np.where(u <= _HALF, by_u, self._piece(_COMPLEMENT_OCTAVES, near))

    # ---- outside: below the first radius, from the last one on -----------------------------------

    def _octaves_below(self, r: np.ndarray) -> np.ndarray:
        """log2(first_mm / r)"""
        return _log2(self._first_mm.reshape(1)) - (_log2(r * _2_TO_THE_24) - np.float32(24))

    def _near_flat(self, r: np.ndarray) -> np.ndarray:
        """R over the scale, of a profile that is not steep."""
        if not self._near_log > 0:
            return np.full_like(r, self._near_R)
        rising = np.where(r > 0, self._octaves_below(r), _INFINITY)
        return self._near_R + self._near_log * rising

    def _near_R_at(self, r: np.ndarray) -> np.ndarray:
        """In the order in which nothing overflows or underflows before the product does."""
        if not self._near_power > 0:
            return self._near_flat(r) * self._scale
        if not self._limit > 0:
            return np.zeros_like(r)
        nearest = self._near_R * (self._scale / r)
        return np.where(r < 1, nearest, self._near_R / r * self._scale)

    def _near_ring(self, r: np.ndarray, scale: np.float32) -> np.ndarray:
        """r R times what scale is over the scale of R."""
        if self._near_power > 0:
            return np.full_like(r, self._near_R * scale)
        return np.where(r > 0, _times_radius(self._near_flat(r), r, scale), _ZERO)

    def _near_cdf_factor(self, r: np.ndarray) -> np.ndarray:
        """The cdf over r^2, of a profile that is not steep."""
        rising = np.where(r > 0, self._octaves_below(r), _ZERO)
        return self._near_cdf + self._near_cdf_log * rising

    def _near_cdf_at(self, r: np.ndarray) -> np.ndarray:
        if self._near_power > 0:
            return self._near_cdf * r
        return self._near_cdf_factor(r) * r * r

    def _near_radius_at(self, u: np.ndarray) -> np.ndarray:
        """Where the cdf is factor r^2 the factor depends on ln r, which hardly moves it."""
        if self._near_power > 0:
            return self._near_radius * u
        root = np.sqrt(u)
        r = self._near_radius * root
        for _ in range(4):
            r = root / np.sqrt(self._near_cdf_factor(r))
        return r

    def _outside_R(self, r: np.ndarray) -> np.ndarray:
        ratio = self._last_mm / r
        far = self._far * ratio * ratio * ratio
        return np.where(r < self._first_mm, self._near_R_at(r), far * self._scale)

    def _outside_ring(self, r: np.ndarray, scale: np.float32) -> np.ndarray:
        ratio = self._last_mm / r
        far = self._far * self._last_mm * ratio * ratio
        return np.where(r < self._first_mm, self._near_ring(r, scale), far * scale)

    def _outside_cdf(self, r: np.ndarray) -> np.ndarray:
        return np.where(r < self._first_mm, self._near_cdf_at(r), self._limit)

    def _outside_radius(self, u: np.ndarray) -> np.ndarray:
        return np.where(u < 1, self._near_radius_at(u), _INFINITY if self._limit > 0 else _ZERO)


def _floats(values: Any) -> np.ndarray:
    """A flat copy in single precision, in which -0 is 0."""
    return np.array(values, np.float32).reshape(-1) + _ZERO


def _times_radius(piece: np.ndarray, r: np.ndarray, scale: np.float32) -> np.ndarray:
    """In the order in which nothing underflows before the product does."""
    return piece * (r * scale) if scale > 1 else piece * r * scale


def _log2(x: np.ndarray) -> np.ndarray:
    """log2 of normal numbers, as core/models/lut.c has it: 2 artanh(s) / ln 2 of the mantissa
    (1 + s) / (1 - s)."""
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
    """The length of the frame that data starts with."""
    if len(data) < wire.HEADER.bytes + wire.TABLE_REPLY.bytes:
        raise TableError("no table: too short")
    header = wire.HEADER.unpack(data)
    known = (header.magic, header.version) == (wire.MAGIC, wire.VERSION)
    if not known or header.type != wire.MESSAGES["table"] | wire.REPLY:
        raise TableError("no table: it does not start as one")
    end = wire.HEADER.bytes + header.payload_bytes
    if len(data) < end:
        raise TableError("a table whose end is missing")
    return end


def _payload_of(data: bytes) -> bytes:
    if _frame_bytes(data) != len(data):
        raise TableError("a table with something behind it")
    payload = data[wire.HEADER.bytes :]
    if len(payload) < wire.TABLE_REPLY.bytes:
        raise TableError("no table: too short")
    return payload


def _check(words: np.ndarray) -> None:
    """Every entry's piece, and all of its octave's, must lie within the words."""
    pieces = (len(words) - _PIECES) // _TERMS
    if len(words) % _TERMS or not 1 <= pieces <= _PIECES_MAX:
        raise TableError("a table with too few or too many words")
    entries = words[_R_OCTAVES:_PIECES].astype(np.int64)
    cuts = _MANTISSA_BITS - (entries & 31)
    fits = (cuts >= 0) & (cuts <= _CUTS_MAX)
    if not np.all(fits) or not np.all((entries >> 5) + (1 << cuts) <= pieces):
        raise TableError("a table with an entry that points outside of it")


def _name(info: Info | None, kind: str, number: int) -> str | int:
    if info is not None:
        for choice in info.choices[kind].values():
            if choice.id == number:
                return choice.name
    return number


def _notes(info: Info | None, notes: int) -> tuple[str | int, ...]:
    bits = [1 << i for i in range(32) if notes >> i & 1]
    return tuple(_name(info, "note", bit) for bit in bits)
