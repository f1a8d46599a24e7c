"""Write one film's pictures to files of many kinds, for `tests.bench.stored_ways`."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from av import logging
from numpy.typing import NDArray

Pictures = Sequence[NDArray[np.uint8]]  # RGB, each of shape (H, W, 3)
TICKS_HZ = 90_000  # of containers that can count so finely


def write_video(
    path: Path,
    pictures: Pictures,
    codec: str,
    rate_hz: int,
    *,
    pixels: str = "yuv420p",
    container: str | None = None,
    ticks: Sequence[int] | None = None,
    rotated_deg: int = 0,
    options: Mapping[str, str] | None = None,
) -> None:
    """Write a video file; codec, pixels, container and options are as FFmpeg calls them.

    `ticks` are the pictures' stamps [1/90000 s], even ones if None; `rotated_deg` is by how much a
    player is to turn what is stored.
    """
    logging.set_level(None)
    height, width = pictures[0].shape[:2]
    base = Fraction(1, rate_hz) if ticks is None else Fraction(1, TICKS_HZ)
    with av.open(str(path), "w", format=container) as file:
        stream: Any = file.add_stream(codec, rate=rate_hz, options=dict(options or {}))
        stream.width, stream.height, stream.pix_fmt = width, height, pixels
        stream.codec_context.time_base = base
        if rotated_deg:
            stream.set_display_rotation(rotated_deg)
        for number, picture in enumerate(pictures):
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts = number if ticks is None else ticks[number]
            frame.time_base = base
            file.mux(stream.encode(frame))
        file.mux(stream.encode())


def copy_from(source: Path, target: Path, hidden_s: float) -> None:
    """Copy packets with the start hidden by an edit list, as phones trim.

    The file begins at the last picture that needs no other before the cut.
    """
    with (
        av.open(str(source)) as whole,
        av.open(str(target), "w", options={"avoid_negative_ts": "disabled"}) as cut,
    ):
        stream = cut.add_stream_from_template(whole.streams.video[0])
        packets: list[Any] = [one for one in whole.demux(video=0) if one.size]
        shift = round(hidden_s / packets[0].time_base)
        keys = [at for at, one in enumerate(packets) if one.is_keyframe and one.pts <= shift]
        for packet in packets[keys[-1] :]:
            packet.pts, packet.dts = packet.pts - shift, packet.dts - shift
            packet.stream = stream
            cut.mux(packet)


def copy_until(source: Path, target: Path, length_s: float) -> None:
    """Copy the packets of the first seconds, in the order in which they are stored."""
    with av.open(str(source)) as whole, av.open(str(target), "w") as cut:
        stream = cut.add_stream_from_template(whole.streams.video[0])
        packets: list[Any] = [one for one in whole.demux(video=0) if one.size]
        for packet in packets:
            if packet.dts * packet.time_base > length_s:
                break
            packet.stream = stream
            cut.mux(packet)


def write_files(folder: Path, pictures: Pictures, suffix: str, *, sixteen: bool = False) -> None:
    """Write a folder of numbered pictures, without leading zeros; `sixteen` is grey of 12 bits."""
    folder.mkdir()
    for name, data in named(pictures, suffix, sixteen=sixteen):
        (folder / name).write_bytes(data)


def write_zip(path: Path, pictures: Pictures, suffix: str) -> None:
    """Write the same, in a folder of a zip."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in named(pictures, suffix):
            archive.writestr(f"drop/{name}", data)


def named(pictures: Pictures, suffix: str, *, sixteen: bool = False) -> Iterator[tuple[str, bytes]]:
    """Yield names and bytes of picture files."""
    for number, picture in enumerate(pictures):
        stored: Any = picture[:, :, ::-1]
        if sixteen:
            grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
            stored = grey.astype(np.uint16) << 4
        yield f"img{number}{suffix}", cv2.imencode(suffix, stored)[1].tobytes()


def write_animation(path: Path, pictures: Pictures, rate_hz: int, tick_ms: int = 1) -> None:
    """Write a WebP or GIF of several pictures, times rounded to `tick_ms`."""
    animation: Any = cv2.Animation()
    ticks = np.round(np.arange(len(pictures) + 1) * 1000 / rate_hz / tick_ms).astype(int) * tick_ms
    animation.durations = np.diff(ticks).tolist()
    animation.frames = [picture[:, :, ::-1] for picture in pictures]
    if not cv2.imwriteanimation(str(path), animation, [cv2.IMWRITE_WEBP_QUALITY, 90]):
        raise RuntimeError(f"{path} cannot be written")


Store = Callable[[Path], None]  # writes a file, or a folder, of the name given
