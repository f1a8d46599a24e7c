"""Paths of an arm, the torques along them, and a driver's disturbances: each does what it says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio  # pyright: ignore[reportMissingImports]  (where no type checker looks)
import pytest

from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.recorders.simulators.arm.description import Arm, Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import (
    CIRCLE_CSV,
    CIRCLE_RAD_S,
    JointPath,
    circle,
    circle_at,
    eased,
    link_poses,
    path_from_file,
    random_path,
    read_path_file,
    write_path_file,
)
from tunenet_logs.recorders.simulators.arm.payload import (
    CALIBRATED,
    REAL_ARM,
    TOPIC,
    Disturbances,
    PayloadRollout,
    drawn,
    driver_episode,
    joint_efforts_nm,
    perturbed,
    roll_out,
    through_kinovas_driver,
)

ARM = jaco()
every_engine = pytest.mark.usefixtures("each_engine")

# ---- Paths: the paper's circle, random ones, a user's file


def check_derivatives(path: JointPath, tolerance: float) -> None:
    step = path.seconds[1] - path.seconds[0]
    for values, derivative in (
        (path.position_rad, path.velocity_rad_s),
        (path.velocity_rad_s, path.acceleration_rad_s2),
    ):
        slopes = (values[2:] - values[:-2]) / (2 * step)
        assert np.abs(slopes - derivative[1:-1]).max() < tolerance


def share_of_speed(path: JointPath, arm: Arm = ARM) -> float:
    limits = np.array([joint.max_velocity_rad_s for joint in arm.joints])
    return float((np.abs(path.velocity_rad_s) / limits).max())


def test_the_tool_goes_round_the_papers_circle():
    path = circle(240, 6)
    angle = CIRCLE_RAD_S * path.seconds
    across, up = 0.2 * np.cos(angle), 0.3 + 0.2 * np.sin(angle)
    wanted = np.column_stack([np.full(len(angle), -0.4), across, up])
    assert np.abs(link_poses(ARM, path.position_rad).position_m[:, -1] - wanted).max() < 1e-9
    assert share_of_speed(path) < 0.71
    check_derivatives(path, 1e-4)
    turn_later = circle_at(path.seconds + 2 * np.pi / CIRCLE_RAD_S)
    assert np.abs(turn_later.position_rad - path.position_rad).max() < 1e-9
    names, seconds, position_rad = read_path_file(CIRCLE_CSV)  # one turn that can be commanded
    assert names == ARM.joint_names
    assert seconds[-1] == pytest.approx(2 * np.pi / CIRCLE_RAD_S, abs=1e-6)
    assert np.array_equal(position_rad[0], position_rad[-1])


def test_frames_are_where_another_library_has_them():
    model = pinocchio.buildModelFromXML(ARM.urdf())
    data = model.createData()
    path = random_path(ARM, 0, rate_hz=5)
    poses = link_poses(ARM, path.position_rad)
    for row, angles in enumerate(path.position_rad):
        pinocchio.forwardKinematics(model, data, angles)
        for index in range(1, 8):
            assert np.abs(data.oMi[index].translation - poses.position_m[row, index]).max() < 1e-9
            assert np.abs(data.oMi[index].rotation - poses.rotation[row, index]).max() < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_random_motions_are_smooth_and_allowed(seed: int):
    path = random_path(ARM, seed, rate_hz=240).checked(ARM)
    assert 0.3 < share_of_speed(path) <= 0.7
    check_derivatives(path, 1e-3)
    again = random_path(ARM, seed, rate_hz=240)
    assert np.array_equal(path.position_rad, again.position_rad)
    assert link_poses(ARM, path.position_rad).position_m[:, -1, 2].min() > 0


@pytest.mark.parametrize("lasts_s", [5.0, 0.8])
def test_an_eased_path_goes_the_same_way_from_rest_to_rest(lasts_s: float):
    path = circle(240, lasts_s)
    easy = eased(path, 1.0, rate_hz=1000)
    check_derivatives(easy, 0.01)
    assert np.abs(easy.velocity_rad_s[[0, -1]]).max() == 0
    assert np.abs(easy.acceleration_rad_s2[[0, -1]]).max() < 1e-9
    assert np.abs(easy.position_rad[[0, -1]] - path.position_rad[[0, -1]]).max() < 1e-9
    assert share_of_speed(easy) <= share_of_speed(path) + 1e-6
    tool_m = link_poses(ARM, easy.position_rad).position_m[:, -1] - [-0.4, 0.0, 0.3]
    assert np.abs(np.hypot(tool_m[:, 1], tool_m[:, 2]) - 0.2).max() < 1e-6


def test_a_path_comes_back_from_its_file(tmp_path: Path):
    file = tmp_path / "path.csv"
    path = random_path(ARM, 1, rate_hz=100)
    names = ARM.joint_names[::-1]
    write_path_file(file, names, path.seconds + 7, path.position_rad[:, ::-1], overwrite=False)
    back = path_from_file(ARM, file, rate_hz=100)
    assert np.abs(back.position_rad - path.position_rad[: len(back.seconds)]).max() < 1e-6
    assert np.abs(back.acceleration_rad_s2 - path.acceleration_rad_s2[:-1])[5:-5].max() < 1e-3
    with pytest.raises(LogError, match="--overwrite"):
        write_path_file(file, names, path.seconds, path.position_rad, overwrite=False)


HEADER = "time_s," + ",".join(ARM.joint_names)
ROW = ",0.3,3.4,0.7,1.4,2.3,1.9,0.7"
NINE = "".join(f"{t}{ROW.replace('3.4', '0.1')}\n" for t in range(9))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["0 rows"]),
        ("a,b\n1,2\n", ["time_s"]),
        (f"{HEADER}\n0{ROW}\n0{ROW}\n", ["line 3", "increase"]),
        (f"{HEADER}\n0{ROW}\n1{ROW},4\n", ["line 3", "9 values", "8 columns"]),
        (f"{HEADER}\n0{ROW}\nx{ROW}\n", ["line 3", "time_s", "'x'"]),
        (f"{HEADER}\n0{ROW}\n1{ROW.replace('3.4', 'nan')}\n", ["line 3", "joint_2", "nan"]),
        (f"{HEADER}\n0{ROW}\n1{ROW}\n", ["2 rows", "at least 6"]),
        (f"{HEADER.replace('joint_3', 'joint_2')}\n0{ROW}\n", ["one name"]),
        (f"{HEADER.replace('joint_3', 'joint_9')}\n0{ROW}\n1{ROW}\n", ["joint_3", "joint_9"]),
        (f"{HEADER}\n{NINE}", ["joint_2", "limits"]),
        ('a"\n\x00', ["time_s"]),
    ],
)
def test_a_bad_table_is_one_line_with_the_place(tmp_path: Path, text: str, words: list[str]):
    file = tmp_path / "path.csv"
    file.write_text(text)
    with pytest.raises(UsageError) as caught:
        path_from_file(ARM, file)
    for word in (str(file), *words):
        assert word in str(caught.value)


# ---- Torques: a rollout and inverse dynamics agree; payloads do what they weigh

SHIFTED = Payload(0.7, (0.01, 0.02, -0.01))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@every_engine
def test_a_rollout_applies_the_torques_of_inverse_dynamics_whatever_ran_before():
    times = CALIBRATED.times()
    rollout = roll_out(ARM, circle_at(times), SHIFTED)
    along_the_circle = joint_efforts_nm(ARM, circle_at(times[150:-1]), SHIFTED)
    assert rms(rollout.effort_nm - along_the_circle) < 0.001
    where_it_went = joint_efforts_nm(ARM, rollout.path, SHIFTED)
    assert rms(rollout.effort_nm - where_it_went) < 1e-9
    short = replace(CALIBRATED, samples=50)
    path = circle_at(short.times())
    first = roll_out(ARM, path, SHIFTED, short).effort_nm
    joint_efforts_nm(ARM, circle(), Payload(3.0))
    assert np.array_equal(roll_out(ARM, path, SHIFTED, short).effort_nm, first)


@every_engine
def test_the_rollout_simulator_samples_what_was_before_a_step():
    settings = replace(CALIBRATED, samples=240)
    simulator = PayloadRollout(ARM, circle_at(settings.times()), SHIFTED.com_m, settings)
    episode = simulator.rollout({"payload_mass": 0.7})
    efforts = episode.signals[f"{TOPIC}.effort"]
    assert efforts.rate_hz == pytest.approx(60)
    wanted = circle_at(settings.times()[150:-1:4])
    assert rms(efforts.values - joint_efforts_nm(ARM, wanted, SHIFTED)) < 0.001
    reached = episode.signals[f"{TOPIC}.position"].values
    assert np.abs(reached - wanted.position_rad).max() < 2e-4


# ---- Disturbances

PATH, HELD = circle(240), Payload(0.6)


@pytest.fixture(scope="module")
def ideal() -> np.ndarray:
    return joint_efforts_nm(ARM, PATH, HELD)


def of(episode: Episode, part: str) -> np.ndarray:
    return episode.signals[f"/joint_states.{part}"].values


def effort(**disturbances: Any) -> np.ndarray:
    return of(driver_episode(ARM, PATH, HELD, Disturbances(**disturbances)), "effort")


def test_noise_offsets_gains_and_friction(ideal: np.ndarray):
    off = effort(torque_noise_nm=0.2) - ideal  # white, and as large as was asked for
    assert np.std(off, axis=0) == pytest.approx(np.full(7, 0.2), rel=0.1)
    assert np.abs(np.mean(off[1:] * off[:-1], axis=0)).max() < 0.1 * 0.2**2
    offsets, speed = tuple(np.linspace(-0.3, 0.3, 7)), PATH.velocity_rad_s
    assert np.abs(effort(offset_nm=offsets) - ideal - offsets).max() < 1e-12
    assert np.abs(effort(gain_error=(0.03,) * 7) - 1.03 * ideal).max() < 1e-12
    assert np.abs(effort(viscous_nm_s=(0.5,) * 7) - ideal - 0.5 * speed).max() < 1e-12
    coulomb = effort(coulomb_nm=(0.4,) * 7) - ideal
    assert np.abs(coulomb - 0.4 * np.sign(speed))[np.abs(speed) > 0.05].max() < 1e-3
    assert np.abs(coulomb).max() < 0.4 + 1e-9


def test_torques_that_lag():
    late = effort(lag_s=4.4 / 240)
    before = joint_efforts_nm(ARM, circle(240 * 5, 5), HELD)  # a fifth of a sample each
    first = len(PATH.seconds) - len(late)
    assert np.abs(late - before[5 * first - 22 :: 5][: len(late)]).max() < 1e-5


def test_an_arm_that_differs_from_its_description():
    disturbances = Disturbances(
        link_mass_error=(0.0, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0),
        link_com_error_m=((0.0, 0.0, 0.0),) * 6 + ((0.003, 0.0, 0.0),),
    )
    other = perturbed(ARM, disturbances)
    assert other.joints[1].link.mass_kg == pytest.approx(1.05 * 0.8447)
    assert other.joints[6].link.com_m[0] == pytest.approx(0.003)
    assert other.joints[3] == ARM.joints[3]
    efforts = of(driver_episode(ARM, PATH, HELD, disturbances), "effort")
    assert np.array_equal(efforts, joint_efforts_nm(other, PATH, HELD))


def test_fields_are_new_at_their_own_rates_and_repeated_between():
    episode = driver_episode(ARM, PATH, HELD, through_kinovas_driver(drawn(3, ARM)))
    stamps = episode.signals["/joint_states.effort"].stamps_ns
    seconds = (stamps[-1] - stamps[0]) * 1e-9
    assert len(stamps) / seconds == pytest.approx(65, rel=0.02)
    assert np.std(np.diff(stamps)) > 1e6  # jitter
    for part, rate_hz in (("position", 30), ("velocity", 16), ("effort", 58)):
        fresh = np.any(np.diff(of(episode, part), axis=0) != 0, axis=1)
        assert np.count_nonzero(fresh) / seconds == pytest.approx(rate_hz, rel=0.03)
    at = np.interp(stamps * 1e-9, PATH.seconds, PATH.position_rad[:, 0])
    assert np.abs(of(episode, "position")[:, 0] - at).max() < 0.1
    slow = driver_episode(ARM, PATH, HELD, through_kinovas_driver(drawn(3, ARM), 10))
    assert slow.signals["/joint_states.effort"].rate_hz == pytest.approx(10, rel=0.02)
    for part in ("position", "velocity", "effort"):  # nothing is stale
        assert np.all(np.any(np.diff(of(slow, part), axis=0) != 0, axis=1))


def test_drawn_disturbances_are_as_large_as_stated():
    many = [drawn(seed, ARM) for seed in range(300)]
    sizes = {
        "offset_nm": 0.3, "viscous_nm_s": 0.5, "coulomb_nm": 0.5, "gain_error": 0.03,
        "link_mass_error": 0.05, "link_com_error_m": 0.003,
    }  # fmt: skip
    for name, size in sizes.items():
        values = np.array([getattr(one, name) for one in many])
        assert rms(values) == pytest.approx(size, rel=0.05)
    assert min(min(one.coulomb_nm) for one in many) >= 0
    lags = [one.lag_s for one in many]
    assert 0 <= min(lags) < 0.003
    assert 0.027 < max(lags) <= 0.03
    either = replace(REAL_ARM, friction_opposes=False)
    assert min(min(drawn(seed, ARM, either).coulomb_nm) for seed in range(3)) < -0.1


def test_a_path_too_short_is_refused():
    with pytest.raises(UsageError, match="too short"):
        driver_episode(ARM, circle(240, 0.05), None, through_kinovas_driver(drawn(1, ARM)))
