"""Certificates for tests of TLS, which the command openssl makes, and records of any content."""

import ctypes
import hmac
import signal
import socket
import ssl
import subprocess
from pathlib import Path

from daemons import Daemon, eventually
from frames import STATISTICS, frame, read_statistics, statistics

EC = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"]


def openssl(*arguments: object) -> None:
    subprocess.run(["openssl", *map(str, arguments)], check=True, capture_output=True)


class Authority:
    """A CA in a folder, and what it has signed: NAME.pem and NAME.key."""

    def __init__(self, folder: Path, name: str = "ca"):
        self.folder = folder
        self.pem = folder / f"{name}.pem"
        self._key = folder / f"{name}.key"
        about = ["-subj", f"/CN={name}", "-days", 30]
        openssl("req", "-x509", *EC, "-keyout", self._key, "-out", self.pem, *about)

    def sign(
        self,
        name: str,
        hosts: str = "DNS:localhost,IP:127.0.0.1",
        days: int = 30,
        lines: str = "",
        subject: str | None = None,
    ) -> tuple[str, str]:
        """Makes a certificate that is good for these hosts, and its key. days: may be negative for
        one that has expired. lines: more lines of openssl's extensions. subject: unless it is the name."""
        pem, key, asked = (self.folder / f"{name}.{end}" for end in ("pem", "key", "csr"))
        openssl("req", *EC, "-keyout", key, "-out", asked, "-subj", f"/CN={subject or name}")
        extensions = self.folder / f"{name}.cnf"
        extensions.write_text(f"subjectAltName={hosts}\n{lines}\n")
        made = ["-CA", self.pem, "-CAkey", self._key, "-CAcreateserial", "-extfile", extensions]
        openssl("x509", "-req", "-in", asked, *made, "-days", days, "-out", pem)
        return str(pem), str(key)


def sealed(key: bytes, nonce: bytes, head: bytes, text: bytes) -> bytes:
    """Encrypts by AES-256-GCM, with the libcrypto that Python has anyway."""
    crypto = ctypes.CDLL("libcrypto.so.3")
    crypto.EVP_CIPHER_CTX_new.restype = crypto.EVP_aes_256_gcm.restype = ctypes.c_void_p
    context, cipher = ctypes.c_void_p(crypto.EVP_CIPHER_CTX_new()), ctypes.c_void_p(crypto.EVP_aes_256_gcm())
    out, tag, done = ctypes.create_string_buffer(len(text) + 16), ctypes.create_string_buffer(16), ctypes.c_int()
    crypto.EVP_EncryptInit_ex(context, cipher, None, key, nonce)
    crypto.EVP_EncryptUpdate(context, None, ctypes.byref(done), head, len(head))
    crypto.EVP_EncryptUpdate(context, out, ctypes.byref(done), text, len(text))
    crypto.EVP_EncryptFinal_ex(context, out, ctypes.byref(done))
    crypto.EVP_CIPHER_CTX_ctrl(context, 16, 16, tag)  # EVP_CTRL_AEAD_GET_TAG
    crypto.EVP_CIPHER_CTX_free(context)
    return out.raw[: len(text)] + tag.raw


def expand(secret: bytes, label: str, count: int) -> bytes:
    """Returns RFC 8446's HKDF-Expand-Label with SHA-384 and an empty context."""
    name = b"tls13 " + label.encode()
    return hmac.digest(secret, count.to_bytes(2, "big") + bytes([len(name)]) + name + b"\0\1", "sha384")[:count]


class Recorder:
    """A connection by TLS 1.2 or 1.3 whose client makes records of any kind and content, in the order
    in which they are to be sent. Kinds: 21 is an alert, 22 a part of a handshake, 23 data."""

    def __init__(self, port: int, context: ssl.SSLContext, version: str, folder: Path):
        context.maximum_version = getattr(ssl.TLSVersion, "TLSv" + version.replace(".", "_"))
        context.set_ciphers("ECDHE-ECDSA-AES256-GCM-SHA384")
        context.keylog_filename = str(folder / "keys")
        self._arriving, leaving = ssl.MemoryBIO(), ssl.MemoryBIO()
        self._session = context.wrap_bio(self._arriving, leaving, server_hostname="localhost")
        self.socket = socket.create_connection(("127.0.0.1", port), 60)
        arrived, done = b"", False
        while not done:
            try:
                self._session.do_handshake()
                done = True
            except ssl.SSLWantReadError:
                self.socket.sendall(leaving.read())
                arrived += self._receive()
        self.socket.sendall(leaving.read())
        lines = [line.split() for line in (folder / "keys").read_text().splitlines() if line[0] != "#"]
        secrets = {name: (bytes.fromhex(nonce), bytes.fromhex(secret)) for name, nonce, secret in lines}
        self._secret = None
        if version == "1.3":
            self._update_keys(secrets["CLIENT_TRAFFIC_SECRET_0"][1])
        else:
            nonce, master = secrets["CLIENT_RANDOM"]
            seed, block = b"key expansion" + arrived[11:43] + nonce, b""
            turn = seed
            while len(block) < 68:  # two keys and the first bytes of a nonce
                turn = hmac.digest(master, turn, "sha384")
                block += hmac.digest(master, turn + seed, "sha384")
            self._key, self._nonce, self._count = block[:32], block[64:68], 1

    def _update_keys(self, secret: bytes) -> None:
        self._secret, self._count = secret, 0
        self._key, self._nonce = expand(secret, "key", 32), expand(secret, "iv", 12)

    def _receive(self) -> bytes:
        got = self.socket.recv(65536)
        self._arriving.write(got)
        return got

    def record(self, kind: int, content: bytes) -> bytes:
        number = self._count.to_bytes(8, "big")
        self._count += 1
        if self._secret is None:
            head = number + bytes([kind, 3, 3]) + len(content).to_bytes(2, "big")
            text = number + sealed(self._key, self._nonce + number, head, content)
            return bytes([kind, 3, 3]) + len(text).to_bytes(2, "big") + text
        head = b"\x17\3\3" + (len(content) + 17).to_bytes(2, "big")
        nonce = (int.from_bytes(self._nonce, "big") ^ (self._count - 1)).to_bytes(12, "big")
        return head + sealed(self._key, nonce, head, content + bytes([kind]))

    def update_of_keys(self, answered: bool = False) -> bytes:
        made = self.record(22, bytes([24, 0, 0, 1, answered]))
        self._update_keys(expand(self._secret, "traffic upd", 48))
        return made

    def flood(self, how: str, request: bytes) -> bytes:
        """Returns many records in one of the ways of FLOODS, and then a request."""
        if how == "bytes":
            return b"".join(self.record(23, request[i : i + 1]) for i in range(len(request)))
        many = [
            self.record(22, CLIENT_HELLO) if how == "renegotiations" else self.update_of_keys(how == "answered updates")
            for _ in range(1500 if how == "answered updates" else 300)  # those fill the daemon's socket
        ]
        return b"".join(many) + self.record(23, request)

    def receive(self) -> bytes:
        """Waits for data, and returns those of a record."""
        while True:
            try:
                return self._session.read(65536)
            except ssl.SSLWantReadError:
                assert self._receive()

    def assert_others_are_served(self, daemon: Daemon, how: str, request: bytes, counter: str) -> None:
        """Sends a flood to a daemon with --workers 1 --max-in-flight 1, together with six requests of
        another client, and checks that these, which take a turn each, come before that behind the
        flood. counter: of the statistics, which counts this request."""
        self.socket.sendall(self.record(23, request))
        assert self.receive()
        with daemon.connect("unix") as other:
            assert statistics(other)[counter] == 1  # So the worker has both connections.
            daemon.pause()
            self.socket.sendall(self.flood(how, request))
            other.send_bytes(b"".join(frame(STATISTICS, number) for number in range(6)))
            daemon.process.send_signal(signal.SIGCONT)
            answers = [read_statistics(other.receive_frame().payload) for _ in range(6)]
            assert [answer[counter] for answer in answers] == [1] * 6
            assert eventually(lambda: statistics(other)[counter] == 2)
        if how != "renegotiations":  # Python's OpenSSL takes their refusals for the end.
            assert self.receive()


FLOODS = {"updates": "1.3", "answered updates": "1.3", "bytes": "1.3", "renegotiations": "1.2"}
CLIENT_HELLO = bytes([1, 0, 0, 41, 3, 3, *bytes(32), 0, 0, 2, 0xC0, 0x2C, 1, 0])
