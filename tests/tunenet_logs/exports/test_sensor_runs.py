"""Exports of PASCO Capstone and of Vernier's programs."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.tunenet_logs.test_csv_table import read
from tunenet_logs.errors import LogError

PASCO = (
    '"Time (s) Run #1","Position (m) Run #1","Velocity (m/s) Run #1",'
    '"Acceleration (m/s²) Run #1","Time (s) Run #2","Position (m) Run #2"\n'
    "0.00,0.30,,,0.01,0.31\n0.05,0.31,0.1,,0.06,0.33\n0.10,0.33,0.2,9.8,,\n"
)


def test_each_run_has_its_own_times(tmp_path: Path):
    episode = read(tmp_path, "\ufeff" + PASCO)
    assert episode.info.source == "sensor's export a.csv"
    first, second = episode.signals["track.run1"], episode.signals["track.run2"]
    assert first.values[:, 2].tolist() == [0.3, 0.31, 0.33]
    assert second.stamps_ns.tolist() == [10_000_000, 60_000_000]
    assert (first.unit, first.columns) == ("m", ("x", "y", "z"))
    assert not episode.warnings


def test_speeds_are_said_and_not_used(tmp_path: Path):
    channels = {one.topic: one for one in read(tmp_path, PASCO).channels}
    assert "speed" in (channels["Velocity (m/s) Run #1"].skipped or "")
    assert "speed" in (channels["Acceleration (m/s²) Run #1"].skipped or "")
    assert "up or down" in channels["track.run1"].type_name


@pytest.mark.parametrize(
    ("header", "names"),
    [
        ("Latest: Time (s),Latest: Position (m),Latest: Velocity (m/s)", {"track"}),
        ("Run 1: Time (s),Run 1: Position (m),Run 1: Velocity (m/s)", {"track"}),
        ("Data Set 1:Time(s),Data Set 1:Position(m),Data Set 1:Acceleration(m/s²)", {"track"}),
        (
            "Run 1: Time (s),Run 1: Position (m),Latest: Position (m)",
            {"track.run1", "track.latest"},
        ),
        ("Time (s) Run #1,Position (m) Run #1,Position (m) Run #2", {"track.run1", "track.run2"}),
        ("Bounce:Time(s),Bounce:Position(m),Bounce:Velocity(m/s)", {"track"}),
    ],
)
def test_names_of_runs(tmp_path: Path, header: str, names: set[str]):
    episode = read(tmp_path, f"{header}\n0,0.5,0.25\n0.05,0.75,0.25\n")
    assert set(episode.signals) == names
    assert all(one.unit == "m" for one in episode.signals.values())


def test_decimal_commas_and_tabs(tmp_path: Path):
    text = "Time (s) Run #1\tPosition (cm) Run #1\n0,00\t30,5\n0,05\t31\n"
    assert read(tmp_path, text, "a.txt").signals["track"].values[0, 2] == pytest.approx(0.305)
    text = '"Time (s) Run #1";"Position (m) Run #1"\n0,00;0,305\n0,05;0,31\n'
    assert read(tmp_path, text).signals["track"].values[0, 2] == 0.305


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "Data Set 1:Time(s),Data Set 1:Force(N)\n0,0.4\n",
            r"1 run without positions .*'Force\(N\)'",
        ),
        (
            "Time (s) Run #1,Voltage (V) Run #1,Time (s) Run #2,Voltage (V) Run #2\n0,1,0,1\n",
            r"2 runs without positions .*'Voltage \(V\)'.*motion sensor.*--columns t=1,z=2",
        ),
    ],
)
def test_what_holds_no_position_says_what_it_is(tmp_path: Path, text: str, says: str):
    with pytest.raises(LogError, match=says):
        read(tmp_path, text)
