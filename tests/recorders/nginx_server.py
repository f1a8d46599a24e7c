"""nginx as a camera's front door: passwords, encryption, redirections."""

from __future__ import annotations

import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.recorders.free_port import free_port
from tests.recorders.live_wait import ending, wait_until

USERS = "me:{PLAIN}secret\n"


@contextmanager
def nginx_server(folder: Path, rules: str, certificate: Path | None = None) -> Iterator[str]:
    """Serves; its address without a scheme.

    Args:
        folder: an empty one, for its files; /users of it holds who may come in.
        rules: what stands inside `server { }`.
        certificate: a PEM file with key and certificate, for HTTPS.
    """
    program = shutil.which("nginx")
    if program is None:
        pytest.skip("nginx is not installed")
    port = free_port()
    (folder / "users").write_text(USERS)
    (folder / "users").chmod(0o644)
    tls = (
        f"ssl_certificate {certificate}; ssl_certificate_key {certificate};" if certificate else ""
    )
    (folder / "nginx.conf").write_text(
        f"daemon off; master_process off; worker_processes 1; pid {folder}/pid; "
        f"error_log {folder}/error.log; events {{ }} http {{ access_log off; "
        f"client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy; "
        f"fastcgi_temp_path {folder}/f; uwsgi_temp_path {folder}/u; scgi_temp_path {folder}/s; "
        f"server {{ listen 127.0.0.1:{port}{' ssl; ' + tls if certificate else ';'} {rules} }} }}"
    )

    def listens() -> bool:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
            return True
        return False

    words = [program, "-p", folder, "-c", folder / "nginx.conf"]
    process = subprocess.Popen(words, stderr=subprocess.DEVNULL, text=True)
    with ending(process):
        wait_until(listens, "nginx")
        yield f"127.0.0.1:{port}"
