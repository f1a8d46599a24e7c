"""Made logs and tracks of drops, in closed form or by an integrator that no fit shares."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.strangers import bounce_heights
from tunenet_logs.analysis.drop.film import FilmedDrop, find_filmed_drop
from tunenet_logs.analysis.evaluation.worlds.ball import RealBall, drop_ball
from tunenet_logs.analysis.evaluation.worlds.camera import B, BallRanges, draw_scene, film
from tunenet_logs.analysis.tracking.track import Track
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.recorders.simulators.ball import Bounce

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
    """Times and heights at 120 Hz of a ball that falls 1 m."""
    seconds = np.arange(-0.4, 2.6, 1 / 120)
    noise = np.random.default_rng(seed).normal(0.0, noise_m, len(seconds))
    fall = drop_ball(RealBall(restitution, slope, drag_1_m, 1.0), seconds)
    return seconds, fall.heights_m + noise


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


def with_a_lost_picture(share: float) -> tuple[FilmedDrop, float]:
    """A drop with restitution .7, one period lost from a share of the pictures on, and when."""
    track = film(draw_scene(B, BallRanges((0.7, 0.7)), 0.3, -77, 2))
    stamps_ns = track.stamps_ns.copy()
    lost = int(share * len(stamps_ns))
    stamps_ns[lost:] -= stamps_ns[lost] - stamps_ns[lost - 1] - 1_000_000
    return find_filmed_drop(replace(track, stamps_ns=stamps_ns), 0), stamps_ns[lost] * 1e-9


HEIGHT_M, RESTITUTION, SLOPE, DRAG_1_M = 1.2, 0.78, 0.04, 0.02  # of the ball that is heard


def episode_of(
    times_s: NDArray[Any], name: str = "All/impacts", *, frames: bool = False
) -> Episode:
    stamps_ns = np.round(np.asarray(times_s) * 1e9).astype(np.int64)
    values = np.ones((len(stamps_ns), 1))
    signal = Signal(name, stamps_ns, values, ("impact",), "1", counts_frames=frames)
    return Episode(EpisodeInfo(), {name: signal})


def impacts(count: int, seed: int = 0, jitter_s: float = 0.0005) -> Array:
    """Times of the first impacts of the ball, from the closed form."""
    ball = Bounce(RESTITUTION, SLOPE, DRAG_1_M * HEIGHT_M)
    starts, _ = ball.flights(10.0)
    rng = np.random.default_rng(seed)
    fall_s = np.sqrt(2 * HEIGHT_M / 9.80665)
    return 0.8 + starts[:count] * fall_s + rng.normal(0.0, jitter_s, count)
