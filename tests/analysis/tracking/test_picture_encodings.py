"""The same filmed drop in every form that other people's cameras write it, tuned and shown."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader

from tests.analysis.films import short_film
from tests.conftest import Made
from tests.picture_strangers import (
    ENCODED,
    Fields,
    compressed,
    image,
    packets,
    png,
    video,
    write_pictures,
)
from tests.tunenet_logs.test_images import with_size
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.review.tuning import write_review
from tunenet_logs.analysis.tracking.picker import album_of
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.messages import is_whole
from tunenet_logs.reader import read_episode


def pictures(log: Path) -> tuple[list[int], list[np.ndarray]]:
    """Stamps [ns] and RGB pictures, a second after 1970: 0 would mean that no stamp is set."""
    frames = list(read_episode(log).frames())
    return [10**9 + one.stamp_ns for one in frames], [one.decode() for one in frames]


def messages(log: Path, form: str) -> Iterator[Fields]:
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
    return restitution(tune_log(short, TuneOptions()))


def restitution(tuning: Tuning) -> float:
    assert tuning.estimate is not None, tuning.reason
    return float(tuning.estimate[0])


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
    path = write_pictures(tmp_path / "a.mcap", messages(short, form), "/anything")
    tuning = tune_log(path, TuneOptions())
    assert restitution(tuning) == pytest.approx(reference, abs=OFF[form])
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


FORGED = {
    "of a few kB": with_size(9000, 7000),
    "of the most that is believed": with_size(6000, 6000, filler=70_000),
    "beyond what a JPEG can be": with_size(65_000, 65_000, filler=70_000),
}


@pytest.mark.slow
def test_forged_pictures_cost_no_memory(tmp_path: Path):
    """Twelve that are believed would be over the limit, all in memory."""
    logs = [tmp_path / f"{number}.mcap" for number in range(len(FORGED))]
    noise = np.random.default_rng(0)  # behind each, that no log packs: their pixels are paid for
    for log, data in zip(logs, FORGED.values(), strict=True):
        tail = min(len(data) // 1000 * 1000, 70_000)
        stamps = range(10**9, 10**9 + 12 * 10**7, 10**7)
        made = [compressed(stamp_ns, "jpeg", data + noise.bytes(tail)) for stamp_ns in stamps]
        write_pictures(log, made)
    said, used = measured("tunenet_logs.cli", "info", *logs)
    assert all(f"{log}: " in said for log in logs)
    assert said.count("/eye") >= len(logs)
    assert used < MAX_BYTES
    said, used = measured("tunenet_logs.analysis.cli.tune", *logs, "--jobs", 1)
    assert all(said.count(f"{log}: ") == 1 for log in logs)
    assert said.count(" rejected ") == len(logs)
    assert "no ball is seen" in (tmp_path / "1.json").read_text()  # these were looked at
    assert "Traceback" not in said
    assert used < MAX_BYTES


MAX_BYTES = 512 * 1024 * 1024


def measured(module: str, *arguments: object) -> tuple[str, int]:
    """What a command says, and the most memory that it takes, in a process of its own."""
    code = (  # getrusage would count what the parent had in memory, too
        f"import sys\nfrom {module} import main\ntry:\n    main()\nexcept SystemExit:\n    pass\n"
        "finally:\n    print(open('/proc/self/status').read(), file=sys.stderr)"
    )
    words = [sys.executable, "-c", code, *(str(one) for one in arguments)]
    result = subprocess.run(words, capture_output=True, text=True, timeout=300)
    (peak,) = re.findall(r"VmHWM:\s+(\d+) kB", result.stderr)
    return result.stdout + result.stderr, int(peak) * 1024
