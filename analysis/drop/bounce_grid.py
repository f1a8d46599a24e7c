"""Starting points of a film's fit: a grid over the ball, the fall time and the camera."""

from __future__ import annotations

import numpy as np

from analysis.drop.bounce_model import CONTACT, FALL, IMPACT, LOW, PERSPECTIVE, RESTITUTION, SPAN
from analysis.drop.projection import projected
from tunenet_logs.arrays import Array

_RESTITUTIONS = np.linspace(0.02, 0.995, 40)
_STRETCHES = np.exp(np.linspace(np.log(0.92), np.log(3.2), 22))
# The grid of a fit's starts: its cost has dozens of local minima. Fall times in durations of the
# part of the fall that is seen; perspectives within about one standard deviation of their prior.
_PERSPECTIVES = np.array([-0.8, -0.25, 0.3, 0.9])

# Of a track that the 3520 points of the grid are compared with: more cost more than they gain.
_MAX_SAMPLES = 96

_COMPARED = 5.0  # fall durations after the impact that are looked at


def grid_starts(seconds: Array, along: Array, impact_s: float, count: int) -> list[Array]:
    """Find the best points of a grid over ideal ball, fall time and perspective.

    No two of them are neighbours. Contact and span are in closed form for each point.

    Args:
        seconds: shape (T,): the fall, the bounces, nothing before or after.
        along: positions along the image's vertical, up positive, shape (T,).
        impact_s: the first impact, to half a sample.
        count: how many are wanted.

    Returns:
        The unknowns of a `BounceFit`, shape (14,) each, best first.
    """
    seen_s = impact_s - float(seconds[0])
    near = seconds < impact_s + _COMPARED * seen_s
    every = max(1, -(-int(near.sum()) // _MAX_SAMPLES))
    clock, positions = seconds[near][::every] - impact_s, along[near][::every]
    falls = seen_s * _STRETCHES
    times, kept = clock / falls[:, None], _RESTITUTIONS[:, None, None]
    after = np.clip(times, 0.0, None)
    bouncing = 1 - after * (1 - kept) / (2 * kept)  # e^n when flight n begins
    speeds = kept ** np.floor(np.log(np.maximum(bouncing, 1e-12)) / np.log(kept))
    since = after - 2 * kept * (1 - speeds) / (1 - kept)
    flying = np.clip(since * (2 * kept * speeds - since), 0.0, None)
    falling = 1 - np.clip(times + 1, 0.0, None) ** 2
    heights = np.where(times < 0, falling, np.where(bouncing > 0, flying, 0.0))
    shapes = projected(heights, _PERSPECTIVES[:, None, None, None])
    middle = shapes.mean(axis=-1, keepdims=True)
    off, about = shapes - middle, positions - positions.mean()
    spread = (off**2).sum(axis=-1)
    spans = (off @ about) / np.maximum(spread, 1e-12)
    squares = float(about @ about) - spans**2 * spread
    squares = np.where(spans > 0, squares, np.inf) + 1e-9
    starts: list[Array] = []
    taken = np.zeros(squares.shape, dtype=bool)
    while len(starts) < count and not taken.all():
        at = np.unravel_index(np.where(taken, np.inf, squares).argmin(), squares.shape)
        if not np.isfinite(squares[at]):
            break
        view, ball, fall = (int(index) for index in at)
        span = float(spans[at])
        contact = float(positions.mean() - span * middle[view, ball, fall, 0])
        start = np.zeros(len(LOW))
        start[[RESTITUTION, IMPACT, FALL]] = _RESTITUTIONS[ball], impact_s, np.log(falls[fall])
        start[[CONTACT, SPAN, PERSPECTIVE]] = contact, span, _PERSPECTIVES[view]
        starts.append(start)
        taken[:, max(0, ball - 1) : ball + 2, max(0, fall - 2) : fall + 3] = True
    return starts
