"""A small whole file of each kind that is read beside logs of messages, to be damaged."""

from __future__ import annotations

import bz2
import gzip
import json
import shutil
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import cv2
import lz4.frame
import numpy as np
import zstandard
from numpy.typing import NDArray
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import CompressionMode

from tests import export_writers, export_writers_video, library_writers, strangers
from tests import message_logs as logs
from tests.clips import clicks, write_clip
from tests.export_writers_video import FilmedTrack, phyphox_xlsx, write_xlsx
from tests.message_logs import Schema, in_steps, write_json, write_raw

SECONDS = np.arange(24) / 60
BALL = np.column_stack([0 * SECONDS, 0.1 * SECONDS, 1 - 4.9 * SECONDS**2])
ARRAYS: dict[str, Any] = {"t": SECONDS, "ball": BALL, "q": np.ones((24, 3))}
ROWS: list[tuple[float, list[float]]] = list(zip(SECONDS.tolist(), BALL.tolist(), strict=True))


def _captured(layout: str, path: Path) -> None:
    export_writers.WRITERS[layout](path, SECONDS, {"ball": BALL, "hand": BALL + 1}, rate_hz=60)


def _filmed(writer: Callable[[Path, FilmedTrack], None], path: Path) -> None:
    writer(path, FilmedTrack(SECONDS, {"A": BALL, "B": BALL + 1}, rate_hz=60))


def _book(path: Path) -> None:
    rows: list[list[Any]] = [["t (s)", "x", "z"], *([t, x, z] for t, (x, _, z) in ROWS)]
    write_xlsx(path, {"A": rows, "Words": [["dropped"]]})


def _zip(path: Path, files: Iterable[tuple[str, str | bytes]]) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files:
            archive.writestr(name, data)


PHYPHOX = (
    ("All.csv", '"Event time (s)","Interval (s)"\n0,0.9\n0.9,0.7\n1.6,0.5\n2.1,0\n'),
    ("meta/device.csv", '"property","value"\n"version","1.1"\n'),
)


def _joints(path: Path, time: str, parts: Sequence[str], mark: str) -> None:
    """Names of a robot's columns, `{n}` being the joint."""
    count = 6 if "actual_q_{n}" in parts else 7
    names = [part.format(n=n) for part in parts for n in range(count)]
    rows = [[f"{t:.3f}", *(f"{t + n:.4f}" for n in range(3 * count))] for t in SECONDS]
    path.write_text("\n".join(mark.join(row) for row in [[time, *names], *rows]) + "\n")


def _table(path: Path) -> None:
    rows = [f"{t:.4f},{x:.5f},{y:.5f},{z:.5f}" for t, (x, y, z) in ROWS]
    path.write_text("\n".join(["t,x,y,z", *rows]) + "\n")


def _packed(pack: Callable[[bytes], bytes], write: Callable[[Path], object], path: Path) -> None:
    inner = path.with_suffix("")
    write(inner)
    path.write_bytes(pack(inner.read_bytes()))
    inner.unlink()


def spot(number: int) -> NDArray[np.uint8]:
    """A small picture with a spot that moves."""
    pixels = np.full((32, 32, 3), 40, np.uint8)
    cv2.circle(pixels, (16, 4 + number % 24), 3, (240, 240, 240), -1)
    return pixels


def _pictures(suffix: str, path: Path) -> None:
    _zip(path, ((f"{n}{suffix}", cv2.imencode(suffix, spot(n))[1].tobytes()) for n in range(8)))


def _film(codec: str, path: Path) -> None:
    import av

    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=30)
        stream.width, stream.height, stream.pix_fmt = 32, 32, "yuv420p"
        for number in range(8):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(spot(number), format="bgr24")))
        container.mux(stream.encode(None))


def _webp(path: Path) -> None:
    animation: Any = cv2.Animation()
    animation.frames = [spot(number) for number in range(8)]
    animation.durations = np.full(8, 20, np.int32)
    cv2.imwriteanimation(str(path), animation)


def _unknown_type(path: Path) -> None:
    messages = [{"when": t, "at": dict(zip("xyz", xyz, strict=True))} for t, xyz in ROWS]
    write_json(path, in_steps("/thing", "lab.Seen", messages))


def _defined_type(path: Path) -> None:
    text = b"float64 t\nlab/Point at\n" + b"=" * 80 + b"\nMSG: lab/Point\nfloat64 x\nfloat64 z\n"
    write_raw(path, [("/thing", Schema("lab/msg/Seen", text=text), 1, b"\0\1\0\0" + bytes(24))])


def _clip(codec: str, path: Path, film: str = "") -> None:
    write_clip(path, clicks([0.1], 0.2), codec, film=film, pictures=5)


POSES = [("/a", logs.POSE, n * 10**7, logs.pose(n * 10**7, xyz)) for n, (_, xyz) in enumerate(ROWS)]
PLANS = [("/a", logs.TRAJECTORY, n, logs.trajectory(0, "ab", logs.point(n, xyz[:2], xyz[1:])))
         for n, (_, xyz) in enumerate(ROWS)]  # fmt: skip
PICTURES = [
    one for n in range(8) for one in (
        ("/raw", "sensor_msgs/msg/Image", n,
         {"width": 32, "height": 32, "encoding": "rgb8", "step": 96, "data": spot(n).tobytes()}),
        ("/jpeg", "sensor_msgs/msg/CompressedImage", n,
         {"format": "jpeg", "data": cv2.imencode(".jpg", spot(n))[1].tobytes()}))
]  # fmt: skip
STATES = [("/a", logs.JOINT_STATE, n, {"name": ["a", "b"], "position": xyz[1:], "effort": xyz[:2]})
          for n, (_, xyz) in enumerate(ROWS)]  # fmt: skip


def _foxglove(path: Path) -> None:
    strangers.write_protobuf(path.with_name("chunks"), 10**9 + np.arange(24) * 10**7, BALL)
    strangers.without_chunks(path.with_name("chunks"), path)
    path.with_name("chunks").unlink()


def _db3(path: Path, mode: CompressionMode = CompressionMode.NONE) -> None:
    folder = path.with_name("folder")
    logs.write_folder(folder, POSES, mode=mode)
    next(folder.glob("*.db3")).rename(path)
    shutil.rmtree(folder)


ZSTD = zstandard.ZstdCompressor().compress
UR = ("actual_q_{n}", "actual_qd_{n}", "actual_current_{n}")
FRANKA = ("q[{n}]", "dq[{n}]", "tau_J[{n}]")
# By the name of the file: what writes it.
KINDS: dict[str, Callable[[Path], object]] = {
    **{f"{name}{suffix}": partial(_captured, name)
       for name, suffix in export_writers.SUFFIXES.items()},
    **{name: partial(_filmed, writer) for name, writer in export_writers_video.WRITERS.items()},
    "phyphox.xlsx": lambda path: phyphox_xlsx(path, [0.0, 0.9, 1.6, 2.1]),
    "phyphox.zip": lambda path: _zip(path, PHYPHOX),
    "book.xlsx": _book,
    "ur.csv": lambda path: _joints(path, "timestamp", UR, " "),
    "franka.csv": lambda path: _joints(path, "time", FRANKA, ","),
    "plain.csv": _table,
    "a.parquet": lambda path: library_writers.ARRAYS["a.parquet"](
        path, {"timestamp": SECONDS, "x": BALL[:, 0], "z": BALL[:, 2]}),
    "a.npy": lambda path: np.save(path, np.column_stack([SECONDS, BALL])),
    "a.npz": lambda path: np.savez_compressed(path, **ARRAYS),
    "level4.mat": lambda path: library_writers.ARRAYS["c.mat"](path, ARRAYS),
    "level5.mat": lambda path: library_writers.ARRAYS["a.mat"](path, {"run": ARRAYS}),
    "packed.mat": lambda path: library_writers.ARRAYS["b.mat"](path, {"run": ARRAYS}),
    "a.jsonl": lambda path: path.write_text(
        "".join(json.dumps({"t": t, "ball": xyz}) + "\n" for t, xyz in ROWS)),
    "servo.json": lambda path: path.write_text(json.dumps({"kp": 400, "entries": [
        {"timestamp": t, "position": xyz[2], "goal_position": xyz[0], "torque_enable": True}
        for t, xyz in ROWS]})),
    "motions.json": lambda path: path.write_text(json.dumps({"action_hz": 50, "data": [
        {"type": "a", "action": [xyz[0] for _, xyz in ROWS], "q": [xyz[2] for _, xyz in ROWS]}]})),
    "state_motor.csv": lambda path: path.write_text("type,timestamp,positions,torques\n" + "".join(
        f'STATE_MOTOR,{t * 1e6},"{list(xyz)}","{list(xyz)}"\n' for t, xyz in ROWS)),
    "ticks.csv": lambda path: path.write_text("t_ms,present_position_1,goal_position_1,on\n"
        + "".join(f"{at * 20},{2000 + at * 7 % 900},{2000 + at * 7},1\n" for at in range(200))),
    "plain.h5": library_writers.plain_hdf5,
    "demos.hdf5": library_writers.robomimic,
    "a.feather": library_writers.feather,
    "a.arrows": library_writers.arrow_stream,
    "a.rrd": library_writers.rerun_points,
    "a.ulg": library_writers.ulog,
    **{f"{one}s.zip": partial(_pictures, f".{one}") for one in ("png", "jpg", "webp")},
    "tiffs.zip": partial(_pictures, ".tiff"),
    "bmps.zip": partial(_pictures, ".bmp"),
    "a.y4m": partial(_film, "rawvideo"),
    "a.h264": partial(_film, "h264"),
    "a.webp": _webp,
    "plain.csv.zst": partial(_packed, ZSTD, _table),
    "plain.csv.gz": partial(_packed, gzip.compress, _table),
    "plain.csv.bz2": partial(_packed, bz2.compress, _table),
    "plain.csv.lz4": partial(_packed, lz4.frame.compress, _table),
    "unknown.mcap.zst": partial(_packed, ZSTD, _unknown_type),
    # Messages outside chunks, whose damage no checksum keeps from what decodes them.
    "cdr.mcap": lambda path: logs.write_cdr(path, [*POSES, *PLANS, *STATES], chunk_bytes=0),
    "json.mcap": lambda path: logs.write_json(path, [*POSES, *PLANS, *STATES], chunk_bytes=0),
    "protobuf.mcap": _foxglove,
    "pictures.mcap": lambda path: logs.write_cdr(path, PICTURES, chunk_bytes=0),
    "plain.bag": lambda path: logs.write_bag(path, [*POSES, *STATES]),
    **{f"{one.name}.bag": partial(logs.write_bag, sent=POSES, compression=one)
       for one in BagWriter.CompressionFormat},
    "a.db3": _db3,
    "messages.db3": partial(_db3, mode=CompressionMode.MESSAGE),
    **{f"a.{name}": partial(_clip, codec) for name, codec in (
        ("wav", "pcm_s16le"), ("flac", "flac"), ("m4a", "aac"), ("ogg", "libopus"),
        ("mp3", "libmp3lame"))},
    "float.wav": partial(_clip, "pcm_f32le"),
    "a.mp4": partial(_clip, "aac", film="libx264"),
    "unknown.mcap": _unknown_type,
    "defined.mcap": _defined_type,
}  # fmt: skip
# Kinds that are read in a process of their own.
SLOW = (
    "track.xlsx", "phyphox.xlsx", "phyphox.zip", "book.xlsx", "a.parquet", "track.parquet",
    "track.mat", "level4.mat", "level5.mat", "packed.mat", "plain.h5", "demos.hdf5", "a.feather",
    "a.arrows", "a.rrd", "a.ulg",
)  # fmt: skip


@cache
def small(kind: str) -> bytes:
    """The bytes of a small file of a kind."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / kind
        KINDS[kind](path)
        return path.read_bytes()
