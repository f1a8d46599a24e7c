"""A fitted drop recovers the truth, says how sure it is, and its simulator moves like the ball."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.analysis.answers import ends, known, steps, trace_of, value
from tests.analysis.drop.made import real_drop, seen, smoothed
from tests.conftest import real, tune_all
from tunenet_logs.analysis.drop.bounce_fit import fit_positions
from tunenet_logs.analysis.drop.bounce_posterior import (
    BallPosterior,
    ball_posterior,
    unidentifiable,
)
from tunenet_logs.analysis.drop.free_flight import Drop, find_drops
from tunenet_logs.analysis.evaluation.studies.throws import throw
from tunenet_logs.analysis.evaluation.worlds.ball import RealBall, record_drop
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import Motion
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import Episode
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.terminal import Progress


def recorded(**order: object) -> Drop:
    episode = simulate_drop(DropOrder(**order))  # type: ignore[arg-type]
    signal = next(iter(episode.signals.values()))
    return find_drops(signal.seconds, signal.values[:, 2])[0]


def fitted(drop: Drop) -> BallPosterior:
    return ball_posterior(known(fit_positions(drop)))


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
    sure = ball_posterior(known(fit_positions(drop, 0.12)))
    assert sure.values[2] == pytest.approx(0.12, abs=0.01)
    assert np.ptp(sure.interval95[0]) <= 1.1 * np.ptp(fitted(drop).interval95[0])


def test_a_smoothed_track_is_no_surer_than_the_samples_it_was_made_of():
    drops = [real_drop(0.7, noise_m=0.001, seed=seed) for seed in range(4)]
    single, thrice = (
        np.median(
            [np.ptp(fitted(find_drops(at, smoothed(z, by))[0]).interval95[0]) for at, z in drops]
        )
        for by in (1, 3)
    )
    assert single < 0.002
    assert thrice > 0.9 * single


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


@pytest.mark.slow
def test_intervals_of_ideal_balls_hold_the_truth_as_often_as_they_say():
    """Of 120, a 95 % interval misses 6; over 13 or none at all is a matter of 1 in 200."""
    rng = np.random.default_rng(5)
    missed = 0
    for seed in range(120):
        truth = rng.uniform(0.2, 0.9)
        order = {"noise_m": rng.uniform(0.0005, 0.01), "height_m": rng.uniform(1, 4), "seed": seed}
        low, high = fitted(recorded(restitution=truth, **order)).interval95[0]
        missed += not low <= truth <= high
    assert 0 < missed < 14


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
def test_intervals_hold_balls_and_tracks_that_differ_from_the_ideal(
    ball: dict[str, float], averaged: int, count: int, least: int
):
    """Of so many drops; with a moving average if asked for."""
    rng = np.random.default_rng(1)
    held = 0
    for seed in range(count):
        truth = float(rng.uniform(0.5, 0.85))
        seconds, heights = real_drop(truth, seed=seed, noise_m=0.001, **ball)
        with suppress(NotFoundError):
            drop = find_drops(seconds, smoothed(heights, averaged))[0]
            low, high = fitted(drop).interval95[0]
            held += low <= truth <= high
    assert held >= least


@pytest.mark.slow
def test_a_smoothed_track_is_right_and_a_little_too_sure():
    """Of 40 drops 30 are ok, with errors of .0002; eight of ten of their intervals hold."""
    rng = np.random.default_rng(1)
    held = []
    for seed in range(40):
        truth = float(rng.uniform(0.5, 0.85))
        seconds, heights = real_drop(truth, seed=seed, noise_m=0.001)
        stamps_ns = np.round((seconds - seconds[0]) * 1e9).astype(np.int64)
        tuning = tune_episode(seen(smoothed(heights, 3), stamps_ns), TuneOptions())
        if tuning.verdict == "ok":
            assert value(tuning) == pytest.approx(truth, abs=0.001)
            low, high = ends(tuning)
            held.append(low <= truth <= high)
    assert len(held) >= 24
    assert np.mean(held) >= 0.75


@pytest.fixture
def posterior(drop_log: Path) -> BallPosterior:
    return known(tune_log(drop_log, TuneOptions()).detection.posterior)


def test_what_a_log_leaves_open_is_named(posterior: BallPosterior):
    assert unidentifiable(posterior) == ()
    assert unidentifiable(replace(posterior, correlation=-0.99)) == ()  # both are told all the same
    ends = np.array([[0.5, 0.53], [-0.02, 0.15], [0.03, 0.06]])
    prior = replace(posterior, told=np.array([0.0, 0.9]), correlation=0.0, interval95=ends)
    (words,) = unidentifiable(prior)
    assert words.startswith("this log cannot determine the slope: ")
    assert words.endswith("from -0.020 to 0.150")
    view, samples = posterior.fit.projection(), posterior.fit.samples
    third_s = view.impact_s + view.fall_time_s * float(view.impacts(1e3)[2])
    fit = replace(posterior.fit, samples=samples.only(samples.seconds < third_s - 0.01))
    short = replace(posterior, told=np.array([0.2, 0.3]), correlation=-0.97, fit=fit)
    assert unidentifiable(short) == ("drag and slope cannot be separated in this log: two flights",)


# ---- The tuned simulator moves like the ball, thrown or let go


# A table-tennis ball from 1.4 m, by an integrator that shares nothing with fit or simulator.
LIGHT = RealBall(0.8, 0.06, 0.12, 1.4)


def on_file(ball: RealBall, noise_m: float = 0.001, seed: int = 3) -> Episode:
    return record_drop(ball, 120.0, noise_m, np.random.default_rng(seed)).episode()


def motion_of(episode: Episode, **options: object) -> tuple[str, Motion]:
    tuning = tune_episode(episode, TuneOptions(**options))  # type: ignore[arg-type]
    return tuning.verdict, record_of(tuning).motion


@pytest.fixture(scope="module")
def light() -> Tuning:
    """What is tuned from one such ball."""
    return tune_episode(on_file(LIGHT), TuneOptions(), Path("a.mcap"))


def test_the_tuned_rollout_lies_on_the_samples(light: Tuning):
    motion = record_of(light).motion
    fit, curves = known(motion.fit), known(motion.curves)
    assert light.verdict == "ok"
    assert fit.excess_percent < 0.1
    assert known(fit.held_out_percent) < 0.3
    off_m = curves.simulated_m - curves.observed_m
    assert np.nanstd(off_m) == pytest.approx(0.001, rel=0.15)
    stamps_ns = curves.start_ns + np.round(curves.seconds * 1e9).astype(np.int64)
    (signal,) = on_file(LIGHT).signals.values()
    assert np.isin(stamps_ns, signal.stamps_ns).all()


def test_a_simulator_without_air_does_not_move_like_it_but_reaches_the_first_rebound():
    """One parameter leaves the observation, and says so, whatever it is itself."""
    verdict, motion = motion_of(on_file(LIGHT), method="brent")
    assert verdict != "ok"
    assert known(motion.fit).excess_percent > 1
    _, motion = motion_of(on_file(LIGHT, noise_m=0.0))
    equivalents = known(motion.equivalents)
    first, best = equivalents.first, equivalents.all
    seen_m = known(motion.curves).observed_m
    falls = np.flatnonzero(np.diff(np.sign(np.diff(seen_m))) > 0)
    later_m = seen_m[falls[0] + 1 :]
    rebound_m = later_m[: int(np.argmax(np.diff(later_m) < 0)) + 1].max()
    assert first.restitution**2 * 1.4 == pytest.approx(rebound_m, abs=0.003)
    assert first.restitution < 0.78
    assert best.rms_percent < first.rms_percent
    assert first.speeds_m_s[1] == pytest.approx(first.restitution * first.speeds_m_s[0])


def test_a_ball_that_hits_something_later_is_not_ok():
    """From the third flight on another ball: the tuned one leaves it visibly."""
    episode = on_file(LIGHT, noise_m=0.0005)
    other = on_file(RealBall(0.8, -0.2, 0.12, 1.4), noise_m=0.0005)
    (topic, signal), (_, changed) = (next(iter(one.signals.items())) for one in (episode, other))
    count = min(len(signal.values), len(changed.values))
    values = signal.values[:count].copy()
    late = np.arange(count) > 0.55 * count
    values[late] = changed.values[:count][late]
    mixed = replace(signal, stamps_ns=signal.stamps_ns[:count], values=values)
    verdict, _ = motion_of(replace(episode, signals={topic: mixed}))
    assert verdict != "ok"


def test_a_vector_of_first_values_is_taken():
    tuning = tune_episode(on_file(LIGHT), TuneOptions(initial=(0.5, 0.02), method="tunenet"))
    assert steps(tuning)[0] == pytest.approx([0.5, 0.02, 0.0])
    assert tuning.estimate == pytest.approx([0.8, 0.06, 0.12], abs=0.02)


@pytest.mark.slow
def test_the_network_alone_walks_all_three():
    """No noise, K = 5, random balls: medians of .0003, .001 and .001 (drag times height)."""
    rng = np.random.default_rng(5)
    off: list[np.ndarray] = []
    for _ in range(30):
        truth = rng.uniform((0.3, 0.0, 0.0), (0.95, 0.12, 0.25))
        episode = on_file(RealBall(truth[0], truth[1], truth[2], 1.0), noise_m=0.0)
        start = tuple(rng.uniform((0.3, 0.0, 0.0), (0.95, 0.12, 0.25)).tolist())
        tuning = tune_episode(episode, TuneOptions(initial=start, method="tunenet"))
        off.append(np.abs(trace_of(tuning).estimate - truth))
    assert np.all(np.median(off, axis=0) < (0.0005, 0.002, 0.002))


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
    assert value(tuning) == pytest.approx(first.restitution, abs=0.012)


@pytest.mark.parametrize("seed", range(4))
def test_a_hand_is_no_bounce(seed: int):
    made = throw(np.random.default_rng([78, seed]), "tossed")
    assert tune_episode(made.episode, TuneOptions()).verdict != "ok"


# ---- Recordings that others made


def of_file(name: str, folder: Path, **options: Any) -> dict[str, Any]:
    """The JSON of a recording."""
    log = real(f"labs/{name}")
    tune_all([log], TuneOptions(**options), folder, 1, Progress(quiet=True))
    return json.loads((folder / name).with_suffix(".json").read_text())


# Restitutions of the basketball's six bounces, by parabolas of .16 s on each side.
BY_HAND = (0.796, 0.811, 0.799, 0.808, 0.816, 0.824)


def test_six_bounces_of_a_real_basketball_that_was_thrown_down(tmp_path: Path):
    result = of_file("motive_basketball_10.csv", tmp_path)
    assert result["verdict"] == "ok"
    assert result["units"]["length_by"] == "named"
    assert len(result["bounces"]) == len(BY_HAND)
    for bounce, by_hand in zip(result["bounces"], BY_HAND, strict=True):
        assert bounce["restitution"] == pytest.approx(by_hand, abs=0.02)
        low, high = bounce["interval95"]
        assert low <= by_hand <= high
        assert 5.0 < bounce["impact_speed"] < 5.5


def test_two_bare_columns_of_a_falling_tennis_ball(tmp_path: Path):
    result = of_file("fallingtennisball02.txt", tmp_path, columns={"t": "1", "z": "2"})
    assert result["parameters"]["restitution"]["value"] == pytest.approx(0.753, abs=0.02)
    assert result["units"] == {
        "length_m": 1.0, "length_by": "gravity", "rate_hz": 1000.0, "rate_by": "clock"
    }  # fmt: skip
