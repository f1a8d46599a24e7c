"""Render a synthetic clip, frame by frame, with the true position of its ball."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from analysis.evaluation.clips.ball import add_ball
from analysis.evaluation.clips.order import ClipOrder, Hand, Person
from analysis.evaluation.video.bouncing_ball import GRAVITY_M_S2, drop_ball
from tunenet_logs.arrays import Array, Picture

_MAX_SUBFRAMES = 16  # positions of the ball while a shutter is open: enough for a smooth streak
# A ball that moves less while the shutter is open is drawn once, one that moves more 16 times, and
# every other one four times.
_STILL_PX, _FAST_PX = 0.2, 4.0

_MAINS_HZ = 50.0  # Europe's: lamps flicker at twice this
_NOISE_PICTURES = 3  # drawing noise for each frame anew would take longer than all the rest
_NOISE_MARGIN_PX = 64  # by how much a noise picture is larger than a frame, to be cut out anywhere
_MIN_NOISE = 0.05  # of 255: less would be rounded away


def frame_seconds(order: ClipOrder) -> Array:
    """Return the times of the frames after the release, shape (T,)."""
    count = int((order.held_s + order.length_s) * order.rate_hz)
    return np.arange(count) / order.rate_hz - order.held_s


def centers_m(order: ClipOrder, seconds: Array) -> Array:
    """Return the ball's centre in the world, shape (T, 3) [m], at `seconds` after the release."""
    if order.heights_m is not None:
        up = order.heights_m(seconds) + order.look.radius_m
    else:
        up = drop_ball(order.ball, seconds).heights_m + order.look.radius_m
    return np.column_stack([np.zeros((len(up), 2)), up])


def places_px(order: ClipOrder) -> Array:
    """Project the ball's centre into each frame at its stamp, shape (T, 2) [px]."""
    return order.view.image_from_world(centers_m(order, frame_seconds(order)))


def clip_frames(order: ClipOrder) -> Iterator[Picture]:
    """Yield the frames, RGB, uint8, shape (H, W, 3)."""
    import cv2

    seconds = frame_seconds(order)
    exposed = _exposed(order, seconds)
    noise = SensorNoise(np.random.default_rng(order.pixel_seed), order.view.size_px, order.noise)
    for centers, second in zip(exposed, seconds.tolist(), strict=True):
        frame = order.stage.picture.copy()
        if order.person is not None:
            _add_person(frame, order.person, second)
        hand = order.hand
        if hand is not None and not hand.covers:
            _add_hand(frame, order, hand, second)
        add_ball(frame, order.view, order.stage, order.look, centers)
        if hand is not None and hand.covers:
            _add_hand(frame, order, hand, second)
        if order.flicker:
            gain = 1 + order.flicker * np.sin(4 * np.pi * _MAINS_HZ * second)
            frame = np.asarray(cv2.convertScaleAbs(frame, alpha=gain), np.uint8)
        yield noise.added_to(frame)


def _exposed(order: ClipOrder, seconds: Array) -> list[Array]:
    """Return the ball's centres during each frame's exposure, shape (1, 4 or 16, 3) [m] each."""
    offsets = (np.arange(_MAX_SUBFRAMES) + 0.5) / _MAX_SUBFRAMES - 0.5
    fine = (seconds[:, None] + offsets * order.exposure_s).ravel()
    centers = centers_m(order, fine)
    pixels = order.view.image_from_world(centers).reshape(len(seconds), _MAX_SUBFRAMES, 2)
    centers = centers.reshape(len(seconds), _MAX_SUBFRAMES, 3)
    ways = np.linalg.norm(np.diff(pixels, axis=1), axis=2).sum(axis=1)
    chosen = []
    for way_px, positions in zip(ways.tolist(), centers, strict=True):
        if way_px < _STILL_PX:
            chosen.append(positions[_MAX_SUBFRAMES // 2][None])
        else:
            chosen.append(positions if way_px > _FAST_PX else positions[1::4])
    return chosen


class SensorNoise:
    """White sensor noise of std `noise` of 255: a few noise images, from random corners."""

    def __init__(self, rng: np.random.Generator, size_px: tuple[int, int], noise: float) -> None:
        self._rng = rng
        self._width, self._height = size_px
        shape = (self._height + _NOISE_MARGIN_PX, self._width + _NOISE_MARGIN_PX, 3)
        self._pictures = [
            np.round(rng.standard_normal(shape, np.float32) * noise).astype(np.int16)
            for _ in range(_NOISE_PICTURES if noise > _MIN_NOISE else 0)
        ]

    def added_to(self, frame: Picture) -> Picture:
        """Add noise to a copy of the frame."""
        import cv2

        if not self._pictures:
            return frame
        picture = self._pictures[int(self._rng.integers(len(self._pictures)))]
        top, left = self._rng.integers(_NOISE_MARGIN_PX, size=2)
        noise = picture[top : top + self._height, left : left + self._width]
        return np.asarray(cv2.add(frame, noise, dtype=cv2.CV_8U), np.uint8)


def _add_hand(frame: Picture, order: ClipOrder, hand: Hand, second: float) -> None:
    """Draw a palm with an arm that comes from beyond the image's edge."""
    import cv2

    start = centers_m(order, np.array([0.0]))
    x, y = order.view.image_from_world(start)[0]
    radius = float(order.view.camera.radius_px(start, order.look.radius_m)[0])
    after = max(second, 0.0)
    x, y = x + radius * (hand.grip[0]), y + radius * hand.grip[1]
    together = min(after, hand.follows_s)
    low = start - np.array([0.0, 0.0, GRAVITY_M_S2 * together**2 / 4])
    y += float(order.view.image_from_world(low)[0, 1] - order.view.image_from_world(start)[0, 1])
    away = max(after - hand.follows_s, 0.0)
    x, y = x + radius * hand.leaves[0] * away, y + radius * hand.leaves[1] * away
    reach = 4 * max(frame.shape[:2])
    length = np.hypot(*hand.grip)
    far = (x + reach * hand.grip[0] / length, y + reach * hand.grip[1] / length)
    palm = (round(16 * float(x)), round(16 * float(y)))
    elbow = (round(16 * float(far[0])), round(16 * float(far[1])))
    if max(map(abs, palm)) > 2**18:
        return
    thick = max(1, round(0.9 * radius))
    cv2.line(frame, palm, elbow, hand.colour, thick, cv2.LINE_AA, 4)
    axes = (round(16 * 1.0 * radius), round(16 * 0.8 * radius))
    turn = float(np.degrees(np.arctan2(hand.grip[1], hand.grip[0])))
    cv2.ellipse(frame, palm, axes, turn, 0, 360, hand.colour, -1, cv2.LINE_AA, 4)


def _add_person(frame: Picture, person: Person, second: float) -> None:
    """Draw a person walking from one edge to the other."""
    import cv2

    if second < person.from_s:
        return
    height, width = frame.shape[:2]
    tall = person.height * height
    crossed = (second - person.from_s) / abs(person.crossing_s)
    if crossed > 1:
        return
    crossed = crossed if person.crossing_s > 0 else 1 - crossed
    x = -0.2 * tall + crossed * (width + 0.4 * tall)
    foot = 0.95 * height
    swing = 0.12 * tall * float(np.sin(2 * np.pi * 0.9 * second))
    head, body, legs = person.colours
    top = foot - tall
    for side in (-1, 1):
        ends = (round(x), round(foot - 0.45 * tall)), (round(x + side * swing), round(foot))
        cv2.line(frame, *ends, legs, max(2, round(0.07 * tall)), cv2.LINE_AA)
    corners = (
        (round(x - 0.1 * tall), round(top + 0.14 * tall)),
        (
            round(x + 0.1 * tall),
            round(foot - 0.42 * tall),
        ),
    )
    cv2.rectangle(frame, *corners, body, -1)
    cv2.circle(frame, (round(x), round(top + 0.07 * tall)), round(0.07 * tall), head, -1)
