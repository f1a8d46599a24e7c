"""A small whole file of each kind that is read beside logs of messages, to be damaged."""

from __future__ import annotations

import bz2
import gzip
import json
import tempfile
import zipfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import cv2
import lz4.frame
import numpy as np
import zstandard
from numpy.typing import NDArray

from tests import export_writers, export_writers_video, library_writers
from tests.export_writers_video import FilmedTrack, phyphox_xlsx, write_xlsx

SECONDS = np.arange(24) / 60
BALL = np.column_stack([0 * SECONDS, 0.1 * SECONDS, 1 - 4.9 * SECONDS**2])


def _captured(layout: str, path: Path) -> None:
    export_writers.WRITERS[layout](path, SECONDS, {"ball": BALL, "hand": BALL + 1}, rate_hz=60)


def _filmed(writer: Callable[[Path, FilmedTrack], None], path: Path) -> None:
    writer(path, FilmedTrack(SECONDS, {"A": BALL, "B": BALL + 1}, rate_hz=60))


def _arrays() -> dict[str, np.ndarray]:
    return {"t": SECONDS, "ball": BALL, "q": np.ones((24, 3))}


def _npy(path: Path) -> None:
    np.save(path, np.column_stack([SECONDS, BALL]))


def _npz(path: Path) -> None:
    np.savez_compressed(path, **_arrays())  # type: ignore[arg-type]


def _mat(path: Path, *, form: str = "5", packed: bool = False) -> None:
    import scipy.io

    scipy.io.savemat(path, {"run": {**_arrays()}} if form == "5" else _arrays(),
                     format=form, do_compression=packed)  # fmt: skip


def _json_lines(path: Path) -> None:
    rows = zip(SECONDS.tolist(), BALL.tolist(), strict=True)
    path.write_text("".join(json.dumps({"t": t, "ball": xyz}) + "\n" for t, xyz in rows))


def _parquet(path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {"timestamp": SECONDS, "x": BALL[:, 0], "z": BALL[:, 2]}
    pq.write_table(pa.table({name: pa.array(one) for name, one in columns.items()}), path)


def _book(path: Path) -> None:
    rows: list[list[object]] = [["t (s)", "x", "z"]]
    for t, (x, _, z) in zip(SECONDS, BALL, strict=True):
        rows.append([float(t), float(x), float(z)])
    write_xlsx(path, {"A": rows, "Words": [["dropped"]]})


def _phyphox_zip(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(
            "All.csv", '"Event time (s)","Interval (s)"\n0,0.9\n0.9,0.7\n1.6,0.5\n2.1,0\n'
        )
        archive.writestr("meta/device.csv", '"property","value"\n"version","1.1"\n')


def _robot(path: Path) -> None:
    names = [
        f"{part}_{n}" for part in ("actual_q", "actual_qd", "actual_current") for n in range(6)
    ]
    rows = [[f"{t:.3f}", *(f"{t + n:.4f}" for n in range(18))] for t in SECONDS]
    path.write_text("\n".join(" ".join(row) for row in [["timestamp", *names], *rows]) + "\n")


def _franka(path: Path) -> None:
    names = [f"{part}[{n}]" for part in ("q", "dq", "tau_J") for n in range(7)]
    rows = [[f"{t:.3f}", *(f"{t + n:.4f}" for n in range(21))] for t in SECONDS]
    path.write_text("\n".join(",".join(row) for row in [["time", *names], *rows]) + "\n")


def _table(path: Path) -> None:
    rows = [f"{t:.4f},{x:.5f},{y:.5f},{z:.5f}" for t, (x, y, z) in zip(SECONDS, BALL, strict=True)]
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


def picture(number: int, suffix: str) -> bytes:
    """The same as a file."""
    return cv2.imencode(suffix, spot(number))[1].tobytes()


def _pictures(suffix: str, path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(8):
            archive.writestr(f"{number}{suffix}", picture(number, suffix))


def _film(codec: str, path: Path) -> None:
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30)
        stream.width = stream.height = 32  # type: ignore[attr-defined]
        stream.pix_fmt = "yuv420p"  # type: ignore[attr-defined]
        for number in range(8):
            frame = av.VideoFrame.from_ndarray(spot(number), format="bgr24")
            container.mux(stream.encode(frame))  # type: ignore[attr-defined]
        container.mux(stream.encode(None))  # type: ignore[attr-defined]


def _webp(path: Path) -> None:
    animation = cv2.Animation()
    animation.frames = [spot(number) for number in range(8)]
    animation.durations = np.full(8, 20, np.int32)  # type: ignore[assignment]
    cv2.imwriteanimation(str(path), animation)


def _unknown_type(path: Path) -> None:
    from tests.tunenet_logs.any_message_logs import write_json

    messages = [{"when": t, "at": {"x": x, "y": y, "z": z}}
                for t, (x, y, z) in zip(SECONDS.tolist(), BALL.tolist(), strict=True)]  # fmt: skip
    write_json(path, "/thing", "lab.Seen", messages)


def _defined_type(path: Path) -> None:
    from tests.tunenet_logs.any_message_logs import write_raw

    text = b"float64 t\nlab/Point at\n" + b"=" * 80 + b"\nMSG: lab/Point\nfloat64 x\nfloat64 z\n"
    write_raw(path, "/thing", "lab/msg/Seen", text, b"\0\1\0\0" + bytes(24))


_track = FilmedTrack(SECONDS, {"A": BALL}, rate_hz=60)

# By the name of the file: what writes it.
KINDS: dict[str, Callable[[Path], object]] = {
    **{f"{name}{suffix}": partial(_captured, name)
       for name, suffix in export_writers.SUFFIXES.items()},
    **{name: partial(_filmed, writer) for name, writer in export_writers_video.WRITERS.items()},
    "phyphox.xlsx": lambda path: phyphox_xlsx(path, [0.0, 0.9, 1.6, 2.1]),
    "phyphox.zip": _phyphox_zip,
    "book.xlsx": _book,
    "ur.csv": _robot,
    "franka.csv": _franka,
    "plain.csv": _table,
    "a.parquet": _parquet,
    "a.npy": _npy,
    "a.npz": _npz,
    "level4.mat": partial(_mat, form="4"),
    "level5.mat": _mat,
    "packed.mat": partial(_mat, packed=True),
    "a.jsonl": _json_lines,
    "plain.h5": library_writers.plain_hdf5,
    "demos.hdf5": library_writers.robomimic,
    "a.feather": library_writers.feather,
    "a.arrows": library_writers.arrow_stream,
    "a.rrd": library_writers.rerun_points,
    "a.ulg": library_writers.ulog,
    "pngs.zip": partial(_pictures, ".png"),
    "tiffs.zip": partial(_pictures, ".tiff"),
    "bmps.zip": partial(_pictures, ".bmp"),
    "a.y4m": partial(_film, "rawvideo"),
    "a.h264": partial(_film, "h264"),
    "a.webp": _webp,
    "plain.csv.zst": partial(_packed, zstandard.ZstdCompressor().compress, _table),
    "plain.csv.gz": partial(_packed, gzip.compress, _table),
    "plain.csv.bz2": partial(_packed, bz2.compress, _table),
    "plain.csv.lz4": partial(_packed, lz4.frame.compress, _table),
    "unknown.mcap.zst": partial(_packed, zstandard.ZstdCompressor().compress, _unknown_type),
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
