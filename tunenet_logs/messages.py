"""Define and encode the ROS 2 messages that logs hold.

Types and CDR serialization come from rosbags; the definitions are those of ROS 2 Humble, which the
later distributions share for every type used here, Kinova's for its own, and one of ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError
from tunenet_logs.images import image_size

# ---- JPEG: check that one is whole, and encode bare pixels


def is_whole(data: bytes) -> bool:
    """Check whether `data` is one JPEG from first to last marker, of a camera's size."""
    if not data.startswith(b"\xff\xd8") or not data.rstrip(b"\0 \t\r\n").endswith(b"\xff\xd9"):
        return False
    try:
        image_size(data)
    except LogError:
        return False
    return True


def compressed(frame: Frame) -> Frame:
    """Encode bare pixels as JPEG, colour at full resolution (4:4:4), by which a ball is found."""
    if frame.size is None:
        return frame
    import cv2

    bgr = cv2.cvtColor(frame.decode(), cv2.COLOR_RGB2BGR)
    return Frame(frame.stamp_ns, "jpeg", from_bgr(bgr))


def from_bgr(pixels: np.ndarray) -> bytes:
    """Encode uint8 BGR, (H, W, 3), or grey, (H, W), as JPEG; LogError for what is too large."""
    import cv2

    # Of 100: a ball's edge stays sharp, at a fraction of the bare pixels' size.
    settings = [cv2.IMWRITE_JPEG_QUALITY, 95]
    settings += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    done, data = cv2.imencode(".jpg", pixels, settings)
    if not done:
        height, width = pixels.shape[:2]
        raise LogError(f"a picture of {width} x {height} px fits no JPEG; record a smaller one")
    return data.tobytes()


# ---- Types, topics and records of our logs

# Types that are written, as ROS 2 names them.
HEADER = "std_msgs/msg/Header"
POSE = "geometry_msgs/msg/PoseStamped"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
IMAGE = "sensor_msgs/msg/Image"
JOINT_STATE = "sensor_msgs/msg/JointState"
JOINT_ANGLES = "kinova_msgs/msg/JointAngles"
TASK_OUTCOME = "tunenet_msgs/msg/TaskOutcome"
COMPRESSED_VIDEO = "foxglove_msgs/msg/CompressedVideo"
RAW_AUDIO = "foxglove_msgs/msg/RawAudio"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
NUMBERS = "std_msgs/msg/Float64MultiArray"
TEXT = "std_msgs/msg/String"
# How Kinova defines JointAngles, JointTorque and JointVelocity.
SEVEN_JOINTS = "\n".join(f"float32 joint{number}" for number in range(1, 8))
# How we define TaskOutcome: what the hardware did in one attempt; [m], NaN where not known.
OUTCOME_FIELDS = """\
std_msgs/Header header
string task
string ball
uint32 attempt
bool success
float64 shot_height
float64 miss_distance
float64 tuned_parameter
string drop_log
string tuning
string reason
string note
"""
# How Foxglove defines CompressedVideo: one picture of a video as it was compressed.
VIDEO_FIELDS = """\
builtin_interfaces/Time timestamp
string frame_id
uint8[] data
string format
"""
# How Foxglove defines RawAudio: a block of samples, interleaved and little-endian.
AUDIO_FIELDS = """\
builtin_interfaces/Time timestamp
uint8[] data
string format
uint32 sample_rate
uint32 number_of_channels
"""
# Encodings of frames that are made from those before them; they go into CompressedVideo.
VIDEO_FORMATS = frozenset({"h264", "h265", "vp9", "av1"})
CAMERA_TOPIC = "/camera/image_raw/compressed"  # where a camera's frames go in our own logs
VIDEO_TOPIC = "/camera/video"  # where they go that the camera compressed as video
AUDIO_TOPIC = "/audio"  # where sound goes, and what that of a file goes by
OUTCOME_TOPIC = "/task/outcome"  # where what the hardware did goes
# The metadata record of a recovered log that says what was lost.
RECOVERY_RECORD = "tunenet/recovery"
# The metadata record of a log that holds its EpisodeInfo. What became known since is in others by
# the names "tunenet/episode/...", since viewers warn of records that share one.
INFO_RECORD = "tunenet/episode"
# The key of a channel's metadata that names the topic which it draws for viewers.
SHOWS = "shows"
# The types that no distribution of ROS defines.
_DEFINITIONS = {
    JOINT_ANGLES: SEVEN_JOINTS,
    TASK_OUTCOME: OUTCOME_FIELDS,
    COMPRESSED_VIDEO: VIDEO_FIELDS,
    RAW_AUDIO: AUDIO_FIELDS,
}


def is_info(record_name: str) -> bool:
    """Return whether a metadata record of that name holds EpisodeInfo, or a later part of it."""
    return record_name == INFO_RECORD or record_name.startswith(f"{INFO_RECORD}/")


@cache
def typestore() -> Typestore:
    """Return the store of message types that this project writes."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in _DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


@cache
def definition(type_name: str) -> str:
    """Return the `ros2msg` text of a type with all that it contains; ValueError if unknown."""
    if type_name not in typestore().fielddefs:
        raise ValueError(f"{type_name} is no message type that can be written")
    return typestore().generate_msgdef(type_name, ros_version=2)[0]


def _type(name: str) -> Any:
    return typestore().types[name]


def header(stamp_ns: int, frame_id: str) -> Any:
    """Build a std_msgs/Header; `stamp_ns` may lie before the epoch."""
    return _type(HEADER)(stamp=_time(stamp_ns), frame_id=frame_id)


def _time(stamp_ns: int) -> Any:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return _type("builtin_interfaces/msg/Time")(sec=seconds, nanosec=nanoseconds)


NOT_TURNED = (0.0, 0.0, 0.0, 1.0)  # the quaternion x, y, z, w of no rotation


def pose(stamp_ns: int, frame_id: str, position_m: ArrayLike, turn: ArrayLike = NOT_TURNED) -> Any:
    """Build a PoseStamped at `position_m`, shape (3,), with a quaternion x, y, z, w."""
    x, y, z = np.asarray(position_m, np.float64).tolist()
    placed = _type("geometry_msgs/msg/Pose")(
        position=_type("geometry_msgs/msg/Point")(x=x, y=y, z=z), orientation=_quaternion(turn)
    )
    return _type(POSE)(header=header(stamp_ns, frame_id), pose=placed)


def _quaternion(turn: ArrayLike) -> Any:
    x, y, z, w = np.asarray(turn, np.float64).tolist()
    return _type("geometry_msgs/msg/Quaternion")(x=x, y=y, z=z, w=w)


def transform(
    stamp_ns: int, parent: str, child: str, origin_m: ArrayLike, turn: ArrayLike = NOT_TURNED
) -> Any:
    """Build a TransformStamped of the frame `child` in `parent`; see `pose`."""
    x, y, z = np.asarray(origin_m, np.float64).tolist()
    return _type("geometry_msgs/msg/TransformStamped")(
        header=header(stamp_ns, parent),
        child_frame_id=child,
        transform=_type("geometry_msgs/msg/Transform")(
            translation=_type("geometry_msgs/msg/Vector3")(x=x, y=y, z=z),
            rotation=_quaternion(turn),
        ),
    )


def transforms(each: Sequence[Any]) -> Any:
    """Build a TFMessage of several `transform`s."""
    return _type(TRANSFORMS)(transforms=list(each))


def point_cloud(
    stamp_ns: int, frame_id: str, points_m: ArrayLike, rgb: tuple[int, int, int]
) -> Any:
    """Build a PointCloud2 of points of one colour, shape (N, 3) [m]."""
    places = np.asarray(points_m, "<f4")
    red, green, blue = rgb
    rows = np.zeros(len(places), [("xyz", "<f4", 3), ("rgb", "<u4")])
    rows["xyz"], rows["rgb"] = places, (red << 16) | (green << 8) | blue
    field = _type("sensor_msgs/msg/PointField")
    fields = [field(name=name, offset=4 * at, datatype=7, count=1) for at, name in enumerate("xyz")]
    return _type(POINT_CLOUD)(
        header=header(stamp_ns, frame_id),
        height=1,
        width=len(rows),
        fields=[*fields, field(name="rgb", offset=12, datatype=7, count=1)],
        is_bigendian=False,
        point_step=rows.itemsize,
        row_step=rows.nbytes,
        data=np.frombuffer(rows.tobytes(), np.uint8),
        is_dense=True,
    )


def numbers(values: ArrayLike) -> Any:
    """Build a Float64MultiArray, shape (N,)."""
    layout = _type("std_msgs/msg/MultiArrayLayout")(dim=[], data_offset=0)
    return _type(NUMBERS)(layout=layout, data=np.asarray(values, np.float64))


def text(words: str) -> Any:
    """Build a std_msgs/String."""
    return _type(TEXT)(data=words)


def raw_audio(stamp_ns: int, pcm: NDArray[np.int16], rate_hz: int) -> Any:
    """Build a RawAudio of `pcm`, shape (N, channels), with its first sample at `stamp_ns`."""
    return _type(RAW_AUDIO)(
        timestamp=_time(stamp_ns),
        data=np.frombuffer(pcm.astype("<i2").tobytes(), np.uint8),
        format="pcm-s16",
        sample_rate=rate_hz,
        number_of_channels=pcm.shape[1],
    )


def joint_state(
    stamp_ns: int,
    names: Sequence[str],
    position_rad: ArrayLike,
    velocity_rad_s: ArrayLike,
    effort_nm: ArrayLike,
) -> Any:
    """Build a JointState, each quantity of shape (joints,), or empty where it is unknown.

    [rad], [rad/s] and [N·m], or m, m/s and N of a prismatic joint.

    Raises:
        ValueError: a quantity is neither empty nor one number a joint.
    """
    columns: list[NDArray[np.float64]] = []
    for values in (position_rad, velocity_rad_s, effort_nm):
        column = np.asarray(values, np.float64)
        if column.shape not in ((len(names),), (0,)):
            raise ValueError(f"{len(names)} joints have values of shape {column.shape}")
        columns.append(column)
    position, velocity, effort = columns
    return _type(JOINT_STATE)(
        header=header(stamp_ns, ""),
        name=list(names),
        position=position,
        velocity=velocity,
        effort=effort,
    )


def frame(picture: Frame) -> tuple[str, bytes]:
    """Encode a picture as (type name, CDR): of a video, compressed by itself, or of bare pixels."""
    stamp_ns, encoding = picture.stamp_ns, picture.encoding
    data = picture.data if picture.pixels is None else picture.decode().tobytes()
    about: dict[str, Any] = {"header": header(stamp_ns, "camera"), "format": encoding}
    if encoding in VIDEO_FORMATS:
        name = COMPRESSED_VIDEO
        about = {"timestamp": _time(stamp_ns), "frame_id": "camera", "format": encoding}
    elif picture.size is None:
        name = COMPRESSED_IMAGE
    else:
        name, (width, height) = IMAGE, picture.size
        about = {"header": about["header"], "height": height, "width": width, "encoding": encoding}
        about |= {"is_bigendian": 0, "step": len(data) // height}
    return name, encode(_type(name)(data=np.frombuffer(data, np.uint8), **about), name)


def encode(message: Any, type_name: str) -> bytes:
    """Serialise to little-endian CDR."""
    return bytes(typestore().serialize_cdr(message, type_name, little_endian=True))
