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

from . import answers, mc, wire
from .answers import Answer, Query
from .connection import Connection, Frame, frame_bytes
from .errors import ArgumentError, DipoleError, ProtocolError, Refused, TableError
from .parts import Parts
from .table import Table
from .values import Choice, Grid, Info, Medium, Offer, Offers, Result


class Client:
    """Connects, agrees on a protocol version and reads the daemon's lists.

    address and timeout_s: see Connection. A client belongs to one thread at a time. Close it, or
    use it in a with statement; a private daemon ends with it.
    """

    def __init__(self, address: str | None = None, timeout_s: float | None = 30.0):
        self._last_id = 0
        self._outstanding: dict[int, Answer] = {}  # of submitted queries
        self._arrived: list[int] = []  # those of them that are whole, or refused, in that order
        self._read: dict[int, Answer] = {}  # of queries that are read part by part
        self._ignored: set[int] = set()  # requests whose replies say nothing that is wanted
        self._connection = Connection(address, timeout_s)
        try:
            self.info: Info = self._hello()
        except BaseException:
            self._connection.close()
            raise

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection and ends a private daemon. Closing twice is fine."""
        self._connection.close()

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
            while request_id not in self._arrived:
                self._receive()
        except BaseException:
            self._forget(request_id)
            raise
        return self._take(request_id)

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
        payload, query = self._pack_query(
            model, media, r, grid, evaluator, moments, wanted, parameters, tolerance
        )
        request_id = self._send("eval", payload, deadline_ms)
        self._outstanding[request_id] = Answer(query)
        return request_id

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
        payload, query = self._pack_query(
            model, media, r, grid, evaluator, moments, wanted, parameters, tolerance
        )
        request_id = self._send("eval", payload, deadline_ms)
        self._read[request_id] = Answer(query._replace(handed_on=True))
        return Parts(self, request_id)

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
        payload, _ = self._pack_query(
            None, media, r, grid, evaluator, "exact", wanted, parameters, tolerance
        )
        answer = self._answer(self._send("offers", payload), "offers")
        fixed, (entries,) = _unpack_list(answer, wire.OFFERS_REPLY, [("count", wire.OFFER)])
        if fixed.taken > fixed.count:
            raise ProtocolError("an offers reply that takes what it does not offer")
        offers = tuple(
            Offer(
                model=answers.name_of(self.info, "model", entry.model),
                evaluator=answers.name_of(self.info, "evaluator", entry.evaluator),
                meets=entry.meets != 0,
                error=entry.error,
                numerical_error=entry.numerical_error,
                cost_ns=entry.cost,
                prepare_ns=entry.prepare_cost,
            )
            for entry in entries
        )
        return Offers(offers, offers[fixed.taken] if fixed.taken < fixed.count else None)

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
        media = _media_array(medium)
        if len(media) != 1:
            raise ArgumentError("medium: one Medium")
        listed_parameters = self._parameters(parameters, tolerance)
        fixed = wire.TABLE_REQUEST.pack(
            model=self._id("model", model),
            moments=self._id("moments", moments),
            parameter_count=len(listed_parameters),
        )
        payload = b"".join([fixed, media.tobytes(), *listed_parameters])
        request_id = self._send("table", payload, deadline_ms)
        payload = self._answer(request_id, "table")
        frame = frame_bytes(wire.MESSAGES["table"] | wire.REPLY, request_id, payload)
        try:
            return Table(frame, self.info)
        except TableError as error:
            raise ProtocolError(f"a table reply that is none: {error}") from error

    def collect(self) -> tuple[int, Result]:
        """Waits for the answer to any outstanding query; returns its id and the result. A refusal
        is raised with the query's id in request_id; the others go on."""
        if not self._outstanding:
            raise ArgumentError("nothing is outstanding")
        while not self._arrived:
            self._receive()
        request_id = self._arrived[0]
        return request_id, self._take(request_id)

    def _take(self, request_id: int) -> Result:
        """The answer to a submitted query, which has arrived."""
        self._arrived.remove(request_id)
        answer = self._outstanding.pop(request_id)
        return answers.result(answer, self.info)

    def _forget(self, request_id: int) -> None:
        """Nobody wants the answer to a submitted query."""
        del self._outstanding[request_id]
        if request_id in self._arrived:
            self._arrived.remove(request_id)
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
        if photons is None:
            wishes = error_total or error_rings
            photons = self.info.limits["max_mc_photons"] if wishes else 1_000_000
        spacing = self._id("spacing", edges.spacing)
        payload = mc.pack_request(
            medium, edges, spacing, photons, error_total, error_rings, thickness, albedos, seed
        )
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
        entries = self._list("media", wire.MEASURED_MEDIUM)
        return {
            entry.name: tuple(
                Medium(entry.sigma_a[i], entry.sigma_s[i], entry.g, entry.eta) for i in range(3)
            )
            for entry in entries
        }

    def statistics(self) -> dict[str, int]:
        """The daemon's statistics by name, whose end is the unit."""
        return {entry.name: entry.value for entry in self._list("statistics", wire.VALUE)}

    def ping(self, payload: bytes = b"") -> float:
        """A round trip that does nothing else, in seconds. payload: up to 1024 bytes, a multiple of
        8, that the daemon sends back."""
        if len(payload) % wire.ALIGNMENT or len(payload) > wire.PING_MAX_BYTES:
            raise ArgumentError("payload: a multiple of 8 bytes, at most 1024")
        start = time.perf_counter()
        if self._answer(self._send("ping", payload), "ping") != payload:
            raise ProtocolError("the ping came back changed")
        return time.perf_counter() - start

    def send_frame(
        self, type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0
    ) -> None:
        """Sends a frame of any type as it is; use receive_frame() for what comes back."""
        self._connection.send_frame(type, request_id, payload, deadline_ms)

    def receive_frame(self) -> Frame:
        """The next frame, unless another call took it; see send_frame()."""
        return self._connection.receive_frame()

    # ---- requests and replies --------------------------------------------------------------------

    def _id(self, kind: str, name: str | int) -> int:
        """The id of a choice by its name; an id stays as it is, for the daemon to judge."""
        if not isinstance(name, str):
            return name
        choices = self.info.choices[kind]
        if name not in choices:
            raise ArgumentError(f"{kind} {name}: not one of {', '.join(choices)}")
        return choices[name].id

    def _pack_query(
        self,
        model: str | int | None,
        media: Medium | Iterable[Sequence[float]] | np.ndarray,
        r: Any,
        grid: Grid | None,
        evaluator: str | int | None,
        moments: str | int,
        wanted: Iterable[str] | None,
        parameters: Mapping[str, float | str] | None,
        tolerance: float | None,
    ) -> tuple[bytes, Query]:
        """The payload of an eval request, see eval()."""
        if wanted is None:
            wanted = ("R", "albedo", "cdf") if grid is None else ("R", "albedo", "cdf", "r")
        if evaluator is None:
            evaluator = "f64" if model is not None else "lut"
        evaluator_id = self._id("evaluator", evaluator)
        media_array = _media_array(media)
        radii = _radii_array(r, grid, evaluator_id)
        radius_count = grid.count if radii is None else len(radii)
        listed_parameters = self._parameters(parameters, tolerance)
        wanted_ids = sum({self._id("quantity", name) for name in wanted})
        fixed = wire.EVAL_REQUEST.pack(
            model=wire.ANY_MODEL if model is None else self._id("model", model),
            evaluator=evaluator_id,
            moments=self._id("moments", moments),
            wanted=wanted_ids,
            medium_count=len(media_array),
            spacing=wire.SPACING_LIST if grid is None else self._id("spacing", grid.spacing),
            parameter_count=len(listed_parameters),
            radius_count=radius_count,
            radius_start=0.0 if grid is None else grid.start_mm,
            radius_stop=0.0 if grid is None else grid.stop_mm,
        )
        listed = b"" if radii is None else radii.tobytes()
        listed += bytes(wire.padded(len(listed)) - len(listed))
        payload = b"".join([fixed, media_array.tobytes(), *listed_parameters, listed])
        value_type = wire.EVALUATOR_TYPES.get(evaluator_id)
        return payload, Query(radii, value_type, wanted_ids, len(media_array), radius_count)

    def _parameters(
        self, parameters: Mapping[str, float | str] | None, tolerance: float | None
    ) -> list[bytes]:
        """Parameter structures; their values are the daemon's to judge."""
        structures = []
        all_parameters = dict(parameters or {})
        if tolerance is not None:
            if "tolerance" in all_parameters:
                raise ArgumentError("tolerance: as an argument or in parameters, not both")
            all_parameters["tolerance"] = tolerance
        for name, given in all_parameters.items():
            value = self._id("model", given) if name == "fit_model" else given
            try:
                number = float(value)
            except (TypeError, ValueError) as error:
                raise ArgumentError(f"parameter {name}: {value!r} is no number") from error
            parameter = self._id("parameter", name)
            structures.append(wire.PARAMETER.pack(parameter=parameter, value=number))
        return structures

    def _send(self, message: str, payload: bytes = b"", deadline_ms: int = 0) -> int:
        self._last_id += 1
        type = wire.MESSAGES[message]
        self._connection.send_frame(type, self._last_id, payload, deadline_ms)
        return self._last_id

    def _receive(self, request_id: int = 0) -> Frame | None:
        """The next frame when it answers this request. One that answers a query is kept with its
        Answer; one that answers nothing is the daemon's word on the connection as a whole."""
        frame = self._connection.receive_frame()
        if frame.request_id in self._ignored:
            if frame.type != wire.MESSAGES["eval"] | wire.REPLY or answers.is_last(frame.payload):
                self._ignored.remove(frame.request_id)
            return None
        for queries in (self._outstanding, self._read):
            answer = queries.get(frame.request_id)
            if answer is not None:
                self._add(answer, frame)
                return None
        if request_id != 0 and frame.request_id == request_id:
            return frame
        if frame.type == wire.TYPE_ERROR and frame.request_id == 0:
            raise self._refused(frame)
        raise ProtocolError(f"a reply to request {frame.request_id}, which was not made")

    def _add(self, answer: Answer, frame: Frame) -> None:
        if answer.ended:
            raise ProtocolError(f"a second reply to request {frame.request_id}")
        try:
            answer.add(self._payload(frame, "eval"))
        except Refused as refusal:
            answer.refuse(refusal)
        if answer.ended and frame.request_id in self._outstanding:
            self._arrived.append(frame.request_id)

    def _answer(self, request_id: int, message: str) -> bytes:
        """The payload of the reply to a request that is not among the submitted ones."""
        frame = None
        while frame is None:
            frame = self._receive(request_id)
        return self._payload(frame, message)

    def _payload(self, frame: Frame, message: str) -> bytes:
        """The payload of a reply, or its error as an exception."""
        if frame.type == wire.TYPE_ERROR:
            raise self._refused(frame)
        if frame.type != wire.MESSAGES[message] | wire.REPLY:
            raise ProtocolError(f"a reply of type {frame.type} to a request for {message}")
        return frame.payload

    def _refused(self, frame: Frame) -> Exception:
        if len(frame.payload) != wire.ERROR.bytes:
            return ProtocolError("an error of an unexpected size")
        error = wire.ERROR.unpack(frame.payload)
        return Refused(
            status=wire.STATUSES.get(error.status, f"status {error.status}"),
            code=error.status,
            field=error.field,
            allowed=error.allowed,
            index=error.index,
            retry_after_ms=error.retry_after_ms,
            request_id=frame.request_id,
        )

    def _list(self, message: str, structure: wire.Structure) -> list[Any]:
        payload = self._answer(self._send(message), message)
        return _unpack_list(payload, wire.LIST_REPLY, [("count", structure)])[1][0]

    def _hello(self) -> Info:
        request = wire.HELLO_REQUEST.pack(version_min=wire.VERSION, version_max=wire.VERSION)
        payload = self._answer(self._send("hello", request), "hello")
        reply, (choices, limits) = _unpack_list(
            payload,
            wire.HELLO_REPLY,
            [("choice_count", wire.CHOICE), ("limit_count", wire.VALUE)],
        )
        by_kind: dict[str, dict[str, Choice]] = {kind: {} for kind in wire.KINDS.values()}
        for choice in choices:
            kind = wire.KINDS.get(choice.kind)
            if kind is not None:  # a later daemon may have kinds that this client does not know
                by_kind[kind][choice.name] = Choice(choice.id, choice.name, choice.about)
        return Info(
            address=self._connection.address,
            software=reply.software,
            instruction_set=reply.instruction_set,
            R_unit=reply.R_unit,
            protocol_version=reply.version,
            workers=reply.workers,
            choices=by_kind,
            limits={limit.name: limit.value for limit in limits},
        )


def _media_array(media: Medium | Iterable[Sequence[float]] | np.ndarray) -> np.ndarray:
    array = np.asarray(media if isinstance(media, (tuple, np.ndarray)) else list(media), "<f8")
    if array.ndim == 1:
        array = array[np.newaxis]
    if array.ndim != 2 or array.shape[1] != 4:
        raise ArgumentError("media: a Medium, or several, or an array [C, 4]")
    return array


def _radii_array(r: Any, grid: Grid | None, evaluator_id: int) -> np.ndarray | None:
    if grid is not None:
        if r is not None:
            raise ArgumentError("r, grid: one of them, not both")
        return None
    if evaluator_id not in wire.EVALUATOR_TYPES:
        raise ArgumentError(f"evaluator {evaluator_id}: the type of its radii is not known here")
    radii = np.asarray([] if r is None else r, wire.EVALUATOR_TYPES[evaluator_id])
    if radii.ndim > 1:
        raise ArgumentError("r: one radius or an array [N]")
    return radii.reshape(-1)


def _unpack_list(
    payload: bytes, fixed_structure: wire.Structure, lists: list[tuple[str, wire.Structure]]
) -> tuple[Any, list[list[Any]]]:
    """A payload that is a fixed part followed by lists, whose lengths the fixed part names."""
    if len(payload) < fixed_structure.bytes:
        raise ProtocolError(f"a {fixed_structure.name} that is too short")
    fixed = fixed_structure.unpack(payload)
    counts = [getattr(fixed, count) for count, _ in lists]
    expected = fixed_structure.bytes
    expected += sum(count * entry.bytes for count, (_, entry) in zip(counts, lists))
    if len(payload) != expected:
        raise ProtocolError(f"a {fixed_structure.name} of an unexpected size")
    offset = fixed_structure.bytes
    unpacked = []
    for count, (_, entry) in zip(counts, lists):
        unpacked.append([entry.unpack(payload, offset + i * entry.bytes) for i in range(count)])
        offset += count * entry.bytes
    return fixed, unpacked

