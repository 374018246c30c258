"""What Client and AsyncClient do alike: they send requests, receive replies and connect again. It
is written once, in coroutines: those of a Client never suspend, because what they wait for blocks.
"""

from __future__ import annotations

import contextlib
import select
import time
from collections.abc import Callable, Coroutine, Iterable
from typing import Any, Protocol, TypeVar

from . import wire
from .arguments import known
from .connection import Connection
from .errors import ArgumentError, ConnectionLost, DipoleError, Refused
from .exchange import Exchange, Once, Request
from .message import call
from .opening import Opening
from .values import Info, MeasuredMedia, Media, Medium, Stack

T = TypeVar("T")


class Event(Protocol):
    """As of asyncio."""

    def set(self) -> None: ...
    async def wait(self) -> Any: ...


class Waiting:
    """How a client waits. Client blocks; AsyncClient replaces this by what lets other tasks run."""

    async def events(self, connection: Connection, wait_s: float | None) -> int:
        """Waits for events of a connection, as of poll(); 0 if there are none within wait_s."""
        return connection.events(wait_s)

    async def work(self, function: Callable[[], T]) -> T:
        """Calls a function that blocks."""
        return function()

    def check(self, connection: Connection) -> None:
        """Raises ConnectionLost if a connection is that of another process or event loop."""
        connection.check_owner()

    def interrupt(self) -> None:
        """Ends a running wait for events."""

    async def close(self, connection: Connection) -> None:
        """Closes a connection, and ends a running wait."""
        connection.close()

    def event(self) -> Event:
        """Makes an event for which one task waits while another one waits for the connection."""
        raise NotImplementedError


class Session:
    """The connection of one client, and its requests."""

    def __init__(self, opening: Opening, waiting: Waiting):
        self._opening, self._waiting = opening, waiting
        self.exchange = Exchange(0.0)
        self.connection: Connection
        self.info: Info
        self.closed = False
        self._moving = False  # whether a task waits for the connection; others wait for this one
        # events of the other tasks, by the request that they wait for
        self._sleepers: dict[int, Event] = {}
        self._sending: set[int] = set()  # requests whose callers wait until they are sent
        self._measured: MeasuredMedia = {}

    async def open(self) -> Session:
        """Opens the first connection. An unopened session cannot be used."""
        self.connection, self.info = await self._waiting.work(self._opening.open)
        self.exchange.retry_s = self._opening.retry_s
        return self

    async def close(self) -> None:
        """Closes the connection and ends a private daemon. Running calls fail."""
        self.closed = True
        try:
            self._waiting.check(self.connection)
        except ConnectionLost:  # A forked loop shares its parent's epoll: it may wait for nothing.
            self.connection.close()
            return
        self.exchange.fail(self._closed())
        self._wake_all()
        await self._waiting.close(self.connection)

    # ---- for calls -------------------------------------------------------------------------------

    async def call(self, request: Request[T]) -> T:
        """Sends a request and returns its reply."""
        request_id = await self.send(request)
        try:
            reply: T = await self.next(request_id)
            return reply
        finally:
            self.exchange.drop(request_id)

    async def each(
        self,
        requests: Iterable[Request[T]],
        take: Callable[[T], object],
        most: int = 1,
        cancels: bool = False,
    ) -> None:
        """Sends requests, of which at most `most` are under way, and gives the replies to take() in
        their order. After an error, the other replies are no longer wanted. cancels: whether the
        daemon is informed, unless the error is its own."""
        waiting = iter(requests)
        under_way: list[int] = []
        taking = False
        try:
            while True:
                while len(under_way) < most and (request := next(waiting, None)) is not None:
                    under_way.append(await self.send(request))
                if not under_way:
                    return
                reply = await self.next(under_way[0])
                taking = True
                take(reply)
                taking = False
                self.exchange.drop(under_way.pop(0))
        except GeneratorExit:
            raise
        except BaseException as error:
            if cancels and (taking or not isinstance(error, DipoleError)):
                await self.cancel(under_way)
            raise
        finally:
            for request_id in under_way:
                self.exchange.drop(request_id)

    async def cancel(self, request_ids: Iterable[int]) -> None:
        """Lets the daemon end jobs. Those of a lost connection have ended with it. No reply to a
        cancel is read: the job's result follows."""
        with contextlib.suppress(ConnectionLost):
            for request_id in request_ids:
                self.exchange.send_once(request_id)
                payload = wire.CANCEL_REQUEST.pack(job_id=request_id)
                request = Request("cancel", payload, lambda: Once(lambda _: None))
                self.exchange.drop(await self.send(request))

    async def media(self) -> MeasuredMedia:
        """Returns the media that the daemon knows by name."""
        layers: dict[str, list[Iterable[Medium]]] = {}
        for one in (await call(self, "media"))["media"]:
            channels = map(Medium, one.sigma_a, one.sigma_s, one.g, one.eta, one.thickness)
            layers.setdefault(one.name, []).append(channels)
        return {
            name: tuple(of[0]) if len(of) == 1 else tuple(map(Stack, *of))
            for name, of in layers.items()
        }

    async def media_of(self, given: Media) -> Media:
        """Returns the channels of a measured medium for its name, and other media unchanged."""
        if not isinstance(given, str):
            return given
        self._measured = self._measured or await self.media()
        return known("medium", given, self._measured)

    # ---- sending and receiving -------------------------------------------------------------------

    async def send(self, request: Request[Any]) -> int:
        """Sends a request; returns its id. Later calls send what an exception leaves unsent."""
        self._check()
        request_id = self.exchange.begin(request)
        self._sending.add(request_id)
        try:
            self._put([request_id])
            await self.until(
                lambda: not self.connection.unsent or self.exchange.is_ready(request_id), request_id
            )
        except BaseException:
            self.exchange.drop(request_id)
            raise
        finally:
            self._sending.discard(request_id)
        return request_id

    async def next(self, request_id: int) -> Any:
        """Waits for the next part of a reply. Returns None after the last one."""
        await self.until(lambda: self.exchange.is_ready(request_id), request_id)
        return self.exchange.next(request_id)

    async def until(self, done: Callable[[], bool], request_id: int) -> None:
        """Moves bytes until a request is done. Only one task of a client does so at a time."""
        try:
            while not done():
                self._check()
                if self._moving:
                    await self._sleep(request_id)
                    continue
                self._moving = True
                try:
                    await self._move()
                finally:
                    self._moving = False
        finally:
            if not self._moving:  # Another one continues.
                self._wake(next(iter(self._sleepers), 0))

    async def _sleep(self, request_id: int) -> None:
        event = self._sleepers[request_id] = self._waiting.event()
        try:
            await event.wait()
        finally:
            self._sleepers.pop(request_id, None)

    def _wake_all(self) -> None:
        for event in self._sleepers.values():
            event.set()

    def _wake(self, request_id: int) -> None:
        if request_id in self._sleepers:
            self._sleepers[request_id].set()

    def _check(self) -> None:
        if self.closed:
            raise self._closed()
        self._waiting.check(self.connection)

    def _closed(self) -> ConnectionLost:
        return ConnectionLost(f"{self.connection.name}: this client is closed", final=True)

    def _put(self, request_ids: Iterable[int]) -> None:
        """Sends requests as far as that is possible at once; _move() sends the rest."""
        for request_id in request_ids:
            pieces = self.exchange.frame(request_id)
            self.connection.put(pieces)
            if not pieces:  # The deadline of the request has passed.
                self._wake(request_id)
        if self._moving:
            self._waiting.interrupt()

    async def _move(self) -> None:
        """Waits until bytes can be received or sent, or a refused request may be sent again."""
        connection = self.connection
        try:
            connection.check_usable()
            self._put(self.exchange.due())
            due_s, silent_s = self.exchange.next_due_s(), connection.timeout_s
            began_s = time.monotonic()
            limits_s = [silent_s, None if due_s is None else max(due_s - began_s, 0)]
            wait_s = min((limit_s for limit_s in limits_s if limit_s is not None), default=None)
            events = select.POLLOUT if connection.is_fresh else 0
            events = events or await self._waiting.events(connection, wait_s)
            if events:
                connection.move(events)
            elif silent_s is not None and time.monotonic() - began_s >= silent_s:
                raise connection.silent()
            while (frame := connection.take_frame(self.exchange.take)) is not None:
                self._wake(frame.request_id)
            if events & select.POLLOUT and not connection.unsent:
                for request_id in self._sending:
                    self._wake(request_id)
        # Here Refused concerns the connection, not a request.
        except (ConnectionLost, Refused) as lost:
            await self._restore(lost)

    async def _restore(self, lost: DipoleError) -> None:
        """Connects and sends requests without a reply again; if that fails, `lost` ends them."""
        try:
            self._check()
            until_s = self.exchange.lost(lost)
            self.connection.torn = True  # the next call continues if this one is interrupted
            await self._waiting.work(self.connection.close)
            self.connection = await self._waiting.work(lambda: self._open_again(until_s, lost))
            self._put(self.exchange.restored())
        except DipoleError as error:
            self.exchange.fail(error)
            self._wake_all()

    def _open_again(self, until_s: float, lost: DipoleError) -> Connection:
        try:
            return self._opening.open_again(self.info, until_s, lost)
        except DipoleError:
            self.connection.torn = False  # It is closed for good.
            raise


def run(coroutine: Coroutine[Any, Any, T]) -> T:
    """Runs a coroutine that does not suspend."""
    try:
        coroutine.send(None)
    except StopIteration as end:
        returned: T = end.value
        return returned
    raise AssertionError("a coroutine of a Client suspends")
