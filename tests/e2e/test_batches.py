"""Short requests that arrive together are evaluated together. Their answers are the same as those
of single requests, and in steady state they allocate no memory."""

import random
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from daemons import Daemon, eventually
from dipole import Connection, wire
from frames import (
    ALBEDO, CDF, EVAL, F32, F64, LINEAR, LOGARITHMIC, RADIUS, SKIN, SPECTRALON, R, ask,
    assert_serves, eval_payload, frame, receive_reply, statistics,
)
from lists import BALANCE, MODELS, PARAMETERS, QUANTITIES, everywhere

EVALUATED = EVAL | wire.REPLY
LUT = 3
SEED = 7041


def similar_payload(rng: random.Random) -> bytes:
    """Makes a request for one of a few profiles, so that many requests share a profile. Quantities,
    precision, parameters and length are random."""
    media = rng.choice([[SKIN], [SPECTRALON], [SKIN, SPECTRALON], [(0.5, 1.0, 0.0, 1.4)] * 3])
    count = rng.choice([0, 1, 2, 3, 7, 8, 15, 16, 16, 16, 17, 100, 127, 128, 129, 200])
    angles = [(PARAMETERS[name].id, rng.choice([0.25, 1.0])) for name in ("cos_in", "cos_out")]
    model = rng.choice(["better", "better", "classical", "single", "beam", "burley", "better+single"])
    fields = {
        "model": MODELS[model],
        "evaluator": rng.choice([F64, F32, LUT]),
        "wanted": rng.choice([R, R, R | CDF | ALBEDO, R | RADIUS, rng.randint(1, 511), CDF]),
        "parameters": angles if rng.random() < 0.3 else [],
    }
    if fields["evaluator"] == LUT and model in ("better", "classical"):
        fields["parameters"] = [(PARAMETERS["tolerance"].id, rng.choice([1e-3, 1e-4]))]
    elif fields["evaluator"] == LUT:  # Other tables take long: random_lut() asks for some.
        fields["evaluator"] = F32
    if rng.random() < 0.6 or count == 0:
        radii = np.random.default_rng(rng.getrandbits(32)).uniform(0.0, 5.0, count)
        return eval_payload(media, radii, **fields)
    return eval_payload(
        media,
        None,
        spacing=rng.choice([LINEAR, LOGARITHMIC]),
        radius_count=count,
        radius_start=rng.choice([0.01, 0.1]),
        radius_stop=rng.choice([1.0, 6.0]),
        **fields,
    )


def random_lut(rng: random.Random) -> bytes:
    """Makes a request for a table of a random model that covers all radii."""
    model = rng.choice([name for name in everywhere() if "transport" not in name])
    radii = np.random.default_rng(rng.getrandbits(32)).uniform(0.0, 5.0, rng.randint(0, 200))
    fields = {"model": MODELS[model], "evaluator": LUT, "wanted": R | CDF | ALBEDO}
    return eval_payload([SKIN], radii, **fields)


def repeated_payloads(rng: random.Random) -> list[bytes]:
    """Makes requests that differ from others in their radii alone. Transport is known for one of two
    media, so that the other has no model error."""
    error = QUANTITIES["model_error"]
    fields = [
        {"media": [SKIN, (0.1, 10.0, 0.0, 3.0)], "wanted": R | ALBEDO | RADIUS | error},
        {"media": [SKIN], "wanted": R | CDF | error, "evaluator": F32},
        {"media": [SKIN, SPECTRALON], "wanted": R | BALANCE, "model": MODELS["transport"]},
    ]
    radii = 3 * [[rng.uniform(0.0, 5.0) for _ in range(3)] for _ in range(4)]
    return [eval_payload(radii=some, **one) for one in fields for some in radii]


def mixed_payloads(seed: int) -> list[bytes]:
    rng = random.Random(seed)
    payloads = [similar_payload(rng) for _ in range(600)]
    payloads += repeated_payloads(rng)
    payloads += [random_lut(rng) for _ in range(8)]
    rng.shuffle(payloads)
    return payloads


def pipelined(daemon, payloads: list[bytes], connections: int) -> list[tuple[int, bytes]]:
    """Returns the answers to all requests, which are spread over some connections, and sent without
    waiting."""
    answers: dict[int, tuple[int, bytes]] = {}

    def ask_share(first: int) -> None:
        numbers = range(first, len(payloads), connections)
        with daemon.connect(("unix", "tcp")[first % 2]) as connection:
            connection.send_bytes(b"".join(frame(EVAL, i, payloads[i]) for i in numbers))
            for _ in numbers:
                reply = connection.receive_frame()
                answers[reply.request_id] = (reply.type, reply.payload)

    with ThreadPoolExecutor(connections) as pool:
        list(pool.map(ask_share, range(connections)))
    return [answers[i] for i in range(len(payloads))]


# ---- the same bits -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def alone():
    """Returns the answers that each request of the mix gets from a daemon that has nothing else to
    do, and that remembers nothing."""
    one = Daemon("--workers", "1", "--cache-bytes", "0")
    payloads = mixed_payloads(SEED)
    with one.connect() as connection:
        replies = [ask(connection, EVAL, payload) for payload in payloads]
    one.close()
    return payloads, [(reply.type, reply.payload) for reply in replies]


@pytest.mark.parametrize(
    "options, connections", [(["--workers", "1"], 6), (["--max-in-flight", "3", "--cache-bytes", "20000"], 1), ([], 6)]
)
def test_together_as_alone(daemon, alone, options, connections):
    payloads, expected = alone
    one = daemon(*options)
    for times in range(2):  # In the second round, the daemon knows all requests.
        answers = pipelined(one, payloads, connections)
        for i, (answer, right) in enumerate(zip(answers, expected, strict=True)):
            assert answer == right, (times, i, wire.EVAL_REQUEST.unpack(payloads[i]))
    assert sum(type == EVALUATED for type, _ in expected) > 400
    with one.connect() as watcher:
        now = statistics(watcher)
    assert 0 < now["batches_evaluated"] < now["batched_requests"]


def test_a_fault_among_many(daemon):
    """A refused request does not change the answers to requests of the same batch."""
    one = daemon("--workers", "1")
    good = [eval_payload([SKIN], [0.1 * i, 1.0], wanted=R) for i in range(1, 200)]
    bad = [eval_payload([SKIN], [-1.0, 1.0], wanted=R), eval_payload([(-1, 1, 0, 1.3)], wanted=R)]
    with one.connect() as connection:
        expected = [ask(connection, EVAL, payload).payload for payload in good]
    payloads = [payload for i in range(len(good)) for payload in (good[i], bad[i % 2])]
    answers = pipelined(one, payloads, 3)
    assert [payload for _, payload in answers[::2]] == expected
    assert {type for type, _ in answers[1::2]} == {wire.TYPE_ERROR}


# ---- how many go together ------------------------------------------------------------------------

SIXTEEN = eval_payload([SKIN], np.linspace(0.1, 3, 16), wanted=R)


def batch_counts(connection: Connection) -> tuple[int, int]:
    now = statistics(connection)
    return now["batches_evaluated"], now["batched_requests"]


def send_and_receive(connection: Connection, payload: bytes, times: int) -> None:
    connection.send_bytes(frame(EVAL, 1, payload) * times)
    for _ in range(times):
        assert receive_reply(connection).type == EVALUATED


def test_a_pipeline_is_evaluated_in_few_passes(daemon):
    one = daemon("--workers", "1")
    with one.connect() as connection, one.connect() as watcher:
        before = batch_counts(watcher)
        send_and_receive(connection, SIXTEEN, 5000)
        after = batch_counts(watcher)
    assert after[1] - before[1] == 5000
    assert after[0] - before[0] < 1000


@pytest.mark.parametrize("most", [1, 2, 10])
def test_max_in_flight(daemon, most):
    """At most this many requests of a connection are answered at a time, so no more are evaluated
    together."""
    one = daemon("--workers", "1", "--max-in-flight", str(most))
    with one.connect() as connection, one.connect() as watcher:
        before = batch_counts(watcher)
        send_and_receive(connection, SIXTEEN, 1000)
        after = batch_counts(watcher)
        assert after[1] - before[1] == 1000
        assert after[0] - before[0] >= 1000 / most
        assert_serves(connection)


def test_long_requests_are_not_gathered(daemon):
    one = daemon("--workers", "1")
    with one.connect() as connection, one.connect() as watcher:
        before = batch_counts(watcher)
        send_and_receive(connection, eval_payload([SKIN], [1.0] * 129, wanted=R), 100)
        assert batch_counts(watcher) == before
        send_and_receive(connection, eval_payload([SKIN], [1.0] * 128, wanted=R), 100)
        assert batch_counts(watcher)[1] == before[1] + 100


# ---- nothing from the heap -----------------------------------------------------------------------

STEADY = {
    "better": {"model": MODELS["better"]},
    "better of three media": {"model": MODELS["better"], "media": [SKIN] * 3},
    "better, all that there is": {
        "model": MODELS["better"],
        "radii": [0.1, 3.0],
        "wanted": sum(QUANTITIES.values()) - BALANCE,
        "parameters": [(PARAMETERS["mhz"].id, 100.0)],
    },
    "by rule": {"model": MODELS["better"], "evaluator": F32, "radii": None, "radius_count": 16},
    "transport by table": {"model": MODELS["transport"], "evaluator": LUT, "radii": [0.5] * 16},
    "single": {"model": MODELS["single"], "media": [(0.1, 1.0, 0.7, 1.3)]},
    "evaluated alone": {"model": MODELS["better"], "evaluator": F32, "radii": [0.5] * 129},
    "a tolerance": {
        "model": 0,
        "parameters": [(PARAMETERS["tolerance"].id, 0.02)],
        "radii": [0.5] * 16,
    },
}


@pytest.mark.parametrize("name", STEADY)
def test_steady_requests_allocate_nothing(daemon, name):
    """Sends thousands of requests over each transport, a hundred at a time, whose answers wait in one
    buffer, and then one by one; hundreds of those that take milliseconds. A connection gives its
    buffers back after a second of silence, which happens on a busy machine: the test is then
    repeated."""
    fields = {"media": [SKIN], "radii": np.linspace(0.1, 3, 16), "wanted": R, **STEADY[name]}
    hundreds = 5 if "all that there is" in name else 50
    payload = eval_payload(**fields)
    one = daemon("--workers", "1", counting=True)

    def allocations(connection: Connection) -> int:
        send_and_receive(connection, payload, 100)
        before = one.allocations()
        for _ in range(hundreds):
            send_and_receive(connection, payload, 100)
        for _ in range(10 * hundreds):
            send_and_receive(connection, payload, 1)
        return one.allocations() - before

    for scheme in ("unix", "tcp"):
        with one.connect(scheme) as connection:
            assert any(allocations(connection) == 0 for _ in range(5))
