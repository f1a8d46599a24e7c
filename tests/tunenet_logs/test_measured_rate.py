"""Rates are messages over time, whatever delays, pauses and losses do to single steps."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from tunenet_logs.timing.stamps import MAX_SPEED_CAMERA_HZ, measured_hz

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
    "seconds",
    [
        EVEN_S,
        EVEN_S[:2],
        EVEN_S + RNG.uniform(0, 0.04, 600),
        EVEN_S + RNG.exponential(0.01, 600),
        bursts(0.1),
        bursts(0.25),
        bursts(1.0),
        stopped(slice(None)),
        stopped(slice(0)),
        stopped(slice(60)),
        np.r_[EVEN_S, 7200.0],
        np.r_[-7200.0, EVEN_S],
        np.r_[EVEN_S[:200], EVEN_S[200:400] + 5, EVEN_S[400:] + 12],
        np.r_[np.full(120, 2.0) + np.arange(120) * 1e-4, EVEN_S[120:]],
        EVEN_S[np.argsort(np.arange(600) + RNG.uniform(0, 3, 600))],
    ],
    ids=[
        "even", "two", "jitter", "exponential", "bursts", "longer bursts", "long bursts",
        "stopped", "stopped and lost", "stopped and half lost", "one far", "one far before",
        "pauses", "read ahead", "out of order",
    ],
)  # fmt: skip
def test_sixty_a_second(seconds: np.ndarray):
    assert hz(seconds) == pytest.approx(HZ, rel=0.002)


def test_what_is_missing_is_not_counted():
    assert hz(EVEN_S[RNG.random(600) > 0.1]) == pytest.approx(0.9 * HZ, rel=0.03)


def test_a_rate_that_changes_is_that_of_the_whole():
    seconds = np.r_[EVEN_S[:300], EVEN_S[299] + np.arange(1, 151) / 30]
    assert hz(seconds) == pytest.approx(45, rel=0.002)


def test_slow_ones_have_pauses_too():
    assert hz(np.arange(20) * 10.0) == pytest.approx(0.1)
    assert hz(np.r_[np.arange(30), np.arange(90, 120)]) == pytest.approx(1.0, rel=0.03)


def test_what_came_in_one_piece_tells_none():
    assert hz(np.arange(300) * 1e-9) == 0
    assert hz([]) == hz([3.0]) == 0
    assert measured_hz([0, 100_000, 200_000], MAX_SPEED_CAMERA_HZ) == 0
