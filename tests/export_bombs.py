"""Exports that a stranger made to hurt: small or dense, and claiming much."""

from __future__ import annotations

import bz2
import gzip
import io
import json
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zstandard

from tests import film_bombs

_DENSE_BYTES = 275 * 1024**2

MOTIVE_HEAD = (
    "Format Version,1.23,Take Name,a,Capture Frame Rate,120.0,Export Frame Rate,120.0,"
    "Length Units,Meters,Coordinate Space,Global\n\n,Type,Marker,Marker,Marker\n"
    ',Name,M:1,M:1,M:1\n,ID,"1","1","1"\n,,Position,Position,Position\n'
    "Frame,Time (Seconds),X,Y,Z\n"
)
NEXUS_HEAD = "Trajectories\n100\n,,M,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n"
TRC_HEAD = (
    "PathFileType,4,(X/Y/Z),a.trc\nDataRate,CameraRate,NumFrames,NumMarkers,Units,OrigDataRate,"
    "OrigDataStartFrame,OrigNumFrames\n100,100,99,1,mm,100,1,99\nFrame#,Time,M,,\n,,X1,Y1,Z1\n\n"
)


def _dense(path: Path, head: str, row: str = "1,1,1\n", size: int = _DENSE_BYTES) -> Path:
    block = row.encode() * (2**20 // len(row))
    with path.open("wb") as file:
        file.write(head.encode())
        for _ in range(size // len(block)):
            file.write(block)
    return path


def dense_motive(folder: Path) -> Path:
    """A table of a body whose rows are short."""
    return _dense(folder / "bomb.csv", MOTIVE_HEAD)


def dense_nexus(folder: Path) -> Path:
    """Likewise, of Nexus."""
    return _dense(folder / "bomb.csv", NEXUS_HEAD)


def dense_trc(folder: Path) -> Path:
    """Likewise, as TRC."""
    return _dense(folder / "bomb.trc", TRC_HEAD)


def long_motive(folder: Path) -> Path:
    """As many rows as are read, all of them whole, in order."""
    path = folder / "bomb.csv"
    with path.open("w") as file:
        file.write(MOTIVE_HEAD)
        file.writelines(f"{n},{n / 120:.3f},1,1,1\n" for n in range(499_000))
    return path


def long_table(folder: Path) -> Path:
    """Likewise, a table of heights."""
    path = folder / "bomb.csv"
    with path.open("w") as file:
        file.write("t,x,z\n")
        file.writelines(f"{n},1,1\n" for n in range(499_000))
    return path


def full_motive(folder: Path) -> Path:
    """Likewise, of whole rows."""
    return _dense(folder / "bomb.csv", MOTIVE_HEAD, "1,1,1,1,1\n")


def dense_table(folder: Path) -> Path:
    """A table of times and heights of one digit each."""
    return _dense(folder / "bomb.csv", "t,x,z\n")


def dense_impacts(folder: Path) -> Path:
    """A column of times of impacts."""
    return _dense(folder / "bomb.csv", "impact_s\n", "1\n")


def dense_tracker(folder: Path) -> Path:
    """A mass of Tracker's."""
    return _dense(folder / "bomb.txt", ",mass A,,\nt,x,y,\n", "1,1,1,\n")


def dense_slices(folder: Path) -> Path:
    """Measurements of ImageJ."""
    return _dense(folder / "bomb.csv", " \tX\tY\tSlice\n", "1\t1\t1\t1\n")


def dense_json(folder: Path) -> Path:
    """Records of one digit in nearly as many bytes as are read."""
    return _dense(folder / "bomb.jsonl", "", '{"t":1,"z":1}\n', 250 * 1024**2)


def dense_json_array(folder: Path) -> Path:
    """Empty lists in one array."""
    return _dense(folder / "bomb.json", "[", "[],", 250 * 1024**2)


def dense_json_object(folder: Path) -> Path:
    """One object with one long list."""
    return _dense(folder / "bomb.json", '{"t":[0', ",1", 250 * 1024**2)


def many_columns(folder: Path) -> Path:
    """100,000 columns."""
    names = ",".join(f"x{n}" for n in range(100_000))
    row = ",".join(["1"] * 100_000)
    return _dense(folder / "bomb.csv", f"t,{names}\n", f"1,{row}\n", 20 * 2**20)


def many_tracks(folder: Path) -> Path:
    """20,000 tracks side by side."""
    head = "\t".join(["Frame", *(f"{k}{n}" for n in range(20_000) for k in ("X", "Y", "Flag"))])
    row = "\t".join(["1", *(["5", "5", " "] * 20_000)])
    return _dense(folder / "bomb.txt", f"{head}\nTracks 1 to 20000\n", f"{row}\n", 20 * 2**20)


def many_motive_bodies(folder: Path) -> Path:
    """60,000 columns of a Motive export."""
    count = 20_000
    head = MOTIVE_HEAD.replace("Marker,Marker,Marker", ",".join(["Marker"] * 3 * count))
    head = head.replace("M:1,M:1,M:1", ",".join(f"M:{n}" for n in range(count) for _ in "XYZ"))
    head = head.replace("Position,Position,Position", ",".join(["Position"] * 3 * count))
    head = head.replace("X,Y,Z\n", ",".join("XYZ" * count) + "\n")
    return _dense(folder / "bomb.csv", head, ",".join(["1"] * 3 * count) + "\n", 20 * 2**20)


def nested_json(folder: Path) -> Path:
    """A million brackets."""
    path = folder / "bomb.json"
    path.write_text('{"a":' * 1_000_000)
    return path


def nested_xml(folder: Path) -> Path:
    """A million elements, one in the other."""
    path = folder / "bomb.xml"
    path.write_text('<?xml version="1.0"?><Tracks nTracks="1">' + "<particle>" * 1_000_000)
    return path


def entities_xml(folder: Path) -> Path:
    """Entities of entities."""
    path = folder / "bomb.xml"
    inner = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10}">' for n in range(1, 12))
    path.write_text(
        f'<?xml version="1.0"?><!DOCTYPE Tracks [<!ENTITY e0 "aaaaaaaaaa">{inner}]>'
        '<Tracks nTracks="1" spaceUnits="&e11;"></Tracks>'
    )
    return path


def dense_xml(folder: Path) -> Path:
    """Places without an end."""
    head = '<Tracks nTracks="1" spaceUnits="pixel" frameInterval="1.0"><particle nSpots="1">'
    return _dense(folder / "bomb.xml", head, '<detection t="1" x="1" y="1" z="1"/>')


def forged_c3d(folder: Path) -> Path:
    """A header of 65,535 points and frames in one block of data."""
    path = folder / "bomb.c3d"
    head = struct.pack("<BBHHHHHfHHf", 2, 0x50, 0xFFFF, 0xFFFF, 1, 0xFFFF, 0, -1.0, 3, 0, 1e9)
    path.write_bytes(head.ljust(512, b"\0") + bytes([1, 80, 255, 84]) + bytes(508) + bytes(512))
    return path


def forged_npz(folder: Path) -> Path:
    """An array that claims 2^40 numbers."""
    stream = io.BytesIO()
    claim = {"descr": "<f8", "fortran_order": False, "shape": (2**40, 3)}
    np.lib.format.write_array_header_1_0(stream, claim)
    path = folder / "bomb.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("ball.npy", stream.getvalue() + bytes(240))
    return path


def zeros_npz(folder: Path) -> Path:
    """A gigabyte of zeros, packed."""
    stream = io.BytesIO()
    shape = (2**25, 4)
    np.lib.format.write_array_header_1_0(
        stream, {"descr": "<f8", "fortran_order": False, "shape": shape}
    )
    path = folder / "bomb.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("ball.npy", "w", force_zip64=True) as file,
    ):
        file.write(stream.getvalue())
        for _ in range(64):
            file.write(bytes(16 * 2**20))
    return path


def zeros_mat(folder: Path) -> Path:
    """Elements of a gigabyte of zeros, packed."""
    import zlib

    packer = zlib.compressobj()
    body = struct.pack("<II", 14, 2**30) + struct.pack("<IIII", 6, 8, 6, 0)
    body += struct.pack("<IIii", 5, 8, 2**27, 1) + struct.pack("<HH4s", 1, 1, b"t\0\0\0")
    body += struct.pack("<II", 9, 2**30 - 64)
    packed = [packer.compress(body), *(packer.compress(bytes(2**24)) for _ in range(64))]
    data = b"".join([*packed, packer.flush()])
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H2s", 0x0100, b"IM")
    path = folder / "bomb.mat"
    path.write_bytes(head + struct.pack("<II", 15, len(data)) + data)
    return path


def forged_mat(folder: Path) -> Path:
    """A matrix that claims 2^31 rows."""
    body = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, 2**31 - 1, 3)
    body += struct.pack("<HH4s", 1, 1, b"t\0\0\0") + struct.pack("<II", 9, 2**32 - 8) + bytes(64)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H2s", 0x0100, b"IM")
    path = folder / "bomb.mat"
    path.write_bytes(head + struct.pack("<II", 14, 2**32 - 1) + body)
    return path


def forged_parquet(folder: Path) -> Path:
    """A footer of nearly 2 GiB."""
    path = folder / "bomb.parquet"
    path.write_bytes(b"PAR1" + bytes(1000) + struct.pack("<I", 2**31 - 1) + b"PAR1")
    return path


def zeros_parquet(folder: Path) -> Path:
    """Two million rows of 64 columns, all of them zero."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    zeros = pa.array(np.zeros(1_900_000))
    path = folder / "bomb.parquet"
    table = pa.table(
        {"t": pa.array(np.arange(1_900_000) / 1e3)} | {f"q_{n}": zeros for n in range(64)}
    )
    pq.write_table(table, path, compression="zstd")
    return path


def _packed(path: Path, pack: Callable[[bytes], bytes], count: int = 4096) -> Path:
    """A table of 1 MiB pieces, packed one behind the other."""
    piece = pack(b"1,1,1\n" * (2**20 // 6))
    path.write_bytes(pack(b"t,x,z\n") + piece * count)
    return path


def zstd_table(folder: Path) -> Path:
    """4 GiB of a table."""
    return _packed(folder / "bomb.csv.zst", zstandard.ZstdCompressor().compress)


def gzip_table(folder: Path) -> Path:
    """Likewise."""
    return _packed(folder / "bomb.csv.gz", gzip.compress)


def bz2_table(folder: Path) -> Path:
    """Likewise."""
    return _packed(folder / "bomb.csv.bz2", bz2.compress)


def lz4_table(folder: Path) -> Path:
    """Likewise."""
    import lz4.frame

    return _packed(folder / "bomb.csv.lz4", lz4.frame.compress)


def gzip_dense_motive(folder: Path) -> Path:
    """A dense table of Motive's, packed so that it may be unpacked."""
    plain = dense_motive(folder)
    path = folder / "bomb.csv.gz"
    path.write_bytes(gzip.compress(plain.read_bytes(), 1))
    plain.unlink()
    return path


def long_definition(folder: Path) -> Path:
    """A message type of 100,000 fields, within itself."""
    from tests.tunenet_logs.any_message_logs import write_raw

    text = "Loop[] me\n" + "".join(f"float64 f{n}\n" for n in range(100_000))
    text += "=" * 80 + "\nMSG: a/Loop\nLoop[] me\n"
    return write_raw(folder / "bomb.mcap", "/thing", "a/msg/Loop", text.encode(), bytes(64))


def deep_lists(folder: Path) -> Path:
    """Columns that are lists of lists."""
    path = folder / "bomb.json"
    path.write_text(json.dumps({f"x{n}": [[1] * 60] * 60 for n in range(2000)}))
    return path


BOMBS: tuple[Callable[[Path], Path], ...] = (
    dense_motive, dense_nexus, dense_trc, long_motive, long_table, full_motive, dense_table,
    dense_impacts, dense_tracker, dense_slices, dense_json, dense_json_array, dense_json_object,
    many_columns, many_tracks, many_motive_bodies, nested_json, nested_xml, entities_xml,
    dense_xml, forged_c3d, forged_npz, zeros_npz, zeros_mat, forged_mat, forged_parquet,
    zeros_parquet, zstd_table, gzip_table, bz2_table, lz4_table, gzip_dense_motive,
    long_definition, deep_lists, *film_bombs.BOMBS,
)  # fmt: skip
