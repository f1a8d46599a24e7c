"""From a log of an arm to what it holds: the command, its files, which arm, and what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import Command, real
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload.arm_log import which_arm
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import PayloadOrder, simulate_payload
from tunenet_logs.recorders.simulators.arm.description import (
    JACO_TOOL_LINK,
    JACO_URDF,
    Payload,
    jaco,
)
from tunenet_logs.recorders.simulators.arm.known import ARMS, DEFAULT, known_arm
from tunenet_logs.recorders.simulators.arm.path import circle_at, random_path
from tunenet_logs.recorders.simulators.arm.payload import (
    Disturbances,
    driver_episode,
    joint_efforts_nm,
    joint_signals,
)
from tunenet_logs.terminal import Progress

TWO_JOINTS = """\
<robot name="two">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
    <inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0.15 0 0"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="hand"/>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="100" velocity="2"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="100" velocity="2"/></joint>
  <joint name="wrist" type="fixed"><parent link="lower"/><child link="hand"/>
    <origin xyz="0.3 0 0"/></joint>
</robot>
"""


def record(path: Path, **order: object) -> Path:
    """Simulate an arm's run and record it."""
    episode = simulate_payload(PayloadOrder(**order))  # type: ignore[arg-type]
    record_episode(episode, path, overwrite=False, progress=Progress(quiet=True))
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A payload as a real driver's log shows it, and its tare."""
    folder = tmp_path_factory.mktemp("payload")
    held = record(folder / "held.mcap", mass_kg=0.6, com_m=(0.02, 0.0, -0.02), is_driver=True)
    return held, record(folder / "empty.mcap", is_empty=True, is_driver=True)


@pytest.fixture(scope="module")
def tared(logs: tuple[Path, Path]) -> Tuning:
    held, empty = logs
    return tune_log(held, TuneOptions(tares=(empty,)))


def mass(tuning: Tuning) -> float:
    assert tuning.estimate is not None, tuning.reason
    return float(tuning.estimate[0])


def test_the_command_writes_what_the_contract_says(
    command: Command, logs: tuple[Path, Path], tmp_path: Path
):
    held, empty = logs
    result = command("tunenet-tune", held, "--tare", empty, "-o", tmp_path)
    assert result.returncode == 0, result.stderr
    head, row, centre = result.stdout.splitlines()[:3]
    assert "payload_mass [kg]" in head
    assert " ok " in row
    assert centre.strip().startswith("payload_com [m] ")
    report = json.loads((tmp_path / "held.json").read_text())
    assert report["task"] == "payload"
    told = report["parameters"]["payload_mass"]
    assert told["unit"] == "kg"
    assert told["value"] == pytest.approx(0.6, abs=0.03)
    low, high = told["interval95"]
    assert low < 0.6 < high
    com = report["parameters"]["payload_com"]
    assert com["unit"] == "m"
    assert com["value"] == pytest.approx([0.02, 0.0, -0.02], abs=0.015)
    assert np.shape(com["interval95"]) == (3, 2)
    assert report["method"] == "tunenet+refine"
    assert [step["k"] for step in report["iterations"]] == list(range(7))
    assert report["bounces"] == []
    assert report["cross_check"]["agrees"] is True
    assert set(report["window"]) == {"start_s", "end_s"}
    assert (tmp_path / "held.rrd").stat().st_size < 3e6


def test_a_tare_makes_it_more_exact(logs: tuple[Path, Path], tmp_path: Path):
    _, empty = logs
    held = record(tmp_path / "held.mcap", mass_kg=0.6, is_driver=True)
    alone = tune_log(held, TuneOptions())
    tared = tune_log(held, TuneOptions(tares=(empty,)))
    assert alone.interval95 is not None
    assert tared.interval95 is not None
    assert np.ptp(tared.interval95) < 0.5 * np.ptp(alone.interval95)
    assert mass(alone) == pytest.approx(0.6, abs=0.2)
    assert mass(tared) == pytest.approx(0.6, abs=0.03)


def test_a_clean_log_of_another_library_is_answered_to_a_gram():
    for path, seed in (("circle", 1), ("random", 2), ("random", 3)):
        episode = simulate_payload(PayloadOrder(mass_kg=0.75, path=path, seed=seed))
        assert mass(tune_episode(episode, TuneOptions())) == pytest.approx(0.75, abs=1e-3)


def test_the_truth_in_the_log_is_never_used():
    episode = simulate_payload(PayloadOrder(mass_kg=0.4, is_driver=True))
    mass_kg = mass(tune_episode(episode, TuneOptions()))
    for info in (EpisodeInfo(kind="payload"), replace(episode.info, truth={"payload_mass": 9.0})):
        assert mass(tune_episode(Episode(info, episode.signals), TuneOptions())) == mass_kg


def test_any_serial_arm(command: Command, tmp_path: Path):
    urdf = tmp_path / "two.urdf"
    urdf.write_text(TWO_JOINTS)
    order = {"urdf": urdf, "tool_link": "hand", "seed": 4}
    record(tmp_path / "a.mcap", mass_kg=1.2, torque_noise_nm=0.05, **order)
    words = ("tunenet-tune", tmp_path / "a.mcap", "-o", tmp_path / "out")
    result = command(*words, "--urdf", urdf, "--tool-link", "hand")
    assert result.returncode == 0, result.stderr
    report = json.loads((tmp_path / "out" / "a.json").read_text())
    low, high = report["parameters"]["payload_mass"]["interval95"]
    assert low < 1.2 < high
    assert high - low < 0.2
    other = command(*words)
    assert other.returncode == 1
    assert "j2s7s300_joint_1" in other.stdout
    assert "--urdf FILE --tool-link" in other.stdout


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--urdf", "arm.urdf"), "go together; add --tool-link"),
        (("--tool-link", "hand"), "go together; add --urdf"),
        (("--urdf", "none.urdf", "--tool-link", "hand"), "none.urdf"),
        (("--effort-unit", "A"), "--effort-unit A needs each joint's torque for each A"),
        (("--effort-unit", "lb"), "'lb' is neither N·m (or Nm) nor A"),
        (("--gravity", "on"), "--gravity"),
        (("--effort-sign", "-1"), "--effort-sign"),
        (("--tare", "x.mcap", "--tare", "./x.mcap"), "named twice; name each empty run once"),
        (("--tare", "x.mcap", "y.mcap"), "--tare takes one LOG, and y.mcap was not expected"),
        (("b.mcap", "--save-arm-card", "arm.json"), "is for one log, not 2"),
        (("--save-arm-card", "no/arm.json"), "no such folder"),
        (("--arm-card", "none.json"), "none.json: cannot be read"),
        (("--arm", "pandda"), "did you mean panda"),
        (("--arm", "panda", "--urdf", "a.urdf"), "--arm panda does not go with --urdf"),
        (("--arm", "panda", "--tool-link", "a"), "--arm panda does not go with --tool-link"),
    ],
)
def test_words_that_are_wrong_are_one_line(
    command: Command, logs: tuple[Path, Path], tmp_path: Path, words: tuple[str, ...], says: str
):
    result = command("tunenet-tune", logs[0], *words, "-o", tmp_path, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert says in result.stderr


def test_a_tare_that_is_none_is_named(command: Command, logs: tuple[Path, Path], tmp_path: Path):
    (tmp_path / "bad.mcap").write_text("no log")
    result = command("tunenet-tune", logs[0], "--tare", tmp_path / "bad.mcap", "-o", tmp_path)
    assert result.returncode == 1
    assert "--tare" in result.stdout
    assert "bad.mcap" in result.stdout
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    ("tare", "says"),
    [
        ("held", "held 0.6 kg, as it says"),
        ("copy", "has the torques of the log itself"),
        ("noise", "tare: torques fit the arm: these torques fit no arm"),
        ("short", "tare: long enough: 0.4 s"),
    ],
)
def test_a_tare_that_tells_nothing_is_refused_by_name(
    logs: tuple[Path, Path], tare: str, says: str
):
    held, empty = logs
    episode = read_episode(empty if tare in ("noise", "short") else held)
    signals = dict(episode.signals)
    effort = signals["/joint_states.effort"]
    if tare == "noise":
        noise = np.random.default_rng(0).normal(0, 3, effort.values.shape)
        signals[effort.name] = replace(effort, values=noise)
    if tare == "short":
        signals = {
            name: replace(one, stamps_ns=one.stamps_ns[:60], values=one.values[:60])
            for name, one in signals.items()
        }
    truth = {} if tare == "copy" else episode.info.truth
    other = Episode(replace(episode.info, truth=truth), signals)
    tuning = tune_log(held, TuneOptions(start_s=1.0, tares=(other,)))
    assert tuning.verdict == "rejected"
    assert says in (tuning.reason or "")
    assert "; at the next run: record the empty gripper" not in (tuning.reason or "")


def test_a_topic_is_looked_for_in_the_tare_too(logs: tuple[Path, Path], tared: Tuning):
    held, empty = (read_episode(one) for one in logs)

    def doubled(episode: Episode, factor: float) -> Episode:
        """With a second arm's joints, whose torques are others, under the first name."""
        here = {
            f"/b{name}": replace(one, name=f"/b{name}") for name, one in episode.signals.items()
        }
        one = episode.signals["/joint_states.effort"]
        there = {**episode.signals, one.name: replace(one, values=factor * one.values)}
        return Episode(episode.info, {**there, **here})

    topic = "/b/joint_states"
    selection = TuneOptions(topic=topic, tares=(doubled(empty, 5.0),))
    found = tune_episode(doubled(held, 1.0), selection)
    assert mass(found) == pytest.approx(mass(tared), abs=1e-9)


def test_an_arm_that_is_not_upright_needs_its_tilt_in_its_base_joint(tmp_path: Path):
    path, roll_rad = circle_at(np.arange(0.0, 6.0, 1 / 60)), 0.7
    gravity = (0.0, -9.81 * np.sin(roll_rad), -9.81 * np.cos(roll_rad))
    effort_nm = joint_efforts_nm(jaco(), path, Payload(0.8), gravity)
    episode = Episode(EpisodeInfo(kind="payload"), joint_signals(jaco(), path, effort_nm))
    upright = tune_episode(episode, TuneOptions())
    assert upright.verdict == "suspect"
    advice = [one.advice for one in upright.checks if not one.passed]
    assert any("needs its tilt in the base joint" in one for one in advice)
    tilted = tmp_path / "tilted.urdf"
    tilt = (
        '<link name="wall"/><joint name="tilt" type="fixed"><parent link="wall"/>'
        f'<child link="j2s7s300_link_base"/><origin rpy="{roll_rad} 0 0"/></joint></robot>'
    )
    tilted.write_text(JACO_URDF.read_text().replace("</robot>", tilt))
    selection = TuneOptions(urdf=tilted, tool_link=JACO_TOOL_LINK)
    found = tune_episode(episode, selection)
    assert found.verdict == "ok"
    assert mass(found) == pytest.approx(0.8, abs=1e-3)


def test_advice_is_not_to_do_what_was_done(tared: Tuning):
    advice = [one.advice for one in tared.checks]
    assert tared.cross_check is not None
    assert not [one for one in (*advice, tared.cross_check.advice) if "--tare" in one]


def test_a_log_that_may_be_two_things_is_asked_about(command: Command, tmp_path: Path):
    arm = simulate_payload(PayloadOrder(mass_kg=0.5))
    stamps = arm.signals["/joint_states.effort"].stamps_ns
    ball = Signal("/ball/pose", stamps, np.ones((len(stamps), 3)), ("x", "y", "z"), "m")
    both = Episode(EpisodeInfo(), {**arm.signals, "/ball/pose": ball})
    record_episode(both, tmp_path / "both.mcap", overwrite=False, progress=Progress(quiet=True))
    result = command("tunenet-tune", tmp_path / "both.mcap", "-o", tmp_path)
    assert result.returncode == 2
    assert "--task drop or --task payload" in result.stderr
    result = command("tunenet-tune", tmp_path / "both.mcap", "--task", "payload", "-o", tmp_path)
    assert result.returncode == 0, result.stdout
    frames = Signal("/tf.hand", stamps, np.ones((len(stamps), 3)), ("x", "y", "z"), "m")
    tuning = tune_episode(
        Episode(EpisodeInfo(), {**arm.signals, "/tf.hand": frames}), TuneOptions()
    )
    assert mass(tuning) == pytest.approx(0.5, abs=1e-3)


def test_options_of_the_other_kind_are_said_to_have_no_effect(
    command: Command, logs: tuple[Path, Path], drop_log: Path, tmp_path: Path
):
    for log, words, said in (
        (drop_log, ("--tare", logs[1]), "--tare not used: this is a drop"),
        (
            drop_log,
            ("--gravity", "included", "--effort-sign", "joint", "--effort-unit", "Nm"),
            "--gravity, --effort-sign, --effort-unit not used: this is a drop",
        ),
        (logs[0], ("--ball", "golf"), "--ball not used: this is a payload"),
    ):
        result = command("tunenet-tune", log, *words, "-o", tmp_path, "--no-review")
        assert said in result.stderr


@pytest.mark.parametrize(
    ("bag", "says"),
    [
        ("jaco2_no_effort", "no joint torques"),
        ("jaco_names_recorded_by_rosbag", "fit no arm"),
        ("jaco_names_recorded_by_rosbag_lz4", "fit no arm"),
    ],
)
def test_what_is_no_log_of_torques_is_refused(bag: str, says: str):
    tuning = tune_log(real(f"ros1/{bag}.bag"), TuneOptions())
    assert tuning.verdict == "rejected"
    assert says in (tuning.reason or "")


@pytest.mark.parametrize("preset", ["paper", "paper-code"])
def test_the_papers_presets_know_the_papers_circle(preset: Any):
    """Clean, and wherever on the circle the log begins; gravity is 10 m/s² there."""
    episode = simulate_payload(PayloadOrder(mass_kg=0.5, seconds=6.0))
    tuning = tune_episode(episode, TuneOptions(preset=preset, iterations=9))
    assert mass(tuning) == pytest.approx(0.5, abs=0.35)
    assert tuning.interval95 is None
    assert not tuning.physical
    other = simulate_payload(PayloadOrder(mass_kg=0.5, path="random", seconds=6.0))
    refused = tune_episode(other, TuneOptions(preset=preset))
    assert refused.verdict == "rejected"
    assert "knows one motion" in (refused.reason or "")


def test_torques_in_another_unit_reject_their_log_alone(
    command: Command, logs: tuple[Path, Path], tmp_path: Path
):
    episode = simulate_payload(PayloadOrder(mass_kg=2.6))
    signals = dict(episode.signals)
    effort = signals["/joint_states.effort"]
    signals[effort.name] = replace(effort, values=10 * effort.values)
    odd = Episode(episode.info, signals)
    record_episode(odd, tmp_path / "odd.mcap", overwrite=False, progress=Progress(quiet=True))
    words = ("--jobs", 1, "-o", tmp_path / "out")
    result = command("tunenet-tune", tmp_path / "odd.mcap", logs[0], *words)
    assert result.returncode == 1
    assert "over 20 kg; say their unit with --effort-unit" in result.stdout
    report = json.loads((tmp_path / "out" / "held.json").read_text())
    assert report["parameters"]["payload_mass"]["value"] == pytest.approx(0.6, abs=0.3)


def test_what_cannot_be_asked_of_a_log(logs: tuple[Path, Path]):
    tuning = tune_log(logs[0], TuneOptions(topic="/nope"))
    assert tuning.verdict == "rejected"
    assert "no usable topic /nope (there is: /joint_states); name one" in (tuning.reason or "")
    with pytest.raises(UsageError, match="payload_mass"):
        tune_log(logs[0], TuneOptions(initial=(50.0,)))


HELD_KG = 0.8
LWR = tuple(f"lwr_{axis}_joint" for axis in ("a1", "a2", "e1", "a3", "a4", "a5", "a6"))


@cache
def log_of(name: str, seconds: float = 4.0) -> Episode:
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
    tuning = tune_episode(log_of(name), TuneOptions(arm=name))
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
    chosen = which_arm(called(log_of(of), *names), None, None)
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
    chosen = which_arm(called(log_of(of), *numbered(before, 7)), None, None)
    assert len(chosen[0].joints) == 7
    (remark,) = chosen[1]
    assert "do not say which arm this is: taken for a Kinova Jaco, 7 joints" in remark
    assert "--arm" in remark


def test_what_fits_several_and_not_the_default_asks_for_a_name():
    with pytest.raises(NotFoundError, match=r"UR5e or .* UR10e.*--arm ur5e or --arm ur10e"):
        which_arm(log_of("ur5e"), None, None)
    with pytest.raises(NotFoundError, match=r"\(joint_1, .*joint_6\); name the arm.*--urdf"):
        which_arm(called(log_of("jaco6"), *numbered("joint_", 6)), None, None)
    named = which_arm(called(log_of("jaco6"), *numbered("joint_", 6)), "jaco6", None)
    assert len(named[0].joints) == 6


def test_the_topic_that_a_user_prefers_names_the_arm():
    panda = {key.replace("/", "/b/"): one for key, one in log_of("panda").signals.items()}
    panda = {key: replace(one, name=key) for key, one in panda.items()}
    both = replace(log_of("jaco6"), signals={**log_of("jaco6").signals, **panda})
    assert len(which_arm(both, None, None)[0].joints) == 6
    assert len(which_arm(both, None, "/b/joint_states")[0].joints) == 7


def test_a_real_log_of_six_joints_is_asked_for_its_arm():
    episode = read_episode(real("ros1/jaco2_6dof_bsd3.bag"))
    with pytest.raises(NotFoundError, match=r"jaco_joint_1.*--arm jaco6"):
        which_arm(episode, None, None)
    assert len(which_arm(episode, "jaco6", None)[0].joints) == 6


def test_the_commands_take_and_keep_a_name(command: Command, tmp_path: Path):
    file = tmp_path / "ur.mcap"
    record(file, mass_kg=HELD_KG, arm="ur10e", seconds=3.0, seed=2)
    asked = command("tunenet-tune", file, "--quiet")
    assert asked.returncode == 1
    assert "--arm ur5e or --arm ur10e" in asked.stdout + asked.stderr
    result = command("tunenet-tune", file, "--arm", "UR10e", "--quiet")
    assert result.returncode == 0, result.stderr
    assert "arm: Universal Robots UR10e, as --arm says" in result.stderr
    report = json.loads((tmp_path / "ur.json").read_text())
    assert report["parameters"]["payload_mass"]["value"] == pytest.approx(HELD_KG, abs=0.03)
    assert report["provenance"]["options"]["arm"] == "ur10e"


def test_help_lists_the_arms(command: Command):
    text = "".join(command("tunenet-tune", "--help", "payload").stdout.split())
    assert all(name in text for name in ARMS)
