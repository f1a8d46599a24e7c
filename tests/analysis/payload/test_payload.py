"""From a log of an arm to what it holds: the command, its files, which arm, and what it refuses."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.analysis.payload.arm_logs import (
    ARM,
    CLEAN,
    changed,
    circle_log,
    driver,
    of_all,
    renamed,
    with_values,
)
from tests.conftest import Command, real
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import EffortSign, Gravity, TuneOptions
from tunenet_logs.analysis.payload.arm_log import which_arm
from tunenet_logs.analysis.record import read_record
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import NotFoundError
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
    held_efforts_nm,
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


def record(file: Path, /, **order: object) -> Path:
    """Simulate an arm's run and record it."""
    episode = simulate_payload(PayloadOrder(**order))  # type: ignore[arg-type]
    record_episode(episode, file, overwrite=False, progress=Progress(quiet=True))
    return file


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
    assert report["provenance"]["tare"]["log"] == "empty.mcap"
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


def test_a_log_that_may_be_two_things_is_what_is_said(command: Command, tmp_path: Path):
    arm = simulate_payload(PayloadOrder(mass_kg=0.5))
    stamps = arm.signals["/joint_states.effort"].stamps_ns

    def with_places(name: str) -> Episode:
        places = Signal(name, stamps, np.ones((len(stamps), 3)), ("x", "y", "z"), "m")
        return Episode(EpisodeInfo(), {**arm.signals, name: places})

    both = with_places("/ball/pose")
    record_episode(both, tmp_path / "both.mcap", overwrite=False, progress=Progress(quiet=True))
    result = command("tunenet-tune", tmp_path / "both.mcap", "--task", "payload", "-o", tmp_path)
    assert result.returncode == 0, result.stdout
    tuning = tune_episode(with_places("/tf.hand"), TuneOptions())
    assert mass(tuning) == pytest.approx(0.5, abs=1e-3)


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
    effort = episode.signals["/joint_states.effort"]
    tenfold = replace(effort, values=10 * effort.values)
    odd = Episode(episode.info, {**episode.signals, effort.name: tenfold})
    record_episode(odd, tmp_path / "odd.mcap", overwrite=False, progress=Progress(quiet=True))
    words = ("--jobs", 1, "-o", tmp_path / "out")
    result = command("tunenet-tune", tmp_path / "odd.mcap", logs[0], *words)
    assert result.returncode == 1
    assert "over 20 kg; say their unit with --effort-unit" in result.stdout
    report = json.loads((tmp_path / "out" / "held.json").read_text())
    assert report["parameters"]["payload_mass"]["value"] == pytest.approx(0.6, abs=0.3)


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
        ("jaco6-bent", tuple(f"left_j2n6s300_joint_{at}" for at in range(1, 7)), "jaco6-bent"),
        ("panda-bare", (), "panda"),
        ("fr3", tuple(f"right/fr3_joint{at}" for at in range(1, 8)), "fr3"),
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
    names = (f"{before}{at}" for at in range(1, 8))
    chosen = which_arm(called(log_of(of), *names), None, None)
    assert len(chosen[0].joints) == 7
    (remark,) = chosen[1]
    assert "do not say which arm this is: taken for a Kinova Jaco, 7 joints" in remark
    assert "--arm" in remark


def test_what_fits_several_and_not_the_default_asks_for_a_name():
    with pytest.raises(NotFoundError, match=r"UR5e or .* UR10e.*--arm ur5e or --arm ur10e"):
        which_arm(log_of("ur5e"), None, None)
    six = called(log_of("jaco6"), *(f"joint_{at}" for at in range(1, 7)))
    with pytest.raises(NotFoundError, match=r"\(joint_1, .*joint_6\); name the arm.*--urdf"):
        which_arm(six, None, None)
    assert len(which_arm(six, "jaco6", None)[0].joints) == 6


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


# ---- What an owner states of the torques, and several runs of the empty gripper.

HELD = Payload(0.75)
DRIVER = driver(12)
CONSTANTS = (11.0, 12.5, 9.0, 8.0, 6.5, 7.0, 5.0)


@pytest.fixture(scope="module")
def held() -> Episode:
    return circle_log(HELD, CLEAN)


def in_amperes(constants) -> object:
    return with_values(lambda effort: effort / np.array(constants))


def fitted_kg(episode: Episode, **stated) -> float:
    return mass(tune_episode(episode, TuneOptions(method="fit", **stated)))


def reason(episode: Episode, **stated) -> str:
    tuning = tune_episode(episode, TuneOptions(method="fit", **stated))
    assert tuning.verdict == "rejected"
    return tuning.reason or ""


def without_gravity(episode: Episode) -> Episode:
    stamps_ns = episode.signals["/joint_states.effort"].stamps_ns
    path = circle_at(stamps_ns.astype(np.float64) * 1e-9)
    return changed(episode, effort=with_values(lambda effort: effort - held_efforts_nm(ARM, path)))


@pytest.mark.parametrize("gravity", [None, "included", "compensated"])
@pytest.mark.parametrize("effort_sign", [None, "joint", "load"])
def test_what_is_stated_of_torques_is_all_that_is_tried(
    held: Episode, gravity: Gravity | None, effort_sign: EffortSign | None
):
    sign = -1 if effort_sign == "load" else 1
    episode = without_gravity(held) if gravity == "compensated" else held
    episode = changed(episode, effort=with_values(lambda effort: sign * effort))
    options = TuneOptions(gravity=gravity, effort_sign=effort_sign, method="fit")
    tuning = tune_episode(episode, options)
    assert tuning.estimate is not None
    assert float(tuning.estimate[0]) == pytest.approx(HELD.mass_kg, abs=2e-3)
    assert tuning.detection.fit.convention.sign == sign
    assert tuning.detection.fit.convention.has_gravity == (gravity != "compensated")
    assert len(tuning.detection.conventions) == 4 // (1 + (gravity is not None)) // (
        1 + (effort_sign is not None)
    )


def test_what_is_stated_goes_before_what_the_log_shows(held: Episode):
    options = TuneOptions(gravity="compensated", effort_sign="load", method="fit")
    tuning = tune_episode(held, options)
    assert tuning.verdict in ("suspect", "rejected")


@pytest.mark.parametrize("constants", [CONSTANTS, (9.5,)])
def test_efforts_in_amperes_are_torques_times_constants(held: Episode, constants):
    episode = changed(held, effort=in_amperes(constants))
    found = fitted_kg(episode, effort_unit="A", torque_constants=constants)
    assert found == pytest.approx(HELD.mass_kg, abs=2e-3)


@pytest.mark.parametrize("off", [0.85, 1.0, 1.15])
def test_a_mass_from_currents_is_no_surer_than_the_constants(off: float):
    """One laboratory's are all too high beside another's: the interval holds the truth."""
    held, empty = (
        changed(circle_log(*run), effort=in_amperes(CONSTANTS))
        for run in ((HELD, DRIVER), (None, DRIVER.another_run()))
    )
    constants = tuple(off * constant for constant in CONSTANTS)
    options = TuneOptions(effort_unit="A", torque_constants=constants, tares=(empty,), method="fit")
    tuning = tune_episode(held, options)
    low_kg, high_kg = tuning.detection.fit.held.interval95
    assert low_kg < HELD.mass_kg < high_kg
    assert 0.15 < (high_kg - low_kg) / 2 / HELD.mass_kg < 0.4
    if off == 1:
        assert tuning.estimate is not None
        assert tuning.estimate[0] == pytest.approx(HELD.mass_kg, abs=0.03)


def test_a_tare_is_read_as_the_log_is(tmp_path: Path, command: Command):
    """Tables without a line of names, of an arm whose joints have none of their own."""
    names = [f"{what}_{joint}" for what in ("position", "effort") for joint in range(1, 8)]
    columns = ",".join(["t=1", *(f"{name}={number}" for number, name in enumerate(names, start=2))])
    for name, load in (("held", HELD), ("empty", None)):
        position, effort = (
            circle_log(load, CLEAN).signals[f"/joint_states.{one}"]
            for one in ("position", "effort")
        )
        rows = np.column_stack([position.stamps_ns * 1e-9, position.values, effort.values])
        np.savetxt(tmp_path / f"{name}.csv", rows, "%.9g", delimiter=",")
    done = command(
        "tunenet-tune", "held.csv", "--tare", "empty.csv", "--columns", columns, cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "held.json").read_text())["parameters"]["payload_mass"]["value"]
    assert found == pytest.approx(HELD.mass_kg, abs=2e-3)


def test_constants_that_do_not_fit_the_joints_are_counted(held: Episode):
    said = reason(held, effort_unit="A", torque_constants=(9.5,) * 6)
    assert "--torque-constants has 6 numbers, the arm 7 joints" in said


def test_a_table_of_currents_alone_needs_no_unit(command: Command, tmp_path: Path):
    rows = [f"{at / 50:.2f},{np.sin(at / 50):.6f},{at % 7}" for at in range(300)]
    table = tmp_path / "arm.csv"
    table.write_text("\n".join(["t,joint1_position (rad),joint1_current (A)", *rows]))
    words = ("--task", "payload", "--effort-unit", "A", "--torque-constants", "9.5")
    result = command("tunenet-tune", table, *words, "-o", tmp_path)
    assert result.returncode == 1
    assert "leave --effort-unit out" in result.stdout + result.stderr


def test_several_tares_and_what_is_stated_are_kept(
    command: Command, logs: tuple[Path, Path], tmp_path: Path
):
    held, *empty = (*logs, tmp_path / "again.mcap")
    record(empty[1], is_empty=True, is_driver=True, path="random")
    words = [word for tare in empty for word in ("--tare", tare)]
    stated = ("--gravity", "included", "--effort-sign", "joint", "--effort-unit", "N.m")
    result = command("tunenet-tune", held, *words, *stated, "-o", tmp_path)
    assert result.returncode == 0, result.stderr
    report = json.loads((tmp_path / "held.json").read_text())
    assert report["parameters"]["payload_mass"]["value"] == pytest.approx(0.6, abs=0.03)
    tares = report["provenance"]["tare"]
    assert [tare["log"] for tare in tares] == ["empty.mcap", "again.mcap"]
    assert [len(tare["sha256"]) for tare in tares] == [64, 64]
    options = report["provenance"]["options"]
    assert (options["gravity"], options["effort_sign"]) == ("included", "joint")
    assert options["effort_unit"] == "N·m"
    names = [check["name"] for check in report["checks"]]
    assert {"tare 1: no gaps", "tare 2: no gaps"} <= set(names)
    provenance = read_record(tmp_path / "held.json").provenance
    assert provenance is not None
    assert provenance.tares == tuple(tares)


def test_neither_the_log_nor_a_copy_of_a_tare_is_a_tare(logs: tuple[Path, Path], tmp_path: Path):
    held, empty = logs
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(empty.read_bytes())
    broken = tmp_path / "bad.mcap"
    broken.write_text("no log")
    for tares, said in (
        ((empty, copy), f"--tare {copy}: is a run that was named before"),
        ((held,), f"--tare {held}: held 0.6 kg"),
        ((broken,), f"--tare {broken}: is not an MCAP log"),
    ):
        tuning = tune_log(held, TuneOptions(tares=tares))
        assert tuning.verdict == "rejected"
        assert said in (tuning.reason or "")


def test_a_tare_with_other_joints_is_refused(held: Episode):
    def named(episode: Episode, names: Iterable[str]) -> Episode:
        joints = tuple(names)
        return changed(episode, **of_all(lambda signal: renamed(signal, joints)))

    jaco, panda, plain = (
        [f"{arm}{number}" for number in range(1, 8)]
        for arm in ("j2s7s300_joint_", "panda_joint", "joint")
    )
    empty, full = circle_log(None, replace(CLEAN, torque_noise_nm=0.01)), named(held, jaco)
    said = reason(full, tares=(named(empty, panda),))
    assert "its joint panda_joint1 is j2s7s300_joint_1 in the log" in said
    assert fitted_kg(full, tares=(named(empty, plain),)) == pytest.approx(HELD.mass_kg, abs=5e-3)
    assert "no joint of the log is" in reason(full, tares=(named(empty, "abcdefg"),))
