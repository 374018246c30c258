"""A client of dipoled: evaluates subsurface-scattering profiles R(r).

with dipole.Client() as client:
    result = client.eval("better", client.media()["skin1"], r=[0.5, 1, 2])
    print(result.R)  # [channel, radius], 1/mm^2
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from . import broadcast, calls, evaluation, inversion, mc
from .broadcast import Values
from .connection import Connection, Frame
from .errors import ArgumentError, ConnectionLost, DipoleError, Refused
from .exchange import RETRY_S, Exchange, Request, connect_again, open_connection
from .table import Table
from .values import Draw, Grid, Info, Inversion, McProgress, McResult, Medium
from .values import Offers, Query, Result, Samples

T = TypeVar("T")


class Client:
    """Connects, agrees on a protocol version and reads the daemon's lists.

    address and timeout_s: see Connection. A client belongs to one thread at a time. Close it, or
    use it in a with statement: a private daemon ends with it.

    retry_s: how long a request that meets trouble is tried again. The default is 5 s, and 0 (not at
    all) for a private daemon. Trouble is a lost connection, or a daemon that is busy or stops: the
    client then connects again and sends again what has no answer. It cannot do so for mc(), for
    eval_parts() once a part has come, and for what exceeds 64 MiB of waiting requests: then
    ConnectionLost is raised. dipole_set_retry_ms() in dipole.h has the details.
    """

    def __init__(
        self,
        address: str | None = None,
        timeout_s: float | None = 30.0,
        retry_s: float | None = None,
    ):
        self.info: Info
        self._connection, self.info = open_connection(address, timeout_s, calls.hello)
        default_s = 0.0 if self._connection.is_private else RETRY_S
        self._exchange = Exchange(default_s if retry_s is None else retry_s)
        self._submitted: dict[int, None] = {}

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection and ends a private daemon. Closing twice is fine."""
        self._connection.close()

    # ---- evaluating ------------------------------------------------------------------------------

    def eval(self, *query: Any, **options: Any) -> Result:
        """Evaluates a Query, or the same arguments: eval(model, media, r, tolerance=0.01). Waits
        for the answer. Raises Refused, with the field at fault, if the daemon does not take the
        query; its status is "deadline" if the answer would be too late."""
        return self._ask(evaluation.eval(self.info, Query.of(*query, **options)))

    def values(
        self, model: Any, media: Any = None, r: Any = None, quantity: str = "R", **options: Any
    ) -> Values:
        """Evaluates one quantity as numpy's functions do: media and radii have any shapes and are
        broadcast against each other.

        media: a Medium whose fields may be arrays, or an array [..., 4]. r: radii in mm, of any
        shape. For example, sigma_a of shape [H, W, 1] and r of shape [N] give values [H, W, N]; an
        r [H, W] gives every medium of an image its own radius. quantity: the name of one that has a
        value for each radius. options: as of a Query.

        Equal media are asked for once, and there may be any number of media and radii. deadline_ms
        holds for each of the queries that this takes.
        """
        template = Query(model, media, r, wanted=[quantity], **options)
        places, collected = broadcast.plan(self.info, media, r, quantity)
        under_way: dict[int, broadcast.Places] = {}

        def collect_one() -> None:
            request_id = next(iter(under_way))
            collected.add(under_way.pop(request_id), self.collect(request_id)[1])

        try:
            for place in places:
                request_id = self.submit(replace(template, media=place.media, r=place.radii))
                under_way[request_id] = place
                if len(under_way) >= broadcast.OUTSTANDING:
                    collect_one()
            while under_way:
                collect_one()
        finally:  # After a refusal nobody waits for the other answers.
            for request_id in under_way:
                self.forget(request_id)
        return collected.values()

    def submit(self, *query: Any, **options: Any) -> int:
        """Sends a query like eval() without waiting. Returns its id, for collect()."""
        request_id = self._send(evaluation.eval(self.info, Query.of(*query, **options)))
        self._submitted[request_id] = None
        return request_id

    def collect(self, request_id: int | None = None) -> tuple[int, Result]:
        """Waits for the answer to one submitted query, or to any of them. Returns its id and the
        result. A refusal is raised with the query's id in request_id; the other queries go on."""
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
        """Gives up a submitted query. One that is not outstanding is fine."""
        if request_id in self._submitted:
            del self._submitted[request_id]
            self._exchange.drop(request_id)

    def eval_parts(self, *query: Any, **options: Any) -> Parts:
        """Evaluates like eval() and gives the parts of the answer as they come: an iterator of
        results, each of which begins at radius number radius_first. So an answer may be larger
        than memory. The daemon chooses how many radii come at a time. Any step may raise Refused;
        the parts before it are right."""
        request = evaluation.eval(self.info, Query.of(*query, **options), hands_on=True)
        return Parts(self, self._send(request))

    def offers(self, media: Any, r: Any = None, **options: Any) -> Offers:
        """Lists what could answer eval(None, ...) with the same arguments, cheapest first: how
        exact each model and evaluator is measured to be, and how fast."""
        return self._ask(evaluation.offers(self.info, Query(None, media, r, **options)))

    def table(
        self, model: str | int, medium: Medium | Sequence[float], **options: Any
    ) -> Table:
        """Fetches the table that the evaluator "lut" uses for a medium. It is then evaluated here,
        without a daemon and with the same bits. options: moments, parameters, tolerance (relative,
        from 1e-6, by default 1e-4) and deadline_ms, as of a Query."""
        return self._ask(evaluation.table(self.info, Query(model, medium, **options)))

    def sample(
        self,
        model: str | int,
        media: Any,
        u: Any = None,
        *,
        draw: Draw | None = None,
        **options: Any,
    ) -> Samples:
        """Draws radii in proportion to r R(r): the radius for a number u has the cdf u.

        u: N numbers from 0 (0 mm) to 1 (infinity). draw: the numbers by a rule, in place of u;
        Draw(1024) are 1024 random ones. All channels get the same numbers. options: as of a Query.
        In `wanted`, which is ("r", "pdf") by default, "r" means the drawn radii; every other
        quantity is evaluated at them. A model that does not cover all radii is refused.
        """
        return self._ask(evaluation.sample(self.info, Query(model, media, **options), u, draw))

    def invert(self, model: str | int, albedo: Any, length: Any, **options: Any) -> Inversion:
        """Finds the media whose diffuse albedo under a model is the given one.

        albedo: from 0 to 1, of any shape, such as a texture [H, W, 3]. length: mm, of a shape that
        can be broadcast with it. NaN stands for an albedo that the model cannot reach.
        options: given="mean-free-path" says what length means: 1 / sigma_t' with
        sigma_t' = sigma_a + sigma_s (1 - g), or "diffuse-mean-free-path", or another name in
        info.choices["length"]. g=0.0 and eta=1.3 hold for all media. moments, deadline_ms: as of a
        Query.
        """
        return self._ask(inversion.request(self.info, model, albedo, length, **options))

    # ---- Monte Carlo -----------------------------------------------------------------------------

    def mc(
        self,
        medium: Medium | Sequence[float],
        edges: Grid,
        *,
        progress: Callable[[McProgress], bool | None] | None = None,
        **options: Any,
    ) -> McResult:
        """Lets the daemon walk photons through a medium and waits for the table.

        edges: of the rings, of which there is one less. progress: called a few times a second. If
        it returns False the job is cancelled, and the table is what there is by then. An exception,
        such as KeyboardInterrupt, cancels it too.
        options: photons: how many to walk. The default is as many as the daemon allows if an error
        is given, else a million. error_total, error_rings: the job ends as soon as the relative
        standard error of R, or of every ring with light, is this small; given both, both must be.
        thickness: of a slab, mm; None is a half space. albedos: up to 16 in place of the medium's
        own, all served by one walk. seed: 1 by default.
        """
        request_id = self._send(mc.request(self.info, medium, edges, **options))
        cancelled = False
        try:
            while not isinstance(report := self._next(request_id), McResult):
                if progress is not None and progress(report) is False and not cancelled:
                    cancelled = True
                    self._cancel(request_id)
            return report
        except (DipoleError, OSError):
            raise
        except BaseException:
            self._cancel(request_id)
            while not isinstance(self._next(request_id), McResult):
                pass
            raise
        finally:
            self._exchange.drop(request_id)

    def _cancel(self, job_id: int) -> None:
        self._exchange.drop(self._send(mc.cancellation(job_id)))

    # ---- the rest --------------------------------------------------------------------------------

    def media(self) -> dict[str, tuple[Medium, Medium, Medium]]:
        """The daemon's measured media by name: red, green, blue."""
        return self._ask(calls.media())

    def statistics(self) -> dict[str, int]:
        """The daemon's statistics by name. The end of a name is the unit."""
        return self._ask(calls.statistics())

    def ping(self, payload: bytes = b"") -> float:
        """Measures a round trip that does nothing else, in seconds. payload: up to 1024 bytes, a
        multiple of 8, which the daemon sends back."""
        request = calls.ping(payload)
        start = time.perf_counter()
        self._ask(request)
        return time.perf_counter() - start

    def send_frame(
        self, type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0
    ) -> None:
        """Sends a frame of any type as it is. Use receive_frame() for the reply."""
        self._connection.send_frame(type, request_id, payload, deadline_ms)

    def receive_frame(self) -> Frame:
        """The next frame, unless another call took it. See send_frame()."""
        return self._connection.receive_frame()

    # ---- sending and receiving -------------------------------------------------------------------

    def _ask(self, request: Request[T]) -> T:
        request_id = self._send(request)
        try:
            return self._next(request_id)
        finally:
            self._exchange.drop(request_id)

    def _send(self, request: Request[Any]) -> int:
        """Sends a request; returns its id."""
        request_id = self._exchange.begin(request)
        try:
            self._send_again([request_id])
        except ConnectionLost as lost:
            try:
                self._restore(lost)
            except BaseException:
                self._exchange.drop(request_id)
                raise
        return request_id

    def _send_again(self, request_ids: Sequence[int]) -> None:
        for request_id in request_ids:
            for data in self._exchange.frame(request_id):
                self._connection.send_bytes(data)

    def _next(self, request_id: int) -> Any:
        """Waits for the next piece of an answer; None if there is no other."""
        while not self._exchange.is_ready(request_id):
            self._receive()
        return self._exchange.next(request_id)

    def _receive(self) -> None:
        """Waits for a frame and gives it to its request. A lost connection is restored."""
        try:
            due = self._exchange.due()
            self._send_again(due)
            next_s = self._exchange.next_due_s()
            if due or (next_s is not None and not self._connection.moves_by(next_s)):
                return
            frame = self._connection.receive_frame()
        except ConnectionLost as lost:
            self._restore(lost)
            return
        try:
            self._exchange.take(frame)
        except Refused as refusal:  # It is about the connection as a whole.
            self._restore(refusal)

    def _restore(self, lost: DipoleError) -> None:
        """Connects again and sends again what has no answer. Raises `lost` if it cannot."""
        until_s = self._exchange.lost(lost)
        timeout_s = self._connection.timeout_s
        addresses = self._connection.next_addresses()
        self._connection.close()

        def connect(left_s: float) -> tuple[Connection, Info]:
            limit_s = left_s if timeout_s is None else min(left_s, timeout_s)
            return open_connection(addresses, limit_s, calls.hello)

        self._connection = connect_again(connect, self.info, until_s, lost)
        self._connection.timeout_s = timeout_s
        self._connection.socket.settimeout(timeout_s)
        try:
            self._send_again(self._exchange.restored())
        except ConnectionLost as again:
            self._restore(again)


class Parts(Iterator[Result]):
    """The parts of an answer, as Client.eval_parts() gives them. The client may be used between two
    parts. To leave before the end, close it or use it in a with statement: what still comes is then
    thrown away."""

    def __init__(self, client: Client, request_id: int):
        self._client = client
        self._request_id = request_id
        self._open = True

    def __next__(self) -> Result:
        try:
            part = self._client._next(self._request_id) if self._open else None
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
