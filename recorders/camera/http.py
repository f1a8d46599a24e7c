"""Read a camera over HTTP: one host alone, with its login and its certificate.

`answer_of` requests the address; `open_http` takes the response for MJPEG or a container.
"""

from __future__ import annotations

import re
import string
from http.client import HTTPConnection, HTTPException, HTTPResponse
from urllib.parse import SplitResult, quote, urljoin, urlsplit, urlunsplit

from tunenet_logs.addresses import Address
from tunenet_logs.errors import CameraError
from tunenet_logs.recorders.camera import network
from tunenet_logs.recorders.camera.base import Source
from tunenet_logs.recorders.camera.feeds import TimedFeed
from tunenet_logs.recorders.camera.streams import MjpegStream, stream_of
from tunenet_logs.recorders.session import closed_on_failure


def answer_of(address: Address, trust: network.Trust, deadline: network.Deadline) -> HTTPResponse:
    """Request an address; return the response (2xx), its body still to be read.

    Redirections are followed within the host alone: elsewhere may be what only this machine can
    reach, and a camera shall not choose it. The password goes nowhere else, and never from https
    to http. There are no proxies: a camera stands in the same room.
    """
    parts = first = urlsplit(address.url)
    login = network.Login.of(address)
    asked = 0
    while True:
        path = urlunsplit(("", "", parts.path or "/", parts.query, ""))
        connection = _Connection(parts, deadline, trust)
        proof = login.header("GET", path)
        with closed_on_failure(connection):
            headers = {"Accept": "*/*", "Connection": "close", "User-Agent": "tunenet-record"}
            headers |= {"Authorization": proof} if proof else {}
            connection.request("GET", path, headers=headers)
            response = connection.getresponse()
        if connection.sock is not None:  # the answer holds it open, and closes it
            connection.sock.close()
            connection.sock = None
        if 200 <= response.status < 300:
            return response
        response.close()  # its body is not read: it may have no end
        place = response.headers.get("Location", "")
        is_moved = bool(place) and response.status in (301, 302, 303, 307, 308)
        asked += 1
        if asked > 8 or not (is_moved or response.status == 401):  # redirects, and the login
            raise network.refused(response.status, response.reason)
        if response.status == 401:
            login.take(response.headers.get_all("WWW-Authenticate", []))
        else:
            place = quote(place, safe=string.punctuation, encoding="latin-1")
            url = urljoin(urlunsplit(parts), place)
            parts = urlsplit(url)
            is_there = parts.scheme in ("http", "https") and parts.hostname == first.hostname
            is_weaker = parts.scheme == "http" and first.scheme == "https" and login.is_known
            if not is_there or is_weaker:
                raise network.sent_on(url, ("http", "https"))


class _Connection(HTTPConnection):
    """An HTTP or HTTPS connection with a deadline."""

    def __init__(
        self, parts: SplitResult, deadline: network.Deadline, trust: network.Trust
    ) -> None:
        self.default_port = 443 if parts.scheme == "https" else 80
        super().__init__(parts.hostname or "", parts.port or self.default_port)
        self._deadline = deadline
        self._trust = trust if parts.scheme == "https" else None

    def connect(self) -> None:
        self.sock = network.connect(self.host, self.port, self._deadline, self._trust)


class _HttpFeed:
    """The body of an HTTP response."""

    def __init__(self, answer: HTTPResponse) -> None:
        self._answer = answer

    def read(self, most: int) -> bytes:
        try:
            data = self._answer.read1(most)
        except HTTPException as error:
            raise ConnectionError(f"{type(error).__name__} in what it sends") from error
        if not data and self._answer.length:
            raise ConnectionError(f"{self._answer.length} bytes before its end")
        return data

    def close(self) -> None:
        self._answer.close()


def open_http(address: Address, timeout_s: float, trust: network.Trust) -> Source:
    """Open the video that a camera serves over HTTP."""
    # User and password in the address are sent when the camera asks for them, and go nowhere else.
    deadline = network.Deadline.opening()
    with network.answering(address.shown, deadline):
        answer = answer_of(address, trust, deadline)
    deadline.await_pictures(timeout_s)
    feed = TimedFeed(_HttpFeed(answer), deadline, timeout_s)
    if answer.headers.get_content_maintype() == "multipart":
        # What separates the parts, with quotes or without; a thousand characters are enough.
        boundary = r'(?i)boundary\s*=\s*(?:"([^"]*)"|([^;\s]*))'
        found = re.search(boundary, answer.headers.get("Content-Type", "")[:1000])
        boundary = (found[1] or found[2] or "") if found else ""
        return MjpegStream(feed, address.shown, boundary)
    with closed_on_failure(feed), network.answering(address.shown, deadline):
        is_jpeg = feed.format() == "mjpeg"
        if is_jpeg and (answer.length is not None or feed.is_one_jpeg()):
            raise CameraError("gives a single picture; give the address of its video stream")
    return stream_of(feed, address.shown, live=answer.length is None)
