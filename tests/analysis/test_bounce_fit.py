"""A fitted drop recovers the truth, and says how sure it is."""

from __future__ import annotations

import numpy as np
import pytest

from analysis.observe.free_fall import Drop, find_drops
from analysis.refine.bounce_fit import BounceFit, fit_bounce
from recorders.simulated_drop import DropOrder, simulate_drop


def recorded(**order: object) -> Drop:
    episode = simulate_drop(DropOrder(**order))  # type: ignore[arg-type]
    signal = next(iter(episode.signals.values()))
    return find_drops(signal.seconds, signal.values[:, 2])[0]


def fitted(drop: Drop, initial: float) -> BounceFit:
    fit = fit_bounce(drop, initial)
    assert fit is not None
    return fit


@pytest.mark.parametrize("restitution", [0.05, 0.2, 0.5, 0.8, 0.97])
def test_a_clean_drop_of_the_engine_is_recovered(restitution: float):
    drop = recorded(restitution=restitution, height_m=1.3, rate_hz=120.0)
    fit = fitted(drop, restitution + 0.003)
    assert fit.restitution == pytest.approx(restitution, abs=3e-5)
    low, high = fit.interval95
    assert low <= restitution <= high
    assert high - low < 2e-4


def test_noise_widens_the_interval_as_the_square_root_says():
    widths = []
    for noise_m in (0.001, 0.004):
        drop = recorded(restitution=0.7, height_m=2.0, noise_m=noise_m, seed=3)
        low, high = fitted(drop, 0.7).interval95
        widths.append(high - low)
    assert widths[1] / widths[0] == pytest.approx(4, rel=0.25)


def test_intervals_hold_the_truth_as_often_as_they_say():
    """Of 120, a 95 % interval misses 6; over 13 or none at all is a matter of 1 in 200."""
    rng = np.random.default_rng(5)
    missed = 0
    for seed in range(120):
        restitution, noise_m = rng.uniform(0.2, 0.9), rng.uniform(0.0005, 0.01)
        drop = recorded(
            restitution=restitution, height_m=rng.uniform(1, 4), noise_m=noise_m, seed=seed
        )
        low, high = fitted(drop, restitution).interval95
        missed += not low <= restitution <= high
    assert 0 < missed < 14


def test_noise_that_leans_one_way_widens_the_interval():
    drop = recorded(restitution=0.7, height_m=2.0, noise_m=0.001, seed=1)
    rng = np.random.default_rng(0)
    white = rng.normal(0, 0.003, len(drop.seconds))
    leaning = np.convolve(white, np.ones(9) / 3, "same")  # as strong, over nine samples

    def width(noise: np.ndarray) -> float:
        parts = {**vars(drop), "heights_m": drop.heights_m + noise, "noise_m": 0.003}
        low, high = fitted(Drop(**parts), 0.7).interval95
        return high - low

    assert width(leaning) > 1.8 * width(white)


def test_a_restitution_that_falls_with_speed_is_fitted_at_the_first_impact():
    """Each flight is a parabola of its own restitution, e (v / v1)^-0.2 with v1 at the first."""
    rate_hz, fall_s, first = 240.0, 0.6, 0.7
    seconds = np.arange(int(4 * rate_hz)) / rate_hz
    drop_m = 9.80665 * fall_s**2 / 2
    heights = np.clip(drop_m - 9.80665 * seconds**2 / 2, 0, None)
    start, speed = fall_s, 9.80665 * fall_s
    impact = speed
    for _ in range(12):
        speed *= first * (speed / impact) ** -0.2
        since = seconds - start
        flight = speed * since - 9.80665 * since**2 / 2
        heights = np.where(since > 0, np.clip(flight, 0, None), heights)
        start += 2 * speed / 9.80665
    heights += np.random.default_rng(0).normal(0, 0.001, len(seconds))
    fit = fitted(find_drops(seconds, heights)[0], 0.72)
    assert fit.restitution == pytest.approx(first, abs=0.002)
    assert fit.flights == 1


def test_too_few_samples_give_no_fit():
    drop = recorded(restitution=0.5, height_m=1.0)
    few = slice(24, 33)
    parts = {**vars(drop), "seconds": drop.seconds[few], "heights_m": drop.heights_m[few]}
    assert fit_bounce(Drop(**parts), 0.5) is None
