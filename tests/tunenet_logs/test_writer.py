"""What was written stays: in our reader and in others', when the disk is full.

Our MCAP is byte for byte what the mcap library writes of the same.
"""

from __future__ import annotations

import errno
import io
import os
import subprocess
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, nullcontext
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, Writer

from tests.conftest import files_no_larger_than
from tests.recorders.live_recorder import OF_OURS
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode
from tunenet_logs.timing.stamps import now_ns, wall_ns
from tunenet_logs.writing.owned_path import WholeFile
from tunenet_logs.writing.writer import EpisodeWriter, McapOutput, bare_ending

INFO = EpisodeInfo(kind="drop", source="a test", truth={"restitution": 0.5})
PERIOD_NS = 10_000_000


def write(path: Path, pause_s: float = 0.0) -> np.ndarray:
    positions = np.random.default_rng(0).normal(size=(100, 3))
    with EpisodeWriter(path, INFO, live=False) as writer:
        for index, position in enumerate(positions):
            time.sleep(pause_s if index == 50 else 0)
            writer.write_pose("/ball/pose", index * PERIOD_NS, position)
    return positions


def test_the_same_episode_gives_the_same_bytes_however_slow_the_machine(tmp_path: Path):
    write(tmp_path / "a.mcap")
    write(tmp_path / "b.mcap", pause_s=0.2)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


@pytest.mark.parametrize("live", [True, False])
def test_a_live_log_tells_the_receipt_beside_the_acquisition(tmp_path: Path, live: bool):
    before = now_ns()
    with EpisodeWriter(tmp_path / "a.mcap", INFO, live=live) as writer:
        writer.write_pose("/ball/pose", 5, np.zeros(3))
        writer.write_frame("/camera", Frame(6, "jpeg", b"x"), received_ns=before)
        writer.write_joints("/joint_states", 7, ["a"], [0.5])
    after = now_ns()
    with (tmp_path / "a.mcap").open("rb") as file:
        times = {
            channel.topic: (message.log_time, message.publish_time)
            for _, channel, message in make_reader(file).iter_messages()
        }
    published = {topic: one[1] for topic, one in times.items()}
    assert published == {"/ball/pose": 5, "/camera": 6, "/joint_states": 7}
    if live:
        assert times["/camera"][0] == before
        assert all(before <= logged <= after for logged, _ in times.values())
    else:
        assert all(logged == published for logged, published in times.values())


def test_an_error_of_the_recorder_ends_the_log_whole_and_is_named(tmp_path: Path):
    def record() -> None:
        with EpisodeWriter(tmp_path / "a.mcap", INFO) as writer:
            writer.write_pose("/ball/pose", 5, np.zeros(3))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        record()
    episode = read_episode(tmp_path / "a.mcap")
    assert not episode.warnings
    assert episode.info.notes["ended"] == "broke off (ZeroDivisionError)"
    assert episode.info.counts == {"captured": 1, "written": 1, "dropped": 0}


def test_what_is_there_is_never_overwritten_unasked(tmp_path: Path):
    log, active = tmp_path / "a.mcap", tmp_path / "a.mcap.active"
    writer = EpisodeWriter(log, INFO)
    log.write_bytes(b"mine")  # came into being meanwhile
    with pytest.raises(LogError, match=r"are kept in a\.mcap\.active"):
        writer.close()
    assert log.read_bytes() == b"mine"
    assert not read_episode(active).warnings
    active.unlink()
    log.unlink()
    write(log)
    before = log.read_bytes()
    with pytest.raises(LogError, match="--overwrite"):
        EpisodeWriter(log, INFO)
    assert log.read_bytes() == before
    log.rename(active)  # what a killed recording left
    with pytest.raises(LogError, match="did not end"):
        EpisodeWriter(log, INFO)
    assert active.read_bytes() == before


def test_a_wall_clock_that_is_set_does_not_bend_the_stamps(monkeypatch: pytest.MonkeyPatch):
    before, jumped_ns = now_ns(), time.time_ns() + 3_600_000_000_000
    monkeypatch.setattr(time, "time_ns", lambda: jumped_ns)
    assert 0 <= now_ns() - before < 1_000_000_000_000
    assert wall_ns(5) - wall_ns(3) == 2


ELSEWHERE = "choose another place with -o"
CANNOT = "PATH: its folder cannot be written to"


@pytest.mark.parametrize(
    ("number", "why"),
    [
        (errno.EACCES, f"{CANNOT} (Permission denied); {ELSEWHERE}"),
        (errno.EROFS, f"{CANNOT} (Read-only file system); {ELSEWHERE}"),
        (errno.ENOSPC, "PATH: cannot be written (No space left on device); free some space, or "
         f"{ELSEWHERE}"),
        (errno.EIO, f"PATH: cannot be written (Input/output error); {ELSEWHERE}"),
    ],
)  # fmt: skip
def test_what_cannot_be_written_is_named_as_it_was_given_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, why: str
):
    def refuse(path: Path, **_: bool) -> None:
        raise OSError(number, os.strerror(number), str(path))

    monkeypatch.setattr("tunenet_logs.writing.owned_path.ClaimedName", refuse)
    with pytest.raises(LogError) as caught:
        EpisodeWriter(tmp_path / "a.mcap", INFO)
    path = str(tmp_path / "a.mcap")
    assert str(caught.value) == why.replace("PATH", path)


# Byte for byte what the mcap library writes.
MESSAGES = [
    (index % 2, 50 + 7 * (index % 3), os.urandom(index * 37 % 9000).hex().encode())
    for index in range(99)
]
LAST = ("last", {"b": "2", "é": "ü"})


def by_the_library(flushes: bool) -> bytes:
    file, packing = io.BytesIO(), CompressionType.ZSTD
    writer = Writer(file, chunk_size=64 * 1024, compression=packing, enable_data_crcs=True)
    writer.start(profile="ros2", library="ours")
    writer.add_metadata("first", {"a": "1"})
    channels: list[int] = []
    for number, (which, time_ns, data) in enumerate(MESSAGES):
        if which == len(channels):
            schema = writer.register_schema(f"type{which}", "ros2msg", b"float64 x")
            channels.append(writer.register_channel(f"/{which}", "cdr", schema))
        writer.add_message(channels[which], time_ns, data, time_ns + 1, number)
        if flushes and number % 10 == 0:
            writer.flush()
    writer.flush()
    writer.add_metadata(*LAST)
    writer.finish()
    return file.getvalue()


Opened = Callable[[Path], WholeFile]


@pytest.fixture
def opened() -> Iterator[Opened]:
    """Opens files, empty, which are closed at the end."""
    with ExitStack() as stack:

        def one(path: Path) -> WholeFile:
            descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_TRUNC, 0o666)
            stack.callback(os.close, descriptor)
            return WholeFile(descriptor)

        yield one


def by_us(file: WholeFile, flushes: bool, *, ends: bool = True) -> McapOutput:
    output = McapOutput(file, "ros2", "ours")
    output.add_metadata("first", {"a": "1"})
    channels: list[int] = []
    for number, (which, time_ns, data) in enumerate(MESSAGES):
        if which == len(channels):
            schema = output.add_schema(f"type{which}", "ros2msg", "float64 x")
            channels.append(output.add_channel(f"/{which}", "cdr", schema))
        output.add_message(channels[which], number, time_ns, time_ns + 1, data)
        if flushes and number % 10 == 0:
            output.close_chunk()
    output.close_chunk()
    if ends:
        output.end(*LAST)
    return output


@pytest.mark.parametrize("flushes", [False, True])
def test_the_bytes_are_those_of_the_library(tmp_path: Path, opened: Opened, flushes: bool):
    output = by_us(opened(tmp_path / "a.mcap"), flushes)
    assert output.message_count == len(MESSAGES)
    assert (tmp_path / "a.mcap").read_bytes() == by_the_library(flushes)


def test_what_is_given_up_of_the_end_as_room_gets_short(tmp_path: Path, opened: Opened):
    """Every log that has an end reads to its last message, however little of it fits."""
    by_us(opened(tmp_path / "whole.mcap"), flushes=True)
    whole = (tmp_path / "whole.mcap").stat().st_size
    by_us(opened(tmp_path / "open.mcap"), flushes=True, ends=False)
    endless = (tmp_path / "open.mcap").stat().st_size
    forms: list[tuple[bool, ...]] = []
    for limit in range(whole, endless - 1, -9):
        output = by_us(opened(tmp_path / "a.mcap"), flushes=True, ends=False)
        with files_no_larger_than(limit):
            is_ended = output.end_as_fits(*LAST)
        if not is_ended:
            assert (tmp_path / "a.mcap").stat().st_size == endless
            forms.append((False,))
            continue
        with (tmp_path / "a.mcap").open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert len(list(reader.iter_messages())) == len(MESSAGES)
            summary = reader.get_summary()
            names = [one.name for one in reader.iter_metadata()]
            file.seek(0)
            streamed = NonSeekingReader(file, validate_crcs=True)
            assert len(list(streamed.iter_messages(log_time_order=False))) == len(MESSAGES)
        if summary is not None:
            assert summary.statistics is not None
            assert summary.statistics.message_count == len(MESSAGES)
        has_chunks = summary is not None and bool(summary.chunk_indexes)
        forms.append((True, has_chunks, summary is not None, "last" in names))
    assert list(dict.fromkeys(forms)) == [
        (True, True, True, True), (True, False, True, True), (True, False, False, True),
        (True, False, False, False), (False,),
    ]  # fmt: skip


@pytest.mark.parametrize("step", [1, 50, 997])
def test_a_piece_that_does_not_fit_leaves_no_trace(tmp_path: Path, opened: Opened, step: int):
    file, taken = opened(tmp_path / "a"), b""
    with files_no_larger_than(4000):
        for piece in (os.urandom(one * step % 300 + 1) for one in range(60)):
            try:
                file.append(piece)
            except OSError:
                assert len(taken) + len(piece) > 4000
            else:
                taken += piece
            assert (tmp_path / "a").read_bytes() == taken
            assert (file.size_bytes, file.crc32) == (len(taken), zlib.crc32(taken))
    file.append(b"more")
    assert (tmp_path / "a").read_bytes() == taken + b"more"


# A disk that takes no more ends a recording: what was acknowledged is read back by everyone.
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
@pytest.mark.parametrize(
    "limit", [1, 40, 1200, 4000, 12_000, 20_000, 36_000, 60_000, 66_000, 100_000, 300_001]
)
def test_a_file_that_may_not_grow(tmp_path: Path, limit: int, live: bool):
    acknowledged, said = fill(tmp_path, limit, live=live)
    if limit < 100:  # not even the beginning fits
        assert "cannot be written" in said
        assert not list(tmp_path.iterdir())
        return
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
