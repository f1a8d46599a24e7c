"""Of several bodies, the one that bounces as a ball does."""

from __future__ import annotations

import numpy as np
import pytest

from tests.strangers import Stranger
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Episode, EpisodeInfo, Signal


def test_a_doubtful_body_is_passed_over_for_a_ball():
    stamps, ball = Stranger(restitution=0.7).samples()
    tapped = ball.copy()
    tapped[:, 2] = 0.3 * np.abs(np.sin(np.pi * (stamps - stamps[0]) * 2e-9)) ** 0.8
    bodies = {"A": tapped, "B": ball}
    signals = {
        name: Signal(name, stamps, xyz, ("x", "y", "z"), "m") for name, xyz in bodies.items()
    }
    alone = tune_episode(Episode(EpisodeInfo(), {"A": signals["A"]}), TuneOptions())
    assert alone.verdict != "ok"
    tuning = tune_episode(Episode(EpisodeInfo(), signals), TuneOptions())
    assert (tuning.verdict, tuning.detection.topic) == ("ok", "B")
    assert tuning.estimate is not None
    assert tuning.estimate[0] == pytest.approx(0.7, abs=0.003)
