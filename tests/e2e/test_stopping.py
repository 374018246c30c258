"""After SIGTERM the daemon accepts nothing new, answers the requests in flight, and exits with
status 0."""

import os
import pty
import signal
import socket
import subprocess

import pytest
from certificates import Authority
from daemons import END_S, PROGRAM, environment, eventually, read_log_line
from dipole import Client, ConnectError, Connection, ConnectionLost, Frame, wire
from frames import EVAL, PING, ask, assert_closed, assert_error, assert_serves, eval_payload, frame, statistics
from test_metrics import fetch

LARGE = eval_payload(radii=None, radius_count=200_000)


def refused(url: str) -> bool:
    """Returns whether no daemon listens at an address any more."""
    try:
        with Connection(url) as connection:
            ask(connection, PING)
        return False
    except (ConnectError, ConnectionLost):
        return True


def test_every_connection_is_told(daemon):
    one = daemon()
    connections = [one.connect(scheme) for scheme in ("unix", "tcp") * 5]
    for connection in connections:
        assert_serves(connection)
    one.terminate()
    for connection in connections:
        assert_error(connection.receive_frame(), "shutting-down", "daemon", "another one", request_id=0)
        assert_closed(connection)
        connection.close()
    assert one.wait() == 0
    assert refused(one.url("unix")) and refused(one.url("tcp"))


@pytest.mark.parametrize("scheme, how", [("unix", signal.SIGTERM), ("tcp", signal.SIGHUP)])
def test_requests_in_flight_are_answered_and_nobody_new(daemon, scheme, how):
    """A client has not yet read its answers, so the daemon is still running."""
    one = daemon("--drain-timeout-ms", "60000")
    with one.connect(scheme) as slow:
        expected = ask(slow, EVAL, LARGE).payload
        slow.send_bytes(b"".join(frame(EVAL, i, LARGE) for i in range(30)))
        replies = [slow.receive_frame()]  # After the first reply, all requests have arrived.
        one.terminate(how)
        assert eventually(lambda: refused(one.url("tcp")) and refused(one.url("unix")))
        assert one.process.poll() is None
        replies += [slow.receive_frame() for _ in range(29)]
        assert replies == [Frame(EVAL | wire.REPLY, i, expected) for i in range(30)]
        assert_error(slow.receive_frame(), "shutting-down", "daemon", "another one", request_id=0)
        assert_closed(slow)
    assert one.wait() == 0
    assert any(f"event=stopping reason={how.name}" in line for line in one.log)
    assert one.log[-1].endswith("event=stopped")


def test_a_partial_frame_does_not_hold_it_up(daemon):
    one = daemon()
    with one.connect() as connection:
        connection.send_bytes(frame(PING, 4) + frame(EVAL, 5, LARGE)[:50])
        assert connection.receive_frame().request_id == 4
        one.terminate()
        last = connection.receive_frame()
        assert last.type == wire.TYPE_ERROR
        assert_closed(connection)
    assert one.wait() == 0
    assert not any("drain-timeout" in line for line in one.log)
    assert any("event=stopping reason=SIGTERM" in line for line in one.log)


def test_a_drain_that_times_out_says_what_it_abandons(daemon):
    """A client never reads the answers to ten requests, another one has read all of its own."""
    one = daemon("--drain-timeout-ms", "300")
    with one.connect() as slow, one.connect() as quick:
        slow.send_bytes(b"".join(frame(EVAL, i, LARGE) for i in range(1, 11)))
        slow.receive_frame()
        ask(quick, PING)
        one.terminate()
        assert one.wait() == 0
    (line,) = [line for line in one.log if "event=drain-timeout" in line]
    assert "level=error" in line and " drain_timeout_ms=300" in line
    assert read_log_line(line)["connections"] == "1"


def test_jobs_of_http_end_with_their_client_and_with_the_daemon(daemon):
    one = daemon("--http", "127.0.0.1:0", "--drain-timeout-ms", "300")
    host, port = one.url("http").removeprefix("http://").strip("/").split(":")
    numbers = ",".join(map(str, range(100_000, 900_000, 40)))
    body = f'{{"albedo":[{numbers.replace(",", "e-6,")}e-6],"length":[{",".join("1" * 20_000)}],"eta":1.37}}'
    head = f"POST /v1/invert HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: {len(body)}"

    def post() -> socket.socket:
        made = socket.create_connection((host, int(port)))
        made.sendall(f"{head}\r\n\r\n{body}".encode())
        assert eventually(lambda: statistics(watcher)["owed_radii"] > 0)
        return made

    def unanswered() -> int:
        now = statistics(watcher)
        return now["requests_statistics"] + now["requests_invert"] - now["replies_ok"]

    with one.connect() as watcher:
        before = unanswered()
        post().close()
        assert eventually(lambda: statistics(watcher)["owed_radii"] == 0)
        assert unanswered() == before + 1
        with post():
            one.terminate()
            assert one.wait() == 0
    (line,) = [line for line in one.log if "event=drain-timeout" in line]
    assert read_log_line(line)["connections"] == "1"


def test_hanging_up_is_ignored_under_nohup(daemon):
    one = daemon(prefix=["env", "--ignore-signal=HUP"])
    one.process.send_signal(signal.SIGHUP)
    with one.connect() as connection:
        assert_serves(connection)
    assert not any("event=stopping" in line for line in one.log)


def test_health_and_metrics_until_the_end(daemon):
    one = daemon("--metrics", "127.0.0.1:0", "--drain-timeout-ms", "60000")
    assert fetch(one, "/healthz")[0] == 200
    with one.connect() as slow:
        slow.send_bytes(frame(EVAL, 1, LARGE) * 10)
        slow.receive_frame()
        one.terminate()
        assert eventually(lambda: fetch(one, "/healthz")[0] == 503)
        assert fetch(one, "/healthz")[2] == "draining\n"
        assert fetch(one, "/readyz")[::2] == (503, "draining\n")
        status, _, text = fetch(one, "/metrics")
        assert status == 200 and "dipoled_connections_open 1\n" in text
        for _ in range(9):
            slow.receive_frame()
    assert one.wait() == 0


ENDS = {
    "pipe": os.pipe,
    "terminal": pty.openpty,
    "socket": lambda: tuple(end.detach() for end in socket.socketpair()),
}


@pytest.mark.parametrize("kind", ENDS)
def test_a_log_that_nobody_reads_holds_nobody_up(tmp_path, kind):
    """Standard error is full from the beginning. The lines that are dropped are counted, in the
    statistics and in the next lines that get through."""
    ours, theirs = ENDS[kind]()

    def fill() -> None:
        os.set_blocking(theirs, False)
        with pytest.raises(BlockingIOError):
            while True:
                os.write(theirs, b"filling\n" * 64)
        os.set_blocking(theirs, True)

    fill()
    pem, key = Authority(tmp_path).sign("farm")
    options = [f"--listen=unix:{tmp_path}/s", "--listen=tls:127.0.0.1:0"]
    options += [f"--certificate={pem}", f"--key={key}"]
    process = subprocess.Popen([PROGRAM, *options], stderr=theirs, env=environment())
    try:
        assert eventually(lambda: not refused(f"unix:{tmp_path}/s"))
        with Client(f"unix:{tmp_path}/s") as client:

            def dropped() -> int:
                process.send_signal(signal.SIGHUP)  # which reads the certificates, and logs that
                return client.statistics()["log_lines_dropped"]

            assert eventually(lambda: dropped() >= 5)
            told, text = 0, ""
            os.set_blocking(ours, False)

            def all_told() -> bool:
                nonlocal told, text
                count = dropped()
                try:
                    text += os.read(ours, 65536).decode()
                except BlockingIOError:
                    pass
                told = sum(int(read_log_line(line).get("dropped", 0)) for line in text.split("\n"))
                return count == told

            assert eventually(all_told)
            assert "event=ready" in text and told >= 5
        fill()
        process.terminate()
        assert process.wait(END_S) == 0
    finally:
        process.kill()
        process.wait()
        os.close(ours)
        os.close(theirs)
