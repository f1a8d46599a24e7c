"""A disk that takes no more ends a recording: what was acknowledged is read back by everyone."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader

from tests.conftest import Command, files_no_larger_than, record
from tests.recorders.contender import OF_OURS
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode
from tunenet_logs.writing.writer import EpisodeWriter, bare_ending

DROP = EpisodeInfo(kind="drop")


def fill(folder: Path, limit: int, *, live: bool, overwrite: bool = False) -> tuple[int, str]:
    """Record until it fails; messages acknowledged before, and what is said.

    Args:
        folder: for a.mcap.
        limit: of the file's size; 0 for the disk's own.
        live: whether the source is.
        overwrite: whether a log there is to be replaced.
    """
    acknowledged = 0

    def write() -> None:
        nonlocal acknowledged
        rng = np.random.default_rng(0)
        with EpisodeWriter(folder / "a.mcap", DROP, live=live, overwrite=overwrite) as writer:
            for index in range(100_000):
                writer.write_pose("/ball/pose", 1 + index, rng.normal(size=3))
                acknowledged = writer.written

    bound = files_no_larger_than(limit) if limit else nullcontext()
    with bound, pytest.raises(LogError) as caught:
        write()
    assert caught.value.exit_code == 1
    assert "\n" not in str(caught.value)
    return acknowledged, str(caught.value)


def heights_in(log: Path, acknowledged: int) -> int:
    """Check a log that ended early with our reader and with others'; its messages."""
    episode = read_episode(log)
    ball = episode.signals.get("/ball/pose")
    values = np.zeros((0, 3)) if ball is None else ball.values
    assert np.array_equal(values, np.random.default_rng(0).normal(size=(len(values), 3)))
    with log.open("rb") as file:
        assert len(list(make_reader(file).iter_messages())) == len(values)
        file.seek(0)
        streamed = NonSeekingReader(file, validate_crcs=True)
        assert len(list(streamed.iter_messages(log_time_order=False))) == len(values)
        file.seek(0)
        summary = make_reader(file).get_summary()
    if summary is not None and summary.statistics is not None:
        assert summary.statistics.message_count == len(values)
    assert len(values) >= acknowledged
    assert not episode.warnings
    return len(values)


@pytest.mark.parametrize("live", [True, False])
@pytest.mark.parametrize("limit", [1200, 4000, 20_000, 60_000, 100_000, 300_001])
def test_a_file_that_may_not_grow(tmp_path: Path, limit: int, live: bool):
    acknowledged, said = fill(tmp_path, limit, live=live)
    [log] = tmp_path.iterdir()
    size = log.stat().st_size
    assert size <= limit
    if live and limit - size < len(bare_ending(0)) and log.name == "a.mcap.active":
        # The clock ends a live one's chunks anywhere, so once in a hundred runs no end fits.
        assert f"; {acknowledged} of " in said
        return
    assert log.name == "a.mcap"
    kept = heights_in(log, acknowledged)
    assert f"; {kept} of " in said
    assert "are kept in a.mcap;" in said
    assert kept > 100 or limit < 50_000  # which holds no whole chunk
    info = read_episode(log).info
    assert info.kind == "drop"
    assert info.counts["written"] == kept
    assert info.counts["captured"] == kept + info.counts["dropped"]
    assert info.counts["dropped"] > 0
    assert info.notes["ended"].startswith("writing failed")


@pytest.mark.parametrize("step", [6007, pytest.param(1571, marks=pytest.mark.slow)])
def test_at_any_size_there_is_one_log_and_it_holds_what_was_acknowledged(tmp_path: Path, step: int):
    forms: set[str] = set()
    for limit in range(1, 66_000, step):
        folder = tmp_path / str(limit)
        folder.mkdir()
        acknowledged, said = fill(folder, limit, live=False)
        names = [one.name for one in folder.iterdir()]
        if "cannot be written" in said:  # not even the beginning fits
            assert not names
        else:
            assert names == ["a.mcap"]
            assert heights_in(folder / "a.mcap", acknowledged) == acknowledged
        forms.add(said.split("(")[0].rpartition(":")[2])
    assert forms == {" cannot be written ", " writing failed "}


def test_where_no_end_fits_or_a_log_was_to_be_replaced_it_stays_active(tmp_path: Path):
    with EpisodeWriter(tmp_path / "a.mcap", DROP, live=False) as writer:
        rng = np.random.default_rng(0)
        while not writer.written:
            writer.write_pose("/ball/pose", 1 + writer.accepted, rng.normal(size=3))
        size = writer.active_path.stat().st_size
    folder = tmp_path / "again"
    folder.mkdir()
    _, said = fill(folder, size + 40, live=False)
    assert "kept in a.mcap.active" in said
    episode = read_episode(folder / "a.mcap.active")
    assert any("end of the file is missing" in warning for warning in episode.warnings)
    (folder / "a.mcap.active").unlink()
    (folder / "a.mcap").write_bytes(OF_OURS + b"the old one")
    acknowledged, said = fill(folder, 100_000, live=True, overwrite=True)
    assert (folder / "a.mcap").read_bytes() == OF_OURS + b"the old one"
    kept = heights_in(folder / "a.mcap.active", acknowledged)
    assert f"{kept} of " in said
    assert "kept in a.mcap.active" in said


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 1 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    words = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    try:
        mounted = subprocess.run(words, capture_output=True, text=True, timeout=20)
    except FileNotFoundError:
        pytest.skip("a full disk needs a small one, and there is no mount command to make it with")
    if mounted.returncode:
        why = mounted.stderr.strip()
        pytest.skip(f"a full disk needs a small one, and only root may mount it ({why})")
    yield folder
    subprocess.run(["umount", str(folder)], check=True, timeout=20)


@pytest.mark.parametrize("live", [True, False])
@pytest.mark.parametrize("taken", [600_000, 900_000, 1_040_000])
def test_a_small_disk(small_disk: Path, live: bool, taken: int):
    (small_disk / "other").write_bytes(bytes(taken))
    acknowledged, said = fill(small_disk, 0, live=live)
    assert "No space left on device" in said
    [left] = [one for one in small_disk.iterdir() if one.name != "other"]
    assert left.name in said
    assert f"; {heights_in(left, acknowledged)} of " in said


def test_too_little_space_ends_it_whole(small_disk: Path):
    log, half = small_disk / "a.mcap", 512 * 1024
    writer = EpisodeWriter(log, DROP, min_free_bytes=half)
    rng = np.random.default_rng(0)
    for index in range(2000):
        writer.write_pose("/ball/pose", 1 + index, rng.normal(size=3))
    (small_disk / "other").write_bytes(bytes(half))

    def wait() -> None:
        while True:
            writer.tick()
            time.sleep(0.01)

    with pytest.raises(LogError, match=r"2000 of 2000 messages are kept in a\.mcap; free some"):
        wait()
    assert heights_in(log, 2000) == 2000
    info = read_episode(log).info
    assert info.counts == {"captured": 2000, "written": 2000, "dropped": 0}
    assert "are to stay free" in info.notes["ended"]
    with pytest.raises(LogError, match="not recorded, the disk has"):
        EpisodeWriter(small_disk / "b.mcap", EpisodeInfo(), min_free_bytes=half)
    assert not (small_disk / "b.mcap.active").exists()


@pytest.mark.parametrize("verb", ["import", "recover"])
@pytest.mark.parametrize("taken", [1_040_000, 1_048_576])
def test_a_copy_on_a_small_disk_leaves_nothing_and_says_what_to_do(
    command: Command, small_disk: Path, tmp_path: Path, verb: str, taken: int
):
    record(tmp_path / "a.mcap", restitution=0.7, height_m=1.0, seconds=8.0, noise_m=0.001)
    (small_disk / "other").write_bytes(bytes(taken))
    result = command("tunenet-logs", verb, "a.mcap", "-o", "disk/b.mcap", cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.startswith("tunenet-logs: disk/b.mcap: ")
    assert "(No space left on device); " in result.stderr
    assert "free some space" in result.stderr
    assert "record again" not in result.stderr
    assert [one.name for one in small_disk.iterdir()] == ["other"]


@pytest.mark.parametrize("source", [("--simulate", "drop"), ("--camera", "a.mp4")])
def test_a_recording_does_not_start_on_a_disk_that_is_nearly_full(
    command: Command, tmp_path: Path, source: tuple[str, str]
):
    from tests.recorders.films import write_video

    write_video(tmp_path / "a.mp4", [0, 10, 20])
    words = ("tunenet-record", *source, "-o", "a.mcap", "--min-free")
    result = command(*words, 999_999_999, cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert " GB left and 1000000 GB are to stay free" in result.stderr
    assert "--min-free" in result.stderr
    assert [one.name for one in tmp_path.iterdir()] == ["a.mp4"]
    allowed = command(*words, 0, cwd=tmp_path)
    assert allowed.returncode == 0, allowed.stderr
