"""The client for asyncio. It has the calls of Client as coroutines, and any number may run at once.

async with dipole.AsyncClient("tcp:farm:4817") as client:
    near, far = await asyncio.gather(
        client.eval("better", skin, r=[0.1]), client.eval("better", skin, r=[10.0])
    )
"""

from __future__ import annotations

import asyncio
import socket
import ssl
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterable
from typing import Any, Concatenate, ParamSpec, TypeVar

from . import broadcast, calls, evaluation, fitting, gathering, inversion, mc, rings, varying
from .calls import Calls, Cancel, Steps, takes_query
from .connection import TLS_WAITS, Connection, Frame, Tls
from .errors import ArgumentError, ConnectionLost, DipoleError, Refused
from .exchange import Exchange, Request
from .opening import Opening
from .values import Info, Query, Result

P = ParamSpec("P")
T = TypeVar("T")

# While no call waits, the client stops reading when this many parts of answers are not yet taken.
_PIECES_AHEAD = 16


def _method(
    call: Callable[Concatenate[Calls, P], Steps[T]]
) -> Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]:
    """Makes a method of a call."""
    signature = calls.signature_of(call)

    async def method(self: AsyncClient, *arguments: Any, **options: Any) -> T:
        signature.bind(self, *arguments, **options)
        return await self._drive(call(self._open_calls(), *arguments, **options))

    made: Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]
    made = calls.described(method, call, "AsyncClient")
    return made


class _Exchange(Exchange):
    """Requests for which tasks wait."""

    def __init__(self, retry_s: float):
        super().__init__(retry_s)
        self.moved: dict[int, asyncio.Event] = {}  # by request: a part has come, or it has ended
        self.read_on = asyncio.Event()  # set when the reader that has paused may read again

    def begin(self, request: Request[Any]) -> int:
        request_id = super().begin(request)
        self.moved[request_id] = asyncio.Event()
        return request_id

    def drop(self, request_id: int) -> None:
        super().drop(request_id)
        self.moved.pop(request_id, None)
        self.read_on.set()


class AsyncClient:
    """A client for asyncio. Entering it in an async with statement, or awaiting open(), connects.
    It then belongs to this event loop: in another one, such as that of a second asyncio.run(), and
    in a forked process, its calls raise ConnectionLost until open() has connected again.

    It has the arguments of Client, and like Client it retries when the connection is lost or the
    daemon is busy. Cancelling a call does not disturb other calls; cancelling mc() also cancels
    its job on the daemon.
    """

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
        self._timeout_s = timeout_s
        self._retry_s = retry_s
        self._tls = Tls(ca, certificate, key)
        self._calls: Calls | None = None
        self._stream: _Stream | None = None
        self._begin()

    def _begin(self) -> None:
        self._exchange = _Exchange(0.0)
        self._tasks: set[asyncio.Task[None]] = set()
        self._connected = asyncio.Event()  # clear only before open() and while reconnecting
        self._waiting: set[int] = set()  # ids of the requests for which a call waits
        self._waiting_since_s = 0.0  # when _waiting last became non-empty
        self._failed: DipoleError | None = None

    @property
    def info(self) -> Info:
        """The daemon's description of itself."""
        return self._open_calls().info

    @property
    def address(self) -> str:
        """See Client.address."""
        return self._opened().connection.address

    def __repr__(self) -> str:
        if self._stream is None:
            return f"<AsyncClient: {self._address}, not open>"
        return f"<AsyncClient: {self.info.software} at {self._name()}>"

    # ---- opening and closing ---------------------------------------------------------------------

    async def __aenter__(self) -> AsyncClient:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def open(self) -> None:
        """Connects and reads the daemon's lists. An earlier connection is closed."""
        await self.close()
        self._begin()
        self._opening = Opening(
            self._address, self._timeout_s, self._retry_s, calls.hello, self._tls
        )
        connection, info = await asyncio.to_thread(self._opening.open)
        self._calls = Calls(info, self._exchange)
        self._exchange.retry_s = self._opening.retry_s
        self._stream = _Stream(connection)
        self._connected.set()
        self._start(self._read())
        if self._timeout_s is not None:
            self._start(self._watch(self._timeout_s))

    async def close(self) -> None:
        """Closes the connection and ends a private daemon. Running calls fail. A second close()
        does nothing."""
        name = self._name().removesuffix(":")
        stream, self._stream = self._stream, None
        tasks, self._tasks = self._tasks, set()
        if stream is None or stream.is_ours():
            self._fail(ConnectionLost(f"{name}: this client is closed", final=True))
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        if stream is not None:
            await stream.close()

    def _open_calls(self) -> Calls:
        if self._calls is None:
            raise ArgumentError("this client is not open")
        return self._calls

    def _opened(self) -> _Stream:
        if self._stream is None:
            raise self._failed or ArgumentError("this client is not open")
        return self._stream

    def _name(self) -> str:
        return str(self._address) if self._stream is None else self._stream.connection.address

    # ---- calls -----------------------------------------------------------------------------------

    values = _method(broadcast.values)
    offers = _method(evaluation.offers)
    table = _method(evaluation.table)
    surface = _method(evaluation.surface)
    sample = _method(evaluation.sample)
    invert = _method(inversion.invert)
    fit = _method(fitting.fit)
    varying = _method(varying.varying)
    gather = _method(gathering.gather)
    mc = _method(mc.mc)
    ring_means = _method(rings.ring_means)
    media = _method(calls.media)
    statistics = _method(calls.statistics)
    ping = _method(calls.ping)

    @takes_query(Query, evaluation.eval)
    async def eval(self, *query: Any, **options: Any) -> Result:
        return await self._drive(evaluation.eval(self._open_calls(), Query.of(*query, **options)))

    @takes_query(Query, evaluation.eval_parts)
    async def eval_parts(self, *query: Any, **options: Any) -> AsyncIterator[Result]:
        made = Query.of(*query, **options)
        request_id = await self._drive(evaluation.eval_parts(self._open_calls(), made))
        try:
            while (part := await self._next(request_id)) is not None:
                yield part
        finally:
            self._exchange.drop(request_id)

    # ---- requests and answers --------------------------------------------------------------------

    async def _drive(self, steps: Steps[T]) -> T:
        """Does the steps of a call."""
        try:
            step = next(steps)
            while True:
                try:
                    given = await self._do(step)
                except BaseException as error:
                    step = steps.throw(error)
                else:
                    step = steps.send(given)
        except StopIteration as end:
            returned: T = end.value
            return returned

    async def _do(self, step: Request[Any] | int | Cancel) -> Any:
        if isinstance(step, Request):
            return await self._send(step)
        if isinstance(step, int):
            return await self._next(step)
        self._exchange.ask_once(step.request_id)
        if self._stream is not None:
            request_id = self._exchange.begin(mc.cancellation(step.request_id))
            pieces = self._exchange.frame(request_id)
            self._exchange.drop(request_id)
            await self._stream.send(pieces)
        return None

    async def _send(self, request: Request[Any]) -> int:
        """Sends a request; returns its id."""
        self._opened().check_usable()
        await self._connected.wait()
        if self._failed is not None:
            raise self._failed
        request_id = self._exchange.begin(request)
        try:
            await self._opened().send(self._exchange.frame(request_id))
        except BaseException:
            self._exchange.drop(request_id)
            raise
        return request_id

    async def _next(self, request_id: int) -> Any:
        """Waits for the next part of an answer. Returns None after the last one."""
        moved = self._exchange.moved[request_id]
        while not self._exchange.is_ready(request_id):
            if self._failed is not None:
                raise self._failed
            self._opened().check_usable()
            if not self._waiting:
                self._waiting_since_s = time.monotonic()
            self._waiting.add(request_id)
            self._exchange.read_on.set()
            moved.clear()
            try:
                await moved.wait()
            finally:
                self._waiting.discard(request_id)
        self._exchange.read_on.set()
        return self._exchange.next(request_id)

    # ---- reading ---------------------------------------------------------------------------------

    async def _read(self) -> None:
        """Gives frames to their requests until the client is closed or fails."""
        try:
            while True:
                try:
                    self._take(await self._opened().receive_frame())
                except (ConnectionLost, Refused) as lost:
                    await self._restore(lost)
                while not self._waiting and self._exchange.ahead() >= _PIECES_AHEAD:
                    self._exchange.read_on.clear()
                    await self._exchange.read_on.wait()
        except DipoleError as error:
            self._fail(error)
        except BaseException as error:
            text = f"{self._name()}: receiving has ended: {error!r}"
            self._fail(ConnectionLost(text, final=True))
            raise

    def _take(self, frame: Frame) -> None:
        request_id = self._exchange.take(frame)
        moved = self._exchange.moved.get(request_id)
        if moved is not None and self._exchange.is_ready(request_id):
            moved.set()
            self._waiting.discard(request_id)  # The call no longer waits, even if it runs later.
        elif self._exchange.is_planned(request_id) and moved is not None:
            self._start(self._send_later())

    async def _watch(self, timeout_s: float) -> None:
        """When a call waits and the daemon has sent nothing for timeout_s, goes on with the next of
        several addresses, or else fails all calls."""
        while True:
            await asyncio.sleep(timeout_s / 8)
            stream = self._opened()
            silent_s = time.monotonic() - max(self._waiting_since_s, stream.moved_s)
            if not self._waiting or not self._connected.is_set() or silent_s <= timeout_s:
                continue
            text = stream.connection.silent_text(timeout_s)
            if not stream.connection.is_one_of_several:
                self._fail(ConnectionLost(text, final=True))
                return
            stream.give_up(ConnectionLost(text))

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _send_later(self) -> None:
        """Waits until a request that a busy daemon refused may be sent again, and sends it."""
        next_s = self._exchange.next_due_s()
        if next_s is not None:
            await asyncio.sleep(max(next_s - time.monotonic(), 0))
            await self._send_again(self._exchange.due())

    async def _send_again(self, request_ids: Iterable[int]) -> None:
        for request_id in request_ids:
            pieces = self._exchange.frame(request_id)
            if pieces:
                await self._opened().send(pieces)
            elif request_id in self._exchange.moved:  # The deadline of the request has passed.
                self._exchange.moved[request_id].set()

    async def _restore(self, lost: DipoleError) -> None:
        """Connects again and sends the requests without an answer again. Raises `lost` if that
        fails."""
        until_s = self._exchange.lost(lost)
        self._connected.clear()
        await self._opened().close()
        self._stream = _Stream(
            await asyncio.to_thread(self._opening.open_again, self.info, until_s, lost)
        )
        sent = self._exchange.restored()
        self._connected.set()
        self._start(self._send_again(sent))

    def _fail(self, error: DipoleError) -> None:
        """Ends all calls with an error: nothing more is received."""
        if self._failed is None:
            self._failed = error
        for moved in self._exchange.moved.values():
            moved.set()
        self._connected.set()


class _Stream:
    """Sends and receives whole frames over a Connection, which it owns from now on. Only one task
    may receive; any number may send."""

    def __init__(self, connection: Connection):
        self.connection = connection
        self.moved_s = time.monotonic()  # when a byte last came
        self._loop = asyncio.get_running_loop()
        self._sending = asyncio.Lock()
        self._sends: set[asyncio.Task[None]] = set()
        self._closed = False
        self._given_up: ConnectionLost | None = None
        connection.socket.setblocking(False)

    async def close(self) -> None:
        """Closes the connection; a private daemon ends with it. No task may be receiving."""
        self._closed = True
        self.connection.hang_up()  # so that those end who wait for bytes, or for room to send
        if self.is_ours():
            await asyncio.gather(*self._sends)
            await asyncio.to_thread(self.connection.close)
        else:  # A forked loop shares its epoll with the parent's: nothing may be waited for.
            self.connection.close()

    def give_up(self, error: ConnectionLost) -> None:
        """Makes the task that receives raise this error."""
        self._given_up = error
        self._closed = True
        self.connection.hang_up()

    def is_ours(self) -> bool:
        """Whether this is the process, and the running event loop the one, that made the stream."""
        return asyncio.get_running_loop() is self._loop and self.connection.is_ours()

    def check_usable(self) -> None:
        """Raises ConnectionLost if this process or this event loop has not opened the connection."""
        self.connection.check_owner()
        if not self.is_ours():
            text = "another event loop opened this client: open one in each asyncio.run()"
            raise ConnectionLost(f"{self.connection.name}: {text}", final=True)

    async def send(self, pieces: list[bytes]) -> None:
        """Sends a frame, completely even if the caller is cancelled. A lost connection raises
        nothing here: receive_frame() reports it."""
        if not self._closed:
            send = asyncio.create_task(self._send(pieces))
            self._sends.add(send)
            send.add_done_callback(self._sends.discard)
            await asyncio.shield(send)

    async def _send(self, pieces: list[bytes]) -> None:
        async with self._sending:
            try:
                for data in pieces:
                    await self._send_all(data)
            except OSError:
                pass
            except BaseException:
                name = self.connection.name
                self.give_up(ConnectionLost(f"{name}: an exception has ended the sending of a frame"))
                raise

    async def _send_all(self, data: bytes) -> None:
        """asyncio's own calls take no socket with TLS."""
        connection = self.connection.socket
        if not isinstance(connection, ssl.SSLSocket):
            await self._loop.sock_sendall(connection, data)
            return
        view = memoryview(data)
        while view:
            try:
                view = view[connection.send(view) :]
            except TLS_WAITS:
                await self._wait(connection, self._loop.add_writer, self._loop.remove_writer)

    async def _receive_into(self, room: memoryview) -> int:
        connection = self.connection.socket
        if not isinstance(connection, ssl.SSLSocket):
            return await self._loop.sock_recv_into(connection, room)
        while True:
            try:
                return connection.recv_into(room)
            except TLS_WAITS:
                await self._wait(connection, self._loop.add_reader, self._loop.remove_reader)

    async def _wait(
        self,
        connection: socket.socket,
        add: Callable[[int, Callable[[], None]], None],
        remove: Callable[[int], bool],
    ) -> None:
        """Waits until the socket can be read or written to."""
        ready = asyncio.Event()
        descriptor = connection.fileno()
        add(descriptor, ready.set)
        try:
            await ready.wait()
        finally:
            remove(descriptor)

    async def receive_frame(self) -> Frame:
        """Waits for the next frame, whatever its type."""
        incoming = self.connection.incoming
        while (frame := incoming.take_frame()) is None:
            try:
                count = await self._receive_into(incoming.room())
            except OSError as error:
                raise self.connection.lost(error) from error
            if self._given_up is not None:
                raise self._given_up
            self.connection.received(count)
            self.moved_s = time.monotonic()
        return frame
