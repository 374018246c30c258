"""The Python client for asyncio: it gives the same answers as the other client, many at a time,
also when calls are cancelled and when the daemon goes away."""

import asyncio
import os
import signal

import dipole
import numpy as np
import pytest
from dipole import AsyncClient, Grid, Medium
from frames import SKIN
from messages import CALLS, RADII, assert_same
from test_retry import RETRY_S, restarted  # noqa: F401

LIMIT_S = 60


def run(coroutine):
    """Runs a test's coroutine, with a time limit."""

    async def limited():
        return await asyncio.wait_for(coroutine, LIMIT_S)

    return asyncio.run(limited())


# ---- the same answers ----------------------------------------------------------------------------


def test_every_call_answers_as_the_other_client(shared):
    async def ask() -> None:
        async with AsyncClient(shared.url()) as client:
            assert client.info == known.info
            for name, (arguments, options) in CALLS.items():
                found = await getattr(client, name)(*arguments, **options)
                assert_same(found, getattr(known, name)(*arguments, **options))
            assert (await client.statistics()).keys() == known.statistics().keys()
            assert await client.ping(b"12345678") > 0
            parts = [part async for part in client.eval_parts("better", SKIN, RADII)]
            assert_same(parts, list(known.eval_parts("better", SKIN, RADII)))

    with shared.client() as known:
        run(ask())
    own = {name for name in dir(dipole.Client) if not name.startswith("_")}
    both = own & {name for name in dir(AsyncClient) if not name.startswith("_")}
    assert both == {*CALLS, "statistics", "ping", "call", "eval_parts", "address", "close", "info"}


def test_many_at_a_time_are_told_apart(shared):
    async def ask() -> None:
        async with AsyncClient(shared.url("tcp")) as client:
            radii = [0.01 * (i + 1) for i in range(700)]
            results = await asyncio.gather(*(client.eval("better", SKIN, [r]) for r in radii))
            together = await client.eval("better", SKIN, radii)
            np.testing.assert_array_equal([one.R[0, 0] for one in results], together.R[0])

    run(ask())


def test_parts(daemon):
    """Other calls are made between two parts. Their answers come behind the parts."""

    async def ask() -> None:
        async with AsyncClient(one.url()) as client:
            whole = await client.eval("better", SKIN, grid=Grid(0.1, 9.0, 40_000))
            read = []
            async for part in client.eval_parts("better", SKIN, grid=Grid(0.1, 9.0, 40_000)):
                assert part.radius_first == sum(len(values) for values in read)
                read.append(part.R[0])
                assert (await client.eval("better", SKIN, [1.0])).R > 0
            assert len(read) > 50
            np.testing.assert_array_equal(np.concatenate(read), whole.R[0])

    one = daemon("--max-part-bytes", "16384", "--max-frame-bytes", "65536")
    run(ask())


def test_parts_that_nobody_wants_more_of(daemon):
    async def ask() -> None:
        async with AsyncClient(one.url()) as client:
            parts = client.eval_parts("better", SKIN, grid=Grid(0.1, 9.0, 400_000))
            await parts.__anext__()
            await parts.aclose()
            assert (await client.eval("better", SKIN, [1.0])).R > 0

    one = daemon("--max-part-bytes", "16384", "--max-frame-bytes", "65536")
    run(ask())


# ---- faults --------------------------------------------------------------------------------------


def test_refusals_are_their_callers(shared):
    async def ask() -> None:
        async with AsyncClient(shared.url()) as client:
            media = [SKIN, Medium(-1.0, 1.0), SKIN]
            answers = await asyncio.gather(
                *(client.eval("better", medium, [1.0]) for medium in media), return_exceptions=True
            )
            assert isinstance(answers[1], dipole.Refused) and answers[1].field == "sigma_a"
            assert answers[0].R == answers[2].R
            with pytest.raises(dipole.Refused):
                await client.values("better", Medium(np.linspace(1, -1, 200), 1.0), np.ones(200))
            with pytest.raises(dipole.ArgumentError):
                await client.eval("no such model", SKIN, [1.0])
            assert (await client.eval("better", SKIN, [1.0])).R == answers[0].R

    run(ask())


def test_a_call_that_is_given_up_takes_no_other_with_it(shared):
    async def ask() -> None:
        async with AsyncClient(shared.url()) as client:
            radii = np.linspace(0, 9, 500_000)
            slow = asyncio.create_task(client.eval("better", SKIN, radii))
            quick = asyncio.create_task(client.eval("better", SKIN, [1.0]))
            await asyncio.sleep(0)  # The client now sends both requests.
            slow.cancel()
            assert (await quick).R > 0
            with pytest.raises(asyncio.CancelledError):
                await slow
            assert (await client.eval("better", SKIN, radii)).R.shape == (1, 500_000)

    run(ask())


def test_a_job_that_is_given_up_is_cancelled(shared):
    async def ask() -> None:
        async with AsyncClient(shared.url()) as client:
            reports = []

            def stop(progress: dipole.McProgress) -> bool:
                reports.append(progress)
                return False

            edges = Grid(0.0, 4.0, 5)
            result = await client.mc(SKIN, edges, photons=1_000_000_000, progress=stop)
            assert len(reports) == 1 and 0 < result.photons < 1_000_000_000
            job = asyncio.create_task(client.mc(SKIN, edges, photons=1_000_000_000))
            while (await client.statistics())["mc_jobs_open"] == 0:
                await asyncio.sleep(0.005)
            job.cancel()
            while (await client.statistics())["mc_jobs_open"] > 0:
                await asyncio.sleep(0.005)

    run(ask())


def test_a_closed_client(daemon):
    """The daemon stands still, so that the client is closed before the answer."""
    one = daemon()

    async def ask() -> None:
        client = AsyncClient(one.url())
        with pytest.raises(dipole.ArgumentError, match="not open"):
            await client.ping()
        await client.open()
        one.pause()
        waiting = asyncio.create_task(client.eval("better", SKIN, [1.0]))
        await asyncio.sleep(0)
        await client.close()
        await client.close()
        with pytest.raises(dipole.ConnectionLost, match="closed"):
            await waiting
        with pytest.raises(dipole.ConnectionLost, match="closed"):
            await client.ping()

    try:
        run(ask())
    finally:
        one.process.send_signal(signal.SIGCONT)


@pytest.mark.parametrize("timeout_s", [30.0, None])
def test_a_second_event_loop(shared, timeout_s):
    async def use() -> float:
        return float((await client.eval("better", SKIN, [1.0])).R[0, 0])

    async def open_and_use() -> float:
        async with client:
            return await use()

    client = AsyncClient(shared.url(), timeout_s)
    run(client.open())
    for call in (use, client.ping, client.statistics):
        with pytest.raises(dipole.ConnectionLost, match="another event loop opened this client"):
            run(call())
    assert run(open_and_use()) == run(open_and_use())  # it may be opened again
    loop = asyncio.new_event_loop()  # which stands still, and keeps its tasks
    loop.run_until_complete(client.open())
    with pytest.raises(dipole.ConnectionLost, match="another event loop opened this client"):
        run(use())
    child = os.fork()
    if child == 0:  # Closing its copy waits for nothing, and leaves the parent's loop alone.
        loop.run_until_complete(client.close())
        os._exit(0)
    assert os.waitpid(child, 0)[1] == 0 and loop.run_until_complete(use()) > 0
    loop.run_until_complete(client.close())
    loop.close()
    assert run(open_and_use()) > 0


@pytest.mark.parametrize("where", ["sending", "receiving"])
def test_an_exception_in_the_middle_of_a_frame(shared, monkeypatch, where):
    """The connection is given up. No call waits for what has been lost."""

    async def ask() -> None:
        async with AsyncClient(shared.url(), timeout_s=None) as client:
            before = client._session.connection

            def fail(*_) -> None:
                raise MemoryError

            if where == "sending":
                monkeypatch.setattr(before, "_send", fail)
            else:
                take = client._session.exchange.take
                monkeypatch.setattr(client._session.exchange, "take", fail)
            with pytest.raises(MemoryError):
                await client.eval("better", SKIN, [1.0])
            if where == "receiving":
                monkeypatch.setattr(client._session.exchange, "take", take)
            assert (await client.eval("better", SKIN, [1.0])).R > 0
            assert client._session.connection is not before

    run(ask())


# ---- a daemon that goes away ---------------------------------------------------------------------


def test_a_loss_while_much_is_being_sent(restarted):  # noqa: F811
    """When the connection is lost, calls that still wait to send their requests go on, and are
    answered."""
    radii = np.linspace(0.0, 9.0, 100_000)

    async def ask() -> None:
        async with AsyncClient(restarted.url, retry_s=RETRY_S) as client:
            expected = (await client.eval("better", SKIN, radii)).R
            calls = [asyncio.create_task(client.eval("better", SKIN, radii)) for _ in range(40)]
            await asyncio.sleep(0)
            await asyncio.to_thread(restarted.end, "kill")
            for result in await asyncio.gather(*calls):
                assert (result.R == expected).all()

    run(ask())
