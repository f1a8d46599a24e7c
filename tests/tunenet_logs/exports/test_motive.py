"""OptiTrack Motive: bodies, markers, versions of the format."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import real
from tests.export_writers import write_motive
from tests.tunenet_logs.exports.tracks import BALL, OTHER, RATE_HZ, SECONDS, read, skipped
from tunenet_logs.episode import UNSTATED
from tunenet_logs.errors import LogError
from tunenet_logs.timing.arrivals import correct_late_stamps


def take(folder: Path, version: str = "1.23", **options: object) -> Path:
    path = folder / "take.csv"
    write_motive(path, SECONDS, {"Ball_10": BALL}, rate_hz=RATE_HZ, version=version, **options)  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize("version", ["1.1", "1.21", "1.23", "1.24", "1.25"])
def test_bodies_come_before_their_markers(tmp_path: Path, version: str):
    markers = {"Ball_10:Marker1": OTHER, "Ball_10:Marker2": BALL}
    path = take(tmp_path, version, markers=markers, unlabeled={"Unlabeled 1234": OTHER})
    episode = read(path)
    names = ["Ball_10", "Ball_10:Marker1", "Ball_10:Marker2", "Unlabeled 1234"]
    assert list(episode.signals) == names
    unused = skipped(episode)
    assert "rotation" in unused["Ball_10 rotation"]
    assert "not used" in unused["Ball_10 mean marker error"]
    assert episode.info.source == "OptiTrack Motive export take.csv"


def test_a_timecode_may_stand_before_the_columns(tmp_path: Path):
    path = take(tmp_path)
    lines = path.read_text().splitlines()
    cells = [line.split(",") for line in lines[2:]]
    for row in cells:
        row.insert(2, "")
    cells[4][2] = "Timecode"
    for row in cells[5:]:
        row[2] = "01:02:03:04"
    path.write_text("\n".join([*lines[:2], *(",".join(row) for row in cells)]) + "\n")
    np.testing.assert_allclose(read(path).signals["Ball_10"].values[0, 1], BALL[0, 2], atol=1e-6)


@pytest.mark.parametrize(
    ("named", "unit"), [("Meters", "m"), ("Centimeters", "m"), ("Parsecs", UNSTATED)]
)
def test_the_unit_is_the_one_that_it_names(tmp_path: Path, named: str, unit: str):
    path = take(tmp_path)
    path.write_text(path.read_text().replace("Length Units,Meters", f"Length Units,{named}"))
    assert read(path).signals["Ball_10"].unit == unit


def test_of_hundreds_of_unlabeled_markers_those_seen_most_are_used(tmp_path: Path):
    unlabeled = {}
    for number in range(150):
        xyz = np.full_like(BALL, np.nan)
        xyz[number : 2 * number + 1] = 1.0
        unlabeled[f"Unlabeled {number}"] = xyz
    episode = read(take(tmp_path, unlabeled=unlabeled))
    assert len(episode.signals) == 101
    assert "Unlabeled 10" not in episode.signals
    assert "Unlabeled 100" in episode.signals
    assert "of 150 unlabeled markers" in skipped(episode)["Unlabeled 10"]


def test_bones_and_what_is_local_are_not_used(tmp_path: Path):
    path = take(tmp_path, markers={"Hip": OTHER})
    text = path.read_text()
    path.write_text(text.replace("Marker,Marker,Marker", "Bone,Bone,Bone"))
    assert "skeleton" in skipped(read(path))["Hip"]
    local = text.replace("Space,Global", "Space,Local")
    path.write_text(local.replace("Marker,Marker,Marker", ",".join(["Rigid Body Marker"] * 3)))
    assert "Global" in skipped(read(path))["Hip"]


def test_rotations_alone_are_refused(tmp_path: Path):
    path = take(tmp_path)
    path.write_text(path.read_text().replace("Position", "Rotation"))
    with pytest.raises(LogError, match="OptiTrack Motive export without a position"):
        read(path)


def test_a_header_alone_is_refused(tmp_path: Path):
    path = take(tmp_path)
    path.write_text("\n".join(path.read_text().splitlines()[:3]))
    with pytest.raises(LogError, match="no row that begins with Frame; copy or export it again"):
        read(path)


def test_too_many_columns_are_refused(tmp_path: Path):
    path = take(tmp_path)
    path.write_text(path.read_text().replace("Frame,Time", f"Frame{',X' * 6000},Time"))
    with pytest.raises(LogError, match="over the limit of 5000"):
        read(path)


def test_more_numbers_than_are_held_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tunenet_logs.formats.readers.mocap.MAX_PLACES", 100)
    with pytest.raises(LogError, match="export fewer markers or a part of the take"):
        read(take(tmp_path))


def test_a_basketball_of_a_laboratory():
    episode = read(real("labs/motive_basketball_10.csv"))
    ball = episode.signals["Ball_10"]
    assert len(ball.stamps_ns) == 5130
    assert ball.unit == "m"
    assert len(episode.signals) == 11
    assert correct_late_stamps(ball.stamps_ns).warnings("samples") == []


def test_a_take_of_bodies_and_unlabeled_markers():
    episode = read(real("labs/motive_sample.csv"))
    assert list(episode.signals)[:2] == ["Rigid Body 1", "Rigid Body 1_1"]
    assert "Unlabeled:108" in episode.signals
    assert skipped(episode)["Unlabeled:105"] == "was never seen"
    assert episode.losses == ()
