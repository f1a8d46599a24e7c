"""Read a video file as a frame source: every frame, at the times that the file states."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from recorders.camera.base import Shot
from tunenet_logs.errors import CameraError, LogError
from tunenet_logs.formats.sound_file import is_sound_alone
from tunenet_logs.formats.video import open_video, video_notes
from tunenet_logs.jpeg import compressed
from tunenet_logs.sound import Sound


class VideoFile:
    """A video file.

    Args:
        filmed_hz: rate at which it was filmed, where the user knows better than its tags.

    Raises:
        CameraError: `path` is no file, or sound alone.
        LogError: no video, or damaged.
    """

    live = False
    returns = False
    damaged = dropped = 0
    ended = ""

    def __init__(self, path: Path, filmed_hz: float | None = None) -> None:
        if path.is_dir():
            raise CameraError(f"{path}: is a directory; name a video file inside it")
        if not path.exists():
            raise CameraError(f"{path}: no such file; name a video, a camera's number or address")
        if not path.is_file():
            raise CameraError(f"{path}: is neither a file nor a camera device")
        if not path.stat().st_size:
            raise CameraError(f"{path}: is empty; copy the video again")
        try:
            self._video = open_video(path, filmed_hz)
        except LogError as error:
            if not is_sound_alone(path):
                raise
            what = f"{path}: is sound alone, and no film"
            raise CameraError(what, f"tune it as it is: tunenet-tune {path}") from error
        if not self._video.clock.is_timed:
            raise CameraError(f"{path}: does not say how many pictures a second it has; add --fps")
        self._closed = False
        self.name = f"video file {path.name}"

    def notes(self) -> dict[str, str]:
        """Return codec, size, rates and warnings."""
        notes = video_notes(self._video)
        if self._video.warnings:
            notes["warnings"] = "; ".join(self._video.warnings)
        return notes

    def frames(self) -> Iterator[Shot]:
        """Yield all frames; the file's JPEGs as they are, all else recompressed.

        Raises:
            LogError: the file is damaged; the frames before that have been delivered.
        """
        for frame in self._video.frames():
            if self._closed:
                return
            yield Shot(compressed(frame))

    def sound(self) -> Sound | None:
        """Return the sound track, on the clock of the pictures; None where there is none."""
        return self._video.sound.sound() if self._video.sound else None

    def close(self) -> None:
        """End a running `frames`; nothing else is held open."""
        self._closed = True
