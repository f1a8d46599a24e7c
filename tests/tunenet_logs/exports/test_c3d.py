"""C3D files: processors, kinds of numbers, sizes that lie."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import real
from tests.export_writers import write_c3d
from tests.tunenet_logs.exports.tracks import BALL, RATE_HZ, SECONDS, TRACKS, read, skipped
from tunenet_logs.errors import LogError

SEEN = np.isfinite(BALL[:, 0])


def take(folder: Path, **options: object) -> Path:
    path = folder / "take.c3d"
    write_c3d(path, SECONDS, TRACKS, rate_hz=RATE_HZ, **options)  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize("processor", ["intel", "dec", "mips"])
@pytest.mark.parametrize("is_float", [True, False])
@pytest.mark.parametrize("analogs", [0, 3])
def test_processors_and_kinds_of_numbers(
    tmp_path: Path, processor: str, is_float: bool, analogs: int
):
    episode = read(take(tmp_path, processor=processor, is_float=is_float, analogs=analogs))
    ball = episode.signals["Ball 1"]
    np.testing.assert_allclose(ball.values, BALL[SEEN], atol=1e-6 if is_float else 6e-5)
    np.testing.assert_allclose(ball.seconds, SECONDS[SEEN] - SECONDS[SEEN][0], atol=2e-9)
    assert len(skipped(episode)) == analogs
    assert episode.losses == ()


@pytest.mark.parametrize("processor", ["intel", "dec"])
@pytest.mark.parametrize("is_float", [True, False])
def test_another_reader_sees_the_same(tmp_path: Path, processor: str, is_float: bool):
    ezc3d = pytest.importorskip("ezc3d")
    path = take(tmp_path, processor=processor, is_float=is_float, analogs=2)
    assert_same(path, ezc3d.c3d(str(path)))


def test_a_file_of_a_laboratory_is_what_another_reader_sees():
    path = real("labs/markers_analogs.c3d")
    ezc3d = pytest.importorskip("ezc3d")
    assert len(read(path).signals) == 51
    assert_same(path, ezc3d.c3d(str(path)))


def assert_same(path: Path, theirs) -> None:
    signals = read(path).signals
    points = theirs["data"]["points"]
    for at, name in enumerate(theirs["parameters"]["POINT"]["LABELS"]["value"]):
        xyz = points[:3, at].T * 0.001
        np.testing.assert_allclose(signals[name].values, xyz[np.isfinite(xyz[:, 0])], atol=1e-6)


def test_points_of_models_are_no_positions(tmp_path: Path):
    path = take(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"UNITS", b"FORCE").replace(b"mm", b"AA"))
    assert read(path).signals["Ball 1"].unit == ""
    text = struct.pack("<bb", 6, 1) + b"FORCES" + struct.pack("<HbBBB", 12, -1, 2, 5, 1)
    assert b"ANALOG" in data
    at = data.index(struct.pack("<bb", 6, -2) + b"ANALOG")
    path.write_bytes(data[:at] + text + b"Other\0" + data[at : 1024 - 19] + data[1024:])
    episode = read(path)
    assert list(episode.signals) == ["Ball 1"]
    assert "model" in skipped(episode)["Other"]


@pytest.mark.parametrize(
    ("at", "value"),
    [(2, 0xFFFF), (2, 0), (4, 0xFFFF), (8, 0xFFFE), (16, 0xFFFF), (6, 0xFFFF)],
)
def test_sizes_that_lie_are_bounded(tmp_path: Path, at: int, value: int):
    path = take(tmp_path)
    data = bytearray(path.read_bytes())
    data[at : at + 2] = struct.pack("<H", value)
    path.write_bytes(data)
    try:
        episode = read(path)
    except LogError as error:
        said = str(error)
    else:
        said = " ".join(episode.losses) or "read"
    assert said == "read" or "C3D" in said or "it is cut" in said


def test_a_header_alone_is_refused(tmp_path: Path):
    path = take(tmp_path)
    path.write_bytes(path.read_bytes()[:512])
    with pytest.raises(LogError, match="C3D file that ends before its parameters"):
        read(path)


def test_more_frames_than_the_header_counts(tmp_path: Path):
    path = tmp_path / "take.c3d"
    seconds = np.arange(70_000) / RATE_HZ
    xyz = np.column_stack([seconds + 1, seconds + 2, seconds + 3])
    write_c3d(path, seconds, {"Ball": xyz}, rate_hz=RATE_HZ, unit="m")
    episode = read(path)
    assert len(episode.signals["Ball"].stamps_ns) in range(70_000, 70_032)
    assert episode.losses == ()
