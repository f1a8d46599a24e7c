"""A network camera that speaks RTSP, over TCP."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from recorders.camera.address import Address
from tunenet_logs.clock import wall_ns
from tunenet_logs.episode import Frame
from tunenet_logs.errors import CameraError
from tunenet_logs.images import MAX_PIXELS
from tunenet_logs.jpeg import compressed, is_whole

if TYPE_CHECKING:
    from av import Packet

_LEAP_NS = 5_000_000_000
"""The camera's clock has jumped (or started anew) where it differs by more from the arrival."""


class RtspStream:
    """An RTSP stream; JPEGs stay as they are, all else is decoded and compressed anew.

    A frame's stamp is the camera's own (RTP), counted from when the first frame arrived: arrival
    itself would be bent by the packets that are read ahead to learn what the stream holds.

    Args:
        address: where.
        timeout_s: for connecting, and for the longest silence.

    Raises:
        CameraError: nothing answers there, or not with a video.
    """

    live = True

    def __init__(self, address: Address, timeout_s: float) -> None:
        import av
        from av import logging
        from av.error import FFmpegError

        logging.set_level(None)  # errors come as exceptions; its printing could show the password
        self.name = f"camera {address.shown}"
        self.ended = ""
        self.damaged = 0
        self._closed = False
        self._reading = False
        self._timeout_s = timeout_s
        self._anchor_ns: int | None = None
        options = {"rtsp_transport": "tcp"}
        try:
            self._container = av.open(
                address.full_url, "r", format="rtsp", options=options, timeout=timeout_s
            )
        except (FFmpegError, ValueError) as error:
            why = getattr(error, "strerror", None) or type(error).__name__
            raise CameraError(
                f"{address.shown}: gives no video ({why}); is the camera on, and the address right?"
            ) from error
        if not self._container.streams.video:
            self._container.close()
            raise CameraError(f"{address.shown}: holds no video; give the address of its video")
        self._stream = self._container.streams.video[0]
        self._stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
        self._codec = self._stream.codec_context.name

    def notes(self) -> dict[str, str]:
        """The codec, and how its frames are stamped."""
        return {"codec": self._codec, "stamps": "camera"}

    def frames(self) -> Iterator[Frame]:
        """The frames as they come, until the camera ends the stream or falls silent.

        They begin with the first that has a time: FFmpeg gives none to the very first.
        """
        from av.error import ExitError, FFmpegError

        self._reading = True
        try:
            for packet in self._container.demux(self._stream):
                if self._closed:
                    return
                yield from self._pictures(packet)
            self.ended = "the stream was closed by the camera"
        except ExitError:  # the time-out interrupts the read
            self.ended = f"no data for {self._timeout_s:.1f} s"
        except FFmpegError as error:
            self.ended = f"the stream broke ({error.strerror})"
        finally:
            self._container.close()

    def close(self) -> None:
        """End running `frames` with the next packet; the connection is closed there."""
        self._closed = True
        if not self._reading:
            self._container.close()

    def _pictures(self, packet: Packet) -> Iterator[Frame]:
        from av.error import InvalidDataError

        if self._codec == "mjpeg":
            data = bytes(packet)
            if not is_whole(data):
                self.damaged += bool(data)
            elif packet.pts is not None:
                yield Frame(self._stamp_ns(packet.pts), "jpeg", data)
            return
        try:
            pictures = self._stream.codec_context.decode(packet)
        except InvalidDataError:  # lost packets, or no key frame yet: the next may be whole
            self.damaged += 1
            return
        for picture in pictures:
            if picture.pts is None:
                continue
            pixels = np.ascontiguousarray(picture.to_ndarray(format="rgb24"))
            height, width = pixels.shape[:2]
            stamp_ns = self._stamp_ns(picture.pts)
            yield compressed(Frame(stamp_ns, "rgb8", pixels.tobytes(), (width, height)))

    def _stamp_ns(self, ticks: int) -> int:
        """A frame's time; anchored anew where the camera's clock leaps away from ours."""
        arrived_ns = wall_ns(time.monotonic_ns())
        base = self._stream.time_base
        if base is None:
            return arrived_ns
        camera_ns = round(ticks * base * 10**9)
        if self._anchor_ns is None or abs(self._anchor_ns + camera_ns - arrived_ns) > _LEAP_NS:
            self._anchor_ns = arrived_ns - camera_ns
        return self._anchor_ns + camera_ns
