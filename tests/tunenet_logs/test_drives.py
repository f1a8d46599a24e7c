"""What drives a robot, and how it is turned: trajectories, numbers, wrenches, in every encoding."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

from tests.conftest import Command
from tests.driven_logs import (
    DRIVEN_WRITERS,
    JOINT_STATE,
    NUMBER,
    NUMBERS,
    POSE,
    START_NS,
    TF,
    TRAJECTORY,
    WRENCH,
    Sent,
    header,
    numbers,
    point,
    pose,
    trajectory,
    transform,
    wrench,
    write_cdr,
    write_json,
)
from tunenet_logs.copying import import_log
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.base import BeyondLimitError
from tunenet_logs.formats.message_types import PlanSample
from tunenet_logs.reader import read_episode, without_commands
from tunenet_logs.signals import PlannedRows, PointBudget

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


@pytest.mark.parametrize("name", list(DRIVEN_WRITERS))
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
    episode = read_episode(DRIVEN_WRITERS[name](tmp_path / name, sent))
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
        (trajectory(0, "a", *(point(one) for one in range(100_001))), "over 100000 points"),
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


def test_a_million_points_are_not_even_decoded(tmp_path: Path):
    """A message of these would become objects of a gigabyte."""
    start = b"\0\1\0\0" + bytes(8) + np.array([1, 0, 0, 10**6], np.uint32).tobytes()
    data = start + bytes(24) * 10**6
    text = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(TRAJECTORY, ros_version=2)[0]
    with (tmp_path / "a.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        schema = writer.register_schema(TRAJECTORY, "ros2msg", text.encode())
        channel = writer.register_channel("/cmd", "cdr", schema)
        writer.add_message(channel, START_NS, data, START_NS)
        writer.finish()
    episode = read_episode(tmp_path / "a.mcap")
    assert not episode.signals
    says = f"a message of {len(data)} bytes is over the limit of 4194304"
    assert [one.skipped for one in episode.channels] == [says]


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
    rows = PlannedRows("/cmd", PointBudget(0))
    for name in range(500):
        rows.add(0, PlanSample(0, (str(name),), [(1, (1.0,), (), ())]))
    for _ in range(19_500):  # many ends of plans take no time
        rows.add(1, PlanSample(0, (), ()))
    with pytest.raises(BeyondLimitError, match="over 10000000 values"):
        rows.add(1, PlanSample(0, (), ()))
    (position,), _ = rows.signals()
    assert position.values.tolist() == [[1.0] * 500]


def test_what_is_no_number_is_missing(tmp_path: Path):
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
    assert list(read_episode(tmp_path / "b.mcap").signals) == ["/state.position"]
    assert [line.partition(":")[0] for line in done.left_out] == ["/cmd", "/u", "/f"]
    write_cdr(tmp_path / "c.mcap", [("/u", NUMBERS, 0, numbers(1))])
    with pytest.raises(LogError, match="holds no positions, joints, pictures or sound"):
        import_log(tmp_path / "c.mcap", tmp_path / "d.mcap")


def test_info_and_check_say_that_they_are_used(driven: Path, command: Command):
    done = command("tunenet-logs", "info", driven)
    assert done.returncode == 0
    rows = [line for line in done.stdout.splitlines() if line.startswith("  /")][:4]
    assert all(row.endswith("yes") for row in rows), rows
    assert "/cmd: 1 messages were left out (the first: the times of its points" in done.stdout
    done = command("tunenet-logs", "check", driven)
    assert done.returncode == 1
    assert "/cmd" in done.stdout
    assert "not whole" in done.stdout


_ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=4,
)


@given(data=st.data())
def test_anything_in_a_plan_is_a_plan_or_left_out(tmp_path_factory: Any, data: st.DataObject):
    plan = trajectory(0, AB, point(0, [1, 2]), point(S, [3, 4]))
    where = data.draw(st.sampled_from(["joint_names", "points", "point", "time"]))
    if where in plan:
        plan[where] = data.draw(_ANY)
    elif where == "point":
        plan["points"][1]["positions"] = data.draw(_ANY)
    else:
        wide = st.integers(-(10**12), 10**12)
        plan["points"][1]["time_from_start"] = {"sec": data.draw(wide), "nanosec": 0}
    path = tmp_path_factory.mktemp("any") / "a.mcap"
    good = trajectory(0, AB, point(0, [1, 2]))
    episode = read_episode(
        write_json(path, [("/cmd", TRAJECTORY, 0, good), ("/cmd", TRAJECTORY, S, plan)])
    )
    assert episode.signals["/cmd.position"].values[0].tolist() == [1, 2]


# Orientations and frames of what has a position.
STEP_NS, COUNT = 10_000_000, 20
ANGLES = np.linspace(0.0, 1.0, COUNT)
TURNS = np.column_stack([np.zeros((COUNT, 2)), np.sin(ANGLES / 2), np.cos(ANGLES / 2)])
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


@pytest.mark.parametrize("name", DRIVEN_WRITERS)
def test_orientations_and_frames_are_read_and_imported(name: str, tmp_path: Path):
    path = DRIVEN_WRITERS[name](tmp_path / name, turned())
    signals = read_episode(path).signals
    assert {one.name: one.frame for one in signals.values()} == FRAMES
    for label in ("/mocap.orientation", "/tf.tool.orientation"):
        assert signals[label].columns == ("x", "y", "z", "w")
        np.testing.assert_allclose(signals[label].values, TURNS, atol=1e-15)
        assert not signals[label].is_position
    imported = import_log(path, tmp_path / "imported.mcap")
    assert [one for one in imported.left_out if one.startswith("/ft: a command or a force")]
    again = read_episode(tmp_path / "imported.mcap").signals
    for old, new in (("/mocap", "/mocap"), ("/tf.tool", "/tf/tool")):
        for label in ("", ".orientation"):
            one, other = signals[old + label], again[new + label]
            assert np.array_equal(one.values, other.values)
            assert one.frame == other.frame


@pytest.mark.parametrize("turn", [(0, 0, 0, 1), (0, 0, 0, 0), (np.nan,) * 4, (3, 4, 0, 0)])
def test_what_is_no_rotation_is_no_signal(turn: Any, tmp_path: Path):
    path = write_cdr(tmp_path / "a.mcap", turned([turn] * COUNT))
    assert not [name for name in read_episode(path).signals if "orientation" in name]
