"""The Python client's values(), grids, samples and inversions: arrays of any shapes, as numpy
broadcasts them."""

import dipole
import numpy as np
import pytest
from dipole import Draw, Grid, Medium
from frames import SKIN

SKIN1 = [Medium(0.032, 0.74), Medium(0.17, 0.88), Medium(0.48, 1.01)]
SIGMA_A = np.array([medium.sigma_a for medium in SKIN1])
SIGMA_S = np.array([medium.sigma_s for medium in SKIN1])


def one_by_one(client, media: np.ndarray, r: np.ndarray, quantity: str, **options) -> np.ndarray:
    """Computes the expected result of values() by one eval for each value. media: [..., 4]"""
    shape = np.broadcast_shapes(media.shape[:-1], r.shape)
    all_media = np.broadcast_to(media, (*shape, 4))
    all_r = np.broadcast_to(r, shape)
    found = [
        client.eval("better", tuple(all_media[i]), [all_r[i]], wanted=[quantity], **options)
        for i in np.ndindex(shape)
    ]
    return np.array([one.values[quantity][0, 0] for one in found]).reshape(shape)


def random_media(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Returns random media of which some are equal."""
    few = np.stack([rng.choice([0.03, 0.2], shape), rng.choice([0.7, 0.9, 1.0], shape)], axis=-1)
    return np.concatenate([few, np.zeros((*shape, 1)), np.full((*shape, 1), 1.3)], axis=-1)


@pytest.mark.parametrize(
    "media_shape, r_shape",
    [
        ((), ()),
        ((), (5,)),
        ((3, 1), (5,)),
        ((3, 1, 1), (2, 5)),
        ((3,), (5, 1)),
        ((2, 1, 4), (3, 1)),
        ((4, 3), (4, 3)),
        ((4, 3, 1), (3, 2)),
        ((6,), (1,)),
        ((6,), ()),
        ((1,), (2, 3)),
        ((5,), (4, 5)),
    ],
)
def test_shapes(client, media_shape, r_shape):
    rng = np.random.default_rng(20261121)
    media, r = random_media(rng, media_shape), rng.uniform(0, 5, r_shape)
    for quantity, evaluator in (("R", "f64"), ("cdf", "f32")):
        found = client.values("better", media, r, quantity, evaluator=evaluator)
        expected = one_by_one(client, media, r, quantity, evaluator=evaluator)
        np.testing.assert_array_equal(found.values, expected)
        assert found.values.dtype == expected.dtype
        assert found.models == ("better",)
        assert found.numerical_error.shape == found.model_error.shape == expected.shape


def test_fields_that_are_arrays(client):
    r = np.linspace(0.1, 3, 7)
    expected = client.eval("better", SKIN1, r)
    found = client.values("better", Medium(SIGMA_A[:, None], SIGMA_S[:, None]), r)
    np.testing.assert_array_equal(found.values, expected.R)
    np.testing.assert_array_equal(found.numerical_error, expected.numerical_error(r))
    np.testing.assert_array_equal(found.model_error, expected.model_error[:, None] + np.zeros(7))


def test_more_media_and_radii_than_a_request_may_have(daemon):
    options = ["--max-media", "4", "--max-frame-bytes", "4096"]
    with daemon(*options).client() as small, daemon().client() as large:
        media = Medium(np.linspace(0.01, 1, 11)[:, None], 1.0)
        r = np.linspace(0, 4, 700)
        expected = large.values("better", media, r)
        np.testing.assert_array_equal(small.values("better", media, r).values, expected.values)
        one = Medium(np.full(700, 0.3), 1.0)  # all pairs have the same medium
        expected = large.values("better", one, r)
        np.testing.assert_array_equal(small.values("better", one, r).values, expected.values)


def test_nothing_is_asked_for(client):
    empty = client.values("better", SKIN1[0], np.empty((3, 0)))
    assert empty.values.shape == empty.numerical_error.shape == (3, 0)
    assert client.values("better", np.empty((0, 4)), 1.0).values.shape == (0,)


def test_a_tolerance_may_take_several_models(client):
    media = Medium(np.array([0.0001, 0.1, 3.0]), 1.0)
    r = np.array([1.0, 1.5, 2.0])
    found = client.values(None, media, r, tolerance=0.05)
    for i in range(3):
        one = client.eval(None, Medium(media.sigma_a[i], 1.0), [r[i]], tolerance=0.05)
        assert one.model in found.models
        assert found.values[i] == one.R[0, 0]
        assert found.model_error[i] == one.model_error[0] <= 0.05


@pytest.mark.parametrize(
    "media, r, text",
    [
        (Medium(SIGMA_A, 1.0), [1.0, 2.0], "media, r"),
        (Medium(SIGMA_A, [1.0, 2.0]), 1.0, "shapes of its fields"),
        (np.zeros((4, 3)), 1.0, "media"),
        (3.0, 1.0, "media"),
    ],
)
def test_what_does_not_fit_is_not_sent(client, media, r, text):
    with pytest.raises(dipole.ArgumentError, match=text):
        client.values("better", media, r)


def test_arguments_of_other_kinds_are_told_what_belongs_there(client):
    points = dipole.Points(np.zeros((1, 3)), np.ones((1, 1)))
    with pytest.raises(dipole.ArgumentError, match=r"dipole.Medium\(sigma_a, sigma_s, g, eta, thickness\)"):
        client.eval(None, {"sigma_a": 0.1, "sigma_s": 1.0}, [1.0], tolerance=0.01)
    with pytest.raises(dipole.ArgumentError, match="model: a name, such as .*, or an id; not None"):
        client.gather(None, SKIN1[0], points, np.zeros((1, 3)))
    for text, call in {
        "points: dipole.Points": lambda: client.gather("better", SKIN1[0], np.zeros(3), np.zeros((1, 3))),
        "a Grid is given as grid=": lambda: client.eval("better", SKIN1[0], Grid(0, 1, 3)),
        "deadline_ms: a whole": lambda: client.eval("better", SKIN1[0], [1.0], deadline_ms="1"),
        "timeout_s.*above 0": lambda: dipole.Client(timeout_s=0),
    }.items():
        with pytest.raises(dipole.ArgumentError, match=text):
            call()
    for address in (["tcp:localhost:1"], [], ""):
        with pytest.raises(dipole.AddressError, match="one text"):
            dipole.Client(address)
    with pytest.raises(dipole.ConnectError, match="/none.pem"):
        dipole.Client("tls:localhost:1", ca="/none.pem", retry_s=0)


def test_a_refusal_among_many_leaves_the_client_as_it_was(client):
    sigma_a = np.linspace(-1, 5, 100)  # The first media are refused.
    with pytest.raises(dipole.Refused) as caught:
        client.values("better", Medium(sigma_a, 1.0), np.linspace(0, 1, 100))
    assert caught.value.field == "sigma_a"
    assert client.eval("better", SKIN1[0], [1.0]).R.shape == (1, 1)
    with pytest.raises(dipole.ArgumentError):
        client.collect()


def test_collecting_a_certain_one(client):
    ids = [client.submit("better", SKIN1[0], [0.1 * i]) for i in range(20)]
    expected = {i: client.eval("better", SKIN1[0], [0.1 * n]).R for n, i in enumerate(ids)}
    for request_id in reversed(ids[5:]):
        found, result = client.collect(request_id)
        assert found == request_id
        np.testing.assert_array_equal(result.R, expected[request_id])
    client.forget(ids[0])
    client.forget(ids[0])  # A query that has been collected may be forgotten.
    rest = [client.collect()[0] for _ in range(4)]
    assert rest == ids[1:5]
    with pytest.raises(dipole.ArgumentError, match="not outstanding"):
        client.collect(ids[0])


# ---- grids, samples and inversions ---------------------------------------------------------------


@pytest.mark.parametrize("evaluator", ["f64", "f32", "lut"])
@pytest.mark.parametrize("spacing", ["linear", "logarithmic"])
def test_a_grid_is_the_list_of_its_radii(client, spacing, evaluator):
    """Its ends are rounded to the evaluator's precision before errors are stated."""
    medium = Medium(0.35, 0.65, 0.0, 1.5)
    for model in ("transport", "better"):
        how = {"evaluator": evaluator, "wanted": ["R", "cdf", "albedo", "r"]}
        grid = client.eval(model, medium, grid=Grid(0.01, 19.9, 11, spacing), **how)
        listed = client.eval(model, medium, grid.r, **how)
        for name in ("R", "cdf"):
            assert grid.values[name].tobytes() == listed.values[name].tobytes()
        assert (grid.r == listed.r).all() and grid.albedo == listed.albedo
        np.testing.assert_equal(grid.errors, listed.errors)
    albedo = client.eval("better", Medium(0, 1), grid=Grid(0.0, 1.0, 2**40), wanted=["albedo"])
    assert albedo.albedo[0] == 1.0  # Any number of radii costs nothing then.


def test_an_inversion_of_a_texture(client):
    """The albedos are a texture, with one length for each of its channels."""
    texture = np.random.default_rng(3).uniform(0.05, 0.95, (4, 5, 3))
    found = client.invert("better", texture, [1.0, 0.5, 0.25], g=0.8)
    assert found.sigma_a.shape == found.sigma_s.shape == found.albedo.shape == texture.shape
    assert found.media.shape == (4, 5, 3, 4)
    one = client.invert("better", texture[2, 3, 1], 0.5, g=0.8)
    assert one.sigma_a.shape == ()
    assert one.sigma_a == found.sigma_a[2, 3, 1] and one.sigma_s == found.sigma_s[2, 3, 1]
    for off in (found.sigma_a_error / found.sigma_a, found.sigma_s_error / found.sigma_s):
        assert (0 < off).all() and (off < 1e-12).all()
    truth = client.eval("transport", found.media[2, 3], [], wanted=["albedo"])
    off = found.albedo[2, 3] / truth.albedo - 1
    assert (abs(abs(off) - found.model_error[2, 3]) < 1e-5).all()
    with pytest.raises(dipole.ArgumentError, match="albedo, length"):
        client.invert("better", [0.1, 0.2], [1.0, 2.0, 3.0])
    with pytest.raises(dipole.ArgumentError, match="length paths"):
        client.invert("better", 0.1, 1.0, given="paths")


@pytest.mark.parametrize("light, specular", [("beam", True), ("diffuse", False)])
def test_an_inversion_means_what_varying_means(client, light, specular):
    colours, lengths = np.array([0.3, 0.9]), np.array([1.0, 0.25])
    asked = {"given": "extinction-path", "light": light, "specular": specular, "g": 0.9, "eta": 1.5}
    found = client.invert("transport", colours, lengths, **asked)
    other = client.varying("transport", colour=colours, length=lengths, evaluator="f64", **asked)
    assert np.allclose(found.albedo, colours, rtol=1e-9, atol=0)
    assert np.allclose(1 / (found.sigma_a + found.sigma_s), lengths, rtol=1e-12, atol=0)
    for name in ("sigma_a", "sigma_s"):
        assert np.allclose(getattr(found, name), other.coefficients[name], rtol=1e-3, atol=0)
    assert (found.albedo_least > 0.02) == specular
    assert (found.model_error == 0).all()
    for name in ("sigma_a", "sigma_s"):  # as far apart as albedos that differ by their error
        share = getattr(found, name + "_error") / getattr(found, name)
        assert (1e-14 < share).all() and (share < 1e-4).all()


def test_a_dipole_knows_no_diffuse_light(client):
    with pytest.raises(dipole.Refused, match="light"):
        client.invert("better", 0.5, 1.0, light="diffuse")


OTHER = (0.3, 2.0, 0.0, 1.4)


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


def test_samples_without_numbers(client):
    sampled = client.sample("better", SKIN, [], wanted=["r", "pdf", "albedo"])
    assert sampled.r.shape == (1, 0) and sampled.albedo[0] > 0
    alone = client.sample("better", SKIN, draw=Draw(3), wanted=["albedo"])
    assert not hasattr(alone, "r") and alone.albedo == sampled.albedo


def test_samples_that_do_not_fit(client):
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
