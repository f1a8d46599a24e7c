"""Encode a synthetic clip as users have it: a phone's mp4, or a log of JPEGs."""

from __future__ import annotations

from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np

from analysis.evaluation.clips.film import clip_frames, frame_seconds
from analysis.evaluation.clips.order import ClipOrder
from tunenet_logs.arrays import Picture
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.writer import EpisodeWriter

_TICKS_HZ = 90_000  # the clock of an mp4's stamps, as most phones have it
# Bytes from the name of an mp4's track header to its display matrix (ISO/IEC 14496-12, 8.3.2).
_MATRIX_AT = 44

# What can be made of one clip that changes nothing of its ball.
VERSIONS = (
    "as filmed",
    "1/8 speed",
    "half size",
    "mirrored",
    "rotated, flagged",
    "every 2nd frame",
)

_ROTATED, _HALF_SIZE, _MIRRORED = VERSIONS[4], VERSIONS[2], VERSIONS[3]


class _Sink(Protocol):
    """Sink of frames."""

    def add(self, picture: Picture, second: float) -> None: ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None: ...


def write_clip(order: ClipOrder, folder: Path) -> Path:
    """Write the clip as filmed to a new file."""
    return write_versions(order, folder, VERSIONS[:1])[0]


def write_versions(order: ClipOrder, folder: Path, versions: tuple[str, ...]) -> list[Path]:
    """Render one clip once, and write some of its `VERSIONS`; one file each."""
    suffix = "mcap" if order.as_log and versions == VERSIONS[:1] else "mp4"
    paths = [folder / f"clip_{VERSIONS.index(one)}.{suffix}" for one in versions]
    with ExitStack() as stack:
        sinks: list[_Sink] = []
        for one, path in zip(versions, paths, strict=True):
            sink: _Sink = _Log(order, path) if suffix == "mcap" else _Mp4(order, path, one)
            sinks.append(stack.enter_context(sink))
        seconds = frame_seconds(order) + order.held_s
        for at, (picture, second) in enumerate(zip(clip_frames(order), seconds, strict=True)):
            for one, sink in zip(versions, sinks, strict=True):
                if one != VERSIONS[5] or at % 2 == 0:
                    sink.add(
                        _changed(picture, one), float(second) * (8 if one == VERSIONS[1] else 1)
                    )
    for one, path in zip(versions, paths, strict=True):
        if one == _ROTATED:
            _flag_rotation(path)
    return paths


def _changed(picture: Picture, version: str) -> Picture:
    import cv2

    if version == _HALF_SIZE:
        height, width = picture.shape[:2]
        size = (width // 2, height // 2)
        return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    if version == _MIRRORED:
        return np.ascontiguousarray(picture[:, ::-1])
    if version == _ROTATED:
        return np.asarray(cv2.rotate(picture, cv2.ROTATE_90_COUNTERCLOCKWISE), np.uint8)
    return picture


class _Mp4:
    """H.264 with frame times."""

    def __init__(self, order: ClipOrder, path: Path, version: str) -> None:
        import av

        width, height = order.view.size_px
        if version == _HALF_SIZE:
            width, height = width // 2, height // 2
        if version == _ROTATED:
            width, height = height, width
        self._size = (width // 2 * 2, height // 2 * 2)  # colours are stored for two by two pixels
        self._container = av.open(str(path), "w")
        options = {"crf": str(order.h264_factor), "preset": "ultrafast"}
        stream: Any = self._container.add_stream("libx264", rate=30, options=options)
        stream.width, stream.height = self._size
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, _TICKS_HZ)
        stream.thread_count = 1
        self._stream = stream

    def add(self, picture: Picture, second: float) -> None:
        import av

        width, height = self._size
        cut = np.ascontiguousarray(picture[:height, :width])
        frame = av.VideoFrame.from_ndarray(cut, format="rgb24")
        frame.pts, frame.time_base = round(second * _TICKS_HZ), Fraction(1, _TICKS_HZ)
        self._container.mux(self._stream.encode(frame))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()


class _Log:
    """MCAP of JPEGs, as our own recorder writes."""

    def __init__(self, order: ClipOrder, path: Path) -> None:
        self._writer = EpisodeWriter(path, EpisodeInfo(), live=False)
        self._quality = order.jpeg_quality

    def add(self, picture: Picture, second: float) -> None:
        import cv2

        options = [cv2.IMWRITE_JPEG_QUALITY, self._quality]
        _, data = cv2.imencode(".jpg", picture[:, :, ::-1], options)
        self._writer.write_frame("/camera", Frame(round(second * 1e9), "jpeg", data.tobytes()))

    def __enter__(self) -> Self:
        self._writer.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._writer.__exit__(kind, error, traceback)


def _flag_rotation(path: Path) -> None:
    """Set the rotation flag of an mp4 to a quarter turn, clockwise."""
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + _MATRIX_AT
    rows = np.array([[0, 1 << 16, 0], [-(1 << 16), 0, 0], [0, 0, 1 << 30]], ">i4")
    data[at : at + 36] = rows.tobytes()
    path.write_bytes(data)
