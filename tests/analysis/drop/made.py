"""Made logs and tracks of drops, in closed form or by an integrator that no fit shares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tests.strangers import bounce_heights
from tunenet_logs.analysis.tracking.track import Track
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal

TOPIC, RATE_HZ, GRAVITY = "/ball/pose", 120.0, 9.81
DAY_NS = 86_400 * 10**9


def seen(
    positions: Array, stamps_ns: NDArray[np.int64] | None = None, rate_hz: float = RATE_HZ
) -> Episode:
    """A log of heights, shape (T,), or of positions, shape (T, 3), in metres."""
    if positions.ndim == 1:
        positions = np.column_stack([0 * positions, 0 * positions, positions])
    if stamps_ns is None:
        stamps_ns = np.round(np.arange(len(positions)) / rate_hz * 1e9).astype(np.int64) + 10**18
    signal = Signal(TOPIC, stamps_ns, positions, ("x", "y", "z"), "m")
    return Episode(EpisodeInfo(), {TOPIC: signal})


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


def smoothed(heights: np.ndarray, averaged: int) -> np.ndarray:
    """Heights after a moving average over so many samples."""
    padded = np.pad(heights, averaged // 2, "edge")
    return np.convolve(padded, np.ones(averaged) / averaged, "valid")


def pixels(heights: np.ndarray, span_px: float, perspective: float) -> np.ndarray:
    """Image rows, down, of heights [drop heights]."""
    grow = np.exp(perspective)
    return 200 - span_px * grow * heights / (1 + (grow - 1) * heights)


def track_of(
    rows: np.ndarray, rate_hz: float, noise_px: float = 0.1, sideways: np.ndarray | None = None
) -> Track:
    rng = np.random.default_rng(7)
    columns = np.full(len(rows), 150.0) if sideways is None else sideways
    places = np.column_stack([columns, rows]) + rng.normal(0, noise_px, (len(rows), 2))
    return Track(
        stamps_ns=np.round(np.arange(len(rows)) * 1e9 / rate_hz).astype(np.int64),
        places_px=places,
        radius_px=np.full(len(rows), 5.0),
        confidence=np.ones(len(rows)),
        size_px=(320, 240),
        gravity_px=np.array([0.0, 1000.0]),
        colour=(200, 80, 30),
    )


def filmed(
    restitution: float,
    gap_m: float = 1.0,
    rate_hz: float = 60.0,
    perspective: float = 0.0,
    seconds: float = 2.5,
    start_s: float = -0.3,
) -> Track:
    """A drop in closed form; `start_s` after the release."""
    times = start_s + np.arange(round(seconds * rate_hz)) / rate_hz
    heights = bounce_heights(restitution, gap_m, times, GRAVITY) / gap_m
    return track_of(pixels(heights, 120.0, perspective), rate_hz)


def with_stamps(episode: Episode, change) -> Episode:
    """The film with each stamp as `change` (of its number and itself) has it."""

    def opened(topic: str):
        for number, frame in enumerate(episode.frames(topic)):
            yield replace(frame, stamp_ns=change(number, frame.stamp_ns))

    return replace(episode, open_frames=opened)
