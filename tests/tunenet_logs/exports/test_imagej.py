"""Tracks by plug-ins of ImageJ."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.export_writers_video import (
    FilmedTrack,
    imagej_results,
    manual_tracking,
    mtrack2,
    trackmate_csv,
    trackmate_xml,
)
from tunenet_logs.episode import FRAME_NS, Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.registry import open_log
from tunenet_logs.reader import read_episode

Write = Callable[[Path, FilmedTrack], None]


def filmed(**settings: object) -> FilmedTrack:
    seconds = np.arange(40) / 100
    first = np.column_stack([0.1 + 0 * seconds, 0 * seconds, 1 - seconds**2])
    second = first + 0.5
    second[10:15] = np.nan
    order = {"scale": 400.0, "is_y_down": True, "origin": (30.0, 500.0), "rate_hz": 100.0}
    return FilmedTrack(seconds, {"a": first, "b": second}, **{**order, **settings})  # type: ignore[arg-type]


def read(path: Path, **options: object) -> Episode:
    episode = open_log(path, ReadOptions(**options))  # type: ignore[arg-type]
    assert isinstance(episode, Episode)
    return episode


@pytest.mark.parametrize(
    ("write", "names", "unit", "counts"),
    [
        (mtrack2, ("track1", "track2"), "", True),
        (manual_tracking, ("track1", "track2"), "", True),
        (imagej_results, ("track",), "", True),
        (trackmate_csv, ("track0", "track1"), "px", False),
        (trackmate_xml, ("track1", "track2"), "px", False),
    ],
)
def test_each_layout(tmp_path: Path, write: Write, names: tuple[str, ...], unit: str, counts: bool):
    track = filmed()
    write(tmp_path / "a.xls", track)
    episode = read(tmp_path / "a.xls")
    assert tuple(episode.signals) == names
    for body, signal in zip(track.bodies, episode.signals.values(), strict=False):
        places = track.places(body)
        seen = ~np.isnan(places[:, 0])
        np.testing.assert_allclose(signal.values[:, :2], places[seen], atol=1e-5)
        assert (signal.unit, signal.counts_frames) == (unit, counts)
        period_ns = FRAME_NS if counts else 10_000_000
        steps = np.diff(track.frames[seen]) * period_ns
        assert np.diff(signal.stamps_ns).tolist() == steps.tolist()
    assert not episode.warnings
    assert not episode.losses


@pytest.mark.parametrize("write", [mtrack2, manual_tracking, imagej_results, trackmate_csv])
def test_rate_that_the_user_knows(tmp_path: Path, write: Write):
    write(tmp_path / "a.txt", filmed())
    for signal in read(tmp_path / "a.txt", fps=250.0).signals.values():
        assert np.diff(signal.stamps_ns).min() == 4_000_000
        assert not signal.counts_frames


@pytest.mark.parametrize("write", [trackmate_csv, trackmate_xml])
def test_frame_a_second_is_no_rate(tmp_path: Path, write: Write):
    track = filmed(rate_hz=1.0)
    write(tmp_path / "a.txt", FilmedTrack(np.arange(40.0), track.bodies, rate_hz=1.0))
    assert all(one.counts_frames for one in read(tmp_path / "a.txt").signals.values())


@pytest.mark.parametrize(("unit", "known"), [("micron", "m"), ("mm", "m"), ("furlong", "")])
def test_units_as_trackmate_says(tmp_path: Path, unit: str, known: str):
    for write in (trackmate_csv, trackmate_xml):
        write(tmp_path / "a.txt", filmed(unit=unit))
        assert {one.unit for one in read(tmp_path / "a.txt").signals.values()} == {known}


def test_spots_of_no_track_are_listed(tmp_path: Path):
    trackmate_csv(tmp_path / "a.csv", filmed())
    unused = [one for one in read(tmp_path / "a.csv").channels if one.skipped]
    assert [one.topic for one in unused] == ["places of no track"]


def test_mtrackj_and_trackpy(tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text(
        "Nr\tTID\tPID\tx [cm]\ty [cm]\tt [sec]\tI [val]\n"
        + "".join(f"{n}\t1\t{n}\t100\t{n}.5\t{n / 50}\t9\n" for n in range(1, 9))
    )
    signal = read(path).signals["track1"]
    assert signal.unit == "m"
    assert signal.values[0].tolist() == [1.0, 0.015, 0.0]
    assert np.diff(signal.stamps_ns).tolist() == [20_000_000] * 7
    path.write_text(
        ",y,x,mass,frame,particle\n" + "".join(f"{n},{n}.5,7.0,3,{n},4\n" for n in range(9))
    )
    signal = read(path).signals["track4"]
    assert signal.counts_frames
    assert signal.values[2].tolist() == [7.0, 2.5, 0.0]


def test_blocks_of_mtrack2(tmp_path: Path):
    path = tmp_path / "a.txt"
    path.write_text(
        "Frame,X1,Y1,Flag1,X2,Y2,Flag2\nTracks,1,to,2\n1,5,6, ,7,8,*\n2,5,6, , , , \n"
        "Tracks,3,to,3\n1,1,1, \n2,1,2, \n"
    )
    episode = read(path)
    lengths = {name: len(one.stamps_ns) for name, one in episode.signals.items()}
    assert lengths == {"track1": 2, "track2": 1, "track3": 2}
    assert episode.warnings == ("track2: MTrack2 was not sure of 1 of its places",)


def test_blanks_of_mtrack2(tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text(
        "Frame X1 Y1 Flag1 X2 Y2 Flag2 X3 Y3 Flag3\nTracks 1 to 3         \n"
        "3 140 10       \n4 140 12 300 50 *   \n5 140 16 301 50 500 9 *\n"
        "6 301 50 500 9    \n8 140 31 500 9    \n9 140 39       \n \nTrack Length\n1 9\n"
    )
    episode = read(path)
    seen = {name: one.values[:, :2].tolist() for name, one in episode.signals.items()}
    assert seen == {
        "track1": [[140, 10], [140, 12], [140, 16], [140, 31], [140, 39]],
        "track2": [[300, 50], [301, 50], [301, 50]],
        "track3": [[500, 9], [500, 9], [500, 9]],
    }
    assert "track2: MTrack2 was not sure of 1 of its places" in episode.warnings


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("Frame X1 Y1 Flag1 X2 Y2 Flag2\nTracks 1 to 2\n1 5 6 7  \n", "is no row"),
        (f"Frame X1 Y1 Flag1\nTracks 1 to 1\n1{' 5' * 400}\n", "is no row"),
        ("Frame,X1,Y1,Flag1\nTracks 1 to 1\n", "has no row"),
        (" \tArea\tMean\tX\tY\tSlice\n" + "1\t2\t3\t4\t5\t1\n" * 9, "measure one thing alone"),
        ("LABEL,TRACK_ID,POSITION_X,POSITION_Y,FRAME\nID1,,1,2,0\n", "link them to tracks"),
        ("LABEL,TRACK_ID,POSITION_X,POSITION_Y,FRAME\nID1,1,a,b,0\n" * 3, "'b'|'a'|no row"),
        ('<?xml version="1.0"?><TrackMate version="7"></TrackMate>', "holds none"),
        ('<Tracks nTracks="1"><particle><detection t="1" x="q"/></particle></Tracks>', "line 1"),
        ('<Tracks nTracks="1"><particle>', "export it again"),
        ('<!DOCTYPE l [<!ENTITY a "b">]><Tracks nTracks="1"></Tracks>', "declares"),
        ('<Tracks nTracks="1">' + "<a>" * 500, "nested"),
        ('<Tracks nTracks="1"></Tracks>', "holds none"),
        ('<?xml version="1.0" encoding="q"?><Tracks nTracks="1"></Tracks>', "encoding"),
        (" \tArea\tMean\tX\tXM\tYM\tSlice\n1\t2\t3\t4\ta\tb\t1\n", "has no row"),
    ],
)
def test_refusals_are_one_line(tmp_path: Path, text: str, says: str):
    path = tmp_path / "a.txt"
    path.write_text(text)
    with pytest.raises(LogError, match=says) as caught:
        read_episode(path)
    assert "\n" not in str(caught.value)


def test_session_of_trackmate(tmp_path: Path):
    path = tmp_path / "a.xml"
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
    path.write_text(
        '<?xml version="1.0"?><TrackMate version="7"><Model spatialunits="mm" timeunits="sec">'
        f"<AllSpots>{spots}</AllSpots><AllTracks>{tracks}</AllTracks>{kept}</Model>"
        '<Settings><ImageData timeinterval="0.01" /></Settings></TrackMate>'
    )
    episode = read(path)
    signal = episode.signals["track4"]
    assert list(episode.signals) == ["track4"]
    assert signal.unit == "m"
    assert signal.values[3].tolist() == pytest.approx([0.0065, 0.036, 0])
    assert np.diff(signal.stamps_ns).tolist() == [10_000_000] * 8
    skipped = {one.topic: one.skipped or "" for one in episode.channels if one.skipped}
    assert "filtered out" in skipped["track7"]
    assert "splits or merges" in skipped["track8"]
    assert "places" in skipped["places of no track"]


def test_thousands_of_tracks_are_bounded(tmp_path: Path):
    path = tmp_path / "a.csv"
    rows = "".join(f"{n},{n % 3000},1,2,{n // 3000}\n" for n in range(6001))
    path.write_text("LABEL,TRACK_ID,POSITION_X,POSITION_Y,FRAME\n" + rows)
    episode = read(path)
    assert len(episode.signals) == 1000
    assert "track0" in episode.signals
    assert any(one.topic == "2000 more tracks" for one in episode.channels)
