"""Tracks of films by Tracker, by plug-ins of ImageJ and TrackMate; of sensors by their programs."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.export_writers_video import (
    FilmedTrack,
    imagej_results,
    manual_tracking,
    mtrack2,
    phyphox_xlsx,
    tracker,
    tracker_multi,
    trackmate_csv,
    trackmate_xml,
    write_xlsx,
    xlsx_track,
)
from tests.reading import one, read, refusal, skipped
from tunenet_logs.episode import FRAME_NS
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode

Write = Callable[[Path, FilmedTrack], None]


def filmed(**settings: Any) -> FilmedTrack:
    """Two things, of which one is not seen for a while."""
    seconds = np.arange(40) / 100
    first = np.column_stack([0.1 + 0 * seconds, 0 * seconds, 1 - seconds**2])
    second = first + 0.5
    second[10:15] = np.nan
    order = {"scale": 400.0, "is_y_down": True, "origin": (30.0, 500.0), "rate_hz": 100.0}
    return FilmedTrack(seconds, {"mass A": first, "mass B": second}, **{**order, **settings})


# Layout, variation, names of the tracks, unit, whether frames are counted.
LAYOUTS: list[tuple[Write, dict[str, Any], tuple[str, ...], str, bool]] = [
    (mtrack2, {}, ("track1", "track2"), "", True),
    (manual_tracking, {}, ("track1", "track2"), "", True),
    (imagej_results, {}, ("track",), "", True),
    (trackmate_csv, {}, ("track0", "track1"), "px", False),
    (trackmate_xml, {}, ("track1", "track2"), "px", False),
    *((write, {"unit": unit}, ("track0", "track1") if write is trackmate_csv else
       ("track1", "track2"), "" if unit == "furlong" else "m", False)
      for write in (trackmate_csv, trackmate_xml) for unit in ("micron", "mm", "furlong")),
    *((write, {"is_slow": True}, ("track0", "track1") if write is trackmate_csv else
       ("track1", "track2"), "px", True) for write in (trackmate_csv, trackmate_xml)),
    (tracker, {}, ("mass A",), "", False),
    *((tracker_multi, {"separator": separator, "decimal": decimal, "extra": ("v", "a")},
       ("mass A", "mass B"), "", False)
      for separator, decimal in ((",", "."), ("\t", "."), (";", "."), (";", ","), ("\t", ","))),
]  # fmt: skip
SCALES = {"micron": 1e-6, "mm": 1e-3}


@pytest.mark.parametrize(("write", "way", "names", "unit", "counts"), LAYOUTS)
def test_each_layout(
    tmp_path: Path, write: Write, way: dict, names: tuple[str, ...], unit: str, counts: bool
):
    settings = {key: value for key, value in way.items() if key != "is_slow"}
    track = filmed(**settings)
    if "is_slow" in way:  # a frame a second is what a program says that knows no rate
        track = FilmedTrack(np.arange(40.0), track.bodies, 400.0, True, (30.0, 500.0), 1.0)
    write(tmp_path / "a.xls", track)
    episode = read(tmp_path / "a.xls")
    assert tuple(episode.signals) == names
    for body, signal in zip(track.bodies, episode.signals.values(), strict=False):
        places = track.places(body) * SCALES.get(way.get("unit", ""), 1.0)
        seen = ~np.isnan(places[:, 0])
        np.testing.assert_allclose(signal.values[:, :2], places[seen], atol=1e-5)
        assert (signal.unit, signal.counts_frames) == (unit, counts)
        period_ns = FRAME_NS if counts else 10_000_000
        steps = np.diff(track.frames[seen]) * period_ns
        np.testing.assert_allclose(np.diff(signal.stamps_ns), steps, atol=1)
    assert not episode.warnings or "is_slow" in way
    assert not episode.losses
    unused = {*(f"{body}.{word}" for body in track.bodies for word in track.extra)}
    assert set(skipped(episode)) == ({"places of no track"} if write is trackmate_csv else unused)


@pytest.mark.parametrize("write", [mtrack2, manual_tracking, imagej_results, trackmate_csv])
def test_rate_that_the_user_knows(tmp_path: Path, write: Write):
    write(tmp_path / "a.txt", filmed())
    for signal in read(tmp_path / "a.txt", fps=250.0).signals.values():
        assert np.diff(signal.stamps_ns).min() == 4_000_000
        assert not signal.counts_frames


FRAMES = ",ball,,\nframe,x,y,\n" + "".join(f"{n},1.5,{n / 7}\n" for n in range(9))
MTRACKJ = "Nr\tTID\tPID\tx [cm]\ty [cm]\tt [sec]\tI [val]\n" + "".join(
    f"{n}\t1\t{n}\t100\t{n}.5\t{n / 50}\t9\n" for n in range(1, 9)
)
TRACKPY = ",y,x,mass,frame,particle\n" + "".join(f"{n},{n}.5,7.0,3,{n},4\n" for n in range(9))
ENDS = ",mass A,,,\nt,frame,x,y,\n" + "".join(
    f"{n / 240:.6E},{n + 120}.0E0,1.5,-{n}.0,\n" for n in range(20)
)
PASCO = (
    '\ufeff"Time (s) Run #1","Position (m) Run #1","Velocity (m/s) Run #1",'
    '"Acceleration (m/s²) Run #1","Time (s) Run #2","Position (m) Run #2"\n'
    "0.00,0.30,,,0.01,0.31\n0.05,0.31,0.1,,0.06,0.33\n0.10,0.33,0.2,9.8,,\n"
)


@pytest.mark.parametrize(
    ("text", "name", "unit", "row", "values", "step_ns"),
    [
        (FRAMES, "ball", "", 7, [1.5, 1, 0], FRAME_NS),
        (",ball,,\nt (ms),x (cm),y (cm),\n0,1,200\n10,1,150\n20,1,100\n", "ball", "m", 0,
         [0.01, 2, 0], 10_000_000),
        (ENDS, "mass A", "", 3, [1.5, -3, 0], None),
        (MTRACKJ, "track1", "m", 0, [1, 0.015, 0], 20_000_000),
        (TRACKPY, "track4", "", 2, [7, 2.5, 0], FRAME_NS),
        ("Time (s) Run #1\tPosition (cm) Run #1\n0,00\t30,5\n0,05\t31\n", "track", "m", 0,
         [0, 0, 0.305], 50_000_000),
        ('"Time (s) Run #1";"Position (m) Run #1"\n0,00;0,305\n0,05;0,31\n', "track", "m", 0,
         [0, 0, 0.305], 50_000_000),
    ],
    ids=["frames", "units", "commas at the end", "MTrackJ", "trackpy", "tabs", "semicolons"],
)  # fmt: skip
def test_by_hand(
    tmp_path: Path, text: str, name: str, unit: str, row: int, values: list, step_ns: int | None
):
    signal = one(tmp_path / "a.csv", text)
    assert (signal.name, signal.unit) == (name, unit)
    assert signal.values[row].tolist() == pytest.approx(values)
    assert signal.counts_frames == (text in (FRAMES, TRACKPY))
    if step_ns:
        assert set(np.diff(signal.stamps_ns)) == {step_ns}
    if text == FRAMES:
        told = one(tmp_path / "a.csv", text, fps=240.0)
        assert told.rate_hz == pytest.approx(240)
        assert not told.counts_frames


def test_blocks_and_blanks_of_mtrack2(tmp_path: Path):
    path = tmp_path / "a.txt"
    text = "Frame,X1,Y1,Flag1,X2,Y2,Flag2\nTracks,1,to,2\n1,5,6, ,7,8,*\n2,5,6, , , , \n"
    episode = read(path, text + "Tracks,3,to,3\n1,1,1, \n2,1,2, \n")
    lengths = {name: len(one.stamps_ns) for name, one in episode.signals.items()}
    assert lengths == {"track1": 2, "track2": 1, "track3": 2}
    assert episode.warnings == ("track2: MTrack2 was not sure of 1 of its places",)
    text = (
        "Frame X1 Y1 Flag1 X2 Y2 Flag2 X3 Y3 Flag3\nTracks 1 to 3         \n"
        "3 140 10       \n4 140 12 300 50 *   \n5 140 16 301 50 500 9 *\n"
        "6 301 50 500 9    \n8 140 31 500 9    \n9 140 39       \n \nTrack Length\n1 9\n"
    )
    episode = read(path, text)
    assert {name: one.values[:, :2].tolist() for name, one in episode.signals.items()} == {
        "track1": [[140, 10], [140, 12], [140, 16], [140, 31], [140, 39]],
        "track2": [[300, 50], [301, 50], [301, 50]],
        "track3": [[500, 9], [500, 9], [500, 9]],
    }
    assert "track2: MTrack2 was not sure of 1 of its places" in episode.warnings


def test_session_of_trackmate(tmp_path: Path):
    spots = "".join(
        f'<Spot ID="{n}" FRAME="{n // 2}" POSITION_X="{n}.5" POSITION_Y="{n * n}" POSITION_Z="0" '
        f'POSITION_T="{n / 50}" />'
        for n in range(20)
    )
    tracks = "".join(
        f'<Track TRACK_ID="{track}">'
        + "".join(
            f'<Edge SPOT_SOURCE_ID="{n}" SPOT_TARGET_ID="{n + step}" />'
            for n in range(track % 2, 16, step)
        )
        + "</Track>"
        for track, step in ((4, 2), (7, 2), (8, 1))
    )
    kept = '<FilteredTracks><TrackID TRACK_ID="4"/><TrackID TRACK_ID="8"/></FilteredTracks>'
    text = (
        '<?xml version="1.0"?><TrackMate version="7"><Model spatialunits="mm" timeunits="sec">'
        f"<AllSpots>{spots}</AllSpots><AllTracks>{tracks}</AllTracks>{kept}</Model>"
        '<Settings><ImageData timeinterval="0.01" /></Settings></TrackMate>'
    )
    episode = read(tmp_path / "a.xml", text)
    (signal,) = episode.signals.values()
    assert (signal.name, signal.unit) == ("track4", "m")
    assert signal.values[3].tolist() == pytest.approx([0.0065, 0.036, 0])
    assert np.diff(signal.stamps_ns).tolist() == [10_000_000] * 8
    assert "filtered out" in skipped(episode)["track7"]
    assert "splits or merges" in skipped(episode)["track8"]
    assert "places" in skipped(episode)["places of no track"]


def test_rows_that_are_cut_and_thousands_of_tracks(tmp_path: Path):
    path = tmp_path / "a.txt"
    tracker(path, filmed())
    episode = read(path, path.read_text().rstrip()[:-30])
    assert len(episode.signals["mass A"].stamps_ns) == 39
    assert len(episode.losses) == 1
    assert "1 of 40 rows" in episode.losses[0]
    rows = "".join(f"{n},{n % 3000},1,2,{n // 3000}\n" for n in range(6001))
    episode = read(path, "LABEL,TRACK_ID,POSITION_X,POSITION_Y,FRAME\n" + rows)
    assert len(episode.signals) == 1000
    assert "track0" in episode.signals
    assert any(one.topic == "2000 more tracks" for one in episode.channels)


def test_each_run_of_a_sensor_has_its_own_times(tmp_path: Path):
    episode = read(tmp_path / "a.csv", PASCO)
    assert episode.info.source == "sensor's export a.csv"
    first, second = episode.signals["track.run1"], episode.signals["track.run2"]
    assert first.values[:, 2].tolist() == [0.3, 0.31, 0.33]
    assert second.stamps_ns.tolist() == [10_000_000, 60_000_000]
    assert (first.unit, first.columns) == ("m", ("x", "y", "z"))
    assert not episode.warnings
    assert "speed" in skipped(episode)["Velocity (m/s) Run #1"]
    assert "speed" in skipped(episode)["Acceleration (m/s²) Run #1"]
    assert "up or down" in {one.topic: one.type_name for one in episode.channels}["track.run1"]


@pytest.mark.parametrize(
    ("header", "names"),
    [
        ("Latest: Time (s),Latest: Position (m),Latest: Velocity (m/s)", {"track"}),
        ("Run 1: Time (s),Run 1: Position (m),Run 1: Velocity (m/s)", {"track"}),
        ("Data Set 1:Time(s),Data Set 1:Position(m),Data Set 1:Acceleration(m/s²)", {"track"}),
        ("Run 1: Time (s),Run 1: Position (m),Latest: Position (m)",
         {"track.run1", "track.latest"}),
        ("Time (s) Run #1,Position (m) Run #1,Position (m) Run #2", {"track.run1", "track.run2"}),
        ("Bounce:Time(s),Bounce:Position(m),Bounce:Velocity(m/s)", {"track"}),
    ],
)  # fmt: skip
def test_names_of_runs(tmp_path: Path, header: str, names: set[str]):
    episode = read(tmp_path / "a.csv", f"{header}\n0,0.5,0.25\n0.05,0.75,0.25\n")
    assert {name: one.unit for name, one in episode.signals.items()} == dict.fromkeys(names, "m")


SPOTS = "LABEL,TRACK_ID,POSITION_X,POSITION_Y,FRAME\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (",mass A,,\nt,x,y,\n", "has no row"),
        (",mass A,,\nt,x,y,\n0,a,b\n1,c,d\n", "'a' is no number"),
        ('<object class="org.opensourcephysics.cabrillo.tracker.TrackerPanel">',
         "File > Export > Data File"),
        (",mass A,,\nt,x,y,\n" + "1e99,1,1\n" * 3, "'1e99' is no time"),
        ("Frame X1 Y1 Flag1 X2 Y2 Flag2\nTracks 1 to 2\n1 5 6 7  \n", "is no row"),
        (f"Frame X1 Y1 Flag1\nTracks 1 to 1\n1{' 5' * 400}\n", "is no row"),
        ("Frame,X1,Y1,Flag1\nTracks 1 to 1\n", "has no row"),
        (" \tArea\tMean\tX\tY\tSlice\n" + "1\t2\t3\t4\t5\t1\n" * 9, "measure one thing alone"),
        (f"{SPOTS}ID1,,1,2,0\n", "link them to tracks"),
        (SPOTS + "ID1,1,a,b,0\n" * 3, "'b'|'a'|no row"),
        ('<?xml version="1.0"?><TrackMate version="7"></TrackMate>', "holds none"),
        ('<Tracks nTracks="1"><particle><detection t="1" x="q"/></particle></Tracks>', "line 1"),
        ('<Tracks nTracks="1"><particle>', "export it again"),
        ('<!DOCTYPE l [<!ENTITY a "b">]><Tracks nTracks="1"></Tracks>', "declares"),
        ('<Tracks nTracks="1">' + "<a>" * 500, "nested"),
        ('<Tracks nTracks="1"></Tracks>', "holds none"),
        ('<?xml version="1.0" encoding="q"?><Tracks nTracks="1"></Tracks>', "encoding"),
        (" \tArea\tMean\tX\tXM\tYM\tSlice\n1\t2\t3\t4\ta\tb\t1\n", "has no row"),
        ("Data Set 1:Time(s),Data Set 1:Force(N)\n0,0.4\n",
         r"1 run without positions .*'Force\(N\)'"),
        ("Time (s) Run #1,Voltage (V) Run #1,Time (s) Run #2,Voltage (V) Run #2\n0,1,0,1\n",
         r"2 runs without positions .*'Voltage \(V\)'.*motion sensor.*--columns t=1,z=2"),
    ],
)  # fmt: skip
def test_refusals_are_one_line(tmp_path: Path, text: str, says: str):
    assert re.search(says, refusal(tmp_path / "a.txt", text))


# Spreadsheets, and impact times by phyphox.
pytestmark = pytest.mark.skipif(
    find_spec("python_calamine") is None, reason="needs python-calamine of the extra `tables`"
)

ROWS: list[list[Any]] = [["t (s)", "x (m)", "z (m)"], *([n / 50, 0.5, 1.0] for n in range(9))]


def lengths(path: Path) -> dict[str, int]:
    signals = read_episode(path).signals.values()
    return {one.name: len(one.stamps_ns) for one in signals}


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
