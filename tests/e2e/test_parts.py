"""Answers larger than a frame come in parts. They have the same bits as in one piece, use no more
memory than small answers, and delay nobody else."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from daemons import Daemon, eventually
from dipole import Connection, wire
from frames import (
    ALBEDO, CDF, EVAL, F32, F64, LINEAR, LOGARITHMIC, RADIUS, SKIN, SPECTRALON, R, ask,
    assert_closed, assert_daemon_serves, assert_error, assert_serves, eval_payload, frame,
    head_bytes, statistics,
)
from lists import (
    DERIVATIVES, DIPOLES, MODELS, PARAMETERS, QUANTITIES, has_derivatives, needs,
)
from parted import EVALUATED, Part, assert_same, put_together, receive_parts, take_apart

LUT = 3
THREE = [SKIN, SPECTRALON, (0.17, 0.88, 0.0, 1.4)]
EVERYTHING = sum(QUANTITIES.values())
# An answer of 16 GB, more than any test reads. Its work is less than max_backlog_ms.
ENDLESS = {"radii": None, "radius_count": 2**31, "wanted": R}


def answer(connection: Connection, payload: bytes) -> list[Part]:
    connection.send_bytes(frame(EVAL, 77, payload))
    return receive_parts(connection)


@pytest.fixture(scope="module")
def tiny():
    """Returns a daemon whose parts have a few hundred values, for one channel and one or two
    quantities."""
    one = Daemon("--max-frame-bytes", "4096", "--max-part-bytes", "4096")
    yield one
    one.close()


@pytest.fixture(scope="module")
def small():
    """Returns a daemon whose frames hold more than its parts."""
    one = Daemon("--max-frame-bytes", "131072", "--max-part-bytes", "81920")
    yield one
    one.close()


# ---- the same bits -------------------------------------------------------------------------------

GRIDS = {
    "linear": {"spacing": LINEAR, "radius_start": 0.0, "radius_stop": 7.0},
    "logarithmic": {"spacing": LOGARITHMIC, "radius_start": 1e-3, "radius_stop": 50.0},
}


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("evaluator", [F64, F32, LUT])
@pytest.mark.parametrize("wanted", [R, CDF | ALBEDO, RADIUS, R | RADIUS])
@pytest.mark.parametrize("count", [504, 513, 1537, 10_000])
def test_grids(shared, tiny, grid, evaluator, wanted, count):
    if wanted == R | RADIUS and evaluator == F64:
        wanted = RADIUS  # A part has no room for 256 radii of two such arrays.
    fields = {**GRIDS[grid], "evaluator": evaluator, "wanted": wanted, "radius_count": count}
    payload = eval_payload(radii=None, **fields)
    with tiny.connect() as in_parts, shared.connect() as at_once:
        parts = answer(in_parts, payload)
        [whole] = answer(at_once, payload)
        assert_serves(in_parts)
    if count > 2000:
        assert len(parts) > 1
    assert_same(put_together(parts), whole)


def media_and_quantities():
    """Yields media and quantities for one model of each kind and for all cheap models."""
    for name in [*DIPOLES, "single", "beam", "burley", "quantized", "better+single", "multipole"]:
        yield name, THREE, EVERYTHING & ~(0 if has_derivatives(name) else DERIVATIVES)
    yield "better", THREE[:1], R | CDF
    yield "better", THREE[:2], EVERYTHING - R


@pytest.mark.parametrize("name, media, wanted", media_and_quantities())
@pytest.mark.parametrize("evaluator", [F64, F32])
def test_lists(shared, small, name, media, wanted, evaluator):
    """The values of a part are those of a request for its radii alone. Its errors hold for the
    radii of the whole request."""
    count = 10_000 if name in DIPOLES else 1_500  # a part has some hundreds
    radii = np.random.default_rng(5).uniform(0.01, 6.0, count if evaluator == F64 else 2 * count)
    given = {**needs(name), "cos_in": 0.75, "cos_out": 0.5}
    fields = {
        "model": MODELS[name],
        "parameters": [(PARAMETERS[key].id, value) for key, value in given.items()],
        "evaluator": evaluator,
        "wanted": wanted,
    }
    with small.connect() as in_parts, shared.connect() as at_once:
        parts = answer(in_parts, eval_payload(media, radii, **fields))
        assert len(parts) > 1
        [whole] = answer(at_once, eval_payload(media, radii, **fields))
        assert_same(put_together(parts), whole)
        for part in (parts[0], parts[len(parts) // 2], parts[-1]):
            first = part.fixed.first
            some = radii[first : first + part.fixed.count]
            [alone] = answer(in_parts, eval_payload(media, some, **fields))
            for row, row_alone in zip(part.rows, alone.rows, strict=True):
                np.testing.assert_array_equal(row, row_alone)
            assert part.channels == whole.channels


def test_tables_and_slow_models(shared, tiny):
    """A profile that is slow to prepare is prepared once for all parts."""
    gaussians = [(PARAMETERS["gaussians"].id, 6.0)]
    grid = {"radii": None, "radius_count": 3000, "radius_start": 0.5, "radius_stop": 4.0}
    for fields in (
        {"model": MODELS["transport"], "evaluator": F64, "wanted": R},
        {"model": MODELS["transport"], "evaluator": LUT, "wanted": CDF},
        {"model": MODELS["gaussians"], "evaluator": F32, "wanted": R, "parameters": gaussians},
    ):
        payload = eval_payload(**grid, **fields)
        with tiny.connect() as in_parts, shared.connect() as at_once:
            before = statistics(in_parts)["cache_builds"]
            parts = answer(in_parts, payload)
            assert len(parts) > 3
            assert statistics(in_parts)["cache_builds"] == before + 1
            assert_same(put_together(parts), answer(at_once, payload)[0])


def test_a_model_that_a_tolerance_chose(shared, tiny):
    tolerance = [(PARAMETERS["tolerance"].id, 0.02)]
    grid = {"radii": None, "radius_count": 3000, "radius_start": 0.5, "radius_stop": 4.0}
    payload = eval_payload(model=0, wanted=R, parameters=tolerance, **grid)
    with tiny.connect() as in_parts, shared.connect() as at_once:
        parts = answer(in_parts, payload)
        assert len(parts) > 3 and parts[0].fixed.model != 0
        assert_same(put_together(parts), answer(at_once, payload)[0])


# ---- how they are cut ----------------------------------------------------------------------------


@pytest.mark.parametrize("frame_bytes", [4096, 10_000, 1 << 20])
@pytest.mark.parametrize("part_bytes", [4096, 9000, 65536, 1 << 20])
def test_sizes(daemon, frame_bytes, part_bytes):
    most = min(frame_bytes, part_bytes)
    one = daemon("--max-frame-bytes", str(frame_bytes), "--max-part-bytes", str(part_bytes))
    with one.connect() as connection:
        for evaluator, value_bytes in ((F64, 8), (F32, 4)):
            fields = {"radii": None, "wanted": R, "evaluator": evaluator}
            head = head_bytes(1, 1)
            fits = (frame_bytes - head) // value_bytes
            [only] = answer(connection, eval_payload(radius_count=fits, **fields))
            assert only.fixed.part_count == 1
            parts = answer(connection, eval_payload(radius_count=fits + 1, **fields))
            counts = [part.fixed.count for part in parts]
            assert len(parts) > 1 and sum(counts) == fits + 1
            # Parts are as large as possible, in steps of 256 radii.
            assert set(counts[:-1]) == {(most - head) // value_bytes // 256 * 256}
            assert 0 < counts[-1] <= counts[0]


def test_answers_of_one_connection_follow_each_other(tiny):
    endings = []
    with tiny.connect() as connection:
        large = eval_payload(radii=None, radius_count=5000, wanted=R)
        little = eval_payload(wanted=R)
        requests = [frame(EVAL, i, large if i % 2 else little) for i in range(8)]
        connection.send_bytes(b"".join(requests))
        for i in range(8):
            endings.append(put_together(receive_parts(connection, i)))
        assert_serves(connection)
    for ended in endings[2:]:
        assert_same(ended, endings[ended.fixed.count == 5000])


def test_an_answer_in_parts_counts_once(daemon):
    one = daemon("--max-frame-bytes", "4096", "--max-part-bytes", "4096")
    with one.connect() as connection, one.connect() as watcher:
        before = statistics(watcher)
        parts = answer(connection, eval_payload(radii=None, radius_count=10_000, wanted=R))
        after = statistics(watcher)
    assert len(parts) > 10
    # One for the eval, and one for the statistics.
    assert after["answers_ok"] == before["answers_ok"] + 2
    assert after["requests_eval"] == before["requests_eval"] + 1
    assert after["radii_evaluated"] == before["radii_evaluated"] + 10_000


# ---- readers -------------------------------------------------------------------------------------


def settled(read) -> bool:
    """Returns whether a number has stopped changing."""
    before = read()
    time.sleep(0.05)
    return read() == before


def test_a_reader_that_stops_costs_bounded_memory_and_no_time(daemon):
    one = daemon("--workers", "1")
    with one.connect() as stuck, one.connect() as other:
        stuck.send_bytes(frame(EVAL, 1, eval_payload(**ENDLESS)))
        for _ in range(20):
            assert stuck.receive_frame().type == EVALUATED
        # The daemon evaluates only as much as it queues for this reader.
        assert eventually(lambda: settled(lambda: statistics(other)["radii_evaluated"]))
        limits = 4 * (1 << 20)  # max_queued_bytes, a part that had begun, and a spare
        for _ in range(20):
            assert statistics(other)["buffer_bytes"] < limits
            assert_serves(other)
        evaluated = statistics(other)["radii_evaluated"]
        number = 20
        for _ in range(20):  # When the client reads again, the answer goes on where it stopped.
            part = take_apart(stuck.receive_frame().payload)
            assert part.fixed.part == number
            number += 1
        assert eventually(lambda: statistics(other)["radii_evaluated"] > evaluated)
        assert statistics(other)["buffer_bytes"] < limits
    assert_daemon_serves(one)


def test_a_client_that_leaves_in_the_middle(daemon):
    one = daemon("--workers", "1")
    with one.connect() as watcher:
        for reads in (0, 1, 3):
            with one.connect() as leaving:
                leaving.send_bytes(frame(EVAL, 1, eval_payload(**ENDLESS)))
                for _ in range(reads):
                    assert leaving.receive_frame().type == EVALUATED
            assert eventually(lambda: statistics(watcher)["connections_open"] == 1)
            assert settled(lambda: statistics(watcher)["radii_evaluated"])
        assert eventually(lambda: statistics(watcher)["buffer_bytes"] < 1 << 20)
        assert_serves(watcher)


def test_a_client_that_says_no_more_still_gets_all(tiny):
    with tiny.connect() as connection:
        count = 100_000
        payload = eval_payload(radii=None, radius_count=count, wanted=R)
        connection.send_bytes(frame(EVAL, 77, payload))
        connection.half_close()
        whole = put_together(receive_parts(connection))
        assert whole.fixed.count == count
        assert_closed(connection)


class Stream:
    """A thread that reads an answer that never ends, until it is told to stop."""

    def __init__(self, daemon):
        self._connection = daemon.connect()
        self._connection.send_bytes(frame(EVAL, 1, eval_payload(**ENDLESS)))
        self.parts = 0
        self._wanted = True
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        while self._wanted:
            reply = self._connection.receive_frame()
            assert reply.type == EVALUATED
            assert wire.EVAL_REPLY.unpack(reply.payload).part == self.parts
            self.parts += 1

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self._wanted = False
        self._thread.join()
        self._connection.close()


def test_small_requests_are_answered_between_parts(daemon):
    """Small requests are answered while two clients read endless answers of the only worker."""
    one = daemon("--workers", "1")
    with Stream(one) as first, Stream(one) as second, one.connect() as other:
        assert eventually(lambda: first.parts > 3 and second.parts > 3)
        for _ in range(200):
            assert_serves(other)
        before = first.parts, second.parts
        assert eventually(lambda: first.parts > before[0] and second.parts > before[1])


# ---- ends ----------------------------------------------------------------------------------------


def test_stopping_lets_an_answer_end(daemon):
    one = daemon()
    with one.connect() as connection:
        count = 20_000_000
        payload = eval_payload(radii=None, radius_count=count, wanted=R)
        connection.send_bytes(frame(EVAL, 77, payload))
        first = connection.receive_frame()
        one.terminate()
        parts = [wire.EVAL_REPLY.unpack(first.payload)]
        while parts[-1].part + 1 < parts[-1].part_count:
            parts.append(wire.EVAL_REPLY.unpack(connection.receive_frame().payload))
        assert sum(part.count for part in parts) == count
        assert_error(connection.receive_frame(), "shutting-down", "daemon", "another one", request_id=0)
        assert_closed(connection)
    assert one.wait() == 0


@pytest.mark.parametrize("reads", [True, False])
def test_stopping_does_not_wait_for_an_answer_without_end(daemon, reads):
    one = daemon("--drain-timeout-ms", "300")
    with one.connect() as connection:
        connection.send_bytes(frame(EVAL, 77, eval_payload(**ENDLESS)))
        connection.receive_bytes(1)
        one.terminate()
        start = time.monotonic()
        if reads:
            while not connection.receive_eof():
                connection.receive_bytes(1)
        assert one.wait() == 0
        assert time.monotonic() - start < 5


def test_an_answer_that_memory_does_not_let_go_on(daemon):
    """When other connections hold the memory, the next part is refused with BUSY. Later requests
    are answered again."""
    total = (7 << 20) // 2
    one = daemon("--max-total-bytes", str(total), "--workers", "1")
    with one.connect() as first, one.connect() as second:
        first.send_bytes(frame(EVAL, 1, eval_payload(**ENDLESS)))
        first.receive_bytes(1)
        with one.connect() as watcher:
            evaluated = lambda: statistics(watcher)["radii_evaluated"]  # noqa: E731
            assert eventually(lambda: settled(evaluated))
            assert statistics(watcher)["buffer_bytes"] > 2 << 20
        second.send_bytes(frame(EVAL, 77, eval_payload(**ENDLESS)))
        assert take_apart(second.receive_frame().payload).fixed.part == 0
        assert_error(second.receive_frame(), "busy", "max_total_bytes", "fewer bytes")
        first.close()
        assert_serves(second)

        def taken_again() -> bool:
            reply = ask(second, EVAL, eval_payload(radii=None, radius_count=200_000, wanted=R))
            return reply.type == EVALUATED

        assert eventually(taken_again)
