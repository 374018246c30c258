"""The daemon's description of itself: versions, lists, limits and statistics."""

import pytest
from daemons import eventually
from dipole import wire
from frames import (
    BETTER, EVAL, HELLO, SKIN, STATISTICS, ask, assert_serves, eval_payload, frame, read_statistics,
)
from lists import MODELS, NOTES, OTHER_PARAMETERS, PARAMETERS, choices


def versions(low: int, high: int) -> bytes:
    """The payload of a hello request."""
    return wire.HELLO_REQUEST.pack(version_min=low, version_max=high)


@pytest.mark.parametrize("low, high", [(2, 2), (0, 2), (2, 9), (0, 65535)])
def test_version_that_both_speak(connection, low, high):
    reply = ask(connection, HELLO, versions(low, high))
    assert reply.type == HELLO | wire.REPLY
    fixed = wire.HELLO_REPLY.unpack(reply.payload)
    assert (fixed.version, fixed.version_min, fixed.version_max) == (2, 2, 2)


def test_the_lists(client):
    listed = client.info.choices
    ids = {kind: {name: one.id for name, one in some.items()} for kind, some in listed.items()}
    named = {kind: kind.upper() for kind in ("evaluator", "moments", "quantity", "spacing", "parameter", "draw", "length", "phase")}
    named |= {"scale": "FIT_SCALE", "axis": "FIT_AXIS", "fit_status": "FIT_STATUS"}
    for kind, name in named.items():
        assert ids[kind] == choices(name), kind
    assert (ids["model"], ids["note"]) == (MODELS, NOTES)
    assert set(ids["parameter"]) == {*PARAMETERS, *OTHER_PARAMETERS}
    assert ids["status"] == {name: code for code, name in wire.STATUSES.items()}
    assert "d'Eon" in listed["model"]["better"].about
    assert listed["quantity"]["R"].about == "1/mm^2"
    assert all(one.about for entries in listed.values() for one in entries.values())


def test_permanent_ids(client):
    """Old clients have these ids compiled in."""
    permanent = {
        "model": {"classical": 1, "better": 2},
        "evaluator": {"f64": 1, "f32": 2, "lut": 3},
        "moments": {"exact": 1, "fit": 2, "jensen": 3},
        "quantity": {"R": 1, "albedo": 2, "cdf": 4, "r": 8, "2_pi_r_R": 128, "S": 256},
        "parameter": {"tolerance": 1, "cos_in": 2, "cos_out": 3, "surface_albedo": 5},
        "note": {"similarity": 1, "albedo-above-1": 2},
        "spacing": {"list": 1, "linear": 2, "logarithmic": 3},
        "draw": {"list": 1, "regular": 2, "stratified": 3, "random": 4},
        "length": {"mean-free-path": 1, "diffuse-mean-free-path": 2, "classical-diffuse-path": 3,
                   "extinction-path": 4},
        "scale": {"absolute": 1, "free": 2, "reference": 3},
        "axis": {"r": 1, "f": 2},
        "fit_status": {
            "fitted": 1, "at-bound": 2, "undetermined": 3, "ambiguous": 4, "unfinished": 5,
            "refused": 6, "implausible": 7,
        },
    }
    for kind, ids in permanent.items():
        for name, number in ids.items():
            assert client.info.choices[kind][name].id == number


def test_who_it_is(client):
    info = client.info
    assert info.software.startswith("dipoled ")
    assert info.protocol_version == 2
    assert info.workers == 2
    assert "1/mm^2" in info.R_unit and "entered" in info.R_unit


def test_statistics_of_connections(daemon):
    one = daemon("--max-connections", "3")
    with one.client() as client:
        assert client.statistics()["connections_open"] == 1
        with one.connect() as second, one.connect("tcp") as third:
            assert_serves(second)
            assert_serves(third)
            with one.connect() as fourth:
                fourth.receive_frame()
            there = client.statistics()
            assert there["connections_open"] == 3
            assert there["connections_accepted"] == 3
            assert there["connections_refused"] == 1
            assert there["replies_busy"] == 1
        assert eventually(lambda: client.statistics()["connections_open"] == 1)
        assert client.statistics()["connections_accepted"] == 3


def test_statistics_of_bytes(daemon):
    one = daemon()
    with one.connect() as connection:
        first = ask(connection, STATISTICS)
        sent = frame(EVAL, 5, eval_payload([SKIN], [1.0, 2.0], model=BETTER))
        connection.send_bytes(sent)
        reply = connection.receive_frame()
        second = ask(connection, STATISTICS)

    before, after = read_statistics(first.payload), read_statistics(second.payload)
    header_bytes = wire.HEADER.bytes
    received = after["received_bytes"] - before["received_bytes"]
    assert received == len(sent) + header_bytes  # the request, and the second statistics request
    answered = after["sent_bytes"] - before["sent_bytes"]
    assert answered == 2 * header_bytes + len(first.payload) + len(reply.payload)
    assert after["uptime_ms"] >= before["uptime_ms"]
