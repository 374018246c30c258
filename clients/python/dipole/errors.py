"""What can go wrong, as exceptions; DipoleError catches all of it."""

from __future__ import annotations


class DipoleError(Exception):
    """Any failure of this module."""


class AddressError(DipoleError, ValueError):
    """The address cannot be understood."""


class ConnectError(DipoleError, ConnectionError):
    """Nobody answers at the address, or the private daemon does not start."""


class ConnectionLost(DipoleError, ConnectionError):
    """The connection ended or timed out; the client can only be closed. final: not because of the
    peer, so that to connect again would not help."""

    def __init__(self, text: str, final: bool = False):
        self.final = final
        super().__init__(text)


class ProtocolError(DipoleError):
    """The peer does not speak this protocol; the client can only be closed."""


class ArgumentError(DipoleError, ValueError):
    """The arguments of a call do not fit together; nothing was sent."""


class TableError(DipoleError, ValueError):
    """The bytes are not an intact table of a layout that is known here."""


class Refused(DipoleError):
    """The daemon refused a request; the client goes on working."""

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
        self.status = status  # name of the status: "bad-value", "too-large", "busy", ...
        self.code = code  # its code
        self.field = field  # the field at fault, or ""
        self.allowed = allowed  # what is allowed there, or ""
        self.index = index  # position of the value at fault in its array
        self.retry_after_ms = retry_after_ms  # busy: when to try again; else 0
        self.request_id = request_id  # of the request that was refused
        super().__init__(self._text())

    def _text(self) -> str:
        text = self.status
        if self.field:
            where = f"{self.field}[{self.index}]" if self.index else self.field
            text += f": {where}"
        if self.allowed:
            text += f": allowed is {self.allowed}"
        if self.retry_after_ms:
            text += f"; try again in {self.retry_after_ms} ms"
        return text
