"""Parameters on the command line. tests/cli/eval.t has notes and `--model all`."""


import pytest
from command_line import USAGE, Proxy, dipole, eval_rows
from dipole import wire
from frames import changed_choices
from lists import MODELS, medium_for, some_value, takes, thickness

MEDIUM = ["--sigma-a", "0.032", "--sigma-s", "0.74"]  # SKIN


def options(parameters: dict[str, float]) -> list[str]:
    """Returns parameters as options of the command line."""
    words = [[f"--{name.replace('_', '-')}", repr(value)] for name, value in parameters.items()]
    return [word for pair in words for word in pair]


def some_parameters(model: str) -> dict[str, float]:
    """Returns parameters that a model takes, with values that fit together. The range of a fit is
    not among them, nor a tolerance that a fit with so many Gaussians does not meet."""
    apart = ("fit_", "tolerance") if "gaussians" in takes(model) else ()
    given = {name: some_value(name) for name in takes(model) if not name.startswith(apart)}
    given.pop("eta_below", None)  # of slabs alone
    given.pop("derivative_layer", None)  # of several layers
    if thickness(model):
        given.pop("mhz", None)  # of phase and modulation alone, for which a slab is solved nine times
    return given | {"cos_in": 0.75}


# ---- eval ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_parameters_reach_the_model(client, model):
    given = some_parameters(model)
    rows = eval_rows(
        *[*MEDIUM, "--model", model, "--r", "0.5,2", "--wanted", "R,S,2_pi_r_R,albedo"],
        *[*options(given), "--evaluator", "f64", "--thickness", str(thickness(model))],
        *["--connect", client.info.address],  # which solves once for both
    )
    answer = client.eval(
        model,
        medium_for(model),
        [0.5, 2.0],
        wanted=["R", "S", "2_pi_r_R", "albedo"],
        parameters=given,
    )
    for i, row in enumerate(rows):
        assert float(row["R"]) == answer.R[0, i]
        assert float(row["S"]) == answer.S[0, i]
        assert float(row["2_pi_r_R"]) == answer.two_pi_r_R[0, i]
        assert float(row["albedo"]) == answer.albedo[0]


def without_parameters(type: int, payload: bytes) -> list[bytes]:
    """Changes the reply to hello so that the daemon has no parameters: it turns them into
    statuses."""

    def change(choice):
        is_parameter = wire.KINDS[choice.kind] == "parameter"
        return choice._replace(kind=6, id=choice.id + 1000) if is_parameter else choice

    return changed_choices(type, payload, change)


def test_a_daemon_without_the_parameter(daemon):
    with Proxy(daemon().url(), lambda number, request_id: None, without_parameters) as proxy:
        run = dipole("eval", *MEDIUM, "--cos-in", "1", "--connect", proxy.url, status=USAGE)
    assert "--cos-in: this daemon does not know it" in run.stderr
