"""Short films in any container, and recordings of what a test brings."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import av
import numpy as np

from tests.recorders.live_wait import LAST_RESORT_S
from tests.recorders.mjpeg_camera import number_in, picture
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.base import CapturedFrame, Source
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.recording import Limits, record_camera
from tunenet_logs.recorders.session import Summary
from tunenet_logs.terminal import Progress

RATE_HZ = 30  # of `film`
SIZE = (320, 240)  # of a numbered picture
PATIENT = CameraOptions(stall_s=LAST_RESORT_S)


def numbered(number: int) -> np.ndarray:
    """RGB pixels that hold a number, as blocks that survive a video codec."""
    width, height = SIZE
    pixels = np.full((height, width, 3), (200, 40, 90), np.uint8)
    for bit in range(16):
        pixels[:16, bit * 16 : bit * 16 + 16] = 255 if number >> bit & 1 else 0
    return pixels


def write_video(
    path: Path,
    ticks: Iterable[int],
    codec: str = "libx264",
    *,
    ticks_hz: int = 600,
    drawn: Callable[[int], np.ndarray] = numbered,
    form: str | None = None,
    muxing: dict[str, str] | None = None,
    **coding: str,
) -> Path:
    """Write a video with a picture at each tick [1 / ticks_hz s].

    Args:
        ticks_hz: 600, or the rate itself.
        drawn: RGB pixels of a picture's number.
        form: FFmpeg's name of the container, where the file's name does not tell it.
    """
    with av.open(str(path), "w", format=form, options=muxing or {}) as container:
        stream: Any = container.add_stream(codec, rate=min(ticks_hz, 60), options=coding)
        stream.height, stream.width = drawn(0).shape[:2]
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.time_base = stream.codec_context.time_base = Fraction(1, ticks_hz)
        for number, tick in enumerate(ticks):
            frame = av.VideoFrame.from_ndarray(drawn(number), format="rgb24")
            frame.pts, frame.time_base = tick, Fraction(1, ticks_hz)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


@cache
def film(kind: str, codec: str = "libx264", count: int = 30, **options: str) -> bytes:
    """A film of 64 x 48 px and 30 Hz whose pictures differ, in a container of FFmpeg's."""

    def drawn(number: int) -> np.ndarray:
        pixels = np.full((48, 64, 3), 60, np.uint8)
        pixels[:, 2 * number % 60 :][:, :4] = 220
        return pixels

    h264 = {"tune": "zerolatency", "preset": "ultrafast"}
    coding: dict[str, Any] = h264 if codec == "libx264" else {}
    with tempfile.TemporaryDirectory() as folder:  # to write an index first, it is read again
        path = Path(folder) / "film"
        coding |= {"form": kind, "muxing": options, "ticks_hz": RATE_HZ, "drawn": drawn}
        write_video(path, range(count), codec, g="10", **coding)
        return path.read_bytes()


def write_jpegs(path: Path, count: int) -> Path:
    """Write a video that holds given JPEGs as its packets, as a webcam's file does."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("mjpeg", rate=60)
        (stream.width, stream.height), stream.pix_fmt = SIZE, "yuvj420p"
        for number in range(count):
            packet = av.Packet(picture(number))
            packet.stream, packet.pts, packet.dts = stream, number, number
            packet.time_base = Fraction(1, 60)
            container.mux(packet)
    return path


def write_moved(whole: Path, cut: Path, by_s: float, first: int = 0, **muxing: str) -> Path:
    """Write a video's packets from one on, as they are compressed, earlier by so much."""
    with av.open(str(whole)) as source, av.open(str(cut), "w", options=muxing) as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in [one for one in source.demux(video=0) if one.size][first:]:
            if by_s and packet.pts is not None and packet.dts is not None:
                moved = round(Fraction(by_s).limit_denominator(1000) / packet.time_base)
                packet.pts, packet.dts = packet.pts - moved, packet.dts - moved
            packet.stream = stream
            target.mux(packet)
    return cut


def pixels_of(path: Path) -> Iterator[bytes]:
    """A film's pictures, as PyAV decodes them."""
    with av.open(str(path)) as container:
        for shown in container.decode(video=0):
            yield shown.to_ndarray(format="rgb24").tobytes()


def recorded(
    source: Source, path: Path, progress: Progress | None = None, **limits: Any
) -> tuple[Summary, Episode]:
    """Record a source to `path` in this process, and read it back; all its counts agree."""
    summary = record_camera(
        source,
        EpisodeInfo(kind="drop"),
        path,
        limits=Limits(**{"stall_s": LAST_RESORT_S, **limits}),
        overwrite=False,
        progress=progress or Progress(quiet=True),
    )
    episode = read_episode(path)
    counts = episode.info.counts
    assert not episode.warnings
    assert not path.with_name(f"{path.name}.active").exists()
    assert counts["captured"] == counts["written"] + counts["dropped"] == summary.captured
    assert counts["written"] == len(list(episode.frames())) == summary.written
    return summary, episode


def numbers(episode: Episode) -> list[int]:
    return [number_in(frame.decode()) for frame in episode.frames()]


class MadeSource:
    name, live, returns = "camera made up", True, False
    ended, damaged, dropped = "", 0, 0

    def __init__(self, shots: Iterator[CapturedFrame]) -> None:
        self.closed = threading.Event()
        self._shots = shots

    def notes(self) -> dict[str, str]:
        return {}

    def frames(self) -> Iterator[CapturedFrame]:
        return self._shots

    def close(self) -> None:
        self.closed.set()
