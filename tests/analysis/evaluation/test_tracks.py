"""Made-up tracks: the camera against another, scenes as ordered, faults as told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.worlds.ball import GRAVITY_M_S2
from tunenet_logs.analysis.evaluation.worlds.camera import (
    FAULT_BALLS,
    FAULT_SET,
    NARROW,
    NOISES_PX,
    SIZE_PX,
    TABLE_TENNIS_DRAG_1_M,
    TABLE_TENNIS_RADIUS_M,
    TRACK_FAULTS,
    TRACK_SETS,
    WIDE,
    A,
    B,
    BallRanges,
    C,
    TrackFault,
    TrackScene,
    TrackSet,
    View,
    draw_scene,
    drifts,
    edge,
    film,
    upright,
)
from tunenet_logs.analysis.tracking.track import Track
from tunenet_logs.recorders.simulators.camera import PinholeCamera
from tunenet_logs.recorders.simulators.known import BALLS

SEED = -1
BAD = {one.name: one for one in TRACK_FAULTS}


def scenes(which: TrackSet, count: int = 60, noise_px: float = 0.3) -> list[TrackScene]:
    return [draw_scene(which, BallRanges(WIDE), noise_px, SEED, number) for number in range(count)]


def test_the_air_on_a_table_tennis_ball():
    told = BALLS["table-tennis"]
    assert pytest.approx(told.drag_1_m, rel=1e-9) == TABLE_TENNIS_DRAG_1_M
    assert told.diameter_m == 2 * TABLE_TENNIS_RADIUS_M


@pytest.mark.parametrize("number", range(8))
def test_the_camera_is_that_of_the_recorders(number: int):
    rng = np.random.default_rng(number)
    x, y, z, *near = (float(one) for one in rng.uniform(-4.0, 4.0, 6))
    position, aim = (x, y, z), (near[0] / 8, near[1] / 8, near[2] / 8)
    other = PinholeCamera(position, aim, SIZE_PX, float(rng.uniform(20.0, 90.0)))
    mine = View(position, aim, other.focal_px)
    points = rng.uniform(-6.0, 6.0, (200, 3))
    places = mine.image_from_world(points)
    assert places == pytest.approx(other.image_from_world(points), nan_ok=True, abs=1e-6)
    seen = np.isfinite(places[:, 0])
    assert 0 < seen.sum() < 200
    radii = mine.radius_px(points, 0.03)
    assert radii[seen] == pytest.approx(other.radius_px(points, 0.03)[seen])
    turned = replace(mine, roll_rad=np.pi / 2).image_from_world(points)
    middle = (np.array(SIZE_PX) - 1) / 2
    right, down = (places - middle)[seen].T
    assert (turned - middle)[seen] == pytest.approx(np.column_stack([-down, right]))


def test_a_ball_at_the_edge_of_the_picture_is_not_whole():
    view = View((0.0, -2.0, 0.0), (0.0, 0.0, 0.0), 100.0)  # 50 px a metre
    up = np.array([0.0, 2.1, 2.3, 2.5, -2.3])
    assert view.shows(upright(up), 0.1).tolist() == [True, True, False, False, False]
    assert not view.shows(np.array([[0.0, -3.0, 0.0]]), 0.1)[0]


@pytest.mark.parametrize("which", TRACK_SETS, ids=lambda one: one.name)
def test_the_whole_drop_is_in_the_picture(which: TrackSet):
    for scene in scenes(which):
        track = film(scene)
        assert np.array_equal(track.found, ~scene.lost)
        assert 60 < np.linalg.norm(scene.view.plumb_px(scene.ball.drop_m)) < 205
        down = track.gravity_px / np.linalg.norm(track.gravity_px)
        along = track.places_px[track.found] @ down
        assert np.ptp(along) > 55 or scene.seconds[0] > 0
        across = track.places_px[track.found] @ np.array([down[1], -down[0]])
        assert np.std(across) < 3
        if which is not C:  # the release is seen, and most of the bounces
            assert scene.seconds[0] <= 0
            assert 3.8 < scene.seconds[-1] / scene.ball.fall_s <= 8
            assert not scene.lost.any()


def test_the_papers_rig():
    for scene in scenes(A):
        x, y, z = scene.view.position_m
        assert 5 <= np.hypot(x, y) <= 10
        assert 5 <= z + 0.5 <= 8
        assert scene.view.aim_m == (0.0, 0.0, 1.5)  # over the contact, not over the table
        assert 4 <= scene.ball.drop_m + scene.radius_m <= 5
        assert np.diff(scene.seconds) == pytest.approx(1 / 60)


def test_anything_that_a_user_may_film():
    drawn = scenes(C, 200)
    begins = np.array([scene.seconds[0] / scene.ball.fall_s for scene in drawn])
    ends = np.array([scene.seconds[-1] / scene.ball.fall_s for scene in drawn])
    frames = np.array([scene.ball.fall_s / np.diff(scene.seconds)[0] for scene in drawn])
    assert 0.3 < np.mean(begins > 0) < 0.7
    assert begins.max() < 0.4
    assert frames.min() > 6
    assert frames.max() < 150
    assert np.percentile(frames, 5) < 20
    assert 0.03 < np.mean(ends < 3.8) < 0.2
    assert np.all(ends > 1.9 - 1 / frames)
    lost = [scene.lost.mean() for scene in drawn]
    assert 0.02 < np.mean(lost) < 0.15
    for scene in drawn:
        flight = 1 + 2 * scene.ball.restitution
        first = (scene.seconds > scene.ball.fall_s) & (scene.seconds < scene.ball.fall_s * flight)
        assert not first.any() or np.mean(~scene.lost[first]) >= 0.6


@pytest.mark.parametrize("noise_px", NOISES_PX)
def test_places_are_whole_pixels_and_as_noisy_as_told(noise_px: float):
    off, sizes = [], []
    for scene in scenes(B, noise_px=noise_px):
        track = film(scene)
        points = upright(scene.fall().heights_m)
        assert np.array_equal(track.places_px, np.round(track.places_px))
        assert np.array_equal(2 * track.radius_px, np.round(2 * track.radius_px))
        off.append(track.places_px - scene.view.image_from_world(points))
        sizes.append(track.radius_px - scene.view.radius_px(points, scene.radius_m))
    expected = np.hypot(noise_px, 1 / np.sqrt(12))
    assert np.std(np.concatenate(off)) == pytest.approx(expected, rel=0.03)
    assert abs(np.mean(np.concatenate(off))) < 0.02
    assert np.std(np.concatenate(sizes)) > 0.2


def test_a_scene_depends_on_its_seed_and_number_alone():
    one, again = (draw_scene(B, BallRanges(NARROW), noise, SEED, 7) for noise in NOISES_PX)
    assert one.ball == again.ball
    assert np.array_equal(one.seconds, again.seconds)
    assert one.view == again.view
    others = [
        draw_scene(B, BallRanges(NARROW), 0.3, SEED, 8),
        draw_scene(B, BallRanges(NARROW), 0.3, SEED - 1, 7),
        draw_scene(B, BallRanges(WIDE), 0.3, SEED, 7),
        draw_scene(C, BallRanges(NARROW), 0.3, SEED, 7),
    ]
    assert all(other.ball.restitution != one.ball.restitution for other in others)


def bad_pairs(name: str, count: int = 12) -> list[tuple[TrackScene, Track, Track]]:
    """Shots, their good and their bad tracks, with next to no noise."""
    drawn = [draw_scene(FAULT_SET, FAULT_BALLS, 0.01, SEED, number) for number in range(count)]
    return [(scene, film(scene), BAD[name].track(scene)) for scene in drawn]


@pytest.mark.parametrize("bad", TRACK_FAULTS, ids=lambda one: one.name)
def test_a_bad_track_differs_from_its_good_one_and_is_the_same_again(bad: TrackFault):
    for scene, good, track in bad_pairs(bad.name):
        again = bad.track(scene)
        assert np.array_equal(track.places_px, again.places_px, equal_nan=True)
        assert np.array_equal(track.stamps_ns, again.stamps_ns)
        assert len(track.stamps_ns) == len(track.places_px) == len(track.radius_px)
        same = len(track.stamps_ns) == len(good.stamps_ns)
        assert not same or not np.array_equal(track.places_px, good.places_px, equal_nan=True)
        places = track.places_px[track.found]
        assert np.all((places >= 0) & (places <= np.array(SIZE_PX)))


def test_what_is_no_ball():
    for _, _, track in bad_pairs("still"):
        assert np.ptp(track.places_px, axis=0).max() <= 1
    for _, _, track in bad_pairs("wandering"):
        steps = np.linalg.norm(np.diff(track.places_px, axis=0), axis=1)
        assert np.ptp(track.places_px, axis=0).max() > 30
        assert steps.max() < 20


def test_what_is_seen_no_more():
    for scene, good, track in bad_pairs("leaves"):
        first, second = scene.fall().impacts_s[:2]
        last = np.flatnonzero(track.found)[-1]
        assert first / 2 - 0.02 < scene.seconds[last] < second
        assert np.array_equal(track.places_px[: last + 1], good.places_px[: last + 1])


def heights_of(scene: TrackScene, track: Track) -> np.ndarray:
    """About how high over the table [drop heights], by the camera's vertical there."""
    plumb = scene.view.plumb_px(scene.ball.drop_m)
    (contact,) = scene.view.image_from_world(np.zeros((1, 3)))
    return -(track.places_px - contact) @ plumb / (plumb @ plumb)


@pytest.mark.parametrize("name", ["rolls-off", "edge-first", "edge-second"])
def test_what_leaves_the_table(name: str):
    below = []
    for scene, good, track in bad_pairs(name, 30):
        impacts = scene.fall().impacts_s
        until = impacts[1 if name == "edge-second" else 0]
        before = scene.seconds < until - 0.02
        assert np.array_equal(track.places_px[before], good.places_px[before])
        heights = heights_of(scene, track)
        below.append(np.nanmin(heights) < -0.05 or not track.found.all())
    assert np.mean(below) > (0.9 if name == "rolls-off" else 0.5)


@pytest.mark.parametrize("hit", [0, 1])
def test_an_edge_turns_the_rebound_about_its_normal(hit: int):
    for number in range(10):
        scene = draw_scene(FAULT_SET, FAULT_BALLS, 0.3, SEED, number)
        fall, restitution = scene.fall(), scene.ball.restitution
        at_s, speed = fall.impacts_s[hit], fall.impact_speeds_m_s[hit]
        ends = at_s + np.array([0.0, 1e-3]) * scene.ball.fall_s
        points = edge(replace(scene, seconds=ends), np.random.default_rng(number), hit)
        gone, since_s = points[1] - points[0], ends[1] - ends[0]
        aside = np.hypot(gone[0], gone[1]) / since_s
        up = gone[2] / since_s + GRAVITY_M_S2 / 2 * since_s
        tilt = np.arctan2(aside, up + speed)
        normal = up * np.cos(tilt) + aside * np.sin(tilt)
        if up > 0.05 * speed:
            assert 10 <= np.degrees(tilt) <= 45
            assert normal == pytest.approx(restitution * speed * np.cos(tilt), rel=1e-3)


def test_hands():
    for scene, _, track in bad_pairs("thrown"):
        heights = heights_of(scene, track)
        assert heights[0] == pytest.approx(0, abs=0.05)
        assert np.nanmax(heights) > 0.4
    for scene, _, track in bad_pairs("held"):
        assert np.ptp(heights_of(scene, track)[track.found]) < 0.9
    raised = []
    for scene, good, track in bad_pairs("caught"):
        impact = scene.fall().impacts_s[0]
        before = scene.seconds < impact
        assert np.array_equal(track.places_px[before], good.places_px[before])
        raised.append(heights_of(scene, track)[-1] > 0.03)
    assert np.mean(raised) > 0.7


def test_a_ball_that_drifts_goes_steadily_to_the_camera_or_away():
    towards = []
    for number in range(10):
        scene = draw_scene(FAULT_SET, FAULT_BALLS, 0.3, SEED, number)
        points = drifts(scene, np.random.default_rng(number))
        camera = np.array(scene.view.position_m[:2])
        gone = points[:, :2] @ camera / (camera @ camera)
        falls = np.maximum(scene.seconds, 0.0) / scene.ball.fall_s
        assert points[:, :2] == pytest.approx(gone[:, None] * camera)
        assert gone == pytest.approx(falls / falls[-1] * gone[-1])
        assert 0.05 <= abs(gone[-1] / falls[-1]) <= 0.15
        assert points[:, 2] == pytest.approx(scene.fall().heights_m)
        towards.append(gone[-1] > 0)
    assert 0 < sum(towards) < 10


def test_frames_that_are_repeated_or_missing():
    for _, good, track in bad_pairs("freezes"):
        changed = np.flatnonzero((track.places_px != good.places_px).any(axis=1))
        assert np.array_equal(track.stamps_ns, good.stamps_ns)
        assert changed[-1] - changed[0] < 20
        assert np.ptp(track.places_px[changed[0] : changed[-1] + 1], axis=0).max() == 0
    for _, good, track in bad_pairs("loses-20"):
        gone = len(good.stamps_ns) - len(track.stamps_ns)
        assert gone == 20
        assert np.array_equal(track.stamps_ns, good.stamps_ns[:-20])
        assert np.array_equal(track.places_px[-5:], good.places_px[-5:])
    shares = [len(track.stamps_ns) / len(good.stamps_ns) for _, good, track in bad_pairs("slows")]
    assert 0.5 < np.mean(shares) < 0.8
    pairs = bad_pairs("loses-tenth")
    shares = [len(track.stamps_ns) / len(good.stamps_ns) for _, good, track in pairs]
    assert np.mean(shares) == pytest.approx(0.9, abs=0.02)


def test_a_tracker_on_something_else_comes_back():
    for scene, good, track in bad_pairs("jumps"):
        off = np.linalg.norm(track.places_px - good.places_px, axis=1)
        away = np.flatnonzero(off > 10)
        assert 3 <= len(away) == away[-1] - away[0] + 1
        assert np.ptp(scene.seconds[away]) < 0.7 * scene.ball.fall_s + 0.05
        assert off[away].min() > 25
