"""The client for asyncio. It has the calls of Client as coroutines, and any number may run at once.

async with dipole.AsyncClient("tcp:farm:4817") as client:
    near, far = await asyncio.gather(
        client.eval("better", skin, r=[0.1]), client.eval("better", skin, r=[10.0])
    )
"""

from __future__ import annotations

import asyncio
import select
from collections.abc import AsyncIterator, Callable
from typing import Any, TypeVar

from . import evaluation
from .calls import Calls, takes_query
from .connection import Connection
from .errors import ConnectionLost
from .opening import Opening
from .session import Session, Waiting
from .values import Query, Result

T = TypeVar("T")


class _Waiting(Waiting):
    """Waits in an event loop, that in which it was made."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._events: asyncio.Future[int] | None = None
        self._work: asyncio.Future[Any] | None = None
        self._ended = False

    def check(self, connection: Connection) -> None:
        connection.check_owner()
        if asyncio.get_running_loop() is not self._loop:
            text = "another event loop opened this client: open one in each asyncio.run()"
            raise ConnectionLost(f"{connection.name}: {text}", final=True)

    def event(self) -> asyncio.Event:
        return asyncio.Event()

    def interrupt(self) -> None:
        if self._events is not None and not self._events.done():
            self._events.set_result(0)

    async def close(self, connection: Connection) -> None:
        self.interrupt()
        if self._work is not None:
            self._work.cancel()
        self._ended = True
        await asyncio.sleep(0)  # The task that waits continues first.
        await self.work(connection.close)

    async def events(self, connection: Connection, wait_s: float | None) -> int:
        if connection.has_read():
            return select.POLLIN
        future = self._events = self._loop.create_future()
        descriptor = connection.socket.fileno()

        def found(events: int) -> None:
            if not future.done():
                future.set_result(events)

        timer = None if wait_s is None else self._loop.call_later(wait_s, found, 0)
        self._loop.add_reader(descriptor, found, select.POLLIN)
        if connection.unsent:
            self._loop.add_writer(descriptor, found, select.POLLOUT)
        try:
            events: int = await future
            return events
        finally:
            self._loop.remove_reader(descriptor)
            self._loop.remove_writer(descriptor)
            if timer is not None:
                timer.cancel()

    async def work(self, function: Callable[[], T]) -> T:
        """Calls a function in a thread. A connection that it opens is closed if nobody waits."""
        result: asyncio.Future[T] = self._loop.create_future()
        self._work = result

        def end(work: asyncio.Future[T]) -> None:
            error = work.exception()
            if not result.done() and error is None:
                result.set_result(work.result())
            elif not result.done() and error is not None:
                result.set_exception(error)
            elif error is None and isinstance(opened := work.result(), Connection):
                self._loop.run_in_executor(None, opened.close)

        self._loop.run_in_executor(None, function).add_done_callback(end)
        try:
            return await result
        except asyncio.CancelledError:
            if not self._ended:
                raise
            raise ConnectionLost("this client is closed", final=True) from None


class AsyncClient(Calls):
    """A client for asyncio. Entering it in an async with statement, or awaiting open(), connects.
    It then belongs to this event loop: in another one, such as that of a second asyncio.run(), and
    in a forked process, its calls raise ConnectionLost until open() has connected again.

    It has the arguments of Client, and like Client it retries when the connection is lost or the
    daemon is busy. Cancelling a call does not disturb other calls; cancelling mc() also cancels
    its job on the daemon.
    """

    def __repr__(self) -> str:
        if self._session is None or self._session.closed:
            return f"<AsyncClient: {self._address}, not open>"
        return f"<AsyncClient: {self.info.software} at {self.address}>"

    # ---- opening and closing ---------------------------------------------------------------------

    async def __aenter__(self) -> AsyncClient:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def open(self) -> None:
        """Connects and reads the daemon's lists. An earlier connection is closed."""
        await self.close()
        self._session = await Session(Opening(*self._how), _Waiting()).open()

    async def close(self) -> None:
        """Closes the connection and ends a private daemon. Running calls fail. A second close()
        does nothing."""
        if self._session is not None and not self._session.closed:
            await self._session.close()

    # ---- calls -----------------------------------------------------------------------------------

    @staticmethod
    def _method(call: Callable[..., Any], check: Callable[..., None]) -> Callable[..., Any]:
        async def method(self: AsyncClient, *arguments: Any, **options: Any) -> Any:
            check(self, *arguments, **options)
            return await call(self._opened(), *arguments, **options)

        return method

    @takes_query(Query, evaluation.eval)
    async def eval(self, *query: Any, **options: Any) -> Result:
        return await evaluation.eval(self._opened(), Query.of(*query, **options))

    @takes_query(Query, evaluation.eval_parts)
    async def eval_parts(self, *query: Any, **options: Any) -> AsyncIterator[Result]:
        session = self._opened()
        request_id = await evaluation.eval_parts(session, Query.of(*query, **options))
        try:
            while (part := await session.next(request_id)) is not None:
                yield part
        finally:
            session.exchange.drop(request_id)
