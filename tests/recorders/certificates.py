"""A certificate that nobody vouches for, of a host of another name, as cameras have them."""

from __future__ import annotations

import shutil
import ssl
import subprocess
from functools import cache
from hashlib import sha256
from pathlib import Path
from tempfile import mkdtemp

import pytest


@cache
def self_signed() -> Path:
    """A PEM file with key and certificate; the test is skipped without openssl."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    file = Path(mkdtemp(prefix="tunenet-certificate-")) / "camera.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=camera.lan",
         "-days", "1", "-keyout", file, "-out", file.with_suffix(".crt")],
        check=True, capture_output=True,
    )  # fmt: skip
    with file.open("a") as both:
        both.write(file.with_suffix(".crt").read_text())
    return file


def fingerprint_of(file: Path) -> str:
    """As `openssl x509 -fingerprint -sha256` prints it: capital digits with colons."""
    text = file.with_suffix(".crt").read_text()
    return sha256(ssl.PEM_cert_to_DER_cert(text)).digest().hex(":").upper()
