"""An HTTP camera for a test: five pictures for whoever proves who asks."""

from __future__ import annotations

import hashlib
import re
import ssl
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from tests.recorders.mjpeg_camera import picture
from tests.recorders.server_thread import beside

PICTURES = 5
MULTIPART = "multipart/x-mixed-replace; boundary=frame"

_FIELD = re.compile(r'(\w+)=(?:"([^"]*)"|([^\s,]+))')


@dataclass
class HttpCamera:
    """What it wants, and what it saw.

    Attributes:
        challenges: its `WWW-Authenticate` to who has not proved anything.
        proves: whether a request's `Authorization` does; the nonce is "n0".
        moved: where it sends on to from /moved.
        seen: the `Authorization` of each request, "" for none.
    """

    challenges: tuple[str, ...] = ()
    proves: Callable[[str], bool] = field(default=bool)
    moved: str = ""
    seen: list[str] = field(default_factory=list)
    address: str = ""


@contextmanager
def http_camera(camera: HttpCamera, certificate: Path | None = None) -> Iterator[HttpCamera]:
    """Serves, and sets the camera's address, without a scheme."""

    class Handler(BaseHTTPRequestHandler):
        def log_message(self, format: str, *_words: object) -> None:  # noqa: A002
            pass

        def do_GET(self) -> None:
            given = self.headers.get("Authorization", "")
            camera.seen.append(given)
            if camera.moved and self.path.startswith("/moved"):
                self.send_response(302)
                self.send_header("Location", camera.moved)
                self.end_headers()
                return
            if camera.challenges and not camera.proves(given):
                self.send_response(401)
                for challenge in camera.challenges:
                    self.send_header("WWW-Authenticate", challenge)
                self.end_headers()
                return
            self.send_response(200)
            self.send_header("Content-Type", MULTIPART)
            self.end_headers()
            for number in range(PICTURES):
                self.wfile.write(b"--frame\r\n\r\n" + picture(number) + b"\r\n")
            self.wfile.write(b"--frame--\r\n")  # else it is asked for again

    class Server(ThreadingHTTPServer):
        def handle_error(self, request: object, client_address: object) -> None:
            pass  # who does not believe a certificate hangs up

    server = Server(("127.0.0.1", 0), Handler)
    if certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate)
        server.socket = context.wrap_socket(
            server.socket, server_side=True, do_handshake_on_connect=False
        )
    with beside(server) as camera.address:
        yield camera


def digest_of(given: str, kind: str, user: str, password: str) -> str:
    """What a digest has to be, by RFC 7616, from the words that were given with it."""
    words = {name: quoted or plain for name, quoted, plain in _FIELD.findall(given)}

    def hashed(*parts: str) -> str:
        return hashlib.new(kind, ":".join(parts).encode()).hexdigest()

    secret = hashed(user, words["realm"], password)
    if words.get("algorithm", "").lower().endswith("-sess"):
        secret = hashed(secret, words["nonce"], words["cnonce"])
    request = hashed("GET", words["uri"])
    if "qop" in words:
        middle = (words["nonce"], words["nc"], words["cnonce"], words["qop"])
        return hashed(secret, *middle, request)
    return hashed(secret, words["nonce"], request)
