"""Knocks in a sound: when they begin, and what is none."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.worlds.audio import through_aac
from tunenet_logs.analysis.onsets import Onsets, onsets
from tunenet_logs.episode import Array, Sound

RATE_HZ = 44_100.0
TRUE_S = np.array([0.81, 1.304, 1.622, 2.2071, 2.71])


def sound_of(samples: Array, rate_hz: float = RATE_HZ, file_rate_hz: float | None = None) -> Sound:
    return Sound(
        name="/audio",
        start_ns=0,
        rate_hz=rate_hz,
        samples=samples.astype(np.float32),
        file_rate_hz=file_rate_hz or rate_hz,
    )


def knocks(times_s: Array, loudness: Array | float = 0.3, lasts_s: float = 3.2) -> Array:
    """Damped tones of four modes, each from its moment on."""
    at_s = np.arange(int(lasts_s * RATE_HZ)) / RATE_HZ
    samples = np.zeros_like(at_s)
    for begin_s, loud in zip(times_s, np.broadcast_to(loudness, times_s.shape), strict=True):
        since_s = at_s - begin_s
        for tone_hz, decay_s in ((410.0, 0.02), (1150.0, 0.012), (3300.0, 0.006), (7900.0, 0.003)):
            with np.errstate(over="ignore"):
                ringing = np.exp(-since_s / decay_s) * np.sin(2 * np.pi * tone_hz * since_s)
            samples += np.where(since_s >= 0, 0.25 * loud * ringing, 0.0)
    return samples


def clear(found: Onsets) -> Onsets:
    """Those that no noise makes."""
    return found.only(found.rises_db > 3.0)


def noise(count: int, size: float) -> Array:
    return size * np.random.default_rng(5).standard_normal(count)


@pytest.mark.parametrize("size", [1e-5, 1e-3, 5e-3])
def test_knocks_are_found_to_a_fraction_of_a_millisecond(size: float):
    clean = knocks(TRUE_S)
    heard = clear(onsets(sound_of(clean + noise(len(clean), size))))
    near = np.abs(heard.times_s[:, None] - TRUE_S).min(axis=0)
    assert near.max() < 0.0005
    assert len(heard) == len(TRUE_S)
    assert np.all(heard.sds_s > 0)


def test_soft_knocks_after_loud_ones_are_knocks_and_an_echo_is_none():
    soft = knocks(TRUE_S, np.geomspace(0.5, 0.01, len(TRUE_S)))
    heard = clear(onsets(sound_of(soft + noise(len(soft), 1e-4))))
    assert np.abs(heard.times_s[:, None] - TRUE_S).min(axis=0).max() < 0.0005
    assert np.all(np.diff(heard.loudness_db) < 0)
    echoed = knocks(TRUE_S) + knocks(TRUE_S + 0.023, 0.1)
    heard = clear(onsets(sound_of(echoed + noise(len(echoed), 1e-4))))
    assert len(heard) == len(TRUE_S)


def test_a_files_rate_is_its_clock_and_changes_nothing_else():
    """Slowed sound; and of a studio's rate every second sample is kept."""
    clean = knocks(TRUE_S) + noise(int(3.2 * RATE_HZ), 1e-4)
    usual, slow = onsets(sound_of(clean)), onsets(sound_of(clean, 4 * RATE_HZ, RATE_HZ))
    assert np.allclose(slow.times_s * 4, usual.times_s)
    fast = onsets(sound_of(clean, RATE_HZ, 2 * RATE_HZ))
    assert np.array_equal(usual.times_s, fast.times_s)
    assert np.array_equal(usual.sds_s, fast.sds_s)


@pytest.mark.parametrize(
    "samples",
    [
        np.zeros(44_100),
        np.zeros(0),
        np.zeros(3),
        np.sin(2 * np.pi * 440 * np.arange(88_200) / RATE_HZ),
        np.full(44_100, np.nan),
    ],
    ids=["silence", "nothing", "three samples", "a tone", "no numbers"],
)
def test_what_does_not_knock(samples: Array):
    assert len(onsets(sound_of(samples))) == 0


def test_clipped_and_inverted_knocks_begin_when_they_do():
    clean = knocks(TRUE_S, 2.0) + noise(int(3.2 * RATE_HZ), 1e-4)
    for samples in (np.clip(clean, -0.2, 0.2), -clean):
        heard = onsets(sound_of(samples))
        assert np.abs(heard.times_s[:, None] - TRUE_S).min(axis=0).max() < 0.0005


@pytest.mark.parametrize("size", [1e-4, 1e-3])
def test_what_a_codec_puts_before_a_knock_is_not_its_beginning(size: float):
    """AAC at 64 kbit/s spreads a knock over the milliseconds before it."""
    clean = knocks(TRUE_S) + noise(int(3.2 * RATE_HZ), size)
    packed = through_aac(clean.astype(np.float32), int(RATE_HZ)).astype(np.float64)
    heard = clear(onsets(sound_of(packed)))
    late_s = heard.times_s[np.abs(heard.times_s[:, None] - TRUE_S).argmin(axis=0)] - TRUE_S
    assert np.abs(late_s - np.median(late_s)).max() < 0.0003
