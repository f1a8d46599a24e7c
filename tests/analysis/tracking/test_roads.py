"""One clip by every road: its file, our recording of it, and bags of it that others made."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from tests.analysis.films import short_film
from tests.conftest import Command, Made, real
from tests.picture_strangers import (
    compressed,
    image,
    jpeg,
    write_jpegs_bag,
    write_pictures_folder,
    write_video_file,
)
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.reader import read_episode

START_NS = 1_700_000_000_000_000_000  # when a bag was recorded


def drawn(made: Made, shown_as: str) -> Iterator[tuple[int, np.ndarray]]:
    """Stamps [ns] and pictures, at 60 frames a second, of a ball that falls and bounces."""
    pictures = [frame.decode() for frame in read_episode(short_film(made)).frames()]
    lost = np.random.default_rng(3).random(len(pictures)) < 0.15
    for number in range(len(pictures)):
        if shown_as != "uneven" or not lost[number]:
            repeats = number % 2 if shown_as == "doubled" else 0
            yield round(number * 1e9 / 60), pictures[number - repeats]


H264 = {"crf": "18", "preset": "veryfast"}
# Encoder and its options, by the file's name.
CLIPS = {
    "doubled.mp4": ("libx264", H264),
    "uneven.mp4": ("libx264", H264),
    "b-frames.mkv": ("libx264", {"crf": "18", "bf": "3"}),
    "full-range.mp4": ("libx264", {"pix_fmt": "yuvj420p", **H264}),
    "b-frames.avi": ("mpeg4", {"b": "4000000", "bf": "2"}),
    "webcam.avi": ("mjpeg", {"pix_fmt": "yuvj420p", "b": "20000000"}),
    "hevc.mp4": ("libx265", {"crf": "18", "preset": "ultrafast", "x265-params": "log-level=none"}),
    "vp9.webm": ("libvpx-vp9", {"crf": "15", "b": "0", "cpu-used": "8"}),
}

FIRST = ("doubled.mp4", "b-frames.mkv")  # the others are encoded in other ways


def decoded(video: Path, rate_hz: float | None = None) -> Iterator[tuple[int, np.ndarray]]:
    """What another's converter puts into a bag: all pictures upright, at the file's times.

    Where B-frames have no times of their own, as in an AVI, they are counted.
    """
    with av.open(str(video)) as container:
        for count, frame in enumerate(container.decode(video=0)):
            seconds = count / rate_hz if rate_hz else frame.time
            pixels = np.rot90(frame.to_ndarray(format="rgb24"), round(frame.rotation / 90))
            yield START_NS + round(seconds * 1e9), np.ascontiguousarray(pixels)


def by_road(road: str, video: Path, folder: Path, command: Command) -> Path:
    """The clip as a log or a bag."""
    path = folder / road
    if road == "log.mcap":
        result = command("tunenet-record", "--camera", video, "-o", path, "--quiet")
        assert result.returncode == 0, result.stderr
        return path
    pictures = decoded(video, 60 if video.suffix == ".avi" else None)
    if road == "ros1.bag":
        return write_jpegs_bag(path, pictures)
    if road == "db3":
        raw = (
            image(stamp_ns, "rgb8", pixels.shape[1::-1], pixels.tobytes())
            for stamp_ns, pixels in pictures
        )
        return write_pictures_folder(path, raw, StoragePlugin.SQLITE3)
    jpegs = (compressed(stamp_ns, "jpeg", jpeg(pixels)) for stamp_ns, pixels in pictures)
    return write_pictures_folder(path, jpegs, StoragePlugin.MCAP)


ROADS = ("log.mcap", "ros1.bag", "db3", "mcap")


def is_the_same(one: Tuning, other: Tuning) -> None:
    """The same verdict, and a value within a fifth of the interval's half width."""
    assert other.verdict == one.verdict, (one.reason, other.reason)
    assert one.estimate is not None
    assert other.estimate is not None
    assert one.interval95 is not None
    half_width = float(np.ptp(one.interval95[0])) / 2
    assert abs(other.estimate[0] - one.estimate[0]) < half_width / 5


@pytest.fixture(scope="module")
def tuned(made: Made):
    """A clip's file, and what is tuned from it, each once."""
    known: dict[str, tuple[Path, Tuning]] = {}

    def tune(name: str) -> tuple[Path, Tuning]:
        if name not in known:
            codec, options = CLIPS[name]
            shown_as = name.partition(".")[0]
            video = made(
                name,
                lambda path: write_video_file(path, drawn(made, shown_as), codec, 60, **options),
            )
            known[name] = video, tune_log(video, TuneOptions())
        return known[name]

    return tune


@pytest.mark.parametrize("road", ROADS)
@pytest.mark.parametrize(
    "clip", [pytest.param(one, marks=[pytest.mark.slow] * (one not in FIRST)) for one in CLIPS]
)
def test_a_clip_has_one_answer(tuned, command: Command, tmp_path: Path, clip: str, road: str):
    video, from_file = tuned(clip)
    assert from_file.verdict == "ok", from_file.reason
    assert from_file.estimate[0] == pytest.approx(0.7, abs=0.01)
    is_the_same(from_file, tune_log(by_road(road, video, tmp_path, command), TuneOptions()))


@pytest.mark.slow
@pytest.mark.parametrize("road", ROADS[:2])
def test_a_phones_slow_motion_has_one_answer(command: Command, tmp_path: Path, road: str):
    """Stored rotated, of full range, at a quarter of its rate."""
    video = real("videos/red_ball_drop_120fps.mp4")
    if road == "log.mcap":
        log = by_road(road, video, tmp_path, command)
    else:
        taken = ((START_NS + (one - START_NS) // 4, two) for one, two in decoded(video))
        log = write_jpegs_bag(tmp_path / road, taken)
    is_the_same(tune_log(video, TuneOptions()), tune_log(log, TuneOptions()))
