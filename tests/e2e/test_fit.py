"""Fits: coefficients come back from readings, whatever else is asked; sets that are wrong are named
and others are fitted; a request of any size is answered in turns, in parts and in time."""

from __future__ import annotations


import dipole
import numpy as np
import pytest
from dipole import Medium, fitting, wire
from frames import FIT_REQUEST, READINGS, ask, assert_refused, assert_serves, fit_payload
from frames import frame, refused
from known import receive_answer
from lists import FIT_PARAMETERS, MODELS, PARAMETERS

FITTED = FIT_REQUEST | wire.REPLY
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


def test_g_scales_sigma_s(client):
    """With similarity, only sigma_s (1 - g) matters to a diffusion model."""
    R = client.eval("better", Medium(0.03, 6.0, 0.8, 1.4), AT_MM).R[0]
    found = client.fit("better", AT_MM, R, 0.01 * R, g=0.8, eta=1.4)
    np.testing.assert_allclose(found.sigma_s_prime, 1.2, rtol=1e-6)


def test_eta_has_to_be_given_and_g_is_shown(client, readings):
    with pytest.raises(dipole.ArgumentError, match="eta: give the refractive index"):
        client.fit("better", AT_MM, readings, 0.01 * readings)
    found = client.fit("better", AT_MM, readings, 0.01 * readings, eta=1.4)
    assert (found.g, found.eta, found.g_is_default) == (0, 1.4, True)
    assert "g 0 (default), eta 1.4" in repr(found)
    found = client.fit("better", AT_MM, readings, 0.01 * readings, eta=1.4, g=0.5)
    assert "g 0.5, eta 1.4" in repr(found) and not found.g_is_default


def test_a_free_factor_and_a_reference(client, readings):
    free = client.fit("better", AT_MM, 7 * readings, 0.07 * readings, eta=1.4, scale="free")
    np.testing.assert_allclose([free.factor, free.sigma_a], [7, 0.03], rtol=1e-5)
    assert free.factor_error > 0 and free.sets["covariance_s_factor"] != 0
    known = Medium(0.01, 1.0, 0.0, 1.4)
    ratio = readings / client.eval("better", known, AT_MM).R[0]
    found = client.fit("better", AT_MM, ratio, 0.01 * ratio, eta=1.4, reference=known)
    np.testing.assert_allclose([found.sigma_a, found.sigma_s_prime], [0.03, 1.2], rtol=1e-6)
    with pytest.raises(dipole.ArgumentError, match="reference"):
        client.fit("better", AT_MM, ratio, ratio, scale="reference", eta=1.3)


def test_a_detector_of_small_aperture(client):
    """Far from the source a detector gets a little more than of a Lambertian surface."""
    at = np.array([2.0, 4.0, 8.0, 12.0])
    R = client.eval("transport", Medium(0.01, 1.0, 0.0, 1.4), at).R[0]
    found, fainter = (
        client.fit("transport", at, R, 0.01 * R, eta=1.4, scale="free",
                   parameters={"detector_na": aperture})
        for aperture in (0.44, 0.22)
    )
    assert 0.85 < found.factor * 0.44**2 < 1 and 0.85 < fainter.factor * 0.22**2 < 1
    np.testing.assert_allclose(found.sigma_s_prime, 1, rtol=0.2)
    assert found.sigma_s_prime != fainter.sigma_s_prime


def test_stated_errors_are_those_of_noise(client, readings):
    """Of 1,000 fits to readings with 2 % noise, 68 % lie within one standard error of the truth and
    95 % within two."""
    found = client.fit("better", AT_MM, noisy(readings, (1000,)), 0.02 * readings, eta=1.4)
    assert found.fitted.all()
    for value, error, true in (
        (found.sigma_a, found.sigma_a_error, 0.03),
        (found.sigma_s_prime, found.sigma_s_prime_error, 1.2),
    ):
        off = np.abs(value - true) / error
        assert 0.64 < np.mean(off < 1) < 0.73 and 0.93 < np.mean(off < 2) < 0.97
    np.testing.assert_allclose(found.chi_squared / 4, found.reduced_chi_squared)
    assert found.reduced_chi_squared.mean() == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize(
    "model, g", [("transport", 0.0), ("transport", 0.9), ("quantized", 0.0), ("beam", 0.0)]
)
def test_what_eval_gives_comes_back(client, model, g):
    """Readings of eval with errors of 1e-4: the last steps are done with profiles of the model,
    some of which another thread prepares."""
    R = client.eval(model, Medium(0.02, 1.1 / (1 - g), g, 1.4), AT_MM).R[0]
    sets = np.stack([R, R * (1 + 1e-4), np.full(6, np.nan), R])
    found = client.fit(model, AT_MM, sets, 1e-4 * R, g=g, eta=1.4, residuals=True)
    assert list(found.status) == ["fitted", "fitted", "refused", "fitted"]
    assert np.abs(found.residuals[0]).max() < 1e-3
    for i in (0, 3):
        np.testing.assert_allclose(found.sigma_a[i], 0.02, rtol=1e-6)
        np.testing.assert_allclose(found.sigma_s_prime[i], 1.1, rtol=1e-6)
    assert found.sets[0].tobytes() == found.sets[3].tobytes()


def test_shapes(client, readings):
    image = noisy(readings, (3, 4))
    found = client.fit("better", AT_MM, image, 0.02 * image, eta=1.4, residuals=True)
    assert found.sets.shape == found.status.shape == found.sigma_a.shape == (3, 4)
    assert found.residuals.shape == image.shape
    one = client.fit("better", AT_MM, image[2, 1], 0.02 * image[2, 1], eta=1.4, residuals=True)
    assert one.sets.tobytes() == found.sets[2, 1].tobytes()
    np.testing.assert_array_equal(one.residuals, found.residuals[2, 1])
    assert "12 fitted" in repr(found) and "1 fitted" in repr(one)
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


def test_negative_readings_count_and_nothing_is_biased(client):
    """At far distances noise is more than R. Dropping what is below 0 would raise the mean."""
    at = [1.0, 2.0, 4.0, 10.0, 15.0, 20.0]
    R = client.eval("better", Medium(0.1, 1.2, 0.0, 1.4), at).R[0]
    errors = np.maximum(0.02 * R, 1e-5)
    values = np.random.default_rng(1).normal(R, errors, (400, len(at)))
    assert np.count_nonzero((values < 0).any(axis=1)) > 300
    for scale in ("absolute", "free"):
        found = client.fit("better", at, values, errors, eta=1.4, scale=scale)
        assert np.count_nonzero(found.fitted) >= 399
        assert (found.chi_squared <= (((values - R) / errors) ** 2).sum(axis=1)).all()
        if scale == "free":  # so little is known that coefficients are far from linear in readings
            continue
        for name, truth in (("sigma_a", 0.1), ("sigma_s_prime", 1.2)):
            values_found = getattr(found, name)[found.fitted]
            assert abs(values_found.mean() - truth) < 4 * values_found.std() / 20, name
    all_dark = client.fit("better", at, -values[0], errors, eta=1.4)
    assert all_dark.status != "fitted"


def test_a_tolerance_does_not_solve_media(client):
    """The search looks media up, whatever tolerance is asked of transport."""
    r = np.array([0.5, 1.0, 2.0, 4.0])
    R = client.eval("transport", Medium(0.05, 10.0, 0.9, 1.3), r, wanted="R").R[0]
    how = {"g": 0.9, "eta": 1.3}
    found = client.fit("transport", r, R, 0.01 * R, parameters={"tolerance": 1e-4}, **how)
    expected = client.fit("transport", r, R, 0.01 * R, **how)
    assert found.sigma_a == pytest.approx(expected.sigma_a, rel=1e-9)


def test_a_bound_is_no_success(client):
    """No medium that is tried absorbs as little."""
    R = client.eval("better", Medium(0.0, 1.0, 0.0, 1.4), AT_MM).R[0]
    found = client.fit("better", AT_MM, R, 0.01 * R, eta=1.4)
    assert found.status == "at-bound" and found.sets["bounds"] == 1 and not found.fitted


def test_readings_that_rise_are_implausible(client):
    """No medium gives more light far away than near."""
    at, rising = [1.0, 2.0, 4.0], np.array([1e-3, 1e-2, 1e-1])
    for model in "better", "transport":
        for scale in "absolute", "free":
            found = client.fit(model, at, rising, 0.01 * rising, scale=scale, eta=1.3)
            assert found.status == "implausible" and found.chi_squared > 1e3 and not found.fitted
    assert client.fit("better", at, rising, rising, eta=1.3).status != "implausible"


def test_readings_that_say_too_little(client, readings):
    """Two readings at nearly the same place, with large errors, leave a line of media."""
    at = [2.0, 2.000001]
    R = client.eval("better", MEDIUM, at).R[0]
    found = client.fit("better", at, R, 0.3 * R, eta=1.4)
    assert found.status in ("undetermined", "at-bound") and not found.fitted
    assert found.condition > 1e3 or found.sigma_a_error > found.sigma_a


# ---- requests that are wrong ---------------------------------------------------------------------

KNOWN = (0.01, 1.0, 0.0, 1.4)

WRONG = {
    **refused("bad-value", "model", "classical", {"0": fit_payload(model=0)}),
    **refused("bad-value", "model", "coefficients alone", {
        name: fit_payload(model=MODELS[name]) for name in ("gaussians", "skin-red")
    }),
    **refused("bad-value", "moments", "exact", {"9": fit_payload(moments=9)}),
    **refused("bad-value", "axis", "1 (r)", {"3": fit_payload(axis=3)}),
    **refused("bad-value", "scale", "1 (absolute)", {"0": fit_payload(scale=0)}),
    **refused("bad-value", "residuals", "0 or 1", {"2": fit_payload(residuals=2)}),
    **refused("bad-value", "zero", "0", {"1": fit_payload(zero=1)}),
    **refused("bad-value", "g", "1", {f"{g}": fit_payload(g=g) for g in (1.0, -1.0, np.nan)}),
    **refused("bad-value", "eta", "0.001", {"0": fit_payload(eta=0.0)}),
    **refused("bad-value", "eta", "2.485", {"fit": fit_payload(moments=2, eta=3.0)}),
    **refused("bad-value", "at", "1e12", {"negative": (fit_payload(at=(1.0, -1.0, 2.0)), 1)}),
    **refused("bad-value", "at", "above 0", {"0": (fit_payload(at=(1.0, 2.0, 0.0)), 2)}),
    **refused("bad-value", "source", "0", {
        "negative": (fit_payload(discs=[[0, -1.0, 0], [0, 0, 0]]), 1),
    }),
    **refused("bad-value", "detector", "0", {
        "NaN": (fit_payload(discs=[[0, 0, 0], [0, 0, np.nan]]), 2),
    }),
    **refused("bad-value", "sigma_a", "0 to 1e15", {
        "of the reference": fit_payload(reference=(-1.0, 1.0, 0.0, 1.4)),
    }),
    **refused("bad-value", "reference", "light", {
        "dark": (fit_payload(reference=KNOWN, at=(1.0, 2.0, 1e6)), 2),
    }),
    **refused("bad-value", "parameter", "1 (tolerance)", {
        "unknown": fit_payload(parameters=[(999, 1.0)]),
    }),
    **refused("bad-value", "thickness", "nothing", {
        "none": fit_payload(parameters=[(PARAMETERS["thickness"].id, 1.0)]),
    }),
    **refused("bad-value", "detector_na", "nothing but with transport", {
        "better": fit_payload(parameters=[(FIT_PARAMETERS["detector_na"].id, 0.22)]),
    }),
    **refused("bad-value", "detector_na", "0.01 to 1", {
        f"{number}": fit_payload(model=MODELS["transport"],
                                 parameters=[(FIT_PARAMETERS["detector_na"].id, number)])
        for number in (2.0, 0.0)
    }),
    **refused("bad-count", "parameter_count", "as many", {
        "65535": fit_payload(parameter_count=65535),
    }),
    **refused("bad-count", "reading_count", "2 to 1024", {
        "1": (fit_payload([[0.1]], 0.01, [1.0]), 1),
        "0": fit_payload(reading_count=0),
        "1025": (fit_payload(reading_count=1025), 1025),
        "2 with a factor": (fit_payload([[0.1, 0.01]], 0.01, [1.0, 2.0], scale=2), 2),
    }),
    **refused("bad-count", "reading_count", "as many", {"1000": fit_payload(reading_count=1000)}),
    **refused("bad-count", "set_count", "at least 1", {"none": fit_payload(set_count=0)}),
    **refused("bad-count", "set_count", "as many", {
        **{f"{n:#x}": fit_payload(set_count=n) for n in (2, 2**60, 2**64 - 1)},
        "trailing bytes": fit_payload() + bytes(8),
        "cut": fit_payload()[:-8],
    }),
    **refused("bad-length", "payload_bytes", "at least 48", {"none": b"", "short": bytes(40)}),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said(connection, name):
    assert_refused(connection, FIT_REQUEST, *WRONG[name])


# ---- large requests ------------------------------------------------------------------------------


def test_in_parts_the_same_bits(daemon, client, readings):
    """A reply has the same bits when it fits into a frame exactly and when it is cut into parts."""
    one = daemon("--max-frame-bytes", "65536", "--max-part-bytes", "8192")
    room = (65536 - wire.FIT_REPLY.bytes) // (wire.FITTED.bytes + 8 * len(AT_MM))
    values = noisy(readings, (room + 1,))
    values[::50] = -1
    errors = 0.02 * np.abs(values)
    whole = client.fit("better", AT_MM, values, errors, eta=1.4, residuals=True)
    assert np.count_nonzero(~whole.fitted) == len(values[::50])
    with one.client() as small, one.connect() as connection:
        for count, parts in ((room, 1), (room + 1, 9)):
            cut = small.fit(
                "better", AT_MM, values[:count], errors[:count], eta=1.4, residuals=True
            )
            assert cut.sets.tobytes() == whole.sets[:count].tobytes()
            np.testing.assert_array_equal(cut.residuals, whole.residuals[:count])
            payload = fit_payload(values[:count], errors[:count], AT_MM, residuals=1)
            connection.send_bytes(frame(FIT_REQUEST, 77, payload))
            first, received = receive_answer(connection)
            assert first.type == FITTED and len(received) == parts
            assert parts == 1 or all(len(part) <= 8192 for part in received)


@pytest.mark.parametrize("isa", ["portable", "sse2"])
def test_every_instruction_set_finds_the_same(daemon, client, readings, isa):
    values = noisy(readings, (20,))
    with daemon("--isa", isa).client() as other:
        for model in ("better", "classical+single"):
            one, two = (
                some.fit(model, AT_MM, values, 0.02 * values, eta=1.4) for some in (client, other)
            )
            assert one.sets.tobytes() == two.sets.tobytes()


def test_a_design_is_prepared_once(daemon, readings):
    with daemon().client() as client:
        for _ in range(3):
            client.fit("better", AT_MM, readings, 0.01 * readings, eta=1.4)
        assert client.statistics()["cache_builds"] == 1
        client.fit("better", AT_MM, readings, 0.01 * readings, eta=1.41)
        assert client.statistics()["cache_builds"] == 2
        assert client.statistics()["sets_fitted"] == 4


def test_without_a_cache(daemon, readings):
    with daemon("--cache-bytes", "0").client() as client:
        found = client.fit("better", AT_MM, readings, 0.01 * readings, eta=1.4)
        assert found.status == "fitted"


def test_leaving_while_it_is_fitted(daemon):
    one = daemon("--workers", "1")
    for sets in (1, 300):
        with one.connect() as leaving:
            payload = fit_payload([READINGS] * sets, eta=1.3 + 1e-4 * sets)
            leaving.send_bytes(frame(FIT_REQUEST, 1, payload))
    with one.connect() as connection:
        assert_serves(connection)
        assert ask(connection, FIT_REQUEST, fit_payload()).type == FITTED


def test_answers_that_do_not_fit_are_not_taken():
    """A client refuses a reply that does not fit its request, because its caller relies on the
    shape."""
    right = {
        "part": 0, "part_count": 2, "count": 3, "first": 0, "fitted_count": 1,
        "reading_count": 2, "notes": 0,
    }  # fmt: skip

    def payload(**changes) -> bytes:
        fixed = {**right, **changes}
        each = wire.FITTED.bytes + 8 * fixed["reading_count"]
        return wire.FIT_REPLY.pack(**fixed) + bytes(each * min(fixed["count"], 9))

    def answer() -> fitting.Answer:
        return fitting.Answer(0, 4, 2)

    last = {"part": 1, "count": 1, "first": 3}
    wrong = [{"part": 1}, {"part_count": 1}, {"count": 4}, {"count": 0}, {"first": 1}]
    wrong += [{"fitted_count": 4}, {"reading_count": 3}, {"reading_count": 0}]
    for changes in wrong:
        with pytest.raises(dipole.ProtocolError):
            answer().add(payload(**changes))
    for changes in ({"first": 2}, {"count": 2}, {"part": 0}):
        begun = answer()
        begun.add(payload())
        with pytest.raises(dipole.ProtocolError):
            begun.add(payload(**{**last, **changes}))
    for cut in (payload()[:-8], payload()[:20]):
        with pytest.raises(dipole.ProtocolError):
            answer().add(cut)
    whole = answer()
    whole.add(payload())
    assert not whole.ended and not whole.ready
    whole.add(payload(**{**last, "fitted_count": 0}))
    assert whole.ended and len(whole.ready.popleft().sets) == 4


def test_a_client_asks_again_when_the_daemon_is_gone(daemon, readings):
    one = daemon()
    with dipole.Client(one.url("unix"), retry_s=20.0) as client:
        before = client.fit("better", AT_MM, readings, 0.01 * readings, eta=1.4)
        client._connection.socket.shutdown(2)
        after = client.fit("better", AT_MM, readings, 0.01 * readings, eta=1.4)
        assert before.sets.tobytes() == after.sets.tobytes()
