"""Ball tracking through the pictures: found by how it flies, then by how it looks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.selection import Hints
from analysis.tracking.appearance import learn_appearance
from analysis.tracking.arcs import MIN_FRAMES, Arc, longest_arc, same_arc
from analysis.tracking.background import Background, halved_background, still_background
from analysis.tracking.ball_detector import BallDetector
from analysis.tracking.camera_motion import check_still
from analysis.tracking.candidates import Blobs, Candidates, hsv_blobs, moving_blobs, picked
from analysis.tracking.following import (
    MIN_SEEN,
    color_and_size,
    flight_and_rest,
    follow,
)
from analysis.tracking.pictures import Pictures
from analysis.tracking.repeats import change_around, new_pictures, repeated
from analysis.tracking.rolling import refuse_roll
from tunenet_logs.arrays import Array, Picture
from tunenet_logs.errors import NotFoundError
from tunenet_logs.progress import told

# Pictures of a flight that is searched for once more, against two backgrounds: fewer show it.
_FEW_FRAMES = 5

_MARK = "mark the ball with --roi, --hsv or --ball-at"

_FILM_MORE = "at the next drop: film fall and bounces at 60 pictures a second or more"

# From a mark to the edge of what it marks, in the reduced picture: it need not be exact.
_NEAR_PX = 50

# Difference in RGB (0 to 255), and ratio of areas, from a marked ball: it changes by less as it
# moves through light and shade, and is blurred.
_UNLIKE_COLOUR, _UNLIKE_AREA = 90.0, 4.0

# What speaks against a candidate where its confidence is 1/e; `follow` takes none above 12.
_CONFIDENCE_COST = 8.0

_EXPOSURE_S = 0.016  # longer ones blur a ball so much that people add light
_GOOD = 0.4  # misfit of a `Placing` up to which it tells whether the ball stands still
# Radii around the ball that the background is not learnt from: its shadow, and an error of its
# position.
_HIDDEN = 2.5

# Ball radii below the lowest place where it was followed, in which it may have come to rest.
_RESTS_BELOW = (0.0, 2.0, 4.0)

# A learnt radius over the first one, above which the ball stood out by a part of it alone, and too
# little was kept out of the background.
_MISSED = 1.2


@dataclass(frozen=True, eq=False)
class Track:
    """Position of the ball in each picture.

    Attributes:
        stamps_ns: of the T pictures, all but those that repeat the one before, shape (T,).
        places_px: x right, y down; the first pixel's centre is 0, 0; shape (T, 2); NaN where the
            ball is not found.
        radius_px: of a disc of its area, shape (T,); NaN likewise.
        confidence: 0 to 1, shape (T,).
        size_px: (width, height) of the pictures.
        gravity_px: acceleration in flight [px/s²], shape (2,).
        colour: RGB of the ball, 0 to 255.
        exposure_s: for which a shutter may have been open around each stamp, at most; 0 for
            positions that no camera saw.
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
    if len(stamps_ns) < MIN_SEEN:
        raise NotFoundError(f"{len(stamps_ns)} pictures are too few for a drop", _FILM_MORE)
    seconds = (stamps_ns - stamps_ns[0]).astype(np.float64) * 1e-9
    allowed = pictures.allowed(hints.roi)

    if hints.hsv is not None:
        low, high = (np.array(end) for end in hints.hsv)
        shown = told(pictures, "finding the ball's colour", len(stamps_ns))
        blobs = [hsv_blobs(picture, low, high, allowed) for picture in shown]
        table = Candidates.of(seconds, blobs)
        return _track(pictures, table, _arc_of(table))

    def moving(background: Background) -> Candidates:
        shown = told(pictures, "finding what moves", len(stamps_ns))
        blobs = [moving_blobs(picture, background, allowed) for picture in shown]
        table = Candidates.of(seconds, blobs)
        if hints.ball_at is not None:
            return _only_like(table, pictures, hints.ball_at)
        return table

    check_still(pictures.samples)
    table = moving(still_background(pictures.samples))
    arc = longest_arc(table)
    try:
        if arc is None:
            look = moving(halved_background(pictures.samples))
            track = _of_arc(pictures, look, _arc_of(look.inside(), _FEW_FRAMES), allowed)
        else:
            track = _of_arc(pictures, table, arc, allowed)
    except NotFoundError as error:
        refuse_roll(table, pictures.scale, 0.0, error)
        raise
    way_px = np.linalg.norm(np.ptp(track.places_px[track.found], axis=0))
    refuse_roll(table, pictures.scale, float(way_px))
    return track


def _of_arc(pictures: Pictures, first: Candidates, arc: Arc, allowed: Picture | None) -> Track:
    """Track the ball in all pictures, from a flight among candidates by their motion."""
    second = _redetect(pictures, first, arc, allowed)
    fresh = second.new_frames()
    table = second.table.some(fresh)
    shown = np.unique(np.searchsorted(fresh, arc.frames, side="right") - 1)  # first, where repeated
    arc = same_arc(table, shown, arc.gravity_px, second.before_px[fresh])
    return _track(pictures, table, arc, fresh)


def _arc_of(table: Candidates, least_frames: int = MIN_FRAMES) -> Arc:
    arc = longest_arc(table, least_frames)
    if arc is None:
        raise NotFoundError(
            "no ball is seen to fly: nothing moves along a parabola, as a drop does from the side",
            f"{_MARK} (--preview: with a click), or at the next drop: film it from the side, with "
            "light and a plain background (docs/camera.md)",
        )
    return arc


def _only_like(
    table: Candidates, pictures: Pictures, ball_at: tuple[float, float, float]
) -> Candidates:
    """Keep the candidates that look like the one nearest to where the user saw the ball."""
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
    unlike = np.linalg.norm(table.colours - colour, axis=2) > _UNLIKE_COLOUR
    unlike |= np.abs(np.log(table.areas_px / area)) > np.log(_UNLIKE_AREA)
    areas = np.where(unlike, np.nan, table.areas_px)
    positions = np.where(unlike[:, :, None], np.nan, table.places_px)
    return replace(table, areas_px=areas, places_px=positions)


def _track(
    pictures: Pictures,
    table: Candidates,
    arc: Arc,
    fresh: NDArray[np.intp] | slice = slice(None),
) -> Track:
    """Track the ball in each of the pictures `fresh`, from an arc among their candidates."""
    ball = color_and_size(table, arc.frames, arc.chosen)
    chosen, _ = follow(table, arc, ball)
    # Where the light falls in its flight is chance: how it looks is how it does on all of its way.
    sure = np.flatnonzero((chosen >= 0) & (picked(table.misfits, chosen) < _GOOD))
    if len(sure) >= MIN_SEEN:
        ball = color_and_size(table, sure, chosen[sure])
    chosen, cost = follow(table, arc, ball)
    positions = picked(table.places_px, chosen)
    areas = picked(table.areas_px, chosen)
    cut = ~picked(table.whole.astype(float), chosen).astype(bool)  # at the edge: half a ball
    positions[cut], areas[cut] = np.nan, np.nan
    if np.isfinite(areas).sum() < MIN_SEEN:
        raise NotFoundError("the ball is lost after a few pictures", _MARK)
    red, green, blue = np.nanmedian(picked(table.colours, chosen), axis=0).round().astype(int)
    scale = pictures.scale
    return Track(
        stamps_ns=pictures.stamps_ns[fresh],
        places_px=positions * scale + (scale - 1) / 2,
        radius_px=np.sqrt(areas / np.pi) * scale,
        confidence=np.where(np.isfinite(areas), np.exp(-cost / _CONFIDENCE_COST), 0.0),
        size_px=pictures.size_px,
        gravity_px=arc.gravity_px * scale,
        colour=(int(red), int(green), int(blue)),
        exposure_s=_EXPOSURE_S,
    )


@dataclass(frozen=True, eq=False)
class Redetection:
    """Candidates of T pictures, by how the ball looks.

    Attributes:
        table: candidates of every picture.
        before_px: where the first look saw the ball, gaps filled, shape (T, 2).
        unchanged: whether a picture is, around the ball, the one before once more, shape (T,).
    """

    table: Candidates
    before_px: Array
    unchanged: NDArray[np.bool_]

    def new_frames(self) -> NDArray[np.intp]:
        """Return the numbers of the pictures but those that repeat one; see `new_pictures`."""
        table = self.table
        rows = np.arange(len(self.unchanged))
        if not table.areas_px.size:
            return rows
        misfits = np.where(np.isfinite(table.areas_px), table.misfits, np.inf)
        best = misfits.argmin(axis=1)
        places = table.places_px[rows, best].copy()
        places[misfits[rows, best] > _GOOD] = np.nan
        return new_pictures(places, self.unchanged)


def _redetect(
    pictures: Pictures, first: Candidates, arc: Arc, allowed: Picture | None
) -> Redetection:
    """Learn the ball's appearance and the background without it, and find it in all pictures."""
    ball = color_and_size(first, arc.frames, arc.chosen)
    chosen, _ = follow(first, arc, ball)
    seen_px = picked(first.places_px, chosen)
    every = np.arange(len(seen_px))
    known = np.flatnonzero(np.isfinite(seen_px[:, 0]))
    before_px = np.column_stack([np.interp(every, known, seen_px[known, i]) for i in (0, 1)])
    areas = picked(first.areas_px, chosen)
    shown, still_px = flight_and_rest(first.seconds, arc, chosen, before_px, ball.radius_px)
    crops = pictures.some(shown)
    samples = [*pictures.samples, *crops]
    numbers = [*pictures.sampled, *shown]
    down = arc.gravity_px / np.linalg.norm(arc.gravity_px)
    maybe_px: list[Array] = []
    for at in numbers:  # a ball that lies was lost before it got there: a little above
        rests = at > arc.frames[-1] and np.isfinite(still_px[at, 0])
        below = (
            [still_px[at] + radii * ball.radius_px * down for radii in _RESTS_BELOW]
            if rests
            else []
        )
        maybe_px.append(np.stack([before_px[at], *below]))
    clear = still_background(samples, maybe_px, _HIDDEN * ball.radius_px + 2)
    appearance = learn_appearance(crops, clear, before_px[shown], areas[shown])
    if appearance is not None and appearance.radius_px > _MISSED * ball.radius_px:
        clear = still_background(samples, maybe_px, _HIDDEN * appearance.radius_px + 2)
        appearance = learn_appearance(crops, clear, before_px[shown], areas[shown])
    del crops, samples  # many whole pictures
    detector = BallDetector(clear, ball, appearance, allowed)
    blobs: list[Blobs] = []
    changes = np.full((len(before_px), 2), np.nan)
    before: Picture | None = None
    for number, picture in enumerate(told(pictures, "following the ball", len(before_px))):
        blobs.append(detector.find(picture, before_px[number], still_px[number]))
        if before is not None:
            changes[number] = change_around(before, picture, blobs[-1])
        before = picture
    return Redetection(Candidates.of(first.seconds, blobs), before_px, repeated(changes))
