"""Exports of motion capture: one track in every layout, and what each layout has of its own."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.conftest import Command, real
from tests.export_writers import SUFFIXES, WRITERS, oriented
from tests.reading import skipped
from tunenet_logs.episode import UNSTATED, Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.kinds import start_of
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions
from tunenet_logs.formats.registry import EXPORTS, open_log
from tunenet_logs.timing.arrivals import correct_late_stamps

RATE_HZ = 120.0
SECONDS = np.arange(240) / RATE_HZ
LAYOUTS = sorted(WRITERS)
TEXTS = [layout for layout in LAYOUTS if layout != "c3d"]
every_layout = pytest.mark.parametrize("layout", LAYOUTS)


def falling(x_m: float = 0.3) -> NDArray[np.float64]:
    """A ball that falls from 2 m, z up, and is not seen for a while."""
    height = 2 - 0.5 * 9.81 * np.minimum(SECONDS, 0.6) ** 2
    xyz = np.column_stack([np.full_like(SECONDS, x_m), 0.1 + 0.05 * SECONDS, height])
    xyz[60:80] = np.nan
    return xyz


BALL = falling()
OTHER = falling(1.5)[::-1].copy()
TRACKS = {"Ball 1": BALL, "Other": OTHER}
SEEN = np.isfinite(BALL[:, 0])


def written(
    folder: Path, layout: str, tracks: Any = None, seconds: Any = SECONDS, **options: Any
) -> Path:
    """An export, of both tracks where no others are given."""
    path = folder / f"take{SUFFIXES[layout]}"
    WRITERS[layout](path, seconds, tracks or TRACKS, **{"rate_hz": RATE_HZ, **options})
    return path


def read(path: Path, options: ReadOptions = AS_IT_SAYS) -> Episode:
    """As `open_log` does."""
    episode = open_log(path, options)
    assert isinstance(episode, Episode)
    return episode


def outcome(path: Path) -> Episode | str:
    """The episode, or what is said instead."""
    try:
        return read(path)
    except LogError as error:
        return str(error)


def assert_track(signal: Any, xyz: NDArray[np.float64], atol: float) -> None:
    seen = np.isfinite(xyz[:, 0])
    np.testing.assert_allclose(signal.values, xyz[seen], atol=atol)
    steps = np.round(np.diff(SECONDS[seen]) * 1e9)
    np.testing.assert_allclose(np.diff(signal.stamps_ns), steps, atol=1)
    assert not signal.counts_frames


@every_layout
@pytest.mark.parametrize("unit", ["m", "mm", "cm", "in"])
@pytest.mark.parametrize("up", ["x", "y", "z", "-z"])
def test_a_track_comes_back(tmp_path: Path, layout: str, unit: str, up: str):
    episode = read(written(tmp_path, layout, unit=unit, up=up))
    assert list(episode.signals) == list(TRACKS)
    states_unit = layout != "qualisys"
    for name, xyz in TRACKS.items():
        assert episode.signals[name].unit == ("m" if states_unit else UNSTATED)
        expected = oriented(xyz, up, "m" if states_unit else unit)
        assert_track(episode.signals[name], expected, 2e-5 if states_unit else 6e-4)
    assert episode.losses == ()


# What programs of one layout write in several ways.
WAYS: list[tuple[str, dict[str, Any]]] = [
    *(("c3d", {"processor": kind, "is_float": is_float, "analogs": analogs})
      for kind in ("intel", "dec", "mips") for is_float in (True, False) for analogs in (0, 3)),
    *(("qualisys", {"unseen": unseen, "has_columns": has_columns, "bodies": bodies})
      for unseen in ("", "0.000", "NULL") for has_columns in (True, False)
      for bodies in (True, False)),
    *(("trc", {"separator": separator}) for separator in ("\t", ",", ";")),
    *(("motive", {"version": version}) for version in ("1.1", "1.21", "1.23", "1.24", "1.25")),
    ("nexus", {"devices": True}),
]  # fmt: skip


@pytest.mark.parametrize(("layout", "way"), WAYS)
def test_a_layout_is_read_however_it_is_written(tmp_path: Path, layout: str, way: dict[str, Any]):
    options = ReadOptions(length_unit="mm" if layout == "qualisys" else "")
    episode = read(written(tmp_path, layout, **way), options)
    assert list(episode.signals) == list(TRACKS)
    ball = episode.signals["Ball 1"]
    atol = 2e-5 if layout == "nexus" else 1e-6 if way.get("is_float", True) else 6e-5
    assert_track(ball, oriented(BALL, "y" if layout in ("motive", "trc") else "z"), atol)
    assert ball.unit == "m"
    assert episode.losses == ()
    if layout == "c3d":
        assert len(skipped(episode)) == way["analogs"]
    if layout == "motive":
        assert "rotation" in skipped(episode)["Ball 1 rotation"]
        assert "not used" in skipped(episode)["Ball 1 mean marker error"]
        assert episode.info.source == "OptiTrack Motive export take.csv"
    if layout == "nexus":
        assert "'devices'" in skipped(episode)["Force plate - Force"]


@every_layout
@pytest.mark.parametrize("rate_hz", [100.0, 239.76, 359.64, 1000.0])
def test_stamps_are_exact(tmp_path: Path, layout: str, rate_hz: float):
    path = written(tmp_path, layout, seconds=np.arange(240) / rate_hz, rate_hz=rate_hz)
    stamps = read(path).signals["Ball 1"].stamps_ns
    ideal = np.flatnonzero(SEEN) / rate_hz * 1e9
    wrong = (stamps - stamps[0]) - (ideal - ideal[0])
    rate_as_written = 0.01 / rate_hz if layout == "trc" else 1e-6
    assert np.abs(wrong).max() <= 1 + rate_as_written * ideal[-1]


@every_layout
def test_a_layout_is_known_by_its_header_alone_and_a_user_says_its_rate(
    tmp_path: Path, layout: str
):
    other = written(tmp_path, layout).rename(tmp_path / "noname.dat")
    claimed = [read.__name__ for is_this, read in EXPORTS if is_this(start_of(other))]
    assert claimed[:1] == [f"read_{layout}"]
    assert list(read(other).signals) == list(TRACKS)
    signal = read(other, ReadOptions(fps=240)).signals["Ball 1"]
    assert signal.rate_hz == pytest.approx(240, rel=1e-6)


@every_layout
@pytest.mark.parametrize("fraction", [0.02, 0.05, 0.1, 0.2, 0.37, 0.5, 0.731, 0.9, 0.99])
def test_a_file_cut_short_is_read_as_far_as_it_goes(tmp_path: Path, layout: str, fraction: float):
    path = written(tmp_path, layout)
    whole, data = read(path).signals, path.read_bytes()
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


def line(number: int, text: str) -> Callable[[str], str]:
    """Puts a text in the place of a line."""

    def changed(whole: str) -> str:
        lines = whole.splitlines()
        return "\n".join([*lines[:number], text, *lines[number + 1 :]]) + "\n"

    return changed


def without(*numbers: int) -> Callable[[str], str]:
    return lambda whole: "\n".join(
        one for at, one in enumerate(whole.splitlines()) if at not in numbers
    )


def with_timecode(whole: str) -> str:
    lines = whole.splitlines()
    cells = [one.split(",") for one in lines[2:]]
    for at, row in enumerate(cells):
        row.insert(2, "" if at < 4 else "Timecode" if at == 4 else "01:02:03:04")
    return "\n".join([*lines[:2], *(",".join(row) for row in cells)]) + "\n"


def rounded(whole: str) -> str:
    """Times of three digits."""
    lines = whole.splitlines()
    rows = [one.split("\t") for one in lines[6:]]
    cut = ["\t".join([row[0], f"{float(row[1]):.3f}", *row[2:]]) for row in rows]
    return "\n".join([*lines[:6], *cut]) + "\n"


def unseen_as(word: str) -> Callable[[str], str]:
    def changed(whole: str) -> str:
        text = whole.replace("\t\t\t", f"\t{word}\t{word}\t")
        text = line(3, "Frame#\tTime\tBall 1\t\t\tOther\t\t")(text)
        return line(4, "\t\tX1\tY1\tZ1\tX2\tY2\tZ2")(text)

    return changed


def decimal_commas(whole: str) -> str:
    return whole.replace(",", ";").replace("\t", ";").replace(".", ",")


MODEL = "\n\nModel Outputs\n120\n,,Arm:Angle,,\nFrame,Sub Frame,X,Y,Z\n,,deg,deg,deg\n"
NO_CHANGE: list[tuple[str, Callable[[str], str | bytes]]] = [
    *((layout, lambda whole: whole.replace("\n", "\r\n").encode("utf-8-sig")) for layout in TEXTS),
    *((layout, lambda whole: whole.encode("utf-16")) for layout in TEXTS),
    *((layout, decimal_commas) for layout in ("motive", "nexus", "trc")),
    ("motive", with_timecode),
    ("nexus", lambda whole: f"\n,,,\n{whole}{MODEL}1,0,9,9,9\n2,0,9,9,9\n"),
    ("trc", line(3, "Frame#\tTime\t\tBall 1\t\t\tOther\t\t")),
    ("trc", line(3, "Frame#\tTime\tBall 1\tOther")),
    ("trc", line(3, "Frame#\tTime\tBall 1\t\t\tOther\t\t\t\t\t\t\t\t")),
    ("trc", line(4, "\t\t\tX1\tY1\tZ1\tX2\tY2\tZ2")),
    ("trc", line(4, "X1\tY1\tZ1\tX2\tY2\tZ2")),
    ("trc", without(5)),
    ("trc", without(4, 5)),
    *(("trc", unseen_as(word)) for word in ("NaN", "nan", "Nan", "NAN", "nAn", " ", "0")),
    ("trc", rounded),
    ("trc", lambda whole: whole.replace("120.00", "60.00", 3)),  # times that are not even: believed
]


@pytest.mark.parametrize(("layout", "change"), NO_CHANGE)
def test_what_changes_nothing(tmp_path: Path, layout: str, change: Callable[[str], str | bytes]):
    path = written(tmp_path, layout)
    whole = read(path).signals
    changed = change(path.read_text())
    path.write_bytes(changed if isinstance(changed, bytes) else changed.encode())
    episode = read(path)
    assert list(episode.signals) == list(TRACKS)
    assert episode.losses == ()
    for name, signal in episode.signals.items():
        np.testing.assert_allclose(signal.values, whole[name].values, atol=1e-6)
        np.testing.assert_allclose(signal.stamps_ns, whole[name].stamps_ns, atol=1000)
    if MODEL in str(changed):
        assert "'model outputs'" in skipped(episode)["Arm:Angle"]


@pytest.mark.parametrize("layout", TEXTS)
def test_a_cell_that_is_no_number_is_left_out_and_said(tmp_path: Path, layout: str):
    path = written(tmp_path, layout)
    lines = path.read_text().splitlines()
    mark = "\t" if layout in ("qualisys", "trc") else ","
    cells = lines[-30].split(mark)
    place = max(index for index, cell in enumerate(cells) if cell)
    cells[place - (layout == "motive")] = "lost"  # the last is an error, which is not read
    path.write_text("\n".join([*lines[:-30], mark.join(cells), *lines[-29:]]) + "\n")
    episode = read(path)
    assert len(episode.signals["Other"].stamps_ns) == np.isfinite(OTHER[:, 0]).sum() - 1
    assert len(episode.signals["Ball 1"].stamps_ns) == SEEN.sum()
    assert any("1 of 240 rows" in loss for loss in episode.losses)


@every_layout
def test_what_was_never_seen_is_listed_and_names_that_stand_twice_stay_apart(
    tmp_path: Path, layout: str, command: Command
):
    path = written(tmp_path, layout, {"Ball": BALL, "Ghost": np.full_like(BALL, np.nan)})
    assert list(read(path).signals) == ["Ball"]
    assert skipped(read(path))["Ghost"] == "was never seen"
    path = written(tmp_path, layout, {"AAAA": BALL, "BBBB": OTHER})
    path.write_bytes(path.read_bytes().replace(b"BBBB", b"AAAA"))
    signals = read(path).signals
    assert list(signals) == ["AAAA", "AAAA (2)"]
    assert np.ptp(signals["AAAA"].values[0] - signals["AAAA (2)"].values[0]) > 0
    done = command("tunenet-logs", "info", path)
    assert done.returncode == 0
    used = [one for one in done.stdout.splitlines() if one.endswith("yes")]
    assert all(any(name in one for one in used) for name in signals)


@pytest.mark.parametrize(
    ("layout", "old", "new", "says"),
    [
        ("motive", "Position", "Rotation", "OptiTrack Motive export without a position"),
        ("motive", "Frame,Time", f"Frame{',X' * 6000},Time", "over the limit of 5000"),
        ("motive", "", "3", "no row that begins with Frame; copy or export it again"),
        ("nexus", "Trajectories", "Model Outputs", "Vicon Nexus export without traj.* .*Ball 1"),
        ("qualisys", "INCLUDED\t3D", "INCLUDED\t2D", "Qualisys QTM .* of 2D data.*export it as 3D"),
        ("trc", "", "2", "TRC file of markers that names no marker"),
    ],
)
def test_refusals(tmp_path: Path, layout: str, old: str, new: str, says: str):
    path = written(tmp_path, layout)
    whole = path.read_text()
    if old:
        path.write_text(whole.replace(old, new))
    else:
        path.write_text("\n".join(whole.splitlines()[: int(new)]) + "\n")
    with pytest.raises(LogError, match=says) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_motives_markers_follow_their_bodies_and_its_unit_is_what_it_names(tmp_path: Path):
    markers = {"Ball 1:Marker1": OTHER, "Hip": BALL}
    path = written(tmp_path, "motive", markers=markers, unlabeled={"Unlabeled 1234": OTHER})
    text = path.read_text()
    assert list(read(path).signals) == [*TRACKS, *markers, "Unlabeled 1234"]
    for named, unit in (("Meters", "m"), ("Centimeters", "m"), ("Parsecs", UNSTATED)):
        path.write_text(text.replace("Length Units,Meters", f"Length Units,{named}"))
        assert read(path).signals["Ball 1"].unit == unit
    path.write_text(text.replace("Marker,Marker,Marker", "Bone,Bone,Bone"))
    assert "skeleton" in skipped(read(path))["Hip"]
    local = text.replace("Space,Global", "Space,Local")
    path.write_text(local.replace("Marker,Marker,Marker", ",".join(["Rigid Body Marker"] * 3)))
    assert "Global" in skipped(read(path))["Hip"]


def test_of_hundreds_of_unlabeled_markers_those_seen_most_are_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    unlabeled = {}
    for number in range(150):
        xyz = np.full_like(BALL, np.nan)
        xyz[number : 2 * number + 1] = 1.0
        unlabeled[f"Unlabeled {number}"] = xyz
    path = written(tmp_path, "motive", {"Ball": BALL}, unlabeled=unlabeled)
    episode = read(path)
    assert len(episode.signals) == 101
    assert "Unlabeled 10" not in episode.signals
    assert "Unlabeled 100" in episode.signals
    assert "of 150 unlabeled markers" in skipped(episode)["Unlabeled 10"]
    monkeypatch.setattr("tunenet_logs.formats.readers.mocap.MAX_PLACES", 100)
    with pytest.raises(LogError, match="export fewer markers or a part of the take"):
        read(path)


NEXUS = "Trajectories\n100\n,,Ball,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n"
FAST = NEXUS.replace("Ball,,", "Ball,,,,,").replace("X,Y,Z", "X,Y,Z,X',Y',Z'")
EARLY = 'Title\nDate:\nNotes:,""\n\nTRAJECTORIES\n100,Hz\n,LFHD,,,LAnkleAngles,,,\nField #' + (
    ",X,Y,Z,X,Y,Z\n"
)


@pytest.mark.parametrize(
    ("head", "row", "name", "unit", "step_ns"),
    [
        (NEXUS, "{0},0,1,2,3\n{0},1,1,2,3", "Ball", "m", 5_000_000),  # sub frames part frames
        (FAST.replace("mm\n", "mm,mm/s,mm/s,mm/s\n"), "{0},0,1,2,3,7,8,9", "Ball", "m", 10_000_000),
        (EARLY, "{0},1,2,3,7,8,9", "LFHD", UNSTATED, 10_000_000),
    ],
    ids=["sub frames", "velocities", "early version"],
)
def test_nexus_by_hand(tmp_path: Path, head: str, row: str, name: str, unit: str, step_ns: int):
    path = tmp_path / "take.csv"
    path.write_text(head + "\n".join(row.format(frame) for frame in range(1, 20)) + "\n")
    episode = read(path)
    (signal,) = episode.signals.values()
    assert (signal.name, signal.unit) == (name, unit)
    assert set(np.diff(signal.stamps_ns)) == {step_ns}
    scale = 0.001 if unit == "m" else 1
    np.testing.assert_allclose(signal.values[0], np.array([1, 2, 3]) * scale)
    if name == "LFHD":
        assert "model" in skipped(episode)["LAnkleAngles"]


def test_zeros_are_how_nexus_may_write_the_unseen_and_a_strange_line_ends_it(tmp_path: Path):
    path = tmp_path / "take.csv"
    rows = [f"{frame},0,{'0,0,0' if frame % 2 else '0,0,5'}\n" for frame in range(1, 20)]
    path.write_text(NEXUS + "".join(rows))
    assert set(np.diff(read(path).signals["Ball"].stamps_ns)) == {20_000_000}
    path = written(tmp_path, "nexus", subject="Daphne")
    assert list(read(path).signals) == ["Daphne:Ball 1", "Daphne:Other"]
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:50], "pause", *lines[50:]]) + "\n")
    assert "no row ends it after 45 frames" in read(path).losses[0]


def test_qualisys_may_name_neither_rate_nor_markers(tmp_path: Path):
    path = written(tmp_path, "qualisys", has_columns=False)
    text = path.read_text()
    path.write_text(text.replace("FREQUENCY\t120", "FREQUENCY\tEXT", 1))
    assert read(path).signals["Ball 1"].counts_frames
    lines = text.splitlines()
    path.write_text("\n".join(one for one in lines if not one.startswith("MARKER_N")) + "\n")
    assert list(read(path).signals) == ["marker 1", "marker 2"]


def assert_as_ezc3d(path: Path) -> None:
    theirs = pytest.importorskip("ezc3d").c3d(str(path))
    for at, name in enumerate(theirs["parameters"]["POINT"]["LABELS"]["value"]):
        xyz = theirs["data"]["points"][:3, at].T * 0.001
        found = read(path).signals[name].values
        np.testing.assert_allclose(found, xyz[np.isfinite(xyz[:, 0])], atol=1e-6)


@pytest.mark.parametrize("processor", ["intel", "dec"])
@pytest.mark.parametrize("is_float", [True, False])
def test_another_reader_sees_the_same_in_c3d(tmp_path: Path, processor: str, is_float: bool):
    assert_as_ezc3d(written(tmp_path, "c3d", processor=processor, is_float=is_float, analogs=2))


def test_c3ds_points_of_models_are_no_positions(tmp_path: Path):
    path = written(tmp_path, "c3d")
    data = path.read_bytes()
    path.write_bytes(data.replace(b"UNITS", b"FORCE").replace(b"mm", b"AA"))
    assert read(path).signals["Ball 1"].unit == ""
    text = struct.pack("<bb", 6, 1) + b"FORCES" + struct.pack("<HbBBB", 12, -1, 2, 5, 1)
    at = data.index(struct.pack("<bb", 6, -2) + b"ANALOG")
    path.write_bytes(data[:at] + text + b"Other\0" + data[at : 1024 - 19] + data[1024:])
    episode = read(path)
    assert list(episode.signals) == ["Ball 1"]
    assert "model" in skipped(episode)["Other"]


def test_c3ds_sizes_are_checked(tmp_path: Path):
    path = written(tmp_path, "c3d")
    whole = path.read_bytes()
    for at, value in ((2, 0xFFFF), (2, 0), (4, 0xFFFF), (8, 0xFFFE), (16, 0xFFFF), (6, 0xFFFF)):
        path.write_bytes(whole[:at] + struct.pack("<H", value) + whole[at + 2 :])
        found = outcome(path)
        said = found if isinstance(found, str) else " ".join(found.losses) or "read"
        assert said == "read" or "C3D" in said or "it is cut" in said
    path.write_bytes(whole[:512])
    with pytest.raises(LogError, match="C3D file that ends before its parameters"):
        read(path)
    seconds = np.arange(70_000) / RATE_HZ  # more frames than the header counts
    xyz = np.column_stack([seconds + 1, seconds + 2, seconds + 3])
    episode = read(written(tmp_path, "c3d", {"Ball": xyz}, seconds, unit="m"))
    assert len(episode.signals["Ball"].stamps_ns) in range(70_000, 70_032)
    assert episode.losses == ()


@pytest.mark.parametrize(
    ("name", "signals", "of", "loss"),
    [
        ("motive_basketball_10.csv", 11, ("Ball_10", 5130, "m"), ""),
        ("nexus_markers.csv", 51, ("boite:gauche_ext", None, "m"), ""),
        ("markers.trc", 51, None, "93 of the 652 frames"),
        ("markers_analogs.c3d", 51, None, None),
        ("motive_sample.csv", None, ("Unlabeled:108", None, "m"), ""),
    ],
)
def test_takes_of_laboratories(name: str, signals: int | None, of: Any, loss: str | None):
    path = real(f"labs/{name}")
    episode = read(path)
    assert signals in (None, len(episode.signals))
    if loss is not None:
        assert loss in " ".join(episode.losses)
        assert bool(loss) == bool(episode.losses)
    if of is not None:
        signal = episode.signals[of[0]]
        assert (signal.unit, of[1]) in ((of[2], None), (of[2], len(signal.stamps_ns)))
        assert correct_late_stamps(signal.stamps_ns).warnings("samples") == []
    if name.endswith(".c3d"):
        assert_as_ezc3d(path)
    if name == "motive_sample.csv":
        assert list(episode.signals)[:2] == ["Rigid Body 1", "Rigid Body 1_1"]
        assert skipped(episode)["Unlabeled:105"] == "was never seen"
