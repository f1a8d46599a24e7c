"""Decode video in messages, one compressed frame in each: foxglove.CompressedVideo."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError
from tunenet_logs.formats.decoded_picture import decoded_frame
from tunenet_logs.images import MAX_PIXELS

if TYPE_CHECKING:
    from av.video.codeccontext import VideoCodecContext
    from av.video.frame import VideoFrame

# From the format of a message to FFmpeg's decoder.
CODECS = {"h264": "h264", "h265": "hevc", "hevc": "hevc", "vp9": "vp9", "av1": "libdav1d"}

_MAX_WAITING = 256  # packets of which the picture may still come; no decoder reorders more


_MAX_AV1_PARTS = 500  # of a packet that are gone through; encoders write a handful for each picture
# That begin in a packet: one that is shown, and those never shown that it is made from.
_MAX_AV1_PICTURES = 8

_AV1_BEGINS_PICTURE = (3, 6)  # types of an AV1 packet's parts: OBU_FRAME_HEADER and OBU_FRAME


@dataclass(slots=True)
class Packet:
    """Content of one message; `format` is one of `CODECS`, or FFmpeg's name for another."""

    stamp_ns: int
    format: str
    data: bytes


def decoded(
    packets: Iterable[Packet], opened: Callable[[str], VideoCodecContext] | None = None
) -> Iterator[Frame]:
    """Decode a stream to "rgb8" frames, each with the stamp of its own message.

    Frames before the first key frame are left out, and so are damaged packets and frames that the
    decoder marks as corrupt. One frame is in memory at a time, beside the decoder's references.

    Args:
        packets: in sending order.
        opened: opens a decoder by FFmpeg's name, where one knows more than packets say.

    Raises:
        LogError: this machine's FFmpeg has no such decoder.
    """
    open_decoder = opened or _opened
    for name, group in groupby(
        packets, key=lambda packet: CODECS.get(packet.format, packet.format)
    ):
        yield from _Stream(name, open_decoder(name)).frames(group)


def _is_picture(name: str, data: bytes) -> bool:
    """Return whether a packet may be one frame; dav1d decodes all frames of a packet at once.

    A few kB of AV1 can then be gigabytes. The OBUs that begin a frame are counted: with hidden
    references, one that is shown has a few.
    """
    if name != CODECS["av1"]:
        return bool(data)
    at = begun = 0
    for _ in range(_MAX_AV1_PARTS):
        if at >= len(data):
            return bool(data)
        head = data[at]
        begun += (head >> 3 & 15) in _AV1_BEGINS_PICTURE
        if begun > _MAX_AV1_PICTURES:
            return False
        if not head & 2:  # it has no size: the rest of the packet
            return True
        at += 2 if head & 4 else 1
        size = shift = 0
        for byte in data[at : at + 8]:
            at += 1
            size |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                break
        at += size
    return False


class _Stream:
    """One decoder, from its first packet to its final flush."""

    def __init__(self, name: str, decoder: VideoCodecContext) -> None:
        self._name = name
        self._decoder = decoder
        self._stamps_ns: dict[int, int] = {}
        self._began = False

    def frames(self, packets: Iterable[Packet]) -> Iterator[Frame]:
        for number, packet in enumerate(packets):
            if not _is_picture(self._name, packet.data):  # none would mean the end of the stream
                continue
            self._stamps_ns[number] = packet.stamp_ns
            if len(self._stamps_ns) > _MAX_WAITING:
                del self._stamps_ns[next(iter(self._stamps_ns))]
            yield from self._pictures(number, packet.data)
        yield from self._pictures(None, b"")

    def _pictures(self, number: int | None, data: bytes) -> Iterator[Frame]:
        """Yield the frames that one packet completes; without a packet, flush the rest."""
        for picture in self._decode(number, data):
            stamp_ns = self._stamps_ns.pop(-1 if picture.pts is None else picture.pts, None)
            self._began = self._began or bool(picture.key_frame)
            if stamp_ns is None or not self._began or picture.is_corrupt:
                continue
            if 0 < picture.width * picture.height <= MAX_PIXELS:
                yield decoded_frame(stamp_ns, picture)

    def _decode(self, number: int | None, data: bytes) -> list[VideoFrame]:
        import av
        from av.error import FFmpegError

        packet = None
        if number is not None:
            # A packet around Python's own bytes lacks the room that decoders read ahead in, and a
            # decoder's thread that frees it waits for Python, which may wait for that thread.
            packet = av.Packet(len(data))
            packet.update(data)
            packet.pts = packet.dts = number
        try:
            return self._decoder.decode(packet)
        except (FFmpegError, ValueError, OverflowError, MemoryError):
            return []


def _opened(name: str) -> VideoCodecContext:
    import av
    from av import logging
    from av.codec.codec import UnknownCodecError

    logging.set_level(None)  # errors come as exceptions; its printing would only disturb
    try:
        decoder = av.CodecContext.create(name, "r")
    except UnknownCodecError as error:
        raise LogError(
            f"this machine's FFmpeg cannot decode {name}", "record the camera as JPEG or H.264"
        ) from error
    assert isinstance(decoder, av.VideoCodecContext)
    decoder.options = {"max_pixels": str(MAX_PIXELS)}
    decoder.thread_type = "SLICE"  # threads for each picture would keep one more picture each
    return decoder
