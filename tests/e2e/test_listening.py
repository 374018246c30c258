"""The daemon's addresses: Unix sockets, TCP, several of them, or one connection that it
inherits."""

import os
import re
import socket
import subprocess
import urllib.request
from pathlib import Path

import dipole
import pytest
from daemons import BUILD, END_S, PROGRAM, environment, eventually, finished, read_log_line, run, sanitized
from frames import EVAL, PING, ask, assert_serves, eval_payload, frame


@pytest.fixture
def folder(tmp_path_factory) -> Path:
    """Returns a folder whose path is short enough for sockets."""
    return tmp_path_factory.mktemp("l")


def has_ipv6() -> bool:
    """Returns whether the loopback of this machine has an IPv6 address."""
    try:
        with socket.socket(socket.AF_INET6) as one:
            one.bind(("::1", 0))
        return True
    except OSError:
        return False


def test_several_addresses(daemon, folder):
    listen = [f"unix:{folder}/a", "tcp:127.0.0.1:0", f"unix:{folder}/b", "tcp:localhost:0"]
    listen += ["tcp:[::1]:0"] if has_ipv6() else []
    one = daemon(listen=listen)
    assert len(set(one.urls)) == len(one.urls) >= len(listen)
    assert {url.split(":")[0] for url in one.urls} == {"unix", "tcp"}
    for url in one.urls:
        with dipole.Connection(url) as connection:
            assert_serves(connection)


def test_socket_file_goes_when_the_daemon_does(daemon, folder):
    one = daemon(listen=[f"unix:{folder}/s"])
    assert (folder / "s").is_socket()
    one.close()
    assert not (folder / "s").exists()


def test_stale_socket_file_is_replaced(daemon, folder):
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(folder / "s"))
        dead.listen()
    assert (folder / "s").is_socket()
    with daemon(listen=[f"unix:{folder}/s"]).connect() as connection:
        assert_serves(connection)


def test_live_socket_file_is_left_alone(daemon, folder):
    one = daemon(listen=[f"unix:{folder}/s"])
    second = run("--listen", f"unix:{folder}/s")
    assert second.returncode == 1
    assert f"unix:{folder}/s" in second.stderr and "in use: end the program that has it" in second.stderr
    with one.connect() as connection:
        assert_serves(connection)


def test_the_socket_file_of_another_daemon_is_left_alone(daemon, folder):
    first = daemon(listen=[f"unix:{folder}/s"])
    (folder / "s").unlink()
    with daemon(listen=[f"unix:{folder}/s"]).connect() as connection:
        first.terminate()
        assert first.wait() == 0
        assert (folder / "s").is_socket()
        assert_serves(connection)


# Makes two.invalid a name of two addresses, one of them twice, and of one that no machine has.
TWO = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <netdb.h>
#include <string.h>
int getaddrinfo(const char *host, const char *port, const struct addrinfo *hints, struct addrinfo **found) {
  int (*next)(const char *, const char *, const struct addrinfo *, struct addrinfo **) = dlsym(RTLD_NEXT, "getaddrinfo");
  if (host == NULL || strcmp(host, "two.invalid") != 0) return next(host, port, hints, found);
  const char *hosts[] = {"192.0.2.1", "127.0.0.1", "127.0.0.2", "127.0.0.1"};
  for (int i = 3; i >= 0; i--) {
    struct addrinfo *one;
    next(hosts[i], port, hints, &one);
    if (i < 3) one->ai_next = *found;
    *found = one;
  }
  return 0;
}
void freeaddrinfo(struct addrinfo *found) { (void)found; }
"""


@pytest.mark.skipif(sanitized(), reason="a sanitizer has to be loaded before TWO")
def test_all_addresses_of_a_name(daemon, folder):
    (folder / "two.c").write_text(TWO)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", "two.so", "two.c", "-ldl"], cwd=folder, check=True)
    env = {"LD_PRELOAD": str(folder / "two.so")}
    options = ["--modbus", "tcp:two.invalid:0", "--http", "two.invalid:0", "--metrics", "two.invalid:0"]
    one = daemon(*options, listen=["tcp:two.invalid:0"], env=env)
    hosts = [url.rpartition(":")[0] for url in one.urls]
    assert hosts == [f"{way}127.0.0.{n}" for way in ("tcp:", "modbus-tcp:", "http://") for n in (1, 2)]
    metrics = [read_log_line(line)["url"] for line in one.log if "event=metrics" in line]
    assert [url.rpartition(":")[0] for url in metrics] == ["http://127.0.0.1", "http://127.0.0.2"]
    for url in [f"{url}/healthz" for url in one.urls[4:]] + metrics:
        with urllib.request.urlopen(url, timeout=END_S) as answer:
            assert answer.status == 200
    for url in one.urls[:2]:
        with dipole.Connection(url) as connection:
            assert_serves(connection)
    with socket.socket() as taken:  # all or none
        taken.bind(("127.0.0.2", 0))
        taken.listen()
        ended = run("--listen", f"tcp:two.invalid:{taken.getsockname()[1]}", env=env)
        assert ended.returncode == 1 and "Address already in use" in ended.stderr


@pytest.mark.skipif(not has_ipv6(), reason="this machine has no IPv6")
@pytest.mark.parametrize("turned", [False, True])
def test_all_addresses_of_both_kinds(daemon, turned):
    with socket.socket() as free:  # holds the port until the daemon has it
        free.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
        listen = [f"tcp:[::]:{port}", f"tcp:0.0.0.0:{port}"]
        one = daemon(listen=listen[::-1] if turned else listen)
    assert sorted(one.urls) == sorted(listen)
    for host in ("[::1]", "127.0.0.1"):
        with dipole.Connection(f"tcp:{host}:{port}") as connection:
            assert_serves(connection)
    assert finished(BUILD / "dipole", "media", "--connect", f"tcp:localhost:{port}").returncode == 0
    with dipole.Client(one.url("tcp")) as client:  # the command took one of two addresses
        assert client.statistics()["connections_accepted"] == 4


@pytest.mark.parametrize(
    "first, second",
    [("--listen unix:{0}/s", "--listen unix:{0}/s"),
     ("--listen tcp:127.0.0.1:{1}", "--listen tcp:127.0.0.1:{1}"),
     ("--listen tcp:localhost:{1}", "--modbus tcp:0.0.0.0:{1}"),
     ("--listen unix:{0}/s", "--listen unix:{0}/../{2}/s"),
     ("--listen tcp:127.0.0.1:{1}", "--listen tcp:[::ffff:127.0.0.1]:{1}"),
     ("--listen tcp:127.0.0.1:{1}", "--http {1}"),
     ("--metrics {1}", "--listen tcp:0.0.0.0:{1}"),
     ("--modbus rtu:/none", "--modbus rtu:/none,9600")],
)  # fmt: skip
def test_the_same_address_twice(folder, first, second):
    with socket.socket() as free:
        free.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        free.bind(("127.0.0.1", 0))
        ended = run(*f"{first} {second}".format(folder, free.getsockname()[1], folder.name).split())
    assert ended.returncode == 1 and re.search("Address already in use|name each device once", ended.stderr)
    assert not (folder / "s").exists()


# ---- who may connect -----------------------------------------------------------------------------


class From(dipole.Connection):
    """A connection from an address of this machine, which has sent a ping."""

    def __init__(self, source: str, url: str):
        self.source = source
        super().__init__(url)
        self.send_frame(PING, 1)

    def _open(self) -> socket.socket:
        host, port = self.address.removeprefix("tcp:").rsplit(":", 1)
        return socket.create_connection((host, int(port)), 10, (self.source, 0))


def test_who_is_allowed_over_tcp(daemon, folder):
    allow = ["--allow", "10.0.0.0/8", "--allow", "127.0.0.8/31", "--allow", "::1"]
    one = daemon(*allow, listen=[f"unix:{folder}/s", "tcp:127.0.0.1:0"])
    for source in ("127.0.0.8", "127.0.0.9"):
        with From(source, one.url("tcp")) as connection:
            assert connection.receive_frame().payload == b""
            assert_serves(connection)
    for source in ("127.0.0.1", "127.0.0.7", "127.0.0.10"):
        with From(source, one.url("tcp")) as connection:
            refused = dipole.wire.ERROR.unpack(connection.receive_frame().payload)
            assert refused.status == 14 and refused.field == "allow"
            assert connection.receive_eof()
        assert one.has_line(f"event=connection-refused status=not-allowed field=allow peer={source}")
    with one.connect("unix") as connection:
        assert_serves(connection)
    with one.client("unix") as client:
        assert client.statistics()["connections_refused"] == 3
        assert eventually(lambda: client.statistics()["connections_open"] == 1)


def test_a_client_that_is_not_allowed_does_not_try_again(daemon):
    one = daemon("--allow", "10.0.0.0/8", listen=["tcp:127.0.0.1:0"])
    with pytest.raises(dipole.Refused, match="not-allowed: allow") as refused:
        one.client("tcp")
    assert refused.value.status == "not-allowed"
    said = finished(BUILD / "dipole", "media", "--connect", one.url("tcp"))
    assert said.returncode != 0 and "not-allowed: allow: allowed: addresses" in said.stderr
    with one.connect("tcp"):
        pass
    assert sum("event=connection-refused" in line for line in one.log) <= 3


# ---- an inherited connection ---------------------------------------------------------------------


SERVES_OTHERS = ["LISTEN", "MODBUS", "HTTP", "METRICS", "SCPI"]


def start_with_fd(one: socket.socket, *options: str) -> subprocess.Popen[str]:
    """Starts a dipoled that serves a socket of this process."""
    return subprocess.Popen(
        [str(PROGRAM), "--fd", str(one.fileno()), *options],
        pass_fds=[one.fileno()],
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env=environment(**{f"DIPOLED_{name}": "no address, which it ignores" for name in SERVES_OTHERS}),
        text=True,
    )


def exchange(one: socket.socket, request: bytes, reply_bytes: int) -> bytes:
    """Sends a request and reads reply_bytes bytes."""
    one.sendall(request)
    return receive(one, reply_bytes)


def receive(one: socket.socket, reply_bytes: int) -> bytes:
    """Reads reply_bytes bytes, or until the end of the stream."""
    one.settimeout(END_S)
    reply = b""
    while len(reply) < reply_bytes and (more := one.recv(reply_bytes - len(reply))):
        reply += more
    return reply


def test_fd_serves_and_ends_with_the_connection(shared):
    ours, theirs = socket.socketpair()
    with theirs:
        process = start_with_fd(theirs, "--workers", "1")
    with shared.connect() as connection:
        expected = ask(connection, EVAL, eval_payload(), request_id=5).payload
    reply = exchange(ours, frame(EVAL, 5, eval_payload()), 24 + len(expected))
    assert reply[24:] == expected
    assert process.poll() is None
    ours.close()
    _, log = process.communicate(timeout=END_S)
    assert process.returncode == 0, log
    assert "listening" not in log


def test_fd_answers_what_came_before_the_end():
    with socket.create_server(("127.0.0.1", 0)) as server:
        ours = socket.create_connection(server.getsockname())
        theirs, _ = server.accept()
    with theirs:
        process = start_with_fd(theirs)
    ours.sendall(frame(PING, 1) * 1000)
    ours.shutdown(socket.SHUT_WR)
    assert len(receive(ours, 24 * 1000 + 1)) == 24 * 1000
    ours.close()
    process.communicate(timeout=END_S)
    assert process.returncode == 0


def test_fd_of_a_datagram_socket():
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as wrong:
        process = start_with_fd(wrong)
        _, log = process.communicate(timeout=END_S)
    assert process.returncode in (1, 2) and "--fd" in log


@pytest.mark.parametrize("besides", [[], ["--modbus", "tcp:127.0.0.1:0"]])
def test_the_usual_addresses(folder, besides):
    """Without --listen, the daemon listens at its default addresses, with or without Modbus. If the
    default port is in use on this machine, it must say so."""
    process = subprocess.Popen(
        [str(PROGRAM), *besides],
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        env={**environment(XDG_RUNTIME_DIR=str(folder)), "RUNTIME_DIRECTORY": ""},
        text=True,
    )
    lines = []
    try:
        for line in process.stderr:
            lines.append(line)
            if "event=ready" in line:
                process.terminate()
        process.wait(END_S)
    finally:
        process.kill()
        process.wait()
        process.stderr.close()
    log = "".join(lines)
    assert f"url=unix:{folder}/dipoled.sock" in log
    assert "url=tcp:127.0.0.1:4817" in log or "tcp:127.0.0.1:4817: " in log
    assert process.returncode == (0 if "event=ready" in log else 1)


def accepts(path: Path) -> bool:
    """Returns whether somebody listens at a path, which exists a moment before that."""
    with socket.socket(socket.AF_UNIX) as one:
        return one.connect_ex(str(path)) == 0


@pytest.mark.parametrize("closing", ["<&-", ">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_closed_standard_streams_are_nobody_elses(folder, closing):
    """Nothing that the daemon opens gets their numbers, which log lines would go into."""
    command = [str(PROGRAM), "--listen", f"unix:{folder}/s", "--listen", "tcp:127.0.0.1:0"]
    process = subprocess.Popen(
        ["sh", "-c", f'exec "$@" {closing}', "sh", *command],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment(),
    )  # fmt: skip
    try:
        assert eventually(lambda: accepts(folder / "s"))
        links = [os.readlink(f"/proc/{process.pid}/fd/{fd}") for fd in range(3)]
        assert links.count("/dev/null") == len(closing.split()) + ("2>" not in closing), links
        assert all(link == "/dev/null" or link.startswith("pipe:") for link in links), links
        with dipole.Connection(f"unix:{folder}/s") as connection:
            assert_serves(connection)
    finally:
        process.terminate()
    process.communicate(timeout=END_S)
    assert process.returncode == 0


def test_a_daemon_that_lacks_descriptors_says_so():
    """Below 6 descriptors, libuv itself ends the process."""
    for limit in range(6, 64):
        ours, theirs = socket.socketpair()
        ours.close()
        with theirs:
            ended = finished(
                "prlimit", f"--nofile={limit}:{limit}", PROGRAM, "--fd", "0", "--log-level", "error",
                "--workers", "2", "--metrics", "127.0.0.1:0", "--http", "127.0.0.1:0",
                stdin=theirs, env=environment(ASAN_OPTIONS="detect_leaks=0"),  # that opens files
            )  # fmt: skip
        if ended.returncode == 0:
            break
        assert ended.returncode == 1, (limit, ended)
        assert re.fullmatch(r"dipoled: .*(oo many open files|does not start).*\n", ended.stderr), ended
    assert ended.returncode == 0 and limit > 6
