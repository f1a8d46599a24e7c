"""Track the ball through the pictures: found by how it flies, then by how it looks.

First come checks of what cannot be tracked: a camera that moves, repeated pictures, a ball that
rolls and never falls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.options import Hints
from tunenet_logs.analysis.tracking.appearance import BallDetector, learn_appearance
from tunenet_logs.analysis.tracking.candidates import (
    Background,
    Blobs,
    Candidates,
    halved_background,
    hsv_blobs,
    middle_of,
    moving_blobs,
    picked,
    still_background,
)
from tunenet_logs.analysis.tracking.flights import (
    AREA_RATIO,
    COLOUR_APART,
    MIN_FRAMES,
    MIN_SEEN,
    Arc,
    color_and_size,
    flight_and_rest,
    flight_score,
    follow,
    fresh_pictures,
    longest_flight,
    same_arc,
)
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.episode import Array, Picture
from tunenet_logs.errors import NotFoundError
from tunenet_logs.terminal import told

# ---- Check of a still camera: without a still background no ball can be found

_TILES = 6  # a picture's tiles, each way
# Of the tiles that show something, and of the pictures: with more the background is none.
_MAX_ELSEWHERE = 0.5


def share_elsewhere(samples: Sequence[Picture]) -> float:
    """Return the fraction of pictures most of whose textured tiles differ from the median's."""
    reduced = [_reduced(sample) for sample in samples]
    still = _tiles(middle_of(reduced))
    spread = still.std(axis=1)
    seen, changed = np.zeros(len(reduced)), np.zeros(len(reduced))
    for at, picture in enumerate(reduced):  # all at once would take much memory
        tiles = _tiles(picture)
        spreads = tiles.std(axis=1)
        # Standard deviation [of 255] of a tile that shows something: more than a wall and noise
        shown = np.maximum(spreads, spread) > 8.0
        alike = (tiles * still).mean(axis=1) / np.maximum(spreads * spread, 1e-3)
        seen[at], changed[at] = shown.sum(), (shown & (alike < 0.7)).sum()
    if np.median(seen) < 14:  # of 36 tiles: it may be what moves, an arm or a large ball
        return 0.0
    return float(np.mean(changed > _MAX_ELSEWHERE * seen))


def _reduced(picture: Picture) -> Picture:
    """Reduce a picture to its brightness, small and smooth, shape (H, W)."""
    import cv2

    scale = min(1.0, 240 / max(picture.shape[:2]))  # noise and a shaking hand average out
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (3, 3), 0), np.uint8)


def _tiles(picture: Picture) -> Array:
    """Cut a picture of shape (H, W) into tiles, each less its mean, shape (tiles, pixels)."""
    tall, wide = picture.shape[0] // _TILES, picture.shape[1] // _TILES
    cut = picture[: tall * _TILES, : wide * _TILES].astype(np.float64)
    parts = cut.reshape(_TILES, tall, _TILES, wide).transpose(0, 2, 1, 3)
    tiles = parts.reshape(_TILES * _TILES, tall * wide)
    return tiles - tiles.mean(axis=1, keepdims=True)


# ---- Repeated pictures, which show a moving ball where it was
# Phones double pictures, and cameras freeze. The pictures alone decide, so that a film is the same
# film from its file, from a log and from a bag.

_MOVED_PX = 1.0  # least way of a ball that moves: several times the noise


def change_around(before: Picture, picture: Picture, found: Blobs) -> tuple[float, float]:
    """Measure a picture's change from the one before around its likeliest candidate, of 255."""
    import cv2

    if not len(found.areas_px):
        return np.nan, np.nan
    best = int(found.misfits.argmin())
    half = int(np.ceil(1.5 * np.sqrt(found.areas_px[best] / np.pi))) + 2
    column, row = (int(value) for value in np.round(found.places_px[best]))
    part = (
        slice(max(row - half, 0), row + half + 1),
        slice(max(column - half, 0), column + half + 1),
    )
    if not picture[part].size:
        return np.nan, np.nan
    off = np.asarray(cv2.absdiff(cv2.blur(before[part], (3, 3)), cv2.blur(picture[part], (3, 3))))
    return float(off.max()), float(np.sqrt(np.mean(np.square(off, dtype=np.float32))))


def new_pictures(places_px: Array, unchanged: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Select the pictures but those that show a moving ball where it was, once more.

    A ball that lies moves neither before nor after; one that bounces may be seen twice in one place
    by chance, but goes back. Where a recording doubles pictures of a ball that goes on, it is no
    chance, and those of one that turns back are left out, too. A longer run than it makes of one
    picture, or of two of a ball at the top of its flight, shows a ball that lies. `places_px` (T,
    2), `unchanged` (T,).
    """
    edges = np.diff(np.concatenate([[False], unchanged, [False]]).astype(int))
    firsts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    runs = list(zip(firsts.tolist(), ends.tolist(), strict=True))
    repeats = [run for run in runs if _goes_on(places_px, *run)]
    moves = np.linalg.norm(np.diff(places_px, axis=0), axis=1) > _MOVED_PX
    if len(repeats) >= max(3, 0.02 * np.count_nonzero(moves)):  # it doubles pictures
        most = 2 * max(end - first for first, end in repeats) + 1
        repeats += [(first, end) for first, end in runs if end - first <= most]
    kept = np.ones(len(unchanged), dtype=bool)
    for first, end in repeats:
        kept[first:end] = False
    return np.flatnonzero(kept)


def _goes_on(places_px: Array, first: int, end: int) -> bool:
    """Return whether a ball stands in a run of pictures, and then goes on as it came."""
    found = np.flatnonzero(np.isfinite(places_px[:, 0]))
    earlier, later = found[found < first], found[found >= end]
    if len(earlier) < 2 or not len(later):
        return False
    before, here, after = places_px[[earlier[-2], earlier[-1], later[0]]]
    came, went = here - before, after - here
    stood = np.linalg.norm(places_px[first:end] - here, axis=1).max() < 0.5
    least = min(np.linalg.norm(came), np.linalg.norm(went))
    # The cosine between the ways: a bounce turns, flight goes on.
    onward = came @ went > 0.8 * np.linalg.norm(came) * np.linalg.norm(went)
    return bool(stood and least > _MOVED_PX and onward)


# ---- Steady motion along a straight line: a ball that rolls, and never falls

_MIN_ROLL_FRAMES = 8  # pictures of a way


def refuse_roll(
    table: Candidates, scale: int, way_px: float, error: NotFoundError | None = None
) -> None:
    """Raise if something rolls three times as far through the pictures as what was found moves.

    What was found moves by `way_px` in pictures of full size; `scale` is how much they are reduced.
    """
    if way_px > 40.0 * scale:  # it is something
        return
    roll_px = longest_roll_px(table) * scale
    if roll_px > 3.0 * way_px:
        raise NotFoundError(
            f"nothing falls: what moves goes {roll_px:.0f} px along a straight line without "
            "gaining speed, as a ball that rolls; at the next drop: let the ball fall onto the "
            "table, filmed from the side"
        ) from error


def longest_roll_px(table: Candidates) -> float:
    """Measure the longest straight and steady path of one candidate [px]; 0 for none."""
    if not table.areas_px.size or not np.isfinite(table.areas_px).any():
        return 0.0
    low, high = np.nanmin(table.places_px, (0, 1)), np.nanmax(table.places_px, (0, 1))
    spread = float(np.linalg.norm(high - low))
    count = len(table.seconds)
    longest = 0.0
    for first in np.unique(np.linspace(0, count - 1, 48).astype(int)).tolist():
        for one in np.flatnonzero(np.isfinite(table.areas_px[first])).tolist():
            # All of a candidate's path through a picture: the pictures, and where, shape (N, 2).
            before, came = _followed(table, first, one, -1)
            after, went = _followed(table, first, one, 1)
            places = np.array([*came[::-1], table.places_px[first, one], *went])
            frames = [*before[::-1], first, *after]
            length = _length_px(table.seconds[frames], places)
            radius = float(np.sqrt(table.areas_px[first, one] / np.pi))
            if length > max(6.0 * radius, 0.15 * spread):
                longest = max(longest, length)
    return longest


def _followed(table: Candidates, first: int, one: int, step: int) -> tuple[list[int], list[Array]]:
    """Follow a candidate from one picture on, or back: the pictures after it, and where."""
    frames, places = [first], [table.places_px[first, one]]
    area, colour = float(table.areas_px[first, one]), table.colours[first, one]
    radius = float(np.sqrt(area / np.pi))
    velocity: Array | None = None
    for frame in range(first + step, len(table.seconds) if step > 0 else -1, step):
        if abs(frame - frames[-1]) > 3:  # pictures in a row without it
            break
        dt = float(table.seconds[frame] - table.seconds[frames[-1]])
        expected = places[-1] + (velocity * dt if velocity is not None else 0.0)
        reach = 2.0 + 0.5 * radius if velocity is not None else 4.0 * radius
        off = np.linalg.norm(table.places_px[frame] - expected, axis=1)
        unlike = np.linalg.norm(table.colours[frame] - colour, axis=1) > COLOUR_APART
        unlike |= np.abs(np.log(table.areas_px[frame] / area)) > np.log(AREA_RATIO)
        off = np.where(np.isfinite(off) & ~unlike, off, np.inf)
        best = int(off.argmin())
        if off[best] > reach:
            continue
        frames.append(frame)
        places.append(table.places_px[frame, best])
        back = max(len(frames) - _MIN_ROLL_FRAMES, 0)
        span = float(table.seconds[frame] - table.seconds[frames[back]])
        velocity = (places[-1] - places[back]) / span
    return frames[1:], places[1:]


def _length_px(seconds: Array, places: Array) -> float:
    """Return the end-to-end length of a path that is straight and steady; else 0."""
    if len(seconds) < _MIN_ROLL_FRAMES:
        return 0.0
    way = places[-1] - places[0]
    length = float(np.linalg.norm(way))
    clock = seconds - seconds.mean()
    curve = np.polyfit(clock, places, 2)
    fitted = curve[0] * clock[:, None] ** 2 + curve[1] * clock[:, None] + curve[2]
    loose = float(np.sqrt(((places - fitted) ** 2).sum(axis=1).mean()))
    bend = curve[0] * float(np.ptp(clock)) ** 2 / 4
    onward = float(bend @ way) / max(length, 1e-9)
    aside = float(np.sqrt(max(bend @ bend - onward**2, 0.0)))
    # It may fall farther behind a steady speed than get ahead: balls that roll come to rest.
    straight = loose < 0.04 * length and aside < 0.06 * length
    return length if straight and -0.2 * length < onward < 0.06 * length else 0.0


# ---- Track of the ball, from what moves to what looks like it

_MARK = "mark the ball with --roi, --hsv or --ball-at"
_FILM_MORE = "at the next drop: film fall and bounces at 60 pictures a second or more"
_GOOD = 0.4  # misfit of a `Placing` up to which it tells whether the ball stands still


@dataclass(frozen=True, eq=False)
class Track:
    """Position of the ball in each picture."""

    # Of the T pictures, all but those that repeat the one before, shape (T,).
    stamps_ns: NDArray[np.int64]
    # x right, y down; the first pixel's centre is 0, 0; shape (T, 2); NaN where it is not found.
    places_px: Array
    radius_px: Array  # of a disc of its area, shape (T,); NaN likewise
    confidence: Array  # 0 to 1, shape (T,)
    size_px: tuple[int, int]  # (width, height) of the pictures
    gravity_px: Array  # acceleration in flight [px/s²], shape (2,)
    colour: tuple[int, int, int]  # RGB of the ball, 0 to 255
    # For which a shutter may have been open around each stamp; 0 for positions that no camera saw.
    exposure_s: float = 0.0

    @property
    def found(self) -> NDArray[np.bool_]:
        """Whether the ball is found in each picture, shape (T,)."""
        return np.isfinite(self.places_px[:, 0])

    def some(self, rows: slice | NDArray[np.intp]) -> Track:
        """Return the track of some of its pictures, in order."""
        return replace(
            self,
            stamps_ns=self.stamps_ns[rows],
            places_px=self.places_px[rows],
            radius_px=self.radius_px[rows],
            confidence=self.confidence[rows],
        )


def track_ball(pictures: Pictures, hints: Hints | None = None) -> Track:
    """Find the ball by its free flight, learn how it looks, and follow it through all pictures."""
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
        return _track(pictures, *_flight_of(table, stamps_ns))

    def moving(background: Background) -> Candidates:
        shown = told(pictures, "finding what moves", len(stamps_ns))
        blobs = [moving_blobs(picture, background, allowed) for picture in shown]
        table = Candidates.of(seconds, blobs)
        return table if hints.ball_at is None else _like_marked(pictures, table, hints.ball_at)

    share = share_elsewhere(pictures.samples)
    if share > _MAX_ELSEWHERE:
        raise NotFoundError(
            f"the camera moves: {100 * share:.0f} % of the pictures looked at show another view; "
            "at the next drop: fix the camera, or tune the part in which it stands still "
            "(--start, --end)"
        )
    first = moving(still_background(pictures.samples))
    flown = longest_flight(first, stamps_ns)
    fresh = fresh_pictures(first)
    if fresh is not None:
        once = longest_flight(first.some(fresh), stamps_ns[fresh])
        if once is not None and (flown is None or flight_score(*once) > flight_score(*flown)):
            pictures.leave(fresh)
            first, flown, stamps_ns = first.some(fresh), once, stamps_ns[fresh]
            seconds = seconds[fresh]
    look = first
    try:
        if flown is None:  # once more, against two backgrounds: fewer pictures of a flight show it
            look = moving(halved_background(pictures.samples))
            flown = _flight_of(look.inside(), stamps_ns, 5)
        look, arc = replace(look, seconds=flown[0].seconds), flown[1]
        second, before_px, unchanged = _redetect(pictures, look, arc, allowed)
        fresh = new_frames(second, unchanged)
        table = second.some(fresh)
        # The flight's pictures among those, the first one where one is repeated.
        frames = np.unique(np.searchsorted(fresh, arc.frames, side="right") - 1)
        arc = same_arc(table, frames, arc.gravity_px, before_px[fresh])
        track = _track(pictures, table, arc, fresh)
    except NotFoundError as error:
        refuse_roll(first, pictures.scale, 0.0, error)
        raise
    way_px = np.linalg.norm(np.ptp(track.places_px[track.found], axis=0))
    refuse_roll(first, pictures.scale, float(way_px))
    return track


def _like_marked(
    pictures: Pictures, table: Candidates, ball_at: tuple[float, float, float]
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
    if apart[nearest] > 50 + np.sqrt(area / np.pi):  # a mark need not be exact
        right, down = table.places_px[frame, nearest] * pictures.scale
        raise NotFoundError(
            f"nothing moves near {there}, the nearest at {right:.0f}, {down:.0f} px; "
            "mark the ball in flight"
        )
    # It changes by less as it moves through light and shade, and is blurred.
    unlike = np.linalg.norm(table.colours - colour, axis=2) > 90.0
    unlike |= np.abs(np.log(table.areas_px / area)) > np.log(4.0)
    areas = np.where(unlike, np.nan, table.areas_px)
    positions = np.where(unlike[:, :, None], np.nan, table.places_px)
    return replace(table, areas_px=areas, places_px=positions)


def new_frames(table: Candidates, unchanged: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the numbers of the pictures but those that repeat one; see `new_pictures`."""
    rows = np.arange(len(unchanged))
    if not table.areas_px.size:
        return rows
    misfits = np.where(np.isfinite(table.areas_px), table.misfits, np.inf)
    best = misfits.argmin(axis=1)
    places = table.places_px[rows, best].copy()
    places[misfits[rows, best] > _GOOD] = np.nan
    return new_pictures(places, unchanged)


def _flight_of(
    table: Candidates, stamps_ns: NDArray[np.int64], least_frames: int = MIN_FRAMES
) -> tuple[Candidates, Arc]:
    flown = longest_flight(table, stamps_ns, least_frames)
    if flown is None:
        raise NotFoundError(
            "no ball is seen to fly: nothing moves along a parabola, as a drop does from the side",
            f"{_MARK} (--preview: with a click), or at the next drop: film it from the side, with "
            "light and a plain background (tunenet docs camera)",
        )
    return flown


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
    # `follow` takes no candidate that more than 12 speaks against: its confidence is 1/e at 8. A
    # longer exposure blurs a ball so much that people add light.
    return Track(
        stamps_ns=pictures.stamps_ns[fresh],
        places_px=positions * scale + (scale - 1) / 2,
        radius_px=np.sqrt(areas / np.pi) * scale,
        confidence=np.where(np.isfinite(areas), np.exp(-cost / 8.0), 0.0),
        size_px=pictures.size_px,
        gravity_px=arc.gravity_px * scale,
        colour=(int(red), int(green), int(blue)),
        exposure_s=0.016,
    )


def _redetect(
    pictures: Pictures, first: Candidates, arc: Arc, allowed: Picture | None
) -> tuple[Candidates, Array, NDArray[np.bool_]]:
    """Learn the ball's appearance and the background without it, and find it in all pictures.

    Returns the candidates of T pictures, by how the ball looks; where the first look saw the ball,
    gaps filled, shape (T, 2); and which pictures are, around the ball, the one before once more.
    """
    ball = color_and_size(first, arc.frames, arc.chosen)
    chosen, _ = follow(first, arc, ball)
    seen_px = picked(first.places_px, chosen)
    every = np.arange(len(seen_px))
    known = np.flatnonzero(np.isfinite(seen_px[:, 0]))
    before_px = np.column_stack([np.interp(every, known, seen_px[known, i]) for i in (0, 1)])
    areas = picked(first.areas_px, chosen)
    shown, still_px = flight_and_rest(first.seconds, arc, chosen, before_px, ball.radius_px)
    crops = list(pictures.some(shown))
    samples = [*pictures.samples, *crops]
    numbers = [*pictures.sampled, *shown]
    down = arc.gravity_px / np.linalg.norm(arc.gravity_px)
    maybe_px: list[Array] = []
    for at in numbers:  # a ball that lies was lost before it got there: up to 4 radii above
        places = [before_px[at]]
        if at > arc.frames[-1] and np.isfinite(still_px[at, 0]):
            places += [still_px[at] + radii * ball.radius_px * down for radii in (0.0, 2.0, 4.0)]
        maybe_px.append(np.stack(places))
    # What is around the ball is no background: its shadow, and an error of its position.
    clear = still_background(samples, maybe_px, 2.5 * ball.radius_px + 2)
    appearance = learn_appearance(crops, clear, before_px[shown], areas[shown])
    # A much larger radius: a part of it alone stood out, and too little was kept out.
    if appearance is not None and appearance.radius_px > 1.2 * ball.radius_px:
        clear = still_background(samples, maybe_px, 2.5 * appearance.radius_px + 2)
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
    # A change by less than 10 of 255, in the mean of three by three pixels, is none. A codec
    # refines a picture that comes twice, by .02 to .2 of what it changes where the ball has moved.
    largest, rms = changes.T
    # It may come up to four times.
    around = np.pad(np.nan_to_num(rms), 3)
    beside = np.lib.stride_tricks.sliding_window_view(around, 7).max(axis=1)
    unchanged = (largest < 10) | (rms < 0.3 * beside)
    return Candidates.of(first.seconds, blobs), before_px, unchanged
