"""Positions by the shape of messages whose types nobody here knows."""

from __future__ import annotations

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
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode

VICON = {
    "vicon_bridge/msg/Marker": "string marker_name\nstring subject_name\nstring segment_name\n"
    "geometry_msgs/Point translation\nbool occluded",
    "vicon_bridge/msg/Markers": "std_msgs/Header header\nuint32 frame_number\nMarker[] markers",
}
HEIGHTS = [height(index) for index in range(20)]


def reasons(path: Path) -> dict[str, str | None]:
    """Why channels are not used."""
    return {channel.topic: channel.skipped for channel in read_episode(path).channels}


def test_named_entries_of_a_list_are_apart_and_those_that_are_hidden_left_out(tmp_path: Path):
    log = RosLog(VICON)

    def marker(name: str, z: float, *, hidden: bool = False) -> Any:
        return log.make(
            "vicon_bridge/msg/Marker",
            marker_name=name,
            subject_name="ball",
            segment_name="",
            translation=log.point(1.0, 2.0, z),
            occluded=hidden,
        )

    messages = [
        log.make(
            "vicon_bridge/msg/Markers",
            header=log.header(index),
            frame_number=index,
            markers=[marker("a", 1000 * z, hidden=index == 3), marker("b", 0.0)],
        )
        for index, z in enumerate(HEIGHTS)
    ]
    path = log.write(tmp_path / "a.mcap", {"/vicon": ("vicon_bridge/msg/Markers", messages)})
    signals = read_episode(path).signals
    assert list(signals) == ["/vicon.a.ball", "/vicon.b.ball"]
    signal = signals["/vicon.a.ball"]
    assert signal.unit == ""
    assert np.array_equal(signal.values[:, 2], np.delete(1000 * np.array(HEIGHTS), 3))
    assert signal.stamps_ns[0] == START_NS - 2_000_000
    scaled = read_episode(path, ReadOptions(length_unit="mm")).signals["/vicon.a.ball"]
    assert scaled.unit == "m"
    assert scaled.values[0, 2] == pytest.approx(1.5)


@pytest.mark.parametrize("changes", [False, True])
def test_a_pose_array_is_read_by_number_where_the_number_never_changes(
    tmp_path: Path, changes: bool
):
    log = RosLog({})
    kind = "geometry_msgs/msg/PoseArray"
    messages = [
        log.make(
            kind,
            header=log.header(index),
            poses=[log.pose(0.0, 0.0, z)] * (3 if changes and index == 5 else 2),
        )
        for index, z in enumerate(HEIGHTS)
    ]
    path = log.write(tmp_path / "a.mcap", {"/poses": (kind, messages)})
    signals = read_episode(path).signals
    if changes:
        assert not signals
        assert "choose one with --columns z=/poses.poses[0].position.z" in str(
            reasons(path)["/poses"]
        )
    else:
        assert [(one.name, one.unit) for one in signals.values()] == [
            ("/poses.0", "m"),
            ("/poses.1", "m"),
        ]


def test_what_is_known_by_type_comes_first(tmp_path: Path):
    log = RosLog({"a_msgs/msg/Where": "float64[3] position"})
    shaped = [log.make("a_msgs/msg/Where", position=[0.0, 0.0, z]) for z in HEIGHTS]
    points = [
        log.make("geometry_msgs/msg/PointStamped", header=log.header(at), point=log.point(0, 0, z))
        for at, z in enumerate(HEIGHTS)
    ]
    path = log.write(
        tmp_path / "a.mcap",
        {
            "/a": ("a_msgs/msg/Where", shaped),
            "/z": ("geometry_msgs/msg/PointStamped", points),
        },
    )
    signals = read_episode(path).signals
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


def test_two_entries_of_one_name_are_left_out(tmp_path: Path):
    messages = [
        {"objects": [{"label": name, "position": [0, 0, z]} for name in ("ball", "x", "x")]}
        for z in HEIGHTS
    ]
    episode = read_episode(write_json(tmp_path / "a.mcap", "/objects", "", messages))
    assert list(episode.signals) == ["/objects.ball"]
    assert "40 entries were left out" in " ".join(episode.warnings)


def test_json_that_only_later_says_something_is_read(tmp_path: Path):
    messages = [{"markers": []}] * 3 + [
        {"markers": [{"name": "m", "position": {"x": 0, "y": 0, "z": z}}]} for z in HEIGHTS
    ]
    episode = read_episode(write_json(tmp_path / "a.mcap", "/tracker", "t", messages))
    assert np.array_equal(episode.signals["/tracker.m"].values[:, 2], HEIGHTS)


def test_json_of_other_things_is_no_damage(tmp_path: Path):
    messages = [{"note": float("nan")}, {"note": 1}, [1, 2]] * 100
    path = write_json(tmp_path / "a.mcap", "/notes", "t", messages)
    episode = read_episode(path)
    assert not episode.losses
    assert episode.channels[0].skipped == "its type is not one that a task uses"


@pytest.mark.parametrize(
    "definition",
    [
        b"a_msgs/Inner position\n" + b"=" * 80 + b"\nMSG: a_msgs/Inner\na_msgs/Inner position",
        b"a_msgs/Inner[1000000000] markers\n" + b"=" * 80 + b"\nMSG: a_msgs/Inner\n",
        b"float64[3] position\n\x00\xff",
        b"float64[99999999999] position\nfloat64 z",
        b"a_msgs/Missing position\nfloat64 z",
        b"".join(
            b"=" * 80
            + b"\nMSG: a_msgs/T%d\n%s" % (at, b"T%d position%%d\n" % (at + 1) * 2 % (0, 1))
            for at in range(40)
        ),
    ],
)
def test_a_definition_that_is_made_to_hurt_is_passed_over(tmp_path: Path, definition: bytes):
    path = write_raw(tmp_path / "a.mcap", "/a", "a_msgs/msg/T0", definition, bytes(100))
    episode = read_episode(path)
    assert not episode.signals
    assert episode.channels[0].skipped


LAB_TYPES = {
    "gazebo_msgs/msg/ModelStates": "string[] name\ngeometry_msgs/Pose[] pose\n"
    "geometry_msgs/Twist[] twist",
    "px4_msgs/msg/VehicleOdometry": "uint64 timestamp\nuint8 pose_frame\nfloat32[3] position\n"
    "float32[4] q\nfloat32[3] velocity",
    "tags_msgs/msg/Tag": "int32[] id\nfloat64[] size\ngeometry_msgs/PoseWithCovarianceStamped pose",
    "tags_msgs/msg/Tags": "std_msgs/Header header\nTag[] detections",
    "rigid_msgs/msg/Body": "int32 id\nbool tracking_valid\ngeometry_msgs/PoseStamped pose_stamped",
    "rigid_msgs/msg/Bodies": "std_msgs/Header header\nBody[] rigid_bodies",
}


def states(log: RosLog, index: int, z: float) -> Any:
    """A world with a ball, and a plane that is listed in turns before and behind it."""
    names, poses = ["ball", "plane"], [log.pose(0.0, 0.0, z), log.pose(0.0, 0.0, 0.0)]
    order = (0, 1) if index % 2 else (1, 0)
    return log.make(
        "gazebo_msgs/msg/ModelStates",
        name=[names[at] for at in order],
        pose=[poses[at] for at in order],
        twist=[],
    )


def odometry(log: RosLog, index: int, z: float) -> Any:
    return log.make(
        "px4_msgs/msg/VehicleOdometry",
        timestamp=index,
        pose_frame=1,
        position=np.array([0, 0, z], np.float32),
        q=np.zeros(4, np.float32),
        velocity=np.ones(3, np.float32),
    )


def tags(log: RosLog, index: int, z: float) -> Any:
    pose = log.make(
        "geometry_msgs/msg/PoseWithCovariance", pose=log.pose(0, 0, z), covariance=[0.0] * 36
    )
    stamped = log.make(
        "geometry_msgs/msg/PoseWithCovarianceStamped", header=log.header(index), pose=pose
    )
    tag = log.make("tags_msgs/msg/Tag", id=np.array([7], np.int32), size=[0.1], pose=stamped)
    seen = [tag] if index % 3 else []
    return log.make("tags_msgs/msg/Tags", header=log.header(index), detections=seen)


def bodies(log: RosLog, index: int, z: float) -> Any:
    stamped = log.make(
        "geometry_msgs/msg/PoseStamped", header=log.header(index), pose=log.pose(0.0, 0.0, z)
    )
    body = log.make("rigid_msgs/msg/Body", id=4, tracking_valid=index != 2, pose_stamped=stamped)
    return log.make("rigid_msgs/msg/Bodies", header=log.header(index), rigid_bodies=[body])


def markers(log: RosLog, index: int, z: float) -> Any:
    kinds = log.store.types
    empty: dict[str, Any] = {}
    for name in ("visualization_msgs/msg/UVCoordinate", "std_msgs/msg/ColorRGBA"):
        empty[name] = kinds[name](
            **dict.fromkeys(("u", "v") if "UV" in name else tuple("rgba"), 0.0)
        )
    one = log.make(
        "visualization_msgs/msg/Marker",
        header=log.header(index),
        ns="ball",
        id=3,
        type=2,
        action=0 if index else 3,
        pose=log.pose(0.0, 0.0, z),
        scale=log.make("geometry_msgs/msg/Vector3", x=0.1, y=0.1, z=0.1),
        color=empty["std_msgs/msg/ColorRGBA"],
        lifetime=log.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[log.point(9.0, 9.0, 9.0)],
        colors=[empty["std_msgs/msg/ColorRGBA"]],
        texture_resource="",
        texture=log.make(
            "sensor_msgs/msg/CompressedImage",
            header=log.header(0),
            format="",
            data=np.zeros(0, np.uint8),
        ),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=log.make(
            "visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8)
        ),
        mesh_use_embedded_materials=False,
    )
    return log.make("visualization_msgs/msg/MarkerArray", markers=[one])


@pytest.mark.parametrize(
    ("kind", "make", "names", "unit", "count"),
    [
        ("gazebo_msgs/msg/ModelStates", states, ["/a.ball", "/a.plane"], "m", 20),
        ("px4_msgs/msg/VehicleOdometry", odometry, ["/a"], "", 20),
        ("tags_msgs/msg/Tags", tags, ["/a.7"], "", 13),
        ("rigid_msgs/msg/Bodies", bodies, ["/a.4"], "", 19),
        ("visualization_msgs/msg/MarkerArray", markers, ["/a.ball.3"], "m", 19),
    ],
)
def test_types_of_labs(
    tmp_path: Path, kind: str, make: Any, names: list[str], unit: str, count: int
):
    log = RosLog(LAB_TYPES)
    messages = [make(log, index, z) for index, z in enumerate(HEIGHTS)]
    signals = read_episode(log.write(tmp_path / "a.mcap", {"/a": (kind, messages)})).signals
    assert sorted(signals) == names
    signal = signals[names[0]]
    assert (signal.unit, len(signal.stamps_ns)) == (unit, count)
    assert signal.values[-1, 2] == pytest.approx(HEIGHTS[-1])
