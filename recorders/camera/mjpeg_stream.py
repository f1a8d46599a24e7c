"""Read an MJPEG stream (multipart/x-mixed-replace), as most cheap cameras send it."""

from __future__ import annotations

from collections.abc import Iterator

from recorders.camera.base import Shot
from recorders.camera.multipart import MultipartParser
from recorders.camera.timed_feed import TimedFeed
from recorders.camera.told_times import ToldTimes
from tunenet_logs.clock import wall_ns
from tunenet_logs.episode import Frame
from tunenet_logs.errors import CameraError
from tunenet_logs.jpeg import is_whole


class MjpegStream:
    """An MJPEG stream; its JPEGs are kept byte for byte.

    A frame's reported time is that of its part's headers, where those are a clock's.

    Args:
        shown: where the bytes come from, for errors.
        boundary: as announced, or "".
    """

    live = True
    dropped = 0

    def __init__(self, feed: TimedFeed, shown: str, boundary: str = "") -> None:
        self.name = f"camera {shown}"
        self.ended = ""
        self.returns = True
        self.damaged = 0
        self._shown = shown
        self._feed = feed
        self._parser = MultipartParser(feed.read, boundary, feed.arrived_ns)
        self._told = ToldTimes()
        self._closed = False
        self._reading = False

    def notes(self) -> dict[str, str]:
        """Return a note where the reported times were left out."""
        return {} if self._told.is_trusted else {"told_times": "left out: they are no clock's"}

    def frames(self) -> Iterator[Shot]:
        """Yield the whole JPEGs as they come, until the stream ends or falls silent.

        Raises:
            CameraError: it is no multipart stream.
        """
        self._reading = True
        self._feed.got_picture()
        try:
            for part in self._parser.parts():
                if self._closed:
                    return
                if is_whole(part.data):
                    told_ns = self._told.taken_ns(part.told_ns, part.arrived_ns)
                    yield Shot(Frame(wall_ns(part.arrived_ns), "jpeg", part.data), told_ns)
                    self._feed.got_picture()
                else:
                    self.damaged += 1
            self.returns = not self._parser.is_closed
            self.ended = "the stream was closed by the camera"
        except OSError as error:
            self.ended = self._feed.why_broken(error)
        except CameraError as error:
            raise CameraError(f"{self._shown}: {error}") from error
        finally:
            self._feed.close()

    def close(self) -> None:
        """End a running `frames`, which closes the connection."""
        self._closed = True
        self._feed.deadline.break_off()
        if not self._reading:
            self._feed.close()
