"""From a log of an arm to what it holds: the command, its files, and what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import Command, real
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import PayloadOrder, simulate_payload
from tunenet_logs.recorders.simulators.arm.description import (
    JACO_TOOL_LINK,
    JACO_URDF,
    Payload,
    jaco,
)
from tunenet_logs.recorders.simulators.arm.path import circle_at
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm, joint_signals
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
    ],
)
def test_wrong_usage_of_an_arm_is_one_line(
    command: Command, logs: tuple[Path, Path], tmp_path: Path, words: tuple[str, ...], says: str
):
    result = command("tunenet-tune", logs[0], *words, "-o", tmp_path)
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
    result = command("tunenet-tune", drop_log, "--tare", logs[1], "-o", tmp_path)
    assert "--tare not used: this is a drop" in result.stderr
    result = command("tunenet-tune", logs[0], "--ball", "golf", "-o", tmp_path)
    assert "--ball not used: this is a payload" in result.stderr


def test_joints_without_torques_are_refused():
    tuning = tune_log(real("ros1/jaco2_no_effort.bag"), TuneOptions())
    assert tuning.verdict == "rejected"
    assert "no joint torques" in (tuning.reason or "")


@pytest.mark.parametrize("name", ["rosbag", "rosbag_lz4"])
def test_torques_that_are_no_arms_are_refused(name: str):
    tuning = tune_log(real(f"ros1/jaco_names_recorded_by_{name}.bag"), TuneOptions())
    assert tuning.verdict == "rejected"
    assert "fit no arm" in (tuning.reason or "")


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
    assert mass_of(tmp_path / "out" / "held.json") == pytest.approx(0.6, abs=0.3)


def mass_of(report: Path) -> float:
    return json.loads(report.read_text())["parameters"]["payload_mass"]["value"]


def test_a_topic_that_is_not_there_is_said_with_those_that_are(logs: tuple[Path, Path]):
    tuning = tune_log(logs[0], TuneOptions(topic="/nope"))
    assert tuning.verdict == "rejected"
    assert "no usable topic /nope (there is: /joint_states); name one" in (tuning.reason or "")


def test_a_first_guess_beyond_any_arm_is_wrong_usage(logs: tuple[Path, Path]):
    with pytest.raises(UsageError, match="payload_mass"):
        tune_log(logs[0], TuneOptions(initial=(50.0,)))
