"""Store one rendered drop in 37 ways, tune to each, and compare.

`python -m tests.bench.stored_ways` prints for each way its verdict, the restitution, and how far it
is from what the log of the camera's own JPEGs gives. All of them should be "ok" and within that
one's interval, but two, which deserve doubt: pictures of 160 x 120 px, and a file in which six of
a hundred pictures are there twice.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from tests.bench.storing import (
    TICKS_HZ,
    Pictures,
    Store,
    copy_from,
    copy_until,
    write_animation,
    write_files,
    write_video,
    write_zip,
)
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import Episode
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, film_drop
from tunenet_logs.terminal import Progress

ORDER = DropOrder(restitution=0.7, height_m=1.0, seconds=1.7, hold_s=0.3, rate_hz=240, seed=5)
FILM = FilmOrder(size_px=(640, 480), exposure_s=0.002)
RATE_HZ = 60  # of all ways that say nothing else: every fourth picture
DOUBTFUL = ("160 x 120", "six of a hundred twice")  # ways that need not be "ok"


@dataclass(frozen=True)
class Way:
    """Way to store a drop."""

    name: str  # of the file; its suffix is part of what is tried
    store: Store  # writes it
    rate_hz: float | None = None  # what a user says of it, as `--fps`; None for nothing


def rendered() -> Episode:
    """Render the drop at 240 pictures a second, its pictures in memory."""
    episode = film_drop(ORDER, FILM)
    frames = list(episode.frames())
    return replace(episode, open_frames=lambda _topic: iter(frames))


def at_rate(episode: Episode, rate_hz: float) -> Episode:
    """Subsample the episode as a slower camera would have filmed it."""
    frames = list(episode.frames())[:: round(240 / rate_hz)]
    channel = replace(
        episode.channels[0], log_ns=np.array([one.stamp_ns for one in frames], np.int64)
    )
    return replace(episode, channels=(channel,), open_frames=lambda _topic: iter(frames))


def pictures_of(episode: Episode) -> Pictures:
    """Decode the pictures, RGB."""
    return [frame.decode() for frame in episode.frames()]


def ways(episode: Episode) -> dict[str, Way]:
    """Return all ways but the log, by name."""
    usual = pictures_of(at_rate(episode, RATE_HZ))
    return {
        **_codecs(usual),
        **_without_a_rate(usual),
        **_rates(episode, usual),
        **_cuts(usual),
        **_picture_files(usual),
    }


def _codecs(usual: Pictures) -> dict[str, Way]:
    """Return codecs in containers: (suffix, encoder, pixels, its options)."""
    x264 = "libx264"
    table: Mapping[str, tuple[str, str, str, dict[str, str]]] = {
        "H.264, mp4": ("mp4", x264, "yuv420p", {}),
        "H.264 without B-frames, mov": ("mov", x264, "yuv420p", {"bf": "0"}),
        "H.264, transport stream": ("ts", x264, "yuv420p", {}),
        "H.264, strongly compressed, 3gp": ("3gp", x264, "yuv420p", {"crf": "32"}),
        "H.264 4:2:2, 10 bits, mkv": ("mkv", x264, "yuv422p10le", {}),
        "H.264 grey, mp4": ("mp4", x264, "gray", {}),
        "H.265, mp4": ("mp4", "libx265", "yuv420p", {"x265-params": "log-level=none"}),
        "VP8, webm": ("webm", "libvpx", "yuv420p", {"b": "3M", "deadline": "realtime"}),
        "VP9, webm": ("webm", "libvpx-vp9", "yuv420p", {"b": "3M", "deadline": "realtime"}),
        "AV1, mp4": ("mp4", "libsvtav1", "yuv420p", {"preset": "8"}),
        "MPEG-4, avi": ("avi", "mpeg4", "yuv420p", {"b": "4M"}),
        "Motion JPEG, avi": ("avi", "mjpeg", "yuvj420p", {"qmin": "2", "qmax": "4"}),
        "ProRes, mov": ("mov", "prores_ks", "yuv422p10le", {}),
        "FFV1, mkv": ("mkv", "ffv1", "yuv444p", {}),
        "HuffYUV, avi": ("avi", "huffyuv", "rgb24", {}),
        "uncompressed, avi": ("avi", "rawvideo", "bgr24", {}),
        "uncompressed, y4m": ("y4m", "wrapped_avframe", "yuv420p", {}),
    }
    return {
        name: Way(
            f"a.{suffix}",
            partial(
                write_video,
                pictures=usual,
                codec=codec,
                rate_hz=RATE_HZ,
                pixels=pixels,
                options=options,
            ),
        )
        for name, (suffix, codec, pixels, options) in table.items()
    }


def _without_a_rate(usual: Pictures) -> dict[str, Way]:
    """Return streams that no container holds."""
    table = {
        "H.264, bare": ("h264", "libx264", "h264", "yuv420p"),
        "H.265, bare": ("h265", "libx265", "hevc", "yuv420p"),
        "Motion JPEG, bare": ("mjpeg", "mjpeg", "mjpeg", "yuvj420p"),
    }
    return {
        name: Way(
            f"a.{suffix}",
            partial(
                write_video,
                pictures=usual,
                codec=codec,
                container=container,
                rate_hz=RATE_HZ,
                pixels=pixels,
                options={"x265-params": "log-level=none"} if codec == "libx265" else {},
            ),
            RATE_HZ,
        )
        for name, (suffix, codec, container, pixels) in table.items()
    }


def _rates(episode: Episode, usual: Pictures) -> dict[str, Way]:
    """Return other rates than the usual one."""

    def filmed_at(rate_hz: int, plays_hz: int) -> Store:
        def store(path: Path) -> None:
            write_video(path, pictures_of(at_rate(episode, rate_hz)), "libx264", plays_hz)

        return store

    rng = np.random.default_rng(1)
    kept = np.sort(rng.choice(len(usual), round(0.8 * len(usual)), replace=False))
    uneven = [usual[number] for number in kept]
    uneven_ticks = [int(number) * TICKS_HZ // RATE_HZ for number in kept]
    raised = np.floor(np.arange(round(len(usual) * 1.06)) / 1.06).astype(int)
    small = [
        np.asarray(cv2.resize(one, (160, 120), interpolation=cv2.INTER_AREA), np.uint8)
        for one in usual
    ]
    write = partial(write_video, codec="libx264")
    return {
        "24 pictures a second": Way("a.mp4", filmed_at(24, 24)),
        "30 pictures a second": Way("a.mp4", filmed_at(30, 30)),
        "240 pictures a second": Way("a.mp4", filmed_at(240, 240)),
        "slow motion, 240 played at 30": Way("a.mp4", filmed_at(240, 30), 240),
        "uneven, a fifth left out": Way(
            "a.mp4", partial(write, pictures=uneven, rate_hz=RATE_HZ, ticks=uneven_ticks)
        ),
        DOUBTFUL[1]: Way(
            "a.mp4", partial(write, pictures=[usual[number] for number in raised], rate_hz=64)
        ),
        DOUBTFUL[0]: Way("a.mp4", partial(write, pictures=small, rate_hz=RATE_HZ)),
    }


def _cuts(usual: Pictures) -> dict[str, Way]:
    """Return what phones do to a film."""

    def hidden(path: Path) -> None:
        whole = path.with_name("whole.mp4")
        write_video(whole, usual, "libx264", RATE_HZ, options={"g": "30"})
        copy_from(whole, path, 0.2)

    def ended(path: Path) -> None:
        whole = path.with_name("whole.mp4")
        write_video(whole, usual, "libx264", RATE_HZ)
        copy_until(whole, path, 1.5)

    turned = [np.ascontiguousarray(np.rot90(one)) for one in usual]
    return {
        "turned by a tag": Way(
            "a.mov",
            partial(
                write_video, pictures=turned, codec="libx264", rate_hz=RATE_HZ, rotated_deg=-90
            ),
        ),
        "start hidden by an edit list": Way("a.mp4", hidden),
        "cut at the end": Way("a.mp4", ended),
    }


def _picture_files(usual: Pictures) -> dict[str, Way]:
    """Return one file for each picture, or one of many without being a video."""
    return {
        "folder of PNG": Way("a", partial(write_files, pictures=usual, suffix=".png"), RATE_HZ),
        "folder of JPEG, no rate said": Way(
            "a", partial(write_files, pictures=usual, suffix=".jpg")
        ),
        "folder of TIFF, 12 bits in 16": Way(
            "a", partial(write_files, pictures=usual, suffix=".tiff", sixteen=True), RATE_HZ
        ),
        "zip of PNG": Way("a.zip", partial(write_zip, pictures=usual, suffix=".png"), RATE_HZ),
        "animated WebP": Way("a.webp", partial(write_animation, pictures=usual, rate_hz=RATE_HZ)),
        "GIF": Way(
            "a.gif",
            partial(write_animation, pictures=usual, rate_hz=RATE_HZ, tick_ms=10),
        ),
    }


def tuned(way: Way) -> Tuning:
    """Tune one way, its file written and removed."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / way.name
        way.store(path)
        return tune_log(path, TuneOptions(fps=way.rate_hz))


def row(name: str, tuning: Tuning, reference: Tuning) -> tuple[str, bool]:
    """Format a line of the table; return whether it is as promised."""
    found, wanted, interval = tuning.estimate, reference.estimate, reference.interval95
    assert wanted is not None
    assert interval is not None
    if found is None:
        return f"{name:32} {tuning.verdict:9} {tuning.reason}", False
    (low, high), value = interval[0], float(found[0])
    right = low <= value <= high and (tuning.verdict == "ok" or name in DOUBTFUL)
    why = f"  {tuning.reason}" if tuning.reason else ""
    off = value - float(wanted[0])
    return f"{name:32} {tuning.verdict:9} {value:.4f}  {off:+.4f}{why}", right


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", help="ways whose name holds this", default="")
    words = parser.parse_args().only
    episode = rendered()
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "a.mcap"
        record_episode(
            at_rate(episode, RATE_HZ), log, overwrite=False, progress=Progress(quiet=True)
        )
        reference = tune_log(log, TuneOptions())
    assert reference.interval95 is not None, reference.reason
    low, high = reference.interval95[0]
    print(f"truth {ORDER.restitution}; the log says {low:.4f} to {high:.4f}")
    lines = [row("log of JPEGs", reference, reference)]
    print(lines[0][0], flush=True)
    for name, way in ways(episode).items():
        if words in name:
            lines.append(row(name, tuned(way), reference))
            print(lines[-1][0], flush=True)
    right = sum(is_right for _, is_right in lines)
    print(f"{right} of {len(lines)} as promised")


if __name__ == "__main__":
    main()
