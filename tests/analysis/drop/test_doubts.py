"""Logs that are no good drops, or not only: what is doubted, and what costs nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from tests.analysis.drop.made import GRAVITY, RATE_HZ, TOPIC, seen
from tests.conftest import record
from tests.strangers import Stranger, bounce_heights, without_chunks
from tunenet_logs.analysis.drop import presets as views
from tunenet_logs.analysis.drop.free_flight import find_drops
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import Array, Episode, EpisodeInfo
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.recorders.simulators.ball import DropRig

TIMES_S = np.arange(840) / RATE_HZ


def value(tuning: Tuning) -> float:
    assert tuning.estimate is not None, tuning.reason
    return float(tuning.estimate[0])


def bounced(
    restitution: float = 0.7,
    gap_m: float = 1.0,
    *,
    noise_m: float = 0.0,
    at: dict[int, float] | None = None,
) -> Array:
    """Heights of a ball that is let go after a second; some samples are elsewhere."""
    heights = bounce_heights(restitution, gap_m, TIMES_S - 1)
    heights += np.random.default_rng(3).normal(0, noise_m, len(heights)) if noise_m else 0.0
    for index, stray in (at or {}).items():
        heights[index] = stray
    return heights


def off_the_table() -> Array:
    heights, late_s = bounced(), np.maximum(TIMES_S - 3.0, 0)
    fallen = np.maximum(heights - 4.9 * late_s**2, -0.75)
    return np.where(late_s > 0, fallen, heights)


def caught() -> Array:
    heights, at = bounced(), int((1 + 0.4515 + 0.35) * RATE_HZ)
    heights[at:] = heights[at]
    return heights


def rests_elsewhere(restitution: float, gap_m: float, rest_m: float) -> Array:
    fall_s = np.sqrt(2 * gap_m / 9.81)
    end_s = 1 + fall_s * (1 + 2 * restitution / (1 - restitution)) + 0.05
    heights = np.where(end_s < TIMES_S, rest_m, bounced(restitution, gap_m))
    return heights + np.random.default_rng(0).normal(0, 0.001, 840)


def noisy_in_flight() -> Array:
    noise = np.random.default_rng(0).normal(0, 0.005, 840)
    return bounced(0.5) + np.where(TIMES_S > 1, noise, 0.0)


def small_before_big() -> Array:
    times = np.arange(1800) / RATE_HZ
    small, big = bounce_heights(0.5, 0.4, times - 1), bounce_heights(0.9, 4, times - 8)
    return np.where(times < 5, small, np.where(times < 7, 2 * (times - 5), big))


def carried() -> Array:
    """To its place, and let go."""
    way = 1.6 - 0.6 * (1 - np.cos(np.pi * np.arange(150) / 150)) / 2
    return np.concatenate([way, bounced()])


class Row(NamedTuple):
    """A log's heights, and what must come of it; a word may stand in a warning, too."""

    heights: Array
    verdict: str | None = "ok"  # None: any but rejected
    value: float = 0.7
    within: float = 0.001
    words: tuple[str, ...] = ()


ANOTHER_LEVEL = ((0.1, 2, -0.02), (0.15, 1, -0.01), (0.25, 5, -0.06), (0.3, 5, 0.06))
ROWS = {
    "good": Row(bounced()),
    "does not bounce": Row(bounced(0.0), "rejected", words=("does not bounce",)),
    "leaves the table": Row(off_the_table(), None),
    "is caught": Row(caught()),
    "feet": Row(0.3048 * bounced(gap_m=3.0), "suspect", within=0.01, words=("gravity",)),
    "is carried to its place": Row(carried(), None),
    "falls already": Row(bounced()[140:], None),
    "still": Row(np.full(300, 0.5), "rejected", words=("does not fall",)),
    "lowered": Row(np.linspace(1, 0, 300), "rejected", words=("no ",)),
    "waved": Row(0.5 + 0.4 * np.sin(np.arange(600) / 60), "rejected", words=("no ",)),
    "noise": Row(
        np.random.default_rng(0).normal(0, 0.01, 400), "rejected", words=("does not fall",)
    ),
    "few samples": Row(np.zeros(3), "rejected", words=("too few",)),
    "cut before it hits": Row(bounced()[:170], "rejected"),
    "millimetres": Row(
        1000 * bounced(gap_m=1.2), "suspect", words=("the lengths are in mm", "--length-unit mm")
    ),
    "a stray below": Row(bounced(at={100: 0.0})),
    "a stray far away": Row(bounced(at={400: 1e5})),
    "a stray at first": Row(bounced(at={30: -1.0})),
    "noise only while it moves": Row(noisy_in_flight(), None, 0.5, 0.01),
    "a small drop first": Row(small_before_big(), None, 0.5, 0.002, ("2 drops",)),
    "dull, noisy": Row(bounced(0.15, 4.0, noise_m=0.003), "ok", 0.15, 0.02),
    "usual, noisy": Row(bounced(0.5, 1.0, noise_m=0.003), "ok", 0.5, 0.02),
    "lively, noisy": Row(bounced(0.9, 0.4, noise_m=0.003), "ok", 0.9, 0.02),
    **{
        f"rests {1000 * rest_m} mm off after {gap_m} m": Row(
            rests_elsewhere(restitution, gap_m, rest_m),
            "suspect",
            restitution,
            0.005,
            ("rests where it hit",),
        )
        for restitution, gap_m, rest_m in ANOTHER_LEVEL
    },
}


@pytest.mark.parametrize("name", ROWS)
def test_what_is_made_of_a_log(name: str):
    row = ROWS[name]
    tuning = tune_episode(seen(row.heights), TuneOptions())
    assert tuning.verdict in ((row.verdict,) if row.verdict else ("ok", "suspect")), tuning.reason
    if row.verdict == "rejected":
        assert tuning.estimate is None
    else:
        assert value(tuning) == pytest.approx(row.value, abs=row.within)
    said = " ".join([tuning.reason or "", *tuning.warnings])
    assert all(word in said for word in row.words), said


@pytest.mark.slow
def test_good_drops_with_noise_are_ok_and_right():
    rng = np.random.default_rng(20_003)
    wrong = rejected = 0
    for _ in range(60):
        truth, rate_hz = float(rng.uniform(0.1, 0.95)), float(rng.uniform(60, 240))
        times = np.arange(int(8 * rate_hz)) / rate_hz
        heights = bounce_heights(truth, float(rng.uniform(0.3, 5)), times - 1.5)
        heights += rng.normal(0, rng.uniform(0, 0.003), len(times))
        tuning = tune_episode(seen(heights, rate_hz=rate_hz), TuneOptions())
        rejected += tuning.verdict != "ok"
        wrong += tuning.verdict == "ok" and abs(value(tuning) - truth) > 0.02
    assert wrong == 0
    assert rejected <= 4


@pytest.mark.parametrize("seed", range(3))
def test_the_top_of_a_bounce_is_not_rest(seed: int):
    order = DropOrder(
        restitution=0.46, height_m=4.5, rate_hz=200.0, noise_m=0.005, hold_s=1.0, seed=seed
    )
    tuning = tune_episode(simulate_drop(order), TuneOptions())
    assert tuning.verdict == "ok", tuning.reason
    assert value(tuning) == pytest.approx(0.46, abs=0.005)


def test_samples_lost_with_their_stamps_cost_nothing():
    stamps, positions = Stranger(0.7, noise_m=0.0).samples()
    keep = np.random.default_rng(0).random(len(stamps)) > 0.1
    tuning = tune_episode(seen(positions[keep], stamps[keep]), TuneOptions())
    assert value(tuning) == pytest.approx(0.7, abs=0.001)


@pytest.mark.parametrize("jump_s", [3600, 86_400])
def test_a_clock_that_jumps_is_not_simulated_across(jump_s: int):
    good = seen(bounced()).signals[TOPIC]
    stamps = good.stamps_ns.copy()
    stamps[600:] += jump_s * 10**9
    tuning = tune_episode(seen(good.values, stamps), TuneOptions())
    assert value(tuning) == pytest.approx(0.7, abs=0.001)
    if jump_s == 86_400:
        assert any("after sample 600 of 840" in words for words in tuning.warnings)
        assert tuning.episode is not None
        assert len(tuning.episode.signals[TOPIC].stamps_ns) == 600
    assert tuning.trace is not None
    look = tuning.trace.steps[0].evaluation
    assert look is not None
    assert len(look.episode.signals[TOPIC].stamps_ns) < 10_000
    with pytest.raises(UsageError, match="not within an hour"):
        DropRig(samples=2, times_s=(0.0, 86_400.0))


@pytest.mark.parametrize(
    ("episode", "options", "words"),
    [
        (Episode(EpisodeInfo(), {}), TuneOptions(), ("a ball's position or with pictures", "none")),
        (seen(bounced()), TuneOptions(topic="/nope"), (TOPIC,)),
    ],
    ids=["empty", "another topic"],
)
def test_a_log_without_the_ball_says_what_it_holds(
    episode: Episode, options: TuneOptions, words: tuple[str, ...]
):
    tuning = tune_episode(episode, options)
    assert tuning.verdict == "rejected"
    assert all(word in (tuning.reason or "") for word in words)


def test_a_cut_log_is_tuned_as_far_as_it_goes(drop_log: Path):
    drop_log.write_bytes(drop_log.read_bytes()[:-3000])
    tuning = tune_log(drop_log, TuneOptions())
    assert any("end of the file" in warning for warning in tuning.warnings)
    assert tuning.estimate is None or value(tuning) == pytest.approx(0.7, abs=0.001)


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


def test_of_several_bodies_the_one_that_bounces_as_a_ball_does():
    stamps, ball = Stranger(restitution=0.7).samples()
    tapped = ball.copy()
    tapped[:, 2] = 0.3 * np.abs(np.sin(np.pi * (stamps - stamps[0]) * 2e-9)) ** 0.8
    one = seen(tapped, stamps).signals[TOPIC]
    signals = {"A": replace(one, name="A"), "B": replace(one, name="B", values=ball)}
    alone = tune_episode(Episode(EpisodeInfo(), {"A": signals["A"]}), TuneOptions())
    assert alone.verdict != "ok"
    tuning = tune_episode(Episode(EpisodeInfo(), signals), TuneOptions())
    assert (tuning.verdict, tuning.detection.topic) == ("ok", "B")
    assert value(tuning) == pytest.approx(0.7, abs=0.003)


@pytest.mark.parametrize("rate", [60.0, 120.0, 1000.0])
@pytest.mark.parametrize("gap", [0.3, 1.0, 5.0])
@pytest.mark.parametrize("restitution", [0.1, 0.4, 0.95])
def test_impact_and_height_are_found_to_a_fraction_of_a_sample(
    restitution: float, gap: float, rate: float
):
    times = np.arange(int(5.5 * rate)) / rate
    heights = bounce_heights(restitution, gap, times - 0.5)
    (drop,) = find_drops(times, heights + 0.37)
    fall = np.sqrt(2 * gap / GRAVITY)
    assert drop.impact_s == pytest.approx(0.5 + fall, abs=1e-4)
    assert drop.contact_m == pytest.approx(0.37, abs=2e-4)
    assert drop.drop_height_m == pytest.approx(gap, rel=1e-3)
    assert drop.gravity_m_s2 == pytest.approx(GRAVITY, rel=1e-6)
    assert drop.release_s == pytest.approx(0.5, abs=2e-3)


def test_random_walks_never_break_it():
    rng = np.random.default_rng(1)
    for _ in range(200):
        count = int(rng.integers(10, 400))
        heights = np.cumsum(rng.normal(0, rng.uniform(0.001, 0.3), count))
        times = np.cumsum(rng.uniform(0.001, 0.03, count))
        try:
            find_drops(times, heights)
        except NotFoundError:
            continue


@pytest.mark.parametrize("restitution", [0.1, 0.6, 0.95])
@pytest.mark.parametrize("gravity", [1.62, 9.81])
@pytest.mark.parametrize("rate", [60.0, 133.0, 240.0])
def test_height_rate_gravity_and_table_drop_out(restitution: float, gravity: float, rate: float):
    exact = bounce_heights(restitution, 1.0, views.canonical_axis() + 1, gravity=2.0)
    for gap in (0.5, 2.2):
        times = np.arange(int(12 * rate)) / rate
        heights = bounce_heights(restitution, gap, times - 0.3, gravity) - 0.8
        observation = views.canonical(find_drops(times, heights)[0])
        assert np.abs(observation.values[:, 0] - exact).max() < 2e-3
