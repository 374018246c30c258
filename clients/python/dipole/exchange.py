"""Requests and their replies, without any input, output or waiting. A session sends the
frames that this module makes, gives it the frames that arrive, and does the waiting.

A request that fails is sent again if every daemon gives the same reply to it, however often it is
sent. The parts of an unfinished reply are thrown away before that.
"""

from __future__ import annotations

import random
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from . import wire
from .connection import Frame, frame_pieces
from .errors import ArgumentError, ConnectError, ConnectionLost, DipoleError, ProtocolError, Refused
from .values import Array

T = TypeVar("T")

KEPT_BYTES = 64 << 20  # most bytes of payloads that a client keeps for sending again

PAUSE_FIRST_S = 0.010
_COUNTED = ("fitted_count", "missing_count", "computed_count")  # those of some items of a part
_TEMPORARY = ("busy", "shutting-down", "timeout")


class Replies(Generic[T]):
    """Reads the frames that reply to a request. A subclass for each kind has its own _add()."""

    is_streamed = False  # whether the caller gets each part of the reply as soon as it has come

    def __init__(self) -> None:
        self.ended = False  # whether the last reply has come
        self.begun = False  # whether the first reply has come
        self.cut_off = False  # whether a daemon that stopped has cut it off
        self.ready: deque[T | DipoleError] = deque()  # parts and errors that next() returns

    def add(self, payload: bytes) -> None:
        """Reads the payload of the next reply."""
        if self.ended:
            raise ProtocolError("a second reply to one request")
        self.begun = True
        self._add(payload)

    def refuse(self, error: DipoleError) -> None:
        """Ends the reply with an error in place of its next part."""
        self.ended = True
        self.ready.append(error)

    def can_begin_again(self) -> bool:
        """Returns whether all replies may come again: not if the caller has a part."""
        return not (self.is_streamed and self.begun)

    def _add(self, payload: bytes) -> None:
        raise NotImplementedError


class Once(Replies[T]):
    """A reply of one frame. read: makes the caller's result of its payload."""

    def __init__(self, read: Callable[[bytes], T]):
        super().__init__()
        self._read = read

    def _add(self, payload: bytes) -> None:
        self.ready.append(self._read(payload))
        self.ended = True


class Joined(NamedTuple):
    """A reply in parts, or one of its parts."""

    replies: list[Any]  # structures of the parts
    heads: list[dict[str, Any]]  # values of each part besides its items, by name
    arrays: dict[str, Array]  # arrays over all items, by name; items are the last axis


class InParts(Replies[T]):
    """A reply whose items come in parts, which this class checks and puts together.

    payload: of each reply. count: how many items were requested. same: what fields of its structure
    have to be, or the set that they are of. read: makes the caller's result of all, or if is_streamed
    of each part. alike: whether parts may differ in nothing but their items.
    """

    def __init__(
        self,
        payload: str,
        count: int,
        same: Mapping[str, Any],
        read: Callable[[Joined], T],
        is_streamed: bool = False,
        alike: bool = False,
    ):
        super().__init__()
        self.is_streamed = is_streamed
        self._payload, self._count, self._same = wire.PAYLOADS[payload], count, same
        self._read, self._alike = read, alike
        self._parts: list[Joined] = []
        self._next = 0  # index of the first item of the next part

    def _add(self, payload: bytes) -> None:
        fixed, heads = self._payload.unpack(payload)
        arrays = {name: heads.pop(name) for name in self._payload.of_items}
        part = Joined([fixed], [heads], arrays)
        for name, allowed in self._same.items():
            found = getattr(fixed, name)
            if found not in allowed if isinstance(allowed, set) else found != allowed:
                raise self._wrong("that does not reply to the request")
        if max(getattr(fixed, name, 0) for name in _COUNTED) > fixed.count:
            raise self._wrong("that counts more than its items")
        if (fixed.part, fixed.first) != (len(self._parts), self._next):
            raise self._wrong("that is not the next part")
        left = self._count - self._next
        self.ended = fixed.part + 1 == fixed.part_count
        if fixed.count > left or self.ended != (fixed.count == left):
            raise self._wrong("with another count than was requested")
        if self._parts and not self._is_like_first(part):
            raise self._wrong("whose parts do not belong together")
        self._parts.append(part._replace(arrays={}) if self.is_streamed else part)
        self._next += fixed.count
        if self.is_streamed:
            self.ready.append(self._read(part))
        elif self.ended:
            self.ready.append(self._read(self._join()))

    def _wrong(self, what: str) -> ProtocolError:
        return ProtocolError(f"a {self._payload.name} {what}")

    def _is_like_first(self, part: Joined) -> bool:
        own, first = part.replies[0], self._parts[0].replies[0]
        if not self._alike:
            return bool(own.part_count == first.part_count)
        same = own == first._replace(part=own.part, first=own.first, count=own.count)
        heads = zip(part.heads[0].values(), self._parts[0].heads[0].values())
        return same and all(one.tobytes() == other.tobytes() for one, other in heads)

    def _join(self) -> Joined:
        if len(self._parts) == 1:
            return self._parts[0]
        replies = [part.replies[0] for part in self._parts]
        arrays = {name: together(self._parts, name) for name in self._payload.of_items}
        return Joined(replies, [part.heads[0] for part in self._parts], arrays)


@dataclass(frozen=True)
class Request(Generic[T]):
    """One request. replies: makes the object that reads its replies."""

    message: str
    payload: bytes
    replies: Callable[[], Replies[T]]
    deadline_ms: int = 0

    def __post_init__(self) -> None:
        if not hasattr(self.deadline_ms, "__index__") or not 0 <= self.deadline_ms < 1 << 32:
            raise ArgumentError("deadline_ms: a whole number from 0 to 4294967295")


def pieces(
    message: str,
    items: range,
    pack: Callable[[int, int], bytes],
    same: Mapping[str, Any],
    deadline_ms: int,
) -> Iterator[Request[Joined]]:
    """Yields the requests for many items, of which each has as many as the step of `items` says; one
    if there are none. pack: makes the payload of the items from one index to another."""
    for first in items or range(items.start, items.start + 1):
        end = min(first + items.step, items.stop)

        def replies(count: int = end - first) -> InParts[Joined]:
            return InParts(f"{message}_reply", count, same, lambda whole: whole)

        yield Request(message, pack(first, end), replies, deadline_ms)


def together(found: list[Joined], name: str) -> Array:
    """Returns an array over the items of all requests."""
    array: Array = np.concatenate([one.arrays[name] for one in found], axis=-1)
    array.setflags(write=False)
    return array


class _Pending:
    """A request whose reply has not been handed out. Times are those of time.monotonic()."""

    def __init__(self, request: Request[Any], kept: bool):
        self.request = request
        self.kept = kept  # whether the client keeps the request to send it again
        self.replies = request.replies()
        self.first_sent_s: float | None = None
        self.failed_s: float | None = None  # when the request first failed; None if it has not
        self.again_s: float | None = None  # when to send the request again; None if it is sent

    def failed_since_s(self) -> float:
        if self.failed_s is None:
            self.failed_s = time.monotonic()
        return self.failed_s

    def can_repeat(self) -> bool:
        return self.kept and self.replies.can_begin_again()

    def begin_again(self) -> None:
        self.replies = self.request.replies()


class Exchange:
    """The requests of one client.

    retry_s: for how long the client sends a failed request again; 0 means that it never does.
    """

    def __init__(self, retry_s: float):
        self.retry_s = retry_s
        self.last_id = 0
        self._pending: dict[int, _Pending] = {}
        self._kept_bytes = 0

    # ---- sending ---------------------------------------------------------------------------------

    def begin(self, request: Request[Any]) -> int:
        """Starts a request; returns its id. The caller then sends what frame() gives."""
        fits = self._kept_bytes + len(request.payload) <= KEPT_BYTES
        # A cancel concerns one connection.
        kept = self.retry_s > 0 and request.message != "cancel" and fits
        self.last_id += 1
        self._pending[self.last_id] = _Pending(request, kept)
        self._kept_bytes += len(request.payload) if kept else 0
        return self.last_id

    def frame(self, request_id: int) -> list[bytes]:
        """Returns the pieces of a request's frame, which states the rest of the deadline. If the
        deadline has passed, returns no pieces and ends the reply with the daemon's error."""
        entry = self._pending.get(request_id)
        if entry is None:
            return []
        request, deadline_ms = entry.request, entry.request.deadline_ms
        now_s = time.monotonic()
        if entry.first_sent_s is None:
            entry.first_sent_s = now_s
        elif deadline_ms:
            deadline_ms -= int((now_s - entry.first_sent_s) * 1000)
            if deadline_ms <= 0:
                entry.replies.refuse(_too_late(request_id))
                return []
        type = wire.MESSAGES[request.message]
        return frame_pieces(type, request_id, request.payload, deadline_ms)

    def due(self) -> list[int]:
        """Returns the ids of requests that a busy daemon refused and that may be sent again."""
        now_s = time.monotonic()
        entries = self._pending.items()
        ids = [i for i, entry in entries if entry.again_s is not None and entry.again_s <= now_s]
        for request_id in ids:
            self._pending[request_id].again_s = None
        return ids

    def next_due_s(self) -> float | None:
        """Returns when the next refused request may be sent again; None if there is none."""
        times = (entry.again_s for entry in self._pending.values() if entry.again_s is not None)
        return min(times, default=None)

    # ---- replies ---------------------------------------------------------------------------------

    def take(self, frame: Frame) -> int:
        """Gives a frame to the request that it belongs to; returns the request's id. Raises an error
        frame that concerns the whole connection."""
        request_id = frame.request_id
        if frame.type == wire.TYPE_ERROR and request_id == 0:
            raise refused(frame)
        if not 0 < request_id <= self.last_id:
            raise ProtocolError(f"a reply to request {request_id}, which was not made")
        entry = self._pending.get(request_id)
        if entry is None:  # The request has been dropped.
            return request_id
        if frame.type == wire.TYPE_ERROR:
            error = refused(frame)
            if isinstance(error, ProtocolError):
                raise error
            passes = error.status in ("busy", "shutting-down")
            if not passes or not self._retry_later(entry, error.retry_after_ms):
                entry.replies.refuse(error)
        elif frame.type == wire.MESSAGES[entry.request.message] | wire.REPLY:
            entry.replies.add(frame.payload)
            if entry.replies.cut_off:
                self._retry_later(entry, 0)
            elif entry.replies.is_streamed and entry.replies.can_begin_again():
                entry.failed_s = None  # The request continues, so another failure is a new one.
        elif frame.type != wire.MESSAGES["ping"] | wire.REPLY or len(frame.payload) > 0:  # F3e
            raise ProtocolError(
                f"a reply of type {frame.type} to a request for {entry.request.message}"
            )
        return request_id

    def ended(self, request_id: int) -> bool:
        """Returns whether the whole reply, or an error in its place, has arrived."""
        return self._pending[request_id].replies.ended

    def is_ready(self, request_id: int) -> bool:
        """Returns whether next() has something to give."""
        replies = self._pending[request_id].replies
        return bool(replies.ready) or replies.ended

    def next(self, request_id: int) -> Any:
        """Returns the next part of a reply, or None after the last; or raises its error."""
        ready = self._pending[request_id].replies.ready
        item = ready.popleft() if ready else None
        if isinstance(item, DipoleError):
            raise item
        return item

    def send_once(self, request_id: int) -> None:
        """Lets a request that has been sent never be sent again."""
        entry = self._pending.get(request_id)
        if entry is not None and entry.kept:
            entry.kept = False
            self._kept_bytes -= len(entry.request.payload)

    def drop(self, request_id: int) -> None:
        """Forgets a request that has its reply, or whose reply the caller no longer wants."""
        entry = self._pending.pop(request_id, None)
        if entry is not None and entry.kept:
            self._kept_bytes -= len(entry.request.payload)

    # ---- failures --------------------------------------------------------------------------------

    def _retry_later(self, entry: _Pending, retry_after_ms: int) -> bool:
        """Plans to send a request again. Returns False if it cannot be."""
        if not entry.can_repeat():
            return False
        pause_s = max(retry_after_ms / 1000, PAUSE_FIRST_S) + with_jitter(PAUSE_FIRST_S)
        again_s = time.monotonic() + pause_s
        if again_s > entry.failed_since_s() + self.retry_s:
            return False
        entry.again_s = again_s
        entry.begin_again()
        return True

    def lost(self, error: DipoleError) -> float:
        """Handles the loss of the connection. Returns until when the client may try to connect
        again. Raises the error if a request without a reply cannot be sent again."""
        unfinished = [entry for entry in self._pending.values() if not entry.replies.ended]
        may_repeat = all(entry.can_repeat() for entry in unfinished)
        if self.retry_s == 0 or not is_temporary(error) or not may_repeat:
            raise error
        began_s = [entry.failed_since_s() for entry in unfinished]
        return min(began_s, default=time.monotonic()) + self.retry_s

    def fail(self, error: DipoleError) -> None:
        """Ends all requests without a reply by an error."""
        for entry in self._pending.values():
            if not entry.replies.ended:
                entry.again_s = None
                entry.replies.refuse(error)

    def restored(self) -> list[int]:
        """Handles a new connection: returns the ids of the requests that are sent over it now."""
        ids = [i for i, entry in sorted(self._pending.items()) if not entry.replies.ended]
        for request_id in ids:
            self._pending[request_id].begin_again()
        return [i for i in ids if self._pending[i].again_s is None]


def refused(frame: Frame) -> Refused | ProtocolError:
    """Makes an exception of an error frame."""
    if len(frame.payload) != wire.ERROR.bytes:
        return ProtocolError("an error of an unexpected size")
    error = wire.ERROR.unpack(frame.payload)
    return Refused(
        status=wire.STATUSES.get(error.status, f"status {error.status}"),
        code=error.status,
        field=error.field,
        allowed=error.allowed,
        index=error.index,
        retry_after_ms=error.retry_after_ms,
        request_id=frame.request_id,
    )


def _too_late(request_id: int) -> Refused:
    """Makes the exception for a request whose deadline passed while there was no connection."""
    code = wire.STATUS_DEADLINE
    allowed = "more: the connection was lost meanwhile"
    return Refused(wire.STATUSES[code], code, "deadline_ms", allowed, 0, 0, request_id)


def is_temporary(error: DipoleError) -> bool:
    """Returns whether connecting again may help after this error."""
    if isinstance(error, Refused):
        return error.status in _TEMPORARY
    if isinstance(error, ConnectionLost):
        return not error.final
    return isinstance(error, ConnectError) and not error.final


def with_jitter(pause_s: float) -> float:
    """Returns a random pause, so that clients of a lost daemon do not all return at one moment."""
    return random.uniform(pause_s / 2, pause_s)
