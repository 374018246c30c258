"""Fits: coefficients come back from readings, whatever else is asked; sets that are wrong are named
and others are fitted; a request of any size is answered in turns, in parts and in time."""


import dipole
import numpy as np
import pytest
from dipole import Medium, fitting

AT_MM = np.array([0.5, 1.0, 1.5, 2.0, 3.0, 4.0])
MEDIUM = Medium(0.03, 1.2, 0.0, 1.4)


@pytest.fixture
def readings(client) -> np.ndarray:
    return client.eval("better", MEDIUM, AT_MM).R[0]


def noisy(readings: np.ndarray, shape: tuple[int, ...], error: float = 0.02) -> np.ndarray:
    return readings * np.random.default_rng(2).normal(1.0, error, (*shape, len(readings)))


# ---- values --------------------------------------------------------------------------------------


def test_the_medium_comes_back(client, readings):
    found = client.fit("better", AT_MM, readings, 0.01 * readings, eta=1.4, residuals=True)
    assert found.status == "fitted" and found.fitted and found.sets.shape == ()
    np.testing.assert_allclose(found.sigma_a, 0.03, rtol=1e-6)
    np.testing.assert_allclose(found.sigma_s_prime, 1.2, rtol=1e-6)
    assert found.factor == 1 and found.factor_error == 0 and found.chi_squared < 1e-8
    assert np.abs(found.residuals).max() < 1e-4
    assert 0 < found.sigma_a_error < 0.003 and 0 < found.sigma_s_prime_error < 0.1
    assert -1 < found.correlation < 1 and found.condition < 100


def test_the_model_error_is_that_of_the_best_medium(client, readings):
    """It is that of transport; for other models an eval of the medium that was found says it."""
    found = client.fit("better", AT_MM, readings, 0.01 * readings, eta=1.4)
    assert np.isnan(found.model_error)
    exact = client.fit("transport", AT_MM, readings, 0.01 * readings, eta=1.4)
    assert exact.model_error == 0
    values, errors = [readings, -readings], 0.01 * readings
    narrow = client.fit("transport", AT_MM, values, errors, eta=1.4, parameters={"detector_na": 0.3})
    assert 0.005 < narrow.model_error[0] < 0.04 and np.isnan(narrow.model_error[1])
    thin = client.fit("transport", AT_MM, readings, errors, eta=1.4, parameters={"detector_na": 0.05})
    assert np.isnan(thin.model_error)


def test_eta_has_to_be_given_and_g_is_shown(client, readings):
    with pytest.raises(dipole.ArgumentError, match="eta: give the refractive index"):
        client.fit("better", AT_MM, readings, 0.01 * readings)
    found = client.fit("better", AT_MM, readings, 0.01 * readings, eta=1.4)
    assert (found.g, found.eta, found.g_is_default) == (0, 1.4, True)
    assert "g 0; g_is_default True; eta 1.4" in repr(found)
    found = client.fit("better", AT_MM, readings, 0.01 * readings, eta=1.4, g=0.5)
    assert "g 0.5; g_is_default False; eta 1.4" in repr(found) and not found.g_is_default


def test_a_free_factor_and_a_reference(client, readings):
    free = client.fit("better", AT_MM, 7 * readings, 0.07 * readings, eta=1.4, scale="free")
    np.testing.assert_allclose([free.factor, free.sigma_a], [7, 0.03], rtol=1e-5)
    assert free.factor_error > 0 and free.sets["covariance_s_factor"] != 0
    known = Medium(0.01, 1.0, 0.0, 1.4)
    ratio = readings / client.eval("better", known, AT_MM).R[0]
    found = client.fit("better", AT_MM, ratio, 0.01 * ratio, eta=1.4, reference=known)
    np.testing.assert_allclose([found.sigma_a, found.sigma_s_prime], [0.03, 1.2], rtol=1e-6)
    for wrong in (None, [known, known]):
        with pytest.raises(dipole.ArgumentError, match="reference"):
            client.fit("better", AT_MM, ratio, ratio, scale="reference", eta=1.3, reference=wrong)


def test_shapes(client, readings):
    image = noisy(readings, (3, 4))
    found = client.fit("better", AT_MM, image, 0.02 * image, eta=1.4, residuals=True)
    assert found.sets.shape == found.status.shape == found.sigma_a.shape == (3, 4)
    assert found.residuals.shape == image.shape
    one = client.fit("better", AT_MM, image[2, 1], 0.02 * image[2, 1], eta=1.4, residuals=True)
    assert one.sets.tobytes() == found.sets[2, 1].tobytes()
    np.testing.assert_array_equal(one.residuals, found.residuals[2, 1])
    assert "counts fitted 12;" in repr(found) and one.counts == {"fitted": 1}
    empty = client.fit("better", AT_MM, np.empty((2, 1, 6)), 1.0, eta=1.4)
    assert empty.sets.shape == (2, 1)
    for values, at, errors in ((1.0, [1.0], 1.0), (image, [1, 2], 1), (image, AT_MM, [1.0, 2.0])):
        with pytest.raises(dipole.ArgumentError):
            client.fit("better", at, values, errors, eta=1.4)


def test_many_requests_for_an_image(client, readings, monkeypatch):
    image = noisy(readings, (5, 8))
    whole = client.fit("better", AT_MM, image, 0.02 * image, eta=1.4, residuals=True)
    monkeypatch.setattr(fitting, "_REQUEST_BYTES", 7 * 16 * len(AT_MM))
    cut = client.fit("better", AT_MM, image, 0.02 * image, eta=1.4, residuals=True)
    assert cut.sets.tobytes() == whole.sets.tobytes()
    np.testing.assert_array_equal(cut.residuals, whole.residuals)


# ---- what is never a success ---------------------------------------------------------------------


def test_wrong_readings_are_named_and_others_are_fitted(client, readings):
    values = np.tile(readings, (8, 1))
    errors = 0.01 * values
    wrong = [(0, 3, -np.inf), (1, 0, np.nan), (2, 5, np.inf)]
    for i, index, value in wrong:
        values[i, index] = value
    for i, index, error in ((3, 2, 0.0), (4, 1, -1.0), (5, 5, np.nan), (6, 0, np.inf)):
        errors[i, index] = error
    found = client.fit("better", AT_MM, values, errors, eta=1.4, residuals=True)
    assert list(found.status) == ["refused"] * 7 + ["fitted"]
    assert list(found.sets["field"]) == [1, 1, 1, 2, 2, 2, 2, 0]
    assert list(found.sets["index"]) == [3, 0, 5, 2, 1, 5, 0, 0]
    assert np.isnan(found.sigma_a[:7]).all() and np.isnan(found.sigma_a_error[:7]).all()
    assert np.isnan(found.residuals[:7]).all() and np.isfinite(found.residuals[7]).all()


# ---- large requests ------------------------------------------------------------------------------


def test_a_design_is_prepared_once(daemon, readings):
    with daemon().client() as client:
        for _ in range(3):
            client.fit("better", AT_MM, readings, 0.01 * readings, eta=1.4)
        assert client.statistics()["cache_builds"] == 1
        client.fit("transport", AT_MM[1:5:3], readings[1:5:3], 0.01, eta=1.4)  # fitted by an inverse
        assert client.statistics()["cache_builds"] == 2
        assert client.statistics()["sets_fitted"] == 4
