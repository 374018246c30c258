"""The Python client: its results, the requests that it refuses to send, and how it reports
errors."""

import contextlib
import copy
import inspect
import os
import pickle
import re
import shutil
import socket
import struct
import subprocess
import sys
import threading
from pathlib import Path

import dipole
import numpy as np
import pytest
from command_line import Proxy, busy
from daemons import BUILD, PROGRAM, REPOSITORY, environment, finished
from dipole import Grid, Medium, exchange, wire
from dipole import connection as connections
from frames import PING, SKIN, frame

THREE = [Medium(0.032, 0.74), Medium(0.17, 0.88), Medium(0.48, 1.01)]


def test_result_of_a_list(client):
    result = client.eval("better", THREE, [0.5, 1.0])
    assert (result.model, result.evaluator, result.moments) == ("better", "f64", "exact")
    assert result.R.shape == result.cdf.shape == (3, 2)
    assert result.albedo.shape == result.model_error.shape == (3,)
    assert result.R.dtype == result.albedo.dtype == np.float64
    np.testing.assert_array_equal(result.r, [0.5, 1.0])
    assert result.numerical_error().shape == (3, 2)
    assert result.numerical_error(4.0).shape == (3,)
    np.testing.assert_array_equal(result.numerical_error(0.0), result.numerical_error([0.0])[:, 0])


def test_result_of_a_grid(client):
    result = client.eval("classical", THREE[0], grid=Grid(0.0, 1.0, 5), evaluator="f32")
    assert result.R.dtype == result.r.dtype == np.float32
    np.testing.assert_array_equal(result.r, [0, 0.25, 0.5, 0.75, 1])
    assert result.R.shape == (1, 5)
    one, same = (client.eval("transport", THREE[0], **how) for how in ({"grid": Grid(0.5, 9.0, 1)}, {"r": [0.5]}))
    assert one.R == same.R and (one.model_error, one.numerical_error()) == (same.model_error, same.numerical_error())
    without = client.eval("classical", THREE[0], grid=Grid(0.0, 1.0, 5), wanted=["cdf"])
    assert not hasattr(without, "r") and not hasattr(without, "R") and without.cdf.shape == (1, 5)


def test_a_query_object_is_the_same_as_its_arguments(client):
    query = dipole.Query("better", THREE, grid=Grid(0.0, 2.0, 9), evaluator="f32")
    expected = client.eval("better", THREE, grid=Grid(0.0, 2.0, 9), evaluator="f32")
    assert_same_result(client.eval(query), expected)
    assert_same_result(client.collect(client.submit(query))[1], expected)
    [only] = client.eval_parts(query)
    assert_same_result(only, expected)
    for call in (client.eval, client.sample, client.mc):
        with pytest.raises(TypeError, match='parameters={"eta_below"'):
            call("better", THREE, [1.0], eta_below=1.3)
    for wrong in ({"r": [1.0]}, {"tolerence": 0.1}):
        with pytest.raises(TypeError):
            client.eval(query, **wrong)
    with pytest.raises(TypeError):
        client.eval("better", THREE, [1.0], Grid(0.0, 2.0, 9))


def test_media_may_be_given_in_many_ways(client):
    expected = client.eval("better", [SKIN, SKIN], [1.0]).R
    for media in ([Medium(*SKIN)] * 2, np.array([SKIN, SKIN]), (SKIN, SKIN), iter([SKIN, SKIN])):
        np.testing.assert_array_equal(client.eval("better", media, [1.0]).R, expected)
    np.testing.assert_array_equal(client.eval("better", SKIN, 1.0).R, expected[:1])


@pytest.mark.parametrize(
    "arguments, text",
    [
        ({"model": "worse"}, "classical, better"),
        ({"evaluator": "f16"}, "f64, f32"),
        ({"moments": "none"}, "exact, fit, jensen"),
        ({"wanted": ["R", "flux"]}, "R, albedo, cdf, r"),
        ({"r": [1.0], "grid": Grid(0.0, 1.0, 2)}, "not both"),
        ({"r": None, "grid": Grid(0.0, 1.0, 2, "cubic")}, "linear, logarithmic"),
        ({"r": None, "grid": Grid(0.0, 1.0, -2)}, "radius_count: "),
        ({"media": [1.0, 2.0]}, "array [C, 4]"),
        ({"r": [[1.0]]}, "array [N]"),
        ({"evaluator": 7}, "evaluator 7"),
        ({"model": 70000}, "model: "),
        ({"model": "bettr"}, "Did you mean better?"),
        ({"model": None}, "tolerance=0.01"),
        ({"media": "wholmilk"}, "Did you mean wholemilk?"),
        ({"media": ["a", "b"]}, "could not convert"),
        ({"media": Medium([0.1, 0.2], [1.0, 2.0])}, "give a list of Medium, or call values()"),
        ({"media": Medium(*np.full((4, 4), 0.5))}, "give a list of Medium, or call values()"),
        ({"r": None}, "give radii, or a grid"),
        ({"r": None, "wanted": ["R", "albedo"]}, "give radii, or a grid"),
        ({"r": ["near"]}, "r: one radius or an array [N]: could not convert"),
        ({"r": None, "grid": (0, 1, 2)}, "grid: a Grid"),
        ({"deadline_ms": -1}, "deadline_ms"),
    ],
)
def test_arguments_that_do_not_fit(client, arguments, text):
    call = {"model": "better", "media": SKIN, "r": [1.0], **arguments}
    with pytest.raises(dipole.ArgumentError) as caught:
        client.eval(call.pop("model"), call.pop("media"), call.pop("r"), **call)
    assert text in str(caught.value)
    assert client.eval("better", SKIN, [1.0]).R.shape == (1, 1)


def test_refusal(client):
    with pytest.raises(dipole.Refused) as caught:
        client.eval("better", [SKIN, Medium(-1.0, 1.0)], [1.0])
    refusal = caught.value
    assert (refusal.status, refusal.code) == ("bad-value", 6)
    assert (refusal.field, refusal.index) == ("sigma_a", 1)
    assert "1e15" in refusal.allowed and refusal.retry_after_ms == 0
    for part in ("bad-value", "sigma_a[1]", "1e15"):
        assert part in str(refusal)
    assert client.eval("better", SKIN, [1.0]).R.shape == (1, 1)


def test_the_name_of_a_measured_medium(client):
    skin = client.media()["skin1"]
    r = np.array([[0.5, 1.0], [2.0, 4.0]])
    np.testing.assert_array_equal(
        client.eval("better", "skin1", r[0]).R, client.eval("better", skin, r[0]).R
    )
    each = client.values("better", "skin1", r).values
    assert each.shape == (3, 2, 2)
    np.testing.assert_array_equal(each[:, 0], client.eval("better", skin, r[0]).R)
    for one_medium_only in (
        lambda: client.table("better", "skin1"),
        lambda: client.mc("skin1", Grid(0.0, 5.0, 6)),
    ):
        with pytest.raises(dipole.ArgumentError, match="one Medium or one .* not 3"):
            one_medium_only()
    with pytest.raises(dipole.ArgumentError, match="Did you mean skin1?"):
        client.values("better", "skim1", 1.0)


def test_the_error_is_the_largest_of_all_quantities(client):
    found = client.eval("better", SKIN, [1.0, 1000.0], wanted=["R", "albedo"])
    R, albedo = (found.numerical_error(quantity=name)[0] for name in ("R", "albedo"))
    assert R[1] > R[0] > 0 and albedo[1] == albedo[0] > 0  # that of R grows with the radius
    np.testing.assert_array_equal(found.numerical_error()[0], np.maximum(R, albedo))


def test_a_quantity_that_was_not_wanted_is_named(client):
    result = client.eval("better", SKIN, [1.0], wanted="cdf")
    assert list(result.values) == ["cdf"]
    assert list(client.eval("better", SKIN, [1.0]).values) == ["R", "cdf"]
    assert list(client.eval(None, SKIN, [1.0], tolerance=0.01).values) == ["R"]
    with pytest.raises(AttributeError, match="R: was not wanted. The result has: cdf, r"):
        result.R


def test_what_is_printed_fits_three_lines(client):
    r = np.linspace(0.1, 9.0, 500)
    apart = ("S", "phase", "modulation", "phase_f", "modulation_f", "balance")
    whole = [name for name in client.info.choices["quantity"] if name not in apart]
    with client.__class__() as private:
        shown = [repr(private)]
    assert "private:" in shown[0]
    shown += map(repr, [
        client, client.info, dipole.AsyncClient("unix:/nowhere"),
        client.table("better", SKIN),
        client.eval("better", THREE, r),
        client.eval("better", THREE, grid=Grid(0.1, 9.0, 500), wanted=whole),
        client.eval("better", SKIN, wanted=["albedo"]),
        client.sample("better", THREE, draw=dipole.Draw(500)),
        client.sample("better", THREE, draw=dipole.Draw(500), wanted=[*whole, "S"]),
        client.offers(THREE, r, tolerance=0.01), client.offers(SKIN, r, tolerance=1e-12),
        client.values("better", "skin1", r),
        client.invert("better", np.full((40, 50), 0.3), 1.0),
        client.mc((*SKIN[:4], 3.0), Grid(0.0, 5.0, 51), photons=4096, albedos=[0.5, 0.9]),
    ])  # fmt: skip
    for text in shown:
        assert text.count("\n") < 3 and max(map(len, text.splitlines())) <= 102, text
        assert re.fullmatch(r"<\w+: (.|\n)+>|<\w+: (.|\n)+ \.\.\.", text), text
    closed = dipole.Client(client.info.address)
    closed.close()
    assert "closed" in repr(closed)


def test_the_version_is_that_of_the_daemon(client):
    assert client.info.software == f"dipoled {dipole.__version__}"


@pytest.mark.parametrize(
    "before, said",
    [
        ("sys.modules['numpy'] = None", r"numpy, which .* python3-numpy .* -m pip install numpy"),
        ("sys.version_info = (3, 9)", r"Python 3\.11 or newer"),
    ],
)
def test_an_unfit_python_is_told_what_to_do(before, said):
    run = finished(
        sys.executable, "-c", f"import sys; {before}; import dipole",
        env=environment(PYTHONPATH=str(REPOSITORY / "clients/python"))
    )
    assert run.returncode == 1
    assert re.match(f"ImportError: dipole needs {said}", run.stderr.splitlines()[-1])


def test_parameters(client):
    angles = {"cos_in": 0.5, "cos_out": 0.25}
    answer = client.eval("better", THREE, [1.0], wanted=["S", "2_pi_r_R"], parameters=angles)
    assert answer.S.shape == answer.two_pi_r_R.shape == (3, 1)
    assert set(answer.values) == {"S", "2_pi_r_R"}
    np.testing.assert_array_equal(answer.values["S"], answer.S)
    np.testing.assert_array_equal(answer.values["2_pi_r_R"], answer.two_pi_r_R)
    assert not hasattr(answer, "R") and not hasattr(answer, "albedo")
    again = client.submit("better", THREE, [1.0], wanted=["S"], parameters=angles)
    assert dict([client.collect()])[again].S.tobytes() == answer.S.tobytes()
    as_text = {"cos_in": "0.5", "cos_out": np.float32(0.25)}
    np.testing.assert_array_equal(
        client.eval("better", THREE, [1.0], wanted=["S"], parameters=as_text).S, answer.S
    )
    assert not hasattr(client.eval("better", SKIN, [1.0], parameters={}), "S")


@pytest.mark.parametrize(
    "parameters, text",
    [
        ({"cosine": 1}, "parameter cosine: not one of tolerance, cos_in"),
        ({"cos_in": "steep"}, "parameter cos_in: 'steep' is no number"),
        ({"cos_in": None}, "parameter cos_in: None is no number"),
        ({"fit_model": "best"}, "model best: not one of classical, better"),
        ({70000: 1.0}, "parameter:"),
    ],
)
def test_parameters_that_do_not_fit(client, parameters, text):
    with pytest.raises(dipole.ArgumentError) as caught:
        client.eval("better", SKIN, [1.0], parameters=parameters)
    assert text in str(caught.value)
    assert client.eval("better", SKIN, [1.0]).R.shape == (1, 1)


def test_submit_and_collect(client):
    queries = {client.submit("better", SKIN, [0.1 * i]): 0.1 * i for i in range(1, 51)}
    between = client.eval("better", SKIN, [7.0])
    client.ping(b"between ")
    bad = client.submit("better", SKIN, [-1.0])
    collected = {}
    refused = []
    for _ in range(51):
        try:
            request_id, result = client.collect()
            collected[request_id] = result
        except dipole.Refused as refusal:
            refused.append((refusal.request_id, refusal.field))
    assert refused == [(bad, "r")]
    assert set(collected) == set(queries)
    for request_id, result in collected.items():
        alone = client.eval("better", SKIN, [queries[request_id]])
        np.testing.assert_array_equal(result.R, alone.R)
    assert between.r[0] == 7.0
    with pytest.raises(dipole.ArgumentError):
        client.collect()


# ---- answers in parts ----------------------------------------------------------------------------


@pytest.fixture
def small(daemon):
    """Returns a client of a daemon whose parts are small."""
    with daemon("--max-frame-bytes", "65536", "--max-part-bytes", "32768").client() as one:
        yield one


def assert_same_result(one: dipole.Result, other: dipole.Result, radii=slice(None)) -> None:
    """Checks that a result is the same, bit for bit, as that for some of the radii of another."""
    for field in ("model", "evaluator", "moments", "notes"):
        assert getattr(one, field) == getattr(other, field)
    np.testing.assert_equal(one.errors, other.errors)
    assert one.quantities.keys() == other.quantities.keys()
    if "albedo" in one.quantities:
        np.testing.assert_array_equal(one.albedo, other.albedo)
    for name in one.values:
        np.testing.assert_array_equal(one.values[name], other.values[name][:, radii])
    if "r" in other.quantities:
        np.testing.assert_array_equal(one.r, other.r[radii])


def test_parts_among_others(small):
    """Answers in parts, some of which are read part by part, and short answers, all at once."""
    grid = Grid(0.0, 5.0, 10_000)
    expected = small.eval("better", SKIN, grid=grid)
    ids = [small.submit("better", SKIN, grid=grid) for _ in range(3)]
    first = small.eval_parts("better", SKIN, grid=grid)
    second = small.eval_parts("better", SKIN, grid=grid)
    short = small.submit("better", SKIN, [1.0])
    parts = [next(first), next(second)]
    assert small.eval("better", SKIN, [1.0]).R.shape == (1, 1)
    assert small.ping() > 0
    parts += [*second, *first]
    assert sum(part.R.shape[1] for part in parts) == 20_000
    collected = dict(small.collect() for _ in range(4))
    assert sorted(collected) == sorted([*ids, short])
    for request_id in ids:
        assert_same_result(collected[request_id], expected)


def test_parts_that_are_not_wanted(small):
    grid = Grid(0.0, 5.0, 10_000)
    with small.eval_parts("better", SKIN, grid=grid) as parts:
        next(parts)
    assert list(parts) == []
    unread = small.eval_parts("better", SKIN, grid=grid)
    del unread
    left = small.eval_parts("better", SKIN, grid=grid)
    left.close()
    left.close()
    assert len(list(small.eval_parts("better", SKIN, grid=grid))) > 3
    with pytest.raises(dipole.ArgumentError):
        small.collect()


def test_a_part_of_a_larger_answer():
    """It is refused at once, before its items are handed on. test_messages.py has other lies."""
    replies = exchange.InParts("invert_reply", 4, {"model": 2}, lambda whole: whole)
    items = dict.fromkeys(("sigma_a", "sigma_s", "albedo"), bytes(8 * 5))
    with pytest.raises(dipole.ProtocolError, match="another count than was requested"):
        replies.add(wire.PAYLOADS["invert_reply"].pack({"part_count": 2, "count": 5, "model": 2}, **items))


def test_much_may_be_submitted_before_anything_is_collected(client):
    """A client may submit megabytes of requests before it collects answers: neither end waits for
    the other forever."""
    r = np.linspace(0, 10, 50_000)
    ids = [client.submit("better", SKIN, r) for _ in range(30)]
    results = dict(client.collect() for _ in ids)
    assert sorted(results) == ids
    assert all(np.array_equal(results[i].R, results[ids[0]].R) for i in ids)


def test_ping(client):
    assert 0 < client.ping() < 10
    assert client.ping(bytes(1024)) > 0
    for payload in (b"odd", bytes(1032)):
        with pytest.raises(dipole.ArgumentError):
            client.ping(payload)


NO_ADDRESSES = [
    *["nonsense", "unix:", "tcp:", "tcp:h", "tcp:h:", "tcp::1", "tcp:h:99999", "http:x"],
    *["tcp:a:1, tcp:b:2", "tcp:a:1;tcp:b:2", "tcp:a:1,b:2"],
]


@pytest.mark.parametrize("address", NO_ADDRESSES)
def test_addresses_that_cannot_be_understood(address):
    with pytest.raises(dipole.AddressError) as caught:
        dipole.Client(address)
    assert address in str(caught.value)


def run_in_clone(folder: Path, has_build: bool, **variables: str):
    """Runs a program that imports the module of a fresh clone. PATH and DIPOLED are not set."""
    shutil.copytree(Path(dipole.__file__).parent, folder / "clients/python/dipole")
    if has_build:
        (folder / "build").mkdir()
        (folder / "build/dipoled").symlink_to(PROGRAM)
    program = "import dipole\nwith dipole.Client() as client: print(client.info.address)"
    env = environment(PYTHONPATH=str(folder / "clients/python"), PATH="", **variables)
    command = [sys.executable, "-c", program]
    return finished(*command, cwd=folder, env=env)


def test_daemon_of_a_clone(tmp_path):
    """The module of a clone finds the daemon of that clone, which serves no other client and writes
    nothing. A folder of that name beside the program is no daemon."""
    (tmp_path / "dipoled").mkdir()
    listen = f"unix:{tmp_path}/s"
    run = run_in_clone(tmp_path, True, DIPOLED_LISTEN=listen)
    assert (run.returncode, run.stdout, run.stderr) == (0, "private:\n", "")
    assert not (tmp_path / "s").exists()


def test_errors_of_a_private_daemon_appear(tmp_path):
    run = run_in_clone(tmp_path, True, DIPOLED_WORKERS="many")
    assert run.returncode != 0 and "many" in run.stderr.splitlines()[0]


@pytest.mark.parametrize("address, closing", [("private:", "<&-"), ("unix", ">&- 2>&-"),
                                              *((one, "<&- >&- 2>&-") for one in ("private:", "tcp"))])  # fmt: skip
def test_no_socket_gets_the_number_of_a_closed_standard_stream(shared, tmp_path, closing, address):
    """What a program in C, or a child, writes to its standard output must not reach the daemon."""
    address = f"private:{PROGRAM}" if address == "private:" else shared.url(address)
    done = tmp_path / "done"
    program = f"""import os, dipole
with dipole.Client({address!r}) as client:
    for fd in range(3):
        try:
            os.write(fd, b"text")
        except OSError:
            pass
    client.eval("better", "skin1", [1.0])
    open({str(done)!r}, "x")
"""
    python = [sys.executable, "-c", program]
    shell = ["sh", "-c", f'exec "$@" {closing}', "sh", *python]
    path = os.pathsep.join(sys.path)
    run = finished(*shell, env=environment(PYTHONPATH=path))
    assert run.returncode == 0 and done.exists(), run.stderr


def test_no_daemon_to_start(tmp_path):
    run = run_in_clone(tmp_path, False)
    assert run.returncode != 0 and "ConnectError: private: there is no dipoled" in run.stderr


def test_daemon_from_the_path(monkeypatch):
    monkeypatch.delenv("DIPOLED", raising=False)
    monkeypatch.setenv("PATH", str(PROGRAM.parent))
    with dipole.Client() as client:
        assert client.info.address == client.address == "private:"
        assert client.ping() > 0


def test_address_from_the_environment(monkeypatch, shared):
    monkeypatch.setenv("DIPOLED", shared.url("tcp"))
    with dipole.Client() as client:
        assert client.info.address == shared.url("tcp")


def answer_with(data: bytes) -> tuple[str, threading.Thread]:
    """Starts a server that answers the first bytes of one connection with data, and closes it."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with server, server.accept()[0] as connection:
            connection.recv(4096)
            connection.sendall(data)

    thread = threading.Thread(target=serve)
    thread.start()
    return f"tcp:127.0.0.1:{server.getsockname()[1]}", thread


HELLO_REPLY = wire.MESSAGES["hello"] | wire.REPLY
STRANGERS = {
    "http": (b"HTTP/1.1 400 Bad Request\r\nServer: somebody else\r\n\r\n", dipole.ProtocolError),
    "nothing": (b"", dipole.ConnectError),
    "half a header": (frame(HELLO_REPLY, 1)[:10], dipole.ConnectError),
    "half a payload": (frame(HELLO_REPLY, 1, bytes(112))[:-1], dipole.ConnectError),
    "short hello": (frame(HELLO_REPLY, 1, bytes(8)), dipole.ProtocolError),
    "counts that do not fit": (frame(HELLO_REPLY, 1, b"\x01" * 112), dipole.ProtocolError),
    "another type": (frame(PING | wire.REPLY, 1, bytes(112)), dipole.ProtocolError),
    "another id": (frame(HELLO_REPLY, 9, bytes(112)), dipole.ProtocolError),
    "short error": (frame(wire.TYPE_ERROR, 1, bytes(8)), dipole.ProtocolError),
}


@pytest.mark.parametrize("name", STRANGERS)
def test_a_stranger_at_the_address(name):
    data, error = STRANGERS[name]
    address, thread = answer_with(data)
    with pytest.raises(error):
        dipole.Client(address, retry_s=0)
    thread.join(10)
    assert not thread.is_alive()


def test_timeout():
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp:127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(dipole.ConnectError) as caught:
            dipole.Client(address, timeout_s=0.1, retry_s=0)
    assert "nothing moved for 0.1 s. The daemon may still be at work: " in str(caught.value)


def test_closing_twice_is_fine(shared):
    client = shared.client()
    client.close()
    client.close()
    with pytest.raises(dipole.ConnectionLost):
        client.ping()


def error_classes(base: type = dipole.DipoleError) -> list[type]:
    return [base, *(one for sub in base.__subclasses__() for one in error_classes(sub))]


@pytest.mark.parametrize("kind", error_classes())
@pytest.mark.parametrize("again", [copy.copy, copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
def test_errors_can_be_pickled_and_copied(kind, again):
    if kind is dipole.Refused:
        error = kind("busy", 5, "r", "less", 3, 10, 77)
    elif kind in (dipole.ConnectError, dipole.ConnectionLost):
        error = kind("text", final=True)
    else:
        error = kind("text")
    error.add_note("a note")
    other = again(error)
    assert type(other) is kind and (str(other), vars(other)) == (str(error), vars(error))


class Interrupts(socket.socket):
    """Takes a socket over. Call number `number` of a method is interrupted, before or after it."""

    def prepare(self, method: str, number: int, after: bool):
        self._left = {method: number}
        self._after = after
        return self

    def _interrupted(self, method: str, *arguments):
        self._left[method] = self._left.get(method, 0) - 1
        if self._left[method] == 0 and not self._after:
            raise KeyboardInterrupt
        done = getattr(super(), method)(*arguments)
        if self._left[method] == 0:
            raise KeyboardInterrupt
        return done

    def send(self, *arguments):
        return self._interrupted("send", *arguments)

    def recv_into(self, *arguments):
        return self._interrupted("recv_into", *arguments)


@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize("method", ["send", "recv_into"])
@pytest.mark.parametrize("retry_s", [0, 5])
def test_an_interrupt_in_the_middle_of_a_frame(shared, method, number, after, retry_s):
    """The client goes on over another connection, or says that this one is given up."""
    r = np.linspace(0, 9, 400_000)  # header and payload go apart
    with dipole.Client(shared.url(), retry_s=retry_s) as client:
        expected = client.eval("better", SKIN, r).R
        waiting = client.submit("better", SKIN, r[:3])
        connection = client._session.connection
        taken = Interrupts(fileno=connection.socket.detach())
        connection.socket = taken.prepare(method, number, after)
        with pytest.raises(KeyboardInterrupt):
            client.eval("better", SKIN, r)
        for _ in range(2):
            if retry_s == 0:
                with pytest.raises(dipole.ConnectionLost, match="in the middle of a frame"):
                    client.eval("better", SKIN, r[:5])
            else:
                np.testing.assert_array_equal(client.eval("better", SKIN, r[:5]).R, expected[:, :5])
        if retry_s > 0:
            np.testing.assert_array_equal(client.collect(waiting)[1].R, expected[:, :3])
            assert not client._session.exchange._pending


def test_an_interrupt_while_the_client_waits(shared, monkeypatch):
    """Nothing is lost then: the connection stays."""

    def interrupted(*_):
        raise KeyboardInterrupt

    with shared.client() as client:
        waiting = client.submit("better", SKIN, [1.0])
        with monkeypatch.context() as patch:
            patch.setattr(connections, "_poll", interrupted)
            with pytest.raises(KeyboardInterrupt):
                client.collect(waiting)
        before = client._session.connection
        assert client.collect(waiting)[1].R > 0 and client._session.connection is before


def test_a_client_that_was_refused_sleeps_until_its_time(daemon, monkeypatch):
    asked, polls, poll = [], [], connections._poll
    monkeypatch.setattr(connections, "_poll", lambda *how: polls.append(how) or poll(*how))

    def refuse_the_first(number: int, request_id: int) -> bytes | None:
        asked.append(number)
        return busy(request_id, 300) if len(asked) == 1 else None

    with Proxy(daemon().url(), refuse_the_first) as proxy, dipole.Client(proxy.url) as client:
        assert client.eval("better", SKIN, [1.0]).R > 0
    assert len(asked) == 2 and len(polls) < 30


GOOD_CALLS = [
    'eval("better", m, [1.0], wanted=["R"], deadline_ms=9)', 'eval(Query("better", m, 1.0))',
    'submit("better", "skin1", r=1.0, wanted="R")', 'values("better", m, 1.0, "R", evaluator="f32")',
    'sample("better", m, [0.5], wanted="r")', 'sample("better", m, draw=Draw(5))',
    'offers(m, 1.0, tolerance=0.1)', 'table("better", m, tolerance=1e-3)',
    'surface("transport", 0.5, evaluator="f64")', 'invert("better", 0.5, 1.0, g=0.1)',
    'varying("better", sigma_a=1, sigma_s=1, r=1, wanted="R")',
    'gather("better", m, Points([[0, 0, 0]], [1]), [[1, 2, 3]], progress=lambda a, b: True)',
    'mc(m, Grid(0, 1, 2), photons=2e3, progress=lambda now: now.photons > 0)',
    'fit("better", [1, 2], [0.01, 0.002], 1e-4, axis="r", eta=1.4, deadline_ms=9000)',
]  # fmt: skip
BAD_CALLS = [
    'eval("better", m, [1.0], wanted=3)', 'eval("better", m, [1.0], want=["R"])', 'eval("better")',
    'eval("better", m, [1.0], None, "f64", "exact")', 'eval(Query("better", m, 1.0), wanted="R")',
    'submit("better", m, [1.0], wanted=3)', 'eval_parts("better", m, [1.0], want="R")',
    'values("better", m, 1.0, wanted="R")', 'sample("better", m, [0.5], None)',
    'sample("better", m, [0.5], r=[1.0])', 'offers(m, 1.0, want="R")', 'table("better", m, r=[1.0])',
    'surface("transport", 0, 1.3, "f32")', 'invert("better", 0.5, 1.0, "mean-free-path")',
    'varying("better", want="R")', 'varying("better", sigma_a=1, sigma_s=1, r=1, wanted=3)',
    'gather("better", m)', 'gather("better", m, Points([[0, 0, 0]], [1]), [[1, 2, 3]], 0.1)',
    'mc(m, Grid(0, 1, 2), 2000)', 'mc(m, Grid(0, 1, 2), photon=2000)', 'mc(m)',
    'fit("better", [1, 2], [1, 1], 1, "r", "absolute")',
]  # fmt: skip


def test_calls_have_signatures(client, tmp_path):
    """A call that does not fit fails, and mypy finds it, too; also where it is awaited."""
    names = {"c": client, "m": Medium(*SKIN), **vars(dipole)}
    for call in GOOD_CALLS:
        eval("c." + call, names)
    for call in BAD_CALLS:
        with pytest.raises((TypeError, dipole.ArgumentError)):
            eval("c." + call, names)
    assert "wanted" in str(inspect.signature(dipole.AsyncClient.eval))
    text = "from dipole import *\n\nm = Medium(1, 1)\nasync def run(c: Client, a: AsyncClient) -> None:\n"
    calls = [*GOOD_CALLS, *BAD_CALLS]
    awaited = [one for one in calls if not one.startswith(("submit", "eval_parts"))]
    lines = [f"    c.{one}" for one in calls] + [f"    await a.{one}" for one in awaited]
    (tmp_path / "calls.py").write_text(text + "\n".join(lines) + "\n")
    checked = finished(
        sys.executable, "-m", "mypy", "--strict", "--enable-incomplete-feature=Unpack",
        "--cache-dir", str(BUILD / "mypy"), "calls.py", cwd=tmp_path,
        env=environment(MYPYPATH=str(REPOSITORY / "clients/python"))
    )
    if "No module named mypy" in checked.stderr:
        pytest.skip("mypy is not installed")
    found = {int(line.split(":")[1]) - 5 for line in checked.stdout.splitlines() if ": error: " in line}
    bad = {i for i, line in enumerate(lines) if line.split(".", 1)[1] in BAD_CALLS}
    assert found == bad, checked.stdout

# ---- requests ------------------------------------------------------------------------------------

OTHER = {
    "axis": "f", "scale": "free", "moments": "jensen", "light": "diffuse", "specular": True, "draw": dipole.Draw(3, 7),
    "given": "diffuse-mean-free-path", "haemoglobin": "ucl", "evaluator": "f64", "wanted": ["cdf"], "quantity": "phase",
    "coefficients": ["sigma_s"], "residuals": True, "model_error": False, "name": "liver", "model": "better",
    "deadline_ms": 54321, "seed": 77, "photons": 4096.0, "tolerance": 0.0123, "g": 0.71, "eta": 1.37, "thickness": 2.75,
    "source": [0.21, 0.22], "detector": [0.31, 0.32], "mhz": [81.0, 82.0], "detector_na": 0.41, "error_total": 0.043,
    "error_rings": 0.054, "albedos": [0.91, 0.82], "parameters": {"cos_in": 0.65}, "properties": {"fat_fraction": 0.17},
    "reference": Medium(0.013, 1.7, 0.2, 1.4), "grid": Grid(0.6, 4.7, 5), "u": [0.55, 0.66],
}  # fmt: skip
AT, VALUES, ERRORS = [1.11, 2.22], [0.0333, 0.00444], [0.000555, 0.0000666]
NO_ERRORS = [0, 0]  # are refused before anything is solved
# Calls: arguments, which others are left out, and numbers in the order in which a request has them.
REQUESTS = {
    "fit": (("better", AT, VALUES, ERRORS), {"eta": 1.4}, [], ["g", "eta", "thickness", "source", "detector"]),
    "fit_layers": ((dipole.Stack(Medium(0.1, 2, 0, 1.4, 1), Medium(0.2, 3)), ["sigma_a_1"], AT, VALUES, NO_ERRORS), {}, [], []),
    "fit_tissue": ((["hb_uM"], [650.5], AT, [VALUES], [ERRORS]), {}, [], ["source", "detector", "mhz"]),
    "mc": ((Medium(0.1, 2), Grid(0.3, 5.2, 3)), {"photons": 100}, ["progress"], ["error_total", "error_rings"]),
    "invert": (("better", 0.44, 1.3), {}, [], ["g", "eta"]),
    "gather": (("better", "skin1", dipole.Points([[1, 2, 3]], [1.0]), [[0.5, 0, 0]]), {}, ["progress"], []),
    "varying": (("better",), {"colour": 0.44, "length": 1.3}, ["sigma_a", "sigma_s", "colour", "length", "r"], ["g", "eta"]),
    "tissue": (([650.5],), {}, [], []),
    "surface": (("better",), {}, ["evaluator"], ["g", "eta"]),
    "table": (("better", THREE[0]), {}, [], []),
    "sample": (("better", "skin1", [0.1, 0.2]), {}, ["u", "draw"], []),
    "eval": (("better", "skin1", [0.5]), {}, ["r", "grid"], []),
    "offers": (("skin1", [0.5]), {"tolerance": 0.1}, ["r", "grid"], []),
}


@pytest.mark.parametrize("call", REQUESTS)
def test_each_argument_is_in_the_request(client, monkeypatch, call):
    arguments, base, left_out, order = REQUESTS[call]
    sent = []

    def pieces(type: int, request_id: int, payload: bytes = b"", deadline_ms: int = 0) -> list[bytes]:
        sent.append((bytes(payload), deadline_ms))
        return connections.frame_pieces(type, request_id, payload, deadline_ms)

    def asked(**more: object) -> tuple[bytes, int]:
        sent.clear()
        with contextlib.suppress(dipole.Refused):
            getattr(client, call)(*arguments, **{**base, **more})
        return sent[0]

    monkeypatch.setattr(exchange, "frame_pieces", pieces)
    usual = asked()
    names = list(inspect.signature(getattr(dipole.Client, call)).parameters)[1 + len(arguments) :]
    for name in set(names) - set(left_out):
        assert asked(**{name: OTHER[name]}) != usual, name
    payload = asked(**{name: OTHER[name] for name in order})[0]
    numbers = [one for name in order for one in np.ravel(OTHER[name])]
    places = [payload.find(struct.pack("<d", one)) for one in numbers]
    assert places == sorted(places) and -1 not in places, dict(zip(numbers, places))
