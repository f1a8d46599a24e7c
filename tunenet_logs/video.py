"""Read video: files with exact stamps, upright frames, slow motion at its true rate; and messages.

A decoded picture stays as its decoder gave it, half of RGB's size, and becomes RGB on demand, at
the size asked for (`decoded_frame`). `open_video` and `read_video` take files, `decoded` takes
messages with one compressed frame in each. A damaged frame is left out, and what depends on it.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import chain, groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.audio import PacketTimes, SoundTrack, film_sound, film_streams, sound_stream
from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame
from tunenet_logs.errors import COPY_AGAIN, LogError
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions
from tunenet_logs.images import FREE_VIDEO_PIXELS, MAX_PIXELS, VIDEO_PIXELS_A_BYTE, mean_of_blocks
from tunenet_logs.media import FILMS, StoredTimes, VideoClock, clock_of, opened_media

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer
    from av.video.codeccontext import VideoCodecContext


def decoded_frame(
    stamp_ns: int, picture: VideoFrame, rotation_deg: int = 0, *, dithered: bool = False
) -> Frame:
    """Wrap a decoded picture as a frame, kept as its decoder gave it: half of RGB's size.

    `rotation_deg`, a multiple of 90, turns it upright counterclockwise; `dithered` ones have few
    colours that alternate, which stand for their mean.
    """
    width, height = picture.width, picture.height
    upright = (height, width) if rotation_deg % 180 else (width, height)
    pixels = partial(_rgb, picture, rotation_deg % 360, dithered)
    return Frame(stamp_ns, "rgb8", b"", upright, pixels)


def _rgb(picture: VideoFrame, rotation_deg: int, dithered: bool, scale: int) -> NDArray[np.uint8]:
    """Convert to RGB, reduced by the integer factor `scale`, shape (H, W, 3)."""
    import cv2
    from av.error import FFmpegError

    try:
        pixels = np.asarray(_CONVERTER.of(picture).to_ndarray(), np.uint8)
    except (FFmpegError, ValueError, OverflowError, MemoryError) as error:
        raise LogError(f"a picture of a video cannot be shown ({error})", COPY_AGAIN) from error
    if not dithered and picture.width % scale == picture.height % scale == 0:
        pixels, scale = mean_of_blocks(pixels, scale), 1  # the same, and less to turn
    if rotation_deg:
        turns = {90: cv2.ROTATE_90_COUNTERCLOCKWISE, 180: cv2.ROTATE_180}
        turn = turns.get(rotation_deg, cv2.ROTATE_90_CLOCKWISE)
        pixels = np.asarray(cv2.rotate(pixels, turn), np.uint8)
    if dithered:
        pixels = np.asarray(cv2.GaussianBlur(pixels, (0, 0), 1.0), np.uint8)
    return mean_of_blocks(pixels, scale)


class _Converter(threading.local):
    """Conversion to RGB by a thread: its tables are 1 MB, which a picture of its own would keep."""

    reformat: Callable[..., VideoFrame] | None = None

    def of(self, picture: VideoFrame) -> VideoFrame:
        """Convert a picture."""
        from av.video.reformatter import VideoReformatter

        self.reformat = self.reformat or VideoReformatter().reformat
        return self.reformat(picture, format="rgb24", threads=1)


_CONVERTER = _Converter()

# ---- Files

VIDEO_TOPIC = "video"  # what the pictures of a video file go by
# Streams that no container holds: FFmpeg makes times up for them.
_BARE = frozenset({"h264", "hevc", "mjpeg", "m4v", "obu", "av1"})
_MAX_PICTURES = 250_000  # of a file: two hours at 30 a second, ten minutes at 400
# Said of a film whose pictures are many and large, and hardly a byte each.
_TOO_LARGE = "claims far more pixels than a film of its size has; cut the drop out of it"


@dataclass(frozen=True, eq=False)
class Video:
    """Metadata and stamps of a video file."""

    path: Path
    codec: str  # as FFmpeg calls it ("h264", "mjpeg")
    size: tuple[int, int]  # (width, height) [px] of the upright frame
    rotation_deg: int  # counterclockwise turn that brings a stored frame upright; a multiple of 90
    # of the frames shown, increasing, in the file's own units; None where they do not identify the
    # frames
    ticks: tuple[int, ...] | None
    clock: VideoClock  # acquisition stamps
    warnings: tuple[str, ...]  # what was repaired or is doubtful, in words
    # beside the frames; None where there is none, or their times are unknown
    sound: SoundTrack | None = None

    def frames(self, _topic: str = VIDEO_TOPIC) -> Iterator[Frame]:
        """Decode the frames in order, a camera's JPEG untouched. What is damaged is left out."""
        # Their stamps are found by their time in the file, else by their order; None: not shown.
        stamps = iter(self.clock.stamps_ns.tolist())
        by_tick: dict[int | None, int] = {}
        if self.ticks and len(set(self.ticks)) == len(self.ticks):
            by_tick = dict(zip(self.ticks, stamps, strict=True))
        with opened_media(self.path, FILMS, "video") as container:
            stream = _video_stream(container, self.path)
            if self.codec == "mjpeg" and not self.rotation_deg:
                for packet in filter(_is_shown, container.demux(stream)):
                    stamp_ns = by_tick.get(packet.pts) if by_tick else next(stamps, None)
                    if stamp_ns is not None:
                        yield Frame(stamp_ns, "jpeg", bytes(packet))
                return
            made_up, left_px = False, _most_pixels(self.path)
            for picture in container.decode(stream):
                if picture.width * picture.height > MAX_PIXELS:
                    raise LogError(
                        f"{self.path}: a picture claims {picture.width} px of width", COPY_AGAIN
                    )
                left_px -= picture.width * picture.height
                if left_px < 0:
                    raise LogError(f"{self.path}: {_TOO_LARGE}")
                stamp_ns = by_tick.get(picture.pts) if by_tick else next(stamps, None)
                if stamp_ns is None:
                    continue
                made_up = picture.is_corrupt or (made_up and not picture.key_frame)
                if made_up:  # the decoder fills a hole from the pictures before it
                    continue
                yield decoded_frame(
                    stamp_ns, picture, self.rotation_deg, dithered=self.codec == "gif"
                )


def open_video(path: Path, filmed_hz: float | None = None) -> Video:
    """Read a video's metadata and stamps, at the user's `filmed_hz`; one frame alone is decoded."""
    with opened_media(path, FILMS, "video") as container:
        stream = _video_stream(container, path)
        tags = {**stream.metadata, **container.metadata}
        heard = sound_stream(container)
        times = None if heard is None else PacketTimes(heard)
        packets: list[int | None] = []  # the times of shown pictures
        for packet in container.demux(*(one for one in (stream, heard) if one is not None)):
            if times is not None and packet.stream_index != stream.index:
                times.add(packet)
            elif _is_shown(packet):
                packets.append(packet.pts)
                if len(packets) > _MAX_PICTURES:
                    break
        track = times.track(path, FILMS) if times else None
        coded_px = stream.codec_context.width * stream.codec_context.height
        base, codec = stream.time_base, stream.codec_context.name
        is_bare, is_avi = container.format.name in _BARE, container.format.name == "avi"
        stated = stream.codec_context.framerate if is_bare else stream.average_rate
    if len(packets) > _MAX_PICTURES:
        raise LogError(f"{path}: holds over {_MAX_PICTURES} pictures; cut the drop out of it")
    if coded_px * len(packets) > _most_pixels(path):
        raise LogError(f"{path}: {_TOO_LARGE}")
    timed = [tick for tick in packets if tick is not None]
    # Where few have a time, they are counted at the rate that the file states.
    ticks = None if is_bare or len(timed) < 0.9 * len(packets) else sorted(timed)
    if not packets or base is None:
        raise LogError(f"{path}: holds no picture; convert it to .mp4 first")
    with opened_media(path, FILMS, "video") as container:
        pictures = container.decode(_video_stream(container, path))
        first = next((picture for picture in pictures if not picture.is_corrupt), None)
        if first is None:
            raise LogError(f"{path}: no picture in it can be decoded", COPY_AGAIN)
        rotation = 90 * round(first.rotation / 90)  # the file's display matrix, by a phone's pose
        size = (first.height, first.width) if rotation % 180 else (first.width, first.height)
    warnings: list[str] = []
    if ticks is not None and first.pts is not None and not is_avi:  # it has no times but its order
        begun = [tick for tick in ticks if tick >= first.pts]
        if 0 < len(begun) < len(ticks):
            warnings.append(
                f"its first {len(ticks) - len(begun)} pictures need others that were cut off"
            )
            ticks = begun
    stored = StoredTimes(
        ticks=ticks or None,
        count=len(ticks or packets),
        base_s=base,
        rate_hz=float(stated) if stated else None,
        tags=tags,
    )
    clock = clock_of(stored, filmed_hz)
    sound = None
    if track is not None and clock.is_timed:
        sound = film_sound(track, stored.ticks, base, clock)
    return Video(
        path=path,
        codec=codec,
        size=size,
        rotation_deg=rotation,
        ticks=tuple(ticks) if ticks and not is_avi else None,
        clock=clock,
        warnings=(*warnings, *clock.warnings),
        sound=sound,
    )


def read_video(path: Path, options: ReadOptions = AS_IT_SAYS) -> Episode:
    """Read a video file as an episode without signals."""
    video = open_video(path, options.fps)
    stamps_ns = video.clock.stamps_ns
    channel = Channel(VIDEO_TOPIC, video.codec, "video", stamps_ns, pictures=True)
    info = EpisodeInfo(source=f"video file {path.name}", notes=video_notes(video))
    channels = (channel,) if video.sound is None else (channel, video.sound.channel())
    return Episode(
        info,
        {},
        channels,
        video.warnings,
        open_frames=video.frames,
        open_sound=video.sound and video.sound.sound,
        frames_untimed=not video.clock.is_timed,
    )


def _most_pixels(path: Path) -> int:
    """Return the limit on the total pixels of a video's frames."""
    return FREE_VIDEO_PIXELS + VIDEO_PIXELS_A_BYTE * path.stat().st_size


def is_rate_said(notes: Mapping[str, str]) -> bool:
    """Return whether `video_notes` give a filmed rate other than the file's own."""
    rates = re.findall(r"[\d.]{1,20}", notes.get("rate_hz", ""))
    return len(rates) == 2 and rates[0] != rates[1]


def video_notes(video: Video) -> dict[str, str]:
    """Describe a video for the notes of a log."""
    clock = video.clock
    rates = f"stored {clock.stored_hz:.3f}, filmed {clock.filmed_hz:.3f}"
    notes = {"codec": video.codec, "size_px": f"{video.size[0]}x{video.size[1]}"}
    notes["rate_hz"] = rates if clock.is_timed else "unknown"
    if video.rotation_deg:
        notes["rotated_deg"] = str(video.rotation_deg)
    return notes


def _is_shown(packet: Any) -> bool:
    """Return whether a packet holds a frame that a player shows: a cut video hides some."""
    return bool(packet.size) and not packet.is_discard


def _video_stream(container: InputContainer, path: Path) -> Any:
    """Return the first video stream."""
    streams = film_streams(container)
    if not streams:
        kinds = ", ".join(sorted({str(stream.type) for stream in container.streams})) or "nothing"
        raise LogError(f"{path}: holds no video (only {kinds}); name a video of the drop")
    stream = streams[0]
    if stream.codec_context is None:  # FFmpeg has no decoder of what the file says it is
        raise LogError(f"{path}: holds a video of an unknown codec", "copy it again, or convert it")
    width, height = stream.codec_context.width, stream.codec_context.height
    if not 0 < width * height <= MAX_PIXELS:
        raise LogError(
            f"{path}: claims pictures of {width} x {height} px, over the limit of {MAX_PIXELS} px",
            "make it smaller, or cut the drop out of it",
        )
    stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
    stream.thread_type = "AUTO"
    return stream


# ---- Messages, one compressed frame in each: foxglove.CompressedVideo

# From the format of a message to FFmpeg's decoder.
CODECS = {"h264": "h264", "h265": "hevc", "hevc": "hevc", "vp9": "vp9", "av1": "libdav1d"}


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
    `opened` opens a decoder by FFmpeg's name, where one knows more than packets say.
    """
    import av
    from av.error import FFmpegError

    for name, group in groupby(
        packets, key=lambda packet: CODECS.get(packet.format, packet.format)
    ):
        decoder = (opened or _opened)(name)
        waiting_ns: dict[int, int] = {}  # stamps of packets whose picture may still come
        has_begun = False
        for number, packet in enumerate(chain(group, (None,))):
            coded = None  # at the end: what waits is flushed
            if packet is not None:
                if not _is_picture(name, packet.data):  # none would mean the end of the stream
                    continue
                waiting_ns[number] = packet.stamp_ns
                if len(waiting_ns) > 256:  # no decoder reorders more
                    del waiting_ns[next(iter(waiting_ns))]
                # A packet around Python's own bytes lacks the room that decoders read ahead in, and
                # a decoder's thread that frees it waits for Python, which may wait for that thread.
                coded = av.Packet(len(packet.data))
                coded.update(packet.data)
                coded.pts = coded.dts = number
            try:
                pictures = decoder.decode(coded)
            except (FFmpegError, ValueError, OverflowError, MemoryError):
                continue
            for picture in pictures:
                stamp_ns = waiting_ns.pop(-1 if picture.pts is None else picture.pts, None)
                has_begun = has_begun or bool(picture.key_frame)
                if stamp_ns is None or not has_begun or picture.is_corrupt:
                    continue
                if 0 < picture.width * picture.height <= MAX_PIXELS:
                    yield decoded_frame(stamp_ns, picture)


def _is_picture(name: str, data: bytes) -> bool:
    """Return whether a packet may be one frame; dav1d decodes all frames of a packet at once.

    A few kB of AV1 can then be gigabytes. The OBUs that begin a frame are counted: with hidden
    references, one that is shown has a few.
    """
    if name != CODECS["av1"]:
        return bool(data)
    at = begun = 0
    for _ in range(500):  # encoders write a handful for each picture
        if at >= len(data):
            return bool(data)
        head = data[at]
        begun += (head >> 3 & 15) in (3, 6)  # OBU_FRAME_HEADER and OBU_FRAME
        if begun > 8:
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
