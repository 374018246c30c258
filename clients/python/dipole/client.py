"""A client of dipoled: evaluates subsurface-scattering profiles R(r).

    with dipole.Client() as client:
        result = client.eval("better", client.media()["skin1"], r=[0.5, 1, 2])
        print(result.R)  # [channel, radius], 1/mm^2
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from . import broadcast, calls, inversion, mc, packing, samples, wire
from .answers import Answer
from .broadcast import Values
from .errors import DipoleError
from .inversion import Inversion
from .parts import Parts
from .samples import Draw, Samples
from .session import Session
from .table import Table
from .values import Grid, Medium, Offers, Result


class Client(Session):
    """Connects, agrees on a protocol version and reads the daemon's lists.

    address and timeout_s: see Connection. A client belongs to one thread at a time. Close it, or
    use it in a with statement; a private daemon ends with it.

    retry_s: how long a request that meets trouble is tried again; by default 5 s at a unix: or tcp:
    address; 0: not at all. Trouble is a lost connection, or a daemon that is busy or stops: then
    the client connects again and sends again what is outstanding. A connection is given up when a
    request cannot be asked again: mc(), eval_parts() of which parts have come, and what is beyond
    64 MiB of outstanding requests. dipole_set_retry_ms() in dipole.h tells more.
    """

    # ---- evaluating ------------------------------------------------------------------------------

    def eval(
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
        """Evaluates a model for one or more media and waits for the answer.

        model: None: the cheapest model and evaluator that are measured to be within `tolerance` of
        radiative transport, for all media, from the smallest to the largest radius; the result
        says what was taken. Refused when nothing is known to be.
        media: one Medium, or C of them, or an array [C, 4] of sigma_a, sigma_s (1/mm), g, eta.
        r: N radii in mm, from 0 to infinity; or grid: the radii by rule, which cost no bytes.
        evaluator: "f64" (the default of a model); or for radii and values in single precision
        "f32", or "lut", which looks up in a table. Of any model it says no more than the
        precision, which then is single by default.
        moments: "exact", or "fit" for the polynomials.
        wanted: names of quantities; by default R, albedo, cdf and, for a grid, r.
        parameters: optional numbers by name, such as {"cos_in": 0.8}: see info.choices["parameter"]
        for their units and ranges. fit_model may also be the name of a model. A model refuses a
        parameter that it does not take.
        tolerance: that parameter: of a model its numerical error, relative, where it can choose; of
        the evaluator "lut" what its table is built to.
        deadline_ms: how long the answer may take from the arrival of the query; 0: any time.

        Raises Refused when the daemon does not take the query, with the field at fault, and with
        the status "deadline" instead of an answer that would be late.
        """
        request_id = self.submit(
            model,
            media,
            r,
            grid=grid,
            evaluator=evaluator,
            moments=moments,
            wanted=wanted,
            parameters=parameters,
            tolerance=tolerance,
            deadline_ms=deadline_ms,
        )
        try:
            return self.collect(request_id)[1]
        finally:
            self.forget(request_id)

    def values(
        self,
        model: str | int | None,
        media: Medium | Sequence[Any] | np.ndarray,
        r: Any,
        quantity: str = "R",
        *,
        evaluator: str | int | None = None,
        moments: str | int = "exact",
        parameters: Mapping[str, float | str] | None = None,
        tolerance: float | None = None,
        deadline_ms: int = 0,
    ) -> Values:
        """Evaluates one quantity as numpy's functions do: media and radii of any shapes, which are
        broadcast against each other.

        media: a Medium whose fields may be arrays, or an array [..., 4]. r: radii in mm, of any
        shape. So a Medium whose sigma_a is [H, W, 1] and r [N] give values [H, W, N], and r [H, W]
        gives every medium of an image its own radius. quantity: the name of one that has a value
        for each radius. The rest: as of eval(). Equal media are asked for once; any number of
        media, and of radii, goes. deadline_ms counts for each of the queries that this takes.
        """
        queries, collected = broadcast.plan(self.info, media, r, quantity)
        under_way: dict[int, broadcast.Query] = {}

        def collect_one() -> None:
            request_id = next(iter(under_way))
            query = under_way.pop(request_id)
            collected.add(query, self.collect(request_id)[1])

        try:
            for query in queries:
                request_id = self.submit(
                    model,
                    query.media,
                    query.radii,
                    evaluator=evaluator,
                    moments=moments,
                    wanted=[quantity],
                    parameters=parameters,
                    tolerance=tolerance,
                    deadline_ms=deadline_ms,
                )
                under_way[request_id] = query
                if len(under_way) >= broadcast.OUTSTANDING:
                    collect_one()
            while under_way:
                collect_one()
        finally:  # after a refusal nobody waits for the answers to the others
            for request_id in under_way:
                self.forget(request_id)
        return collected.values()

    def submit(
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
    ) -> int:
        """Sends a query like eval() without waiting; returns its id, for collect()."""
        payload, query = packing.query(
            self.info, model, media, r, grid, evaluator, moments, wanted, parameters, tolerance
        )
        return self._send("eval", payload, deadline_ms, self._outstanding, Answer(query))

    def eval_parts(
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
    ) -> Parts:
        """Evaluates like eval() and gives the parts of the answer as they come: an iterator of
        results, of which each holds the radii from radius_first on. So an answer may be larger than
        memory. How many radii come at a time is the daemon's choice. Refused may be raised by any
        step; the parts before it are right.
        """
        payload, query = packing.query(
            self.info, model, media, r, grid, evaluator, moments, wanted, parameters, tolerance
        )
        query = query._replace(handed_on=True)
        return Parts(self, self._send("eval", payload, deadline_ms, self._read, Answer(query)))

    def offers(
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
        """What could answer eval(None, ...) with the same arguments: how exact each model and
        evaluator are measured to be, and how fast; cheapest first."""
        call = calls.offers(
            self.info, media, r, grid, evaluator, wanted, parameters, tolerance
        )
        return self._call(call)

    def table(
        self,
        model: str | int,
        medium: Medium | Sequence[float],
        *,
        moments: str | int = "exact",
        parameters: Mapping[str, float | str] | None = None,
        tolerance: float | None = None,
        deadline_ms: int = 0,
    ) -> Table:
        """Fetches the table by which the evaluator "lut" answers for a medium, to be evaluated
        here: without a daemon, and with the same bits. tolerance: what it is built to, relative,
        from 1e-6 (by default 1e-4). deadline_ms: as of eval()."""
        call = calls.table(self.info, model, medium, moments, parameters, tolerance)
        return self._call(call, deadline_ms)

    def sample(
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
        """Draws radii in proportion to r R(r): the radius for each number u has the cdf u.

        u: N numbers from 0 to 1, both included (0 mm, infinity); or draw: the numbers by rule, the
        same for every channel: Draw(1024) are 1024 random ones. wanted: names of quantities, of
        which "r" are the radii and all others are evaluated at them. All else is as of eval(), but
        for models that do not cover all radii, which are refused.
        """
        payload, query, numbers = samples.request(
            self.info,
            model,
            media,
            u,
            draw,
            evaluator,
            moments,
            wanted,
            parameters,
            tolerance,
        )
        answer = self._whole("sample", payload, deadline_ms, Answer(query))
        return samples.result(answer, self.info, numbers)

    def invert(
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
        """The media whose diffuse albedo under a model is the given one: sigma_a and sigma_s from
        what artists have.

        albedo: from 0 to 1, of any shape: a number, channels, a texture [H, W, 3]. length: mm, of a
        shape that can be broadcast with it: what `given` says: "mean-free-path", 1 / sigma_t', with
        sigma_t' = sigma_a + sigma_s (1 - g); or "diffuse-mean-free-path",
        "classical-diffuse-path": see info.choices["length"]. g, eta: of all of them. An albedo that
        the model cannot reach has no medium: its values are NaN. deadline_ms: as of eval().
        """
        payload, query = inversion.request(
            self.info, model, albedo, length, given, g, eta, moments
        )
        answer = self._whole("invert", payload, deadline_ms, inversion.Answer(query))
        return inversion.result(answer, self.info)

    # ---- Monte Carlo -----------------------------------------------------------------------------

    def mc(
        self,
        medium: Medium | Sequence[float],
        edges: Grid,
        *,
        photons: int | None = None,
        error_total: float = 0.0,
        error_rings: float = 0.0,
        thickness: float | None = None,
        albedos: Iterable[float] = (),
        seed: int = 1,
        progress: Callable[[mc.McProgress], bool | None] | None = None,
    ) -> mc.McResult:
        """Walks photons through a medium on the daemon and waits for the table.

        edges: of the rings, of which there is one less. photons: how many to walk; by default as
        many as the daemon allows where an error is given, else a million. error_total,
        error_rings: it ends earlier when the relative standard error of R, that of every ring with
        light, or both, are so small. thickness: of a slab, mm; None: half space. albedos: up to 16
        in place of the medium's own; one walk serves all. progress: called a few times a second;
        when it returns False the job is cancelled, and the table is what there is by then. An
        exception, such as KeyboardInterrupt, cancels it too.
        """
        walk = (photons, error_total, error_rings, thickness, albedos, seed)
        payload = mc.request(self.info, medium, edges, *walk)
        request_id = self._send("mc", payload)
        try:
            return self._mc_result(request_id, progress)
        except (DipoleError, OSError):
            raise
        except BaseException:
            self._cancel(request_id)
            self._mc_result(request_id, None)
            raise

    def _cancel(self, request_id: int) -> None:
        """Cancels a job whose last reply has not been received."""
        job_id = wire.CANCEL_REQUEST.pack(job_id=request_id)
        self._ignored.add(self._send("cancel", job_id))

    def _mc_result(
        self, request_id: int, progress: Callable[[mc.McProgress], bool | None] | None
    ) -> mc.McResult:
        cancelled = False
        while True:
            payload = self._answer(request_id, "mc")
            fixed = mc.unpack_fixed(payload)
            if fixed.state != wire.MC_UNDER_WAY:
                return mc.unpack_result(payload)
            if progress is not None and progress(mc.progress_of(fixed)) is False and not cancelled:
                self._cancel(request_id)
                cancelled = True

    # ---- the rest --------------------------------------------------------------------------------

    def media(self) -> dict[str, tuple[Medium, Medium, Medium]]:
        """The daemon's measured media by name: red, green, blue."""
        return self._call(calls.media())

    def statistics(self) -> dict[str, int]:
        """The daemon's statistics by name, whose end is the unit."""
        return self._call(calls.statistics())

    def ping(self, payload: bytes = b"") -> float:
        """A round trip that does nothing else, in seconds. payload: up to 1024 bytes, a multiple of
        8, that the daemon sends back."""
        call = calls.ping(payload)
        start = time.perf_counter()
        self._call(call)
        return time.perf_counter() - start
