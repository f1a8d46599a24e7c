"""The same filmed drop in every form that other people's cameras write it, tuned and shown."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from analysis.album import album_of
from analysis.review.film import log_recorded_film
from analysis.tuning import Options, Tuning, tune_log
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
def reference(filmed_log: Path) -> float:
    return restitution(tune_log(filmed_log, Options()))


def restitution(tuning: Tuning) -> float:
    assert tuning.estimate is not None, tuning.reason
    return float(tuning.estimate[0])


OFF = {
    "rgb8": 1e-9,
    "bgr8": 1e-9,
    "png": 1e-9,
    "webp": 1e-9,
    "mono8": 2e-3,
    "yuv422_yuy2": 1e-3,
    "nv12": 1e-3,
    "bayer_rggb8": 1e-3,
    "h264": 1e-3,
    "h265": 1e-3,
}
"""How far the restitution may be off that of the JPEGs that the pictures were made of."""


@pytest.mark.parametrize("form", OFF)
def test_tunes_to_the_same(filmed_log: Path, reference: float, tmp_path: Path, form: str):
    path = write_pictures(tmp_path / "a.mcap", messages(filmed_log, form), "/anything")
    tuning = tune_log(path, Options())
    print(form, restitution(tuning) - reference, tuning.verdict)
    assert restitution(tuning) == pytest.approx(reference, abs=OFF[form])
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.warnings == ()
