"""Exports of the video program Tracker."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import real
from tests.export_writers_video import FilmedTrack, tracker, tracker_multi
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.registry import open_log
from tunenet_logs.reader import read_episode


def two_masses(**settings: object) -> FilmedTrack:
    seconds = np.arange(60) / 60
    first = np.column_stack([0.1 + 0 * seconds, 0 * seconds, 1 - seconds**2])
    second = first + 0.5
    second[10:15] = np.nan
    return FilmedTrack(seconds, {"mass A": first, "mass B": second}, **settings)  # type: ignore[arg-type]


def test_one_mass(tmp_path: Path):
    track = two_masses()
    tracker(tmp_path / "a.txt", track)
    episode = read_episode(tmp_path / "a.txt")
    signal = episode.signals["mass A"]
    assert list(episode.signals) == ["mass A"]
    assert signal.unit == ""
    assert not signal.counts_frames
    assert np.abs(signal.stamps_ns - track.seconds * 1e9).max() <= 1
    np.testing.assert_allclose(signal.values[:, :2], track.places("mass A"), atol=1e-8)
    assert not episode.warnings
    assert not episode.losses


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), ("\t", "."), (";", "."), (";", ","), ("\t", ",")]
)
def test_several_masses_are_told_apart(tmp_path: Path, separator: str, decimal: str):
    track = two_masses(separator=separator, decimal=decimal, extra=("v", "a"))
    tracker_multi(tmp_path / "a.txt", track)
    episode = read_episode(tmp_path / "a.txt")
    assert {name: len(one.stamps_ns) for name, one in episode.signals.items()} == {
        "mass A": 60,
        "mass B": 55,
    }
    for name, signal in episode.signals.items():
        places = track.places(name)
        np.testing.assert_allclose(signal.values[:, :2], places[~np.isnan(places[:, 0])], atol=1e-8)
    unused = {channel.topic for channel in episode.channels if channel.skipped}
    assert unused == {"mass A.v", "mass A.a", "mass B.v", "mass B.a"}


def test_frames_alone_count_frames(tmp_path: Path):
    path = tmp_path / "a.txt"
    path.write_text(",ball,,\nframe,x,y,\n" + "".join(f"{n},1.5,{n / 7}\n" for n in range(9)))
    assert read_episode(path).signals["ball"].counts_frames
    told = open_log(path, ReadOptions(fps=240.0)).signals["ball"]  # type: ignore[union-attr]
    assert not told.counts_frames
    assert told.rate_hz == pytest.approx(240)


def test_units_that_are_named_are_kept(tmp_path: Path):
    path = tmp_path / "a.txt"
    path.write_text(",ball,,\nt (ms),x (cm),y (cm),\n0,1,200\n10,1,150\n20,1,100\n")
    signal = read_episode(path).signals["ball"]
    assert signal.unit == "m"
    assert signal.values[0].tolist() == pytest.approx([0.01, 2.0, 0])
    assert signal.stamps_ns.tolist() == [0, 10_000_000, 20_000_000]


def test_frame_column_and_commas_at_the_end_of_rows(tmp_path: Path):
    path = tmp_path / "a.csv"
    rows = "".join(f"{n / 240:.6E},{n + 120}.0E0,1.5,-{n}.0,\n" for n in range(20))
    path.write_text(f",mass A,,,\nt,frame,x,y,\n{rows}")
    signal = read_episode(path).signals["mass A"]
    assert len(signal.stamps_ns) == 20
    assert signal.values[3].tolist() == [1.5, -3.0, 0.0]


def test_last_row_cut_short_is_a_loss(tmp_path: Path):
    path = tmp_path / "a.txt"
    tracker(path, two_masses())
    path.write_text(path.read_text().rstrip()[:-30])
    episode = read_episode(path)
    assert len(episode.signals["mass A"].stamps_ns) == 59
    assert len(episode.losses) == 1
    assert "1 of 60 rows" in episode.losses[0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (",mass A,,\nt,x,y,\n", "has no row"),
        (",mass A,,\nt,x,y,\n0,a,b\n1,c,d\n", "'a' is no number"),
        (
            '<object class="org.opensourcephysics.cabrillo.tracker.TrackerPanel">',
            "File > Export > Data File",
        ),
        (",mass A,,\nt,x,y,\n" + "1e99,1,1\n" * 3, "'1e99' is no time"),
    ],
)
def test_refusals_are_one_line(tmp_path: Path, text: str, says: str):
    path = tmp_path / "a.txt"
    path.write_text(text)
    with pytest.raises(LogError, match=says) as caught:
        read_episode(path)
    assert "\n" not in str(caught.value)


def test_real_exports():
    one = read_episode(real("labs/tracker.txt"))
    assert {name: len(signal.stamps_ns) for name, signal in one.signals.items()} == {"mass A": 10}
    two = read_episode(real("labs/tracker_multi_data.txt"))
    assert {name: len(signal.stamps_ns) for name, signal in two.signals.items()} == {
        "mass A": 128,
        "mass B": 128,
    }
    assert not two.warnings
