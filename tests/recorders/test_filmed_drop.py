"""Filmed drops: the camera is where it is said to be, and its film does as it is told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Command
from tests.engines import needs_pybullet
from tunenet_logs.errors import UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, film_drop, simulate_drop
from tunenet_logs.recorders.simulators.ball import TOPIC
from tunenet_logs.recorders.simulators.camera import PinholeCamera, random_camera

ORDER = DropOrder(restitution=0.6, height_m=1.0, seconds=1.0, seed=3)


def test_the_middle_of_the_picture_is_what_the_camera_looks_at():
    camera = PinholeCamera((2.0, -1.0, 1.5), (0.0, 0.0, 0.4), (320, 240))
    assert camera.image_from_world(np.array([[0.0, 0.0, 0.4]]))[0] == pytest.approx([159.5, 119.5])


def test_up_is_up_right_is_right_and_behind_is_nowhere():
    camera = PinholeCamera((0.0, -2.0, 1.0), (0.0, 0.0, 1.0), (320, 240), fov_deg=90)
    points = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 1.0], [0.0, -3.0, 1.0]])
    above, right, behind = camera.image_from_world(points)
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


def test_the_same_order_gives_the_same_bits_and_the_seed_another_camera():
    small = FilmOrder(size_px=(160, 120))
    first, second, other = (film_drop(replace(ORDER, seed=seed), small) for seed in (3, 3, 4))
    assert first.info == second.info
    assert [one.data for one in first.frames()] == [one.data for one in second.frames()]
    assert first.info.notes["camera_position_m"] != other.info.notes["camera_position_m"]


def test_a_seed_is_one_drop_filmed_or_not():
    plain = simulate_drop(DropOrder(seed=8, height_m=1.0))
    filmed = film_drop(DropOrder(seed=8, height_m=1.0), FilmOrder())
    assert filmed.info.truth == plain.info.truth
    assert filmed.info.rig == plain.info.rig


def test_lost_frames_are_missing_with_their_stamps():
    filmed = film_drop(ORDER, FilmOrder(size_px=(160, 120), lost_share=0.3))
    stamps = [frame.stamp_ns for frame in filmed.frames()]
    every = simulate_drop(ORDER).signals[TOPIC].stamps_ns.tolist()
    assert len(stamps) == len(every) - int(filmed.info.notes["lost_frames"])
    assert 0 < int(filmed.info.notes["lost_frames"]) < 0.6 * len(every)
    assert set(stamps) < set(every)


def test_an_open_shutter_smears_the_falling_ball_only():
    camera = PinholeCamera((0.0, -2.0, 0.6), (0.0, 0.0, 0.6), (320, 240))
    order, falling = replace(ORDER, rate_hz=20, seconds=0.45, hold_s=0.2), 12
    sharp, blurred = (
        [one.decode().astype(float) for one in film_drop(order, film).frames()]
        for film in (
            FilmOrder(camera=camera, noise=0),
            FilmOrder(camera=camera, noise=0, exposure_s=0.016),
        )
    )
    assert np.abs(sharp[3] - blurred[3]).max() < 3
    assert np.abs(sharp[falling] - blurred[falling]).max() > 40


def test_the_command_records_pictures_and_no_positions(command: Command, tmp_path: Path):
    result = command(
        "tunenet-record", "--simulate", "drop", "--render", "--restitution", 0.6, "--height", 1,
        "--seconds", 0.5, "--size", "160x120", "--camera-at", "1.5,-1,1", "-o", "a.mcap",
        cwd=tmp_path,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "30 frames captured, 30 written, 0 dropped" in result.stdout
    episode = read_episode(tmp_path / "a.mcap")
    assert not episode.signals
    assert episode.picture_topics == ("/camera/image_raw/compressed",)
    pictures = [frame.decode() for frame in episode.frames()]
    assert len(pictures) == 30
    assert pictures[0].shape == (120, 160, 3)
    assert episode.info.notes["camera_position_m"] == "1.5000, -1.0000, 1.0000"


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--blur", "4"), "--blur"),
        (("--size", "320x240"), "--size"),
        (("--render", "--look-at", "0,0,1"), "--look-at"),
        (("--render", "--camera-at", "0,0,5", "--height", "1"), "camera"),
        (("--render", "--camera-at", "1,2"), "--camera-at"),
        (("--render", "--lost", "1"), "--lost"),
        (("--render", "--size", "5"), "--size"),
        pytest.param(
            ("--render", "--preset", "paper", "--blur", "4"), "--blur", marks=needs_pybullet
        ),
        (("--render", "--fov", "2"), "--fov"),
    ],
)
def test_a_bad_order_is_one_line_that_names_it(
    command: Command, tmp_path: Path, words: tuple[str, ...], named: str
):
    result = command("tunenet-record", "--simulate", "drop", *words, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert named in result.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("place", [".", "/"])
def test_a_folder_is_no_log(command: Command, tmp_path: Path, place: str):
    result = command("tunenet-record", "--simulate", "drop", "-o", place, cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "is a folder" in result.stderr
