"""The tuned simulator moves like the ball, thrown or let go, and what does not is told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import real, tune_all
from tunenet_logs.analysis.evaluation.studies.throws import throw
from tunenet_logs.analysis.evaluation.worlds.ball import RealBall, record_drop
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import Motion, read_record, to_json
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Episode
from tunenet_logs.terminal import Progress

# A table-tennis ball from 1.4 m, by an integrator that shares nothing with fit or simulator.
LIGHT = RealBall(0.8, 0.06, 0.12, 1.4)


def recorded(ball: RealBall, noise_m: float = 0.001, seed: int = 3) -> Episode:
    return record_drop(ball, 120.0, noise_m, np.random.default_rng(seed)).episode()


def motion_of(episode: Episode, **options: object) -> tuple[str, Motion]:
    tuning = tune_episode(episode, TuneOptions(**options))  # type: ignore[arg-type]
    return tuning.verdict, record_of(tuning).motion


@pytest.fixture(scope="module")
def light() -> Tuning:
    """What is tuned from one such ball."""
    return tune_episode(recorded(LIGHT), TuneOptions(), Path("a.mcap"))


def test_the_tuned_rollout_lies_on_the_samples(light: Tuning):
    motion = record_of(light).motion
    assert light.verdict == "ok"
    assert motion.fit is not None
    assert motion.curves is not None
    assert motion.fit.excess_percent < 0.1
    assert motion.fit.held_out_percent is not None
    assert motion.fit.held_out_percent < 0.3
    off_m = motion.curves.simulated_m - motion.curves.observed_m
    assert np.nanstd(off_m) == pytest.approx(0.001, rel=0.15)
    stamps_ns = motion.curves.start_ns + np.round(motion.curves.seconds * 1e9).astype(np.int64)
    (signal,) = recorded(LIGHT).signals.values()
    assert np.isin(stamps_ns, signal.stamps_ns).all()


def test_a_simulator_without_air_does_not_move_like_it():
    """One parameter leaves the observation, and says so, whatever it is itself."""
    verdict, motion = motion_of(recorded(LIGHT), method="brent")
    assert verdict != "ok"
    assert motion.fit is not None
    assert motion.fit.excess_percent > 1


def test_the_equivalent_reaches_the_first_rebound():
    episode = recorded(LIGHT, noise_m=0.0)
    _, motion = motion_of(episode)
    assert motion.equivalents is not None
    assert motion.curves is not None
    first, best = motion.equivalents.first, motion.equivalents.all
    falls = np.flatnonzero(np.diff(np.sign(np.diff(motion.curves.observed_m))) > 0)
    later = motion.curves.observed_m[falls[0] + 1 :]
    rebound_m = later[: int(np.argmax(np.diff(later) < 0)) + 1].max()
    assert first.restitution**2 * 1.4 == pytest.approx(rebound_m, abs=0.003)
    assert first.restitution < 0.78
    assert best.rms_percent < first.rms_percent
    assert first.speeds_m_s[1] == pytest.approx(first.restitution * first.speeds_m_s[0])


def test_a_ball_that_hits_something_later_is_not_ok():
    """From the third flight on another ball: the tuned one leaves it visibly."""
    episode = recorded(LIGHT, noise_m=0.0005)
    other = recorded(RealBall(0.8, -0.2, 0.12, 1.4), noise_m=0.0005)
    (topic, signal), (_, changed) = (next(iter(one.signals.items())) for one in (episode, other))
    count = min(len(signal.values), len(changed.values))
    values = signal.values[:count].copy()
    late = np.arange(count) > 0.55 * count
    values[late] = changed.values[:count][late]
    mixed = replace(signal, stamps_ns=signal.stamps_ns[:count], values=values)
    verdict, _ = motion_of(replace(episode, signals={topic: mixed}))
    assert verdict != "ok"


def test_a_record_keeps_motion_and_vector(light: Tuning, tmp_path: Path):
    record = record_of(light)
    path = tmp_path / "a.json"
    path.write_text(to_json(record))
    again = read_record(path)
    assert again.motion.fit == record.motion.fit
    assert again.motion.equivalents == record.motion.equivalents
    assert {known.name for known in again.estimates} == {"restitution", "restitution_slope", "drag"}
    fields = json.loads(path.read_text())
    assert {"rms_percent", "excess_percent", "held_out_percent"} <= fields["simulation_fit"].keys()
    assert set(fields["iterations"][0]) == {"k", "restitution", "restitution_slope", "drag"}


def test_a_vector_of_first_values_is_taken():
    tuning = tune_episode(recorded(LIGHT), TuneOptions(initial=(0.5, 0.02), method="tunenet"))
    assert tuning.trace is not None
    assert tuning.trace.steps[0].values == pytest.approx([0.5, 0.02, 0.0])
    assert tuning.estimate == pytest.approx([0.8, 0.06, 0.12], abs=0.02)


@pytest.mark.slow
def test_the_network_alone_walks_all_three():
    """No noise, K = 5, random balls: medians of .0003, .001 and .001 (drag times height)."""
    rng = np.random.default_rng(5)
    off: list[np.ndarray] = []
    for _ in range(30):
        truth = rng.uniform((0.3, 0.0, 0.0), (0.95, 0.12, 0.25))
        episode = recorded(RealBall(truth[0], truth[1], truth[2], 1.0), noise_m=0.0)
        start = tuple(rng.uniform((0.3, 0.0, 0.0), (0.95, 0.12, 0.25)).tolist())
        tuning = tune_episode(episode, TuneOptions(initial=start, method="tunenet"))
        assert tuning.trace is not None
        off.append(np.abs(tuning.trace.estimate - truth))
    assert np.all(np.median(off, axis=0) < (0.0005, 0.002, 0.002))


# Restitutions of the basketball's six bounces, by parabolas of .16 s on each side.
BY_HAND = (0.796, 0.811, 0.799, 0.808, 0.816, 0.824)


@pytest.mark.parametrize("kind", ["thrown", "dribbled", "bouncing", "edge"])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_ball_is_measured_however_it_came_to_fly(kind: str, seed: int):
    made = throw(np.random.default_rng([77, seed]), kind, noise_m=0.0005)
    tuning = tune_episode(made.episode, TuneOptions())
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
    assert tune_episode(made.episode, TuneOptions()).verdict != "ok"


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
