"""A connection with requests under way: sent, asked again where that may help, and answered."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, TypeVar

from . import answers, calls, inversion, mc, retry, wire
from .answers import Answer
from .connection import Connection, Frame
from .errors import ArgumentError, ConnectionLost, DipoleError, ProtocolError, Refused
from .values import Info, Result

S = TypeVar("S", bound="Session")
T = TypeVar("T")


class Session:
    """What a Client is built on, which tells about the arguments."""

    def __init__(
        self,
        address: str | None = None,
        timeout_s: float | None = 30.0,
        retry_s: float | None = None,
    ):
        self._last_id = 0
        self._outstanding: dict[int, Answer] = {}  # of submitted queries
        self._arrived: dict[int, None] = {}  # those that are whole, or refused, in that order
        self._read: dict[int, Answer] = {}  # of queries that are read part by part
        self._asked: dict[int, Any] = {}  # of calls that wait for all of it
        self._ignored: set[int] = set()  # requests whose replies say nothing that is wanted
        self._requests = retry.Requests()
        self._late: list[Frame] = []  # answers to requests whose deadlines passed while lost
        self._connection = Connection(address, timeout_s)
        try:
            self.info: Info = self._call(calls.hello(self._connection.address))
        except BaseException:
            self._connection.close()
            raise
        is_private = self._connection.address.startswith("private:")
        default_s = 0.0 if is_private else retry.DEFAULT_S
        self._requests.for_s = default_s if retry_s is None else retry_s

    def __enter__(self: S) -> S:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection and ends a private daemon. Closing twice is fine."""
        self._connection.close()

    # ---- frames ----------------------------------------------------------------------------------

    def send_frame(
        self, type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0
    ) -> None:
        """Sends a frame of any type as it is; use receive_frame() for what comes back."""
        self._connection.send_frame(type, request_id, payload, deadline_ms)

    def receive_frame(self) -> Frame:
        """The next frame, unless another call took it; see send_frame()."""
        return self._connection.receive_frame()

    # ---- answers to queries ----------------------------------------------------------------------

    def collect(self, request_id: int | None = None) -> tuple[int, Result]:
        """Waits for the answer to any outstanding query, or to a certain one; returns its id and
        the result. A refusal is raised with the query's id in request_id; the others go on."""
        if request_id is None and not self._outstanding:
            raise ArgumentError("nothing is outstanding")
        if request_id is not None and request_id not in self._outstanding:
            raise ArgumentError(f"request_id {request_id}: not outstanding")
        while not (self._arrived if request_id is None else request_id in self._arrived):
            self._receive()
        found = next(iter(self._arrived)) if request_id is None else request_id
        del self._arrived[found]
        answer = self._outstanding.pop(found)
        return found, answers.result(answer, self.info)

    def forget(self, request_id: int) -> None:
        """Nobody wants the answer to a submitted query any more. One that is not outstanding is
        fine."""
        if self._outstanding.pop(request_id, None) is None:
            return
        if request_id in self._arrived:
            del self._arrived[request_id]
        else:
            self._ignored.add(request_id)

    def _next_part(self, request_id: int) -> Result | None:
        """The next part of an answer; None: that was the last."""
        answer = self._read[request_id]
        while not answer.ready:
            if answer.ended:
                return None
            self._receive()
        return answers.result(answer, self.info)

    def _drop(self, request_id: int) -> None:
        """Nobody wants more of an answer that is read part by part."""
        answer = self._read.pop(request_id, None)
        if answer is not None and not answer.ended:
            self._ignored.add(request_id)

    # ---- requests and replies --------------------------------------------------------------------

    def _send(
        self,
        message: str,
        payload: bytes = b"",
        deadline_ms: int = 0,
        queries: dict[int, Any] | None = None,
        answer: Any = None,
    ) -> int:
        """Sends a request; returns its id. queries: where its answer is to be found."""
        self._last_id += 1
        request_id = self._last_id
        self._requests.add(request_id, message, payload, deadline_ms)
        if queries is not None:
            queries[request_id] = answer
        try:
            type = wire.MESSAGES[message]
            self._connection.send_frame(type, request_id, payload, deadline_ms)
        except ConnectionLost as lost:
            self._restore(lost)
        return request_id

    def _send_again(self, request_ids: Iterable[int]) -> None:
        """Sends requests as they were, but for what is left of their deadlines. One that has none
        left gets the error that the daemon would send if there were one."""
        for request_id in request_ids:
            kept = self._requests.kept[request_id]
            left_ms = retry.left_ms(kept) if kept.deadline_ms else 0
            if kept.deadline_ms and left_ms <= 0:
                self._late.append(retry.late_frame(request_id))
            else:
                type = wire.MESSAGES[kept.message]
                self._connection.send_frame(type, request_id, kept.payload, left_ms)

    def _restore(self, lost: DipoleError) -> None:
        """Connects again and sends again what is outstanding; raises `lost` where it cannot."""
        for request_id in self._ignored:
            self._requests.remove(request_id)
        self._ignored.clear()
        until_s = self._requests.until_s()
        if until_s is None or not retry.may_pass(lost):
            raise lost
        if any(not answer.is_new for answer in self._read.values() if not answer.ended):
            raise lost
        timeout_s = self._connection.timeout_s
        addresses = self._connection.next_addresses()
        self._connection.close()

        def connect(left_s: float) -> Session:
            return Session(addresses, left_s if timeout_s is None else min(left_s, timeout_s), 0)

        fresh = retry.connect_again(connect, self.info, until_s, lost)
        self._connection = fresh._connection
        self._connection.timeout_s = timeout_s
        self._connection.socket.settimeout(timeout_s)
        for queries in (self._outstanding, self._asked):
            for request_id, answer in queries.items():
                if not answer.ended:
                    queries[request_id] = answer.fresh()
        sent = [i for i in sorted(self._requests.kept) if i not in self._requests.again_s]
        try:
            self._send_again(sent)
        except ConnectionLost as again:
            self._restore(again)

    def _receive(self, request_id: int = 0) -> Frame | None:
        """The next frame when it answers this request. One that answers a query is kept with its
        Answer; one that answers nothing is the daemon's word on the connection as a whole. After
        a loss that has been made good there is none."""
        try:
            self._send_again(self._requests.due())
            if self._late:
                return self._take_frame(self._late.pop(), request_id)
            next_s = min(self._requests.again_s.values(), default=None)
            if next_s is not None and not self._connection.moves_by(next_s):
                return None
            frame = self._connection.receive_frame()
        except ConnectionLost as lost:
            self._restore(lost)
            return None
        return self._take_frame(frame, request_id)

    def _take_frame(self, frame: Frame, request_id: int) -> Frame | None:
        """Gives a frame to whom it belongs; returns it when it answers this request."""
        if self._is_to_be_asked_later(frame):
            return None
        is_last = {
            wire.MESSAGES["eval"] | wire.REPLY: answers.is_last,
            wire.MESSAGES["sample"] | wire.REPLY: answers.is_last,
            wire.MESSAGES["invert"] | wire.REPLY: inversion.is_last,
            wire.MESSAGES["mc"] | wire.REPLY: mc.is_last,
        }.get(frame.type)
        ends = is_last is None or is_last(frame.payload)
        if ends:
            self._requests.remove(frame.request_id)
        if frame.request_id in self._ignored:
            if ends:
                self._ignored.remove(frame.request_id)
            return None
        for queries in (self._outstanding, self._read, self._asked):
            answer = queries.get(frame.request_id)
            if answer is not None:
                self._add(answer, frame)
                return None
        if request_id != 0 and frame.request_id == request_id:
            return frame
        if frame.type == wire.TYPE_ERROR and frame.request_id == 0:
            self._restore(calls.refused(frame))
            return None
        raise ProtocolError(f"a reply to request {frame.request_id}, which was not made")

    def _is_to_be_asked_later(self, frame: Frame) -> bool:
        """Whether it is a refusal of a request that is tried again; what came before is dropped."""
        request_id = frame.request_id
        reader = self._read.get(request_id)
        if frame.type != wire.TYPE_ERROR or request_id in self._ignored:
            return False
        refused = calls.refused(frame)
        if not isinstance(refused, Refused) or (reader is not None and not reader.is_new):
            return False
        if not self._requests.later(refused):
            return False
        for queries in (self._outstanding, self._asked):
            if request_id in queries:
                queries[request_id] = queries[request_id].fresh()
        return True

    def _add(self, answer: Any, frame: Frame) -> None:
        if answer.ended:
            raise ProtocolError(f"a second reply to request {frame.request_id}")
        try:
            answer.add(calls.payload_of(frame, answer.message))
        except Refused as refusal:
            answer.refuse(refusal)
        if answer.ended and frame.request_id in self._outstanding:
            self._arrived[frame.request_id] = None

    def _whole(self, message: str, payload: bytes, deadline_ms: int, answer: Any) -> Any:
        """Sends a request and waits for all of its answer, which is returned; or an error, which is
        raised."""
        request_id = self._send(message, payload, deadline_ms, self._asked, answer)
        try:
            while not self._asked[request_id].ended:
                self._receive()
        except BaseException:
            if not self._asked.pop(request_id).ended:
                self._ignored.add(request_id)
            raise
        return self._asked.pop(request_id)

    def _answer(self, request_id: int, message: str) -> bytes:
        """The payload of the reply to a request that is not among the submitted ones."""
        frame = None
        while frame is None:
            frame = self._receive(request_id)
        return calls.payload_of(frame, message)

    def _call(self, call: calls.Call[T], deadline_ms: int = 0) -> T:
        request_id = self._send(call.message, call.payload, deadline_ms)
        return call.read(self._answer(request_id, call.message))
