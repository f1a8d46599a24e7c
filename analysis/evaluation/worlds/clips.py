"""Render synthetic films of a dropped ball: clips of any room, and drops of the hidden world.

A ball is drawn by rays before a static scene; what is drawn at random (rig, room, hand, bystander)
is in a `ClipOrder` or a `DropFilm`. Files are as users have them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.evaluation.worlds.ball import (
    DROP_M,
    FILMED_S,
    GRAVITY_M_S2,
    HELD_S,
    MASS_KG,
    RADIUS_M,
    HiddenDrop,
    HomeDrop,
    RealBall,
    drop_ball,
)
from tunenet_logs.analysis.evaluation.worlds.camera import (
    SIZES_PX,
    View,
    drop_view,
    found_track,
    is_well_inside,
    random_view,
    upright,
)
from tunenet_logs.analysis.tracking.track import Track
from tunenet_logs.episode import Array, EpisodeInfo, Frame, Picture
from tunenet_logs.messages import CAMERA_TOPIC
from tunenet_logs.writing.writer import EpisodeWriter

# ---- Static scene: a textured floor, a wall behind it, a light.

_TEXTURE_PX = 512  # side of a texture, which is repeated

_FINER = 2  # points along each side of a pixel, whose mean is its colour (antialiasing)


@dataclass(frozen=True, eq=False)
class Stage:
    """Static part of a scene."""

    picture: Picture  # RGB, uint8, shape (H, W, 3)
    # x and y of the floor that each pixel shows, float32, shape (H, W, 2); NaN where it shows the
    # wall
    floor_m: NDArray[np.float32]


def draw_stage(view: View, drop_m: float, rng: np.random.Generator) -> Stage:
    """Render a floor and a wall of random colour, texture and light, as the camera sees them."""
    import cv2

    wall_m = drop_m * rng.uniform(0.3, 1.5)
    turn = rng.uniform(-0.6, 0.6)  # of the wall about the vertical
    floor, wall = _texture(rng), _texture(rng)
    floor_scale, wall_scale = (drop_m * rng.uniform(0.3, 1.5) / _TEXTURE_PX for _ in range(2))
    width, height = view.size_px
    offsets = (np.arange(_FINER) + 0.5) / _FINER - 0.5
    fine = ((np.arange(side)[:, None] + offsets).ravel() for side in (width, height))
    looks = view.directions(*fine) @ view.camera_from_world.astype(np.float32)
    along, at_m, is_floor = _surfaces(view, looks, wall_m, turn)
    scale = np.where(is_floor, floor_scale, wall_scale)
    columns, rows = ((along[:, :, axis] / scale).astype(np.float32) for axis in (0, 1))
    picked = [
        cv2.remap(one, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        for one in (wall, floor)
    ]
    fine = np.where(is_floor[:, :, None], picked[1], picked[0]).astype(np.float32)
    # The light falls off to one side and to the corners.
    x, y = (np.linspace(-1, 1, _FINER * side, dtype=np.float32) for side in (width, height))
    y = y[:, None]
    slope_x, slope_y = rng.uniform(-0.2, 0.2, 2)
    corners = rng.uniform(0.0, 0.15)
    light = 1 + slope_x * x + slope_y * y - corners * (x**2 + y**2)
    fine *= (rng.uniform(0.75, 1.05) * light)[:, :, None].astype(np.float32)
    small = cv2.resize(np.clip(fine, 0, 255), (width, height), interpolation=cv2.INTER_AREA)
    middle = at_m[_FINER // 2 :: _FINER, _FINER // 2 :: _FINER, :2]
    shown = np.where(is_floor[_FINER // 2 :: _FINER, _FINER // 2 :: _FINER, None], middle, np.nan)
    picture = np.round(np.asarray(small)).astype(np.uint8)
    return Stage(picture, shown.astype(np.float32))


def _surfaces(
    view: View, looks: NDArray[np.float32], wall_m: float, turn: float
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return coordinates on the surface seen [m], world places [m], and whether it is the floor."""
    position = np.array(view.position_m, np.float32)
    normal = np.array([-np.cos(turn), np.sin(turn), 0.0], np.float32)  # towards the camera
    sideways = np.array([normal[1], -normal[0], 0.0], np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        to_floor = np.where(looks[:, :, 2] < 0, -position[2] / looks[:, :, 2], np.inf)
        facing = looks @ normal
        to_wall = np.where(facing < 0, -(wall_m + position @ normal) / facing, np.inf)
    to_wall = np.where(to_wall > 0, to_wall, np.inf)
    is_floor = to_floor < to_wall
    reach = np.minimum(np.minimum(to_floor, to_wall), 1e3)
    at_m = position + reach[:, :, None] * looks
    on_wall = np.stack([at_m @ sideways, -at_m[:, :, 2]], axis=2)
    along = np.where(is_floor[:, :, None], at_m[:, :, :2], on_wall)
    return along.astype(np.float64), at_m.astype(np.float64), is_floor


def _texture(rng: np.random.Generator) -> Picture:
    """Draw a texture, plain, rough, striped or chequered, of a dull, dark or light colour."""
    import cv2

    side = _TEXTURE_PX
    saturation = rng.choice([rng.uniform(0.0, 0.2), rng.uniform(0.0, 0.6)])
    colour = _rgb(rng.random(), saturation, rng.uniform(0.2, 0.95))
    pattern = np.zeros((side, side))
    for cells, strength in ((6, 0.05), (24, 0.05), (96, 0.05), (256, 0.05)):
        rough = rng.normal(0.0, strength * rng.random(), (cells, cells))
        pattern += cv2.resize(rough, (side, side), interpolation=cv2.INTER_CUBIC)
    kind = rng.choice(["plain", "plain", "boards", "tiles"])
    y, x = np.mgrid[:side, :side]
    lines = side // int(rng.choice([4, 8, 16]))
    if kind == "boards":
        pattern += rng.normal(0, 0.08, side // lines)[(x // lines) % (side // lines)]
        pattern -= 0.25 * (x % lines < 2)
    elif kind == "tiles":
        pattern += rng.uniform(0, 0.35) * ((x // lines + y // lines) % 2 - 0.5)
    return np.clip(np.array(colour) * (1 + pattern[:, :, None]), 0, 255).astype(np.uint8)


def _rgb(hue: float, saturation: float, value: float) -> tuple[float, float, float]:
    """Convert to red, green and blue, 0 to 255."""
    import colorsys

    red, green, blue = colorsys.hsv_to_rgb(hue, saturation, value)
    return 255 * red, 255 * green, 255 * blue


# ---- Ray-cast ball: shaded, with its shadow and its reflection, only where they are.
# A sphere of radius r at c (camera axes) covers a pixel that looks along d where g(d) = (d c)^2 -
# d^2 (c^2 - r^2) > 0, an ellipse. Of a pixel on its edge 1/2 + g / |grad g| is ball.

Box = tuple[int, int, int, int]  # left, top, right, bottom; the last two are outside


@dataclass(frozen=True)
class BallLook:
    """Appearance of the ball."""

    radius_m: float  # of the ball
    colour: tuple[float, float, float]  # RGB, 0 to 255
    light: tuple[float, float, float]  # unit vector to the lamp, in the world
    ambient: float  # fraction of the light that comes from everywhere
    gloss: float  # strength of the highlight, 0 to 1
    shadow: float  # fraction of the light that the middle of its shadow lacks
    softness: float  # width of the shadow's edge over the ball's height
    mirror: float  # how much of it the floor reflects, 0 to 1


def add_ball(frame: Picture, view: View, stage: Stage, look: BallLook, centers_m: Array) -> None:
    """Render a ball at its positions `centers_m`, shape (S, 3), while the shutter is open."""
    if look.shadow > 0:
        _add_shadow(frame, view, stage, look, centers_m)
    if look.mirror > 0:
        below = centers_m * np.array([1.0, 1.0, -1.0])
        _add_spheres(frame, view, look, below, stage.floor_m)
    _add_spheres(frame, view, look, centers_m, None)


def _add_spheres(
    frame: Picture,
    view: View,
    look: BallLook,
    centers_m: Array,
    through: NDArray[np.float32] | None,
) -> None:
    """Blend in the mean of the spheres; `through` a floor they are faint, and only there."""
    boxes = [_box(view, center, look.radius_m) for center in centers_m]
    left, top = np.min([box[:2] for box in boxes], axis=0)
    right, bottom = np.max([box[2:] for box in boxes], axis=0)
    if left >= right or top >= bottom:
        return
    cover = np.zeros((bottom - top, right - left), np.float32)
    light = np.zeros((bottom - top, right - left, 3), np.float32)
    for center, box in zip(centers_m, boxes, strict=True):
        if box[0] >= box[2] or box[1] >= box[3]:
            continue
        part = slice(box[1] - top, box[3] - top), slice(box[0] - left, box[2] - left)
        covered, colours = _sphere(view, center, look, box)
        cover[part] += covered / len(centers_m)
        light[part] += covered[:, :, None] * colours / len(centers_m)
    where = slice(top, bottom), slice(left, right)
    if through is not None:
        shown = look.mirror * np.isfinite(through[where][:, :, 0])
        cover, light = cover * shown, light * shown[:, :, None]
    behind = frame[where].astype(np.float32)
    frame[where] = np.clip(behind * (1 - cover[:, :, None]) + light + 0.5, 0, 255)


def _box(view: View, center_m: Array, radius_m: float) -> Box:
    """Return the pixels that a sphere may touch; none out of view."""
    seen = view.seen_from_camera(center_m[None])[0]
    if seen[2] < 2 * radius_m:
        return 0, 0, 0, 0
    x, y = view.image_from_world(center_m[None])[0]
    half = 1.15 * view.focal_px * radius_m / (seen[2] - radius_m) + 2
    width, height = view.size_px
    left, top = max(0, int(x - half)), max(0, int(y - half))
    return left, top, min(width, int(x + half) + 2), min(height, int(y + half) + 2)


def _sphere(
    view: View, center_m: Array, look: BallLook, box: Box
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the ball's coverage of each pixel, shape (H, W), and colour, shape (H, W, 3)."""
    center = view.seen_from_camera(center_m[None])[0].astype(np.float32)
    looks = view.directions(np.arange(box[0], box[2]), np.arange(box[1], box[3]))
    along = looks @ center
    squared = (looks**2).sum(axis=2)
    rim = np.float32(center @ center - look.radius_m**2)
    inside = along**2 - squared * rim
    slope = 2 * (along[:, :, None] * center[:2] - looks[:, :, :2] * rim) / view.focal_px
    steepness = np.sqrt((slope**2).sum(axis=2)) + 1e-12
    covered = np.clip(0.5 + inside / steepness, 0, 1)
    reach = (along - np.sqrt(np.maximum(inside, 0))) / squared
    normal = (reach[:, :, None] * looks - center) / np.float32(look.radius_m)
    normal /= np.sqrt((normal**2).sum(axis=2, keepdims=True)) + 1e-9
    lamp = (view.camera_from_world @ np.array(look.light)).astype(np.float32)
    facing = normal @ lamp
    bright = look.ambient + (1 - look.ambient) * np.maximum(facing, 0)
    towards = -looks / np.sqrt(squared)[:, :, None]
    bounced = 2 * facing[:, :, None] * normal - lamp
    shine = np.maximum((bounced * towards).sum(axis=2), 0) ** 24
    colours = bright[:, :, None] * np.array(look.colour, np.float32)
    return covered, colours + 255 * look.gloss * shine[:, :, None]


def _add_shadow(frame: Picture, view: View, stage: Stage, look: BallLook, centers_m: Array) -> None:
    """Darken the floor where the ball keeps the lamp's light away, softer the higher it is."""
    middle = centers_m[len(centers_m) // 2]
    lamp = np.array(look.light)
    ground = (middle - lamp / lamp[2] * middle[2])[:2]
    edge = look.softness * (middle[2] - look.radius_m) + 0.1 * look.radius_m
    turns = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    reach = look.radius_m + edge
    rim = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(16)]) * 1.3 * reach
    rim[:, :2] += ground
    if view.seen_from_camera(rim)[:, 2].min() <= 0.02:
        return
    pixels = view.image_from_world(rim)
    width, height = view.size_px
    left, top = np.maximum(np.floor(pixels.min(axis=0)), 0).astype(int)
    right, bottom = np.minimum(np.ceil(pixels.max(axis=0)) + 1, [width, height]).astype(int)
    if left >= right or top >= bottom:
        return
    where = slice(top, bottom), slice(left, right)
    apart = np.linalg.norm(stage.floor_m[where] - ground.astype(np.float32), axis=2)
    apart = np.where(np.isfinite(apart), apart, np.inf)
    depth = look.shadow * (look.radius_m / (look.radius_m + edge / 2)) ** 2
    dark = depth * np.clip((reach - apart) / (2 * edge), 0, 1)
    frame[where] = frame[where] * (1 - dark[:, :, None]) + 0.5


# ---- Content of a clip, drawn at random: the ball, rig, room and bystanders.

RESTITUTION = (0.1, 0.95)
RATES_HZ = (30.0, 120.0)  # drawn evenly: what a person films at home with a phone
NOISE = 6.0  # the most: a room's light; standard deviation of a pixel, of 255
_MAX_S = 4.0  # filmed after the release: so many fall times, but no longer than that


@dataclass(frozen=True)
class Hand:
    """Hand that holds the ball until it lets go, and then leaves."""

    colour: tuple[int, int, int]  # RGB
    covers: bool  # whether it is before the ball; else behind
    leaves: tuple[float, float]  # which way [ball radii a second], right and down
    follows_s: float  # how long it goes on downward with half the ball's acceleration
    grip: tuple[float, float]  # where its middle is, from the ball's [ball radii], right and down


Passing = Callable[[Picture, float], None]  # adds a person to a frame at a time after the release


@dataclass(frozen=True, eq=False)
class ClipOrder:
    """Specification of one clip."""

    ball: RealBall  # what falls
    view: View  # where from
    stage: Stage  # what is behind it
    look: BallLook  # of the ball
    rate_hz: float  # frames a second
    held_s: float  # from the first frame to the release
    length_s: float  # from the release to the last frame
    exposure_s: float  # how long the shutter is open, centred on a frame's stamp
    noise: float  # standard deviation of a pixel, of 255
    flicker: float  # amplitude of a lamp's at twice the mains
    hand: Hand | None  # None where the ball is held by nothing that shows
    person: Passing | None  # None where nobody comes
    as_log: bool  # recorded to MCAP as JPEGs; else to mp4 as H.264
    jpeg_quality: int  # of 100
    h264_factor: int  # constant rate factor; smaller is better
    pixel_seed: int  # draws the noise
    # of the ball over its contact at times after the release, shape (T, 3), where they are not what
    # `ball` does by itself
    points_m: Callable[[Array], Array] | None = None
    released_s: float = 0.0  # when it leaves the hand
    kept: tuple[int, int] = (1, 1)  # of so many pictures in a row a converter kept so many


def draw_clip(seed: int, index: int) -> ClipOrder:
    """Draw the clip of that number; the same numbers give the same clip."""
    rng = np.random.default_rng([seed, index, 0xC11B])
    drop_m, restitution = float(rng.uniform(0.2, 2.0)), float(rng.uniform(*RESTITUTION))
    return draw_clip_of(RealBall(restitution, 0.0, 0.0, drop_m), rng)


def draw_clip_of(
    ball: RealBall, rng: np.random.Generator, sizes_px: Sequence[tuple[int, int]] = SIZES_PX
) -> ClipOrder:
    """Draw a clip of this ball, with images of one of these sizes."""
    while True:
        radius_m = float(rng.uniform(0.012, 0.06))
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
        length_s=float(min(rng.uniform(5.0, 9.0) * fall_s + 0.3, _MAX_S)),
        exposure_s=float(rng.uniform(0.0, min(0.008, 0.95 / rate_hz))),
        noise=float(rng.uniform(0.0, NOISE)),
        flicker=float(rng.choice([0.0, 0.0, 0.0, rng.uniform(0.0, 0.03)])),
        hand=_hand(rng) if rng.random() < 0.65 else None,
        person=_person(rng, fall_s) if rng.random() < 0.15 else None,
        as_log=bool(rng.random() < 0.3),
        jpeg_quality=int(rng.integers(80, 96)),
        h264_factor=int(rng.integers(16, 24)),
        pixel_seed=int(rng.integers(2**31)),
    )


def draw_home_clip(seed: int, index: int) -> tuple[ClipOrder, str]:
    """Draw a clip as people film at home, and what is special of it: one thing at a time.

    A hand that gives way, a table that gives at up to 480 pictures a second, a kick to the side, or
    a converter that kept four of five pictures.
    """
    rng = np.random.default_rng([seed, index, 0x40E])
    drop_m, restitution = float(rng.uniform(0.3, 1.6)), float(rng.uniform(0.4, 0.9))
    slope, drag_1_m = (float(rng.choice([0.0, rng.uniform(0.0, most)])) for most in (0.12, 0.05))
    ball = RealBall(restitution, slope, drag_1_m, drop_m)
    kind = ("hand", "contact", "kick", "converted")[index % 4]
    home, rate_hz, kept = HomeDrop(ball), float(rng.choice([30.0, 60.0, 120.0])), (1, 1)
    impact_m_s = float(np.sqrt(2 * GRAVITY_M_S2 * drop_m))
    if kind == "hand":
        hand_m_s = float(rng.uniform(0.05, 0.3)) * impact_m_s
        # A hand that falls faster than the ball does not hold it.
        ease_s = float(rng.uniform(1.2, 4.0)) * hand_m_s / GRAVITY_M_S2
        home = HomeDrop(ball, hand_m_s, ease_s)
    elif kind == "contact":
        rate_hz = float(rng.choice([120.0, 240.0, 480.0]))
        home = HomeDrop(ball, contact_s=float(rng.uniform(0.003, 0.015)))
    elif kind == "kick":
        angle, speed = rng.uniform(0.0, 2 * np.pi), rng.uniform(0.02, 0.12) * impact_m_s
        home = HomeDrop(ball, kick_m_s=(float(speed * np.cos(angle)), float(speed * np.sin(angle))))
    else:
        rate_hz, kept = 30.0, (5, 4)
    sizes_px = SIZES_PX[:5] if rate_hz > 120 else SIZES_PX
    order = draw_clip_of(ball, rng, sizes_px)
    return replace(
        order,
        points_m=home.points_m,
        released_s=home.released_s,
        kept=kept,
        rate_hz=rate_hz,
        length_s=min(order.length_s, 2.5 if rate_hz > 120 else _MAX_S),
        exposure_s=float(rng.uniform(0.0, min(0.008, 0.95 / rate_hz))),
        person=None,
        as_log=order.as_log and kept == (1, 1),
    ), kind


def _visible_look(
    rng: np.random.Generator, radius_m: float, view: View, stage: Stage, ball: RealBall
) -> BallLook:
    """Draw a ball with enough contrast to its background for a person to follow it."""
    look = BallLook(
        radius_m=radius_m,
        light=_lamp(rng),
        colour=_ball_colour(rng),
        ambient=float(rng.uniform(0.35, 0.8)),
        gloss=float(rng.choice([0.0, rng.uniform(0.0, 0.7)])),
        shadow=float(rng.choice([0.0, rng.uniform(0.1, 0.6), rng.uniform(0.1, 0.6)])),
        softness=float(rng.uniform(0.02, 0.3)),
        mirror=float(rng.choice([0.0, 0.0, 0.0, rng.uniform(0.05, 0.25)])),
    )
    while True:
        apart = np.quantile(_contrasts(look, view, stage, ball.drop_m), [0.15, 0.5])
        if (apart > (20.0, 30.0)).all():
            return look
        look = replace(look, colour=_ball_colour(rng))


def _lamp(rng: np.random.Generator) -> tuple[float, float, float]:
    """Draw the unit vector to a lamp."""
    light = np.array([rng.uniform(-0.9, 0.4), rng.uniform(-0.6, 0.6), 1.0])
    light /= np.linalg.norm(light)
    return float(light[0]), float(light[1]), float(light[2])


def _ball_colour(rng: np.random.Generator) -> tuple[float, float, float]:
    """Draw a colour: vivid, dull, or grey; dark and light."""
    saturation = rng.choice([rng.uniform(0.0, 0.15), rng.uniform(0.15, 0.5), rng.uniform(0.5, 1)])
    return _rgb(rng.random(), float(saturation), rng.uniform(0.12, 1.0))


def _contrasts(look: BallLook, view: View, stage: Stage, drop_m: float) -> Array:
    """Return by how much the ball and what is behind it differ along the fall, of 255, (9,)."""
    places = view.image_from_world(upright(look.radius_m + drop_m * np.linspace(0.0, 1.0, 9)))
    columns, rows = np.clip(np.round(places), 0, np.array(view.size_px) - 1).astype(int).T
    mean = np.array(look.colour) * (look.ambient + 0.5 * (1 - look.ambient))
    return np.abs(stage.picture[rows, columns].astype(np.float64) - mean).max(axis=1)


def _hand(rng: np.random.Generator) -> Hand:
    tone = rng.uniform(0.3, 1.0)
    red, green, blue = (int(tone * part) for part in (225, 170, 140))
    angle, speed = rng.uniform(-2.6, -0.5), rng.uniform(0.0, 12.0)  # it comes from above
    away, reach = angle + rng.normal(0.0, 0.4), rng.uniform(0.8, 1.4)
    return Hand(
        colour=(red, green, blue),
        covers=bool(rng.random() < 0.5),
        leaves=(float(speed * np.cos(away)), float(speed * np.sin(away))),
        follows_s=float(rng.choice([0.0, 0.0, rng.uniform(0.0, 0.15)])),
        grip=(float(reach * np.cos(angle)), float(reach * np.sin(angle))),
    )


def _person(rng: np.random.Generator, fall_s: float) -> Passing:
    """Draw a person who walks from one edge to the other; return what adds them to a frame."""
    head, body, legs = (tuple(map(int, one)) for one in rng.integers(20, 220, (3, 3)))  # RGB
    from_s, tall_share = fall_s * rng.uniform(1.5, 4.0), rng.uniform(0.5, 1.1)
    way, crossing_s = rng.choice([-1, 1]), rng.uniform(1.5, 4.0)

    def add(frame: Picture, second: float) -> None:
        import cv2

        crossed = (second - from_s) / crossing_s
        if second < from_s or crossed > 1:
            return
        height, width = frame.shape[:2]
        tall = tall_share * height
        x = -0.2 * tall + (crossed if way > 0 else 1 - crossed) * (width + 0.4 * tall)
        foot = 0.95 * height
        swing = 0.12 * tall * float(np.sin(2 * np.pi * 0.9 * second))
        top = foot - tall
        for side in (-1, 1):
            ends = (round(x), round(foot - 0.45 * tall)), (round(x + side * swing), round(foot))
            cv2.line(frame, *ends, legs, max(2, round(0.07 * tall)), cv2.LINE_AA)
        low, high = round(foot - 0.42 * tall), round(top + 0.14 * tall)
        cv2.rectangle(frame, (round(x - 0.1 * tall), high), (round(x + 0.1 * tall), low), body, -1)
        cv2.circle(frame, (round(x), round(top + 0.07 * tall)), round(0.07 * tall), head, -1)

    return add


# ---- Frames of a clip, with the true position of its ball.

_NOISE_MARGIN_PX = 64  # by how much a noise picture is larger than a frame, to be cut out anywhere


def frame_seconds(order: ClipOrder) -> Array:
    """Return the times of the frames after the release, shape (T,)."""
    count = int((order.held_s + order.length_s) * order.rate_hz)
    return np.arange(count) / order.rate_hz - order.held_s


def centers_m(order: ClipOrder, seconds: Array) -> Array:
    """Return the ball's centre in the world, shape (T, 3) [m], at `seconds` after the release."""
    own = order.points_m or (lambda seconds: upright(drop_ball(order.ball, seconds).heights_m))
    return own(seconds) + np.array([0.0, 0.0, order.look.radius_m])


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
            order.person(frame, second)
        hand = order.hand
        if hand is not None and not hand.covers:
            _add_hand(frame, order, hand, second)
        add_ball(frame, order.view, order.stage, order.look, centers)
        if hand is not None and hand.covers:
            _add_hand(frame, order, hand, second)
        if order.flicker:
            gain = 1 + order.flicker * np.sin(4 * np.pi * 50.0 * second)
            frame = np.asarray(cv2.convertScaleAbs(frame, alpha=gain), np.uint8)
        yield noise.added_to(frame)


def _exposed(order: ClipOrder, seconds: Array) -> list[Array]:
    """Return the ball's centres during each frame's exposure, shape (S, 3) [m] each.

    One where it moves by less than .2 px meanwhile, 16 where by more than 4, and four else.
    """
    many = 16  # enough for a smooth streak
    offsets = (np.arange(many) + 0.5) / many - 0.5
    centers = centers_m(order, (seconds[:, None] + offsets * order.exposure_s).ravel())
    pixels = order.view.image_from_world(centers).reshape(len(seconds), many, 2)
    ways = np.linalg.norm(np.diff(pixels, axis=1), axis=2).sum(axis=1)
    return [
        places[many // 2][None] if way_px < 0.2 else places if way_px > 4.0 else places[1::4]
        for way_px, places in zip(ways, centers.reshape(len(seconds), many, 3), strict=True)
    ]


class SensorNoise:
    """White sensor noise of std `noise` of 255: a few noise images, from random corners."""

    def __init__(self, rng: np.random.Generator, size_px: tuple[int, int], noise: float) -> None:
        self._rng = rng
        self._width, self._height = size_px
        shape = (self._height + _NOISE_MARGIN_PX, self._width + _NOISE_MARGIN_PX, 3)
        self._pictures = [
            np.round(rng.standard_normal(shape, np.float32) * noise).astype(np.int16)
            for _ in range(3 if noise > 0.05 else 0)
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

    start = centers_m(order, np.array([min(second, order.released_s)]))
    after = max(second - order.released_s, 0.0)
    low = start - np.array([0.0, 0.0, GRAVITY_M_S2 * min(after, hand.follows_s) ** 2 / 4])
    (x, y), (_, below) = order.view.image_from_world(np.vstack([start, low]))
    radius = float(order.view.radius_px(start, order.look.radius_m)[0])
    x, y = x + radius * hand.grip[0], below + radius * hand.grip[1]
    away = max(after - hand.follows_s, 0.0)
    x, y = x + radius * hand.leaves[0] * away, y + radius * hand.leaves[1] * away
    reach, length = 4 * max(frame.shape[:2]), np.hypot(*hand.grip)
    far = (x + reach * hand.grip[0] / length, y + reach * hand.grip[1] / length)
    # in sixteenths of a pixel
    palm, elbow = ((round(16 * float(x)), round(16 * float(y))) for x, y in ((x, y), far))
    if max(map(abs, palm)) > 2**18:
        return
    thick = max(1, round(0.9 * radius))
    cv2.line(frame, palm, elbow, hand.colour, thick, cv2.LINE_AA, 4)
    axes = (round(16 * 1.0 * radius), round(16 * 0.8 * radius))
    turn = float(np.degrees(np.arctan2(hand.grip[1], hand.grip[0])))
    cv2.ellipse(frame, palm, axes, turn, 0, 360, hand.colour, -1, cv2.LINE_AA, 4)


# ---- Files as users have them: a phone's mp4, or a log of JPEGs.

_TICKS_HZ = 90_000  # the clock of an mp4's stamps, as most phones have it
_MATRIX_AT = 44  # bytes from an mp4's track header to its display matrix (ISO/IEC 14496-12, 8.3.2)
AAC_BIT_S = 64_000
_AAC_SAMPLES = 1024  # of one packet

# What can be made of one clip that changes nothing of its ball.
VERSIONS = (
    *("as filmed", "1/8 speed", "half size"),
    *("mirrored", "rotated, flagged", "every 2nd frame"),
)
_SLOW, _HALF_SIZE, _MIRRORED, _ROTATED, _SPARSE = VERSIONS[1:]

Add = Callable[[Picture, float], None]  # a picture, and when it was taken after the first [s]


def write_clip(order: ClipOrder, folder: Path) -> Path:
    """Write the clip as filmed to a new file."""
    return write_versions(order, folder, VERSIONS[:1])[0]


def write_versions(order: ClipOrder, folder: Path, versions: tuple[str, ...]) -> list[Path]:
    """Render one clip once, and write some of its `VERSIONS`; one file each."""
    is_log = order.as_log and versions == VERSIONS[:1]
    paths = [
        folder / f"clip_{VERSIONS.index(one)}.{'mcap' if is_log else 'mp4'}" for one in versions
    ]
    with ExitStack() as stack:
        sinks: dict[str, Add] = {}
        for one, path in zip(versions, paths, strict=True):
            width, height = _changed(order.stage.picture, one).shape[1::-1]
            sinks[one] = stack.enter_context(
                jpeg_log(path, EpisodeInfo(), order.jpeg_quality)
                if is_log
                else mp4(path, (width, height), order.h264_factor)
            )
        seconds = (frame_seconds(order) + order.held_s).tolist()
        of, kept = order.kept
        for at, (picture, second) in enumerate(zip(clip_frames(order), seconds, strict=True)):
            if at % of >= kept:
                continue
            stamped_s = second
            if kept < of:  # a converter stamps evenly what it keeps
                stamped_s = (at // of * kept + at % of) * of / kept / order.rate_hz
            for one, add in sinks.items():
                if one != _SPARSE or at % 2 == 0:
                    add(_changed(picture, one), stamped_s * (8 if one == _SLOW else 1))
    for one, path in zip(versions, paths, strict=True):
        if one == _ROTATED:  # set its flag to a quarter turn, clockwise
            data = bytearray(path.read_bytes())
            at = data.index(b"tkhd") + _MATRIX_AT
            rows = np.array([[0, 1 << 16, 0], [-(1 << 16), 0, 0], [0, 0, 1 << 30]], ">i4")
            data[at : at + 36] = rows.tobytes()
            path.write_bytes(data)
    return paths


def _changed(picture: Picture, version: str) -> Picture:
    import cv2

    if version == _HALF_SIZE:
        height, width = picture.shape[:2]
        size = (width // 2, height // 2)
        return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
    if version == _MIRRORED:
        return np.ascontiguousarray(picture[:, ::-1])
    if version == _ROTATED:
        return np.asarray(cv2.rotate(picture, cv2.ROTATE_90_COUNTERCLOCKWISE), np.uint8)
    return picture


@contextmanager
def jpeg_log(path: Path, info: EpisodeInfo, quality: int) -> Iterator[Add]:
    """Record JPEGs to MCAP in a block, as our own recorder does."""
    import cv2

    def add(picture: Picture, second: float) -> None:
        options = [cv2.IMWRITE_JPEG_QUALITY, quality]
        _, data = cv2.imencode(".jpg", picture[:, :, ::-1], options)
        writer.write_frame(CAMERA_TOPIC, Frame(round(second * 1e9), "jpeg", data.tobytes()))

    with EpisodeWriter(path, info, live=False) as writer:
        yield add


@contextmanager
def mp4(
    path: Path,
    size_px: tuple[int, int],
    factor: int,
    sound: tuple[NDArray[np.float32], int, int] | None = None,
) -> Iterator[Add]:
    """Write H.264 with frame times in a block, then a sound: see `add_sound`."""
    import av

    width, height = (side // 2 * 2 for side in size_px)  # colours are stored for 2 by 2 pixels
    with av.open(str(path), "w") as container:
        options = {"crf": str(factor), "preset": "ultrafast"}
        film: Any = container.add_stream("libx264", rate=30, options=options)
        film.width, film.height, film.pix_fmt = width, height, "yuv420p"
        film.codec_context.time_base = Fraction(1, _TICKS_HZ)
        film.thread_count = 1
        audio = None if sound is None else aac_stream(container, sound[1])

        def add(picture: Picture, second: float) -> None:
            cut = np.ascontiguousarray(picture[:height, :width])
            frame = av.VideoFrame.from_ndarray(cut, format="rgb24")
            frame.pts, frame.time_base = round(second * _TICKS_HZ), Fraction(1, _TICKS_HZ)
            container.mux(film.encode(frame))

        yield add
        container.mux(film.encode())
        if sound is not None:
            add_sound(container, audio, *sound)


def aac_stream(container: Any, rate_hz: int) -> Any:
    """Add a stream of AAC, one channel, to an open PyAV container."""
    stream = container.add_stream("aac", rate=rate_hz)
    stream.bit_rate, stream.layout = AAC_BIT_S, "mono"
    return stream


def add_sound(
    container: Any, stream: Any, samples: NDArray[np.float32], rate_hz: int, at: int = 0
) -> None:
    """Encode a sound, shape (N,), from sample `at` of its stream on."""
    import av

    for start in range(0, len(samples), _AAC_SAMPLES):
        piece = np.ascontiguousarray(samples[None, start : start + _AAC_SAMPLES], np.float32)
        frame = av.AudioFrame.from_ndarray(piece, format="fltp", layout="mono")
        frame.sample_rate, frame.pts = rate_hz, at + start
        container.mux(stream.encode(frame))
    container.mux(stream.encode(None))


# ---- Film of a hidden drop by a camera of unknown pose: pictures in a log, or a track.

FRAME_HZ = 60.0
TRACK_NOISE_PX = 0.15  # of a projected track: what the tracker has on such films
_COLOURS = {
    "red gel": (205, 40, 50),
    "racquetball": (40, 70, 190),
    "tennis": (200, 220, 60),
    "foam": (240, 130, 30),
    "lacrosse": (235, 235, 230),
    "super": (120, 40, 150),
}


@dataclass(frozen=True, eq=False)
class DropFilm:
    """Drop and its camera."""

    drop: HiddenDrop  # what happens
    view: View
    seed: int  # of the room and the noise

    @property
    def seconds(self) -> Array:
        """Frame times after the release, shape (T,)."""
        return np.arange(int((HELD_S + FILMED_S) * FRAME_HZ)) / FRAME_HZ - HELD_S


def film_of(drop: HiddenDrop, rng: np.random.Generator) -> DropFilm:
    """Draw a camera with the whole fall in view; of a ball that will leave it, most of it."""
    while True:
        view = drop_view(rng)
        seed = int(rng.integers(2**31))
        if drop.leaves_s is None:
            return DropFilm(drop, view, seed)
        for _ in range(4):
            view = _turned_away(view, drop, drop.leaves_s)
        if is_well_inside(view, upright(np.array([RADIUS_M + DROP_M]))):
            return DropFilm(drop, view, seed)


def _turned_away(view: View, drop: HiddenDrop, leaves_s: float) -> View:
    """Turn the camera so that a ball that is to leave crosses the image's edge."""
    at = drop.path.at(np.array([leaves_s]))
    to_right = math.sin(drop.heading_rad) < 0  # y is to the left of a camera that looks along x
    edge = view.size_px[0] + 5.0 if to_right else -5.0
    angle = math.atan2(float(view.image_from_world(at)[0, 0]) - edge, view.focal_px)
    x, y = view.aim_m[0] - view.position_m[0], view.aim_m[1] - view.position_m[1]
    cos, sin = math.cos(-angle), math.sin(-angle)
    target = (
        view.position_m[0] + cos * x - sin * y,
        view.position_m[1] + sin * x + cos * y,
        view.aim_m[2],
    )
    return replace(view, aim_m=target)


def record_film(film: DropFilm, path: Path) -> None:
    """Write the film as the recorder does: JPEGs in a log, and what is known of the ball."""
    ball = film.drop.ball
    info = EpisodeInfo(
        kind="drop",
        source="hidden world, drawn",
        rig={"ball_diameter_m": 2 * RADIUS_M, "ball_mass_kg": MASS_KG, "drop_height_m": DROP_M},
        truth={"restitution": ball.restitution_at(film.drop.impact_m_s)},
        notes={"ball": ball.name},
    )
    with jpeg_log(path, info, 85) as add:
        for second, picture in zip((film.seconds + HELD_S).tolist(), _frames(film), strict=True):
            add(picture, second)


def track_of(film: DropFilm) -> Track:
    """Simulate the track that a tracker would find, without pictures."""
    rng, view = np.random.default_rng(film.seed), film.view
    centers = film.drop.path.at(film.seconds)
    places, radii = view.image_from_world(centers), view.radius_px(centers, RADIUS_M)
    places += rng.normal(0.0, TRACK_NOISE_PX, places.shape)
    room = np.array(view.size_px) - 1 - radii[:, None]
    seen = np.all((places > radii[:, None]) & (places < room), axis=1)
    seen &= centers[:, 0] > view.position_m[0] + 0.2
    top, low = view.image_from_world(upright(RADIUS_M + np.array([DROP_M, 0.0])))
    stamps_ns = np.round((film.seconds + HELD_S) * 1e9).astype(np.int64)
    return found_track(stamps_ns, places, radii, ~seen, low - top, view.size_px)


def _frames(film: DropFilm) -> Iterator[Picture]:
    rng = np.random.default_rng(film.seed)
    look = BallLook(
        radius_m=RADIUS_M,
        colour=_COLOURS.get(film.drop.ball.name, _COLOURS["foam"]),
        light=_lamp(rng),
        ambient=float(rng.uniform(0.4, 0.8)),
        gloss=float(rng.uniform(0.0, 0.6)),
        shadow=float(rng.choice([0.0, rng.uniform(0.1, 0.6)])),
        softness=float(rng.uniform(0.02, 0.3)),
        mirror=0.0,
    )
    while True:  # a room before which a person could follow the ball
        stage = draw_stage(film.view, DROP_M, rng)
        if np.quantile(_contrasts(look, film.view, stage, DROP_M), 0.15) > 35.0:
            break
    noise = SensorNoise(rng, film.view.size_px, 4.0)
    offsets = ((np.arange(6) + 0.5) / 6 - 0.5) * 0.004  # six places in an exposure of 4 ms
    centers = film.drop.path.at((film.seconds[:, None] + offsets).ravel())
    for places in centers.reshape(-1, len(offsets), 3):
        frame = stage.picture.copy()
        shown = places if np.linalg.norm(places[-1] - places[0]) > 5e-4 else places[:1]
        below = replace(look, shadow=0.0) if places[0, 2] < 0 else look
        add_ball(frame, film.view, stage, below, shown)
        yield noise.added_to(frame)
