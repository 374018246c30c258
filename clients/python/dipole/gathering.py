"""Client.gather(): sums of the light that points leave at other positions; and gather_at_home(),
which needs no daemon.

The points are sent at most once to each daemon, which knows them by the hash of their content. A
daemon that does not have them says so, and is then sent them; so it does not matter which daemon
replies, or whether it has been started anew since.
"""

from __future__ import annotations

import ctypes
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from . import wire
from .arguments import ids_of, media_array, names_of_ids, parameters_of
from .session import Session
from .errors import ArgumentError, ProtocolError, Refused, naming
from .exchange import Joined, Once, Request, pieces, together
from .library import Handle, address, call
from .library import library as load
from .table import Table
from .values import Array, Gathered, Media

OUTSTANDING = 4  # number of requests under way at a time
_PART_POINTS = 65536
_PART_QUERIES = 16384
_PART_PAIRS = 1 << 30  # tolerance 0: most pairs of query and point in a request
_SENT_MOST = 4  # most times that points are sent until sums come: daemons may lose them

# Called with the numbers of queries that are computed and that there are; False ends the call.
Progress = Callable[[int, int], bool | None] | None


class Points:
    """A set of points that hold power.

    xyz: [N, 3] mm. power: [N] or [N, C] W, one for each channel: irradiance times area. The powers
    are rounded to single precision. A Points object may be used for any number of calls and
    clients; it computes the name of its content once.
    """

    def __init__(self, xyz: Any, power: Any):
        with naming("points"):
            self.xyz: Array = np.ascontiguousarray(xyz, "<f8")
            self.power: Array = np.ascontiguousarray(power, "<f4")
        if self.power.ndim == 1:
            self.power = self.power[:, np.newaxis]
        if self.xyz.ndim != 2 or self.xyz.shape[1] != 3:
            raise ArgumentError("xyz: an array [N, 3]")
        if self.power.ndim != 2 or len(self.power) != len(self.xyz):
            raise ArgumentError("power: an array [N] or [N, C], for as many points as xyz")

    def __len__(self) -> int:
        return len(self.xyz)

    def __repr__(self) -> str:
        return f"<Points: {len(self)}, {self.channels} channels, {self.name.hex()}>"

    @property
    def channels(self) -> int:
        """The number of powers of each point."""
        return int(self.power.shape[1])

    @cached_property
    def name(self) -> bytes:
        """The hash of the content: 16 bytes (rule G2 of the protocol)."""
        counts = np.array([self.channels, len(self)], "<u8").tobytes()
        return _hash(counts + _hash(self.xyz.data) + _hash(self.power.data))


def _hash(content: Any) -> bytes:
    return hashlib.blake2b(content, digest_size=16).digest()


def _read_sent(payload: bytes) -> Any:
    return wire.PAYLOADS["points_reply"].unpack(payload)[0]


def _order(queries: Array) -> Any:
    """Returns an order that keeps neighbours together: Morton's curve through 1024^3 cubes."""
    least = queries.min(axis=0)
    extent = float(np.max(queries.max(axis=0) - least)) or 1.0
    cubes = ((queries - least) * (1023 / extent)).astype(np.int64)
    keys = np.zeros(len(queries), np.int64)
    for bit in range(10):
        for axis in range(3):
            keys |= (cubes[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(keys, kind="stable")


class _Stopped(Exception):
    """The caller has ended a gather."""


def _words(name: bytes) -> tuple[int, int]:
    return int.from_bytes(name[:8], "little"), int.from_bytes(name[8:], "little")


async def gather(
    session: Session,
    model: str | int,
    media: Media,
    points: Points,
    queries: Any,
    *,
    progress: Progress = None,
    tolerance: float = 1e-2,
    evaluator: str | int = "lut",
    moments: str | int = "exact",
    parameters: Mapping[str, float | str] | None = None,
    deadline_ms: int = 0,
) -> Gathered:
    """gather(model, media, points, queries) sums, at each query position x, the light of all
    points: R(|x - x_i|) times the power of point i, for each channel.

    media: one for each power of a point. points: Points(xyz, power). queries: [..., 3] mm.
    progress: is called with the numbers of queries that are computed and that there are. If it
    returns False, the call ends, and the sums that are missing are NaN; what the daemon still does
    for it ends, too, as if it raises an exception. options: tolerance, 1e-2 by default: the largest
    relative error, at each query, that grouping points may cause; 0 sums each point by itself.
    evaluator, "lut" by default, moments, parameters and deadline_ms: as of a Query; the deadline
    holds for each request.

    The points are sent to a daemon that does not have them, and again when it has lost them. The
    numbers of points and queries of one daemon are its limits; queries are sent in several
    requests, whose number is not limited.
    """
    info = session.info
    if not isinstance(points, Points):
        raise ArgumentError("points: dipole.Points(xyz, power)")
    media = await session.media_of(media)
    with naming("queries"):
        listed = np.asarray(queries, "<f8")
    if listed.ndim < 1 or listed.shape[-1] != 3:
        raise ArgumentError("queries: an array [..., 3]")
    places = np.ascontiguousarray(listed.reshape(-1, 3))
    # If several requests are needed, neighbours share one: the daemon shares work
    # between them. Invalid queries stay in place, because errors name them by index.
    order: Any = None
    if len(places) > _PART_QUERIES and tolerance > 0 and np.all(np.abs(places) <= 1e9):
        order = _order(places)
        places = places[order]
    channels = points.channels
    array = media_array(media)
    ids = ids_of(info, model=model, evaluator=evaluator, moments=moments)
    fixed: dict[str, Any] = {
        **ids,
        "medium_count": len(array),
        "layer_count": array.shape[1],
        "set": _words(points.name),
        "tolerance": float(tolerance),
    }
    head = {"medium": array.tobytes(), "parameter": parameters_of(info, parameters)}
    most = _PART_QUERIES
    if tolerance == 0:
        most = max(1, min(most, _PART_PAIRS // max(1, len(points) * channels)))
    found: list[Joined] = []
    done = 0

    def pack(first: int, end: int) -> bytes:
        request = {"query_count": end - first, **fixed}
        part = places[first:end].tobytes()
        return wire.PAYLOADS["gather_request"].pack(request, xyz=part, **head)

    def requests(end: int) -> Iterator[Request[Joined]]:
        some = range(done, min(end, len(places)), most)
        return pieces("gather", some, pack, {"channel_count": channels}, deadline_ms)

    def take(piece: Joined) -> None:
        nonlocal done
        found.append(piece)
        count = len(piece.arrays["M"]) // channels
        done += count
        if count and progress is not None and progress(done, len(places)) is False:
            raise _Stopped

    sent_times = 0
    try:
        while done < len(places) or not found:
            before = done
            try:  # Others than the first would be refused, too, if the daemon lacks the points.
                await session.each(requests(before + most), take, cancels=True)
                if done < len(places):
                    await session.each(requests(len(places)), take, OUTSTANDING, cancels=True)
            except Refused as error:
                sent_times = 1 if done > before else sent_times + 1
                if error.status != "unknown-points" or sent_times > _SENT_MOST:
                    raise
                await _send(session, points, deadline_ms)
    except _Stopped:
        pass
    sums = np.full((len(places), channels), np.nan)
    computed = together(found, "M").reshape(-1, channels)
    sums[slice(done) if order is None else order[:done]] = computed
    sums = sums.reshape(*listed.shape[:-1], channels)
    sums.setflags(write=False)
    replies = [reply for piece in found for reply in piece.replies]
    stated = np.stack([head["errors"] for piece in found for head in piece.heads])
    return Gathered(
        **names_of_ids(info, ids),
        **names_of_ids(info, replies[-1], "notes"),
        tolerance=fixed["tolerance"],
        M=sums,
        bound=max(reply.bound for reply in replies),
        numerical_error=stated["numerical_error"].max(axis=0),
        model_error=stated["model_error"].max(axis=0),
        points_visited=sum(reply.points_visited for reply in replies),
        nodes_visited=sum(reply.nodes_visited for reply in replies),
    )


async def _send(session: Session, points: Points, deadline_ms: int) -> None:
    """Sends points to a daemon that does not have them, until it has all of them."""
    known = False

    def requests() -> Iterator[Request[Any]]:
        for first in range(0, max(len(points), 1), _PART_POINTS):
            if known:
                return
            xyz = points.xyz[first : first + _PART_POINTS]
            power = points.power[first : first + _PART_POINTS]
            fixed = {
                "set": _words(points.name),
                "channel_count": points.channels,
                "point_count": len(points),
                "point_first": first,
                "part_points": len(xyz),
            }
            payload = wire.PAYLOADS["points_request"].pack(
                fixed, xyz=xyz.tobytes(), power=power.tobytes()
            )
            yield Request("points", payload, lambda: Once(_read_sent), deadline_ms)

    def take(reply: Any) -> None:
        nonlocal known
        known = known or bool(reply.known)
        if reply.point_next == len(points) and not known:
            raise ProtocolError("a points reply that does not know the set, with all its points")

    await session.each(requests(), take, OUTSTANDING)


# ---- at home -------------------------------------------------------------------------------------


class _Result(ctypes.Structure):
    """struct dipole_gather_result of clients/c/dipole.h."""

    _fields_ = (
        ("computed_count", ctypes.c_uint64),
        ("bound", ctypes.c_double),
        ("numerical_error", ctypes.c_double * 8),
        ("model_error", ctypes.c_double * 8),
        ("points_visited", ctypes.c_uint64),
        ("nodes_visited", ctypes.c_uint64),
        ("notes", ctypes.c_uint),
    )


_FOLLOW = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint64)


def gather_at_home(
    tables: Sequence[Table],
    points: Points,
    queries: Any,
    *,
    tolerance: float = 1e-2,
    progress: Progress = None,
    library: str | None = None,
) -> Gathered:
    """Sums as Client.gather() does, with the same bits, but in this process and on one thread. It
    needs the C library, not a daemon.

    tables: those of Client.table() or Table.load(), one for each power of a point. library: the
    path of the C library; else that of the clone that holds this module, or the installed one.
    Raises LibraryError if there is none.
    """
    listed = np.asarray(queries, np.float64)
    if listed.ndim < 1 or listed.shape[-1] != 3:
        raise ArgumentError("queries: an array [..., 3]")
    if len(tables) != points.channels:
        raise ArgumentError(f"tables: {points.channels}, one for each power of a point")
    places = np.ascontiguousarray(listed)
    sums = np.empty((*listed.shape[:-1], points.channels))
    calls, result = load(library), _Result()
    handle = ctypes.c_void_p()
    raised: list[BaseException] = []

    def follow(_context: Any, done: int, count: int) -> bool:
        try:
            return progress is None or progress(done, count) is not False
        except BaseException as caught:  # C code is between, and cannot pass exceptions.
            raised.append(caught)
            return False

    held = [Handle(calls, "table", table.data) for table in tables]
    call(
        calls.dipole_points_make,
        ctypes.c_uint64(len(points)),
        ctypes.c_uint32(points.channels),
        address(points.xyz),
        address(points.power),
        ctypes.byref(handle),
    )
    try:
        call(
            calls.dipole_gather_at_home,
            (ctypes.c_void_p * len(held))(*(one.value for one in held)),
            handle,
            ctypes.c_double(tolerance),
            ctypes.c_uint64(places.size // 3),
            address(places),
            _FOLLOW(follow),
            None,
            address(sums),
            ctypes.byref(result),
        )
    finally:
        calls.dipole_points_free(handle)
    if raised:
        raise raised[0]
    sums.setflags(write=False)
    return Gathered(
        model=tables[0].model,
        moments=tables[0].moments,
        evaluator="lut",
        tolerance=tolerance,
        M=sums,
        bound=result.bound,
        numerical_error=np.array(result.numerical_error[: points.channels]),
        model_error=np.array(result.model_error[: points.channels]),
        points_visited=result.points_visited,
        nodes_visited=result.nodes_visited,
        notes=tuple(dict.fromkeys(note for table in tables for note in table.notes)),
    )
