"""`dipole bench`: its figures add up, in every format. No test checks how fast it is."""

import json

import pytest
from command_line import FAILED, Proxy, dipole

SHORT = ("--seconds", "0.05")
FIGURES = [
    *("radii", "in_flight", "requests", "seconds", "p50_us", "p99_us", "max_us"),
    *("requests_per_s", "radii_per_s", "bytes_per_s"),
]


def bench_json(*arguments: str) -> dict:
    return json.loads(dipole("bench", "--format", "json", *SHORT, *arguments).stdout)


def check_figures(figures: dict, channels: int, value_bytes: int, connections: int = 1) -> None:
    requests, radii = figures["requests"], figures["radii"]
    assert requests >= 1 and figures["seconds"] >= 0.05
    assert figures["requests_per_s"] == pytest.approx(requests / figures["seconds"])
    assert figures["radii_per_s"] == pytest.approx(figures["requests_per_s"] * radii * channels)
    assert figures["bytes_per_s"] == pytest.approx(
        figures["requests_per_s"] * radii * (channels + 1) * value_bytes
    )
    quantiles = [figures[name] for name in ("p50_us", "p99_us", "max_us")]
    assert quantiles == sorted(quantiles) and quantiles[0] > 0
    # Requests that are outstanding at the same time share the time.
    under_way = connections * figures["in_flight"]
    assert quantiles[0] / 1e6 * requests <= 2.1 * under_way * figures["seconds"]


def test_json():
    report = bench_json()
    assert (report["model"], report["evaluator"], report["channels"]) == ("better", "f32", 3)
    assert report["daemon"].startswith("dipoled ") and report["workers"] == 2
    assert [one["measurement"] for one in report["rows"]] == ["small", "pipelined", "large"]
    for one in report["rows"]:
        assert list(one)[1:] == FIGURES
        check_figures(one, channels=3, value_bytes=4)
    loads = [[one[name] for name in FIGURES[:2]] for one in report["rows"]]
    assert loads == [[16, 1], [16, 64], [65536, 1]]


def test_the_load_is_the_one_that_was_asked_for(daemon):
    one = daemon()
    with one.client() as watcher:
        before = watcher.statistics()
        report = bench_json(
            *("--connect", one.url(), "--connections", "3", "--in-flight", "5"),
            *("--radii", "7", "--large-radii", "1000", "--model", "transport"),
            *("--evaluator", "lut", "--medium", "marble"),
        )
        after = watcher.statistics()
    measurements = report["rows"]
    loads = [[one[name] for name in FIGURES[:2]] for one in measurements]
    assert loads == [[7, 1], [7, 5], [1000, 1]]
    for figures in measurements:
        check_figures(figures, channels=3, value_bytes=4, connections=3)
    # Before it measures, it sends one request with all radii.
    requests = [figures["requests"] for figures in measurements]
    evals = after["requests_eval"] - before["requests_eval"]
    assert evals == sum(requests) + 1
    radii = after["radii_transport"] - before["radii_transport"]
    assert radii == 3 * (7 * (requests[0] + requests[1]) + 1000 * requests[2] + 1016)


def test_a_reply_with_another_bit_is_reported(daemon):
    replies = []

    def change(type: int, payload: bytes) -> list[bytes]:
        replies.append(type)
        return [payload[:-1] + bytes([payload[-1] ^ (len(replies) == 100)])]

    with Proxy(daemon().url(), lambda *_: None, change) as proxy:
        failed = dipole("bench", *SHORT, "--connect", proxy.url, status=FAILED)
    assert failed.stderr == "dipole bench: a reply has other values than the first one\n"
