"""Loads libdipole, which evaluates tables, surfaces and points here, with the daemon's bits."""

from __future__ import annotations

import ctypes
import functools
import os
from pathlib import Path
from typing import Any

from . import wire
from .connection import built
from .errors import ArgumentError, LibraryError, TableError
from .values import Array, Info, Medium

_NAME = "libdipole.so.0"
_ERROR_TABLE = 8


class _Error(ctypes.Structure):
    """struct dipole_error of clients/c/dipole.h."""

    _fields_ = (
        ("kind", ctypes.c_int),
        ("status", ctypes.c_uint),
        ("index", ctypes.c_uint64),
        ("field", ctypes.c_char * 33),
        ("allowed", ctypes.c_char * 81),
        ("retry_after_ms", ctypes.c_uint32),
        ("text", ctypes.c_char * 256),
    )


PATH: str | None = None  # path of the library; None: library() finds it


@functools.cache
def library(path: str | None = None) -> ctypes.CDLL:
    """Loads the library at a path; or else that of the clone that holds this module, the one below
    the same prefix, or the installed one. Raises LibraryError if there is none."""
    below_prefix = Path(__file__).resolve().parents[3] / _NAME
    near = built(_NAME) or (below_prefix if below_prefix.exists() else _NAME)
    try:
        return ctypes.CDLL(path or PATH or str(near))
    except OSError as error:
        text = "tables, surfaces and gather_at_home() need libdipole: run make, or install it"
        raise LibraryError(f"{text} ({error})") from None


def address(array: Array) -> ctypes.c_void_p:
    """Returns the address of an array for an argument."""
    return ctypes.c_void_p(array.ctypes.data)


def succeeds(function: Any, *arguments: Any) -> bool:
    """Calls a function of the library that returns whether it has succeeded."""
    function.restype = ctypes.c_bool
    return bool(function(*arguments))


def call(function: Any, *arguments: Any) -> None:
    """Calls a function whose last argument, which is not given here, is an error."""
    error = _Error()
    if not succeeds(function, *arguments, ctypes.byref(error)):
        failure = TableError if error.kind == _ERROR_TABLE else ArgumentError
        raise failure(error.text.decode())


class Handle(ctypes.c_void_p):
    """A table or a surface of the library, which is freed with this object."""

    def __init__(self, calls: ctypes.CDLL, kind: str, data: bytes):
        super().__init__()
        self._free = getattr(calls, f"dipole_{kind}_free")
        size = ctypes.c_size_t(len(data))
        call(getattr(calls, f"dipole_{kind}_load"), data, size, ctypes.byref(self))

    def __del__(self) -> None:
        if self:
            self._free(self)


# ---- what a daemon replies to a table request ----------------------------------------------------


def frame_bytes(data: bytes) -> int:
    """Returns the length of the frame at the start of the data; 0 if that is no frame."""
    if len(data) < wire.HEADER.bytes:
        return 0
    return wire.HEADER.bytes + int(wire.HEADER.unpack(data).payload_bytes)


def bytes_of(source: str | os.PathLike[str] | bytes) -> bytes:
    """Returns bytes, or those of a file."""
    is_bytes = isinstance(source, (bytes, bytearray, memoryview))
    return bytes(source) if is_bytes else Path(source).read_bytes()  # type: ignore[arg-type]


class Fetched:
    """What Table and Surface share. model, moments: names if lists were given, else ids."""

    def __init__(self, data: bytes, info: Info | None, kind: str):
        """data: exactly one frame, as a daemon sent it or save() wrote it."""
        self._handle = Handle(library(), kind, data)
        if frame_bytes(data) != len(data):
            raise TableError(f"a {kind} with something behind it")
        self._info = info
        self.data: bytes = data  # the frame
        self._fixed: Any
        self._fixed, parts = wire.PAYLOADS["table_reply"].unpack(data[wire.HEADER.bytes :])
        self._listed = parts["parameter"]
        self.layers = tuple(Medium(*one) for one in parts["medium"].tolist())
        self.model_id: int = self._fixed.model
        self.moments_id: int = self._fixed.moments
        self.model: str | int = self._name("model", self.model_id)
        self.moments: str | int = self._name("moments", self.moments_id)
        # The parameters of the request by name, or without the daemon's lists by id.
        self.parameters: dict[str | int, float] = {
            self._name("parameter", int(one["parameter"])): float(one["value"])
            for one in self._listed
        }

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.data, self._info)

    def _name(self, kind: str, number: int) -> str | int:
        listed = self._info.choices[kind].values() if self._info is not None else ()
        return next((choice.name for choice in listed if choice.id == number), number)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the frame into a file, which libdipole can read, too."""
        Path(path).write_bytes(self.data)
