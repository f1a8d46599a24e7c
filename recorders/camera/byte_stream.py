"""A stream of bytes as a source, by what its first bytes are."""

from __future__ import annotations

from recorders.camera.base import Source
from recorders.camera.connection import answering
from recorders.camera.container_stream import ContainerStream
from recorders.camera.first_bytes import MULTIPART, PLAYLIST
from recorders.camera.mjpeg_stream import MjpegStream
from recorders.camera.timed_feed import TimedFeed
from recorders.closing import closed_on_failure
from tunenet_logs.errors import CameraError


def stream_of(feed: TimedFeed, shown: str, *, live: bool) -> Source:
    """The source of what a feed brings.

    Args:
        feed: closed with the source, and where this fails.
        shown: where it comes from.
        live: whether its pictures come as they are taken.

    Raises:
        CameraError: it brings no video, or nothing in time.
    """
    with closed_on_failure(feed), answering(shown, feed.deadline):
        kind = feed.format()
        if kind == PLAYLIST:
            raise CameraError("is a playlist (HLS); give the http:// address where it is kept")
        if kind == MULTIPART:
            return MjpegStream(feed, shown)
        return ContainerStream(feed, kind, shown, live=live)
