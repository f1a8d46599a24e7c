"""What messages cannot say goes through an import all the same: units, frames, impacts."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.export_writers_video import FilmedTrack, mtrack2, phyphox_xlsx
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.copying import import_log
from tunenet_logs.episode import FRAME_NS, Episode
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode

RATE_HZ = 240.0


def bounced(seconds: np.ndarray) -> np.ndarray:
    """Heights [m] of a ball of restitution 0.8 that falls 1 m, shape (T,)."""
    heights = 1 - 4.905 * seconds**2
    begin_s, speed = np.sqrt(2 / 9.81), 0.8 * np.sqrt(2 * 9.81)
    while begin_s < seconds[-1]:
        since_s = seconds - begin_s
        later = since_s > 0
        heights[later] = (speed * since_s - 4.905 * since_s**2)[later]
        begin_s += 2 * speed / 9.81
        speed *= 0.8
    return heights


def imported(log: Path) -> Path:
    target = log.with_name("imported.mcap")
    import_log(log, target)
    return target


def only(episode: Episode) -> str:
    (name,) = episode.signals
    return name


@pytest.fixture
def film_track(tmp_path: Path) -> Path:
    """Pixels, and frames without a rate."""
    seconds = np.arange(0, 2, 1 / RATE_HZ)
    body = np.column_stack([0 * seconds, 0 * seconds, bounced(seconds)])
    track = FilmedTrack(seconds, {"ball": body}, 400.0, True, (300, 500), RATE_HZ)
    mtrack2(tmp_path / "a.txt", track)
    return tmp_path / "a.txt"


def test_pixels_and_frames_stay_what_they_are(film_track: Path):
    first = read_episode(film_track)
    second = read_episode(imported(film_track))
    before, after = first.signals[only(first)], second.signals[only(second)]
    assert before.unit != "m"
    assert before.counts_frames
    assert (after.unit, after.counts_frames) == (before.unit, True)
    assert np.array_equal(after.stamps_ns, before.stamps_ns)
    assert np.array_equal(after.values, before.values)


def test_an_import_is_tuned_as_what_it_came_from(film_track: Path):
    first, second = (
        tune_log(log, options=TuneOptions()) for log in (film_track, imported(film_track))
    )
    assert first.estimate is not None
    assert second.estimate == pytest.approx(first.estimate, abs=1e-6)
    assert second.detection.units == first.detection.units
    assert second.detection.extent == first.detection.extent


def test_what_a_user_says_goes_before_the_notes(film_track: Path):
    log = imported(film_track)
    episode = read_episode(log, ReadOptions(fps=RATE_HZ, length_unit="mm"))
    signal = episode.signals[only(episode)]
    assert (signal.unit, signal.counts_frames) == ("m", False)
    assert signal.rate_hz == pytest.approx(RATE_HZ, rel=1e-5)


def test_impacts_are_times_and_no_places(tmp_path: Path):
    phyphox_xlsx(tmp_path / "a.xlsx", [0.0, 0.9, 1.6, 2.1, 2.5])
    first = read_episode(tmp_path / "a.xlsx")
    second = read_episode(imported(tmp_path / "a.xlsx"))
    (before,) = first.signals.values()
    (after,) = second.signals.values()
    assert after.columns == ("impact",)
    assert np.array_equal(after.stamps_ns, before.stamps_ns)
    assert [one.type_name for one in second.channels] == ["std_msgs/msg/Header"]
    assert [one.skipped for one in second.channels] == [None]


def test_pictures_without_a_rate_stay_without_one(tmp_path: Path):
    folder = tmp_path / "film"
    folder.mkdir()
    for number in range(5):
        data = cv2.imencode(".jpg", np.full((24, 32), 9 * number, np.uint8))[1].tobytes()
        (folder / f"{number}.jpg").write_bytes(data)
    log = imported(folder)
    assert read_episode(log).frames_untimed
    steps = [one.stamp_ns for one in read_episode(log).frames()]
    assert np.diff(steps).tolist() == [FRAME_NS] * 4
    timed = read_episode(log, ReadOptions(fps=500))
    assert not timed.frames_untimed
    assert np.diff([one.stamp_ns for one in timed.frames()]).tolist() == [2_000_000] * 4
