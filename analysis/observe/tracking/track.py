"""The ball's way through the pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.observe.tracking.arcs import Arc, Candidates, longest_arc, tabulate
from analysis.observe.tracking.background import (
    still_background,
    without_ball,
)
from analysis.observe.tracking.blobs import Blobs, hsv_blobs, moving_blobs
from analysis.observe.tracking.following import (
    LEAST_SEEN,
    flying,
    follow,
    hiding_places,
    look_of,
    same_arc,
    still_places,
)
from analysis.observe.tracking.learning import learn_appearance
from analysis.observe.tracking.looking import Eye
from analysis.observe.tracking.pictures import Pictures
from tunenet_logs.errors import NotFoundError

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

_HIDDEN = 2.5
_MISSED = 1.2
_NEAR_PX = 50
"""From a mark to the edge of what it marks, in the reduced picture: it need not be exact."""


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
        stamps_ns: of all pictures, shape (T,).
        places_px: x right, y down; the first pixel's centre is 0, 0; shape (T, 2); NaN where the
            ball is not found.
        radius_px: shape (T,); NaN likewise.
        confidence: 0 to 1, shape (T,).
        size_px: (width, height) of the pictures.
        gravity_px: acceleration in flight [px/s²], shape (2,).
        colour: RGB of the ball.
    """

    stamps_ns: NDArray[np.int64]
    places_px: Array
    radius_px: Array
    confidence: Array
    size_px: tuple[int, int]
    gravity_px: Array
    colour: tuple[int, int, int]

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
    background = still_background(pictures.samples)

    def candidates(find: Callable[[Picture], Blobs]) -> Candidates:
        return tabulate(seconds, [find(picture) for picture in pictures])

    if hints.hsv is not None:
        low, high = (np.array(one) for one in hints.hsv)
        table = candidates(lambda one: hsv_blobs(one, low, high, allowed))
        arc = _arc_of(table)
        chosen, cost = follow(table, arc, look_of(table, arc))
        return _track(pictures, table, chosen, cost, arc)
    table = candidates(lambda one: moving_blobs(one, background, allowed))
    if hints.ball_at is not None:
        table = _only_like(table, pictures, hints.ball_at)
    arc = _arc_of(table)
    look = look_of(table, arc)
    chosen, _ = follow(table, arc, look)
    places = _filled(_chosen(table.places_px, chosen))
    areas = _chosen(table.areas_px, chosen)
    shown, end = flying(arc, chosen, places, look)
    still = still_places(seconds, arc, places, end)
    crops = pictures.some(shown)
    numbers, all_of = [*pictures.sampled, *shown], [*pictures.samples, *crops]
    maybe = [hiding_places(number, arc, places, still, look) for number in numbers]
    clear = without_ball(all_of, maybe, _HIDDEN * look.radius_px + 2)
    ball = learn_appearance(crops, clear, places[shown], areas[shown])
    if ball is not None and ball.radius_px > _MISSED * look.radius_px:
        clear = without_ball(all_of, maybe, _HIDDEN * ball.radius_px + 2)
        ball = learn_appearance(crops, clear, places[shown], areas[shown])
    del crops, all_of
    eye = Eye(clear, look, ball, allowed)
    looked = [eye.find(*one) for one in zip(pictures, places, still, strict=True)]
    table = tabulate(seconds, looked)
    arc = same_arc(table, arc, places)
    look = look_of(table, arc)
    chosen, cost = follow(table, arc, look)
    return _track(pictures, table, chosen, cost, arc)


def _arc_of(table: Candidates) -> Arc:
    arc = longest_arc(table) if table.areas_px.size else None
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
    pictures: Pictures, table: Candidates, chosen: NDArray[np.intp], cost: Array, arc: Arc
) -> Track:
    places = _chosen(table.places_px, chosen)
    areas = _chosen(table.areas_px, chosen)
    cut = ~_chosen(table.whole.astype(float), chosen).astype(bool)  # at the edge: half a ball
    places[cut], areas[cut] = np.nan, np.nan
    if np.isfinite(areas).sum() < LEAST_SEEN:
        raise NotFoundError("the ball is lost after a few pictures (mark it with --roi or --hsv)")
    red, green, blue = np.nanmedian(_chosen(table.colours, chosen), axis=0).round().astype(int)
    scale = pictures.scale
    return Track(
        stamps_ns=pictures.stamps_ns,
        places_px=places * scale + (scale - 1) / 2,
        radius_px=np.sqrt(areas / np.pi) * scale,
        confidence=np.where(np.isfinite(areas), np.exp(-cost / 8), 0.0),
        size_px=pictures.size_px,
        gravity_px=arc.gravity_px * scale,
        colour=(int(red), int(green), int(blue)),
    )


def _chosen(values: Array, chosen: NDArray[np.intp]) -> Array:
    picked = values[np.arange(len(chosen)), np.maximum(chosen, 0)].astype(np.float64)
    picked[chosen < 0] = np.nan
    return picked


def _filled(places: Array) -> Array:
    """Gaps filled, and the ends held."""
    known = np.flatnonzero(np.isfinite(places[:, 0]))
    numbers = np.arange(len(places))
    return np.column_stack([np.interp(numbers, known, places[known, axis]) for axis in (0, 1)])
