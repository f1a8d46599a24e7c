"""Where the ball is to a small part of a pixel: its own picture, laid over the background, fitted.

A pixel is background B and ball P in the shares that the ball's outline gives: (1 - a) B + a P. The
ball's picture moves and grows until that is what is seen. So a ball that looks like a part of what is
behind it, its shadow, its reflection and a hand that holds it do not pull its centre: they are
residuals, and those that are large count little (Geman and McClure's weights).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.observe.tracking.background import Background

Picture = NDArray[np.uint8]
Array = NDArray[np.float64]
Fine = NDArray[np.float32]

_FINE_PX = 9.0
"""A larger ball is reduced to that radius before it is fitted."""

_REACH = 1.6
_MOST_STEPS = 10
_ENOUGH_PX = 0.01
_LARGE, _LARGE_SHARE, _AT_FIRST, _STRICTER = 30.0, 0.35, 4.0, 0.65
"""Residuals that count little: at first only the largest, or there would be no pull to the edge."""

_PRIOR = np.diag([0.0, 0.0, 0.25**-2, 0.2**-2, 0.2**-2, 0.2**-2])
"""Of the growth, and of the light: as a whole, to the right and downward."""

_LEAST_SAMPLES = 3
_TELLING = 400.0
_ROUNDS = 5
_SURROUNDINGS = 5.0
_STARTS = ((0, 0, 0.0), (1, 0, 0.0), (-1, 0, 0.0), (0, 1, 0.0), (0, -1, 0.0), (0, 0, 0.2), (0, 0, -0.2))
_COARSE_PX = 4.0


@dataclass(frozen=True)
class Placing:
    """A place of the ball in one picture.

    Attributes:
        x, y: of its centre [px].
        radius_px: of its outline.
        misfit: rms residual inside it over how far it stands out; 0 is a perfect fit.
    """

    x: float
    y: float
    radius_px: float
    misfit: float


@dataclass(frozen=True, eq=False)
class _Patch:
    """A part of a picture and of the background, reduced.

    Attributes:
        seen, behind: shape (N, N, 3).
        inside: 1 where it is in the picture, shape (N, N).
        left, top: of its first pixel, in the picture.
        zoom: its pixels for one of the picture.
    """

    seen: Fine
    behind: Fine
    inside: Fine
    left: int
    top: int
    zoom: float

    def here(self, x: float, y: float) -> tuple[float, float]:
        """A place of the picture in the patch."""
        z = self.zoom
        return (x - self.left + 0.5) * z - 0.5, (y - self.top + 0.5) * z - 0.5

    def there(self, x: float, y: float) -> tuple[float, float]:
        """A place of the patch in the picture."""
        z = self.zoom
        return (x + 0.5) / z - 0.5 + self.left, (y + 0.5) / z - 0.5 + self.top


@dataclass(frozen=True, eq=False)
class Appearance:
    """The ball's own picture.

    Attributes:
        layers: its colours times its share of each pixel, and that share, shape (N, N, 4).
        radius_px: of its outline, in the pictures.
        zoom: its pixels for one of the pictures.
    """

    layers: Fine
    radius_px: float
    zoom: float

    def place(
        self, picture: Picture, background: Background, gain: float, x: float, y: float, grown: float = 1.0
    ) -> Placing | None:
        """The ball near a place; None where there is none in view.

        Args:
            picture: where it is looked for.
            background: behind it.
            gain: how much brighter the background is than the picture.
            x: near its centre [px].
            y: likewise.
            grown: about its radius over `radius_px`.
        """
        patch = _cut(picture, background, gain, (x, y), self.radius_px * grown, self.zoom)
        if patch is None:
            return None
        start = np.array([*patch.here(x, y), np.log(grown), 0.0, 0.0, 0.0])
        start = self._nearest(patch, start)
        values, misfit = self._fit(patch, start, np.log(grown))
        px, py = patch.there(values[0], values[1])
        if np.hypot(px - x, py - y) > 1.2 * self.radius_px * grown + 2:
            return None
        return Placing(px, py, self.radius_px * float(np.exp(values[2])), misfit)

    def alike(self, picture: Picture, x: float, y: float) -> list[tuple[float, float]]:
        """Where in the surroundings of a place the picture is most like the ball, the best first."""
        import cv2

        half = int(np.ceil(_SURROUNDINGS * self.radius_px)) + 2
        left, top = max(round(x) - half, 0), max(round(y) - half, 0)
        part = picture[top : max(round(y) + half + 1, 0), left : max(round(x) + half + 1, 0)]
        coarse = min(1.0, _COARSE_PX / self.radius_px)
        own = self._reduced(coarse / self.zoom)
        size = (round(part.shape[1] * coarse), round(part.shape[0] * coarse))
        if min(size) <= own.shape[0]:
            return []
        small = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.float32)
        share = np.repeat(own[:, :, 3:], 3, axis=2)
        colours = own[:, :, :3] / np.maximum(share, 1e-3)
        off = np.array(cv2.matchTemplate(small, colours, cv2.TM_SQDIFF, mask=share))
        found = []
        for _ in range(2):
            row, column = np.unravel_index(int(off.argmin()), off.shape)
            middle = (own.shape[0] - 1) / 2
            found.append(
                ((column + middle + 0.5) / coarse - 0.5 + left, (row + middle + 0.5) / coarse - 0.5 + top)
            )
            near = int(_COARSE_PX)
            off[max(row - near, 0) : row + near + 1, max(column - near, 0) : column + near + 1] = np.inf
        return found

    def _reduced(self, zoom: float) -> Fine:
        import cv2

        side = self.layers.shape[0]
        small = max(3, round(side * zoom))
        if small >= side:
            return self.layers
        return np.asarray(cv2.resize(self.layers, (small, small), interpolation=cv2.INTER_AREA))

    def _nearest(self, patch: _Patch, start: Array) -> Array:
        """The best of a few places around, for a start that is off by a part of the ball."""
        step = 0.45 * self.radius_px * self.zoom
        tried = []
        for right, down, growth in _STARTS:
            values = start + np.array([right * step, down * step, growth, 0.0, 0.0, 0.0])
            off = self._residual(patch, values)[0]
            tried.append((float((off / (off + _LARGE**2)).sum()), values))
        return min(tried, key=lambda one: one[0])[1]

    def _residual(self, patch: _Patch, values: Array) -> tuple[Fine, Fine, Fine, Fine]:
        """Squared residuals (N, N), residuals (N, N, 3), the ball's layers, where in the ball."""
        side = patch.seen.shape[0]
        layers = _moved(self.layers, values, side)
        size = np.float32(self.radius_px * self.zoom * np.exp(values[2]))
        axis = np.arange(side, dtype=np.float32)
        within = np.stack(np.meshgrid((axis - values[0]) / size, (axis - values[1]) / size))
        light = 1 + values[3] + values[4] * within[0] + values[5] * within[1]
        layers[:, :, :3] *= light.astype(np.float32)[:, :, None]
        model = patch.behind * (1 - layers[:, :, 3:]) + layers[:, :, :3]
        off = (patch.seen - model) * patch.inside[:, :, None]
        return (off**2).mean(axis=2), off, layers, within.astype(np.float32)

    def _fit(self, patch: _Patch, start: Array, growth: float) -> tuple[Array, float]:
        """Gauss-Newton steps in x, y, the logarithm of the size, and the light on the ball."""
        values = start.copy()
        expected = np.array([0.0, 0.0, growth, 0.0, 0.0, 0.0])
        radius = self.radius_px * self.zoom
        strict = max(_LARGE, _LARGE_SHARE * self._contrast(patch, self._residual(patch, values)[2]))
        for turn in range(_MOST_STEPS):
            squared, off, layers, within = self._residual(patch, values)
            large = strict * max(1.0, _AT_FIRST * _STRICTER**turn)
            weight = patch.inside / (1 + squared / large**2) ** 2
            jacobian = self._jacobian(patch, layers, within, radius)
            weighted = jacobian * np.repeat(weight.reshape(-1), 3)
            normal = (weighted @ jacobian.T).astype(np.float64)
            towards = (weighted @ off.reshape(-1)).astype(np.float64)
            noise = max(float((weight * squared).sum() / (weight.sum() + 1e-9)), 1.0)
            normal += 3 * noise * _PRIOR
            towards -= 3 * noise * _PRIOR @ (values - expected)
            normal[0, 0] += 1e-3
            normal[1, 1] += 1e-3
            step = np.linalg.solve(normal, towards)
            step[:2] *= min(1.0, 0.4 * radius / (float(np.hypot(*step[:2])) + 1e-9))
            step[2] = np.clip(step[2], -0.1, 0.1)
            values = values + step
            if large == strict and np.abs(step[:2]).max() < _ENOUGH_PX:
                break
        squared, _, layers, _ = self._residual(patch, values)
        inside = (layers[:, :, 3] > 0.5) & (patch.inside > 0)
        if not inside.any():
            return values, np.inf
        return values, float(np.sqrt(squared[inside].mean()) / self._contrast(patch, layers))

    def _contrast(self, patch: _Patch, layers: Fine) -> float:
        """How far the ball stands out, rms, at least 1."""
        inside = (layers[:, :, 3] > 0.5) & (patch.inside > 0)
        stands_out = (layers[:, :, :3] - patch.behind * layers[:, :, 3:])[inside]
        return float(np.sqrt((stands_out**2).mean() + 1.0)) if len(stands_out) else 1.0

    def _jacobian(self, patch: _Patch, layers: Fine, within: Fine, radius: float) -> Fine:
        """What each value changes, shape (6, 3 N^2)."""
        right, down = (
            patch.behind * one[:, :, 3:] - one[:, :, :3]
            for one in (_slope(layers, 1), _slope(layers, 0))
        )
        x, y = within[0][:, :, None], within[1][:, :, None]
        colours = layers[:, :, :3]
        grown = np.float32(radius) * (x * right + y * down)
        rows = (right, down, grown, colours, colours * x, colours * y)
        return np.stack([one.reshape(-1) for one in rows])


def learn_appearance(
    samples: Sequence[Picture], background: Background, places_px: Array, areas_px: Array
) -> Appearance | None:
    """The ball's picture, from pictures in which it is about known where it is.

    Args:
        samples: uint8, shape (H, W, 3) each.
        background: without the ball.
        places_px: where the ball is in each, shape (N, 2); NaN where that is not known.
        areas_px: how large it is there, shape (N,).

    Returns:
        None where it is seen too seldom.
    """
    known = np.flatnonzero(np.isfinite(places_px[:, 0]) & np.isfinite(areas_px))
    if len(known) < _LEAST_SAMPLES:
        return None
    radius = float(np.quantile(np.sqrt(areas_px[known] / np.pi), 0.7))
    places = {int(at): (float(places_px[at, 0]), float(places_px[at, 1]), 0.0) for at in known}
    gains = {at: background.gain(samples[at]) for at in places}
    ball: Appearance | None = None
    for _ in range(_ROUNDS):
        zoom = min(1.0, _FINE_PX / radius)
        patches, starts, used = [], [], []
        for at, (x, y, growth) in places.items():
            patch = _cut(samples[at], background, gains[at], (x, y), 1.3 * radius, zoom)
            if patch is not None:
                patches.append(patch)
                starts.append(np.array([*patch.here(x, y), growth, 0.0, 0.0, 0.0]))
                used.append(at)
        if len(patches) < _LEAST_SAMPLES:
            return None
        ball = Appearance(_layers(patches, starts, radius * zoom), radius, zoom)
        fitted = [
            ball._fit(one, ball._nearest(one, start), 0.0)[0]
            for one, start in zip(patches, starts, strict=True)
        ]
        middle = float(np.median([values[2] for values in fitted]))
        for values in fitted:
            values[2] -= middle
        radius = _outline(patches, fitted, radius * zoom) * float(np.exp(middle)) / zoom
        for at, patch, values in zip(used, patches, fitted, strict=True):
            places[at] = (*patch.there(values[0], values[1]), float(values[2]))
    return ball


def _cut(
    picture: Picture,
    background: Background,
    gain: float,
    place: tuple[float, float],
    radius_px: float,
    zoom: float,
) -> _Patch | None:
    import cv2

    half = int(np.ceil(_REACH * radius_px)) + 3
    height, width = picture.shape[:2]
    left, top = round(place[0]) - half, round(place[1]) - half
    side = 2 * half + 1
    if left + side <= 0 or top + side <= 0 or left >= width or top >= height:
        return None
    box = slice(max(top, 0), min(top + side, height)), slice(max(left, 0), min(left + side, width))
    outside = (
        box[0].start - top,
        top + side - box[0].stop,
        box[1].start - left,
        left + side - box[1].stop,
    )
    small = max(5, round(side * zoom))
    inside = np.ones((box[0].stop - box[0].start, box[1].stop - box[1].start), np.float32)
    parts: list[Fine] = []
    for part in (picture[box] * np.float32(gain), background.picture[box].astype(np.float32), inside):
        if max(outside):
            part = np.asarray(cv2.copyMakeBorder(part, *outside, cv2.BORDER_CONSTANT))
        if small != side:
            part = np.asarray(cv2.resize(part, (small, small), interpolation=cv2.INTER_AREA))
        parts.append(part)
    return _Patch(parts[0], parts[1], (parts[2] > 0.99).astype(np.float32), left, top, small / side)


def _moved(layers: Fine, values: Array, side: int) -> Fine:
    """The ball's layers with its middle at x, y, grown, as `side` by `side` pixels."""
    import cv2

    x, y, growth = values[:3]
    grow = float(np.exp(growth))
    middle = (layers.shape[0] - 1) / 2
    turn = np.array([[grow, 0.0, x - grow * middle], [0.0, grow, y - grow * middle]])
    return np.asarray(cv2.warpAffine(layers, turn, (side, side), flags=cv2.INTER_LINEAR), np.float32)


def _slope(layers: Fine, axis: int) -> Fine:
    """Central differences."""
    slope = np.zeros_like(layers)
    if axis == 0:
        slope[1:-1] = (layers[2:] - layers[:-2]) / 2
    else:
        slope[:, 1:-1] = (layers[:, 2:] - layers[:, :-2]) / 2
    return slope


def _straightened(picture: Fine, values: Array, side: int) -> Fine:
    """A patch with the ball in its middle and at its usual size."""
    import cv2

    x, y, growth = values[:3]
    grow = float(np.exp(growth))
    middle = (side - 1) / 2
    turn = np.array([[grow, 0.0, x - grow * middle], [0.0, grow, y - grow * middle]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(picture, turn, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE))


def _layers(patches: Sequence[_Patch], places: Sequence[Array], radius: float) -> Fine:
    """The median of what is seen, inside a disc with smooth edges."""
    side = 2 * int(np.ceil(radius + 2)) + 1
    seen = np.stack([_straightened(one.seen, at, side) for one, at in zip(patches, places, strict=True)])
    colours = np.median(seen, axis=0)
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    apart = np.hypot(x, y)
    share = np.clip(radius + 0.5 - apart, 0, 1)[:, :, None]
    # The colour at the edge is half background's: that of the ring within goes on to the edge.
    ring = np.maximum(apart, 1e-6)
    inward = np.minimum(1.0, max(radius - 1.2, 0.5) / ring)
    rows = np.clip(np.round(y * inward + (side - 1) / 2).astype(int), 0, side - 1)
    columns = np.clip(np.round(x * inward + (side - 1) / 2).astype(int), 0, side - 1)
    return np.concatenate([colours[rows, columns] * share, share], axis=2).astype(np.float32)


def _outline(patches: Sequence[_Patch], places: Sequence[Array], radius: float) -> float:
    """The ball's radius in its own pixels: to where as often as not it is what differs."""
    side = 2 * int(np.ceil(1.6 * radius + 3)) + 1
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    apart = np.hypot(x, y)
    inner = np.median(
        [_straightened(one.seen, at, side)[apart < 0.8 * radius] for one, at in zip(patches, places, strict=True)],
        axis=0,
    ).mean(axis=0)
    shares = []
    for one, at in zip(patches, places, strict=True):
        seen, behind = _straightened(one.seen, at, side), _straightened(one.behind, at, side)
        towards = inner - behind
        size = (towards**2).sum(axis=2)
        share = ((seen - behind) * towards).sum(axis=2) / (size + 1.0)
        shares.append(np.where(size > _TELLING, np.clip(share, 0, 1), np.nan))
    with np.errstate(invalid="ignore"):
        stack = np.array(shares)
        enough = np.isfinite(stack).sum(axis=0) >= min(3, len(stack))
        middle = np.where(enough, np.nanmedian(np.where(enough, stack, 0.0), axis=0), np.nan)
    rings = np.arange(0.5 * radius, 1.5 * radius + 1, 0.5)
    profile = []
    for ring in rings:
        values = middle[np.abs(apart - ring) < 0.5]
        values = values[np.isfinite(values)]
        profile.append(float(np.median(values)) if len(values) > 3 else np.nan)
    known = np.isfinite(profile)
    below = np.flatnonzero(known & (np.array(profile) < 0.5))
    if not len(below) or below[0] == 0:
        return radius
    at = int(below[0])
    high, low = profile[at - 1], profile[at]
    part = (high - 0.5) / (high - low) if np.isfinite(high) and high > low else 0.5
    return float(np.clip(rings[at - 1] + 0.5 * part, 0.75 * radius, 1.35 * radius))
