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

from . import broadcast, calls, evaluation, fitting, gathering, inversion, mc, rings, varying
from .broadcast import Values
from .connection import Frame, Tls
from .errors import ArgumentError, ConnectionLost, DipoleError, Refused
from .exchange import Exchange, Request, signed, takes_query
from .opening import Opening
from .rings import RingMeans
from .surface import Surface
from .table import Table
from .values import Fits, Gathered, Grid, Info, Inversion, McProgress, McResult, Media, Medium
from .values import Offers, Query, Result, Samples, Varying

T = TypeVar("T")


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
        self._submitted: dict[int, None] = {}
        self._measured: dict[str, tuple[Medium, Medium, Medium]] = {}

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

    # ---- evaluating ------------------------------------------------------------------------------

    @takes_query(Query)
    def eval(self, *query: Any, **options: Any) -> Result:
        """Evaluates a Query, or its arguments: eval(model, media, r, tolerance=0.01). The options
        are grid, evaluator, moments, wanted, parameters, tolerance and deadline_ms; help(Query)
        describes them. Waits for the answer. Raises Refused, which names the field at fault, if the
        daemon refuses the query. Its status is "deadline" if the answer would be too late."""
        return self._ask(evaluation.eval(self.info, self._query(*query, **options)))

    @signed(broadcast.query)
    def values(
        self, model: str | int | None, media: Media, r: Any, quantity: str = "R", **options: Any
    ) -> Values:
        """Evaluates one quantity for media and radii of any shapes, which are broadcast against
        each other as numpy's functions do.

        media: a Medium whose fields may be arrays, or an array [..., 4], or the name of a measured
        medium, whose three channels become the first axis. r: radii in mm, of any shape. For
        example, sigma_a of shape [H, W, 1] and r of shape [N] give values [H, W, N]; for an image
        of media, r of shape [H, W] gives each pixel its own radius. quantity: the name of a
        quantity that has a value for each radius. options: as of a Query.

        The number of media and radii is not limited: this method sends as many queries as it needs.
        deadline_ms holds for each query. Equal media are sent once.
        """
        template = broadcast.query(self.info, model, media, r, quantity, **options)
        media = broadcast.first_axis(self._media_of(media), r) if isinstance(media, str) else media
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
        finally:  # After an error, the other answers are no longer wanted.
            for request_id in under_way:
                self.forget(request_id)
        return collected.values()

    @takes_query(Query)
    def submit(self, *query: Any, **options: Any) -> int:
        """Sends a query like eval(), but does not wait. Returns the query's id for collect()."""
        request_id = self._send(evaluation.eval(self.info, self._query(*query, **options)))
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

    @takes_query(Query)
    def eval_parts(self, *query: Any, **options: Any) -> Parts:
        """Evaluates like eval(), but returns an iterator that gives each part of the answer when it
        arrives, so that an answer may be larger than memory. A part is a Result that begins at
        radius number radius_first. The daemon chooses how many radii a part has. Any step of the
        iterator may raise Refused; the parts before that are valid."""
        request = evaluation.eval(self.info, self._query(*query, **options), is_streamed=True)
        return Parts(self, self._send(request))

    @signed(evaluation.offers)
    def offers(self, media: Media, r: Any = None, **options: Any) -> Offers:
        """Lists the models and evaluators that could answer eval(None, ...) with the same
        arguments, cheapest first, with the measured error and cost of each."""
        return self._ask(evaluation.offers(self.info, self._media_of(media), r, **options))

    @signed(evaluation.table)
    def table(self, model: str | int, medium: Media, **options: Any) -> Table:
        """Fetches the table that the evaluator "lut" uses for a medium. The Table evaluates it in
        this process, with the daemon's bits. options: moments, parameters, deadline_ms and
        tolerance (relative, at least 1e-6, by default 1e-4), as of a Query."""
        listed = self._media_of(medium)
        return self._ask(evaluation.table(self.info, model, listed, **options))

    @signed(evaluation.surface)
    def surface(self, *model: Any, **options: Any) -> Surface:
        """Fetches what all media with this g and eta share. The Surface evaluates transport with a
        medium for each value, and finds the media of colours, in this process and with the bits of
        varying(). options: evaluator, "f32" by default, or "f64"; moments, parameters, tolerance
        and deadline_ms, as of varying()."""
        return self._ask(evaluation.surface(self.info, *model, **options))

    @signed(evaluation.sample)
    def sample(self, model: str | int, media: Media, *u: Any, **options: Any) -> Samples:
        """Draws radii with a density in proportion to r R(r): the radius for a number u has cdf u.

        u: N numbers from 0 (0 mm) to 1 (infinity). draw: a rule that makes the numbers, in place of
        u; Draw(1024) makes 1024 random numbers. All channels get the same numbers. options: as of a
        Query, whose `wanted` is ("r", "pdf") by default. "r" is the drawn radii; all other
        quantities are evaluated at these. A model that does not cover all radii is refused.
        """
        listed = self._media_of(media)
        return self._ask(evaluation.sample(self.info, model, listed, *u, **options))

    @signed(inversion.request)
    def invert(self, model: str | int, albedo: Any, length: Any, **options: Any) -> Inversion:
        """Finds media that have given diffuse albedos under a model.

        albedo: from 0 to 1, of any shape, such as a texture [H, W, 3]. length: mm, of a shape that
        can be broadcast with that of albedo. Where the model cannot reach an albedo, the medium is
        NaN. options: given names the kind of length, from info.choices["length"]. The default,
        "mean-free-path", is 1 / (sigma_a + sigma_s (1 - g)). g=0.0 and eta=1.3 hold for all media.
        moments, deadline_ms: as of a Query.
        """
        return self._ask(inversion.request(self.info, model, albedo, length, **options))

    @signed(fitting.design)
    def fit(
        self, model: str | int, at: Any, values: Any, errors: Any, **options: Any
    ) -> Fits:
        """Finds the sigma_a and sigma_s' under a model that make readings most likely.

        at: [N] distances in mm or, with axis="f", spatial frequencies in 1/mm. values: [..., N]
        readings there, such as an image [H, W, N]: R in 1/mm^2, or R(f). errors: their standard
        errors, of a shape that broadcasts. A reading may be negative by noise. One that is not finite, or whose error is 0,
        gives its set the status "refused"; the others are fitted.

        options: scale: "absolute"; "free" if all readings of a set have an unknown factor. In its
        place, reference names the Medium whose readings, by the same instrument, the values were
        divided by. source, detector: diameters of the discs that emit and detect the light, mm, one
        for all readings or [N]; the detector sees light of all angles, unless parameters has
        {"detector_na": NA / the index outside}. residuals: whether they are wanted. eta, which has
        to be given, and g=0.0 hold for all sets. Beyond two mean free paths readings hardly see g:
        a wrong one is "fitted", too. Ask again with g - 0.05 and g + 0.05 to see how much sigma_a
        and sigma_s_prime change; for 0.1 it is about twice that. moments, parameters, deadline_ms:
        as of a Query; large images are sent in several requests, and the deadline holds for each.
        """
        made = fitting.design(self.info, model, at, values, errors, **options)
        collected = fitting.Collected(self.info, made)
        under_way: list[int] = []

        def collect_one() -> None:
            collected.add(self._next(under_way[0]))
            self._exchange.drop(under_way.pop(0))

        try:
            for request in fitting.requests(made):
                under_way.append(self._send(request))
                if len(under_way) >= fitting.OUTSTANDING:
                    collect_one()
            while under_way:
                collect_one()
        finally:  # After an error, the other answers are no longer wanted.
            for request_id in under_way:
                self._exchange.drop(request_id)
        return collected.fits()

    @signed(varying.plan)
    def varying(self, model: str | int, **options: Any) -> Varying:
        """Evaluates values each of which has a medium of its own, as the points of a texture have.
        A value costs some ten nanoseconds.

        sigma_a, sigma_s: 1/mm. In place of them, colour and length give the media: a colour is a
        diffuse albedo, from 0 to 1; given names the kind of length, as for invert(). light: "beam"
        or "diffuse", the light of the colours. specular: whether the colours contain what the
        surface itself reflects. r: radii in mm; or u: numbers from 0 to 1, for which radii are
        drawn. All of them are arrays of any shapes that can be broadcast with each other. g=0.0 and
        eta=1.3 hold for all values.

        wanted: names of quantities. The default is R, or r for numbers u. coefficients: names from
        info.choices["coefficient"]; the default is sigma_a and sigma_s for colours without r and u.
        evaluator: "f32" or "f64", also the precision of the arrays. A value that has no answer is
        NaN; statuses says why. tolerance: of transport, 1e-5 or more, 1e-3 by default. moments,
        parameters, deadline_ms: as of a Query. The number of values is not limited.
        """
        plan = varying.plan(self.info, model, **options)
        return plan.join([self._ask(request) for request in plan.requests()])

    @signed(gathering.plan)
    def gather(
        self, model: str | int, media: Media, *light: Any, **options: Any
    ) -> Gathered:
        """Sums, at each query position x, the light of all points: R(|x - x_i|) times the power of
        point i, for each channel.

        media: one for each power of a point. points: Points(xyz, power). queries: [..., 3] mm.
        progress: is called with the numbers of queries that are answered and that there are. If it
        returns False, the call ends, and the sums that are missing are NaN; what the daemon still does
        for it ends, too, as if it raises an exception. options: tolerance, 1e-2 by default: the largest relative error, at each query, that grouping points may cause; 0
        sums each point by itself. evaluator, "lut" by default, moments, parameters and deadline_ms:
        as of a Query; the deadline holds for each request.

        The points are sent to a daemon that does not have them, and again when it has lost them.
        The numbers of points and queries of one daemon are its limits; queries are sent in several
        requests, whose number is not limited.
        """
        plan = gathering.plan(self.info, model, self._media_of(media), *light, **options)
        run = gathering.Run(plan)
        under_way: list[int] = []
        try:
            while True:
                while len(under_way) < gathering.OUTSTANDING and (request := run.next()):
                    under_way.append(self._send(request))
                if not under_way:
                    return run.result()
                try:
                    run.add(self._next(under_way[0]))
                except Refused as error:
                    if not run.refused(error):
                        raise
                    while len(under_way) > 1:  # Their answers are no longer wanted.
                        self._exchange.drop(under_way.pop())
                finally:
                    self._exchange.drop(under_way.pop(0))
                if run.stopped:
                    self._cancel_all(under_way)
                    return run.result()
        except (DipoleError, OSError):
            raise
        except BaseException:
            self._cancel_all(under_way)
            raise
        finally:
            for request_id in under_way:
                self._exchange.drop(request_id)

    # ---- Monte Carlo -----------------------------------------------------------------------------

    @signed(mc.request)
    def mc(
        self,
        medium: Media,
        edges: Grid,
        *,
        progress: Callable[[McProgress], bool | None] | None = None,
        **options: Any,
    ) -> McResult:
        """Runs a Monte Carlo job on the daemon and waits for its result.

        edges: the edges of the rings; n edges make n - 1 rings. progress: is called a few times a
        second. If it returns False, the job is cancelled, and the result holds the photons walked
        so far. If it raises an exception, such as KeyboardInterrupt, the job is cancelled too.
        options: photons: how many to walk. The default is a million, or the daemon's limit if an
        error is given. error_total, error_rings: the job ends as soon as the relative standard
        error of the total R, or of every ring with light, is at most this; if both are given, both
        must hold. thickness: of a slab, mm; None means a half space. albedos: up to 16, in place of
        the medium's own; one walk gives the results for all of them. seed: 1 by default.
        parameters: a phase function in place of Henyey and Greenstein's, by name, for example
        {"phase": "two-term", "phase_share": 0.95, "phase_g": -0.3}; info.choices["phase"]
        describes them. The medium's g is their mean cosine.
        """
        request = mc.request(self.info, self._media_of(medium), edges, **options)
        request_id = self._send(request)
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

    def _cancel_all(self, request_ids: list[int]) -> None:
        for request_id in request_ids:
            self._cancel(request_id)

    def _cancel(self, job_id: int) -> None:
        self._exchange.ask_once(job_id)
        self._exchange.drop(self._send(mc.cancellation(job_id)))

    @signed(rings.means)
    def ring_means(
        self, model: str | int | None, media: Media, edges: Any, **options: Any
    ) -> RingMeans:
        """Returns a model's means of R over rings, to compare with those of mc().

        edges: mm, a Grid as for mc(), or the edges [N + 1] of its result. The means are integrals
        of 2 pi r R over the ring, over the ring's area; the numerical error holds that of the
        integration, for which several queries are sent. The model error is NaN for rings that start
        at 0: it is measured from 0.01 mean free paths on. options: evaluator, moments, parameters,
        tolerance and deadline_ms, as of a Query.
        """
        listed = self._media_of(media)
        means = rings.means(self.info, model, listed, edges, **options)
        try:
            query = next(means)
            while True:
                query = means.send(self.eval(query))
        except StopIteration as end:
            done: RingMeans = end.value
            return done

    # ---- the rest --------------------------------------------------------------------------------

    def media(self) -> dict[str, tuple[Medium, Medium, Medium]]:
        """Returns the daemon's measured media by name, each with three channels: red, green,
        blue."""
        return self._ask(calls.media())

    def statistics(self) -> dict[str, int]:
        """Returns the daemon's statistics by name. A name ends in the unit of its number."""
        return self._ask(calls.statistics())

    def ping(self, payload: bytes = b"") -> float:
        """Returns the time of an empty round trip, in seconds. payload: up to 1024 bytes, a
        multiple of 8, which the daemon sends back."""
        request = calls.ping(payload)
        start = time.perf_counter()
        self._ask(request)
        return time.perf_counter() - start

    def send_frame(
        self, type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0
    ) -> None:
        """Sends a frame of any type without checking it. Use receive_frame() for the reply."""
        self._connection.send_frame(type, request_id, payload, deadline_ms)

    def receive_frame(self) -> Frame:
        """Waits for the next frame. Use it only with send_frame(): other calls take frames, too."""
        return self._connection.receive_frame()

    def _query(self, *query: Any, **options: Any) -> Query:
        made = Query.of(*query, **options)
        return replace(made, media=self._media_of(made.media))

    def _media_of(self, media: Media) -> Media:
        """Returns the channels of a measured medium for its name, and other media unchanged."""
        if not isinstance(media, str):
            return media
        self._measured = self._measured or self.media()
        return evaluation.known("medium", media, self._measured)

    # ---- sending and receiving -------------------------------------------------------------------

    def _ask(self, request: Request[T]) -> T:
        request_id = self._send(request)
        try:
            answer: T = self._next(request_id)
            return answer
        finally:
            self._exchange.drop(request_id)

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
