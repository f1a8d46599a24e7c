"""Several publishers or bodies on one topic: what is apart stays apart, what is one is one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from tests.tunenet_logs.any_message_logs import START_NS, STEP_NS, RosLog
from tunenet_logs.copying import import_log
from tunenet_logs.formats.base import BeyondLimitError
from tunenet_logs.formats.message_types import JointSample
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode
from tunenet_logs.signals import JointRows, PositionRows, two_sources

COUNT = 600
SECONDS = np.arange(COUNT) / 240
RNG = np.random.default_rng(1)
ABC = ("a", "b", "c")


def stamp(row: float) -> int:
    return START_NS + round(row * STEP_NS)


def joint_rows(*samples: JointSample) -> JointRows:
    rows = JointRows("/joint_states")
    for sample in samples:
        rows.add(sample.stamp_ns, sample)
    return rows


def bounces(height_m: float = 1.0) -> np.ndarray:
    """Heights of a ball that is let go and bounces, with noise, shape (T,)."""
    fall_s = np.sqrt(2 * height_m / 9.81)
    heights, begin_s, speed = np.empty(COUNT), -fall_s, np.sqrt(2 * 9.81 * height_m)
    for row, now_s in enumerate(SECONDS):
        while speed > 0.05 and now_s - begin_s > 2 * speed / 9.81:
            begin_s, speed = begin_s + 2 * speed / 9.81, 0.7 * speed
        since_s = now_s - begin_s
        heights[row] = max(speed * since_s - 4.905 * since_s**2, 0.0)
    return heights + RNG.normal(0, 3e-4, COUNT)


def ball(x_m: float, height_m: float = 1.0) -> np.ndarray:
    return np.column_stack([np.full(COUNT, x_m), np.zeros(COUNT), bounces(height_m)])


def swing() -> np.ndarray:
    return np.column_stack([np.sin(SECONDS * k + k) for k in (1, 2, 3)])


@pytest.mark.parametrize("share", [2, 3, 5])
@pytest.mark.parametrize(
    ("one", "other"),
    [
        (ball(0.2), ball(0.7)),
        (ball(0.2), np.tile([3.0, 0.0, 0.5], (COUNT, 1))),
        (swing(), np.zeros((COUNT, 3)) + 2.5),
        (swing(), swing() + 4.0),
    ],
    ids=["two balls", "a ball and what lies", "an arm and one that always says the same", "arms"],
)
def test_two_series_by_turns_are_told_apart(one: np.ndarray, other: np.ndarray, share: int):
    is_other = np.arange(COUNT) % share == 0
    second = two_sources(np.where(is_other[:, None], other, one))
    assert second is not None
    is_still = not np.ptp(other, axis=0).any()
    assert second.tolist() == (is_other if is_still or not is_other[0] else ~is_other).tolist()


@pytest.mark.parametrize(
    "values",
    [
        ball(0.2),
        np.round(ball(0.2), 3),
        swing(),
        np.round(swing(), 2),
        np.round(swing() * 1e-3 + RNG.normal(0, 4e-4, (COUNT, 3)), 3),
        RNG.normal(0, 1, (COUNT, 3)),
        np.zeros((COUNT, 3)),
        np.repeat(swing()[::4], 4, axis=0),
        np.where(RNG.random((COUNT, 1)) < 0.05, RNG.normal(0, 9, (COUNT, 3)), swing()),
        np.concatenate([swing()[:300], swing()[300:] + 5]),
        (SECONDS[:, None] * 1e-3 + (np.arange(COUNT) % 2)[:, None] * 1e-3).round(3),
        np.full((COUNT, 3), np.nan),
    ],
    ids=["a ball", "in mm", "an arm", "in hundredths", "dithered", "noise", "nothing", "repeated",
         "outliers", "moved once", "to and fro by a step", "no number"],
)  # fmt: skip
def test_one_series_stays_one(values: np.ndarray):
    assert two_sources(values) is None


@pytest.mark.parametrize("turn", [slice(None), slice(None, None, -1)], ids=["same", "other order"])
@pytest.mark.parametrize("is_first", [False, True])
@pytest.mark.parametrize("later_ns", [0, 4_000_000])
def test_a_publisher_of_zeros_is_named_and_apart(turn: slice, is_first: bool, later_ns: int):
    arm, nothing = swing() + 2.0, np.zeros(3)
    samples = []
    for row, values in enumerate(arm):
        real = JointSample(stamp(row), ABC, values, (), 9 * values)
        zero = JointSample(stamp(row) + later_ns, ABC[turn], nothing, (), nothing)
        samples += (zero, real) if is_first else (real, zero)
    signals, notes = joint_rows(*samples).signals()
    found = {signal.name: signal for signal in signals}
    assert np.array_equal(found["/joint_states.position"].values, arm)
    assert np.array_equal(found["/joint_states.effort"].values, 9 * arm)
    assert not found["/joint_states@2.position"].values.any()
    assert len(found) == 4
    assert any(note.startswith("/joint_states: two publishers on /joint_states") for note in notes)


def test_a_publisher_that_repeats_another_is_none_of_its_own():
    samples = []
    for row, values in enumerate(swing()):
        samples.append(JointSample(stamp(row), ABC, values))
        more = [*values[::-1], 0.1]
        samples.append(JointSample(stamp(row) + 1_000_000, ("c", "b", "a", "gripper"), more))
    (position,), notes = joint_rows(*samples).signals()
    assert position.columns == (*ABC, "gripper")
    assert not notes


def test_joints_of_two_publishers_are_one_sample_or_samples_of_their_own():
    both = [
        one
        for n in range(20)
        for one in (
            JointSample(stamp(n), ("a", "b"), [n, -n], [], [1.0, 2.0]),
            JointSample(stamp(n), ("gripper",), [0.5 * n]),
        )
    ]
    (position, effort), notes = joint_rows(*both).signals()
    assert position.columns == effort.columns == ("a", "b", "gripper")
    assert np.array_equal(position.values, [[n, -n, 0.5 * n] for n in range(20)])
    assert np.isnan(effort.values[:, 2]).all()
    assert not notes
    apart = [
        JointSample(stamp(2 * n + at), (name,), [n])
        for n in range(20)
        for at, name in enumerate("ab")
    ]
    (position,), _ = joint_rows(*apart).signals()
    turns = np.tile([[False, True], [True, False]], (20, 1))
    assert np.array_equal(np.isnan(position.values), turns)
    twice = [JointSample(stamp(n), ("a",), [n]) for n in range(20)]
    (position,), notes = joint_rows(*twice, JointSample(stamp(0), ("a",), [99.0])).signals()
    assert position.values[0, 0] == 0  # the first is kept
    assert any("already seen" in note for note in notes)


@pytest.mark.parametrize("separator", ["/", "."])
def test_names_of_interfaces_are_taken_apart(separator: str):
    kinds = ("position", "velocity", "effort", "temperature")
    names = tuple(f"j{joint}{separator}{kind}" for joint in (1, 2) for kind in kinds)
    sent = (JointSample(stamp(n), names, np.arange(8.0) + n) for n in range(30))
    (position, velocity, effort), notes = joint_rows(*sent).signals()
    for signal, first in ((position, 0), (velocity, 1), (effort, 2)):
        assert signal.columns == ("j1", "j2")
        assert signal.values[5].tolist() == [first + 5, first + 9]
    assert position.unit == "rad"
    (note,) = notes
    assert "temperature" in note


@pytest.mark.parametrize(
    ("in_message", "given", "expected"),
    [
        ((), ("a", "b"), ("a", "b")),
        ((), ("a", "b", "c"), ("joint1", "joint2")),
        ((), ("a", "a"), ("joint1", "joint2")),
        ((), (), ("joint1", "joint2")),
        (("x", "y"), ("a", "b"), ("x", "y")),
    ],
)
def test_given_names_are_for_joints_without_names_and_as_many(
    in_message: tuple[str, ...], given: tuple[str, ...], expected: tuple[str, ...]
):
    (signal,), _ = joint_rows(JointSample(5, in_message, effort=[1.0, 2.0])).signals(given)
    assert signal.columns == expected


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_what_is_no_number_is_missing(value: float):
    """Infinite too: no ball is there, and no joint."""
    heights = [value if n == 7 else 1.0 for n in range(20)]
    joints = joint_rows(
        *(JointSample(stamp(n), ("a", "b"), [z, 2.0]) for n, z in enumerate(heights))
    )
    positions = PositionRows("/ball")
    for n, z in enumerate(heights):
        positions.add(0, [(stamp(n), "", "world", 0, 0, z)])
    for rows, column in ((positions, 2), (joints, 0)):
        (signal,), _ = rows.signals()
        gone = np.zeros(signal.values.shape, dtype=bool)
        gone[7, column] = True
        assert np.array_equal(np.isnan(signal.values), gone)
        assert np.isfinite(signal.values[~gone]).all()


LEFT, RIGHT = ball(0.2), ball(0.7)


def placed(places: Sequence[np.ndarray], frames: Sequence, child: str = "") -> PositionRows:
    """Rows of bodies, of each a frame or one by row."""
    rows = PositionRows("/pose")
    for row in range(COUNT):
        for frame, body in zip(frames, places, strict=True):
            said = frame if isinstance(frame, str) else frame(row)
            rows.add(stamp(row), [(stamp(row), child, said, *body[row].tolist())])
    return rows


@pytest.mark.parametrize(
    ("places", "frames", "child", "names", "notes"),
    [
        ((LEFT, RIGHT), ("left", "right"), "", ("/pose", None), 1),
        ((LEFT, RIGHT), ("world", "world"), "", ("/pose", None), 1),
        ((LEFT, RIGHT), ("world", "camera"), "ball", ("/pose.ball", "/pose.ball@camera"), 1),
        ((LEFT,), (lambda row: "" if row < 7 else "world",), "", ("/pose",), 0),
        ((LEFT,), (lambda row: "ab"[row // 300],), "", ("/pose",), 0),
    ],
    ids=["frames", "turns", "a body in two frames", "another name", "a change"],
)
def test_bodies_of_one_topic(places, frames, child: str, names: tuple, notes: int):
    signals, said = placed(places, frames, child).signals()
    assert [len(one.values) for one in signals] == [COUNT] * len(names)
    assert all(name in (None, one.name) for name, one in zip(names, signals, strict=True))
    assert len(said) == notes
    if len(names) == 1:
        assert signals[0].frame == ""
    if child:
        assert "several frames" in said[0]


def test_frames_that_count_are_no_frames_and_more_names_than_any_robot_has_are_refused():
    signals, _ = placed((LEFT,), (lambda row: f"frame{row}",)).signals()
    assert sum(len(one.values) for one in signals) == COUNT
    with pytest.raises(BeyondLimitError):  # and are no damage
        PositionRows("/tf").add(0, [(1, f"frame{n}", "world", 0, 0, 0) for n in range(2000)])


def test_odometry_of_two_bodies_is_apart_by_its_children(tmp_path: Path):
    ros = RosLog({})
    made, kind = ros.make, "nav_msgs/msg/Odometry"
    zero = made("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    still = made("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    twist = made("geometry_msgs/msg/TwistWithCovariance", twist=still, covariance=np.zeros(36))
    sent = []
    for row in range(80):
        pose = ros.pose(0.0, 0.0, row / 100 if row % 2 else 1 - row / 100)
        where = made("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36))
        child = "ball" if row % 2 else "cube"
        sent.append(
            made(kind, header=ros.header(row), child_frame_id=child, pose=where, twist=twist)
        )
    for some, names in ((sent, {"/odom.ball", "/odom.cube"}), (sent[::2], {"/odom"})):
        ros.write(tmp_path / "a.mcap", {"/odom": (kind, some)})
        assert set(read_episode(tmp_path / "a.mcap").signals) == names


def test_a_second_channel_of_a_name_is_there_and_said(tmp_path: Path):
    """A topic with two types; what falls is of the second."""
    ros, path = RosLog({}), tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        for kind, field in (("PoseStamped", "pose"), ("PointStamped", "point")):
            name = f"geometry_msgs/msg/{kind}"
            schema = writer.register_schema(name, "ros2msg", ros.definition(name))
            channel = writer.register_channel("/vrpn", "cdr", schema)
            for row in range(50):
                where = ros.pose(1, 2, 3) if field == "pose" else ros.point(0, 0, row)
                one = ros.make(name, header=ros.header(row), **{field: where})
                writer.add_message(
                    channel, stamp(row), bytes(ros.store.serialize_cdr(one, name)), 0
                )
        writer.finish()
    episode, second = read_episode(path), "/vrpn@PointStamped"
    assert list(episode.signals) == ["/vrpn", second]
    assert episode.signals_of(second)[0].values[7, 2] == 7
    assert any("second channel" in one and second in one for one in episode.warnings)
    assert all(channel.skipped is None for channel in episode.channels)
    columns = {axis: f"/vrpn.point.{axis}" for axis in "xyz"}
    picked = read_episode(path, ReadOptions(columns=columns))
    assert next(iter(picked.signals.values())).values[7, 2] == 7
    assert import_log(path, tmp_path / "b.mcap").messages == 100
