"""A camera that is asked over HTTP: its answer's first bytes say how it sends its video."""

from __future__ import annotations

import math
import re
from http.client import HTTPException, HTTPResponse

from recorders.camera.base import Source
from recorders.camera.byte_stream import stream_of
from recorders.camera.connection import OPENING_S, answering
from recorders.camera.first_bytes import PLAYLIST
from recorders.camera.hls_feed import HlsFeed
from recorders.camera.http_answer import HttpCamera
from recorders.camera.mjpeg_stream import MjpegStream
from recorders.camera.timed_feed import TimedFeed
from recorders.camera.tls import Trust
from recorders.closing import closed_on_failure
from recorders.deadline import Deadline
from tunenet_logs.addresses import Address
from tunenet_logs.errors import CameraError

_BOUNDARY = re.compile(r'boundary\s*=\s*(?:"([^"]*)"|([^;\s]*))', re.IGNORECASE)
"""In a Content-Type: what separates the parts, with quotes or without."""

_LONGEST_KIND = 1000
"""Characters of a Content-Type that are looked at."""

_PIECES_APART = 1.5
"""The longest from one piece to the next, in lengths of one: a camera writes them when it likes."""


class HttpFeed:
    """The body of an answer."""

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
    """The video that a camera answers with.

    User and password in the address are sent when the camera asks for them, and go nowhere else.

    Args:
        address: where.
        timeout_s: the longest silence, and the longest without a whole picture. Opening may take
            10 s, or so long where that is longer.
        trust: which certificate is believed.

    Raises:
        CameraError: nothing answers there, or not with a video.
    """
    deadline = Deadline(timeout_s, max(OPENING_S, timeout_s))
    camera = HttpCamera(address, trust)
    answer = camera.answer(address.url, deadline)
    feed = TimedFeed(HttpFeed(answer), deadline, timeout_s)
    if answer.headers.get_content_maintype() == "multipart":
        found = _BOUNDARY.search(answer.headers.get("Content-Type", "")[:_LONGEST_KIND])
        boundary = (found.group(1) or found.group(2) or "") if found else ""
        return MjpegStream(feed, address.shown, boundary)
    with closed_on_failure(feed), answering(address.shown, deadline):
        kind = feed.format()
        if kind == PLAYLIST:
            return _open_pieces(address, camera, feed, answer.url)
        if kind == "mjpeg" and (answer.length is not None or feed.is_one_jpeg()):
            raise CameraError("gives a single picture; give the address of its video stream")
    return stream_of(feed, address.shown, live=answer.length is None)


def _open_pieces(address: Address, camera: HttpCamera, playlist: TimedFeed, url: str) -> Source:
    """The pieces that a playlist names, all of the same host."""
    deadline, timeout_s = playlist.deadline, playlist.timeout_s

    def ask(place: str) -> HttpFeed:
        try:
            return HttpFeed(camera.answer(place, deadline))
        except CameraError as error:
            if isinstance(error.__cause__, TimeoutError):  # how the stream ends, not an error
                raise error.__cause__ from error
            raise

    pieces = HlsFeed(url, playlist, ask, deadline)
    if pieces.live and timeout_s < _PIECES_APART * pieces.target_s:
        longer_s = math.ceil(2 * _PIECES_APART * pieces.target_s)
        raise CameraError(
            f"sends pieces of {pieces.target_s:g} s, and --stall {timeout_s:g} ends it between "
            f"them; let it send shorter ones, or add --stall {longer_s}"
        )
    return stream_of(TimedFeed(pieces, deadline, timeout_s), address.shown, live=pieces.live)
