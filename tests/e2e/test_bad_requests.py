"""Invalid requests: each gets an error that names the field and says what is allowed. The
connection and the daemon go on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from dipole import wire
from frames import (
    ALBEDO, CDF, EVAL, F32, HELLO, LINEAR, LOGARITHMIC, MEDIA, PING, RADIUS, SKIN, STATISTICS, R,
    ask, assert_daemon_serves, assert_error, assert_refused, assert_serves, eval_payload,
    head_bytes, header, refused,
)
from lists import EVALUATORS, MODELS, MOMENTS

INF, NAN = math.inf, math.nan
above = np.nextafter  # above(x, inf) is the next double.


def medium(**changes: float) -> tuple[float, float, float, float]:
    """SKIN with some coefficients changed."""
    values = dict(zip(("sigma_a", "sigma_s", "g", "eta"), SKIN))
    return tuple({**values, **changes}.values())


def with_bad(bad, at: int = 1) -> tuple[bytes, int]:
    """Makes a request with three media of which one, by default the second, is invalid. Returns it
    with the position of that medium."""
    return eval_payload([SKIN] * at + [bad] + [SKIN] * (2 - at)), at


def with_ids(field: str, *ids: int) -> dict[str, bytes]:
    """Makes requests with these ids in a field."""
    return {f"{id:#x}": eval_payload(**{field: id}) for id in ids}


def grid(**fixed: float) -> bytes:
    """Makes an eval payload with a grid."""
    return eval_payload(radii=None, **fixed)


def log_grid(start: float, stop: float = 1.0) -> bytes:
    """Makes an eval payload with a logarithmic grid."""
    return grid(spacing=LOGARITHMIC, radius_start=start, radius_stop=stop)


CHOICES = {
    **refused("bad-value", "model", "0 with the parameter tol", {"0": eval_payload(model=0)}),
    **refused("bad-value", "model", "1 (classical)", with_ids("model", 999, 65535)),
    **refused(
        "bad-value",
        "evaluator",
        "one of 1 (f64), 2 (f32), 3 (lut)",
        with_ids("evaluator", 0, 9, 65535),
    ),
    **refused("bad-value", "moments", "1 (exact), 2 (fit)", with_ids("moments", 0, 999, 65535)),
    # 257 would mean a list if the daemon read only eight bits.
    **refused("bad-value", "spacing", "1 (list), 2 (lin", with_ids("spacing", 0, 257, 999, 65535)),
    **refused(
        "bad-value",
        "wanted",
        "1 (R), 2 (albedo), 4 (cdf), 8 (r)",
        with_ids("wanted", 0, 0x4000, 0x8007, 65535),
    ),
}

COEFFICIENTS = {
    f"{field} {value}": (with_bad(medium(**{field: value}))[0], "bad-value", field, allowed, 1)
    for field, allowed, values in [
        ("sigma_a", "0 to 1e15", [-0.1, -5e-324, INF, -INF, NAN, above(1e15, INF)]),
        ("sigma_s", "0 to 1e15", [-0.1, -5e-324, INF, -INF, NAN, above(1e15, INF)]),
        ("g", "-1 and 1, exclusive", [1.0, -1.0, 1.5, -7.0, INF, -INF, NAN]),
        ("eta", "0.001 to 1000", [0.0, 5e-324, -1.3, above(1e-3, 0), above(1e3, INF), INF, NAN]),
    ]
    for value in values
}

TRANSPORT = {
    **refused("bad-value", "sigma_s", "1e-15", {
        "sigma_a and sigma_s 0": with_bad((0.0, 0.0, 0.0, 1.3), at=2),
        "sigma_t' too small": with_bad((4e-16, 5e-16, 0.0, 1.3), at=0),
        "sigma_t' too small through g": with_bad((0.0, 1e-3, above(1, 0), 1.3)),
    }),
    **{
        f"{name} {eta}": (
            eval_payload([SKIN, SKIN, medium(eta=eta)], moments=moments.id),
            "bad-value",
            "eta",
            f"{moments.eta_min:g} to {moments.eta_max:g}",
            2,
        )
        for name, moments in MOMENTS.items()
        for eta in [above(moments.eta_min, 0), above(moments.eta_max, INF)]
    },
}

RADII = refused("bad-value", "r", "0 to infinity", {
    "negative": (eval_payload(radii=[0, 1, 2, -1e-300]), 3),
    "first NaN": eval_payload(radii=[NAN, 1]),
    "-inf": (eval_payload(radii=[1, -INF, 2]), 1),
    "the first of two": (eval_payload(radii=[1, 2, -1, NAN]), 2),
    "f32 negative": (eval_payload(radii=[1, 1, 1, 1, -1], evaluator=F32), 4),
    "f32 NaN": (eval_payload(radii=[1, NAN, 1], evaluator=F32), 1),
    "only albedo wanted": (eval_payload(radii=[1, NAN], wanted=ALBEDO), 1),
    "far down a long list": (eval_payload(radii=[1.0] * 99_999 + [NAN]), 99_999),
})

GRIDS = {
    **refused(
        "bad-value",
        "radius_start",
        "at least 1e-300",
        {f"log from {start}": log_grid(start) for start in (0.0, above(1e-300, 0), -1.0)},
    ),
    **refused("bad-value", "radius_stop", "at least radius_start", {
        "log stop < start": log_grid(0.1, above(0.1, 0)),
        "linear stop < start": grid(radius_start=2.0, radius_stop=1.0),
    }),
    **refused("bad-value", "radius_stop", "finite", {
        "log to inf": log_grid(0.1, INF),
        "linear to NaN": grid(radius_stop=NAN),
        "linear to inf": grid(radius_stop=INF),
    }),
    **refused("bad-value", "radius_start", "at least 0", {"below 0": grid(radius_start=-5e-324)}),
    **refused(
        "bad-value",
        "radius_start",
        "finite",
        {"NaN": grid(radius_start=NAN), "inf": grid(radius_start=INF, radius_stop=INF)},
    ),
    # The bytes of 2^61 radii wrap to 0.
    **refused(
        "bad-count",
        "radius_count",
        "1 to 2^53",
        {f"{n:#x}": grid(radius_count=n) for n in (0, 2**53 + 1, 2**61, 2**64 - 1)},
    ),
    **refused(
        "too-large",
        "radius_count",
        str(2**40),
        {f"{n:#x}": grid(radius_count=n) for n in (2**40 + 1, 2**53)},
    ),
    **refused(
        "too-large",
        "radius_count",
        "at most",
        {"radii alone": grid(radius_count=2**41, wanted=RADIUS)},
    ),
}

# Near these counts, the size in bytes wraps in 32 or 64 bits, to 0 or to the size of the payload.
WRAPPING = [2**29, 2**32, 2**61, 2**62, 2**63, 2**64]

COUNTS = {
    **refused("bad-count", "medium_count", "at least 1", {"no medium": eval_payload([])}),
    **refused("bad-count", "medium_count", "no more media than the payload holds", {
        **{
            f"{count:#x}": eval_payload(medium_count=count)
            for count in [2, 2**27, 2**27 + 1, 2**28 + 1, 2**31, 2**32 - 1]
        },
        "without its media": eval_payload()[:40],
        "with a medium cut": eval_payload()[:64],
    }),
    **refused("bad-count", "radius_count", "no more radii than the payload holds", {
        # The payload has enough bytes for the media, so the list is too short.
        "one medium too many": eval_payload([SKIN], [1, 2, 3, 4], medium_count=2),
        **{
            f"evaluator {evaluator}, {count:#x}": eval_payload(
                radii=[1.0] * 2, radius_count=count, evaluator=evaluator
            )
            for evaluator in EVALUATORS.values()
            for near in WRAPPING
            for count in [3, near - 1, near, near + 2]
            if count < 2**64
        },
    }),
    **refused("bad-length", "payload_bytes", "nothing after the listed radii", {
        "one medium too few": eval_payload([SKIN, SKIN], [1.0], medium_count=1),
        "one radius too few": eval_payload(radius_count=1),
        "no radii but a list": eval_payload(radius_count=0, wanted=ALBEDO),
        "trailing bytes": eval_payload() + bytes(8),
        "f32 trailing bytes": eval_payload(radii=[1.0], evaluator=F32) + bytes(8),
    }),
    **refused(
        "bad-length",
        "payload_bytes",
        "nothing after media and parameters",
        {"trailing bytes after a grid": grid() + bytes(8)},
    ),
    **refused(
        "bad-length",
        "payload_bytes",
        "at least 40",
        {"empty": b"", "cut in its fixed part": eval_payload()[:32]},
    ),
}

SINGLE = eval_payload(radii=[1.0, 2.0, 3.0], evaluator=F32)
UNUSED = {
    **refused(
        "bad-value",
        "r",
        "zero bytes of padding",
        {f"padding {i}": SINGLE[: len(SINGLE) - i] + b"\x01" + bytes(i - 1) for i in range(1, 5)},
    ),
    **refused(
        "bad-value",
        "radius_start",
        "0 when",
        {f"{start} with a list": eval_payload(radius_start=start) for start in (1.0, 1e-300, NAN)},
    ),
    **refused(
        "bad-value",
        "radius_stop",
        "0 when",
        {f"{stop} with a list": eval_payload(radius_stop=stop) for stop in (1.0, -1.0)},
    ),
}

EVALS = {**CHOICES, **COEFFICIENTS, **TRANSPORT, **RADII, **GRIDS, **COUNTS, **UNUSED}


@pytest.mark.parametrize("name", EVALS)
def test_eval(shared, name):
    with shared.connect() as connection:
        assert_refused(connection, EVAL, *EVALS[name])
    assert_daemon_serves(shared)


def test_a_long_list_is_cut_between_its_entries(connection):
    error = wire.ERROR.unpack(ask(connection, EVAL, eval_payload(model=65535)).payload)
    named = [name for name, id in MODELS.items() if f"{id} ({name})" in error.allowed]
    assert 0 < len(named) == error.allowed.count("(") == error.allowed.count(")")
    assert ("hello" in error.allowed) == (len(named) < len(MODELS))


def test_faults_are_named_in_the_order_of_the_tables(connection):
    # If a request has several faults, the error names the first of the table's fields, and then the
    # first medium.
    media = [SKIN, medium(g=1.0, eta=0.0), medium(sigma_a=-1.0)]
    both = eval_payload(media, radii=[-1.0])
    assert_error(ask(connection, EVAL, both), "bad-value", "g", "exclusive", 1)
    all_ids = eval_payload(media, model=999, evaluator=0, moments=0)
    assert_error(ask(connection, EVAL, all_ids), "bad-value", "model", "1 (classical)")
    media_before_radii = eval_payload([medium(eta=0.0)], radii=[NAN])
    assert_refused(connection, EVAL, media_before_radii, "bad-value", "eta", "0.001")


def hello(version_min: int, version_max: int, zero: int = 0) -> bytes:
    """The payload of a hello request."""
    return wire.HELLO_REQUEST.pack(version_min=version_min, version_max=version_max, zero=zero)


# Maps names to invalid requests: (type, payload, status, field, allowed).
OTHERS = {
    "hello newer": (HELLO, hello(3, 9), "bad-version", "version_max", "2"),
    "hello older": (HELLO, hello(1, 1), "bad-version", "version_max", "2"),
    "hello range turned round": (HELLO, hello(2, 0), "bad-value", "version_min", "at most"),
    "hello zero field": (HELLO, hello(1, 1, 7), "bad-value", "zero", "0"),
    "hello empty": (HELLO, b"", "bad-length", "payload_bytes", "8"),
    "hello trailing bytes": (HELLO, hello(1, 1) + bytes(8), "bad-length", "payload_bytes", "8"),
    "media with a payload": (MEDIA, bytes(8), "bad-length", "payload_bytes", "0"),
    "statistics with a payload": (STATISTICS, bytes(16), "bad-length", "payload_bytes", "0"),
    "ping too long": (PING, bytes(1032), "bad-length", "payload_bytes", "1024"),
    "type 0": (0, b"", "bad-type", "type", "message"),
    "type after the last": (max(wire.MESSAGES.values()) + 1, b"", "bad-type", "type", "message"),
    "type with a payload": (0x7FFF, bytes(64), "bad-type", "type", "message"),
    "type of a reply": (PING | wire.REPLY, b"", "bad-type", "type", "message"),
    "type of an error": (wire.TYPE_ERROR, bytes(128), "bad-type", "type", "message"),
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_message(shared, name):
    with shared.connect() as connection:
        assert_refused(connection, *OTHERS[name])
    assert_daemon_serves(shared)


ALIGNED = "bad-length", "payload_bytes", "a multiple of 8"
NO_SUCH_VERSION = "bad-version", "version", "2"
# Maps names to invalid headers: (header fields, payload, (status, field, allowed)).
HEADERS = {
    "version 0": ({"version": 0}, b"", NO_SUCH_VERSION),
    "version 1": ({"version": 1}, b"", NO_SUCH_VERSION),
    "version 1 with a payload": ({"version": 1}, bytes(64), NO_SUCH_VERSION),
    "version 1, odd payload": ({"version": 1}, bytes(13), NO_SUCH_VERSION),
    "payload of 1": ({}, bytes(1), ALIGNED),
    "payload of 7": ({}, bytes(7), ALIGNED),
    "payload of 1025": ({}, bytes(1025), ALIGNED),
    "eval cut by a byte": ({"type": EVAL}, eval_payload()[:-1], ALIGNED),
}


@pytest.mark.parametrize("name", HEADERS)
def test_header(shared, name):
    changes, payload, error = HEADERS[name]
    with shared.connect() as connection:
        at_fault = header(**changes, request_id=2**64 - 1, payload_bytes=len(payload))
        connection.send_bytes(at_fault + payload)
        assert_error(connection.receive_frame(), *error, request_id=2**64 - 1)
        assert_serves(connection)
    assert_daemon_serves(shared)


def test_a_skipped_payload_is_not_read_as_frames(connection):
    # The skipped payload looks like pings, which the daemon must not answer.
    inside = header(request_id=5) * 3
    connection.send_bytes(header(version=9, request_id=4, payload_bytes=len(inside)) + inside)
    assert_error(connection.receive_frame(), "bad-version", "version", "2", request_id=4)
    assert_serves(connection)


def test_wanted_quantities_are_what_is_sent(connection):
    # For comparison, this is the reply to R alone: no error, 2 radii, one array.
    reply = ask(connection, EVAL, eval_payload(wanted=R))
    assert len(reply.payload) == head_bytes(1, 1) + 2 * 8
    reply = ask(connection, EVAL, eval_payload(wanted=R | CDF | RADIUS, spacing=LINEAR, radii=None))
    assert len(reply.payload) == head_bytes(1, 3) + 3 * 2 * 8
