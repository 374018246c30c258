"""Clients give a tolerance in place of a model: which model is chosen, and what the answer says
about its error."""

import re

import dipole as python_client
import numpy as np
import pytest
from dipole import Grid, wire
from frames import ALBEDO, EVAL, F32, R, SKIN, ask
from frames import eval_payload
from lists import EVALUATORS, PARAMETERS

TOLERANCE = PARAMETERS["tolerance"].id


def error_of(answer: python_client.Result) -> float:
    """Returns the error against transport that the answer states."""
    return float(np.max(answer.model_error[:, np.newaxis] + answer.numerical_error()))


def total(offer: python_client.Offer, count: int) -> float:
    """Returns the cost of a medium at so many radii."""
    return offer.prepare_ns + count * offer.cost_ns


# ---- Python --------------------------------------------------------------------------------------


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


FAR = (4.0, 16.0, 0.0, 1.4)  # 60 decay lengths at 5 mm, where the error grows
THREE = [(0.05, 1.0, 0.0, 1.4), FAR, (0.15, 1.4, 0.0, 1.4)]
REFUSAL = r"at least (\S+) for medium %d \(best: transport, (?:lut|f32|f64)\)"


def refusal(client, media, radii, **how) -> python_client.Refused:
    with pytest.raises(python_client.Refused) as caught:
        client.eval(None, media, radii, **how)
    assert caught.value.field == "tolerance"
    return caught.value


@pytest.mark.parametrize("evaluator", ["f64", "f32", "lut"])
@pytest.mark.parametrize("tolerance", [1e-8, 9e-7])
def test_the_least_that_a_refusal_quotes_is_accepted(client, evaluator, tolerance):
    how = {"evaluator": evaluator, "wanted": ["R", "albedo"]}
    error = refusal(client, THREE, [0.05, 5.0], tolerance=tolerance, **how)
    least = re.match(REFUSAL % 2, error.allowed)
    assert error.index == 1 and least is not None
    assert error_of(client.eval(None, THREE, [0.05, 5.0], tolerance=float(least[1]), **how)) <= 1
    lower = refusal(client, THREE, [0.05, 5.0], tolerance=0.9 * tolerance, **how)
    assert lower.allowed.startswith(least[0])


def test_a_refusal_quotes_what_solving_reaches(client):
    medium = (0.05, 7.0, 0.85, 1.4)
    stored = error_of(client.eval("transport", medium, [1.0]))
    error = refusal(client, medium, [1.0], tolerance=1e-8)
    least = re.match(r"at least (\S+) \(best: transport, solved\)", error.allowed)
    assert float(least[1]) < stored
    _, taken = client.offers(medium, [1.0], tolerance=float(least[1]))
    assert taken is not None and taken.meets


def test_a_medium_whose_error_nothing_bounds_is_named(client):
    error = refusal(client, [SKIN, (1e-3, 1e-3, 0.995, 2.5)], [1.0], tolerance=0.1, wanted="R")
    known = "a model instead: no error known"
    assert error.allowed == f"{known}: g 0.995 is above 0.99 for medium 2"
    assert error.index == 1
    for medium, cause in (((0.1, 1.0, -0.99, 1.4), "g -0.99 is below -0.98"),
                          ((1500.0, 1.0, 0.0, 1.4), "sigma_a/sigma_s' 1500 is above 1e+03")):
        error = refusal(client, [medium], [1.0], tolerance=0.1, wanted="R")
        assert error.allowed == f"{known}: {cause}"
    error = refusal(client, [SKIN], [0.1, 500.0, 1.0], tolerance=0.1, wanted="R")
    cause = re.fullmatch(known + r": r 500 mm is above (\d+)", error.allowed)
    client.eval(None, SKIN, [0.9 * float(cause[1])], tolerance=1.0, wanted="R")
    stack = [(0.5, 1, 0, 1.4, 0.5), (0.1, 2, 0, 1.4)]
    error = refusal(client, [stack], [1e-9, 1.0], tolerance=1e-7, wanted="R")
    assert re.fullmatch(r"at least \S+ at 1 mm \(solved; else mc\)", error.allowed)


def test_wrong_arguments(client):
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
