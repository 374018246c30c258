"""MODBUS/TCP Security (MB-TCP-Security-v36): who gets in, what a role may do, and what TLS has to
be like. tests/promises.txt says which test holds which MUST."""

import functools
import re
import socket
import ssl
import struct

import pytest
from certificates import EC, Authority, openssl
from daemons import Daemon, finished, run
from modbus_master import (
    AT, BAD_FUNCTION, Exception_, Lost, Tcp, as_floats, input_block, write_read_pdu,
)

ROLE = "1.3.6.1.4.1.50316.802.1=ASN1:"
TLS = "tls:127.0.0.1:0"
RULES = """# what             who
read,write           role:Engineer
read                 role:Operator
read                 subject:CN=clock
write                role:Writer
evaluate             role:Farm
"""
RADII = [0.1 * (k + 1) for k in range(20)]
EVERYTHING = write_read_pdu(100, input_block(7, radii=RADII), 312, 2 * len(RADII))
READ_R, READ_INPUT, READ_NAME = (
    struct.pack(">BHH", 3, address, count) for address, count in ((312, 40), (100, 5), (1200, 10))
)
WRITE_DEFAULTS = struct.pack(">BHH", 6, AT["DEFAULTS"], 1)
REPORT_ID, DEVICE_ID = b"\x11", b"\x2b\x0e\x01\x00"


@pytest.fixture(scope="module")
def authority(tmp_path_factory):
    return Authority(tmp_path_factory.mktemp("mbaps"))


@pytest.fixture(scope="module")
def server(authority):
    """Returns the daemon's certificate, behind which stands its CA's, and its key."""
    certificate, key = authority.sign("server")
    with open(certificate, "a") as file:
        file.write(authority.pem.read_text())
    return certificate, key


def options_of(authority, server, folder, rules: str = RULES) -> list[str]:
    """Returns the options of a daemon: with the rules, unless they are empty."""
    (folder / "rules").write_text(rules)
    given = ["--roles", str(folder / "rules")] if rules else []
    return ["--modbus", TLS, "--certificate", server[0], "--key", server[1], "--client-ca", str(authority.pem), *given]


@pytest.fixture
def slave(daemon, authority, server, tmp_path):
    """Returns a function that starts a daemon."""
    return lambda *options, **how: daemon(*options_of(authority, server, tmp_path, **how), *options)


@pytest.fixture(scope="module")
def usual(authority, server, tmp_path_factory):
    """Returns a daemon with the rules, for tests that leave it as it is."""
    one = Daemon(*options_of(authority, server, tmp_path_factory.mktemp("rules")))
    yield one
    one.close()


@functools.cache
def person(authority, name: str, role: str | None = None, days: int = 30) -> tuple[str, str]:
    """Returns the certificate and the key of a master."""
    lines = f"{ROLE}UTF8String:{role}" if role else ""
    return authority.sign(f"{name}-{role}-{days}", lines=lines, days=days, subject=name)


def port_of(one) -> int:
    return int(one.url("modbus-tls").rpartition(":")[2])


def context_of(authority, files: tuple[str, str] | None) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=str(authority.pem))
    if files is not None:
        context.load_cert_chain(*files)
    return context


class Secure(Tcp):
    """A master through TLS."""

    def __init__(self, slave, authority, files, version: str | None = None):
        super().__init__(f"127.0.0.1:{port_of(slave)}")
        context = context_of(authority, files)
        if version is not None:
            context.maximum_version = getattr(ssl.TLSVersion, version)
        self.socket = context.wrap_socket(self.socket, server_hostname="localhost")


def outcome(master: Tcp, pdu: bytes) -> int:
    """Returns the exception that a request gets, or 0."""
    try:
        master.ask(pdu)
        return 0
    except Exception_ as refused:
        return refused.code


def s_client(slave, *arguments: object, said: str = "") -> str:
    """Runs openssl's client, and returns what it prints."""
    words = ["openssl", "s_client", "-connect", f"127.0.0.1:{port_of(slave)}", *map(str, arguments)]
    ended = finished(*words, input=said)
    return ended.stdout + ended.stderr


def files_of(authority, files: tuple[str, str]) -> list[object]:
    return ["-CAfile", authority.pem, "-cert", files[0], "-key", files[1]]


# ---- who gets in ---------------------------------------------------------------------------------


@pytest.mark.parametrize("version", ["TLSv1_2", "TLSv1_3"])
def test_the_same_protocol_through_tls(slave, authority, version):
    """Frames, answers and exceptions have the bytes that they have without TLS."""
    one = slave("--modbus", "tcp:127.0.0.1:0", rules="")
    with Tcp(one) as plain, Secure(one, authority, person(authority, "m"), version) as secure:
        assert secure.socket.version() == version.replace("_", ".")
        for pdu in (EVERYTHING, READ_INPUT, WRITE_DEFAULTS, REPORT_ID, DEVICE_ID, b"\x63", b"\x03"):
            frames = [master.frame(3, pdu) for master in (plain, secure)]
            assert frames[0] == frames[1]
            assert plain.exchange(3, pdu) == secure.exchange(3, pdu)
        many = [secure.frame(1, EVERYTHING) for _ in range(300)]
        secure.socket.sendall(b"".join(many))
        answers = [secure.receive()[2] for _ in many]
        assert set(answers) == {plain.exchange(2, EVERYTHING)}
        assert (as_floats(answers[0][2:]) > 0).all()
        secure.socket.sendall(b"\0\1\0\1\0\6")
        assert secure.is_closed()
    with Secure(one, authority, person(authority, "m"), version) as secure:
        secure.ask(READ_INPUT)
        secure.socket.sendall(b"".join(secure.frame(1, EVERYTHING) for _ in range(50)))
        one.terminate()  # what has arrived is answered
        assert {secure.receive()[2] for _ in range(50)} == set(answers) and secure.is_closed()
    assert one.wait() == 0


@pytest.mark.parametrize("version", ["TLSv1_2", "TLSv1_3"])
@pytest.mark.parametrize("who", ["none", "expired", "of another CA", "signed by itself"])
def test_masters_that_are_not_believed(slave, authority, tmp_path, who, version):
    """They get a fatal alert, the connection ends, and nothing of it is resumed."""
    one = slave()
    files = None
    if who == "expired":
        files = person(authority, "old", "Engineer", days=-1)
    elif who != "none":
        other = Authority(tmp_path, "alone")
        files = other.sign("m", lines=ROLE + "UTF8String:Engineer")
        files = files if who == "of another CA" else (str(other.pem), str(tmp_path / "alone.key"))
    with pytest.raises(ssl.SSLError, match="(?i)alert"):
        with Secure(one, authority, files, version) as master:
            master.socket.recv(1)  # With TLS 1.3, the client's certificate comes last.
    assert one.has_line("event=tls-refused peer=127.0.0.1")
    with Secure(one, authority, person(authority, "good", "Engineer")) as master:
        assert master.read(1200, 2)


def test_a_server_without_a_ca_for_masters_does_not_start(server):
    files = ["--certificate", server[0], "--key", server[1]]
    ended = run("--modbus", TLS, *files)
    assert ended.returncode == 1 and "--modbus tls:HOST:PORT needs --client-ca FILE" in ended.stderr
    assert "--modbus tls:HOST:PORT needs --certificate" in run("--modbus", TLS).stderr


def test_plain_masters_at_the_secure_port(slave):
    one = slave()
    with Tcp(f"127.0.0.1:{port_of(one)}") as master:
        master.socket.sendall(master.frame(1, READ_NAME))
        with pytest.raises((Lost, struct.error, AssertionError)):
            while True:
                master.receive()
    assert one.has_line("event=tls-refused")


def test_pymodbus(slave, authority):
    """A master that others have made, with its own TLS. By itself it sends no header before the
    PDU, which the specification does not allow (R-05), so it is told to."""
    one = slave()
    certificate, key = person(authority, "scada", "Engineer")
    script = """
import asyncio, sys
from pymodbus.client import AsyncModbusTlsClient
from pymodbus.client.tls import sslctx_provider
from pymodbus.framer.socket_framer import ModbusSocketFramer
port, ca, certificate, key = sys.argv[1:]

async def ask():
    context = sslctx_provider(None, certificate, key, None)
    context.load_verify_locations(ca)
    client = AsyncModbusTlsClient(
        "127.0.0.1", port=int(port), sslctx=context, server_hostname="localhost",
        framer=ModbusSocketFramer,
    )
    await client.connect()
    answer = await client.read_holding_registers(1200, 2, slave=1)
    print(answer.registers)
    await client.close()

asyncio.run(ask())
"""
    words = [str(port_of(one)), str(authority.pem), certificate, key]
    said = finished("/usr/bin/python3", "-c", script, *words)
    if "No module named 'pymodbus'" in said.stderr:
        pytest.skip("pymodbus is not installed")
    assert (said.returncode, said.stdout) == (0, "[17481, 20556]\n"), said.stderr


# ---- roles ---------------------------------------------------------------------------------------

OF_ROLE = {
    "Engineer": [0, 0, 0, 0, 0, 0, 0],
    "Operator": [1, 0, 0, 0, 1, 0, 0],
    "Writer": [1, 1, 1, 1, 0, 1, 1],
    "Farm": [1, 1, 1, 1, 1, 1, 1],
    "engineer": [1, 1, 1, 1, 1, 1, 1],
    "Engineers": [1, 1, 1, 1, 1, 1, 1],
    "Engineer,Operator": [1, 1, 1, 1, 1, 1, 1],
    None: [1, 1, 1, 1, 1, 1, 1],
}


def asked(master: Tcp) -> list[int]:
    requests = (
        EVERYTHING, READ_R, READ_INPUT, READ_NAME, WRITE_DEFAULTS, REPORT_ID, DEVICE_ID,
    )  # fmt: skip
    return [outcome(master, pdu) for pdu in requests]


@pytest.mark.parametrize("role", OF_ROLE)
def test_what_a_role_may_do(usual, authority, role):
    """Functions that the rules do not allow get exception 01, also where there is no
    role."""
    with Secure(usual, authority, person(authority, "m", role)) as master:
        assert asked(master) == OF_ROLE[role]
        for function, fields, right in (
            (1, (0, 100), "read"), (4, (420, 2), "read"), (5, (0, 0), "write"),
            (22, (101, 0xFFFF, 0), "write"),
        ):  # fmt: skip
            pdu = struct.pack(f">B{len(fields)}H", function, *fields)
            may = {"Engineer": "read write", "Operator": "read", "Writer": "write"}.get(role, "")
            assert outcome(master, pdu) == (0 if right in may else BAD_FUNCTION)
    if any(OF_ROLE[role]):
        assert usual.has_line("event=modbus-request-refused")  # not each: it logs some of a second


def test_a_subject_has_rights_too(usual, authority):
    with Secure(usual, authority, person(authority, "clock")) as master:
        assert asked(master) == OF_ROLE["Operator"]


@pytest.mark.parametrize("written", ["René,Söhne", r"Ren\C3\A9,Söhne"])
def test_subjects_beyond_ascii(slave, authority, tmp_path, written):
    """The file may have such characters as they are, or as openssl prints them."""
    comma = written.replace(",", r"\,")
    one = slave(rules=f"read subject:CN={comma}\n")
    certificate, key, asked_for = (tmp_path / f"own.{end}" for end in ("pem", "key", "csr"))
    subject = ["-utf8", "-subj", "/CN=René,Söhne"]
    openssl("req", *EC, "-keyout", key, "-out", asked_for, *subject)
    signed = ["-CA", authority.pem, "-CAkey", authority.pem.with_suffix(".key"), "-days", 30]
    openssl("x509", "-req", "-in", asked_for, *signed, "-CAcreateserial", "-out", certificate)
    with Secure(one, authority, (str(certificate), str(key))) as master:
        assert asked(master) == OF_ROLE["Operator"]


@pytest.mark.parametrize("value", ["INTEGER:1", "IA5String:Engineer", "OCTETSTRING:Engineer"])
def test_a_role_is_a_utf8_string(usual, authority, value):
    """A role of another type is no role."""
    with Secure(usual, authority, authority.sign("odd", lines=ROLE + value)) as master:
        assert asked(master) == OF_ROLE[None]


@pytest.mark.parametrize(
    "value, good",
    [("0C:06:57:72:69:74:65:72", True), ("0C:81:06:57:72:69:74:65:72", False),
     ("0C:06:57:72:69:74:65:72:05:00", False), ("2C:80:0C:06:57:72:69:74:65:72:00:00", False),
     ("0C:07:57:72:69:74:65:72:00", False), ("0C:07:57:72:69:74:65:72", False)],
    ids=["DER", "long length", "more behind it", "in parts", "with a zero", "cut"],
)
def test_a_role_is_one_string_in_der(usual, authority, value, good):
    """Writer in another encoding, which another reader may take for another role, is no role."""
    lines = ROLE.removesuffix("ASN1:") + f"DER:{value}"
    with Secure(usual, authority, authority.sign("odd", lines=lines)) as master:
        assert outcome(master, struct.pack(">BHH", 6, 101, 2)) == (0 if good else BAD_FUNCTION)


def test_the_role_of_another_extension_is_none(usual, authority):
    lines = "1.3.6.1.4.1.50316.802.2=ASN1:UTF8String:Engineer"
    with Secure(usual, authority, authority.sign("near", lines=lines)) as master:
        assert asked(master) == OF_ROLE[None]


def test_no_rules_no_limits_but_the_options(slave, authority):
    files = person(authority, "m")
    with Secure(slave(rules=""), authority, files) as master:
        assert asked(master) == [0] * 7
    with Secure(slave("--modbus-allow-write", "10.0.0.0/8"), authority, person(authority, "e", "Engineer")) as master:
        assert asked(master) == [1, 0, 0, 0, 1, 0, 0]
    one = slave("--modbus-allow", "10.0.0.0/8")
    with pytest.raises((OSError, Lost)):
        Secure(one, authority, files)
    assert one.has_line("event=modbus-refused reason=not-allowed")


def test_rules_are_the_users_and_are_read_again(slave, authority, tmp_path):
    """SIGHUP reads other rules. Connections keep what they began with."""
    one = slave()
    files = person(authority, "m", "Engineer")
    with Secure(one, authority, files) as before:
        (tmp_path / "rules").write_text("read role:Engineer\n")
        one.process.send_signal(1)
        assert one.has_line("event=tls-reloaded")
        with Secure(one, authority, files) as after:
            assert asked(after) == [1, 0, 0, 0, 1, 0, 0]
        assert asked(before) == [0] * 7


# ---- what TLS has to be like ---------------------------------------------------------------------


def old_hello(version: str) -> bytes:
    """Returns the ClientHello of a version that no tool of today speaks."""
    if version == "SSL 2.0":
        hello = bytes.fromhex("01 0002 0003 0000 0010 010080") + bytes(16)
        return struct.pack(">H", 0x8000 | len(hello)) + hello
    body = b"\3\0" + bytes(32) + b"\0" + bytes.fromhex("0004 c02b 002f 0100")
    handshake = b"\1" + len(body).to_bytes(3, "big") + body
    return b"\x16\3\0" + len(handshake).to_bytes(2, "big") + handshake


@pytest.mark.parametrize("old", ["-tls1_1", "-tls1", "SSL 3.0", "SSL 2.0"])
def test_no_older_version_is_negotiated(slave, authority, old):
    """A client that speaks an older version gets an alert."""
    one, files = slave(), person(authority, "m")
    if old.startswith("-"):
        said = s_client(one, old, "-cipher", "ALL:@SECLEVEL=0", *files_of(authority, files))
        assert "Cipher is (NONE)" in said and "alert protocol version" in said
    else:
        with socket.create_connection(("127.0.0.1", port_of(one)), 10) as client:
            client.sendall(old_hello(old))
            got = client.recv(100)
            assert got == b"" or got[0] == 21
    assert one.has_line("event=tls-refused")
    assert "Protocol  : TLSv1.2" in s_client(one, "-tls1_2", *files_of(authority, files))


@pytest.mark.parametrize(
    "cipher",
    [
        "NULL-SHA256", "NULL-SHA", "NULL-MD5", "RC4-MD5", "AES128-SHA", "ECDHE-ECDSA-AES128-SHA",
        "ECDHE-ECDSA-NULL-SHA", "AES128-SHA256", "ECDHE-ECDSA-AES128-SHA256", "aNULL",
    ],
)  # fmt: skip
def test_ciphers_that_are_refused(usual, authority, cipher):
    """Neither MD5 nor SHA-1 nor nothing as hash, nor nothing as cipher."""
    files = person(authority, "m")
    listed = f"{cipher}:@SECLEVEL=0"
    assert "Cipher is (NONE)" in s_client(usual, "-tls1_2", "-cipher", listed, *files_of(authority, files)) or (
        "no cipher match" in s_client(usual, "-tls1_2", "-cipher", listed, *files_of(authority, files))
    )


@pytest.mark.parametrize("key", ["ECDSA", "RSA"])
def test_the_ciphers_that_must_be_there(slave, daemon, authority, tmp_path, key):
    """With AES-128 in counter mode, SHA-256 as hash of its pseudo-random function, and ephemeral
    keys on P-256."""
    files = person(authority, "m")
    if key == "RSA":
        (tmp_path / "other").mkdir()
        pem, private = tmp_path / "other" / "rsa.pem", tmp_path / "other" / "rsa.key"
        about = ["-subj", "/CN=localhost", "-days", 3, "-nodes"]
        openssl("req", "-x509", "-newkey", "rsa:2048", "-keyout", private, "-out", pem, *about)
        given = ["--certificate", str(pem), "--key", str(private), "--client-ca", str(authority.pem)]
        one = daemon("--modbus", TLS, *given)
    else:
        one = slave()
    cipher = f"ECDHE-{key}-AES128-GCM-SHA256"
    words = ["-tls1_2", "-cipher", cipher, "-groups", "P-256", *files_of(authority, files)]
    said = s_client(one, *words)
    assert f"Cipher is {cipher}" in said and "Server Temp Key: ECDH, prime256v1" in said
    assert f"Peer signature type: {key}" in said.replace("RSA-PSS", "RSA")
    assert "Compression: NONE" in said


@pytest.mark.parametrize("length", [512, 1024, 2048, 4096])
def test_fragments_may_be_short(usual, authority, length):
    """A master asks for short records, and the daemon agrees."""
    files = person(authority, "m", "Engineer")
    words = ["-tls1_2", "-maxfraglen", length, "-tlsextdebug"]
    said = s_client(usual, *words, *files_of(authority, files))
    agreed = re.search(r'extension "max fragment length" \(id=1\), len=1\n0000 - 0(\d)', said)
    assert agreed and 256 << int(agreed[1]) == length


def test_renegotiation_is_indicated_and_refused(usual, authority):
    files = person(authority, "m")
    said = s_client(usual, "-tls1_2", *files_of(authority, files), said="R\n")
    assert "Secure Renegotiation IS supported" in said
    assert "no renegotiation" in said


@pytest.mark.parametrize("version", ["-tls1_2", "-tls1_3"])
def test_no_session_is_resumed(usual, authority, tmp_path, version):
    files = person(authority, "m")
    said = s_client(usual, version, "-reconnect", *files_of(authority, files))
    assert "New, TLSv1" in said and "Reused, TLSv1" not in said


def test_the_whole_chain_is_sent(usual, authority):
    """The certificate, and that of its CA."""
    files = person(authority, "m")
    said = s_client(usual, "-showcerts", *files_of(authority, files))
    assert said.count("-----BEGIN CERTIFICATE-----") == 2
    assert "0 s:CN = server" in said and "1 s:CN = ca" in said
    assert "Verify return code: 0 (ok)" in said


def test_the_certificate_is_asked_for(usual, authority):
    said = s_client(usual, "-tls1_2", "-msg", "-CAfile", authority.pem)
    assert "CertificateRequest" in said
    assert "Acceptable client certificate CA names\nCN = ca" in said
