"""Whole frames over a connection, both ways, for asyncio."""

from __future__ import annotations

import asyncio
import socket
import time

import numpy as np

from . import wire
from .connection import Connection, Frame, header_bytes
from .errors import ConnectionLost, ProtocolError

_RECEIVE_BYTES = 1 << 18  # at a time; a payload that is larger is received to where it stays


class AsyncStream:
    """Takes over a connection; belongs to one event loop. One task reads; any number write."""

    def __init__(self, connection: Connection):
        self.connection = connection
        self.moved_s = time.monotonic()  # when a byte last came
        self._loop = asyncio.get_running_loop()
        self._incoming = bytearray()
        self._sending = asyncio.Lock()
        self._sends: set[asyncio.Task[None]] = set()
        self._closed = False
        connection.socket.setblocking(False)

    @property
    def address(self) -> str:
        return self.connection.address

    async def close(self) -> None:
        """Closes the connection; a private daemon ends with it. Nobody may be reading."""
        self._closed = True
        try:  # sends that wait for room end by themselves, and those who wait for them go on
            self.connection.socket.shutdown(socket.SHUT_RDWR)
        except OSError:
            pass
        await asyncio.gather(*self._sends)
        await asyncio.to_thread(self.connection.close)

    # ---- sending ---------------------------------------------------------------------------------

    async def send_frame(
        self, type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0
    ) -> None:
        """Sends a frame, whole even if the caller is cancelled. A loss is for who reads to meet."""
        if self._closed:
            return
        header = header_bytes(type, request_id, len(payload), deadline_ms)
        send = asyncio.create_task(self._send(header, payload))
        self._sends.add(send)
        send.add_done_callback(self._sends.discard)
        await asyncio.shield(send)

    async def _send(self, header: bytes, payload: bytes) -> None:
        async with self._sending:
            try:
                if len(payload) < _RECEIVE_BYTES:
                    await self._loop.sock_sendall(self.connection.socket, header + payload)
                else:
                    await self._loop.sock_sendall(self.connection.socket, header)
                    await self._loop.sock_sendall(self.connection.socket, payload)
            except OSError:
                pass

    # ---- receiving -------------------------------------------------------------------------------

    async def receive_frame(self) -> Frame:
        """The next frame, whatever its type."""
        await self._fill(wire.HEADER.bytes)
        header = wire.HEADER.unpack(self._take(wire.HEADER.bytes))
        if header.magic != wire.MAGIC or header.version != wire.VERSION:
            raise ProtocolError(f"{self.address}: this is not a dipoled")
        if header.payload_bytes >= _RECEIVE_BYTES:
            payload = await self._receive_large(header.payload_bytes)
        else:
            await self._fill(header.payload_bytes)
            payload = self._take(header.payload_bytes)
        return Frame(header.type, header.request_id, payload)

    def _take(self, count: int) -> bytes:
        data = bytes(memoryview(self._incoming)[:count])
        del self._incoming[:count]
        return data

    async def _fill(self, count: int) -> None:
        """Until so many bytes are there."""
        while len(self._incoming) < count:
            try:
                data = await self._loop.sock_recv(self.connection.socket, _RECEIVE_BYTES)
            except OSError as error:
                raise ConnectionLost(f"{self.address}: {error}") from error
            self._note(len(data))
            self._incoming += data

    async def _receive_large(self, count: int) -> memoryview:
        buffer = np.empty(count, np.uint8)
        there = min(len(self._incoming), count)
        buffer[:there] = np.frombuffer(self._take(there), np.uint8)
        view = memoryview(buffer)
        while there < count:
            try:
                got = await self._loop.sock_recv_into(self.connection.socket, view[there:])
            except OSError as error:
                raise ConnectionLost(f"{self.address}: {error}") from error
            self._note(got)
            there += got
        return view.toreadonly()

    def _note(self, count: int) -> None:
        if count == 0:
            raise ConnectionLost(f"{self.address}: the daemon closed the connection")
        self.moved_s = time.monotonic()
