"""Overload: large requests get BUSY with a hint when to retry, small ones are still answered, and a
client that does not read harms nobody."""

from contextlib import ExitStack

import numpy as np
import pytest
from beside import Beside
from daemons import eventually
from dipole import Connection, wire
from frames import EVAL, FIT_REQUEST, INVERT, RADIUS, READINGS, SAMPLE, SKIN, VARYING, R, ask
from frames import assert_error, assert_serves, eval_payload, fit_payload, frame, invert_payload, receive_reply, sample_payload, statistics
from frames import varying_payload
from lists import MODELS
from messages import receive_answer

EVALUATED = EVAL | wire.REPLY


def sample(count: int, model: str = "beam+single") -> bytes:
    return sample_payload([SKIN], None, sample_count=count, model=MODELS[model], wanted=RADIUS)


def invert(count: int, model: str = "better") -> bytes:
    albedos = np.linspace(0.01, 0.99, count)
    return invert_payload(albedos, np.ones(count), model=MODELS[model], eta=1.37)


def varying(count: int) -> bytes:
    """A request for R, albedo, cdf, pdf and 2_pi_r_R of many media."""
    return varying_payload(np.tile([0.1, 1.0], (count, 1)), np.ones(count), wanted=199)


def fit(count: int) -> bytes:
    """Noisy readings, so that each set is a search."""
    noise = np.random.default_rng(1).normal(1, 0.02, (count, len(READINGS)))
    return fit_payload(READINGS * noise)


# A request for about a second of work, whose reply fits into one frame.
LONG = eval_payload(model=MODELS["beam+single"], radii=None, radius_count=1_000_000, wanted=R)
# A request for a fraction of a millisecond of work.
LARGE = eval_payload(radii=None, radius_count=100_000, wanted=R)
# The largest request that counts as small. The next one has one radius more.
LARGEST_SMALL = eval_payload(radii=None, radius_count=16384, wanted=R)
SMALLEST_LARGE = eval_payload(radii=None, radius_count=16385, wanted=R)


def start(connection: Connection, watcher: Connection, payload: bytes) -> None:
    """Sends a request and waits until it is being evaluated."""
    before = statistics(watcher)["radii_evaluated"]
    connection.send_bytes(frame(EVAL, 77, payload))
    assert eventually(lambda: statistics(watcher)["radii_evaluated"] > before)


class Others:
    """Connections that each have the same request running, of at least so many radii, and do not read
    its answer."""

    def __init__(self, daemon, watcher: Connection, count: int, type: int, payload: bytes, least: float = 0):
        self._stack = ExitStack()
        self.all = [self._stack.enter_context(daemon.connect()) for _ in range(count)]
        self._request = frame(type, 1, payload)
        self._watcher, self._least = watcher, least

    def __enter__(self) -> None:
        for connection in self.all:
            before = statistics(self._watcher)["owed_radii"]
            connection.send_bytes(self._request)
            assert eventually(lambda: statistics(self._watcher)["owed_radii"] > before + self._least)

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def test_large_requests_are_refused_while_many_connections_have_much_to_do(daemon):
    """A large request is refused when the other connections together would delay it by too much.
    Each counts for at most a sixteenth of the allowed backlog, here 31,250 radii, and for at most
    the work of the new request."""
    one = daemon("--workers", "1", "--max-backlog-ms", "1", "--drain-timeout-ms", "100")
    with one.connect() as other:
        with Others(one, other, 16, EVAL, LONG):
            for _ in range(2):
                reply = ask(other, EVAL, LARGE)
                assert_error(reply, "busy", "radius_count", "max_backlog_ms")
                assert 0 < wire.ERROR.unpack(reply.payload).retry_after_ms < 1000
            # This request is not delayed by as much.
            assert ask(other, EVAL, SMALLEST_LARGE).type == EVALUATED
            assert ask(other, EVAL, LARGEST_SMALL).type == EVALUATED
            for _ in range(20):
                assert_serves(other)
            assert statistics(other)["replies_busy"] == 2


def test_a_few_connections_with_endless_work_keep_nobody_out(daemon):
    """Two connections each have a request of 96 bytes for 2^40 radii and read as fast as they can.
    Other requests are still admitted."""
    one = daemon("--workers", "1", "--drain-timeout-ms", "100")
    endless = frame(EVAL, 1, eval_payload(radii=None, radius_count=2**40, wanted=R))
    with one.connect() as first, one.connect() as second, one.connect() as other:
        for reader in (first, second):
            reader.send_bytes(endless)
        with Beside(lambda: first.receive_bytes(1 << 16)), Beside(lambda: second.receive_bytes(1 << 16)):
            assert eventually(lambda: statistics(other)["owed_radii"] > 1.5 * 2**40)
            assert ask(other, EVAL, LARGE).type == EVALUATED
            for type, large in ((SAMPLE, sample(1000)), (INVERT, invert(100))):
                assert ask(other, type, large).type == type | wire.REPLY
            other.send_bytes(endless)  # A third connection may have an endless request, too.
            assert receive_reply(other).type == EVALUATED


def test_other_workers_have_less_to_do(daemon):
    """Each worker has its own backlog. A new connection goes to the worker with the fewest
    connections."""
    one = daemon("--workers", "2", "--max-backlog-ms", "1")
    with one.connect() as busy, one.connect() as other:
        start(busy, other, LONG)
        assert ask(other, EVAL, LARGE).type == EVALUATED
        assert wire.PART.unpack(receive_reply(busy).payload).count == 1_000_000


@pytest.mark.parametrize("count", [2**31, 2**40])
def test_who_does_not_read_gives_nobody_a_backlog(daemon, count):
    one = daemon("--workers", "1", "--max-backlog-ms", "1")
    with ExitStack() as stack, one.connect() as other:
        for _ in range(16):  # none counts for more than a sixteenth of the backlog
            stuck = stack.enter_context(one.connect())
            stuck.send_bytes(frame(EVAL, 1, eval_payload(radii=None, radius_count=count, wanted=R)))
            stuck.receive_bytes(1)
        assert eventually(lambda: ask(other, EVAL, LARGE).type == EVALUATED)
        for _ in range(20):
            assert ask(other, EVAL, LARGE).type == EVALUATED


def test_a_request_larger_than_the_backlog_is_taken_when_there_is_none(daemon):
    one = daemon("--workers", "1", "--max-backlog-ms", "1", "--max-frame-bytes", "65536")
    with one.connect() as connection:
        # The requests of one connection run one after the other and do not delay each other.
        for _ in range(3):
            payload = eval_payload(radii=None, radius_count=2_000_000, wanted=R)
            connection.send_bytes(frame(EVAL, 77, payload) * 2)
            for _ in range(2):
                assert sum(wire.PART.unpack(one).count for one in receive_answer(connection)[1]) == 2_000_000


# ---- samples, inversions and fits ----------------------------------------------------------------------

@pytest.mark.parametrize(
    "type, small, large, field, radii",
    [
        (SAMPLE, sample_payload(), sample(20_000, "extended"), "sample_count", 2e6),
        (INVERT, invert_payload(), invert(20_000), "medium_count", 4e7),
        (FIT_REQUEST, fit_payload(), fit(5000), "set_count", 5e7),
    ],
    ids=["sample", "invert", "fit"],
)
def test_large_ones_are_refused_while_there_is_much_to_do(daemon, type, small, large, field, radii):
    one = daemon("--workers", "1", "--max-backlog-ms", "1", "--drain-timeout-ms", "100")
    with one.connect() as second:
        with Others(one, second, 16, type, large, radii):
            assert_error(ask(second, type, large), "busy", field, "max_backlog_ms")
            assert ask(second, type, small).type == type | wire.REPLY
    one = daemon("--workers", "1")
    with one.connect() as second:
        with Others(one, second, 1, type, large):
            pass
        # A client that has left owes no work.
        assert eventually(lambda: statistics(second)["owed_radii"] == 0)
        assert_serves(second)


def test_values_with_media_of_their_own_are_admitted(daemon):
    """They are too fast to fill a backlog themselves."""
    one = daemon("--workers", "1", "--max-backlog-ms", "1", "--drain-timeout-ms", "100")
    with one.connect() as second:
        with Others(one, second, 16, INVERT, invert(20_000)):
            refused = ask(second, VARYING, varying(60_000))
            assert_error(refused, "busy", "value_count", "max_backlog_ms")
            assert ask(second, VARYING, varying_payload()).type == VARYING | wire.REPLY
