"""Clients give a tolerance in place of a model: which model is chosen, and what the answer says
about its error."""

from __future__ import annotations

import re
from functools import partial

import dipole as python_client
import numpy as np
import pytest
from command_line import FAILED, dipole, eval_json, eval_rows, says
from dipole import Grid, Medium, wire
from frames import ALBEDO, EVAL, F32, F64, R, SKIN, ask, assert_refused, assert_serves
from frames import eval_payload
from lists import EVALUATORS, MODELS, PARAMETERS

OFFERS = wire.MESSAGES["offers"]
TOLERANCE = PARAMETERS["tolerance"].id
MEDIUM = ["--sigma-a", "0.032", "--sigma-s", "0.74"]  # SKIN
RANGE = ["--from", "0.5", "--to", "8", "--count", "3"]


def error_of(answer: python_client.Result) -> float:
    """Returns the error against transport that the answer states."""
    return float(np.max(answer.model_error[:, np.newaxis] + answer.numerical_error()))


def total(offer: python_client.Offer, count: int) -> float:
    """Returns the cost of a medium at so many radii."""
    return offer.prepare_ns + count * offer.cost_ns


# ---- Python --------------------------------------------------------------------------------------


@pytest.mark.parametrize("tolerance", [0.5, 0.1, 0.01, 1e-3, 1e-5])
@pytest.mark.parametrize("evaluator", ["f64", "f32", None])
def test_the_answer_keeps_the_tolerance(client, tolerance, evaluator):
    media = [SKIN, (0.17, 0.88, 0.0, 1.3)]
    how = {"evaluator": evaluator, "tolerance": tolerance, "wanted": ["R", "albedo"]}
    answer = client.eval(None, media, [0.5, 2.0, 6.0], **how)
    assert error_of(answer) <= tolerance * (1 + 1e-6)
    assert answer.R.dtype == (np.float64 if evaluator == "f64" else np.float32)
    assert (answer.evaluator == "f64") == (evaluator == "f64")
    exact = client.eval("transport", media, [0.5, 2.0, 6.0], tolerance=1e-8)
    np.testing.assert_allclose(answer.R, exact.R, rtol=tolerance)
    np.testing.assert_allclose(answer.albedo, exact.albedo, rtol=tolerance)


def test_the_choice_is_that_of_the_offers(client):
    for tolerance in (0.5, 0.05, 1e-3):
        how = {"tolerance": tolerance, "wanted": ["R"], "evaluator": "f32"}
        offers, taken = client.offers(SKIN, [0.5, 1.0, 8.0], **how)
        answer = client.eval(None, SKIN, [0.5, 3.0, 8.0], **how)
        assert (taken.model, taken.evaluator) == (answer.model, answer.evaluator)
        assert taken.meets and taken.error <= tolerance and taken in offers
        assert error_of(answer) <= taken.error * (1 + 1e-6)
        costs = [total(offer, 3) for offer in offers]
        assert costs == sorted(costs) and costs[0] > 0
        assert all(offer.meets == (offer.error <= tolerance) for offer in offers)
        assert all(offer.prepare_ns > 0 for offer in offers)
        own = [o for o in offers if o.model == "transport" and o.meets]
        assert taken in own and not any(total(o, 3) < total(taken, 3) for o in own)


def test_offers_where_nothing_keeps_the_tolerance(client):
    offers, taken = client.offers(SKIN, [1.0], tolerance=1e-9, wanted=["R"])
    assert taken is None and offers and not any(offer.meets for offer in offers)
    with pytest.raises(python_client.Refused) as caught:
        client.eval(None, SKIN, [1.0], tolerance=1e-9, wanted=["R"])
    assert caught.value.field == "tolerance" and "(best: transport, " in caught.value.allowed


DENSE = (0.4, 11.0, 0.85, 1.4)  # beyond 10 mean free paths at 4.88 mm
THREE = [(0.05, 7.0, 0.85, 1.4), DENSE, (0.15, 9.0, 0.85, 1.4)]
REFUSAL = r"at least (\S+) for medium %d \(best: transport, (?:lut|f32|f64)\)"


def refusal(client, media, radii, **how) -> python_client.Refused:
    with pytest.raises(python_client.Refused) as caught:
        client.eval(None, media, radii, **how)
    assert caught.value.field == "tolerance"
    return caught.value


@pytest.mark.parametrize("evaluator", ["f64", "f32", "lut"])
@pytest.mark.parametrize("tolerance", [1e-8, 9e-5])
def test_the_least_that_a_refusal_quotes_is_accepted(client, evaluator, tolerance):
    how = {"evaluator": evaluator, "wanted": ["R", "albedo"]}
    error = refusal(client, THREE, [0.05, 5.0], tolerance=tolerance, **how)
    least = re.match(REFUSAL % 2, error.allowed)
    assert error.index == 1 and least is not None
    assert error_of(client.eval(None, THREE, [0.05, 5.0], tolerance=float(least[1]), **how)) <= 1
    lower = refusal(client, THREE, [0.05, 5.0], tolerance=0.9 * tolerance, **how)
    assert lower.allowed.startswith(least[0])


def test_a_medium_whose_error_nothing_bounds_is_named(client):
    error = refusal(client, [SKIN, (1e-3, 1e-3, 0.995, 2.5)], [1.0], tolerance=0.1, wanted="R")
    known = "a model instead: no error known"
    assert error.allowed == f"{known}: g 0.995 is above 0.99 for medium 2"
    assert error.index == 1
    for medium, cause in (((0.1, 1.0, -0.99, 1.4), "g -0.99 is below -0.98"),
                          ((1500.0, 1.0, 0.0, 1.4), "sigma_a/sigma_s' 1500 is above 1e+03")):
        error = refusal(client, [medium], [1.0], tolerance=0.1, wanted="R")
        assert error.allowed == f"{known}: {cause}"


def test_what_the_table_does_not_keep_is_solved(client):
    """A tolerance below the table's error, then a medium beyond the table."""
    medium, radii, how = THREE[0], [2.5, 5.0], {"evaluator": "f64", "wanted": ["R", "albedo"]}
    table = client.eval("transport", medium, radii, **how)
    assert error_of(table) > 3e-4
    for answer in (client.eval(None, medium, radii, tolerance=3e-4, **how),
                   client.eval("transport", medium, radii, tolerance=3e-4, **how)):
        assert answer.model == "transport" and error_of(answer) <= 3e-4
        np.testing.assert_allclose(answer.R, table.R, rtol=error_of(answer) + error_of(table))
        assert (answer.R != table.R).all()
    beyond = [SKIN, (0.1, 1.0, 0.0, 2.5)]
    answer = client.eval(None, beyond, radii, tolerance=0.01, **how)
    assert error_of(answer) <= 0.01
    assert answer.R.tobytes() == client.eval("transport", beyond, radii, **how).R.tobytes()


@pytest.mark.parametrize("evaluator", ["f64", None])
def test_media_beyond_the_table_keep_it_too(client, evaluator):
    """They are solved in either precision, or refused with the least error."""
    medium = Medium(0.05, 95.0, 0.99, 1.4)
    how = {"wanted": ["R"], "evaluator": evaluator}
    answer = client.eval(None, medium, [1.0], tolerance=0.03, **how)
    assert answer.model == "transport" and error_of(answer) <= 0.03
    with pytest.raises(python_client.Refused) as caught:
        client.eval(None, medium, [0.1, 1.0], tolerance=1e-4, **how)
    assert caught.value.field == "tolerance" and "at least" in caught.value.allowed


def test_a_tolerance_that_the_solver_misses_is_refused(client):
    narrow, how = [SKIN, (0.1, 33.0, 0.97, 1.4)], {"wanted": "R", "evaluator": "f64"}
    error = refusal(client, narrow, [0.02, 1.0], tolerance=2e-3, **how)
    least = re.fullmatch(r"at least (\S+) for medium 2 \(best: transport, solved\)", error.allowed)
    assert error.index == 1 and least is not None
    answer = client.eval(None, narrow, [0.02, 1.0], tolerance=float(least[1]), **how)
    assert 2e-3 < error_of(answer) <= float(least[1])


def test_grids_and_submitted_queries(client):
    grid = Grid(0.5, 8.0, 5)
    how = {"grid": grid, "tolerance": 0.01, "wanted": ["R", "r"]}
    answer = client.eval(None, SKIN, **how)
    assert answer.r.tolist() == [0.5, 2.375, 4.25, 6.125, 8.0]
    request_id = client.submit(None, SKIN, **how)
    found, again = client.collect()
    assert found == request_id and again.model == answer.model
    assert again.R.tobytes() == answer.R.tobytes()
    assert client.offers(SKIN, grid=grid, tolerance=0.01, wanted=["R"]).taken is not None


def test_wrong_arguments(client):
    refused = []
    for tolerance in (0.0, 2.0, -1.0):
        ask = partial(client.eval, None, SKIN, [1.0], tolerance=tolerance)
        refused.append(("tolerance", ask))
    refused.append(("sigma_a", lambda: client.offers(Medium(-1.0, 1.0), [1.0], tolerance=0.1)))
    refused.append(("r", lambda: client.offers(SKIN, [-1.0], tolerance=0.1)))
    for field, ask in refused:
        with pytest.raises(python_client.Refused) as caught:
            ask()
        assert caught.value.field == field
    with pytest.raises(python_client.ArgumentError, match="^model: "):
        client.eval(None, SKIN, [1.0])
    with pytest.raises(python_client.ArgumentError):
        client.eval(None, SKIN, [1.0], tolerance=0.1, parameters={"tolerance": 0.1})


def test_a_model_keeps_its_numerical_tolerance(client):
    answer = client.eval("quantized", SKIN, [1.0], tolerance=1e-3)
    assert answer.model == "quantized" and answer.evaluator == "f64"
    same = client.eval("quantized", SKIN, [1.0], parameters={"tolerance": 1e-3})
    assert answer.R == same.R != client.eval("quantized", SKIN, [1.0]).R


# ---- the wire ------------------------------------------------------------------------------------


def any_model(tolerance=0.01, **fixed) -> bytes:
    """Makes the payload of an eval or offers request of any model."""
    parameters = [(TOLERANCE, tolerance)] if tolerance is not None else []
    fields = {"model": 0, "wanted": R | ALBEDO, **fixed}
    return eval_payload(parameters=parameters, **fields)


def test_offers_on_the_wire(connection):
    reply = ask(connection, OFFERS, any_model())
    assert reply.type == OFFERS | wire.REPLY
    fixed = wire.OFFERS_REPLY.unpack(reply.payload)
    assert len(reply.payload) == wire.OFFERS_REPLY.bytes + fixed.count * wire.OFFER.bytes
    assert fixed.taken < fixed.count
    for i in range(fixed.count):
        at = wire.OFFERS_REPLY.bytes + i * wire.OFFER.bytes
        offer = wire.OFFER.unpack(reply.payload, at)
        assert offer.model in MODELS.values() and offer.evaluator == EVALUATORS["f64"]
        assert offer.meets in (0, 1) and offer.error >= offer.numerical_error > 0
    assert_serves(connection)


REFUSED = {
    "a model": (any_model(model=1), "bad-value", "model"),
    "no tolerance": (any_model(None), "bad-value", "model"),
    "tolerance": (any_model(2.0), "bad-value", "tolerance"),
    "evaluator": (any_model(evaluator=9), "bad-value", "evaluator"),
    "medium": (any_model(media=[(1.0, 1.0, 0.0, 0.0)]), "bad-value", "eta"),
    "media": (any_model(media=[]), "bad-count", "medium_count"),
    "short": (any_model()[:-8], "bad-count", "radius_count"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_offers_that_are_refused(connection, name):
    assert_refused(connection, OFFERS, *REFUSED[name], "")


def test_the_choice_counts_preparing(connection, client):
    """A table is not made for a few radii, and many radii get one, however they come."""
    few = any_model(0.03, radii=(0.5, 5.0), evaluator=F32)
    many = any_model(0.03, radii=tuple(np.linspace(0.5, 5, 250_000)), evaluator=F32)
    evaluators = [
        wire.EVAL_REPLY.unpack(ask(connection, EVAL, payload).payload).evaluator
        for payload in (few, many)
    ]
    assert evaluators == [EVALUATORS["f32"], EVALUATORS["lut"]]
    how = {"tolerance": 0.03, "wanted": ["R"], "evaluator": "f32"}
    radii = np.linspace(0.5, 5.0, 250_000).astype(np.float32)
    listed = client.eval(None, SKIN, radii, **how)
    grid = client.eval(None, SKIN, grid=Grid(0.5, 5.0, 250_000), **how)
    assert listed.evaluator == grid.evaluator == "lut" and listed.model == grid.model
    offers, taken = client.offers(SKIN, grid=Grid(0.5, 5.0, 250_000), **how)
    assert (taken.model, taken.evaluator) == (grid.model, grid.evaluator)
    costs = [total(offer, 250_000) for offer in offers]
    assert costs == sorted(costs)


def test_all_parts_have_one_choice(client):
    """An answer in parts is one request, with one model."""
    whole = Grid(0.5, 5.0, client.info.limits["max_frame_bytes"] // 4 + 1)
    how = {"grid": whole, "tolerance": 0.03, "wanted": ["R"], "evaluator": "f32"}
    parts = list(client.eval_parts(None, SKIN, **how))
    assert len(parts) > 1 and {(part.model, part.evaluator) for part in parts} == {
        (parts[0].model, "lut")
    }


def test_a_loose_tolerance_builds_a_loose_table(client):
    """A table is made to what the tolerance leaves, not to 1e-4."""
    grid = Grid(0.5, 5.0, 1_000_000)
    for tolerance, least, most in ((0.03, 1.1e-4, 1e-3), (2e-4, 0.0, 2e-4)):
        how = {"grid": grid, "tolerance": tolerance, "wanted": ["R"], "evaluator": "f32"}
        answer = client.eval(None, SKIN, **how)
        assert answer.evaluator == "lut"
        assert least < np.max(answer.numerical_error([5.0])) <= most


def test_evaluators_of_a_precision_mean_the_same(connection):
    same = {ask(connection, EVAL, any_model(evaluator=e)).payload for e in (F32, 3)}
    assert len(same) == 1
    assert ask(connection, EVAL, any_model(evaluator=F64)).payload not in same


# ---- anisotropic scattering ----------------------------------------------------------------------

TISSUE = (0.05, 9.5, 0.9, 1.4)


def test_a_tolerance_is_answered_for_tissue(client):
    """From .1 to 5 mm, 20 media of g from -.5 to .95 and all quantities with an error."""
    radii = [0.1, 1.0, 5.0]
    for g in np.linspace(-0.5, 0.95, 20):
        medium = (0.05, 0.95 / (1 - g), float(g), 1.4)
        for tolerance, wanted in ((0.02, ["R", "albedo"]), (0.05, ["cdf", "pdf"])):
            answer = client.eval(None, medium, radii, tolerance=tolerance, wanted=wanted)
            assert error_of(answer) <= tolerance
    report = eval_json(*"--sigma-a .05 --sigma-s 9.5 --g .9 --eta 1.4 --tolerance .01".split(),
                       *["--r", "0.1,1,5"])
    for row in report["rows"]:
        assert row["model"] == "transport" and row["numerical_error"] + row["model_error"] <= 0.01


def test_other_models_are_offered_for_tissue(client):
    """Their errors are computed for this medium, but a tolerance takes transport."""
    how = {"evaluator": "f32", "wanted": ["R"]}
    offers, taken = client.offers(TISSUE, [2.0, 3.0, 5.0], tolerance=0.5, **how)
    assert taken.model == "transport" and all(np.isfinite(offer.error) for offer in offers)
    assert {"single", "better+single", "better", "beam"} <= {offer.model for offer in offers}
    truth = client.eval("transport", TISSUE, [2.0, 3.0, 5.0], evaluator="f64", wanted=["R"])
    for model in {offer.model for offer in offers}:
        answer = client.eval(model, TISSUE, [2.0, 3.0, 5.0], wanted=["R"])
        off = np.abs(answer.R / truth.R - 1).max()
        assert off <= answer.model_error[0] <= off * 1.05 + 0.005
        offered = min(offer.error for offer in offers if offer.model == model)
        assert answer.model_error[0] <= offered * (1 + 1e-6) + 1e-6


# ---- dipole eval ---------------------------------------------------------------------------------


def test_all_formats_name_what_was_taken(client):
    asked = [*MEDIUM, "--tolerance", "0.1", *RANGE]
    rows, report = eval_rows(*asked), eval_json(*asked)
    how = {"grid": Grid(0.5, 8.0, 3), "tolerance": 0.1, "wanted": ["R", "albedo"]}
    taken = client.offers(SKIN, **how).taken
    answer = client.eval(None, SKIN, **how)
    assert np.array([row["R"] for row in rows], answer.R.dtype).tolist() == answer.R[0].tolist()
    for row, same in zip(rows, report["rows"], strict=True):
        assert (row["model"], row["evaluator"]) == (taken.model, taken.evaluator)
        assert (same["evaluator"], same["R"]) == (row["evaluator"], float(row["R"]))
        assert float(row["model_error"]) == answer.model_error[0] <= 0.1
    text = dipole("eval", *asked).stdout
    assert f"\ntook {taken.model} ({taken.evaluator}), the cheapest that keeps the tolerance\n" in text
    assert "took" not in dipole("eval", *MEDIUM, "--r", "1").stdout


def test_double_precision_where_only_that_will_do():
    for tolerance, more in (("3.25e-6", []), ("0.01", ["--evaluator", "f64"])):
        asked = [*MEDIUM, "--tolerance", tolerance, "--r", "1", "--wanted", "R", *more]
        (row,) = eval_rows(*asked)
        assert row["evaluator"] == "f64" and float(row["model_error"]) <= float(tolerance)


test_refusals_have_the_daemons_words = says(FAILED, ["eval", *MEDIUM], [
    (["--tolerance", "1e-9"], "(best: transport, f64) (--tolerance)"),
    (["--tolerance", "2"], "bad-value: tolerance: allowed: 1e-12 to 1 (--tolerance)"),
    (["--tolerance", "0.1", "--eta", "0"], "bad-value: eta: allowed: "),
    (["--tolerance", "0.1", "--r", "1,-1"], "bad-value: r number 2 of 2: allowed: "),
    (["--tolerance", "0.1", "--from", "3", "--to", "1"], "(--to)"),
    (["--tolerance", "1e-5", "--wanted", "ln_R", "--g", "0.9"], "bad-value: tolerance"),
])


def test_model_errors_at_the_ends_of_what_may_be_asked(client):
    """More radii than are compared one by one: all next to 0, and from 0 on, where 2 pi r R of
    transport is finite and that of a dipole is 0."""
    one = Medium(0.1, 10, 0, 1.4)
    next_to_0 = client.eval("classical", one, grid=Grid(0, 1e-301, 300), wanted="R", evaluator="f64")
    assert np.isnan(next_to_0.model_error).all()
    ring = client.eval("classical", one, grid=Grid(0, 10, 257), wanted="2_pi_r_R")
    assert 1 <= ring.model_error[0] < 1.001
    listed = client.eval("classical", one, np.append(0, np.linspace(0, 10, 300)), wanted="R")
    assert 0.4 < listed.model_error[0] < 1


def test_a_white_medium_has_the_error_that_the_choice_counts(client):
    white = {"media": Medium(1e-8, 1, 0, 1.3), "r": [1.0], "wanted": "R", "evaluator": "f64"}
    with pytest.raises(python_client.Refused, match="at least 9.2"):
        client.eval(None, tolerance=5e-6, **white)
    assert error_of(client.eval(None, tolerance=1e-5, **white)) <= 1e-5
