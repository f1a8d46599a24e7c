"""Folders of ROS 2 bags: one recording in the order of its files, or a refusal that says why."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from tests.conftest import Command, real, record
from tests.strangers import Stranger, write_poses, write_poses_folder
from tunenet_logs.errors import LogError
from tunenet_logs.formats.base import Loss, RawMessage, one_by_one
from tunenet_logs.formats.registry import read_folder
from tunenet_logs.reader import read_episode

TOPIC = "/vrpn/thing/pose"
SAMPLES = Stranger(0.6).samples()
SUFFIXES = {StoragePlugin.SQLITE3: ".db3", StoragePlugin.MCAP: ".mcap"}


def split(folder: Path, storage: StoragePlugin, numbers: tuple[int, ...] = (9, 10, 11)) -> Path:
    """A bag in several files, the last written first."""
    folder.mkdir()
    parts = np.array_split(np.arange(len(SAMPLES[0])), len(numbers))
    for number, part in reversed(list(zip(numbers, parts, strict=True))):
        whole = folder.with_name(f"{folder.name}_part{number}")
        file = write_poses_folder(whole, SAMPLES[0][part], SAMPLES[1][part], TOPIC, storage)
        file.rename(folder / f"lab_drop_{number}{file.suffix}")
    (folder / "metadata.yaml").write_text("not: [believed")
    return folder


@pytest.mark.parametrize("storage", list(StoragePlugin))
@pytest.mark.parametrize("is_split", [False, True])
def test_it_gives_the_episode_that_the_mcap_gives(
    tmp_path: Path, storage: StoragePlugin, is_split: bool
):
    write_poses(tmp_path / "a.mcap", *SAMPLES, TOPIC)
    truth = read_episode(tmp_path / "a.mcap").signals[TOPIC]
    folder = tmp_path / "bag"
    if is_split:
        split(folder, storage)
    else:
        write_poses_folder(folder, *SAMPLES, TOPIC, storage)
    episode = read_episode(folder)
    assert np.array_equal(episode.signals[TOPIC].values, truth.values)
    assert np.array_equal(episode.signals[TOPIC].stamps_ns, truth.stamps_ns)
    assert len(episode.channels) == 1
    assert not episode.losses
    assert len(episode.warnings) == 1


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_files_come_in_the_order_of_their_numbers(tmp_path: Path, storage: StoragePlugin):
    records = one_by_one(read_folder(split(tmp_path / "bag", storage), []))
    stamps = [one.log_ns for one in records if isinstance(one, RawMessage)]
    assert stamps == list(SAMPLES[0])


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_a_damaged_file_is_named_and_the_others_read(tmp_path: Path, storage: StoragePlugin):
    folder = split(tmp_path / "bag", storage, (0, 1, 2, 3))
    files = [folder / f"lab_drop_{number}{SUFFIXES[storage]}" for number in range(4)]
    files[1].write_bytes(files[1].read_bytes()[:-3000])
    files[2].write_bytes(b"something else")
    files[3].write_bytes(b"")  # what a killed recorder left of a file that it had just begun
    losses: list[Loss] = []
    found = [one for one in one_by_one(read_folder(folder, losses)) if isinstance(one, RawMessage)]
    assert len(found) >= len(SAMPLES[0]) // 4
    lost = {one.file for one in losses if not one.harmless}
    assert lost == {one.name for one in files[1:]}
    assert any(str(one).startswith(f"{files[3].name}: is empty") for one in losses)
    assert sum(one.harmless for one in losses) == 1


def test_files_that_are_all_unreadable_are_one_error(tmp_path: Path):
    (tmp_path / "a_0.mcap").write_bytes(b"x")
    (tmp_path / "a_1.mcap").write_bytes(b"")
    with pytest.raises(LogError, match=r"no file in it can be read: a_0.mcap is no .mcap file"):
        read_episode(tmp_path)


def test_without_its_metadata_it_says_what_it_took_for_one(tmp_path: Path):
    folder = split(tmp_path / "bag", StoragePlugin.MCAP)
    (folder / "metadata.yaml").unlink()
    episode = read_episode(folder)
    assert not episode.losses
    assert any("lab_drop_9.mcap to lab_drop_11.mcap" in one for one in episode.warnings)


@pytest.mark.parametrize(
    "names",
    [
        ("a_0.mcap", "b_1.mcap"),
        ("a_0.mcap", "a_0.db3"),
        ("red1.mcap", "red2.mcap"),
        ("a.mcap", "a_1.mcap"),
    ],
)
def test_a_folder_of_several_recordings_is_refused(tmp_path: Path, names: tuple[str, str]):
    for name in names:
        (tmp_path / name).write_bytes(b"x")
    with pytest.raises(LogError, match=r"several recordings \(.*name one of them"):
        read_episode(tmp_path)


def test_a_folder_of_our_own_recordings_is_refused_whatever_their_names(tmp_path: Path):
    for number in range(2):
        record(tmp_path / f"drop_{number}.mcap", restitution=0.5, height_m=0.5, seconds=0.5)
    with pytest.raises(LogError, match="several recordings"):
        read_episode(tmp_path)


@pytest.mark.parametrize("names", [(), ("a.txt", "._x_0.db3", "b.bag")])
def test_a_folder_of_something_else_says_what_was_expected(tmp_path: Path, names: tuple[str, ...]):
    for name in names:
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "folder.mcap").mkdir()
    with pytest.raises(LogError, match=r"is a directory without .*\.db3, \.mcap.*name a log file"):
        read_episode(tmp_path)


def test_splits_by_others_read_as_one(tmp_path: Path):
    """Files of rosbag2's own tests, as its writer left them."""
    counts = []
    for number in range(5):
        name = f"py_wbag_wbag_{number}.mcap"
        path = real(f"mcap_rosbag2/{name}")
        (tmp_path / name).write_bytes(path.read_bytes())
        counts.append(sum(one.messages for one in read_episode(path).channels))
    episode = read_episode(tmp_path)
    assert sum(one.messages for one in episode.channels) == sum(counts) > 0


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_the_commands_take_a_folder(command: Command, tmp_path: Path, storage: StoragePlugin):
    folder = split(tmp_path / "lab.drop", storage)
    before = sorted(folder.iterdir())
    result = command("tunenet-logs", "info", f"{folder}/")
    assert result.returncode == 0, result.stderr
    size = sum(one.stat().st_size for one in folder.iterdir())
    assert result.stdout.startswith(f"{folder}: {size} bytes, ")
    result = command("tunenet-tune", ".", cwd=folder)
    assert result.returncode == 0, result.stderr
    report = json.loads((tmp_path / "lab.drop.json").read_text())
    assert report["verdict"] == "ok"
    assert (tmp_path / "lab.drop.rrd").exists()
    assert before == sorted(folder.iterdir())


def test_a_part_that_is_missing_is_said(tmp_path: Path):
    folder = split(tmp_path / "bag", StoragePlugin.MCAP, (0, 1, 3, 10))
    [loss] = read_episode(folder).losses
    assert "number 2, 4, 5, 6, 7 are missing" in loss
