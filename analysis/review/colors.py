"""Colours that all that is drawn of a tuning shares."""

from __future__ import annotations

Color = tuple[int, int, int]

OBSERVED: Color = (255, 255, 255)
MUTED: Color = (140, 140, 140)
SUCCESS: Color = (60, 190, 130)
FAILURE: Color = (235, 95, 75)
FITTED: Color = (255, 95, 165)
# Cold to warm: readable on a dark ground, and apart for the colour-blind.
_RAMP: tuple[Color, ...] = (
    (112, 100, 190),
    (66, 120, 220),
    (40, 165, 200),
    (60, 190, 130),
    (160, 205, 60),
    (255, 165, 40),
)


def ramp(k: int, count: int) -> Color:
    """The colour of iteration `k` of `count`."""
    place = k / max(count - 1, 1) * (len(_RAMP) - 1)
    low = min(int(place), len(_RAMP) - 2)
    pairs = zip(_RAMP[low], _RAMP[low + 1], strict=True)
    red, green, blue = (round(a + (place - low) * (b - a)) for a, b in pairs)
    return red, green, blue
