"""The examples of proto/PROTOCOL.md, sent to a daemon as they stand there."""

from __future__ import annotations

import re

import pytest
from daemons import REPOSITORY
from dipole import Frame, Table, wire
from dipole.mc import unpack_result
from frames import assert_serves

DETERMINISTIC = [
    "eval",
    "parameter",
    "media",
    "ping",
    "mc",
    "cancel",
    "sample",
    "invert",
    "error",
]
NAMES = {
    "hello-request",
    "eval-request",
    "eval-reply",
    "parameter-request",
    "parameter-reply",
    "media-request",
    "ping-request",
    "ping-reply",
    "mc-request",
    "mc-reply",
    "cancel-request",
    "cancel-reply",
    "table-request",
    "offers-request",
    "sample-request",
    "sample-reply",
    "invert-request",
    "invert-reply",
    "error-request",
    "error-reply",
    "statistics-request",
}


# Types of requests by the names of examples, which are the messages' but for a second eval.
TYPES = {**wire.MESSAGES, "parameter": wire.MESSAGES["eval"]}


def read_examples() -> dict[str, bytes]:
    """The frames in blocks ```hex NAME: pairs of digits, and comments from # to the line's end."""
    text = (REPOSITORY / "proto/PROTOCOL.md").read_text()
    examples = {}
    for name, body in re.findall(r"^```hex ([\w-]+)\n(.*?)^```", text, re.M | re.S):
        assert name not in examples, name
        examples[name] = bytes.fromhex(re.sub(r"#.*", "", body))
    return examples


EXAMPLES = read_examples()
REQUESTS = sorted(name for name in EXAMPLES if name.endswith("-request"))


def test_all_examples_are_there():
    assert NAMES <= set(EXAMPLES)


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_example_is_one_whole_frame(name):
    data = EXAMPLES[name]
    header = wire.HEADER.unpack(data)
    assert (header.magic, header.version, header.deadline_ms) == (wire.MAGIC, wire.VERSION, 0)
    assert len(data) == wire.HEADER.bytes + header.payload_bytes
    message = name.split("-")[0]
    if name == "error-reply":
        assert header.type == wire.TYPE_ERROR
    elif name.endswith("-reply"):
        assert header.type == TYPES[message] | wire.REPLY
    elif message != "error":
        assert header.type == TYPES[message]


def frame_bytes(reply: Frame) -> bytes:
    """A received frame as it came."""
    header = wire.HEADER.pack(
        magic=wire.MAGIC,
        version=wire.VERSION,
        type=reply.type,
        request_id=reply.request_id,
        payload_bytes=len(reply.payload),
        deadline_ms=0,
    )
    return header + reply.payload


def is_progress(reply: Frame) -> bool:
    """Whether more replies to the same request follow."""
    if reply.type != wire.MESSAGES["mc"] | wire.REPLY:
        return False
    return wire.MC_REPLY.unpack(reply.payload).state == wire.MC_UNDER_WAY


@pytest.mark.parametrize("name", REQUESTS)
def test_request_is_answered_as_documented(connection, name):
    message = name.removesuffix("-request")
    connection.send_bytes(EXAMPLES[name])
    reply = connection.receive_frame()
    while is_progress(reply):
        reply = connection.receive_frame()
    assert reply.request_id == wire.HEADER.unpack(EXAMPLES[name]).request_id
    if message == "error":
        assert reply.type == wire.TYPE_ERROR
    else:
        assert reply.type == TYPES[message] | wire.REPLY
    documented = EXAMPLES.get(f"{message}-reply")
    if message in DETERMINISTIC and documented is not None:
        assert frame_bytes(reply).hex(" ") == documented.hex(" ")
    STRUCTURE[message](reply.payload)
    assert_serves(connection)


def check_hello(payload: bytes) -> None:
    fixed = wire.HELLO_REPLY.unpack(payload)
    lists_bytes = fixed.choice_count * wire.CHOICE.bytes + fixed.limit_count * wire.VALUE.bytes
    assert len(payload) == wire.HELLO_REPLY.bytes + lists_bytes
    assert fixed.version == 1 and fixed.choice_count > 0 and fixed.limit_count > 0


def check_eval(payload: bytes) -> None:
    fixed = wire.EVAL_REPLY.unpack(payload)
    assert fixed.channel_count >= 1
    channel = wire.CHANNEL.unpack(payload, wire.EVAL_REPLY.bytes)
    assert 0 <= channel.numerical_error < 1


def check_list(entry: wire.Structure):
    def check(payload: bytes) -> None:
        fixed = wire.LIST_REPLY.unpack(payload)
        assert fixed.count > 0 and fixed.zero == 0
        assert len(payload) == wire.LIST_REPLY.bytes + fixed.count * entry.bytes
        for i in range(fixed.count):
            assert entry.unpack(payload, wire.LIST_REPLY.bytes + i * entry.bytes).name

    return check


def check_ping(payload: bytes) -> None:
    assert len(payload) % wire.ALIGNMENT == 0


def check_mc(payload: bytes) -> None:
    result = unpack_result(payload)
    assert result.state == "photons" and len(result.energies) == len(result.values) == 1


def check_cancel(payload: bytes) -> None:
    assert wire.CANCEL_REPLY.unpack(payload) == (0, 0)


def check_table(payload: bytes) -> None:
    header = wire.HEADER.pack(
        magic=wire.MAGIC,
        version=wire.VERSION,
        type=TYPES["table"] | wire.REPLY,
        request_id=0,
        payload_bytes=len(payload),
        deadline_ms=0,
    )
    table = Table(header + payload)
    assert table.medium == (0.032, 0.74, 0.0, 1.3) and table.numerical_error_constant <= 1e-3


def check_offers(payload: bytes) -> None:
    fixed = wire.OFFERS_REPLY.unpack(payload)
    assert len(payload) == wire.OFFERS_REPLY.bytes + fixed.count * wire.OFFER.bytes
    assert fixed.taken < fixed.count


def check_invert(payload: bytes) -> None:
    fixed = wire.INVERT_REPLY.unpack(payload)
    assert len(payload) == wire.INVERT_REPLY.bytes + 3 * 8 * fixed.medium_count
    assert fixed.missing_count == 0 and fixed.albedo_least < fixed.albedo_most


def check_error(payload: bytes) -> None:
    assert len(payload) == wire.ERROR.bytes
    error = wire.ERROR.unpack(payload)
    assert error.status in wire.STATUSES and error.field and error.allowed


STRUCTURE = {
    "hello": check_hello,
    "eval": check_eval,
    "parameter": check_eval,
    "media": check_list(wire.MEASURED_MEDIUM),
    "statistics": check_list(wire.VALUE),
    "ping": check_ping,
    "mc": check_mc,
    "cancel": check_cancel,
    "table": check_table,
    "offers": check_offers,
    "sample": check_eval,
    "invert": check_invert,
    "error": check_error,
}
