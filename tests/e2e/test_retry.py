"""Daemons are killed or stopped under load and come back at the same address. Clients connect again
and repeat their requests, and every request gets its correct answer once."""

import asyncio
import contextlib
import functools
import itertools
import re
import signal
import threading
import time

import dipole
import pytest
from beside import Beside, Bench
from command_line import Proxy, busy
from daemons import BUILD, NOWHERE, PROGRAM, Daemon, eventually, finished, nowhere
from frames import EVAL, SKIN, SPECTRALON, R, eval_payload, frame

RETRY_S = 60.0
RESTARTS = 2


class Restarted:
    """A daemon that can be ended and replaced by another one at the same address."""

    def __init__(self, url: str):
        self._options = ("--max-frame-bytes", "1048576", "--max-part-bytes", "65536", "--mc-threads", "1")
        self.daemon = Daemon(*self._options, listen=[url])
        self._late: threading.Timer | None = None
        self.url = self.daemon.urls[0]  # This address has the actual port.

    def end(self, how: str | None = None) -> None:
        """Kills the daemon, or closes it and checks its end, by its transport unless `how` says which;
        starts another."""
        getattr(self.daemon, how or ("kill" if self.url.startswith("unix:") else "close"))()
        self.daemon = Daemon(*self._options, listen=[self.url])

    def pause_and_come_back(self) -> None:
        """Kills the daemon, and starts another only after clients have tried in vain."""
        self.daemon.kill()
        self._late = threading.Timer(0.3, self._begin)
        self._late.start()

    def _begin(self) -> None:
        self.daemon = Daemon(*self._options, listen=[self.url])

    def close(self) -> None:
        """Stops the current daemon."""
        if self._late is not None:
            self._late.join()
        self.daemon.close()


@pytest.fixture(params=["unix", "tcp"])
def restarted(request, tmp_path):
    """Returns a daemon that can be restarted, over each transport in turn."""
    one = Restarted(f"unix:{tmp_path}/s" if request.param == "unix" else "tcp:127.0.0.1:0")
    yield one
    one.close()


def result_bytes(result: dipole.Result) -> tuple:
    """Returns all values of a result as bytes."""
    return result.R.tobytes(), result.albedo.tobytes(), result.r.tobytes()


QUESTIONS = [
    {"model": model, "media": medium, "r": [0.1 * (i + 1) for i in range(count)]}
    for model, medium, count in itertools.product(
        ["better", "classical"], [SKIN, SPECTRALON], [1, 5, 700]
    )
] + [
    {
        "model": "better",
        "media": [SKIN] * 2,
        "grid": dipole.Grid(0.1, 10.0, 400_000),
        "evaluator": "f32",
    }
]


def ask_all(client: dipole.Client, known: list[tuple]) -> None:
    """Asks all questions at once, twice, and checks every answer."""
    outstanding = {client.submit(**QUESTIONS[i]): i for i in (*range(len(QUESTIONS)),) * 2}
    while outstanding:
        request_id, result = client.collect()
        assert result_bytes(result) == known[outstanding.pop(request_id)]


def test_python_clients_outlive_their_daemon(restarted):
    clients = [dipole.Client(restarted.url, retry_s=RETRY_S) for _ in range(2)]
    known = [result_bytes(clients[0].eval(**question)) for question in QUESTIONS]
    with contextlib.ExitStack() as stack:
        for one in clients:
            stack.enter_context(one)
        threads = [stack.enter_context(Beside(lambda one=one: ask_all(one, known))) for one in clients]
        for _ in range(RESTARTS):
            before = [one.done for one in threads]
            restarted.end()
            assert eventually(lambda: all(t.failure or t.done > b + 2 for t, b in zip(threads, before)), 60)


def test_libdipole_outlives_its_daemon(restarted):
    """Each answer to `dipole bench` has the bits of the first daemon's, also those in parts."""
    large = ("--radii", "200000", "--large-radii", "200000", "--in-flight", "4", "--connections", "2")
    short = ("--seconds", "0.3")
    with Bench(restarted.url, *short) as one, Bench(restarted.url, *short, *large):
        for _ in range(2 * RESTARTS):
            one.reached([restarted.daemon])
            restarted.end()


# It has to last for some reports: a daemon sends five in a second, and this machine may be a fast one.
JOB = {"medium": SKIN, "edges": dipole.Grid(0.0, 4.0, 5), "photons": 3_000_000, "seed": 7}


def job_bytes(result: dipole.McResult) -> tuple:
    """Returns all values of a job as bytes."""
    parts = result.values, result.errors, result.ring_photons
    return result.state, result.photons, result.energies, *(part.tobytes() for part in parts)


@functools.cache
def known_job() -> tuple:
    """Returns what a daemon of its own gives for JOB."""
    return job_bytes(job_once(f"private:{PROGRAM}", None))


def job_once(address: str, progress, **options) -> dipole.McResult:
    """Runs JOB by a Client."""
    with dipole.Client(address, **options) as client:
        return client.mc(**JOB, progress=progress)


def job_once_async(address: str, progress, **options) -> dipole.McResult:
    """Runs JOB by an AsyncClient, with evals beside it if the client retries."""

    async def ask() -> dipole.McResult:
        async with dipole.AsyncClient(address, **options) as client:
            job = asyncio.create_task(client.mc(**JOB, progress=progress))
            known = result_bytes(await client.eval("better", SKIN, [1.0]))
            try:
                while options.get("retry_s") and not job.done():
                    assert result_bytes(await client.eval("better", SKIN, [1.0])) == known
                    await asyncio.sleep(0.01)
            except dipole.ConnectionLost:
                await job  # It has failed, too.
                raise
            return await job

    return asyncio.run(ask())


# Jobs do not depend on the transport.
both_run = pytest.mark.parametrize("restarted, run", [("unix", job_once), ("tcp", job_once_async)], indirect=["restarted"])


@both_run
def test_a_job_is_begun_again(restarted, run):
    """Twice in the middle of a job its daemon ends; the job ends with the same bits."""
    reports: list[int] = []

    def end(report: dipole.McProgress) -> None:
        reports.append(report.photons)
        if len(reports) < 3:
            restarted.end()

    assert job_bytes(run(restarted.url, end, retry_s=RETRY_S)) == known_job()
    assert len(reports) > 2


@both_run
def test_a_cancelled_job_is_not_begun_again(restarted, run):
    def end(_: dipole.McProgress) -> bool:
        restarted.end("kill")
        return False

    with pytest.raises(dipole.ConnectionLost):
        run(restarted.url, end, retry_s=RETRY_S)


@both_run
def test_a_job_is_cut_off_where_no_retries_are_wanted(restarted, run):
    def end(_: dipole.McProgress) -> None:
        restarted.end("close")

    result = run(restarted.url, end, retry_s=0)
    assert result.state == "stopped" and 0 < result.photons < JOB["photons"]


def test_parts_are_not_handed_on_twice(restarted):
    question = QUESTIONS[-1]
    with dipole.Client(restarted.url, retry_s=RETRY_S) as client:
        whole = client.eval(**question)
        with client.eval_parts(**question) as parts:
            first = next(parts)
            assert (first.R == whole.R[:, : first.R.shape[1]]).all()
            restarted.end("kill")
            read = first.R.shape[1]
            with pytest.raises(dipole.ConnectionLost):
                for part in parts:
                    read += part.R.shape[1]
            assert read < whole.R.shape[1]


def test_no_retries_where_none_are_wanted(restarted):
    with dipole.Client(restarted.url, retry_s=0) as client:
        client.ping()
        restarted.end("kill")
        for _ in range(2):
            with pytest.raises(dipole.ConnectionLost):
                client.ping()


@pytest.mark.parametrize("what", ["eval", "parts", "table"])
def test_deadlines_go_on_while_nobody_is_there(restarted, what):
    """While there is no daemon, deadlines go on: a request that cannot be sent again in time fails
    as late, and no other does."""
    with dipole.Client(restarted.url, retry_s=RETRY_S) as client:
        ask = {
            "eval": lambda: client.eval("better", SKIN, [1.0], deadline_ms=1),
            "parts": lambda: next(client.eval_parts("better", SKIN, [1.0], deadline_ms=1)),
            "table": lambda: client.table("better", SKIN, deadline_ms=1),
        }[what]
        client.ping()
        restarted.pause_and_come_back()
        with pytest.raises(dipole.Refused) as caught:
            ask()
        assert (caught.value.status, caught.value.field) == ("deadline", "deadline_ms")
        assert client.eval("better", SKIN, [1.0]).R > 0


def test_what_has_been_answered_is_not_asked_again(shared):
    with dipole.Client(shared.url()) as client:
        before = client.statistics()["requests_eval"]
        first = client.submit("better", SKIN, [1.0])
        client.eval("better", SKIN, [2.0])  # its answer comes behind
        client._session.connection.socket.shutdown(2)
        client.ping()
        assert client.collect(first)[1].R > 0 and client.statistics()["requests_eval"] == before + 2


def test_nobody_comes_back(daemon):
    one = daemon()
    with dipole.Client(one.url(), retry_s=0.2) as client:
        client.ping()
        one.kill()
        with pytest.raises(dipole.ConnectionLost, match="and connecting again failed: unix:"):
            client.eval("better", SKIN, [1.0])


def test_busy_is_asked_again(daemon):
    """A request that is refused with BUSY is repeated. Another client uses up the budget for
    buffers, and then releases it."""
    one = daemon("--max-total-bytes", "1048576")
    grid = dipole.Grid(0.1, 10.0, 100_000)
    with one.connect() as holder, one.client() as impatient:
        with dipole.Client(one.url(), retry_s=RETRY_S) as client:
            before = client.eval("better", SKIN, grid=grid, wanted=["R"])
            holder.send_bytes(holding_frame())
            assert eventually(lambda: client.statistics()["buffer_bytes"] > 500_000)
            with dipole.Client(one.url(), retry_s=0) as at_once:
                with pytest.raises(dipole.Refused):
                    at_once.eval("better", SKIN, grid=grid, wanted=["R"])
            request_id = client.submit("better", SKIN, grid=grid, wanted=["R"])
            assert impatient.ping() > 0
            holder.close()
            collected_id, result = client.collect()
            assert collected_id == request_id
            assert (result.R == before.R).all()
            assert client.statistics()["replies_busy"] >= 1


def test_a_pause_beyond_the_clients_patience_is_not_cut_short(daemon):
    asked = []

    def refuse(number: int, request_id: int) -> bytes:
        asked.append(number)
        return busy(request_id, retry_after_ms=3_600_000)

    with Proxy(daemon().url(), refuse) as proxy, dipole.Client(proxy.url, retry_s=RETRY_S) as client:
        with pytest.raises(dipole.Refused):
            client.eval("better", SKIN, [1.0])
    assert asked == [0]


def holding_frame() -> bytes:
    """Returns a request of half a megabyte without its last byte."""
    return frame(EVAL, 1, eval_payload(radii=[1.0] * 70_000, wanted=R))[:-1]


# ---- several addresses ---------------------------------------------------------------------------


def test_another_daemon_takes_over(daemon):
    one, other = daemon(), daemon()
    addresses = f"{one.url()},{other.url('tcp')}"
    with dipole.Client(addresses, retry_s=RETRY_S) as client:
        known = [result_bytes(client.eval(**question)) for question in QUESTIONS]
        outstanding = {client.submit(**question): i for i, question in enumerate(QUESTIONS)}
        assert client.address == one.url()
        one.kill()
        while outstanding:
            request_id, result = client.collect()
            assert result_bytes(result) == known[outstanding.pop(request_id)]
        assert client.address == other.url("tcp")
    assert other.client().statistics()["requests_eval"] > 0


def test_lists_of_addresses(tmp_path):
    with pytest.raises(dipole.ConnectError, match="none.*no,ne") as caught:
        dipole.Client(f"unix:{tmp_path}/none,unix:{tmp_path}/no,ne", retry_s=0)
    assert str(caught.value).count("unix:") == 2
    with pytest.raises(dipole.AddressError, match="private"):
        dipole.Client("unix:/s,private:")


# ---- all clients ---------------------------------------------------------------------------------


def eval_once(address: str, **options) -> tuple[str, dipole.Result]:
    """Opens a Client and evaluates one query. Returns the first daemon's address, too."""
    with dipole.Client(address, **options) as client:
        return client.info.address, client.eval("better", SKIN, [1.0])


def eval_once_async(address: str, **options) -> tuple[str, dipole.Result]:
    """Does the same with an AsyncClient."""

    async def ask() -> tuple[str, dipole.Result]:
        async with dipole.AsyncClient(address, **options) as client:
            return client.info.address, await client.eval("better", SKIN, [1.0])

    return asyncio.run(ask())


def open_once_in_c(address: str, **options: float) -> tuple[str]:
    """Opens a client of libdipole, by `dipole info`, whose failure becomes an exception."""
    how = [f"--{name.replace('_s', '-ms')}={1000 * value:.0f}" for name, value in options.items()]
    run = finished(BUILD / "dipole", "info", "--format", "csv", "--connect", address, *how)
    assert run.returncode in (0, 1) and "Sanitizer" not in run.stderr, run.stderr
    if run.returncode == 1:
        raise dipole.ConnectError(run.stderr)
    return tuple(re.findall("daemon,address,(.*)", run.stdout))


all_clients = pytest.mark.parametrize("ask", [eval_once, eval_once_async, open_once_in_c])


@all_clients
@pytest.mark.parametrize("why", NOWHERE)
def test_opening_goes_on_until_the_time_is_over(shared, tmp_path, ask, why):
    """Where nobody answers; of a list, whoever does is taken."""
    with nowhere(why, tmp_path) as address:
        assert ask(f"{address},{shared.url()}")[0] == shared.url()
        for retry_s in (0, 0.3):
            began_s = time.monotonic()
            with pytest.raises(dipole.ConnectError) as caught:
                ask(address, retry_s=retry_s)
            tried = re.search(r"tried for (\d+\.\d) s", str(caught.value))
            assert (tried is None) == (retry_s == 0)
            assert 0.9 * retry_s <= float(tried[1] if tried else 0) <= time.monotonic() - began_s + 0.05
            assert all(one.split(":")[-1] in str(caught.value) for one in address.split(","))


@all_clients
@pytest.mark.parametrize("address", ["unix:/" + "x" * 200, "private:/no/such/program", "private:/dev/null", "private:/bin/false"])
def test_addresses_where_nobody_can_answer(ask, address):
    with pytest.raises((dipole.ConnectError, dipole.ConnectionLost)) as caught:
        ask(address, retry_s=0)
    assert "tried for" not in str(caught.value)


@all_clients
def test_a_daemon_that_comes_later(tmp_path, ask):
    """The default of retry_s is enough for a daemon that is being started again."""
    path, late = f"unix:{tmp_path}/s", []
    begin = threading.Timer(0.3, lambda: late.append(Daemon(listen=[path])))
    begin.start()
    try:
        assert ask(path)[0] == path
    finally:
        begin.join()
        late[0].close()


@pytest.fixture
def hung(daemon):
    """Returns a daemon that is stopped with SIGSTOP: the kernel still takes connections for it."""
    one = daemon()
    one.pause()
    yield one
    one.process.send_signal(signal.SIGCONT)


@all_clients
def test_opening_beside_one_that_hangs(daemon, hung, ask):
    """A daemon that hangs has a share of the time, a half of 2 s here, and the next one answers."""
    good = daemon()
    assert ask(f"{hung.url()},{good.url()}", retry_s=2.0)[0] == good.url()


@all_clients
def test_a_daemon_that_hangs_alone(hung, ask):
    began_s = time.monotonic()
    with pytest.raises(dipole.ConnectError, match="(before it said hello|does not say hello within).*tried for"):
        ask(hung.url(), retry_s=0.5)
    assert time.monotonic() - began_s >= 0.48


def test_a_daemon_that_hangs_is_left(daemon):
    """After timeout_s of silence both clients go on with the other daemon, and then stay there."""
    one, other = daemon(), daemon()
    addresses, known = f"{one.url()},{other.url()}", eval_once(other.url())[1]

    async def ask() -> list[dipole.Result]:
        async with dipole.AsyncClient(addresses, timeout_s=0.5) as client:
            await client.ping()
            one.pause()
            return await asyncio.gather(*(client.eval("better", SKIN, [1.0]) for _ in range(3)))

    with dipole.Client(addresses, timeout_s=0.5) as client:
        client.ping()
        try:
            results = asyncio.run(ask())
            results += [client.eval("better", SKIN, [1.0]) for _ in range(3)]
        finally:
            one.process.send_signal(signal.SIGCONT)
    assert all(result_bytes(result) == result_bytes(known) for result in results)
    # All seven came from the other one, which may have been too slow once, and asked again.
    assert other.client().statistics()["requests_eval"] >= 7
