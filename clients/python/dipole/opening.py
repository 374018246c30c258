"""Opens a connection to the first of several daemons that replies, at first and after a loss. Waits
with time.sleep(): AsyncClient calls it in a thread."""

from __future__ import annotations

import re
import time

from . import wire
from .connection import Connection, Tls, usual_address
from .errors import AddressError, ConnectError, ConnectionLost, DipoleError, naming
from .exchange import PAUSE_FIRST_S, Exchange, Once, Request, is_temporary, with_jitter
from .values import Choice, Info

RETRY_S = 5.0  # how long a client of unix: or tcp: addresses retries by default

_PAUSE_MOST_S = 1.0


class Opening:
    """How a client opens its connections.

    address, timeout_s, retry_s, tls: see Client.
    """

    def __init__(
        self, address: str | None, timeout_s: float | None, retry_s: float | None, tls: Tls
    ):
        self._addresses = _several(usual_address() if address is None else address)
        self._at = 0  # index of the address that is in use, or is tried next
        with naming("timeout_s, retry_s"):
            if not (timeout_s is None or float(timeout_s) > 0) or not float(retry_s or 0) >= 0:
                raise ValueError("seconds above 0, or None; retry_s may be 0")
        self._timeout_s = timeout_s
        self._tls = tls
        usual_s = 0.0 if self._addresses[0].startswith("private:") else RETRY_S
        self.retry_s = usual_s if retry_s is None else retry_s

    def open(self) -> tuple[Connection, Info]:
        """Opens the first connection. Returns what its daemon says about itself, too."""
        began_s = time.monotonic()
        until_s = began_s + self.retry_s if self.retry_s > 0 else None
        failures: list[DipoleError] = []
        opened = self._try_each(until_s, None, failures)
        if opened is None and until_s is not None:
            opened = self._try_in_rounds(until_s, None, failures)
        if opened is not None:
            return opened
        tried = f" (tried for {time.monotonic() - began_s:.1f} s)"
        raise _together(failures, tried if until_s is not None else "")

    def open_again(self, info: Info, until_s: float, lost: DipoleError) -> Connection:
        """Opens a connection in place of a lost one, if possible to the next daemon in the list,
        until the time until_s. Raises `lost` if that fails. info: what the first daemon said about
        itself. The new daemon must have the same lists."""
        self._at = (self._at + 1) % len(self._addresses)
        failures = [lost]
        opened = self._try_in_rounds(until_s, info, failures)
        if opened is not None:
            return opened[0]
        if isinstance(lost, ConnectionLost) and failures != [lost]:
            raise ConnectionLost(f"{lost} (and connecting again failed: {failures[-1]})")
        raise lost from failures[-1]

    # ---- attempts --------------------------------------------------------------------------------

    def _try_in_rounds(
        self, until_s: float, like: Info | None, failures: list[DipoleError]
    ) -> tuple[Connection, Info] | None:
        """Waits and tries all addresses, until one replies, the time is over, or another round
        cannot help. failures: of the latest round. A pause takes at most half of the time that is
        left, so that the last attempts come close to until_s."""
        pause_s = PAUSE_FIRST_S
        opened = None
        while opened is None and any(map(is_temporary, failures)):
            retry_after_s = min(getattr(failure, "retry_after_ms", 0) for failure in failures) / 1000
            left_s = until_s - time.monotonic()
            if left_s < max(PAUSE_FIRST_S, retry_after_s):
                break
            time.sleep(max(min(with_jitter(pause_s), left_s / 2), retry_after_s))
            pause_s = min(2 * pause_s, _PAUSE_MOST_S)
            failures.clear()
            opened = self._try_each(until_s, like, failures)
        return opened

    def _try_each(
        self, until_s: float | None, like: Info | None, failures: list[DipoleError]
    ) -> tuple[Connection, Info] | None:
        """Tries each address once. The time until until_s is shared equally among the addresses
        that are still to be tried, so that a daemon that hangs leaves time for the others."""
        count = len(self._addresses)
        for others in reversed(range(count)):
            limit_s = self._timeout_s
            if until_s is not None:
                share_s = max((until_s - time.monotonic()) / (others + 1), 0.001)
                limit_s = share_s if limit_s is None else min(limit_s, share_s)
            try:
                return self._try_one(limit_s, like)
            except AddressError:
                raise
            except DipoleError as failure:
                failures.append(failure)
                self._at = (self._at + 1) % count
        return None

    def _try_one(self, limit_s: float | None, like: Info | None) -> tuple[Connection, Info]:
        address = self._addresses[self._at]
        connection = Connection(address, limit_s, self._tls)
        try:
            info = self._greet(connection, address)
            if like is not None and not _has_lists_of(info, like):
                text = f"{address}: the daemon that is there now has other lists"
                raise ConnectionLost(text, final=True)
        except BaseException as error:
            connection.close()
            if isinstance(error, ConnectionLost) and not error.final:
                hint = ": is it a tls: address?" if address.startswith("tcp:") else ""
                raise ConnectError(f"{error} (before it said hello{hint})") from error
            raise
        connection.timeout_s = self._timeout_s
        connection.is_one_of_several = len(self._addresses) > 1
        return connection, info

    def _greet(self, connection: Connection, address: str) -> Info:
        """Sends hello and waits for the reply."""
        exchange = Exchange(0.0)
        request_id = exchange.begin(_hello(address))
        connection.is_one_of_several = True  # A daemon that is silent now may reply later.
        for data in exchange.frame(request_id):
            connection.send_bytes(data)
        while not exchange.is_ready(request_id):
            exchange.take(connection.receive_frame())
        info: Info = exchange.next(request_id)
        return info


def _hello(address: str) -> Request[Info]:
    """Makes the first request of a client. address: that of the connection, which Info repeats."""
    request = wire.HELLO_REQUEST.pack(version_min=wire.VERSION, version_max=wire.VERSION)

    def read(reply: bytes) -> Info:
        fixed, parts = wire.PAYLOADS["hello_reply"].unpack(reply)
        by_kind: dict[str, dict[str, Choice]] = {kind: {} for kind in wire.KINDS.values()}
        for choice in parts["choice"]:
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
            limits={limit.name: limit.value for limit in parts["limit"]},
        )

    return Request("hello", request, lambda: Once(read))


def _several(text: str) -> list[str]:
    """Splits a list of addresses at each comma before a scheme. Other commas belong to a path."""
    if not isinstance(text, str) or text == "":
        raise AddressError(f"address: one text, in which several have commas between them; not {text!r}")
    addresses = re.split(",(?=unix:|tcp:|tls:|private:)", text)
    if len(addresses) > 1 and any(address.startswith("private:") for address in addresses):
        raise AddressError(f"{text}: private: cannot be one of several addresses")
    return addresses


def _together(failures: list[DipoleError], tried: str) -> DipoleError:
    """Makes one exception of the failures at all addresses. tried: says for how long."""
    if len(failures) == 1 and not isinstance(failures[0], ConnectError):
        return failures[0]
    error = ConnectError("; ".join(map(str, failures)) + tried)
    error.__cause__ = failures[-1]
    return error


def _has_lists_of(fresh: Info, info: Info) -> bool:
    """Returns whether each name in the lists of `info` has the same id in the lists of `fresh`, so
    that the ids in requests keep their meaning."""
    return all(
        choice.name in fresh.choices[kind] and fresh.choices[kind][choice.name].id == choice.id
        for kind, choices in info.choices.items()
        for choice in choices.values()
    )
