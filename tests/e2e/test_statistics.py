"""Statistics of the service itself: latencies, radii by model, batch sizes, queues."""

import time

import dipole
import pytest
from daemons import eventually
from dipole import Connection
from frames import (
    BETTER, CLASSICAL, EVAL, F32, HELLO, MEDIA, PING, R, SKIN, ask, eval_payload, frame,
)
from lists import MODELS
from messages import receive_answer

KINDS = ["eval_short", "eval_long", "other", "refused"]

# Requests, and the class in which their latency is counted. An eval of 128 radii is short.
ASKED = {
    "short list": (EVAL, eval_payload([SKIN], [1.0] * 16), "eval_short"),
    "longest short": (EVAL, eval_payload([SKIN], [1.0] * 128), "eval_short"),
    "no radii": (EVAL, eval_payload([SKIN], [], wanted=2), "eval_short"),
    "shortest long": (EVAL, eval_payload([SKIN], [1.0] * 129), "eval_long"),
    "grid": (EVAL, eval_payload([SKIN], None, radius_count=100_000), "eval_long"),
    "ping": (PING, b"12345678", "other"),
    "media": (MEDIA, b"", "other"),
    "wrong eval": (EVAL, eval_payload(model=99), "refused"),
    "wrong type": (99, b"", "refused"),
    "wrong hello": (HELLO, bytes(3), "refused"),
}


def latency_counts(statistics: dict[str, int]) -> dict[str, int]:
    """Returns how many latencies are counted in each class."""
    return {kind: statistics[f"latency_{kind}_count"] for kind in KINDS}


@pytest.mark.parametrize("name", ASKED)
def test_every_request_has_one_latency(daemon, name):
    type, payload, kind = ASKED[name]
    with daemon().client() as client, client_connection(client) as connection:
        before = client.statistics()
        for _ in range(7):
            ask(connection, type, payload)
        after = look_when(client, lambda now: total(now) >= total(before) + 8)
        looks = after["requests_statistics"] - before["requests_statistics"]
    expected = latency_counts(before)
    expected[kind] += 7
    expected["other"] += looks  # all but the last one, which is still being answered
    assert latency_counts(after) == expected


def total(statistics: dict[str, int]) -> int:
    return sum(latency_counts(statistics).values())


def look_when(client, condition) -> dict[str, int]:
    """Returns the statistics as soon as a condition holds. A latency is counted only after the
    answer is written, so a receiver may ask another worker before that."""
    found = []

    def look() -> bool:
        found.append(client.statistics())
        return condition(found[-1])

    assert eventually(look), found[-1]
    return found[-1]


def client_connection(client) -> Connection:
    """Opens another connection to the same daemon."""
    return Connection(client.info.address)


def test_an_answer_lasts_until_its_last_part(daemon):
    """And a request begins with its last byte: another latency is that of none that is sent slowly."""
    payload = eval_payload([SKIN], None, radius_count=20_000_000, wanted=R, evaluator=F32)
    request = frame(EVAL, 1, eval_payload([SKIN], [1.0] * 16))
    with daemon().client() as client, client_connection(client) as connection:
        connection.send_bytes(frame(EVAL, 1, payload))
        connection.receive_frame()
        time.sleep(0.5)
        _, parts = receive_answer(connection)
        assert len(parts) > 10
        now = look_when(client, lambda now: now["latency_eval_long_count"] >= 1)
        assert now["latency_eval_long_max_us"] >= 500_000

        def slowly() -> int:
            before = client.statistics()
            connection.send_bytes(request[:-8])
            time.sleep(0.5)
            connection.send_bytes(request[-8:])
            connection.receive_frame()
            name = "latency_eval_short_sum_us"
            now = look_when(client, lambda now: now[name] > before[name])
            return now[name] - before[name]

        assert any(slowly() < 500_000 for _ in range(3))  # the machine may be busy


def test_the_duration_of_a_walk_is_no_latency(daemon):
    """Only that of a refusal at the start is one."""
    grid = dipole.Grid(0.1, 3.0, 8)
    with daemon().client() as client:
        before = client.statistics()
        client.mc(SKIN, grid, photons=100_000)
        with pytest.raises(dipole.Refused):
            client.mc((-1.0, 1.0, 0.0, 1.3), grid, photons=100_000)
        after = look_when(client, lambda now: total(now) >= total(before) + 2)
    expected = latency_counts(before)
    expected["refused"] += 1
    expected["other"] += after["requests_statistics"] - before["requests_statistics"]
    assert latency_counts(after) == expected


def test_radii_by_model(daemon):
    with daemon().client() as client, client_connection(client) as connection:
        ask(connection, EVAL, eval_payload([SKIN] * 3, [1.0] * 1000, model=BETTER))
        for _ in range(5):  # Repeated requests count, too.
            ask(connection, EVAL, eval_payload([SKIN], [1.0, 2.0], model=CLASSICAL))
        client.sample("better", "skin1", draw=dipole.Draw(100))
        client.invert("better", [0.5, 0.9], [1.0, 2.0])
        before = client.statistics()
        for _ in range(3):
            client.eval("beam", SKIN, [1.0])
        now = client.statistics()
    radii = {name: now[f"radii_{name}"] for name in MODELS}
    assert radii.pop("better") == 3300 and now["radii_drawn"] == 300 and now["media_inverted"] == 2
    assert radii.pop("beam") == 3 and [now[one] - before[one] for one in ("cache_misses", "cache_hits")] == [1, 5]  # and what it is compared with
    assert radii.pop("classical") == 10
    assert set(radii.values()) == {0}
    assert now["radii_evaluated"] == 3313


def test_queues(daemon):
    grid = eval_payload([SKIN], None, radius_count=1 << 36, wanted=R, evaluator=F32)
    with daemon("--workers", "1").client() as client:
        idle = client.statistics()
        assert idle["owed_radii"] == 0
        assert idle["queued_connections"] == 1  # the connection of this request
        with client_connection(client) as connection:
            connection.send_bytes(frame(EVAL, 1, grid))

            def owed() -> int:
                """A job rests, and counts nothing, while its client does not read."""
                connection.receive_bytes(1 << 20)
                return client.statistics()["owed_radii"]

            assert eventually(lambda: 1 << 35 < owed() <= 1 << 36)
        assert eventually(lambda: client.statistics()["owed_radii"] == 0)
