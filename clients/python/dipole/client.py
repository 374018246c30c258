"""A client of dipoled: evaluates subsurface-scattering profiles R(r).

with dipole.Client() as client:
    result = client.eval("better", client.media()["skin1"], r=[0.5, 1, 2])
    print(result.R)  # [channel, radius], 1/mm^2
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Concatenate, ParamSpec, TypeVar

from . import broadcast, calls, evaluation, fitting, gathering, inversion, mc, rings, varying
from .calls import Calls, Cancel, Steps, takes_query
from .connection import Frame, Tls
from .errors import ArgumentError, ConnectionLost, DipoleError, Refused
from .exchange import Exchange, Request
from .opening import Opening
from .values import Info, Query, Result

P = ParamSpec("P")
T = TypeVar("T")


def _method(
    call: Callable[Concatenate[Calls, P], Steps[T]]
) -> Callable[Concatenate[Any, P], T]:
    """Makes a method of a call."""
    signature = calls.signature_of(call)

    def method(self: Client, *arguments: Any, **options: Any) -> T:
        signature.bind(self, *arguments, **options)
        return self._drive(call(self._calls, *arguments, **options))

    made: Callable[Concatenate[Any, P], T] = calls.described(method, call, "Client")
    return made


class Client:
    """A connection to a daemon. The constructor connects, agrees on a protocol version and reads
    the daemon's lists.

    address: as of a Connection. Several addresses but private: are tried in turn; commas without
    blanks separate them. The attribute `address` is the one in use. A client belongs to one
    thread at a time, and after a fork to the process that opened it: in the other one, its calls
    raise ConnectionLost. Close it, or use it in a with statement: a private daemon ends with the
    client.

    timeout_s: how long a call waits while no byte is sent or received, and how long an address may
    take to answer; None means no limit. After that, the client goes on with the next of several
    addresses; with a single one, the call raises ConnectionLost.

    retry_s: for how long the client goes on trying when no daemon is there, when the connection is
    lost, or when the daemon is busy or stops. The default is 5 s; for a private daemon it is 0,
    which means never. The client connects again and sends the requests without an answer again. A
    Monte Carlo job then begins anew. The client cannot repeat eval_parts() once a part has come,
    mc() once it is cancelled, and requests beyond 64 MiB of waiting ones: these raise
    ConnectionLost. dipole_set_retry_ms() in dipole.h has the details.

    ca, certificate, key: files for tls: addresses, see Tls. The daemon's certificate has to be good
    for the host in the address. If a certificate is at fault, the client does not try again.
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
        self.info: Info
        self._opening = Opening(address, timeout_s, retry_s, calls.hello, Tls(ca, certificate, key))
        self._connection, self.info = self._opening.open()
        self._exchange = Exchange(self._opening.retry_s)
        self._calls = Calls(self.info, self._exchange)
        self._submitted: dict[int, None] = {}

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection and ends a private daemon. Closing twice is fine."""
        self._connection.close()

    @property
    def address(self) -> str:
        """The address of the daemon that the client is connected to, or was last connected to. It
        changes when the client goes on with another daemon."""
        return self._connection.address

    def __repr__(self) -> str:
        closed = ", closed" if self._connection.is_closed else ""
        return f"<Client: {self.info.software} at {self.address}{closed}>"

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
    def eval(self, *query: Any, **options: Any) -> Result:
        return self._drive(evaluation.eval(self._calls, Query.of(*query, **options)))

    @takes_query(Query, evaluation.eval_parts)
    def eval_parts(self, *query: Any, **options: Any) -> Parts:
        made = Query.of(*query, **options)
        return Parts(self, self._drive(evaluation.eval_parts(self._calls, made)))

    @takes_query(Query, evaluation.submit)
    def submit(self, *query: Any, **options: Any) -> int:
        request_id = self._drive(evaluation.submit(self._calls, Query.of(*query, **options)))
        self._submitted[request_id] = None
        return request_id

    def collect(self, request_id: int | None = None) -> tuple[int, Result]:
        """Waits for the answer to a submitted query; None means any of them. Returns the query's id
        and its result. If the daemon refuses the query, raises Refused, whose request_id is the
        query's id; the other queries go on."""
        if request_id is None and not self._submitted:
            raise ArgumentError("nothing is outstanding")
        if request_id is not None and request_id not in self._submitted:
            raise ArgumentError(f"request_id {request_id}: not outstanding")
        ids = self._submitted if request_id is None else (request_id,)
        while (found := next((i for i in ids if self._exchange.ended(i)), None)) is None:
            self._receive()
        try:
            return found, self._exchange.next(found)
        finally:
            self.forget(found)

    def forget(self, request_id: int) -> None:
        """Gives up a submitted query. Does nothing if the query is not outstanding."""
        if request_id in self._submitted:
            del self._submitted[request_id]
            self._exchange.drop(request_id)

    def send_frame(
        self, type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0
    ) -> None:
        """Sends a frame of any type without checking it. Use receive_frame() for the reply."""
        self._connection.send_frame(type, request_id, payload, deadline_ms)

    def receive_frame(self) -> Frame:
        """Waits for the next frame. Use it only with send_frame(): other calls take frames, too."""
        return self._connection.receive_frame()

    # ---- sending and receiving -------------------------------------------------------------------

    def _drive(self, steps: Steps[T]) -> T:
        """Does the steps of a call."""
        try:
            step = next(steps)
            while True:
                try:
                    given = self._do(step)
                except BaseException as error:
                    step = steps.throw(error)
                else:
                    step = steps.send(given)
        except StopIteration as end:
            returned: T = end.value
            return returned

    def _do(self, step: Request[Any] | int | Cancel) -> Any:
        if isinstance(step, Request):
            return self._send(step)
        if isinstance(step, int):
            return self._next(step)
        self._exchange.ask_once(step.request_id)
        return self._exchange.drop(self._send(mc.cancellation(step.request_id)))

    def _send(self, request: Request[Any]) -> int:
        """Sends a request; returns its id."""
        request_id = self._exchange.begin(request)
        try:
            try:
                self._send_again([request_id])
            except ConnectionLost as lost:
                self._restore(lost)
        except BaseException:
            self._exchange.drop(request_id)
            raise
        return request_id

    def _send_again(self, request_ids: Sequence[int]) -> None:
        connection = self._connection
        connection.check_usable()
        connection.torn = True
        for request_id in request_ids:
            for data in self._exchange.frame(request_id):
                connection.send_bytes(data)
        connection.torn = False

    def _next(self, request_id: int) -> Any:
        """Waits for the next part of an answer. Returns None after the last one."""
        while not self._exchange.is_ready(request_id):
            self._receive()
        return self._exchange.next(request_id)

    def _receive(self) -> None:
        """Waits for a frame and gives it to its request. A lost connection is restored."""
        try:
            due = self._exchange.due()
            self._send_again(due)
            next_s = self._exchange.next_due_s()
            if due or (next_s is not None and not self._connection.arrives_by(next_s)):
                return
            self._connection.receive_frame(self._exchange.take)
        except (ConnectionLost, Refused) as lost:  # Refused is the connection, not a request.
            self._restore(lost)

    def _restore(self, lost: DipoleError) -> None:
        """Connects again and sends the requests without an answer again. Raises `lost` if that
        fails."""
        until_s = self._exchange.lost(lost)
        self._connection.close()
        self._connection.torn = True  # so that the next call goes on if this one is interrupted
        try:
            self._connection = self._opening.open_again(self.info, until_s, lost)
        except DipoleError:
            self._connection.torn = False
            raise
        try:
            self._send_again(self._exchange.restored())
        except ConnectionLost as again:
            self._restore(again)


class Parts(Iterator[Result]):
    """An iterator of the parts of an answer; Client.eval_parts() returns it. The client may make
    other calls between two parts. To stop early, close the iterator or use it in a with statement:
    the client then throws the other parts away."""

    def __init__(self, client: Client, request_id: int):
        self._client = client
        self._request_id = request_id
        self._open = True

    def __next__(self) -> Result:
        try:
            part: Result | None = self._client._next(self._request_id) if self._open else None
        except BaseException:
            self.close()
            raise
        if part is None:
            self.close()
            raise StopIteration
        return part

    def __enter__(self) -> Parts:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()

    def close(self) -> None:
        """Gives up the rest of the answer. Closing twice is fine."""
        if self._open:
            self._open = False
            self._client._exchange.drop(self._request_id)
