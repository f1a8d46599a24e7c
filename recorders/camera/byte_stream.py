"""Open a byte stream as a source, by the format that its first bytes reveal."""

from __future__ import annotations

from recorders.camera.base import Source
from recorders.camera.connection import answering
from recorders.camera.container_stream import ContainerStream
from recorders.camera.first_bytes import MULTIPART
from recorders.camera.mjpeg_stream import MjpegStream
from recorders.camera.timed_feed import TimedFeed
from recorders.closing import closed_on_failure


def stream_of(feed: TimedFeed, shown: str, *, live: bool) -> Source:
    """Open the source that a feed's first bytes call for.

    Args:
        feed: closed with the source, and where this fails.
        shown: where it comes from, for errors.
        live: whether pictures arrive as they are taken.

    Raises:
        CameraError: it is no video, or nothing came in time.
    """
    with closed_on_failure(feed), answering(shown, feed.deadline):
        kind = feed.format()
        if kind == MULTIPART:
            return MjpegStream(feed, shown)
        return ContainerStream(feed, kind, shown, live=live)
