"""Asks a page that a command serves on this machine, over real HTTP."""

from __future__ import annotations

from collections.abc import Iterable
from http.client import HTTPConnection
from pathlib import Path


class Page:
    """A page, as a browser (or something that poses as one) asks it.

    Attributes:
        host: name or address, and port.
        secret: what every path begins with.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.host, _, secret = url.removeprefix("http://").strip("/").partition("/")
        self.secret = f"/{secret}"

    def ask(
        self, method: str, path: str, body: str | None = None, **headers: str
    ) -> tuple[int, bytes]:
        """The answer's status and body."""
        return self.ask_anywhere(method, self.secret + path, body, **headers)

    def ask_anywhere(
        self, method: str, path: str, body: str | None = None, **headers: str
    ) -> tuple[int, bytes]:
        """The same with a whole path, as somebody asks who does not know the secret."""
        connection = HTTPConnection(self.host, timeout=10)
        try:
            connection.request(method, path, body, headers)
            response = connection.getresponse()
            return response.status, response.read()
        finally:
            connection.close()


def assert_for_this_machine_alone(page: Page, paths: Iterable[tuple[str, str]]) -> None:
    """Other sites and other names of this machine are refused, and nothing listens outside it."""
    port = page.host.partition(":")[2]
    paths = list(paths)
    for headers in (
        {"Host": "evil.example"},
        {"Host": f"evil.example:{port}"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
    ):
        for method, path in paths:
            assert page.ask(method, path, **headers)[0] == 403
    for method, path in paths:
        for prefix in ("", "/", "/x", page.secret[:-1], page.secret + "x", "/%2e", "//"):
            code, body = page.ask_anywhere(method, prefix + path)
            assert (code, body) == (404, b"no such page\n")
    listening = Path("/proc/net/tcp").read_text()
    bound = [line.split()[1] for line in listening.splitlines() if line.split()[3] == "0A"]
    assert f"0100007F:{int(port):04X}" in bound
    assert f"00000000:{int(port):04X}" not in bound
