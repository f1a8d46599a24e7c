"""Store one rendered drop in 37 ways, tune to each, and compare.

`python -m tests.bench.stored_ways` prints for each way its verdict, the restitution, and how far it
is from what the log of the camera's own JPEGs gives. All of them should be "ok" and within that
one's interval, but two, which deserve doubt: pictures of 160 x 120 px, and a file in which six of
a hundred pictures are there twice.
"""

from __future__ import annotations

import argparse
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import av
import cv2
import numpy as np
from av import logging
from numpy.typing import NDArray

from tunenet_logs.analysis.evaluation.study import Row, listed
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import Episode
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, film_drop
from tunenet_logs.terminal import Progress

# ---- Writers of one film's pictures.


Pictures = Sequence[NDArray[np.uint8]]  # RGB, each of shape (H, W, 3)
TICKS_HZ = 90_000  # of containers that can count so finely
RATE_HZ = 60  # of all ways that say nothing else: every fourth picture of the drop


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


def write_trimmed(path: Path, pictures: Pictures, hidden_s: float) -> None:
    """Write a video whose start an edit list hides, as phones trim.

    The file begins at the last picture that needs no other before the cut.
    """
    write_video(path.with_name("whole.mp4"), pictures, "libx264", RATE_HZ, options={"g": "30"})
    with (
        av.open(str(path.with_name("whole.mp4"))) as whole,
        av.open(str(path), "w", options={"avoid_negative_ts": "disabled"}) as cut,
    ):
        stream = cut.add_stream_from_template(whole.streams.video[0])
        packets: list[Any] = [one for one in whole.demux(video=0) if one.size]
        shift = round(hidden_s / packets[0].time_base)
        keys = [at for at, one in enumerate(packets) if one.is_keyframe and one.pts <= shift]
        for packet in packets[keys[-1] :]:
            packet.pts, packet.dts = packet.pts - shift, packet.dts - shift
            packet.stream = stream
            cut.mux(packet)


def write_ended(path: Path, pictures: Pictures, length_s: float) -> None:
    """Write the packets of a video's first seconds, in the order in which they are stored."""
    write_video(path.with_name("whole.mp4"), pictures, "libx264", RATE_HZ)
    with av.open(str(path.with_name("whole.mp4"))) as whole, av.open(str(path), "w") as cut:
        stream = cut.add_stream_from_template(whole.streams.video[0])
        packets: Iterator[Any] = whole.demux(video=0)
        for packet in packets:
            if packet.size and packet.dts * packet.time_base <= length_s:
                packet.stream = stream
                cut.mux(packet)


def write_files(path: Path, pictures: Pictures, suffix: str, *, sixteen: bool = False) -> None:
    """Write numbered pictures without leading zeros, in a folder or a zip.

    `sixteen` is grey of 12 bits in 16.
    """
    names = _files(pictures, suffix, sixteen=sixteen)
    if path.suffix == ".zip":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in names:
                archive.writestr(f"drop/{name}", data)
        return
    path.mkdir()
    for name, data in names:
        (path / name).write_bytes(data)


def _files(pictures: Pictures, suffix: str, *, sixteen: bool) -> Iterator[tuple[str, bytes]]:
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


# ---- The drop, and the ways to store it.


FILMED_HZ = 240
ORDER = DropOrder(restitution=0.7, height_m=1.0, seconds=1.7, hold_s=0.3, rate_hz=FILMED_HZ, seed=5)
FILM = FilmOrder(size_px=(640, 480), exposure_s=0.002)
DOUBTFUL = ("160 x 120", "six of a hundred twice")  # ways that need not be "ok"


class Way(NamedTuple):
    """Way to store a drop."""

    name: str  # of the file; its suffix is part of what is tried
    store: Callable[[Path], None]  # writes it
    rate_hz: float | None = None  # what a user says of it, as `--fps`; None for nothing


def at_rate(episode: Episode, rate_hz: float) -> Episode:
    """Subsample the episode as a slower camera would have filmed it."""
    frames = list(episode.frames())[:: round(FILMED_HZ / rate_hz)]
    stamps_ns = np.array([one.stamp_ns for one in frames], np.int64)
    channel = replace(episode.channels[0], log_ns=stamps_ns)
    return replace(episode, channels=(channel,), open_frames=lambda _topic: iter(frames))


def ways(episode: Episode) -> dict[str, Way]:
    """Return all ways but the log, by name."""

    def filmed(rate_hz: int) -> Pictures:
        return [frame.decode() for frame in at_rate(episode, rate_hz).frames()]

    usual = filmed(RATE_HZ)
    count = len(usual)

    def video(
        suffix: str,
        codec: str = "libx264",
        pixels: str = "yuv420p",
        pictures: Pictures = usual,
        rate_hz: int = RATE_HZ,
        said_hz: float | None = None,
        **more: Any,
    ) -> Way:
        write = partial(write_video, pictures=pictures, codec=codec, rate_hz=rate_hz)
        return Way(f"a.{suffix}", partial(write, pixels=pixels, **more), said_hz)

    def at(rate_hz: int, plays_hz: int, said_hz: float | None = None) -> Way:
        def store(path: Path) -> None:  # 240 pictures a second are many: decoded when needed
            write_video(path, filmed(rate_hz), "libx264", plays_hz)

        return Way("a.mp4", store, said_hz)

    def files(name: str, suffix: str, said_hz: float | None = RATE_HZ, **more: Any) -> Way:
        return Way(name, partial(write_files, pictures=usual, suffix=suffix, **more), said_hz)

    quiet = {"x265-params": "log-level=none"}
    fast = {"b": "3M", "deadline": "realtime"}
    kept = np.sort(np.random.default_rng(1).choice(count, round(0.8 * count), replace=False))
    raised = np.floor(np.arange(round(count * 1.06)) / 1.06).astype(int)
    small = [
        np.asarray(cv2.resize(one, (160, 120), interpolation=cv2.INTER_AREA), np.uint8)
        for one in usual
    ]
    turned = [np.ascontiguousarray(np.rot90(one)) for one in usual]
    animated = partial(write_animation, pictures=usual, rate_hz=RATE_HZ)
    return {
        "H.264, mp4": video("mp4"),
        "H.264 without B-frames, mov": video("mov", options={"bf": "0"}),
        "H.264, transport stream": video("ts"),
        "H.264, strongly compressed, 3gp": video("3gp", options={"crf": "32"}),
        "H.264 4:2:2, 10 bits, mkv": video("mkv", pixels="yuv422p10le"),
        "H.264 grey, mp4": video("mp4", pixels="gray"),
        "H.265, mp4": video("mp4", "libx265", options=quiet),
        "VP8, webm": video("webm", "libvpx", options=fast),
        "VP9, webm": video("webm", "libvpx-vp9", options=fast),
        "AV1, mp4": video("mp4", "libsvtav1", options={"preset": "8"}),
        "MPEG-4, avi": video("avi", "mpeg4", options={"b": "4M"}),
        "Motion JPEG, avi": video("avi", "mjpeg", "yuvj420p", options={"qmin": "2", "qmax": "4"}),
        "ProRes, mov": video("mov", "prores_ks", "yuv422p10le"),
        "FFV1, mkv": video("mkv", "ffv1", "yuv444p"),
        "HuffYUV, avi": video("avi", "huffyuv", "rgb24"),
        "uncompressed, avi": video("avi", "rawvideo", "bgr24"),
        "uncompressed, y4m": video("y4m", "wrapped_avframe"),
        # streams that no container holds
        "H.264, bare": video("h264", container="h264", said_hz=RATE_HZ),
        "H.265, bare": video("h265", "libx265", container="hevc", options=quiet, said_hz=RATE_HZ),
        "Motion JPEG, bare": video(
            "mjpeg", "mjpeg", "yuvj420p", container="mjpeg", said_hz=RATE_HZ
        ),
        "24 pictures a second": at(24, 24),
        "30 pictures a second": at(30, 30),
        "240 pictures a second": at(240, 240),
        "slow motion, 240 played at 30": at(240, 30, 240),
        "uneven, a fifth left out": video(
            "mp4",
            pictures=[usual[number] for number in kept],
            ticks=[int(number) * TICKS_HZ // RATE_HZ for number in kept],
        ),
        DOUBTFUL[1]: video("mp4", pictures=[usual[number] for number in raised], rate_hz=64),
        DOUBTFUL[0]: video("mp4", pictures=small),
        # what phones do to a film
        "turned by a tag": video("mov", pictures=turned, rotated_deg=-90),
        "start hidden by an edit list": Way(
            "a.mp4", partial(write_trimmed, pictures=usual, hidden_s=0.2)
        ),
        "cut at the end": Way("a.mp4", partial(write_ended, pictures=usual, length_s=1.5)),
        "folder of PNG": files("a", ".png"),
        "folder of JPEG, no rate said": files("a", ".jpg", None),
        "folder of TIFF, 12 bits in 16": files("a", ".tiff", sixteen=True),
        "zip of PNG": files("a.zip", ".png"),
        "animated WebP": Way("a.webp", animated),
        "GIF": Way("a.gif", partial(animated, tick_ms=10)),
    }


# ---- Tuned, each beside the log of JPEGs.


def tuned(way: Way) -> Tuning:
    """Tune one way, its file written and removed."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / way.name
        way.store(path)
        return tune_log(path, TuneOptions(fps=way.rate_hz))


def row_of(name: str, tuning: Tuning, reference: Tuning) -> Row:
    """Return a line of the table."""
    wanted, interval = reference.estimate, reference.interval95
    assert wanted is not None
    assert interval is not None
    value = np.nan if tuning.estimate is None else float(tuning.estimate[0])
    low, high = interval[0]
    return {
        "way": name,
        "verdict": tuning.verdict,
        "value": value,
        "off": value - float(wanted[0]),
        "promised": bool(low <= value <= high and (tuning.verdict == "ok" or name in DOUBTFUL)),
        "reason": tuning.reason or "",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", help="ways whose name holds this", default="")
    words = parser.parse_args().only
    progress = Progress()
    episode = film_drop(ORDER, FILM)  # at 240 pictures a second, kept in memory
    frames = list(episode.frames())
    episode = replace(episode, open_frames=lambda _topic: iter(frames))
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "a.mcap"
        record_episode(
            at_rate(episode, RATE_HZ), log, overwrite=False, progress=Progress(quiet=True)
        )
        reference = tune_log(log, TuneOptions())
    assert reference.interval95 is not None, reference.reason
    low, high = reference.interval95[0]
    rows = [row_of("log of JPEGs", reference, reference)]
    asked = {name: way for name, way in ways(episode).items() if words in name}
    with progress.bar(len(asked), "tuning", "way") as bar:
        for name, way in asked.items():
            rows.append(row_of(name, tuned(way), reference))
            bar.update(1)
    right = sum(row["promised"] for row in rows)
    print(listed(rows, f"truth {ORDER.restitution}; the log says {low:.4f} to {high:.4f}"))
    print(f"{right} of {len(rows)} as promised")


if __name__ == "__main__":
    main()
