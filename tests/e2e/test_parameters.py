"""The optional parameters of a request: which values are refused, and what valid ones do."""

import math

import pytest
from dipole import Refused, wire
from frames import BETTER, EVAL, SKIN, ask, eval_payload
from lists import MODELS, PARAMETERS, medium_for, some_value, takes, thickness

INF, NAN = math.inf, math.nan
COS_IN, COS_OUT = PARAMETERS["cos_in"].id, PARAMETERS["cos_out"].id


# ---- what is refused -----------------------------------------------------------------------------


def given(*parameters: tuple[int, float], **fixed) -> bytes:
    return eval_payload(parameters=parameters, **fixed)


def model_that_takes(name: str) -> str:
    return next(model for model in MODELS if name in takes(model))


@pytest.mark.parametrize("name", PARAMETERS)
def test_range(client, name):
    """A model that takes the parameter refuses values just beyond both ends of the range, and
    states the range."""
    model = model_that_takes(name)
    parameter = PARAMETERS[name]
    for value in (
        math.nextafter(parameter.least, -INF), math.nextafter(parameter.most, INF), -INF, INF
    ):
        with pytest.raises(Refused) as caught:
            client.eval(model, medium_for(model), [1.0], parameters={name: value})
        refusal = caught.value
        assert (refusal.status, refusal.field) == ("bad-value", name)
        words = refusal.allowed.split()
        assert [float(words[0]), float(words[2])] == [parameter.least, parameter.most]


@pytest.mark.parametrize("model", MODELS)
def test_parameters_that_a_model_does_not_take(client, model):
    """A parameter that a model does not take is refused with an error of its own, which a program
    can recognize."""
    for name in set(PARAMETERS) - set(takes(model)):
        with pytest.raises(Refused) as caught:
            client.eval(model, medium_for(model), [1.0], parameters={name: some_value(name)})
        assert (caught.value.status, caught.value.field) == ("bad-value", name)
        assert caught.value.allowed.startswith("nothing")


@pytest.mark.parametrize("model", MODELS)
def test_a_model_takes_half_spaces_or_slabs(client, model):
    for wrong in (0.0,) if thickness(model) else (2.0,) if model not in ("transport", "gaussians") else ():
        with pytest.raises(Refused) as caught:
            client.eval(model, (*SKIN, wrong), [1.0])
        assert (caught.value.status, caught.value.field) == ("bad-value", "thickness")
    assert client.eval(model, medium_for(model), wanted=["albedo"]).albedo.shape == (1,)


def test_their_order_counts_for_nothing(connection):
    given = [(COS_IN, 0.25), (COS_OUT, 0.75), (PARAMETERS["tolerance"].id, 1e-3)]
    replies = {
        ask(connection, EVAL, eval_payload(parameters=order, wanted=511, model=BETTER)).payload
        for order in (given, given[::-1], given[1:] + given[:1])
    }
    assert len(replies) == 1 and len(next(iter(replies))) > wire.ERROR.bytes


# ---- layers --------------------------------------------------------------------------------------


def test_layers_are_from_the_top_down(client):
    """Near the source R is that of the layer above."""
    r, dark = [0.3, 1.0, 3.0], (0.5, *SKIN[1:])
    whole = client.eval("transport", SKIN, r)
    over = client.eval("transport", [[(*SKIN, 0.5), (*dark, 0.0)]], r, parameters={"tolerance": 0.1})
    shares = (over.R / whole.R)[0]
    assert shares[0] > 0.75 and shares[2] < 0.2


def test_derivatives_are_by_the_coefficients_of_one_layer(client):
    """The path in a layer follows from its sigma_a. accuracy/test_derivative.c has their values."""
    dark, darker = (0.5, *SKIN[1:]), (1.0, *SKIN[1:])
    one, other = (
        client.eval("transport", [[(*dark, 3.0), (*darker, 0.0)]], [0.3, 4.0],
                    wanted=["dlnR_dln_sigma_a", "path"],
                    parameters={"tolerance": 0.1, "derivative_layer": layer})
        for layer in (1, 2)
    )  # fmt: skip
    for derivatives, sigma_a in ((one, dark[0]), (other, darker[0])):
        assert derivatives.path[0] == pytest.approx(-derivatives.dlnR_dln_sigma_a[0] / sigma_a, rel=1e-5)
    assert (one.path > other.path).all() and (other.path > 0).all()
