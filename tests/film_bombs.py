"""Workbooks, archives and films that a stranger made to hurt."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from tests.export_writers_video import write_xlsx

_ROWS: list[list[object]] = [["t (s)", "x", "y"], [0.0, 1.0, 2.0], [0.1, 1.0, 2.0]]


def workbook_with_macros(folder: Path) -> Path:
    """Macros, and links to other files and machines."""
    path = folder / "bomb.xlsm"
    write_xlsx(path, {"S": [["a", "b"], ["=cmd|' /C calc'!A0", "words"]]})
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("xl/vbaProject.bin", bytes(10_000))
        archive.writestr(
            "xl/externalLinks/_rels/externalLink1.xml.rels",
            '<Relationships><Relationship Id="rId1" Target="file:///etc/passwd" '
            'TargetMode="External"/></Relationships>',
        )
    return path


def workbook_of_zeros(folder: Path) -> Path:
    """A sheet of 2 GiB of blanks."""
    path = folder / "bomb.xlsx"
    write_xlsx(path, {"S": _ROWS})
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        for number in range(8):
            archive.writestr(f"xl/worksheets/sheet{number + 2}.xml", b" " * 2**28)
    return path


def spreadsheet_repeated(folder: Path) -> Path:
    """A row that is repeated a billion times, in OpenDocument."""
    path = folder / "bomb.ods"
    space = "urn:oasis:names:tc:opendocument:xmlns"
    cell = '<table:table-cell office:value-type="float" office:value="1" '
    cells = cell + 'table:number-columns-repeated="16384"/>'
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        archive.writestr(
            "content.xml",
            f'<?xml version="1.0"?><office:document-content xmlns:office="{space}:office:1.0" '
            f'xmlns:table="{space}:table:1.0"><office:body><office:spreadsheet>'
            f'<table:table table:name="S"><table:table-row '
            f'table:number-rows-repeated="1000000000">{cells}</table:table-row></table:table>'
            "</office:spreadsheet></office:body></office:document-content>",
        )
        archive.writestr("META-INF/manifest.xml", "<manifest/>")
    return path


def blank_png() -> bytes:
    """A blank picture of 36 megapixels, of 110 kB or less."""
    return cv2.imencode(".png", np.zeros((6000, 6000), np.uint8))[1].tobytes()


def zip_of_blanks(folder: Path) -> Path:
    """2,000 blank pictures of 36 megapixels."""
    data, path = blank_png(), folder / "bomb.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(2000):
            archive.writestr(f"{number}.png", data, compresslevel=1)
    return path


def folder_of_blanks(folder: Path) -> Path:
    """Likewise, in a folder."""
    data, path = blank_png(), folder / "bomb"
    path.mkdir()
    (folder / "one.png").write_bytes(data)
    for number in range(2000):
        (path / f"{number}.png").hardlink_to(folder / "one.png")
    return path


def zip_of_many(folder: Path) -> Path:
    """250,000 empty files."""
    path = folder / "bomb.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(250_000):
            archive.writestr(zipfile.ZipInfo(f"{number}.png"), b"")
    return path


def zip_of_one_file(folder: Path) -> Path:
    """A gigabyte of zeros called a picture, three times."""
    path = folder / "bomb.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(3):
            archive.writestr(f"{number}.png", bytes(2**28), compresslevel=1)
    return path


def forged_tiffs(folder: Path) -> Path:
    """TIFFs of 2^31 pixels in a kilobyte."""
    path = folder / "bomb"
    path.mkdir()
    tags = [(256, 4, 1, 46_340), (257, 4, 1, 46_340), (258, 3, 1, 8), (277, 3, 1, 1)]
    body = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *one) for one in tags)
    for number in range(10):
        (path / f"{number}.tif").write_bytes(b"II*\0" + struct.pack("<I", 8) + body + bytes(900))
    return path


def forged_y4m(folder: Path) -> Path:
    """Frames of 65,000 x 65,000."""
    path = folder / "bomb.y4m"
    path.write_bytes(b"YUV4MPEG2 W65000 H65000 F30:1 C420\nFRAME\n" + bytes(100_000))
    return path


def many_y4m(folder: Path) -> Path:
    """A million frames of 2 x 2."""
    path = folder / "bomb.y4m"
    path.write_bytes(b"YUV4MPEG2 W2 H2 F30:1 C420\n" + (b"FRAME\n" + bytes(6)) * 1_000_000)
    return path


def empty_h264(folder: Path) -> Path:
    """Parameters, and units of nothing behind them."""
    path = folder / "bomb.h264"
    head = bytes.fromhex("0000000167640028acd940780227e5c044000003000400000300f03c60c658")
    path.write_bytes(
        head + bytes.fromhex("0000000168ebe3cb22c0") + b"\0\0\0\x01\x65\x88" * 2_000_000
    )
    return path


def forged_webp(folder: Path) -> Path:
    """An animation of 16,384 x 16,384 whose frames are empty."""
    frame = bytes(6) + (16_383).to_bytes(3, "little") * 2 + bytes(4) + b"VP8L" + bytes(4)
    parts = b"VP8X" + struct.pack("<I", 10) + b"\x02\0\0\0" + (16_383).to_bytes(3, "little") * 2
    parts += b"ANIM" + struct.pack("<I", 6) + bytes(6)
    parts += (b"ANMF" + struct.pack("<I", len(frame)) + frame) * 10_000
    path = folder / "bomb.webp"
    path.write_bytes(b"RIFF" + struct.pack("<I", 4 + len(parts)) + b"WEBP" + parts)
    return path


BOMBS: tuple[Callable[[Path], Path], ...] = (
    workbook_with_macros, workbook_of_zeros, spreadsheet_repeated, zip_of_blanks,
    folder_of_blanks, zip_of_many, zip_of_one_file, forged_tiffs, forged_y4m, many_y4m,
    empty_h264, forged_webp,
)  # fmt: skip
