"""Films that several test files look at, each rendered once."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.conftest import Made, film
from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder
from tunenet_logs.recorders.simulators.camera import PinholeCamera

ORDER = DropOrder(restitution=0.65, height_m=1.0, seconds=1.2, hold_s=0.2, rate_hz=60, seed=11)
CAMERA = PinholeCamera((1.2, -1.4, 1.1), (0.0, 0.0, 0.45))


def short_film(made: Made, rate_hz: int = 60) -> Path:
    """Restitution 0.7 from 1 m, 1.8 s: the ball in the hand, and two bounces."""
    order = {"restitution": 0.7, "height_m": 1.0, "seconds": 1.5, "hold_s": 0.3, "seed": 5}
    return made(f"filmed_short_{rate_hz}.mcap", lambda path: film(path, rate_hz=rate_hz, **order))


def rendered_ball(made: Made) -> Episode:
    """The drop of `ORDER` before `CAMERA`, 84 pictures."""
    order = {**vars(ORDER)}
    path = made(
        "filmed_for_tracking.mcap", lambda one: film(one, FilmOrder(camera=CAMERA), **order)
    )
    return kept(read_episode(path))


def kept(episode: Episode) -> Episode:
    """The same, its frames in memory: tracking looks at them several times."""
    frames = list(episode.frames())
    return replace(episode, open_frames=lambda _topic: iter(frames))


def film_of(frames: Iterable[Frame], info: EpisodeInfo | None = None) -> Episode:
    """Pictures alone, in memory."""
    shown = list(frames)
    stamps_ns = np.array([frame.stamp_ns for frame in shown])
    channel = Channel("video", "", "", stamps_ns, pictures=True)
    said = info or EpisodeInfo(kind="drop")
    return Episode(said, {}, (channel,), open_frames=lambda _topic: iter(shown))
