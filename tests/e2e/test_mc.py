"""Monte Carlo jobs: tables, progress, how jobs end, and that they do not disturb other work."""

import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import dipole
import numpy as np
import pytest
from daemons import eventually
from dipole import Frame, Grid, Medium, wire
from dipole.mc import McResult, pack_request, progress_of, unpack_fixed, unpack_result
from frames import LINEAR, SKIN, ask, assert_closed, assert_error, assert_serves, frame

MC, CANCEL = wire.MESSAGES["mc"], wire.MESSAGES["cancel"]
BATCH = 4096
EDGES = Grid(0.0, 5.0, 11)
TISSUE = Medium(sigma_a=0.1, sigma_s=0.9, g=0.3, eta=1.3)
# A job with hours of work, for tests that need a running job.
ENDLESS = {"medium": Medium(1e-4, 10.0, 0.9, 1.4), "photons": 10**10}


def mc_payload(**changes) -> bytes:
    fields = {"medium": TISSUE, "edges": EDGES, "spacing": LINEAR, "photons": 2 * BATCH}
    fields |= {"error_total": 0.0, "error_rings": 0.0, "albedos": ()}
    return pack_request(**{**fields, "seed": 1, **changes})


def receive_last(connection: dipole.Connection, request_id: int) -> Frame:
    """Receives the last reply to a request, after any reports of progress, of other jobs, too."""
    while True:
        reply = connection.receive_frame()
        if reply.type != MC | wire.REPLY or unpack_fixed(reply.payload).state != wire.MC_UNDER_WAY:
            assert reply.request_id == request_id
            return reply


def receive_table(connection: dipole.Connection, request_id: int = 77) -> McResult:
    reply = receive_last(connection, request_id)
    assert reply.type == MC | wire.REPLY
    return unpack_result(reply.payload)


def start_endless(connection: dipole.Connection, request_id: int = 77) -> None:
    """Starts a job that does not end, and waits for its first report."""
    connection.send_bytes(frame(MC, request_id, mc_payload(**ENDLESS)))
    reply = connection.receive_frame()
    assert (reply.type, reply.request_id) == (MC | wire.REPLY, request_id)
    assert unpack_fixed(reply.payload).state == wire.MC_UNDER_WAY


def cancel(connection: dipole.Connection, job_id: int, request_id: int = 500) -> int:
    """Sends a cancel request. Returns the field `found` of its reply."""
    connection.send_bytes(frame(CANCEL, request_id, wire.CANCEL_REQUEST.pack(job_id=job_id)))
    reply = receive_last(connection, request_id)
    assert reply.type == CANCEL | wire.REPLY
    return wire.CANCEL_REPLY.unpack(reply.payload).found


# ---- tables --------------------------------------------------------------------------------------


def test_errors_end_it_early(client):
    total = client.mc(TISSUE, EDGES, error_total=0.01)
    # Standard errors need at least 32 batches.
    assert total.state == "errors" and total.photons == 32 * BATCH
    assert 0 < total.error_total <= 0.01 < total.error_rings
    rings = client.mc(TISSUE, EDGES, error_rings=0.05)
    assert rings.state == "errors" and rings.error_rings <= 0.05
    worst = np.nanmax(rings.R_error / rings.R)
    assert rings.error_rings == worst
    at = int(np.nanargmax(rings.R_error / rings.R))
    assert rings.worst_ring_mm == (rings.edges[at], rings.edges[at + 1])
    slab = client.mc((0.1, 0.9, 0.0, 1.3, 4.0), EDGES, photons=20_000, albedos=[0.9, 0.5])
    fixed, relative = unpack_fixed(slab.payload), slab.errors / slab.values
    assert relative[fixed.worst_albedo, fixed.worst_side].max() == relative.max() and fixed.worst_albedo and fixed.worst_side
    both = client.mc(TISSUE, EDGES, error_rings=0.05, error_total=0.5)
    assert both.payload == rings.payload
    short = client.mc(TISSUE, EDGES, error_rings=1e-6, photons=50_000)
    assert short.state == "photons" and short.photons == 13 * BATCH
    assert client.mc(TISSUE, Grid(1e8, 2e8, 3), photons=BATCH).error_rings == np.inf  # no light
    with pytest.raises(dipole.ProtocolError, match="in state 99, which is not known"):
        unpack_result(b"\x63\0" + short.payload[2:])


# ---- progress and the end ------------------------------------------------------------------------


def test_progress_is_numbered_and_grows(client):
    seen: list[dipole.McProgress] = []

    def follow(now: dipole.McProgress) -> bool:
        seen.append(now)
        return len(seen) < 6

    result = client.mc(ENDLESS["medium"], EDGES, error_rings=0.001, progress=follow)
    assert [one.number for one in seen[:6]] == [1, 2, 3, 4, 5, 6]
    photons = [one.photons for one in seen]
    assert photons == sorted(photons) and photons[-1] <= result.photons
    assert result.state == "cancelled"
    assert all(one.photons_expected >= one.photons for one in seen)
    assert all(one.worst_ring_mm[1] <= 5.0 and one.error_total > 0 < one.error_rings for one in seen)
    assert client.ping() >= 0


def test_only_the_named_job_is_cancelled(daemon):
    with daemon().connect() as connection:
        start_endless(connection, 1)
        connection.send_bytes(frame(MC, 2, mc_payload(**ENDLESS)))
        assert cancel(connection, 3) == 0
        assert cancel(connection, 2) == 1
        assert receive_table(connection, 2).state == "cancelled"
        assert cancel(connection, 1) == 1
        assert receive_table(connection, 1).state == "cancelled"


def test_jobs_of_others_cannot_be_cancelled(daemon):
    one = daemon()
    with one.connect() as mine, one.connect() as other:
        start_endless(mine)
        assert cancel(other, 77) == 0
        assert not no_job_open(one)


def statistic(one, name: str) -> int:
    """Reads a statistic of a daemon, over a new connection."""
    with one.client() as client:
        return client.statistics()[name]


def no_job_open(one) -> bool:
    return statistic(one, "mc_jobs_open") == 0


def test_who_stops_sending_gets_what_there_is(daemon):
    with daemon().connect() as connection:
        start_endless(connection)
        connection.half_close()
        assert receive_table(connection).state == "cancelled"
        assert_closed(connection)


def test_a_lost_frame_drops_the_job(daemon):
    one = daemon()
    with one.connect() as connection:
        start_endless(connection)
        connection.send_bytes(bytes(24))
        assert_error(receive_last(connection, 0), "bad-magic", "magic", "", request_id=0)
        assert_closed(connection)
    assert eventually(lambda: no_job_open(one))


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_stopping_ends_jobs_with_what_there_is(daemon, how):
    one = daemon("--max-mc-jobs", "6", "--drain-timeout-ms", "60000")
    connections = [one.connect(scheme) for scheme in ("unix", "tcp") * 3]
    for connection in connections:
        start_endless(connection)
    one.terminate(how)
    for connection in connections:
        assert receive_table(connection).state == "stopped"
        assert_error(connection.receive_frame(), "shutting-down", "daemon", "another one", request_id=0)
        assert_closed(connection)
        connection.close()
    assert one.wait() == 0


def test_stopping_does_not_wait_for_who_does_not_read(daemon):
    one = daemon("--drain-timeout-ms", "300")
    large = mc_payload(**{**ENDLESS, "edges": Grid(0.0, 5.0, 4097), "albedos": [0.5] * 16})
    with one.connect() as stuck:
        stuck.send_bytes(frame(MC, 1, large))
        assert eventually(lambda: not no_job_open(one))
        one.terminate()
        assert one.wait() == 0


# ---- beside other work ---------------------------------------------------------------------------


def test_jobs_take_turns(daemon):
    """A short job ends while long ones go on, even with a single thread."""
    with daemon("--mc-threads", "1").connect() as connection:
        for request_id in (1, 2, 3):
            connection.send_bytes(frame(MC, request_id, mc_payload(**ENDLESS)))
        connection.send_bytes(frame(MC, 4, mc_payload()))
        assert receive_table(connection, 4).state == "photons"


def test_many_clients_at_a_time(daemon):
    """Their jobs have the bits of a single thread, whichever of three walks which batch."""
    one = daemon("--max-mc-jobs", "8", "--mc-threads", "3")
    with daemon("--mc-threads", "1").client() as client:
        alone = client.mc(TISSUE, EDGES, photons=10 * BATCH).payload

    def work(_: int) -> set[bytes]:
        with one.client() as client:
            return {client.mc(TISSUE, EDGES, photons=10 * BATCH).payload for _ in range(4)}

    with ThreadPoolExecutor(8) as pool:
        assert set().union(*pool.map(work, range(8))) == {alone}
    assert no_job_open(one) and statistic(one, "mc_photons_walked") == 320 * BATCH


def niceness(one) -> list[int]:
    """Returns the nice value of each thread of a daemon."""
    tasks = Path(f"/proc/{one.process.pid}/task").iterdir()
    stats = [(task / "stat").read_text().rpartition(")")[2].split() for task in tasks]
    return sorted(int(stat[16]) for stat in stats)


def test_threads_have_a_low_priority_and_start_with_the_first_job(daemon):
    one = daemon("--mc-threads", "3")
    before = niceness(one)
    with one.connect() as connection:
        start_endless(connection)
        assert eventually(lambda: niceness(one) == sorted([*before, *[max(10, before[0])] * 3]))


def test_a_slow_reader_gets_the_table_and_little_else(daemon):
    one = daemon()
    with one.connect() as slow:
        slow.send_bytes(frame(MC, 77, mc_payload(photons=10**6)))
        assert eventually(lambda: statistic(one, "requests_mc") == 1)
        assert eventually(lambda: no_job_open(one), timeout_s=60)
        assert receive_table(slow).state == "photons"
        assert_serves(slow)


def test_a_job_is_no_silence(daemon):
    one = daemon("--idle-timeout-ms", "100")
    with one.connect() as connection:
        start_endless(connection)
        for _ in range(3):
            reply = connection.receive_frame()
            assert progress_of(unpack_fixed(reply.payload)).number > 1


# ---- limits and faults ---------------------------------------------------------------------------


def test_max_mc_jobs(daemon):
    with daemon("--max-mc-jobs", "2").connect() as connection:
        start_endless(connection, 1)
        connection.send_bytes(frame(MC, 2, mc_payload(**ENDLESS)))
        connection.send_bytes(frame(MC, 3, mc_payload()))
        assert_error(receive_last(connection, 3), "busy", "max_mc_jobs", "fewer", request_id=3)
        assert cancel(connection, 2) == 1
        assert receive_table(connection, 2).state == "cancelled"
        connection.send_bytes(frame(MC, 3, mc_payload()))
        assert receive_table(connection, 3).state == "photons"


def test_one_job_after_the_other(daemon):
    """When a job has answered, its place is free at once."""
    with daemon("--max-mc-jobs", "1", "--mc-threads", "4").client() as client:
        for photons in [BATCH, 20 * BATCH, 3 * BATCH] * 10:
            assert client.mc(TISSUE, EDGES, photons=photons).photons == photons


def test_max_mc_photons(daemon):
    with daemon("--max-mc-photons", "10000").connect() as connection:
        connection.send_bytes(frame(MC, 77, mc_payload(photons=10_000)))
        assert receive_table(connection).photons == 3 * BATCH
        reply = ask(connection, MC, mc_payload(photons=10_001))
        assert_error(reply, "too-large", "photons", "at most 10000")


def test_tables_larger_than_a_frame(daemon):
    with daemon("--max-frame-bytes", "4096").connect() as connection:
        # 72 + 8 (n + 1) + 304 + 24 n bytes
        connection.send_bytes(frame(MC, 77, mc_payload(edges=Grid(0.0, 5.0, 117))))
        assert len(receive_table(connection).payload) == 4096
        reply = ask(connection, MC, mc_payload(edges=Grid(0.0, 5.0, 118)))
        assert_error(reply, "too-large", "ring_count", "at most 4096 bytes")


def test_memory_is_from_the_budget(daemon):
    with daemon("--max-total-bytes", "1048576", "--max-mc-jobs", "1").connect() as connection:
        large = mc_payload(edges=Grid(0.0, 5.0, 4097), albedos=[0.5] * 16)
        reply = ask(connection, MC, large)
        assert_error(reply, "busy", "max_total_bytes", "fewer bytes")
        assert wire.ERROR.unpack(reply.payload).retry_after_ms == 1000
        connection.send_bytes(frame(MC, 77, mc_payload()))
        assert receive_table(connection).state == "photons"
        assert_serves(connection)


# ---- the Python client ---------------------------------------------------------------------------


# The last one is of another client, which progress() used.
@pytest.mark.parametrize("error", [KeyboardInterrupt, dipole.ConnectionLost])
def test_interrupting_the_python_client_cancels(daemon, error):
    one = daemon()
    with one.client() as client:

        def interrupt(now: dipole.McProgress) -> bool:
            raise error("stop")

        with pytest.raises(error, match="stop"):
            client.mc(ENDLESS["medium"], EDGES, photons=ENDLESS["photons"], progress=interrupt)
        assert client.statistics()["mc_jobs_open"] == 0
        assert client.eval("better", SKIN, [1.0]).R.shape == (1, 1)


def test_a_query_that_was_submitted_before(client):
    submitted = client.submit("better", SKIN, [1.0])
    client.mc(TISSUE, EDGES, photons=BATCH)
    assert client.collect()[0] == submitted


# ---- beside models -------------------------------------------------------------------------------


def test_whole_numbers_may_be_floats(client):
    one = client.mc(SKIN, Grid(0.0, 4.0, 5.0), photons=2e4, seed=np.float32(3))
    assert one.payload == client.mc(SKIN, Grid(0.0, 4.0, 5), photons=20_000, seed=3).payload
    assert client.eval("better", SKIN, grid=Grid(0.0, 4.0, 5e0)).R.shape == (1, 5)
    assert client.sample("better", SKIN, draw=dipole.Draw(1e2, seed=2.0)).r.shape == (1, 100)
    for wrong in ({"photons": 2.5}, {"photons": np.nan}, {"photons": "2e5"}, {"seed": 0.1}):
        with pytest.raises(dipole.ArgumentError, match=next(iter(wrong))):
            client.mc(SKIN, Grid(0.0, 4.0, 5), **wrong)


def test_layers_are_one_stack(client):
    """tests/cli/mc.t has what layers absorb, and test_modbus_jobs.py the bits of both sides."""
    stack = dipole.Stack(Medium(2, 5, 0.8, 1.4, 0.05), Medium(0.1, 10, 0.8, 1.33, 0.5))
    for several in (list(stack), np.array(stack)):  # A list is of several media.
        with pytest.raises(dipole.ArgumentError, match="one Stack"):
            client.mc(several, EDGES)
