"""Tables of the evaluator `lut`, which libdipole evaluates without a daemon, and with its bits."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from . import wire
from .arguments import names_of
from .errors import ArgumentError, TableError
from .library import Fetched, address, bytes_of, frame_bytes, library, succeeds
from .values import Array, Info, Medium, shows

_QUANTITIES = {name: wire.QUANTITIES[name] for name in ("R", "albedo", "cdf", "pdf", "2_pi_r_R", "S")}


class TableErrors(NamedTuple):
    """The relative errors of values of a table, for the radii of one call."""

    numerical_error_constant: float  # constant part of the numerical error
    numerical_error_per_mm: float  # this number times r is added to the constant part
    model_error: float  # error of the model against radiative transport; NaN if not known


@shows("model", "medium", "albedo", "numerical_error_constant", "model_error")
class Table(Fetched):
    """Looks up one medium's R, cdf, pdf, 2 pi r R, and the radius for a given cdf.

    model, moments and notes are names if the daemon's lists were given, else ids.
    """

    def __init__(self, data: bytes, info: Info | None = None):
        """data: exactly one frame, as a daemon sent it or save() wrote it."""
        super().__init__(data, info, "table")
        fixed = self._fixed
        self.layout: int = fixed.layout  # proto/PROTOCOL.md, "table"
        bits = [1 << i for i in range(32) if fixed.notes >> i & 1]
        self.notes: tuple[str | int, ...] = tuple(self._name("note", bit) for bit in bits)
        self.medium = self.layers[0]
        self.albedo: float = fixed.albedo  # integral of 2 pi r R(r) over all radii
        # numerical_error() and errors() have the errors at given radii.
        self.numerical_error_constant: float = fixed.numerical_error
        self.numerical_error_per_mm: float = fixed.numerical_error_per_mm
        self.reach_mm: float = fixed.reach  # the two errors above hold for R up to this radius
        # model error at all radii: 0, or NaN if not known
        self.model_error: float = fixed.model_error
        # below this radius an asymptotic formula holds
        self.pieces_from_mm: float = fixed.pieces_from
        # from this radius on an asymptotic formula holds
        self.pieces_to_mm: float = fixed.pieces_to
        self.radius_least_mm: float = fixed.radius_least  # the least radius that the model covers
        self.radius_most_mm: float = fixed.radius_most  # the largest radius that the model covers
        self.words: Array = np.frombuffer(data, "<u4", -1, len(data) - 4 * fixed.word_count)

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
        data = bytes_of(source)
        tables: list[Table] = []
        while data or not tables:
            end = frame_bytes(data)
            tables.append(cls(data[:end], info))
            data = data[end:]
        return tables

    def R(self, r: Any) -> Array:
        """Returns R in 1/mm^2 per unit of power that entered, as float32 and in the shape of r. r:
        radii in mm, from 0 to infinity."""
        return self._values("R", r)

    def cdf(self, r: Any) -> Array:
        """Returns the power that leaves within r over all power that leaves, from 0 to 1."""
        return self._values("cdf", r)

    def pdf(self, r: Any) -> Array:
        """Returns the probability density of radii in 1/mm: 2 pi r R over the albedo."""
        return self._values("pdf", r)

    def ring(self, r: Any) -> Array:
        """Returns 2 pi r R, the power that leaves per mm of radius, in 1/mm. It is finite even
        where R is infinite at r = 0."""
        return self._values("2_pi_r_R", r)

    def _values(self, quantity: str, r: Any) -> Array:
        radii = _floats(r)
        values = np.empty_like(radii)
        arguments = (ctypes.c_size_t(radii.size), address(radii), address(values))
        evaluate = library().dipole_table_values
        if not succeeds(evaluate, self._handle, _QUANTITIES[quantity], *arguments):
            raise self._outside()
        return values.reshape(np.shape(r))

    def _outside(self) -> ArgumentError:
        least = max(self.radius_least_mm, 0.0)
        return ArgumentError(f"r: from {least:g} to {self.radius_most_mm:g} mm")

    def radius(self, u: Any) -> Array:
        """Returns the radii in mm with cdf(r) = u: random u give radii that are distributed as the
        light. u: from 0 to 1; 1 gives infinity. All radii are 0 if the medium does not scatter."""
        numbers = _floats(u)
        radii = np.empty_like(numbers)
        arguments = (ctypes.c_size_t(radii.size), address(numbers), address(radii))
        if not succeeds(library().dipole_table_radii, self._handle, *arguments):
            raise ArgumentError("u: from 0 to 1")
        return radii.reshape(np.shape(u))

    def errors(self, r: Any, wanted: str | Iterable[str] = ("R",)) -> TableErrors:
        """Returns the errors of quantities at the radii of a call, r (mm): those that a daemon
        states for an eval with evaluator lut at these radii. wanted: names of quantities that a
        table holds: R, albedo, cdf, pdf, 2_pi_r_R, S."""
        names = names_of(wanted, ())
        for name in names:
            if name not in _QUANTITIES:
                raise ArgumentError(f"wanted: {name!r}: a table does not hold it")
        return self._errors(_floats(r), sum({_QUANTITIES[name] for name in names}))

    def _errors(self, radii: Array, wanted: int) -> TableErrors:
        errors = (ctypes.c_double * 3)()  # struct dipole_errors of clients/c/dipole.h
        arguments = (wanted, ctypes.c_size_t(radii.size), address(radii), errors)
        if not succeeds(library().dipole_table_errors, self._handle, *arguments):
            raise self._outside()
        return TableErrors(*errors)

    def numerical_error(self, r: Any) -> Array:
        """Returns how far R at r (mm) may be from the model's exact formula, relative. That of the
        other values is not larger, except that cdf and pdf may be off by numerical_error_constant.
        """
        radii = _floats(r)
        of_R = _QUANTITIES["R"]
        constant = [self._errors(one, of_R).numerical_error_constant for one in radii[:, None]]
        growth = np.zeros(radii.size)  # At infinity, 0 times infinity would be NaN.
        if self.numerical_error_per_mm > 0:
            growth = self.numerical_error_per_mm * radii.astype(np.float64)
        return (constant + growth).reshape(np.shape(r))


def _floats(values: Any) -> Array:
    """Makes a flat copy in single precision."""
    flat: Array = np.array(values, np.float32).reshape(-1)
    return flat
