"""A client of dipoled: evaluates subsurface-scattering profiles R(r).

with dipole.Client() as client:
    result = client.eval("better", client.media()["skin1"], r=[0.5, 1, 2])
    print(result.R)  # [channel, radius], 1/mm^2
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from . import evaluation
from .calls import Calls, takes_query
from .errors import ArgumentError
from .opening import Opening
from .session import Session, Waiting, run
from .values import Query, Result


class Client(Calls):
    """A connection to a daemon. The constructor connects, agrees on a protocol version and reads
    the daemon's lists.

    address: as of a Connection. Several addresses but private: are tried in turn; commas without
    blanks separate them. The attribute `address` is the one in use. A client belongs to one
    thread at a time, and after a fork to the process that opened it: in the other one, its calls
    raise ConnectionLost. Close it, or use it in a with statement: a private daemon ends with the
    client.

    timeout_s: how long a call waits while no byte is sent or received, and how long an address may
    take to reply; None means no limit. After that, the client continues with the next of several
    addresses; with a single one, the call raises ConnectionLost.

    retry_s: for how long the client retries when no daemon is there, when the connection is
    lost, or when the daemon is busy or stops. The default is 5 s; for a private daemon it is 0,
    which means never. The client connects again and sends the requests without a reply again. A
    Monte Carlo job then begins anew. The client cannot repeat eval_parts() once a part has come,
    mc() once it is cancelled, and requests beyond 64 MiB of waiting ones: these raise
    ConnectionLost. dipole_set_retry_ms() in dipole.h has the details.

    ca, certificate, key: files for tls: addresses, see Tls. The daemon's certificate has to be good
    for the host in the address. If a certificate is at fault, the client does not try again.
    """

    _session: Session

    def _start(self) -> None:
        self._session = run(Session(Opening(*self._how), Waiting()).open())
        self._submitted: dict[int, None] = {}

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection and ends a private daemon. Closing twice is fine."""
        run(self._session.close())

    def __repr__(self) -> str:
        closed = ", closed" if self._session.closed else ""
        return f"<Client: {self.info.software} at {self.address}{closed}>"

    # ---- calls -----------------------------------------------------------------------------------

    @staticmethod
    def _method(call: Callable[..., Any], check: Callable[..., None]) -> Callable[..., Any]:
        def method(self: Client, *arguments: Any, **options: Any) -> Any:
            check(self, *arguments, **options)
            return run(call(self._session, *arguments, **options))

        return method

    @takes_query(Query, evaluation.eval)
    def eval(self, *query: Any, **options: Any) -> Result:
        return run(evaluation.eval(self._session, Query.of(*query, **options)))

    @takes_query(Query, evaluation.eval_parts)
    def eval_parts(self, *query: Any, **options: Any) -> Parts:
        made = Query.of(*query, **options)
        return Parts(self._session, run(evaluation.eval_parts(self._session, made)))

    @takes_query(Query, evaluation.submit)
    def submit(self, *query: Any, **options: Any) -> int:
        request_id = run(evaluation.submit(self._session, Query.of(*query, **options)))
        self._submitted[request_id] = None
        return request_id

    def collect(self, request_id: int | None = None) -> tuple[int, Result]:
        """Waits for the reply to a submitted query; None means any of them. Returns the query's id
        and its result. If the daemon refuses the query, raises Refused, whose request_id is the
        query's id; the other queries go on."""
        if request_id is None and not self._submitted:
            raise ArgumentError("nothing is outstanding")
        if request_id is not None and request_id not in self._submitted:
            raise ArgumentError(f"request_id {request_id}: not outstanding")
        ids = self._submitted if request_id is None else (request_id,)
        exchange = self._session.exchange

        def find() -> int:
            return next((i for i in ids if exchange.ended(i)), 0)

        run(self._session.until(lambda: find() > 0, 0))
        found = find()
        try:
            return found, exchange.next(found)
        finally:
            self.forget(found)

    def forget(self, request_id: int) -> None:
        """Gives up a submitted query. Does nothing if the query is not outstanding."""
        if request_id in self._submitted:
            del self._submitted[request_id]
            self._session.exchange.drop(request_id)


class Parts(Iterator[Result]):
    """An iterator of the parts of a reply; Client.eval_parts() returns it. The client may make
    other calls between two parts. To stop early, close the iterator or use it in a with statement:
    the client then throws the other parts away."""

    def __init__(self, session: Session, request_id: int):
        self._session = session
        self._request_id = request_id
        self._open = True

    def __next__(self) -> Result:
        try:
            part: Result | None = run(self._session.next(self._request_id)) if self._open else None
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
        """Gives up the rest of the reply. Closing twice is fine."""
        if self._open:
            self._open = False
            self._session.exchange.drop(self._request_id)
