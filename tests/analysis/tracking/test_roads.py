"""One clip by every road and in every form that other people's cameras write it: one answer."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader
from rosbags.rosbag2 import StoragePlugin

from tests.analysis.answers import ends, value
from tests.analysis.films import short_film
from tests.conftest import Command, Made, real
from tests.picture_strangers import (
    ENCODED,
    Fields,
    compressed,
    image,
    jpeg,
    packets,
    png,
    video,
    write_jpegs_bag,
    write_pictures,
    write_pictures_folder,
    write_video_file,
)
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.review.tuning import write_review
from tunenet_logs.analysis.tracking.picker import album_of
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.messages import is_whole
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


def is_the_same(one: Tuning, other: Tuning, share: float = 0.2) -> None:
    """The same verdict, and a value within a share of the way to the interval's end."""
    assert other.verdict == one.verdict, (one.reason, other.reason)
    end = ends(one)[int(value(other) > value(one))]
    assert abs(value(other) - value(one)) < share * abs(end - value(one))


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
    assert value(from_file) == pytest.approx(0.7, abs=0.01)
    log = by_road(road, video, tmp_path, command)
    # Of x265's quickest pictures those encoded anew differ as much as the interval allows.
    is_the_same(from_file, tune_log(log, TuneOptions()), 1.0 if clip == "hevc.mp4" else 0.2)


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
    share = 0.2 if road == "log.mcap" else 1.0  # a bag's pictures are encoded anew
    is_the_same(tune_log(video, TuneOptions()), tune_log(log, TuneOptions()), share)


def messages_of(log: Path, form: str) -> Iterator[Fields]:
    stamps, shown = pictures(log)
    height, width = shown[0].shape[:2]
    if form in ("h264", "h265", "vp9", "av1"):
        for number, data in packets(shown, form):
            yield video(stamps[number], form, data)
        return
    for stamp_ns, pixels in zip(stamps, shown, strict=True):
        if form == "png":
            yield compressed(stamp_ns, "rgb8; png compressed bgr8", png(pixels))
        elif form == "webp":
            data = cv2.imencode(".webp", pixels[..., ::-1])[1].tobytes()
            yield compressed(stamp_ns, "webp", data)
        else:
            step = width if form.startswith("nv") else None
            yield image(stamp_ns, form, (width, height), ENCODED[form](pixels), step)


@pytest.fixture(scope="module")
def short(made: Made) -> Path:
    return short_film(made)


@pytest.fixture(scope="module")
def reference(short: Path) -> float:
    return value(tune_log(short, TuneOptions()))


# How far the restitution may be off that of the JPEGs that the pictures were made of.
OFF = {
    **dict.fromkeys(("rgb8", "bgr8", "png"), 1e-9),
    **dict.fromkeys(("mono8", "yuv422_yuy2", "nv12", "h264", "h265"), 1e-3),
    "bayer_rggb8": 4e-3,  # half of the picture's sharpness is left
}
ALIKE = ("bgr8", "yuv422_yuy2", "h265")  # read as others of `OFF` are: raw pixels, or a stream


@pytest.mark.parametrize(
    "form", [pytest.param(one, marks=[pytest.mark.slow] * (one in ALIKE)) for one in OFF]
)
def test_tunes_to_the_same_and_is_shown(short: Path, reference: float, tmp_path: Path, form: str):
    """On the page on which the ball is marked, and in the review."""
    path = write_pictures(tmp_path / "a.mcap", messages_of(short, form), "/anything")
    tuning = tune_log(path, TuneOptions())
    assert value(tuning) == pytest.approx(reference, abs=OFF[form])
    assert tuning.verdict == "ok", tuning.reason
    assert [one for one in tuning.warnings if "checksum" not in one] == []
    album = album_of(read_episode(path), "/anything")
    assert album.size_px == next(read_episode(short).frames()).size_px()
    assert all(is_whole(thumbnail.data) for thumbnail in album.thumbnails)
    assert len(album.thumbnails) > 60
    write_review(tuning, record_of(tuning), tmp_path / "a.rrd")
    drop = tuning.detection.film.drop
    shown = drop.seconds > drop.release_s  # and a little before it
    assert np.count_nonzero(shown) <= jpeg_count(tmp_path / "a.rrd") <= len(drop.seconds)


def jpeg_count(review: Path) -> int:
    """How many pictures the video of a review has."""
    return sum(
        chunk.num_rows
        for chunk in RrdReader(review).stream()
        if str(chunk.entity_path) == "/film/picture" and not chunk.is_static
    )


def pictures(log: Path) -> tuple[list[int], list[np.ndarray]]:
    """Stamps [ns] and RGB pictures, a second after 1970: 0 would mean that no stamp is set."""
    frames = list(read_episode(log).frames())
    return [10**9 + one.stamp_ns for one in frames], [one.decode() for one in frames]
