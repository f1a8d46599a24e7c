"""Drops are found in heights whatever came before, and only where there are any."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.strangers import bounce_heights
from tunenet_logs.analysis.drop.checks import recording_checks
from tunenet_logs.analysis.drop.free_flight import find_drops
from tunenet_logs.errors import NotFoundError

GRAVITY = 9.81


def recording(
    restitution: float, gap: float, rate: float, hold: float = 0.5, seconds: float = 5.0
) -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(int((hold + seconds) * rate)) / rate
    return times, bounce_heights(restitution, gap, times - hold)


@pytest.mark.parametrize("rate", [60.0, 120.0, 240.0, 1000.0])
@pytest.mark.parametrize("gap", [0.3, 1.0, 5.0])
@pytest.mark.parametrize("restitution", [0.1, 0.4, 0.7, 0.95])
def test_impact_and_height_are_found_to_a_fraction_of_a_sample(
    restitution: float, gap: float, rate: float
):
    times, heights = recording(restitution, gap, rate)
    (drop,) = find_drops(times, heights + 0.37)
    fall = np.sqrt(2 * gap / GRAVITY)
    assert drop.impact_s == pytest.approx(0.5 + fall, abs=1e-4)
    assert drop.contact_m == pytest.approx(0.37, abs=2e-4)
    assert drop.drop_height_m == pytest.approx(gap, rel=1e-3)
    assert drop.gravity_m_s2 == pytest.approx(GRAVITY, rel=1e-6)
    assert drop.release_s == pytest.approx(0.5, abs=2e-3)


@pytest.mark.parametrize("noise", [0.001, 0.005])
def test_noise_costs_little(noise: float):
    rng = np.random.default_rng(0)
    off = []
    for _ in range(100):
        gap, rate = rng.uniform(0.5, 4), rng.uniform(60, 240)
        times, heights = recording(rng.uniform(0.2, 0.9), gap, rate)
        (drop,) = find_drops(times, heights + rng.normal(0, noise, len(times)))
        off.append(abs(drop.drop_height_m / gap - 1))
    assert np.median(off) < 0.5 * noise


def test_a_ball_carried_to_its_place_and_held_is_found():
    rate = 200.0
    carry = 1.6 - 0.6 * (1 - np.cos(np.pi * np.arange(200) / 200)) / 2
    times, heights = recording(0.7, 1.0, rate)
    heights = np.concatenate([carry, heights])
    times = np.arange(len(heights)) / rate
    (drop,) = find_drops(times, heights)
    assert drop.drop_height_m == pytest.approx(1.0, rel=1e-3)


def test_a_ball_already_falling_at_first_is_found():
    times, heights = recording(0.7, 1.0, 240, hold=0)
    (drop,) = find_drops(times[40:], heights[40:])
    assert drop.drop_height_m == pytest.approx(1.0, rel=1e-3)
    assert drop.release_s == pytest.approx(0.0, abs=2e-3)


def test_several_drops_are_told_apart():
    rate = 120.0
    _, first = recording(0.6, 1.0, rate, seconds=4)
    _, second = recording(0.6, 0.5, rate, seconds=4)
    lift = 0.5 * np.linspace(0, 1, 120)
    heights = np.concatenate([first, lift, second])
    drops = find_drops(np.arange(len(heights)) / rate, heights)
    assert [round(drop.drop_height_m, 2) for drop in drops] == [1.0, 0.5]
    assert drops[0].seconds[-1] < len(first) / rate


@pytest.mark.parametrize(
    ("heights", "says"),
    [
        (np.full(300, 0.5), "does not fall"),
        (np.linspace(1, 0, 300), "no "),
        (0.5 + 0.4 * np.sin(np.arange(600) / 60), "no "),
        (bounce_heights(0.0, 1.0, np.arange(300) / 60 - 0.5), "does not bounce"),
        (bounce_heights(0.7, 1.0, np.arange(56) / 60 - 0.5), "ends before|no "),
        (np.zeros(3), "too few"),
        (np.random.default_rng(0).normal(0, 0.01, 400), "does not fall"),
    ],
    ids=["still", "lowered", "waved", "dead", "cut", "few", "noise"],
)
def test_what_is_no_drop_is_refused_with_the_reason(heights: np.ndarray, says: str):
    with pytest.raises(NotFoundError, match=says):
        find_drops(np.arange(len(heights)) / 60, heights)


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


def test_a_fit_that_ends_before_its_impact_is_checked_all_the_same():
    times, heights = recording(0.7, 1.0, 120.0)
    (drop,) = find_drops(times, heights)
    late = replace(drop, impact_s=float(drop.seconds[-1]) + 0.1)
    checks = recording_checks(late, np.zeros((len(drop.seconds), 2)))
    assert not all(check.passed for check in checks)
