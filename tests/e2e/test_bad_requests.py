"""Requests that cannot be answered: each gets an error that names the field and what is allowed,
and its connection, like the daemon, goes on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from dipole import wire
from frames import (
    ALBEDO,
    CDF,
    EVAL,
    F32,
    HELLO,
    LINEAR,
    LOGARITHMIC,
    MEDIA,
    PING,
    RADIUS,
    SKIN,
    STATISTICS,
    R,
    ask,
    assert_daemon_serves,
    assert_error,
    assert_serves,
    eval_payload,
    header,
)
from lists import MOMENTS

INF, NAN = math.inf, math.nan
above = np.nextafter  # above(x, inf): the next double


def medium(**changes: float) -> tuple[float, float, float, float]:
    """SKIN with some coefficients changed."""
    values = dict(zip(("sigma_a", "sigma_s", "g", "eta"), SKIN))
    return tuple({**values, **changes}.values())


def with_bad(bad, at: int = 1) -> list:
    """Three media or radii of which one, by default the second, is bad."""
    return [SKIN] * at + [bad] + [SKIN] * (2 - at)


# name: (payload, status, field, allowed, index)
CHOICES = {
    "model 0": (eval_payload(model=0), "bad-value", "model", "0 with the parameter tolerance"),
    "model unknown": (eval_payload(model=999), "bad-value", "model", "1 (classical)"),
    "evaluator 0": (eval_payload(evaluator=0), "bad-value", "evaluator", "1 (f64), 2 (f32), 3 (lut)"),
    "evaluator unknown": (eval_payload(evaluator=65535), "bad-value", "evaluator", "1 (f64)"),
    "moments 0": (eval_payload(moments=0), "bad-value", "moments", "1 (exact), 2 (fit)"),
    "moments unknown": (eval_payload(moments=65535), "bad-value", "moments", "1 (exact)"),
    "spacing 0": (eval_payload(spacing=0), "bad-value", "spacing", "1 (list), 2 (linear)"),
    "spacing unknown": (eval_payload(spacing=65535), "bad-value", "spacing", "1 (list)"),
    "spacing wraps to 1 in 8 bits": (eval_payload(spacing=257), "bad-value", "spacing", "1 (list)"),
    "wanted nothing": (eval_payload(wanted=0), "bad-value", "wanted", "1 (R), 2 (albedo)"),
    "wanted unknown bit": (eval_payload(wanted=0x4000), "bad-value", "wanted", "4 (cdf), 8 (r)"),
    "wanted known and unknown": (eval_payload(wanted=0x8007), "bad-value", "wanted", "1 (R)"),
}

COEFFICIENTS = {
    f"{field} {value}": (
        eval_payload(with_bad(medium(**{field: value}))),
        "bad-value",
        field,
        allowed,
        1,
    )
    for field, allowed, values in [
        ("sigma_a", "0 to 1e15", [-0.1, -5e-324, INF, -INF, NAN, above(1e15, INF)]),
        ("sigma_s", "0 to 1e15", [-0.1, -5e-324, INF, -INF, NAN, above(1e15, INF)]),
        ("g", "-1 and 1, exclusive", [1.0, -1.0, 1.5, -7.0, INF, -INF, NAN]),
        ("eta", "0.001 to 1000", [0.0, -0.0, -1.3, INF, NAN, above(1e-3, 0), above(1e3, INF)]),
    ]
    for value in values
}

TRANSPORT = {
    "sigma_a and sigma_s 0": (
        eval_payload(with_bad((0.0, 0.0, 0.0, 1.3), at=2)),
        "bad-value",
        "sigma_s",
        "1e-15",
        2,
    ),
    "sigma_t' too small": (
        eval_payload(with_bad((4e-16, 5e-16, 0.0, 1.3), at=0)),
        "bad-value",
        "sigma_s",
        "1e-15",
    ),
    "sigma_t' too small through g": (
        eval_payload(with_bad((0.0, 1e-3, above(1, 0), 1.3))),
        "bad-value",
        "sigma_s",
        "1e-15",
        1,
    ),
    **{
        f"{name} {side} its range": (
            eval_payload(with_bad(medium(eta=eta), at=2), moments=moments.id),
            "bad-value",
            "eta",
            f"{moments.eta_min:g} to {moments.eta_max:g}",
            2,
        )
        for name, moments in MOMENTS.items()
        for side, eta in [
            ("below", above(moments.eta_min, 0)),
            ("above", above(moments.eta_max, INF)),
        ]
    },
}

RADII = {
    "negative": (eval_payload(radii=[0, 1, 2, -1e-300]), "bad-value", "r", "0 to infinity", 3),
    "first NaN": (eval_payload(radii=[NAN, 1]), "bad-value", "r", "0 to infinity"),
    "-inf": (eval_payload(radii=[1, -INF, 2]), "bad-value", "r", "0 to infinity", 1),
    "the first of two": (eval_payload(radii=[1, 2, -1, NAN]), "bad-value", "r", "0 to inf", 2),
    "f32 negative": (
        eval_payload(radii=[1, 1, 1, 1, -1], evaluator=F32),
        "bad-value",
        "r",
        "0 to infinity",
        4,
    ),
    "f32 NaN": (eval_payload(radii=[1, NAN, 1], evaluator=F32), "bad-value", "r", "0 to inf", 1),
    "only albedo wanted": (
        eval_payload(radii=[1, NAN], wanted=ALBEDO),
        "bad-value",
        "r",
        "0 to infinity",
        1,
    ),
    "far down a long list": (
        eval_payload(radii=[1.0] * 99_999 + [NAN]),
        "bad-value",
        "r",
        "0 to infinity",
        99_999,
    ),
}


def grid(**fixed: float) -> bytes:
    """An eval payload with a grid."""
    return eval_payload(radii=None, **fixed)


LOG = {"spacing": LOGARITHMIC, "radius_start": 0.1}
GRIDS = {
    "log from 0": (
        grid(spacing=LOGARITHMIC, radius_start=0.0),
        "bad-value",
        "radius_start",
        "at least 1e-300",
    ),
    "log from too near 0": (
        grid(spacing=LOGARITHMIC, radius_start=above(1e-300, 0)),
        "bad-value",
        "radius_start",
        "at least 1e-300",
    ),
    "log from below 0": (
        grid(spacing=LOGARITHMIC, radius_start=-1.0),
        "bad-value",
        "radius_start",
        "at least 1e-300",
    ),
    "log stop < start": (
        grid(**LOG, radius_stop=above(0.1, 0)),
        "bad-value",
        "radius_stop",
        "at least radius_start",
    ),
    "log stop inf": (grid(**LOG, radius_stop=INF), "bad-value", "radius_stop", "finite"),
    "linear from below 0": (grid(radius_start=-5e-324), "bad-value", "radius_start", "at least 0"),
    "linear from NaN": (grid(radius_start=NAN), "bad-value", "radius_start", "finite"),
    "linear from inf": (
        grid(radius_start=INF, radius_stop=INF),
        "bad-value",
        "radius_start",
        "finite",
    ),
    "linear stop < start": (
        grid(radius_start=2.0, radius_stop=1.0),
        "bad-value",
        "radius_stop",
        "at least radius_start",
    ),
    "linear stop NaN": (grid(radius_stop=NAN), "bad-value", "radius_stop", "finite"),
    "linear stop inf": (grid(radius_stop=INF), "bad-value", "radius_stop", "finite"),
    "no radii": (grid(radius_count=0), "bad-count", "radius_count", "1 to 2^53"),
    "beyond 2^53": (grid(radius_count=2**53 + 1), "bad-count", "radius_count", "1 to 2^53"),
    "2^64 - 1": (grid(radius_count=2**64 - 1), "bad-count", "radius_count", "1 to 2^53"),
    "2^61, whose bytes wrap to 0": (
        grid(radius_count=2**61),
        "bad-count",
        "radius_count",
        "1 to 2^53",
    ),
    "2^53, too many": (grid(radius_count=2**53), "too-large", "radius_count", str(2**40)),
    "2^40 + 1, too many": (grid(radius_count=2**40 + 1), "too-large", "radius_count", str(2**40)),
    "radii alone too many": (
        grid(radius_count=2**41, wanted=RADIUS),
        "too-large",
        "radius_count",
        "at most",
    ),
}

COUNTS = {
    "no medium": (eval_payload([]), "bad-count", "medium_count", "at least 1"),
    # The next two still hold bytes enough for their media, so the list is what comes up short.
    "one medium too many": (
        eval_payload([SKIN], [1, 2, 3, 4], medium_count=2),
        "bad-count",
        "radius_count",
        "no more radii than",
    ),
    "one medium too few": (
        eval_payload([SKIN, SKIN], [1.0], medium_count=1),
        "bad-length",
        "payload_bytes",
        "nothing after",
    ),
    **{
        f"{count:#x} media": (
            eval_payload(medium_count=count),
            "bad-count",
            "medium_count",
            "no more media than the payload holds",
        )
        # the last two: counts whose bytes wrap in 32 bits to those that are there
        for count in [2, 2**31, 2**32 - 1, 2**27 + 1, 2**28 + 1]
    },
    **{
        f"{count:#x} radii": (
            eval_payload(radius_count=count),
            "bad-count",
            "radius_count",
            "no more radii than the payload holds",
        )
        # the last three: counts whose bytes wrap in 32 or 64 bits to those that are there
        for count in [3, 2**32 - 1, 2**32, 2**63, 2**64 - 1, 2**29 + 2, 2**32 + 2, 2**61 + 2]
    },
    "f32 2^62 + 2 radii": (
        eval_payload(radius_count=2**62 + 2, evaluator=F32),
        "bad-count",
        "radius_count",
        "no more radii than the payload holds",
    ),
    "one radius too few": (
        eval_payload(radius_count=1),
        "bad-length",
        "payload_bytes",
        "nothing after the listed radii",
    ),
    "no radii but a list": (
        eval_payload(radius_count=0, wanted=ALBEDO),
        "bad-length",
        "payload_bytes",
        "nothing after the listed radii",
    ),
}

LENGTHS = {
    "eval empty": (b"", "bad-length", "payload_bytes", "at least 40"),
    "eval cut in its fixed part": (
        eval_payload()[:32],
        "bad-length",
        "payload_bytes",
        "at least 40",
    ),
    "eval without its media": (
        eval_payload()[:40],
        "bad-count",
        "medium_count",
        "no more media than",
    ),
    "eval with a medium cut": (
        eval_payload()[:64],
        "bad-count",
        "medium_count",
        "no more media than",
    ),
    "trailing bytes": (
        eval_payload() + bytes(8),
        "bad-length",
        "payload_bytes",
        "nothing after the listed radii",
    ),
    "trailing bytes after a grid": (
        eval_payload(radii=None) + bytes(8),
        "bad-length",
        "payload_bytes",
        "nothing after media and parameters",
    ),
    "f32 trailing bytes": (
        eval_payload(radii=[1.0], evaluator=F32) + bytes(8),
        "bad-length",
        "payload_bytes",
        "nothing after the listed radii",
    ),
}

UNUSED = {
    "padding": (
        eval_payload(radii=[1.0, 2.0, 3.0], evaluator=F32)[:-1] + b"\x01",
        "bad-value",
        "r",
        "zero bytes of padding",
    ),
    "start with a list": (eval_payload(radius_start=1.0), "bad-value", "radius_start", "0 when"),
    "NaN start, list": (eval_payload(radius_start=NAN), "bad-value", "radius_start", "0 when"),
    "stop with a list": (eval_payload(radius_stop=1.0), "bad-value", "radius_stop", "0 when"),
}

EVALS = {
    f"{group}: {name}": case
    for group, cases in [
        ("choices", CHOICES),
        ("coefficients", COEFFICIENTS),
        ("media", TRANSPORT),
        ("radii", RADII),
        ("grids", GRIDS),
        ("counts", COUNTS),
        ("lengths", LENGTHS),
        ("unused", UNUSED),
    ]
    for name, case in cases.items()
}


@pytest.mark.parametrize("name", EVALS)
def test_eval(shared, name):
    payload, status, field, allowed, *index = EVALS[name]
    with shared.connect() as connection:
        assert_error(ask(connection, EVAL, payload), status, field, allowed, *index)
        assert_serves(connection)
    assert_daemon_serves(shared)


def test_faults_are_named_in_the_order_of_the_tables(connection):
    # Everything at once: the first of the table's fields, then the first medium, is what is named.
    media = [SKIN, medium(g=1.0, eta=0.0), medium(sigma_a=-1.0)]
    both = eval_payload(media, radii=[-1.0])
    assert_error(ask(connection, EVAL, both), "bad-value", "g", "exclusive", 1)
    all_ids = eval_payload(media, model=999, evaluator=0, moments=0)
    assert_error(ask(connection, EVAL, all_ids), "bad-value", "model", "1 (classical)")
    media_before_radii = eval_payload([medium(eta=0.0)], radii=[NAN])
    assert_error(ask(connection, EVAL, media_before_radii), "bad-value", "eta", "0.001")
    assert_serves(connection)


def hello(version_min: int, version_max: int, zero: int = 0) -> bytes:
    """The payload of a hello request."""
    return wire.HELLO_REQUEST.pack(version_min=version_min, version_max=version_max, zero=zero)


# name: (type, payload, status, field, allowed)
OTHERS = {
    "hello newer": (HELLO, hello(2, 9), "bad-version", "version_max", "1"),
    "hello older": (HELLO, hello(0, 0), "bad-version", "version_max", "1"),
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
    type, payload, status, field, allowed = OTHERS[name]
    with shared.connect() as connection:
        assert_error(ask(connection, type, payload), status, field, allowed)
        assert_serves(connection)
    assert_daemon_serves(shared)


# name: (header fields, payload, status, field, allowed)
HEADERS = {
    "version 0": ({"version": 0}, b"", "bad-version", "version", "1"),
    "version 2": ({"version": 2}, b"", "bad-version", "version", "1"),
    "version 2 with a payload": ({"version": 2}, bytes(64), "bad-version", "version", "1"),
    "version 2, odd payload": ({"version": 2}, bytes(13), "bad-version", "version", "1"),
    "payload of 1": ({}, bytes(1), "bad-length", "payload_bytes", "a multiple of 8"),
    "payload of 7": ({}, bytes(7), "bad-length", "payload_bytes", "a multiple of 8"),
    "payload of 1025": ({}, bytes(1025), "bad-length", "payload_bytes", "a multiple of 8"),
    "eval cut by a byte": (
        {"type": EVAL},
        eval_payload()[:-1],
        "bad-length",
        "payload_bytes",
        "a multiple of 8",
    ),
}


@pytest.mark.parametrize("name", HEADERS)
def test_header(shared, name):
    changes, payload, status, field, allowed = HEADERS[name]
    with shared.connect() as connection:
        at_fault = header(**changes, request_id=2**64 - 1, payload_bytes=len(payload))
        connection.send_bytes(at_fault + payload)
        reply = connection.receive_frame()
        assert_error(reply, status, field, allowed, request_id=2**64 - 1)
        assert_serves(connection)
    assert_daemon_serves(shared)


def test_a_skipped_payload_is_not_read_as_frames(connection):
    # What is skipped looks like pings, none of which may be answered.
    inside = header(request_id=5) * 3
    connection.send_bytes(header(version=9, request_id=4, payload_bytes=len(inside)) + inside)
    assert_error(connection.receive_frame(), "bad-version", "version", "1", request_id=4)
    assert_serves(connection)


def test_wanted_quantities_are_what_is_sent(connection):
    # The reply to R alone, for comparison: no error, 2 radii, one array.
    reply = ask(connection, EVAL, eval_payload(wanted=R))
    assert len(reply.payload) == wire.EVAL_REPLY.bytes + wire.CHANNEL.bytes + 2 * 8
    reply = ask(connection, EVAL, eval_payload(wanted=R | CDF | RADIUS, spacing=LINEAR, radii=None))
    assert len(reply.payload) == wire.EVAL_REPLY.bytes + wire.CHANNEL.bytes + 3 * 2 * 8
