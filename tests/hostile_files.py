"""Exports, archives, films and sounds that a stranger made to hurt: small or dense, claiming much.

`FILES` lists them by name, beside the logs in `tests.hostile`; `EVERY` lists all.
"""

from __future__ import annotations

import bz2
import gzip
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import av
import lz4.frame
import numpy as np
import zstandard

from tests.export_writers_video import write_xlsx
from tests.hostile import HOSTILE, Hostile, blank
from tests.message_logs import Schema, write_raw
from tunenet_logs import messages

# Tables.
_MIB = 2**20
_MOTIVE = (
    "Format Version,1.23,Take Name,a,Capture Frame Rate,120.0,Export Frame Rate,120.0,"
    "Length Units,Meters,Coordinate Space,Global\n\n,Type,Marker,Marker,Marker\n"
    ',Name,M:1,M:1,M:1\n,ID,"1","1","1"\n,,Position,Position,Position\n'
    "Frame,Time (Seconds),X,Y,Z\n"
)
_NEXUS = "Trajectories\n100\n,,M,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n"
_TRC = (
    "PathFileType,4,(X/Y/Z),a.trc\nDataRate,CameraRate,NumFrames,NumMarkers,Units,OrigDataRate,"
    "OrigDataStartFrame,OrigNumFrames\n100,100,99,1,mm,100,1,99\nFrame#,Time,M,,\n,,X1,Y1,Z1\n\n"
)
_TRACKS = '<Tracks nTracks="1" spaceUnits="pixel" frameInterval="1.0"><particle nSpots="1">'


def _dense(path: Path, head: str, row: str = "1,1,1\n", size: int = 275 * _MIB) -> None:
    block = row.encode() * (_MIB // len(row))
    with path.open("wb") as file:
        file.write(head.encode())
        for _ in range(size // len(block)):
            file.write(block)


def _long(path: Path, head: str, rows: Iterable[str]) -> None:
    """As many rows as are read, all of them whole, in order."""
    with path.open("w") as file:
        file.write(head)
        file.writelines(rows)


def _many_columns(path: Path) -> None:
    names = ",".join(f"x{n}" for n in range(100_000))
    _dense(path, f"t,{names}\n", "1" + ",1" * 100_000 + "\n", 20 * _MIB)


def _many_tracks(path: Path) -> None:
    head = "\t".join(["Frame", *(f"{k}{n}" for n in range(20_000) for k in ("X", "Y", "Flag"))])
    _dense(path, f"{head}\nTracks 1 to 20000\n", "1" + "\t5\t5\t " * 20_000 + "\n", 20 * _MIB)


def _many_bodies(path: Path) -> None:
    count = 20_000
    head = _MOTIVE.replace("Marker,Marker,Marker", ",".join(["Marker"] * 3 * count))
    head = head.replace("M:1,M:1,M:1", ",".join(f"M:{n}" for n in range(count) for _ in "XYZ"))
    head = head.replace("Position,Position,Position", ",".join(["Position"] * 3 * count))
    head = head.replace("X,Y,Z\n", ",".join("XYZ" * count) + "\n")
    _dense(path, head, ",".join(["1"] * 3 * count) + "\n", 20 * _MIB)


def _entities(path: Path) -> None:
    inner = "".join(f'<!ENTITY e{n} "{f"&e{n - 1};" * 10}">' for n in range(1, 12))
    path.write_text(
        f'<?xml version="1.0"?><!DOCTYPE Tracks [<!ENTITY e0 "aaaaaaaaaa">{inner}]>'
        '<Tracks nTracks="1" spaceUnits="&e11;"></Tracks>'
    )


# Arrays.


def npy_head(*shape: int) -> bytes:
    """What an array of doubles begins with."""
    stream = io.BytesIO()
    claim = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, claim)
    return stream.getvalue()


def _forged_c3d(_: Path) -> bytes:
    head = struct.pack("<BBHHHHHfHHf", 2, 0x50, 0xFFFF, 0xFFFF, 1, 0xFFFF, 0, -1.0, 3, 0, 1e9)
    return head.ljust(512, b"\0") + bytes([1, 80, 255, 84]) + bytes(508) + bytes(512)


def _npz(path: Path, head: bytes, mebibytes: int) -> None:
    packing = zipfile.ZIP_DEFLATED if mebibytes else zipfile.ZIP_STORED
    with (
        zipfile.ZipFile(path, "w", packing) as archive,
        archive.open("ball.npy", "w", force_zip64=True) as file,
    ):
        file.write(head if mebibytes else head + bytes(240))
        for _ in range(mebibytes // 16):
            file.write(bytes(16 * _MIB))


_MAT = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H2s", 0x0100, b"IM")


def _mat(rows: int, columns: int, size: int) -> bytes:
    """A matrix called t."""
    body = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, rows, columns)
    return body + struct.pack("<HH4s", 1, 1, b"t\0\0\0") + struct.pack("<II", 9, size)


def _zeros_mat(_: Path) -> bytes:
    packer = zlib.compressobj()
    body = struct.pack("<II", 14, 2**30) + _mat(2**27, 1, 2**30 - 64)
    packed = [packer.compress(body), *(packer.compress(bytes(2**24)) for _ in range(64))]
    data = b"".join([*packed, packer.flush()])
    return _MAT + struct.pack("<II", 15, len(data)) + data


def _zeros_parquet(path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    zeros = {f"q_{n}": pa.array(np.zeros(1_900_000)) for n in range(64)}
    pq.write_table(pa.table({"t": np.arange(1_900_000) / 1e3} | zeros), path, compression="zstd")


def _packed(pack: Callable[[bytes], bytes], _: Path) -> bytes:
    """4 GiB of a table in pieces of 1 MiB, packed one behind the other."""
    return pack(b"t,x,z\n") + pack(b"1,1,1\n" * (_MIB // 6)) * 4096


def _packed_motive(path: Path) -> None:
    plain = path.with_name("plain")
    _dense(plain, _MOTIVE)
    path.write_bytes(gzip.compress(plain.read_bytes(), 1))
    plain.unlink()


def _long_definition(path: Path) -> None:
    text = "Loop[] me\n" + "".join(f"float64 f{n}\n" for n in range(100_000))
    text += "=" * 80 + "\nMSG: a/Loop\nLoop[] me\n"
    write_raw(path, [("/thing", Schema("a/msg/Loop", text=text.encode()), 1, bytes(64))])


def _lists(_: Path) -> bytes:
    return json.dumps({f"x{n}": [[1] * 60] * 60 for n in range(2000)}).encode()


# Workbooks, archives and films.
_ROWS: list[list[object]] = [["t (s)", "x", "y"], [0.0, 1.0, 2.0], [0.1, 1.0, 2.0]]


def _macros(path: Path) -> None:
    """Beside them links to other files and machines."""
    write_xlsx(path, {"S": [["a", "b"], ["=cmd|' /C calc'!A0", "words"]]})
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("xl/vbaProject.bin", bytes(10_000))
        archive.writestr(
            "xl/externalLinks/_rels/externalLink1.xml.rels",
            '<Relationships><Relationship Id="rId1" Target="file:///etc/passwd" '
            'TargetMode="External"/></Relationships>',
        )


def _zeros_xlsx(path: Path) -> None:
    write_xlsx(path, {"S": _ROWS})
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        for number in range(8):
            archive.writestr(f"xl/worksheets/sheet{number + 2}.xml", b" " * 2**28)


_SHEET = "xl/worksheets/sheet1.xml"
_SHEET_HEAD = (
    '<?xml version="1.0"?>'
    '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
)


def _with_sheet(path: Path, cells: str, head: str = _SHEET_HEAD) -> None:
    """A workbook whose one sheet holds this XML."""
    write_xlsx(path, {"S": _ROWS})
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    parts[_SHEET] = f"{head}{cells}</sheetData></worksheet>".encode()
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in parts.items():
            archive.writestr(name, data)


def _sparse_xlsx(path: Path) -> None:
    """Two cells, as far apart as a sheet allows."""
    first = '<row r="1"><c r="A1"><v>1</v></c></row>'
    _with_sheet(path, f'{first}<row r="9"><c r="XFD1048576"><v>2</v></c></row>')


def _forged_xlsx(path: Path) -> None:
    """A sheet of 300 MiB that is said to have a thousand bytes."""
    _with_sheet(path, " " * (300 * _MIB))
    data = path.read_bytes()
    at = data.rindex(b"PK\x01\x02", 0, data.rindex(_SHEET.encode()))  # its entry in the directory
    path.write_bytes(data[: at + 24] + struct.pack("<I", 1000) + data[at + 28 :])


def _entities_xlsx(path: Path) -> None:
    types = '?><!DOCTYPE a [<!ENTITY b "cccccccc"><!ENTITY d "&b;&b;&b;&b;">]>'
    cell = '<row r="1"><c r="A1" t="inlineStr"><is><t>&d;</t></is></c></row>'
    _with_sheet(path, cell, _SHEET_HEAD.replace("?>", types, 1))


def _repeated_ods(path: Path) -> None:
    space = "urn:oasis:names:tc:opendocument:xmlns"
    cell = '<table:table-cell office:value-type="float" office:value="1" '
    cells = cell + 'table:number-columns-repeated="16384"/>'
    rows = f'<table:table-row table:number-rows-repeated="1000000000">{cells}</table:table-row>'
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        archive.writestr(
            "content.xml",
            f'<?xml version="1.0"?><office:document-content xmlns:office="{space}:office:1.0" '
            f'xmlns:table="{space}:table:1.0"><office:body><office:spreadsheet>'
            f'<table:table table:name="S">{rows}</table:table>'
            "</office:spreadsheet></office:body></office:document-content>",
        )
        archive.writestr("META-INF/manifest.xml", "<manifest/>")


def _zip(path: Path, count: int, data: bytes, name: str = "{}.png") -> None:
    with zipfile.ZipFile(
        path, "w", zipfile.ZIP_DEFLATED if data else zipfile.ZIP_STORED
    ) as archive:
        for number in range(count):
            archive.writestr(name.format(number), data, compresslevel=1)


def _blank_folder(path: Path) -> None:
    path.mkdir()
    one = path.with_name("one.png")
    one.write_bytes(blank(6000))
    for number in range(2000):
        (path / f"{number}.png").hardlink_to(one)


def _forged_tiffs(path: Path) -> None:
    path.mkdir()
    tags = [(256, 4, 1, 46_340), (257, 4, 1, 46_340), (258, 3, 1, 8), (277, 3, 1, 1)]
    body = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *one) for one in tags)
    for number in range(10):
        (path / f"{number}.tif").write_bytes(b"II*\0" + struct.pack("<I", 8) + body + bytes(900))


def _empty_h264(_: Path) -> bytes:
    head = "0000000167640028acd940780227e5c044000003000400000300f03c60c6580000000168ebe3cb22c0"
    return bytes.fromhex(head) + b"\0\0\0\x01\x65\x88" * 2_000_000


def _forged_webp(_: Path) -> bytes:
    side = (16_383).to_bytes(3, "little")
    frame = bytes(6) + side * 2 + bytes(4) + b"VP8L" + bytes(4)
    parts = b"VP8X" + struct.pack("<I", 10) + b"\x02\0\0\0" + side * 2
    parts += b"ANIM" + struct.pack("<I", 6) + bytes(6)
    parts += (b"ANMF" + struct.pack("<I", len(frame)) + frame) * 10_000
    return b"RIFF" + struct.pack("<I", 4 + len(parts)) + b"WEBP" + parts


# Films of some hundred bytes that claim pictures without end.
FILE_TYPE = struct.pack(">I4s4sI", 16, b"ftyp", b"isom", 0)  # the box with which a file begins
CLAIMED = 80_000_000


def box(kind: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I4s", 8 + len(body), kind) + body


def mp4_of_many(count: int) -> bytes:
    """A film that says in 535 bytes that so many pictures follow."""
    return FILE_TYPE + box(b"moov", *_of_film(count))


def fragment_of_many(count: int) -> bytes:
    """The same of a fragment behind a film without pictures."""
    extends = box(b"mvex", box(b"trex", struct.pack(">IIIIII", 0, 1, 1, 1, 0, 0)))
    run = box(b"trun", struct.pack(">II", 0, count))
    track = box(b"traf", box(b"tfhd", struct.pack(">II", 0, 1)), run)
    fragment = box(b"moof", box(b"mfhd", struct.pack(">II", 0, 1)), track)
    return FILE_TYPE + box(b"moov", *_of_film(0), extends) + fragment + box(b"mdat", bytes(1000))


def _of_film(count: int) -> tuple[bytes, bytes]:
    header = struct.pack(">IIIII", 0, 0, 0, 1000, 1000) + bytes(80)
    entry = box(b"jpeg", bytes(6), b"\0\1", bytes(16), struct.pack(">HH", 64, 48), bytes(50))
    entries = min(count, 1)
    table = box(
        b"stbl",
        box(b"stsd", struct.pack(">II", 0, 1), entry),
        box(b"stts", struct.pack(">II", 0, entries), struct.pack(">II", count, 1) * entries),
        box(b"stsc", struct.pack(">II", 0, entries), struct.pack(">III", 1, count, 1) * entries),
        box(b"stsz", struct.pack(">III", 0, 100 * entries, count)),
        box(b"stco", struct.pack(">II", 0, entries), struct.pack(">I", 1000) * entries),
    )
    media = box(
        b"mdia",
        box(b"mdhd", struct.pack(">IIIIIHH", 0, 0, 0, 90000, 1000, 0, 0)),
        box(b"hdlr", struct.pack(">II4s", 0, 0, b"vide"), bytes(13)),
        box(b"minf", box(b"vmhd", bytes(12)), table),
    )
    head = box(b"tkhd", struct.pack(">IIIIII", 7, 0, 0, 1, 0, 1000), bytes(60))
    return box(b"mvhd", header), box(b"trak", head, media)


# Sound.
_FLOAT, _WHOLE = 3, 1


class Block(NamedTuple):
    """One message of sound in a log."""

    stamp_ns: int
    pcm: bytes
    rate_hz: int = 48_000
    channels: int = 1


def write_blocks(path: Path, topics: dict[str, list[Block]]) -> Path:
    """A log of blocks as our recorders write them, whatever they state."""
    text = messages.definition(messages.RAW_AUDIO).encode()
    schema, sent = Schema(messages.RAW_AUDIO, text=text), []
    for topic, blocks in topics.items():
        for block in blocks:
            message = messages.raw_audio(block.stamp_ns, np.zeros((0, 1), np.int16), 0)
            message.data, message.sample_rate = np.frombuffer(block.pcm, "u1"), block.rate_hz
            message.number_of_channels = block.channels
            data = messages.encode(message, messages.RAW_AUDIO)
            sent.append((topic, schema, block.stamp_ns, data))
    return write_raw(path, sent)


def tones(seconds: float, rate_hz: int = 48_000, channels: int = 1) -> bytes:
    """Of 440 Hz and 16 bits."""
    times_s = np.arange(round(seconds * rate_hz)) / rate_hz
    whole = np.round(3000 * np.sin(2 * np.pi * 440 * times_s)).astype("<i2")
    return np.repeat(whole, channels).tobytes()


def _wav(data: bytes, *, form: int = _WHOLE, bits: int = 16, channels: int = 1,
         rate_hz: int = 48_000, stated: int | None = None) -> bytes:  # fmt: skip
    """Uncompressed sound that states the given number of bytes, or what it has."""
    width = bits // 8 * channels
    speed = rate_hz * width & 0xFFFFFFFF
    about = struct.pack("<HHIIHH", form, channels, rate_hz, speed, width, bits)
    size = len(data) if stated is None else stated
    body = b"WAVEfmt " + struct.pack("<I", len(about)) + about + b"data" + struct.pack("<I", size)
    return b"RIFF" + struct.pack("<I", min(size + 36, 2**32 - 1)) + body + data


def _hours_of_holes(path: Path) -> None:
    """Ten hours of 8 kHz and 8 bits, which the disk need not hold."""
    with path.open("wb") as file:
        file.write(_wav(b"", bits=8, rate_hz=8000, stated=288_000_000))
        file.truncate(288_000_044)


def _hour_of_flac(path: Path) -> None:
    """An hour of silence: a packet of some bytes, many times."""
    rate_hz = 48_000
    with av.open(str(path), "w") as file:
        stream: Any = file.add_stream("flac", rate=rate_hz)
        stream.layout = "mono"
        frame = av.AudioFrame(format="s16", layout="mono", samples=rate_hz)
        frame.planes[0].update(bytes(2 * rate_hz))
        frame.sample_rate, frame.pts = rate_hz, 0
        silence, step = bytes(stream.encode(frame)[1]), stream.codec_context.frame_size
        for number in range(3600 * rate_hz // step):
            packet = av.Packet(silence)
            packet.stream, packet.pts, packet.duration = stream, number * step, step
            packet.dts, packet.time_base = packet.pts, stream.codec_context.time_base
            file.mux(packet)


def _no_numbers(_: Path) -> bytes:
    """Floats, a few of them NaN, infinite or huge."""
    samples = np.frombuffer(tones(1.0), "<i2").astype("<f4") / 32768
    samples[1000:4000:1000] = np.nan, np.inf, -3e38
    return _wav(samples.tobytes(), form=_FLOAT, bits=32)


def _far_apart(path: Path) -> None:
    """20 microphones, each of which hears two moments that are ten hours apart."""
    pcm = tones(0.1, 2_000_000)
    blocks = [Block(n * 36_000 * 10**9 + 10**9, pcm, 2_000_000) for n in (0, 1)]
    write_blocks(path, {f"/mic{n}": blocks for n in range(20)})


def _many_moments(path: Path) -> None:
    """20,000 messages of one sample, each an hour behind the last."""
    write_blocks(path, {"/mic": [Block(n * 3600 * 10**9, b"\1\0") for n in range(20_000)]})


# By name: the file, what writes it, and what `tunenet-logs check` says of it.
_SOUNDS: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "hours_claimed": ("a.wav", lambda _: _wav(tones(1.0), stated=2**32 - 1), "whole"),
    "hours_of_holes": ("a.wav", _hours_of_holes, "only the first 600.0 s of the sound are used"),
    "hour_of_flac": ("a.flac", _hour_of_flac, "the first 600.0 s of the sound are used: 10 min"),
    "64_channels": ("a.wav", lambda _: _wav(tones(2.0, channels=64), channels=64), "whole"),
    "most_channels": ("a.wav", lambda _: _wav(bytes(2 * 65_535), bits=8, channels=65_535),
                      "/audio: the sound track holds no sound"),
    "high_rate": ("a.wav", lambda _: _wav(tones(2.0, 192_000), rate_hz=192_000),
                  "the sound was reduced from 192000 to 48000 Hz"),
    "no_numbers": ("a.wav", _no_numbers,
                   "3 samples that are no numbers, or far too loud, became silence"),
    "no_rate": ("a.wav", lambda _: _wav(tones(1.0), rate_hz=0),
                "is no sound that can be read (Invalid data"),
    "impossible_rate": ("a.wav", lambda _: _wav(tones(1.0), rate_hz=2**31 - 1),
                        "the sound cannot be used: it claims 2.14748e+09 samples a second"),
    "far_apart": ("a.mcap", _far_apart,
                  "the sound of 12 channels were left out: the log has over 8 channels of sound"),
    "many_moments": ("a.mcap", _many_moments, "1 hole in the sound, 3600.00 s in all"),
}  # fmt: skip
_QUICK: dict[str, tuple[str, Callable[[Path], object]]] = {
    "many_columns": ("bomb.csv", _many_columns),
    "nested_json_file": ("bomb.json", lambda _: b'{"a":' * 1_000_000),
    "nested_xml": ("bomb.xml", lambda _: b'<?xml version="1.0"?><Tracks nTracks="1">'
                   + b"<particle>" * 1_000_000),
    "entities_xml": ("bomb.xml", _entities),
    "forged_c3d": ("bomb.c3d", _forged_c3d),  # 65,535 points and frames in one block of data
    "forged_npz": ("bomb.npz", partial(_npz, head=npy_head(2**40, 3), mebibytes=0)),
    "forged_mat": ("bomb.mat", lambda _: _MAT + struct.pack("<II", 14, 2**32 - 1)
                   + _mat(2**31 - 1, 3, 2**32 - 8) + bytes(64)),
    "forged_parquet": ("bomb.parquet",  # a footer of nearly 2 GiB
                       lambda _: b"PAR1" + bytes(1000) + struct.pack("<I", 2**31 - 1) + b"PAR1"),
    "workbook_with_macros": ("bomb.xlsm", _macros),
    "sparse_workbook": ("bomb.xlsx", _sparse_xlsx),
    "forged_workbook": ("bomb.xlsx", _forged_xlsx),
    "workbook_of_entities": ("bomb.xlsx", _entities_xlsx),
    "deep_workbook": ("bomb.xlsx", lambda path: _with_sheet(path, "<a>" * 1_000_000)),
    "wide_workbook": ("bomb.xlsx",
                      lambda path: write_xlsx(path, {"S": [[f"x{n}" for n in range(16_000)]]})),
    "archive_of_parts": ("bomb.xlsx", lambda path: _zip(path, 20_000, b"", "xl/{}")),
    "spreadsheet_repeated": ("bomb.ods", _repeated_ods),  # a row, a billion times
    "forged_tiffs": ("bomb", _forged_tiffs),  # 2^31 pixels in a kilobyte
    "forged_y4m": ("bomb.y4m", lambda _: b"YUV4MPEG2 W65000 H65000 F30:1 C420\nFRAME\n"
                   + bytes(100_000)),
    "forged_webp": ("bomb.webp", _forged_webp),  # 16,384 x 16,384 whose frames are empty
    "long_definition": ("bomb.mcap", _long_definition),  # 100,000 fields, within itself
    "deep_lists": ("bomb.json", _lists),
}  # fmt: skip
_SLOW: dict[str, tuple[str, Callable[[Path], object]]] = {
    "dense_motive": ("bomb.csv", partial(_dense, head=_MOTIVE)),  # of one digit, as the others
    "dense_nexus": ("bomb.csv", partial(_dense, head=_NEXUS)),
    "dense_trc": ("bomb.trc", partial(_dense, head=_TRC)),
    "full_motive": ("bomb.csv", partial(_dense, head=_MOTIVE, row="1,1,1,1,1\n")),
    "dense_table": ("bomb.csv", partial(_dense, head="t,x,z\n")),
    "dense_impacts": ("bomb.csv", partial(_dense, head="impact_s\n", row="1\n")),
    "dense_tracker": ("bomb.txt", partial(_dense, head=",mass A,,\nt,x,y,\n", row="1,1,1,\n")),
    "dense_slices": ("bomb.csv", partial(_dense, head=" \tX\tY\tSlice\n", row="1\t1\t1\t1\n")),
    "dense_json": ("bomb.jsonl", partial(_dense, head="", row='{"t":1,"z":1}\n', size=250 * _MIB)),
    "dense_json_array": ("bomb.json", partial(_dense, head="[", row="[],", size=250 * _MIB)),
    "dense_json_object": ("bomb.json", partial(_dense, head='{"t":[0', row=",1", size=250 * _MIB)),
    "dense_xml": ("bomb.xml",
                  partial(_dense, head=_TRACKS, row='<detection t="1" x="1" y="1" z="1"/>')),
    "many_tracks": ("bomb.txt", _many_tracks),
    "many_motive_bodies": ("bomb.csv", _many_bodies),
    "zeros_npz": ("bomb.npz", partial(_npz, head=npy_head(2**25, 4), mebibytes=1024)),
    "zeros_mat": ("bomb.mat", _zeros_mat),
    "zeros_parquet": ("bomb.parquet", _zeros_parquet),  # two million rows of 64 columns
    "zstd_table": ("bomb.csv.zst", partial(_packed, zstandard.ZstdCompressor().compress)),
    "gzip_table": ("bomb.csv.gz", partial(_packed, gzip.compress)),
    "bz2_table": ("bomb.csv.bz2", partial(_packed, bz2.compress)),
    "lz4_table": ("bomb.csv.lz4", partial(_packed, lz4.frame.compress)),
    "gzip_dense_motive": ("bomb.csv.gz", _packed_motive),
    "workbook_of_zeros": ("bomb.xlsx", _zeros_xlsx),
    "zip_of_blanks": ("bomb.zip", lambda path: _zip(path, 2000, blank(6000))),
    "folder_of_blanks": ("bomb", _blank_folder),
    "zip_of_many": ("bomb.zip", lambda path: _zip(path, 250_000, b"")),
    "zip_of_one_file": ("bomb.zip", lambda path: _zip(path, 3, bytes(2**28))),
    "many_y4m": ("bomb.y4m", lambda _: b"YUV4MPEG2 W2 H2 F30:1 C420\n"
                 + (b"FRAME\n" + bytes(6)) * 1_000_000),
    "empty_h264": ("bomb.h264", _empty_h264),
}  # fmt: skip
_ROWS_READ = 499_000
_WHOLE_AND_LONG: dict[str, Callable[[Path], object]] = {
    "long_motive": lambda path: _long(
        path, _MOTIVE, (f"{n},{n / 120:.3f},1,1,1\n" for n in range(_ROWS_READ))
    ),
    "long_table": lambda path: _long(path, "t,x,z\n", (f"{n},1,1\n" for n in range(_ROWS_READ))),
}
_TUNED = ((), (1,))  # what is no log of a drop ends a tuning, and may well be whole
FILES: dict[str, Hostile] = {
    **{name: Hostile(*row, True, _TUNED, "", 10.0) for name, row in _QUICK.items()},
    **{name: Hostile(*row, False, _TUNED, "", 10.0) for name, row in _SLOW.items()},
    **{name: Hostile("bomb.csv", make, False, _TUNED, "", 10.0, 640_000)
       for name, make in _WHOLE_AND_LONG.items()},
    **{name: Hostile(file, make, True, ((int(name == "no_rate"),), ()), says)
       for name, (file, make, says) in _SOUNDS.items()},
    **{f"{make.__name__}_pictures": Hostile(
        "film.mp4", lambda _, make=make: make(CLAIMED), True, _TUNED, f"claims {CLAIMED} samples in"
       ) for make in (mp4_of_many, fragment_of_many)},
}  # fmt: skip
EVERY: dict[str, Hostile] = {**HOSTILE, **FILES}
