"""Connecting again and asking again. Only what has one right answer, whoever gives it and however
often it is asked for, is kept to be sent again; of an unfinished answer nothing is used."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from . import wire
from .connection import Frame
from .errors import ConnectError, ConnectionLost, DipoleError, Refused

if TYPE_CHECKING:
    from .session import Session
    from .values import Info

# How long a client of a unix: or tcp: address tries by default, and what it keeps at most.
DEFAULT_S = 5.0
KEPT_BYTES = 64 << 20

_PAUSE_FIRST_S = 0.010
_PAUSE_MOST_S = 1.0
# Of a Monte Carlo job the photons walked so far would be lost, and others' jobs delayed.
_IDEMPOTENT = ("eval", "sample", "invert", "offers", "table", "media", "statistics", "ping")
_PASSING = ("busy", "shutting-down", "timeout")


class Kept(NamedTuple):
    """A request as it was sent."""

    message: str
    payload: bytes
    deadline_ms: int
    sent_s: float


class Requests:
    """The requests that have no whole answer yet."""

    def __init__(self) -> None:
        self.for_s = 0.0  # how long a request that meets trouble is tried again; 0: not
        self.kept: dict[int, Kept] = {}
        self.again_s: dict[int, float] = {}  # of those kept: when one is to be sent again
        self._once: set[int] = set()  # those that cannot be asked again
        self._trouble_s: dict[int, float] = {}  # since when there has been trouble with one
        self._bytes = 0

    def add(self, request_id: int, message: str, payload: bytes, deadline_ms: int) -> None:
        """A request is being sent."""
        fits = self._bytes + len(payload) <= KEPT_BYTES
        if self.for_s == 0 or message not in _IDEMPOTENT or not fits:
            self._once.add(request_id)
        else:
            self.kept[request_id] = Kept(message, payload, deadline_ms, time.monotonic())
            self._bytes += len(payload)

    def remove(self, request_id: int) -> None:
        """Its answer is whole, or nobody wants it any more."""
        self._once.discard(request_id)
        self._trouble_s.pop(request_id, None)
        self.again_s.pop(request_id, None)
        kept = self.kept.pop(request_id, None)
        if kept is not None:
            self._bytes -= len(kept.payload)

    def _trouble_began_s(self, request_id: int) -> float:
        return self._trouble_s.setdefault(request_id, time.monotonic())

    def later(self, refused: Refused) -> bool:
        """Whether a refusal says no more than that the request is to be asked later."""
        request_id = refused.request_id
        if request_id not in self.kept or refused.status not in ("busy", "shutting-down"):
            return False
        pause_s = max(refused.retry_after_ms / 1000, _PAUSE_FIRST_S) + _with_jitter(_PAUSE_FIRST_S)
        again_s = time.monotonic() + pause_s
        if again_s > self._trouble_began_s(request_id) + self.for_s:
            return False
        self.again_s[request_id] = again_s
        return True

    def due(self) -> list[int]:
        """Those that are to be sent again by now; they count as sent then."""
        now_s = time.monotonic()
        ids = [request_id for request_id, at_s in self.again_s.items() if at_s <= now_s]
        for request_id in ids:
            del self.again_s[request_id]
        return ids

    def until_s(self) -> float | None:
        """The connection is lost: until when all of this may be tried again; None: not at all."""
        if self.for_s == 0 or self._once:
            return None
        began_s = [self._trouble_began_s(request_id) for request_id in self.kept]
        return min(began_s, default=time.monotonic()) + self.for_s


def left_ms(kept: Kept) -> int:
    """What is left of a deadline that runs since the request was first sent."""
    return kept.deadline_ms - int((time.monotonic() - kept.sent_s) * 1000)


def late_frame(request_id: int) -> Frame:
    """The answer to a request whose deadline has passed."""
    code = next(code for code, name in wire.STATUSES.items() if name == "deadline")
    allowed = "more: the connection was lost meanwhile"
    payload = wire.ERROR.pack(
        status=code, index=0, retry_after_ms=0, field="deadline_ms", allowed=allowed
    )
    return Frame(wire.TYPE_ERROR, request_id, payload)


def may_pass(error: DipoleError) -> bool:
    """Whether what ended a connection, or kept one from being made, may be over soon."""
    if isinstance(error, Refused):
        return error.status in _PASSING
    if isinstance(error, ConnectionLost):
        return not error.final
    return isinstance(error, ConnectError)


def connect_again(
    connect: Callable[[float], Session], info: Info, until_s: float, lost: DipoleError
) -> Session:
    """Connects, with growing pauses, until it is until_s; raises `lost` when there is no hope.
    connect: given how long it may take. info: what the lost daemon said of itself."""
    pause_s = _PAUSE_FIRST_S
    latest = lost
    while True:
        wait_s = max(_with_jitter(pause_s), getattr(latest, "retry_after_ms", 0) / 1000)
        if time.monotonic() + wait_s >= until_s:
            raise lost
        time.sleep(wait_s)
        pause_s = min(2 * pause_s, _PAUSE_MOST_S)
        try:
            fresh = connect(max(until_s - time.monotonic(), 0.001))
        except DipoleError as error:
            if not may_pass(error):
                raise lost from error
            latest = error
            continue
        if _has_lists_of(fresh.info, info):
            return fresh
        fresh.close()
        raise ConnectionLost(f"{info.address}: the daemon that is there now has other lists")


def _with_jitter(pause_s: float) -> float:
    """Clients that lost the same daemon at once do not all come back at once."""
    return random.uniform(pause_s / 2, pause_s)


def _has_lists_of(fresh: Info, info: Info) -> bool:
    """Whether the numbers in requests still mean what they meant."""
    return all(
        choice.name in fresh.choices[kind] and fresh.choices[kind][choice.name].id == choice.id
        for kind, choices in info.choices.items()
        for choice in choices.values()
    )
