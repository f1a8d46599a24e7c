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


def off_s(found: Onsets) -> float:
    """How far the true knocks are from those that were found, at most."""
    return float(np.abs(found.times_s[:, None] - TRUE_S).min(axis=0).max())


@pytest.mark.parametrize("size", [1e-5, 1e-3, 5e-3])
def test_knocks_are_found_to_a_fraction_of_a_millisecond(size: float):
    clean = knocks(TRUE_S)
    heard = clear(onsets(sound_of(clean + noise(len(clean), size))))
    assert off_s(heard) < 0.0005
    assert len(heard) == len(TRUE_S)
    assert np.all(heard.sds_s > 0)


def test_soft_clipped_and_inverted_knocks_are_knocks_and_an_echo_is_none():
    hiss = noise(int(3.2 * RATE_HZ), 1e-4)
    heard = clear(onsets(sound_of(knocks(TRUE_S, np.geomspace(0.5, 0.01, len(TRUE_S))) + hiss)))
    assert off_s(heard) < 0.0005
    assert np.all(np.diff(heard.loudness_db) < 0)
    loud = knocks(TRUE_S, 2.0) + hiss
    for samples in (np.clip(loud, -0.2, 0.2), -loud):
        assert off_s(onsets(sound_of(samples))) < 0.0005
    echoed = knocks(TRUE_S) + knocks(TRUE_S + 0.023, 0.1)
    assert len(clear(onsets(sound_of(echoed + hiss)))) == len(TRUE_S)


def test_a_files_rate_is_its_clock_and_changes_nothing_else():
    """Slowed sound; and of a studio's rate every second sample is kept."""
    clean = knocks(TRUE_S) + noise(int(3.2 * RATE_HZ), 1e-4)
    usual, slow = onsets(sound_of(clean)), onsets(sound_of(clean, 4 * RATE_HZ, RATE_HZ))
    assert np.allclose(slow.times_s * 4, usual.times_s)
    fast = onsets(sound_of(clean, RATE_HZ, 2 * RATE_HZ))
    assert np.array_equal(usual.times_s, fast.times_s)
    assert np.array_equal(usual.sds_s, fast.sds_s)


SILENT = {
    "silence": np.zeros(44_100),
    "nothing": np.zeros(0),
    "three samples": np.zeros(3),
    "a tone": np.sin(2 * np.pi * 440 * np.arange(88_200) / RATE_HZ),
    "no numbers": np.full(44_100, np.nan),
}


@pytest.mark.parametrize("name", SILENT)
def test_what_does_not_knock(name: str):
    assert len(onsets(sound_of(SILENT[name]))) == 0


@pytest.mark.parametrize("size", [1e-4, 1e-3])
def test_what_a_codec_puts_before_a_knock_is_not_its_beginning(size: float):
    """AAC at 64 kbit/s spreads a knock over the milliseconds before it."""
    clean = knocks(TRUE_S) + noise(int(3.2 * RATE_HZ), size)
    packed = through_aac(clean.astype(np.float32), int(RATE_HZ)).astype(np.float64)
    heard = clear(onsets(sound_of(packed)))
    late_s = heard.times_s[np.abs(heard.times_s[:, None] - TRUE_S).argmin(axis=0)] - TRUE_S
    assert np.abs(late_s - np.median(late_s)).max() < 0.0003
