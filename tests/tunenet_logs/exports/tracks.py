"""The track that the tests of exports write, and how they read it back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.export_writers import SUFFIXES, WRITERS
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions
from tunenet_logs.formats.registry import open_log

RATE_HZ = 120.0
SECONDS = np.arange(240) / RATE_HZ
HIDDEN = slice(60, 80)


def falling(x_m: float = 0.3) -> NDArray[np.float64]:
    """A ball that falls from 2 m, z up, and is not seen for a while."""
    height = 2 - 0.5 * 9.81 * np.minimum(SECONDS, 0.6) ** 2
    xyz = np.column_stack([np.full_like(SECONDS, x_m), 0.1 + 0.05 * SECONDS, height])
    xyz[HIDDEN] = np.nan
    return xyz


BALL = falling()
OTHER = falling(1.5)[::-1].copy()
TRACKS = {"Ball 1": BALL, "Other": OTHER}


def written(folder: Path, layout: str, **options: object) -> Path:
    """An export of both tracks."""
    path = folder / f"take{SUFFIXES[layout]}"
    WRITERS[layout](path, SECONDS, TRACKS, rate_hz=RATE_HZ, **options)
    return path


def read(path: Path, options: ReadOptions = AS_IT_SAYS) -> Episode:
    """As `open_log` does."""
    episode = open_log(path, options)
    assert isinstance(episode, Episode)
    return episode


def outcome(path: Path) -> Episode | str:
    """The episode, or what is said instead."""
    try:
        return read(path)
    except LogError as error:
        return str(error)


def skipped(episode: Episode) -> dict[str, str]:
    """Why what is not used is not."""
    return {one.topic: one.skipped for one in episode.channels if one.skipped is not None}
