"""Sums of the light of points: values, bits, points that are sent, lost and sent again, faults, and
what a daemon bears."""

import asyncio
import dataclasses

import dipole
import numpy as np
import pytest
from daemons import eventually, sanitized
from dipole import Points, wire
from frames import (
    EVAL, SKIN, R, ask, assert_daemon_serves, assert_error, assert_serves, eval_payload, frame,
    gather_payload, points_payload, receive_reply, statistics, words,
)
from lists import MODELS
from modbus_master import SLOW

POINTS = wire.MESSAGES["points"]
GATHER = wire.MESSAGES["gather"]
CANCEL = wire.MESSAGES["cancel"]


def scene(count: int, channels: int = 1, seed: int = 1) -> Points:
    """Points in a box, half of them in a cluster, some without power."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform(-10, 10, (count, 3))
    xyz[: count // 2] = xyz[: count // 2] / 50 + [3, 4, 0]
    power = rng.uniform(0, 1, (count, channels))
    power[::7] = 0
    return Points(xyz, power)


def positions(count: int, seed: int = 2) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-12, 12, (count, 3))


def send(connection, points: Points) -> wire.Any:
    """Sends a whole set in one part; returns the reply."""
    reply = ask(connection, POINTS, points_payload(points))
    assert reply.type == POINTS | wire.REPLY, reply
    return wire.POINTS_REPLY.unpack(reply.payload)


# ---- values --------------------------------------------------------------------------------------


def test_no_queries_and_many(client):
    points = scene(50)
    assert client.gather("better", [SKIN], points, np.zeros((0, 3))).M.shape == (0, 1)
    queries = positions(40_000)
    reports = []
    found = client.gather(
        "better", [SKIN], points, queries, tolerance=0, progress=lambda *now: reports.append(now)
    )
    assert reports == [(16384, 40_000), (32768, 40_000), (40_000, 40_000)]
    assert np.all(found.M > 0)


@pytest.mark.parametrize(
    "model, tolerance", [("better", 0), ("better", 1e-5), ("transport", 1e-2), ("transport", 1e-4)]
)
def test_at_home(client, model, tolerance):
    """libdipole, and Python through it, sum with tables that they have loaded, without a daemon and
    with its bits. They state the same errors."""
    points, queries = scene(5000, 3), positions(6000).reshape(60, 100, 3)
    media = client.media()["skin1"]
    tables = [client.table(model, medium) for medium in media]
    asked = client.gather(model, media, points, queries, tolerance=tolerance)
    home = dipole.gather_at_home(tables, points, queries, tolerance=tolerance)
    assert home.M.shape == (60, 100, 3) and np.array_equal(home.M, asked.M)
    assert (home.nodes_visited > 0) == (tolerance > 0)
    np.testing.assert_equal(dataclasses.asdict(home), dataclasses.asdict(asked))


def test_at_home_faults_and_progress(client):
    points, queries = scene(3000, 1), positions(9000)
    table = client.table("better", SKIN)

    def home(tables, at, **options):
        return dipole.gather_at_home(tables, points, at, library=dipole.library.PATH, **options)

    expected = home([table], queries).M
    told = []
    part = home([table], queries, progress=lambda *numbers: told.append(numbers))
    assert np.array_equal(part.M, expected)
    assert told[-1] == (9000, 9000) and len(told) > 1
    part = home([table], queries, progress=lambda answered, count: False)
    assert np.isnan(part.M).sum() == 9000 - told[0][0]
    assert np.array_equal(part.M[~np.isnan(part.M)], expected[~np.isnan(part.M)])
    assert home([table], queries[:0]).M.shape == (0, 1)

    def fail(answered, count):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        home([table], queries, progress=fail)
    for tables, at, options, said in (
        ([table, table], queries, {}, "tables"),
        ([table], queries[:, :2], {}, "queries"),
        ([table], np.where(queries == queries[7], NAN, queries), {}, "queries"),
        ([table], queries, {"tolerance": 0.6}, "tolerance"),
        ([table], queries, {"tolerance": NAN}, "tolerance"),
    ):
        with pytest.raises(dipole.ArgumentError) as caught:
            home(tables, at, **options)
        assert said in str(caught.value)


# ---- points --------------------------------------------------------------------------------------


def test_points_are_sent_once(daemon):
    points = scene(1000)
    one = daemon()
    with one.client() as first, one.client("tcp") as second:
        values = [client.gather("better", [SKIN], points, positions(9)).M for client in (first, second)]
        assert np.array_equal(*values)
        assert first.statistics()["requests_points"] == 1
        same = Points(points.xyz.copy(), points.power.copy())
        assert same.name == points.name
        second.gather("better", [SKIN], same, positions(9))
        numbers = first.statistics()
        assert numbers["requests_points"] == numbers["points_sets"] == 1
        assert numbers["points_sent_sets"] == numbers["points_sent_bytes"] == 0


def test_parts_and_their_replies(shared):
    points = scene(1000, 3, seed=11)
    with shared.connect() as connection:
        question = points_payload(points, 0, 0)
        for first, count in ((0, 400), (400, 1), (401, 598)):
            assert ask(connection, GATHER, gather_payload(points, [SKIN] * 3)).type == wire.TYPE_ERROR
            for payload in (points_payload(points, first, count), question):
                reply = ask(connection, POINTS, payload)
                fixed = wire.POINTS_REPLY.unpack(reply.payload)
                assert fixed.set == words(points.name)
                assert (fixed.known, fixed.point_next) == (0, first + count)
        reply = ask(connection, POINTS, points_payload(points, 999, 1))
        assert wire.POINTS_REPLY.unpack(reply.payload)[1:] == (1, 0, 1000)
        assert ask(connection, GATHER, gather_payload(points, [SKIN] * 3)).type == GATHER | wire.REPLY
        reply = ask(connection, POINTS, points_payload(points, 0, 10))
        assert wire.POINTS_REPLY.unpack(reply.payload).known == 1
        with shared.connect() as other:
            assert wire.POINTS_REPLY.unpack(ask(other, POINTS, question).payload).known == 1
    assert_daemon_serves(shared)


def test_sent_through_several_connections_at_a_time(daemon):
    one = daemon()
    points, queries = scene(100_000, 2), positions(50)

    async def gather() -> list[np.ndarray]:
        clients = [dipole.AsyncClient(one.url()) for _ in range(4)]
        for client in clients:
            await client.open()
        try:
            found = await asyncio.gather(
                *(client.gather("better", [SKIN] * 2, points, queries) for client in clients)
            )
            return [each.M for each in found]
        finally:
            for client in clients:
                await client.close()

    values = asyncio.run(gather())
    assert all(np.array_equal(value, values[0]) for value in values)
    with one.client() as client:
        assert client.statistics()["points_sets"] == 1
        assert client.statistics()["points_sent_sets"] == 0


def test_a_daemon_dies_between_sending_and_asking(daemon):
    """The client goes on with the second daemon of its list, which has never seen the points."""
    points, queries = scene(3000, seed=3), positions(20)
    first, second = daemon(), daemon()
    with second.client() as client:
        expected = client.gather("better", [SKIN], points, queries).M
    other = scene(2000, seed=4)
    with dipole.Client(f"{first.url()},{second.url()}") as client:
        client.gather("better", [SKIN], other, queries)
        first.kill()
        assert np.array_equal(client.gather("better", [SKIN], points, queries).M, expected)
        assert client.gather("better", [SKIN], other, queries).M.shape == (20, 1)
        assert client.address == second.url()


def test_a_daemon_dies_while_it_sums(daemon):
    points, queries = scene(500), positions(100_000)
    first, second = daemon(), daemon()
    with second.client() as client:
        expected = client.gather("better", [SKIN], points, queries[-100:]).M
    killed = []

    def kill(answered: int, count: int) -> None:
        if not killed:
            killed.append(first.kill())

    with dipole.Client(f"{first.url()},{second.url()}") as client:
        found = client.gather("better", [SKIN], points, queries, progress=kill)
        assert client.address == second.url()
    assert killed and np.array_equal(found.M[-100:], expected) and np.all(found.M > 0)


def test_the_oldest_sets_are_evicted_and_sent_again(daemon):
    one = daemon("--points-bytes", "4000000")
    sets = [scene(20_000, seed=seed) for seed in range(8)]
    queries = positions(5)
    with one.client() as client:
        before = [client.gather("better", [SKIN], points, queries).M for points in sets]
        numbers = client.statistics()
        assert numbers["points_evictions"] > 0
        assert 0 < numbers["points_sets"] < 8
        assert numbers["points_bytes"] <= 4_000_000
        assert numbers["requests_points"] == 8
        after = [client.gather("better", [SKIN], points, queries).M for points in sets]
        assert client.statistics()["requests_points"] == 16
    assert np.array_equal(before, after)


def test_a_set_that_no_room_is_enough_for(daemon):
    one = daemon("--points-bytes", "100000", "--max-points", "10000")
    with one.client() as client:
        client._session.exchange.retry_s = 0.0
        with pytest.raises(dipole.Refused) as refused:
            client.gather("better", [SKIN], scene(10_000), positions(1))
        assert (refused.value.status, refused.value.field) == ("busy", "points_bytes")
        with pytest.raises(dipole.Refused) as refused:
            client.gather("better", [SKIN], scene(10_001), positions(1))
        assert (refused.value.status, refused.value.field) == ("too-large", "point_count")
        assert "10000 points" in refused.value.allowed
        assert client.info.limits["max_points"] == 10_000
        assert client.statistics()["points_sent_bytes"] == 0
        assert_daemon_serves(one)


# ---- ending early --------------------------------------------------------------------------------


def test_requests_behind_a_gather_are_answered_meanwhile(daemon):
    one = daemon("--workers", "1")
    points = scene(50_000, seed=11)
    slow = gather_payload(points, queries=positions(16_384), model=MODELS["extended"], tolerance=0.0)
    with one.connect() as connection:
        send(connection, points)
        connection.send_bytes(frame(GATHER, 1, slow))
        for request_id in range(2, 102):
            connection.send_bytes(frame(wire.MESSAGES["ping"], request_id, b""))
        connection.send_bytes(frame(CANCEL, 102, wire.CANCEL_REQUEST.pack(job_id=1)))
        replies = [connection.receive_frame() for _ in range(102)]
        assert {reply.request_id for reply in replies} == set(range(1, 103))
        ended = [reply for reply in replies if reply.request_id == 1]
        assert_error(ended[0], "cancelled", "job_id", "no cancel", request_id=1)


def test_a_client_that_cancels_ends_the_daemons_work(daemon):
    one = daemon("--workers", "1")
    points = scene(500 if sanitized() else 5_000, seed=11)  # a part takes a second or so, all seven

    def stop(answered: int, count: int) -> bool:
        return False

    with one.client() as client, one.client() as watcher:
        found = client.gather(
            "extended", [SKIN], points, positions(100_000), tolerance=0, progress=stop
        )
        assert 0 < np.count_nonzero(~np.isnan(found.M)) < 100_000
        assert eventually(lambda: watcher.statistics()["owed_radii"] == 0)
        done = watcher.statistics()["queries_gathered"]
        client.ping()
        assert watcher.statistics()["queries_gathered"] == done < 3 * 16_384


def test_a_late_gather_whose_answer_waits_for_an_eval(daemon):
    """The eval before it in the output has its part open until its profile is prepared. The worker
    serves others meanwhile."""
    one = daemon("--workers", "1")
    points = scene(20_000)
    late = gather_payload(points, queries=positions(40_000), tolerance=0.0)
    with one.connect() as connection, one.connect() as other:
        other.timeout_s = 30.0
        connection.timeout_s = 30.0
        send(connection, points)
        for i in range(5):
            slow = eval_payload([(0.0333 + i / 1e4, 0.74, 0.0, 1.3)], [1.0], **SLOW)
            connection.send_bytes(frame(GATHER, 9, late, 1) + frame(EVAL, 5, slow))
            assert_serves(other)
            replies = [connection.receive_frame() for _ in range(2)]
            by_id = {reply.request_id: reply for reply in replies}
            assert_error(by_id[9], "deadline", "deadline_ms", "more", request_id=9)
            assert by_id[5].type == EVAL | wire.REPLY


def test_gathers_of_a_connection_wait_without_memory_of_their_own(daemon):
    """A gather that is under way takes 11.3 MB. All are answered where there is room for one."""
    one = daemon("--workers", "1", "--max-total-bytes", str(16 << 20))
    points = scene(2000)
    with one.connect() as connection:
        send(connection, points)
        payload = gather_payload(points, queries=positions(1000), tolerance=0.0)
        for request_id in range(40):
            connection.send_bytes(frame(GATHER, request_id, payload))
        late = [frame(GATHER, 100 + i, payload, 1) for i in range(3)]
        connection.send_bytes(b"".join(late))
        replies = {reply.request_id: reply for reply in (connection.receive_frame() for _ in range(43))}
        assert {replies[i].type for i in range(40)} == {GATHER | wire.REPLY}
        for i in range(100, 103):
            assert_error(replies[i], "deadline", "deadline_ms", "more", request_id=i)


def test_gathers_whose_readers_have_stopped_refuse_nobody(daemon):
    """Sixteen that go on would delay the eval by max_backlog_ms, as far as they count."""
    one = daemon(
        "--workers", "1", "--max-backlog-ms", "20", "--max-queued-bytes", "4096",
        "--max-part-bytes", "16384",
    )  # fmt: skip
    points = scene(100)
    payload = gather_payload(points, queries=positions(60_000), tolerance=0.0)
    stopped = [one.connect() for _ in range(16)]
    try:
        for connection in stopped:
            send(connection, points)
        for connection in stopped:
            connection.send_bytes(frame(GATHER, 1, payload))
        with one.connect() as watcher:
            assert eventually(lambda: statistics(watcher)["queries_gathered"] > 16 * 20_000)
            large = eval_payload(radii=np.linspace(0.1, 9.0, 1_000_000), wanted=R)
            assert eventually(lambda: ask(watcher, EVAL, large).type == EVAL | wire.REPLY)
            assert statistics(watcher)["queries_gathered"] < 16 * 55_000
        for connection in stopped:
            while True:
                fixed = wire.GATHER_REPLY.unpack(receive_reply(connection).payload)
                if fixed.part + 1 == fixed.part_count:
                    break
    finally:
        for connection in stopped:
            connection.close()


def test_a_gather_is_answered_between_evals_that_wait(daemon):
    one = daemon("--workers", "1")
    points = scene(100)
    with one.connect() as connection:
        send(connection, points)
        assert ask(connection, GATHER, gather_payload(points)).type == GATHER | wire.REPLY
        slow = [eval_payload([(0.0343 + i / 1e4, 0.74, 0.0, 1.3)], [1.0], **SLOW) for i in range(4)]
        connection.send_bytes(
            frame(GATHER, 9, gather_payload(points))
            + b"".join(frame(EVAL, i, payload) for i, payload in enumerate(slow))
        )
        order = [connection.receive_frame().request_id for _ in range(5)]
        assert sorted(order) == [0, 1, 2, 3, 9] and order[-1] != 9


# ---- faults --------------------------------------------------------------------------------------

NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    "index, xyz, power, field",
    [
        (0, (NAN, 0, 0), 1, "points"),
        (3, (0, INF, 0), 1, "points"),
        (9, (0, 0, 1e30), 1, "points"),
        (2, (0, -1.0000001e9, 0), 1, "points"),
        (4, (0, 0, 0), -1e-30, "power"),
        (5, (0, 0, 0), NAN, "power"),
        (9, (0, 0, 0), INF, "power"),
        (9, (0, 0, 0), 2e30, "power"),
    ],
)
def test_wrong_points(shared, index, xyz, power, field):
    """The index counts all points of the set, wherever its parts are cut."""
    points = scene(10)
    points.xyz[index], points.power[index] = xyz, power
    for cut in (0, 5):
        with shared.connect() as connection:
            if 0 < cut <= index:
                assert ask(connection, POINTS, points_payload(points, 0, cut)).type != wire.TYPE_ERROR
            first = cut if cut <= index else 0
            reply = ask(connection, POINTS, points_payload(points, first))
            assert_error(reply, "bad-value", field, "to", index=index)
            reply = ask(connection, POINTS, points_payload(points, 5, 1))
            assert_error(reply, "unknown-points", "point_first", "0")
            assert_serves(connection)


def test_parts_that_do_not_follow(shared):
    points = scene(100, seed=21)
    points.xyz[0], points.power[0] = (-1e9, 0, 1e9), 1e30  # the limits
    with shared.connect() as connection:
        assert_error(
            ask(connection, POINTS, points_payload(points, 50)), "unknown-points", "point_first", "0"
        )
        ask(connection, POINTS, points_payload(points, 0, 40))
        reply = ask(connection, POINTS, points_payload(points, 50))
        assert_error(reply, "bad-value", "point_first", "behind")
        reply = ask(connection, POINTS, points_payload(points, 40))
        assert_error(reply, "unknown-points", "point_first", "0")
        ask(connection, POINTS, points_payload(points, 0, 40))
        ask(connection, POINTS, points_payload(points, 0, 60))  # It begins anew.
        reply = ask(connection, POINTS, points_payload(points, 60))
        assert wire.POINTS_REPLY.unpack(reply.payload).known == 1


# ---- memory --------------------------------------------------------------------------------------


def test_a_hundred_clients_that_send_and_never_ask(daemon):
    """Unfinished sets share a budget, and finished ones another. What was sent and not finished is
    freed after a time."""
    budget = 4_000_000
    one = daemon("--points-bytes", str(budget), "--frame-timeout-ms", "6000")
    # Each client sends the half of another set, about 0.28 MB.
    payload_of = lambda seed: points_payload(scene(19_000, seed=seed), 0, 9_500)  # noqa: E731
    first = payload_of(0)
    connections = [one.connect() for _ in range(100)]
    before = one.resident_bytes()
    try:
        with one.connect() as watcher:
            refused = 0
            for seed, connection in enumerate(connections):
                other = wire.POINTS_REQUEST.unpack(first)._asdict() | {"set": (seed, 1)}
                connection.send_bytes(
                    frame(POINTS, 1, wire.POINTS_REQUEST.pack(**other) + first[48:])
                )
                reply = connection.receive_frame()
                refused += reply.type == wire.TYPE_ERROR
                if reply.type == wire.TYPE_ERROR:
                    assert_error(reply, "busy", "points_bytes", "fewer", request_id=1)
                assert statistics(watcher)["points_sent_bytes"] <= budget
            assert refused > 50
            assert statistics(watcher)["points_sent_sets"] >= 8
            if not sanitized():
                # The allocator may keep what 100 frames of 0.28 MB took, beside the budget.
                assert one.resident_bytes() - before < 10 * budget
            assert eventually(lambda: statistics(watcher)["points_sent_bytes"] == 0)
            assert statistics(watcher)["points_sent_sets"] == 0
            with one.client() as client:  # There is room again.
                assert client.gather("better", [SKIN], scene(20_000), positions(1)).M > 0
    finally:
        for connection in connections:
            connection.close()


@pytest.mark.skipif(sanitized(), reason="a sanitizer's memory is another")
def test_small_sets_take_what_they_count(daemon):
    one = daemon(env={"LD_PRELOAD": ""})
    with one.connect() as connection:
        held = []
        for seed in range(6000):
            send(connection, Points([[seed, 0, 0]], [1]))
            if seed in (1000, 5999):
                held.append((one.resident_bytes(), statistics(connection)["points_bytes"]))
    assert held[1][0] - held[0][0] < 1.5 * (held[1][1] - held[0][1])
