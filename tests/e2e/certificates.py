"""Certificates for tests of TLS, which the command openssl makes."""

from __future__ import annotations

import subprocess
from pathlib import Path

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
    ) -> tuple[str, str]:
        """Makes a certificate that is good for these hosts, and its key. days: may be negative for
        one that has expired. lines: more lines of openssl's extensions."""
        pem, key, asked = (self.folder / f"{name}.{end}" for end in ("pem", "key", "csr"))
        openssl("req", *EC, "-keyout", key, "-out", asked, "-subj", f"/CN={name}")
        extensions = self.folder / f"{name}.cnf"
        extensions.write_text(f"subjectAltName={hosts}\n{lines}\n")
        made = ["-CA", self.pem, "-CAkey", self._key, "-CAcreateserial", "-extfile", extensions]
        openssl("x509", "-req", "-in", asked, *made, "-days", days, "-out", pem)
        return str(pem), str(key)
