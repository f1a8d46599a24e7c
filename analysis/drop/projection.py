"""A bounce as an uncalibrated camera shows it: heights through an unknown projective map.

Along the image of the vertical a height u [drop heights] above contact appears at
p = A + B phi(u), phi(u) = e^k u / (1 + (e^k - 1) u): contact at A, drop height at A + B, and k the
perspective between the two. Time is in fall times T0 after the first impact. So five numbers and a
ball say what a track looks like, whatever camera, height and frame rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recorders.simulators.bounce import Bounce
from tunenet_logs.arrays import Array


@dataclass(frozen=True, eq=False)
class Projection:
    """Where heights are in the picture, and what the ball does.

    Attributes:
        contact_px: A, along the image's vertical, up positive.
        span_px: B.
        perspective: k.
        impact_s: the first impact.
        fall_time_s: T0, without air.
        bounce: the ball.
        residual_px: rms of the track about it.
        worst_px: largest residual.
    """

    contact_px: float
    span_px: float
    perspective: float
    impact_s: float
    fall_time_s: float
    bounce: Bounce
    residual_px: float
    worst_px: float

    def heights(self, places_px: Array) -> Array:
        """Heights [drop heights] of places along the image's vertical."""
        share = (places_px - self.contact_px) / self.span_px
        grow = np.exp(self.perspective)
        return share / np.maximum(grow - (grow - 1) * share, 1e-3)

    def places_px(self, heights: Array) -> Array:
        """Places along the image's vertical of heights [drop heights]."""
        return self.contact_px + self.span_px * projected(heights, self.perspective)

    def fall_times(self, seconds: Array) -> Array:
        """Times [fall times after the first impact]."""
        return (seconds - self.impact_s) / self.fall_time_s

    def impacts(self, until_s: float) -> Array:
        """All impacts until then, in order [fall times after the first], the first is 0."""
        last = (until_s - self.impact_s) / self.fall_time_s
        starts, _ = self.bounce.flights(last)
        return starts[starts <= max(last, 0.0)]


def projected(heights: Array, perspective: float) -> Array:
    """phi(u) of heights [drop heights]."""
    grow = np.exp(perspective)
    return grow * heights / np.maximum(1 + (grow - 1) * heights, 1e-3)
