"""Sends the examples in proto/PROTOCOL.md to a daemon, as the document has them."""


import numpy as np
import pytest
from dipole import Table, wire
from frames import SKIN, assert_serves, frame
from lists import QUANTITIES
from messages import EXAMPLES

# The requests whose documented replies are compared byte by byte.
DETERMINISTIC = {
    "eval", "ping", "mc", "cancel", "sample", "invert", "varying", "points", "gather", "error",
    "fit_layers", "tissue", "fit_tissue",
}
# The types of requests by the names of examples, which are the names of messages and one more.
TYPES = {**wire.MESSAGES, "error": wire.MESSAGES["eval"]}


PING_REPLY = wire.MESSAGES["ping"] | wire.REPLY
REQUESTS = sorted(name for name in EXAMPLES if name.endswith("-request"))


def payload_of(name: str) -> bytes:
    return EXAMPLES[name][wire.HEADER.bytes :]


def test_all_examples_are_there():
    assert {f"{name}-request" for name in TYPES} <= set(EXAMPLES)
    assert {f"{name}-reply" for name in DETERMINISTIC} <= set(EXAMPLES)


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_example_is_one_whole_frame(name):
    message, kind = name.rsplit("-", 1)
    header = wire.HEADER.unpack(EXAMPLES[name])
    expected = {
        "request": TYPES[message],
        "reply": wire.TYPE_ERROR if message == "error" else TYPES[message] | wire.REPLY,
    }
    assert EXAMPLES[name] == frame(expected[kind], header.request_id, payload_of(name))
    assert header.request_id == wire.HEADER.unpack(EXAMPLES[f"{message}-request"]).request_id


def test_requests_are_what_the_text_says():
    request = wire.EVAL_REQUEST.unpack(payload_of("eval-request"))
    assert (request.evaluator, request.spacing, request.medium_count) == (1, wire.SPACING_LIST, 1)
    assert wire.MEDIUM.unpack(payload_of("eval-request"), wire.EVAL_REQUEST.bytes) == (*SKIN, 0.0)
    assert request.wanted == QUANTITIES["R"] | QUANTITIES["albedo"] | QUANTITIES["cdf"]
    assert wire.EVAL_REQUEST.unpack(payload_of("offers-request")).model == wire.ANY_MODEL


@pytest.mark.parametrize("name", REQUESTS)
def test_request_is_answered_as_documented(connection, name):
    message = name.removesuffix("-request")
    if message == "gather":  # of the points of another example
        connection.send_bytes(EXAMPLES["points-request"])
        connection.receive_frame()
    connection.send_bytes(EXAMPLES[name])
    reply = connection.receive_frame()
    while is_progress(reply) or (reply.type == PING_REPLY and message != "ping"):
        reply = connection.receive_frame()
    assert reply.request_id == wire.HEADER.unpack(EXAMPLES[name]).request_id
    if message == "error":
        assert reply.type == wire.TYPE_ERROR
    else:
        assert reply.type == TYPES[message] | wire.REPLY
    if message in DETERMINISTIC:
        received = frame(reply.type, reply.request_id, reply.payload)
        assert received.hex(" ") == EXAMPLES[f"{message}-reply"].hex(" ")
    else:
        STRUCTURE[message](reply.payload)
    assert_serves(connection)


def is_progress(reply) -> bool:
    """Returns whether more replies to the same request follow."""
    if reply.type != wire.MESSAGES["mc"] | wire.REPLY:
        return False
    return wire.MC_REPLY.unpack(reply.payload).state == wire.MC_UNDER_WAY


def check_hello(payload: bytes) -> None:
    fixed = wire.HELLO_REPLY.unpack(payload)
    lists_bytes = fixed.choice_count * wire.CHOICE.bytes + fixed.limit_count * wire.VALUE.bytes
    assert len(payload) == wire.HELLO_REPLY.bytes + lists_bytes
    assert fixed.version == wire.VERSION and fixed.choice_count > 0 and fixed.limit_count > 0


def check_list(entry: wire.Structure):
    def check(payload: bytes) -> None:
        fixed = wire.LIST_REPLY.unpack(payload)
        assert fixed.count > 0 and fixed.zero == 0
        assert len(payload) == wire.LIST_REPLY.bytes + fixed.count * entry.bytes
        for i in range(fixed.count):
            assert entry.unpack(payload, wire.LIST_REPLY.bytes + i * entry.bytes).name

    return check


def check_table(payload: bytes) -> None:
    table = Table(frame(TYPES["table"] | wire.REPLY, 0, payload))
    assert table.medium == (*SKIN, 0.0) and table.numerical_error_constant <= 1e-3


def check_offers(payload: bytes) -> None:
    fixed = wire.OFFERS_REPLY.unpack(payload)
    assert len(payload) == wire.OFFERS_REPLY.bytes + fixed.count * wire.OFFER.bytes
    assert fixed.taken < fixed.count


def check_fit(payload: bytes) -> None:
    """Checks what was found: the last digits depend on how the search goes."""
    expected = payload_of("fit-reply")
    assert len(payload) == len(expected)
    head, end = wire.FIT_REPLY.bytes, wire.FIT_REPLY.bytes + wire.FITTED.bytes
    assert payload[:head] == expected[:head]
    found, shown = wire.FITTED.unpack(payload, head), wire.FITTED.unpack(expected, head)
    assert found[:4] == shown[:4] and found.index == shown.index
    np.testing.assert_allclose(found[6:-4], shown[6:-4], rtol=1e-6)
    residuals = [np.frombuffer(one, "<f8", 3, end) for one in (payload, expected)]
    np.testing.assert_allclose(*residuals, rtol=1e-4)


STRUCTURE = {
    "hello": check_hello,
    "media": check_list(wire.MEASURED_MEDIUM),
    "statistics": check_list(wire.VALUE),
    "table": check_table,
    "offers": check_offers,
    "fit": check_fit,
}
