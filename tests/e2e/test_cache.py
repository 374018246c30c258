"""The cache keeps prepared profiles by content. A profile is prepared once for all clients, and memory
is bounded. test_batches.py shows that answers do not depend on it."""

import resource
import signal
import socket

import pytest
from daemons import LEAKS, eventually, sanitized
from dipole import wire
from frames import (
    EVAL, PING, ask, assert_closed, assert_daemon_serves, assert_error, eval_payload, frame, receive_reply,
)
from lists import EVALUATORS, MODELS, PARAMETERS

REPLY = EVAL | wire.REPLY
MEDIA = [(0.032, 0.74, 0, 1.3), (0.17, 0.88, 0, 1.3), (0.48, 1.01, 0.3, 1.4)]
KINDS = ["better", "single", "quantized", "beam+single", "gaussians", "transport"]
CLIENTS = 1000


def payload(model: str, media=MEDIA[:1], **fixed) -> bytes:
    """Makes an eval request for a model of the list."""
    return eval_payload(media, model=MODELS[model], **fixed)


def slow(media=MEDIA[:1]) -> bytes:
    """Makes a request whose profiles take a tenth of a second each to prepare."""
    return payload("beam", media, evaluator=EVALUATORS["lut"])


def media(count: int) -> list[tuple[float, ...]]:
    """This number of different media."""
    return [(0.01 + 0.001 * i, 1.0, 0.0, 1.3) for i in range(count)]


class Counted:
    """The change of the cache's statistics within a with block."""

    def __init__(self, daemon):
        self.daemon = daemon
        self.before = self._read()

    def _read(self) -> dict[str, int]:
        with self.daemon.client() as client:
            return client.statistics()

    def __getitem__(self, name: str) -> int:
        name = "cache_" + name
        return self._read()[name] - self.before[name]


# ---- what is kept --------------------------------------------------------------------------------


@pytest.mark.parametrize("model", KINDS)
def test_the_same_twice_is_one_build(daemon, model):
    one = daemon()
    counted = Counted(one)
    with one.connect() as connection:
        first = ask(connection, EVAL, payload(model))
        assert first.type == REPLY
        assert (counted["hits"], counted["misses"], counted["builds"]) == (0, 1, 1)
        for times in range(1, 4):
            assert ask(connection, EVAL, payload(model)) == first
            assert (counted["hits"], counted["misses"], counted["builds"]) == (times, 1, 1)
    kept = 0 if model == "better" else 1
    assert counted["entries"] == kept
    assert (counted["bytes"] > 0) == (kept > 0)


def test_memory_is_returned(daemon):
    """An evicted profile is freed even if a worker's local cache had it. The test evicts 4000
    profiles of 17 KiB."""
    # This setting keeps the address sanitizer from holding on to freed memory.
    one = daemon("--cache-bytes", "200000", env={"ASAN_OPTIONS": "quarantine_size_mb=1"})
    with one.connect() as connection:
        ask(connection, EVAL, payload("better+single", media(64), radii=[1.0]))
        before = one.resident_bytes()
        for i in range(60):
            some = [(0.2 + 0.001 * i, 1 + 0.01 * j, 0, 1.3) for j in range(64)]
            assert ask(connection, EVAL, payload("better+single", some, radii=[1.0])).type == REPLY
        assert one.resident_bytes() - before < 20e6


# ---- many at once --------------------------------------------------------------------------------


@pytest.fixture
def connections():
    """Returns a function that opens many connections to a daemon, with a raised limit of
    descriptors."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    opened = []

    def open_many(one, count: int):
        opened.extend(one.connect() for _ in range(count))
        return opened[-count:]

    yield open_many
    for connection in opened:
        connection.close()
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.skipif(sanitized(), reason="the build is sanitized")
def test_a_silent_connection_holds_a_kilobyte(daemon, connections):
    one = daemon("--max-connections", "2048", env=dict.fromkeys(LEAKS, ""))  # with its own heap
    connections(one, 100)
    with one.client() as client:

        def bytes_with(count: int) -> int:
            assert eventually(lambda: client.statistics()["connections_open"] == count)
            return one.resident_bytes()

        before = bytes_with(101)  # which holds what the first answers of this client take
        connections(one, CLIENTS)
        assert bytes_with(CLIENTS + 101) - before < CLIENTS * 1024


@pytest.mark.parametrize("workers", ["1", "4"])
def test_a_thousand_clients_cause_one_build(daemon, connections, workers):
    with daemon("--cache-bytes", "0").connect() as fresh:
        expected = ask(fresh, EVAL, slow())
    assert expected.type == REPLY
    one = daemon("--workers", workers)
    counted = Counted(one)
    clients = connections(one, CLIENTS)
    request = frame(EVAL, 77, slow())
    one.pause()  # so that it reads them all at once
    for client in clients:
        client.send_bytes(request)
    one.process.send_signal(signal.SIGCONT)
    for client in clients:
        assert client.receive_frame() == expected
    assert counted["builds"] == 1
    assert counted["hits"] + counted["misses"] == CLIENTS
    assert counted["misses"] > 1  # Some requests waited for the same profile.


def test_a_fault_goes_to_all_who_wait(daemon, connections):
    one = daemon()
    tolerance = PARAMETERS["tolerance"].id
    request = payload("gaussians", parameters=[(tolerance, 1e-11)])
    clients = connections(one, 50)
    for client in clients:
        client.send_bytes(frame(EVAL, 77, request))
    for client in clients:
        assert_error(client.receive_frame(), "bad-value", "tolerance", "")
    counted = Counted(one)
    assert_error(ask(clients[0], EVAL, request), "bad-value", "tolerance", "")
    assert counted["builds"] == 1  # The later request prepares again.
    assert counted["entries"] == 0
    assert_daemon_serves(one)


# ---- leaving and stopping ------------------------------------------------------------------------


def under_way(counted: Counted, builds: int = 1) -> bool:
    """Waits until this many preparations have begun."""
    return eventually(lambda: counted["builds"] == builds)


def test_who_leaves_takes_nothing_along(daemon):
    """A preparation goes on for the clients that stay and for those that come later."""
    one = daemon()
    counted = Counted(one)
    request = frame(EVAL, 77, slow())
    leaving, staying = one.connect(), one.connect()
    leaving.send_bytes(request)
    assert under_way(counted)
    staying.send_bytes(request)
    leaving.close()
    assert receive_reply(staying).type == REPLY
    staying.close()
    with one.connect() as later:
        assert ask(later, EVAL, slow()).type == REPLY
    assert counted["builds"] == 1
    with one.connect() as alone:
        alone.send_bytes(frame(EVAL, 77, slow(MEDIA[1:2])))
        assert under_way(counted, 2)
    assert eventually(lambda: counted["entries"] == 2)
    assert_daemon_serves(one)


def test_stopping_answers_who_waits(daemon):
    one = daemon()
    counted = Counted(one)
    request = frame(EVAL, 77, slow())
    with one.connect() as first, one.connect() as second:
        first.send_bytes(request)
        second.send_bytes(request)
        assert under_way(counted)
        one.terminate()
        for connection in (first, second):
            assert receive_reply(connection).type == REPLY
            assert_error(connection.receive_frame(), "shutting-down", "daemon", "another one", request_id=0)
            assert_closed(connection)
    assert one.wait() == 0


SOLVED = [(0.001, 1.0, -0.9, 1.4)]  # for seconds, as it is beyond the table


def test_a_solution_that_nobody_waits_for_stops(daemon):
    one = daemon()
    counted = Counted(one)
    with one.connect() as connection:
        connection.send_bytes(frame(EVAL, 77, payload("transport", SOLVED)))
        assert under_way(counted)
    one.terminate()
    assert one.wait() == 0
    assert not any("drain-timeout" in line for line in one.log)


def endless() -> bytes:
    """Makes a request for a stack that takes minutes."""
    return payload("transport", [(0.1, 10.0, 0.9, 1.4, 0.5)] * 6, medium_count=1, layer_count=6,
                   parameters=[(PARAMETERS["tolerance"].id, 1e-8)])  # fmt: skip


def test_a_solution_holds_up_no_table(daemon):
    """Until the table is there, nobody gives the stack up."""
    one = daemon()
    counted = Counted(one)
    with one.connect() as solves, one.connect() as looks:
        solves.send_bytes(frame(EVAL, 77, endless()))
        assert under_way(counted)
        assert ask(looks, EVAL, slow()).type == REPLY
        assert counted["builds"] == 2 and counted["entries"] == 1
    one.terminate()
    assert one.wait() == 0


def test_what_outlasts_the_drain_is_refused(daemon):
    """Clients then request it from another daemon. Requests behind it have the last error."""
    one = daemon("--drain-timeout-ms", "300")
    counted = Counted(one)
    with one.connect("tcp") as connection:
        connection.send_bytes(frame(EVAL, 77, endless()) + frame(EVAL, 78, payload("better")))
        assert under_way(counted)
        one.terminate()
        for request_id in (77, 0):
            assert_error(connection.receive_frame(), "shutting-down", "daemon", "another one", request_id=request_id)
        assert_closed(connection)
    assert one.wait() == 0
    assert any("event=drain-timeout connections=1" in line for line in one.log)


def test_a_client_that_ends_its_side_waits_for_no_solution(daemon):
    one = daemon()
    with one.connect("tcp") as connection:
        connection.send_bytes(frame(EVAL, 76, payload("better")) + frame(EVAL, 77, payload("transport", SOLVED)))
        connection.socket.shutdown(socket.SHUT_WR)
        assert receive_reply(connection).type == REPLY
        assert_error(connection.receive_frame(), "cancelled", "connection", "one whose client may still send",
                     request_id=77)  # fmt: skip
        assert_closed(connection)
    assert_daemon_serves(one)


def test_a_client_of_a_unix_socket_that_ends_its_side_gets_its_answer(daemon):
    """There the daemon sees whether the other side, too, has ended."""
    one = daemon()
    with one.connect() as connection:
        slab = [(0.05, 1.0, 0.0, 1.3, 8.0)]  # solved in half a second
        connection.send_bytes(frame(EVAL, 77, payload("transport", slab)))
        connection.socket.shutdown(socket.SHUT_WR)
        connection.timeout_s = 300
        while (reply := connection.receive_frame()).type == PING | wire.REPLY:  # at work
            pass
        assert reply.type == REPLY


def test_stopping_waits_for_what_has_begun_alone(daemon, connections):
    """Clients ask for twenty seconds of preparations, twice the time that the daemon has for
    stopping. Those that have not begun by then never begin."""
    one = daemon("--drain-timeout-ms", "100")
    counted = Counted(one)
    for client, medium in zip(connections(one, 400), media(400), strict=True):
        client.send_bytes(frame(EVAL, 77, slow([medium])))
    assert eventually(lambda: counted["builds"] >= 4)
    one.terminate()
    assert one.wait() == 0
