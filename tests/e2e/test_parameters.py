"""The optional parameters of a request: which values are refused, and what valid ones do."""

from __future__ import annotations

import math

import numpy as np
import pytest
from dipole import Medium, Refused, wire
from frames import (
    BETTER, EVAL, SKIN, ask, assert_daemon_serves, assert_error, assert_refused, eval_payload,
    parameters_bytes, refused,
)
from lists import MODELS, PARAMETERS, choices, everywhere, needs, some_value, takes

INF, NAN = math.inf, math.nan
COS_IN, COS_OUT = PARAMETERS["cos_in"].id, PARAMETERS["cos_out"].id


# ---- what is refused -----------------------------------------------------------------------------


def padded(**changes: int) -> bytes:
    """Makes two parameter structures. The padding of the second one has the given values."""
    fields = {"parameter": COS_IN, "value": 0.5, **changes}
    return parameters_bytes([(COS_OUT, 0.5)]) + wire.PARAMETER.pack(**fields)


def given(*parameters: tuple[int, float], **fixed) -> bytes:
    return eval_payload(parameters=parameters, **fixed)


GRID = {"radii": None, "radius_count": 2}
IDS = [0, max(choices("CORE_PARAMETER").values()) + 1, 256 + COS_IN, 999, 65535]
SHAPES = {
    **refused("bad-value", "parameter", "one of 1 (tolerance), 2 (cos_in)", {
        **{f"{id}": given((id, 0.5)) for id in IDS},
        "the second": (given((COS_IN, 0.5), (999, 0.5)), 1),
        "radii for a parameter": eval_payload(parameter_count=1),
    }),
    **refused("bad-value", "parameter", "at most once", {
        "twice": (given((COS_IN, 0.5), (COS_OUT, 0.5), (COS_IN, 0.5)), 2),
    }),
    **{
        f"{name} NaN": (given((COS_OUT, 0.5), (one.id, NAN)), "bad-value", name, "a number", 1)
        for name, one in PARAMETERS.items()
        if name != "cos_out"
    },
    **refused("bad-value", "zero", "0", {"1": (eval_payload(parameters=padded(zero=1)), 1)}),
    **refused("bad-value", "zero_too", "0", {
        "2^31": (eval_payload(parameters=padded(zero_too=2**31)), 1),
    }),
    # The payload has 16 bytes of radii behind the media.
    **refused("bad-count", "parameter_count", "no more parameters than the payload holds", {
        **{f"{n:#x}": eval_payload(parameter_count=n) for n in [2, 3, 2**12, 2**15, 2**16 - 1]},
        "cut, with a grid": given((COS_IN, 0.5), **GRID)[:-8],
        "cut after the media": given((COS_IN, 0.5))[:-32],
    }),
    **refused("bad-count", "radius_count", "no more radii", {
        f"{cut} bytes less": given((COS_IN, 0.5))[:-cut] for cut in (8, 16)
    }),
    **refused("bad-length", "payload_bytes", "nothing after the listed radii", {
        "not counted": given((COS_IN, 0.5), parameter_count=0),
    }),
    **refused("bad-length", "payload_bytes", "nothing after media and parameters", {
        "not counted": given((COS_IN, 0.5), parameter_count=0, **GRID),
    }),
}


@pytest.mark.parametrize("name", SHAPES)
def test_shape(shared, name):
    with shared.connect() as connection:
        assert_refused(connection, EVAL, *SHAPES[name])
    assert_daemon_serves(shared)


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
            client.eval(model, SKIN, [1.0], parameters={**needs(model), name: value})
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
            client.eval(model, SKIN, [1.0], parameters={**needs(model), name: some_value(name)})
        assert (caught.value.status, caught.value.field) == ("bad-value", name)
        assert caught.value.allowed.startswith("nothing")


@pytest.mark.parametrize("model", MODELS)
def test_parameters_that_a_model_needs(client, model):
    assert set(needs(model)) <= set(takes(model))
    for name in needs(model):
        others = {key: value for key, value in needs(model).items() if key != name}
        with pytest.raises(Refused) as caught:
            client.eval(model, SKIN, [1.0], parameters=others)
        assert (caught.value.status, caught.value.field) == ("bad-value", name)
        assert not caught.value.allowed.startswith("nothing")
    assert client.eval(model, SKIN, wanted=["albedo"], parameters=needs(model)).albedo.shape == (1,)


def test_all_models_take_angles_and_a_tolerance():
    for model in MODELS:
        assert {"tolerance", "cos_in", "cos_out"} <= set(takes(model))


def test_parameters_are_judged_after_the_media(connection):
    payload = eval_payload([(-1.0, 1.0, 0.0, 1.3)], parameters=[(COS_IN, 2.0)])
    assert_error(ask(connection, EVAL, payload), "bad-value", "sigma_a", "0 to 1e15")
    payload = eval_payload(radii=[-1.0], parameters=[(COS_IN, 2.0)])
    assert_error(ask(connection, EVAL, payload), "bad-value", "cos_in", "0 to 1")


def test_their_order_counts_for_nothing(connection):
    given = [(COS_IN, 0.25), (COS_OUT, 0.75), (PARAMETERS["tolerance"].id, 1e-3)]
    replies = {
        ask(connection, EVAL, eval_payload(parameters=order, wanted=511, model=BETTER)).payload
        for order in (given, given[::-1], given[1:] + given[:1])
    }
    assert len(replies) == 1 and len(next(iter(replies))) > wire.ERROR.bytes


# ---- S -------------------------------------------------------------------------------------------


def transmittance(eta: float, cos_outside):
    """Returns Fresnel's transmittance for unpolarized light from outside to inside: one minus the
    squares of the amplitudes of reflection, in a form without cancellation."""
    cos_outside = np.asarray(cos_outside, dtype=float)
    squared = ((eta - 1) * (eta + 1) + cos_outside**2) / eta**2
    inside = np.sqrt(np.maximum(squared, 0))
    with np.errstate(invalid="ignore"):
        s = 4 * eta * cos_outside * inside / (cos_outside + eta * inside) ** 2
        p = 4 * eta * cos_outside * inside / (eta * cos_outside + inside) ** 2
    return np.where((squared > 0) & (cos_outside > 0), (s + p) / 2, 0.0)


def transmitted_flux(eta: float) -> float:
    """Returns 1 - 2 C1(1 / eta), the integral of 2 mu F_t over the cosines outside. From the
    critical angle on, the integrand starts like a square root, so the root is the variable of
    integration."""
    nodes, weights = np.polynomial.legendre.leggauss(200)
    start = math.sqrt(1 - eta**2) if eta < 1 else 0.0
    root = (nodes + 1) / 2
    mu = start + (1 - start) * root**2
    return float(np.sum(weights * (1 - start) * root * 2 * mu * transmittance(eta, mu)))


def expected_factor(eta: float, cos_in: float, cos_out: float) -> float:
    """Returns S over R: d'Eon 2012, Eq. 1; Jensen et al. 2001, Eq. 5."""
    ends = float(transmittance(eta, cos_in) * transmittance(eta, cos_out))
    return ends / (math.pi * transmitted_flux(eta))


ANGLES = [(1.0, 1.0), (0.8, 0.3), (0.05, 1.0), (1e-9, 0.5), (0.0, 0.5), (1.0, 0.0), (0.0, 0.0)]
ETAS = [0.4, 0.75, 1.0, 1.3, 2.2]


@pytest.mark.parametrize("eta", ETAS)
def test_S_follows_R(client, eta):
    r = [0.0, 0.1, 1.0, 4.0, INF]
    for cos_in, cos_out in ANGLES:
        angles = {"cos_in": cos_in, "cos_out": cos_out}
        answer = client.eval(
            "better", Medium(0.1, 1.0, 0.0, eta), r, wanted=["R", "S"], parameters=angles
        )
        factor = expected_factor(eta, cos_in, cos_out)
        np.testing.assert_allclose(answer.S, factor * answer.R, rtol=1e-12)
        assert (factor == 0) == (
            min(cos_in, cos_out) == 0
            or (eta < 1 and min(cos_in, cos_out) <= math.sqrt(1 - eta**2))
        )


@pytest.mark.parametrize("evaluator, bound", [("f64", 1e-12), ("f32", 1e-6)])
@pytest.mark.parametrize("model", MODELS)
def test_S_of_every_model(client, model, evaluator, bound):
    for angles in ({}, {"cos_in": 0.7}, {"cos_in": 0.7, "cos_out": 0.2}):
        answer = client.eval(
            model,
            SKIN,
            [0.5, 1.0, 2.0],
            evaluator=evaluator,
            wanted=["R", "S"],
            parameters={**needs(model), **angles},
        )
        factor = expected_factor(SKIN[3], angles.get("cos_in", 1), angles.get("cos_out", 1))
        np.testing.assert_allclose(answer.S, factor * answer.R, rtol=bound)


@pytest.mark.parametrize("evaluator", ["f64", "f32"])
def test_S_at_the_ends(client, evaluator):
    """S is infinite where R is infinite, but 0 for directions along the surface, where no light
    enters or leaves."""
    for model in everywhere():
        for cos in (0.0, 0.6, 1.0):
            answer = client.eval(
                model,
                SKIN,
                [0.0, INF],
                evaluator=evaluator,
                wanted=["R", "S"],
                parameters={"cos_in": cos},
            )
            assert answer.S[0, 1] == 0, (model, cos)
            if cos == 0:
                assert answer.S[0, 0] == 0, (model, cos)
            else:
                assert np.isinf(answer.S[0, 0]) == np.isinf(answer.R[0, 0]), (model, cos)


def test_angles_change_nothing_but_S(client):
    wanted = ["R", "albedo", "cdf", "ln_R", "pdf", "dR_dr", "2_pi_r_R"]
    for model in MODELS:
        plain = client.eval(model, SKIN, [0.5, 2.0], wanted=wanted, parameters=needs(model))
        given = {**needs(model), "cos_in": 0.1, "cos_out": 0.9}
        answer = client.eval(model, SKIN, [0.5, 2.0], wanted=wanted, parameters=given)
        for name, values in plain.values.items():
            np.testing.assert_array_equal(values, answer.values[name])
        np.testing.assert_array_equal(plain.albedo, answer.albedo)


# ---- 2 pi r R ------------------------------------------------------------------------------------


@pytest.mark.parametrize("evaluator", ["f64", "f32"])
def test_ring_is_finite_where_R_is_not(client, evaluator):
    infinite = 0
    for model in everywhere():
        answer = client.eval(
            model, SKIN, [0.0, 1e-9, INF], evaluator=evaluator, wanted=["R", "2_pi_r_R"]
        )
        assert np.all(np.isfinite(answer.two_pi_r_R)) and np.all(answer.two_pi_r_R >= 0), model
        assert answer.two_pi_r_R[0, 2] == 0
        infinite += np.isinf(answer.R[0, 0])
        if np.isfinite(answer.R[0, 0]):
            assert answer.two_pi_r_R[0, 0] == 0, model
    assert infinite > 0


# ---- the others ----------------------------------------------------------------------------------


@pytest.mark.parametrize("tolerance", [1e-2, 1e-3, 1e-4])
def test_tolerance_bounds_the_error(client, tolerance):
    """The stated error is within the tolerance that was asked for, up to a few roundings. A fit
    with a given number of Gaussians has the error that it has."""
    for model in MODELS:
        if "gaussians" not in takes(model):
            given = {**needs(model), "tolerance": tolerance}
            answer = client.eval(model, SKIN, [1.0], parameters=given)
            assert answer.numerical_error(0.0)[0] <= tolerance + 1e-12, model


@pytest.mark.parametrize("model", ["multipole-transmitted", "better-multipole-transmitted"])
@pytest.mark.parametrize("thickness", [1e4, 131072.0, 1e6])
def test_nothing_comes_through_a_slab_that_is_thick_enough(client, model, thickness):
    result = client.eval(model, SKIN, [0.0, 1.0, 1e6], parameters={"thickness": thickness})
    assert not result.R.any() and not result.albedo.any() and not result.cdf.any()
