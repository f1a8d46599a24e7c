"""`tunenet-record --simulate`: what was asked for is recorded, and the seed draws the rest."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tests.recorders.conftest import Record, Refuses
from tunenet_logs.episode import Array, Episode
from tunenet_logs.errors import UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulated import (
    DropOrder,
    FilmOrder,
    PayloadOrder,
    film_drop,
    simulate_drop,
    simulate_payload,
)
from tunenet_logs.recorders.simulators.arm.description import JACO_URDF, Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import circle, path_from_file, write_path_file
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm
from tunenet_logs.recorders.simulators.ball import TOPIC
from tunenet_logs.recorders.simulators.camera import (
    BallScene,
    PinholeCamera,
    draw_ball,
    random_camera,
)
from tunenet_logs.recorders.simulators.known import engine
from tunenet_logs.recorders.simulators.shot import BounceShot, ShotRig

ARM = jaco()
PAYLOAD = ("--simulate", "payload")
ORDER = DropOrder(restitution=0.6, height_m=1.0, seconds=1.0, seed=3)
SMALL = FilmOrder(size_px=(160, 120))

# ---- Drops


def test_a_drop_is_recorded_as_was_asked_for(record: Record, tmp_path: Path):
    result = record(
        "--simulate", "drop", "--restitution", 0.55, "--height", 1.4, "--radius", 0.02,
        "--rate", 120, "--seconds", 2, "--hold", 0.5, "-o", "a.mcap",
    )  # fmt: skip
    assert "300 samples captured, 300 written, 0 dropped" in result.stdout
    episode = read_episode(tmp_path / "a.mcap")
    heights = episode.signals[TOPIC].values[:, 2]
    assert episode.signals[TOPIC].rate_hz == pytest.approx(120)
    assert np.all(heights[:60] == 1.42)
    assert heights[75] < 1.4
    assert episode.info.truth == {"restitution": 0.55, "restitution_slope": 0.0, "drag": 0.0}
    assert episode.info.rig == {"ball_diameter_m": 0.04, "drop_height_m": 1.4}
    assert episode.info.counts == {"captured": 300, "dropped": 0, "written": 300}


def test_the_seed_draws_what_was_not_asked_for():
    first, second, other = (simulate_drop(DropOrder(seed=seed)) for seed in (4, 4, 5))
    assert first.info == second.info
    assert first.info.truth != other.info.truth
    assert 0.1 <= first.info.truth["restitution"] <= 0.95
    assert 0.3 <= first.info.rig["drop_height_m"] <= 5
    noisy = simulate_drop(replace(ORDER, noise_m=0.003)).signals[TOPIC]
    off = noisy.values - simulate_drop(ORDER).signals[TOPIC].values
    assert np.std(off) == pytest.approx(0.003, rel=0.1)
    first, second, other = (film_drop(replace(ORDER, seed=seed), SMALL) for seed in (3, 3, 4))
    assert first.info == second.info
    assert [one.data for one in first.frames()] == [one.data for one in second.frames()]
    assert first.info.notes["camera_position_m"] != other.info.notes["camera_position_m"]
    plain = simulate_drop(ORDER)  # a seed is one drop, filmed or not
    assert (first.info.truth, first.info.rig) == (plain.info.truth, plain.info.rig)


@needs_pybullet
def test_the_papers_presets_have_the_papers_rates():
    pose = simulate_drop(DropOrder(preset="paper")).signals[TOPIC]
    assert pose.rate_hz == pytest.approx(60)
    with pytest.raises(UsageError, match="60 Hz"):
        simulate_drop(DropOrder(preset="paper", rate_hz=240))
    episode = simulate_payload(PayloadOrder(mass_kg=0.4, preset="paper"))
    assert episode.info.preset == "paper"
    effort = episode.signals["/joint_states.effort"]
    assert (effort.values.shape, effort.rate_hz) == ((1200, 7), pytest.approx(240))


# ---- Filmed drops


def test_the_command_records_pictures_and_no_positions(record: Record, tmp_path: Path):
    result = record(
        "--simulate", "drop", "--render", "--restitution", 0.6, "--height", 1, "--seconds", 0.5,
        "--size", "160x120", "--camera-at", "1.5,-1,1", "-o", "a.mcap",
    )  # fmt: skip
    assert "30 frames captured, 30 written, 0 dropped" in result.stdout
    episode = read_episode(tmp_path / "a.mcap")
    assert not episode.signals
    assert episode.picture_topics == ("/camera/image_raw/compressed",)
    assert [frame.decode().shape for frame in episode.frames()] == [(120, 160, 3)] * 30
    assert episode.info.notes["camera_position_m"] == "1.5000, -1.0000, 1.0000"


def test_lost_frames_are_missing_with_their_stamps():
    filmed = film_drop(ORDER, replace(SMALL, lost_share=0.3))
    stamps = [frame.stamp_ns for frame in filmed.frames()]
    every = simulate_drop(ORDER).signals[TOPIC].stamps_ns.tolist()
    lost = int(filmed.info.notes["lost_frames"])
    assert len(stamps) == len(every) - lost
    assert 0 < lost < 0.6 * len(every)
    assert set(stamps) < set(every)


def test_an_open_shutter_smears_the_falling_ball_only():
    camera = PinholeCamera((0.0, -2.0, 0.6), (0.0, 0.0, 0.6), (320, 240))
    order, falling = replace(ORDER, rate_hz=20, seconds=0.45, hold_s=0.2), 12
    still = FilmOrder(camera=camera, noise=0)
    sharp, blurred = (
        [one.decode().astype(float) for one in film_drop(order, each).frames()]
        for each in (still, replace(still, exposure_s=0.016))
    )
    assert np.abs(sharp[3] - blurred[3]).max() < 3
    assert np.abs(sharp[falling] - blurred[falling]).max() > 40


# ---- Payloads


def efforts(episode: Episode) -> np.ndarray:
    return episode.signals["/joint_states.effort"].values


def test_a_payload_is_recorded_as_was_asked_for(record: Record, tmp_path: Path):
    result = record(*PAYLOAD, "--mass", 0.62, "--com", "0.03,0,-0.01", "-o", "a.mcap")
    made = f"0.6200 kg, by {engine().name}, inverse dynamics"
    assert f"{made}; 300 samples captured, 300 written, 0 dropped" in result.stdout
    episode = read_episode(tmp_path / "a.mcap")
    assert episode.info.kind == "payload"
    com = {"payload_com_x": 0.03, "payload_com_y": 0.0, "payload_com_z": -0.01}
    assert episode.info.truth == {"payload_mass": 0.62, **com}
    path, held = circle(60), Payload(0.62, (0.03, 0.0, -0.01))
    assert np.array_equal(efforts(episode), joint_efforts_nm(ARM, path, held))
    position = episode.signals["/joint_states.position"]
    assert position.columns == ARM.joint_names
    assert np.array_equal(position.values, path.position_rad)
    velocity = episode.signals["/joint_states.velocity"].values
    assert np.array_equal(velocity, path.velocity_rad_s)
    assert not episode.warnings


def test_a_driver_and_its_tare(record: Record, tmp_path: Path):
    words = ("--driver", "--seed", 3, "--seconds", 4, "-o")
    record(*PAYLOAD, *words, "held.mcap")
    tare = record(*PAYLOAD, "--empty", *words, "tare.mcap")
    assert "no payload" in tare.stdout
    first, empty = (read_episode(tmp_path / name) for name in ("held.mcap", "tare.mcap"))
    for name in ("offset_nm", "lag_s"):
        assert first.info.notes[name] == empty.info.notes[name]
    assert empty.info.truth["payload_mass"] == 0
    assert 0.1 <= first.info.truth["payload_mass"] <= 1.5
    for episode in (first, empty):
        signal = episode.signals["/joint_states.effort"]
        assert signal.seconds[-1] == pytest.approx(4, abs=0.05)
        assert len(signal.stamps_ns) / signal.seconds[-1] == pytest.approx(65, rel=0.02)
    assert not np.array_equal(efforts(first)[:100, 6], efforts(empty)[:100, 6])


def test_a_saved_path_can_be_commanded(record: Record, refuses: Refuses, tmp_path: Path):
    saved = record(*PAYLOAD, "--save-path", "circle.csv")
    assert "6.24 s from rest to rest" in saved.stdout
    assert [one.name for one in tmp_path.iterdir()] == ["circle.csv"]
    path = path_from_file(ARM, tmp_path / "circle.csv", rate_hz=100)
    limits = np.array([joint.max_velocity_rad_s for joint in ARM.joints])
    assert (np.abs(path.velocity_rad_s) / limits).max() < 0.72
    assert np.abs(path.velocity_rad_s[[0, -1]]).max() < 0.01
    assert np.abs(path.position_rad[-1] - path.position_rad[0]).max() < 2e-3
    assert np.abs(path.acceleration_rad_s2).max() < 1
    record(*PAYLOAD, "--path", "circle.csv", "-o", "a.mcap")
    assert read_episode(tmp_path / "a.mcap").info.notes["path"] == "circle.csv"
    refuses(1, *PAYLOAD, "--save-path", "circle.csv", says="--overwrite")


def test_another_arm_by_its_file(record: Record, tmp_path: Path):
    words = ("--urdf", JACO_URDF, "--tool-link", "j2s7s300_link_7", "--mass", 1, "-o", "a.mcap")
    record(*PAYLOAD, *words)
    assert read_episode(tmp_path / "a.mcap").info.notes["path"] == "random"


def test_an_order_replaces_its_share_of_what_the_seed_draws():
    first, again, other = (
        simulate_payload(PayloadOrder(path="random", seed=seed)) for seed in (4, 4, 5)
    )
    assert np.array_equal(efforts(first), efforts(again))
    assert first.info == again.info
    assert first.info.truth != other.info.truth
    order = PayloadOrder(mass_kg=0.5, is_driver=True, torque_noise_nm=0.0, lag_s=0.01, rate_hz=10)
    notes = simulate_payload(order).info.notes
    assert "torque_noise_nm" not in notes
    assert (notes["lag_s"], notes["rate_hz"]) == ("0.01", "10")
    only = simulate_payload(PayloadOrder(mass_kg=0.5, offset_nm=0.3)).info.notes
    assert "offset_nm" in only
    assert "gain_error" not in only


def test_a_path_shorter_than_was_asked_for_is_refused(tmp_path: Path):
    path, file = circle(100, 2), tmp_path / "short.csv"
    write_path_file(file, ARM.joint_names, path.seconds, path.position_rad, overwrite=False)
    with pytest.raises(UsageError, match=r"short\.csv.*lasts 1\.9.*asks for 5"):
        simulate_payload(PayloadOrder(path=str(file), seconds=5.0))


# ---- Bounce shots


def test_a_shot_is_recorded(record: Record, tmp_path: Path):
    shot = ("--simulate", "bounce-shot", "--restitution", 0.7)
    result = record(*shot, "--height", 0.335, "-o", "a.mcap")
    assert "through the hoop" in result.stdout
    episode = read_episode(tmp_path / "a.mcap")
    assert (episode.info.kind, episode.info.truth["success"]) == ("bounce-shot", 1)
    assert episode.info.rig["shot_height_m"] == 0.335
    ball = episode.signals[TOPIC]
    assert ball.rate_hz == pytest.approx(240)
    again = BounceShot(ShotRig(), 0.335).rollout({"restitution": 0.7})
    assert np.array_equal(ball.values, again.signals[TOPIC].values)
    record(*shot, "--slope", 0.1, "--drag", 0.05, "--height", 0.5, "-o", "b.mcap")
    truth = read_episode(tmp_path / "b.mcap").info.truth
    assert (truth["restitution_slope"], truth["drag"]) == (0.1, 0.05)


# ---- A camera is where it is said to be, and the drawn ball is the projection of a sphere

LEVEL = PinholeCamera((0.0, -2.0, 1.0), (0.0, 0.0, 1.0), (320, 240))


def test_up_is_up_right_is_right_and_behind_is_nowhere():
    camera = PinholeCamera((0.0, -2.0, 1.0), (0.0, 0.0, 1.0), (320, 240), fov_deg=90)
    points = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [1.0, 0.0, 1.0], [0.0, -3.0, 1.0]])
    aim, above, right, behind = camera.image_from_world(points)
    assert aim == pytest.approx([159.5, 119.5])
    assert above == pytest.approx([159.5, 119.5 - 60])
    assert right == pytest.approx([159.5 + 60, 119.5])
    assert np.isnan(behind).all()


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
        assert camera.sees(np.array([[0, 0, 0.06], [0, 0, 1.06]]), margin_px=2)
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
def test_a_ball_behind_the_camera_or_before_the_lens(depth_m: float, covered: int | None):
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


def test_rays_are_followed_in_pieces():
    """All the rays of this ball at once would need some 300 MB."""
    camera = PinholeCamera((0.0, -2.0, 1.0), (0.0, 0.0, 1.0), (640, 480))
    tracemalloc.start()
    ball = draw_ball(camera, np.array([0.0, -1.89, 1.0]), 0.1)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert ball.cover.size > 0.9 * 640 * 480
    assert peak < 40e6
