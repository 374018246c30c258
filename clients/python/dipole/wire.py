"""The structures and numbers of dipoled's binary protocol, as proto/PROTOCOL.md describes them.

All numbers are little-endian, and no structure has gaps. A structure packs from keywords and
unpacks into a named tuple.
"""

from __future__ import annotations

import re
import struct
from collections import namedtuple
from typing import Any, NamedTuple

import numpy as np

from . import schema
from .errors import ArgumentError, ProtocolError
from .schema import KINDS as KINDS
from .schema import MESSAGES as MESSAGES
from .schema import STATUSES as STATUSES

MAGIC = 0x4C504944
VERSION = 2
REPLY = 0x8000  # The type of a reply is the type of its request plus this.
TYPE_ERROR = 0xFFFF  # the type of an error frame, which is sent in place of a reply
ALIGNMENT = 8  # bytes: payloads, structures and arrays start at multiples of this in a frame
PING_MAX_BYTES = 1024


def _numbered(names: str, first: int = 1) -> dict[int, str]:
    return dict(enumerate(names.split(), first))


STATUS_DEADLINE = 12

# Permanent ids that the layout of a payload depends on.
EVALUATOR_TYPES = {1: "<f8", 2: "<f4", 3: "<f4"}  # by evaluator: the numpy type of its values
EVALUATORS = {"f64": 1, "f32": 2}
QUANTITY_R = 1
QUANTITY_ALBEDO = 2
QUANTITY_CDF = 4
QUANTITY_RADIUS = 8
QUANTITY_SLOPE = 16
QUANTITY_LN_R = 32
QUANTITY_PDF = 64
QUANTITY_RING = 128
QUANTITY_S = 256
QUANTITY_TRANSFER = 512
QUANTITY_BY_SIGMA_A = 1024
QUANTITY_BY_SIGMA_S = 2048
QUANTITY_MODEL_ERROR = 4096
QUANTITY_MODEL_ERRORS = 8192
# Quantities that have a value for each radius and channel, in the order of a reply's arrays.
ELEMENTWISE = (1, 4, 16, 32, 64, 128, 256, 512, 1024, 2048, 8192)
# Quantities that a sample has for each radius and channel: the radii are among them.
DRAWN = tuple(sorted((*ELEMENTWISE, QUANTITY_RADIUS)))
SPACING_LIST = 1
DRAW_LIST = 1
DRAW_REGULAR = 2
DRAW_STRATIFIED = 3
DRAW_RANDOM = 4
SCALE_REFERENCE = 3
FIT_FITTED = 1  # the only status of a fit that is a success
# Of varying: what the third array holds, and the statuses of values that are answered.
VARYING_NONE = 0
VARYING_RADII = 1
VARYING_DRAWN = 2
VALUE_OK = 0
VALUES_ANSWERED = (0, 1)
ANY_MODEL = 0  # in place of a model: the daemon chooses one by the parameter tolerance

# States of an mc job. MC_STATES holds the states in which a job has ended.
MC_UNDER_WAY = 0
MC_STATES = _numbered("photons errors cancelled stopped")

_FORMATS = {"u16": "H", "u32": "I", "u64": "Q", "f64": "d", "text": "s"}


class Field(NamedTuple):
    """One field: `count` numbers of a kind, or a text of `count` bytes padded with zero bytes."""

    kind: str
    name: str
    count: int  # type: ignore[assignment]  # hides tuple.count()

    @property
    def is_array(self) -> bool:
        """Whether the field holds several numbers."""
        return self.kind != "text" and self.count > 1


class Structure:
    """A structure of fixed size, declared by a text like "f64 eta, f64 g[3], text name[16]"."""

    def __init__(self, name: str, declarations: str):
        self.name = name
        parts = re.findall(r"(\w+) (\w+)(?:\[(\d+)\])?", declarations)
        self.fields = tuple(Field(kind, field, int(count or 1)) for kind, field, count in parts)
        formats = (f"{field.count}{_FORMATS[field.kind]}" for field in self.fields)
        self._struct = struct.Struct("<" + "".join(formats))
        self._tuple = namedtuple(name, [field.name for field in self.fields])  # type: ignore[misc]
        self.bytes = self._struct.size  # its size on the wire

    def pack(self, **values: Any) -> bytes:
        """Returns the structure's bytes. Values: every field except those called zero or
        zero_too."""
        flat: list[Any] = []
        for field in self.fields:
            is_zero = field.name in ("zero", "zero_too")
            value = values.pop(field.name, 0) if is_zero else values.pop(field.name)
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

    def dtype(self) -> np.dtype[Any]:
        """Returns the type of numpy arrays of this structure, which has no text and no arrays."""
        numpy_kinds = {"u16": "<u2", "u32": "<u4", "u64": "<u8", "f64": "<f8"}
        return np.dtype([(field.name, numpy_kinds[field.kind]) for field in self.fields])

    def unpack(self, data: bytes, offset: int = 0) -> Any:
        """Reads the structure at an offset of the data as a named tuple. An array becomes a tuple,
        a text a str."""
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


STRUCTURES = {name: Structure(name, text) for name, text in schema.STRUCTURES.items()}
HEADER = STRUCTURES["header"]
HELLO_REQUEST = STRUCTURES["hello_request"]
HELLO_REPLY = STRUCTURES["hello_reply"]
CHOICE = STRUCTURES["choice"]
VALUE = STRUCTURES["value"]
EVAL_REQUEST = STRUCTURES["eval_request"]
MEDIUM = STRUCTURES["medium"]
PARAMETER = STRUCTURES["parameter"]
PART = STRUCTURES["part"]
EVAL_REPLY = STRUCTURES["eval_reply"]
QUANTITY_ERROR = STRUCTURES["quantity_error"]
LIST_REPLY = STRUCTURES["list_reply"]
MEASURED_MEDIUM = STRUCTURES["measured_medium"]
MC_REQUEST = STRUCTURES["mc_request"]
MC_REPLY = STRUCTURES["mc_reply"]
MC_ENERGY = STRUCTURES["mc_energy"]
CANCEL_REQUEST = STRUCTURES["cancel_request"]
CANCEL_REPLY = STRUCTURES["cancel_reply"]
TABLE_REQUEST = STRUCTURES["table_request"]
TABLE_REPLY = STRUCTURES["table_reply"]
OFFERS_REPLY = STRUCTURES["offers_reply"]
OFFER = STRUCTURES["offer"]
SAMPLE_REQUEST = STRUCTURES["sample_request"]
INVERT_REQUEST = STRUCTURES["invert_request"]
INVERT_REPLY = STRUCTURES["invert_reply"]
FIT_REQUEST = STRUCTURES["fit_request"]
FIT_DESIGN = STRUCTURES["fit_design"]
FIT_REPLY = STRUCTURES["fit_reply"]
FITTED = STRUCTURES["fitted"]
VARYING_REQUEST = STRUCTURES["varying_request"]
VARYING_REPLY = STRUCTURES["varying_reply"]
POINTS_REQUEST = STRUCTURES["points_request"]
POINTS_REPLY = STRUCTURES["points_reply"]
GATHER_REQUEST = STRUCTURES["gather_request"]
GATHER_REPLY = STRUCTURES["gather_reply"]
ERROR = STRUCTURES["error"]


def unpack_list(
    payload: bytes, fixed_structure: Structure, **lists: Structure
) -> tuple[Any, list[list[Any]]]:
    """Unpacks a payload of a fixed part and then lists. For each list, `lists` maps the field of
    the fixed part that holds its length to the structure of its entries."""
    if len(payload) < fixed_structure.bytes:
        raise ProtocolError(f"a {fixed_structure.name} that is too short")
    fixed = fixed_structure.unpack(payload)
    at = fixed_structure.bytes
    expected = at + sum(getattr(fixed, count) * entry.bytes for count, entry in lists.items())
    if len(payload) != expected:
        raise ProtocolError(f"a {fixed_structure.name} of an unexpected size")
    unpacked = []
    for count, entry in lists.items():
        end = at + getattr(fixed, count) * entry.bytes
        unpacked.append([entry.unpack(payload, offset) for offset in range(at, end, entry.bytes)])
        at = end
    return fixed, unpacked
