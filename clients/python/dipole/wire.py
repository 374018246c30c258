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

from .errors import ArgumentError, ProtocolError

MAGIC = 0x4C504944
VERSION = 1
REPLY = 0x8000  # The type of a reply is the type of its request plus this.
TYPE_ERROR = 0xFFFF  # the type of an error frame, which is sent in place of a reply
ALIGNMENT = 8  # bytes: payloads, structures and arrays start at multiples of this in a frame
PING_MAX_BYTES = 1024


def _numbered(names: str, first: int = 1) -> dict[int, str]:
    return dict(enumerate(names.split(), first))


# Types of requests by name.
_TYPES = _numbered(
    "hello eval media statistics ping mc cancel table offers sample invert fit varying "
    "points gather"
)
MESSAGES = {name: type for type, name in _TYPES.items()}

# Maps the code of a status to its name.
STATUSES = _numbered(
    "ok bad-magic bad-version bad-type bad-length bad-count bad-value too-large truncated timeout "
    "busy shutting-down deadline bad-address not-allowed unknown-points cancelled",
    first=0,
)
STATUS_DEADLINE = 12

# Maps the number of a kind of choices to its name.
KINDS = _numbered(
    "model evaluator moments quantity spacing status parameter note draw length phase scale axis "
    "fit_status light value coefficient"
)

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
# Quantities that have a value for each radius and channel, in the order of a reply's arrays.
ELEMENTWISE = (1, 4, 16, 32, 64, 128, 256, 512, 1024, 2048)
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


STRUCTURES: dict[str, Structure] = {}


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
        STRUCTURES[name] = self

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


HEADER = Structure(
    "header",
    "u32 magic, u16 version, u16 type, u64 request_id, u32 payload_bytes, u32 deadline_ms",
)
HELLO_REQUEST = Structure("hello_request", "u16 version_min, u16 version_max, u32 zero")
HELLO_REPLY = Structure(
    "hello_reply",
    "u16 version, u16 version_min, u16 version_max, u16 workers, u32 choice_count, "
    "u32 limit_count, text software[32], text instruction_set[16], text R_unit[48]",
)
CHOICE = Structure("choice", "u16 kind, u16 id, text name[28], text about[96]")
VALUE = Structure("value", "text name[40], u64 value")
EVAL_REQUEST = Structure(
    "eval_request",
    "u16 model, u16 evaluator, u16 moments, u16 wanted, u32 medium_count, u16 spacing, "
    "u16 parameter_count, u64 radius_count, f64 radius_start, f64 radius_stop",
)
MEDIUM = Structure("medium", "f64 sigma_a, f64 sigma_s, f64 g, f64 eta")
PARAMETER = Structure("parameter", "u16 parameter, u16 zero, u32 zero_too, f64 value")
EVAL_REPLY = Structure(
    "eval_reply",
    "u16 model, u16 evaluator, u16 moments, u16 wanted, u32 channel_count, u32 notes, "
    "u64 radius_count, u64 radius_first, u32 part, u32 part_count",
)
CHANNEL = Structure(
    "channel",
    "f64 albedo, f64 numerical_error, f64 numerical_error_per_mm, f64 model_error",
)
LIST_REPLY = Structure("list_reply", "u32 count, u32 zero")
MEASURED_MEDIUM = Structure(
    "measured_medium",
    "text name[16], f64 sigma_a[3], f64 sigma_s[3], f64 g, f64 eta",
)
MC_REQUEST = Structure(
    "mc_request",
    "u16 spacing, u16 albedo_count, u32 ring_count, f64 radius_start, f64 radius_stop, "
    "f64 thickness, u64 seed, u64 photons, f64 error_total, f64 error_rings",
)
MC_REPLY = Structure(
    "mc_reply",
    "u16 state, u16 side_count, u16 albedo_count, u16 worst_side, u32 ring_count, "
    "u16 worst_albedo, u16 zero, f64 worst_from, f64 worst_to, f64 error_total, "
    "f64 error_rings, u64 number, u64 photons, u64 photons_expected",
)
MC_ENERGY = Structure(
    "mc_energy",
    "f64 albedo, f64 reflected, f64 reflected_error, f64 transmitted, f64 transmitted_error, "
    "f64 absorbed, f64 absorbed_error, f64 unfinished, f64 unfinished_error, f64 roulette, "
    "f64 roulette_error, f64 unscattered[2], f64 under[2], f64 under_error[2], f64 over[2], "
    "f64 over_error[2], f64 imbalance",
)
CANCEL_REQUEST = Structure("cancel_request", "u64 job_id")
CANCEL_REPLY = Structure("cancel_reply", "u32 found, u32 zero")
TABLE_REQUEST = Structure("table_request", "u16 model, u16 moments, u16 parameter_count, u16 zero")
TABLE_REPLY = Structure(
    "table_reply",
    "u16 layout, u16 model, u16 moments, u16 parameter_count, u32 word_count, u32 checksum, "
    "u32 notes, u32 zero, f64 sigma_a, f64 sigma_s, f64 g, f64 eta, f64 albedo, "
    "f64 numerical_error, f64 numerical_error_per_mm, f64 model_error, f64 pieces_from, "
    "f64 pieces_to, f64 radius_least, f64 radius_most, f64 reach, f64 reach_growth, "
    "f64 model_errors[11], f64 numerical_errors[11]",
)
OFFERS_REPLY = Structure("offers_reply", "u32 count, u32 taken")
OFFER = Structure(
    "offer",
    "u16 model, u16 evaluator, u32 meets, f64 error, f64 numerical_error, f64 cost, "
    "f64 prepare_cost",
)
SAMPLE_REQUEST = Structure(
    "sample_request",
    "u16 model, u16 evaluator, u16 moments, u16 wanted, u32 medium_count, u16 draw, "
    "u16 parameter_count, u64 sample_count, u64 sample_first, u64 seed",
)
INVERT_REQUEST = Structure(
    "invert_request",
    "u16 model, u16 moments, u16 given, u16 zero, u64 medium_count, f64 g, f64 eta",
)
INVERT_REPLY = Structure(
    "invert_reply",
    "u16 model, u16 moments, u16 given, u16 zero, u32 part, u32 part_count, u64 medium_count, "
    "u64 medium_first, u64 missing_count, f64 albedo_least, f64 albedo_most",
)
FIT_REQUEST = Structure("fit_request", "u64 set_count, u16 residuals, u16 zero, u32 zero_too")
FIT_DESIGN = Structure(
    "fit_design",
    "u16 model, u16 moments, u16 axis, u16 scale, u32 reading_count, u16 parameter_count, "
    "u16 zero, f64 g, f64 eta",
)
FIT_REPLY = Structure(
    "fit_reply",
    "u32 part, u32 part_count, u64 set_count, u64 set_first, u64 fitted_count, "
    "u32 reading_count, u32 notes",
)
FITTED = Structure(
    "fitted",
    "u16 status, u16 bounds, u16 field, u16 zero, u32 index, u32 evaluations, f64 sigma_a, "
    "f64 sigma_s_prime, f64 factor, f64 chi_squared, f64 reduced_chi_squared, f64 condition, "
    "f64 variance_a, f64 covariance_a_s, f64 variance_s, f64 covariance_a_factor, "
    "f64 covariance_s_factor, f64 variance_factor, f64 second_sigma_a, "
    "f64 second_sigma_s_prime, f64 second_factor, f64 second_chi_squared, "
    "f64 model_error",
)
VARYING_REQUEST = Structure(
    "varying_request",
    "u16 model, u16 evaluator, u16 moments, u16 wanted, u16 coefficients, u16 given, u16 light, "
    "u16 specular, u16 numbers, u16 parameter_count, u32 zero, u64 value_count, f64 g, f64 eta",
)
VARYING_REPLY = Structure(
    "varying_reply",
    "u16 model, u16 evaluator, u16 moments, u16 wanted, u16 coefficients, u16 zero, u32 notes, "
    "u64 value_count, u64 value_first, u32 part, u32 part_count, u64 answered_count, "
    "f64 numerical_error, f64 model_error, f64 colour_least, f64 colour_most, f64 specular",
)
POINTS_REQUEST = Structure(
    "points_request",
    "u64 set[2], u32 channel_count, u32 zero, u64 point_count, u64 point_first, u64 part_points",
)
POINTS_REPLY = Structure(
    "points_reply", "u64 set[2], u32 known, u32 zero, u64 point_next"
)
GATHER_REQUEST = Structure(
    "gather_request",
    "u16 model, u16 evaluator, u16 moments, u16 parameter_count, u32 medium_count, u32 zero, "
    "u64 set[2], u64 query_count, f64 tolerance",
)
GATHER_REPLY = Structure(
    "gather_reply",
    "u16 model, u16 evaluator, u16 moments, u16 zero, u32 channel_count, u32 notes, "
    "u64 query_count, u64 query_first, u32 part, u32 part_count, f64 bound, "
    "u64 points_visited, u64 nodes_visited",
)
ERROR = Structure(
    "error",
    "u16 status, u16 zero, u32 retry_after_ms, u64 index, text field[32], text allowed[80]",
)


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
