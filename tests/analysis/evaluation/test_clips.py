"""Drawn clips: what they are said to show is in them, and they go the road of a user's video."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.studies.video import (
    clip_row,
    track_errors_px,
    version_estimates,
)
from tunenet_logs.analysis.evaluation.worlds.camera import View
from tunenet_logs.analysis.evaluation.worlds.clips import (
    VERSIONS,
    BallLook,
    ClipOrder,
    Stage,
    add_ball,
    clip_frames,
    draw_clip,
    frame_seconds,
    places_px,
    write_clip,
    write_versions,
)
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.analysis.tracking.track import Track, track_ball
from tunenet_logs.reader import read_episode

PLAIN = BallLook(0.05, (255.0, 255.0, 255.0), (0.0, 0.0, 1.0), 1.0, 0.0, 0.0, 0.1, 0.0)


def short_clip() -> ClipOrder:
    """A quick one to draw: 480 x 270, a dark ball, a hand."""
    order = draw_clip(1000, 4)
    assert max(order.view.size_px) == 480
    return replace(order, length_s=0.9, held_s=0.15)


def track_of(path: Path) -> Track:
    episode = read_episode(path)
    return track_ball(Pictures(episode, episode.picture_topics[0]))


def test_the_ball_is_drawn_where_it_is_said_to_be():
    """A white ball on black: its centroid is that of its projection to a hundredth of a pixel."""
    view = View((-2.0, 0.0, 0.6), (0.0, 0.0, 0.5), 330.0, roll_rad=0.05)
    stage = Stage(np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320, 2), np.float32))
    rng = np.random.default_rng(0)
    for center in rng.uniform([-0.1, -0.3, 0.2], [0.1, 0.3, 0.8], (20, 3)):
        frame = stage.picture.copy()
        add_ball(frame, view, stage, PLAIN, center[None])
        mass = frame[:, :, 0].astype(np.float64)
        y, x = np.mgrid[:240, :320]
        centroid = np.array([(mass * x).sum(), (mass * y).sum()]) / mass.sum()
        # The middle of a sphere's outline lies a little farther out than its centre's picture.
        rim = _outline_middle(view, center)
        assert centroid == pytest.approx(rim, abs=0.02)
        assert np.hypot(*(rim - view.image_from_world(center[None])[0])) < 0.1


def _outline_middle(view: View, center_m: np.ndarray) -> np.ndarray:
    """Of the ellipse, by its own closed form: the cone of rays that touch the sphere."""
    c = view.seen_from_camera(center_m[None])[0]
    rim = c @ c - PLAIN.radius_m**2
    cone = np.outer(c, c) - rim * np.eye(3)
    return view.middle_px + view.focal_px * -np.linalg.solve(cone[:2, :2], cone[:2, 2])


def test_a_clip_is_the_same_each_time_and_others_are_others():
    first, second = (next(clip_frames(draw_clip(1000, index))) for index in (4, 4))
    assert np.array_equal(first, second)
    looks = {draw_clip(1000, index).look.colour for index in (4, 5, 16)}
    assert len(looks) == 3


@pytest.mark.slow
def test_the_whole_fall_is_in_the_picture():
    for index in (4, 5, 16):
        order = draw_clip(1001, index)
        places = places_px(order)
        assert (places > 2).all()
        assert (places < np.array(order.view.size_px) - 3).all()
        assert np.ptp(places[:, 1]) > 0.3 * order.view.size_px[1]


@pytest.mark.slow
def test_a_clip_is_tracked_to_a_part_of_a_pixel(tmp_path: Path):
    """The figure to hold: .2 px rms, the centre's own place, not up to a constant."""
    order = short_clip()
    off = track_errors_px(order, track_of(write_clip(order, tmp_path)))
    seen = np.isfinite(off[:, 0])
    assert seen.sum() > 0.95 * order.length_s * order.rate_hz
    assert np.sqrt((off[seen] ** 2).sum(axis=1).mean()) < 0.2


@pytest.mark.slow
def test_versions_show_the_same_ball(tmp_path: Path):
    order = replace(short_clip(), as_log=False)
    paths = dict(zip(VERSIONS, write_versions(order, tmp_path, VERSIONS), strict=True))
    tracks = {name: track_of(path) for name, path in paths.items()}
    truth = places_px(order)
    width, height = order.view.size_px
    seconds = frame_seconds(order) + order.held_s
    expected = {
        VERSIONS[0]: (truth, seconds),
        VERSIONS[1]: (truth, 8 * seconds),
        VERSIONS[2]: ((truth + 0.5) / 2 - 0.5, seconds),
        VERSIONS[3]: (np.column_stack([width - 1 - truth[:, 0], truth[:, 1]]), seconds),
        VERSIONS[4]: (truth, seconds),
        VERSIONS[5]: (truth[::2], seconds[::2]),
    }
    released = order.held_s + 0.1
    for name, track in tracks.items():
        places, times = expected[name]
        assert len(track.stamps_ns) == len(times), name
        assert (track.stamps_ns - track.stamps_ns[0]) * 1e-9 == pytest.approx(times, abs=1e-4)
        off = (track.places_px - places)[seconds[: len(times)] > released]
        assert np.nanmedian(np.hypot(*off.T)) < (0.2 if name != VERSIONS[4] else 1.1), name
    assert tracks[VERSIONS[4]].size_px == (width, height // 2 * 2)


def test_one_clip_goes_the_whole_road():
    """The figure to hold for a hundred: mean absolute error .006."""
    (row,) = clip_row((1000, 54))
    assert row["estimate"] == pytest.approx(row["truth"], abs=0.01)
    assert row["verdict"] in ("ok", "suspect")
    assert row["off_px"] < 0.6
    assert 0.9 < row["found"] <= 1


@pytest.mark.slow
def test_its_versions_are_answered_alike():
    order = replace(short_clip(), length_s=1.2)
    estimates = version_estimates(order)
    assert None not in estimates
    assert np.ptp(np.array(estimates, float)) < 0.01
    assert estimates[0] == pytest.approx(order.ball.restitution, abs=0.005)
