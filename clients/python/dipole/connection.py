"""A connection to a dipoled: addresses, a private daemon, and whole frames in both directions."""

from __future__ import annotations

import os
import re
import select
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import wire
from .errors import AddressError, ConnectError, ConnectionLost, ProtocolError

_RECEIVE_BYTES = 1 << 20
_LARGE_BYTES = 1 << 18  # of a payload that is received to where it stays
_PRIVATE_EXIT_S = 10.0


class Frame(NamedTuple):
    """A frame as received: the header's fields and the payload."""

    type: int
    request_id: int
    payload: bytes | memoryview  # a large one is a view, read-only


class Connection:
    """One connection, without any knowledge of what the messages mean.

    address: unix:PATH, tcp:HOST:PORT ([::1]:PORT for IPv6), private: or private:PROGRAM; None means
    $DIPOLED when that is set, else private:. Several of unix: and tcp:, separated by commas without
    blanks, are tried in turn; `address` is then the one that answered. timeout_s: how long a call
    waits without any byte arriving or leaving, and each address for an answer; None: for ever.
    """

    def __init__(self, address: str | None = None, timeout_s: float | None = 30.0):
        self._addresses = _several(address or os.environ.get("DIPOLED") or "private:")
        self.address = self._addresses[0]
        self.timeout_s = timeout_s
        self._incoming = bytearray()
        self._process: subprocess.Popen[bytes] | None = None
        self.socket = self._open()

    def __enter__(self) -> Connection:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Closes the connection and waits for a private daemon to end, which it then does."""
        self.socket.close()
        if self._process is not None:
            _end(self._process)
            self._process = None

    # ---- connecting ------------------------------------------------------------------------------

    def next_addresses(self) -> str:
        """All addresses, to connect again: those behind the one that was lost come first."""
        at = self._addresses.index(self.address) + 1
        return ",".join(self._addresses[at:] + self._addresses[:at])

    def _open(self) -> socket.socket:
        """At the first address where somebody answers."""
        failures = []
        for self.address in self._addresses:
            try:
                return self._open_one()
            except ConnectError as error:
                failures.append(error)
        if len(failures) == 1:
            raise failures[0]
        raise ConnectError("; ".join(map(str, failures))) from failures[-1]

    def _open_one(self) -> socket.socket:
        scheme, colon, rest = self.address.partition(":")
        try:
            if colon and scheme == "unix" and rest:
                return self._open_unix(rest)
            if colon and scheme == "tcp":
                return self._open_tcp(rest)
            if colon and scheme == "private":
                return self._open_private(rest or _find_daemon())
        except (OSError, subprocess.SubprocessError) as error:
            raise ConnectError(f"{self.address}: {error}") from error
        raise AddressError(
            f"{self.address}: not one of unix:PATH, tcp:HOST:PORT, private:, private:PROGRAM"
        )

    def _open_unix(self, path: str) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.settimeout(self.timeout_s)
            connection.connect(path)
        except OSError:
            connection.close()
            raise
        return connection

    def _open_tcp(self, host_and_port: str) -> socket.socket:
        host, _, port = host_and_port.rpartition(":")
        if host.startswith("[") and host.endswith("]"):
            host = host[1:-1]
        if not host or not port.isascii() or not port.isdigit() or not 0 < int(port) < 65536:
            raise AddressError(f"{self.address}: not tcp:HOST:PORT")
        connection = socket.create_connection((host, int(port)), self.timeout_s)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return connection

    def _open_private(self, program: str) -> socket.socket:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            with theirs:
                self._process = subprocess.Popen(
                    [program, "--fd", str(theirs.fileno())],
                    pass_fds=[theirs.fileno()],
                    stdin=subprocess.DEVNULL,
                )
        except BaseException:
            ours.close()
            raise
        ours.settimeout(self.timeout_s)
        return ours

    # ---- bytes -----------------------------------------------------------------------------------

    def send_bytes(self, data: bytes) -> None:
        """Sends bytes as they are. What arrives meanwhile is kept, so that two ends that both have
        much to say cannot wait for each other."""
        view = memoryview(data)
        try:
            while view:
                readable, writable = self._wait(writing=True)
                if readable:
                    self._receive_some()
                if writable:
                    view = view[self._send_some(view) :]
        except ConnectionLost:
            # A daemon that hangs up says why first: what it said is to be read before the loss.
            if not self._incoming:
                raise

    def receive_bytes(self, count: int) -> bytes | memoryview:
        """Exactly count bytes."""
        if count >= _LARGE_BYTES:
            return self._receive_large(count)
        while len(self._incoming) < count:
            self._wait(writing=False)
            self._receive_some()
        data = bytes(self._incoming[:count])
        del self._incoming[:count]
        return data

    def _receive_large(self, count: int) -> memoryview:
        """Nothing of it is copied but what has come already."""
        there = min(len(self._incoming), count)
        buffer = np.empty(count, np.uint8)
        buffer[:there] = memoryview(self._incoming)[:there]
        del self._incoming[:there]
        view = memoryview(buffer)
        while there < count:
            self._wait(writing=False)
            there += self._received(self.socket.recv_into, view[there:])
        return view.toreadonly()

    def receive_eof(self) -> bool:
        """Waits for the peer's next move: True when it closes, False when it sends something."""
        if self._incoming:
            return False
        self._wait(writing=False)
        try:
            self._receive_some()
        except ConnectionLost:
            return True
        return False

    def moves_by(self, time_s: float) -> bool:
        """Whether something comes before a moment of time.monotonic()."""
        wait_ms = max(time_s - time.monotonic(), 0) * 1000
        return bool(self._incoming or _poll(self.socket, select.POLLIN, wait_ms))

    def half_close(self) -> None:
        """Says that nothing more will be sent; the peer's answers can still be read."""
        self.socket.shutdown(socket.SHUT_WR)

    def _wait(self, writing: bool) -> tuple[bool, bool]:
        if self.socket.fileno() < 0:
            raise ConnectionLost(f"{self.address}: this client is closed", final=True)
        wanted = select.POLLIN | (select.POLLOUT if writing else 0)
        wait_ms = None if self.timeout_s is None else self.timeout_s * 1000
        events = _poll(self.socket, wanted, wait_ms)
        if not events:
            raise ConnectionLost(f"{self.address}: nothing moved for {self.timeout_s} s", final=True)
        readable = select.POLLIN | select.POLLHUP | select.POLLERR
        return bool(events & readable), bool(events & select.POLLOUT)

    def _send_some(self, data: memoryview) -> int:
        try:
            return self.socket.send(data, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise ConnectionLost(f"{self.address}: {error}") from error

    def _receive_some(self) -> None:
        self._incoming += self._received(self.socket.recv, _RECEIVE_BYTES)

    def _received(self, receive: Callable[[Any], Any], argument: Any) -> Any:
        """What a call that receives returns, unless it is the end."""
        try:
            received = receive(argument)
        except OSError as error:
            raise ConnectionLost(f"{self.address}: {error}") from error
        if not received:
            raise ConnectionLost(f"{self.address}: the daemon closed the connection")
        return received

    # ---- frames ----------------------------------------------------------------------------------

    def send_frame(
        self, type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0
    ) -> None:
        """Sends a header and a payload, whose length must be a multiple of 8."""
        header = header_bytes(type, request_id, len(payload), deadline_ms)
        if len(payload) < _LARGE_BYTES:
            self.send_bytes(header + payload)
        else:
            self.send_bytes(header)
            self.send_bytes(payload)

    def receive_frame(self) -> Frame:
        """The next frame, whatever its type."""
        header = wire.HEADER.unpack(self.receive_bytes(wire.HEADER.bytes))
        if header.magic != wire.MAGIC or header.version != wire.VERSION:
            raise ProtocolError(f"{self.address}: this is not a dipoled")
        return Frame(header.type, header.request_id, self.receive_bytes(header.payload_bytes))


def _several(text: str) -> list[str]:
    """A comma that no scheme follows is part of a path."""
    addresses = re.split(",(?=unix:|tcp:|private:)", text)
    if len(addresses) > 1 and any(address.startswith("private:") for address in addresses):
        raise AddressError(f"{text}: a private daemon is no address among others")
    return addresses


def header_bytes(type: int, request_id: int, payload_bytes: int, deadline_ms: int = 0) -> bytes:
    """The header of a frame."""
    return wire.HEADER.pack(
        magic=wire.MAGIC,
        version=wire.VERSION,
        type=type,
        request_id=request_id,
        payload_bytes=payload_bytes,
        deadline_ms=deadline_ms,
    )


def frame_bytes(type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0) -> bytes:
    """A whole frame."""
    return b"".join([header_bytes(type, request_id, len(payload), deadline_ms), payload])


def _poll(connection: socket.socket, wanted: int, wait_ms: float | None) -> int:
    """Waits for one socket; its events, 0 when there are none in time."""
    poll = select.poll()
    poll.register(connection, wanted)
    events = poll.poll(wait_ms)
    return events[0][1] if events else 0


def _find_daemon() -> str:
    """The dipoled beside the running program, else the one in $PATH."""
    beside = Path(sys.argv[0] or ".").resolve().parent / "dipoled"
    if os.access(beside, os.X_OK):
        return str(beside)
    found = shutil.which("dipoled")
    if found is None:
        raise FileNotFoundError("there is no dipoled beside this program or in $PATH")
    return found


def _end(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(_PRIVATE_EXIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
