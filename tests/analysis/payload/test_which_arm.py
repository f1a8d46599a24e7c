"""Arms by name and by their joints' names: each one's made log is tuned to what it holds."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from tests.conftest import Command, real
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload.arm_log import which_arm
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Episode
from tunenet_logs.errors import NotFoundError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import PayloadOrder, simulate_payload
from tunenet_logs.recorders.simulators.arm.description import Payload
from tunenet_logs.recorders.simulators.arm.known import ARMS, DEFAULT, known_arm
from tunenet_logs.recorders.simulators.arm.path import random_path
from tunenet_logs.recorders.simulators.arm.payload import Disturbances, driver_episode
from tunenet_logs.terminal import Progress

HELD_KG = 0.8
LWR = tuple(f"lwr_{axis}_joint" for axis in ("a1", "a2", "e1", "a3", "a4", "a5", "a6"))


@cache
def log(name: str, seconds: float = 4.0) -> Episode:
    """Of a known arm that holds 0.8 kg; joints called as its own description has them."""
    arm = known_arm(name).arm()
    path = random_path(arm, 3, 250.0, seconds)
    noise = Disturbances(rate_hz=60.0, torque_noise_nm=0.05)
    return driver_episode(arm, path, Payload(HELD_KG), noise)


def called(episode: Episode, *names: str) -> Episode:
    signals = {
        key: replace(signal, columns=names + signal.columns[len(names) :])
        for key, signal in episode.signals.items()
    }
    return replace(episode, signals=signals)


def numbered(before: str, count: int) -> tuple[str, ...]:
    return tuple(f"{before}{number}" for number in range(1, count + 1))


@pytest.mark.parametrize("name", ARMS)
def test_what_each_arm_holds_is_found(name: str):
    tuning = tune_episode(log(name), TuneOptions(arm=name))
    assert tuning.estimate is not None, tuning.reason
    assert tuning.estimate[0] == pytest.approx(HELD_KG, abs=0.005)
    assert any(f"arm: {known_arm(name).words}, as --arm says" in one for one in tuning.warnings)


@pytest.mark.parametrize(
    ("of", "names", "found"),
    [
        (DEFAULT, (), DEFAULT),
        ("jaco6", (), "jaco6"),
        ("jaco6-bent", numbered("left_j2n6s300_joint_", 6), "jaco6-bent"),
        ("panda-bare", (), "panda"),
        ("fr3", numbered("right/fr3_joint", 7), "fr3"),
        ("lwr", LWR, "lwr"),
    ],
)
def test_the_joints_names_say_which(of: str, names: tuple[str, ...], found: str):
    chosen = which_arm(called(log(of), *names), None, None)
    expected = known_arm(found)
    assert chosen[1][0].startswith(f"arm: {expected.words}, by its joints' names")
    assert [joint.link for joint in chosen[0].joints] == [
        joint.link for joint in expected.arm().joints
    ]
    if of == "lwr":
        assert chosen[0].joint_names == names
        assert "without a tare" in chosen[1][1]


@pytest.mark.parametrize("of", ["xarm7", "gen3"])
@pytest.mark.parametrize("before", ["joint", "joint_", "iiwa_joint_", "A"])
def test_seven_joints_of_no_name_are_the_jacos_and_said_so(of: str, before: str):
    chosen = which_arm(called(log(of), *numbered(before, 7)), None, None)
    assert len(chosen[0].joints) == 7
    (remark,) = chosen[1]
    assert "do not say which arm this is: taken for a Kinova Jaco, 7 joints" in remark
    assert "--arm" in remark


def test_what_fits_several_and_not_the_default_asks_for_a_name():
    with pytest.raises(NotFoundError, match=r"UR5e or .* UR10e.*--arm ur5e or --arm ur10e"):
        which_arm(log("ur5e"), None, None)
    with pytest.raises(NotFoundError, match=r"\(joint_1, .*joint_6\); name the arm.*--urdf"):
        which_arm(called(log("jaco6"), *numbered("joint_", 6)), None, None)
    named = which_arm(called(log("jaco6"), *numbered("joint_", 6)), "jaco6", None)
    assert len(named[0].joints) == 6


def test_the_topic_that_a_user_prefers_names_the_arm():
    panda = {key.replace("/", "/b/"): one for key, one in log("panda").signals.items()}
    panda = {key: replace(one, name=key) for key, one in panda.items()}
    both = replace(log("jaco6"), signals={**log("jaco6").signals, **panda})
    assert len(which_arm(both, None, None)[0].joints) == 6
    assert len(which_arm(both, None, "/b/joint_states")[0].joints) == 7


def test_a_real_log_of_six_joints_is_asked_for_its_arm():
    episode = read_episode(real("ros1/jaco2_6dof_bsd3.bag"))
    with pytest.raises(NotFoundError, match=r"jaco_joint_1.*--arm jaco6"):
        which_arm(episode, None, None)
    assert len(which_arm(episode, "jaco6", None)[0].joints) == 6


def test_the_commands_take_and_keep_a_name(command: Command, tmp_path: Path):
    file = tmp_path / "ur.mcap"
    made = simulate_payload(PayloadOrder(mass_kg=HELD_KG, arm="ur10e", seconds=3.0, seed=2))
    record_episode(made, file, overwrite=False, progress=Progress(quiet=True), min_free_bytes=0)
    asked = command("tunenet-tune", file, "--quiet")
    assert asked.returncode == 1
    assert "--arm ur5e or --arm ur10e" in asked.stdout + asked.stderr
    result = command("tunenet-tune", file, "--arm", "UR10e", "--quiet")
    assert result.returncode == 0, result.stderr
    assert "arm: Universal Robots UR10e, as --arm says" in result.stderr
    record = json.loads((tmp_path / "ur.json").read_text())
    assert record["parameters"]["payload_mass"]["value"] == pytest.approx(HELD_KG, abs=0.03)
    assert record["provenance"]["options"]["arm"] == "ur10e"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--arm", "pandda"), "did you mean panda"),
        (("--arm", "panda", "--urdf", "a.urdf"), "--arm panda does not go with --urdf"),
        (("--arm", "panda", "--tool-link", "a"), "--arm panda does not go with --tool-link"),
    ],
)
def test_a_name_that_is_wrong_is_one_line(
    command: Command, tmp_path: Path, words: tuple[str, ...], message: str
):
    result = command("tunenet-tune", tmp_path / "a.mcap", *words)
    assert result.returncode == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1


def test_help_lists_the_arms(command: Command):
    text = "".join(command("tunenet-tune", "--help", "payload").stdout.split())
    assert all(name in text for name in ARMS)
