"""Bounces that do not begin at rest, made by an integrator that shares nothing with the fit."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.bench.throws import throw
from tests.conftest import real, tune_all
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.recorders.simulators.ball import DropRig, DropSimulator
from tunenet_logs.terminal import Progress

# Restitutions of the basketball's six bounces, by parabolas of .16 s on each side.
BY_HAND = (0.796, 0.811, 0.799, 0.808, 0.816, 0.824)


@pytest.mark.parametrize("kind", ["thrown", "dribbled", "bouncing", "edge"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_ball_is_measured_however_it_came_to_fly(kind: str, seed: int):
    made = throw(np.random.default_rng([77, seed]), kind, noise_m=0.0005)
    tuning = tune_episode(made.episode(), TuneOptions())
    assert tuning.verdict != "rejected", tuning.reason
    found = record_of(tuning).rebounds
    for one in found:
        hit = min(made.hits, key=lambda hit: abs(hit.seconds - one.impact_s))
        assert abs(hit.seconds - one.impact_s) < 0.01
    first = min(made.hits, key=lambda hit: abs(hit.seconds - tuning.detection.drop.impact_s))
    assert tuning.trace is not None
    assert tuning.trace.estimate[0] == pytest.approx(first.restitution, abs=0.012)


@pytest.mark.parametrize("seed", range(4))
def test_a_hand_is_no_bounce(seed: int):
    made = throw(np.random.default_rng([78, seed]), "tossed")
    assert tune_episode(made.episode(), TuneOptions()).verdict != "ok"


def test_a_simulated_ball_starts_with_the_speed_that_it_has():
    rig = DropRig(gap_m=0.6, speed_m_s=-3.0, rate_hz=200.0, samples=120)
    heights = next(iter(DropSimulator(rig).rollout({"restitution": 0.8}).signals.values()))
    gap = heights.values[:, 2] - rig.radius_m
    fall = gap[:20]
    seconds = np.arange(20) / rig.rate_hz
    assert fall == pytest.approx(0.6 - 3.0 * seconds - 9.80665 / 2 * seconds**2, abs=1e-4)
    speed = np.sqrt(3.0**2 + 2 * 9.80665 * 0.6)
    assert gap.max() < (0.8 * speed) ** 2 / (2 * 9.80665) + 1e-3
    assert gap[30:].max() == pytest.approx((0.8 * speed) ** 2 / (2 * 9.80665), abs=2e-3)


def test_six_bounces_of_a_real_basketball_that_was_thrown_down(tmp_path: Path):
    log = real("labs/motive_basketball_10.csv")
    tune_all([log], TuneOptions(), tmp_path, 1, Progress(quiet=True))
    result = json.loads((tmp_path / "motive_basketball_10.json").read_text())
    assert result["verdict"] == "ok"
    assert result["units"]["length_by"] == "named"
    assert len(result["bounces"]) == len(BY_HAND)
    for bounce, by_hand in zip(result["bounces"], BY_HAND, strict=True):
        assert bounce["restitution"] == pytest.approx(by_hand, abs=0.02)
        low, high = bounce["interval95"]
        assert low <= by_hand <= high
        assert 5.0 < bounce["impact_speed"] < 5.5


def test_two_bare_columns_of_a_falling_tennis_ball(tmp_path: Path):
    options = TuneOptions(columns={"t": "1", "z": "2"})
    log = real("labs/fallingtennisball02.txt")
    tune_all([log], options, tmp_path, 1, Progress(quiet=True))
    result = json.loads((tmp_path / "fallingtennisball02.json").read_text())
    assert result["parameters"]["restitution"]["value"] == pytest.approx(0.753, abs=0.02)
    assert result["units"] == {
        "length_m": 1.0, "length_by": "gravity", "rate_hz": 1000.0, "rate_by": "clock"
    }  # fmt: skip
