"""The structures and numbers of dipoled's binary protocol, as proto/PROTOCOL.md describes them.

All numbers are little-endian, and no structure has gaps. A structure packs from keywords and
unpacks into a named tuple.
"""

from __future__ import annotations

import math
import re
import struct
from collections import namedtuple
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from . import schema
from .errors import ArgumentError, ProtocolError
from .schema import ELEMENTWISE as ELEMENTWISE
from .schema import KINDS as KINDS
from .schema import MESSAGES as MESSAGES
from .schema import QUANTITIES as QUANTITIES
from .schema import STATUSES as STATUSES

MAGIC = 0x4C504944
VERSION = 2
REPLY = 0x8000  # The type of a reply is the type of its request plus this.
TYPE_ERROR = 0xFFFF  # the type of an error frame, which is sent in place of a reply
ALIGNMENT = 8  # bytes: payloads, structures and arrays start at multiples of this in a frame
PING_MAX_BYTES = 1024


STATUS_DEADLINE = 12

# Permanent ids that the layout of a payload depends on.
EVALUATOR_TYPES = {1: "<f8", 2: "<f4", 3: "<f4"}  # numpy's type of the values of each evaluator
EVALUATORS = {"f64": 1, "f32": 2}
# Quantities that a sample has for each radius and channel: the radii are among them.
DRAWN = tuple(sorted((*ELEMENTWISE, QUANTITIES["r"])))
SPACING_LIST = 1
DRAW_LIST = 1
DRAW_STRATIFIED = 3
DRAW_RANDOM = 4
SCALE_REFERENCE = 3
FIT_FITTED = 1  # the only status of a fit that is a success
# For varying: contents of the third array, and statuses of values that were computed.
VARYING_NONE = 0
VARYING_RADII = 1
VARYING_DRAWN = 2
VALUE_OK = 0
VALUES_COMPUTED = (0, 1)
ANY_MODEL = 0  # model id: the daemon chooses a model by the parameter tolerance

# States of an mc job. MC_STATES holds the states in which a job has ended.
MC_UNDER_WAY = 0
MC_STATES = dict(enumerate(("photons", "errors", "cancelled", "stopped"), 1))

_FORMATS = {"u16": "H", "u32": "I", "u64": "Q", "f64": "d", "text": "s"}


_TYPES = {"u16": int, "u32": int, "u64": int, "f64": float, "text": int}
_FIELD = re.compile(r"(\w+) (\w+)(?:\[(\d+)\])?(?: = ([^, ]+))?")


class Field(NamedTuple):
    """One field: `count` numbers of a kind, or a text of `count` bytes padded with zero bytes."""

    kind: str
    name: str
    count: int  # type: ignore[assignment]  # hides tuple.count()
    usual: float  # its default

    @property
    def is_array(self) -> bool:
        """Whether the field holds several numbers."""
        return self.kind != "text" and self.count > 1


class Structure:
    """A structure of fixed size, declared by a text like "f64 eta = 1.3, f64 g[3], text name[16]"."""

    def __init__(self, name: str, declarations: str):
        self.name = name
        self.fields = tuple(
            Field(kind, name, int(count or 1), _TYPES[kind](usual or 0))
            for kind, name, count, usual in _FIELD.findall(declarations)
        )
        formats = (f"{field.count}{_FORMATS[field.kind]}" for field in self.fields)
        self._struct = struct.Struct("<" + "".join(formats))
        self.names = [field.name for field in self.fields]
        self._tuple = namedtuple(name, self.names)  # type: ignore[misc]
        self.bytes = self._struct.size  # size of the structure in bytes

    def pack(self, **values: Any) -> bytes:
        """Returns the structure's bytes. A number that is left out is 0."""
        flat: list[Any] = []
        for field in self.fields:
            value = values.pop(field.name, 0)
            if field.is_array:
                flat.extend(value)
            else:
                flat.append(value.encode() if field.kind == "text" else value)
        if values:
            raise TypeError(f"{self.name} has no field {', '.join(values)}")
        try:
            return self._struct.pack(*flat)
        except struct.error as error:
            raise ArgumentError(f"{self._misfit(flat)}: {error}") from error

    def _misfit(self, flat: list[Any]) -> str:
        """Returns the name of the field whose value does not fit it."""
        at = 0
        for field in self.fields:
            count = field.count if field.is_array else 1
            try:
                struct.pack(f"<{field.count}{_FORMATS[field.kind]}", *flat[at : at + count])
            except struct.error:
                return field.name
            at += count
        return self.name

    @property
    def is_flat(self) -> bool:
        """Whether it has no text and no arrays."""
        return all(field.kind != "text" and not field.is_array for field in self.fields)

    def dtype(self) -> np.dtype[Any]:
        """Returns the type of numpy arrays of this structure, which has no text and no arrays."""
        numpy_kinds = {"u16": "<u2", "u32": "<u4", "u64": "<u8", "f64": "<f8"}
        return np.dtype([(field.name, numpy_kinds[field.kind]) for field in self.fields])

    def unpack(self, data: bytes, offset: int = 0) -> Any:
        """Reads the structure at an offset as a named tuple. Arrays become tuples, texts str."""
        flat = iter(self._struct.unpack_from(data, offset))
        values: list[Any] = []
        for field in self.fields:
            if field.kind == "text":
                values.append(next(flat).rstrip(b"\0").decode(errors="replace"))
            elif field.is_array:
                values.append(tuple(next(flat) for _ in range(field.count)))
            else:
                values.append(next(flat))
        return self._tuple(*values)


def padded(data_bytes: int) -> int:
    """Rounds a length up to a multiple of ALIGNMENT."""
    return -(-data_bytes // ALIGNMENT) * ALIGNMENT


def _entries(text: str) -> list[tuple[str, str]]:
    """Splits a text of schema.py into names and what is said of each."""
    listed = text.strip().replace("\n    ", " ").split("\n")
    return [(name, said) for name, _, said in (one.partition(": ") for one in listed)]


STRUCTURES = {name: Structure(name, text) for name, text in _entries(schema.STRUCTURES)}


def __getattr__(name: str) -> Structure:
    """Finds a structure: HEADER is STRUCTURES["header"], and so on."""
    if name.lower() not in STRUCTURES or name != name.upper():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return STRUCTURES[name.lower()]


_NUMBERS = {"u8": "u1", "u32": "<u4", "u64": "<u8", "f32": "<f4", "f64": "<f8"}
_PART = re.compile(r"(\w+) (\w+)((?:\[[^\]]*\])*)(?: (if|unless) (\S+) is (\d+))?")


def _factor(text: str, fixed: Any) -> int:
    """Returns a number of a payload's structure, or how many of its bits are in a mask."""
    name, _, mask = text.partition("&")
    if name.isdecimal():
        return int(name)
    value = int(getattr(fixed, name))
    return (value & int(mask)).bit_count() if mask else value


def _product(text: str, fixed: Any) -> int:
    product, _, more = text.partition("+")
    return math.prod(_factor(one, fixed) for one in product.split("*")) + int(more or 0)


class Part:
    """A part of a payload, declared by a text of schema.PAYLOADS."""

    def __init__(self, declaration: str):
        match = _PART.fullmatch(declaration)
        assert match is not None
        self.element, self.name, products, self._how, self._if, self._is = match.groups()
        self._products = re.findall(r"\[([^\]]*)\]", products)
        # The field that alone counts its elements, if their size is known, and that size.
        structure = STRUCTURES.get(self.element)
        kind = _NUMBERS.get(self.element, "V0")
        self.each = structure.bytes if structure is not None else np.dtype(kind).itemsize
        alone = len(self._products) == 1 and self._products[0].isidentifier() and self.each
        self.counted_by = self._products[0] if alone else None
        # Whether its elements are of the items that a reply in parts counts.
        self.is_of_items = bool(self._products) and "count" in self._products[-1].split("*")

    def shape(self, fixed: Any) -> tuple[int, ...]:
        """Returns the number of elements, or of arrays and of the elements of each."""
        there = not self._how or (_factor(self._if, fixed) == int(self._is)) == (self._how == "if")
        return tuple(_product(one, fixed) for one in self._products or ["1"]) if there else (0,)

    def dtype(self, evaluator_id: int) -> np.dtype[Any]:
        """Returns the type of numpy arrays of its elements."""
        if self.element in STRUCTURES:
            return STRUCTURES[self.element].dtype()
        real = self.element == "real"
        return np.dtype(EVALUATOR_TYPES[evaluator_id] if real else _NUMBERS[self.element])

    def take(self, data: bytes, at: int, fixed: Any) -> tuple[Any, int]:
        """Reads the part at an offset. Returns its elements, and where it ends."""
        *arrays, count = self.shape(fixed)
        structure = STRUCTURES.get(self.element)
        if structure is not None and not structure.is_flat:
            ends = range(at, at + count * structure.bytes, structure.bytes)
            return [structure.unpack(data, i) for i in ends], at + count * structure.bytes
        dtype = self.dtype(getattr(fixed, "evaluator", 1))
        each = padded(count * dtype.itemsize)
        if not arrays:
            return np.frombuffer(data, dtype, count, at), at + each
        rows = np.frombuffer(data, dtype, arrays[0] * each // dtype.itemsize, at)
        return rows.reshape(arrays[0], each // dtype.itemsize)[:, :count], at + arrays[0] * each


class Payload:
    """The payload of a message: one structure or two, and the parts that follow."""

    def __init__(self, name: str, declarations: list[str]):
        self.name = name
        self.structures = [STRUCTURES[one] for one in declarations if one and " " not in one]
        self.parts = [Part(one) for one in declarations if " " in one]
        self._bytes = sum(structure.bytes for structure in self.structures)
        self.fields = [field for structure in self.structures for field in structure.fields]
        self.names = [field.name for field in self.fields]
        self.of_items = [part.name for part in self.parts if part.is_of_items]

    def pack(self, *fixed: Mapping[str, Any], **parts: Any) -> bytes:
        """Returns the bytes of a payload. fixed: fields of its structures; counts may be absent.
        parts: bytes, or arrays that hold them, by name; others have no elements."""
        pieces: list[bytes | memoryview] = []
        counts: dict[str, int] = {}
        for part in self.parts:
            data = memoryview(parts.pop(part.name, b"")).cast("B")
            pieces += [data, bytes(padded(len(data)) - len(data))]
            if part.counted_by is not None:
                counts.setdefault(part.counted_by, len(data) // part.each)
        assert not parts, parts
        starts = (
            one.pack(**{name: counts[name] for name in one.names if name in counts} | given)
            for one, given in zip(self.structures, fixed, strict=True)
        )
        return b"".join([*starts, *pieces])

    def unpack(self, payload: bytes) -> tuple[Any, dict[str, Any]]:
        """Returns the first structure, and the parts by name: arrays, or lists of structures that
        hold text or arrays. Raises ProtocolError if the length does not fit the counts."""
        if len(payload) < self._bytes:
            raise ProtocolError(f"a {self.name} that is too short")
        fixed, at = self.structures[0].unpack(payload), self._bytes
        if getattr(fixed, "evaluator", 1) not in EVALUATOR_TYPES:
            raise ProtocolError(f"a {self.name} of evaluator {fixed.evaluator}, not known here")
        parts = {}
        try:
            for part in self.parts:
                parts[part.name], at = part.take(payload, at, fixed)
        except (ValueError, OverflowError, struct.error):
            at = -1
        if at != len(payload):
            raise ProtocolError(f"a {self.name} whose size does not fit its counts")
        return fixed, parts


PAYLOADS = {name: Payload(name, parts.split("; ")) for name, parts in _entries(schema.PAYLOADS)}
NOTHING = Payload("nothing", [])
