"""tunenet-record --simulate payload as a user runs it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Command
from tests.engines import needs_pybullet
from tunenet_logs.episode import Episode
from tunenet_logs.errors import UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulated import PayloadOrder, simulate_payload
from tunenet_logs.recorders.simulators.arm.description import JACO_URDF, Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import circle, path_from_file
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm
from tunenet_logs.recorders.simulators.known import engine

ARM = jaco()
PAYLOAD = ("tunenet-record", "--simulate", "payload")


def efforts(episode: Episode) -> np.ndarray:
    return episode.signals["/joint_states.effort"].values


def test_records_what_was_asked_for(command: Command, tmp_path: Path):
    log = tmp_path / "a.mcap"
    result = command(*PAYLOAD, "--mass", 0.62, "--com", "0.03,0,-0.01", "-o", log)
    assert result.returncode == 0, result.stderr
    made = f"0.6200 kg, by {engine().name}, inverse dynamics"
    assert f"{made}; 300 samples captured, 300 written, 0 dropped" in result.stdout
    episode = read_episode(log)
    assert episode.info.kind == "payload"
    assert episode.info.truth == {
        "payload_mass": 0.62, "payload_com_x": 0.03, "payload_com_y": 0.0, "payload_com_z": -0.01,
    }  # fmt: skip
    path, held = circle(60), Payload(0.62, (0.03, 0.0, -0.01))
    assert np.array_equal(efforts(episode), joint_efforts_nm(ARM, path, held))
    position = episode.signals["/joint_states.position"]
    assert position.columns == ARM.joint_names
    assert np.array_equal(position.values, path.position_rad)
    velocity = episode.signals["/joint_states.velocity"].values
    assert np.array_equal(velocity, path.velocity_rad_s)
    assert not episode.warnings


def test_a_driver_and_its_tare(command: Command, tmp_path: Path):
    words = ("--driver", "--seed", 3, "--seconds", 4, "-o")
    held = command(*PAYLOAD, *words, "held.mcap", cwd=tmp_path)
    tare = command(*PAYLOAD, "--empty", *words, "tare.mcap", cwd=tmp_path)
    assert held.returncode == tare.returncode == 0, held.stderr + tare.stderr
    assert "no payload" in tare.stdout
    first, empty = (read_episode(tmp_path / name) for name in ("held.mcap", "tare.mcap"))
    assert first.info.notes["offset_nm"] == empty.info.notes["offset_nm"]
    assert first.info.notes["lag_s"] == empty.info.notes["lag_s"]
    assert empty.info.truth["payload_mass"] == 0
    assert 0.1 <= first.info.truth["payload_mass"] <= 1.5
    for episode in (first, empty):
        signal = episode.signals["/joint_states.effort"]
        assert signal.seconds[-1] == pytest.approx(4, abs=0.05)
        assert len(signal.stamps_ns) / signal.seconds[-1] == pytest.approx(65, rel=0.02)
    assert not np.array_equal(efforts(first)[:100, 6], efforts(empty)[:100, 6])


def test_the_path_that_is_saved_can_be_commanded_and_simulated(command: Command, tmp_path: Path):
    saved = command(*PAYLOAD, "--save-path", "circle.csv", cwd=tmp_path)
    assert saved.returncode == 0, saved.stderr
    assert "6.24 s from rest to rest" in saved.stdout
    assert [one.name for one in tmp_path.iterdir()] == ["circle.csv"]
    path = path_from_file(ARM, tmp_path / "circle.csv", rate_hz=100)
    limits = np.array([joint.max_velocity_rad_s for joint in ARM.joints])
    assert (np.abs(path.velocity_rad_s) / limits).max() < 0.72
    assert np.abs(path.velocity_rad_s[[0, -1]]).max() < 0.01
    assert np.abs(path.position_rad[-1] - path.position_rad[0]).max() < 2e-3
    assert np.abs(path.acceleration_rad_s2).max() < 1
    result = command(*PAYLOAD, "--path", "circle.csv", "-o", "a.mcap", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert read_episode(tmp_path / "a.mcap").info.notes["path"] == "circle.csv"
    again = command(*PAYLOAD, "--save-path", "circle.csv", cwd=tmp_path)
    assert again.returncode == 1
    assert "--overwrite" in again.stderr


def test_another_arm_by_its_file(command: Command, tmp_path: Path):
    words = ("--urdf", JACO_URDF, "--tool-link", "j2s7s300_link_7", "--mass", 1, "-o", "a.mcap")
    result = command(*PAYLOAD, *words, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert read_episode(tmp_path / "a.mcap").info.notes["path"] == "random"


@needs_pybullet
def test_the_papers_preset_is_a_rollout_at_240_hz():
    episode = simulate_payload(PayloadOrder(mass_kg=0.4, preset="paper"))
    assert efforts(episode).shape == (1200, 7)
    assert episode.info.preset == "paper"
    assert episode.signals["/joint_states.effort"].rate_hz == pytest.approx(240)


def test_the_seed_draws_what_was_not_asked_for():
    first, again, other = (
        simulate_payload(PayloadOrder(path="random", seed=seed)) for seed in (4, 4, 5)
    )
    assert np.array_equal(efforts(first), efforts(again))
    assert first.info == again.info
    assert first.info.truth != other.info.truth
    assert not np.array_equal(efforts(first), efforts(other))


def test_what_is_ordered_replaces_its_share_of_a_driver():
    order = PayloadOrder(mass_kg=0.5, is_driver=True, torque_noise_nm=0.0, lag_s=0.01, rate_hz=10)
    notes = simulate_payload(order).info.notes
    assert "torque_noise_nm" not in notes
    assert notes["lag_s"] == "0.01"
    assert notes["rate_hz"] == "10"
    only = simulate_payload(PayloadOrder(mass_kg=0.5, offset_nm=0.3)).info.notes
    assert "offset_nm" in only
    assert "gain_error" not in only


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["--mass", "-1"], ["--mass", "'-1'"]),
        (["--mass", "nan"], ["--mass", "'nan'"]),
        (["--com", "0,0"], ["--com", "'0,0'"]),
        (["--com", "0,0,nan"], ["--com", "nan"]),
        (["--lag", "-1"], ["--lag"]),
        (["--path", "nowhere.csv"], ["nowhere.csv", "No such file"]),
        (["--urdf", "arm.urdf"], ["arm.urdf", "--tool-link"]),
        (["--tool-link", "hand"], ["--tool-link", "--urdf"]),
        (["--urdf", "arm.urdf", "--tool-link", "hand"], ["arm.urdf", "No such file"]),
        (
            ["--urdf", str(JACO_URDF), "--tool-link", "tool_mount", "--path", "circle"],
            ["--path circle", "--path random"],
        ),
        (["--empty", "--mass", "1"], ["--empty", "--mass"]),
        (["--preset", "paper", "--driver"], ["preset paper"]),
        (["--preset", "paper", "--rate", "60"], ["240 Hz", "60 Hz"]),
        (["--restitution", "0.5"], ["--restitution", "--simulate payload"]),
        (["--render"], ["--render", "--simulate payload"]),
        (["--size", "320x240"], ["--size"]),
        (["--fps", "60"], ["--fps", "--simulate payload"]),
        (["--save-path", "a.csv", "-o", "a.mcap"], ["--save-path", "-o"]),
    ],
)
def test_what_makes_no_sense_is_one_line_that_names_it(
    command: Command, tmp_path: Path, words: list[str], names: list[str]
):
    result = command(*PAYLOAD, *words, cwd=tmp_path)
    assert result.returncode == 2, result.stdout
    assert result.stderr.count("\n") == 1
    for name in names:
        assert name in result.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("source", [("--simulate", "drop"), ("--camera", "clip.mp4")])
@pytest.mark.parametrize("option", [("--mass", "1"), ("--driver",), ("--save-path", "a.csv")])
def test_an_arms_options_are_its_alone(
    command: Command, tmp_path: Path, source: tuple[str, str], option: tuple[str, ...]
):
    result = command("tunenet-record", *source, *option, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert option[0] in result.stderr
    assert not list(tmp_path.iterdir())


def test_a_path_shorter_than_was_asked_for_is_refused(tmp_path: Path):
    from tunenet_logs.recorders.simulators.arm.path import write_path_file

    path, file = circle(100, 2), tmp_path / "short.csv"
    write_path_file(file, ARM.joint_names, path.seconds, path.position_rad, overwrite=False)
    with pytest.raises(UsageError, match=r"short\.csv.*lasts 1\.9.*asks for 5"):
        simulate_payload(PayloadOrder(path=str(file), seconds=5.0))
