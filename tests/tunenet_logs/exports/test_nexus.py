"""Vicon Nexus: sections, frames without times, early versions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import real
from tests.export_writers import write_nexus
from tests.tunenet_logs.exports.tracks import BALL, RATE_HZ, SECONDS, TRACKS, read, skipped
from tunenet_logs.episode import FRAME_NS, UNSTATED
from tunenet_logs.errors import LogError


def take(folder: Path, **options: object) -> Path:
    path = folder / "take.csv"
    write_nexus(path, SECONDS, TRACKS, rate_hz=RATE_HZ, **options)  # type: ignore[arg-type]
    return path


def test_of_the_sections_trajectories_alone_are_used(tmp_path: Path):
    episode = read(take(tmp_path, devices=True, subject="Daphne"))
    assert list(episode.signals) == ["Daphne:Ball 1", "Daphne:Other"]
    assert "'devices'" in skipped(episode)["Force plate - Force"]
    assert episode.losses == ()


def test_sections_may_follow(tmp_path: Path):
    path = take(tmp_path)
    below = "\n\nModel Outputs\n120\n,,Arm:Angle,,\nFrame,Sub Frame,X,Y,Z\n,,deg,deg,deg\n"
    path.write_text("\n,,,\n" + path.read_text() + below + "1,0,9,9,9\n2,0,9,9,9\n")
    episode = read(path)
    assert len(episode.signals["Ball 1"].stamps_ns) == np.isfinite(BALL[:, 0]).sum()
    assert "'model outputs'" in skipped(episode)["Arm:Angle"]


def test_a_line_among_the_rows_that_is_none_is_said(tmp_path: Path):
    path = take(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:50], "pause", *lines[50:]]) + "\n")
    assert "no row ends it after 45 frames" in read(path).losses[0]


def test_without_trajectories_it_is_refused(tmp_path: Path):
    path = take(tmp_path)
    path.write_text(path.read_text().replace("Trajectories", "Model Outputs"))
    with pytest.raises(LogError, match=r"Vicon Nexus export without trajectories .*Ball 1"):
        read(path)


def test_frames_are_parted_by_sub_frames(tmp_path: Path):
    path = tmp_path / "take.csv"
    rows = [f"{frame},{sub},1,2,{3 + frame}" for frame in range(1, 20) for sub in range(2)]
    head = ["Trajectories", "100", ",,Ball,,", "Frame,Sub Frame,X,Y,Z", ",,mm,mm,mm"]
    path.write_text("\n".join([*head, *rows]) + "\n")
    assert set(np.diff(read(path).signals["Ball"].stamps_ns)) == {5_000_000}


def test_velocities_beside_positions_are_not_used(tmp_path: Path):
    path = tmp_path / "take.csv"
    head = ["Trajectories", "100", ",,Ball,,,,,", "Frame,Sub Frame,X,Y,Z,X',Y',Z'"]
    head += [",,mm,mm,mm,mm/s,mm/s,mm/s"]
    rows = [f"{frame},0,1,2,3,7,8,9" for frame in range(1, 20)]
    path.write_text("\n".join([*head, *rows]) + "\n")
    np.testing.assert_allclose(read(path).signals["Ball"].values[0], [0.001, 0.002, 0.003])


def test_an_early_version_names_no_unit(tmp_path: Path):
    path = tmp_path / "take.csv"
    head = ["Title", "Date:", 'Notes:,""', "", "TRAJECTORIES", "100,Hz"]
    head += [",LFHD,,,LAnkleAngles,,,", "Field #,X,Y,Z,X,Y,Z"]
    rows = [f"{frame},1,2,3,7,8,9" for frame in range(1, 20)]
    path.write_text("\n".join([*head, *rows]) + "\n")
    episode = read(path)
    assert list(episode.signals) == ["LFHD"]
    assert episode.signals["LFHD"].unit == UNSTATED
    assert len(episode.signals["LFHD"].stamps_ns) == 19
    assert "model" in skipped(episode)["LAnkleAngles"]


def test_zeros_are_how_some_write_what_was_not_seen(tmp_path: Path):
    path = tmp_path / "take.csv"
    head = ["Trajectories", "100", ",,Ball,,", "Frame,Sub Frame,X,Y,Z", ",,mm,mm,mm"]
    rows = [f"{frame},0,{'0,0,0' if frame % 2 else '0,0,5'}" for frame in range(1, 20)]
    path.write_text("\n".join([*head, *rows]) + "\n")
    signal = read(path).signals["Ball"]
    assert set(np.diff(signal.stamps_ns)) == {20_000_000}
    assert FRAME_NS not in np.diff(signal.stamps_ns)


def test_a_take_of_a_laboratory():
    episode = read(real("labs/nexus_markers.csv"))
    assert len(episode.signals) == 51
    assert episode.signals["boite:gauche_ext"].unit == "m"
    assert episode.losses == ()
