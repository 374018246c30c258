"""Calls as coroutines, from which Client and AsyncClient make their methods. Each call is written
once, with its signature and its description. Here are those about the daemon.
"""

from __future__ import annotations

import inspect
import time
from collections.abc import Callable, Coroutine
from typing import TYPE_CHECKING, Any, Concatenate, Generic, ParamSpec, Protocol, TypeVar, overload

from . import broadcast, evaluation, fitting, gathering, inversion, tissues, values, wire
from . import mc as walking
from . import varying as textures
from .connection import Tls
from .errors import ArgumentError, ProtocolError
from .exchange import Once, Request
from .message import call
from .session import Session
from .values import Info, MeasuredMedia, Query

if TYPE_CHECKING:
    from .aio import AsyncClient
    from .client import Client

P = ParamSpec("P")
T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])
T_co = TypeVar("T_co", covariant=True)


# ---- signatures of the clients' methods ----------------------------------------------------------


class QueryCall(Protocol[P, T_co]):
    """The type of a method that takes a Query or the arguments of a Query."""

    @overload
    def __call__(self, query: Query, /) -> T_co: ...
    @overload
    def __call__(self, *arguments: P.args, **options: P.kwargs) -> T_co: ...


def takes_query(
    like: Callable[P, Query], call: Callable[..., object]
) -> Callable[[Callable[..., T]], QueryCall[P, T]]:
    """Returns a decorator. The method that it makes has the signature of Query and the description of
    a call; it takes a Query, or the arguments of one."""

    def describe(method: Callable[..., T]) -> Callable[..., T]:
        own = inspect.signature(method)
        arguments = inspect.signature(like).parameters.values()
        signature = own.replace(parameters=[own.parameters["self"], *arguments])
        return _described(method, call.__doc__, signature)

    return describe


def signature_of(call: Callable[..., object]) -> inspect.Signature:
    """Returns the signature of a method that makes a call, with options of a Query one by one."""
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
    return own.replace(parameters=listed)


def checker_of(call: Callable[..., object]) -> Callable[..., None]:
    """Returns what raises TypeError for arguments that the method of a call does not have."""
    signature = signature_of(call)

    def check(*arguments: Any, **options: Any) -> None:
        values.refuse_unknown(options, signature.parameters)
        signature.bind(*arguments, **options)

    return check


def described(method: Callable[..., Any], call: Callable[..., object], owner: str) -> Any:
    """Gives a method of the class `owner` the name, signature and description of a call."""
    method.__name__, method.__qualname__ = call.__name__, f"{owner}.{call.__name__}"
    return _described(method, call.__doc__, signature_of(call))


def _described(method: F, text: str | None, signature: inspect.Signature) -> F:
    method.__doc__ = text
    setattr(method, "__signature__", signature)  # noqa: B010  (mypy rejects the attribute)
    return method


# ---- about the daemon ----------------------------------------------------------------------------


async def media(session: Session) -> MeasuredMedia:
    """Returns the media that the daemon knows by name, each with three channels: red, green, blue."""
    return await session.media()


async def statistics(session: Session) -> dict[str, int]:
    """Returns the daemon's statistics by name. A name ends in the unit of its number."""
    entries = (await call(session, "statistics"))["value"]
    return {entry.name: entry.value for entry in entries}


async def ping(session: Session, payload: bytes = b"") -> float:
    """Returns the time of an empty round trip, in seconds. payload: up to 1024 bytes, a multiple of
    8, which the daemon sends back."""
    if len(payload) % wire.ALIGNMENT or len(payload) > wire.PING_MAX_BYTES:
        raise ArgumentError("payload: a multiple of 8 bytes, at most 1024")

    def read(reply: bytes) -> None:
        if reply != payload:
            raise ProtocolError("the ping came back changed")

    start = time.perf_counter()
    await session.call(Request("ping", payload, lambda: Once(read)))
    return time.perf_counter() - start


# ---- the methods that both clients have ----------------------------------------------------------


class Call(Generic[P, T]):
    """A method: that of a Client waits for the result of a call, that of an AsyncClient is a
    coroutine. Both stand in their classes as functions."""

    def __init__(self, call: Callable[Concatenate[Session, P], Coroutine[Any, Any, T]]):
        self.call = call

    @overload
    def __get__(self, client: Client, owner: Any) -> Callable[P, T]: ...
    @overload
    def __get__(self, client: AsyncClient, owner: Any) -> Callable[P, Coroutine[Any, Any, T]]: ...
    def __get__(self, client: Any, owner: Any) -> Any:
        raise NotImplementedError


class Calls:
    """What Client and AsyncClient share: how they are opened, and the methods that they have, which say
    by _method() what makes one of a call."""

    def __init__(
        self,
        address: str | None = None,
        timeout_s: float | None = 30.0,
        retry_s: float | None = None,
        ca: str | None = None,
        certificate: str | None = None,
        key: str | None = None,
    ):
        self._address = address
        self._how = (address, timeout_s, retry_s, Tls(ca, certificate, key))
        self._session: Session | None = None
        self._start()

    def _start(self) -> None:
        """Ends the constructor: that of a Client connects."""

    def _opened(self) -> Session:
        if self._session is None:
            raise ArgumentError("this client is not open")
        return self._session

    @property
    def info(self) -> Info:
        """The daemon's description of itself."""
        return self._opened().info

    @property
    def address(self) -> str:
        """The address of the daemon that the client is connected to, or was last connected to. It
        changes when the client continues with another daemon."""
        return self._opened().connection.address

    values = Call(broadcast.values)
    offers = Call(evaluation.offers)
    table = Call(evaluation.table)
    surface = Call(evaluation.surface)
    sample = Call(evaluation.sample)
    invert = Call(inversion.invert)
    fit = Call(fitting.fit)
    fit_layers = Call(fitting.fit_layers)
    fit_tissue = Call(fitting.fit_tissue)
    tissue = Call(tissues.tissue)
    varying = Call(textures.varying)
    gather = Call(gathering.gather)
    mc = Call(walking.mc)
    media = Call(media)
    statistics = Call(statistics)
    ping = Call(ping)
    call = Call(call)

    def __init_subclass__(cls) -> None:
        for name, one in vars(Calls).items():
            if isinstance(one, Call):
                method = getattr(cls, "_method")(one.call, checker_of(one.call))
                setattr(cls, name, described(method, one.call, cls.__name__))
