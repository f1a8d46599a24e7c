"""Read a camera over HTTP: one host alone, with its login and its certificate.

`HttpCamera` requests the address; `open_http` takes the response for MJPEG or a container.
"""

from __future__ import annotations

import re
import string
from http.client import HTTPConnection, HTTPException, HTTPResponse
from urllib.parse import SplitResult, quote, urljoin, urlsplit, urlunsplit

from tunenet_logs.addresses import Address
from tunenet_logs.errors import CameraAwayError, CameraError
from tunenet_logs.recorders.camera.base import Source
from tunenet_logs.recorders.camera.feeds import TimedFeed
from tunenet_logs.recorders.camera.network import (
    OPENING_S,
    PASSING,
    Deadline,
    Login,
    Trust,
    answering,
    connect,
    sent_on,
)
from tunenet_logs.recorders.camera.streams import MjpegStream, stream_of
from tunenet_logs.recorders.session import closed_on_failure
from tunenet_logs.terminal import short_name

_MAX_MORE_REQUESTS = 8  # requests beyond the first for one response: redirects, and the login
_MOVED = (301, 302, 303, 307, 308)

_HEADERS = {"Accept": "*/*", "Connection": "close", "User-Agent": "tunenet-record"}


class HttpCamera:
    """A host that is requested over HTTP or HTTPS.

    Redirections are followed within the host alone: elsewhere may be what only this machine can
    reach, and a camera shall not choose it. The password goes nowhere else, and never from https
    to http. There are no proxies: a camera stands in the same room.
    """

    def __init__(self, address: Address, trust: Trust) -> None:
        self._shown = address.shown
        self._first = urlsplit(address.url)
        self._trust = trust
        self._login = Login.of(address)

    def answer(self, deadline: Deadline) -> HTTPResponse:
        """Request the address; return the response (2xx), its body still to be read.

        Args:
            deadline: for all of it, the body too.

        Raises:
            CameraError: the host cannot be reached, refuses, or redirects to another.
        """
        with answering(self._shown, deadline):
            return self._followed(self._first, deadline)

    def _followed(self, parts: SplitResult, deadline: Deadline) -> HTTPResponse:
        response = self._asked(parts, deadline)
        for _ in range(_MAX_MORE_REQUESTS):
            place = response.headers.get("Location", "")
            if response.status == 401:
                self._login.take(response.headers.get_all("WWW-Authenticate", []))
            elif response.status in _MOVED and place:
                place = quote(place, safe=string.punctuation, encoding="latin-1")
                parts = self._checked(urljoin(urlunsplit(parts), place))
            else:
                break
            response.close()  # its body is not read: it may have no end
            response = self._asked(parts, deadline)
        if 200 <= response.status < 300:
            return response
        response.close()
        remedy = "check the path" if response.status == 404 else "check the address"
        kind = CameraAwayError if response.status in PASSING else CameraError
        raise kind(f"answers {response.status} {short_name(response.reason)}; {remedy}")

    def _asked(self, parts: SplitResult, deadline: Deadline) -> HTTPResponse:
        path = urlunsplit(("", "", parts.path or "/", parts.query, ""))
        connection = _Connection(parts, deadline, self._trust)
        login = self._login.header("GET", path)
        headers = _HEADERS | ({"Authorization": login} if login else {})
        with closed_on_failure(connection):
            connection.request("GET", path, headers=headers)
            response = connection.getresponse()
        if connection.sock is not None:  # the answer holds it open, and closes it
            connection.sock.close()
            connection.sock = None
        return response

    def _checked(self, url: str) -> SplitResult:
        """Parse a URL; raise unless it is on the camera's host, and as well encrypted."""
        parts = urlsplit(url)
        is_there = parts.scheme in ("http", "https") and parts.hostname == self._first.hostname
        is_weaker = (
            self._first.scheme == "https" and parts.scheme == "http" and self._login.is_known
        )
        if not is_there or is_weaker:
            raise sent_on(url, ("http", "https"))
        return parts


class _Connection(HTTPConnection):
    """An HTTP or HTTPS connection with a deadline."""

    def __init__(self, parts: SplitResult, deadline: Deadline, trust: Trust) -> None:
        self.default_port = 443 if parts.scheme == "https" else 80
        super().__init__(parts.hostname or "", parts.port or self.default_port)
        self._deadline = deadline
        self._trust = trust if parts.scheme == "https" else None

    def connect(self) -> None:
        self.sock = connect(self.host, self.port, self._deadline, self._trust)


# ---- Opening: multipart as the response announces it, all else by its first bytes

# In a Content-Type: what separates the parts, with quotes or without.
_BOUNDARY = re.compile(r'boundary\s*=\s*(?:"([^"]*)"|([^;\s]*))', re.IGNORECASE)
_MAX_CONTENT_TYPE = 1000  # characters of it that are searched


class HttpFeed:
    """The body of an HTTP response."""

    def __init__(self, answer: HTTPResponse) -> None:
        self._answer = answer

    def read(self, most: int) -> bytes:
        """See `ByteFeed`."""
        try:
            data = self._answer.read1(most)
        except HTTPException as error:
            raise ConnectionError(f"{type(error).__name__} in what it sends") from error
        if not data and self._answer.length:
            raise ConnectionError(f"{self._answer.length} bytes before its end")
        return data

    def close(self) -> None:
        """See `ByteFeed`."""
        self._answer.close()


def open_http(address: Address, timeout_s: float, trust: Trust) -> Source:
    """Open the video that a camera serves over HTTP.

    User and password in the address are sent when the camera asks for them, and go nowhere else.

    Args:
        address: the camera's URL.
        timeout_s: the longest silence, and the longest without a whole picture. Opening may take
            10 s, or so long where that is longer.
        trust: which certificates are trusted.

    Raises:
        CameraError: nothing answers there, or not with a video.
    """
    deadline = Deadline(timeout_s, max(OPENING_S, timeout_s))
    answer = HttpCamera(address, trust).answer(deadline)
    feed = TimedFeed(HttpFeed(answer), deadline, timeout_s)
    if answer.headers.get_content_maintype() == "multipart":
        found = _BOUNDARY.search(answer.headers.get("Content-Type", "")[:_MAX_CONTENT_TYPE])
        boundary = (found.group(1) or found.group(2) or "") if found else ""
        return MjpegStream(feed, address.shown, boundary)
    with closed_on_failure(feed), answering(address.shown, deadline):
        is_jpeg = feed.format() == "mjpeg"
        if is_jpeg and (answer.length is not None or feed.is_one_jpeg()):
            raise CameraError("gives a single picture; give the address of its video stream")
    return stream_of(feed, address.shown, live=answer.length is None)
