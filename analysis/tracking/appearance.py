"""Appearance of the ball, learnt from pictures in which its position is about known.

Its radius, its picture and its exact positions are found in turn, to a small part of a pixel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.tracking.background import Background, FloatPicture
from analysis.tracking.drawn_ball import NARROW, Patch, best_start, cut_patch, fit_ball, unlike
from tunenet_logs.arrays import Array, Picture

_FINE_PX = 9.0  # a larger ball is reduced to that radius before it is fitted
# Ball radii: a fit that moved farther is run once more from where it ended, at first wide.
_NEAR_START = 0.25

_NEAR = 0.3  # ball radii between two fits of the same ball
_FAR_WORSE = 1.5  # misfit over that of another fit: one that is as much worse is not looked into
# Ball radii, and px more, from a start to its fit: what is farther off has another start.
_MAX_MOVED, _MAX_MOVED_PX = 1.2, 2.0

_SURE = 0.12  # misfit up to which the start was about right
# Pictures of the ball: the median of fewer is one of them, with what was behind it.
_MIN_SAMPLES = 3

_ROUNDS = 4
# Of learning how it looks and fitting that: most of them, and a relative change of the radius that
# ends them.
_SETTLED = 0.01

# Quantile of the radii of what moved: a part of the ball may look like the background.
_FIRST_RADIUS = 0.7

_PATCH = 1.3  # radii of patches over that of the ball: it may be larger than it was thought
_TRANSITION_PX = 1.2  # from the outline inward: the colour there is half the background's
# Squared difference of two colours (0 to 255, summed over RGB), 12 in each channel: with less, it
# cannot be said how much of a pixel is ball.
_TELLING = 400.0

_RING_PX = 0.5  # half the width of a ring, and the step from one to the next
_MIN_IN_RING = 4  # pixels of a ring that make a median
# Least and most of the outline's radius over the last one: the patch shows no more.
_MIN_CHANGE, _MAX_CHANGE = 0.75, 1.35


@dataclass(frozen=True)
class Placing:
    """Fit of the ball's appearance to one picture.

    Attributes:
        x, y: of its centre [px].
        radius_px: of its outline.
        misfit: rms residual inside it, but for noise, over how far it stands out; 0 is perfect.
    """

    x: float
    y: float
    radius_px: float
    misfit: float

    def is_near(self, x: float, y: float) -> bool:
        """Return whether a position [px] is about this one."""
        return math.hypot(x - self.x, y - self.y) < _NEAR * self.radius_px


@dataclass(frozen=True, eq=False)
class FitStart:
    """Starting point of a fit.

    Attributes:
        x, y: near the ball's centre [px].
        patch: what is seen around.
        values: see `draw_ball`, shape (6,).
    """

    x: float
    y: float
    patch: Patch
    values: Array


@dataclass(frozen=True, eq=False)
class Appearance:
    """Template of the ball.

    Attributes:
        layers: its colours (0 to 255) times its fraction of each pixel, and that fraction, shape
            (N, N, 4).
        radius_px: of its outline, in the pictures.
        zoom: its pixels per pixel of the pictures.
    """

    layers: FloatPicture
    radius_px: float
    zoom: float

    def start(
        self,
        picture: Picture,
        background: Background,
        gain: float,
        x: float,
        y: float,
        grown: float = 1.0,
    ) -> FitStart | None:
        """Cut the patch at which a fit may begin, near (x, y) [px]; None out of the picture.

        `gain` is how much brighter the background is, `grown` about the radius over `radius_px`.
        """
        patch = cut_patch(picture, background, gain, (x, y), self.radius_px * grown, self.zoom)
        if patch is None:
            return None
        values = np.array([*patch.here(x, y), math.log(grown), 0.0, 0.0, 0.0])
        return FitStart(x, y, patch, values)

    def unlikeness(self, begin: FitStart) -> float:
        """Return the fraction of what is seen around a start that a ball does not explain."""
        left = unlike(self.layers, self.radius_px * self.zoom, begin.patch, begin.values)
        return left / begin.patch.inside.size

    def place(self, begin: FitStart, known: Sequence[Placing] = ()) -> Placing | None:
        """Fit the ball near a start; None where none is in view, or none that is not known.

        What comes to one of the `known` fits from other starts, or is far worse, is dropped.
        """
        patch, start = begin.patch, begin.values
        radius, growth = self.radius_px * self.zoom, float(start[2])
        values, misfit = fit_ball(self.layers, radius, patch, start, growth, NARROW)
        if misfit > _SURE:
            here = patch.there(values[0], values[1])
            if any(misfit > _FAR_WORSE * fit.misfit or fit.is_near(*here) for fit in known):
                return None
            start = best_start(self.layers, radius, patch, start)
            values, misfit = fit_ball(self.layers, radius, patch, start, growth)
            here = patch.there(values[0], values[1])
            if any(fit.is_near(*here) and misfit > fit.misfit for fit in known):
                return None
        if np.hypot(*(values - start)[:2]) > _NEAR_START * radius:  # it was a long way
            values, misfit = fit_ball(self.layers, radius, patch, values, growth)
        px, py = patch.there(values[0], values[1])
        most_px = _MAX_MOVED * self.radius_px * math.exp(growth) + _MAX_MOVED_PX
        if math.hypot(px - begin.x, py - begin.y) > most_px:
            return None
        return Placing(px, py, self.radius_px * math.exp(values[2]), misfit)


def learn_appearance(
    samples: Sequence[Picture], background: Background, places_px: Array, areas_px: Array
) -> Appearance | None:
    """Learn the ball's picture and radius, in turn with its exact positions.

    Args:
        samples: N pictures, RGB, shape (H, W, 3) each.
        background: without the ball.
        places_px: where the ball is in each, shape (N, 2); NaN where that is not known.
        areas_px: how large it is there [px²], shape (N,).

    Returns:
        None where it is seen too seldom.
    """
    known = np.flatnonzero(np.isfinite(places_px[:, 0]) & np.isfinite(areas_px))
    if len(known) < _MIN_SAMPLES:
        return None
    radius = float(np.quantile(np.sqrt(areas_px[known] / np.pi), _FIRST_RADIUS))
    positions = {int(at): (float(places_px[at, 0]), float(places_px[at, 1]), 0.0) for at in known}
    gains = {at: background.gain(samples[at]) for at in positions}
    ball: Appearance | None = None
    for turn in range(_ROUNDS):
        zoom = min(1.0, _FINE_PX / radius)
        patches, starts, used = [], [], []
        for at, (x, y, growth) in positions.items():
            patch = cut_patch(samples[at], background, gains[at], (x, y), _PATCH * radius, zoom)
            if patch is not None:
                patches.append(patch)
                starts.append(np.array([*patch.here(x, y), growth, 0.0, 0.0, 0.0]))
                used.append(at)
        if len(patches) < _MIN_SAMPLES:
            return None
        before, ball = ball, Appearance(_layers(patches, starts, radius * zoom), radius, zoom)
        if before is not None and abs(before.radius_px / radius - 1) < _SETTLED:
            return ball
        fitted = [
            fit_ball(
                ball.layers,
                radius * zoom,
                patch,
                start if turn > 1 else best_start(ball.layers, radius * zoom, patch, start),
                0.0,
            )[0]
            for patch, start in zip(patches, starts, strict=True)
        ]
        middle = float(np.median([values[2] for values in fitted]))
        for values in fitted:
            values[2] -= middle
        radius = _outline(patches, fitted, radius * zoom) * float(np.exp(middle)) / zoom
        for at, patch, values in zip(used, patches, fitted, strict=True):
            positions[at] = (*patch.there(values[0], values[1]), float(values[2]))
    return ball


def _layers(patches: Sequence[Patch], fits: Sequence[Array], radius: float) -> FloatPicture:
    """Take the median of what is seen, in a disc with smooth edges; see `Appearance.layers`."""
    side = 2 * int(np.ceil(radius + 2)) + 1
    seen = np.stack(
        [_straightened(patch.seen, fit, side) for patch, fit in zip(patches, fits, strict=True)]
    )
    colours = np.median(seen, axis=0)
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    apart = np.hypot(x, y)
    fraction = np.clip(radius + 0.5 - apart, 0, 1)[:, :, None]
    # The colour at the edge is half background's: that of the ring within goes on to the edge.
    ring = np.maximum(apart, 1e-6)
    inward = np.minimum(1.0, max(radius - _TRANSITION_PX, 0.5) / ring)
    rows = np.clip(np.round(y * inward + (side - 1) / 2).astype(int), 0, side - 1)
    columns = np.clip(np.round(x * inward + (side - 1) / 2).astype(int), 0, side - 1)
    return np.concatenate([colours[rows, columns] * fraction, fraction], axis=2).astype(np.float32)


def _outline(patches: Sequence[Patch], fits: Sequence[Array], radius: float) -> float:
    """Measure the ball's radius in its own pixels: to where as often as not it is what differs."""
    side = 2 * int(np.ceil(1.6 * radius + 3)) + 1
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    apart = np.hypot(x, y)
    inner = np.median(
        [
            _straightened(patch.seen, fit, side)[apart < 0.8 * radius]
            for patch, fit in zip(patches, fits, strict=True)
        ],
        axis=0,
    ).mean(axis=0)
    fractions = []
    for patch, fit in zip(patches, fits, strict=True):
        seen, behind = _straightened(patch.seen, fit, side), _straightened(patch.behind, fit, side)
        towards = inner - behind
        size = (towards**2).sum(axis=2)
        fraction = ((seen - behind) * towards).sum(axis=2) / (size + 1.0)
        fractions.append(np.where(size > _TELLING, np.clip(fraction, 0, 1), np.nan))
    with np.errstate(invalid="ignore"):
        stack = np.array(fractions)
        enough = np.isfinite(stack).sum(axis=0) >= min(_MIN_SAMPLES, len(stack))
        middle = np.where(enough, np.nanmedian(np.where(enough, stack, 0.0), axis=0), np.nan)
    rings = np.arange(0.5 * radius, 1.5 * radius + 1, _RING_PX)
    profile = []
    for ring in rings:
        values = middle[np.abs(apart - ring) < _RING_PX]
        values = values[np.isfinite(values)]
        profile.append(float(np.median(values)) if len(values) >= _MIN_IN_RING else np.nan)
    known = np.isfinite(profile)
    below = np.flatnonzero(known & (np.array(profile) < 0.5))
    if not len(below) or below[0] == 0:
        return radius
    at = int(below[0])
    high, low = profile[at - 1], profile[at]
    part = (high - 0.5) / (high - low) if np.isfinite(high) and high > low else 0.5
    outline = rings[at - 1] + _RING_PX * part
    return float(np.clip(outline, _MIN_CHANGE * radius, _MAX_CHANGE * radius))


def _straightened(picture: FloatPicture, values: Array, side: int) -> FloatPicture:
    """Warp a patch (3, N, N) to (side, side, 3), the ball in its middle and at its usual size."""
    import cv2

    x, y, growth = values[:3]
    grow = float(np.exp(growth))
    middle = (side - 1) / 2
    turn = np.array([[grow, 0.0, x - grow * middle], [0.0, grow, y - grow * middle]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    straight = cv2.warpAffine(
        np.ascontiguousarray(picture.transpose(1, 2, 0)),
        turn,
        (side, side),
        flags=flags,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(straight, np.float32)
