"""A fitted drop recovers the truth, and says how sure it is."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.drop.bounce_fit import BounceFit, fit_positions
from tunenet_logs.analysis.drop.bounce_model import (
    CONTACT,
    DRAG,
    FALL,
    HIGH,
    IMPACT,
    RESTITUTION,
    SLOPE,
    SPAN,
    BounceSamples,
)
from tunenet_logs.analysis.drop.bounce_posterior import (
    BallPosterior,
    ball_likelihoods,
    ball_posterior,
)
from tunenet_logs.analysis.drop.free_flight import Drop, find_drops
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop


def recorded(**order: object) -> Drop:
    episode = simulate_drop(DropOrder(**order))  # type: ignore[arg-type]
    signal = next(iter(episode.signals.values()))
    return find_drops(signal.seconds, signal.values[:, 2])[0]


def fitted(drop: Drop) -> BallPosterior:
    fit = fit_positions(drop)
    assert fit is not None
    return ball_posterior(fit)


@pytest.mark.parametrize("restitution", [0.05, 0.2, 0.5, 0.8, 0.97])
def test_a_clean_drop_of_the_engine_is_recovered(restitution: float):
    drop = recorded(restitution=restitution, height_m=1.3, rate_hz=120.0)
    fit = fitted(drop)
    assert fit.values[0] == pytest.approx(restitution, abs=3e-5)
    low, high = fit.interval95[0]
    assert low <= restitution <= high
    assert high - low < 2e-4


def test_noise_widens_the_interval_as_the_square_root_says():
    widths = []
    for noise_m in (0.001, 0.004):
        drop = recorded(restitution=0.7, height_m=2.0, noise_m=noise_m, seed=3)
        low, high = fitted(drop).interval95[0]
        widths.append(high - low)
    assert widths[1] / widths[0] == pytest.approx(4, rel=0.25)


@pytest.mark.parametrize(("restitution", "noise_m"), [(0.3, 0.001), (0.6, 0.005), (0.85, 0.01)])
def test_a_noisy_drop_is_recovered_within_its_interval(restitution: float, noise_m: float):
    drop = recorded(restitution=restitution, height_m=2.0, noise_m=noise_m, seed=3)
    fit = fitted(drop)
    assert fit.values[0] == pytest.approx(restitution, abs=0.005)
    low, high = fit.interval95[0]
    assert low <= restitution <= high


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    """Of 120, a 95 % interval misses 6; over 13 or none at all is a matter of 1 in 200."""
    rng = np.random.default_rng(5)
    missed = 0
    for seed in range(120):
        restitution, noise_m = rng.uniform(0.2, 0.9), rng.uniform(0.0005, 0.01)
        drop = recorded(
            restitution=restitution, height_m=rng.uniform(1, 4), noise_m=noise_m, seed=seed
        )
        low, high = fitted(drop).interval95[0]
        missed += not low <= restitution <= high
    assert 0 < missed < 14


def real_drop(
    restitution: float, *, slope: float = 0.0, drag_1_m: float = 0.0, noise_m: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Times and heights at 120 Hz of a ball that falls 1 m, integrated in steps of 0.1 ms."""
    step, clock, height, speed, first = 1e-4, 0.0, 1.0, 0.0, 0.0
    times, heights = [-1.0, 0.0], [1.0, 1.0]
    while clock < 2.6:
        push = -9.81 - drag_1_m * speed * abs(speed)
        below = height + speed * step + push * step**2 / 2
        if below < 0:
            part = (speed + np.sqrt(speed**2 - 2 * push * height)) / -push
            clock, height, speed = clock + part, 0.0, speed + push * part
            first = first or -speed
            speed *= -restitution * (-speed / first) ** -slope
            if speed < 0.01:  # at rest
                break
        else:
            clock, height, speed = clock + step, below, speed + push * step
        times.append(clock)
        heights.append(height)
    times.append(clock + 1e-4)
    heights.append(0.0 if clock < 2.6 else height)
    seconds = np.arange(-0.4, 2.6, 1 / 120)
    noise = np.random.default_rng(seed).normal(0.0, noise_m, len(seconds))
    return seconds, np.interp(seconds, times, heights) + noise


def held(count: int, *, averaged: int = 1, **ball: float) -> int:
    """Of so many drops, how many intervals hold the truth, with a moving average if asked for."""
    rng = np.random.default_rng(1)
    found = 0
    for seed in range(count):
        truth = float(rng.uniform(0.5, 0.85))
        seconds, heights = real_drop(truth, seed=seed, **ball)  # type: ignore[arg-type]
        kernel = np.ones(averaged) / averaged
        heights = np.convolve(np.pad(heights, averaged // 2, "edge"), kernel, "valid")
        try:
            drop = find_drops(seconds, heights)[0]
        except NotFoundError:
            continue
        low, high = fitted(drop).interval95[0]
        found += low <= truth <= high
    return found


def test_an_ideal_ball_s_intervals_are_narrow():
    seconds, heights = real_drop(0.7, noise_m=0.001, seed=1)
    low, high = fitted(find_drops(seconds, heights)[0]).interval95[0]
    assert low <= 0.7 <= high
    assert high - low < 0.002


@pytest.mark.parametrize(
    ("ball", "averaged", "least"),
    [({"slope": 0.1}, 1, 7), ({"drag_1_m": 0.012}, 1, 6), ({}, 3, 6)],
    ids=["bouncier when slower", "light as a golf ball", "smoothed track"],
)
def test_of_eight_real_balls_most_lie_in_their_intervals(
    ball: dict[str, float], averaged: int, least: int
):
    assert held(8, averaged=averaged, noise_m=0.001, **ball) >= least


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.03, 0.1, 0.2])
def test_intervals_hold_for_a_restitution_that_falls_with_speed(slope: float):
    assert held(20, slope=slope, noise_m=0.001) >= 17


@pytest.mark.slow
@pytest.mark.parametrize(("drag_1_m", "least"), [(0.012, 15), (0.018, 17)])
def test_intervals_hold_for_balls_as_light_as_those_of_golf_and_tennis(drag_1_m: float, least: int):
    assert held(20, drag_1_m=drag_1_m, noise_m=0.001) >= least


@pytest.mark.parametrize(
    ("slope", "drag_1_m"), [(0.1, 0.0), (0.0, 0.12), (0.08, 0.12), (0.0, 0.0), (0.05, 0.02)]
)
def test_slope_and_drag_are_told_apart_where_many_bounces_are_seen(slope: float, drag_1_m: float):
    truth = (0.75, slope, drag_1_m)
    seconds, heights = real_drop(*truth[:1], slope=slope, drag_1_m=drag_1_m, noise_m=0.0005, seed=2)
    found = fitted(find_drops(seconds, heights)[0])
    assert found.values == pytest.approx(truth, abs=0.006)
    assert np.all(found.interval95[:, 0] - 2e-3 <= truth)
    assert np.all(found.interval95[:, 1] + 2e-3 >= truth)


def test_what_a_log_cannot_tell_of_slope_and_drag_is_the_priors():
    seconds, heights = real_drop(0.6, slope=0.05, drag_1_m=0.02, noise_m=0.003, seed=2)
    after = seconds < 0.452 + 2 * 0.6 * 0.452 - 0.02  # the first flight alone
    found = fitted(find_drops(seconds[after], heights[after])[0])
    assert found.told[0] < 0.2
    low, high = found.interval95[1]
    assert low <= 0.05 <= high


def test_a_known_ball_s_drag_is_taken_as_known():
    seconds, heights = real_drop(0.7, drag_1_m=0.12, noise_m=0.002, seed=3)
    drop = find_drops(seconds, heights)[0]
    fit = fit_positions(drop, 0.12)
    assert fit is not None
    known = ball_posterior(fit)
    assert known.values[2] == pytest.approx(0.12, abs=0.01)
    assert np.ptp(known.interval95[0]) <= 1.1 * np.ptp(fitted(drop).interval95[0])


@pytest.mark.slow
def test_intervals_hold_for_smoothed_tracks():
    assert held(20, averaged=3, noise_m=0.001) >= 16


def test_a_low_rebound_is_found():
    drop = recorded(restitution=0.1, height_m=1.0, noise_m=0.0005)
    low, high = fitted(drop).interval95[0]
    assert low <= 0.1 <= high < 0.12


def test_too_few_samples_give_no_fit():
    drop = recorded(restitution=0.5, height_m=1.0)
    few = slice(24, 33)
    parts = {**vars(drop), "seconds": drop.seconds[few], "heights_m": drop.heights_m[few]}
    assert fit_positions(Drop(**parts)) is None


def test_a_fit_with_unknowns_that_no_sample_moves_is_judged():
    """The ball lay before the first sample: neither when it fell nor how far moves any."""
    seconds = np.linspace(0, 1, 60)
    noise = np.random.default_rng(1).normal(0, 1e-3, 60)
    samples = BounceSamples(seconds, noise, 1e-3, in_metres=True)
    unknowns = np.zeros(len(HIGH))
    unknowns[[RESTITUTION, IMPACT, FALL, SPAN]] = 0.005, -1.0, -0.3, 0.5
    free = (RESTITUTION, IMPACT, FALL, CONTACT, SPAN, SLOPE, DRAG)
    (likelihood,) = ball_likelihoods(BounceFit(samples, unknowns, free, noise, 1e-3), 1.0)
    assert np.isfinite([likelihood.log_evidence, likelihood.value, *likelihood.middle]).all()


def test_a_smoothed_track_is_no_surer_than_the_samples_it_was_made_of():
    widths = {}
    for averaged in (1, 3):
        kernel = np.ones(averaged) / averaged
        found = []
        for seed in range(4):
            seconds, heights = real_drop(0.7, noise_m=0.001, seed=seed)
            padded = np.pad(heights, averaged // 2, "edge")
            drop = find_drops(seconds, np.convolve(padded, kernel, "valid"))[0]
            found.append(np.ptp(fitted(drop).interval95[0]))
        widths[averaged] = np.median(found)
    assert widths[3] > 0.9 * widths[1]
