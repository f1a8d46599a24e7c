"""Identify the format of a file by its first bytes; for an unsupported one, name a remedy."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from tunenet_logs.files import open_regular
from tunenet_logs.formats.columns.cells import encoding_of, is_text

_BYTES = 65536  # read of a file


@dataclass(frozen=True, eq=False)
class Start:
    """The first bytes of a file."""

    path: Path
    data: bytes  # up to 64 KiB

    @property
    def suffix(self) -> str:
        """Suffix of the file's name, in lower case, with the dot."""
        return self.path.suffix.lower()

    @property
    def is_text(self) -> bool:
        """Whether the file is text, regardless of its name."""
        return is_text(self.data, self.suffix)

    @cached_property
    def lines(self) -> tuple[str, ...]:
        """Lines of the text, the last one perhaps cut; empty for a binary file."""
        encoding = encoding_of(self.data)
        if not self.is_text or (b"\0" in self.data and encoding in (None, "utf-8-sig", "cp1252")):
            return ()
        return tuple(self.data.decode(encoding or "utf-8", "replace").splitlines())


def start_of(path: Path) -> Start:
    """Read the first bytes of a file."""
    with open_regular(path) as file:
        return Start(path, file.read(_BYTES))


# ---- Unsupported formats and their remedies; `{file}` stands for the path.
# Tests run those commands whose libraries the project has.

UNPACK = "unpack it and name the log inside"  # the remedy for an archive of anything
_COPY = "copy it again, or record it again"
_AS_NUMBERS = (
    "with the program that wrote it, save its numbers: numpy.savez('log.npz', t=times, z=heights)"
)
_FROM_PANDAS = (
    "pip install pandas tables, then: python -c \"import pandas; pandas.read_hdf('{file}')"
    ".to_csv('{file}.csv')\", and name {file}.csv"
)
_FROM_MDF = (
    'pip install asammdf, then: python -c "from asammdf import MDF; '
    "MDF('{file}').export('csv', '{file}.csv')\", and name the table that it writes"
)
_FROM_NETCDF = (
    'pip install xarray scipy, then: python -c "import xarray; '
    "xarray.open_dataset('{file}').to_dataframe().to_csv('{file}.csv')\", and name {file}.csv"
)
_FROM_FEATHER = (
    "python -c \"import pandas; pandas.read_feather('{file}').to_parquet('{file}.parquet')\", "
    "and name {file}.parquet"
)
_FROM_TDMS = (
    'pip install npTDMS pandas, then: python -c "from nptdms import TdmsFile; '
    "[group.as_dataframe().to_csv('{file}.' + group.name + '.csv', index=False) "
    "for group in TdmsFile('{file}').groups()]\", and name the table that it writes"
)
_FROM_DATAFLASH = (
    "pip install pymavlink, then: mavlogdump.py --format csv --types POS {file} > {file}.csv, and "
    "name {file}.csv"
)
_PICKLE = "a Python pickle, which can run programs"
_PICTURE, _NAME_VIDEO = "a single picture", "name a video of the drop"
_PROGRAM, _NAME_WRITTEN = "a program", "name the log that it writes"
_TABLE = "save it as Parquet or CSV"
_BAG = ("a bag of ROS of another version", "`rosbag fix` makes a new one of it")
_HDF5 = b"\x89HDF\r\n\x1a\n"
# First bytes, what the file is, and what to do about it.
_KINDS: tuple[tuple[bytes | tuple[bytes, ...], str, str], ...] = (
    (b"PAR1", "a Parquet file", _COPY),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a file of Microsoft Office (OLE2)", "save it as .xlsx"),
    ((b"CDF\x01", b"CDF\x02", b"CDF\x05"), "a NetCDF file", _FROM_NETCDF),
    (b"MDF     ", "a measurement of ASAM (MDF)", _FROM_MDF),
    (b"UnFinMF ", "a measurement of ASAM (MDF) that was not finished", _FROM_MDF),
    (b"%PDF", "a PDF document", "export the measurements themselves as CSV"),
    (b"\x7fELF", _PROGRAM, _NAME_WRITTEN),
    (b"MZ", f"{_PROGRAM} of Windows", _NAME_WRITTEN),
    (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive", UNPACK),
    (b"Rar!\x1a\x07", "a RAR archive", UNPACK),
    (b"\xfd7zXZ\x00", "an xz file", "unpack it first with `xz -d`"),
    (b"FEA1", "a Feather file of version 1", _FROM_FEATHER),
    (b"Obj\x01", "an Avro file", _TABLE),
    (b"ORC", "an ORC file", _TABLE),
    (b"LOGG", "a log of a CAN bus (BLF)", "decode it with its database (DBC) to CSV"),
    (b"\xa3\x95\x80\x80", "a log of an ArduPilot (DataFlash)", _FROM_DATAFLASH),
    (b"#ROSRECORD", "a bag of ROS before 2.0", _BAG[1]),
    (b"#ROSBAG", *_BAG),
    (b"\x93NUMPY", "a NumPy array", _COPY),
    (b"MATLAB 5.0", "a MATLAB file", _COPY),
    ((b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05"), _PICKLE, _AS_NUMBERS),
    (b"\x89PNG\r\n\x1a\n", f"{_PICTURE} (PNG)", _NAME_VIDEO),
    (b"\xff\xd8\xff", f"{_PICTURE} (JPEG)", _NAME_VIDEO),
    (b"TDSm", "a TDMS file of LabVIEW", _FROM_TDMS),
    (b"{\\rtf", "a text document (RTF)", "save it as plain text (.csv)"),
    (b"version https://git-lfs", "a pointer of Git LFS, not the file", "run `git lfs pull`"),
)
_ZIP_STARTS = (b"PK\x03\x04", b"PK\x05\x06")  # how a ZIP archive begins, and an empty one
# Kinds of ZIP archives, by the names in them.
_ZIPS: tuple[tuple[bytes, str, str], ...] = (
    (b"xl/", "a spreadsheet (.xlsx)", _COPY),
    (b"word/", "a Word document", "save the measurements as CSV"),
    (b"mimetypeapplication/vnd.oasis", "an OpenDocument file", "save its sheet as CSV"),
    (b".npy", "an archive of NumPy arrays (.npz)", _COPY),
    (b"", "a ZIP archive", UNPACK),
)
# How texts begin that are no tables.
_TEXTS: tuple[tuple[re.Pattern[bytes], str, str], ...] = (
    (
        re.compile(rb"\s*<(?:!doctype|html)", re.I),
        "a web page, perhaps of a download that asked for a login",
        "download it again",
    ),
    (re.compile(rb"\s*<(?:mujoco|robot|sdf)\b"), "a model of a simulator", "give it as --model"),
    (re.compile(rb"\s*<[?A-Za-z]"), "an XML file", "export what it holds as CSV"),
    (
        re.compile(rb"(?:---\s+)?header:\s+(?:stamp|seq):"),
        "what `ros2 topic echo` or `rostopic echo` prints",
        "record the topic with `ros2 bag record` or `rosbag record`, or add --csv (ROS 2) or -p "
        "(ROS 1) to the echo",
    ),
    (re.compile(rb"\(dp?\d?\n|\(lp?\d?\n|c[\w.]+\n\w+\n"), _PICKLE, _AS_NUMBERS),
)
# Where HDF5 may begin behind a block of a user: MATLAB's of version 7.3 does.
_HDF5_AT = (0, 512, 1024, 2048)
_PLAIN_NAME = re.compile(r"[\w./+@ -]+")  # a path that can stand in a remedy as it is


def is_hdf5(start: bytes) -> bool:
    """Return whether a file that begins so is HDF5."""
    return any(start[at:].startswith(_HDF5) for at in _HDF5_AT)


def foreign_kind(start: bytes, path: Path) -> tuple[str, str] | None:
    """Identify what is not read by first bytes and name: its kind and a remedy, or None."""
    found = [kind[1:] for kind in _KINDS if start.startswith(kind[0])]
    if start.startswith(_ZIP_STARTS):
        found += [kind[1:] for kind in _ZIPS if kind[0] in start]
    if start[257:262] == b"ustar":
        found.append(("a tar archive", "unpack it with `tar xf` and name the log inside"))
    if path.name == "metadata.yaml":
        found.append(("the index of a ROS 2 bag", f"name its folder: {path.parent}"))
    if not any(start):
        found.append(("nothing but zeros, as a disk leaves of what was never written", _COPY))
    found += [(what, remedy) for begins, what, remedy in _TEXTS if begins.match(start)]
    if is_hdf5(start):
        if path.suffix.lower() == ".slp":
            return "a project of SLEAP (HDF5)", "in SLEAP, File, Export Analysis CSV, and name that"
        found.append(("an HDF5 file", _FROM_PANDAS))
    if not found:
        return None
    what, remedy = found[0]
    name = str(path) if _PLAIN_NAME.fullmatch(str(path)) else "FILE"
    return what, remedy.replace("{file}", name)
