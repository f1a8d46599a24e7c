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
from rosbags.rosbag2 import StoragePlugin

from tests.message_logs import Sent, header, write_bag, write_cdr, write_folder

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
RAW, VIDEO = "foxglove_msgs/msg/RawImage", "foxglove_msgs/msg/CompressedVideo"
_FRAME = "builtin_interfaces/Time timestamp\nstring frame_id\n"
_OF_FOXGLOVE = {
    VIDEO: f"{_FRAME}uint8[] data\nstring format\n",
    RAW: f"{_FRAME}uint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data\n",
}

# Stamp [ns], type, and the fields of a message beside its header.
Fields = tuple[int, str, dict[str, Any]]


def _sent(messages: Iterable[Fields], topic: str) -> Iterator[Sent]:
    """Heard 5 ms after the stamps of the messages."""
    for stamp_ns, kind, fields in messages:
        taken = header(stamp_ns, "lens")
        said = {"header": taken, "timestamp": taken["stamp"], "frame_id": "lens"}
        yield topic, kind, stamp_ns + 5_000_000, {**said, **fields}


def write_pictures(path: Path, messages: Iterable[Fields], topic: str = "/eye") -> Path:
    """A log of one topic; times of the log are 5 ms later than the stamps of its messages."""
    return write_cdr(path, _sent(messages, topic), _OF_FOXGLOVE, start_ns=0)


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
    return stamp_ns, COMPRESSED, {"format": said, "data": data}


def video(stamp_ns: int, said: str, data: bytes) -> Fields:
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
    "rgba8": lambda rgb: _rgba(rgb).tobytes(),
    **dict.fromkeys(("bgr8", "8UC3"), lambda rgb: rgb[..., ::-1].tobytes()),
    **dict.fromkeys(("bgra8", "8UC4"), lambda rgb: _rgba(rgb)[..., [2, 1, 0, 3]].tobytes()),
    **dict.fromkeys(("mono8", "8UC1"), _grey),
    **dict.fromkeys(("mono16", "16UC1"), lambda rgb: _grey(rgb, 256)),
    **{
        name: lambda rgb, kind=kind: cv2.cvtColor(rgb, kind).tobytes()
        for kind, names in (
            (cv2.COLOR_RGB2YUV_UYVY, ("yuv422", "uyvy")),
            (cv2.COLOR_RGB2YUV_YUY2, ("yuv422_yuy2", "yuyv")),
        )
        for name in names
    },
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
    messages = (compressed(stamp_ns, "jpeg", jpeg(pixels)) for stamp_ns, pixels in pictures)
    return write_bag(path, _sent(messages, topic), start_ns=0)


def write_pictures_folder(
    path: Path, messages: Iterable[Fields], storage: StoragePlugin, topic: str = "/eye"
) -> Path:
    """A ROS 2 bag's folder; times of the log are 5 ms later than the stamps of its messages."""
    return write_folder(path, _sent(messages, topic), storage, start_ns=0)


def write_video_file(path: Path, pictures: Taken, codec: str, rate_hz: int, **options: str) -> Path:
    """A video file of H.264 or the like, its stamps those of the pictures to 1/90000 s."""
    clock = Fraction(1, rate_hz if path.suffix == ".avi" else 90_000)
    pixel_format = options.pop("pix_fmt", "yuv420p")
    if codec == "libx264":  # else its pictures are others at each run
        options["x264-params"] = "threads=1:no-asm=1"
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
