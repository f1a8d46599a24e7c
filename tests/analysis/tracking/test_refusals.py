"""What is no drop is refused early, with the cause: a camera that moves, a ball that rolls."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import pytest

from tunenet_logs.analysis.drop.film import find_filmed_drop
from tunenet_logs.analysis.tracking.candidates import Candidates
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.analysis.tracking.track import longest_roll_px, share_elsewhere, track_ball
from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame, Picture
from tunenet_logs.errors import NotFoundError

WIDE, TALL = 320, 240


def room() -> Picture:
    """Something to see everywhere, three times as wide as a picture."""
    rng = np.random.default_rng(3)
    coarse = rng.integers(40, 220, (TALL // 12, 3 * WIDE // 12, 3)).astype(np.uint8)
    size = (3 * WIDE, TALL)
    return np.asarray(cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC), np.uint8)


def with_ball(picture: Picture, x: float, y: float) -> Picture:
    shown = picture.copy()
    cv2.circle(shown, (round(x), round(y)), 9, (250, 120, 20), -1, cv2.LINE_AA)
    return shown


def episode_of(pictures: Sequence[Picture], rate_hz: float = 30.0) -> Episode:
    stamps = np.round(np.arange(len(pictures)) / rate_hz * 1e9).astype(np.int64)
    frames = [
        Frame(int(stamp), "rgb8", picture.tobytes(), (WIDE, TALL))
        for stamp, picture in zip(stamps, pictures, strict=True)
    ]
    channel = Channel("c", "rgb8", "raw", stamps, pictures=True)
    return Episode(EpisodeInfo(), {}, (channel,), open_frames=lambda _topic: iter(frames))


def test_a_camera_that_moves_is_named_before_anything_is_looked_for():
    view = room()
    pictures = [view[:, 8 * at : 8 * at + WIDE] for at in range(60)]
    assert share_elsewhere(pictures) > 0.8
    with pytest.raises(NotFoundError, match="the camera moves"):
        track_ball(Pictures(episode_of([np.ascontiguousarray(one) for one in pictures]), "c"))


def test_a_person_a_shaking_hand_and_a_blank_wall_are_no_moving_camera():
    view, rng = room(), np.random.default_rng(1)
    shaken = [view[1:-1, 10 + x : 10 + x + WIDE] for x in rng.integers(-2, 3, 40)]
    assert share_elsewhere(shaken) == 0
    passing = [view[:, :WIDE].copy() for _ in range(40)]
    for at, picture in enumerate(passing):
        picture[40:, 6 * at : 6 * at + 90] = (30, 60, 90)
    assert share_elsewhere(passing) == 0
    wall = np.full((TALL, WIDE, 3), 180, np.uint8)
    assert share_elsewhere([with_ball(wall, 20 + 6 * at, 100) for at in range(40)]) == 0


def test_a_ball_that_rolls_across_the_picture_never_falls():
    view = np.ascontiguousarray(room()[:, :WIDE] // 2)
    pictures = [with_ball(view, 20 + 6 * at - 0.03 * at**2, 180) for at in range(50)]
    with pytest.raises(NotFoundError, match=r"never falls|nothing falls"):
        find_filmed_drop(track_ball(Pictures(episode_of(pictures), "c")), 0)


@pytest.mark.parametrize(
    ("way", "rolls"),
    [
        (lambda at: (6 * at, 0 * at), True),
        (lambda at: (8 * at - 0.08 * at**2, 0 * at), True),
        (lambda at: (0 * at, 0.15 * at**2), False),
        (lambda at: (6 * at, 4 * at - 0.08 * at**2), False),
        (lambda at: (100 * np.sin(at / 4), 60 * np.sin(at / 3)), False),
    ],
    ids=["steadily", "slower and slower", "falls", "thrown", "waved"],
)
def test_what_rolls_goes_straight_and_gains_no_speed(way: object, rolls: bool):
    at = np.arange(40.0)
    x, y = way(at)  # type: ignore[operator]
    table = Candidates(
        seconds=at / 30,
        places_px=np.column_stack([x, y])[:, None, :],
        areas_px=np.full((40, 1), 80.0),
        colours=np.zeros((40, 1, 3)),
        whole=np.ones((40, 1), dtype=bool),
        misfits=np.zeros((40, 1)),
    )
    assert (longest_roll_px(table) > 100) == rolls
