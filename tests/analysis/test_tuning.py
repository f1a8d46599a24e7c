"""From logs to restitutions: accurate, honest, and blind to the truth in the log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import ROOT, record
from tests.engines import needs_pybullet
from tests.strangers import Stranger, bounce_heights, write_poses
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.terminal import Progress


def value(tuning: Tuning) -> float:
    assert tuning.estimate is not None, tuning.reason
    return float(tuning.estimate[0])


@pytest.mark.parametrize(
    ("restitution", "height_m", "radius_m", "rate_hz"),
    [(0.12, 4.8, 0.3, 60.0), (0.55, 0.35, 0.02, 240.0), (0.93, 1.7, 0.1, 97.0)],
)
def test_a_fresh_drop_is_found_to_four_digits(
    tmp_path: Path, restitution: float, height_m: float, radius_m: float, rate_hz: float
):
    order = {"height_m": height_m, "radius_m": radius_m, "rate_hz": rate_hz}
    path = record(tmp_path / "a.mcap", restitution=restitution, **order)
    tuning = tune_log(path, TuneOptions())
    assert tuning.verdict == "ok", tuning.reason
    assert value(tuning) == pytest.approx(restitution, abs=1e-4)


@pytest.mark.slow
def test_fresh_drops_of_any_height_rate_and_ball(tmp_path: Path):
    """The figure to hold: mean absolute error .002, median .0005 over 200; seen: below 1e-5."""
    rng = np.random.default_rng(20_001)
    off = []
    for index in range(200):
        truth = float(rng.uniform(0.1, 0.95))
        path = record(
            tmp_path / f"{index}.mcap",
            restitution=truth,
            height_m=float(rng.uniform(0.3, 5)),
            radius_m=float(rng.uniform(0.02, 0.5)),
            rate_hz=float(rng.uniform(60, 240)),
        )
        tuning = tune_log(path, TuneOptions())
        assert tuning.verdict == "ok", tuning.reason
        off.append(abs(value(tuning) - truth))
    assert np.mean(off) < 2e-4
    assert np.median(off) < 5e-5


@pytest.mark.parametrize(
    "stranger",
    [
        Stranger(restitution=0.15, gap_m=4.5, rate_hz=65, hold_s=0.3, table_m=-0.8, seed=1),
        Stranger(restitution=0.5, gap_m=1.2, rate_hz=120, hold_s=1.1, table_m=0.0, seed=2),
        Stranger(restitution=0.9, gap_m=0.35, rate_hz=230, hold_s=1.9, table_m=0.9, seed=3),
    ],
    ids=["high", "middle", "low"],
)
def test_a_strangers_noisy_log_costs_little(tmp_path: Path, stranger: Stranger):
    stamps, positions = replace(stranger, seconds=6.0).samples()
    write_poses(tmp_path / "a.mcap", stamps, positions, topic="/any/1")
    tuning = tune_log(tmp_path / "a.mcap", TuneOptions())
    assert tuning.detection.topic == "/any/1"
    assert value(tuning) == pytest.approx(stranger.restitution, abs=0.003)


@pytest.mark.slow
def test_strangers_noisy_logs_held_before_the_release(tmp_path: Path):
    """The figure to hold: mean absolute error .003 over 40 with 1 mm of noise; seen: .0002."""
    rng = np.random.default_rng(20_002)
    off = []
    for index in range(40):
        one = Stranger(
            restitution=float(rng.uniform(0.1, 0.95)),
            gap_m=float(rng.uniform(0.3, 5)),
            rate_hz=float(rng.uniform(60, 240)),
            hold_s=float(rng.uniform(0.2, 2)),
            seconds=6.0,
            table_m=float(rng.uniform(-1, 1)),
            seed=index,
        )
        stamps, positions = one.samples()
        write_poses(tmp_path / "a.mcap", stamps, positions, topic=f"/any/{index}")
        tuning = tune_log(tmp_path / "a.mcap", TuneOptions())
        assert tuning.detection.topic == f"/any/{index}"
        off.append(abs(value(tuning) - one.restitution))
    assert np.mean(off) < 0.001


def changed_truth(episode: Episode, truth: Mapping[str, float]) -> Episode:
    return replace(episode, info=replace(episode.info, truth=truth))


@pytest.mark.parametrize(
    "preset",
    ["default", *(pytest.param(name, marks=needs_pybullet) for name in ("paper", "paper-code"))],
)
def test_truth_in_the_log_changes_nothing(tmp_path: Path, preset: Any):
    episode = simulate_drop(DropOrder(restitution=0.6, height_m=4.0, noise_m=0.001))
    bare = replace(episode, info=EpisodeInfo())
    for name, one in {
        "a": episode,
        "b": changed_truth(episode, {"restitution": 0.1}),
        "c": changed_truth(episode, {}),
        "d": bare,
    }.items():
        path = tmp_path / f"{name}.mcap"
        record_episode(one, path, overwrite=False, progress=Progress(quiet=True))
    first, *others = (
        tune_log(path, TuneOptions(preset=preset)) for path in sorted(tmp_path.iterdir())
    )
    assert first.trace is not None
    for other in others:
        assert other.trace is not None
        for mine, theirs in zip(first.trace.steps, other.trace.steps, strict=True):
            assert np.array_equal(mine.values, theirs.values)
        assert other.checks == first.checks
        assert other.verdict == first.verdict


def test_rollouts_are_counted_with_the_one_that_judges(drop_log: Path):
    tuning = tune_log(drop_log, TuneOptions(iterations=7, method="tunenet"))
    assert tuning.rollouts == 8
    assert tuning.trace is not None
    assert len(tuning.trace.steps) == 8
    refined = tune_log(drop_log, TuneOptions(iterations=7))
    assert refined.rollouts == 9
    assert refined.trace is not None
    assert len(refined.trace.steps) == 9


def test_the_first_guess_is_the_ball_that_does_not_bounce(drop_log: Path):
    default, high = (tune_log(drop_log, TuneOptions(initial=one)) for one in (None, (0.95,)))
    assert default.trace is not None
    assert high.trace is not None
    assert default.trace.steps[0].values[0] == 0
    assert high.trace.steps[0].values[0] == 0.95
    assert value(default) == pytest.approx(value(high), abs=1e-4)


@needs_pybullet
def test_the_paper_presets_find_the_engines_number(tmp_path: Path):
    off = []
    for index, truth in enumerate(np.linspace(0.32, 0.68, 10)):
        order = {"preset": "paper", "restitution": float(truth), "height_m": 3.6 + 0.08 * index}
        path = record(tmp_path / f"{index}.mcap", **order)
        tuning = tune_log(path, TuneOptions(preset="paper-code", initial=(0.5,)))
        assert not tuning.physical
        assert tuning.cross_check is None
        off.append(abs(value(tuning) - truth))
    assert np.mean(off) < 0.02


@needs_pybullet
def test_a_drop_that_the_papers_network_never_saw_gets_a_warning(drop_log: Path):
    tuning = tune_log(drop_log, TuneOptions(preset="paper"))
    assert any("outside" in warning for warning in tuning.warnings)


@pytest.mark.parametrize("up", ["x", "y", "z"])
def test_any_axis_may_be_up(tmp_path: Path, up: str):
    stamps, positions = Stranger(0.66, up=up).samples()
    write_poses(tmp_path / "a.mcap", stamps, positions)
    tuning = tune_log(tmp_path / "a.mcap", TuneOptions())
    assert value(tuning) == pytest.approx(0.66, abs=0.003)
    assert (up == "z") or any(f"+{up}" in warning for warning in tuning.warnings)


def test_the_first_of_several_drops_is_used_and_the_window_can_be_chosen(tmp_path: Path):
    rate = 120.0
    lift = np.linspace(0, 1, 120)
    one, two = (
        bounce_heights(restitution, 1.0, np.arange(600) / rate - 0.5) for restitution in (0.5, 0.8)
    )
    heights = np.concatenate([one, lift, two])
    stamps = np.round(np.arange(len(heights)) / rate * 1e9).astype(np.int64) + 10**18
    positions = np.column_stack([0 * heights, 0 * heights, heights])
    write_poses(tmp_path / "a.mcap", stamps, positions)
    first = tune_log(tmp_path / "a.mcap", TuneOptions())
    assert value(first) == pytest.approx(0.5, abs=0.002)
    assert any("2 drops" in warning for warning in first.warnings)
    later = TuneOptions(start_s=5.5)
    assert value(tune_log(tmp_path / "a.mcap", later)) == pytest.approx(0.8, abs=0.002)


def test_where_the_cross_check_disagrees_no_interval_is_given():
    tuning = tune_log(ROOT / "sample_logs" / "noisy.mcap", TuneOptions())
    assert tuning.cross_check is not None
    assert tuning.interval95 is not None
    other = replace(tuning.cross_check, agrees=False)
    assert replace(tuning, cross_check=other).interval95 is None
