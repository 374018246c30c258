"""Values: published numbers, closed forms, and the edges of the valid range."""

from __future__ import annotations

import math

import lists
import numpy as np
import pytest
from dipole import Medium
from frames import SKIN, SPECTRALON

MODELS = ["classical", "better"]
EVALUATORS = ["f64", "f32"]
INF = math.inf

# Fresnel moments, computed by quadrature with 30 digits: eta -> (C1, C2).
MOMENTS = {
    0.5: (0.0802983185, 0.0446550277),
    1.0: (0.0, 0.0),
    1.33: (0.2359745744, 0.1094128412),
    2.0: (0.3950745796, 0.2349566853),
}


def closed_form(model, medium, r):
    """Computes R, cdf and albedo by d'Eon 2012, Table 2."""
    sigma_a, sigma_s, g, eta = medium
    c1, c2 = MOMENTS[eta]
    sigma_s_prime = sigma_s * (1 - g)
    sigma_t_prime = sigma_a + sigma_s_prime
    alpha = sigma_s_prime / sigma_t_prime
    if model == "classical":
        D, p, A = 1 / (3 * sigma_t_prime), alpha, (1 + 2 * c1) / (1 - 2 * c1)
        c_phi, c_e = 0.0, 1.0
    else:
        D = (2 * sigma_a + sigma_s_prime) / (3 * sigma_t_prime**2)
        p, A = alpha**2, (1 + 3 * c2) / (1 - 2 * c1)
        c_phi, c_e = (1 - 2 * c1) / 4, (1 - 3 * c2) / 2
    mu = math.sqrt(sigma_a / D)
    z1 = 1 / sigma_t_prime
    z2 = z1 + 4 * A * D
    d1, d2 = np.hypot(r, z1), np.hypot(r, z2)
    e1, e2 = np.exp(-mu * d1), np.exp(-mu * d2)
    phi = (e1 / d1 - e2 / d2) / D
    flux = z1 * (1 + mu * d1) * e1 / d1**3 + z2 * (1 + mu * d2) * e2 / d2**3
    R = p / (4 * math.pi) * (c_phi * phi + c_e * flux)
    f1, f2 = math.exp(-mu * z1), math.exp(-mu * z2)
    albedo = p / 2 * (c_e * (f1 + f2) + c_phi / (D * mu) * (f1 - f2))
    within = c_e * (f1 - z1 / d1 * e1 + f2 - z2 / d2 * e2)
    within += c_phi / (D * mu) * ((f1 - e1) - (f2 - e2))
    return R, p / 2 * within / albedo, albedo


CHANNELS = [
    Medium(0.05, 1.2, 0.3, 1.33),
    Medium(0.4, 0.9, -0.5, 2.0),
    Medium(1.5, 2.5, 0.0, 0.5),
    Medium(0.02, 15.0, 0.9, 1.0),
]


@pytest.mark.parametrize("evaluator", EVALUATORS)
@pytest.mark.parametrize("model", MODELS)
def test_closed_forms_in_every_channel(client, model, evaluator):
    r = np.array([0.1, 0.5, 1.0, 3.0, 7.5])
    result = client.eval(model, CHANNELS, r, evaluator=evaluator)
    assert result.R.shape == result.cdf.shape == (4, 5)
    assert result.R.dtype == result.cdf.dtype == {"f64": "f8", "f32": "f4"}[evaluator]
    tolerance = 1e-7 if evaluator == "f64" else 1e-5  # The moments above have ten digits.
    for i, medium in enumerate(CHANNELS):
        R, cdf, albedo = closed_form(model, medium, r)
        np.testing.assert_allclose(result.R[i], R, rtol=tolerance)
        np.testing.assert_allclose(result.cdf[i], cdf, rtol=tolerance)
        np.testing.assert_allclose(result.albedo[i], albedo, rtol=1e-7)


PUBLISHED_SKIN2 = [0.72775656, 0.54408776, 0.44055470]  # at eta = 1, for red, green and blue


def classical_albedo(medium: Medium, first_moment_twice: float) -> float:
    """Computes the albedo of the classical dipole from the given 2 C1."""
    alpha = medium.sigma_s / (medium.sigma_a + medium.sigma_s)
    root = math.sqrt(3 * (1 - alpha))
    A = (1 + first_moment_twice) / (1 - first_moment_twice)
    return alpha / 2 * (1 + math.exp(-4 / 3 * A * root)) * math.exp(-root)


def test_skin2_with_the_polynomials_of_eq_2(client):
    media = [medium._replace(eta=1.0) for medium in client.media()["skin2"]]
    result = client.eval("classical", media, moments="fit", wanted=["albedo"])
    twice = -9.23372 + 22.2272 - 20.9292 + 10.2291 - 2.54396 + 0.254913  # The sum is 0.004333.
    expected = [classical_albedo(medium, twice) for medium in media]
    np.testing.assert_allclose(result.albedo, expected, rtol=1e-13)


def test_skin2_as_published(client):
    """The published numbers were computed with the fit of Jensen et al. for 2 C1, which gives
    0.0017 at eta = 1."""
    media = [medium._replace(eta=1.0) for medium in client.media()["skin2"]]
    result = client.eval("classical", media, moments="jensen", wanted=["albedo"])
    np.testing.assert_allclose(result.albedo, PUBLISHED_SKIN2, rtol=1e-7)
    expected = [classical_albedo(medium, 0.0017) for medium in media]
    np.testing.assert_allclose(result.albedo, expected, rtol=1e-13)


@pytest.mark.parametrize("evaluator", EVALUATORS)
@pytest.mark.parametrize("model", MODELS)
def test_nothing_absorbs(client, model, evaluator):
    media = [(0.0, 2.0, 0.0, eta) for eta in (0.5, 1.0, 1.33, 2.0)]
    result = client.eval(model, media, [0.0, 0.1, 1.0, 10.0, 1e4], evaluator=evaluator)
    # This is the closed form with mu = 0: without absorption, all energy returns.
    np.testing.assert_allclose(result.albedo, 1.0, rtol=0 if model == "better" else 1e-14)
    assert np.all(result.R > 0) and np.all(np.diff(result.R) < 0)
    assert np.all(result.cdf[:, 0] == 0) and np.all(np.diff(result.cdf) > 0)
    near = client.eval(model, [(1e-14, 2.0, 0.0, eta) for eta in (0.5, 1.0, 1.33, 2.0)], [0.1, 1.0])
    np.testing.assert_allclose(result.R[:, 1:3], near.R, rtol=1e-5)


@pytest.mark.parametrize("eta", [1e-3, 0.2, 0.7, 1.0, 1.3, 1.4, 2.4, 10.0, 1e3])
@pytest.mark.parametrize("sigma_s, g", [(11.6, 0.0), (1e-12, 0.0), (1e15, -0.99), (40.0, 0.999)])
def test_better_dipole_keeps_all_energy(client, eta, sigma_s, g):
    result = client.eval("better", Medium(0.0, sigma_s, g, eta), wanted=["albedo"])
    assert result.albedo[0] == 1.0


@pytest.mark.parametrize("evaluator", EVALUATORS)
@pytest.mark.parametrize("model", MODELS)
def test_nothing_scatters(client, model, evaluator):
    media = [(0.5, 0.0, 0.0, 1.3), (1e15, 0.0, 0.9, 1.0), (1e-15, 0.0, -0.9, 2.0)]
    result = client.eval(model, media, [0.0, 1e-300, 1.0, INF], evaluator=evaluator)
    assert np.all(result.R == 0) and np.all(result.cdf == 0) and np.all(result.albedo == 0)
    assert not np.any(np.signbit(result.R)) and not np.any(np.signbit(result.cdf))


@pytest.mark.parametrize("evaluator", EVALUATORS)
@pytest.mark.parametrize("model", MODELS)
def test_radius_zero_and_infinity(client, model, evaluator):
    media = [SKIN, SPECTRALON, (1.5, 2.5, 0.3, 0.5)]
    result = client.eval(model, media, [0.0, -0.0, 1e-30, INF], evaluator=evaluator)
    assert np.all(result.R[:, 0] > 0) and np.all(np.isfinite(result.R[:, 0]))
    np.testing.assert_array_equal(result.R[:, 0], result.R[:, 1])
    np.testing.assert_allclose(result.R[:, 0], result.R[:, 2], rtol=1e-6)
    assert np.all(result.cdf[:, :2] == 0)
    assert np.all(result.R[:, 3] == 0) and np.all(result.cdf[:, 3] == 1)


def test_radius_zero_has_the_closed_form(client):
    for model in MODELS:
        result = client.eval(model, CHANNELS, [0.0])
        for i, medium in enumerate(CHANNELS):
            assert result.R[i, 0] == pytest.approx(closed_form(model, medium, np.zeros(1))[0], 1e-7)


def test_empty_list(client):
    result = client.eval("better", [SKIN, SPECTRALON], [])
    assert result.R.shape == result.cdf.shape == (2, 0)
    assert result.albedo[1] == 1.0
    assert 0 < result.albedo[0] < 1


def test_only_the_albedo(client):
    whole = client.eval("better", [SKIN, SPECTRALON], [0.5, 1.0])
    alone = client.eval("better", [SKIN, SPECTRALON], wanted=["albedo"])
    assert not hasattr(alone, "R") and not hasattr(alone, "cdf")
    np.testing.assert_array_equal(alone.albedo, whole.albedo)


def test_quantities_that_were_not_wanted(client):
    result = client.eval("better", SKIN, [0.5, 1.0], wanted=["cdf"])
    assert not hasattr(result, "R") and not hasattr(result, "albedo")
    np.testing.assert_array_equal(
        result.cdf, client.eval("better", SKIN, [0.5, 1.0], wanted=["R", "cdf"]).cdf
    )


@pytest.mark.parametrize("model", MODELS)
def test_g_near_its_ends(client, model):
    """Only sigma_s (1 - g) matters, even if g is near its ends."""
    r = [0.01, 0.1, 1.0]
    for g in (math.nextafter(1, 0), 1 - 2**-30, -1 + 2**-30, math.nextafter(-1, 0)):
        reduced = 3.0 * (1 - g)  # This is exact, because 1 - g is exact.
        result = client.eval(model, Medium(0.1, 3.0, g, 1.4), r)
        same = client.eval(model, Medium(0.1, reduced, 0.0, 1.4), r)
        np.testing.assert_allclose(result.R, same.R, rtol=1e-14)
        np.testing.assert_allclose(result.cdf, same.cdf, rtol=1e-14)
        np.testing.assert_allclose(result.albedo, same.albedo, rtol=1e-14)
        assert np.all(result.R > 0)


@pytest.mark.parametrize("model", MODELS)
def test_ends_of_the_domain_are_valid(client, model):
    media = [
        (1e15, 1e15, 0.0, 1.3),
        (0.0, 1e-15, 0.0, 1.3),
        (1e-15, 0.0, 0.0, 1.3),
        (1.0, 1.0, 0.0, 1e-3),
        (1.0, 1.0, 0.0, 1e3),
        (0.0, 1e15, -1 + 2**-53, 1.3),
    ]
    result = client.eval(model, media, [0.0, 5e-324, 1e-15, 1.0, 1e15, 1e300, INF])
    assert np.all(result.R >= 0) and np.all(np.isfinite(result.R))
    assert np.all((result.cdf >= 0) & (result.cdf <= 1))
    assert np.all((result.albedo >= 0) & (result.albedo <= 1))
    assert np.all(np.diff(result.cdf) >= 0)


@pytest.mark.parametrize("name", [name for name in lists.MOMENTS if name != "exact"])
def test_fitted_moments_at_the_ends_of_their_range(client, name):
    moments = lists.MOMENTS[name]
    for eta in (moments.eta_min, 1.0, moments.eta_max):
        fit = client.eval("better", Medium(0.1, 1.0, 0.0, eta), [1.0], moments=name)
        exact = client.eval("better", Medium(0.1, 1.0, 0.0, eta), [1.0])
        assert (fit.moments, exact.moments) == (name, "exact")
        assert fit.R[0, 0] == pytest.approx(exact.R[0, 0], rel=0.03)
        assert fit.R[0, 0] != exact.R[0, 0]


def test_cdf_is_the_integral_of_R(client):
    """The integral of 2 pi r R is the cdf times the albedo, so the two arrays belong together."""
    for model in MODELS:
        grid = np.linspace(0, 4, 4001)
        result = client.eval(model, CHANNELS, grid)
        density = 2 * math.pi * grid * result.R
        # This is Simpson's rule.
        total = (density[:, 0] + density[:, -1]) + 4 * density[:, 1::2].sum(1)
        total = (total + 2 * density[:, 2:-1:2].sum(1)) * (grid[1] / 3)
        np.testing.assert_allclose(total, result.cdf[:, -1] * result.albedo, rtol=1e-6)


def test_errors_are_stated(client):
    for evaluator, at_least in (("f64", 2.0**-53), ("f32", 2.0**-24)):
        result = client.eval("better", [SKIN, SPECTRALON], [0.0, 1.0, 10.0], evaluator=evaluator)
        error = result.numerical_error()
        assert error.shape == (2, 3)
        assert np.all(error >= at_least) and np.all(error < at_least * 2**10)
        assert error[0, 2] > error[0, 0]  # The condition number of the problem grows with r.
        assert np.all(np.isnan(result.model_error) | (result.model_error >= 0))


def test_f32_is_within_its_stated_error(client):
    r = np.linspace(0, 20, 500, dtype=np.float32)
    single = client.eval("better", CHANNELS, r, evaluator="f32")
    double = client.eval("better", CHANNELS, r.astype(np.float64))
    allowed = single.numerical_error() * 1.001
    np.testing.assert_array_less(np.abs(single.R - double.R), allowed * double.R)
    off = np.abs(single.cdf - double.cdf)
    assert np.all(off <= allowed * double.cdf)
    np.testing.assert_array_equal(single.albedo, double.albedo)


@pytest.mark.parametrize("tolerance", [None, 1e-3, 1e-6])
def test_a_table_is_within_its_stated_error(client, tolerance):
    r = np.geomspace(1e-6, 20, 500, dtype=np.float32)
    asked = {} if tolerance is None else {"tolerance": tolerance}
    table = client.eval("better", CHANNELS, r, evaluator="lut", parameters=asked)
    double = client.eval("better", CHANNELS, r.astype(np.float64))
    allowed = table.numerical_error()
    assert np.all(allowed <= (tolerance or 1e-4))
    assert np.all(np.abs(table.R - double.R) <= allowed * double.R)
    assert np.all(np.abs(table.cdf - double.cdf) <= allowed * double.cdf)
    np.testing.assert_array_equal(table.albedo, double.albedo)


def test_media_are_the_published_ones(client):
    media = client.media()
    assert list(media) == sorted(media) and len(media) == 12
    for name, sigma_s, sigma_a in [
        ("apple", (2.29, 2.39, 1.97), (0.0030, 0.0034, 0.046)),
        ("ketchup", (0.18, 0.07, 0.03), (0.061, 0.97, 1.45)),
        ("skin1", (0.74, 0.88, 1.01), (0.032, 0.17, 0.48)),
        ("skin2", (1.09, 1.59, 1.79), (0.013, 0.070, 0.145)),
        ("spectralon", (11.6, 20.4, 14.9), (0, 0, 0)),
        ("wholemilk", (2.55, 3.21, 3.77), (0.0011, 0.0024, 0.014)),
    ]:
        expected = tuple(Medium(a, s, 0.0, 1.3) for a, s in zip(sigma_a, sigma_s))
        assert media[name] == expected
