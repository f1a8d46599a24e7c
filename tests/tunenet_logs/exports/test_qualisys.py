"""Qualisys QTM: markers, rigid bodies, with and without names of columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.export_writers import write_qualisys
from tests.tunenet_logs.exports.tracks import BALL, RATE_HZ, SECONDS, TRACKS, read
from tunenet_logs.episode import UNSTATED
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions

SEEN = np.isfinite(BALL[:, 0])


def take(folder: Path, **options: object) -> Path:
    path = folder / "take.tsv"
    write_qualisys(path, SECONDS, TRACKS, rate_hz=RATE_HZ, **options)  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize("unseen", ["", "0.000", "NULL"])
@pytest.mark.parametrize("has_columns", [True, False])
@pytest.mark.parametrize("bodies", [True, False])
def test_markers_and_bodies(tmp_path: Path, unseen: str, has_columns: bool, bodies: bool):
    path = take(tmp_path, unseen=unseen, has_columns=has_columns, bodies=bodies)
    episode = read(path)
    assert list(episode.signals) == list(TRACKS)
    ball = episode.signals["Ball 1"]
    assert ball.unit == UNSTATED
    np.testing.assert_allclose(ball.values, 1000 * BALL[SEEN], atol=6e-4)
    np.testing.assert_allclose(ball.seconds, SECONDS[SEEN], atol=1e-9)
    assert episode.losses == ()


def test_a_user_says_the_unit(tmp_path: Path):
    ball = read(take(tmp_path), ReadOptions(length_unit="mm")).signals["Ball 1"]
    assert ball.unit == "m"
    np.testing.assert_allclose(ball.values, BALL[SEEN], atol=1e-6)


def test_an_outer_clock_leaves_frames_to_be_counted(tmp_path: Path):
    path = take(tmp_path, has_columns=False)
    path.write_text(path.read_text().replace("FREQUENCY\t120", "FREQUENCY\tEXT", 1))
    assert read(path).signals["Ball 1"].counts_frames


def test_what_single_cameras_saw_is_refused(tmp_path: Path):
    path = take(tmp_path)
    path.write_text(path.read_text().replace("INCLUDED\t3D", "INCLUDED\t2D"))
    with pytest.raises(LogError, match=r"Qualisys QTM export of 2D data.*export it as 3D"):
        read(path)


def test_names_may_be_lost(tmp_path: Path):
    path = take(tmp_path, has_columns=False)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(line for line in lines if not line.startswith("MARKER_N")) + "\n")
    assert list(read(path).signals) == ["marker 1", "marker 2"]
