"""A fitted drop recovers the truth, and says how sure it is and what it cannot tell."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.drop.made import real_drop, seen, smoothed
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
    unidentifiable,
)
from tunenet_logs.analysis.drop.free_flight import Drop, find_drops
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_episode, tune_log
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


def test_noise_widens_the_interval_as_the_square_root_says():
    widths = []
    for noise_m in (0.001, 0.004):
        drop = recorded(restitution=0.7, height_m=2.0, noise_m=noise_m, seed=3)
        low, high = fitted(drop).interval95[0]
        widths.append(high - low)
    assert widths[1] / widths[0] == pytest.approx(4, rel=0.25)


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


@pytest.mark.slow
def test_a_smoothed_track_is_right_and_a_little_too_sure():
    """Of 40 drops 30 are ok, with errors of .0002; eight of ten of their intervals hold."""
    rng = np.random.default_rng(1)
    ok = held = 0
    for seed in range(40):
        truth = float(rng.uniform(0.5, 0.85))
        seconds, heights = real_drop(truth, seed=seed, noise_m=0.001)
        stamps_ns = np.round((seconds - seconds[0]) * 1e9).astype(np.int64)
        tuning = tune_episode(seen(smoothed(heights, 3), stamps_ns), TuneOptions())
        if tuning.verdict == "ok":
            assert tuning.estimate is not None
            assert tuning.interval95 is not None
            assert tuning.estimate[0] == pytest.approx(truth, abs=0.001)
            low, high = tuning.interval95[0]
            ok, held = ok + 1, held + (low <= truth <= high)
    assert ok >= 24
    assert held >= 0.75 * ok


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
        found = []
        for seed in range(4):
            seconds, heights = real_drop(0.7, noise_m=0.001, seed=seed)
            drop = find_drops(seconds, smoothed(heights, averaged))[0]
            found.append(np.ptp(fitted(drop).interval95[0]))
        widths[averaged] = np.median(found)
    assert widths[1] < 0.002
    assert widths[3] > 0.9 * widths[1]


@pytest.mark.parametrize(
    ("restitution", "noise_m", "height_m", "off", "widest"),
    [
        *((one, 0.0, 1.3, 3e-5, 2e-4) for one in (0.05, 0.2, 0.5, 0.8, 0.97)),
        (0.1, 0.0005, 1.0, 0.02, 0.04),
        (0.3, 0.001, 2.0, 0.005, 0.02),
        (0.6, 0.005, 2.0, 0.005, 0.02),
        (0.85, 0.01, 2.0, 0.005, 0.02),
    ],
)
def test_a_drop_of_the_engine_is_recovered(
    restitution: float, noise_m: float, height_m: float, off: float, widest: float
):
    order = {"rate_hz": 120.0, "noise_m": noise_m, "seed": 3}
    fit = fitted(recorded(restitution=restitution, height_m=height_m, **order))
    assert fit.values[0] == pytest.approx(restitution, abs=off)
    low, high = fit.interval95[0]
    assert low <= restitution <= high
    assert high - low < widest


def held(count: int, *, averaged: int = 1, **ball: float) -> int:
    """Of so many drops, how many intervals hold the truth, with a moving average if asked for."""
    rng = np.random.default_rng(1)
    found = 0
    for seed in range(count):
        truth = float(rng.uniform(0.5, 0.85))
        seconds, heights = real_drop(truth, seed=seed, noise_m=0.001, **ball)  # type: ignore[arg-type]
        try:
            drop = find_drops(seconds, smoothed(heights, averaged))[0]
        except NotFoundError:
            continue
        low, high = fitted(drop).interval95[0]
        found += low <= truth <= high
    return found


@pytest.mark.parametrize(
    ("ball", "averaged", "count", "least"),
    [
        ({"slope": 0.1}, 1, 8, 7),
        ({"drag_1_m": 0.012}, 1, 8, 6),
        ({}, 3, 8, 6),
        *(
            pytest.param(*row, marks=pytest.mark.slow)
            for row in (
                ({"slope": 0.03}, 1, 20, 17),
                ({"slope": 0.1}, 1, 20, 17),
                ({"slope": 0.2}, 1, 20, 17),
                ({"drag_1_m": 0.012}, 1, 20, 15),  # as light as a golf ball
                ({"drag_1_m": 0.018}, 1, 20, 17),
            )
        ),
    ],
)
def test_intervals_hold_balls_that_differ_from_the_ideal(
    ball: dict[str, float], averaged: int, count: int, least: int
):
    assert held(count, averaged=averaged, **ball) >= least


@pytest.fixture
def posterior(drop_log: Path) -> BallPosterior:
    found = tune_log(drop_log, TuneOptions()).detection.posterior
    assert found is not None
    return found


def test_a_log_of_many_bounces_leaves_nothing_open(posterior: BallPosterior):
    assert unidentifiable(posterior) == ()
    assert unidentifiable(replace(posterior, correlation=-0.99)) == ()  # both are told all the same


def test_what_its_prior_says_is_named(posterior: BallPosterior):
    ends = np.array([[0.5, 0.53], [-0.02, 0.15], [0.03, 0.06]])
    (words,) = unidentifiable(
        replace(posterior, told=np.array([0.0, 0.9]), correlation=0.0, interval95=ends)
    )
    assert words.startswith("this log cannot determine the slope: ")
    assert words.endswith("from -0.020 to 0.150")


def test_what_trades_places_cannot_be_told_apart(posterior: BallPosterior):
    samples = posterior.fit.samples
    view = posterior.fit.projection()
    third_s = view.impact_s + view.fall_time_s * float(view.impacts(1e3)[2])
    fit = replace(posterior.fit, samples=samples.only(samples.seconds < third_s - 0.01))
    short = replace(posterior, told=np.array([0.2, 0.3]), correlation=-0.97, fit=fit)
    assert unidentifiable(short) == ("drag and slope cannot be separated in this log: two flights",)
