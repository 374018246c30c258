"""A service manager passes listening sockets to the daemon, and waits for its notifications
(sd_notify)."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import dipole
import pytest
from daemons import END_S, PROGRAM, START_S, finished, run
from frames import PING, assert_serves, frame


# This program passes sockets as a service manager does, from descriptor 3 on, and then becomes the
# daemon, because LISTEN_PID must be the daemon's process.
BECOME_SERVICE = """
import fcntl, os, sys
count, *passed = map(int, sys.argv[1].split(","))
high = [fcntl.fcntl(fd, fcntl.F_DUPFD, 100) for fd in passed]
for at, fd in enumerate(high):
    os.dup2(fd, 3 + at, inheritable=True)
os.environ.update(LISTEN_FDS=str(count), LISTEN_PID=str(os.getpid()))
os.execv(sys.argv[2], sys.argv[2:])
"""


def passing(*sockets: socket.socket, count: int | None = None) -> dict:
    """Returns the arguments that start a daemon to which these sockets are passed. count: how many
    the daemon is told of."""
    numbers = tuple(one.fileno() for one in sockets)
    said = ",".join(map(str, [len(sockets) if count is None else count, *numbers]))
    prefix = [sys.executable, "-c", BECOME_SERVICE, said]
    return {"prefix": prefix, "pass_fds": numbers, "listen": []}


def start(*sockets: socket.socket, **how) -> subprocess.CompletedProcess[str]:
    """Runs a daemon that ends by itself."""
    passed = passing(*sockets, **how)
    return finished(*passed["prefix"], PROGRAM, pass_fds=passed["pass_fds"])


@pytest.fixture
def folder(tmp_path_factory) -> Path:
    """Returns a folder whose path is short enough for sockets."""
    return tmp_path_factory.mktemp("m")


@pytest.fixture
def unix_listener(folder):
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(f"{folder}/passed")
        one.listen()
        yield one


@pytest.fixture
def tcp_listener():
    with socket.create_server(("127.0.0.1", 0)) as one:
        yield one


def url_of(one: socket.socket) -> str:
    name = one.getsockname()
    return f"unix:{name}" if isinstance(name, str) else f"tcp:{name[0]}:{name[1]}"


class Manager:
    """The socket at which a service manager waits for notifications."""

    def __init__(self, name: str):
        self.name = name
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(name.replace("@", "\0", 1))
        self.socket.settimeout(START_S)

    def hear(self) -> list[str]:
        """Returns the lines of the next notification."""
        return self.socket.recv(4096).decode().splitlines()

    def has_word(self) -> bool:
        self.socket.setblocking(False)
        try:
            return bool(self.socket.recv(4096))
        except BlockingIOError:
            return False
        finally:
            self.socket.settimeout(START_S)


@pytest.fixture
def manager(folder):
    one = Manager(f"{folder}/word")
    yield one
    one.socket.close()


# ---- sockets -------------------------------------------------------------------------------------


def test_passed_sockets_are_served(daemon, unix_listener, tcp_listener):
    passed = [unix_listener, tcp_listener]
    one = daemon(**passing(*passed))
    assert one.urls == [url_of(listener) for listener in passed]
    for url in one.urls:
        with dipole.Client(url) as client:
            assert client.eval("better", dipole.Medium(0.0, 1.0), [1.0]).albedo[0] == 1.0


def test_passed_sockets_stay(daemon, unix_listener, tcp_listener):
    """Passed sockets stay open when the daemon ends: the manager still listens at them and can
    start another daemon."""
    passed = [unix_listener, tcp_listener]
    first = daemon(**passing(*passed))
    first.terminate()
    assert first.wait() == 0
    with dipole.Connection(url_of(unix_listener)) as waiting:
        waiting.send_bytes(frame(PING, 1))
        second = daemon(**passing(*passed))
        assert waiting.receive_frame().request_id == 1
        assert second.urls == first.urls


def test_listen_besides_passed_sockets(daemon, folder, unix_listener):
    how = passing(unix_listener)
    one = daemon(**{**how, "listen": [f"unix:{folder}/s"]})
    assert one.urls == [url_of(unix_listener), f"unix:{folder}/s"]
    for url in one.urls:
        with dipole.Connection(url) as connection:
            assert_serves(connection)


def test_an_abstract_socket(daemon, folder):
    name = f"dipoled-test-{os.getpid()}-{folder.name}"
    with socket.socket(socket.AF_UNIX) as one:
        one.bind(f"\0{name}")
        one.listen()
        daemon(**passing(one))
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(END_S)
            client.connect(f"\0{name}")
            client.sendall(frame(PING, 9))
            assert client.recv(24) == frame(PING | 0x8000, 9)


def test_sockets_for_another_process_are_left_alone(daemon, unix_listener):
    """The daemon ignores variables that it has inherited from its parent and that name another
    process."""
    env = {"LISTEN_FDS": "1", "LISTEN_PID": str(os.getpid())}
    one = daemon(env=env, pass_fds=(unix_listener.fileno(),))
    assert url_of(unix_listener) not in one.urls
    with one.connect() as connection:
        assert_serves(connection)


def test_what_is_no_listening_stream_socket():
    ours, theirs = socket.socketpair()
    datagrams = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    closed = socket.socket(socket.AF_INET)
    with ours, theirs, datagrams, closed:
        for wrong in (theirs, datagrams, closed):
            ended = start(wrong)
            assert ended.returncode == 1
            assert "descriptor 3: it is no stream socket that listens" in ended.stderr


@pytest.mark.parametrize("count", [-1, 33])
def test_a_wrong_number_of_sockets(count):
    ended = start(count=count)
    assert ended.returncode == 1 and "LISTEN_FDS" in ended.stderr


# ---- word ----------------------------------------------------------------------------------------


def test_word_of_readiness_and_of_stopping(daemon, manager, unix_listener):
    one = daemon(env={"NOTIFY_SOCKET": manager.name}, **passing(unix_listener))
    assert manager.hear() == ["READY=1", "STATUS=Serving."]
    with dipole.Connection(url_of(unix_listener)) as connection:
        assert_serves(connection)
    assert not manager.has_word()
    one.terminate()
    assert manager.hear() == ["STOPPING=1", "STATUS=Serving what is in flight."]
    assert one.wait() == 0
    assert not manager.has_word()


def test_no_word_of_readiness_without_it(manager, folder):
    ended = run("--listen", "nonsense", env={"NOTIFY_SOCKET": manager.name})
    assert ended.returncode == 1
    assert manager.hear()[0] == "STOPPING=1"
    assert not manager.has_word()


def test_a_private_daemon_has_no_word_for_its_users_manager(manager, monkeypatch):
    monkeypatch.setenv("NOTIFY_SOCKET", manager.name)
    with dipole.Client(f"private:{PROGRAM}") as client:
        client.ping()
    assert not manager.has_word()
