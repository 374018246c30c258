"""Evaluates surfaces, what all media of one g and eta share, without a daemon and with its bits.

core/varying/surface.h describes the words. All arithmetic is in the precision of the evaluator. It
rounds each sum and product, in the order of core/models/surface.c and varying.c.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import wire
from .errors import ArgumentError, TableError
from .table import frame_of, name_in
from .values import Array, Info, in_short

# Positions of the words.
_VERSION = 0
_LEAST = 1  # of each axis
_MOST = 8
_CELLS = 15
_AT = 22  # where each function begins
_KAPPA = 31
_COLOUR_MOST = 36
_COLOUR_LEAST = 38
_SCATTERED_LEAST = 40
_FAR = 41
_ERROR = 44
_ENTRIES = 64
_AXIS = 64  # entries of each axis
_PATCHES = 512

# Axes, and functions.
_S, _RADIUS, _U, _COLOUR, _AXES = 0, 2, 3, 5, 7
_Q, _CDF, _X_OF_U, _TOTAL, _W_OF_COLOUR, _FUNCTIONS = 0, 1, 2, 4, 5, 9
_COLUMNS = (_RADIUS, _RADIUS, _U, _U + 1, None, _COLOUR, _COLOUR, _COLOUR + 1, _COLOUR + 1)
_DIFFUSE_FUNCTIONS = (6, 8)  # of transport alone

_EXPONENT = -40  # of the first octave of an axis
_CUTS_MAX = 7
_LIGHTS = 2
_SIGMA_T_LEAST, _SIGMA_T_MOST = 1e-6, 1e6  # of sigma_t' (1/mm)
_X_MOST = 1e15
_TRANSPORT, _BURLEY_DMFP = 29, 20  # ids of models


class Coefficients(NamedTuple):
    """Media, of the shape of the arguments; NaN where no medium has the colour or length."""

    sigma_a: Array  # 1/mm
    sigma_s: Array  # 1/mm
    scattered: Array  # sigma_s / (sigma_a + sigma_s), the albedo of a random walk


class Surface:
    """Finds media of colours for any model and, for the model transport, evaluates R, cdf, pdf,
    2 pi r R and the radius for a cdf, where every value has a medium of its own.

    model and moments are names if the daemon's lists were given, else ids. evaluator: "f32" or
    "f64", the precision of all arrays.
    """

    def __init__(self, data: bytes, info: Info | None = None, evaluator: str = "f32"):
        """data: exactly one frame, as a daemon sent it or save() wrote it."""
        fixed, self.parameters, words = frame_of(data, info)
        if (fixed.sigma_a, fixed.sigma_s) != (0, 0):
            raise TableError("the table of one medium, not a surface: use Table")
        if evaluator not in ("f32", "f64"):
            raise ArgumentError("evaluator: f32 or f64")
        self.data: bytes = data  # the frame
        self.evaluator = evaluator
        self.model_id: int = fixed.model
        self.moments_id: int = fixed.moments
        self.model: str | int = name_in(info, "model", fixed.model)
        self.moments: str | int = name_in(info, "moments", fixed.moments)
        self.g: float = fixed.g
        self.eta: float = fixed.eta
        self.numerical_error: float = fixed.numerical_error  # relative, the largest of all values
        self._lengths = None if info is None else {
            name: one.id for name, one in info.choices["length"].items()
        }
        single = evaluator == "f32"
        self._type: Any = np.float32 if single else np.float64
        self._bits: Any = np.int32 if single else np.int64
        self._mantissa = 23 if single else 52
        self._bias = 127 if single else 1023
        _check(words, fixed.model == _TRANSPORT)
        self._n = words.astype(np.int64)
        with np.errstate(all="ignore"):
            self._c = words.view("<f4").astype(self._type)
        self._scatter = self._type(1 - fixed.g)
        self._scattered_least = self._c[_SCATTERED_LEAST]
        if not self._scattered_least > 0:
            self._scattered_least = self._type(1e-12)

    def __repr__(self) -> str:
        return in_short(
            f"<Surface: {self.model}, {self.evaluator}; g {self.g:.3g}, eta {self.eta:.4g}",
            f"numerical error {self.numerical_error:.2g}, {len(self.data)} bytes>",
        )

    # ---- files -----------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the surface into a file, which libdipole can read, too."""
        Path(path).write_bytes(self.data)

    @classmethod
    def load(
        cls,
        source: str | os.PathLike[str] | bytes,
        info: Info | None = None,
        evaluator: str = "f32",
    ) -> Surface:
        """Loads a file, or bytes, that holds exactly one surface. info: that of a client; the
        surface then has names instead of ids."""
        if isinstance(source, (bytes, bytearray, memoryview)):
            return cls(bytes(source), info, evaluator)
        return cls(Path(source).read_bytes(), info, evaluator)

    # ---- values ----------------------------------------------------------------------------------

    def R(self, sigma_a: Any, sigma_s: Any, r: Any) -> Array:
        """Returns R in 1/mm^2 at radii r (mm), from 0 to infinity, of media with sigma_a and
        sigma_s (1/mm). The arrays have any shapes that can be broadcast with each other. A value
        that has no answer is NaN."""
        with self._arrays(sigma_a, sigma_s, r, np.inf) as (row, r, finish):
            return finish(self._R(row, r))

    def ring(self, sigma_a: Any, sigma_s: Any, r: Any) -> Array:
        """Returns 2 pi r R in 1/mm; arguments as of R()."""
        with self._arrays(sigma_a, sigma_s, r, np.inf) as (row, r, finish):
            return finish(self._ring(row, r, 1))

    def pdf(self, sigma_a: Any, sigma_s: Any, r: Any) -> Array:
        """Returns the probability density of radii in 1/mm; arguments as of R()."""
        with self._arrays(sigma_a, sigma_s, r, np.inf) as (row, r, finish):
            total = self._line(self._n[_AT + _TOTAL] + 4 * row.cell, row.t)
            return finish(self._ring(row, r, total.astype(np.float64)))

    def cdf(self, sigma_a: Any, sigma_s: Any, r: Any) -> Array:
        """Returns the power that leaves within r over all power that leaves; arguments as of R()."""
        with self._arrays(sigma_a, sigma_s, r, np.inf) as (row, r, finish):
            x = r * row.sigma_t
            value, kept = self._function(_CDF, _RADIUS, row, x)
            one = self._type(1)
            below = self._min(value * self._min(x / kept, one), np.nextafter(one, self._type(0)))
            inside = np.where(r < np.inf, below, one)
            return finish(np.where(row.scattered > 0, inside, self._type(0)))

    def radius(self, sigma_a: Any, sigma_s: Any, u: Any) -> Array:
        """Returns the radii in mm with cdf u, from 0 to 1; 1 gives infinity."""
        with self._arrays(sigma_a, sigma_s, u, 1) as (row, u, finish):
            one = self._type(1)
            near = u <= self._type(0.5)
            wanted = np.where(near, u, one - u)
            rest = np.where(near, 0, 1)
            x, kept = self._function(_X_OF_U + rest, _U + rest, row, wanted)
            below = np.where(near, self._min(wanted / kept, one), one)
            r = x * below * row.mfp
            inside = np.where(u < one, r, self._type(np.inf))
            return finish(np.where((row.scattered > 0) & (u > 0), inside, self._type(0)))

    def is_within_error(self, sigma_a: Any, sigma_s: Any, r: Any) -> Array:
        """Returns whether an error is stated for each value: that it has an answer, and is not so
        far from the source that a daemon gives it the status "far"."""
        with self._arrays(sigma_a, sigma_s, r, np.inf) as (row, r, finish):
            near = np.ones_like(r, bool)
            if self._c[_FAR] > 0:
                s = row.s
                far = self._c[_FAR] + s * (self._c[_FAR + 1] + s * self._c[_FAR + 2])
                near = ~(r * row.sigma_t * far > 1) | ~(row.scattered > 0)
            found: Array = finish(np.where(near, self._type(1), self._type(0))) > 0
            return found

    # ---- colours ---------------------------------------------------------------------------------

    def media(
        self,
        colour: Any,
        length: Any,
        *,
        given: str | int = "mean-free-path",
        light: str = "beam",
        specular: bool | float = False,
    ) -> Coefficients:
        """Finds the media of colours and lengths (mm); given and light as of Client.varying().

        specular: whether the colours contain what the surface itself reflects; or its share, the
        `specular` of a Varying. For diffuse light it has to be given as that number.
        """
        number = {"beam": 0, "diffuse": 1}.get(light)
        if number is None or not self._c[_COLOUR_LEAST + number] < self._c[_COLOUR_MOST + number]:
            raise ArgumentError("light: beam, or diffuse with transport")
        length_id = self._length_id(given)
        mirror = self._type(self._specular(specular, number))
        listed = np.broadcast_arrays(np.asarray(colour, self._type), np.asarray(length, self._type))
        with np.errstate(all="ignore"):
            return self._media(number, length_id, mirror, listed[0] + 0, listed[1] + 0)

    def _specular(self, specular: bool | float, light: int) -> float:
        if not isinstance(specular, bool):
            if not 0 <= specular < 1:
                raise ArgumentError("specular: from 0 to 1")
            return float(specular)
        if specular and light == 1:
            raise ArgumentError("specular: of diffuse light its share, specular of a Varying")
        normal = (self.eta - 1) / (self.eta + 1)
        return normal * normal if specular else 0.0

    def _length_id(self, given: str | int) -> int:
        usual = {"mean-free-path": 1, "diffuse-mean-free-path": 2, "classical-diffuse-path": 3}
        names = self._lengths if self._lengths is not None else usual
        found = names.get(given) if isinstance(given, str) else given
        if found not in (1, 2, 3):
            raise ArgumentError(f"given: one of {', '.join(names)}")
        return found

    def _media(
        self, light: int, length_id: int, mirror: Any, colour: Array, length: Array
    ) -> Coefficients:
        number = self._type
        one = number(1)
        least, most = self._c[_COLOUR_LEAST + light], self._c[_COLOUR_MOST + light]
        entered = (colour - mirror) / (one - mirror)
        has_medium = (entered <= most) & ((entered >= least) | ~((entered < 0) | (entered > 0)))
        v = self._max(entered, number(0)) / most
        near = v <= number(0.5)
        wanted = np.where(near, v, one - v)
        rest = np.where(near, 0, 1)
        kept = self._kept(_COLOUR + rest, wanted)
        cell, t = self._find(_COLOUR + rest, kept)
        at = self._n[_AT + _W_OF_COLOUR + rest * _LIGHTS + light] + 4 * cell
        found = self._line(at, t) * self._min(wanted / kept, one)
        s, w = np.where(near, one - found, found), np.where(near, found, one - found)
        shares = [number(length_id == one_id) for one_id in (1, 2, 3)]
        grosjean = s * np.sqrt(number(3) / (one + s * s))
        classical = s * number(1.7320508075688772)
        paths = one / (shares[0] + shares[1] * grosjean + shares[2] * classical)
        sigma_t = paths / length
        scattered = w * (one + s) / self._scatter
        absorbed = s * s
        in_range = (length > 0) & (sigma_t >= number(_SIGMA_T_LEAST))
        good = has_medium & in_range & (sigma_t <= number(_SIGMA_T_MOST))
        sigma_a, sigma_s = sigma_t * absorbed, sigma_t * scattered
        good &= self._row(sigma_a, sigma_s, False).good
        nan = number(np.nan)
        walks = scattered / (scattered + absorbed)
        return Coefficients(*(np.where(good, one, nan) for one in (sigma_a, sigma_s, walks)))

    # ---- rows and cells --------------------------------------------------------------------------

    def _arrays(self, sigma_a: Any, sigma_s: Any, values: Any, most: float) -> _Prepared:
        if self.model_id != _TRANSPORT:
            raise ArgumentError(
                "a surface evaluates transport alone: other models have formulas, which a daemon "
                "and libdipole evaluate"
            )
        listed = [np.asarray(one, self._type) for one in (sigma_a, sigma_s, values)]
        try:
            a, s, x = np.broadcast_arrays(*listed)
        except ValueError as error:
            raise ArgumentError(f"sigma_a, sigma_s, r or u: {error}") from error
        return _Prepared(self, a, s, x, most)

    def _row(self, sigma_a: Array, sigma_s: Array, placed: bool = True) -> _Row:
        one = self._type(1)
        reduced = sigma_s * self._scatter
        sigma_t = sigma_a + reduced
        mfp = one / sigma_t
        absorbed, scattered = sigma_a * mfp, reduced * mfp
        positive = sigma_a > 0 if self.model_id == _BURLEY_DMFP else sigma_a >= 0
        good = positive & (sigma_s >= 0) & (sigma_t >= self._type(_SIGMA_T_LEAST))
        good &= sigma_t <= self._type(_SIGMA_T_MOST)
        good &= ~(sigma_s > 0) | (scattered >= self._scattered_least)
        s = np.sqrt(absorbed)
        if not placed:
            return _Row(good, sigma_t, mfp, scattered, s, s, s, s)
        w = scattered / (one + s)
        by_w = np.where(s < self._type(0.5), 0, 1)
        cell, t = self._find(_S + by_w, self._kept(_S + by_w, np.where(by_w == 0, s, w)))
        cell = cell + by_w * self._n[_CELLS + _S]
        k = self._c[_KAPPA + 4]
        for i in (3, 2, 1, 0):
            k = self._c[_KAPPA + i] + s * k
        return _Row(good, sigma_t, mfp, scattered, s, s * k, cell, t)

    def _min(self, a: Any, b: Any) -> Array:
        return np.where(a < b, a, b)

    def _max(self, a: Any, b: Any) -> Array:
        return np.where(a > b, a, b)

    def _kept(self, axis: Any, x: Array) -> Array:
        return self._min(self._max(x, self._c[_LEAST + axis]), self._c[_MOST + axis])

    def _find(self, axis: Any, kept: Array) -> tuple[Array, Array]:
        """Returns the cells that hold coordinates, and the places in them, from 0 to 1."""
        bits = np.ascontiguousarray(kept).view(self._bits).astype(np.int64)
        bits = bits.reshape(np.shape(kept))
        octave = (bits >> self._mantissa) - (self._bias + _EXPONENT)
        entry = self._n[_ENTRIES + _AXIS * axis + octave]
        shift = self._mantissa - (entry & 31)
        mantissa = bits & ((1 << self._mantissa) - 1)
        index = mantissa >> shift
        rest = mantissa - (index << shift)
        unit = np.ldexp(self._type(1), -shift)  # a power of two
        return (entry >> 5) + index, rest.astype(self._type) * unit.astype(self._type)

    def _line(self, at: Any, t: Array) -> Array:
        c = self._c
        value: Array = c[at] + t * (c[at + 1] + t * (c[at + 2] + t * c[at + 3]))
        return value

    def _function(self, function: Any, axis: Any, row: _Row, x: Array) -> tuple[Array, Array]:
        """Returns a function of rows and a coordinate, and the coordinate, clamped to its axis."""
        kept = self._kept(axis, x)
        column, t = self._find(axis, kept)
        at = self._n[_AT + function] + 16 * (row.cell * self._n[_CELLS + axis] + column)
        p = row.t
        lines = [self._line(at + 4 * i, t) for i in range(4)]
        return lines[0] + p * (lines[1] + p * (lines[2] + p * lines[3])), kept

    def _x_R(self, row: _Row, true_x: Array, scale: Array) -> Array:
        """Returns scale x R / sigma_t'^2."""
        one = self._type(1)
        x = self._min(true_x, self._type(_X_MOST))
        Q, kept = self._function(_Q, _RADIUS, row, x)
        kx = row.k * x
        beyond = self._min(kept / x, one)
        far = np.where(x > kept, beyond * beyond, one)
        return self._times_exp(scale * row.scattered * (one + kx) * far, Q - kx)

    def _R(self, row: _Row, r: Array) -> Array:
        x = r * row.sigma_t
        value = self._x_R(row, x, row.sigma_t * row.sigma_t) / x
        return np.where((row.scattered > 0) & (r < np.inf), value, self._type(0))

    def _ring(self, row: _Row, r: Array, over: Any) -> Array:
        """Returns 2 pi r R over a number. Where R is infinite, next to the source, r R is
        constant."""
        near = np.where(np.isinf(self._R(row, r)), self._type(1e-20), r)
        R = self._R(row, near)
        ring = 6.28318530717958647693 * near.astype(np.float64) * (R.astype(np.float64) / over)
        return np.where(R > 0, ring.astype(self._type), R)

    def _times_exp(self, scale: Array, z: Array) -> Array:
        """Returns scale e^z."""
        number = self._type
        single = number is np.float32
        magic = number(1.5 * 2.0**self._mantissa)
        high, low, least, terms = (
            (float.fromhex("0x1.63p-1"), float.fromhex("-0x1.bd0106p-13"), -174.0, 8)
            if single
            else (float.fromhex("0x1.62e42feep-1"), float.fromhex("0x1.a39ef35793c76p-33"),
                  -1400.0, 14)
        )
        kept = self._max(z, number(least))
        k = (kept * number(1.44269504088896340736) + magic) - magic
        f = (kept - k * number(high)) - k * number(low)
        factorial = [1.0]
        for i in range(1, terms):
            factorial.append(factorial[-1] * i)
        e = np.full_like(f, number(1) / number(factorial[-1]))
        for i in range(terms - 2, -1, -1):
            e = number(1) / number(factorial[i]) + f * e
        power = np.where(np.isnan(k), 0, k).astype(np.int64) + 2 * self._bias
        half = power >> 1  # two powers of two, since 2^k alone may underflow
        both = [(one << self._mantissa).astype(self._bits).view(number) for one in
                (half, power - half)]
        value: Array = scale * e * both[0] * both[1]
        return value


class _Row(NamedTuple):
    """Media, and where they are on the axis of albedos."""

    good: Array
    sigma_t: Array
    mfp: Array
    scattered: Array
    s: Array
    k: Array
    cell: Array
    t: Array


class _Prepared:
    """Yields the rows of media, the numbers, and a function that puts NaN where there is no
    answer. Infinities and NaN on the way are no errors."""

    def __init__(self, surface: Surface, a: Array, s: Array, x: Array, most: float):
        self._arguments = surface, a, s, x, most
        self._errors: Any = np.errstate(all="ignore")

    def __enter__(self) -> tuple[_Row, Array, Callable[[Array], Array]]:
        self._errors.__enter__()
        surface, a, s, x, most = self._arguments
        number = surface._type
        shape = x.shape
        row = surface._row(a.reshape(-1), s.reshape(-1))
        in_range = ((x >= 0) & (x <= most)).reshape(-1)

        def finish(values: Array) -> Array:
            found: Array = np.where(row.good & in_range, values, number(np.nan)).reshape(shape)
            assert found.dtype == number
            return found

        return row, x.reshape(-1) + number(0), finish

    def __exit__(self, *exception: Any) -> None:
        self._errors.__exit__(*exception)


# ---- words ---------------------------------------------------------------------------------------


def _octaves(words: Array, axis: int) -> Iterator[int]:
    """Yields the entries of the octaves between the ends of an axis."""
    ends = words[[_LEAST + axis, _MOST + axis]].view("<f4").astype(np.float64)
    if not 0 < ends[0] < ends[1] < np.inf:
        raise TableError("a damaged surface: an axis has no length")
    mantissa, first = np.frexp(ends[0])
    first = int(first) - 1 - _EXPONENT
    end = int(np.frexp(ends[1])[1]) - _EXPONENT
    if mantissa > 0.5 or first < 0 or end > _AXIS:
        raise TableError("a damaged surface: an axis begins or ends where it cannot")
    begin = _ENTRIES + _AXIS * axis
    yield from map(int, words[begin + first : begin + end])


def _check(words: Array, is_transport: bool) -> None:
    """Checks that evaluating reads no words outside, whatever numbers they hold."""
    if len(words) < _PATCHES or words[_VERSION] != 1:
        raise TableError("not the words of a surface of this version")
    for axis in range(0 if is_transport else _COLOUR, _AXES):
        cells = 0
        for entry in _octaves(words, axis):
            if entry >> 5 != cells or entry & 31 > _CUTS_MAX:
                raise TableError("a damaged surface: the cells of an axis are not in turn")
            cells += 1 << (entry & 31)
        if cells != words[_CELLS + axis]:
            raise TableError("a damaged surface: an axis has another number of cells")
    rows = int(words[_CELLS + _S]) + int(words[_CELLS + _S + 1])
    for function in range(_FUNCTIONS):
        of_transport = function < _W_OF_COLOUR or function in _DIFFUSE_FUNCTIONS
        if of_transport and not is_transport:
            continue
        columns_of = _COLUMNS[function]
        columns = 1 if columns_of is None else int(words[_CELLS + columns_of])
        lines = rows if function < _W_OF_COLOUR else 1
        count = lines * columns * (16 if function < _TOTAL else 4)
        at = int(words[_AT + function])
        if at < _PATCHES or at + count > len(words):
            raise TableError("a damaged surface: a function lies outside of it")
