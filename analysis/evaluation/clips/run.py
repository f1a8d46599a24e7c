"""Tune synthetic clips through the whole of `tunenet-tune`, as a stranger's videos.

Nothing of a clip's rig is given. Its ball is integrated from impact to impact (`bouncing_ball`)
and drawn by rays (`clips.ball`): neither shares code with the tracker or the fit. A ball differs
from what is behind it by 30 of 255 in one colour on half of its way, by 20 on nearly all of it: or
a person could not follow it either.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from analysis.evaluation.clips.file import VERSIONS, write_clip, write_versions
from analysis.evaluation.clips.film import places_px
from analysis.evaluation.clips.order import ClipOrder, draw_clip
from analysis.processes import Piece, parallel_map
from analysis.record import Tuning
from analysis.selection import Options
from analysis.tracking.track import Track
from analysis.tuning import tune_log
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

Result = TypeVar("Result")

COUNT = 100
TRANSFORMED = 30  # clips of a full run, as filmed, and in all `VERSIONS`


@dataclass(frozen=True)
class ClipResult:
    """Result for one clip.

    Attributes:
        truth: restitution that was drawn.
        estimate: None where it was rejected.
        interval: 95 %; None where there is none.
        verdict: "ok", "suspect" or "rejected".
        reason: why it is not "ok".
        off_px: rms distance of the tracked centres from the true ones, from the release on; None
            where there is no track.
        found: fraction of the frames from the release on in which the ball was found.
        seconds: the time that reading and tuning took.
        length_s: of the clip.
    """

    seed: int
    index: int
    truth: float
    estimate: float | None
    interval: tuple[float, float] | None
    verdict: str
    reason: str | None
    off_px: float | None
    found: float
    seconds: float
    length_s: float


@dataclass(frozen=True)
class TransformedClip:
    """Results for one clip and its versions, in the order of `VERSIONS`.

    Attributes:
        truth: restitution that was drawn.
        estimates: None where a version was rejected.
    """

    seed: int
    index: int
    truth: float
    estimates: tuple[float | None, ...]

    @property
    def answered(self) -> int:
        """Number of versions that were answered."""
        return sum(estimate is not None for estimate in self.estimates)

    @property
    def spread(self) -> float | None:
        """Largest less smallest estimate; None where fewer than two were answered."""
        known = [estimate for estimate in self.estimates if estimate is not None]
        return max(known) - min(known) if len(known) > 1 else None


def clip_results(
    seed: int, count: int, jobs: int | None, progress: Progress
) -> tuple[ClipResult, ...]:
    """Render, write, read and tune `count` clips, in `jobs` processes (default: all cores)."""
    return tuple(_spread(clip_result, seed, count, jobs, progress))


def transformed_results(
    seed: int, count: int, jobs: int | None, progress: Progress
) -> tuple[TransformedClip, ...]:
    """Tune the first `count` clips of a seed, each in all `VERSIONS`."""
    return tuple(_spread(transformed_result, seed, count, jobs, progress))


def clip_result(seed: int, index: int) -> ClipResult:
    """Tune one clip."""
    order = draw_clip(seed, index)
    with tempfile.TemporaryDirectory() as folder:
        tuning = tune_log(write_clip(order, Path(folder)), Options())
    ends = tuning.interval95
    off_px, found = _tracked(order, tuning)
    return ClipResult(
        seed=seed,
        index=index,
        truth=order.ball.restitution,
        estimate=_value(tuning),
        interval=None if ends is None else (float(ends[0, 0]), float(ends[0, 1])),
        verdict=tuning.verdict,
        reason=tuning.reason,
        off_px=off_px,
        found=found,
        seconds=tuning.seconds["total"],
        length_s=order.held_s + order.length_s,
    )


def transformed_result(seed: int, index: int) -> TransformedClip:
    """Tune one clip in all versions."""
    order = draw_clip(seed, index)
    return TransformedClip(seed, index, order.ball.restitution, version_estimates(order))


def version_estimates(order: ClipOrder) -> tuple[float | None, ...]:
    """Return the estimate from each of `VERSIONS`."""
    with tempfile.TemporaryDirectory() as folder:
        paths = write_versions(order, Path(folder), VERSIONS)
        return tuple(_value(tune_log(path, Options())) for path in paths)


def track_errors_px(order: ClipOrder, track: Track) -> Array:
    """Return the errors of tracked centres, shape (T, 2) [px], NaN before the release."""
    seconds = (track.stamps_ns - track.stamps_ns[0]) * 1e-9
    rows = np.round(seconds * order.rate_hz).astype(int)
    off = track.places_px - places_px(order)[rows]
    off[seconds < order.held_s] = np.nan
    return off


def _tracked(order: ClipOrder, tuning: Tuning) -> tuple[float | None, float]:
    if tuning.detection is None:
        return None, 0.0
    off = track_errors_px(order, tuning.detection.film.track)
    seen = np.isfinite(off[:, 0])
    after = int(order.length_s * order.rate_hz)
    return float(np.sqrt(np.nanmean((off**2).sum(axis=1)))), float(min(seen.sum() / after, 1.0))


def _value(tuning: Tuning) -> float | None:
    return None if tuning.estimate is None else float(tuning.estimate[0])


def _spread(
    work: Callable[[int, int], Result],
    seed: int,
    count: int,
    jobs: int | None,
    progress: Progress,
) -> list[Result]:
    """Run `work` on every clip, in their order."""
    pieces = [Piece((seed, index), 1, f"clip {index}") for index in range(count)]
    return parallel_map(partial(_alone, work), pieces, jobs, progress, ("filming", "clip"))


def _alone(work: Callable[[int, int], Result], which: tuple[int, int]) -> Result:
    """Run `work` in one thread: there is a process for each core."""
    import cv2

    cv2.setNumThreads(1)
    return work(*which)
