"""The even clock behind arrivals, found again from arrivals that a network of our own delays."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tunenet_logs.timing.arrivals import (
    UniformClock,
    changing_rate,
    correct_late_stamps,
    recover_uniform_clock,
)

DELAYS = ("up to 40 ms", "exponential", "bursts")


def arrivals(
    seed: int, rate_hz: float, delay: str, missing: float = 0.0, seconds: float = 3.0
) -> tuple[NDArray[np.intp], NDArray[np.floating], NDArray[np.int64]]:
    """Ticks of the samples that come, when they were taken [ms], and when they come [ns]."""
    rng = np.random.default_rng(seed)
    ticks = np.flatnonzero(rng.random(round(seconds * rate_hz)) >= missing)
    taken = rng.uniform(0, 100) + ticks * 1e3 / rate_hz
    late = {
        "up to 40 ms": rng.uniform(0, 40, len(ticks)),
        "exponential": rng.exponential(10, len(ticks)),
        "bursts": -taken % 100,
    }[delay]
    came = np.maximum.accumulate(taken + late + rng.exponential(0.1, len(ticks)))
    came_ns = np.round(came * 1e6).astype(np.int64) + np.arange(len(ticks))
    return ticks, taken, came_ns.astype(np.int64)


def found(came_ns: NDArray[np.int64]) -> UniformClock:
    clock = recover_uniform_clock(came_ns)
    assert clock is not None
    return clock


def rms_ms(clock: UniformClock, taken: NDArray[np.floating]) -> float:
    return float(np.std(clock.stamps - taken))


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

    def cost(numbers: NDArray[np.intp], times: NDArray[np.float64]) -> NDArray[np.float64]:
        return 3 * np.abs(times - (taken[numbers] + shift)[:, None])

    placed = clock.placed_by(cost)
    assert np.ptp(placed.ticks - ticks) == 0
    assert np.all(np.diff(placed.stamps_ns) > 0)


def test_a_clock_that_drifts_is_followed():
    rng = np.random.default_rng(1)
    ticks = np.arange(4000)
    taken = ticks * 1e3 / 60 + 2e-6 * ticks**2  # 32 ms in a minute
    came = np.maximum.accumulate(taken + rng.exponential(10, len(ticks)))
    clock = found(np.round(came * 1e6).astype(np.int64) + ticks)
    assert np.ptp(clock.ticks - ticks) == 0
    assert rms_ms(clock, taken) < 0.5


def test_few_or_simultaneous_samples_tell_no_clock():
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
        corrected = correct_late_stamps(stamps)
        assert np.abs(corrected.stamps_ns - stamps).max() < 50_000


def test_a_sensor_that_is_not_even_stays_what_it_is():
    for seed in range(3):
        rng = np.random.default_rng(seed)
        stamps = np.cumsum(np.abs(rng.normal(33e6, 2e6, 200))).astype(np.int64)
        assert np.array_equal(correct_late_stamps(stamps).stamps_ns, stamps)


@pytest.mark.parametrize("jitter_ms", [0.0, 40.0])
def test_a_camera_that_slows_down_in_the_dark_is_named(jitter_ms: float):
    rng = np.random.default_rng(2)
    taken = np.cumsum(np.linspace(1e3 / 30, 1e3 / 12, 200))
    came = np.maximum.accumulate(taken + rng.uniform(0, jitter_ms + 1e-9, len(taken)))
    stamps = np.round(came * 1e6).astype(np.int64) + np.arange(len(taken))
    corrected = correct_late_stamps(stamps)
    assert np.array_equal(corrected.stamps_ns, stamps)
    assert "the rate of the pictures goes from" in corrected.warnings("pictures")[0]


def test_delays_are_no_change_of_rate():
    for delay in DELAYS:
        assert not changing_rate(arrivals(4, 60, delay)[2], 24)
