"""Spreadsheets, and impact times by phyphox."""

from __future__ import annotations

import struct
import sys
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.export_writers_video import FilmedTrack, phyphox_xlsx, write_xlsx, xlsx_track
from tests.hostile import spent
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode

pytestmark = pytest.mark.skipif(
    find_spec("python_calamine") is None, reason="needs python-calamine of the extra `tables`"
)

ROWS: list[list[Any]] = [["t (s)", "x (m)", "z (m)"], *([n / 50, 0.5, 1.0] for n in range(9))]
SHEET = "xl/worksheets/sheet1.xml"
HEAD = (
    '<?xml version="1.0"?>'
    '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"><sheetData>'
)
END = "</sheetData></worksheet>"


def lengths(path: Path) -> dict[str, int]:
    signals = read_episode(path).signals.values()
    return {one.name: len(one.stamps_ns) for one in signals}


def with_sheet(path: Path, text: str) -> None:
    """A workbook whose one sheet is this XML."""
    write_xlsx(path, {"S": ROWS})
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in {**parts, SHEET: text.encode()}.items():
            archive.writestr(name, data)


def test_each_sheet_has_its_own_track(tmp_path: Path):
    path, seconds = tmp_path / "a.xlsx", np.arange(50) / 50
    body = np.column_stack([seconds, 0 * seconds, 1 - seconds**2])
    hidden = body.copy()
    hidden[5:9] = np.nan
    xlsx_track(path, FilmedTrack(seconds, {"Run1": body, "Run2": hidden}))
    assert lengths(path) == {"Run1/track": 50, "Run2/track": 46}
    episode = read_episode(path)
    signal = episode.signals["Run1/track"]
    np.testing.assert_array_equal(signal.values[:, 1], body[:, 2])
    assert np.diff(signal.stamps_ns).tolist() == [20_000_000] * 49
    assert [one.topic for one in episode.channels if one.skipped] == ["Remarks"]
    write_xlsx(path, {"Sheet1": [["Drop 3"], [], *ROWS], "Sheet2": []})  # one keeps plain names
    (signal,) = read_episode(path).signals.values()
    assert (signal.name, signal.unit) == ("track", "m")


def test_cells_of_words_and_tables_of_programs_that_were_pasted(tmp_path: Path):
    path = tmp_path / "a.xlsx"
    rows = [*ROWS, [0.2, "#DIV/0!", 1.0], [0.22, 'n "a"', 1.0], [0.24, True, 1.0]]
    write_xlsx(path, {"S": [*rows, *([0.3 + n / 50, 0.5, 1.0] for n in range(90))]})
    assert lengths(path) == {"track": 99}
    assert any("\"n ''a''\"" in text for text in read_episode(path).warnings)
    masses: list[list[Any]] = [["", "mass A", "", "mass B", ""], ["t", "x", "y", "x", "y"]]
    places: list[list[Any]] = [[" ", "Area", "Mean", "X", "Y", "Slice"]]
    marks: list[list[Any]] = [["Frame", "X1", "Y1", "Flag1"], ["Tracks 1 to 1"]]
    for n in range(9):
        masses.append([n / 50, 1.5, 2.5, *([None, None] if n == 4 else [3.5, 4.5])])
        places.append([n + 1, 88, 3, 1.25, n / 3, n + 1])
        marks.append([n + 1, 5.5, n / 3, ""])
    write_xlsx(path, {"film": masses, "Results": places, "M": marks})
    found = {"film/mass A": 9, "film/mass B": 8, "Results/track": 9, "M/track1": 9}
    assert lengths(path) == found
    counted = {one.name for one in read_episode(path).signals.values() if one.counts_frames}
    assert counted == {"Results/track", "M/track1"}
    (tmp_path / "a.xls").write_text("t\tx\ty\n" + "".join(f"{n / 50}\t1\t2\n" for n in range(9)))
    assert lengths(tmp_path / "a.xls") == {"track": 9}


def test_acoustic_stopwatch(tmp_path: Path):
    path, times = tmp_path / "a.xlsx", [1.2, 1.8, 2.22, 2.514]
    phyphox_xlsx(path, times)
    episode = read_episode(path)
    (signal,) = episode.signals.values()
    assert (signal.name, signal.columns, signal.unit) == ("All/impacts", ("impact",), "1")
    assert signal.values.tolist() == [[1.0]] * 4
    assert signal.stamps_ns.tolist() == [round(one * 1e9) for one in times]
    skipped = {one.topic for one in episode.channels if one.skipped}
    assert {"Simple", "Multiple", "Metadata Device", "Metadata Time"} < skipped
    acceleration: list[list[Any]] = [["Time (s)", "Acceleration x (m/s^2)"], [0.0, 1.0], [0.1, 2.0]]
    write_xlsx(path, {"Raw Data": acceleration, "Metadata Time": [["event"], ["START"]]})
    with pytest.raises(LogError, match=r"phyphox export .*'Raw Data'.*Acceleration"):
        read_episode(path)


@pytest.mark.parametrize(
    ("text", "runs"),
    [
        ('"Event time (s)","Interval (s)"\n1.0E0,5.0E-1\n1.5E0,0.0E0\n', [[1, 1.5]]),
        ("Event time (s);Interval (s)\n1,0E0;5,0E-1\n1,5E0;0,0E0\n", [[1, 1.5]]),
        ("Interval (s)\n0.5\n0.25\n0\n", [[0, 0.5, 0.75]]),
        ("Start (s),Stop 1 (s),Stop 2 (s),Stop 3 (s),Stop 4 (s),Stop 5 (s)\n1,1.5,2,0,0,0\n",
         [[1, 1.5, 2]]),
        ("Bounce 0 (s),Height 0 (m),Bounce 1 (s),Height 1 (m),Energy 1,Bounce 2 (s)\n"
         "2,0.5,2.5,0.3,1,2.875\n4,0.5,4.5,0.3,1,NaN\n", [[2, 2.5, 2.875], [4, 4.5]]),
        ("Time 1 (s),Time 2 (s),Height 1 (cm)\n0.5,0.25,30\n", [[0, 0.5, 0.75]]),
    ],
)  # fmt: skip
def test_other_tables_of_impacts(tmp_path: Path, text: str, runs: list[list[float]]):
    path = tmp_path / "a.csv"
    path.write_text(text)
    found = [one.stamps_ns.tolist() for one in read_episode(path).signals.values()]
    assert found == [[round(time * 1e9) for time in run] for run in runs]


def test_archive_of_tables(tmp_path: Path):
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("Run/All.csv", '"Event time (s)","Interval (s)"\n1,0.5\n1.5,0\n')
        archive.writestr("Run/Raw Data.csv", '"Time (s)","Acceleration x (m/s^2)"\n0,1\n1,2\n')
        archive.writestr("Run/meta/device.csv", "property,value\nversion,1\n")
    episode = read_episode(path)
    assert list(episode.signals) == ["Run/All/impacts"]
    skipped = {one.topic: one.skipped or "" for one in episode.channels}
    assert "Acceleration" in skipped["Run/Raw Data"]
    assert episode.info.source == "phyphox export a.zip"


def sparse(path: Path) -> None:
    """Two cells, as far apart as a sheet allows."""
    cells = '<row r="1"><c r="A1"><v>1</v></c></row>'
    with_sheet(path, f'{HEAD}{cells}<row r="9"><c r="XFD1048576"><v>2</v></c></row>{END}')


def forged(path: Path) -> None:
    """A sheet of 300 MiB that is said to have a thousand bytes."""
    with_sheet(path, HEAD + " " * (300 << 20) + END)
    data = bytearray(path.read_bytes())
    at = data.find(b"PK\x01\x02")
    while at >= 0:
        length = struct.unpack_from("<H", data, at + 28)[0]
        if data[at + 46 : at + 46 + length] == SHEET.encode():
            struct.pack_into("<I", data, at + 24, 1000)
        at = data.find(b"PK\x01\x02", at + 4)
    path.write_bytes(data)


def entities(path: Path) -> None:
    types = '<!DOCTYPE a [<!ENTITY b "cccccccc"><!ENTITY d "&b;&b;&b;&b;">]>'
    cell = '<row r="1"><c r="A1" t="inlineStr"><is><t>&d;</t></is></c></row>'
    with_sheet(path, HEAD.replace("?>", "?>" + types, 1) + cell + END)


def many_parts(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(20_000):
            archive.writestr(f"xl/{number}", "")


def cut(path: Path) -> None:
    write_xlsx(path, {"S": ROWS})
    path.write_bytes(path.read_bytes()[:700])


HOSTILE: dict[str, Callable[[Path], object]] = {
    "sparse": sparse,
    "bomb": lambda path: with_sheet(path, HEAD + " " * (500 << 20) + END),
    "forged": forged,
    "many columns": lambda path: write_xlsx(path, {"S": [[f"x{n}" for n in range(16_000)]]}),
    "entities": entities,
    "deep": lambda path: with_sheet(path, HEAD + "<a>" * 1_000_000 + END),
    "many parts": many_parts,
    "cut": cut,
    "compound": lambda path: path.write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + b"\xff" * 5000),
    "web page": lambda path: path.write_text("<html><table></table></html>"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_workbooks_are_refused_in_one_line(
    tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]
):
    path = tmp_path / "a.xlsx"
    HOSTILE[name](path)
    with pytest.raises(LogError) as caught:
        read_episode(path)
    assert str(caught.value).startswith(f"{path}: is a ")
    assert "\n" not in str(caught.value)
    assert "".join(capfd.readouterr()) == ""


def test_process_that_reads_has_a_bound_of_memory(tmp_path: Path):
    sparse(tmp_path / "a.xlsx")
    reads = "import sys; from tunenet_logs.reader import read_episode; read_episode('a.xlsx')"
    assert spent([sys.executable, "-c", reads], tmp_path).peak_kib < 500 * 1024
