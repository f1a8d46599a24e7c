"""Which of a log's signals are what of a model, by names that seldom are the same."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tunenet_logs.analysis.sysid.matching import Match
from tunenet_logs.analysis.sysid.source import initial_state
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.recorders.simulators.mujoco import mujoco

PARTS = """<worldbody>
  <body name="upper"><joint name="shoulder" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/>
    <body name="lower" pos=".5 0 0"><joint name="elbow" axis="0 1 0"/>
      <geom size=".1" pos=".2 0 0"/></body></body>
  <body name="block.1"><freejoint name="block"/><geom size=".1"/></body>
</worldbody>"""
SERVOS = """<actuator><motor name="torque" joint="elbow"/>
  <position name="servo" joint="elbow" kp="9"/><velocity joint="shoulder" kv="2"/></actuator>"""
START_NS, STEP_NS = 1_700_000_000_000_000_000, 10_000_000


def model_of(parts: str = PARTS, more: str = SERVOS) -> Any:
    return mujoco().MjModel.from_xml_string(f"<mujoco>{parts}{more}</mujoco>")


def signal(
    name: str,
    columns: Sequence[str] = ("shoulder", "elbow"),
    unit: str = "rad",
    *,
    values: Any = None,
    drives: bool = False,
) -> Signal:
    if values is None:
        values = np.random.default_rng(0).normal(size=(50, len(columns))) * 0.01
    stamps_ns = START_NS + STEP_NS * np.arange(len(values))
    return Signal(name, stamps_ns, np.asarray(values, float), tuple(columns), unit, drives=drives)


STATES = signal("/joint_states.position")


def match(*signals: Signal, told: Mapping[str, str] | None = None, model: Any = None) -> Match:
    log = Episode(EpisodeInfo(), {one.name: one for one in signals})
    return Match(log, model or model_of(), told or {})


def sensed(found: Match) -> dict[str, list[str]]:
    return {
        one.signal.name: [f"{column}={sensor.kind} {sensor.name}" for column, sensor in pairs]
        for one in found.sensed
        if (pairs := list(zip(one.columns, one.sensors, strict=True)))
    }


def driven(found: Match) -> list[tuple[str, list[int], list[int], bool]]:
    return [
        (one.signal.name, one.columns.tolist(), one.targets.tolist(), one.is_effort)
        for one in found.drives
    ]


@pytest.mark.parametrize(
    "columns",
    [
        ("shoulder", "elbow"),
        ("robot/shoulder", "robot/elbow"),
        ("Shoulder", "ELBOW"),
        ("shoul-der", "el_bow"),
        ("arm/left/Shoulder", "elbow"),
    ],
)
def test_joints_are_found_by_name(columns: tuple[str, ...]):
    found = match(signal("/joint_states.position", columns))
    wanted = [f"{columns[0]}=jointpos shoulder", f"{columns[1]}=jointpos elbow"]
    assert sensed(found) == {"/joint_states.position": wanted}
    assert not found.unused


def test_a_name_that_fits_as_it_is_goes_before_one_that_fits_without_its_prefix():
    found = match(signal("/joint_states.position", ("other/elbow", "elbow")))
    assert sensed(found) == {"/joint_states.position": ["elbow=jointpos elbow"]}
    assert "other/elbow" in found.unused[0]


@pytest.mark.parametrize(
    "columns",
    [("main_shoulder", "main_elbow"), ("shoulder.pos", "elbow.pos"), ("a.shoulder.p", "a.elbow.p")],
)
def test_words_that_all_joints_share_are_no_part_of_their_names(columns: tuple[str, ...]):
    found = match(signal("/joint_states.position", columns))
    assert [one.name for one in found.sensed[0].sensors] == ["shoulder", "elbow"]
    longer = model_of(PARTS.replace('name="', 'name="arm_'), "")
    assert len(match(STATES, model=longer).sensed[0].sensors) == 2
    legs = match(signal("/a.position", ("left_elbow", "left_knee", "elbow")))
    assert sensed(legs) == {"/a.position": ["elbow=jointpos elbow"]}
    with pytest.raises(NotFoundError):  # what the log and the model begin with differs
        match(signal("/a.position", ("leg_shoulder", "leg_elbow")), model=longer)


ONE_EACH = """<actuator><position name="a" joint="shoulder" kp="9"/>
  <position name="b" joint="elbow" kp="9"/></actuator>"""


@pytest.mark.parametrize("first", [0, 1])
def test_joints_without_names_go_by_their_numbers(first: int):
    columns = tuple(f"joint{first + at}" for at in (1, 0))
    states = signal("/joints.position", columns)
    commands = signal("/commands.position", columns, drives=True)
    model = model_of(more=ONE_EACH)
    found = match(states, commands, model=model)
    assert sensed(found)["/joints.position"][0] == f"{columns[0]}=jointpos elbow"
    assert driven(found) == [("/commands.position", [0, 1], [1, 0], False)]
    assert [words for words in found.guessed if "by their numbers" in words]
    stem = signal("/joints.position", ("arm_state_0", "arm_state_1"))
    assert [one.name for one in match(stem, model=model).sensed[0].sensors] == ["shoulder", "elbow"]
    for others in (("joint1", "joint3"), ("joint1", "joint2", "joint3"), ("joint2", "joint3")):
        with pytest.raises(NotFoundError):
            match(signal("/joints.position", others), model=model)
    turned = (
        ONE_EACH.replace("shoulder", "x").replace("elbow", "shoulder").replace('"x"', '"elbow"')
    )
    with pytest.raises(NotFoundError):  # the first of which order?
        match(states, model=model_of(more=turned))
    short = PARTS.replace('name="elbow"', 'name="elbow" range="-.1 .1" limited="true"')
    with pytest.raises(NotFoundError):
        match(replace(states, values=states.values + 90), model=model_of(short, ONE_EACH))


def test_one_run_of_several_is_compared():
    names = [f"{topic}.episode{at}.position" for at in (2, 3) for topic in ("action", "state")]
    log = [signal(name, drives=name.startswith("action")) for name in names]
    found = match(*log, model=model_of(more=ONE_EACH))
    assert list(sensed(found)) == ["state.episode2.position"]
    assert [name for name, *_ in driven(found)] == ["action.episode2.position"]
    assert any("episode3: other runs than episode2" in words for words in found.unused)


def test_a_prefix_maps_a_whole_group():
    joints = signal("/joints.position", ("main_upper", "main_lower", "other"))
    model = model_of(
        PARTS.replace('"shoulder"', '"arm_upper"').replace('"elbow"', '"arm_lower"'), ""
    )
    found = match(joints, model=model, told={"main_*": "joint/arm_*"})
    wanted = ["main_upper=jointpos arm_upper", "main_lower=jointpos arm_lower"]
    assert sensed(found) == {"/joints.position": wanted}
    for told in ({"main_*": "joint/x"}, {"leg_*": "joint/*"}, {"main_*": "joint/leg_*"}):
        with pytest.raises(UsageError) as caught:
            match(joints, model=model, told=told)
        assert caught.value.remedy


def test_per_cent_are_of_the_models_ranges_and_no_unit_is_none():
    limited = PARTS.replace(
        'name="elbow"', 'name="elbow" range="-57.29578 114.59156" limited="true"'
    )
    model = model_of(limited)
    states = signal("/joints.position", ("elbow", "shoulder"), "%", values=[[-100, 1], [50, 2]])
    commands = signal("/commands.position", ("elbow",), "%", values=[[0], [100]], drives=True)
    found = match(states, commands, model=model)
    assert sensed(found) == {"/joints.position": ["elbow=jointpos elbow"]}
    np.testing.assert_allclose(found.sensed[0].signal.values[:, 0], [-1, 1.25], atol=1e-6)
    np.testing.assert_allclose(found.drives[0].signal.values[:, 0], [0.5, 2], atol=1e-6)
    assert "shoulder: per cent of a range that the model's joint does not have" in str(found.unused)
    assert any("per cent" in words for words in found.guessed)
    untold = signal("/commands.position", ("elbow",), "", drives=True)
    told = {"/commands": "commands"}
    for one in (match(STATES, untold), match(STATES, untold, told=told)):
        assert not one.drives
        assert "nothing tells its unit; say --angle-unit" in one.unused[0]


def test_what_could_be_several_is_none():
    two = """<worldbody><body><joint name="left/elbow"/><geom size=".1"/>
      <body><joint name="right/elbow"/><geom size=".1"/></body></body></worldbody>"""
    twins = model_of(two, "")
    with pytest.raises(NotFoundError):
        match(signal("/joint_states.position", ("elbow",)), model=twins)
    with pytest.raises(NotFoundError):
        match(signal("/joint_states.position", ("left/elbow", "right/elbow")))
    both = match(signal("/joint_states.position", ("left/elbow", "Right/Elbow")), model=twins)
    assert len(sensed(both)["/joint_states.position"]) == 2


def test_quantities_and_commands():
    found = match(
        STATES,
        signal("/joint_states.velocity", unit="rad/s"),
        signal("/joint_states.effort", unit="N·m"),
        signal("/joint_commands.position"),
    )
    kinds = {name: columns[-1] for name, columns in sensed(found).items()}
    assert kinds == {
        "/joint_states.position": "elbow=jointpos elbow",
        "/joint_states.velocity": "elbow=jointvel elbow",
        "/joint_states.effort": "elbow=jointactuatorfrc elbow",
    }
    assert driven(found) == [
        ("/joint_commands.position", [1], [1], False),
        ("/joint_states.effort", [0], [0], True),  # the shoulder, which nothing commands
    ]


@pytest.mark.parametrize(
    ("quantity", "expected"), [("position", [1]), ("velocity", [2]), ("effort", [0])]
)
def test_a_command_goes_to_the_actuator_that_takes_its_quantity(quantity: str, expected: Any):
    found = match(STATES, signal(f"/plan.{quantity}", drives=True))
    assert [one[2] for one in driven(found)] == [expected]


def test_plain_numbers_command_by_order():
    three = signal("/controller/commands", ("0", "1", "2"), "1", drives=True)
    assert driven(match(STATES, three)) == [("/controller/commands", [0, 1, 2], [0, 1, 2], False)]
    for columns in (("0", "1"), ("0", "1", "2", "3")):
        found = match(STATES, signal("/controller/commands", columns, "1", drives=True))
        assert not found.drives
        assert "no actuator of the model takes it" in found.unused[0]
    odd = signal("/controller/commands", ("7", "8", "9"), "1", drives=True)
    assert driven(match(STATES, odd))[0][2] == [0, 1, 2]


@pytest.mark.parametrize(
    ("topic", "is_command"),
    [
        ("/joint_commands", True),
        ("/desired/joint_states", False),
        ("/joint_trajectory_controller/joint_states", False),
        ("joint_trajectory_controller/state", False),
        ("/joint_states_desired", True),
        ("/cmd/joints", True),
        ("/commander/measured", False),
    ],
)
def test_a_topics_last_part_says_what_is_wanted(topic: str, is_command: bool):
    found = match(signal("/other.position", ("shoulder",)), signal(f"{topic}.position", ("elbow",)))
    assert bool(found.drives) == is_command


def test_one_actuator_has_one_commander():
    found = match(STATES, signal("/cmd.position"), signal("/target.position"))
    assert [one[0] for one in driven(found)] == ["/cmd.position"]
    assert "another signal commands" in found.unused[0]
    again = match(STATES, signal("/cmd.position"), signal("/target.position"), told={"/cmd": "-"})
    assert [one[0] for one in driven(again)] == ["/target.position"]


@pytest.mark.parametrize("name", ["/block.1/pose", "/tf.block.1", "/Block_1", "/x/block.1"])
def test_a_position_is_a_bodys_by_topic_or_frame(name: str):
    found = match(signal(name, ("x", "y", "z"), "m"))
    assert sensed(found) == {name: [f"{axis}=framepos block.1" for axis in "xyz"]}
    state = initial_state(model_of(), found.sensed, START_NS)
    assert state.qpos.shape == (9,)


@pytest.mark.parametrize(("speed_m_s", "is_unsure"), [(0.0, False), (0.05, True)])
def test_what_begins_as_the_model_does_but_moves_is_unsure(speed_m_s: float, is_unsure: bool):
    scatter = np.random.default_rng(1).normal(size=(50, 3)) * 0.001
    scatter[:, 1] += speed_m_s * np.arange(50) * STEP_NS * 1e-9
    found = match(signal("/block.1/pose", ("x", "y", "z"), "m", values=scatter))
    unsure = [one.name for one in initial_state(model_of(), found.sensed, START_NS).unsure]
    assert ("initial/block.1.y.velocity" in unsure) is is_unsure


def test_positions_of_nothing_in_the_model_and_of_the_world_are_listed():
    found = match(STATES, *(signal(name, ("x", "y", "z"), "m") for name in ("/world", "/tf.cup")))
    assert [one.partition(":")[0] for one in found.unused] == ["/world", "/tf.cup"]


NUMBERS = signal("/plain", ("0",), "1", drives=True)


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        ({"/s.position.a": "joint/elbow"}, ["a=jointpos elbow"]),
        ({"/s.a": "joint/elbow"}, ["a=jointpos elbow"]),
        ({"a": "joint/elbow", "b": "joint/shoulder"}, ["a=jointpos elbow", "b=jointpos shoulder"]),
        ({"a": "joint/elbow", "/s.b": "-"}, ["a=jointpos elbow"]),
    ],
)
def test_columns_are_what_a_user_says(told: dict[str, str], expected: list[str]):
    found = match(signal("/s.position", ("a", "b")), told=told)
    assert sensed(found) == {"/s.position": expected}


def test_signals_are_what_a_user_says():
    def roles(name: str, target: str, *more: Signal) -> Match:
        return match(STATES, *more, told={name: target})

    assert sensed(roles("/plain", "joint/elbow", NUMBERS))["/plain"] == ["0=jointpos elbow"]
    assert driven(roles("/plain", "actuator/servo", NUMBERS)) == [("/plain", [0], [1], False)]
    speed = signal("/speed", ("w",), "rad/s")
    assert sensed(roles("/speed", "joint/elbow", speed))["/speed"] == ["w=jointvel elbow"]
    as_states = roles("/cmd", "states", signal("/cmd.position"))
    assert not as_states.drives
    assert "/cmd.position" in sensed(as_states)
    as_commands = roles("/arm", "commands", signal("/arm.position"))
    assert driven(as_commands) == [("/arm.position", [1], [1], False)]
    assert "left out by --map" in roles("/plain", "-", NUMBERS).unused[0]
    track = signal("/track", ("x", "y", "z"), "m")
    assert "/track" in sensed(roles("/track", "body/block.1", track))
    pressure = signal("/gauge", ("p",), "Pa")
    assert "nothing of joints" in roles("/gauge", "states", pressure).unused[0]


@pytest.mark.parametrize(
    ("key", "target", "words"),
    [
        ("/joint_state", "states", "there is: /joint_states"),
        ("", "states", "no such signal"),
        ("/joint_states", "joint/elbo", "joint/elbow"),
        ("/joint_states", "elbow", "joint/elbow"),
        ("/joint_states", "joint/", "no part of the model"),
        ("/joint_states", "actuator/", "no part of the model"),
        ("/joint_states", "site/x", "no part of the model"),
        ("/joint_states", "x" * 100_000, "no part of the model"),
        ("x\n\x1b[31m" * 9000, "states", "no such signal"),
        ("elbow", "states", "is one column alone"),
        ("/joint_states.elbow", "body/lower", "is one column alone"),
        ("/joint_states", "body/lower", "is no position in m"),
    ],
)
def test_what_a_user_says_wrongly_is_one_line(key: str, target: str, words: str):
    with pytest.raises(UsageError) as caught:
        match(STATES, told={key: target})
    line = str(caught.value)
    assert words in line
    assert line.isprintable()
    assert len(line) < 700
    assert caught.value.remedy


def test_what_matches_nothing_names_both_sides():
    with pytest.raises(NotFoundError) as caught:
        match(signal("/joint_states.position", ("hip", "knee")))
    assert "log: hip, knee; model: joints shoulder, elbow, block, bodies upper" in str(caught.value)
    key, _, target = caught.value.remedy.partition("--map ")[2].partition("=")
    offered = match(signal("/joint_states.position", ("hip", "knee")), told={key: target})
    assert "/joint_states" in "".join(offered.used)
    with pytest.raises(NotFoundError, match="log: nothing"):
        match()
    with pytest.raises(UsageError, match="no position in m"):  # pixels are no metres
        match(signal("/track", ("x", "y", "z"), "px"), told={"/track": "body/lower"})


@pytest.mark.parametrize("values", [np.zeros((1, 2)), np.zeros((0, 2)), np.full((50, 2), np.nan)])
def test_what_has_no_samples_says_so(values: Any):
    speeds = signal("/joint_states.velocity", unit="rad/s")
    found = match(signal("/joint_states.position", values=values), speeds)
    assert list(sensed(found)) == ["/joint_states.velocity"]
    assert "fewer than two samples" in found.unused[0]
    commands = match(STATES, signal("/cmd.position", values=values))
    assert bool(commands.drives) == bool(np.isfinite(values).any())  # one command holds
    poses = signal("/block.1", ("x", "y", "z"), "m", values=np.resize(values, (len(values), 3)))
    assert len(match(STATES, poses).sensed) == 1


def test_what_a_joint_cannot_be_is_no_joint():
    found = match(signal("/joint_states.position", ("block", "elbow")))
    assert sensed(found) == {"/joint_states.position": ["elbow=jointpos elbow"]}
    assert "no single position" in found.unused[0]
    blank = match(signal("/joint_states.position", ("elbow", "", "---", "é\n")))
    assert len(blank.sensed[0].columns) == 1


TURNING = np.linspace(2.0, 11.0, 50)
GLITCH = np.where(np.arange(50) == 20, 3.5, 0.1 * np.sin(np.arange(50.0)))


def cut(angles: Any, low: float = -np.pi) -> Any:
    return np.mod(angles - low, 2 * np.pi) + low


@pytest.mark.parametrize(
    ("kind", "shown", "whole"),
    [
        ('type="hinge"', cut(TURNING), TURNING),
        ('type="hinge"', cut(TURNING, 0.0), TURNING),
        ('type="hinge"', cut(-TURNING), -TURNING),
        ('type="hinge"', np.where(np.arange(50) == 9, np.nan, cut(TURNING)), TURNING),
        ('type="hinge"', TURNING, None),
        ('type="hinge"', GLITCH, None),
        ('type="hinge"', np.where(np.arange(50) < 20, 0.0, 4.0) + 0.01 * TURNING, None),
        ('type="hinge" limited="true" range="-180 180"', cut(TURNING), None),
        ('type="slide"', cut(TURNING), None),
    ],
)
def test_angles_that_are_cut_to_one_turn_are_joined(kind: str, shown: Any, whole: Any):
    joint = f'<body><joint name="wheel" {kind}/><geom size=".1"/></body>'
    states = signal("/joint_states.position", ("wheel",), values=shown[:, None])
    found = match(states, model=model_of(f"<worldbody>{joint}</worldbody>", ""))
    assert len(found.joined) == (whole is not None)
    expected = shown if whole is None else np.where(np.isnan(shown), np.nan, whole)
    np.testing.assert_allclose(found.sensed[0].signal.values[:, 0], expected, atol=1e-12)


def test_a_thousand_columns():
    columns = [f"j{number}" for number in range(999)] + ["elbow"]
    found = match(signal("/joint_states.position", columns), signal("/cmd.position", columns))
    assert sensed(found) == {"/joint_states.position": ["elbow=jointpos elbow"]}
    assert driven(found) == [("/cmd.position", [999], [1], False)]
    assert max(map(len, found.unused)) < 200
