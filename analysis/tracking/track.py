"""The ball's way through the pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.arcs import LEAST_FRAMES, Arc, longest_arc
from analysis.tracking.background import (
    Background,
    halved_background,
    still_background,
)
from analysis.tracking.blobs import Blobs, hsv_blobs, moving_blobs
from analysis.tracking.candidates import Candidates, tabulate
from analysis.tracking.following import LEAST_SEEN, follow, look_of, same_arc
from analysis.tracking.pictures import Pictures
from analysis.tracking.second_look import look_again, picked
from tunenet_logs.arrays import Array, Picture
from tunenet_logs.errors import NotFoundError

_FEW_FRAMES = 5
"""Of a flight that is looked for once more, where pictures are few."""

_NEAR_PX = 50
"""From a mark to the edge of what it marks, in the reduced picture: it need not be exact."""

_EXPOSURE_S = 0.008
"""Longer ones blur a ball so much that people add light."""


@dataclass(frozen=True)
class Hints:
    """What a user may say about the ball; nothing is needed.

    Attributes:
        roi: left, top, width, height [px] of the part of the picture to look in.
        hsv: lowest and highest hue (0 to 179), saturation and value (0 to 255) of the ball.
        ball_at: x, y [px] of the ball, and when [s since the first picture, selected or not].
    """

    roi: tuple[int, int, int, int] | None = None
    hsv: tuple[tuple[int, int, int], tuple[int, int, int]] | None = None
    ball_at: tuple[float, float, float] | None = None

    @property
    def options(self) -> tuple[str, ...]:
        """What those that are given are called on the command line."""
        named = {"--roi": self.roi, "--hsv": self.hsv, "--ball-at": self.ball_at}
        return tuple(name for name, value in named.items() if value is not None)


@dataclass(frozen=True, eq=False)
class Track:
    """Where the ball is in each picture.

    Attributes:
        stamps_ns: of all pictures but those that repeat the one before, shape (T,).
        places_px: x right, y down; the first pixel's centre is 0, 0; shape (T, 2); NaN where the
            ball is not found.
        radius_px: shape (T,); NaN likewise.
        confidence: 0 to 1, shape (T,).
        size_px: (width, height) of the pictures.
        gravity_px: acceleration in flight [px/s²], shape (2,).
        colour: RGB of the ball.
        exposure_s: for which a shutter may have been open around each stamp, at most; 0 for places
            that no camera saw.
    """

    stamps_ns: NDArray[np.int64]
    places_px: Array
    radius_px: Array
    confidence: Array
    size_px: tuple[int, int]
    gravity_px: Array
    colour: tuple[int, int, int]
    exposure_s: float = 0.0

    @property
    def found(self) -> NDArray[np.bool_]:
        """Whether the ball is found in each picture, shape (T,)."""
        return np.isfinite(self.places_px[:, 0])


def track_ball(pictures: Pictures, hints: Hints | None = None) -> Track:
    """Find the ball by its free flight, learn how it looks, and follow it through all pictures.

    Raises:
        NotFoundError: nothing in the pictures flies as a ball does.
        UsageError: a hint that does not fit the pictures.
    """
    hints = hints or Hints()
    stamps_ns = pictures.stamps_ns
    if len(stamps_ns) < LEAST_SEEN:
        raise NotFoundError(f"{len(stamps_ns)} pictures are too few for a drop")
    seconds = (stamps_ns - stamps_ns[0]).astype(np.float64) * 1e-9
    allowed = pictures.allowed(hints.roi)

    def candidates(find: Callable[[Picture], Blobs]) -> Candidates:
        return tabulate(seconds, [find(picture) for picture in pictures])

    if hints.hsv is not None:
        low, high = (np.array(one) for one in hints.hsv)
        table = candidates(lambda one: hsv_blobs(one, low, high, allowed))
        arc = _arc_of(table)
        chosen, cost = follow(table, arc, look_of(table, arc))
        return _track(pictures, table, chosen, cost, arc)

    def moving(background: Background) -> Candidates:
        table = candidates(lambda one: moving_blobs(one, background, allowed))
        if hints.ball_at is not None:
            return _only_like(table, pictures, hints.ball_at)
        return table

    table = moving(still_background(pictures.samples))
    arc = longest_arc(table) if table.areas_px.size else None
    if arc is None:
        table = moving(halved_background(pictures.samples))
        arc = _arc_of(table.inside(), _FEW_FRAMES)
    second = look_again(pictures, table, arc, allowed)
    fresh = second.fresh()
    table = second.table.some(fresh)
    kept = np.isin(arc.frames, fresh)
    arc = replace(arc, frames=np.searchsorted(fresh, arc.frames[kept]), chosen=arc.chosen[kept])
    arc = same_arc(table, arc, second.before_px[fresh])
    chosen, cost = follow(table, arc, look_of(table, arc))
    return _track(pictures, table, chosen, cost, arc, fresh)


def _arc_of(table: Candidates, least_frames: int = LEAST_FRAMES) -> Arc:
    arc = longest_arc(table, least_frames) if table.areas_px.size else None
    if arc is None:
        raise NotFoundError(
            "no ball is seen to fly: nothing in the pictures moves along a parabola "
            "(mark it with --roi, --hsv or --ball-at if it is hard to see)"
        )
    return arc


def _only_like(
    table: Candidates, pictures: Pictures, ball_at: tuple[float, float, float]
) -> Candidates:
    """Without the candidates that look unlike the one nearest to where the user saw the ball."""
    x, y, at_s = pictures.scaled(ball_at)
    there = "{:.0f}, {:.0f} px at {:.2f} s".format(*ball_at)
    frame = int(np.abs(table.seconds - at_s).argmin())
    apart = np.linalg.norm(table.places_px[frame] - np.array([x, y]), axis=1)
    if not np.isfinite(apart).any():
        raise NotFoundError(f"nothing moves at {there}; mark the ball in flight")
    nearest = int(np.nanargmin(apart))
    colour, area = table.colours[frame, nearest], table.areas_px[frame, nearest]
    if apart[nearest] > _NEAR_PX + np.sqrt(area / np.pi):
        right, down = table.places_px[frame, nearest] * pictures.scale
        raise NotFoundError(
            f"nothing moves near {there}, the nearest at {right:.0f}, {down:.0f} px; "
            "mark the ball in flight"
        )
    unlike = np.linalg.norm(table.colours - colour, axis=2) > 90
    unlike |= np.abs(np.log(table.areas_px / area)) > np.log(4)
    areas = np.where(unlike, np.nan, table.areas_px)
    places = np.where(unlike[:, :, None], np.nan, table.places_px)
    return replace(table, areas_px=areas, places_px=places)


def _track(
    pictures: Pictures,
    table: Candidates,
    chosen: NDArray[np.intp],
    cost: Array,
    arc: Arc,
    fresh: NDArray[np.intp] | slice = slice(None),
) -> Track:
    places = picked(table.places_px, chosen)
    areas = picked(table.areas_px, chosen)
    cut = ~picked(table.whole.astype(float), chosen).astype(bool)  # at the edge: half a ball
    places[cut], areas[cut] = np.nan, np.nan
    if np.isfinite(areas).sum() < LEAST_SEEN:
        raise NotFoundError("the ball is lost after a few pictures (mark it with --roi or --hsv)")
    red, green, blue = np.nanmedian(picked(table.colours, chosen), axis=0).round().astype(int)
    scale = pictures.scale
    return Track(
        stamps_ns=pictures.stamps_ns[fresh],
        places_px=places * scale + (scale - 1) / 2,
        radius_px=np.sqrt(areas / np.pi) * scale,
        confidence=np.where(np.isfinite(areas), np.exp(-cost / 8), 0.0),
        size_px=pictures.size_px,
        gravity_px=arc.gravity_px * scale,
        colour=(int(red), int(green), int(blue)),
        exposure_s=_EXPOSURE_S,
    )
