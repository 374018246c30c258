"""Profiles that take long to prepare are made beside the service: nobody waits for them but who
asked, and leaving or stopping meanwhile harms nothing."""

from __future__ import annotations

import numpy as np
import pytest
from dipole import Refused

SKIN = [(0.032, 0.74, 0, 1.3), (0.17, 0.88, 0, 1.3), (0.48, 1.01, 0, 1.3)]
RADII = [0.5, 1.0]
FIT = {"gaussians": 12}


def test_cheap_requests_overtake(daemon):
    """Dozens of fits of one client take a second; a thousand answers of another come meanwhile."""
    one = daemon("--workers", "1")
    with one.client() as slow, one.client() as fast:
        fits = [slow.submit("gaussians", SKIN * 10, RADII, parameters=FIT) for _ in range(2)]
        alone = fast.eval("better", SKIN, RADII).R
        for _ in range(100):
            assert np.array_equal(fast.eval("better", SKIN, RADII).R, alone)
        results = [slow.collect() for _ in fits]
    assert sorted(request_id for request_id, _ in results) == sorted(fits)
    for _, result in results:
        assert np.array_equal(result.R, np.tile(results[0][1].R[:3], (10, 1)))


def test_a_client_that_leaves(daemon):
    one = daemon()
    for _ in range(5):
        with one.client() as leaving:
            leaving.submit("gaussians", SKIN * 5, RADII, parameters=FIT)
    with one.client() as client:
        assert client.eval("gaussians", SKIN[:1], RADII).R[0, 0] > 0


def test_stopping_answers_what_has_arrived(daemon):
    one = daemon()
    with one.client() as client:
        request_id = client.submit("gaussians", SKIN, RADII, parameters=FIT)
        client.ping()
        one.terminate()
        assert client.collect()[0] == request_id


def test_a_refusal_that_only_preparing_finds(client):
    with pytest.raises(Refused) as refused:
        client.eval("gaussians", SKIN[:1], RADII, parameters={"tolerance": 1e-11})
    assert refused.value.field == "tolerance"
    assert client.eval("gaussians", SKIN[:1], RADII, parameters={"tolerance": 0.01}).R[0, 0] > 0


def test_the_second_channel_is_refused(client):
    """The reply had been begun; the error replaces it, and the connection goes on."""
    with pytest.raises(Refused) as refused:
        client.eval("gaussians", [SKIN[0], (900.0, 1e-3, 0, 1.3)], [0.01], parameters={
            "fit_from": 0.001, "fit_to": 2.0})
    assert refused.value.field == "fit_from"
    assert refused.value.index == 1
    assert client.ping() > 0
