"""Logs that are no good drops, or not only: what is doubted, and what costs nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import record
from tests.strangers import Stranger, bounce_heights, without_chunks, write_poses
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.terminal import Progress


def value(tuning: Tuning) -> float:
    assert tuning.estimate is not None, tuning.reason
    return float(tuning.estimate[0])


def heights_log(path: Path, heights: np.ndarray, rate: float = 120.0) -> Path:
    stamps = np.round(np.arange(len(heights)) / rate * 1e9).astype(np.int64) + 10**18
    write_poses(path, stamps, np.column_stack([0 * heights, 0 * heights, heights]))
    return path


def test_a_drop_without_a_bounce_is_rejected_without_a_number(tmp_path: Path):
    path = record(tmp_path / "a.mcap", restitution=0.0, height_m=1.0)
    tuning = tune_log(path, TuneOptions())
    assert tuning.verdict == "rejected"
    assert tuning.estimate is None
    assert "does not bounce" in (tuning.reason or "")


def test_a_ball_that_leaves_the_table_is_measured_up_to_there(tmp_path: Path):
    times = np.arange(600) / 120
    heights = bounce_heights(0.7, 1.0, times)
    fallen = times > 2.0
    heights[fallen] = np.maximum(heights[fallen] - 4.9 * (times[fallen] - 2.0) ** 2, -0.75)
    tuning = tune_log(heights_log(tmp_path / "a.mcap", heights), TuneOptions())
    assert value(tuning) == pytest.approx(0.7, abs=0.001)
    assert tuning.detection.drop.seconds[-1] < 2.1


def test_wrong_units_are_not_ok(tmp_path: Path):
    heights = 0.3048 * bounce_heights(0.7, 3.0, np.arange(600) / 120 - 0.3)
    tuning = tune_log(heights_log(tmp_path / "a.mcap", heights), TuneOptions())
    assert tuning.verdict == "suspect"
    assert "gravity" in (tuning.reason or "")


def test_a_ball_that_is_caught_is_measured_up_to_there(tmp_path: Path):
    heights = bounce_heights(0.7, 1.0, np.arange(600) / 120 - 0.3)
    at = int((0.3 + 0.4515 + 0.35) * 120)
    heights[at:] = heights[at]
    tuning = tune_log(heights_log(tmp_path / "a.mcap", heights), TuneOptions())
    assert (tuning.verdict, value(tuning)) == ("ok", pytest.approx(0.7, abs=0.001))


def test_samples_lost_with_their_stamps_cost_nothing(tmp_path: Path):
    stamps, positions = Stranger(0.7, noise_m=0.0).samples()
    keep = np.random.default_rng(0).random(len(stamps)) > 0.1
    write_poses(tmp_path / "a.mcap", stamps[keep], positions[keep])
    assert value(tune_log(tmp_path / "a.mcap", TuneOptions())) == pytest.approx(0.7, abs=0.001)


def test_a_log_without_a_ball_says_what_it_holds_and_what_was_wanted(tmp_path: Path):
    record_episode(
        Episode(EpisodeInfo(), {}), tmp_path / "a.mcap", overwrite=False,
        progress=Progress(quiet=True),
    )  # fmt: skip
    tuning = tune_log(tmp_path / "a.mcap", TuneOptions())
    assert tuning.verdict == "rejected"
    assert "a ball's position or with pictures" in (tuning.reason or "")
    assert "none" in (tuning.reason or "")


def test_a_topic_that_is_not_there_names_those_that_are(drop_log: Path):
    tuning = tune_log(drop_log, TuneOptions(topic="/nope"))
    assert tuning.verdict == "rejected"
    assert "/ball/pose" in (tuning.reason or "")


def test_a_cut_log_is_tuned_as_far_as_it_goes(drop_log: Path):
    drop_log.write_bytes(drop_log.read_bytes()[:-3000])
    tuning = tune_log(drop_log, TuneOptions())
    assert any("end of the file" in warning for warning in tuning.warnings)
    assert tuning.estimate is None or value(tuning) == pytest.approx(0.7, abs=0.001)


def test_a_small_drop_before_a_big_one_is_not_passed_over(tmp_path: Path):
    times = np.arange(1800) / 120
    small, big = bounce_heights(0.5, 0.4, times - 1), bounce_heights(0.9, 4, times - 8)
    heights = np.where(times < 5, small, np.where(times < 7, 2 * (times - 5), big))
    tuning = tune_log(heights_log(tmp_path / "a.mcap", heights), TuneOptions())
    assert value(tuning) == pytest.approx(0.5, abs=0.002)
    assert any("2 drops" in warning for warning in tuning.warnings)


@pytest.mark.parametrize(
    ("restitution", "gap", "rest"),
    [(0.1, 2, -0.02), (0.15, 1, -0.01), (0.25, 5, -0.06), (0.3, 5, 0.06)],
)
def test_a_ball_that_rests_at_another_level_is_suspect_and_costs_nothing(
    tmp_path: Path, restitution: float, gap: float, rest: float
):
    times = np.arange(840) / 120
    fall = np.sqrt(2 * gap / 9.81)
    end = 1 + fall * (1 + 2 * restitution / (1 - restitution)) + 0.05
    heights = np.where(times > end, rest, bounce_heights(restitution, gap, times - 1))
    heights += np.random.default_rng(0).normal(0, 0.001, 840)
    tuning = tune_log(heights_log(tmp_path / "a.mcap", heights), TuneOptions())
    assert tuning.verdict == "suspect"
    assert "rests where it hit" in (tuning.reason or "")
    assert value(tuning) == pytest.approx(restitution, abs=0.005)


@pytest.mark.parametrize(
    ("restitution", "gap", "terminal"), [(0.85, 0.5, 9.4), (0.85, 2.0, 20.0), (0.85, 4.0, 31.0)]
)
def test_the_drag_of_a_ball_that_the_air_slows_is_found(
    tmp_path: Path, restitution: float, gap: float, terminal: float
):
    height, speed, heights = gap, 0.0, []
    for index in range(840):
        heights.append(height)
        for _ in range(40 if index > 60 else 0):
            speed -= 9.81 * (1 + speed * abs(speed) / terminal**2) / 4800
            height += speed / 4800
            if height < 0 and speed < 0:
                height, speed = -height * restitution, -speed * restitution
    noisy = np.array(heights) + np.random.default_rng(0).normal(0, 0.001, 840)
    tuning = tune_log(heights_log(tmp_path / "a.mcap", noisy), TuneOptions())
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.estimate is not None
    assert tuning.estimate[0] == pytest.approx(restitution, abs=0.003)
    assert tuning.estimate[2] == pytest.approx(9.81 / terminal**2, abs=0.006)


@pytest.mark.parametrize(("index", "stray"), [(100, 0.0), (400, 1e5), (30, -1.0)])
def test_a_stray_sample_costs_nothing(tmp_path: Path, index: int, stray: float):
    heights = bounce_heights(0.7, 1.0, np.arange(840) / 120 - 1)
    heights[index] = stray
    tuning = tune_log(heights_log(tmp_path / "a.mcap", heights), TuneOptions())
    assert tuning.verdict == "ok", tuning.reason
    assert value(tuning) == pytest.approx(0.7, abs=0.001)


def test_noise_only_while_it_moves(tmp_path: Path):
    times = np.arange(840) / 120
    heights = bounce_heights(0.5, 1.0, times - 1)
    moving = times > 1
    heights[moving] += np.random.default_rng(0).normal(0, 0.005, moving.sum())
    tuning = tune_log(heights_log(tmp_path / "a.mcap", heights), TuneOptions())
    assert value(tuning) == pytest.approx(0.5, abs=0.01)


def test_the_top_of_a_bounce_is_not_rest(tmp_path: Path):
    for seed in range(5):
        order = {"restitution": 0.46, "height_m": 4.5, "rate_hz": 200.0, "noise_m": 0.005}
        path = record(tmp_path / f"{seed}.mcap", **order, hold_s=1.0, seed=seed)
        tuning = tune_log(path, TuneOptions())
        assert tuning.verdict == "ok", tuning.reason
        assert value(tuning) == pytest.approx(0.46, abs=0.005)


@pytest.mark.parametrize(
    ("restitution", "gap", "rate"), [(0.15, 4.0, 70.0), (0.5, 1.0, 120.0), (0.9, 0.4, 230.0)]
)
def test_a_good_drop_with_noise_is_ok_and_right(
    tmp_path: Path, restitution: float, gap: float, rate: float
):
    times = np.arange(int(8 * rate)) / rate
    heights = bounce_heights(restitution, gap, times - 1.5)
    heights += np.random.default_rng(3).normal(0, 0.003, len(times))
    tuning = tune_log(heights_log(tmp_path / "a.mcap", heights, rate), TuneOptions())
    assert tuning.verdict == "ok", tuning.reason
    assert value(tuning) == pytest.approx(restitution, abs=0.02)


@pytest.mark.slow
def test_good_drops_with_noise_are_ok_and_right(tmp_path: Path):
    rng = np.random.default_rng(20_003)
    wrong = rejected = 0
    for _ in range(60):
        truth, rate = float(rng.uniform(0.1, 0.95)), float(rng.uniform(60, 240))
        times = np.arange(int(8 * rate)) / rate
        heights = bounce_heights(truth, float(rng.uniform(0.3, 5)), times - 1.5)
        heights += rng.normal(0, rng.uniform(0, 0.003), len(times))
        (tmp_path / "a.mcap").unlink(missing_ok=True)
        tuning = tune_log(heights_log(tmp_path / "a.mcap", heights, rate), TuneOptions())
        rejected += tuning.verdict != "ok"
        wrong += tuning.verdict == "ok" and abs(value(tuning) - truth) > 0.02
    assert wrong == 0
    assert rejected <= 4


def test_a_clock_that_jumps_is_not_simulated_across(tmp_path: Path):
    heights = bounce_heights(0.7, 1.0, np.arange(600) / 120 - 1)
    stamps = np.round(np.arange(600) / 120 * 1e9).astype(np.int64) + 10**18
    stamps[300:] += 3600 * 10**9
    write_poses(tmp_path / "a.mcap", stamps, np.column_stack([0 * heights, 0 * heights, heights]))
    tuning = tune_log(tmp_path / "a.mcap", TuneOptions())
    assert value(tuning) == pytest.approx(0.7, abs=0.001)
    assert tuning.trace is not None
    look = tuning.trace.steps[0].evaluation
    assert look is not None
    assert len(look.episode.signals["/ball/pose"].stamps_ns) < 10_000


def test_samples_that_may_have_been_changed_make_a_tuning_suspect(tmp_path: Path):
    """A flipped bit in a log without chunks: only the checksum of all data tells."""
    source = record(tmp_path / "a.mcap", restitution=0.7, height_m=1.0)
    plain = tmp_path / "plain.mcap"
    without_chunks(source, plain)
    assert tune_log(plain, TuneOptions()).verdict == "ok"
    data = bytearray(plain.read_bytes())
    data[data.index(b"world", len(data) // 3)] ^= 1  # in a frame's name: no sample changes
    plain.write_bytes(bytes(data))
    tuning = tune_log(plain, TuneOptions())
    assert tuning.verdict == "suspect"
    assert "checksum" in (tuning.reason or "")


def test_lengths_in_millimetres_are_seen_and_named(tmp_path: Path):
    stamps, positions = Stranger(0.7, gap_m=1.2).samples()
    write_poses(tmp_path / "a.mcap", stamps, 1000 * positions)
    tuning = tune_log(tmp_path / "a.mcap", TuneOptions())
    assert (tuning.verdict, value(tuning)) == ("suspect", pytest.approx(0.7, abs=0.002))
    assert "the lengths are in mm" in (tuning.reason or "")
    assert "--length-unit mm" in (tuning.reason or "")
