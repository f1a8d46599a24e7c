"""Derivatives of positions and times by each impact's own restitution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from analysis.drop.bounce_model import FALL, IMPACT, BounceSamples
from tunenet_logs.arrays import Array

_FASTER = 1e-5  # fraction of a restitution by which positions and times are differentiated


def moved_by_own(samples: BounceSamples, unknowns: Array) -> tuple[Array, Array]:
    """Differentiate positions and touch times by each impact's own restitution, relative.

    Args:
        samples: with impacts that were heard.
        unknowns: of the law, shape (16,).

    Returns:
        Of the positions, shape (T, K), and of the times of the touches [s], shape (N, K), over the
        K impacts that are seen, or come before the last that is heard.
    """
    assert samples.heard is not None
    numbers = samples.heard.numbers
    ball = samples.bounce(unknowns)
    last = float(samples.times(unknowns)[-1])
    heard_s = float(samples.touches_s(unknowns, numbers[-1:])[0] - unknowns[IMPACT])
    starts, speeds = ball.flights(max(last, heard_s / float(np.exp(unknowns[FALL]))))
    count = max(int(np.searchsorted(starts, last)), int(numbers[-1]))
    kept = (speeds / ball.arrivals(speeds)).tolist()
    positions = samples.residuals(unknowns)
    times_s = samples.touches_s(unknowns, numbers)
    seen: list[Array] = []
    heard: list[Array] = []
    for impact in range(min(count, len(kept))):
        own = replace(ball, each=(*kept[:impact], kept[impact] * (1 + _FASTER)))
        seen.append((samples.residuals(unknowns, own) - positions) / _FASTER)
        heard.append((samples.touches_s(unknowns, numbers, own) - times_s) / _FASTER)
    return np.column_stack(seen), np.column_stack(heard)
