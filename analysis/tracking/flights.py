"""RANSAC for the longest free flight among the candidates: what no hand or shadow does.

Triples of candidates at even strides that bend as a fall does are seeds, those first whose
parabola most others lie on; each seed grows to the pictures around it, by least squares in turn
with a new choice of what lies near; the flight with the best score is the ball's. From it the ball
is followed to both ends of the recording.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.tracking.candidates import Candidates, ColorAndSize
from tunenet_logs.episode import Array, median_step
from tunenet_logs.errors import NotFoundError
from tunenet_logs.timing.arrivals import conversions

Index = NDArray[np.intp]
MIN_BEND_PX = 0.25  # of a triple: noise bends less
# Distance in RGB (0 to 255): blur and light change a flying ball's colour by less.
COLOUR_APART = 70.0
# Of one candidate's area to the next one's: blur and a bad outline change it by less.
AREA_RATIO = 2.2


def accelerated_triples(table: Candidates) -> tuple[Index, Array]:
    """Find triples of alike candidates on a parabola that others lie on; those with most first."""
    period = median_step(table.seconds)
    # In pictures and in seconds: how fast a film plays need not be how fast it was filmed.
    strides = {1, 2, 4, 7, *(max(1, round(stride_s / period)) for stride_s in (0.016, 0.033, 0.06))}
    seeds, bends, witnesses = [], [], []
    for stride in sorted(strides):
        # Pair every candidate with all that look like it one stride on, and two, shape (K, 6); of
        # so many pictures at once that the memory of a long film is bounded.
        count = len(table.seconds)
        parts = [np.empty((0, 6), np.intp)]
        for begin in range(0, count - 2 * stride, 2048):
            part = table.some(np.arange(begin, min(begin + 2048 + 2 * stride, count)))
            areas, colours = np.log(part.areas_px), part.colours
            ratio = np.abs(areas[:-stride, :, None] - areas[stride:, None])
            apart = np.linalg.norm(colours[:-stride, :, None] - colours[stride:, None], axis=3)
            same = (ratio < np.log(AREA_RATIO)) & (apart < COLOUR_APART)  # NaN is not
            first, *chosen = np.nonzero(same[:-stride, :, :, None] & same[stride:, None])
            frames = begin + first[:, None] + stride * np.arange(3)
            parts.append(np.column_stack([frames, *chosen]))
        triples = np.concatenate(parts)
        early, middle, late = (table.seconds[triples[:, row]] for row in range(3))
        a, b, c = (table.places_px[triples[:, row], triples[:, row + 3]] for row in range(3))
        before = (b - a) / (middle - early)[:, None]
        after = (c - b) / (late - middle)[:, None]
        bend = (after - before) * (late - early)[:, None] / 2  # over the triple [px]
        travel = np.linalg.norm(c - a, axis=1)
        # What stands travels less than 2 px in a triple.
        moving = (np.abs(bend).max(axis=1) > MIN_BEND_PX) & (travel > 2.0)
        triples, bend = triples[moving], bend[moving]
        seen = np.zeros(len(triples), int)
        for step in (-2, -1, 3, 4):
            seen += _witnessed(table, triples, step * stride)
        # Of a flight two of these four pictures are on the triple's parabola.
        kept = seen >= 2
        seeds.append(triples[kept])
        bends.append(bend[kept])
        witnesses.append(seen[kept])
    order = np.argsort(-np.concatenate(witnesses), kind="stable")
    return np.concatenate(seeds)[order], np.concatenate(bends)[order]


def _witnessed(table: Candidates, triples: Index, step: int) -> Index:
    """Flag triples whose parabola has a look-alike on it `step` pictures after its first."""
    frames = triples[:, 0] + step
    there = np.clip(frames, 0, len(table.seconds) - 1)
    times = [table.seconds[triples[:, row]] for row in range(3)]
    positions = [table.places_px[triples[:, row], triples[:, row + 3]] for row in range(3)]
    when = table.seconds[there]
    expected = np.zeros((len(triples), 2))
    for row in range(3):  # Lagrange's parabola
        basis = np.ones(len(triples))
        for other in {0, 1, 2} - {row}:
            basis *= (when - times[other]) / (times[row] - times[other])
        expected += basis[:, None] * positions[row]
    area = table.areas_px[triples[:, 1], triples[:, 4]]
    colour = table.colours[triples[:, 1], triples[:, 4]]
    off = np.linalg.norm(table.places_px[there] - expected[:, None], axis=2)
    near, one = np.nonzero(off < 2 * np.asarray(tolerance_px(area))[:, None])  # NaN is not
    alike = np.linalg.norm(table.colours[there[near], one] - colour[near], axis=1) < COLOUR_APART
    alike &= np.abs(np.log(table.areas_px[there[near], one] / area[near])) < np.log(2 * AREA_RATIO)
    seen = np.zeros(len(triples), np.intp)
    seen[near[alike]] = 1
    return np.where(frames == there, seen, 0)


def tolerance_px(area_px: Array | float) -> Array | float:
    """Return how far off a parabola a candidate may be: a third of its radius, and noise."""
    return 1.0 + 0.35 * np.sqrt(np.asarray(area_px) / np.pi)


# ---- Growth of the seeds to arcs, and the best of these

MIN_FRAMES = 6  # pictures of a flight: three lie on a parabola by themselves, three more must agree
_CAMOUFLAGED = (
    "the ball looks like what is behind it",
    "mark it with --hsv; at the next drop: film it before a plain background of another colour",
)
# Added to distances that a small ball's radius bounds: its position is no better than that.
SLACK_PX = 2.0


@dataclass(frozen=True, eq=False)
class Arc:
    """One free flight."""

    frames: Index  # numbers of the N pictures it was seen in, increasing, shape (N,)
    chosen: Index  # which candidate of each it is, shape (N,)
    gravity_px: Array  # acceleration [px/s²], shape (2,)


_FARTHER = 1.3  # score of a flight on a converter's clock over that by the stamps


def longest_flight(
    table: Candidates, stamps_ns: NDArray[np.int64], least_frames: int = MIN_FRAMES
) -> tuple[Candidates, Arc] | None:
    """Find the free flight that goes farthest, on the clock that makes it go farthest.

    A converter that leaves out one of up to six pictures stamps the others evenly, (T,), and no
    fall is a parabola any more. Returns the candidates on that clock, and the flight.
    """
    clocks = [
        (how.placed_ns(stamps_ns) - stamps_ns[0]) * 1e-9
        for how in conversions(stamps_ns)
        if how.leaves_out >= 1 / 6
    ]
    best, arc, score = table, *_longest_arc(table, least_frames)
    score *= _FARTHER
    for seconds in clocks:
        other = replace(table, seconds=seconds)
        there, farther = _longest_arc(other, least_frames)
        if farther > score:
            best, arc, score = other, there, farther
    return None if arc is None else (best, arc)


# Way of a candidate over which it moved, and its least area: noise makes smaller ones.
_MOVED_PX, _LEAST_PX2 = 0.5, 20.0
_REPEATED = 0.2  # fraction of a film's pictures from which on it doubles them
_MOST_REPEATS = 4  # of one picture, in a row: in more of them the ball lies


def fresh_pictures(table: Candidates) -> Index | None:
    """Return the numbers of a film's pictures but those that come twice; None where few do.

    Nothing is elsewhere in them than in the one before; of a still scene all pictures are kept.
    """
    apart = np.linalg.norm(table.places_px[1:, :, None] - table.places_px[:-1, None], axis=3)
    stays = np.any(apart < _MOVED_PX, axis=2)  # NaN is not
    moved = np.any((table.areas_px[1:] > _LEAST_PX2) & ~stays, axis=1)
    edges = np.diff(np.concatenate([[0], ~moved, [0]]).astype(int))
    firsts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    short = ends - firsts <= _MOST_REPEATS
    kept = np.ones(len(table.seconds), dtype=bool)
    for first, end in zip(firsts[short], ends[short], strict=True):
        kept[first + 1 : end + 1] = False
    return None if kept.mean() > 1 - _REPEATED else np.flatnonzero(kept)


def _longest_arc(table: Candidates, least_frames: int) -> tuple[Arc | None, float]:
    """Find the best free flight by one clock, and its score; down the picture unless another is.

    A video without its rotation flag falls sideways. And a bounce, seen upside down, looks a little
    like a flight.
    """
    best, best_score = None, 0.0
    if not table.areas_px.size:
        return best, best_score
    seeds, bends = accelerated_triples(table)
    # Where down may be, and how much that is favoured: films are seldom turned.
    for down, factor in (((0, 1), 2.0), ((0, -1), 1.0), ((1, 0), 1.0), ((-1, 0), 1.0)):
        down_px = np.array(down, np.float64)
        towards = bends @ down_px
        sideways = np.abs(bends @ np.array([down_px[1], -down_px[0]]))
        # So many triples grow once, and of the best arcs 60 to the end: it bounds the time.
        falling = seeds[(towards > MIN_BEND_PX) & (towards > sideways)][:500]
        tried: dict[bytes, tuple[float, int]] = {}
        for index, seed in enumerate(falling):
            arc = _grow(table, seed, 1)
            if arc is not None and len(arc.frames) >= 5:
                same = arc.frames.tobytes() + arc.chosen.tobytes()
                score = tried[same][0] if same in tried else flight_score(table, arc)
                tried[same] = (score, index)
        for _, index in sorted(tried.values(), reverse=True)[:60]:
            arc = _grow(table, falling[index], 4)
            if arc is not None and _is_flight(table, arc, down_px, least_frames):
                score = factor * flight_score(table, arc)
                if score > best_score:
                    best, best_score = arc, score
    return best, best_score


def _grow(table: Candidates, seed: Index, rounds: int) -> Arc | None:
    """Extend a triple to the pictures around it that lie on its parabola, refitted each round."""
    frames, chosen = seed[:3], seed[3:]
    area = float(np.median(table.areas_px[frames, chosen]))
    colour = np.median(table.colours[frames, chosen], axis=0)
    tolerance = tolerance_px(area)
    curve = np.zeros((3, 2))
    for _ in range(rounds):
        middle = table.seconds[frames].mean()
        clock = table.seconds[frames] - middle
        curve = _parabola(clock, table.places_px[frames, chosen])
        # A triple may be a short part of a flight; a longer arc about doubles in a round.
        reach = (1.2 if len(frames) > 3 else 2.5) * float(np.ptp(clock))
        low, high = np.searchsorted(table.seconds, [middle - reach, middle + reach])
        window = np.arange(low, high)
        times = (table.seconds[window] - middle)[:, None]
        expected = curve[0] * times**2 + curve[1] * times + curve[2]
        apart = table.places_px[low:high] - expected[:, None]
        off = np.hypot(apart[:, :, 0], apart[:, :, 1])
        row, one = np.nonzero(off < tolerance)  # NaN is not
        there = window[row], one
        alike = np.linalg.norm(table.colours[there] - colour, axis=1) < COLOUR_APART
        alike &= np.abs(np.log(table.areas_px[there] / area)) < np.log(2 * AREA_RATIO)
        near = np.full(off.shape, np.inf)
        near[row[alike], one[alike]] = off[row[alike], one[alike]]
        nearest = near.argmin(axis=1)
        hit = np.isfinite(near[np.arange(len(window)), nearest])
        # Three pictures in a row without it end a flight: a bounce or a hand comes between.
        begin = end = int(np.searchsorted(window, frames[len(frames) // 2]))
        misses = 0
        while begin > 0 and misses < 3:
            begin -= 1
            misses = 0 if hit[begin] else misses + 1
        misses = 0
        while end < len(hit) and misses < 3:
            misses = 0 if hit[end] else misses + 1
            end += 1
        kept = np.arange(begin, end)[hit[begin:end]]
        if len(kept) < 3:  # no parabola
            return None
        frames, chosen = window[kept], nearest[kept]
    return Arc(frames, chosen, 2 * curve[0])


def _parabola(clock: Array, positions: Array) -> Array:
    """Fit a parabola: factors of square, time and 1, shape (3, 2); much faster than `polyfit`."""
    span = float(np.abs(clock).max())
    when = clock / span
    design = np.column_stack([when * when, when, np.ones(len(when))])
    curve = np.linalg.lstsq(design, positions)[0]  # stamps may be as good as equal
    return curve / np.array([[span**2], [span], [1.0]])


def flight_score(table: Candidates, arc: Arc) -> float:
    """Return how far a flight goes in its own sizes, by how many pictures say so.

    What is carried goes far without falling. A fall from rest goes four times as far as it sags
    below the straight line between its ends. Loose ends of a hand lie about a parabola, not on it.
    """
    positions = table.places_px[arc.frames, arc.chosen]
    area = float(np.median(table.areas_px[arc.frames, arc.chosen]))
    travel = float(np.linalg.norm(np.ptp(positions, axis=0)))
    clock = table.seconds[arc.frames]
    sag = float(np.linalg.norm(arc.gravity_px)) * float(np.ptp(clock)) ** 2 / 8
    curve = _parabola(clock - clock.mean(), positions)
    when = (clock - clock.mean())[:, None]
    off = positions - (curve[0] * when**2 + curve[1] * when + curve[2])
    # As far from the parabola, rms, as .3 px and .15 ball radii halves the score.
    loose = np.sqrt((off**2).sum(axis=1).mean()) / (0.3 + 0.15 * np.sqrt(area / np.pi))
    # A fall from rest travels 4 sags; more than 16 pictures do not make a flight likelier.
    return min(travel, 5.0 * sag) / (1 + loose**2) / (2 + np.sqrt(area)) * min(len(arc.frames), 16)


def _is_flight(table: Candidates, arc: Arc, down: Array, least_frames: int) -> bool:
    """Return whether it falls: no faster than a ball of its size, far enough, nearly downward."""
    if len(arc.frames) < least_frames:
        return False
    clock = table.seconds[arc.frames]
    area = float(np.median(table.areas_px[arc.frames, arc.chosen]))
    radius = float(np.sqrt(area / np.pi))
    # Most acceleration [ball radii/s²]: a ball of 4 mm radius, filmed at most at its true rate.
    if np.linalg.norm(arc.gravity_px) > 2500.0 * (radius + 2):
        return False
    falls = float(arc.gravity_px @ down)
    sag = falls * float(np.ptp(clock)) ** 2 / 8  # below the straight line between its ends
    sideways = abs(float(arc.gravity_px @ np.array([down[1], -down[0]])))
    # A camera is turned by less than 35° from one of four directions.
    return sag > 2.0 + 0.3 * radius and sideways < 0.7 * falls


def same_arc(table: Candidates, frames: Index, gravity_px: Array, positions_px: Array) -> Arc:
    """Find a known flight again among new candidates.

    `frames` (N,), `gravity_px` (2,) [px/s²], `positions_px` (T, 2).
    """
    apart = np.linalg.norm(table.places_px[frames] - positions_px[frames][:, None], axis=2)
    apart = np.where(np.isfinite(apart), apart, np.inf)
    if not apart.size:
        raise NotFoundError(*_CAMOUFLAGED)
    nearest = apart.argmin(axis=1)
    area = float(np.nanmedian(table.areas_px[frames, nearest]))
    near = apart[np.arange(len(nearest)), nearest] < SLACK_PX + np.sqrt(area / np.pi)
    if near.sum() < 3:  # no parabola
        raise NotFoundError(*_CAMOUFLAGED)
    return Arc(frames[near], nearest[near], gravity_px)


# ---- Tracking from the flight to both ends of the recording

MIN_SEEN = 8  # pictures with the ball: fewer are no drop and no bounce
COLOUR_OFF = 45.0  # difference in RGB (0 to 255) that counts 1


def color_and_size(table: Candidates, frames: Index, chosen: Index) -> ColorAndSize:
    """Return the medians of some candidates, one in each of these pictures."""
    colours = table.colours[frames, chosen]
    areas = table.areas_px[frames, chosen]
    return ColorAndSize(np.median(colours, axis=0), float(np.median(areas)))


def follow(table: Candidates, arc: Arc, ball: ColorAndSize) -> tuple[Index, Array]:
    """Follow the ball from the middle of its flight to both ends of the recording.

    In each picture the candidate is taken that is most like the ball and nearest to where constant
    acceleration from the last one would have brought it.
    """
    chosen = np.full(len(table.seconds), -1)
    cost = np.full(len(table.seconds), np.inf)
    margin = max((len(arc.frames) - MIN_SEEN) // 2, 0)  # an arc may miss some near its ends
    middle = slice(margin, len(arc.frames) - margin)
    core, core_picks = arc.frames[middle], arc.chosen[middle]
    chosen[core] = core_picks
    cost[core] = _unlike(table, core, core_picks, ball)
    seconds, gravity, radius = table.seconds, arc.gravity_px, ball.radius_px
    # After as many seconds or pictures without it the way is lost: something may pass before it.
    patience = max(0.4, 12 * median_step(seconds))
    for step in (1, -1):
        frames, picks = core[::step], core_picks[::step]
        last, before = int(frames[-1]), int(frames[-2])
        position = table.places_px[last, picks[-1]]
        span = seconds[last] - seconds[before]
        velocity = (position - table.places_px[before, picks[-2]]) / span + gravity * span / 2
        # The largest of four bounds the next: a bounce between two pictures makes the way between
        # them short, and the next one long.
        speeds = deque([float(np.linalg.norm(velocity))], maxlen=4)
        frame = last + step
        while 0 <= frame < len(seconds) and abs(seconds[frame] - seconds[last]) < patience:
            dt = seconds[frame] - seconds[last]
            expected = position + velocity * dt + gravity * dt**2 / 2
            speed = max(speeds) + float(np.linalg.norm(gravity)) * abs(dt)
            off = np.linalg.norm(table.places_px[frame] - expected, axis=1)
            moved = np.linalg.norm(table.places_px[frame] - position, axis=1)
            reach = 1.3 * speed * abs(dt) + radius + SLACK_PX  # noise in the speed
            # In ball radii; it counts 4 at most, as a bounce is not what was expected.
            near = np.minimum((off / (radius + 1)) ** 2, 4.0)
            against = near + _unlike(table, np.full(len(off), frame), np.arange(len(off)), ball)
            against = np.where(moved < reach, against, np.inf)
            against = np.where(np.isfinite(against), against, np.inf)
            best = int(against.argmin()) if len(against) else -1
            if best >= 0 and against[best] < 12.0:  # a sum of squares, each about 1 for the ball
                new = table.places_px[frame, best]
                velocity = (new - position) / dt + gravity * dt / 2
                speeds.append(float(np.linalg.norm(velocity)))
                position, last = new, frame
                chosen[frame], cost[frame] = best, against[best]
            frame += step
    return chosen, cost


def flight_and_rest(
    seconds: Array, arc: Arc, chosen: Index, positions_px: Array, radius_px: float
) -> tuple[Index, Array]:
    """Select pictures that show the moving ball, and where it may lie in the others.

    Before the flight it is where the flight's parabola, followed backwards, comes to rest, and on
    the way from there; after it, at the lowest position before the first picture without it.
    `seconds` (T,), `chosen` (T,), `positions_px` (T, 2).
    """
    found = chosen >= 0
    first, last = int(arc.frames[0]), int(arc.frames[-1])
    gaps = np.flatnonzero(~found[last:])
    end = last + (int(gaps[0]) if len(gaps) else len(chosen) - last)  # followed without a break
    shown: list[int] = []
    for at in range(first, end):
        apart = positions_px[shown] - positions_px[at] if shown else np.empty((0, 2))
        crowd = np.linalg.norm(apart, axis=1)
        # More than two before the same background teach nothing of the ball.
        if found[at] and (crowd < radius_px / 2).sum() < 2:
            shown.append(at)
    # 24 at most: all of them are in memory at once.
    some = np.linspace(0, len(shown) - 1, min(24, len(shown))).astype(int)
    clock = seconds[arc.frames] - seconds[first]
    curve = np.polyfit(clock, positions_px[arc.frames], 2)
    down = arc.gravity_px / np.linalg.norm(arc.gravity_px)
    times = seconds - seconds[first]
    released = -float(curve[1] @ down) / max(2 * float(curve[0] @ down), 1e-9)
    times = np.maximum(times, released)[:, None]
    still = curve[0] * times**2 + curve[1] * times + curve[2]
    still[first : last + 1] = np.nan
    followed = positions_px[first:end]
    still[last + 1 :] = followed[int(np.argmax(followed @ down))]
    return np.array(shown, np.intp)[some], still


def _unlike(table: Candidates, frames: Index, picks: Index, ball: ColorAndSize) -> Array:
    """Return the squared differences from the ball in colour, log size and misfit, shape (N,)."""
    colour = np.linalg.norm(table.colours[frames, picks] - ball.colour, axis=1) / COLOUR_OFF
    size = np.log(table.areas_px[frames, picks] / ball.area_px) / 0.6
    return colour**2 + size**2 + (table.misfits[frames, picks] / 0.35) ** 2
