"""Several publishers or bodies on one topic stay apart; what drives a robot, in every encoding."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import Command
from tests.message_logs import (
    JOINT_STATE,
    NUMBER,
    NUMBERS,
    ODOMETRY,
    POSE,
    START_NS,
    STEP_NS,
    TF,
    TRAJECTORY,
    WRENCH,
    WRITERS,
    Schema,
    Sent,
    definition,
    header,
    in_steps,
    numbers,
    point,
    pose,
    ros2,
    trajectory,
    transform,
    wrench,
    write_cdr,
    write_json,
    write_raw,
)
from tests.reading import skipped
from tests.strangers import bounce_heights
from tunenet_logs.copying import import_log
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.base import BeyondLimitError
from tunenet_logs.formats.message_types import JointSample, PlanSample
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode, without_commands
from tunenet_logs.signals import JointRows, PlannedRows, PointBudget, PositionRows, two_sources

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
    heights = bounce_heights(0.7, height_m, SECONDS)
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


@pytest.mark.parametrize("name", ["cdr.mcap", "one.bag", "folder"])
@pytest.mark.parametrize("children", [("ball", "cube"), ("ball",)])
def test_odometry_of_two_bodies_is_apart_by_its_children(
    tmp_path: Path, name: str, children: tuple[str, ...]
):
    sent: list[Sent] = [
        ("/odom", ODOMETRY, n * STEP_NS, {
            "header": header(stamp(n), "map"), "child_frame_id": children[n % len(children)],
            "pose": {"pose": {"position": {"x": n, "y": 2.0, "z": -n / 3}}},
        })
        for n in range(400)
    ]  # fmt: skip
    signals = read_episode(WRITERS[name](tmp_path / name, sent)).signals
    assert list(signals) == [f"/odom.{one}" for one in children] if children[1:] else ["/odom"]
    for first, signal in enumerate(signals.values()):
        rows = np.arange(first, 400, len(children))
        assert np.array_equal(signal.values, np.column_stack([rows, 2 + 0 * rows, -rows / 3]))
        assert np.array_equal(signal.stamps_ns, START_NS + rows * STEP_NS)


def test_a_second_channel_of_a_name_is_there_and_said(tmp_path: Path):
    """A topic with two types; what falls is of the second."""
    path, said = tmp_path / "a.mcap", [header(stamp(row)) for row in range(50)]
    lies = [{"header": one, "pose": {"position": {"x": 1, "y": 2, "z": 3}}} for one in said]
    falls = [{"header": one, "point": {"z": row}} for row, one in enumerate(said)]
    both = [("PoseStamped", lies), ("PointStamped", falls)]
    kinds = [in_steps("/vrpn", f"geometry_msgs/msg/{kind}", sent) for kind, sent in both]
    write_cdr(path, [*kinds[0], *kinds[1]])
    episode, second = read_episode(path), "/vrpn@PointStamped"
    assert list(episode.signals) == ["/vrpn", second]
    assert episode.signals_of(second)[0].values[7, 2] == 7
    assert any("second channel" in one and second in one for one in episode.warnings)
    assert all(channel.skipped is None for channel in episode.channels)
    columns = {axis: f"/vrpn.point.{axis}" for axis in "xyz"}
    picked = read_episode(path, ReadOptions(columns=columns))
    assert next(iter(picked.signals.values())).values[7, 2] == 7
    assert import_log(path, tmp_path / "b.mcap").messages == 100


# What drives a robot, and how it is turned: trajectories, numbers, wrenches, in every encoding.
S = 10**9
AB = ("a", "b")
NAN, INF = float("nan"), float("inf")
STATE = {"header": header(START_NS), "name": ["a"], "position": [1.0], "velocity": [], "effort": []}


def read(tmp_path: Path, *messages: tuple[str, int, dict]) -> Episode:
    """An episode of messages under `/cmd`: type, when received [ns], fields."""
    sent = [("/cmd", kind, at_ns, fields) for kind, at_ns, fields in messages]
    return read_episode(write_cdr(tmp_path / "a.mcap", sent))


def said(episode: Episode) -> list[str]:
    """What is said of its topics: writers of some kinds leave a checksum out."""
    return [warning for warning in episode.warnings if warning.startswith("/")]


@pytest.mark.parametrize("name", list(WRITERS))
def test_every_encoding_reads_as_the_same_signals(tmp_path: Path, name: str):
    later = START_NS + 5 * S
    plan = trajectory(later, AB, point(0, [1, 2], [3, 4], [5, 6]), point(S // 2, [7, 8]))
    sent: list[Sent] = [
        ("/plan", TRAJECTORY, 0, plan),
        ("/many", NUMBERS, 1, numbers(1.5, -2.5)),
        ("/few", NUMBERS.replace("64", "32"), 2, numbers(0.5)),
        ("/one", NUMBER, 3, {"data": 4.25}),
        ("/single", NUMBER.replace("64", "32"), 4, {"data": 0.25}),
        ("/wrench", WRENCH, 5, wrench(later, (1, 2, 3), (4, 5, 6))),
    ]
    episode = read_episode(WRITERS[name](tmp_path / name, sent))
    assert not said(episode)
    assert not episode.losses
    assert all(one.drives and one.skipped is None for one in episode.channels)
    found = {
        name: (one.values.tolist(), one.columns, one.unit) for name, one in episode.signals.items()
    }
    assert str(found) == str({
        "/plan.position": ([[1.0, 2.0], [7.0, 8.0]], AB, "rad"),
        "/plan.velocity": ([[3.0, 4.0], [NAN] * 2], AB, "rad/s"),
        "/plan.effort": ([[5.0, 6.0], [NAN] * 2], AB, "N·m"),
        "/many": ([[1.5, -2.5]], ("0", "1"), "1"),
        "/few": ([[0.5]], ("0",), "1"),
        "/one": ([[4.25]], ("0",), "1"),
        "/single": ([[0.25]], ("0",), "1"),
        "/wrench.force": ([[1.0, 2.0, 3.0]], ("x", "y", "z"), "N"),
        "/wrench.torque": ([[4.0, 5.0, 6.0]], ("x", "y", "z"), "N·m"),
    })  # fmt: skip
    stamps = {name: one.stamps_ns.tolist() for name, one in episode.signals.items()}
    assert stamps["/plan.position"] == [later, later + S // 2]
    assert (stamps["/many"], stamps["/one"]) == ([START_NS + 1], [START_NS + 3])
    assert stamps["/wrench.force"] == [later]


def counting(*numbers: int) -> dict:
    """A plan whose positions say when they are reached."""
    return trajectory(0, "a", *(point(S * one, [one]) for one in numbers))


BOTH = trajectory(0, AB, point(S, [1, 2]), point(3 * S, [3, 4]))


@pytest.mark.parametrize(
    ("sent", "times", "positions"),
    [
        # Without a stamp it starts when it arrives.
        ([(2 * S, trajectory(0, "a", point(S, [1])))], [3], [[1.0]]),
        # A later one replaces what comes after its start.
        ([(0, counting(1, 2, 3, 4, 5)),
          (3 * S, trajectory(0, "a", point(S, [40]), point(9 * S, [50]))),
          (3 * S + 1, trajectory(START_NS + 8 * S, "a", point(S, [60])))],
         [1, 2, 3, 4, 9], [[1.0], [2.0], [3.0], [40.0], [60.0]]),
        # Of two for one moment the later counts.
        ([(0, counting(1)), (S, trajectory(0, "a", point(0, [2])))], [1], [[2.0]]),
        # It replaces that of its own joints alone.
        ([(0, BOTH), (S, trajectory(0, "c", point(S, [7]))), (2 * S, trajectory(0, "b"))],
         [1, 2], [[1.0, 2.0, NAN], [NAN, NAN, 7.0]]),
        ([(0, BOTH), (2 * S, trajectory(0, "b", point(2 * S, [9])))],
         [1, 3, 4], [[1.0, 2.0], [3.0, NAN], [NAN, 9.0]]),
        ([(0, BOTH), (2 * S, trajectory(0, "ba", point(S, [6, 5])))],
         [1, 3], [[1.0, 2.0], [5.0, 6.0]]),
        # One without points ends every plan.
        ([(0, counting(1, 2, 3, 4, 5)), (2 * S, trajectory(0, ()))], [1, 2], [[1.0], [2.0]]),
    ],
)  # fmt: skip
def test_plans_that_follow_each_other(tmp_path: Path, sent: list, times: list, positions: list):
    signal = read(tmp_path, *((TRAJECTORY, *one) for one in sent)).signals["/cmd.position"]
    assert ((signal.stamps_ns - START_NS) / S).tolist() == times
    assert str(signal.values.tolist()) == str(positions)


@pytest.mark.parametrize(
    ("plan", "said"),
    [
        (trajectory(0, "a", point(-1, [9])), "1 messages were left out"),
        (trajectory(0, "a", point(S, [9]), point(S, [9])), "do not increase from 0"),
        (trajectory(0, "a", point(S, [9]), point(0, [9])), "do not increase from 0"),
        (trajectory(0, "a", point(0, [9, 9])), "1 names but another number of values"),
        (trajectory(0, "aa", point(0, [9, 9])), "two joints have one name"),
        (trajectory(0, (), point(0, [9])), "but another number of values"),
        (trajectory(0, (), point(0)), "it names no joint"),
        (trajectory(0, [str(one) for one in range(1001)], point(0)), "over 1000 joints"),
    ],
)
def test_a_plan_that_no_controller_takes_changes_nothing(tmp_path: Path, plan: dict, said: str):
    good = trajectory(0, "a", point(S, [1]), point(5 * S, [2]))
    episode = read(tmp_path, (TRAJECTORY, 0, good), (TRAJECTORY, S, plan))
    assert episode.signals["/cmd.position"].values.tolist() == [[1], [2]]
    assert any(said in warning for warning in episode.warnings), episode.warnings


def test_stamps_beyond_the_calendar_are_damage(tmp_path: Path):
    far = trajectory(0, "a", point(0, [1]))
    far["points"][0]["time_from_start"] = {"sec": 10**10, "nanosec": 0}
    episode = read_episode(write_json(tmp_path / "a.mcap", [("/cmd", TRAJECTORY, 0, far)]))
    assert not episode.signals
    assert "beyond the year 2262" in episode.losses[0]


@pytest.mark.parametrize(
    ("count", "says"),
    [
        (10**6, "a message of 24000028 bytes is over the limit of 4194304"),
        (100_001, "over 100000 parts"),
    ],
)
def test_a_million_points_are_not_even_decoded(tmp_path: Path, count: int, says: str):
    """A message of these would become objects of a gigabyte."""
    start = b"\0\1\0\0" + bytes(8) + np.array([1, 0, 0, count], np.uint32).tobytes()
    sent = [("/cmd", Schema(TRAJECTORY, text=definition(ros2(), TRAJECTORY)), START_NS,
             start + bytes(24) * count)]  # fmt: skip
    episode = read_episode(write_raw(tmp_path / "a.mcap", sent))
    assert not episode.signals
    assert says in " ".join([*skipped(episode).values(), *episode.warnings])


def test_the_points_and_values_of_a_log_are_bounded():
    rows = PlannedRows("/cmd", PointBudget(0))
    points = [(one, (), (), ()) for one in range(90_000)]
    rows.add(0, PlanSample(0, ("a",), points))
    with pytest.raises(BeyondLimitError, match="over 10000000 values"):
        rows.add(0, PlanSample(0, tuple(map(str, range(100))), points))
    rows.check(b"")
    with pytest.raises(BeyondLimitError, match="over 200000 points"):
        rows.add(0, PlanSample(0, ("a",), points))
    with pytest.raises(BeyondLimitError, match="over 200000 points"):
        rows.check(b"")
    assert rows.signals() == ([], [])  # no quantity was given


def test_what_is_no_number_is_missing_in_a_plan(tmp_path: Path):
    sent: list[Sent] = [
        ("/plan", TRAJECTORY, 0, trajectory(0, AB, point(0, [NAN, INF]), point(1, [1, NAN]))),
        ("/numbers", NUMBERS, 0, numbers(NAN, 1.0, -INF)),
        ("/wrench", WRENCH, 0, wrench(START_NS, (NAN, 1, 2), (NAN, NAN, INF))),
    ]
    signals = read_episode(write_cdr(tmp_path / "a.mcap", sent)).signals
    assert list(signals) == ["/plan.position", "/numbers", "/wrench.force"]
    assert not any(np.isinf(signal.values).any() for signal in signals.values())
    assert np.isnan(signals["/plan.position"].values).tolist() == [[True, True], [False, True]]


def test_of_plain_numbers_the_most_frequent_length_counts(tmp_path: Path):
    lengths = (2, 3, 3, 1, 3, 1001, 0)
    sent = [(NUMBERS, at, numbers(*[float(at)] * length)) for at, length in enumerate(lengths)]
    episode = read(tmp_path, *sent)
    assert episode.signals["/cmd"].values.tolist() == [[one] * 3 for one in (1, 2, 4)]
    assert episode.signals["/cmd"].stamps_ns.tolist() == [START_NS + one for one in (1, 2, 4)]
    assert said(episode) == [
        "/cmd: 2 messages were left out (the first: over 1000 numbers)",
        "/cmd: 2 messages of another length than 3 were left out",
    ]
    dim = {"label": "joints", "size": 2, "stride": 2}
    laid_out = {"layout": {"dim": [dim], "data_offset": 0}, "data": [1.0, 2.0]}
    episode = read(tmp_path, (NUMBERS, 0, laid_out), (NUMBERS, 1, numbers(*[0.0] * 10_000)))
    assert episode.signals["/cmd"].values.tolist() == [[1, 2]]
    assert "bytes is over the limit of 65536" in said(episode)[0]
    sent = [(WRENCH, one, wrench(0, (one, 0, 0), (0, 0, 0))) for one in range(3)]
    force = read(tmp_path, *sent).signals["/cmd.force"]  # by the clock that tells the time
    assert force.stamps_ns.tolist() == [START_NS, START_NS + 1, START_NS + 2]


def test_a_plan_does_not_take_the_name_of_a_state(tmp_path: Path):
    path, plan = tmp_path / "a.mcap", trajectory(0, "a", point(0, [2]))
    write_json(path, [("/a", TRAJECTORY, 0, plan), ("/a.position", NUMBER, 1, {"data": 1})])
    assert set(read_episode(path).signals) == {"/a.position", "/a.position@Float64"}
    other = ("/joint_states.position", NUMBER, 0, {"data": 9.0})
    write_json(path, [other, ("/joint_states", JOINT_STATE, 1, STATE)])
    assert read_episode(path).signals["/joint_states.position"].values.tolist() == [[1]]


@pytest.fixture
def driven(tmp_path: Path) -> Path:
    sent: list[Sent] = [
        ("/state", JOINT_STATE, 0, STATE),
        ("/cmd", TRAJECTORY, 0, trajectory(0, "a", point(0, [2]))),
        ("/cmd", TRAJECTORY, 1, trajectory(0, "a", point(-1, [2]))),
        ("/u", NUMBERS, 2, numbers(1)),
        ("/u", NUMBERS, 3, numbers(1, 2)),
        ("/f", WRENCH, 4, wrench(0, (1, 2, 3), (1, 2, 3))),
    ]
    return write_cdr(tmp_path / "driven.mcap", sent)


def test_what_was_measured_is_the_rest(driven: Path):
    episode = read_episode(driven)
    assert len(said(episode)) == 2
    rest = without_commands(episode)
    assert list(rest.signals) == ["/state.position"]
    assert not said(rest)
    why = "its type is not one that a task uses"
    skipped = {one.topic: one.skipped for one in rest.channels}
    assert skipped == {"/state": None, "/cmd": why, "/u": why, "/f": why}
    assert without_commands(rest).signals == rest.signals


def test_an_import_makes_no_state_of_a_command(driven: Path, tmp_path: Path):
    done = import_log(driven, tmp_path / "b.mcap")
    copy = read_episode(tmp_path / "b.mcap")
    assert {name: one.drives for name, one in copy.signals.items()} == {
        "/state.position": False,
        "/cmd.position": True,
        "/u": True,
    }
    assert list(without_commands(copy).signals) == ["/state.position"]
    assert [line.partition(":")[0] for line in done.left_out][:1] == ["/f"]
    write_cdr(tmp_path / "c.mcap", [("/f", WRENCH, 0, wrench(0, (1, 2, 3), (1, 2, 3)))])
    with pytest.raises(LogError, match="holds no positions, joints, pictures or sound"):
        import_log(tmp_path / "c.mcap", tmp_path / "d.mcap")


def test_info_and_check_say_that_they_are_used(driven: Path, command: Command):
    done = command("tunenet-logs", "info", driven)
    assert done.returncode == 0
    rows = [line for line in done.stdout.splitlines() if line.startswith("  /")][:4]
    assert sorted(row.endswith("with --model") for row in rows) == [False, True, True, True]
    assert sum(row.endswith("yes") for row in rows) == 1
    assert "/cmd: 1 messages were left out (the first: the times of its points" in done.stdout
    done = command("tunenet-logs", "check", driven)
    assert done.returncode == 1
    assert "/cmd" in done.stdout
    assert "not whole" in done.stdout


# Orientations and frames of what has a position.
MOMENTS = 20
ANGLES = np.linspace(0.0, 1.0, MOMENTS)
TURNS = np.column_stack([np.zeros((MOMENTS, 2)), np.sin(ANGLES / 2), np.cos(ANGLES / 2)])
FRAMES = {
    "/mocap": "room", "/mocap.orientation": "room", "/tf.tool": "base",
    "/tf.tool.orientation": "base", "/ft.force": "flange", "/ft.torque": "flange",
}  # fmt: skip


def turned(turns: Any = TURNS) -> list[Sent]:
    """A pose, a transform and a wrench at each of some moments."""
    found: list[Sent] = []
    for number, turn in enumerate(turns):
        at_ns = number * STEP_NS
        stamp_ns = START_NS + at_ns
        moved = transform(stamp_ns, (1, 2, number), turn, "base", "tool")
        found += [
            ("/mocap", POSE, at_ns, pose(stamp_ns, (number, 0, 0), turn, "room")),
            ("/tf", TF, at_ns, {"transforms": [moved]}),
            ("/ft", WRENCH, at_ns, wrench(stamp_ns, (1, 2, 3), (4, 5, 6), "flange")),
        ]
    return found


@pytest.mark.parametrize("name", WRITERS)
def test_orientations_and_frames_are_read_and_imported(name: str, tmp_path: Path):
    path = WRITERS[name](tmp_path / name, turned())
    signals = read_episode(path).signals
    assert {one.name: one.frame for one in signals.values()} == FRAMES
    for label in ("/mocap.orientation", "/tf.tool.orientation"):
        assert signals[label].columns == ("x", "y", "z", "w")
        np.testing.assert_allclose(signals[label].values, TURNS, atol=1e-15)
        assert not signals[label].is_position
    imported = import_log(path, tmp_path / "imported.mcap")
    assert [one for one in imported.left_out if one.startswith("/ft: a force")]
    again = read_episode(tmp_path / "imported.mcap").signals
    for old, new in (("/mocap", "/mocap"), ("/tf.tool", "/tf/tool")):
        for label in ("", ".orientation"):
            one, other = signals[old + label], again[new + label]
            assert np.array_equal(one.values, other.values)
            assert one.frame == other.frame


@pytest.mark.parametrize("turn", [(0, 0, 0, 1), (0, 0, 0, 0), (np.nan,) * 4, (3, 4, 0, 0)])
def test_what_is_no_rotation_is_no_signal(turn: Any, tmp_path: Path):
    path = write_cdr(tmp_path / "a.mcap", turned([turn] * MOMENTS))
    assert not [name for name in read_episode(path).signals if "orientation" in name]
