"""Each message of the protocol meets what can happen to a request: any daemon, pieces, wrong payloads,
answers in parts, peers that lie, cancelling, asking again, leaving, deadlines and others' requests.
messages.py has what a message brings, wrong.txt the values that are refused."""

import ctypes
import dataclasses
import itertools
import math
import re
import select
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import command_line
import dipole
import numpy as np
import pytest
from command_line import Proxy
from daemons import Daemon, eventually
from dipole import Frame, schema, wire
from frames import (  # noqa: F401  (wrong.txt takes some)
    ALBEDO, BETTER, EVAL, F32, F64, LINEAR, LOGARITHMIC, PING, RADIUS, SKIN, R, ask, assert_closed,
    assert_daemon_serves, assert_error, assert_refused, assert_serves, eval_payload, fit_layers_payload, fit_payload, fit_tissue_payload, frame, tissue_payload,
    gather_payload, head_bytes, header, invert_payload, mc_payload, parameters_bytes, points_payload,
    sample_payload, statistics, table_payload, varying_payload,
)
from lists import EVALUATORS, MODELS, MOMENTS, PARAMETERS, QUANTITIES, choices
from messages import (
    CALLS, COMMANDS, FILES, LONG, MC, PARTED, PARTED_CALLS, POINTS_SENT, SAMPLES, SMALL, STREAMED, assert_same, call, receive_answer,
    refusal, reply_structure, send_points,
)

every_message = pytest.mark.parametrize("message", SAMPLES)
every_long_one = pytest.mark.parametrize("message", LONG)
# hello tells of the daemon, and statistics change.
SAME = [name for name in SAMPLES if name not in ("hello", "statistics")]
GATHER = wire.MESSAGES["gather"]
PONG = PING | wire.REPLY


def sample(message: str, request_id: int = 5, deadline_ms: int = 0) -> bytes:
    """Makes the frame of a message's request."""
    return frame(wire.MESSAGES[message], request_id, SAMPLES[message], deadline_ms)


def answer(connection, message: str, request_id: int = 5, deadline_ms: int = 0) -> tuple[bytes, ...]:
    """Returns the answer to a message's request."""
    send_points(connection, message)
    connection.send_bytes(sample(message, request_id, deadline_ms))
    first, parts = receive_answer(connection)
    assert (first.type, first.request_id) == (wire.MESSAGES[message] | wire.REPLY, request_id), refusal(first)
    return parts


@pytest.fixture(scope="module")
def whole():
    """Returns a daemon that answers PARTED in one frame each."""
    one = Daemon()
    yield one
    one.close()


@pytest.fixture(scope="module")
def small():
    """Returns a daemon whose parts are small."""
    one = Daemon(*SMALL)
    yield one
    one.close()


@pytest.fixture(scope="module")
def single():
    """Returns a daemon with one worker, for requests that take long."""
    one = Daemon("--workers", "1")
    yield one
    one.close()


# ---- answers -------------------------------------------------------------------------------------


@every_message
def test_it_is_answered_whatever_its_id_and_deadline(connection, message):
    first = answer(connection, message)
    for request_id, deadline_ms in ((0, 0), (2**64 - 1, 5000), (1, 2**31), (1, 2**32 - 1)):
        again = answer(connection, message, request_id, deadline_ms)
        assert again == first or message not in SAME
    assert_serves(connection)


@pytest.mark.parametrize("message", ["offers", "table", "cancel", "points", "tissue", "fit_layers", "media"])
def test_it_is_sent_by_the_names_of_its_fields(shared, connection, message):
    """Client.call() gives the example's fields and arrays, and returns those of its answer."""
    request, reply = (wire.PAYLOADS.get(f"{message}_{way}") for way in ("request", "reply"))
    fixed, parts = request.unpack(SAMPLES[message]) if request else (None, {})
    listed = {name: part.tolist() for name, part in parts.items()}
    for name in {"parameter", "property"} & {*listed}:
        listed[name] = {one[0]: one[-1] for one in listed[name]}
    with shared.client() as client:
        found = client.call(message, (fixed._asdict() if fixed else {}) | listed)
    numbers, arrays = reply.unpack(b"".join(answer(connection, message)))
    for name, one in (numbers._asdict() | arrays).items():
        if isinstance(found[name], (str, tuple)) and not isinstance(one, tuple):
            assert name in schema.CHOICES or name in schema.SUMS
        else:
            assert_same(found[name], one)


@pytest.mark.parametrize("options", ["--workers 1 --isa portable", "--workers 5 --cache-bytes 0"])
def test_every_daemon_gives_the_same_bits(daemon, shared, options):
    with daemon(*options.split()).connect() as one, shared.connect() as other:
        for message in SAME:
            assert answer(one, message) == answer(other, message), message


def test_hundreds_in_flight(connection):
    """Each has its own answer. Those with one id twice have two."""
    send_points(connection)
    order = [name for name in SAME if name != "mc"] * 20
    alone = {name: answer(connection, name)[0] for name in order}
    connection.send_bytes(b"".join(sample(name, i // 2) for i, name in enumerate(order)))
    found = [connection.receive_frame() for _ in order]
    expected = [(wire.MESSAGES[name] | wire.REPLY, i // 2, alone[name]) for i, name in enumerate(order)]
    assert sorted(found) == sorted(expected)


@every_message
def test_it_is_counted(shared, message):
    with shared.client() as client, shared.connect() as connection:
        answer(connection, message)
        before = client.statistics()
        for _ in range(5):
            answer(connection, message)
        name = f"requests_{message}"
        more = 1 if message == "statistics" else 0
        assert eventually(lambda: client.statistics()[name] - before[name] >= 5)
        if more == 0:
            assert client.statistics()[name] - before[name] == 5


# ---- pieces --------------------------------------------------------------------------------------


@every_message
def test_frames_cut_anywhere(connection, message):
    """The request and a ping, in two writes that cut them anywhere, and byte by byte."""
    alone = answer(connection, message)
    requests = sample(message, 6) + frame(PING, 7, b"8 bytes!")
    for cut in (1, 23, 24, 25, len(requests) - 33, len(requests) - 32, len(requests) - 1, 0):
        pieces = [requests[:cut], requests[cut:]] if cut else [requests[i : i + 1] for i in range(len(requests))]
        for piece in pieces:
            connection.send_bytes(piece)
        found = dict([(one[0].request_id, one[1]) for one in (receive_answer(connection) for _ in "12")])
        assert found[7] == (b"8 bytes!",) and (found[6] == alone or message not in SAME)


@every_message
def test_truncated_frames(shared, connection, message):
    """A client that ends its side within a frame is told, after the answers before it."""
    request = sample(message)
    for length in (1, 23, 24, len(request) - 1):
        with dipole.Connection(connection.address) as one:
            one.send_bytes(sample("ping", 3) + request[:length])
            if length < len(request):
                one.half_close()
                assert one.receive_frame() == Frame(PONG, 3, SAMPLES["ping"])
                known = 5 if length >= wire.HEADER.bytes else 0
                assert_error(one.receive_frame(), "truncated", "payload_bytes", "", request_id=known)
                assert_closed(one)
        with dipole.Connection(connection.address) as one:
            one.send_bytes(request[:length])  # and leaves
    assert_daemon_serves(shared)


def test_earlier_requests_are_answered_before_the_truncated_one(connection):
    payload = eval_payload(radii=[1.0] * 10_000)
    connection.send_bytes(frame(EVAL, 1, payload) * 5 + sample("eval", 4)[:50])
    connection.half_close()
    replies = [connection.receive_frame() for _ in range(6)]
    assert [reply.type for reply in replies[:5]] == [EVAL | wire.REPLY] * 5
    assert_error(replies[5], "truncated", "payload_bytes", "", request_id=4)
    assert_closed(connection)


def test_truncated_frame_that_has_been_refused(connection):
    """If a refused frame is cut off, the error about that has the id of the frame."""
    connection.send_bytes(header(type=EVAL, request_id=77, payload_bytes=2**32 - 8))
    assert_error(connection.receive_frame(), "too-large", "payload_bytes", "at most", request_id=77)
    connection.send_bytes(bytes(100))
    connection.half_close()
    assert_error(connection.receive_frame(), "truncated", "payload_bytes", "", request_id=77)
    assert_closed(connection)


# ---- headers -------------------------------------------------------------------------------------

ALIGNED = "bad-length", "payload_bytes", "a multiple of 8"
NO_SUCH_VERSION = "bad-version", "version", "2"
NO_SUCH_TYPE = "bad-type", "type", "message"
HEADERS = {
    **{f"version {v}, {n} bytes": ({"version": v}, bytes(n), NO_SUCH_VERSION) for v, n in
       ((0, 0), (1, 0), (1, 64), (1, 13), (3, 8))},
    **{f"payload of {n}": ({}, bytes(n), ALIGNED) for n in (1, 7, 1025)},
    "eval cut by a byte": ({"type": EVAL}, SAMPLES["eval"][:-1], ALIGNED),
    **{f"type {type:#x}": ({"type": type}, bytes(n), NO_SUCH_TYPE) for type, n in
       ((0, 0), (max(wire.MESSAGES.values()) + 1, 0), (0x7FFF, 64), (PONG, 0), (wire.TYPE_ERROR, 128))},
}  # fmt: skip


@pytest.mark.parametrize("name", HEADERS)
def test_wrong_headers(shared, name):
    changes, payload, error = HEADERS[name]
    with shared.connect() as connection:
        before = statistics(connection)[f"replies_{error[0]}"]
        connection.send_bytes(header(**changes, request_id=2**64 - 1, payload_bytes=len(payload)) + payload)
        assert_error(connection.receive_frame(), *error, request_id=2**64 - 1)
        assert statistics(connection)[f"replies_{error[0]}"] == before + 1
        assert_serves(connection)


def test_a_skipped_payload_is_not_read_as_frames(connection):
    inside = header(request_id=5) * 3  # which looks like pings
    connection.send_bytes(header(version=9, request_id=4, payload_bytes=len(inside)) + inside)
    assert_error(connection.receive_frame(), "bad-version", "version", "2", request_id=4)
    assert_serves(connection)


NO_MAGIC = {
    "one bit": (header(magic=wire.MAGIC ^ 1), "D I P L"),
    "byte order": (header(magic=int.from_bytes(b"LPID", "little")), "D I P L"),
    "zero bytes": (bytes(4096), "D I P L"),
    "a balancer": (b"PROXY TCP4 192.0.2.1 192.0.2.2 4000 4817\r\n", "no PROXY header of a balancer"),
    "a balancer's bytes": (b"\r\n\r\n\0\r\nQUIT\n\x21\x11\0\x0c" + bytes(12), "no PROXY header of a balancer"),
    "TLS": (b"\x16\3\1\2\0\1\0\1\xfc\3\3" + bytes(32), "this is TLS"),
    "TLS's alert": (b"\x15\3\3\0\2\2\x28" + bytes(32), "this is TLS"),
    "HTTP": (b"POST /v1/eval HTTP/1.1\r\nHost: a\r\n\r\n", "this is HTTP"),
    "GET": (b"GET / HTTP/1.1\r\nHost: a\r\n\r\n", "this is HTTP"),
    "HTTP's answer": (b"HTTP/1.1 200 OK\r\nDate: today\r\n\r\n", "this is HTTP"),
    "another": (b"SSH-2.0-OpenSSH_9.2\r\n" + bytes(32), "D I P L"),
}


@pytest.mark.parametrize("name", NO_MAGIC)
@pytest.mark.parametrize("before", [b"", sample("eval", 8) + sample("ping", 9)], ids=["first", "later"])
def test_other_protocols_are_named_and_closed(shared, connection, name, before):
    """What came before is answered."""
    sent, said = NO_MAGIC[name]
    connection.send_bytes(before + sent)
    found = [connection.receive_frame() for _ in range(3 if before else 1)]
    assert {one.request_id: one.type for one in found[:-1]} == ({8: EVAL | wire.REPLY, 9: PONG} if before else {})
    assert_error(found[-1], "bad-magic", "magic", "D I P L" if before else said, request_id=0)
    assert_closed(connection)
    assert_daemon_serves(shared)


# ---- wrong payloads ------------------------------------------------------------------------------


def above(x: float) -> float:
    return math.nextafter(x, math.inf)


def m(**changes: float) -> tuple[float, ...]:
    """SKIN with some coefficients changed."""
    return tuple({**dict(zip(("sigma_a", "sigma_s", "g", "eta"), SKIN)), **changes}.values())


SLAB = m(thickness=1.0)


def padded(**changes: int) -> bytes:
    """Makes two parameter structures, the second with these paddings."""
    cos_in = {"parameter": PARAMETERS["cos_in"].id, "value": 0.5, **changes}
    return parameters_bytes([(PARAMETERS["cos_out"].id, 0.5)]) + wire.PARAMETER.pack(**cos_in)


MAKERS = {
    "eval": eval_payload, "offers": lambda **how: eval_payload(**{"model": 0, "wanted": R, **how}), "sample": sample_payload,
    "invert": invert_payload, "fit": fit_payload, "fit_layers": fit_layers_payload, "fit_tissue": fit_tissue_payload, "tissue": tissue_payload, "varying": varying_payload, "table": table_payload,
    "mc": mc_payload, "points": lambda **how: points_payload(POINTS_SENT, 0, 10, **{"point_count": 10, **how}),
    "gather": lambda **how: gather_payload(POINTS_SENT, **{"media": [SKIN] * 4, **how}),
    "hello": lambda **how: wire.HELLO_REQUEST.pack(**{"version_min": 2, "version_max": 2, **how}), "ping": bytes,
}  # fmt: skip


def make(message: str, cut: int = 0, more: int = 0, keep: int | None = None, stain: int = 0, **how) -> bytes:
    """Makes a payload with changes, and then cuts bytes off, appends zeros, keeps so many or writes 1
    into one of the last bytes."""
    payload = bytearray(MAKERS[message](**how) + bytes(more))
    payload = payload[: len(payload) - cut if keep is None else keep]
    if stain:
        payload[-stain] = 1
    return bytes(payload)


def read_wrong() -> dict[str, tuple]:
    """Returns the arguments of assert_refused() for the rows of wrong.txt."""
    listed = {"INF": math.inf, "NAN": math.nan, "P": types.SimpleNamespace(**choices("PARAMETER"))}
    listed["M"] = type("M", (dict,), {"__getattr__": dict.__getitem__})(MODELS)
    listed["NO_QUANTITY"] = 2 * max(choices("QUANTITY").values())
    listed["below"] = lambda x: math.nextafter(x, -math.inf)
    cases = {}
    for line in Path(__file__).with_name("wrong.txt").read_text().splitlines():
        if line and not line.startswith("#"):
            message, status, field, allowed, *rest = re.split("  +", line)
            changes, values = rest[0] if rest else "", rest[1].split(" / ") if len(rest) > 1 else ["_"]
            for value in values:
                text = re.sub(r"\b_\b", value, changes)
                name, _, index = re.sub(r"\b_\b", value, field).partition("@")
                payload = make(message, **eval(f"dict({text})", {**globals(), **listed}))
                cases[f"{message}: {text}"] = wire.MESSAGES[message], payload, status, name, allowed, int(index or 0)
    return cases


WRONG = read_wrong()
WRONG |= {
    f"eval: {name} {eta}": (EVAL, eval_payload([SKIN, m(eta=eta)], moments=one.id), "bad-value", "eta",
                            f"{one.eta_min:g} to {one.eta_max:g}" + (name != "exact") * f" with moments {name}", 1)
    for name, one in MOMENTS.items()
    for eta in (math.nextafter(one.eta_min, 0), above(one.eta_max))
}  # fmt: skip
WRONG |= {
    f"eval: {name} NaN": (EVAL, eval_payload(parameters=[(one.id, math.nan)]), "bad-value", name,
                          "a number; a parameter that is not wanted is left out", 0)
    for name, one in PARAMETERS.items()
}  # fmt: skip


# Fields of replies that say what was asked for.
ECHOED = ["model", "evaluator", "moments", "wanted", "given", "coefficients", "haemoglobin", "layer_count"]


def fixed_part(name: str, payload: bytes) -> dict[str, object]:
    structure = wire.STRUCTURES.get(name)
    return structure.unpack(payload[: structure.bytes])._asdict() if structure else {}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said(shared, name):
    with shared.connect() as connection:
        message = name.split(":")[0]
        send_points(connection, message)
        type, payload, status, _, allowed, _ = WRONG[name]
        if status == "ok":
            reply = ask(connection, type, payload)
            assert reply.type == type | wire.REPLY
            asked, told = fixed_part(f"{message}_request", payload), fixed_part(f"{message}_reply", reply.payload)
            assert all(asked[one] in (0, told[one]) for one in ECHOED if one in asked and one in told)
        else:
            assert assert_refused(connection, *WRONG[name]) == allowed  # the whole text


COUNTS = [0, 2**16 - 1, 2**29, 2**31, 2**32 - 1, 2**53 + 1, 2**60, 2**61, 2**62, 2**63, 2**64 - 1]
# Fields in which any value, or the largest, is good.
GOOD = {
    ("hello", "version_max"), ("mc", "seed"), ("sample", "seed"), ("sample", "sample_first"),
    ("sample", "sample_count"), ("cancel", "job_id"), ("mc", "photons"), ("points", "point_count"),
    ("eval", "wanted"), ("sample", "wanted"),
}  # fmt: skip


@every_message
def test_payloads_that_do_not_fit_their_structure(shared, message):
    """Sizes, and each field of the fixed part with values that no request has, or that wrap: an error
    names a field, and the connection goes on."""
    structure, payload = wire.STRUCTURES.get(f"{message}_request"), SAMPLES[message]
    sizes = [payload + bytes(8), *([payload[: structure.bytes - 8], payload[:-8], b""] if structure else [])]
    wrong = [(None, payload + bytes(2048))] if message == "ping" else [(None, size) for size in sizes]
    for field in structure.fields if structure else ():
        most = {"u16": 2**16 - 1, "u32": 2**32 - 1, "u64": 2**64 - 1}.get(field.kind)
        values = [math.nan] if most is None else [one for one in COUNTS if 0 < one <= most]
        for value in values if (message, field.name) not in GOOD else ():
            fixed = structure.unpack(payload)._asdict()
            fixed[field.name] = (value,) * field.count if field.is_array else value
            wrong.append((field.name, structure.pack(**fixed) + payload[structure.bytes :]))
    with shared.connect() as connection:
        send_points(connection, message)
        for name, other in wrong:
            connection.send_bytes(frame(wire.MESSAGES[message], 9, other))
            (reply, _) = receive_answer(connection)
            assert reply.type == wire.TYPE_ERROR, (name, len(other))
            error = wire.ERROR.unpack(reply.payload)
            assert error.field and error.allowed and (error.field != "zero" or "zero" in name), (name, error)
            if name is None and len(other) < len(payload):
                assert wire.STATUSES[error.status] in ("bad-length", "bad-count"), error
        assert_serves(connection)


@pytest.mark.parametrize("start, r, model, evaluator", [(2.0, 2.0, "transport", F64), (1e-300, 0.0, "better", F32)])
def test_a_grid_of_one_radius_is_a_list_of_one(connection, start, r, model, evaluator):
    """Its end does not count, and errors are those of the radius in the evaluator's precision."""
    common = {"wanted": R | QUANTITIES["model_error"], "model": MODELS[model], "evaluator": evaluator}
    grid = eval_payload(radii=None, radius_count=1, radius_start=start, radius_stop=1e4, **common)
    listed = ask(connection, EVAL, eval_payload(radii=[r], **common))
    assert ask(connection, EVAL, grid).payload == listed.payload != b""


def test_a_long_list_is_cut_between_its_entries(connection):
    error = wire.ERROR.unpack(ask(connection, EVAL, eval_payload(model=65535)).payload)
    named = [name for name, id in MODELS.items() if f"{id} ({name})" in error.allowed]
    assert 0 < len(named) == error.allowed.count("(") == error.allowed.count(")")
    assert ("hello" in error.allowed) == (len(named) < len(MODELS))


# ---- answers in parts ----------------------------------------------------------------------------


@pytest.mark.parametrize("message", PARTED)
def test_parts_are_numbered_and_small(small, message):
    """An answer in parts counts once, and parts are as large as they may be."""
    with small.connect() as connection:
        send_points(connection, message)
        before = statistics(connection)
        connection.send_bytes(frame(wire.MESSAGES[message], 77, PARTED[message]))
        first, parts = receive_answer(connection)
        assert first.type == wire.MESSAGES[message] | wire.REPLY, refusal(first)
        assert statistics(connection)["replies_ok"] == before["replies_ok"] + 2
        assert_serves(connection)
    fixed = [wire.PART.unpack(part) for part in parts]
    assert [one.part for one in fixed] == list(range(len(parts))) and len(parts) > 1
    assert [one.first for one in fixed] == np.cumsum([0, *(one.count for one in fixed)])[:-1].tolist()
    assert {one.part_count for one in fixed} == {len(parts)}
    assert max(map(len, parts)) <= 16384 and (max(map(len, parts)) > 8192 or message == "gather")


@pytest.mark.parametrize("message", PARTED_CALLS)
def test_answers_in_parts_have_the_same_bits(small, whole, message):
    with small.client() as client, whole.client() as other:
        found, expected = (call(each, message, PARTED_CALLS) for each in (client, other))
        if message == "sample":  # Doubles are drawn by other lines than floats.
            draw = dipole.Draw(5000, "random", seed=5)
            assert_same(*(each.sample("better", SKIN, draw=draw, evaluator="f64") for each in (client, other)))
        if message == "varying":  # The error of a part holds for its values alone.
            assert 0 < found.numerical_error <= expected.numerical_error
            found = dataclasses.replace(found, numerical_error=expected.numerical_error)
        assert_same(found, expected)
        assert client.ping() > 0


@pytest.mark.parametrize("frame_bytes", [4096, 10_000, 1 << 20])
@pytest.mark.parametrize("part_bytes", [4096, 9000, 1 << 20])
def test_sizes_of_parts(daemon, frame_bytes, part_bytes):
    most = min(frame_bytes, part_bytes)
    one = daemon("--max-frame-bytes", str(frame_bytes), "--max-part-bytes", str(part_bytes))
    with one.connect() as connection:
        for evaluator, value_bytes in ((1, 8), (F32, 4)):
            fields = {"radii": None, "wanted": R, "evaluator": evaluator}
            head = head_bytes(1, 1)
            fits = (frame_bytes - head) // value_bytes
            for count in (fits, fits + 1):
                connection.send_bytes(frame(EVAL, 77, eval_payload(radius_count=count, **fields)))
                counts = [wire.PART.unpack(part).count for part in receive_answer(connection)[1]]
                assert sum(counts) == count and (len(counts) > 1) == (count > fits)
                # Parts are as large as possible, in steps of 256 radii.
                assert set(counts[:-1]) <= {(most - head) // value_bytes // 256 * 256}


# ---- peers that lie ------------------------------------------------------------------------------


# Fields that say something about the values, which no client can judge, and those that a client takes
# as they come, if all parts have the same.
OF_VALUES = {"notes", "points_visited", "nodes_visited", "computed_count", "zero", "fitted_count", "missing_count"}
CHOSEN = {"model", "evaluator", "moments", "taken"}


def lies_about(message: str) -> dict[str, Callable[[int, bytes], list[bytes]]]:
    """Returns functions by name that take the number and the payload of a reply, and return the
    payloads in its place."""
    structure = reply_structure(message)

    def changed(name: str, since: int = 0, by: int = 1) -> Callable[[int, bytes], list[bytes]]:
        def lie(number: int, payload: bytes) -> list[bytes]:
            fixed = structure.unpack(payload)._asdict()
            fixed[name] += by * (number >= since)
            return [structure.pack(**fixed) + payload[structure.bytes :]]

        return lie

    numbers = [one.name for one in structure.fields if one.kind[0] == "u" and one.name not in OF_VALUES]
    lies = {
        "cut by 8": lambda number, payload: [payload[:-8]],
        "cut to 8": lambda number, payload: [payload[:8]],
        "8 more": lambda number, payload: [payload + bytes(8)],
        **{f"another {name}": changed(name) for name in numbers if name not in CHOSEN},
    }
    for name in {one.name for one in structure.fields} & {"computed_count", "fitted_count", "missing_count"}:
        lies[f"{name} beyond all items"] = changed(name, by=2**20)
    if message in ("eval", "sample"):
        lies["another albedo later"] = lambda number, payload: [
            payload if number == 0 else payload[: structure.bytes] + b"\x01" + payload[structure.bytes + 1 :]
        ]
    if message == "invert":

        def no_errors(number: int, payload: bytes) -> list[bytes]:
            fixed = structure.unpack(payload)._asdict() | {"errors": 0}
            return [structure.pack(**fixed) + payload[structure.bytes : -24 * fixed["count"]]]

        lies |= {"no errors": no_errors, "another reach later": changed("albedo_most", 1)}
    if message in STREAMED:
        lies["the first is lost"] = lambda number, payload: [payload] if number else []
        lies["the first twice"] = lambda number, payload: [payload] * (2 if number == 0 else 1)
        kept = numbers if message != "gather" else set(numbers) - CHOSEN
        lies |= {f"another {name} later": changed(name, 1) for name in kept}
    return lies


def refuses(daemon, message: str, lie, ask: Callable[[str], Any]) -> bool:
    """Asks a daemon through a proxy that lies. Returns whether the client says that it does not follow
    the protocol."""
    asked: list[int] = []

    def on_reply(type: int, payload: bytes) -> list[bytes]:
        if type != wire.MESSAGES[message] | wire.REPLY:
            return [payload]
        asked.append(type)
        return lie(len(asked) - 1, payload)

    with Proxy(daemon.url(), lambda number, request_id: None, on_reply) as proxy:
        try:
            ask(proxy.url)
        except (dipole.ProtocolError, dipole.TableError):
            return True
        except (AssertionError, dipole.ArgumentError) as fault:  # of a command that fails, or of libdipole
            return re.search("peer does not speak this protocol|daemon speaks .* this library only", str(fault)) is not None
    return False


@pytest.mark.parametrize("message", [*STREAMED, "table", "offers", "media"])
def test_the_client_takes_no_other_answer(small, message):
    def ask(url: str) -> None:
        with dipole.Client(url, retry_s=0, timeout_s=3) as client:
            call(client, message, {**CALLS, **PARTED_CALLS})

    lies = lies_about(message)
    assert [name for name in lies if not refuses(small, message, lies[name], ask)] == []


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """Returns the folder with the files that commands read, and write."""
    folder = tmp_path_factory.mktemp("files")
    for name, data in FILES.items():
        (folder / name).write_bytes(data)
    return folder


def structure(*fields: tuple[str, Any]) -> type[ctypes.Structure]:
    return type("Fields", (ctypes.Structure,), {"_fields_": [(one, kind) for names, kind in fields for one in names.split()]})


# As clients/c/dipole.h has them. The arrays of an inversion are those of dipole.Inversion.
DOUBLES = ctypes.POINTER(ctypes.c_double)
INVERT_QUERY = structure(
    ("model moments given light", ctypes.c_uint), ("specular", ctypes.c_bool), ("g eta", ctypes.c_double),
    ("albedos lengths_mm", ctypes.c_void_p), ("medium_count", ctypes.c_uint64), ("deadline_ms", ctypes.c_uint),
)
INVERSION = structure(
    ("medium_count missing", ctypes.c_uint64), ("sigma_a sigma_s albedo", DOUBLES),
    ("albedo_least albedo_most", ctypes.c_double), ("sigma_a_error sigma_s_error model_error", DOUBLES),
)
TO_INVERT, LENGTHS = np.tile(np.linspace(0.002, 1, 1667), 2), np.ones(3334)  # no path diffuses with albedo 1


def inverted(url: str) -> dict[str, Any]:
    """What libdipole's dipole_invert() finds for colours, of which commands ask for one at a time."""
    calls, client, found = dipole.library.library(), ctypes.c_void_p(), ctypes.POINTER(INVERSION)()
    places = TO_INVERT.ctypes.data, LENGTHS.ctypes.data
    query = INVERT_QUERY(BETTER, 1, 2, 0, False, 0.5, 1.4, *places, len(TO_INVERT), 0)
    dipole.library.call(calls.dipole_open, url.encode(), ctypes.byref(client))
    try:
        calls.dipole_set_retry_ms(client, 0)
        dipole.library.call(calls.dipole_invert, client, ctypes.byref(query), ctypes.byref(found))
        values = {name: getattr(found.contents, name) for name, _ in INVERSION._fields_}
        return {
            name: np.ctypeslib.as_array(one, TO_INVERT.shape).copy() if isinstance(one, DOUBLES) else one
            for name, one in values.items()
        }
    finally:
        calls.dipole_inversion_free(found)
        calls.dipole_close(client)


def test_libdipole_puts_inversions_together(small):
    with small.client() as client:
        expected = vars(client.invert("better", TO_INVERT, LENGTHS, g=0.5, eta=1.4, given="diffuse-mean-free-path"))
    found = inverted(small.url())
    assert found.pop("medium_count") == len(TO_INVERT) and found["missing"] == 2
    assert_same(found, {name: expected[name] for name in found})


def written(message: str, url: str, files: Path) -> Any:
    """Runs the command of a message. Returns what it prints, and the files that it writes."""
    if message == "invert":
        return inverted(url)
    how = ("--connect", url, "--retry-ms", "0", "--timeout-ms", "60000")
    printed = command_line.dipole(*COMMANDS[message], *how, cwd=files, usual=True).stdout
    return [printed, *(files.joinpath(one).read_bytes() for one in sorted(files.glob("media.*.pfm")))]


@pytest.mark.parametrize("message", [one for one in COMMANDS if one in PARTED])
def test_libdipole_puts_parts_together(small, whole, files, message):
    parted, at_once = (written(message, one.url(), files) for one in (small, whole))
    if message == "gather":  # The errors of its sums are those of the parts (G6).
        keep = at_once[0].split("\n")[0].split(",").index("bound")
        parted, at_once = ([row.split(",")[:keep] for row in one[0].split("\n")] for one in (parted, at_once))
    assert parted == at_once


# What a report of a job or a daemon says of itself, which no client can judge.
OF_ITSELF = {"state", "worst_side", "worst_albedo", "number", "photons", "photons_expected", "workers",
             "version_min", "version_max", "status", "evaluations"}  # fmt: skip


@pytest.mark.parametrize("message", [*COMMANDS, "invert"])
def test_libdipole_takes_no_other_answer(small, files, message):
    taken = [
        name
        for name, lie in lies_about(message).items()
        if name.removeprefix("another ") not in OF_ITSELF
        and not refuses(small, message, lie, lambda url: written(message, url, files))
    ]
    assert taken == []


@pytest.mark.parametrize("model", ["--model=better", "--tolerance=0.02"])
def test_libdipole_takes_an_evaluator_of_the_type(small, model):
    """If the daemon chooses the model; else it takes the evaluator that it asked for."""
    for asked, taken in itertools.product(EVALUATORS, [*EVALUATORS.values(), 1 + max(EVALUATORS.values())]):

        def lie(number: int, payload: bytes) -> list[bytes]:
            fixed = wire.EVAL_REPLY.unpack(payload)._asdict() | {"evaluator": taken}
            return [wire.EVAL_REPLY.pack(**fixed) + payload[wire.EVAL_REPLY.bytes :]]

        def evaluate(url: str) -> None:
            how = ("--connect", url, "--retry-ms", "0", "--evaluator", asked)
            done.append(command_line.dipole("eval", "--medium", "skin1", "--r", "1", model, *how))

        done: list[Any] = []
        same_type = {asked, *(("f32", "lut") if "tolerance" in model and asked != "f64" else ())}
        is_right = taken in [EVALUATORS[name] for name in same_type]
        assert (refuses(small, "eval", lie, evaluate), len(done)) == (not is_right, is_right), (asked, taken)


# ---- cancelling, asking again, leaving -----------------------------------------------------------


def cancel(connection, job_id: int) -> None:
    connection.send_bytes(frame(wire.MESSAGES["cancel"], 100 + job_id, wire.CANCEL_REQUEST.pack(job_id=job_id)))


@every_message
def test_cancelling(single, message):
    """Jobs and gathers end. What is answered, and every other message, is not found."""
    with single.connect() as connection:
        send_points(connection, message)
        ends = message in ("mc", "gather")
        if ends:
            connection.send_bytes(frame(wire.MESSAGES[message], 5, LONG[message]))
        else:
            answer(connection, message)
        cancel(connection, 5)
        cancel(connection, 6)
        found, ended = {}, 0
        while len(found) < 2 or (ends and not ended):
            reply = connection.receive_frame()
            if reply.request_id >= 100:
                found[reply.request_id - 100] = wire.CANCEL_REPLY.unpack(reply.payload).found
            elif message == "mc":
                ended = wire.MC_REPLY.unpack(reply.payload).state
                assert ended == 0 or wire.MC_STATES[ended] == "cancelled"
            elif reply.type == wire.TYPE_ERROR:
                assert_error(reply, "cancelled", "job_id", "no cancel", request_id=5)
                ended = 1
        assert found == {5: int(ends), 6: 0}
        assert statistics(connection)["owed_radii"] == statistics(connection)["mc_jobs_open"] == 0
        assert_serves(connection)


@pytest.mark.parametrize("name", CALLS)
def test_a_client_asks_again_when_its_connection_is_lost(shared, name):
    with dipole.Client(shared.url(), retry_s=20.0) as client:
        before = call(client, name)
        client._session.connection.socket.shutdown(2)
        assert_same(call(client, name), before)


@pytest.mark.parametrize("scheme", ["unix", "tcp"])
@every_message
def test_leaving(single, message, scheme):
    """A client leaves before its answer, within it, or while its request runs."""
    streamed = {name: LONG[name] for name in ("eval", "mc")}  # parts that nobody reads end the rest
    with single.connect() as watcher:
        for payload in (SAMPLES[message], {**PARTED, **streamed}.get(message, SAMPLES[message])):
            for read in (0, 1):
                with single.connect(scheme) as leaving:
                    send_points(leaving, message)
                    leaving.send_bytes(frame(wire.MESSAGES[message], 1, payload))
                    leaving.receive_bytes(read)
        idle = ("owed_radii", "mc_jobs_open", "points_sent_bytes")
        assert eventually(lambda: not any(statistics(watcher)[name] for name in idle))
        assert eventually(lambda: statistics(watcher)["connections_open"] == 1)
        assert eventually(lambda: statistics(watcher)["buffer_bytes"] < 1 << 20)
        assert_serves(watcher)


# ---- deadlines and turns -------------------------------------------------------------------------


@pytest.mark.parametrize("message", [name for name in LONG if name != "mc"])
def test_deadlines_are_kept(single, message):
    """Parts that were complete in time come first; then the error, and the connection goes on."""
    with single.connect() as connection:
        send_points(connection, message)
        connection.send_bytes(frame(wire.MESSAGES[message], 77, LONG[message], 60))
        while (reply := connection.receive_frame()).type == wire.MESSAGES[message] | wire.REPLY:
            assert reply.request_id == 77
        assert_error(reply, "deadline", "deadline_ms", "more")
        answer(connection, message, deadline_ms=60_000)
        assert_serves(connection)


def test_the_deadline_of_a_job_is_for_its_start(shared):
    with shared.connect() as connection:
        connection.send_bytes(frame(MC, 77, mc_payload(photons=2_000_000), 20))
        first, (table,) = receive_answer(connection)
        assert wire.MC_STATES[wire.MC_REPLY.unpack(table).state] == "photons"


@every_long_one
def test_others_are_answered_meanwhile(single, message):
    """One worker does both: small requests of every kind are answered while a long one runs."""
    with single.connect() as busy, single.connect() as other:
        for name in SAME:  # which prepares what they need, on another thread
            answer(other, name)

        def under_way() -> bool:
            while select.select([busy.socket], [], [], 0)[0]:
                one = busy.receive_frame()  # after 5 s on a busy machine: that it is still at work
                assert one == Frame(PONG, 1, b"") or one[:2] == (wire.MESSAGES[message] | wire.REPLY, 1)
            now = statistics(other)
            return now["owed_radii"] + now["mc_jobs_open"] > 0

        def begin() -> None:
            send_points(busy, message)
            busy.send_bytes(frame(wire.MESSAGES[message], 1, LONG[message]))
            eventually(under_way, 2)  # unless it ends before

        def is_answered(name: str) -> bool:
            answer(other, name)
            return eventually(under_way, 1)  # An eval whose reader is slow rests.

        begin()
        for name in [*SAME, message]:
            # Where others work, too, the long one may end first. Then it begins again.
            assert any(is_answered(name) or begin() for _ in range(5)), name
