"""Pictures of which some were lost and all came late, placed by the ball's own flight."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.conftest import ROOT
from tunenet_logs.analysis.drop.film import placed_by_motion
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.analysis.tracking.track import track_ball
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.reader import read_episode
from tunenet_logs.writing.writer import EpisodeWriter

FILMED = ROOT / "sample_logs" / "filmed.mcap"
TOPIC = "/camera"


def sent(path: Path, seed: int) -> NDArray[np.int64]:
    """The sample film in bursts of 100 ms, 3 % of it lost; when its pictures were taken [ns]."""
    rng = np.random.default_rng(seed)
    frames = [one for one in read_episode(FILMED).frames() if rng.random() >= 0.03]
    taken = np.array([frame.stamp_ns for frame in frames])
    came = taken + (-taken - rng.integers(10**8)) % 10**8 + rng.integers(0, 10**5, len(taken))
    came = np.maximum.accumulate(came) + np.arange(len(taken))
    with EpisodeWriter(path, EpisodeInfo(kind="drop"), live=False) as writer:
        for frame, stamp_ns in zip(frames, came, strict=True):
            writer.write_frame(TOPIC, replace(frame, stamp_ns=int(stamp_ns)))
    return taken


def misplaced(stamps_ns: NDArray[np.int64], taken_ns: NDArray[np.int64]) -> float:
    """Share of pictures that are off by more than half a tick, beside what most are off by."""
    off = stamps_ns - taken_ns
    return float(np.mean(np.abs(off - np.median(off)) > np.median(np.diff(taken_ns)) / 2))


@pytest.mark.slow
def test_flight_shows_where_pictures_are_missing(tmp_path: Path):
    path = tmp_path / "late.mcap"
    before, after = [], []
    for seed in (1, 2):
        taken_ns = sent(path, seed)
        pictures = Pictures(read_episode(path), TOPIC)
        assert pictures.arrivals.clock is not None
        assert pictures.arrivals.clock.unsure.any()
        track = track_ball(pictures)
        _, placed = placed_by_motion(track, pictures.arrivals, pictures.start_ns, None)
        before.append(misplaced(pictures.stamps_ns, taken_ns))
        after.append(misplaced(placed.stamps_ns, taken_ns))
        path.unlink()
    assert np.mean(after) < 0.1
    assert np.mean(after) <= np.mean(before)


def test_a_film_that_lost_pictures_on_its_way_tells_the_same(tmp_path: Path):
    truth = tune_log(FILMED, TuneOptions())
    path = tmp_path / "late.mcap"
    sent(path, 1)
    found = tune_log(path, TuneOptions())
    assert truth.estimate is not None
    assert found.estimate is not None
    assert found.estimate[0] == pytest.approx(truth.estimate[0], abs=0.01)
    assert any("perhaps a place off" in one or "missing" in one for one in found.warnings)
