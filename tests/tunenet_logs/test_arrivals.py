"""The clock behind arrivals: even, with pauses and bursts, and the rate that it has."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from tests.conftest import ROOT
from tests.strangers import Stranger
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.media import StoredTimes, clock_of
from tunenet_logs.reader import read_episode
from tunenet_logs.timing.arrivals import (
    UniformClock,
    changing_rate,
    correct_late_stamps,
    recover_uniform_clock,
)
from tunenet_logs.timing.stamps import MAX_SPEED_CAMERA_HZ, measured_hz
from tunenet_logs.writing.writer import EpisodeWriter

Stamps = NDArray[np.int64]
PERIOD_NS = 16_666_667
CLOCK = 1_000_000_000 + PERIOD_NS * np.arange(180)
FILMED = ROOT / "sample_logs" / "filmed.mcap"
DELAYS = ("up to 40 ms", "exponential", "bursts")


def arrivals(
    seed: int, rate_hz: float, delay: str, missing: float = 0.0
) -> tuple[NDArray[np.intp], NDArray[np.floating], Stamps]:
    """Ticks of the samples that come, when they were taken [ms], and when they come [ns]."""
    rng = np.random.default_rng(seed)
    ticks = np.flatnonzero(rng.random(round(3 * rate_hz)) >= missing)
    taken = rng.uniform(0, 100) + ticks * 1e3 / rate_hz
    late = {
        "up to 40 ms": rng.uniform(0, 40, len(ticks)),
        "exponential": rng.exponential(10, len(ticks)),
        "bursts": -taken % 100,
    }[delay]
    came = np.maximum.accumulate(taken + late + rng.exponential(0.1, len(ticks)))
    return ticks, taken, np.round(came * 1e6).astype(np.int64) + np.arange(len(ticks))


def found(came_ns: Stamps) -> UniformClock:
    clock = recover_uniform_clock(came_ns)
    assert clock is not None
    return clock


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("rate_hz", [30, 60, 120, 27.3])
def test_where_all_samples_come_each_is_put_on_its_tick(delay: str, rate_hz: float):
    errors = []
    for seed in range(2):
        ticks, taken, came_ns = arrivals(seed, rate_hz, delay)
        clock = found(came_ns)
        sure = ~clock.unsure
        assert np.mean(sure) > 0.8
        assert np.ptp((clock.ticks - ticks)[sure]) == 0
        assert clock.rate_hz == pytest.approx(rate_hz, rel=4e-3)
        errors.append(np.std((clock.stamps - taken)[sure]))
        assert not changing_rate(came_ns, 24)
    assert np.mean(errors) < (0.3 if rate_hz != 27.3 else 1.5)  # a usual rate is known exactly


def test_what_delays_do_not_tell_apart_is_not_taken_for_television_s_rate():
    rates_hz = [found(arrivals(seed, 60, "up to 40 ms")[2]).rate_hz for seed in range(16)]
    assert np.count_nonzero(np.isclose(rates_hz, 60, rtol=1e-6)) >= 14
    assert found(arrivals(0, 60 / 1.001, "exponential")[2]).rate_hz == pytest.approx(60 / 1.001)


@pytest.mark.parametrize("delay", DELAYS)
def test_samples_around_a_loss_are_unsure_and_those_away_from_it_right(delay: str):
    ticks, _, came_ns = arrivals(3, 30, delay, missing=0.03)
    clock = found(came_ns)
    off = clock.ticks - ticks
    usual = np.median(off[~clock.unsure])
    assert np.mean(off[~clock.unsure] != usual) < 0.03
    is_possible = (ticks + usual >= clock.earliest) & (ticks + usual <= clock.latest)
    assert np.mean(is_possible) > 0.97
    assert clock.lost == ticks[-1] - ticks[0] + 1 - len(ticks)


def test_what_else_is_known_places_an_unsure_sample():
    ticks, taken, came_ns = arrivals(5, 60, "bursts", missing=0.03)
    clock = found(came_ns)
    assert clock.unsure.any()
    shift = np.median((clock.stamps - taken)[~clock.unsure])
    placed = clock.placed_by(
        lambda numbers, times: 3 * np.abs(times - (taken[numbers] + shift)[:, None])
    )
    assert np.ptp(placed.ticks - ticks) == 0
    assert np.all(np.diff(placed.stamps_ns) > 0)


def test_a_clock_that_drifts_is_followed_and_few_samples_tell_none():
    rng = np.random.default_rng(1)
    ticks = np.arange(4000)
    taken = ticks * 1e3 / 60 + 2e-6 * ticks**2  # 32 ms in a minute
    came = np.maximum.accumulate(taken + rng.exponential(10, len(ticks)))
    clock = found(np.round(came * 1e6).astype(np.int64) + ticks)
    assert np.ptp(clock.ticks - ticks) == 0
    assert np.std(clock.stamps - taken) < 0.5
    assert recover_uniform_clock(np.arange(10) * 1_000_000) is None
    assert recover_uniform_clock(np.full(100, 5)) is None


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("noise_us", [0, 20, 200])
def test_exact_stamps_with_dropouts_stay_what_they_are(share: float, noise_us: int):
    for seed in range(2):
        rng = np.random.default_rng(seed)
        ticks = np.flatnonzero(rng.random(400) >= share)
        exact = np.round(ticks * 1e9 / 120).astype(np.int64)
        stamps = exact + np.round(rng.normal(0, 1e3 * noise_us, len(ticks))).astype(np.int64)
        assert np.abs(correct_late_stamps(stamps).stamps_ns - stamps).max() < 50_000


@pytest.mark.parametrize("jitter_ms", [0.0, 40.0])
def test_a_camera_that_slows_down_in_the_dark_is_named(jitter_ms: float):
    rng = np.random.default_rng(2)
    taken = np.cumsum(np.linspace(1e3 / 30, 1e3 / 12, 200))
    came = np.maximum.accumulate(taken + rng.uniform(0, jitter_ms + 1e-9, len(taken)))
    stamps = np.round(came * 1e6).astype(np.int64) + np.arange(len(taken))
    corrected = correct_late_stamps(stamps)
    assert np.array_equal(corrected.stamps_ns, stamps)
    assert "the rate of the pictures goes from" in corrected.warnings("pictures")[0]


# Pauses and bursts.
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
    late = len(arrivals.taken_ns)
    if jitter_ms:
        assert arrivals.clock is not None
        late = np.count_nonzero(arrivals.clock.lateness > 8)
    assert late == pytest.approx(pause_ms / 16.7, abs=1.5)


@pytest.mark.parametrize("quantum_ns", [1, 1_000, 100_000, 1_000_000])
def test_bursts_in_a_burst_and_in_rounded_stamps(quantum_ns: int):
    late = held_up(held_up(held_up(CLOCK, 40, 150, 1000), 90, 150, 1000), 150, 150, 1000)
    arrivals = correct_late_stamps(late // quantum_ns * quantum_ns)
    assert np.abs(arrivals.stamps_ns - CLOCK).max() < 0.5 * PERIOD_NS
    assert "ms late" in arrivals.warnings("samples")[0]
    arrivals = correct_late_stamps(held_up(held_up(CLOCK, 60, 150), 66, 180))
    assert np.abs(arrivals.stamps_ns - CLOCK).max() < 0.3 * PERIOD_NS


UNEVEN = [np.cumsum(np.abs(np.random.default_rng(n).normal(33e6, 2e6, 200))) for n in range(3)]


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
        *(one.astype(np.int64) for one in UNEVEN),  # a sensor that is not even
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
    found = []
    for arrived in (stamps, held_up(stamps, 90, 80)):
        path = tmp_path / f"{len(found)}.mcap"
        with EpisodeWriter(path, EpisodeInfo(kind="drop"), live=False) as writer:
            for stamp_ns, position_m in zip(arrived, positions, strict=True):
                writer.write_pose("/mocap/ball", int(stamp_ns), position_m)
        found.append(value(tune_log(path, TuneOptions())))
    assert found[1] == pytest.approx(found[0], abs=1e-4)


# Rates: messages over time, whatever delays, pauses and losses do to single steps.
HZ = 60.0
EVEN_S = np.arange(600) / HZ
RNG = np.random.default_rng(0)


def hz(seconds: ArrayLike) -> float:
    from_ns = 1_700_000_000_000_000_000
    return measured_hz(from_ns + np.round(np.asarray(seconds) * 1e9).astype(np.int64))


def bursts(every_s: float) -> np.ndarray:
    return np.ceil(EVEN_S / every_s) * every_s + np.arange(600) * 1e-9


def stopped(of_waiting: slice) -> np.ndarray:
    """A reader that was stopped from 4 s to 6 s, and what had waited for it."""
    inside = np.flatnonzero((EVEN_S > 4) & (EVEN_S < 6))
    waited = 6 - np.arange(len(inside))[::-1] * 1e-6
    return np.r_[EVEN_S[EVEN_S <= 4], waited[of_waiting], EVEN_S[EVEN_S >= 6] + 1e-6]


@pytest.mark.parametrize(
    ("seconds", "rate_hz", "rel"),
    [
        (EVEN_S, HZ, 0.002),
        (EVEN_S[:2], HZ, 0.002),
        (EVEN_S + RNG.uniform(0, 0.04, 600), HZ, 0.002),
        (EVEN_S + RNG.exponential(0.01, 600), HZ, 0.002),
        *((bursts(every_s), HZ, 0.002) for every_s in (0.1, 0.25, 1.0)),
        *((stopped(slice(kept)), HZ, 0.002) for kept in (None, 0, 60)),  # some of it lost
        (np.r_[EVEN_S, 7200.0], HZ, 0.002),
        (np.r_[-7200.0, EVEN_S], HZ, 0.002),
        (np.r_[EVEN_S[:200], EVEN_S[200:400] + 5, EVEN_S[400:] + 12], HZ, 0.002),  # pauses
        (np.r_[np.full(120, 2.0) + np.arange(120) * 1e-4, EVEN_S[120:]], HZ, 0.002),  # read ahead
        (EVEN_S[np.argsort(np.arange(600) + RNG.uniform(0, 3, 600))], HZ, 0.002),  # out of order
        (EVEN_S[RNG.random(600) > 0.1], 0.9 * HZ, 0.03),  # what is missing is not counted
        (np.r_[EVEN_S[:300], EVEN_S[299] + np.arange(1, 151) / 30], 45, 0.002),  # it changes
        (np.arange(20) * 10.0, 0.1, 1e-6),
        (np.r_[np.arange(30), np.arange(90, 120)], 1.0, 0.03),
        (np.arange(300) * 1e-9, 0, 0),  # what came in one piece tells none
        ([], 0, 0),
        ([3.0], 0, 0),
    ],
)
def test_measured_rates(seconds: ArrayLike, rate_hz: float, rel: float):
    assert hz(seconds) == pytest.approx(rate_hz, rel=rel)


def test_rates_of_a_few_pictures():
    assert measured_hz([0, 100_000, 200_000], MAX_SPEED_CAMERA_HZ) == 0
    times = StoredTimes(ticks=[0, 10, 110], count=3, base_s=Fraction(1, 100), rate_hz=None, tags={})
    clock = clock_of(times, None)
    assert clock.stamps_ns.tolist() == [0, 100_000_000, 1_100_000_000]
    assert clock.stored_hz == 1 / 0.55
