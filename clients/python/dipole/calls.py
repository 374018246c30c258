"""Requests that have one reply: what is sent, and how the reply is read. Eval and mc have more."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from . import answers, packing, wire
from .connection import Frame, frame_bytes
from .errors import ArgumentError, ProtocolError, Refused, TableError
from .table import Table
from .values import Choice, Grid, Info, Medium, Offer, Offers

T = TypeVar("T")


class Call(NamedTuple, Generic[T]):
    """A request, and what reads its reply."""

    message: str
    payload: bytes
    read: Callable[[bytes], T]


# ---- replies of any kind -------------------------------------------------------------------------


def payload_of(frame: Frame, message: str) -> bytes:
    """The payload of a reply to such a message, or its error as an exception."""
    if frame.type == wire.TYPE_ERROR:
        raise refused(frame)
    if frame.type != wire.MESSAGES[message] | wire.REPLY:
        raise ProtocolError(f"a reply of type {frame.type} to a request for {message}")
    return frame.payload


def refused(frame: Frame) -> Refused | ProtocolError:
    """An error frame as an exception."""
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


def _list_reply(payload: bytes, structure: wire.Structure) -> list[Any]:
    return packing.unpack_list(payload, wire.LIST_REPLY, [("count", structure)])[1][0]


# ---- the calls -----------------------------------------------------------------------------------


def offers(
    info: Info,
    media: Medium | Iterable[Sequence[float]] | np.ndarray,
    r: Any,
    grid: Grid | None,
    evaluator: str | int | None,
    wanted: Iterable[str] | None,
    parameters: Mapping[str, float | str] | None,
    tolerance: float | None,
) -> Call[Offers]:
    """See Client.offers()."""
    payload, _ = packing.query(
        info, None, media, r, grid, evaluator, "exact", wanted, parameters, tolerance
    )

    def read(reply: bytes) -> Offers:
        fixed, (entries,) = packing.unpack_list(reply, wire.OFFERS_REPLY, [("count", wire.OFFER)])
        if fixed.taken > fixed.count:
            raise ProtocolError("an offers reply that takes what it does not offer")
        listed = tuple(
            Offer(
                model=answers.name_of(info, "model", entry.model),
                evaluator=answers.name_of(info, "evaluator", entry.evaluator),
                meets=entry.meets != 0,
                error=entry.error,
                numerical_error=entry.numerical_error,
                cost_ns=entry.cost,
                prepare_ns=entry.prepare_cost,
            )
            for entry in entries
        )
        return Offers(listed, listed[fixed.taken] if fixed.taken < fixed.count else None)

    return Call("offers", payload, read)


def table(
    info: Info,
    model: str | int,
    medium: Medium | Sequence[float],
    moments: str | int,
    parameters: Mapping[str, float | str] | None,
    tolerance: float | None,
) -> Call[Table]:
    """See Client.table()."""
    media = packing.media_array(medium)
    if len(media) != 1:
        raise ArgumentError("medium: one Medium")
    listed_parameters = packing.parameters_list(info, parameters, tolerance)
    fixed = wire.TABLE_REQUEST.pack(
        model=packing.id_of(info, "model", model),
        moments=packing.id_of(info, "moments", moments),
        parameter_count=len(listed_parameters),
    )

    def read(reply: bytes) -> Table:
        try:
            return Table(frame_bytes(wire.MESSAGES["table"] | wire.REPLY, 0, reply), info)
        except TableError as error:
            raise ProtocolError(f"a table reply that is none: {error}") from error

    return Call("table", b"".join([fixed, media.tobytes(), *listed_parameters]), read)


def media() -> Call[dict[str, tuple[Medium, Medium, Medium]]]:
    """See Client.media()."""

    def read(reply: bytes) -> dict[str, tuple[Medium, Medium, Medium]]:
        return {
            entry.name: tuple(
                Medium(entry.sigma_a[i], entry.sigma_s[i], entry.g, entry.eta) for i in range(3)
            )
            for entry in _list_reply(reply, wire.MEASURED_MEDIUM)
        }

    return Call("media", b"", read)


def statistics() -> Call[dict[str, int]]:
    """See Client.statistics()."""

    def read(reply: bytes) -> dict[str, int]:
        return {entry.name: entry.value for entry in _list_reply(reply, wire.VALUE)}

    return Call("statistics", b"", read)


def ping(payload: bytes) -> Call[None]:
    """See Client.ping()."""
    if len(payload) % wire.ALIGNMENT or len(payload) > wire.PING_MAX_BYTES:
        raise ArgumentError("payload: a multiple of 8 bytes, at most 1024")

    def read(reply: bytes) -> None:
        if reply != payload:
            raise ProtocolError("the ping came back changed")

    return Call("ping", payload, read)


def hello(address: str) -> Call[Info]:
    """What a client says first. address: of the connection, for the Info."""
    request = wire.HELLO_REQUEST.pack(version_min=wire.VERSION, version_max=wire.VERSION)

    def read(reply: bytes) -> Info:
        fixed, (choices, limits) = packing.unpack_list(
            reply, wire.HELLO_REPLY, [("choice_count", wire.CHOICE), ("limit_count", wire.VALUE)]
        )
        by_kind: dict[str, dict[str, Choice]] = {kind: {} for kind in wire.KINDS.values()}
        for choice in choices:
            kind = wire.KINDS.get(choice.kind)
            if kind is not None:  # a later daemon may have kinds that this client does not know
                by_kind[kind][choice.name] = Choice(choice.id, choice.name, choice.about)
        return Info(
            address=address,
            software=fixed.software,
            instruction_set=fixed.instruction_set,
            R_unit=fixed.R_unit,
            protocol_version=fixed.version,
            workers=fixed.workers,
            choices=by_kind,
            limits={limit.name: limit.value for limit in limits},
        )

    return Call("hello", request, read)
