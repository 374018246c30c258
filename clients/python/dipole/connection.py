"""A connection to a dipoled: reads addresses, starts a private daemon, and moves whole frames."""

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
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from . import wire
from .errors import AddressError, ConnectError, ConnectionLost, ProtocolError
from .values import Array

T = TypeVar("T")

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
        self._header: Any = None  # header of the frame whose payload is awaited

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
    certificate, key: the client's, if daemons request one; None means $DIPOLED_CERTIFICATE
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
        for path in filter(None, (ca, certificate, key)):  # ssl does not say which file is missing
            open(path, "rb").close()
        context = ssl.create_default_context(cafile=ca)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        if self.key is not None and certificate is None:
            raise ConnectError(f"the key {key} is given without a certificate", final=True)
        if certificate is not None:
            try:  # Without a password here, OpenSSL would request one at the terminal.
                context.load_cert_chain(certificate, key, password="-")
            except ssl.SSLError as error:
                text = f"the key {key or certificate} is not that of {certificate}, in PEM without a password"
                raise ConnectError(f"{text} (openssl pkey): {error}", final=True) from error
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
        self.address = usual_address() if address is None else address
        self._tls = tls
        self.timeout_s = timeout_s
        self.is_one_of_several = False  # whether a client may leave a silent daemon for another
        self.incoming = Incoming()
        self.unsent: deque[memoryview] = deque()
        self.is_fresh = False  # whether nobody has tried yet to send the last of the unsent bytes
        self.torn = False  # True while bytes move, and after an exception in the middle of that
        self._owner = os.getpid()
        self._process: subprocess.Popen[bytes] | None = None
        self.socket = self._open()
        self.socket.setblocking(False)

    def __enter__(self) -> Connection:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def name(self) -> str:
        """The address as errors begin with it, before a colon."""
        return self.address.removesuffix(":")

    def silent(self) -> ConnectionLost:
        """Says that the daemon was silent for timeout_s, and what can be done about it."""
        text = f"{self.name}: nothing moved for {self.timeout_s:g} s. The daemon may still be at work"
        return ConnectionLost(
            f"{text}: a larger timeout_s waits longer", final=not self.is_one_of_several
        )

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
        """Ends the connection, even where a forked process holds the socket, too; but not there."""
        if self.is_ours():
            with contextlib.suppress(OSError):
                shut_down(self.socket, socket.SHUT_RDWR)

    def is_ours(self) -> bool:
        """Whether this process opened the connection, and not one that it was forked from."""
        return self._owner == os.getpid()

    def check_owner(self) -> None:
        """Raises ConnectionLost in a forked process, which would take replies of its parent."""
        if not self.is_ours():
            text = f"process {self._owner} opened this client: after a fork, open one in each process"
            raise ConnectionLost(f"{self.name}: {text}", final=True)

    def check_usable(self) -> None:
        """Raises ConnectionLost in a forked process, and after a call that was torn."""
        self.check_owner()
        if self.torn:
            text = "an exception, such as an interrupt, has ended a call in the middle of a frame"
            raise ConnectionLost(f"{self.name}: {text}")

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
            # bad certificates, or a peer without TLS
            final = isinstance(error, ssl.SSLError) and not ended
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
                    process_group=0,  # the interrupt key then does not end the daemon first
                )
        except BaseException:
            ours.close()
            raise
        return ours

    # ---- bytes -----------------------------------------------------------------------------------

    def put(self, pieces: Iterable[bytes | memoryview]) -> None:
        """Adds bytes to those that move() sends."""
        for data in pieces:
            self.unsent.append(memoryview(data))
            self.is_fresh = True

    def events(self, wait_s: float | None) -> int:
        """Waits until the socket can be read, or written to if there is something to send. Returns
        its events, or 0 if there are none within wait_s."""
        self.check_owner()
        if self.is_closed:
            raise ConnectionLost(f"{self.name}: this client is closed", final=True)
        if self.has_read():
            return select.POLLIN
        return _poll(self.socket, self.wanted(), None if wait_s is None else wait_s * 1000)

    def wanted(self) -> int:
        """Returns the events that matter."""
        return select.POLLIN | (select.POLLOUT if self.unsent else 0)

    def has_read(self) -> bool:
        """Returns whether TLS has read bytes that move() can take."""
        return isinstance(self.socket, ssl.SSLSocket) and self.socket.pending() > 0

    def move(self, events: int) -> None:
        """Receives and sends what is possible at once, after these events."""
        self.torn = True
        try:
            if events & ~select.POLLOUT:
                self._receive()
            if events & select.POLLOUT:
                self._send()
        except ConnectionLost:  # Frames received before the loss can still be read.
            self.torn = False
            raise
        self.torn = False

    def _receive(self) -> None:
        try:
            count = self.socket.recv_into(self.incoming.room())
        except WAITS:
            return
        except OSError as error:  # If the daemon refuses the certificate, that is final.
            refused = isinstance(error, ssl.SSLError) and "ALERT" in (error.reason or "")
            does = "requires a" if "REQUIRED" in str(error) else "refuses this client's"
            why = f"the daemon {does} certificate: " if refused else ""
            raise ConnectionLost(f"{self.name}: {why}{error}", final=refused) from error
        if count == 0:
            raise ConnectionLost(f"{self.name}: the daemon closed the connection")
        self.incoming.add(count)

    def _send(self) -> None:
        self.is_fresh = False
        try:
            while self.unsent:
                sent = self.socket.send(self.unsent[0])
                self.unsent[0] = self.unsent[0][sent:]
                if self.unsent[0]:
                    break
                self.unsent.popleft()
        except WAITS:
            pass
        except OSError as error:
            self.unsent.clear()
            with contextlib.suppress(ConnectionLost):
                self._receive()  # A daemon sends the reason before it hangs up.
            if not self.incoming:
                raise ConnectionLost(f"{self.name}: {error}") from error

    def _move_until(self, done: Callable[[], T | None]) -> T:
        """Moves bytes until done() returns something."""
        self.check_usable()
        while (found := done()) is None:
            events = self.events(self.timeout_s)
            if not events:
                raise self.silent()
            self.move(events)
        return found

    def send_bytes(self, data: bytes) -> None:
        """Sends all the bytes, and meanwhile buffers what arrives. If neither end read while it
        sends, both could wait for each other forever."""
        self.put([data])
        self._move_until(lambda: None if self.unsent else True)

    def receive_bytes(self, count: int) -> bytes | memoryview:
        """Waits for exactly count bytes."""
        return self._move_until(lambda: self.incoming.take(count))

    def receive_eof(self) -> bool:
        """Waits until the peer closes the connection (returns True) or sends a byte (False)."""
        try:
            return self._move_until(lambda: False if self.incoming else None)
        except ConnectionLost as lost:
            if lost.final:
                raise
            return True

    def half_close(self) -> None:
        """Ends the side that sends. Its replies can still be read."""
        shut_down(self.socket, socket.SHUT_WR)

    # ---- frames ----------------------------------------------------------------------------------

    def send_frame(
        self, type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0
    ) -> None:
        """Sends a header and a payload, whose length must be a multiple of 8."""
        self.put(frame_pieces(type, request_id, payload, deadline_ms))
        self._move_until(lambda: None if self.unsent else True)

    def receive_frame(self) -> Frame:
        """Waits for the next frame, whatever its type."""
        return self._move_until(self.take_frame)

    def take_frame(self, give: Callable[[Frame], object] | None = None) -> Frame | None:
        """Returns the next frame, or None if it has not been received completely. give: is called
        with it; if that raises an exception, the connection is given up."""
        self.torn = True
        frame = self.incoming.take_frame()
        if frame is not None and give is not None:
            give(frame)
        self.torn = False
        return frame


# Exceptions of a socket that has to wait.
WAITS = (BlockingIOError, ssl.SSLWantReadError, ssl.SSLWantWriteError)


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
        if found is not None and os.path.isfile(found) and os.access(found, os.X_OK):
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
