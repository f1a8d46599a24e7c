"""Positions of messages whose types nobody here knows: by their shape, or as a user names them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.tunenet_logs.any_message_logs import (
    START_NS,
    STEP_NS,
    RosLog,
    height,
    write_json,
    write_raw,
)
from tunenet_logs.episode import Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions, columns_of
from tunenet_logs.reader import read_episode

HEIGHTS = [height(index) for index in range(20)]
STAMPED = "geometry_msgs/msg/PointStamped"


def reasons(path: Path) -> dict[str, str | None]:
    """Why channels are not used."""
    return {channel.topic: channel.skipped for channel in read_episode(path).channels}


def points(log: RosLog, axis: str = "z") -> list[Any]:
    """Heights as one coordinate of a type that is known."""
    places = [log.point(0, z, 0) if axis == "y" else log.point(0, 0, z) for z in HEIGHTS]
    return [log.make(STAMPED, header=log.header(at), point=one) for at, one in enumerate(places)]


TYPES = {
    "gazebo_msgs/msg/ModelStates": "string[] name\ngeometry_msgs/Pose[] pose\n"
    "geometry_msgs/Twist[] twist",
    "px4_msgs/msg/VehicleOdometry": "uint64 timestamp\nuint8 pose_frame\nfloat32[3] position\n"
    "float32[4] q\nfloat32[3] velocity",
    "tags_msgs/msg/Tag": "int32[] id\nfloat64[] size\ngeometry_msgs/PoseWithCovarianceStamped pose",
    "tags_msgs/msg/Tags": "std_msgs/Header header\nTag[] detections",
    "rigid_msgs/msg/Body": "int32 id\nbool tracking_valid\ngeometry_msgs/PoseStamped pose_stamped",
    "rigid_msgs/msg/Bodies": "std_msgs/Header header\nBody[] rigid_bodies",
    "vicon_bridge/msg/Marker": "string marker_name\nstring subject_name\nstring segment_name\n"
    "geometry_msgs/Point translation\nbool occluded",
    "vicon_bridge/msg/Markers": "std_msgs/Header header\nuint32 frame_number\nMarker[] markers",
}


def states(log: RosLog, index: int, z: float) -> Any:
    """A world with a ball, and a plane that is listed in turns before and behind it."""
    both = [("ball", log.pose(0.0, 0.0, z)), ("plane", log.pose(0.0, 0.0, 0.0))]
    names, poses = zip(*(both if index % 2 else both[::-1]), strict=True)
    return log.make("gazebo_msgs/msg/ModelStates", name=list(names), pose=list(poses), twist=[])


def odometry(log: RosLog, index: int, z: float) -> Any:
    place, turn, speed = np.array([0, 0, z], np.float32), np.zeros(4, "f4"), np.ones(3, "f4")
    return log.make("px4_msgs/msg/VehicleOdometry", timestamp=index, pose_frame=1, position=place,
                    q=turn, velocity=speed)  # fmt: skip


def tags(log: RosLog, index: int, z: float) -> Any:
    kind = "geometry_msgs/msg/PoseWithCovariance"
    pose = log.make(kind, pose=log.pose(0, 0, z), covariance=[0.0] * 36)
    stamped = log.make(f"{kind}Stamped", header=log.header(index), pose=pose)
    tag = log.make("tags_msgs/msg/Tag", id=np.array([7], np.int32), size=[0.1], pose=stamped)
    seen = [tag] if index % 3 else []
    return log.make("tags_msgs/msg/Tags", header=log.header(index), detections=seen)


def bodies(log: RosLog, index: int, z: float) -> Any:
    header = log.header(index)
    stamped = log.make("geometry_msgs/msg/PoseStamped", header=header, pose=log.pose(0.0, 0.0, z))
    body = log.make("rigid_msgs/msg/Body", id=4, tracking_valid=index != 2, pose_stamped=stamped)
    return log.make("rigid_msgs/msg/Bodies", header=header, rigid_bodies=[body])


def vicon(log: RosLog, index: int, z: float) -> Any:
    markers = [
        log.make("vicon_bridge/msg/Marker", marker_name=name, subject_name="ball", segment_name="",
                 translation=log.point(1.0, 2.0, up), occluded=name == "a" and index == 3)
        for name, up in (("a", z), ("b", 0.0))
    ]  # fmt: skip
    header = log.header(index)
    return log.make("vicon_bridge/msg/Markers", header=header, frame_number=index, markers=markers)


def markers(log: RosLog, index: int, z: float) -> Any:
    types, none = log.store.types, np.zeros(0, np.uint8)
    colour = types["std_msgs/msg/ColorRGBA"](0.0, 0.0, 0.0, 0.0)
    fields: dict[str, Any] = {
        "header": log.header(index), "ns": "ball", "id": 3, "type": 2, "action": 0 if index else 3,
        "pose": log.pose(0.0, 0.0, z), "color": colour, "colors": [colour], "frame_locked": False,
        "scale": log.make("geometry_msgs/msg/Vector3", x=0.1, y=0.1, z=0.1),
        "lifetime": log.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        "points": [log.point(9.0, 9.0, 9.0)], "texture_resource": "", "text": "",
        "texture": log.make("sensor_msgs/msg/CompressedImage", header=log.header(0), format="",
                            data=none),
        "uv_coordinates": [], "mesh_resource": "", "mesh_use_embedded_materials": False,
        "mesh_file": log.make("visualization_msgs/msg/MeshFile", filename="", data=none),
    }  # fmt: skip
    one = log.make("visualization_msgs/msg/Marker", **fields)
    return log.make("visualization_msgs/msg/MarkerArray", markers=[one])


def poses(log: RosLog, index: int, z: float, count: int = 2) -> Any:
    many = [log.pose(0.0, 0.0, z)] * count
    return log.make("geometry_msgs/msg/PoseArray", header=log.header(index), poses=many)


@pytest.mark.parametrize(
    ("kind", "make", "names", "unit", "count"),
    [
        ("gazebo_msgs/msg/ModelStates", states, ["/a.ball", "/a.plane"], "m", 20),
        ("px4_msgs/msg/VehicleOdometry", odometry, ["/a"], "", 20),
        ("tags_msgs/msg/Tags", tags, ["/a.7"], "", 13),
        ("rigid_msgs/msg/Bodies", bodies, ["/a.4"], "", 19),
        ("visualization_msgs/msg/MarkerArray", markers, ["/a.ball.3"], "m", 19),
        ("vicon_bridge/msg/Markers", vicon, ["/a.a.ball", "/a.b.ball"], "", 19),
        ("geometry_msgs/msg/PoseArray", poses, ["/a.0", "/a.1"], "m", 20),
    ],
)
def test_types_of_labs(
    tmp_path: Path, kind: str, make: Callable[..., Any], names: list[str], unit: str, count: int
):
    log = RosLog(TYPES)
    sent = [make(log, index, z) for index, z in enumerate(HEIGHTS)]
    path = log.write(tmp_path / "a.mcap", {"/a": (kind, sent)})
    signals = read_episode(path).signals
    assert sorted(signals) == names
    signal = signals[names[0]]
    assert (signal.unit, len(signal.stamps_ns)) == (unit, count)
    assert signal.values[-1, 2] == pytest.approx(HEIGHTS[-1])
    if make is vicon:  # those that are hidden are left out, and a unit may be said
        assert np.array_equal(signal.values[:, 2], np.delete(HEIGHTS, 3))
        assert signal.stamps_ns[0] == START_NS - 2_000_000
        scaled = read_episode(path, ReadOptions(length_unit="mm")).signals[names[0]]
        assert (scaled.unit, scaled.values[0, 2]) == ("m", pytest.approx(0.0015))


def test_what_says_too_little_is_not_read(tmp_path: Path):
    """Entries by number whose number changes, and two of one name."""
    log, path = RosLog({}), tmp_path / "a.mcap"
    sent = [poses(log, index, z, 3 if index == 5 else 2) for index, z in enumerate(HEIGHTS)]
    log.write(path, {"/poses": ("geometry_msgs/msg/PoseArray", sent)})
    assert not read_episode(path).signals
    assert "choose one with --columns z=/poses.poses[0].position.z" in str(reasons(path)["/poses"])
    messages = [
        {"objects": [{"label": name, "position": [0, 0, z]} for name in ("ball", "x", "x")]}
        for z in HEIGHTS
    ]
    episode = read_episode(write_json(path, "/objects", "", messages))
    assert list(episode.signals) == ["/objects.ball"]
    assert "40 entries were left out" in " ".join(episode.warnings)


def test_what_is_known_by_type_comes_first(tmp_path: Path):
    log = RosLog({"a_msgs/msg/Where": "float64[3] position"})
    shaped = [log.make("a_msgs/msg/Where", position=[0.0, 0.0, z]) for z in HEIGHTS]
    topics = {"/a": ("a_msgs/msg/Where", shaped), "/z": (STAMPED, points(log))}
    signals = read_episode(log.write(tmp_path / "a.mcap", topics)).signals
    assert [(one.name, one.unit) for one in signals.values()] == [("/z", "m"), ("/a", "")]
    assert np.array_equal(signals["/a"].values[:, 2], HEIGHTS)
    assert np.array_equal(signals["/a"].stamps_ns, START_NS + STEP_NS * np.arange(20))


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ("geometry_msgs/Point position\ngeometry_msgs/Pose pose", "several positions"),
        ("geometry_msgs/Quaternion pose", "not one that a task uses"),
        ("geometry_msgs/Vector3 speed", "not one that a task uses"),
    ],
)
def test_what_does_not_say_one_position_is_not_read(tmp_path: Path, fields: str, said: str):
    text = RosLog({"a_msgs/msg/What": fields}).definition("a_msgs/msg/What")
    path = write_raw(tmp_path / "a.mcap", "/a", "a_msgs/msg/What", text, bytes(200))
    assert said in str(reasons(path)["/a"])


def test_json_that_only_later_says_something_and_json_of_other_things(tmp_path: Path):
    messages = [{"markers": []}] * 3 + [
        {"markers": [{"name": "m", "position": {"x": 0, "y": 0, "z": z}}]} for z in HEIGHTS
    ]
    episode = read_episode(write_json(tmp_path / "a.mcap", "/tracker", "t", messages))
    assert np.array_equal(episode.signals["/tracker.m"].values[:, 2], HEIGHTS)
    messages = [{"note": float("nan")}, {"note": 1}, [1, 2]] * 100
    episode = read_episode(write_json(tmp_path / "b.mcap", "/notes", "t", messages))
    assert not episode.losses  # is no damage
    assert episode.channels[0].skipped == "its type is not one that a task uses"


RULE = b"\n" + b"=" * 80 + b"\nMSG: "


@pytest.mark.parametrize(
    "definition",
    [
        b"a_msgs/Inner position" + RULE + b"a_msgs/Inner\na_msgs/Inner position",
        b"a_msgs/Inner[1000000000] markers" + RULE + b"a_msgs/Inner\n",
        b"float64[3] position\n\x00\xff",
        b"float64[99999999999] position\nfloat64 z",
        b"a_msgs/Missing position\nfloat64 z",
        b"".join(RULE[1:] + b"a_msgs/T%d\n%s" % (at, b"T%d position%%d\n" % (at + 1) * 2 % (0, 1))
                 for at in range(40)),
    ],
)  # fmt: skip
def test_a_definition_that_is_made_to_hurt_is_passed_over(tmp_path: Path, definition: bytes):
    path = write_raw(tmp_path / "a.mcap", "/a", "a_msgs/msg/T0", definition, bytes(100))
    episode = read_episode(path)
    assert not episode.signals
    assert episode.channels[0].skipped


# Fields that a user names.
BALL = "lab_msgs/msg/Ball"
FIELDS = (
    "std_msgs/Header header\nuint64 timestamp\nfloat32[] values\n"
    "geometry_msgs/Point[] points\nfloat64 height\nfloat64 hit\nstring name"
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    log = RosLog({BALL: FIELDS})
    sent = [
        log.make(BALL, header=log.header(index), timestamp=5_000_000 + 10_000 * index,
                 values=np.array([z, 2 * z, 3 * z], np.float32),
                 points=[log.point(0.0, 0.0, 0.0), log.point(0.0, 7.0, z)], height=z,
                 hit=0.01 * index, name="ball")
        for index, z in enumerate(HEIGHTS)
    ]  # fmt: skip
    topics = {"/ball": (BALL, sent), "/lab/point": (STAMPED, points(log, "y"))}
    return log.write(tmp_path / "a.mcap", topics)


def options(columns: str, **more: Any) -> ReadOptions:
    return ReadOptions(columns=columns_of(columns), **more)


def named(path: Path, columns: str, **more: Any) -> Signal:
    (signal,) = read_episode(path, options(columns, **more)).signals.values()
    return signal


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
    signal = named(path, columns)
    topic, unit = ("/lab/point", "m") if "lab" in columns else ("/ball", "")
    assert (signal.name, signal.columns, signal.unit) == (topic, ("x", "y", "z"), unit)
    assert signal.values == pytest.approx(np.outer(HEIGHTS, expected), rel=1e-6)
    assert signal.stamps_ns[0] == START_NS - 2_000_000


def test_units_clocks_impacts_joints_and_currents_that_are_named(path: Path):
    signal = named(path, "z=/lab/point.point.y", length_unit="mm")  # goes before a type's
    assert (signal.unit, signal.values[0, 2]) == ("m", pytest.approx(0.0015))
    signal = named(path, "t=/ball.timestamp,z=/ball.height")  # its unit is told by the log's clock
    assert np.array_equal(signal.stamps_ns, 5_000_000_000 + STEP_NS * np.arange(20))
    signal = named(path, "times=/ball.hit")
    assert (signal.name, signal.columns, signal.unit) == ("impacts", ("impact",), "1")
    assert signal.seconds == pytest.approx(0.01 * np.arange(20))
    signal = named(path, "times=/ball")  # of the messages
    assert signal.stamps_ns[0] == START_NS - 2_000_000
    assert np.all(signal.values == 1)
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
    signal = named(path, "t=/j.t,z=/j.a.b c[1]")
    assert np.array_equal(signal.values[:, 2], HEIGHTS)
    assert signal.seconds == pytest.approx(0.01 * np.arange(20))
    with pytest.raises(LogError, match="has no q"):
        named(path, "z=/j.q")
