"""Values each of which has a medium of its own: the message varying, and libdipole's clients."""

import pickle

import dipole
import numpy as np
import pytest
from dipole import Medium, varying, wire
from frames import VARYING, ask, assert_serves, varying_payload

REPLY = VARYING | wire.REPLY


def texture(count: int, seed: int = 1) -> dict[str, np.ndarray]:
    """Returns media and radii of all orders of magnitude that renderers meet."""
    source = np.random.default_rng(seed)
    sigma_t = 10 ** source.uniform(-2, 2, count)
    absorbed = 10 ** source.uniform(-5, -0.1, count)
    return {
        "sigma_a": sigma_t * absorbed,
        "sigma_s": sigma_t * (1 - absorbed),
        "r": 10 ** source.uniform(-2, 1, count) / sigma_t,
    }


def bits(result: dipole.Varying) -> list[bytes]:
    arrays = {**result.quantities, **result.coefficients}
    return [array.tobytes() for array in (*arrays.values(), result.statuses)]


# ---- values --------------------------------------------------------------------------------------


def test_a_surface_is_prepared_once(daemon):
    with daemon().client() as client:
        for tolerance in (1e-3, 1e-3, 1e-4):
            client.varying("transport", sigma_a=0.1, sigma_s=1.0, r=1.0, tolerance=tolerance)
        assert client.statistics()["cache_builds"] == 2


# ---- statuses ------------------------------------------------------------------------------------


def test_a_value_that_is_wrong_is_named_and_the_others_are_answered(client):
    nan = np.nan
    sigma_a = [0.1, -1, nan, 0.1, 0.1, 0.1, 0.1, np.inf, 0.1]
    sigma_s = [1.0, -1, 1.0, -1, nan, 1e9, 1.0, 1.0, 1.0]
    r = [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1, 1.0, nan]
    names = ["ok", "sigma_a", "sigma_a", "sigma_s", "sigma_s", "sigma_s", "radius", "sigma_a",
             "radius"]
    statuses = client.info.choices["value"]
    for evaluator in ("f64", "f32"):
        found = client.varying("better", sigma_a=sigma_a, sigma_s=sigma_s, r=r,
                               wanted=["R", "albedo"], evaluator=evaluator,
                               coefficients=["sigma_a", "sigma_s", "scattered"])
        assert [statuses[name].id for name in names] == found.statuses.tolist()
        np.testing.assert_allclose(found["scattered"][found.computed], 1 / 1.1, rtol=1e-6)
        for array in (found["R"], found["albedo"], found["sigma_a"]):
            np.testing.assert_array_equal(np.isnan(array), ~found.computed)
        assert set(found.faults) == set(names) - {"ok"}
        alone = client.varying("better", sigma_a=0.1, sigma_s=1.0, r=1.0, evaluator=evaluator)
        assert found["R"][0] == alone["R"]
    solved = client.varying("transport", sigma_a=[1.0, 1.0, 0.1], sigma_s=[1.0, 1e-3, 9.0], r=[1.0, 1.0, 1e4])
    assert [statuses[name].id for name in ("ok", "ratio", "far")] == solved.statuses.tolist()
    drawn = client.varying("better", sigma_a=0.1, sigma_s=1.0, u=[0.5, -0.1, 1.1, nan])
    assert drawn.statuses.tolist() == [0, *[statuses["number"].id] * 3]


def test_colours_without_a_medium_are_not_clamped(client):
    colours = [0.5, 1.5, -0.1, np.nan]
    found = client.varying("better", colour=colours, length=[1.0, 1.0, 1.0, 1.0])
    colour = client.info.choices["value"]["colour"].id
    assert found.statuses.tolist() == [0, colour, colour, colour]
    assert np.isnan(found["sigma_a"]).tolist() == [False, True, True, True]
    found = client.varying("better", colour=0.5, length=[1.0, 0.0, -1.0, np.nan, 1e30], r=1.0)
    length = client.info.choices["value"]["length"].id
    assert found.statuses.tolist() == [0, length, length, length, length]
    assert np.isnan(found["R"]).tolist() == [False, True, True, True, True]


# ---- requests that are wrong ---------------------------------------------------------------------


def test_no_values(connection):
    reply = ask(connection, VARYING, varying_payload((), ()))
    assert reply.type == REPLY
    fixed = wire.VARYING_REPLY.unpack(reply.payload)
    assert (fixed.count, fixed.computed_count, fixed.part_count) == (0, 0, 1)
    assert_serves(connection)


# ---- the Python client ---------------------------------------------------------------------------


def test_shapes(client):
    """Arrays of any shapes are broadcast: a texture with a length for each of its channels."""
    colours = np.random.default_rng(3).uniform(0.05, 0.9, (4, 5, 3))
    found = client.varying("better", colour=colours, length=[1.0, 0.5, 0.25], g=0.8)
    assert found["sigma_a"].shape == found.statuses.shape == colours.shape
    one = client.varying("better", colour=colours[2, 3, 1], length=0.5, g=0.8)
    assert one["sigma_a"].shape == () and one["sigma_a"] == found["sigma_a"][2, 3, 1]
    assert "better" in repr(found)
    for options in ({"sigma_a": 1.0}, {"colour": 1.0}, {"sigma_a": 1.0, "colour": 1.0}, {},
                    {"sigma_a": 1.0, "sigma_s": 1.0, "r": 1.0, "u": 0.5},
                    {"sigma_a": [1.0, 2.0], "sigma_s": [1.0, 2.0, 3.0]}):
        with pytest.raises(dipole.ArgumentError):
            client.varying("better", **options)


def test_more_values_than_a_request_holds(client, monkeypatch):
    given = texture(1000)
    whole = client.varying("better", **given)
    monkeypatch.setattr(varying, "VALUES_MOST", 300)
    assert bits(client.varying("better", **given)) == bits(whole)


# ---- at home -------------------------------------------------------------------------------------


def awkward(count: int = 3000, g: float = 0.0) -> tuple[np.ndarray, ...]:
    """Returns sigma_a, sigma_s, r and u of all magnitudes, with some that have no answer."""
    dice = np.random.default_rng(20120101)
    sigma_t, ratio = 10 ** dice.uniform(-3, 3, count), 10 ** dice.uniform(-6, 2.2, count)
    ratio[::16] = 0
    sigma_s = sigma_t / (1 + ratio) / (1 - g)
    sigma_a = sigma_t - sigma_s * (1 - g)
    sigma_a[:3] = [-1, np.nan, np.inf]
    sigma_s[3:6] = [-1, 0, np.nan]
    r = 10 ** dice.uniform(-4, 2, count) / sigma_t
    r[6:12] = [0, -0.0, -1, np.nan, np.inf, 1e-30]
    u = dice.uniform(0, 1, count)
    u[6:12] = [0, 1, -0.1, 1.1, 1e-12, 1 - 1e-7]
    return sigma_a, sigma_s, r, u


@pytest.mark.parametrize("evaluator", ["f32", "f64"])
@pytest.mark.parametrize(
    "model, g, eta", [("transport", 0.0, 1.4), ("transport", 0.8, 1.3), ("better", 0.8, 1.3)]
)
def test_a_surface_evaluates_at_home_with_the_same_bits(client, evaluator, model, g, eta):
    surface = client.surface(model, g, eta, evaluator=evaluator)
    sigma_a, sigma_s, r, u = awkward(g=g)
    media = {"sigma_a": sigma_a, "sigma_s": sigma_s, "g": g, "eta": eta, "evaluator": evaluator}
    found = client.varying(model, **media, r=r, wanted=["R", "cdf", "pdf", "2_pi_r_R"])
    for name, values in (("R", surface.R), ("cdf", surface.cdf), ("pdf", surface.pdf),
                         ("2_pi_r_R", surface.ring)):
        assert values(sigma_a, sigma_s, r).tobytes() == found[name].tobytes(), name
    np.testing.assert_array_equal(surface.is_within_error(sigma_a, sigma_s, r),
                                  found.statuses == 0)
    assert np.count_nonzero(found.statuses == 1) < 1500
    assert np.any(found.statuses == 1) == (model == "transport")
    drawn = client.varying(model, **media, u=u)
    assert surface.radius(sigma_a, sigma_s, u).tobytes() == drawn["r"].tobytes()
    assert found.numerical_error <= surface.numerical_error


@pytest.mark.parametrize("evaluator", ["f32", "f64"])
@pytest.mark.parametrize("model", ["transport", "better", "burley-dmfp"])
def test_a_surface_finds_media_at_home_with_the_same_bits(client, model, evaluator):
    dice = np.random.default_rng(20120101)
    colours = dice.uniform(-0.05, 1.05, 1000)
    colours[:9] = [0, 1, np.nan, np.inf, -np.inf, 1e-9, 1 - 1e-7, -0.0, 0.04]
    lengths = 10 ** dice.uniform(-4, 4, 1000)
    lengths[10:16] = [0, -1, np.nan, np.inf, 1e-9, 1e9]
    surface = client.surface(model, 0.5, 1.5, evaluator=evaluator)
    for light in ["beam", "diffuse"] if model == "transport" else ["beam"]:
        for given in client.info.choices["length"]:
            for specular in (False, True):
                found = client.varying(
                    model, colour=colours, length=lengths, light=light, given=given, g=0.5,
                    eta=1.5, specular=specular, evaluator=evaluator,
                    coefficients=["sigma_a", "sigma_s", "scattered"],
                )
                for share in (specular, found.specular if specular else 0.0):
                    how = {"given": given, "light": light, "specular": share}
                    for name, values in surface.media(colours, lengths, **how)._asdict().items():
                        assert values.tobytes() == found[name].tobytes(), (how, name)


def test_a_surface_keeps_shapes_and_its_frame(client, tmp_path):
    surface = client.surface("transport", tolerance=1e-2)
    assert surface.parameters == {"tolerance": 1e-2} and "transport" in repr(surface)
    assert set(surface._fixed.numerical_errors) == {surface.numerical_error}
    media = surface.media(np.full((2, 3), 0.5), [1.0, 0.5, 0.25])
    R = surface.R(media.sigma_a, media.sigma_s, 0.5)
    assert R.shape == media.sigma_a.shape == (2, 3) and R.dtype == np.float32
    assert surface.R(0.1, 1.0, 0.5).shape == ()
    surface.save(tmp_path / "surface")
    again = dipole.Surface.load(tmp_path / "surface", client.info, "f64")
    assert again.R(0.1, 1.0, 0.5) == pytest.approx(float(surface.R(0.1, 1.0, 0.5)), rel=1e-5)
    assert dipole.Surface.load(surface.data).model == surface.model_id
    for light, specular in (("diffuse", 0.5), ("moon", False), ("beam", 1.0)):
        with pytest.raises(dipole.ArgumentError):
            surface.media(0.5, 1.0, light=light, specular=specular)
    with pytest.raises(dipole.ArgumentError):
        surface.media(0.5, 1.0, given="miles")
    with pytest.raises(dipole.ArgumentError, match="light"):
        client.surface("better").media(0.5, 1.0, light="diffuse")
    with pytest.raises(dipole.ArgumentError):
        surface.R([0.1, 0.2], [1.0, 1.0, 1.0], 1.0)
    assert pickle.loads(pickle.dumps(again)).R(0.1, 1.0, 0.5) == again.R(0.1, 1.0, 0.5)
    with pytest.raises(dipole.ArgumentError):
        client.surface("better", evaluator="lut")
    with pytest.raises(dipole.TableError):
        dipole.Table(surface.data)
    with pytest.raises(dipole.TableError):
        dipole.Surface(client.table("better", Medium(0.1, 1.0)).data)
    with pytest.raises(dipole.Refused, match="tolerance"):
        client.surface("transport", tolerance=1e-6)


def test_damaged_surfaces_are_refused(client):
    data = client.surface("transport", tolerance=1e-2).data
    for damaged in (data[:-1], data + b"\0", data[:100], b"", data[:-1] + b"\xff"):
        with pytest.raises(dipole.TableError):
            dipole.Surface(damaged)


def test_the_model_error_has_no_array_of_its_own(client):
    how = {"sigma_a": [0.1, 0.2], "sigma_s": 1.0, "r": 1.0, "g": 0.8, "eta": 1.4}
    one = client.varying("transport", wanted=["R", "model_error"], **how)
    assert list(one.quantities) == ["R"]
    assert np.array_equal(one["R"], client.varying("transport", wanted="R", **how)["R"])


@pytest.mark.parametrize("numbers", [{"r": [0.3, 0.5, 3.0, 8.0]}, {"u": [0.2, 0.5, 0.7, 0.9]}])
def test_the_model_error_is_the_largest_of_the_values_alone(client, numbers):
    (name, given), sigma_a = *numbers.items(), [0.05, 0.1, 0.02, 0.4]
    radii = client.varying("better", sigma_a=sigma_a, sigma_s=1.0, wanted="r", **numbers)["r"] if name == "u" else given
    errors = []
    for media, value, r in zip(sigma_a, given, radii):
        alone = client.varying("better", sigma_a=media, sigma_s=1.0, wanted=["R", "model_error"], **{name: value})
        single = client.eval("better", Medium(media, 1.0), [r], wanted=["R", "model_error"])
        assert alone.model_error == pytest.approx(single.model_error[0], abs=2e-3)
        errors.append(alone.model_error)
    both = client.varying("better", sigma_a=sigma_a, sigma_s=1.0, wanted=["R", "model_error"], **numbers)
    assert both.model_error == pytest.approx(max(errors), abs=2e-3)
