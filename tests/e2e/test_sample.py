"""Drawing radii: the cdf of a radius is the number for which it was drawn, numbers by a rule are
the documented ones, and large requests are answered in parts."""

from __future__ import annotations

import dipole
import numpy as np
import pytest
from dipole import Draw, wire
from frames import F32, SAMPLE, SKIN, assert_refused, frame, head_bytes, refused, sample_payload
from known import receive_answer
from lists import MODELS, PARAMETERS, needs

SAMPLED = SAMPLE | wire.REPLY
OTHER = (0.3, 2.0, 0.0, 1.4)
U = np.array([0.0, 1e-9, 1e-3, 0.1, 0.25, 0.5, 0.75, 0.9, 0.999, 1 - 1e-6, 1.0])
# Bounds of |cdf(r) - u|: see PROTOCOL.md. For a table, this is the tolerance to which it was built.
BOUNDS = {"f64": 1e-14, "f32": 4e-7, "lut": 1e-4}


# ---- values --------------------------------------------------------------------------------------


DRAWN = ["classical", "better", "burley", "quantized", "single", "skin-red"]


@pytest.mark.parametrize("evaluator", BOUNDS)
@pytest.mark.parametrize("model", DRAWN)
def test_the_cdf_of_a_radius_is_its_number(client, model, evaluator):
    """Checks the drawn radii by an eval of their cdf, which is computed independently."""
    sampled = client.sample(model, [SKIN, OTHER], U, evaluator=evaluator)
    assert sampled.r.shape == (2, len(U)) and sampled.model == model
    assert np.all(sampled.r[:, 0] == 0) and np.all(np.isinf(sampled.r[:, -1]))
    for channel, medium in enumerate([SKIN, OTHER]):
        assert np.all(np.diff(sampled.r[channel]) > 0)
        judged = client.eval(model, [medium], sampled.r[channel].astype(float), wanted=["cdf"])
        error = np.abs(judged.cdf[0] - sampled.u)
        bound = BOUNDS[evaluator] + max(one.numerical_error[channel] for one in sampled.errors.values())
        assert np.all(error <= bound), (model, evaluator, error)


def test_transport(client):
    sampled = client.sample("transport", [SKIN], U[1:-1], evaluator="lut")
    judged = client.eval("transport", [SKIN], sampled.r[0], evaluator="lut", wanted=["cdf"])
    assert np.abs(judged.cdf[0] - sampled.u).max() < 1e-4


@pytest.mark.parametrize("evaluator", ["f64", "f32", "lut"])
def test_quantities_are_those_of_an_eval_at_these_radii(client, evaluator):
    names = ["R", "cdf", "r", "dR_dr", "ln_R", "pdf", "2_pi_r_R", "S", "albedo"]
    names += ["dlnR_dln_sigma_a", "dlnR_dln_sigma_s"]
    given = {"parameters": {"cos_in": 0.7, "cos_out": 0.4}, "evaluator": evaluator}
    sampled = client.sample("better", [SKIN, OTHER], U, wanted=names, **given)
    assert set(sampled.values) == set(names) - {"albedo"}
    for channel, medium in enumerate([SKIN, OTHER]):
        r = sampled.r[channel]
        judged = client.eval("better", [medium], r, wanted=names, **given)
        assert judged.albedo[0] == sampled.albedo[channel]
        for name in judged.values:
            np.testing.assert_array_equal(judged.values[name][0], sampled.values[name][channel])


@pytest.mark.parametrize("evaluator", ["f64", "f32", "lut"])
@pytest.mark.parametrize("rule", ["random", "stratified", "regular"])
def test_numbers_by_rule_are_those_that_the_client_makes(client, rule, evaluator):
    """Numbers that the client makes by a rule, and then lists, give the same bits as the rule."""
    draw = Draw(2311, rule, seed=12345678901234567890, first=10**15 if rule == "random" else 0)
    by_rule = client.sample("better", [SKIN, OTHER], draw=draw, evaluator=evaluator)
    listed = client.sample("better", [SKIN, OTHER], by_rule.u, evaluator=evaluator)
    assert np.all((by_rule.u > 0) & (by_rule.u < 1))
    np.testing.assert_array_equal(by_rule.r, listed.r)
    np.testing.assert_array_equal(by_rule.pdf, listed.pdf)


def test_a_sequence_in_pieces(client):
    whole = client.sample("classical", SKIN, draw=Draw(1000, seed=3))
    rest = client.sample("classical", SKIN, draw=Draw(700, seed=3, first=300))
    np.testing.assert_array_equal(whole.r[:, 300:], rest.r)
    other = client.sample("classical", SKIN, draw=Draw(1000, seed=4))
    assert not np.any(whole.r == other.r)


def test_where_nothing_scatters_all_radii_are_0(client):
    sampled = client.sample("better", (1.0, 0.0, 0.0, 1.3), [0.0, 0.3, 0.9], wanted=["r", "R"])
    assert not sampled.r.any() and not sampled.values["R"].any()


def test_without_numbers(client):
    sampled = client.sample("better", SKIN, [], wanted=["r", "pdf", "albedo"])
    assert sampled.r.shape == (1, 0) and sampled.albedo[0] > 0
    alone = client.sample("better", SKIN, draw=Draw(3), wanted=["albedo"])
    assert not hasattr(alone, "r") and alone.albedo == sampled.albedo


def test_every_model_that_covers_all_radii_draws(client):
    drawn = 0
    for model in MODELS:
        given = {"parameters": needs(model), "wanted": ["r", "cdf"]}
        try:
            sampled = client.sample(model, SKIN, [0.2, 0.7], evaluator="f32", **given)
        except dipole.Refused as refusal:
            assert (refusal.field, model) == ("model", "gaussians")
            assert "covers all radii" in refusal.allowed
            continue
        assert np.abs(sampled.values["cdf"][0] - [0.2, 0.7]).max() < 1e-3, model
        drawn += 1
    assert drawn == len(MODELS) - 1


def test_arguments_that_do_not_fit(client):
    for arguments in (
        {},
        {"u": [0.5], "draw": Draw(3)},
        {"u": [[0.5], [0.6]]},
        {"draw": Draw(3, "lots")},
        {"draw": Draw(-1)},
        {"u": [0.5], "evaluator": 9},
    ):
        with pytest.raises(dipole.ArgumentError):
            client.sample("better", SKIN, **arguments)
    assert client.sample("better", SKIN, 0.5).r.shape == (1, 1)


# ---- requests that are wrong ---------------------------------------------------------------------

COS_IN = PARAMETERS["cos_in"].id
WRONG = {
    **refused("bad-value", "model", "classical", {
        "0": sample_payload(model=0),  # A sample needs a model: a tolerance cannot choose it.
        "999": sample_payload(model=999),
    }),
    **refused("bad-value", "evaluator", "f64", {"9": sample_payload(evaluator=9)}),
    **refused("bad-value", "moments", "exact", {"0": sample_payload(moments=0)}),
    **refused("bad-value", "wanted", "R", {
        "nothing": sample_payload(wanted=0), "unknown": sample_payload(wanted=0x8000)
    }),
    **refused("bad-value", "draw", "4 (random)", {
        "0": sample_payload(draw=0), "5": sample_payload(draw=5)
    }),
    **refused("bad-count", "medium_count", "at least 1", {"none": sample_payload([])}),
    **refused("bad-count", "medium_count", "holds", {
        "99": sample_payload(medium_count=99), "2^32 - 1": sample_payload(medium_count=2**32 - 1)
    }),
    **refused("too-large", "medium_count", "at most 64", {"65": sample_payload([SKIN] * 65)}),
    **refused("bad-count", "parameter_count", "holds", {
        "99": sample_payload(parameter_count=99),
        "2^16 - 1": sample_payload(parameter_count=2**16 - 1),
    }),
    **refused("bad-value", "cos_in", "0 to 1", {"2": sample_payload(parameters=[(COS_IN, 2.0)])}),
    **refused("bad-value", "g", "1", {"second": (sample_payload([SKIN, (0.1, 1, 1, 1.3)]), 1)}),
    **refused("bad-value", "u", "0 to 1", {
        **{
            f"{u}": (sample_payload(u=[0, 1, 0.5, u, 2]), 3)
            for u in (-0.1, -5e-324, np.nextafter(1, 2), 1.5, np.inf, np.nan)
        },
        "single": (sample_payload(u=[0.5, 1 + 2**-23], evaluator=F32), 1),
    }),
    **refused("bad-value", "u", "zero", {
        "padding": sample_payload(u=[0.5], evaluator=F32)[:-1] + b"\x01",
    }),
    **refused("bad-count", "sample_count", "no more numbers than", {
        "3": sample_payload(sample_count=3), "2^64 - 1": sample_payload(sample_count=2**64 - 1)
    }),
    **refused("bad-length", "payload_bytes", "nothing after the listed numbers", {
        "one more": sample_payload(sample_count=1), "trailing bytes": sample_payload() + bytes(8)
    }),
    **refused("bad-length", "payload_bytes", "nothing after the media and parameters", {
        "numbers after a rule": sample_payload(draw=wire.DRAW_REGULAR),
    }),
    **refused("bad-length", "payload_bytes", "at least 40", {"none": b"", "too short": bytes(32)}),
    **refused("bad-count", "sample_count", "1 to", {"0": sample_payload(u=None, sample_count=0)}),
    **refused("bad-count", "sample_count", "2^52", {
        "by rule": sample_payload(u=None, sample_count=2**63),
    }),
    **refused("too-large", "sample_count", "radii", {
        "more than max_radii": sample_payload(u=None, sample_count=2**41),
    }),
    **refused("bad-value", "sample_first", "0", {
        "of a list": sample_payload(sample_first=1),
        "of strata": sample_payload(u=None, draw=wire.DRAW_STRATIFIED, sample_first=1),
        "of regular": sample_payload(u=None, draw=wire.DRAW_REGULAR, sample_first=1, seed=0),
    }),
    **refused("bad-value", "sample_first", "2^52", {
        "too far": sample_payload(u=None, sample_first=2**53),
    }),
    **refused("bad-value", "seed", "0", {
        "of a list": sample_payload(seed=1),
        "of regular": sample_payload(u=None, draw=wire.DRAW_REGULAR, seed=1),
    }),
    **refused("bad-value", "model", "covers all radii", {
        "a fit": sample_payload(model=MODELS["gaussians"]),
    }),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said(connection, name):
    assert_refused(connection, SAMPLE, *WRONG[name])


# ---- large requests ------------------------------------------------------------------------------


def test_in_parts_the_same_bits(daemon):
    """A reply has the same bits when it fits into a frame exactly and when it is cut into parts."""
    one = daemon("--max-frame-bytes", "32768", "--max-part-bytes", "16384")
    whole = daemon()
    room = (32768 - head_bytes(2, 2)) // 8 // 4
    with one.client() as small, whole.client() as large, one.connect() as connection:
        for count, parts in ((room, 1), (room + 1, 4), (5000, 20)):
            draw = Draw(count, "stratified", seed=5)
            media = [SKIN, OTHER]
            in_parts = small.sample("better", media, draw=draw)
            at_once = large.sample("better", media, draw=draw)
            np.testing.assert_array_equal(in_parts.r, at_once.r)
            np.testing.assert_array_equal(in_parts.pdf, at_once.pdf)
            payload = sample_payload(media, None, draw=3, sample_count=count, seed=5)
            connection.send_bytes(frame(SAMPLE, 77, payload))
            first, received = receive_answer(connection)
            assert first.type == SAMPLED and len(received) == parts
            assert parts == 1 or all(len(part) <= 16384 for part in received)


@pytest.mark.parametrize("isa", ["portable", "sse2"])
def test_every_instruction_set_draws_the_same(daemon, client, isa):
    with daemon("--isa", isa).client() as other:
        for model in ("better", "burley", "extended"):
            for evaluator in BOUNDS:
                how = {"draw": Draw(300, seed=9), "evaluator": evaluator}
                one, two = (some.sample(model, SKIN, **how) for some in (client, other))
                np.testing.assert_array_equal(one.r, two.r)
