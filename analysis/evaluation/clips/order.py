"""Draw the content of a synthetic clip at random: the ball, rig, room and bystanders."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.evaluation.clips.ball import BallLook
from analysis.evaluation.clips.scene import Stage, draw_stage
from analysis.evaluation.clips.view import SIZES_PX, View, random_view
from analysis.evaluation.video.bouncing_ball import DroppedBall
from tunenet_logs.arrays import Array

DROP_M = (0.2, 2.0)
RESTITUTION = (0.1, 0.95)
RATES_HZ = (30.0, 120.0)  # drawn evenly: what a person films at home with a phone
EXPOSURE_S = 0.008
NOISE = 6.0  # the most: a room's light; standard deviation of a pixel, of 255
_RADIUS_M = (0.012, 0.06)  # from a marble to a small football
_FALLS = (5.0, 9.0)
_MAX_S = 4.0  # filmed after the release: so many fall times, but no longer than that
# Of 255, in the colour that differs most, on nearly all and on half of the way of the fall: what a
# person can follow.
_MIN_CONTRAST = (20.0, 30.0)


@dataclass(frozen=True)
class Hand:
    """Hand that holds the ball until it lets go, and then leaves.

    Attributes:
        colour: RGB.
        covers: whether it is before the ball; else behind.
        leaves: which way [ball radii a second], right and down.
        follows_s: how long it goes on downward with half the ball's acceleration.
        grip: where its middle is, from the ball's [ball radii], right and down.
    """

    colour: tuple[int, int, int]
    covers: bool
    leaves: tuple[float, float]
    follows_s: float
    grip: tuple[float, float]


@dataclass(frozen=True)
class Person:
    """Person who walks through behind the ball.

    Attributes:
        colours: RGB of head, body and legs.
        from_s: when, after the release.
        height: of the picture's height.
        crossing_s: from one edge to the other; negative from the right.
    """

    colours: tuple[tuple[int, int, int], ...]
    from_s: float
    height: float
    crossing_s: float


@dataclass(frozen=True, eq=False)
class ClipOrder:
    """Specification of one clip.

    Attributes:
        ball: what falls.
        view: where from.
        stage: what is behind it.
        look: of the ball.
        rate_hz: frames a second.
        held_s: from the first frame to the release.
        length_s: from the release to the last frame.
        exposure_s: how long the shutter is open, centred on a frame's stamp.
        noise: standard deviation of a pixel, of 255.
        flicker: amplitude of a lamp's at twice the mains.
        hand: None where the ball is held by nothing that shows.
        person: None where nobody comes.
        as_log: recorded to MCAP as JPEGs; else to mp4 as H.264.
        jpeg_quality: of 100.
        h264_factor: constant rate factor; smaller is better.
        pixel_seed: draws the noise.
        heights_m: of the ball over its contact at times after the release, shape (T,), where they
            are not what `ball` does by itself.
    """

    ball: DroppedBall
    view: View
    stage: Stage
    look: BallLook
    rate_hz: float
    held_s: float
    length_s: float
    exposure_s: float
    noise: float
    flicker: float
    hand: Hand | None
    person: Person | None
    as_log: bool
    jpeg_quality: int
    h264_factor: int
    pixel_seed: int
    heights_m: Callable[[Array], Array] | None = None


def draw_clip(seed: int, index: int) -> ClipOrder:
    """Draw the clip of that number; the same numbers give the same clip."""
    rng = np.random.default_rng([seed, index, 0xC11B])
    ball = DroppedBall(float(rng.uniform(*DROP_M)), float(rng.uniform(*RESTITUTION)))
    return draw_clip_of(ball, rng)


def draw_clip_of(
    ball: DroppedBall, rng: np.random.Generator, sizes_px: Sequence[tuple[int, int]] = SIZES_PX
) -> ClipOrder:
    """Draw a clip of this ball, with images of one of these sizes."""
    while True:
        radius_m = float(rng.uniform(*_RADIUS_M))
        view = random_view(rng, ball.drop_m, radius_m, sizes_px)
        if view is not None:
            break
    stage = draw_stage(view, ball.drop_m, rng)
    look = _visible_look(rng, radius_m, view, stage, ball)
    fall_s = ball.fall_s
    rate_hz = float(rng.choice([30.0, 60.0, 120.0, rng.uniform(*RATES_HZ)]))
    return ClipOrder(
        ball=ball,
        view=view,
        stage=stage,
        look=look,
        rate_hz=rate_hz,
        held_s=float(rng.uniform(0.1, 0.8)),
        length_s=float(min(rng.uniform(*_FALLS) * fall_s + 0.3, _MAX_S)),
        exposure_s=float(rng.uniform(0.0, min(EXPOSURE_S, 0.95 / rate_hz))),
        noise=float(rng.uniform(0.0, NOISE)),
        flicker=float(rng.choice([0.0, 0.0, 0.0, rng.uniform(0.0, 0.03)])),
        hand=_hand(rng) if rng.random() < 0.65 else None,
        person=_person(rng, fall_s) if rng.random() < 0.15 else None,
        as_log=bool(rng.random() < 0.3),
        jpeg_quality=int(rng.integers(80, 96)),
        h264_factor=int(rng.integers(16, 24)),
        pixel_seed=int(rng.integers(2**31)),
    )


def _visible_look(
    rng: np.random.Generator, radius_m: float, view: View, stage: Stage, ball: DroppedBall
) -> BallLook:
    """Draw a ball with enough contrast to its background for a person to follow it."""
    heights = radius_m + ball.drop_m * np.linspace(0.0, 1.0, 9)
    places = np.column_stack([np.zeros((9, 2)), heights])
    columns, rows = np.round(view.image_from_world(places)).astype(int).T
    behind = stage.picture[rows, columns].astype(np.float64)
    look = _look(rng, radius_m)
    while True:
        mean = np.array(look.colour) * (look.ambient + 0.5 * (1 - look.ambient))
        apart = np.quantile(np.abs(behind - mean).max(axis=1), [0.15, 0.5])
        if (apart > _MIN_CONTRAST).all():
            return look
        look = replace(look, colour=_ball_colour(rng))


def _look(rng: np.random.Generator, radius_m: float) -> BallLook:
    light = np.array([rng.uniform(-0.9, 0.4), rng.uniform(-0.6, 0.6), 1.0])
    light /= np.linalg.norm(light)
    return BallLook(
        radius_m=radius_m,
        colour=_ball_colour(rng),
        light=(float(light[0]), float(light[1]), float(light[2])),
        ambient=float(rng.uniform(0.35, 0.8)),
        gloss=float(rng.choice([0.0, rng.uniform(0.0, 0.7)])),
        shadow=float(rng.choice([0.0, rng.uniform(0.1, 0.6), rng.uniform(0.1, 0.6)])),
        softness=float(rng.uniform(0.02, 0.3)),
        mirror=float(rng.choice([0.0, 0.0, 0.0, rng.uniform(0.05, 0.25)])),
    )


def _ball_colour(rng: np.random.Generator) -> tuple[float, float, float]:
    """Draw a colour: vivid, dull, or grey; dark and light."""
    import colorsys

    saturation = rng.choice([rng.uniform(0.0, 0.15), rng.uniform(0.15, 0.5), rng.uniform(0.5, 1)])
    red, green, blue = colorsys.hsv_to_rgb(rng.random(), float(saturation), rng.uniform(0.12, 1.0))
    return 255 * red, 255 * green, 255 * blue


def _hand(rng: np.random.Generator) -> Hand:
    tone = rng.uniform(0.3, 1.0)
    red, green, blue = (int(tone * part) for part in (225, 170, 140))
    angle = rng.uniform(-2.6, -0.5)  # from above
    speed = rng.uniform(0.0, 12.0)
    away = angle + rng.normal(0.0, 0.4)
    reach = rng.uniform(0.8, 1.4)
    return Hand(
        colour=(red, green, blue),
        covers=bool(rng.random() < 0.5),
        leaves=(float(speed * np.cos(away)), float(speed * np.sin(away))),
        follows_s=float(rng.choice([0.0, 0.0, rng.uniform(0.0, 0.15)])),
        grip=(float(reach * np.cos(angle)), float(reach * np.sin(angle))),
    )


def _person(rng: np.random.Generator, fall_s: float) -> Person:
    colours = rng.integers(20, 220, (3, 3))
    return Person(
        colours=tuple((int(red), int(green), int(blue)) for red, green, blue in colours),
        from_s=float(fall_s * rng.uniform(1.5, 4.0)),
        height=float(rng.uniform(0.5, 1.1)),
        crossing_s=float(rng.choice([-1, 1]) * rng.uniform(1.5, 4.0)),
    )
