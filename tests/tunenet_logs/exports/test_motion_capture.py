"""What all exports of motion capture have in common, over every layout."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Command
from tests.export_writers import SUFFIXES, WRITERS, oriented
from tests.tunenet_logs.exports.tracks import (
    BALL,
    OTHER,
    RATE_HZ,
    SECONDS,
    TRACKS,
    outcome,
    read,
    written,
)
from tunenet_logs.episode import UNSTATED
from tunenet_logs.formats.kinds import start_of
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.registry import EXPORTS
from tunenet_logs.timing.arrivals import correct_late_stamps

LAYOUTS = sorted(WRITERS)
SEEN = np.isfinite(BALL[:, 0])


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("unit", ["m", "mm", "cm", "in"])
@pytest.mark.parametrize("up", ["x", "y", "z", "-z"])
def test_a_track_comes_back(tmp_path: Path, layout: str, unit: str, up: str):
    episode = read(written(tmp_path, layout, unit=unit, up=up))
    assert list(episode.signals) == list(TRACKS)
    for name, xyz in TRACKS.items():
        signal = episode.signals[name]
        is_seen = np.isfinite(xyz[:, 0])
        states_unit = layout != "qualisys"
        assert signal.unit == ("m" if states_unit else UNSTATED)
        assert not signal.counts_frames
        expected = oriented(xyz, up, "m" if states_unit else unit)[is_seen]
        np.testing.assert_allclose(signal.values, expected, atol=6e-4 if not states_unit else 2e-5)
        steps = np.round(np.diff(SECONDS[is_seen]) * 1e9)
        np.testing.assert_allclose(np.diff(signal.stamps_ns), steps, atol=1)
    assert episode.losses == ()


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("rate_hz", [100.0, 239.76, 359.64, 1000.0])
def test_stamps_are_exact(tmp_path: Path, layout: str, rate_hz: float):
    path = tmp_path / f"take{SUFFIXES[layout]}"
    WRITERS[layout](path, np.arange(240) / rate_hz, TRACKS, rate_hz=rate_hz)
    stamps = read(path).signals["Ball 1"].stamps_ns
    ideal = np.flatnonzero(SEEN) / rate_hz * 1e9
    wrong = (stamps - stamps[0]) - (ideal - ideal[0])
    rate_as_written = 0.01 / rate_hz if layout == "trc" else 1e-6
    assert np.abs(wrong).max() <= 1 + rate_as_written * ideal[-1]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_user_says_the_rate(tmp_path: Path, layout: str):
    path = written(tmp_path, layout)
    signal = read(path, ReadOptions(fps=240)).signals["Ball 1"]
    assert signal.rate_hz == pytest.approx(240, rel=1e-6)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_layout_is_known_by_its_header_and_by_no_other_reader(tmp_path: Path, layout: str):
    path = written(tmp_path, layout)
    other = path.rename(tmp_path / "noname.dat")
    claimed = [read.__name__ for is_this, read in EXPORTS if is_this(start_of(other))]
    assert claimed[:1] == [f"read_{layout}"]
    assert list(read(other).signals) == list(TRACKS)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("fraction", [0.02, 0.05, 0.1, 0.2, 0.37, 0.5, 0.731, 0.9, 0.99])
def test_a_file_cut_short_is_read_as_far_as_it_goes(tmp_path: Path, layout: str, fraction: float):
    path = written(tmp_path, layout)
    whole = read(path).signals
    data = path.read_bytes()
    path.write_bytes(data[: round(fraction * len(data))])
    episode = outcome(path)
    if isinstance(episode, str):
        assert fraction < 0.2
        assert episode.startswith(f"{path}: ")
        return
    ends_a_line = path.read_bytes().endswith(b"\n")
    assert episode.losses or fraction == 0.99 or (layout == "nexus" and ends_a_line)
    for name, signal in episode.signals.items():
        count = len(signal.stamps_ns)
        np.testing.assert_array_equal(signal.values, whole[name].values[:count])
        np.testing.assert_array_equal(signal.stamps_ns, whole[name].stamps_ns[:count])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_damaged_file_gets_one_line_or_is_read(tmp_path: Path, layout: str):
    path = written(tmp_path, layout)
    data = path.read_bytes()
    for seed in range(60):
        chance = random.Random(seed)
        damaged = bytearray(data)
        for _ in range(chance.choice([1, 5, 50])):
            at = chance.randrange(2000 if seed % 2 else len(damaged))
            damaged[at] = chance.choice([0, 255, 10, 34, 44, 45, chance.randrange(256)])
        path.write_bytes(damaged)
        said = outcome(path)
        assert not isinstance(said, str) or "\n" not in said


@pytest.mark.parametrize("layout", [one for one in LAYOUTS if one != "c3d"])
def test_windows_and_spreadsheets_write_lines_in_their_way(tmp_path: Path, layout: str):
    path = written(tmp_path, layout)
    text = path.read_text()
    whole = read(path).signals["Other"]
    for data in (
        text.replace("\n", "\r\n").encode("utf-8-sig"),
        text.encode("utf-16"),
    ):
        path.write_bytes(data)
        signal = read(path).signals["Other"]
        np.testing.assert_array_equal(signal.values, whole.values)
        np.testing.assert_array_equal(signal.stamps_ns, whole.stamps_ns)


@pytest.mark.parametrize("layout", ["motive", "nexus", "trc"])
def test_decimal_commas(tmp_path: Path, layout: str):
    path = written(tmp_path, layout)
    whole = read(path).signals["Other"]
    path.write_text(path.read_text().replace(",", ";").replace("\t", ";").replace(".", ","))
    signal = read(path).signals["Other"]
    np.testing.assert_array_equal(signal.values, whole.values)
    np.testing.assert_array_equal(signal.stamps_ns, whole.stamps_ns)


@pytest.mark.parametrize("layout", [one for one in LAYOUTS if one != "c3d"])
def test_a_cell_that_is_no_number_is_left_out_and_said(tmp_path: Path, layout: str):
    path = written(tmp_path, layout)
    lines = path.read_text().splitlines()
    at = -30
    mark = "\t" if layout in ("qualisys", "trc") else ","
    cells = lines[at].split(mark)
    place = max(index for index, cell in enumerate(cells) if cell)
    place -= layout == "motive"  # the last is an error, which is not read
    cells[place] = "lost"
    lines[at] = mark.join(cells)
    path.write_text("\n".join(lines) + "\n")
    episode = read(path)
    assert len(episode.signals["Other"].stamps_ns) == np.isfinite(OTHER[:, 0]).sum() - 1
    assert len(episode.signals["Ball 1"].stamps_ns) == SEEN.sum()
    assert any("1 of 240 rows" in loss for loss in episode.losses)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_what_was_never_seen_is_listed(tmp_path: Path, layout: str):
    path = tmp_path / f"take{SUFFIXES[layout]}"
    ghost = np.full_like(BALL, np.nan)
    WRITERS[layout](path, SECONDS, {"Ball": BALL, "Ghost": ghost}, rate_hz=RATE_HZ)
    episode = read(path)
    assert list(episode.signals) == ["Ball"]
    assert {one.topic: one.skipped for one in episode.channels}["Ghost"] == "was never seen"


@pytest.mark.parametrize("layout", LAYOUTS)
def test_names_that_stand_twice_stay_apart(tmp_path: Path, layout: str):
    path = tmp_path / f"take{SUFFIXES[layout]}"
    WRITERS[layout](path, SECONDS, {"AAAA": BALL, "BBBB": OTHER}, rate_hz=RATE_HZ)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"BBBB", b"AAAA"))
    signals = read(path).signals
    assert list(signals) == ["AAAA", "AAAA (2)"]
    assert np.ptp(signals["AAAA"].values[0] - signals["AAAA (2)"].values[0]) > 0


@pytest.mark.parametrize("layout", LAYOUTS)
def test_info_lists_bodies_and_markers(tmp_path: Path, layout: str, command: Command):
    done = command("tunenet-logs", "info", written(tmp_path, layout))
    assert done.returncode == 0
    for name in TRACKS:
        assert any(name in line and line.endswith("yes") for line in done.stdout.splitlines())


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("seen", [0.4, 0.6])
def test_what_is_often_unseen_did_not_come_late(tmp_path: Path, layout: str, seen: float):
    path = tmp_path / f"take{SUFFIXES[layout]}"
    xyz = BALL[~np.isnan(BALL[:, 0])][np.minimum(np.arange(2000), 219)]
    xyz[np.random.default_rng(1).random(2000) > seen] = np.nan
    WRITERS[layout](path, np.arange(2000) / 360, {"Ball": xyz}, rate_hz=360.0)
    stamps = read(path).signals["Ball"].stamps_ns
    np.testing.assert_array_equal(correct_late_stamps(stamps).stamps_ns, stamps)
