"""Logs of pictures by others: written with mcap, rosbags and PyAV, with no code of the project."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
RAW, VIDEO = "foxglove_msgs/msg/RawImage", "foxglove_msgs/msg/CompressedVideo"
_FRAME = "builtin_interfaces/Time timestamp\nstring frame_id\n"
STORE.register(get_types_from_msg(f"{_FRAME}uint8[] data\nstring format\n", VIDEO))
STORE.register(
    get_types_from_msg(
        f"{_FRAME}uint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data\n", RAW
    )
)

# Stamp [ns], type, and the fields of a message beside its header.
Fields = tuple[int, str, dict[str, Any]]


def write_pictures(path: Path, messages: Iterable[Fields], topic: str = "/eye") -> Path:
    """A log of one topic; times of the log are 5 ms later than the stamps of its messages."""
    channels: dict[str, int] = {}
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.LZ4, chunk_size=1 << 20)
        writer.start(profile="ros2", library="somebody's camera")
        for stamp_ns, type_name, fields in messages:
            if type_name not in channels:
                text = STORE.generate_msgdef(type_name, ros_version=2)[0].encode()
                schema = writer.register_schema(type_name, "ros2msg", text)
                channels[type_name] = writer.register_channel(topic, "cdr", schema)
            data = bytes(STORE.serialize_cdr(_message(stamp_ns, type_name, fields), type_name))
            writer.add_message(channels[type_name], stamp_ns + 5_000_000, data, stamp_ns)
        writer.finish()
    return path


def _message(stamp_ns: int, type_name: str, fields: dict[str, Any]) -> Any:
    types = STORE.types
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    ready = {**fields, "data": np.frombuffer(fields["data"], np.uint8)}
    if type_name in (RAW, VIDEO):
        return types[type_name](timestamp=stamp, frame_id="lens", **ready)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="lens")
    return types[type_name](header=header, **ready)


def image(
    stamp_ns: int,
    encoding: str,
    size: tuple[int, int],
    data: bytes,
    step: int | None = None,
    is_bigendian: int = 0,
) -> Fields:
    """A sensor_msgs/Image; without a step, rows lie side by side."""
    width, height = size
    fields = {"width": width, "height": height, "encoding": encoding, "data": data}
    fields["step"] = len(data) // height if step is None else step
    return stamp_ns, IMAGE, {**fields, "is_bigendian": is_bigendian}


def compressed(stamp_ns: int, said: str, data: bytes) -> Fields:
    """A sensor_msgs/CompressedImage that says it is `said`."""
    return stamp_ns, COMPRESSED, {"format": said, "data": data}


def video(stamp_ns: int, said: str, data: bytes) -> Fields:
    """A foxglove.CompressedVideo that says it is `said`."""
    return stamp_ns, VIDEO, {"format": said, "data": data}


_ENCODERS: dict[str, tuple[str, dict[str, str]]] = {
    "h264": (
        "libx264",
        {"crf": "8", "preset": "veryfast", "x264-params": "scenecut=0:log-level=none"},
    ),
    "h265": ("libx265", {"crf": "8", "preset": "ultrafast", "x265-params": "log-level=none"}),
    "vp9": ("libvpx-vp9", {"crf": "8", "b": "0", "cpu-used": "8", "lag-in-frames": "0"}),
    "av1": ("libsvtav1", {"crf": "12", "preset": "12", "svtav1-params": "pred-struct=1"}),
}


def packets(
    pictures: Iterable[np.ndarray], codec: str, keyframe_every: int = 30, b_frames: int = 0
) -> Iterator[tuple[int, bytes]]:
    """(number of the picture, packet) in the order in which an encoder sends them."""
    name, options = _ENCODERS[codec]
    encoder: Any = None
    for number, pixels in enumerate(pictures):
        if encoder is None:
            encoder = av.CodecContext.create(name, "w")
            encoder.height, encoder.width = pixels.shape[:2]
            encoder.pix_fmt, encoder.time_base = "yuv420p", Fraction(1, 60)
            encoder.framerate, encoder.gop_size = Fraction(60), keyframe_every
            encoder.options = options
            if b_frames or codec.startswith("h26"):
                encoder.max_b_frames = b_frames
        frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
        frame.pts = number
        yield from _encoded(encoder, frame)
    yield from _encoded(encoder, None)


def _encoded(encoder: Any, frame: av.VideoFrame | None) -> list[tuple[int, bytes]]:
    """What the encoder gives for a picture; None for the rest.

    SVT-AV1, run by root, makes its caller a real-time thread for good, and whatever else the
    machine runs then waits for the tests that follow.
    """
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        return [(packet.pts, bytes(packet)) for packet in encoder.encode(frame)]
    finally:
        os.sched_setscheduler(0, policy, parameter)


def png(pixels: np.ndarray) -> bytes:
    """A PNG of RGB (H, W, 3), or of grey (H, W) of any depth."""
    return cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels)[1].tobytes()


def _uyvy(rgb: np.ndarray) -> bytes:
    return cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_UYVY).tobytes()


def _yuy2(rgb: np.ndarray) -> bytes:
    return cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_YUY2).tobytes()


def _nv(rgb: np.ndarray, first: int) -> bytes:
    """Brightness, then the two colours in turn, from the planar form that OpenCV makes."""
    height, width = rgb.shape[:2]
    flat = cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV_I420).ravel()
    planes = flat[width * height :].reshape(2, -1)
    return flat[: width * height].tobytes() + planes[[first, 1 - first]].T.tobytes()


def _bayer(rgb: np.ndarray, pattern: str, scale: int = 1) -> bytes:
    """What a sensor sees under a filter whose colours are named row by row."""
    dtype = np.uint8 if scale == 1 else np.dtype("<u2")
    seen = np.empty(rgb.shape[:2], dtype)
    for at, colour in enumerate(pattern):
        row, column = divmod(at, 2)
        seen[row::2, column::2] = rgb[row::2, column::2, "rgb".index(colour)].astype(dtype) * scale
    return seen.tobytes()


def _grey(rgb: np.ndarray, scale: int = 1) -> bytes:
    grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    return grey.tobytes() if scale == 1 else (grey.astype("<u2") * scale).tobytes()


def _rgba(rgb: np.ndarray) -> np.ndarray:
    return np.dstack([rgb, np.full(rgb.shape[:2], 77, np.uint8)])


# From RGB, shape (H, W, 3), to the bytes of an encoding of sensor_msgs/Image.
ENCODED: dict[str, Callable[[np.ndarray], bytes]] = {
    "rgb8": lambda rgb: rgb.tobytes(),
    "bgr8": lambda rgb: rgb[..., ::-1].tobytes(),
    "8UC3": lambda rgb: rgb[..., ::-1].tobytes(),
    "rgba8": lambda rgb: _rgba(rgb).tobytes(),
    "bgra8": lambda rgb: _rgba(rgb)[..., [2, 1, 0, 3]].tobytes(),
    "8UC4": lambda rgb: _rgba(rgb)[..., [2, 1, 0, 3]].tobytes(),
    "mono8": _grey,
    "8UC1": _grey,
    "mono16": lambda rgb: _grey(rgb, 256),
    "16UC1": lambda rgb: _grey(rgb, 256),
    "yuv422": _uyvy,
    "uyvy": _uyvy,
    "yuv422_yuy2": _yuy2,
    "yuyv": _yuy2,
    "nv12": lambda rgb: _nv(rgb, 0),
    "nv21": lambda rgb: _nv(rgb, 1),
    **{
        f"bayer_{one}{bits}": lambda rgb, one=one, scale=scale: _bayer(rgb, one, scale)
        for one in ("rggb", "bggr", "gbrg", "grbg")
        for bits, scale in ((8, 1), (16, 256))
    },
}


Taken = Iterable[tuple[int, np.ndarray]]  # stamps [ns], and pictures: RGB, shape (H, W, 3)


def write_jpegs_bag(path: Path, pictures: Taken, topic: str = "/eye") -> Path:
    """A ROS 1 bag of JPEGs as a camera's driver makes them, of quality 95."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with BagWriter(path) as writer:
        connection = writer.add_connection(topic, COMPRESSED, typestore=store)
        for count, (stamp_ns, pixels) in enumerate(pictures):
            time = store.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
            header = store.types["std_msgs/msg/Header"](seq=count, stamp=time, frame_id="lens")
            data = np.frombuffer(jpeg(pixels), np.uint8)
            message = store.types[COMPRESSED](header=header, format="jpeg", data=data)
            raw = bytes(store.serialize_ros1(message, COMPRESSED))
            writer.write(connection, stamp_ns + 5_000_000, raw)
    return path


def write_pictures_folder(
    path: Path, messages: Iterable[Fields], storage: StoragePlugin, topic: str = "/eye"
) -> Path:
    """A ROS 2 bag's folder; times of the log are 5 ms later than the stamps of its messages."""
    with FolderWriter(path, version=9, storage_plugin=storage) as writer:
        connection: Any = None
        for stamp_ns, type_name, fields in messages:
            if connection is None:
                connection = writer.add_connection(topic, type_name, typestore=STORE)
            data = bytes(STORE.serialize_cdr(_message(stamp_ns, type_name, fields), type_name))
            writer.write(connection, stamp_ns + 5_000_000, data)
    return path


def write_video_file(path: Path, pictures: Taken, codec: str, rate_hz: int, **options: str) -> Path:
    """A video file of H.264 or the like, its stamps those of the pictures to 1/90000 s."""
    clock = Fraction(1, rate_hz if path.suffix == ".avi" else 90_000)
    pixel_format = options.pop("pix_fmt", "yuv420p")
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=rate_hz, options=options)
        first_ns: int | None = None
        for stamp_ns, pixels in pictures:
            if first_ns is None:
                first_ns = stamp_ns
                stream.height, stream.width = pixels.shape[:2]
                stream.pix_fmt, stream.codec_context.time_base = pixel_format, clock
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            frame.pts = round(Fraction(stamp_ns - first_ns, 1_000_000_000) / clock)
            frame.time_base = clock
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def jpeg(pixels: np.ndarray) -> bytes:
    """A JPEG of RGB (H, W, 3), as OpenCV makes it: quality 95, half of the colours' resolution."""
    return cv2.imencode(".jpg", pixels[..., ::-1])[1].tobytes()
