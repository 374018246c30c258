"""Every client that wants slow profiles gets its turns: neither a Modbus master with hundreds of
units nor a client that asks without end keeps the others waiting."""

import statistics
import time
from itertools import count

import pytest
from beside import Beside
from daemons import eventually
from dipole import Medium, Stack, wire
from frames import EVAL, PING, assert_error, assert_serves, eval_payload, frame, receive_reply
from modbus_master import BUSY, SLOW, TCP, Exception_, Tcp, input_block
from test_http import post
from test_metrics import fetch

UNITS = range(1, 248)
NUMBERS = count(1)


def new_medium() -> tuple[float, ...]:
    """Returns a medium that no request has had."""
    return (0.03 + 1e-4 * next(NUMBERS), 0.74, 0.0, 1.3)


def request(deadline_ms: int = 0, medium=None) -> bytes:
    payload = eval_payload([medium or new_medium()], [1.0], **SLOW)
    return frame(EVAL, 77, payload, deadline_ms)


def commit(master: Tcp, unit: int) -> None:
    block = input_block(1, new_medium(), [1.0], **SLOW)
    master.write(100, block, unit)


def prepared_meanwhile(daemon, wait, times: int = 7) -> float:
    """Returns how many profiles the daemon prepares while one wait lasts, the wait's own among them:
    the median of several."""
    with daemon.client() as watcher:
        counts = []
        for _ in range(times):
            before = watcher.statistics()["cache_entries"]
            wait()
            counts.append(watcher.statistics()["cache_entries"] - before)
    print(f"prepared during each wait: {counts}")
    return statistics.median(counts)


# What a client waits for at most: a profile that each worker has begun, one of the other client, and
# its own.
TURNS = 4


def client_waits(client) -> None:
    client.send_bytes(request())
    assert receive_reply(client).type == EVAL | wire.REPLY


def master_waits(master: Tcp) -> None:
    commit(master, 1)
    assert master.wait(1).status == 2


def test_a_client_gets_its_turns_beside_a_master_of_all_units(daemon):
    one = daemon(*TCP)
    with Tcp(one) as master, one.connect() as client:
        rounds = []

        def commit_all() -> None:
            for unit in UNITS:
                try:
                    commit(master, unit)
                except Exception_ as refused:
                    assert refused.code == BUSY
            rounds.append(unit)
            time.sleep(0.2)  # much less than the preparations for all units take

        with Beside(commit_all):
            assert eventually(lambda: rounds)
            assert 1 < prepared_meanwhile(one, lambda: client_waits(client)) <= TURNS


def test_a_master_gets_its_turns_beside_clients_that_ask_without_end(daemon):
    one = daemon(*TCP)
    with Tcp(one) as master, one.connect() as client:
        client.send_bytes(b"".join(request() for _ in range(200)))

        def ask_again() -> None:
            kind = receive_reply(client).type
            assert kind in (EVAL | wire.REPLY, PING | wire.REPLY)
            if kind == EVAL | wire.REPLY:
                client.send_bytes(request())

        with Beside(ask_again):
            assert 1 < prepared_meanwhile(one, lambda: master_waits(master)) <= TURNS


def test_short_solutions_are_ready_before_long_ones(daemon):
    """While two clients have stacks solved that take tens of seconds, a client and an HTTP request get
    the replies for stacks that take a fraction of one, before any of those."""
    one = daemon("--http", "127.0.0.1:0")
    layers = [Medium(0.02, 10.0 + i, 0.9, 1.4, 0.1) for i in range(8)]
    short_one = Stack(Medium(0.03, 0.74, 0.0, 1.3, 0.5), Medium(0.1, 0.9, 0.0, 1.3))
    options = {"wanted": "R", "tolerance": 1e-2}
    with one.client() as first, one.client() as second, one.client() as third:
        for client, long_one in (first, layers), (second, layers[1:]):
            client.submit("transport", Stack(*long_one), [1.0], parameters={"tolerance": 1e-5})
        assert eventually(lambda: third.statistics()["cache_builds"] == 2)
        assert third.eval("transport", short_one, [1.0], **options).R.shape == (1, 1)
        other = [dict(layer._asdict(), eta=1.4) for layer in short_one]
        assert post(one, "/v1/eval", model="transport", medium=[other], r=[1.0], **options).status == 200
        assert third.statistics()["cache_entries"] == 2


def test_a_master_may_have_so_many_waiting(daemon):
    """A master may have this many waiting profiles. One more is refused with exception 06. Other
    masters may have as many, so the daemon is ready."""
    one = daemon(*TCP, "--max-waiting-profiles", "3", "--metrics", "127.0.0.1:0")
    with Tcp(one) as master, Tcp(one) as other:
        for unit in range(1, 4):
            commit(master, unit)
        with pytest.raises(Exception_) as refused:
            for unit in range(4, 10):  # Some preparations have begun and no longer count.
                commit(master, unit)
        assert refused.value.code == BUSY
        assert fetch(one, "/readyz")[0] == 200
        commit(other, 100)
        assert other.wait(100).status == 2
        assert master.wait(1).status == 2


def test_deadlines_count_while_a_profile_waits(daemon):
    """A request whose deadline passes before its turn is refused; the next one has its turn."""
    one = daemon(*TCP)
    with Tcp(one) as master, one.connect() as client:
        for unit in UNITS:
            commit(master, unit)
        client.send_bytes(request(10))
        assert_error(client.receive_frame(), "deadline", "deadline_ms", "more")
        assert_serves(client)


def test_stopping_prepares_nothing_that_waits_for_masters(daemon):
    """A daemon that stops finishes a preparation that has begun, and begins no other: all of them
    take longer than close() waits."""
    one = daemon(*TCP)
    with Tcp(one) as master:
        for unit in UNITS:
            commit(master, unit)
        one.terminate()
        assert master.is_closed()
    assert one.wait() == 0
