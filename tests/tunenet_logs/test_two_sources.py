"""Two publishers or objects on one topic: told apart or said, and nothing else taken for them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from tests.tunenet_logs.any_message_logs import START_NS, STEP_NS, RosLog
from tunenet_logs.copying import import_log
from tunenet_logs.episode import Episode
from tunenet_logs.formats.message_types import JointSample
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode
from tunenet_logs.signals import JointRows, PositionRows, two_sources

COUNT = 600
SECONDS = np.arange(COUNT) / 240
RNG = np.random.default_rng(1)


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
    ids=[
        "a ball", "in mm", "an arm", "in hundredths", "dithered", "noise", "nothing", "repeated",
        "outliers", "moved once", "to and fro by a step", "no number",
    ],
)  # fmt: skip
def test_one_series_stays_one(values: np.ndarray):
    assert two_sources(values) is None


@pytest.mark.parametrize("turn", [slice(None), slice(None, None, -1)], ids=["same", "other order"])
@pytest.mark.parametrize("is_first", [False, True])
@pytest.mark.parametrize("later_ns", [0, 4_000_000])
def test_a_publisher_of_zeros_is_named_and_apart(turn: slice, is_first: bool, later_ns: int):
    names = ("a", "b", "c")
    arm = swing() + 2.0
    rows = JointRows("/joint_states")
    for row, values in enumerate(arm):
        stamp_ns = START_NS + row * STEP_NS
        real = (stamp_ns, JointSample(stamp_ns, names, values, (), 9 * values))
        nothing = np.zeros(3)
        stamp_ns += later_ns
        zero = (stamp_ns, JointSample(stamp_ns, names[turn], nothing, (), nothing))
        for log_ns, sample in (zero, real) if is_first else (real, zero):
            rows.add(log_ns, sample)
    signals, notes = rows.signals()
    found = {signal.name: signal for signal in signals}
    assert np.array_equal(found["/joint_states.position"].values, arm)
    assert np.array_equal(found["/joint_states.effort"].values, 9 * arm)
    assert not found["/joint_states@2.position"].values.any()
    assert len(found) == 4
    assert any(note.startswith("/joint_states: two publishers on /joint_states") for note in notes)


def test_a_publisher_that_repeats_another_is_none_of_its_own():
    rows = JointRows("/joint_states")
    for row, values in enumerate(swing()):
        stamp_ns = START_NS + row * STEP_NS
        rows.add(stamp_ns, JointSample(stamp_ns, ("a", "b", "c"), values))
        both = JointSample(stamp_ns, ("c", "b", "a", "gripper"), [*values[::-1], 0.1])
        rows.add(stamp_ns + 1_000_000, both)
    (position,), notes = rows.signals()
    assert position.columns == ("a", "b", "c", "gripper")
    assert not notes


def test_bodies_of_one_topic_are_apart_by_frame_or_by_turns():
    left, right = ball(0.2), ball(0.7)
    for frames in (("left", "right"), ("world", "world")):
        rows = PositionRows("/pose")
        for row in range(COUNT):
            for frame, where in zip(frames, (left[row], right[row]), strict=True):
                stamp_ns = START_NS + row * STEP_NS
                rows.add(stamp_ns, [(stamp_ns, "", frame, *where.tolist())])
        signals, notes = rows.signals()
        assert [len(one.values) for one in signals] == [COUNT, COUNT]
        assert signals[0].name == "/pose"
        assert len(notes) == 1


def test_a_frame_that_gets_another_name_stays_one_track():
    rows = PositionRows("/pose")
    for row, where in enumerate(ball(0.2)):
        frame = "" if row < 7 else "world"
        rows.add(row, [(START_NS + row * STEP_NS, "", frame, *where.tolist())])
    (signal,), notes = rows.signals()
    assert (len(signal.values), signal.frame, notes) == (COUNT, "", [])


def test_frames_that_count_are_no_frames():
    rows = PositionRows("/pose")
    for row, where in enumerate(ball(0.2)):
        rows.add(row, [(START_NS + row * STEP_NS, "", f"frame{row}", *where.tolist())])
    assert sum(len(one.values) for one in rows.signals()[0]) == COUNT


def test_odometry_of_two_bodies_is_apart_by_its_children(tmp_path: Path):
    ros = RosLog({})
    made = ros.make
    zero = made("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    twist = made(
        "geometry_msgs/msg/TwistWithCovariance",
        twist=made("geometry_msgs/msg/Twist", linear=zero, angular=zero),
        covariance=np.zeros(36),
    )
    sent = []
    for row in range(80):
        pose = ros.pose(0.0, 0.0, row / 100 if row % 2 else 1 - row / 100)
        placed = made("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36))
        child = "ball" if row % 2 else "cube"
        sent.append(
            made("nav_msgs/msg/Odometry", header=ros.header(row), child_frame_id=child, pose=placed,
                 twist=twist)
        )  # fmt: skip
    ros.write(tmp_path / "a.mcap", {"/odom": ("nav_msgs/msg/Odometry", sent)})
    assert set(read_episode(tmp_path / "a.mcap").signals) == {"/odom.ball", "/odom.cube"}
    ros.write(tmp_path / "b.mcap", {"/odom": ("nav_msgs/msg/Odometry", sent[::2])})
    assert set(read_episode(tmp_path / "b.mcap").signals) == {"/odom"}


def two_channels(path: Path) -> Episode:
    """A topic with two types; what falls is of the second."""
    ros = RosLog({})
    poses = [
        ros.make("geometry_msgs/msg/PoseStamped", header=ros.header(row), pose=ros.pose(1, 2, 3))
        for row in range(50)
    ]
    points = [
        ros.make(
            "geometry_msgs/msg/PointStamped", header=ros.header(row), point=ros.point(0, 0, row)
        )
        for row in range(50)
    ]
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        for kind, sent in (("PoseStamped", poses), ("PointStamped", points)):
            name = f"geometry_msgs/msg/{kind}"
            schema = writer.register_schema(name, "ros2msg", ros.definition(name))
            channel = writer.register_channel("/vrpn", "cdr", schema)
            for row, one in enumerate(sent):
                data = bytes(ros.store.serialize_cdr(one, name))
                writer.add_message(channel, START_NS + row * STEP_NS, data, 0)
        writer.finish()
    return read_episode(path)


def test_a_second_channel_of_a_name_is_there_and_said(tmp_path: Path):
    episode = two_channels(tmp_path / "a.mcap")
    second = "/vrpn@PointStamped"
    assert list(episode.signals) == ["/vrpn", second]
    assert episode.signals_of(second)[0].values[7, 2] == 7
    assert any("second channel" in one and second in one for one in episode.warnings)
    assert all(channel.skipped is None for channel in episode.channels)
    columns = {axis: f"/vrpn.point.{axis}" for axis in "xyz"}
    picked = read_episode(tmp_path / "a.mcap", ReadOptions(columns=columns))
    assert next(iter(picked.signals.values())).values[7, 2] == 7
    imported = import_log(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert imported.messages == 100
