"""Appearance of the ball, learnt from pictures in which its position is about known.

A pixel is background B and ball P in the fractions that the outline gives: (1 - a) B + a P. The
ball's template moves, grows and takes more or less light until that is what is seen (Lucas-Kanade).
Radius, picture and exact positions are learnt in turn, to a small part of a pixel; then the ball is
found in any picture.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.tracking.candidates import (
    Background,
    Blobs,
    ColorAndSize,
    FloatPicture,
    coloured_blobs,
)
from tunenet_logs.analysis.tracking.flights import COLOUR_OFF
from tunenet_logs.episode import Array, Picture

# ---- Template alignment by Gauss-Newton steps with Geman-McClure weights, at first wide
# What looks like the ball behind it, its shadow, its reflection and a hand hardly move its centre:
# they are residuals, and large ones count little.

_REACH = 1.6  # ball radii from a patch's middle to its edge: the ball may be off by half of one
# Of one step: in ball radii, and in the logarithm of its size. Farther off, the Jacobian is
# different.
_MAX_STEP, _MAX_GROWTH = 0.4, 0.1
# Added to the normal matrix's diagonal, so that a ball without contrast does not make it singular.
_MIN_CURVATURE = np.array([1e-3, 1e-3, 0.0, 0.0, 0.0, 0.0])
# Residuals that count little: above 30 (of 255) or that fraction of the ball's contrast, whichever
# is more. At first only larger ones, the bound times 0.65 a step, or the edge would have no
# gradient.
_LARGE, _LARGE_FRACTION, _STRICTER = 30.0, 0.35, 0.65
# Inverse variances of the values that are fitted. Standard deviations: .25 of the logarithm of the
# size, .2 of the light, as a whole, to the right and downward; of x and y nothing is known.
_PRIOR = np.array([0.0, 0.0, 0.25**-2, 0.2**-2, 0.2**-2, 0.2**-2])
_NO_BALL = 0.6  # misfit of what steps do not improve on
# Starts around a given one: right and down, in ball radii, and growth (logarithm).
_STARTS = np.zeros((7, 6))
_STARTS[1:, :3] = np.kron(np.diag([0.45, 0.45, 0.2]), [[1], [-1]])


class _Room(threading.local):
    """Memory that a thread's fits write to again and again."""

    held = np.empty(0, np.float32)

    def of(self, size: int) -> FloatPicture:
        """Return room for so many numbers."""
        if self.held.size < size:
            self.held = np.empty(size, np.float32)
        return self.held[:size]


_ROOM = _Room()


@dataclass(frozen=True, eq=False)
class Patch:
    """Part of a picture and of the background, N by N pixels, reduced where the ball is large."""

    seen: FloatPicture  # colours (0 to 255), a plane for each, shape (3, N, N)
    behind: FloatPicture  # likewise
    apart: FloatPicture  # what is seen less what is behind, 0 out of the picture, shape (3, N, N)
    inside: FloatPicture  # 1 where it is in the picture, shape (N, N)
    bare: FloatPicture  # mean square of `apart` over the colours, shape (N, N)
    left: int  # of its first pixel, in the picture [px]
    top: int
    zoom: float  # its pixels per pixel of the picture
    is_cut: bool  # whether a part of it is out of the picture

    def here(self, x: float, y: float) -> tuple[float, float]:
        """Convert a position in the picture to the patch's pixels."""
        z = self.zoom
        return (x - self.left + 0.5) * z - 0.5, (y - self.top + 0.5) * z - 0.5

    def there(self, x: float, y: float) -> tuple[float, float]:
        """Convert a position in the patch to the picture's pixels."""
        z = self.zoom
        return (x + 0.5) / z - 0.5 + self.left, (y + 0.5) / z - 0.5 + self.top


def cut_patch(
    picture: Picture,
    background: Background,
    gain: float,
    position_px: tuple[float, float],
    radius_px: float,
    zoom: float,
) -> Patch | None:
    """Cut what is within 1.6 ball radii of a position; None out of the picture.

    `gain` is how much brighter the background is, `zoom` about patch pixels per pixel, at most 1.
    """
    import cv2

    half = int(np.ceil(_REACH * radius_px)) + 3
    height, width = picture.shape[:2]
    left, top = round(position_px[0]) - half, round(position_px[1]) - half
    side = 2 * half + 1
    if left + side <= 0 or top + side <= 0 or left >= width or top >= height:
        return None
    above, below = max(-top, 0), max(top + side - height, 0)
    before, beyond = max(-left, 0), max(left + side - width, 0)
    box = slice(top + above, top + side - below), slice(left + before, left + side - beyond)
    small = max(5, round(side * zoom))
    inside = np.ones((side - above - below, side - before - beyond), np.float32)
    reduced: list[FloatPicture] = []
    for part in (picture[box], background.picture[box], inside):
        fine = part.astype(np.float32)
        if max(above, below, before, beyond):
            fine = cv2.copyMakeBorder(fine, above, below, before, beyond, cv2.BORDER_CONSTANT)
        if fine.shape[0] != small:
            fine = cv2.resize(fine, (small, small), interpolation=cv2.INTER_AREA)
        reduced.append(np.asarray(fine, np.float32))
    seen, behind = (np.ascontiguousarray(one.transpose(2, 0, 1)) for one in reduced[:2])
    seen *= np.float32(gain)
    # A pixel of the patch is in the picture, but for rounding of its reduction.
    known = (reduced[2] > 0.99).astype(np.float32)
    apart = (seen - behind) * known
    is_cut = not known.all()
    return Patch(seen, behind, apart, known, _mean_square(apart), left, top, small / side, is_cut)


def _mean_square(planes: FloatPicture) -> FloatPicture:
    """Average the squares over the three colours, shape (N, M) of (3, N, M)."""
    return np.einsum("kij,kij->ij", planes, planes) * np.float32(1 / 3)


@dataclass(frozen=True, eq=False)
class DrawnBall:
    """Ball rendered in a patch, in the box around it."""

    box: tuple[slice, slice]  # rows and columns of the patch, N of them by M
    # Its colours times its fraction of each pixel, and that fraction, shape (4, N, M).
    layers: FloatPicture
    behind: FloatPicture  # the background, shape (3, N, M)
    off: FloatPicture  # residual, what is seen beyond what would be, shape (3, N, M)
    x: FloatPicture  # from the ball's middle, in its radii, shape (1, M)
    y: FloatPicture  # likewise, shape (N, 1)

    def squared(self, patch: Patch) -> FloatPicture:
        """Return the mean squared residual of each pixel of the patch, shape of the patch."""
        whole = patch.bare.copy()
        whole[self.box] = _mean_square(self.off)
        return whole

    def contrast(self, patch: Patch) -> tuple[float, NDArray[np.bool_]]:
        """Return how far the ball stands out of the background (0 to 255), rms, at least 1.

        And which pixels are mostly ball and in the picture, shape (N, M).
        """
        inside = (self.layers[3] > 0.5) & (patch.inside[self.box] > 0)
        stands_out = _mean_square(self.layers[:3] - self.behind * self.layers[3])
        count = np.count_nonzero(inside)
        rms = math.sqrt(float(np.vdot(stands_out, inside)) / count + 1.0) if count else 1.0
        return rms, inside

    def misfit(self, patch: Patch) -> float:
        """Return the misfit of `Placing`; infinite where no ball is in the picture."""
        contrast, inside = self.contrast(patch)
        count = np.count_nonzero(inside)
        if not count:
            return math.inf
        # A pixel of compressed films has a standard deviation of 4 (of 255): no misfit of the ball.
        squared = float(np.vdot(_mean_square(self.off), inside)) / count
        return math.sqrt(max(squared - 4.0**2, 0.0)) / contrast

    def jacobian(self, radius: float, room: FloatPicture) -> FloatPicture:
        """Differentiate by the values of `draw_ball`, (6, 3, N M); `radius` in patch px.

        It lies in `room`, as memory costs more to get than to fill; and pixels lie in one row, as
        many short ones cost more.
        """
        tall, wide = self.layers.shape[1:]
        layers, behind = self.layers.reshape(4, -1), self.behind.reshape(3, -1)
        slopes = room[-8 * layers.shape[1] :].reshape(2, 4, -1)  # central differences, doubled
        np.subtract(layers[:, 2:], layers[:, :-2], out=slopes[0, :, 1:-1])
        slopes[0].reshape(4, tall, wide)[:, :, [0, -1]] = 0
        np.subtract(layers[:, 2 * wide :], layers[:, : -2 * wide], out=slopes[1, :, wide:-wide])
        slopes[1].reshape(4, tall, wide)[:, [0, -1]] = 0
        rows = room[: 6 * behind.size].reshape(6, 3, -1)
        np.multiply(behind, slopes[:, 3:], out=rows[:2])
        rows[:2] -= slopes[:, :3]
        rows[:2] *= np.float32(0.5)
        x, y = np.tile(self.x[0], tall), np.repeat(self.y[:, 0], wide)
        np.multiply(rows[0], x * np.float32(radius), out=rows[2])
        np.multiply(rows[1], y * np.float32(radius), out=rows[3])
        rows[2] += rows[3]
        rows[3] = layers[:3]
        np.multiply(layers[:3], x, out=rows[4])
        np.multiply(layers[:3], y, out=rows[5])
        return rows


def draw_ball(layers: FloatPicture, radius: float, patch: Patch, values: Array) -> DrawnBall | None:
    """Render the ball as it would be seen; None out of the patch.

    What the patch shows beyond a box around the ball does not depend on it. `values` (6,).
    """
    import cv2

    x_px, y_px, growth, light, sideways, downward = values.tolist()
    side = patch.bare.shape[0]
    grow = math.exp(growth)
    size = radius * grow
    half = math.ceil(size) + 4  # around the ball: its edge is soft, and grows with it [px]
    left, right = max(round(x_px) - half, 0), min(round(x_px) + half + 1, side)
    top, bottom = max(round(y_px) - half, 0), min(round(y_px) + half + 1, side)
    if left >= right or top >= bottom:
        return None
    box = slice(top, bottom), slice(left, right)
    middle = grow * (layers.shape[0] - 1) / 2
    move = np.array([[grow, 0.0, x_px - middle - left], [0.0, grow, y_px - middle - top]])
    warped = cv2.warpAffine(layers, move, (right - left, bottom - top), flags=cv2.INTER_LINEAR)
    drawn = np.ascontiguousarray(np.asarray(warped, np.float32).transpose(2, 0, 1))
    x = np.arange(left - x_px, right - x_px - 0.5, dtype=np.float32)[None] / np.float32(size)
    y = np.arange(top - y_px, bottom - y_px - 0.5, dtype=np.float32)[:, None] / np.float32(size)
    drawn[:3] *= np.float32(1 + light) + np.float32(sideways) * x + np.float32(downward) * y
    behind = np.ascontiguousarray(patch.behind[:, box[0], box[1]])
    off = behind * drawn[3]
    off -= drawn[:3]
    off += patch.apart[:, box[0], box[1]]
    if patch.is_cut:
        off *= patch.inside[box]
    return DrawnBall(box, drawn, behind, off, x, y)


def unlike(layers: FloatPicture, radius: float, patch: Patch, values: Array) -> float:
    """Return how much of what is seen a drawn ball leaves, each residual counting 1 at most."""
    drawn = draw_ball(layers, radius, patch, values)
    off = patch.bare if drawn is None else drawn.squared(patch)
    return float((off / (off + _LARGE**2)).sum())


def best_start(layers: FloatPicture, radius: float, patch: Patch, start: Array) -> Array:
    """Return the best by `unlike` of a few starts around one that is off by a part of the ball."""
    tried = start + _STARTS * np.array([radius, radius, 1.0, 0.0, 0.0, 0.0])
    return min(tried, key=lambda values: unlike(layers, radius, patch, values))


def fit_ball(
    layers: FloatPicture,
    radius: float,
    patch: Patch,
    start: Array,
    growth: float,
    at_first: float = 4.0,
) -> tuple[Array, float]:
    """Fit position, log size and light on the ball by reweighted Gauss-Newton steps.

    Returns them, and the misfit, see `Placing`; infinite where no ball is in the picture. Each step
    re-estimates the noise, and weighs residuals by Geman and McClure's function. `growth`
    is the prior mean of the log size, `at_first` a factor on the residuals that count little,
    before the first step: 4 from a start that may be far off. What is no ball after the first steps
    that count no larger ones is left as it is.
    """
    import cv2

    values = start.copy()
    expected = np.array([0.0, 0.0, growth, 0.0, 0.0, 0.0])
    drawn = draw_ball(layers, radius, patch, values)
    if drawn is None:
        return values, np.inf
    strict = max(_LARGE, _LARGE_FRACTION * drawn.contrast(patch)[0])
    strictly = 0
    room = _ROOM.of(36 * patch.bare.size)
    for turn in range(10):  # most steps of Gauss-Newton
        squared = drawn.squared(patch)
        large = strict * max(1.0, at_first * _STRICTER**turn)
        weight = patch.inside / np.square(1 + squared * np.float32(large**-2))
        noise = max(float(np.vdot(weight, squared)) / (float(weight.sum()) + 1e-9), 1.0)
        jacobian = drawn.jacobian(radius, room).reshape(18, -1)
        weighted = room[jacobian.size : 2 * jacobian.size].reshape(18, -1)
        np.multiply(jacobian, weight[drawn.box].reshape(-1), out=weighted)
        weighted = weighted.reshape(6, -1)
        normal = (weighted @ jacobian.reshape(6, -1).T).astype(np.float64)
        towards = (weighted @ drawn.off.reshape(-1)).astype(np.float64)
        prior = 3 * noise * _PRIOR  # a pixel's three colours err alike: as one
        normal.flat[::7] += prior + _MIN_CURVATURE  # its diagonal
        towards -= prior * (values - expected)
        step = cv2.solve(normal, towards[:, None], flags=cv2.DECOMP_CHOLESKY)[1][:, 0]
        moved = math.hypot(step[0], step[1])
        step[:2] *= min(1.0, _MAX_STEP * radius / (moved + 1e-9))
        step[2] = min(max(step[2], -_MAX_GROWTH), _MAX_GROWTH)
        values = values + step
        drawn = draw_ball(layers, radius, patch, values)
        if drawn is None:
            return values, np.inf
        if large > strict:
            continue
        strictly += 1
        # A shorter step is the last: OpenCV moves pictures by whole 32nds of a pixel [px]
        if max(abs(step[0]), abs(step[1])) < 0.03:
            break
        if strictly == 2 and drawn.misfit(patch) > _NO_BALL:
            break
    return values, drawn.misfit(patch)


# ---- Fits of the appearance to pictures, and learning it from them

# Pictures of the ball: the median of fewer is one of them, with what was behind it.
_MIN_SAMPLES = 3
_ENOUGH = 0.3  # misfit of a `Placing` below which nothing better is looked for
_RING_PX = 0.5  # half the width of a ring, and the step from one to the next


@dataclass(frozen=True)
class Placing:
    """Fit of the ball's appearance to one picture."""

    x: float  # of its centre [px]
    y: float
    radius_px: float  # of its outline
    misfit: float  # rms residual inside it, but for noise, over how far it stands out; 0 is perfect

    def is_near(self, x: float, y: float) -> bool:
        """Return whether a position [px] is about this one, of the same ball."""
        return math.hypot(x - self.x, y - self.y) < 0.3 * self.radius_px


@dataclass(frozen=True, eq=False)
class Appearance:
    """Template of the ball."""

    # Its colours (0 to 255) times its fraction of each pixel, and that fraction, shape (N, N, 4).
    layers: FloatPicture
    radius_px: float  # of its outline, in the pictures
    zoom: float  # its pixels per pixel of the pictures

    def place(
        self, x: float, y: float, patch: Patch, start: Array, known: Sequence[Placing]
    ) -> Placing | None:
        """Fit the ball near (x, y) [px]; None where none is in view, or none that is not known.

        What comes to one of the `known` fits from other starts, or is far worse, is dropped.
        """
        radius, growth = self.radius_px * self.zoom, float(start[2])
        values, misfit = fit_ball(self.layers, radius, patch, start, growth, at_first=1.6)
        if misfit > 0.12:  # the start was not about right
            here = patch.there(values[0], values[1])
            # One that is half as bad again as another fit is not looked into.
            if any(misfit > 1.5 * fit.misfit or fit.is_near(*here) for fit in known):
                return None
            start = best_start(self.layers, radius, patch, start)
            values, misfit = fit_ball(self.layers, radius, patch, start, growth)
            here = patch.there(values[0], values[1])
            if any(fit.is_near(*here) and misfit > fit.misfit for fit in known):
                return None
        # A good one that moved a quarter of a radius is run once more from where it ended.
        if misfit < _ENOUGH and math.hypot(*(values - start)[:2]) > 0.25 * radius:
            values, misfit = fit_ball(self.layers, radius, patch, values, growth)
        px, py = patch.there(values[0], values[1])
        # What is farther off than 1.2 radii and 2 px has another start.
        if math.hypot(px - x, py - y) > 1.2 * self.radius_px * math.exp(growth) + 2.0:
            return None
        return Placing(px, py, self.radius_px * math.exp(values[2]), misfit)


def learn_appearance(
    samples: Sequence[Picture], background: Background, places_px: Array, areas_px: Array
) -> Appearance | None:
    """Learn the ball's picture and radius, in turn with its exact positions.

    `samples` (H, W, 3), `places_px` (N, 2), `areas_px` (N,) [px²].
    """
    known = np.flatnonzero(np.isfinite(places_px[:, 0]) & np.isfinite(areas_px))
    if len(known) < _MIN_SAMPLES:
        return None
    # Quantile of the radii of what moved: a part of the ball may look like the background
    radius = float(np.quantile(np.sqrt(areas_px[known] / np.pi), 0.7))
    positions = {int(at): (float(places_px[at, 0]), float(places_px[at, 1]), 0.0) for at in known}
    gains = {at: background.gain(samples[at]) for at in positions}
    ball: Appearance | None = None
    for turn in range(4):  # rounds of learning how it looks and fitting that, at most
        # A larger ball is reduced to that radius before it is fitted [px]
        zoom = min(1.0, 9.0 / radius)
        patches, starts, used = [], [], []
        for at, (x, y, growth) in positions.items():
            # Radii of patches over that of the ball: it may be larger than it was thought
            patch = cut_patch(samples[at], background, gains[at], (x, y), 1.3 * radius, zoom)
            if patch is not None:
                patches.append(patch)
                starts.append(np.array([*patch.here(x, y), growth, 0.0, 0.0, 0.0]))
                used.append(at)
        if len(patches) < _MIN_SAMPLES:
            return None
        before, ball = ball, Appearance(_layers(patches, starts, radius * zoom), radius, zoom)
        # Relative change of the radius that ends them
        if before is not None and abs(before.radius_px / radius - 1) < 0.01:
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
    # The colour at the edge is half background's: that of the ring 1.2 px within goes on to it.
    inward = np.minimum(1.0, max(radius - 1.2, 0.5) / np.maximum(apart, 1e-6))
    rows = np.clip(np.round(y * inward + (side - 1) / 2).astype(int), 0, side - 1)
    columns = np.clip(np.round(x * inward + (side - 1) / 2).astype(int), 0, side - 1)
    return np.concatenate([colours[rows, columns] * fraction, fraction], axis=2).astype(np.float32)


def _outline(patches: Sequence[Patch], fits: Sequence[Array], radius: float) -> float:
    """Measure the ball's radius in its own pixels: to where as often as not it is what differs."""
    side = 2 * int(np.ceil(1.6 * radius + 3)) + 1
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    apart = np.hypot(x, y)
    pairs = list(zip(patches, fits, strict=True))
    straight = [_straightened(patch.seen, fit, side) for patch, fit in pairs]
    inner = np.median([seen[apart < 0.8 * radius] for seen in straight], axis=0).mean(axis=0)
    fractions = []
    for seen, (patch, fit) in zip(straight, pairs, strict=True):
        behind = _straightened(patch.behind, fit, side)
        towards = inner - behind
        size = (towards**2).sum(axis=2)
        fraction = ((seen - behind) * towards).sum(axis=2) / (size + 1.0)
        # With less difference of two colours, 12 in each channel, it cannot be said how much of a
        # pixel is ball.
        fractions.append(np.where(size > 400.0, np.clip(fraction, 0, 1), np.nan))
    with np.errstate(invalid="ignore"):
        stack = np.array(fractions)
        enough = np.isfinite(stack).sum(axis=0) >= min(_MIN_SAMPLES, len(stack))
        middle = np.where(enough, np.nanmedian(np.where(enough, stack, 0.0), axis=0), np.nan)
    rings = np.arange(0.5 * radius, 1.5 * radius + 1, _RING_PX)
    profile = []
    for ring in rings:
        values = middle[np.abs(apart - ring) < _RING_PX]
        values = values[np.isfinite(values)]
        profile.append(float(np.median(values)) if len(values) >= 4 else np.nan)
    known = np.isfinite(profile)
    below = np.flatnonzero(known & (np.array(profile) < 0.5))
    if not len(below) or below[0] == 0:
        return radius
    at = int(below[0])
    high, low = profile[at - 1], profile[at]
    part = (high - 0.5) / (high - low) if np.isfinite(high) and high > low else 0.5
    outline = rings[at - 1] + _RING_PX * part
    # The patch shows no more.
    return float(np.clip(outline, 0.75 * radius, 1.35 * radius))


def _straightened(picture: FloatPicture, values: Array, side: int) -> FloatPicture:
    """Warp a patch (3, N, N) to (side, side, 3), the ball in its middle and at its usual size."""
    import cv2

    x, y, growth = values[:3]
    grow = float(np.exp(growth))
    middle = (side - 1) / 2
    turn = np.array([[grow, 0.0, x - grow * middle], [0.0, grow, y - grow * middle]])
    planes = np.ascontiguousarray(picture.transpose(1, 2, 0))
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    straight = cv2.warpAffine(
        planes, turn, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(straight, np.float32)


# ---- Detection of the ball in one picture: where it is expected, else anywhere


@dataclass(frozen=True, eq=False)
class BallDetector:
    """Detector of a ball whose appearance and approximate position are known."""

    background: Background  # without it
    ball: ColorAndSize  # its colour and size
    appearance: Appearance | None  # None where that could not be learnt
    allowed: Picture | None  # see `Pictures.allowed`

    def find(self, picture: Picture, expected_px: Array, still_px: Array) -> Blobs:
        """Find candidates in a picture: the ball where it is expected, else all like it.

        `picture` (H, W, 3), `expected_px` (2,), `still_px` (2,).
        """
        if self.appearance is None:
            return coloured_blobs(picture, self.background, self.ball, self.allowed)
        gain = self.background.gain(picture)
        around = [(float(x), float(y)) for x, y in (expected_px, still_px) if np.isfinite(x)]
        if len(around) > 1 and math.dist(*around) < self.appearance.radius_px:
            del around[1]
        placed: list[Placing] = []
        self._place(self.appearance, picture, gain, [(x, y, 1.0) for x, y in around], placed)
        if not any(fit.misfit < _ENOUGH for fit in placed):
            starts = [
                (*at, 1.0) for near in around for at in _alike(self.appearance, picture, *near)
            ]
            # Three blobs of its colour, the most alike first: x, y [px], and how much grown. They
            # may be cut, or have grown together with something else.
            found = coloured_blobs(picture, self.background, self.ball, self.allowed, gain)
            apart = np.linalg.norm(found.colours - self.ball.colour, axis=1) / COLOUR_OFF
            apart += np.abs(np.log(found.areas_px / self.ball.area_px))
            best = np.argsort(apart)[:3]
            grown = np.clip(np.sqrt(found.areas_px[best] / self.ball.area_px), 0.65, 1.5)
            starts += np.column_stack([found.places_px[best], grown]).tolist()
            # Each start costs some milliseconds: five at most.
            self._place(self.appearance, picture, gain, starts, placed, most=5)
        # What was placed, as candidates; its colour is that of a square that lies within the ball.
        height, width = picture.shape[:2]
        positions = np.array([(fit.x, fit.y) for fit in placed]).reshape(-1, 2)
        radii = np.array([fit.radius_px for fit in placed])
        colours = np.zeros((len(placed), 3))
        for at, fit in enumerate(placed):
            half = max(1, round(0.6 * fit.radius_px))
            rows = slice(max(round(fit.y) - half, 0), round(fit.y) + half + 1)
            columns = slice(max(round(fit.x) - half, 0), round(fit.x) + half + 1)
            part = picture[rows, columns]
            if part.size:
                colours[at] = part.reshape(-1, 3).mean(axis=0)
        far = np.array([width, height]) - 1 - radii[:, None]
        whole = np.array(np.all((positions >= radii[:, None]) & (positions <= far), axis=1))
        misfits = np.array([fit.misfit for fit in placed])
        return Blobs(positions, np.pi * radii**2, colours, whole, misfits)

    def _place(
        self,
        ball: Appearance,
        picture: Picture,
        gain: float,
        places: Sequence[tuple[float, float, float]],
        placed: list[Placing],
        most: int | None = None,
    ) -> None:
        """Fit the ball near places (x, y [px], radius over the ball's) until one is sure.

        With `most`, near those that are most alike. Each place that is found and allowed is added
        to those `placed`, once.
        """
        starts: list[tuple[float, float, Patch, Array]] = []
        for x, y, grown in places:
            reach_px = ball.radius_px * grown
            patch = cut_patch(picture, self.background, gain, (x, y), reach_px, ball.zoom)
            if patch is not None:
                values = np.array([*patch.here(x, y), math.log(grown), 0.0, 0.0, 0.0])
                starts.append((x, y, patch, values))
        if most is not None:  # the fraction of what is seen around that a ball does not explain
            radius = ball.radius_px * ball.zoom
            starts.sort(key=lambda one: unlike(ball.layers, radius, *one[2:]) / one[2].inside.size)
        for start in starts[:most]:
            fit = ball.place(*start, placed)
            if fit is None:
                continue
            if self.allowed is not None:
                (height, width), row, column = self.allowed.shape, round(fit.y), round(fit.x)
                inside = 0 <= row < height and 0 <= column < width
                if not (inside and self.allowed[row, column]):
                    continue
            if not any(other.is_near(fit.x, fit.y) for other in placed):
                placed.append(fit)
            if any(known.misfit < _ENOUGH for known in placed):
                break


def _alike(ball: Appearance, picture: Picture, x: float, y: float) -> list[tuple[float, float]]:
    """Match the masked ball near a position, in a reduced picture: x and y [px], best first."""
    import cv2

    # Ball radii around a position in which to look for what is like the ball
    half = int(np.ceil(5.0 * ball.radius_px)) + 2
    left, top = max(round(x) - half, 0), max(round(y) - half, 0)
    part = picture[top : max(round(y) + half + 1, 0), left : max(round(x) + half + 1, 0)]
    # A larger ball is reduced to a radius of 4 px; places that are found are as far apart.
    coarse, near = min(1.0, 4.0 / ball.radius_px), 4
    own = ball.layers
    side = max(3, round(own.shape[0] * (coarse / ball.zoom)))
    if side < own.shape[0]:
        reduced = cv2.resize(own, (side, side), interpolation=cv2.INTER_AREA)
        own = np.asarray(reduced, np.float32)
    size = (round(part.shape[1] * coarse), round(part.shape[0] * coarse))
    if min(size) <= own.shape[0]:
        return []
    small = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.float32)
    fraction = np.repeat(own[:, :, 3:], 3, axis=2)
    colours = own[:, :, :3] / np.maximum(fraction, 1e-3)
    off = np.array(cv2.matchTemplate(small, colours, cv2.TM_SQDIFF, mask=fraction))
    found = []
    middle = (own.shape[0] - 1) / 2
    # Places there: a shadow or a reflection may be more like the ball than the ball
    for _ in range(2):
        row, column = np.unravel_index(int(off.argmin()), off.shape)
        x_px = (column + middle + 0.5) / coarse - 0.5 + left
        y_px = (row + middle + 0.5) / coarse - 0.5 + top
        found.append((x_px, y_px))
        rows = slice(max(row - near, 0), row + near + 1)
        off[rows, max(column - near, 0) : column + near + 1] = np.inf
    return found
