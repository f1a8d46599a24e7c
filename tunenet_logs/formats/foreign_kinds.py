"""Files that are nothing that is read here, called what they are."""

from __future__ import annotations

from pathlib import Path

_COPY = "copy it again, or record it again"

_KINDS: tuple[tuple[bytes, str, str], ...] = (
    (b"PAR1", "a Parquet file", _COPY),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a file of Microsoft Office (OLE2)", "save it as .xlsx"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file", "export what it holds as CSV"),
    (b"CDF\x01", "a NetCDF file", "export what it holds as CSV"),
    (b"CDF\x02", "a NetCDF file", "export what it holds as CSV"),
    (b"%PDF", "a PDF document", "export the measurements themselves as CSV"),
    (b"\x7fELF", "a program", "name the log that it writes"),
    (b"MZ", "a program of Windows", "name the log that it writes"),
    (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive", "unpack it and name the log inside"),
    (b"Rar!\x1a\x07", "a RAR archive", "unpack it and name the log inside"),
    (b"\xfd7zXZ\x00", "an xz file", "unpack it first with `xz -d`"),
    (b"ARROW1", "an Arrow (Feather) file", "save it as Parquet or CSV"),
    (b"\x93NUMPY", "a NumPy array", _COPY),
    (b"MATLAB 5.0", "a MATLAB file", _COPY),
    (b"\x80\x02", "a Python pickle, which can run programs", "save it as CSV or .npz"),
    (b"\x80\x03", "a Python pickle, which can run programs", "save it as CSV or .npz"),
    (b"\x80\x04\x95", "a Python pickle, which can run programs", "save it as CSV or .npz"),
    (b"\x80\x05\x95", "a Python pickle, which can run programs", "save it as CSV or .npz"),
    (b"\x89PNG\r\n\x1a\n", "a single picture (PNG)", "name a video of the drop"),
    (b"\xff\xd8\xff", "a single picture (JPEG)", "name a video of the drop"),
    (b"ULog\x01", "a log of a PX4 autopilot (ULog)", "turn it into CSV with `ulog2csv`"),
    (b"TDSm", "a TDMS file of LabVIEW", "export it as CSV"),
    (b"{\\rtf", "a text document (RTF)", "save it as plain text (.csv)"),
    (b"<?xml", "an XML file", "export what it holds as CSV"),
    (b"<!DOCTYPE", "a web page, perhaps of a download that asked for a login", "download it again"),
    (b"<html", "a web page, perhaps of a download that asked for a login", "download it again"),
    (b"version https://git-lfs", "a pointer of Git LFS, not the file", "run `git lfs pull`"),
)
"""First bytes, what the file is, and what to do about it."""

_ZIPS: tuple[tuple[bytes, str, str], ...] = (
    (b"xl/", "a spreadsheet (.xlsx)", _COPY),
    (b"word/", "a Word document", "save the measurements as CSV"),
    (b"mimetypeapplication/vnd.oasis", "an OpenDocument file", "save its sheet as CSV"),
    (b".npy", "an archive of NumPy arrays (.npz)", _COPY),
)
"""What names in a ZIP archive make it."""

_ZIP_STARTS = (b"PK\x03\x04", b"PK\x05\x06")
"""How a ZIP archive begins, and an empty one."""

_TAR_AT = 257
"""Where a tar archive says what it is."""


def foreign_kind(start: bytes, path: Path) -> tuple[str, str] | None:
    """What a file is, by its first bytes, and what to do; None where these tell nothing.

    Args:
        start: some KiB.
        path: of the file; its name tells a YAML file or plain text.
    """
    marks = _ZIPS if start.startswith(_ZIP_STARTS) else ()
    found = [kind[1:] for kind in _KINDS if start.startswith(kind[0])]
    found += [kind[1:] for kind in marks if kind[0] in start]
    if marks:
        found.append(("a ZIP archive", "unpack it and name the log inside"))
    if start[_TAR_AT : _TAR_AT + 5] == b"ustar":
        found.append(("a tar archive", "unpack it with `tar xf` and name the log inside"))
    if path.name == "metadata.yaml":
        found.append(("the index of a ROS 2 bag", f"name its folder: {path.parent}"))
    if not any(start):
        found.append(("nothing but zeros, as a disk leaves of what was never written", _COPY))
    return found[0] if found else None
