"""The client for asyncio: the same calls, awaited, and any number of them at a time.

    async with dipole.AsyncClient("tcp:farm:4817") as client:
        near, far = await asyncio.gather(
            client.eval("better", skin, r=[0.1]), client.eval("better", skin, r=[10.0])
        )
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from . import answers, broadcast, calls, inversion, mc, packing, retry, samples, wire
from .aio_stream import AsyncStream
from .answers import Answer
from .broadcast import Values
from .connection import Frame
from .errors import ArgumentError, ConnectionLost, DipoleError, ProtocolError, Refused
from .inversion import Inversion
from .samples import Draw, Samples
from .session import Session
from .table import Table
from .values import Grid, Info, Medium, Offers, Result

T = TypeVar("T")

# Frames that have come and that nobody has taken: with so many nothing more is read unless somebody
# waits for it.
_FRAMES_AHEAD = 16


class _Again(NamedTuple):
    """In place of a frame: the answer begins anew, what has come of it is of no use."""


_AGAIN = _Again()


class AsyncClient:
    """Connects when it is entered (or open() is awaited); belongs to one event loop.

    The arguments are those of Client, and so is what happens when the connection is lost or the
    daemon is busy. A call that is cancelled takes none of the others with it; a Monte Carlo job is
    then cancelled on the daemon, too.
    """

    def __init__(
        self,
        address: str | None = None,
        timeout_s: float | None = 30.0,
        retry_s: float | None = None,
    ):
        self.info: Info  # from open() on
        self._address = address
        self._timeout_s = timeout_s
        self._retry_s = retry_s
        self._last_id = 0
        # What has come of requests that have no whole answer yet, by id.
        self._come: dict[int, asyncio.Queue[Frame | DipoleError | _Again]] = {}
        self._begun: set[int] = set()  # those of whose answers parts have been handed on
        self._requests = retry.Requests()
        self._stream: AsyncStream | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._connected = asyncio.Event()  # or failed: not while it connects again
        self._wanted = asyncio.Event()  # something that has not come yet
        self._hungry = 0  # how many calls wait for that
        self._hungry_s = 0.0  # since when there are any
        self._failed: DipoleError | None = None

    # ---- opening and closing ---------------------------------------------------------------------

    async def __aenter__(self) -> AsyncClient:
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def open(self) -> None:
        """Connects and reads the daemon's lists."""
        session = await asyncio.to_thread(Session, self._address, self._timeout_s, 0)
        self.info = session.info
        is_private = session.info.address.startswith("private:")
        default_s = 0.0 if is_private else retry.DEFAULT_S
        self._requests.for_s = default_s if self._retry_s is None else self._retry_s
        self._stream = AsyncStream(session._connection)
        self._connected.set()
        self._start(self._read())
        if self._timeout_s is not None:
            self._start(self._watch(self._timeout_s))

    async def close(self) -> None:
        """Closes the connection and ends a private daemon. Calls under way fail. Closing twice is
        fine."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._fail(ConnectionLost(f"{self._name()}: this client is closed", final=True))
        if self._stream is not None:
            stream, self._stream = self._stream, None
            await stream.close()

    def _name(self) -> str:
        return str(self._address) if self._stream is None else self._stream.address

    # ---- evaluating ------------------------------------------------------------------------------

    async def eval(
        self,
        model: str | int | None,
        media: Medium | Iterable[Sequence[float]] | np.ndarray,
        r: Any = None,
        *,
        grid: Grid | None = None,
        evaluator: str | int | None = None,
        moments: str | int = "exact",
        wanted: Iterable[str] | None = None,
        parameters: Mapping[str, float | str] | None = None,
        tolerance: float | None = None,
        deadline_ms: int = 0,
    ) -> Result:
        """See Client.eval()."""
        payload, query = packing.query(
            self.info, model, media, r, grid, evaluator, moments, wanted, parameters, tolerance
        )
        answer = await self._whole(payload, deadline_ms, Answer(query))
        return answers.result(answer, self.info)

    async def eval_parts(
        self,
        model: str | int | None,
        media: Medium | Iterable[Sequence[float]] | np.ndarray,
        r: Any = None,
        *,
        grid: Grid | None = None,
        evaluator: str | int | None = None,
        moments: str | int = "exact",
        wanted: Iterable[str] | None = None,
        parameters: Mapping[str, float | str] | None = None,
        tolerance: float | None = None,
        deadline_ms: int = 0,
    ) -> AsyncIterator[Result]:
        """See Client.eval_parts(): an asynchronous iterator. Of what nobody takes up a little is
        read ahead, and all of it as far as the answers to other calls come behind it."""
        payload, query = packing.query(
            self.info, model, media, r, grid, evaluator, moments, wanted, parameters, tolerance
        )
        answer = Answer(query._replace(handed_on=True))
        request_id = await self._send("eval", payload, deadline_ms)
        try:
            while not answer.ended:
                answer = await self._take_part(request_id, answer)
                while answer.ready:
                    self._begun.add(request_id)
                    yield answers.result(answer, self.info)
        finally:
            self._drop(request_id)

    async def _whole(self, payload: bytes, deadline_ms: int, answer: Any) -> Any:
        """Sends a request and waits for all of its answer."""
        request_id = await self._send(answer.message, payload, deadline_ms)
        try:
            while not answer.ended:
                answer = await self._take_part(request_id, answer)
        finally:
            self._drop(request_id)
        return answer

    async def _take_part(self, request_id: int, answer: Any) -> Any:
        """Waits for the next part of an answer, or the error in its place; returns the answer, or
        another that takes its place, without a part."""
        frame = await self._next_frame(request_id)
        if isinstance(frame, _Again):
            return answer.fresh()
        try:
            answer.add(calls.payload_of(frame, answer.message))
        except Refused as refusal:
            answer.refuse(refusal)
        return answer

    async def values(
        self,
        model: str | int | None,
        media: Medium | Sequence[Any] | np.ndarray,
        r: Any,
        quantity: str = "R",
        **options: Any,
    ) -> Values:
        """See Client.values(), which has the same options."""
        queries, collected = broadcast.plan(self.info, media, r, quantity)

        async def ask() -> None:
            for query in queries:
                result = await self.eval(
                    model, query.media, query.radii, wanted=[quantity], **options
                )
                collected.add(query, result)

        tasks = [asyncio.create_task(ask()) for _ in range(broadcast.OUTSTANDING)]
        try:
            await asyncio.gather(*tasks)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        return collected.values()

    async def sample(
        self,
        model: str | int,
        media: Medium | Iterable[Sequence[float]] | np.ndarray,
        u: Any = None,
        *,
        draw: Draw | None = None,
        evaluator: str | int = "f64",
        moments: str | int = "exact",
        wanted: Iterable[str] = ("r", "pdf"),
        parameters: Mapping[str, float | str] | None = None,
        tolerance: float | None = None,
        deadline_ms: int = 0,
    ) -> Samples:
        """See Client.sample()."""
        how = (u, draw, evaluator, moments, wanted, parameters, tolerance)
        payload, query, numbers = samples.request(self.info, model, media, *how)
        answer = await self._whole(payload, deadline_ms, Answer(query))
        return samples.result(answer, self.info, numbers)

    async def invert(
        self,
        model: str | int,
        albedo: Any,
        length: Any,
        *,
        given: str | int = "mean-free-path",
        g: float = 0.0,
        eta: float = 1.3,
        moments: str | int = "exact",
        deadline_ms: int = 0,
    ) -> Inversion:
        """See Client.invert()."""
        payload, query = inversion.request(
            self.info, model, albedo, length, given, g, eta, moments
        )
        answer = await self._whole(payload, deadline_ms, inversion.Answer(query))
        return inversion.result(answer, self.info)

    # ---- the rest --------------------------------------------------------------------------------

    async def offers(
        self,
        media: Medium | Iterable[Sequence[float]] | np.ndarray,
        r: Any = None,
        *,
        grid: Grid | None = None,
        evaluator: str | int | None = None,
        wanted: Iterable[str] | None = None,
        parameters: Mapping[str, float | str] | None = None,
        tolerance: float | None = None,
    ) -> Offers:
        """See Client.offers()."""
        call = calls.offers(self.info, media, r, grid, evaluator, wanted, parameters, tolerance)
        return await self._call(call)

    async def table(
        self,
        model: str | int,
        medium: Medium | Sequence[float],
        *,
        moments: str | int = "exact",
        parameters: Mapping[str, float | str] | None = None,
        tolerance: float | None = None,
        deadline_ms: int = 0,
    ) -> Table:
        """See Client.table()."""
        call = calls.table(self.info, model, medium, moments, parameters, tolerance)
        return await self._call(call, deadline_ms)

    async def media(self) -> dict[str, tuple[Medium, Medium, Medium]]:
        """See Client.media()."""
        return await self._call(calls.media())

    async def statistics(self) -> dict[str, int]:
        """See Client.statistics()."""
        return await self._call(calls.statistics())

    async def ping(self, payload: bytes = b"") -> float:
        """See Client.ping()."""
        call = calls.ping(payload)
        start = time.perf_counter()
        await self._call(call)
        return time.perf_counter() - start

    async def mc(
        self,
        medium: Medium | Sequence[float],
        edges: Grid,
        *,
        progress: Callable[[mc.McProgress], bool | None] | None = None,
        **options: Any,
    ) -> mc.McResult:
        """See Client.mc(), which has the same options."""
        payload = mc.request(self.info, medium, edges, **options)
        request_id = await self._send("mc", payload)
        cancelled = ended = False
        try:
            while True:
                reply = calls.payload_of(await self._reply(request_id), "mc")
                fixed = mc.unpack_fixed(reply)
                if fixed.state != wire.MC_UNDER_WAY:
                    ended = True
                    return mc.unpack_result(reply)
                if progress is not None and not cancelled:
                    cancelled = progress(mc.progress_of(fixed)) is False
                    if cancelled:
                        await self._cancel(request_id)
        finally:
            self._drop(request_id)
            if not ended:
                await self._cancel(request_id)

    async def _cancel(self, job_id: int) -> None:
        """Ends a Monte Carlo job. The reply to this is of no interest."""
        self._last_id += 1
        if self._stream is not None:
            type, payload = wire.MESSAGES["cancel"], wire.CANCEL_REQUEST.pack(job_id=job_id)
            await self._stream.send_frame(type, self._last_id, payload)

    # ---- requests and replies --------------------------------------------------------------------

    async def _call(self, call: calls.Call[T], deadline_ms: int = 0) -> T:
        request_id = await self._send(call.message, call.payload, deadline_ms)
        try:
            return call.read(calls.payload_of(await self._reply(request_id), call.message))
        finally:
            self._drop(request_id)

    async def _send(self, message: str, payload: bytes, deadline_ms: int = 0) -> int:
        """Sends a request; returns its id."""
        if self._failed is None and self._stream is None:
            raise ArgumentError("this client is not open")
        await self._connected.wait()
        if self._failed is not None:
            raise self._failed
        self._last_id += 1
        request_id = self._last_id
        self._come[request_id] = asyncio.Queue()
        self._requests.add(request_id, message, payload, deadline_ms)
        try:
            type = wire.MESSAGES[message]
            await self._stream.send_frame(type, request_id, payload, deadline_ms)
        except BaseException:
            self._drop(request_id)
            raise
        return request_id

    def _drop(self, request_id: int) -> None:
        """Its answer is whole, or nobody wants it any more: what still comes is thrown away."""
        self._come.pop(request_id, None)
        self._begun.discard(request_id)
        self._requests.remove(request_id)

    async def _reply(self, request_id: int) -> Frame:
        """The next frame that answers a request of whose answer nothing is kept."""
        frame = await self._next_frame(request_id)
        while isinstance(frame, _Again):
            frame = await self._next_frame(request_id)
        return frame

    async def _next_frame(self, request_id: int) -> Frame | _Again:
        """The next frame that answers a request."""
        come = self._come[request_id]
        if come.empty():
            if self._hungry == 0:
                self._hungry_s = time.monotonic()
            self._hungry += 1
            self._wanted.set()
            try:
                frame = await come.get()
            finally:
                self._hungry -= 1
        else:
            frame = come.get_nowait()
            self._wanted.set()
        if isinstance(frame, DipoleError):
            raise frame
        return frame

    # ---- reading ---------------------------------------------------------------------------------

    async def _read(self) -> None:
        """Reads frames and gives them to whom they belong, until the client is closed or fails."""
        try:
            while True:
                try:
                    await self._give(await self._stream.receive_frame())
                except ConnectionLost as lost:
                    await self._restore(lost)
                while self._hungry == 0 and self._ahead() >= _FRAMES_AHEAD:
                    self._wanted.clear()
                    await self._wanted.wait()
        except DipoleError as error:
            self._fail(error)

    def _ahead(self) -> int:
        return sum(come.qsize() for come in self._come.values())

    async def _watch(self, timeout_s: float) -> None:
        """Gives up on a daemon that is silent for too long."""
        while True:
            await asyncio.sleep(timeout_s / 8)
            silent_s = time.monotonic() - max(self._hungry_s, self._stream.moved_s)
            if self._hungry > 0 and self._connected.is_set() and silent_s > timeout_s:
                break
        text = f"{self._name()}: nothing moved for {timeout_s} s"
        self._fail(ConnectionLost(text, final=True))

    async def _give(self, frame: Frame) -> None:
        if frame.type == wire.TYPE_ERROR and frame.request_id == 0:
            await self._restore(calls.refused(frame))
            return
        if not 0 < frame.request_id <= self._last_id:
            raise ProtocolError(f"a reply to request {frame.request_id}, which was not made")
        come = self._come.get(frame.request_id)
        if come is None:
            return
        if frame.type == wire.TYPE_ERROR and frame.request_id not in self._begun:
            refused = calls.refused(frame)
            if isinstance(refused, Refused) and self._requests.later(refused):
                _begin_again(come)
                self._start(self._send_later())
                return
        come.put_nowait(frame)

    def _start(self, work: Any) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _send_later(self) -> None:
        """Sends what a busy daemon has refused again, when it is time."""
        next_s = min(self._requests.again_s.values(), default=None)
        if next_s is not None:
            await asyncio.sleep(max(next_s - time.monotonic(), 0))
            await self._send_again(self._requests.due())

    async def _send_again(self, request_ids: Iterable[int]) -> None:
        """Sends requests as they were, but for what is left of their deadlines."""
        for request_id in request_ids:
            kept, come = self._requests.kept.get(request_id), self._come.get(request_id)
            if kept is None or come is None:  # nobody waits any more
                continue
            left_ms = retry.left_ms(kept) if kept.deadline_ms else 0
            if kept.deadline_ms and left_ms <= 0:
                come.put_nowait(retry.late_frame(request_id))
            else:
                type = wire.MESSAGES[kept.message]
                await self._stream.send_frame(type, request_id, kept.payload, left_ms)

    async def _restore(self, lost: DipoleError) -> None:
        """Connects again and sends again what is outstanding; raises `lost` where it cannot."""
        until_s = self._requests.until_s()
        if until_s is None or not retry.may_pass(lost) or self._begun:
            raise lost
        self._connected.clear()
        addresses = self._stream.connection.next_addresses()
        await self._stream.close()

        def connect(left_s: float) -> Session:
            timeout_s = left_s if self._timeout_s is None else min(left_s, self._timeout_s)
            return Session(addresses, timeout_s, 0)

        fresh = await asyncio.to_thread(retry.connect_again, connect, self.info, until_s, lost)
        self._stream = AsyncStream(fresh._connection)
        for come in self._come.values():
            _begin_again(come)
        sent = [i for i in sorted(self._requests.kept) if i not in self._requests.again_s]
        self._connected.set()
        self._start(self._send_again(sent))

    def _fail(self, error: DipoleError) -> None:
        """Nothing more will come."""
        if self._failed is None:
            self._failed = error
        for come in self._come.values():
            come.put_nowait(error)
        self._connected.set()


def _begin_again(come: asyncio.Queue[Frame | DipoleError | _Again]) -> None:
    while not come.empty():
        come.get_nowait()
    come.put_nowait(_AGAIN)
