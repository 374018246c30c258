"""The binary protocol through TLS: who gets in, whose certificates are believed, bad peers, and
certificates that change under load."""

import asyncio
import ctypes
import functools
import os
import random
import select
import signal
import socket
import ssl
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import dipole
import numpy as np
import pytest
from beside import Beside
from certificates import FLOODS, Authority, Recorder, openssl
from daemons import BUILD, HANG_S, PROGRAM, environment, eventually, finished, run, sanitized
from dipole import wire
from dipole.exchange import is_temporary
from frames import PING, SKIN, assert_error, assert_serves, frame
from messages import ROLES, SAMPLES, receive_answer, refusal

RADII = np.linspace(0.1, 5.0, 65536)
TLS = "tls:127.0.0.1:0"

# How many half-open handshakes, and fuzzed connections: 10000 in `make check-ci`.
MANY = int(os.environ.get("TLS_HANDSHAKES", "600"))
RECORDS = int(os.environ.get("TLS_RECORDS", "1000"))  # with faults: 1000000 there


@pytest.fixture(scope="module")
def authority(tmp_path_factory):
    return Authority(tmp_path_factory.mktemp("tls"))


@pytest.fixture(scope="module")
def server(authority):
    return authority.sign("server")


@pytest.fixture(scope="module")
def ours(authority):
    """Returns the files of a client whose certificate the daemon believes."""
    certificate, key = authority.sign("client")
    return {"ca": str(authority.pem), "certificate": certificate, "key": key}


def options(server, *others: str) -> list[str]:
    return ["--certificate", server[0], "--key", server[1], *others]


@pytest.fixture
def farm(daemon, authority, server):
    """Returns a daemon that asks its clients for certificates."""
    mutual = options(server, "--client-ca", str(authority.pem))
    return daemon(*mutual, listen=["tls:127.0.0.1:0", "tcp:127.0.0.1:0"])


def port_of(one) -> int:
    return int(one.url("tls").rpartition(":")[2])


def expected(radii=RADII):
    with dipole.Client(f"private:{PROGRAM}") as client:
        return client.eval("better", SKIN, radii).R


def counters(one) -> dict[str, int]:
    with one.client("tcp") as client:
        return client.statistics()


# ---- answers -------------------------------------------------------------------------------------


def test_same_bits_through_tls(farm, ours):
    right = expected()
    with dipole.Client(farm.url("tls"), **ours) as client:
        assert (client.eval("better", SKIN, RADII).R == right).all()
        small = [client.submit("better", SKIN, RADII[:16]) for _ in range(300)]
        large = [client.submit("better", SKIN, RADII) for _ in range(8)]
        for one in small:
            assert (client.collect(one)[1].R == right[..., :16]).all()
        for one in large:
            assert (client.collect(one)[1].R == right).all()
        assert client.mc(dipole.Medium(0.05, 1.0), dipole.Grid(0.0, 5.0, 3), photons=2000)

    async def ask():
        async with dipole.AsyncClient(farm.url("tls"), **ours) as client:
            return await asyncio.gather(*(client.eval("better", SKIN, RADII) for _ in range(12)))

    assert all((answer.R == right).all() for answer in asyncio.run(ask()))


def least_ticks(one) -> int:
    """Returns how long the less busy one of two workers, or of their helpers, has had a processor."""
    stats = [(thread / "stat").read_text() for thread in Path(f"/proc/{one.process.pid}/task").iterdir()]
    return sorted(sum(map(int, stat.split()[13:15])) for stat in stats if "(worker)" in stat)[-2]


@pytest.mark.parametrize("scheme", ["tls", "tcp"])
def test_clients_with_large_requests_share_the_workers(farm, ours, scheme):
    """Of four clients, the two stay that have the same worker, and ask without end, one of them with
    further requests behind: then one of the two moves to the other worker, and no bit differs."""
    medium, tls = dipole.Medium(0.03, 0.74, 0.1, 1.3), ours if scheme == "tls" else {}
    with ExitStack() as stack:
        clients = [stack.enter_context(dipole.Client(farm.url(scheme), **tls)) for _ in range(4)]
        right = clients[0].eval("single", medium, RADII, wanted="R").R
        clients[1].close(), clients[3].close()
        waiting = [clients[2].submit("single", medium, RADII, wanted="R") for _ in range(3)]

        def ask() -> None:
            assert (clients[0].eval("single", medium, RADII, wanted="R").R == right).all()

        def ask_ahead() -> None:
            waiting.append(clients[2].submit("single", medium, RADII, wanted="R"))
            assert (clients[2].collect(waiting.pop(0))[1].R == right).all()

        idle = least_ticks(farm)
        with Beside(ask), Beside(ask_ahead):
            assert eventually(lambda: least_ticks(farm) > idle + 20)


def test_a_client_that_half_closes_gets_its_answers(farm, ours):
    with dipole.Connection(farm.url("tls"), tls=dipole.Tls(**ours)) as connection:
        for number in range(50):
            connection.send_frame(5, number, b"12345678")
        connection.half_close()
        for number in range(50):
            assert connection.receive_frame().request_id == number
        assert connection.receive_eof()


def test_command_line_and_its_environment(farm, ours):
    words = ["eval", "--medium", "skin1", "--model", "better", "--r", "0.5,1", "--format", "csv"]

    def ask(*arguments: str, **variables: str):
        return finished(BUILD / "dipole", *words, *arguments, env=environment(**variables))

    private = ask("--connect", f"private:{PROGRAM}").stdout
    files = [text for name, value in ours.items() for text in (f"--{name}", value)]
    assert private and ask("--connect", farm.url("tls"), *files).stdout == private
    variables = {f"DIPOLED_{name.upper()}": value for name, value in ours.items()}
    assert ask(DIPOLED=farm.url("tls"), **variables).stdout == private
    # One of several addresses; the first one is nobody's.
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        several = f"tls:127.0.0.1:{closed.getsockname()[1]},{farm.url('tls')},{farm.url('tcp')}"
        assert ask(DIPOLED=several, **variables).stdout == private
    # A private daemon is not confused by the clients' variables.
    assert ask("--connect", f"private:{PROGRAM}", **variables).stdout == private


def test_too_many_connections_are_told_so(daemon, server, ours):
    one = daemon("--max-connections", "1", *options(server), listen=["tls:127.0.0.1:0"])
    with dipole.Client(one.url("tls"), ca=ours["ca"]) as client:
        with pytest.raises(dipole.Refused, match="busy: max_connections"):
            dipole.Client(one.url("tls"), ca=ours["ca"], retry_s=0)
        client.ping()


def test_allow_holds_for_tls(daemon, server, ours):
    one = daemon("--allow", "10.0.0.0/8", *options(server), listen=["tls:127.0.0.1:0"])
    with pytest.raises(dipole.ConnectError):
        dipole.Client(one.url("tls"), ca=ours["ca"], retry_s=0)
    assert one.has_line("event=tls-refused peer=127.0.0.1") and "not-allowed" in one.log[-1]


# ---- certificates --------------------------------------------------------------------------------


def media(url: str, files: dict[str, str]) -> str:
    """Returns what `dipole media` says that cannot connect."""
    words = [text for name, value in files.items() for text in (f"--{name}", value)]
    ended = finished(BUILD / "dipole", "media", "--connect", url, "--retry-ms", "0", *words)
    assert ended.returncode == 1
    return ended.stderr


@pytest.mark.parametrize("who", ["none", "expired", "of another CA", "signed by itself"])
def test_clients_that_are_not_believed(farm, authority, ours, tmp_path, who):
    files = {"ca": ours["ca"]}
    if who == "expired":
        files["certificate"], files["key"] = authority.sign("old", days=-1)
    elif who == "of another CA":
        files["certificate"], files["key"] = Authority(tmp_path).sign("client")
    elif who == "signed by itself":
        other = Authority(tmp_path, "alone")
        files["certificate"], files["key"] = str(other.pem), str(tmp_path / "alone.key")
    refusal = "requires a certificate" if who == "none" else "refuses this client's certificate"
    with pytest.raises(dipole.ConnectionLost, match=refusal) as caught:
        dipole.Client(farm.url("tls"), **files)
    assert caught.value.final and not is_temporary(caught.value)
    assert refusal in media(farm.url("tls"), files)
    assert farm.has_line("event=tls-refused peer=127.0.0.1")
    with dipole.Client(farm.url("tls"), **ours) as client:
        client.ping()


@pytest.mark.parametrize("what", ["expired", "wrong host", "wrong CA", "system's CAs"])
def test_daemons_that_are_not_believed(daemon, authority, server, ours, tmp_path, what):
    ca = {"wrong CA": str(Authority(tmp_path).pem), "system's CAs": None}.get(what, ours["ca"])
    if what == "expired":
        server = authority.sign("late", days=-1)
    elif what == "wrong host":
        server = authority.sign("elsewhere", hosts="DNS:elsewhere.invalid,IP:127.0.0.2")
    one = daemon(*options(server), listen=["tls:127.0.0.1:0"])
    why = {"expired": "expired", "wrong host": "mismatch|not valid for"}.get(what, "certificate")
    with pytest.raises(dipole.ConnectError, match=why):
        dipole.Client(one.url("tls"), ca=ca)
    assert "its certificate: " in media(one.url("tls"), {"ca": ca} if ca else {})


def test_plain_and_tls_do_not_mix(farm, ours):
    """Each side says what is the matter."""
    plain, secure = farm.url("tcp").replace("tcp:", "tls:"), farm.url("tls").replace("tls:", "tcp:")
    with pytest.raises(dipole.ConnectError, match="is it a tcp: address"):
        dipole.Client(plain, **ours, retry_s=0)
    assert "is it a tcp: address" in media(plain, ours)
    assert farm.has_line("this is TLS, which needs a tls: address")
    with pytest.raises(dipole.DipoleError, match="is it a tls: address"):
        dipole.Client(secure, retry_s=0)
    assert "is it a tls: address" in media(secure, {})
    assert farm.has_line("the peer does not speak TLS")
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"tls:127.0.0.1:{silent.getsockname()[1]}"
        assert "TLS handshake: Connection timed out" in media(url, {"timeout-ms": "100"})


@pytest.mark.parametrize(
    "files, said",
    [
        ([], "--listen tls:HOST:PORT needs --certificate FILE and --key FILE"),
        (["--certificate", "{pem}"], "--listen tls:HOST:PORT needs --certificate FILE"),
        (["--certificate", "/none", "--key", "{key}"], "/none: No such file or directory"),
        (["--certificate", "{pem}", "--key", "/none"], "/none: No such file or directory"),
        (["--certificate", "{pem}", "--key", "{other}"], "{other}: this is not the key of --certificate"),
        (["--certificate", "{key}", "--key", "{key}"], "{key}: "),
        (["--certificate", "{pem}", "--key", "{key}", "--client-ca", "{key}"], "{key}: "),
        (["--certificate", "/dev/null", "--key", "{key}"], "/dev/null: the file has no such content in PEM"),
        (["--certificate", "{pem}", "--key", "{pem}"], "{pem}: the file has no such content in PEM"),
    ],
)
def test_wrong_files(authority, server, ours, files, said):
    names = {"pem": server[0], "key": server[1], "other": ours["key"]}
    ended = run("--listen", "tls:127.0.0.1:0", *(text.format(**names) for text in files))
    assert ended.returncode == 1
    assert f"dipoled: {said.format(**names)}" in ended.stderr


def test_a_key_with_a_password_asks_nobody(farm, server, ours, tmp_path):
    locked = str(tmp_path / "locked.key")
    openssl("ec", "-in", server[1], "-aes128", "-passout", "pass:secret", "-out", locked)
    ended = run("--listen", "tls:127.0.0.1:0", "--certificate", server[0], "--key", locked)
    assert ended.returncode == 1 and f"dipoled: {locked}: the key has a password" in ended.stderr
    files = {**ours, "key": locked}
    for key in (locked, ours["certificate"], "/dev/null", server[1]):
        with pytest.raises(dipole.ConnectError, match=f"the key {key} is not that of {ours['certificate']}"):
            dipole.Client(farm.url("tls"), **{**ours, "key": key})
    with pytest.raises(dipole.ConnectError, match="without a certificate"):
        dipole.Client(farm.url("tls"), ca=ours["ca"], key=ours["key"])
    assert f"the key {locked} has a password" in media(farm.url("tls"), files)


# ---- roles ---------------------------------------------------------------------------------------

ROLE = "1.3.6.1.4.1.50316.802.1=ASN1:UTF8String:"


def roles_of(url: str, files: dict[str, str]) -> set[str]:
    """Returns the roles that a client has, by what the daemon refuses: each message has one or none."""
    found = {}
    with dipole.Connection(url, tls=dipole.Tls(**files) if files else None) as connection:
        for message, payload in SAMPLES.items():
            connection.send_bytes(frame(wire.MESSAGES[message], 77, payload))
            first, _ = receive_answer(connection)
            refused = refusal(first) == "not-allowed"
            role = ROLES.get(message)
            if refused:
                assert_error(first, "not-allowed", "role", f"certificates with the role {role}")
            assert found.setdefault(role, refused) == refused, message
    assert not found.pop(None)
    return {role for role, refused in found.items() if not refused}


def test_roles_by_subject_and_by_extension(daemon, authority, server, ours, tmp_path):
    file = tmp_path / "roles"
    file.write_text(
        "# roles           who\n\n"
        "evaluate          subject:CN=node7\n"
        "compute,evaluate  role:Engineer\n"
        "observe           subject:CN=clock\n"
        "observe           role:Engineer\n"
    )
    mutual = options(server, "--client-ca", str(authority.pem), "--roles", str(file))
    one = daemon(*mutual, listen=["tls:127.0.0.1:0", "tcp:127.0.0.1:0"])
    people = {
        "node7": ("", {"evaluate"}),
        "clock": ("", {"observe"}),
        "nobody": ("", set()),
        "smith": (ROLE + "Engineer", {"evaluate", "compute", "observe"}),
        "jones": (ROLE + "Engineers", set()),
        "brown": ("1.3.6.1.4.1.50316.802.1=ASN1:INTEGER:1", set()),
    }
    for name, (lines, roles) in people.items():
        certificate, key = authority.sign(name, lines=lines)
        files = {"ca": ours["ca"], "certificate": certificate, "key": key}
        assert roles_of(one.url("tls"), files) == roles, name
        if name == "node7":  # A connection keeps its roles; the file's new ones are for others.
            with dipole.Client(one.url("tls"), **files) as client:
                client.eval("better", SKIN, [1.0])
                file.write_text("compute *\n")
                one.process.send_signal(signal.SIGHUP)
                assert one.has_line("event=tls-reloaded")
                client.eval("better", SKIN, [1.0])
                assert roles_of(one.url("tls"), ours) == {"compute"}
                file.write_text("observe *\nnonsense\n")
                one.process.send_signal(signal.SIGHUP)
                assert one.has_line("event=tls-not-reloaded") and "line 2" in one.log[-1]
                file.write_text(
                    "observe subject:CN=clock\nevaluate,compute,observe role:Engineer\n"
                )
                one.process.send_signal(signal.SIGHUP)
                assert eventually(lambda: sum("tls-reloaded" in line for line in one.log) == 2)
    assert roles_of(one.url("tcp"), {}) == {"evaluate", "compute", "observe"}


@pytest.mark.parametrize(
    "text, said",
    [
        ("nonsense *", "line 1: write roles first: evaluate, compute, observe, read or write"),
        ("\nevaluate", "line 2: write subject:TEXT, role:NAME or * behind the roles"),
        ("evaluate subject:", "line 1: write subject:TEXT"),
        ("evaluate,all *", "line 1: write roles first"),
        (", *", "line 1: write roles first"),
        ("read:300-420 *", "line 1: write roles first"),
        ("evaluate " + "x" * 3000, "line 1: the line is too long"),
        ("evaluate *\n" * 1002, "line 1001: the file has too many lines"),
    ],
)
def test_wrong_files_of_roles(server, tmp_path, text, said):
    file = tmp_path / "roles"
    file.write_text(text)
    ended = run("--listen", TLS, *options(server, "--client-ca", server[0], "--roles", str(file)))
    assert ended.returncode == 1 and f"dipoled: {file}: {said}" in ended.stderr


def test_a_file_of_roles_that_is_missing(server):
    ended = run("--listen", TLS, *options(server, "--client-ca", server[0], "--roles", "/none"))
    assert ended.returncode == 1 and "/none: No such file or directory" in ended.stderr


@pytest.mark.parametrize("listen", ["tls:127.0.0.1:0", "tcp:127.0.0.1:0"])
def test_roles_need_certificates_of_clients(server, listen):
    ended = run("--listen", listen, *options(server, "--roles", "/dev/null"))
    assert ended.returncode == 1 and "dipoled: --roles: it needs --client-ca FILE" in ended.stderr


def test_certificates_need_an_address_with_tls(daemon, server):
    """A client's own certificate may stand in the same environment. tests/cli/dipoled.t has options."""
    with daemon(env={"DIPOLED_CERTIFICATE": server[0], "DIPOLED_KEY": server[1]}).connect() as connection:
        assert_serves(connection)


# ---- reloading -----------------------------------------------------------------------------------


def serial_of(one, ours) -> str:
    context = dipole.Tls(**ours).context()
    with socket.create_connection(("127.0.0.1", port_of(one)), 10) as plain:
        with context.wrap_socket(plain, server_hostname="localhost") as wrapped:
            return wrapped.getpeercert()["serialNumber"]


def assert_same_R(client: dipole.Client, R: np.ndarray) -> None:
    assert (client.eval("better", SKIN, RADII[:2000]).R == R).all()


def test_certificates_are_reloaded_under_load(daemon, authority, ours, tmp_path):
    """No connection ends, the new certificate is used from then on, and a file that cannot be read
    changes nothing."""
    pem, key = tmp_path / "farm.pem", tmp_path / "farm.key"

    def renew(name: str) -> None:
        for made, place in zip(authority.sign(name), (pem, key)):
            place.write_bytes(open(made, "rb").read())

    renew("first")
    mutual = ["--client-ca", str(authority.pem)]
    one = daemon(*options((str(pem), str(key)), *mutual), listen=["tls:127.0.0.1:0"])
    with ExitStack() as stack:
        loads = []
        for _ in range(4):
            client = stack.enter_context(dipole.Client(one.url("tls"), **ours, retry_s=0))
            act = functools.partial(assert_same_R, client, client.eval("better", SKIN, RADII[:2000]).R)
            loads.append(stack.enter_context(Beside(act)))
        serials = [serial_of(one, ours)]
        for turn in range(5):
            renew(f"renewed{turn}")
            before = [load.done for load in loads]
            one.process.send_signal(signal.SIGHUP)
            assert eventually(lambda: sum("event=tls-reloaded" in x for x in one.log) == turn + 1)
            serials.append(serial_of(one, ours))
            assert eventually(lambda: all(x.failure or x.done > n for x, n in zip(loads, before)))
        assert len(set(serials)) == 6
        openssl("ec", "-in", ours["key"], "-aes128", "-passout", "pass:secret", "-out", str(key))
        one.process.send_signal(signal.SIGHUP)
        assert one.has_line(f"event=tls-not-reloaded file={key} reason=the key has a password")
        key.write_text("nonsense")
        one.process.send_signal(signal.SIGHUP)
        assert one.has_line(f"event=tls-not-reloaded file={key} reason=the file has no such content")
        assert serial_of(one, ours) == serials[-1]


# ---- peers that are rude -------------------------------------------------------------------------


def begun_handshake(ours) -> tuple[ssl.MemoryBIO, ssl.MemoryBIO, ssl.SSLObject]:
    """Returns what arrives at a client and what leaves it, its first flight, and the client."""
    arriving, leaving = ssl.MemoryBIO(), ssl.MemoryBIO()
    session = dipole.Tls(**ours).context().wrap_bio(arriving, leaving, server_hostname="localhost")
    with pytest.raises(ssl.SSLWantReadError):
        session.do_handshake()
    return arriving, leaving, session


def hello_bytes(ours) -> bytes:
    """Returns the first flight of a client."""
    return begun_handshake(ours)[1].read()


# Begins handshakes and leaves them, of every second one before the first byte, and keeps the last
# 700 of them open until a line arrives. Arguments: the port, their number, the first flight.
FLOOD = """
import os, socket, sys
os.nice(10)
port, many, first = int(sys.argv[1]), int(sys.argv[2]), bytes.fromhex(sys.argv[3])
kept = []
for number in range(many):
    one = socket.create_connection(("127.0.0.1", port), 60)
    if number % 2:
        one.send(first)
    kept.append(one)
    if len(kept) > 700:
        kept.pop(0).close()
print("done", flush=True)
sys.stdin.readline()
"""


def test_half_open_handshakes_keep_nobody_out(farm, ours):
    """MANY clients begin a handshake and leave it: half of them before the first byte. Others are
    served meanwhile, also new ones, and the daemon's memory does not grow with their number."""
    words = [str(port_of(farm)), str(MANY), hello_bytes(ours).hex()]
    with dipole.Client(farm.url("tls"), **ours) as client:
        before_bytes, rounds = farm.resident_bytes(), 0
        with subprocess.Popen(
            [sys.executable, "-c", FLOOD, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as flood:
            while rounds < 5 or not select.select([flood.stdout], [], [], 0)[0]:
                assert client.eval("better", SKIN, RADII[:16]).R.shape == (1, 16)
                with dipole.Client(farm.url("tls"), retry_s=HANG_S, **ours) as newcomer:
                    newcomer.ping()
                rounds += 1
            assert flood.stdout.readline() == b"done\n"
            assert sanitized() or farm.resident_bytes() - before_bytes < 64 << 20
            after = counters(farm)
            assert after["tls_handshakes_open"] <= 256
            assert after["tls_handshakes_failed"] >= MANY - 700
            flood.communicate(b"\n")
    assert eventually(lambda: counters(farm)["tls_handshakes_open"] == 0)


def test_silent_clients_end_only_each_other(daemon, server, ours):
    """A handshake that has begun goes on beside a flood of connections that send nothing."""
    one = daemon("--max-tls-handshakes", "4", *options(server), listen=[TLS, "tcp:127.0.0.1:0"])
    arriving, leaving, session = begun_handshake(ours)
    hello = leaving.read()
    with socket.create_connection(("127.0.0.1", port_of(one)), 10) as good, ExitStack() as stack:
        good.sendall(hello[:50])
        assert eventually(lambda: counters(one)["tls_handshakes_open"] == 1)
        address = "127.0.0.1", port_of(one)
        silent = [stack.enter_context(socket.create_connection(address, 10)) for _ in range(50)]
        for ended in silent[:46]:
            assert ended.recv(1) == b""
        good.sendall(hello[50:])
        arriving.write(good.recv(65536))
        session.do_handshake()
        good.sendall(leaving.read())
        assert eventually(lambda: counters(one)["tls_handshakes"] == 1)
        assert not select.select(silent[46:], [], [], 0)[0]
        assert counters(one)["tls_handshakes_failed"] == 46


def test_a_handshake_may_not_take_long(daemon, server, ours):
    one = daemon("--tls-handshake-timeout-ms", "300", *options(server), listen=["tls:127.0.0.1:0"])
    with socket.create_connection(("127.0.0.1", port_of(one)), 10) as slow:
        start_s = time.monotonic()
        assert slow.recv(1) == b""
        assert time.monotonic() - start_s > 0.2
    with socket.create_connection(("127.0.0.1", port_of(one)), 10) as slow:
        with pytest.raises(OSError):  # its bytes make no difference
            for byte in hello_bytes(ours):
                slow.send(bytes([byte]))
                time.sleep(0.01)
    assert one.has_line("the handshake takes too long")


def test_a_handshake_may_not_have_many_bytes(farm, ours):
    """The CA names of a ClientHello may fill many records; a client that goes on is ended."""
    with socket.create_connection(("127.0.0.1", port_of(farm)), 10) as one:
        with pytest.raises(OSError):
            one.sendall(b"\x16\x03\x01\x40\x00\x01\x0f\xff\xff" + bytes(16379))
            for _ in range(1000):
                one.sendall(b"\x16\x03\x01\x40\x00" + bytes(16384))
    assert farm.has_line("event=tls-refused")


def test_byte_by_byte(farm, ours):
    """A client whose bytes come one by one gets its answer."""
    arriving, leaving, session = begun_handshake(ours)
    frames = b"".join(dipole.connection.frame_pieces(5, 7, b"12345678"))
    with socket.create_connection(("127.0.0.1", port_of(farm)), 10) as one:
        one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

        def move() -> None:
            for byte in leaving.read():
                one.send(bytes([byte]))
            arriving.write(one.recv(1))

        def until(act):
            while True:
                try:
                    return act()
                except ssl.SSLWantReadError:
                    move()

        until(session.do_handshake)
        session.write(frames)
        answer = b""
        while len(answer) < len(frames):
            answer += until(lambda: session.read(1))
        assert answer[-8:] == b"12345678"


def spoiled(dice: random.Random, flight: bytes) -> bytes:
    """Changes bits, the header or the length of the first record of a flight."""
    head, body = bytearray(flight[:5]), bytearray(flight[5:])
    kind = dice.randrange(5)
    if kind == 0:
        for _ in range(dice.randrange(1, 9)):
            body[dice.randrange(len(body))] ^= 1 << dice.randrange(8)
    elif kind == 1:
        head[dice.randrange(5)] = dice.randrange(256)
    elif kind == 2:
        body = body[: dice.randrange(len(body))]
    elif kind == 3:
        body = bytearray(dice.randbytes(dice.randrange(1, 600)))
    else:
        body += dice.randbytes(18500)
    return bytes(head + body)


def test_a_flood_of_records_with_faults(farm, ours):
    """RECORDS first flights, each changed at random. The daemon's memory does not grow with their
    number, and others are served meanwhile."""
    dice, first, settled_bytes = random.Random(4), hello_bytes(ours), 0
    before, begun = counters(farm), 0
    with dipole.Client(farm.url("tls"), **ours) as client:
        right = client.eval("better", SKIN, RADII[:16]).R
        for number in range(RECORDS):
            with socket.create_connection(("127.0.0.1", port_of(farm)), 60) as one:
                with suppress(OSError):
                    one.sendall(spoiled(dice, first))
                    one.shutdown(socket.SHUT_WR)
                    while one.recv(65536):
                        pass
                begun += 1
            if number % 100 == 0:
                assert (client.eval("better", SKIN, RADII[:16]).R == right).all()
                settled_bytes = settled_bytes or farm.resident_bytes()
    assert eventually(lambda: counters(farm)["tls_handshakes_open"] == 0)
    assert counters(farm)["tls_handshakes_failed"] == before["tls_handshakes_failed"] + begun
    assert sanitized() or farm.resident_bytes() - settled_bytes < 32 << 20


@pytest.mark.parametrize("how", FLOODS)
def test_a_flood_of_records_holds_nobody(daemon, authority, server, ours, tmp_path, how):
    """Records without content, or with a byte each, are read in turns."""
    mutual = options(server, "--client-ca", str(authority.pem), "--listen", "tls:127.0.0.1:0")
    one = daemon(*mutual, "--workers", "1", "--max-in-flight", "1")
    rude = Recorder(port_of(one), dipole.Tls(**ours).context(), FLOODS[how], tmp_path)
    ping = frame(PING, 7, bytes(2400 if how == "bytes" else 8))
    rude.assert_others_are_served(one, how, ping, "requests_ping")


def test_stopping_ends_handshakes_and_answers_what_is_in_flight(farm, ours):
    half = socket.create_connection(("127.0.0.1", port_of(farm)), 10)
    right = expected(RADII[:16])
    with dipole.Client(farm.url("tls"), **ours, retry_s=0) as client:
        under_way = [client.submit("better", SKIN, RADII[:16]) for _ in range(50)]
        first = client.collect(under_way[0])[1]
        with dipole.Client(farm.url("tls"), **ours) as other:  # The daemon has read them all.
            assert eventually(lambda: other.statistics()["requests_eval"] >= 50)
        farm.terminate()
        assert (first.R == right).all()
        for one in under_way[1:]:
            assert (client.collect(one)[1].R == right).all()
    with half:
        assert half.recv(1) == b""
    assert farm.wait() == 0


@pytest.mark.skipif(sanitized(), reason="the build is sanitized")
def test_idle_connections_hold_little_memory(farm, ours):
    clients = [dipole.Client(farm.url("tls"), **ours) for _ in range(25)]
    before = farm.resident_bytes()
    clients += [dipole.Client(farm.url("tls"), **ours) for _ in range(100)]
    # The buffers of silent connections are released.
    assert eventually(lambda: (farm.resident_bytes() - before) / 100 < 128 << 10)
    for one in clients:
        one.close()


def opened(client: str, address: str):
    """Opens a client of Python or of libdipole; returns its calls ping and close."""
    if client == "python":
        one = dipole.Client(address)
        return one.ping, one.close
    library = ctypes.CDLL(str(BUILD / "libdipole.so"))
    library.dipole_open.restype = library.dipole_ping.restype = ctypes.c_bool
    handle, error = ctypes.c_void_p(), ctypes.create_string_buffer(1024)
    assert library.dipole_open(address.encode(), ctypes.byref(handle), error), error.raw

    def ping() -> None:
        if not library.dipole_ping(handle, error):
            raise dipole.ConnectionLost(error.raw.replace(b"\0", b"").decode("latin-1"))

    return ping, lambda: library.dipole_close(handle)


@pytest.mark.parametrize("client", ["python", "c"])
@pytest.mark.parametrize("scheme", ["tcp", "tls", "private"])
def test_a_forked_process_disturbs_nobody(monkeypatch, farm, ours, client, scheme):
    """It gets no answer of its parent, it may close its copy, and the parent's close() is not held
    up by copies that are still open."""
    if client == "c" and sanitized():
        pytest.skip("a sanitized library cannot be loaded here")
    for name, path in ours.items():
        monkeypatch.setenv(f"DIPOLED_{name.upper()}", path)
    ping, close = opened(client, farm.url(scheme) if scheme != "private" else f"private:{PROGRAM}")
    child = os.fork()
    if child == 0:
        try:
            for _ in range(2):
                with pytest.raises(dipole.ConnectionLost, match=f"{os.getppid()} opened this client"):
                    ping()
            close()
            os._exit(0)
        finally:
            os._exit(1)
    assert os.waitpid(child, 0)[1] == 0
    for _ in range(3):
        ping()
    ended, ends = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(ends)
        os.read(ended, 1)
        os._exit(0)
    private = ping.__self__._session.connection._process if client == "python" else None
    close()
    assert private is None or private.returncode == 0
    assert eventually(lambda: counters(farm)["connections_open"] == 1)
    os.close(ends)
    os.close(ended)
    assert os.waitpid(child, 0)[1] == 0
