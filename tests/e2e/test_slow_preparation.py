"""Slow profiles are prepared on other threads: only the clients that asked for them wait.
test_cache.py tests leaving and stopping meanwhile."""

import numpy as np
import pytest
from dipole import Refused, wire
from dipole.connection import Frame
from dipole.exchange import Exchange, Once, Request
from frames import EVAL, PING, READINGS, R, eval_payload, fit_payload, frame

SKIN = [(0.032, 0.74, 0, 1.3), (0.17, 0.88, 0, 1.3), (0.48, 1.01, 0, 1.3)]
RADII = [0.5, 1.0]
FIT = {"gaussians": 12}


def test_cheap_requests_overtake(daemon):
    """Dozens of fits for one client take a second. Another client gets a thousand answers
    meanwhile."""
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


def test_the_second_channel_is_refused(client):
    """The second channel is refused after the reply has begun. The error replaces the reply, and
    the connection goes on."""
    with pytest.raises(Refused) as refused:
        client.eval("gaussians", [SKIN[0], (900.0, 1e-3, 0, 1.3)], [0.01], parameters={
            "fit_from": 0.001, "fit_to": 2.0})
    assert refused.value.field == "fit_from"
    assert refused.value.index == 1
    assert client.ping() > 0


def test_long_work_is_no_silence(daemon):
    """The daemon says every five seconds that it is at work, which no client takes for its reply."""
    layers = [(0.02, 10.0 + i, 0.9, 1.4, 0.1) for i in range(320)]
    one = daemon("--workers", "1")
    with one.connect() as connection, one.connect() as fitting, one.client() as client:
        info = client.info
        fields = {"model": info.choices["model"]["transport"].id, "medium_count": 40, "layer_count": 8, "wanted": R}
        tolerance = (info.choices["parameter"]["tolerance"].id, 1e-3)
        connection.send_bytes(frame(EVAL, 7, eval_payload(layers, parameters=[tolerance], **fields)))
        slab = {"model": info.choices["model"]["better-multipole"].id, "thickness": 3.0}
        sets = fit_payload([READINGS] * 1000, **slab)
        fitting.send_bytes(frame(wire.MESSAGES["fit"], 8, sets))
        assert client.ping() > 0
        one.stand(5.2)
        assert connection.receive_frame() == Frame(PING | wire.REPLY, 7, b"")
        assert fitting.receive_frame() == Frame(PING | wire.REPLY, 8, b"")
    exchange = Exchange(0)
    request_id = exchange.begin(Request("eval", b"", lambda: Once(lambda reply: reply)))
    exchange.take(Frame(PING | wire.REPLY, request_id, b""))
    assert not exchange.is_ready(request_id)
    exchange.take(Frame(wire.MESSAGES["eval"] | wire.REPLY, request_id, b"reply"))
    assert exchange.next(request_id) == b"reply"
