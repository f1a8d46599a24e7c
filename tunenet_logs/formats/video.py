"""Video files: exact stamps, upright pictures, slow motion at its true rate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.images import MAX_PIXELS

if TYPE_CHECKING:
    from av.container import InputContainer

VIDEO_TOPIC = "video"
"""What the pictures of a video file go by."""

_CONTAINERS = "mov,matroska,avi,mpeg,mpegts,flv,ogg,asf,mjpeg,h264,hevc,m4v,gif,apng,ivf,nut,y4m"
"""Only what holds pictures itself: a playlist could name any other file or host."""

_SLOW_MOTION_TAG = "com.android.capture.fps"
"""What Android's cameras call the rate at which they filmed."""

_RATES_HZ = (1.0, 100_000.0)
"""What a camera can film at; a tag beyond it is wrong."""

_SAME_RATE = 1.05
"""A slow-motion tag below so many times the file's own rate says nothing new."""


@dataclass(frozen=True, eq=False)
class Video:
    """What a video file says of itself.

    Attributes:
        codec: as FFmpeg calls it ("h264", "mjpeg").
        size: (width, height) [px] of the upright picture.
        rotation_deg: counterclockwise turn that brings a stored picture upright; a multiple of 90.
        stamps_ns: of all frames, int64, strictly increasing; from the file's creation tag on, else
            from 0.
        stored_hz: rate at which the file plays.
        filmed_hz: rate at which it was filmed: as the user says, else as a slow-motion tag says,
            else as it plays.
        warnings: what was repaired or is doubtful, in words.
    """

    path: Path
    codec: str
    size: tuple[int, int]
    rotation_deg: int
    stamps_ns: np.ndarray
    stored_hz: float
    filmed_hz: float
    warnings: tuple[str, ...]

    def frames(self) -> Iterator[Frame]:
        """The frames in order, one at a time; a camera's own JPEG untouched, all else as pixels.

        A damaged frame is left out, and those after it that are made from it.

        Raises:
            LogError: the file is damaged; the frames before that have been delivered.
        """
        if self.codec == "mjpeg" and not self.rotation_deg:
            yield from self._stored_jpegs()
            return
        with _opened(self.path) as container:
            stamps = iter(self.stamps_ns.tolist())
            made_up = False
            for picture in container.decode(_video_stream(container, self.path)):
                if picture.width * picture.height > MAX_PIXELS:
                    raise LogError(f"{self.path}: a picture claims {picture.width} px of width")
                upright = _turned(picture.to_ndarray(format="rgb24"), self.rotation_deg)
                stamp_ns = next(stamps, None)
                if stamp_ns is None:
                    return
                made_up = picture.is_corrupt or (made_up and not picture.key_frame)
                if made_up:  # the decoder fills a hole from the pictures before it
                    continue
                height, width = upright.shape[:2]
                yield Frame(stamp_ns, "rgb8", upright.tobytes(), (width, height))

    def _stored_jpegs(self) -> Iterator[Frame]:
        with _opened(self.path) as container:
            packets = filter(_is_shown, container.demux(_video_stream(container, self.path)))
            for stamp_ns, packet in zip(self.stamps_ns.tolist(), packets, strict=False):
                yield Frame(stamp_ns, "jpeg", bytes(packet))


def open_video(path: Path, filmed_hz: float | None = None) -> Video:
    """Read a video's facts and stamps; no picture but the first is decoded.

    Args:
        path: the file.
        filmed_hz: rate at which it was filmed, where the user knows better than its tags.

    Raises:
        LogError: no video, without pictures, damaged, or of a size that no camera has.
    """
    with _opened(path) as container:
        stream = _video_stream(container, path)
        tags = {**stream.metadata, **container.metadata}
        ticks = sorted(packet.pts for packet in filter(_is_shown, container.demux(stream)))
        base, codec = stream.time_base, stream.codec_context.name
    if not ticks or base is None:
        raise LogError(f"{path}: holds no frame with a time; convert it to .mp4 first")
    with _opened(path) as container:
        first = next(container.decode(_video_stream(container, path)), None)
        if first is None:
            raise LogError(f"{path}: no picture in it can be decoded; is the file whole?")
        rotation = 90 * round(first.rotation / 90)  # the file's display matrix, by a phone's pose
        size = (first.height, first.width) if rotation % 180 else (first.width, first.height)
    warnings: list[str] = []
    fresh = sorted(set(ticks))
    if len(fresh) < len(ticks):
        warnings.append(f"{len(ticks) - len(fresh)} frames have a stamp of another")
    stored_hz = _stored_rate(fresh, base)
    tagged_hz = _tagged_rate(tags.get(_SLOW_MOTION_TAG, ""), stored_hz)
    rate_hz = filmed_hz or tagged_hz or stored_hz
    slow = Fraction(stored_hz / rate_hz) if stored_hz else Fraction(1)
    start_ns = _creation_ns(tags.get("creation_time", ""))
    origin = fresh[0]
    stamps = [start_ns + round((tick - origin) * base * slow * 10**9) for tick in ticks]
    if len(fresh) < len(ticks):  # keep one stamp a frame, in order
        stamps = np.maximum.accumulate(np.array(stamps)) + np.arange(len(stamps))
    return Video(
        path=path,
        codec=codec,
        size=size,
        rotation_deg=rotation,
        stamps_ns=np.array(stamps, np.int64),
        stored_hz=stored_hz,
        filmed_hz=rate_hz,
        warnings=tuple(warnings),
    )


def read_video(path: Path) -> Episode:
    """A video file as an episode without signals.

    Raises:
        LogError: see `open_video`.
    """
    video = open_video(path)
    channel = Channel(
        topic=VIDEO_TOPIC,
        type_name=video.codec,
        encoding="video",
        log_ns=video.stamps_ns,
        pictures=True,
    )
    info = EpisodeInfo(source=f"video file {path.name}", notes=video_notes(video))
    return Episode(info, {}, (channel,), video.warnings, open_frames=partial(_frames_of, video))


def video_notes(video: Video) -> dict[str, str]:
    """What a log should say of the video that it was made from."""
    width, height = video.size
    notes = {"codec": video.codec, "size_px": f"{width}x{height}"}
    notes["rate_hz"] = f"stored {video.stored_hz:.3f}, filmed {video.filmed_hz:.3f}"
    if video.rotation_deg:
        notes["rotated_deg"] = str(video.rotation_deg)
    return notes


def _frames_of(video: Video, _topic: str) -> Iterator[Frame]:
    return video.frames()


def _turned(pixels: np.ndarray, counterclockwise_deg: int) -> np.ndarray:
    import cv2

    turns = {
        90: cv2.ROTATE_90_COUNTERCLOCKWISE,
        180: cv2.ROTATE_180,
        270: cv2.ROTATE_90_CLOCKWISE,
    }
    turn = turns.get(counterclockwise_deg % 360)
    return pixels if turn is None else cv2.rotate(pixels, turn)


@contextmanager
def _opened(path: Path) -> Iterator[InputContainer]:
    import av
    from av import logging
    from av.error import FFmpegError

    logging.set_level(None)  # errors come as exceptions; its printing would only disturb
    options = {"format_whitelist": _CONTAINERS, "protocol_whitelist": "file,pipe"}
    try:
        with open(path, "rb") as file, av.open(file, "r", options=options) as container:
            yield container
    except (FFmpegError, ValueError, OverflowError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise LogError(f"{path}: is no video that can be read ({reason})") from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error


def _is_shown(packet: Any) -> bool:
    """Whether a packet holds a picture that a player shows.

    A phone that cuts a film leaves out the pictures before the cut by the file's edit list, but
    keeps those that later ones are made from.
    """
    return bool(packet.size) and packet.pts is not None and not packet.is_discard


def _video_stream(container: InputContainer, path: Path) -> Any:
    """The first stream of pictures; the cover of a sound file is none."""
    import av.stream

    cover = av.stream.Disposition.attached_pic
    streams = [stream for stream in container.streams.video if not stream.disposition & cover]
    if not streams:
        kinds = ", ".join(sorted({str(stream.type) for stream in container.streams})) or "nothing"
        raise LogError(f"{path}: holds no video (only {kinds}); name a video of the drop")
    stream = streams[0]
    width, height = stream.codec_context.width, stream.codec_context.height
    if not 0 < width * height <= MAX_PIXELS:
        raise LogError(
            f"{path}: claims pictures of {width} x {height} px, over the limit of {MAX_PIXELS} px"
        )
    stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
    stream.thread_type = "AUTO"
    return stream


def _stored_rate(ticks: list[int], base: Fraction) -> float:
    """Frames a second at which a file plays; 0 for a single frame."""
    if len(ticks) < 2:
        return 0.0
    periods = np.diff(np.array(ticks, np.int64))
    usual = periods[np.abs(periods - np.median(periods)) <= 0.2 * np.median(periods)]
    return float(1 / (np.mean(usual) * float(base)))


def _tagged_rate(text: str, stored_hz: float) -> float | None:
    """The rate that a slow-motion tag states; None where there is none, or nothing to change."""
    try:
        rate = float(text)
    except ValueError:
        return None
    low, high = _RATES_HZ
    if not (math.isfinite(rate) and low <= rate <= high) or rate < stored_hz * _SAME_RATE:
        return None
    return rate


def _creation_ns(text: str) -> int:
    try:
        stamp = datetime.fromisoformat(text)
    except ValueError:
        return 0
    return max(0, round(stamp.timestamp()) * 10**9)
