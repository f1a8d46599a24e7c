"""A film whose camera was away: a drop is tuned from one side of a gap, or not at all."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.analysis.films import short_film
from tests.conftest import Made
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.describe import describe
from tunenet_logs.messages import CAMERA_TOPIC
from tunenet_logs.reader import read_episode
from tunenet_logs.timing.stamps import Gap, gap_note
from tunenet_logs.writing.writer import EpisodeWriter

START_NS = 1_700_000_000_000_000_000


def tuned_without(film: Path, log: Path, at_s: float, gap_s: float, *, is_marked: bool) -> Tuning:
    """Tune a film without its pictures from `at_s` on, for so long."""
    episode = read_episode(film)
    with EpisodeWriter(log, replace(episode.info, truth={}), live=False) as writer:
        before_ns = 0
        for frame in episode.frames():
            if at_s <= frame.stamp_ns * 1e-9 < at_s + gap_s:
                continue
            stamp_ns = START_NS + frame.stamp_ns
            if frame.stamp_ns * 1e-9 >= at_s > (before_ns - START_NS) * 1e-9 and is_marked:
                writer.note(*gap_note([Gap(before_ns, stamp_ns)]))
            writer.write_frame(CAMERA_TOPIC, replace(frame, stamp_ns=stamp_ns))
            before_ns = stamp_ns
    return tune_log(log, TuneOptions())


@pytest.mark.parametrize(
    "at_s", [pytest.param(0.55, marks=pytest.mark.slow), 0.8]
)  # in the fall, which is from .3 to .75 s, and after
def test_a_drop_that_a_gap_cuts_is_rejected_and_the_reason_says_so(
    made: Made, tmp_path: Path, at_s: float
):
    log = tmp_path / "a.mcap"
    tuning = tuned_without(short_film(made), log, at_s, 0.05, is_marked=True)
    assert tuning.verdict == "rejected"
    assert tuning.reason is not None
    assert tuning.reason.startswith("the camera was away for 0.07 s at 0.")
    assert "drop it again while the camera's connection holds" in tuning.reason
    assert "  away: 0.07 s at" in describe(log, read_episode(log))


def test_a_drop_before_a_gap_is_tuned_from_there(made: Made, tmp_path: Path):
    tuning = tuned_without(short_film(made), tmp_path / "a.mcap", 1.5, 0.05, is_marked=True)
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.trace is not None
    assert tuning.trace.estimate[0] == pytest.approx(0.7, abs=0.01)
    assert tuning.detection is not None
    assert tuning.detection.window["end_s"] < 1.5
    assert any("the camera was away for 0.0" in one for one in tuning.warnings)


@pytest.mark.parametrize("at_s", [pytest.param(0.5, marks=pytest.mark.slow), 0.9])
def test_a_long_pause_that_nobody_marked_is_never_ok(made: Made, tmp_path: Path, at_s: float):
    tuning = tuned_without(short_film(made), tmp_path / "a.mcap", at_s, 0.5, is_marked=False)
    assert tuning.verdict != "ok"
