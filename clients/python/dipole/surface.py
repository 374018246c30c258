"""Surfaces: what all media of one g and eta share. libdipole evaluates them with the same bits."""

from __future__ import annotations

import ctypes
import os
from typing import Any, NamedTuple

import numpy as np

from . import wire
from .errors import ArgumentError, naming
from .library import Fetched, address, bytes_of, call, library
from .values import Array, Info, shows

_LENGTHS = {
    "mean-free-path": 1, "diffuse-mean-free-path": 2, "classical-diffuse-path": 3,
    "extinction-path": 4,
}  # fmt: skip
_LIGHTS = {"beam": 1, "diffuse": 2}


class _Parameter(ctypes.Structure):
    """struct dipole_parameter of clients/c/dipole.h."""

    _fields_ = (("id", ctypes.c_uint), ("value", ctypes.c_double))


class _Query(ctypes.Structure):
    """struct dipole_varying_query."""

    _fields_ = (
        *((name, ctypes.c_uint) for name in
          ("model", "evaluator", "moments", "wanted", "coefficients")),
        ("g", ctypes.c_double),
        ("eta", ctypes.c_double),
        *((name, ctypes.c_void_p) for name in ("sigma_a", "sigma_s", "colour", "length")),
        ("given", ctypes.c_uint),
        ("light", ctypes.c_uint),
        ("specular", ctypes.c_bool),
        ("r", ctypes.c_void_p),
        ("u", ctypes.c_void_p),
        ("value_count", ctypes.c_uint64),
        ("parameters", ctypes.POINTER(_Parameter)),
        ("parameter_count", ctypes.c_size_t),
        ("deadline_ms", ctypes.c_uint),
    )  # fmt: skip


class _Result(ctypes.Structure):
    """struct dipole_varying_result."""

    _fields_ = (
        *((name, ctypes.c_uint) for name in
          ("model", "evaluator", "moments", "wanted", "coefficients", "notes")),
        ("value_count", ctypes.c_uint64),
        ("computed_count", ctypes.c_uint64),
        ("statuses", ctypes.c_void_p),
        *((name, ctypes.c_double) for name in
          ("numerical_error", "model_error", "colour_least", "colour_most", "specular")),
    )  # fmt: skip


class Coefficients(NamedTuple):
    """Media, of the shape of the arguments; NaN where no medium has the colour or length."""

    sigma_a: Array  # 1/mm
    sigma_s: Array  # 1/mm
    scattered: Array  # sigma_s / (sigma_a + sigma_s), the albedo of a random walk


@shows("model", "evaluator", "g", "eta", "numerical_error")
class Surface(Fetched):
    """Evaluates R, cdf, pdf, 2 pi r R and the radius for a cdf, where every value has a medium of
    its own, and finds media of colours.

    model and moments are names if the daemon's lists were given, else ids. evaluator: "f32" or
    "f64", the precision of all arrays.
    """

    def __init__(self, data: bytes, info: Info | None = None, evaluator: str = "f32"):
        """data: exactly one frame, as a daemon sent it or save() wrote it."""
        if evaluator not in ("f32", "f64"):
            raise ArgumentError("evaluator: f32 or f64")
        super().__init__(data, info, "surface")
        self.evaluator = evaluator
        self.g: float = self.layers[0].g
        self.eta: float = self.layers[0].eta
        # Relative, the largest of all values.
        self.numerical_error: float = self._fixed.numerical_error
        self._type: Any = np.float32 if evaluator == "f32" else np.float64

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.data, self._info, self.evaluator)

    @classmethod
    def load(
        cls,
        source: str | os.PathLike[str] | bytes,
        info: Info | None = None,
        evaluator: str = "f32",
    ) -> Surface:
        """Loads a file, or bytes, that holds exactly one surface. info: that of a client; the
        surface then has names instead of ids."""
        return cls(bytes_of(source), info, evaluator)

    # ---- values ----------------------------------------------------------------------------------

    def R(self, sigma_a: Any, sigma_s: Any, r: Any) -> Array:
        """Returns R in 1/mm^2 at radii r (mm), from 0 to infinity, of media with sigma_a and
        sigma_s (1/mm). The arrays have any shapes that can be broadcast with each other. A value
        that cannot be computed is NaN."""
        return self._values(wire.QUANTITIES["R"], sigma_a=sigma_a, sigma_s=sigma_s, r=r)

    def ring(self, sigma_a: Any, sigma_s: Any, r: Any) -> Array:
        """Returns 2 pi r R in 1/mm; arguments as of R()."""
        return self._values(wire.QUANTITIES["2_pi_r_R"], sigma_a=sigma_a, sigma_s=sigma_s, r=r)

    def pdf(self, sigma_a: Any, sigma_s: Any, r: Any) -> Array:
        """Returns the probability density of radii in 1/mm; arguments as of R()."""
        return self._values(wire.QUANTITIES["pdf"], sigma_a=sigma_a, sigma_s=sigma_s, r=r)

    def cdf(self, sigma_a: Any, sigma_s: Any, r: Any) -> Array:
        """Returns the power that leaves within r over all that leaves; arguments as of R()."""
        return self._values(wire.QUANTITIES["cdf"], sigma_a=sigma_a, sigma_s=sigma_s, r=r)

    def radius(self, sigma_a: Any, sigma_s: Any, u: Any) -> Array:
        """Returns the radii in mm with cdf u, from 0 to 1; 1 gives infinity."""
        return self._values(wire.QUANTITIES["r"], sigma_a=sigma_a, sigma_s=sigma_s, u=u)

    def is_within_error(self, sigma_a: Any, sigma_s: Any, r: Any) -> Array:
        """Returns whether an error is stated for each value: that it was computed, and is not so
        far from the source that a daemon gives it the status "far"."""
        arrays = {"sigma_a": sigma_a, "sigma_s": sigma_s, "r": r}
        statuses = self._evaluate(arrays, wanted=wire.QUANTITIES["R"])[1]
        return np.asarray(statuses == wire.VALUE_OK)

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
        `specular` of a Varying.
        """
        names = dict(_LENGTHS)
        if self._info is not None:
            names = {name: one.id for name, one in self._info.choices["length"].items()}
        length_id = names.get(given) if isinstance(given, str) else given
        if length_id is None:
            raise ArgumentError(f"given: one of {', '.join(names)}")
        if light not in _LIGHTS:
            raise ArgumentError(f"light: one of {', '.join(_LIGHTS)}")
        arrays, _, share = self._evaluate(
            {"colour": colour, "length": length},
            coefficients=7, given=length_id, light=_LIGHTS[light], specular=bool(specular),
        )  # fmt: skip
        if not isinstance(specular, (bool, np.bool_)) and specular not in (0, share):
            raise ArgumentError(f"specular: a bool, or the share, {share:g}")
        return Coefficients(*arrays)

    def _values(self, quantity: int, **arguments: Any) -> Array:
        return self._evaluate(arguments, wanted=quantity)[0][0]

    def _evaluate(
        self, arguments: dict[str, Any], wanted: int = 0, coefficients: int = 0, **fields: Any
    ) -> tuple[list[Array], Array, float]:
        """Returns the arrays of the wanted quantity or of all coefficients, the statuses, and the
        share of the light that the surface reflects."""
        with naming(", ".join(arguments)):
            listed = np.broadcast_arrays(
                *(np.asarray(one, self._type) for one in arguments.values())
            )
        shape = listed[0].shape
        arrays = [np.ascontiguousarray(one) for one in listed]
        parameters = [_Parameter(int(one["parameter"]), float(one["value"])) for one in self._listed]
        query = _Query(
            model=self.model_id,
            evaluator=wire.EVALUATORS[self.evaluator],
            moments=self.moments_id,
            wanted=wanted,
            coefficients=coefficients,
            g=self.g,
            eta=self.eta,
            value_count=arrays[0].size,
            parameters=(_Parameter * len(parameters))(*parameters),
            parameter_count=len(parameters),
            **{name: address(one) for name, one in zip(arguments, arrays, strict=True)},
            **fields,
        )
        calls, result = library(), ctypes.POINTER(_Result)()
        call(calls.dipole_varying_at_home, self._handle, ctypes.byref(query), ctypes.byref(result))

        def copied(at: int, type: Any) -> Array:
            size = arrays[0].size * np.dtype(type).itemsize
            return np.frombuffer(bytearray(ctypes.string_at(at, size)), type).reshape(shape)

        def found(what: str, bit: int) -> Array:
            get = getattr(calls, f"dipole_{what}_{self.evaluator}")
            get.restype = ctypes.c_void_p
            return copied(get(result, bit), self._type)

        try:
            values = [found("varying", wanted)] if wanted else [
                found("coefficients", 1 << i) for i in range(len(Coefficients._fields))
            ]  # fmt: skip
            return values, copied(result.contents.statuses, np.uint8), result.contents.specular
        finally:
            calls.dipole_varying_result_free(result)
