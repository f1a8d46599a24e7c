"""A camera is where it is said to be, and the drawn ball is the projection of a sphere."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from tunenet_logs.episode import Array
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.camera import (
    BallScene,
    PinholeCamera,
    draw_ball,
    random_camera,
)

LEVEL = PinholeCamera((0.0, -2.0, 1.0), (0.0, 0.0, 1.0), (320, 240))
NOWHERE = np.array([[0.0, -50.0, 1.0]])  # behind the camera `LEVEL`


def test_up_is_up_right_is_right_and_behind_is_nowhere():
    camera = PinholeCamera((0.0, -2.0, 1.0), (0.0, 0.0, 1.0), (320, 240), fov_deg=90)
    points = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [1.0, 0.0, 1.0], [0.0, -3.0, 1.0]])
    aim, above, right, behind = camera.image_from_world(points)
    assert aim == pytest.approx([159.5, 119.5])
    assert above == pytest.approx([159.5, 119.5 - 60])
    assert right == pytest.approx([159.5 + 60, 119.5])
    assert np.isnan(behind).all()


@pytest.mark.parametrize(
    "values",
    [
        {"position_m": (0.0, 0.0, 3.0)},
        {"position_m": (float("nan"), 1.0, 1.0)},
        {"size_px": (0, 240)},
        {"size_px": (100_000, 240)},
        {"fov_deg": 0.0},
        {"fov_deg": float("nan")},
    ],
)
def test_a_camera_that_cannot_be_is_refused(values: dict):
    with pytest.raises(UsageError, match="camera"):
        PinholeCamera(**{"position_m": (1.0, 1.0, 1.0), "target_m": (0.0, 0.0, 0.0), **values})


def test_random_cameras_see_the_whole_drop():
    rng = np.random.default_rng(0)
    for _ in range(50):
        gap, radius = float(rng.uniform(0.3, 5)), float(rng.uniform(0.02, 0.1))
        camera = random_camera(rng, gap, radius)
        assert camera.sees(np.array([[0, 0, radius], [0, 0, gap + radius]]), margin_px=2)


def silhouette(camera: PinholeCamera, center_m: Array, radius_m: float) -> tuple[Array, float]:
    """Centroid (x, y) and area [px] of a sphere's outline: the circle where rays touch it."""
    to_ball = center_m - np.array(camera.position_m)
    distance = np.linalg.norm(to_ball)
    forward = to_ball / distance
    side = np.cross(forward, [0.3, 0.2, 1.0])
    side /= np.linalg.norm(side)
    turns = np.linspace(0, 2 * np.pi, 4000, endpoint=False)[:, None]
    rim = np.cos(turns) * side + np.sin(turns) * np.cross(forward, side)
    nearer = radius_m**2 / distance
    outline = (
        center_m - nearer * forward + np.sqrt(radius_m**2 - nearer * radius_m**2 / distance) * rim
    )
    x, y = camera.image_from_world(outline).T
    origin = np.array([x.mean(), y.mean()])
    x, y = x - origin[0], y - origin[1]
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    area = cross.sum() / 2
    middle = [((one + np.roll(one, -1)) * cross).sum() / 6 / area for one in (x, y)]
    return origin + np.array(middle), abs(area)


def drawn(camera: PinholeCamera, center_m: Array, radius_m: float) -> tuple[Array, float]:
    """Centroid (x, y) and area [px] of the drawn ball."""
    ball = draw_ball(camera, center_m, radius_m)
    left, top, right, bottom = ball.box
    rows, columns = np.mgrid[top:bottom, left:right]
    area = ball.cover.sum()
    return np.array([(ball.cover * columns).sum(), (ball.cover * rows).sum()]) / area, area


def test_a_drawn_ball_is_the_projection_of_a_sphere_wherever_it_is():
    camera = PinholeCamera((0.0, -2.0, 1.0), (0.1, 0.0, 0.8), (641, 480), fov_deg=100)
    rng = np.random.default_rng(2)
    off, areas, stretched = [], [], []
    for x in np.linspace(-2.2, 2.2, 7):
        for z in np.linspace(-0.9, 2.5, 7):
            center = np.array([x, rng.uniform(-0.1, 0.1), z])
            middle, area = silhouette(camera, center, 0.12)
            seen, covered = drawn(camera, center, 0.12)
            off.append(seen - middle)
            areas.append(covered / area)
            stretched.append(middle - camera.image_from_world(center[None])[0])
    assert np.abs(np.mean(off, axis=0)).max() < 0.005
    assert np.abs(off).max() < 0.03
    assert np.mean(areas) == pytest.approx(1, abs=2e-3)
    assert areas == pytest.approx(np.ones(len(areas)), abs=0.01)
    assert np.abs(stretched).max() > 0.5  # an ellipse's middle is not the projected centre


def test_the_balls_of_usual_films_are_where_the_camera_model_puts_them():
    rng = np.random.default_rng(1)
    off = []
    for _ in range(20):
        camera = random_camera(rng, 1.0, 0.06)
        for height in rng.uniform(0.06, 1.0, 5):
            center = np.array([0.0, 0.0, height])
            middle, area = silhouette(camera, center, 0.06)
            seen, covered = drawn(camera, center, 0.06)
            off.append(seen - middle)
            assert covered == pytest.approx(area, rel=0.02)
            assert middle == pytest.approx(camera.image_from_world(center[None])[0], abs=0.3)
    assert np.abs(np.mean(off, axis=0)).max() < 0.01
    assert np.std(off, axis=0).max() < 0.03


def test_a_ball_that_leaves_the_picture_is_cut_by_its_edge():
    wide = PinholeCamera(LEVEL.position_m, LEVEL.target_m, (720, 240))
    for x in (-1.6, -1.45, 0.0, 1.5):
        center = np.array([x, 0.0, 1.9])
        whole, part = np.zeros((240, 720)), np.zeros((240, 320))
        for camera, page in ((wide, whole), (LEVEL, part)):
            ball = draw_ball(camera, center, 0.2)
            left, top, right, bottom = ball.box
            page[top:bottom, left:right] = ball.cover
        assert np.allclose(whole[:, 200:520], part)
        assert whole.any()
    assert draw_ball(LEVEL, np.array([3.0, 0.0, 1.0]), 0.2).cover.size == 0


@pytest.mark.parametrize(
    ("depth_m", "covered"),
    [(-0.5, 0), (-0.11, 0), (0.0, 0), (0.05, 0), (0.1001, 1), (0.105, 1), (0.3, None)],
)
def test_a_ball_behind_the_camera_is_not_seen_and_one_before_the_lens_fills_the_picture(
    depth_m: float, covered: int | None
):
    center = np.array([0.0, -2.0 + depth_m, 1.0])
    cover = np.zeros((240, 320))
    ball = draw_ball(LEVEL, center, 0.1)
    left, top, right, bottom = ball.box
    cover[top:bottom, left:right] = ball.cover
    if covered is None:
        assert 0 < cover.mean() < 1
    else:
        assert np.all(cover == covered)
    picture = BallScene(LEVEL, 0.1, np.random.default_rng(0)).picture(center[None])
    assert np.isfinite(picture).all()
    assert picture.min() >= 0
    assert picture.max() <= 255


def test_a_ball_beside_the_camera_is_seen_by_the_part_that_is_in_front():
    wide = PinholeCamera(LEVEL.position_m, LEVEL.target_m, (1280, 240), fov_deg=150)
    ball = draw_ball(wide, np.array([0.5, -2.01, 1.0]), 0.45)
    assert ball.box[2] == 1280
    assert ball.cover[:, -1].max() == 1


def test_the_floor_ends_below_the_horizon_and_nothing_is_above():
    up = PinholeCamera((0.0, -2.0, 1.0), (0.0, 0.0, 1.5))
    picture = BallScene(up, 0.05, np.random.default_rng(3)).picture(NOWHERE)
    horizon = round(up.image_from_world(np.array([[0.0, 1e6, 1.0]]))[0, 1])
    assert np.all(picture[:horizon] == 255)
    assert np.all(picture[-10:] < 230)
    sky = PinholeCamera((0.0, -2.0, 1.0), (0.0, -1.0, 5.0))
    assert np.all(BallScene(sky, 0.05, np.random.default_rng(3)).picture(NOWHERE) == 255)
    for height in (0.0, -1.0):
        below = PinholeCamera((0.0, -2.0, height), (0.0, 0.0, 1.0))
        assert np.all(BallScene(below, 0.05, np.random.default_rng(3)).picture(NOWHERE) == 255)


def test_an_open_shutter_shows_the_mean_of_what_it_sees():
    camera = PinholeCamera((0.0, -2.0, 0.6), (0.0, 0.0, 0.6))
    scene = BallScene(camera, 0.05, np.random.default_rng(4))
    centers = np.array([[0.0, 0.0, 0.8], [0.0, 0.0, 0.82], [0.0, 0.0, 0.87]])
    each = [scene.picture(center[None]) for center in centers]
    assert np.allclose(scene.picture(centers), np.mean(each, axis=0))


def test_the_floor_is_darker_where_the_ball_takes_its_light():
    camera = PinholeCamera((0.0, -2.0, 1.0), (0.0, 0.0, 0.2))
    scene = BallScene(camera, 0.05, np.random.default_rng(5))
    dark = scene.picture(NOWHERE) - scene.picture(np.array([[0.0, 0.0, 0.4]]))
    column, row = np.round(camera.image_from_world(np.array([[-0.056, 0.08, 0.0]]))[0]).astype(int)
    assert dark[row, column].min() > 5
    assert np.count_nonzero(dark.any(axis=2)) < 0.05 * dark[:, :, 0].size


def test_rays_are_followed_in_pieces():
    """All the rays of this ball at once would need some 300 MB."""
    camera = PinholeCamera((0.0, -2.0, 1.0), (0.0, 0.0, 1.0), (640, 480))
    tracemalloc.start()
    ball = draw_ball(camera, np.array([0.0, -1.89, 1.0]), 0.1)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert ball.cover.size > 0.9 * 640 * 480
    assert peak < 40e6
