"""A connection to a dipoled: reads addresses, starts a private daemon, and sends and receives whole
frames."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import select
import shutil
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from . import wire
from .errors import AddressError, ConnectError, ConnectionLost, ProtocolError
from .values import Array

LARGE_BYTES = 1 << 18  # A payload of this size or more is received and sent without a copy.
_PRIVATE_EXIT_S = 10.0


class Frame(NamedTuple):
    """A frame as received: the header's fields and the payload."""

    type: int
    request_id: int
    payload: bytes | memoryview  # a read-only view if it has LARGE_BYTES or more


class Incoming:
    """A buffer of received bytes, which are taken out in pieces of known length. It does not read
    the socket itself: the caller receives bytes into room() and then calls add()."""

    def __init__(self) -> None:
        self._bytes = bytearray()
        self._spare = memoryview(bytearray(LARGE_BYTES))
        self._large: Array | None = None  # the large piece that is being received
        self._large_bytes = 0  # how many bytes of the large piece have been received
        self._header: Any = None  # of the frame whose payload comes next

    def __bool__(self) -> bool:
        return len(self._bytes) > 0 or self._large is not None

    def room(self) -> memoryview:
        """Returns the memory into which the caller receives the next bytes."""
        return self._spare if self._large is None else self._large.data[self._large_bytes :]

    def add(self, count: int) -> None:
        """Adds the first count bytes of room(), which the caller has received, to the buffer."""
        if self._large is None:
            self._bytes += self._spare[:count]
        else:
            self._large_bytes += count

    def take(self, count: int) -> bytes | memoryview | None:
        """Takes out the next count bytes. Returns None if they have not all been received."""
        if count < LARGE_BYTES:
            if len(self._bytes) < count:
                return None
            data = bytes(memoryview(self._bytes)[:count])
            del self._bytes[:count]
            return data
        if self._large is None:
            self._large = np.empty(count, np.uint8)
            self._large_bytes = min(len(self._bytes), count)
            self._large[: self._large_bytes] = memoryview(self._bytes)[: self._large_bytes]
            del self._bytes[: self._large_bytes]
        if self._large_bytes < count:
            return None
        view, self._large = self._large.data.toreadonly(), None
        return view

    def take_frame(self) -> Frame | None:
        """Takes out the next frame. Returns None if it has not been received completely."""
        if self._header is None:
            data = self.take(wire.HEADER.bytes)
            if data is None:
                return None
            self._header = wire.HEADER.unpack(data)
            if (self._header.magic, self._header.version) != (wire.MAGIC, wire.VERSION):
                raise ProtocolError("the peer is not a dipoled")
        payload = self.take(self._header.payload_bytes)
        if payload is None:
            return None
        header, self._header = self._header, None
        return Frame(header.type, header.request_id, payload)


class Tls(NamedTuple):
    """Files in PEM format for tls: addresses.

    ca: the certificates that sign the daemon's; None means $DIPOLED_CA if that is set, else those of
        the system.
    certificate, key: the client's own, for daemons that ask for one; None means $DIPOLED_CERTIFICATE
        and $DIPOLED_KEY. A missing key is in the certificate's file.
    """

    ca: str | None = None
    certificate: str | None = None
    key: str | None = None

    def context(self) -> ssl.SSLContext:
        """Reads the files."""
        ca = self.ca or os.environ.get("DIPOLED_CA") or None
        certificate = self.certificate or os.environ.get("DIPOLED_CERTIFICATE") or None
        key = self.key or os.environ.get("DIPOLED_KEY") or None
        context = ssl.create_default_context(cafile=ca)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        if certificate is not None:

            def refuse() -> str:  # Without this, OpenSSL would ask for a password at the terminal.
                text = "has a password: give a key without one, as openssl pkey writes it"
                raise ConnectError(f"the key {key or certificate} {text}", final=True)

            context.load_cert_chain(certificate, key, password=refuse)
        return context


class Connection:
    """One connection. It does not know what the messages mean.

    address: unix:PATH, tcp:HOST:PORT or tls:HOST:PORT ([::1]:PORT for IPv6), private: or
        private:PROGRAM. None means
        $DIPOLED if that is set, else private:, which starts a daemon that ends with the connection.
        Unlike a Client, a Connection takes a single address.
    timeout_s: how long a call waits while no byte is sent or received, and how long connecting may
        take; None means no limit.
    tls: files for a tls: address.
    """

    def __init__(
        self,
        address: str | None = None,
        timeout_s: float | None = 30.0,
        tls: Tls = Tls(),  # noqa: B008  (it cannot be changed)
    ):
        self.address = address or usual_address()
        self._tls = tls
        self.timeout_s = timeout_s
        self.is_one_of_several = False  # whether a client may leave a silent daemon for another
        self.incoming = Incoming()
        self.torn = False  # True while a frame moves, and after an exception in the middle of one
        self._owner = os.getpid()
        self._process: subprocess.Popen[bytes] | None = None
        self.socket = self._open()

    def __enter__(self) -> Connection:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def name(self) -> str:
        """The address as errors begin with it, before a colon."""
        return self.address.removesuffix(":")

    def silent_text(self, timeout_s: float) -> str:
        """Says that the daemon was silent for so long, and what can be done about it."""
        return (
            f"{self.name}: nothing moved for {timeout_s:g} s. The daemon may still be at work: "
            "a larger timeout_s waits longer"
        )

    @property
    def is_private(self) -> bool:
        """Whether the daemon was started for this connection."""
        return self.address.startswith("private:")

    @property
    def is_closed(self) -> bool:
        return self.socket.fileno() < 0

    def close(self) -> None:
        """Closes the connection and waits until a private daemon has ended. A forked process only
        closes its copy of the socket."""
        self.hang_up()
        self.socket.close()
        if self._process is not None and self.is_ours():
            _end(self._process)
        self._process = None

    def hang_up(self) -> None:
        """Ends the connection, even where a forked process holds the socket, too; but not in such a
        process."""
        if self.is_ours():
            with contextlib.suppress(OSError):
                shut_down(self.socket, socket.SHUT_RDWR)

    def is_ours(self) -> bool:
        """Whether this process opened the connection, and not one that it was forked from."""
        return self._owner == os.getpid()

    def check_owner(self) -> None:
        """Raises ConnectionLost in a forked process, which would take answers of its parent."""
        if not self.is_ours():
            text = f"process {self._owner} opened this client: after a fork, open one in each process"
            raise ConnectionLost(f"{self.name}: {text}", final=True)

    def check_usable(self) -> None:
        """Raises ConnectionLost in a forked process, and after a call that was torn."""
        self.check_owner()
        if self.torn:
            text = "an exception, such as an interrupt, has ended a call in the middle of a frame"
            raise ConnectionLost(f"{self.name}: {text}")

    def set_timeout_s(self, timeout_s: float | None) -> None:
        self.timeout_s = timeout_s
        if not isinstance(self.socket, ssl.SSLSocket):
            self.socket.settimeout(timeout_s)

    # ---- connecting ------------------------------------------------------------------------------

    def _open(self) -> socket.socket:
        scheme, colon, rest = self.address.partition(":")
        try:
            if colon and scheme == "unix" and rest:
                return self._open_unix(rest)
            if colon and scheme == "tcp":
                return self._open_tcp(rest)
            if colon and scheme == "tls":
                return self._open_tls(rest)
            if colon and scheme == "private":
                return self._open_private(rest or _find_daemon())
        except (OSError, subprocess.SubprocessError) as error:
            ended = isinstance(error, (ssl.SSLZeroReturnError, ssl.SSLEOFError))
            final = isinstance(error, ssl.SSLError) and not ended  # certificates, or no TLS there
            final |= isinstance(error, ConnectError) and error.final
            plain = isinstance(error, ssl.SSLError) and error.reason == "WRONG_VERSION_NUMBER"
            text = "no TLS is spoken at this port: is it a tcp: address?" if plain else error
            raise ConnectError(f"{self.name}: {text}", final=final) from error
        raise AddressError(
            f"{self.name}: not one of unix:PATH, tcp:HOST:PORT, tls:HOST:PORT, private:, "
            "private:PROGRAM"
        )

    def _open_unix(self, path: str) -> socket.socket:
        connection = _above_standard(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
        try:
            connection.settimeout(self.timeout_s)
            connection.connect(path)
        except OSError:
            connection.close()
            raise
        return connection

    def _open_tls(self, host_and_port: str) -> socket.socket:
        context = self._tls.context()
        connection = self._open_tcp(host_and_port)
        try:
            host = host_and_port.rpartition(":")[0].removeprefix("[").removesuffix("]")
            wrapped = context.wrap_socket(connection, server_hostname=host)
        except OSError:
            connection.close()
            raise
        wrapped.setblocking(False)  # A record may be incomplete when the socket can be read.
        return wrapped

    def _open_tcp(self, host_and_port: str) -> socket.socket:
        if re.search("[ \t,;]", host_and_port):
            raise AddressError(
                f"{self.name}: several addresses have nothing but a comma between them, as in "
                "tcp:HOST:PORT,tcp:HOST:PORT"
            )
        host, _, port = host_and_port.rpartition(":")
        if host.startswith("[") and host.endswith("]"):
            host = host[1:-1]
        if not host or not port.isascii() or not port.isdigit() or not 0 < int(port) < 65536:
            scheme = self.address.partition(":")[0]
            raise AddressError(f"{self.name}: not {scheme}:HOST:PORT")
        connection = _above_standard(socket.create_connection((host, int(port)), self.timeout_s))
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return connection

    def _open_private(self, program: str) -> socket.socket:
        """Starts a daemon. It logs only errors, to the standard error of this program."""
        pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
        ours, theirs = map(_above_standard, pair)
        try:
            with theirs:
                self._process = subprocess.Popen(
                    [program, "--fd", str(theirs.fileno()), "--log-level", "error"],
                    pass_fds=[theirs.fileno()],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    process_group=0,  # so that the interrupt key does not end the daemon first
                )
        except BaseException:
            ours.close()
            raise
        ours.settimeout(self.timeout_s)
        return ours

    # ---- bytes -----------------------------------------------------------------------------------

    def send_bytes(self, data: bytes) -> None:
        """Sends all the bytes, and meanwhile buffers what arrives. If neither end read while it
        sends, both could wait for each other forever."""
        view = memoryview(data)
        try:
            while view:
                readable, writable = self._wait(writing=True)
                if readable:
                    self._receive_some()
                if writable:
                    view = view[self._send_some(view) :]
        except ConnectionLost:
            # A daemon sends the reason before it hangs up: the caller reads that first.
            if not self.incoming:
                raise

    def receive_bytes(self, count: int) -> bytes | memoryview:
        """Waits for exactly count bytes."""
        while (data := self.incoming.take(count)) is None:
            self._receive()
        return data

    def receive_eof(self) -> bool:
        """Waits until the peer closes the connection (returns True) or sends a byte (False)."""
        if self.incoming:
            return False
        try:
            self._receive()
        except ConnectionLost as lost:
            if lost.final:
                raise
            return True
        return False

    def arrives_by(self, time_s: float) -> bool:
        """Waits for a byte until the time time_s, as of time.monotonic(). Returns whether one
        came."""
        self.check_usable()
        wait_ms = max(time_s - time.monotonic(), 0) * 1000
        pending = isinstance(self.socket, ssl.SSLSocket) and self.socket.pending() > 0
        return bool(self.incoming or pending or _poll(self.socket, select.POLLIN, wait_ms))

    def half_close(self) -> None:
        """Tells the peer that nothing more is sent. Its answers can still be read."""
        shut_down(self.socket, socket.SHUT_WR)

    def _wait(self, writing: bool) -> tuple[bool, bool]:
        self.check_owner()
        if self.is_closed:
            raise ConnectionLost(f"{self.name}: this client is closed", final=True)
        if isinstance(self.socket, ssl.SSLSocket) and self.socket.pending() > 0:
            return True, writing
        wanted = select.POLLIN | (select.POLLOUT if writing else 0)
        wait_ms = None if self.timeout_s is None else self.timeout_s * 1000
        events = _poll(self.socket, wanted, wait_ms)
        if not events:
            text = self.silent_text(self.timeout_s or 0)
            raise ConnectionLost(text, final=not self.is_one_of_several)
        readable = select.POLLIN | select.POLLHUP | select.POLLERR
        return bool(events & readable), bool(events & select.POLLOUT)

    def _send_some(self, data: memoryview) -> int:
        try:
            if isinstance(self.socket, ssl.SSLSocket):
                return self.socket.send(data)
            return self.socket.send(data, socket.MSG_DONTWAIT)
        except (BlockingIOError, *TLS_WAITS):
            return 0
        except OSError as error:
            raise ConnectionLost(f"{self.name}: {error}") from error

    def _receive(self) -> None:
        self._wait(writing=False)
        self._receive_some()

    def _receive_some(self) -> None:
        is_sending, self.torn = self.torn, True
        try:
            self.received(self.socket.recv_into(self.incoming.room()))
        except TLS_WAITS:
            pass
        except ConnectionLost:  # Frames that came before may still be taken.
            self.torn = is_sending
            raise
        except OSError as error:
            self.torn = is_sending
            raise self.lost(error) from error
        self.torn = is_sending

    def lost(self, error: OSError) -> ConnectionLost:
        """Says that receiving has failed. If the daemon refuses the certificate, that is final."""
        refused = isinstance(error, ssl.SSLError) and "ALERT" in (error.reason or "")
        why = "the daemon refuses this client's certificate: " if refused else ""
        return ConnectionLost(f"{self.name}: {why}{error}", final=refused)

    def received(self, count: int) -> None:
        """Buffers the first count bytes of incoming.room(). Raises ConnectionLost if count is 0:
        the daemon has closed the connection."""
        if count == 0:
            raise ConnectionLost(f"{self.name}: the daemon closed the connection")
        self.incoming.add(count)

    # ---- frames ----------------------------------------------------------------------------------

    def send_frame(
        self, type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0
    ) -> None:
        """Sends a header and a payload, whose length must be a multiple of 8."""
        self.check_usable()
        self.torn = True
        try:
            for data in frame_pieces(type, request_id, payload, deadline_ms):
                self.send_bytes(data)
        except ConnectionLost:  # Frames that came before may still be received.
            self.torn = False
            raise
        self.torn = False

    def receive_frame(self, give: Callable[[Frame], object] | None = None) -> Frame:
        """Waits for the next frame, whatever its type. give: is called with it; if that raises an
        exception, the connection is given up."""
        self.check_usable()
        while True:
            self.torn = True
            frame = self.incoming.take_frame()
            if frame is not None and give is not None:
                give(frame)
            self.torn = False
            if frame is not None:
                return frame
            self._receive()


# What a socket with TLS raises when it has to wait.
TLS_WAITS = (ssl.SSLWantReadError, ssl.SSLWantWriteError)


def frame_pieces(
    type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0
) -> list[bytes]:
    """Makes a frame: one piece, or header and payload apart if the payload is too large to copy."""
    header = wire.HEADER.pack(
        magic=wire.MAGIC,
        version=wire.VERSION,
        type=type,
        request_id=request_id,
        payload_bytes=len(payload),
        deadline_ms=deadline_ms,
    )
    return [header + payload] if len(payload) < LARGE_BYTES else [header, payload]


def _above_standard(connection: socket.socket) -> socket.socket:
    """Returns the socket under a number that is none of a standard stream, which the program may
    have closed: what it writes there must not get into the socket."""
    if connection.fileno() > 2:
        return connection
    with connection:
        number = fcntl.fcntl(connection, fcntl.F_DUPFD_CLOEXEC, 3)
        moved = socket.socket(fileno=number)
        moved.settimeout(connection.gettimeout())
    return moved


def shut_down(connection: socket.socket, how: int) -> None:
    """Shuts a socket down. The method of one with TLS would end TLS in both directions."""
    socket.socket.shutdown(connection, how)


def usual_address() -> str:
    """Returns the address, or the addresses, that are meant where none is given."""
    return os.environ.get("DIPOLED") or "private:"


def _poll(connection: socket.socket, wanted: int, wait_ms: float | None) -> int:
    """Waits for events of one socket. Returns them, or 0 if there are none within wait_ms."""
    poll = select.poll()
    poll.register(connection, wanted)
    events = poll.poll(wait_ms)
    return events[0][1] if events else 0


def built(name: str) -> Path | None:
    """Returns a file in build/ of the repository that holds this module, if there is one."""
    folder = Path(__file__).resolve().parent
    in_clone = folder.parts[-3:] == ("clients", "python", "dipole")
    path = folder.parents[2] / "build" / name
    return path if in_clone and path.exists() else None


def _find_daemon() -> str:
    """Finds the dipoled beside the running program, else the one in $PATH, else the one in build/
    of the repository that holds this module."""
    beside = Path(sys.argv[0] or ".").resolve().parent / "dipoled"
    for found in (beside, shutil.which("dipoled"), built("dipoled")):
        if found is not None and os.access(found, os.X_OK):
            return str(found)
    raise FileNotFoundError(
        "there is no dipoled beside this program, in $PATH, or in build/ of the module's repository"
    )


def _end(process: subprocess.Popen[bytes]) -> None:
    try:
        process.wait(_PRIVATE_EXIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
