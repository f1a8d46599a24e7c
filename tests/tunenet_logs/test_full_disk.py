"""A disk that takes no more ends a recording: what was acknowledged is read back by everyone."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader

from tests.conftest import Command
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode
from tunenet_logs.writer import EpisodeWriter

CODE = """
import resource, signal, sys, numpy as np
from pathlib import Path
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import LogError
from tunenet_logs.writer import EpisodeWriter
limit, live = int(sys.argv[1]), sys.argv[2] == "live"
if limit:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
rng = np.random.default_rng(0)
acknowledged = 0
try:
    info = EpisodeInfo(kind="drop")
    with EpisodeWriter(Path("a.mcap"), info, live=live, overwrite="replace" in sys.argv) as writer:
        for index in range(100_000):
            writer.write_pose("/ball/pose", 1 + index, rng.normal(size=3))
            acknowledged = writer.written
except LogError as error:
    print(acknowledged)
    print(error)
    sys.exit(error.exit_code)
"""


def fill(folder: Path, limit: int, *words: str) -> tuple[int, str]:
    """Record until it fails; messages acknowledged before, and what is said."""
    result = subprocess.run(
        [sys.executable, "-c", CODE, str(limit), *words],
        cwd=folder, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert result.returncode == 1, result.stderr
    acknowledged, said = result.stdout.splitlines()
    assert said.startswith("a.mcap: writing failed (")
    return int(acknowledged), said


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


@pytest.mark.parametrize("live", ["live", "file"])
@pytest.mark.parametrize("limit", [1200, 4000, 20_000, 60_000, 100_000, 300_001])
def test_a_file_that_may_not_grow(tmp_path: Path, limit: int, live: str):
    acknowledged, said = fill(tmp_path, limit, live)
    log = tmp_path / "a.mcap"
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]
    assert log.stat().st_size <= limit
    kept = heights_in(log, acknowledged)
    assert f"; {kept} of " in said
    assert "are kept in a.mcap;" in said
    if limit > 50_000:  # less holds no whole chunk
        assert kept > 100
    info = read_episode(log).info
    assert info.kind == "drop"
    assert info.counts["written"] == kept
    assert info.counts["captured"] == kept + info.counts["dropped"]
    assert info.counts["dropped"] > 0
    assert info.notes["ended"].startswith("writing failed")


def test_where_not_even_an_end_fits_the_log_is_left_without(tmp_path: Path):
    fill(tmp_path, 150_000, "file")
    size = (tmp_path / "a.mcap").stat().st_size
    sizes = range(1, size, size // 40)
    left = set()
    for limit in sizes:
        folder = tmp_path / str(limit)
        folder.mkdir()
        code = CODE.replace("100_000", "3_000")
        words = [sys.executable, "-c", code, str(limit), "file"]
        subprocess.run(words, cwd=folder, capture_output=True, timeout=60)
        left |= {one.name for one in folder.iterdir()}
    assert left <= {"a.mcap", "a.mcap.active"}


def test_a_log_that_was_to_be_replaced_stays(tmp_path: Path):
    (tmp_path / "a.mcap").write_bytes(b"the old one")
    acknowledged, said = fill(tmp_path, 100_000, "live", "replace")
    assert (tmp_path / "a.mcap").read_bytes() == b"the old one"
    kept = heights_in(tmp_path / "a.mcap.active", acknowledged)
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
        pytest.skip("there is no mount command to make a small disk with")
    if mounted.returncode:
        pytest.skip(f"a small disk cannot be mounted here ({mounted.stderr.strip()})")
    yield folder
    subprocess.run(["umount", str(folder)], check=True, timeout=20)


@pytest.mark.parametrize("live", ["live", "file"])
@pytest.mark.parametrize("taken", [0, 900_000, 1_040_000])
def test_a_small_disk(small_disk: Path, live: str, taken: int):
    (small_disk / "other").write_bytes(bytes(taken))
    acknowledged, said = fill(small_disk, 0, live)
    assert "No space left on device" in said
    left = [one for one in small_disk.iterdir() if one.name != "other"]
    assert len(left) == 1
    assert left[0].name in said
    assert f"; {heights_in(left[0], acknowledged)} of " in said


def test_too_little_space_ends_it_whole(small_disk: Path):
    disk_bytes = 1024 * 1024
    writer = EpisodeWriter(
        small_disk / "a.mcap", EpisodeInfo(kind="drop"), min_free_bytes=disk_bytes // 2
    )
    with pytest.raises(LogError, match=r"has 0 MB left .* kept in a\.mcap; free some space"):  # noqa: PT012
        rng = np.random.default_rng(0)
        for index in range(2000):
            writer.write_pose("/ball/pose", 1 + index, rng.normal(size=3))
        (small_disk / "other").write_bytes(bytes(disk_bytes // 2))
        while True:
            writer.tick()
    assert heights_in(small_disk / "a.mcap", 0) == 2000
    episode = read_episode(small_disk / "a.mcap")
    assert episode.info.counts == {"captured": 2000, "written": 2000, "dropped": 0}
    assert "are to stay free" in episode.info.notes["ended"]
    with make_summary(small_disk / "a.mcap") as statistics:
        assert statistics == 2000


@pytest.mark.parametrize("source", [("--simulate", "drop"), ("--camera", "a.mp4")])
def test_a_recording_does_not_start_on_a_disk_that_is_nearly_full(
    command: Command, tmp_path: Path, source: tuple[str, str]
):
    from tests.recorders.test_video_file import write_video

    write_video(tmp_path / "a.mp4", [0, 10, 20])
    words = (*source, "--min-free", 999_999_999, "-o", "a.mcap")
    result = command("tunenet-record", *words, cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "999999999 MB are to stay free" in result.stderr.replace("1e+09", "999999999")
    assert "--min-free" in result.stderr
    assert [one.name for one in tmp_path.iterdir()] == ["a.mp4"]
    allowed = command("tunenet-record", *source, "--min-free", 0, "-o", "a.mcap", cwd=tmp_path)
    assert allowed.returncode == 0, allowed.stderr
