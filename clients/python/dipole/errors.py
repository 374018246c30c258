"""The exceptions of this module. DipoleError is the base of all of them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any


class DipoleError(Exception):
    """The base of all exceptions of this module."""


class AddressError(DipoleError, ValueError):
    """The text of an address is malformed."""


class ConnectError(DipoleError, ConnectionError):
    """No daemon replies at any of the addresses, or the private daemon does not start. final: True
    if trying again would not help, because certificates are at fault."""

    def __init__(self, text: str, final: bool = False):
        self.final = final
        super().__init__(text)


class ConnectionLost(DipoleError, ConnectionError):
    """The connection ended or timed out. The client can only be closed. final: True if connecting
    again would not help, for example because the client has been closed."""

    def __init__(self, text: str, final: bool = False):
        self.final = final
        super().__init__(text)


class ProtocolError(DipoleError):
    """The peer does not follow the protocol. The connection is given up."""


class ArgumentError(DipoleError, ValueError):
    """The arguments of a call do not fit together. The client has sent nothing."""


@contextlib.contextmanager
def naming(arguments: str) -> Iterator[None]:
    """Makes an ArgumentError, which names the arguments, of what numpy says of them."""
    try:
        yield
    except (KeyError, TypeError, ValueError) as error:
        raise ArgumentError(f"{arguments}: {error}") from error


class TableError(DipoleError, ValueError):
    """The bytes are not an intact table of a layout that this module knows."""


class LibraryError(DipoleError):
    """libdipole, which evaluates tables, surfaces and the light of points at home, is missing."""


class Refused(DipoleError):
    """The daemon refused a request. The client continues to work."""

    def __init__(
        self,
        status: str,
        code: int,
        field: str,
        allowed: str,
        index: int,
        retry_after_ms: int,
        request_id: int,
    ):
        self.status = status  # name of the status, such as "bad-value", "too-large" or "busy"
        self.code = code  # number of the status
        self.field = field  # name of the field at fault, or ""
        self.allowed = allowed  # what is allowed in that field, or ""
        self.index = index  # position of the value at fault in its array
        self.retry_after_ms = retry_after_ms  # how long to wait if the daemon is busy; else 0
        self.request_id = request_id  # id of the request that was refused
        text = status
        if field:
            text += f": {field}[{index}]" if index else f": {field}"
        if allowed:
            text += f": allowed is {allowed}"
        if retry_after_ms:
            text += f"; try again in {retry_after_ms} ms"
        super().__init__(text)

    def __reduce__(self) -> tuple[Any, ...]:
        facts = (self.status, self.code, self.field, self.allowed, self.index)
        return type(self), (*facts, self.retry_after_ms, self.request_id), self.__dict__
