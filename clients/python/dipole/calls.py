"""Requests about the daemon itself: hello, measured media, statistics and ping."""

from __future__ import annotations

from typing import Any

from . import wire
from .errors import ArgumentError, ProtocolError
from .evaluation import unpack_list
from .exchange import Once, Request
from .values import Choice, Info, Medium


def hello(address: str) -> Request[Info]:
    """Makes the first request of a client. address: that of the connection, which Info repeats."""
    request = wire.HELLO_REQUEST.pack(version_min=wire.VERSION, version_max=wire.VERSION)

    def read(reply: bytes) -> Info:
        fixed, (choices, limits) = unpack_list(
            reply, wire.HELLO_REPLY, choice_count=wire.CHOICE, limit_count=wire.VALUE
        )
        by_kind: dict[str, dict[str, Choice]] = {kind: {} for kind in wire.KINDS.values()}
        for choice in choices:
            kind = wire.KINDS.get(choice.kind)
            if kind is not None:  # A newer daemon may list kinds that this client does not know.
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

    return Request("hello", request, lambda: Once(read))


def media() -> Request[dict[str, tuple[Medium, Medium, Medium]]]:
    """See Client.media()."""

    def read(reply: bytes) -> dict[str, tuple[Medium, Medium, Medium]]:
        entries = unpack_list(reply, wire.LIST_REPLY, count=wire.MEASURED_MEDIUM)[1][0]
        return {
            entry.name: (_channel(entry, 0), _channel(entry, 1), _channel(entry, 2))
            for entry in entries
        }

    return Request("media", b"", lambda: Once(read))


def _channel(entry: Any, i: int) -> Medium:
    return Medium(entry.sigma_a[i], entry.sigma_s[i], entry.g, entry.eta)


def statistics() -> Request[dict[str, int]]:
    """See Client.statistics()."""

    def read(reply: bytes) -> dict[str, int]:
        entries = unpack_list(reply, wire.LIST_REPLY, count=wire.VALUE)[1][0]
        return {entry.name: entry.value for entry in entries}

    return Request("statistics", b"", lambda: Once(read))


def ping(payload: bytes) -> Request[None]:
    """See Client.ping()."""
    if len(payload) % wire.ALIGNMENT or len(payload) > wire.PING_MAX_BYTES:
        raise ArgumentError("payload: a multiple of 8 bytes, at most 1024")

    def read(reply: bytes) -> None:
        if reply != payload:
            raise ProtocolError("the ping came back changed")

    return Request("ping", payload, lambda: Once(read))
