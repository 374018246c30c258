"""Requests and their answers, without any input, output or waiting: what Client and AsyncClient
share. They send what this gives them, hand it the frames that arrive, and do the waiting.

A request that meets trouble is sent again where that is safe: where every daemon gives the same one
right answer, however often it is asked. Nothing of an unfinished answer is used then.
"""

from __future__ import annotations

import random
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from . import wire
from .connection import Connection, Frame, frame_pieces
from .errors import ConnectError, ConnectionLost, DipoleError, ProtocolError, Refused
from .values import Info

T = TypeVar("T")

RETRY_S = 5.0  # how long clients of unix: and tcp: addresses try again by default
KEPT_BYTES = 64 << 20  # the most payload bytes that are kept to be sent again

_PAUSE_FIRST_S = 0.010
_PAUSE_MOST_S = 1.0
# All but hello, cancel and mc. The photons that a job has walked would be lost, and a new job would
# delay those of others.
_REPEATABLE = ("eval", "sample", "invert", "offers", "table", "media", "statistics", "ping")
_TEMPORARY = ("busy", "shutting-down", "timeout")


class Answer(Generic[T]):
    """Reads the replies to one request. Kinds of answers differ in _add()."""

    hands_on = False  # The caller gets the answer piece by piece, and so may have some of it.

    def __init__(self) -> None:
        self.ended = False  # No more replies will come.
        self.begun = False  # Something has come.
        self.ready: deque[T | DipoleError] = deque()  # what can be handed to the caller

    def add(self, payload: bytes) -> None:
        """Reads the payload of the next reply."""
        if self.ended:
            raise ProtocolError("a second reply to a request that is answered")
        self.begun = True
        self._add(payload)

    def refuse(self, error: DipoleError) -> None:
        """An error takes the place of the next reply and ends the answer."""
        self.ended = True
        self.ready.append(error)

    def _add(self, payload: bytes) -> None:
        raise NotImplementedError


class Once(Answer[T]):
    """An answer of one reply, which a function reads."""

    def __init__(self, read: Callable[[bytes], T]):
        super().__init__()
        self._read = read

    def _add(self, payload: bytes) -> None:
        self.ready.append(self._read(payload))
        self.ended = True


@dataclass(frozen=True)
class Request(Generic[T]):
    """One request, and what makes a reader of its replies."""

    message: str
    payload: bytes
    answer: Callable[[], Answer[T]]
    deadline_ms: int = 0


class _UnderWay:
    """A request that has been begun."""

    def __init__(self, request: Request[Any], kept: bool):
        self.request = request
        self.kept = kept  # It can be sent again.
        self.answer = request.answer()
        self.first_sent_s: float | None = None
        self.trouble_s: float | None = None  # when it first got no answer
        self.again_s: float | None = None  # when it is to be sent again; None if it is sent

    def trouble_since_s(self) -> float:
        if self.trouble_s is None:
            self.trouble_s = time.monotonic()
        return self.trouble_s

    def can_repeat(self) -> bool:
        """Whether it can be sent again: the caller must not have a part of its answer."""
        return self.kept and not (self.answer.hands_on and self.answer.begun)

    def begin_again(self) -> None:
        self.answer = self.request.answer()


class Exchange:
    """The requests of one client.

    retry_s: how long a request that meets trouble is tried again; 0 is not at all.
    """

    def __init__(self, retry_s: float):
        self.retry_s = retry_s
        self.last_id = 0
        self._under_way: dict[int, _UnderWay] = {}
        self._kept_bytes = 0

    # ---- sending ---------------------------------------------------------------------------------

    def begin(self, request: Request[Any]) -> int:
        """Starts a request; returns its id. It is to be sent with frame()."""
        fits = self._kept_bytes + len(request.payload) <= KEPT_BYTES
        kept = self.retry_s > 0 and request.message in _REPEATABLE and fits
        self.last_id += 1
        self._under_way[self.last_id] = _UnderWay(request, kept)
        self._kept_bytes += len(request.payload) if kept else 0
        return self.last_id

    def frame(self, request_id: int) -> list[bytes]:
        """The pieces of a request's frame, with what is left of its deadline. If nothing is left
        there are none, and the answer is the error that a daemon would send."""
        entry = self._under_way.get(request_id)
        if entry is None:
            return []
        request, deadline_ms = entry.request, entry.request.deadline_ms
        now_s = time.monotonic()
        if entry.first_sent_s is None:
            entry.first_sent_s = now_s
        elif deadline_ms:
            deadline_ms -= int((now_s - entry.first_sent_s) * 1000)
            if deadline_ms <= 0:
                entry.answer.refuse(_too_late(request_id))
                return []
        type = wire.MESSAGES[request.message]
        return frame_pieces(type, request_id, request.payload, deadline_ms)

    def due(self) -> list[int]:
        """The requests that are to be sent again now, after a daemon that was busy."""
        now_s = time.monotonic()
        entries = self._under_way.items()
        ids = [i for i, entry in entries if entry.again_s is not None and entry.again_s <= now_s]
        for request_id in ids:
            self._under_way[request_id].again_s = None
        return ids

    def next_due_s(self) -> float | None:
        """When the next request is to be sent again; None if there is none."""
        times = (entry.again_s for entry in self._under_way.values() if entry.again_s is not None)
        return min(times, default=None)

    # ---- answers ---------------------------------------------------------------------------------

    def take(self, frame: Frame) -> int:
        """Gives a frame to its request, whose id is returned. Raises what the daemon says about the
        connection as a whole."""
        request_id = frame.request_id
        if frame.type == wire.TYPE_ERROR and request_id == 0:
            raise refused(frame)
        if not 0 < request_id <= self.last_id:
            raise ProtocolError(f"a reply to request {request_id}, which was not made")
        entry = self._under_way.get(request_id)
        if entry is None:  # Nobody wants this answer any more.
            return request_id
        if frame.type == wire.TYPE_ERROR:
            error = refused(frame)
            if isinstance(error, ProtocolError):
                raise error
            if not self._ask_later(entry, error):
                entry.answer.refuse(error)
        elif frame.type == wire.MESSAGES[entry.request.message] | wire.REPLY:
            entry.answer.add(frame.payload)
        else:
            raise ProtocolError(
                f"a reply of type {frame.type} to a request for {entry.request.message}"
            )
        return request_id

    def ended(self, request_id: int) -> bool:
        """Whether the whole answer is here, or an error in its place."""
        return self._under_way[request_id].answer.ended

    def is_ready(self, request_id: int) -> bool:
        """Whether next() has something to give."""
        answer = self._under_way[request_id].answer
        return bool(answer.ready) or answer.ended

    def next(self, request_id: int) -> Any:
        """The next piece of an answer, or None after the last one. Raises an error in its place."""
        ready = self._under_way[request_id].answer.ready
        item = ready.popleft() if ready else None
        if isinstance(item, DipoleError):
            raise item
        return item

    def ahead(self) -> int:
        """How many pieces of answers have come and have not been taken."""
        return sum(len(entry.answer.ready) for entry in self._under_way.values())

    def drop(self, request_id: int) -> None:
        """Forgets a request: it is answered, or nobody wants its answer any more."""
        entry = self._under_way.pop(request_id, None)
        if entry is not None and entry.kept:
            self._kept_bytes -= len(entry.request.payload)

    # ---- trouble ---------------------------------------------------------------------------------

    def _ask_later(self, entry: _UnderWay, error: Refused) -> bool:
        """Whether a refusal only means that the request is to be sent again later."""
        if not entry.can_repeat() or error.status not in ("busy", "shutting-down"):
            return False
        pause_s = max(error.retry_after_ms / 1000, _PAUSE_FIRST_S) + _with_jitter(_PAUSE_FIRST_S)
        again_s = time.monotonic() + pause_s
        if again_s > entry.trouble_since_s() + self.retry_s:
            return False
        entry.again_s = again_s
        entry.begin_again()
        return True

    def lost(self, error: DipoleError) -> float:
        """The connection is lost. Returns until when to try to connect again; raises the error if
        something under way cannot be asked again."""
        unanswered = [entry for entry in self._under_way.values() if not entry.answer.ended]
        may_ask_again = all(entry.can_repeat() for entry in unanswered)
        if self.retry_s == 0 or not is_temporary(error) or not may_ask_again:
            raise error
        began_s = [entry.trouble_since_s() for entry in unanswered]
        return min(began_s, default=time.monotonic()) + self.retry_s

    def restored(self) -> list[int]:
        """There is another connection. Returns the requests that are to be sent again now."""
        ids = [i for i, entry in sorted(self._under_way.items()) if not entry.answer.ended]
        for request_id in ids:
            self._under_way[request_id].begin_again()
        return [i for i in ids if self._under_way[i].again_s is None]


def refused(frame: Frame) -> Refused | ProtocolError:
    """An error frame as an exception."""
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
    """What a daemon would say about a request whose deadline has passed."""
    code = wire.STATUS_DEADLINE
    allowed = "more: the connection was lost meanwhile"
    return Refused(wire.STATUSES[code], code, "deadline_ms", allowed, 0, 0, request_id)


def is_temporary(error: DipoleError) -> bool:
    """Whether what ended a connection, or prevented one, may be over soon."""
    if isinstance(error, Refused):
        return error.status in _TEMPORARY
    if isinstance(error, ConnectionLost):
        return not error.final
    return isinstance(error, ConnectError)


# ---- connecting ----------------------------------------------------------------------------------


def open_connection(
    address: str | None, timeout_s: float | None, hello: Callable[[str], Request[Info]]
) -> tuple[Connection, Info]:
    """Connects and says hello; waits for both."""
    connection = Connection(address, timeout_s)
    try:
        exchange = Exchange(0.0)
        request_id = exchange.begin(hello(connection.address))
        for data in exchange.frame(request_id):
            connection.send_bytes(data)
        while not exchange.is_ready(request_id):
            exchange.take(connection.receive_frame())
        return connection, exchange.next(request_id)
    except BaseException:
        connection.close()
        raise


def connect_again(
    connect: Callable[[float], tuple[Connection, Info]],
    info: Info,
    until_s: float,
    lost: DipoleError,
) -> Connection:
    """Connects with growing pauses until the time until_s. Raises `lost` if there is no hope.

    connect: is given how long it may take. info: what the lost daemon said about itself.
    """
    latest = lost
    pause_s = _PAUSE_FIRST_S
    while True:
        wait_s = max(_with_jitter(pause_s), getattr(latest, "retry_after_ms", 0) / 1000)
        if time.monotonic() + wait_s >= until_s:
            raise lost
        time.sleep(wait_s)
        pause_s = min(2 * pause_s, _PAUSE_MOST_S)
        try:
            connection, fresh = connect(max(until_s - time.monotonic(), 0.001))
        except DipoleError as error:
            if not is_temporary(error):
                raise lost from error
            latest = error
            continue
        if _has_lists_of(fresh, info):
            return connection
        connection.close()
        raise ConnectionLost(f"{info.address}: the daemon that is there now has other lists")


def _with_jitter(pause_s: float) -> float:
    """A random pause, so that clients that lost a daemon together do not come back together."""
    return random.uniform(pause_s / 2, pause_s)


def _has_lists_of(fresh: Info, info: Info) -> bool:
    """Whether the numbers in requests still mean what they meant."""
    return all(
        choice.name in fresh.choices[kind] and fresh.choices[kind][choice.name].id == choice.id
        for kind, choices in info.choices.items()
        for choice in choices.values()
    )
