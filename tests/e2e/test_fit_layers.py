"""Fits of layers: a slow job beside small requests, which a deadline or a client that leaves ends."""

import numpy as np
import pytest
from daemons import eventually
from dipole import Client, Medium, Refused, Stack, wire
from frames import fit_layers_payload, frame
from test_http import post

LAYERS = [Medium(0.3, 1.0, 0.0, 1.4, 0.8), Medium(0.02, 1.0, 0.0, 1.4)]
STACK = Stack(*LAYERS)
AT_MM = np.geomspace(0.3, 8.0, 10)
UNKNOWNS = ["sigma_a_1"]


def readings(client: Client) -> tuple[np.ndarray, np.ndarray]:
    """Returns R of the stack with 1 % noise, and its standard errors."""
    R = client.eval("transport", STACK, AT_MM, evaluator="f64", tolerance=1e-2).R[0]
    return R * np.random.default_rng(5).normal(1, 0.01, len(R)), 0.01 * R


def test_layers_are_fitted_beside_small_requests(daemon):
    """The reply is kept: HTTP has the same, and no second fit is made."""
    one = daemon("--workers", "1", "--http", "127.0.0.1:0")
    with Client(one.url(), timeout_s=200) as client, one.client() as fast:
        values, errors = readings(client)
        fit = client.fit_layers(STACK, UNKNOWNS, AT_MM, values, errors)
        assert fit.status == "fitted" and list(fit.estimates) == UNKNOWNS
        found = fit.estimates["sigma_a_1"]
        assert abs(found.value - LAYERS[0].sigma_a) < 4 * found.error < 0.1
        assert fit.chi_squared == pytest.approx((fit.residuals**2).sum(), rel=1e-9)
        assert fit.factor == 1.0 and 0 < fit.numerical_error < 0.02
        builds = fast.statistics()["cache_builds"]
        layers = [layer._asdict() for layer in LAYERS]
        arrays = {"at": AT_MM.tolist(), "values": values.tolist(), "errors": errors.tolist()}
        reply = post(one, "/v1/fit_layers", medium=[layers], unknowns=UNKNOWNS, **arrays).json
        assert [each["value"] for each in reply["estimates"]] == [each.value for each in fit.estimates.values()]
        assert reply["status"] == "fitted" and reply["residuals"] == fit.residuals.tolist()
        assert fast.statistics()["cache_builds"] == builds


def test_a_deadline_or_the_end_of_the_client_ends_a_fit(daemon):
    one = daemon("--workers", "1")
    with one.client() as fast:
        with one.client() as slow:
            values, errors = readings(slow)
            with pytest.raises(Refused) as refused:
                slow.fit_layers(STACK, UNKNOWNS, AT_MM, values, errors, deadline_ms=50)
            assert refused.value.status == "deadline"
        payload = fit_layers_payload(LAYERS, AT_MM, values, errors, unknowns=9)
        with one.connect() as leaving:
            leaving.send_bytes(frame(wire.MESSAGES["fit_layers"], 1, payload))
        assert eventually(lambda: fast.statistics()["connections_open"] == 1)
        assert fast.table("better", (0.032, 0.74)).R([1.0]) > 0  # a turn of the same thread
