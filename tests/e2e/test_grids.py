"""A grid gives the same values as the list of its radii. tests/unit/test_grid.c tests the radii
themselves."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from dipole import Grid, Medium

MEDIA = [Medium(0.032, 0.74), Medium(0.17, 0.88), Medium(0.0, 11.6)]

GRIDS = {
    "linear": Grid(0.0, 10.0, 1001),
    "linear, odd step": Grid(0.1, 7.7, 37),
    "linear, three": Grid(1.0, 2.0, 3),
    "linear, large": Grid(0.0, 1.7e308, 5),
    "linear, narrow": Grid(1.0, 1.0 + 2**-50, 9),
    "logarithmic": Grid(0.01, 100.0, 401, "logarithmic"),
    "logarithmic, wide": Grid(1e-300, 1e300, 97, "logarithmic"),
    "logarithmic, narrow": Grid(1.0, 1.0000001, 11, "logarithmic"),
    "longer than a slice": Grid(0.0, 20.0, 100_003),
    "logarithmic, longer than a slice": Grid(1e-4, 50.0, 70_001, "logarithmic"),
}
EVALUATORS = {"f64": np.float64, "f32": np.float32}


@pytest.mark.parametrize(
    "name, evaluator, model", itertools.product(GRIDS, EVALUATORS, ["classical", "better"])
)
def test_values_equal_those_of_the_list(client, name, evaluator, model):
    by_rule = client.eval(model, MEDIA, grid=GRIDS[name], evaluator=evaluator)
    by_list = client.eval(model, MEDIA, by_rule.r, evaluator=evaluator)
    assert by_rule.r.dtype == EVALUATORS[evaluator]
    assert by_rule.R.tobytes() == by_list.R.tobytes()
    assert by_rule.cdf.tobytes() == by_list.cdf.tobytes()
    assert by_rule.albedo.tobytes() == by_list.albedo.tobytes()


@pytest.mark.parametrize("spacing", ["linear", "logarithmic"])
def test_one_radius_is_the_start(client, spacing):
    for grid, r in [(Grid(0.3, 4.0, 1, spacing), [0.3]), (Grid(2.5, 2.5, 4, spacing), [2.5] * 4)]:
        result = client.eval("better", MEDIA, grid=grid)
        np.testing.assert_array_equal(result.r, r)
        np.testing.assert_array_equal(result.R, client.eval("better", MEDIA, r).R)


def test_listed_radii_come_back_when_wanted(client):
    r = [3.0, 0.0, 1.5]
    result = client.eval("better", MEDIA, r, wanted=["r", "R"])
    np.testing.assert_array_equal(result.r, r)
    np.testing.assert_array_equal(result.R, client.eval("better", MEDIA, r).R)


@pytest.mark.parametrize("count", [0, 2**40])
def test_a_grid_for_an_albedo_costs_nothing(client, count):
    """If only the albedo is wanted, any number of radii costs nothing."""
    result = client.eval("better", MEDIA, grid=Grid(0.0, 1.0, count), wanted=["albedo"])
    assert result.albedo[2] == 1.0


@pytest.mark.parametrize("evaluator", EVALUATORS | {"lut": np.float32})
def test_errors_are_those_of_the_list(client, evaluator):
    """The ends of a grid are rounded to the evaluator's precision before the errors are stated. So
    the errors are those of the list of its radii, also when the request is repeated."""
    for model, medium, grid in [
        # The error grows with the radius.
        ("transport", Medium(0.35, 0.65, 0.0, 1.5), Grid(1.0, 70.3, 11)),
        # The error is known from 0.01 mm on.
        ("better", Medium(0.35, 0.65, 0.0, 1.5), Grid(0.01, 19.9, 11)),
    ]:
        how = {"evaluator": evaluator, "wanted": ["R", "albedo"]}
        answers = [client.eval(model, medium, grid=grid, **how) for _ in range(3)]
        r = client.eval(model, medium, grid=grid, evaluator=evaluator, wanted=["r"]).r
        answers += [client.eval(model, medium, r, **how) for _ in range(2)]
        assert len({answer.numerical_error(0.0).tobytes() for answer in answers}) == 1
        assert len({answer.model_error.tobytes() for answer in answers}) == 1
        assert np.isfinite(answers[0].model_error).all()
