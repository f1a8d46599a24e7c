"""Open a camera over HTTP: MJPEG or a container, by the response's first bytes."""

from __future__ import annotations

import re
from http.client import HTTPException, HTTPResponse

from recorders.camera.base import Source
from recorders.camera.byte_stream import stream_of
from recorders.camera.connection import OPENING_S, answering
from recorders.camera.http_answer import HttpCamera
from recorders.camera.mjpeg_stream import MjpegStream
from recorders.camera.timed_feed import TimedFeed
from recorders.camera.tls import Trust
from recorders.closing import closed_on_failure
from recorders.deadline import Deadline
from tunenet_logs.addresses import Address
from tunenet_logs.errors import CameraError

# In a Content-Type: what separates the parts, with quotes or without.
_BOUNDARY = re.compile(r'boundary\s*=\s*(?:"([^"]*)"|([^;\s]*))', re.IGNORECASE)

_MAX_KIND = 1000  # characters of a Content-Type that are looked at


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
        found = _BOUNDARY.search(answer.headers.get("Content-Type", "")[:_MAX_KIND])
        boundary = (found.group(1) or found.group(2) or "") if found else ""
        return MjpegStream(feed, address.shown, boundary)
    with closed_on_failure(feed), answering(address.shown, deadline):
        is_jpeg = feed.format() == "mjpeg"
        if is_jpeg and (answer.length is not None or feed.is_one_jpeg()):
            raise CameraError("gives a single picture; give the address of its video stream")
    return stream_of(feed, address.shown, live=answer.length is None)
