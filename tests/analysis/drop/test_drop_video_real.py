"""Videos of real balls, as phones store them: tuned with no options, or rejected with a reason."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import av
import numpy as np
import pytest

from tests.analysis.films import short_film
from tests.conftest import Command, Made, real
from tunenet_logs.analysis.batch import run as one_log
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.reader import read_episode


@dataclass(frozen=True)
class Phone:
    """What `tunenet-tune` made of a phone's clip: 120 fps stored as 30, rotated."""

    done: CompletedProcess[str]
    folder: Path
    tuning: Tuning


@pytest.fixture(scope="module")
def phone(command: Command, tmp_path_factory: pytest.TempPathFactory) -> Phone:
    """Tuned once, with no options; the tests look at what was written, and at the track."""
    clip, folder = real("videos/red_ball_drop_120fps.mp4"), tmp_path_factory.mktemp("phone")
    tunings: list[Tuning] = []

    def kept(*asked: Any) -> Tuning:
        tunings.append(tune_log(*asked))
        return tunings[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(one_log, "tune_log", kept)
        done = command("tunenet-tune", clip, "-o", folder)
    (tuning,) = tunings
    return Phone(done, folder, tuning)


def test_a_clip_of_a_phone_is_tuned(phone: Phone):
    """Measured by hand .507, 95 % .490 to .525."""
    assert phone.done.returncode == 0, phone.done.stderr
    result = json.loads((phone.folder / "red_ball_drop_120fps.json").read_text())
    assert 0.44 < result["parameters"]["restitution"]["value"] < 0.58
    assert (phone.folder / "red_ball_drop_120fps.rrd").stat().st_size > 100_000


def test_a_real_ball_by_hand(phone: Phone):
    """Impacts were read from the clip by eye: frames 201.6 and 281.2; it leaves at 287."""
    track = phone.tuning.detection.film.track
    assert track.found[140:286].mean() > 0.98
    assert not track.found[290:].any()
    height = track.places_px[:, 1]
    assert 200 <= np.nanargmax(height[:240]) <= 203
    assert 280 <= 240 + np.nanargmax(height[240:]) <= 285


@pytest.mark.parametrize(
    "name",
    ["green_ball_tossed.mp4", pytest.param("green_ball_in_hand.mp4", marks=pytest.mark.slow)],
)
def test_a_ball_that_does_not_bounce_is_rejected(command: Command, tmp_path: Path, name: str):
    result = command("tunenet-tune", real(f"negatives/{name}"), "-o", tmp_path)
    assert result.returncode == 1
    assert "rejected" in result.stdout
    report = json.loads(next(tmp_path.glob("*.json")).read_text())
    assert report["verdict"] == "rejected"
    assert report["parameters"] is None
    assert "bounce" in report["reason"] or "fly" in report["reason"]


def as_video(log: Path, path: Path) -> Path:
    """The pictures of a log in a file as a phone writes it."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=30)
        stream.width, stream.height = 320, 240
        stream.pix_fmt, stream.gop_size = "yuv420p", 15
        for frame in read_episode(log).frames():
            shown = av.VideoFrame.from_ndarray(frame.decode(), format="rgb24")
            container.mux(stream.encode(shown))
        container.mux(stream.encode())
    return path


def test_a_video_with_a_hole_is_read_as_far_as_it_is_whole(
    command: Command, made: Made, tmp_path: Path
):
    path = as_video(short_film(made, rate_hz=30), tmp_path / "hole.mp4")
    data = bytearray(path.read_bytes())
    at = 7 * len(data) // 10  # in the second flight
    data[at : at + 400] = bytes(400)
    path.write_bytes(data)
    report = tuned_with_a_hole(command, path)
    assert report["parameters"]["restitution"]["value"] == pytest.approx(0.7, abs=0.01)


@pytest.mark.slow
def test_a_phones_video_with_a_hole_is_read_as_far_as_it_is_whole(command: Command, tmp_path: Path):
    data = bytearray(real("videos/red_ball_drop_120fps.mp4").read_bytes())
    data[1_700_000:1_700_400] = bytes(400)
    (tmp_path / "hole.mp4").write_bytes(data)
    tuned_with_a_hole(command, tmp_path / "hole.mp4")


def tuned_with_a_hole(command: Command, path: Path) -> dict[str, Any]:
    result = command("tunenet-tune", path, "-o", path.parent)
    assert "Traceback" not in result.stderr
    report = json.loads(path.with_suffix(".json").read_text())
    assert report["verdict"] in ("suspect", "rejected")
    assert "pictures can be read" in report["reason"]
    return report
