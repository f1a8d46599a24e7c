"""Where the fit of a filmed bounce may start: restitutions, fall times and perspectives on a grid.

The cost of such a fit has dozens of local minima, so it is looked at everywhere first. The
contact's place and the span of the fall are in closed form for each point of the grid.
"""

from __future__ import annotations

import numpy as np

from tunenet_logs.arrays import Array

_RESTITUTIONS = np.linspace(0.02, 0.995, 40)
_STRETCHES = np.exp(np.linspace(np.log(0.92), np.log(3.2), 22))
"""Fall times, in durations of the part of the fall that is seen."""

_PERSPECTIVES = np.array([-0.8, -0.25, 0.3, 0.9])
_MOST_SAMPLES = 96
_LATER = 5.0
"""Fall durations after the impact that are looked at."""


def bank_starts(
    seconds: Array, places_px: Array, impact_s: float, count: int
) -> list[tuple[float, Array]]:
    """The best points of the grid, no two of them alike.

    Args:
        seconds: shape (T,): the fall, the bounces, nothing before or after.
        places_px: along the image's vertical, up positive, shape (T,).
        impact_s: the first impact, to half a sample.
        count: how many are wanted.

    Returns:
        Pairs of the rms that is left [px] and the unknowns of a `FilmFit`, best first.
    """
    seen_s = impact_s - float(seconds[0])
    near = seconds < impact_s + _LATER * seen_s
    every = max(1, -(-int(near.sum()) // _MOST_SAMPLES))
    clock, places = seconds[near][::every] - impact_s, places_px[near][::every]
    falls = seen_s * _STRETCHES
    heights = ideal_heights(clock / falls[:, None], _RESTITUTIONS[:, None, None])
    grow = np.exp(_PERSPECTIVES)[:, None, None, None]
    shapes = grow * heights / (1 + (grow - 1) * heights)
    middle = shapes.mean(axis=-1, keepdims=True)
    off, about = shapes - middle, places - places.mean()
    spread = (off**2).sum(axis=-1)
    spans = (off @ about) / np.maximum(spread, 1e-12)
    squares = float(about @ about) - spans**2 * spread
    squares = np.where(spans > 0, squares, np.inf) + 1e-9
    chosen: list[tuple[float, Array]] = []
    taken = np.zeros(squares.shape, dtype=bool)
    while len(chosen) < count and not taken.all():
        at = np.unravel_index(np.where(taken, np.inf, squares).argmin(), squares.shape)
        if not np.isfinite(squares[at]):
            break
        view, ball, fall = (int(one) for one in at)
        span = float(spans[at])
        contact = float(places.mean() - span * middle[view, ball, fall, 0])
        unknowns = np.array(
            [
                _RESTITUTIONS[ball],
                impact_s,
                np.log(falls[fall]),
                contact,
                span,
                _PERSPECTIVES[view],
                0.0,
                0.0,
            ]
        )
        chosen.append((float(np.sqrt(squares[at] / len(clock))), unknowns))
        taken[:, max(0, ball - 1) : ball + 2, max(0, fall - 2) : fall + 3] = True
    return chosen


def ideal_heights(places: Array, restitution: Array) -> Array:
    """Heights [drop heights] of a ball that keeps one restitution, without air.

    Args:
        places: times [fall times after the first impact]; broadcast with `restitution`.
        restitution: below 1.
    """
    after = np.clip(places, 0.0, None)
    share = 1 - after * (1 - restitution) / (2 * restitution)
    flight = np.floor(np.log(np.maximum(share, 1e-12)) / np.log(restitution))
    kept = restitution**flight
    since = after - 2 * restitution * (1 - kept) / (1 - restitution)
    flying = np.clip(since * (2 * restitution * kept - since), 0.0, None)
    falling = 1 - np.clip(places + 1, 0.0, None) ** 2
    return np.where(places < 0, falling, np.where(share > 0, flying, 0.0))
