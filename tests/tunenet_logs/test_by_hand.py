"""Fields of messages that a user names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.tunenet_logs.any_message_logs import START_NS, STEP_NS, RosLog, height, write_json
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions, columns_of
from tunenet_logs.reader import read_episode

HEIGHTS = [height(index) for index in range(20)]
TYPES = {
    "lab_msgs/msg/Ball": "std_msgs/Header header\nuint64 timestamp\nfloat32[] values\n"
    "geometry_msgs/Point[] points\nfloat64 height\nfloat64 hit\nstring name",
}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    log = RosLog(TYPES)
    messages = [
        log.make(
            "lab_msgs/msg/Ball",
            header=log.header(index),
            timestamp=5_000_000 + 10_000 * index,
            values=np.array([z, 2 * z, 3 * z], np.float32),
            points=[log.point(0.0, 0.0, 0.0), log.point(0.0, 7.0, z)],
            height=z,
            hit=0.01 * index,
            name="ball",
        )
        for index, z in enumerate(HEIGHTS)
    ]
    points = [
        log.make("geometry_msgs/msg/PointStamped", header=log.header(at), point=log.point(0, z, 0))
        for at, z in enumerate(HEIGHTS)
    ]
    return log.write(
        tmp_path / "a.mcap",
        {
            "/ball": ("lab_msgs/msg/Ball", messages),
            "/lab/point": ("geometry_msgs/msg/PointStamped", points),
        },
    )


def options(columns: str, **more: object) -> ReadOptions:
    return ReadOptions(columns=columns_of(columns), **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ("z=/ball.height", [0, 0, 1]),
        ("z=ball.height", [0, 0, 1]),
        ("x=/ball.values[2],z=/ball.height", [3, 0, 1]),
        ("z=/ball.points[1].z", [0, 0, 1]),
        ("z=/lab/point.point.y", [0, 0, 1]),
    ],
)
def test_a_position_is_named_by_its_topic(path: Path, columns: str, expected: list[float]):
    (signal,) = read_episode(path, options(columns)).signals.values()
    topic = "/lab/point" if "lab" in columns else "/ball"
    assert (signal.name, signal.columns) == (topic, ("x", "y", "z"))
    assert signal.unit == ("m" if "lab" in columns else "")
    assert signal.values == pytest.approx(np.outer(HEIGHTS, expected), rel=1e-6)
    assert signal.stamps_ns[0] == START_NS - 2_000_000


def test_a_unit_that_is_said_goes_before_that_of_a_type(path: Path):
    said = options("z=/lab/point.point.y", length_unit="mm")
    (signal,) = read_episode(path, said).signals.values()
    assert (signal.unit, signal.values[0, 2]) == ("m", pytest.approx(0.0015))


def test_the_clock_of_a_number_is_told_by_that_of_the_log(path: Path):
    (signal,) = read_episode(path, options("t=/ball.timestamp,z=/ball.height")).signals.values()
    assert np.array_equal(signal.stamps_ns, 5_000_000_000 + STEP_NS * np.arange(20))


def test_impacts_are_times_of_a_field_or_of_messages(path: Path):
    (signal,) = read_episode(path, options("times=/ball.hit")).signals.values()
    assert (signal.name, signal.columns, signal.unit) == ("impacts", ("impact",), "1")
    assert signal.seconds == pytest.approx(0.01 * np.arange(20))
    (signal,) = read_episode(path, options("times=/ball")).signals.values()
    assert signal.stamps_ns[0] == START_NS - 2_000_000
    assert np.all(signal.values == 1)


def test_joints_and_currents(path: Path):
    columns = "position_1=/ball.values[0],position_2=/ball.values[1],current_1=/ball.height"
    signals = read_episode(path, options(columns)).signals
    assert {name: (one.unit, one.columns) for name, one in signals.items()} == {
        "/ball.position": ("rad", ("joint1", "joint2")),
        "/ball.current": ("A", ("joint1",)),
    }
    signals = read_episode(path, options(columns, torque_constants=(2.0,))).signals
    assert signals["/ball.effort"].values[:, 0] == pytest.approx(2 * np.array(HEIGHTS))


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ("z=/bal.height", "no topic of --columns z=/bal.height (there are: /ball, /lab/point"),
        ("z=/ball.heigth", "has no heigth; of /ball there are: header.stamp"),
        ("z=/ball.name", "is no number"),
        ("z=/ball", "is a whole message"),
        ("x=/ball.height,z=/lab/point.point.z", "name fields of one topic"),
        ("z=/ball.values[7]", "hold no value"),
    ],
)
def test_what_is_not_there_is_said_in_one_line(path: Path, columns: str, said: str):
    with pytest.raises(LogError) as caught:
        read_episode(path, options(columns))
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


def test_json_is_read_by_hand_too(tmp_path: Path):
    messages = [{"a": {"b c": [0, z]}, "t": 0.01 * at} for at, z in enumerate(HEIGHTS)]
    path = write_json(tmp_path / "a.mcap", "/j", "", messages)
    (signal,) = read_episode(path, options("t=/j.t,z=/j.a.b c[1]")).signals.values()
    assert np.array_equal(signal.values[:, 2], HEIGHTS)
    assert signal.seconds == pytest.approx(0.01 * np.arange(20))
    with pytest.raises(LogError, match="has no q"):
        read_episode(path, options("z=/j.q"))
