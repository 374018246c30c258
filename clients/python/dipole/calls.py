"""Calls as generators of steps, which Client and AsyncClient drive: one waits, the other awaits.
Each call is written once, with its signature and its description. Here are those about the daemon.
"""

from __future__ import annotations

import contextlib
import inspect
import time
from collections.abc import Callable, Generator, Iterable
from typing import Any, NamedTuple, ParamSpec, Protocol, TypeVar, Union, overload

from . import values, wire
from .arguments import known
from .errors import ArgumentError, ConnectionLost, DipoleError, ProtocolError
from .exchange import Exchange, Once, Request
from .values import Choice, Info, Media, Medium, Query

P = ParamSpec("P")
T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])
T_co = TypeVar("T_co", covariant=True)


class Cancel(NamedTuple):
    """A step: the client asks the daemon to end a job or a gather."""

    request_id: int


# A call that returns a T. Its steps are: a Request, which the client sends, and whose id it gives
# back; an id, for which it gives back the next part of the answer when that has come; and Cancel.
Steps = Generator[Union[Request[Any], int, Cancel], Any, T]


class Calls:
    """What the calls of one client share."""

    def __init__(self, info: Info, exchange: Exchange):
        self.info = info
        self.exchange = exchange
        self._measured: dict[str, tuple[Medium, Medium, Medium]] = {}

    def ask(self, request: Request[T]) -> Steps[T]:
        """Sends a request and returns its answer."""
        request_id = yield request
        try:
            answer: T = yield request_id
            return answer
        finally:
            self.exchange.drop(request_id)

    def each(
        self,
        requests: Iterable[Request[T]],
        take: Callable[[T], object],
        most: int = 1,
        cancels: bool = False,
    ) -> Steps[None]:
        """Sends requests, of which at most `most` are under way, and gives the answers to take() in
        their order. After an error, the other answers are no longer wanted. cancels: whether the
        daemon is told so, unless the error is its own."""
        waiting = iter(requests)
        under_way: list[int] = []
        taking = False
        try:
            while True:
                while len(under_way) < most and (request := next(waiting, None)) is not None:
                    under_way.append((yield request))
                if not under_way:
                    return
                answer = yield under_way[0]
                taking = True
                take(answer)
                taking = False
                self.exchange.drop(under_way.pop(0))
        except GeneratorExit:
            raise
        except BaseException as error:
            if cancels and (taking or not isinstance(error, DipoleError)):
                yield from self.cancel(under_way)
            raise
        finally:
            for request_id in under_way:
                self.exchange.drop(request_id)

    def cancel(self, request_ids: Iterable[int]) -> Steps[None]:
        """Lets the daemon end jobs. Those of a lost connection have ended with it."""
        with contextlib.suppress(ConnectionLost):
            for request_id in request_ids:
                yield Cancel(request_id)

    def media_of(self, given: Media) -> Steps[Media]:
        """Returns the channels of a measured medium for its name, and other media unchanged."""
        if not isinstance(given, str):
            return given
        self._measured = self._measured or (yield from media(self))
        return known("medium", given, self._measured)


# ---- signatures of the clients' methods ----------------------------------------------------------


class QueryCall(Protocol[P, T_co]):
    """A method that takes a Query or its arguments."""

    @overload
    def __call__(self, query: Query, /) -> T_co: ...
    @overload
    def __call__(self, *arguments: P.args, **options: P.kwargs) -> T_co: ...


def takes_query(
    like: Callable[P, Query], call: Callable[..., object]
) -> Callable[[Callable[..., T]], QueryCall[P, T]]:
    """Gives a method the signature of Query, whose arguments or object it gets, and the description
    of a call."""

    def describe(method: Callable[..., T]) -> Callable[..., T]:
        own = inspect.signature(method)
        arguments = inspect.signature(like).parameters.values()
        signature = own.replace(parameters=[own.parameters["self"], *arguments])
        return _described(method, call.__doc__, signature)

    return describe


def signature_of(call: Callable[..., object]) -> inspect.Signature:
    """Returns the signature of a method that makes a call. It has one by one the options that are
    those of a Query."""
    own = inspect.signature(call)
    first, *others = own.parameters.values()
    listed = [first.replace(name="self", annotation=inspect.Parameter.empty)]
    for one in others:
        if one.kind is not inspect.Parameter.VAR_KEYWORD:
            listed.append(one)
            continue
        names = getattr(values, one.annotation[len("Unpack[") : -1]).__annotations__
        of_query = inspect.signature(Query).parameters
        listed += [parameter for name, parameter in of_query.items() if name in names]
    returned = own.return_annotation[len("Steps[") : -1]
    return own.replace(parameters=listed, return_annotation=returned)


def described(method: Callable[..., Any], call: Callable[..., object], owner: str) -> Any:
    """Gives a method of the class `owner` the name, signature and description of a call."""
    method.__name__, method.__qualname__ = call.__name__, f"{owner}.{call.__name__}"
    return _described(method, call.__doc__, signature_of(call))


def _described(method: F, text: str | None, signature: inspect.Signature) -> F:
    method.__doc__ = text
    setattr(method, "__signature__", signature)  # noqa: B010  (mypy does not know it)
    return method


# ---- about the daemon ----------------------------------------------------------------------------


def hello(address: str) -> Request[Info]:
    """Makes the first request of a client. address: that of the connection, which Info repeats."""
    request = wire.HELLO_REQUEST.pack(version_min=wire.VERSION, version_max=wire.VERSION)

    def read(reply: bytes) -> Info:
        fixed, (choices, limits) = wire.unpack_list(
            reply, wire.HELLO_REPLY, choice_count=wire.CHOICE, limit_count=wire.VALUE
        )
        by_kind: dict[str, dict[str, Choice]] = {kind: {} for kind in wire.KINDS.values()}
        for choice in choices:
            kind = wire.KINDS.get(choice.kind)
            if kind is not None:  # A newer daemon may list kinds that this client does not know.
                by_kind[kind][choice.name] = Choice(choice.id, choice.name, choice.about)
        return Info(
            address=address,
            software=fixed.software,
            instruction_set=fixed.instruction_set,
            R_unit=fixed.R_unit,
            protocol_version=fixed.version,
            workers=fixed.workers,
            choices=by_kind,
            limits={limit.name: limit.value for limit in limits},
        )

    return Request("hello", request, lambda: Once(read))


def media(calls: Calls) -> Steps[dict[str, tuple[Medium, Medium, Medium]]]:
    """Returns the daemon's measured media by name, each with three channels: red, green, blue."""

    def read(reply: bytes) -> dict[str, tuple[Medium, Medium, Medium]]:
        entries = wire.unpack_list(reply, wire.LIST_REPLY, count=wire.MEASURED_MEDIUM)[1][0]
        return {
            entry.name: (_channel(entry, 0), _channel(entry, 1), _channel(entry, 2))
            for entry in entries
        }

    return (yield from calls.ask(Request("media", b"", lambda: Once(read))))


def _channel(entry: Any, i: int) -> Medium:
    return Medium(entry.sigma_a[i], entry.sigma_s[i], entry.g, entry.eta)


def statistics(calls: Calls) -> Steps[dict[str, int]]:
    """Returns the daemon's statistics by name. A name ends in the unit of its number."""

    def read(reply: bytes) -> dict[str, int]:
        entries = wire.unpack_list(reply, wire.LIST_REPLY, count=wire.VALUE)[1][0]
        return {entry.name: entry.value for entry in entries}

    return (yield from calls.ask(Request("statistics", b"", lambda: Once(read))))


def ping(calls: Calls, payload: bytes = b"") -> Steps[float]:
    """Returns the time of an empty round trip, in seconds. payload: up to 1024 bytes, a multiple of
    8, which the daemon sends back."""
    if len(payload) % wire.ALIGNMENT or len(payload) > wire.PING_MAX_BYTES:
        raise ArgumentError("payload: a multiple of 8 bytes, at most 1024")

    def read(reply: bytes) -> None:
        if reply != payload:
            raise ProtocolError("the ping came back changed")

    start = time.perf_counter()
    yield from calls.ask(Request("ping", payload, lambda: Once(read)))
    return time.perf_counter() - start
