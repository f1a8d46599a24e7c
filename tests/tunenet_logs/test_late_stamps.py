"""Samples held up on their way: what a pause and a burst tell, and what they do not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.conftest import ROOT
from tests.strangers import Stranger
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.reader import read_episode
from tunenet_logs.timing.arrivals import correct_late_stamps
from tunenet_logs.writing.writer import EpisodeWriter

PERIOD_NS = 16_666_667
CLOCK = 1_000_000_000 + PERIOD_NS * np.arange(180)
FILMED = ROOT / "sample_logs" / "filmed.mcap"

Stamps = NDArray[np.int64]


def held_up(stamps_ns: Stamps, first: int, pause_ms: float, apart_us: int = 200) -> Stamps:
    """As they arrive where nothing comes through for a while from a sample on."""
    free_ns = stamps_ns[first] + round(pause_ms * 1e6)
    arrived = stamps_ns.copy()
    waiting = np.flatnonzero((stamps_ns >= stamps_ns[first]) & (stamps_ns < free_ns))
    arrived[waiting] = free_ns + apart_us * 1000 * np.arange(len(waiting))
    return np.maximum.accumulate(arrived) + np.arange(len(arrived))


@pytest.mark.parametrize("pause_ms", [30, 80, 150, 300])
@pytest.mark.parametrize("first", [20, 80, 150])
@pytest.mark.parametrize("jitter_ms", [0.0, 2.0])
def test_a_burst_is_put_where_its_clock_says(first: int, pause_ms: float, jitter_ms: float):
    rng = np.random.default_rng(first)
    taken = CLOCK + np.round(rng.uniform(0, jitter_ms, len(CLOCK)) * 1e6).astype(np.int64)
    arrivals = correct_late_stamps(held_up(taken, first, pause_ms))
    assert np.abs(arrivals.stamps_ns - CLOCK).max() < 0.3 * PERIOD_NS + jitter_ms * 1e6
    assert np.all(np.diff(arrivals.stamps_ns) > 0)
    assert "ms late" in arrivals.warnings("pictures")[0]
    if jitter_ms:
        assert arrivals.clock is not None
        late = np.count_nonzero(arrivals.clock.lateness > 8)
    else:
        late = len(arrivals.taken_ns)
    assert late == pytest.approx(pause_ms / 16.7, abs=1.5)


def test_a_pause_within_a_burst():
    arrivals = correct_late_stamps(held_up(held_up(CLOCK, 60, 150), 66, 180))
    assert np.abs(arrivals.stamps_ns - CLOCK).max() < 0.3 * PERIOD_NS


@pytest.mark.parametrize(
    "stamps",
    [
        CLOCK,
        np.delete(CLOCK, slice(60, 70)),  # lost for good
        np.delete(held_up(CLOCK, 60, 150), slice(64, 68)),  # lost on the way: nobody knows which
        np.concatenate([CLOCK[:60], CLOCK[60:] + 10 * PERIOD_NS]),  # held up for good
        np.sort(np.concatenate([CLOCK, CLOCK[::10] + 1_000_000])),  # written twice
        CLOCK[np.arange(len(CLOCK)) % 5 != 0],  # every fifth is missing
        CLOCK[:5],
        CLOCK[:0],
    ],
)
def test_what_tells_of_no_burst_is_left_as_it_is(stamps: Stamps):
    arrivals = correct_late_stamps(stamps)
    assert np.array_equal(arrivals.stamps_ns, stamps)
    assert not arrivals.warnings("pictures")


def test_another_rate_is_named_and_left_as_it_is():
    stamps = np.concatenate([CLOCK[:60], 2 * CLOCK[60:] - CLOCK[60]])
    arrivals = correct_late_stamps(stamps)
    assert np.array_equal(arrivals.stamps_ns, stamps)
    assert arrivals.warnings("pictures") == ["the rate of the pictures goes from 60.0 to 30.0 Hz"]


def value(tuning: Tuning) -> float:
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.estimate is not None
    return float(tuning.estimate[0])


@pytest.fixture(scope="module")
def even() -> float:
    return value(tune_log(FILMED, TuneOptions()))


@pytest.mark.parametrize(
    ("first", "pause_ms"),
    [(35, 150), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((45, 80), (80, 300)))],
)
def test_a_film_that_stalls_tells_the_same(
    tmp_path: Path, even: float, first: int, pause_ms: float
):
    """Within .001; without the mending each of these is rejected, or its value doubted."""
    frames = list(read_episode(FILMED).frames())
    stamps = held_up(np.array([frame.stamp_ns for frame in frames]), first, pause_ms)
    path = tmp_path / "stalled.mcap"
    with EpisodeWriter(path, EpisodeInfo(kind="drop"), live=False) as writer:
        for frame, stamp_ns in zip(frames, stamps, strict=True):
            writer.write_frame("/camera", replace(frame, stamp_ns=int(stamp_ns)))
    tuning = tune_log(path, TuneOptions())
    assert value(tuning) == pytest.approx(even, abs=0.001)
    assert any("came in bursts" in warning for warning in tuning.warnings)


def test_positions_that_stall_tell_the_same(tmp_path: Path):
    stamps, positions = Stranger(restitution=0.6, gap_m=1.0).samples()
    for name, arrived in (("even", stamps), ("stalled", held_up(stamps, 90, 80))):
        with EpisodeWriter(
            tmp_path / f"{name}.mcap", EpisodeInfo(kind="drop"), live=False
        ) as writer:
            for stamp_ns, position_m in zip(arrived, positions, strict=True):
                writer.write_pose("/mocap/ball", int(stamp_ns), position_m)
    even, stalled = (
        tune_log(tmp_path / f"{one}.mcap", TuneOptions()) for one in ("even", "stalled")
    )
    assert value(stalled) == pytest.approx(value(even), abs=1e-4)


@pytest.mark.parametrize("rate_hz", [100, 120, 360])
@pytest.mark.parametrize("decimals", [6, 9])
@pytest.mark.parametrize("seen", [0.3, 0.5, 0.6, 0.9])
def test_frames_that_were_not_seen_are_no_burst(rate_hz: int, decimals: int, seen: float):
    frames = np.flatnonzero(np.random.default_rng(rate_hz).random(2000) < seen)
    frames = np.delete(frames, slice(300, 500))
    stamps = np.round(np.round(frames / rate_hz, decimals) * 1e9).astype(np.int64)
    arrivals = correct_late_stamps(stamps)
    np.testing.assert_array_equal(arrivals.stamps_ns, stamps)
    assert arrivals.warnings("samples") == []


@pytest.mark.parametrize("quantum_ns", [1_000, 100_000, 1_000_000])
def test_a_burst_in_rounded_stamps_is_no_grid(quantum_ns: int):
    late = held_up(held_up(held_up(CLOCK, 40, 150, 1000), 90, 150, 1000), 150, 150, 1000)
    rounded = late // quantum_ns * quantum_ns
    arrivals = correct_late_stamps(rounded)
    assert np.abs(arrivals.stamps_ns - CLOCK).max() < 0.5 * PERIOD_NS
    assert "ms late" in arrivals.warnings("samples")[0]
