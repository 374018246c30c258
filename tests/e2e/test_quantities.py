"""The quantities of a profile besides R. tests/accuracy/test_distributions.c tests that they agree with R,
and tests/cli/eval.t has them in every format."""


import numpy as np
import pytest
from command_line import Proxy, eval_rows
from dipole import wire
from frames import SKIN, changed_choices


def test_each_quantity_has_errors_of_its_own(client):
    """Those of R do not depend on what else is wanted. The largest model error is not known where one
    of them is not."""
    many = ["R", "cdf", "dR_dr", "dlnR_dln_sigma_a", "albedo"]
    for model, r in (("better", [0.5, 2.0]), ("transport", [0.5, 2.0]), ("better", [1.0, 1e5])):
        alone = client.eval(model, SKIN, r, wanted="R").errors["R"]
        among = client.eval(model, SKIN, r, wanted=many)
        np.testing.assert_equal(among.errors["R"], alone)
        of_each = [among.errors[name].model_error[0] for name in many if "dln" not in name]
        np.testing.assert_equal(among.model_error[0], np.max(of_each))
        assert np.isnan(among.model_error[0]) == (r[-1] > 1e4)


# ---- a daemon of another kind --------------------------------------------------------------------


def sums_for_quantities(type: int, payload: bytes) -> list[bytes]:
    """Changes a reply to hello: the id of the quantity pdf becomes the sum of the bits of R and
    cdf."""

    def change(choice):
        is_pdf = wire.KINDS[choice.kind] == "quantity" and choice.name == "pdf"
        return choice._replace(id=wire.QUANTITIES["R"] | wire.QUANTITIES["cdf"]) if is_pdf else choice

    return changed_choices(type, payload, change)


@pytest.mark.parametrize("want", ["R", "pdf"])
def test_a_daemon_whose_quantities_are_not_bits(daemon, want):
    """The command must not look for an array that the answer lacks."""
    arguments = ["--sigma-a", "0.1", "--sigma-s", "1", "--r", "0.5,2"]
    with Proxy(daemon().url(), lambda number, request_id: None, sums_for_quantities) as proxy:
        rows = eval_rows(*arguments, "--wanted", want, "--connect", proxy.url)
    expected = eval_rows(*arguments, "--wanted", "R" if want == "R" else "R,cdf")
    assert rows == expected


# ---- model errors at each radius -----------------------------------------------------------------


def test_model_errors_are_those_of_each_radius(client):
    """The largest is the model error of the channel, and each is that of the radius alone."""
    r = np.geomspace(0.05, 20, 300)  # more than are compared together
    wanted = ["R", "cdf", "model_errors"]
    answer = client.eval("better", "skin1", r, wanted=wanted, evaluator="f64")
    few = client.eval("better", "skin1", r[100:110], wanted=wanted, evaluator="f64")
    assert few.model_errors.tolist() == answer.model_errors[:, 100:110].tolist()
    assert few.model_error.tolist() == few.model_errors.max(axis=1).tolist()
    single = client.eval("better", "skin1", r[100:110], wanted=wanted, evaluator="f32")
    np.testing.assert_allclose(single.model_errors, few.model_errors, rtol=1e-4)
    assert (single.model_errors.max(axis=1) >= single.model_error).all()  # they are rounded up
    alone = client.eval("better", "skin1", r[100:110], wanted="model_errors", evaluator="f64")
    of_R = client.eval("better", "skin1", r[100:110], wanted=["R", "model_errors"], evaluator="f64")
    assert alone.model_errors.tolist() == of_R.model_errors.tolist()
    assert (client.eval("transport", "skin1", [1.0], wanted="model_errors").model_errors == 0).all()
    at_0 = client.eval("better", SKIN, [0.0, 1.0], wanted=["R", "model_errors"]).model_errors[0]
    assert np.isnan(at_0[0]) and at_0[1] > 0
    slab = {"media": (*SKIN, 5.0), "r": [1.0]}  # against transport of the same slab
    of_slab = client.eval("multipole", **slab, wanted=["R", "model_errors"])
    solved = client.eval("transport", **slab)
    distance = np.abs(of_slab.R / solved.R - 1)
    assert (np.abs(of_slab.model_errors - distance) <= 2 * solved.numerical_error()).all()
