"""Recorded images in a review."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import rerun as rr

from analysis.record import Tuning
from analysis.review.drawing import GROUND, MUTED, at_seconds
from analysis.tracking.kept_film import kept_film
from analysis.tracking.pictures import readable_frames
from tunenet_logs.episode import Episode, Frame
from tunenet_logs.errors import LogError

# Longer side of a picture that is made smaller: about what a view on a screen shows.
_REDUCED_PX = 640

_QUALITY = 85  # of its JPEG, 0 to 100: what the eye cannot tell from the original
_FONT = 0  # OpenCV's number of its plain sans serif
# Pictures of a recording in which nothing was found: enough to see why, and soon loaded.
_MAX_RECORDED = 240


def log_recorded_film(stream: rr.RecordingStream, tuning: Tuning) -> bool:
    """Log the images of a log without a drop; return False if there are none."""
    episode = tuning.episode
    if episode is None or episode.signals or not episode.picture_topics:
        return False
    total = sum(
        channel.messages
        for channel in episode.channels
        if channel.topic == episode.picture_topics[0]
    )
    every = max(1, -(-total // _MAX_RECORDED))
    frames: list[Frame] = []
    for index, frame in enumerate(frames_to_show(episode, episode.picture_topics[0])):
        if index % every == 0:
            with suppress(LogError):
                frames.append(reduced(frame))
    if frames:
        start_ns = frames[0].stamp_ns
        send_pictures(stream, frames, start_ns)
    return bool(frames)


def frames_to_show(episode: Episode, topic: str) -> Iterator[Frame]:
    """Yield a topic's frames as recorded; raw ones reduced, if that was done."""
    film = kept_film(episode, topic)
    if film is not None and film.is_bare and not film.is_part and film.pictures:
        return film.frames()
    return readable_frames(episode, topic)


def send_pictures(stream: rr.RecordingStream, frames: list[Frame], start_ns: int) -> None:
    """Send JPEG images on the log's time, which is 0 at `start_ns`."""
    seconds = np.array([(frame.stamp_ns - start_ns) * 1e-9 for frame in frames])
    columns = rr.EncodedImage.columns(
        blob=[frame.data for frame in frames], media_type=["image/jpeg"] * len(frames)
    )
    stream.send_columns("film/picture", indexes=[at_seconds(seconds)], columns=columns)


def reduced(frame: Frame) -> Frame:
    """Downsample a frame to a small JPEG."""
    import cv2

    picture = frame.decode()
    height, width = picture.shape[:2]
    scale = min(1.0, _REDUCED_PX / max(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    bgr = cv2.cvtColor(small, cv2.COLOR_RGB2BGR)
    _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return Frame(frame.stamp_ns, "jpeg", data.tobytes())


def blank_picture(size_px: tuple[int, int], words: str) -> bytes:
    """Make a JPEG of the background's colour with these words in the middle."""
    import cv2

    width, height = size_px
    sheet = np.full((height, width, 3), GROUND[::-1], np.uint8)
    (across, up), _ = cv2.getTextSize(words, _FONT, 1.0, 1)
    scale = 0.4 * width / across
    corner = round((width - scale * across) / 2), round((height + scale * up) / 2)
    cv2.putText(sheet, words, corner, _FONT, scale, MUTED[::-1], 1, cv2.LINE_AA)
    return cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
