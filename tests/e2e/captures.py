"""Recorded conversations as capture files, such as a sniffer between two machines would write."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import NamedTuple

_PCAP_MAGIC, _LINKTYPE_IPV4 = 0xA1B2C3D4, 228
_CLIENT, _SERVER, _CLIENT_PORT = bytes([192, 0, 2, 1]), bytes([192, 0, 2, 2]), 49152
_TCP, _ACK_AND_PUSH = 6, 0x18


class Exchange(NamedTuple):
    """What a client sent, and what came back."""

    sent: bytes
    received: bytes


def write_capture(path: Path, exchanges: list[Exchange], port: int) -> None:
    """A TCP connection to the port, whose every message has a packet of its own."""
    packets = []
    client_at = server_at = 1
    for exchange in exchanges:
        ports = (_CLIENT_PORT, port)
        packets.append(_packet(_CLIENT, _SERVER, ports, client_at, server_at, exchange.sent))
        client_at += len(exchange.sent)
        ports = (port, _CLIENT_PORT)
        packets.append(_packet(_SERVER, _CLIENT, ports, server_at, client_at, exchange.received))
        server_at += len(exchange.received)
    header = struct.pack("<IHHiIII", _PCAP_MAGIC, 2, 4, 0, 0, 65535, _LINKTYPE_IPV4)
    records = [
        struct.pack("<IIII", i // 1000, i % 1000 * 1000, len(packet), len(packet)) + packet
        for i, packet in enumerate(packets)
    ]
    path.write_bytes(header + b"".join(records))


def _packet(
    source: bytes, target: bytes, ports: tuple[int, int], at: int, acknowledged: int, data: bytes
) -> bytes:
    tcp = struct.pack(">HHIIBBHHH", *ports, at, acknowledged, 5 << 4, _ACK_AND_PUSH, 65535, 0, 0)
    length = 20 + len(tcp) + len(data)
    ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, length, 0, 0, 64, _TCP, 0, source, target)
    ip = ip[:10] + struct.pack(">H", _checksum(ip)) + ip[12:]
    return ip + tcp + data


def _checksum(header: bytes) -> int:
    total = sum(struct.unpack(f">{len(header) // 2}H", header))
    while total > 0xFFFF:
        total = (total & 0xFFFF) + (total >> 16)
    return ~total & 0xFFFF
