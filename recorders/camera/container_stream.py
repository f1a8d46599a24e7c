"""Video in a container (MPEG-TS, MP4, Matroska, FLV, ...) or as a bare stream (H.264, JPEG)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, NoReturn

from recorders.camera.base import Shot
from recorders.camera.connection import answering
from recorders.camera.packet_stream import PacketStream
from recorders.camera.timed_feed import TimedFeed
from tunenet_logs.clock import wall_ns
from tunenet_logs.errors import CameraError, LogError
from tunenet_logs.formats.mp4_claims import Mp4Claims
from tunenet_logs.images import MAX_PIXELS

if TYPE_CHECKING:
    from av.container import InputContainer

_OPTIONS = {
    "analyzeduration": "1000000",  # [us]; FLV would be read for 5 s before its first picture
    "max_pixels": str(MAX_PIXELS),
    "protocol_whitelist": "",
}

# Formats that tell no times: their pictures are stamped as they come, though a file holds them.
_TIMELESS = frozenset({"h264", "hevc", "mjpeg"})


class ContainerStream(PacketStream):
    """The video in a byte stream, demuxed by FFmpeg, which opens nothing itself.

    Args:
        kind: FFmpeg's name of the format.
        shown: where the bytes come from, for errors.
        live: whether pictures arrive as they are taken; else the container's timestamps are used.

    Raises:
        CameraError: it holds no video, or nothing came in time.
    """

    def __init__(self, feed: TimedFeed, kind: str, shown: str, *, live: bool) -> None:
        self._bytes = _Bytes(feed, kind)
        super().__init__(
            _opened(self._bytes, kind),
            shown,
            feed.timeout_s,
            arrived_ns=lambda packet: wall_ns(feed.arrived_ns(packet.pos)),
        )
        self.live = live or kind in _TIMELESS
        self.returns = self.live
        self._feed = feed
        self._shown = shown

    def frames(self) -> Iterator[Shot]:
        """Yield the pictures as they come, until the stream ends or falls silent.

        Raises:
            CameraError: the stream is invalid.
        """
        self._feed.got_picture()
        try:
            for shot in super().frames():
                self._feed.got_picture()
                if self.live:
                    yield shot
                elif shot.told_ns is not None:
                    yield Shot(replace(shot.frame, stamp_ns=shot.told_ns), None, shot.stands_alone)
        finally:
            self._feed.close()
        broken = self._bytes.broken
        if isinstance(broken, CameraError):
            with answering(self._shown, self._feed.deadline):
                raise broken
        if broken is not None:
            self.ended = self._feed.why_broken(broken)
        elif not self.live:
            self.ended = ""

    def close(self) -> None:
        """End a running `frames`, which closes the feed."""
        self._feed.deadline.break_off()
        super().close()


class _Bytes:
    """A feed as FFmpeg's input: a broken feed ends, and what came before is kept.

    An exception would be lost on its way through FFmpeg, or printed.

    Attributes:
        broken: the error that ended it; None while it runs, and at a regular end.
    """

    def __init__(self, feed: TimedFeed, kind: str) -> None:
        self.broken: OSError | CameraError | None = None
        self._feed = feed
        self._claims = Mp4Claims() if kind == "mov" else None

    def read(self, most: int) -> bytes:
        """See `ByteFeed`."""
        if self.broken is not None:
            return b""
        try:
            data = self._feed.read(most)
            if self._claims is not None:
                self._claims.check(data)
        except (OSError, CameraError) as error:
            self.broken = error
        except LogError as error:
            self.broken = CameraError(str(error))
        else:
            return data
        return b""


def _opened(feed: _Bytes, kind: str) -> InputContainer:
    import av
    from av import logging
    from av.error import FFmpegError

    logging.set_level(None)  # its lines would stand beside ours
    try:
        return av.open(feed, "r", format=kind, options=_OPTIONS, io_open=_refuse)
    except (FFmpegError, ValueError) as error:
        if feed.broken is not None:
            raise feed.broken from error
        why = getattr(error, "strerror", None) or type(error).__name__
        raise CameraError(
            f"begins like {kind} and cannot be read as such ({why}); is it a video's address?"
        ) from error


def _refuse(*_words: object) -> NoReturn:
    """Refuse to open what a container names, be it a file of this machine or another host."""
    raise CameraError("names other files or hosts; only what it holds itself is recorded")
