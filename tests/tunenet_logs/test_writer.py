"""What was written stays: in our reader and in others', when killed, when the disk is full.

Our MCAP is byte for byte what the mcap library writes of the same.
"""

from __future__ import annotations

import copy
import errno
import io
import os
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from tests.conftest import Command, files_no_larger_than
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode
from tunenet_logs.timing.stamps import now_ns, wall_ns
from tunenet_logs.writing.owned_path import LogPlace, WholeFile
from tunenet_logs.writing.writer import EpisodeWriter, McapOutput

INFO = EpisodeInfo(kind="drop", source="a test", truth={"restitution": 0.5})
PERIOD_NS = 10_000_000


def write(path: Path, pause_s: float = 0.0) -> np.ndarray:
    positions = np.random.default_rng(0).normal(size=(100, 3))
    with EpisodeWriter(path, INFO, live=False) as writer:
        for index, position in enumerate(positions):
            time.sleep(pause_s if index == 50 else 0)
            writer.write_pose("/ball/pose", index * PERIOD_NS, position)
    return positions


def test_comes_back_bit_for_bit_in_our_reader_and_in_others(tmp_path: Path):
    path = tmp_path / "a.mcap"
    positions = write(path)
    episode = read_episode(path)
    ball = episode.signals["/ball/pose"]
    assert np.array_equal(ball.values, positions)
    assert np.array_equal(ball.stamps_ns, np.arange(100) * PERIOD_NS)
    assert episode.info.truth["restitution"] == 0.5
    assert episode.info.counts["written"] == 100
    assert not episode.warnings
    assert not (tmp_path / "a.mcap.active").exists()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 100
        assert reader.get_header().profile == "ros2"
        records = {record.name: record.metadata for record in reader.iter_metadata()}
        assert records["tunenet/episode"]["truth.restitution"] == "0.5"
    with AnyReader([path]) as bag:
        seen: list[Any] = [bag.deserialize(raw, one.msgtype) for one, _, raw in bag.messages()]
    assert [message.pose.position.z for message in seen] == list(positions[:, 2])


def test_frames_keep_their_bytes_and_are_read_when_asked_for(tmp_path: Path):
    data = os.urandom(5000)
    with EpisodeWriter(tmp_path / "a.mcap", INFO, live=False) as writer:
        for index in range(20):
            writer.write_frame("/camera/image_raw/compressed", Frame(index, "jpeg", data))
    frames = list(read_episode(tmp_path / "a.mcap").frames())
    assert [frame.stamp_ns for frame in frames] == list(range(20))
    assert all(frame.data == data and frame.encoding == "jpeg" for frame in frames)


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


def test_pixels_and_joints_are_standard_messages(tmp_path: Path):
    pixels = bytes(range(24))
    with EpisodeWriter(tmp_path / "a.mcap", INFO, live=False) as writer:
        writer.write_frame("/raw", Frame(3_000_000_007, "rgb8", pixels, (4, 2)))
        writer.write_joints("/joint_states", 8, ["a", "b"], [1.0, 2.0], effort_nm=[3.0, 4.0])
        with pytest.raises(ValueError, match="cannot hold sensor_msgs/msg/JointState"):
            writer.write_joints("/raw", 6, [], [])  # a topic holds one type
    with AnyReader([tmp_path / "a.mcap"]) as bag:
        seen: dict[str, Any] = {
            one.topic: bag.deserialize(raw, one.msgtype) for one, _, raw in bag.messages()
        }
    image, state = seen["/raw"], seen["/joint_states"]
    assert (image.width, image.height, image.step, image.encoding) == (4, 2, 12, "rgb8")
    assert image.data.tobytes() == pixels
    assert (image.header.stamp.sec, image.header.stamp.nanosec) == (3, 7)
    assert state.name == ["a", "b"]
    parts = [list(one) for one in (state.position, state.velocity, state.effort)]
    assert parts == [[1.0, 2.0], [], [3.0, 4.0]]


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
        (errno.ENOENT, f"FOLDER: no such folder; make it first, or {ELSEWHERE}"),
        (errno.ENOTDIR, f"FOLDER: is no folder; {ELSEWHERE}"),
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
    assert str(caught.value) == why.replace("FOLDER", str(tmp_path)).replace("PATH", path)


@pytest.mark.parametrize(
    "words",
    [
        ("tunenet-record", "--simulate", "drop"),
        ("tunenet-logs", "import", "drop.mcap"),
        ("tunenet-logs", "recover", "drop.mcap"),
    ],
)
def test_every_command_names_the_folder_that_is_missing(
    command: Command, drop_log: Path, words: tuple[str, ...]
):
    result = command(*words, "-o", "no/where/a.mcap", cwd=drop_log.parent)
    assert result.returncode == 1
    missing = f"no/where: no such folder; make it first, or {ELSEWHERE}"
    assert result.stderr == f"{words[0]}: {missing}\n"
    file = command(*words, "-o", "drop.mcap/a.mcap", cwd=drop_log.parent)
    assert file.stderr == f"{words[0]}: drop.mcap: is no folder; {ELSEWHERE}\n"
    assert [one.name for one in drop_log.parent.iterdir()] == ["drop.mcap"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write to every folder")
@pytest.mark.parametrize("mode", [0o555, 0o000])
def test_a_folder_that_is_read_only_is_told(tmp_path: Path, mode: int):
    (tmp_path / "locked").mkdir(mode)
    with pytest.raises(LogError, match="its folder cannot be written to"):
        EpisodeWriter(tmp_path / "locked" / "a.mcap", INFO)
    (tmp_path / "locked").chmod(0o755)


@pytest.mark.parametrize(
    ("bound_mb", "words"),
    [
        (0.5, "the disk has 0 MB left and 1 MB are"),
        (9999, "the disk has 0 MB left and 9999 MB are"),
        (99_999_999, "the disk has 0 GB left and 100000 GB are"),
        (10_500, "the disk has 0 GB left and 11 GB are"),
    ],
)
def test_space_is_told_in_whole_numbers(tmp_path: Path, bound_mb: float, words: str):
    place = LogPlace(tmp_path / "a.mcap", overwrite=False, min_free_bytes=0)
    bounded = copy.copy(place)
    bounded.__dict__["_min_free_bytes"] = int(bound_mb * 1e6)
    assert bounded.why_too_full(1000).startswith(words)


RECORDER = """
import os, struct, time, numpy as np
from pathlib import Path
from tunenet_logs.recorders.session import stop_flag
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.writing.writer import EpisodeWriter

with stop_flag() as stop, EpisodeWriter(Path("a.mcap"), EpisodeInfo(kind="drop")) as writer:
    start = time.monotonic_ns()
    index = 0
    print("ready", flush=True)
    while not stop.is_set():
        stamp_ns = time.monotonic_ns() - start
        writer.write_pose("/ball/pose", stamp_ns, np.full(3, float(index)))
        os.write(2, struct.pack("q", stamp_ns))
        index += 1
        time.sleep(0.001)
"""


def recorder(folder: Path, acknowledged: int) -> tuple[subprocess.Popen[bytes], bytes]:
    """A process that tells on stderr which stamps were acknowledged, and the first so many."""
    words, pipe = [sys.executable, "-c", RECORDER], subprocess.PIPE
    process = subprocess.Popen(words, cwd=folder, stdout=pipe, stderr=pipe)
    assert process.stdout is not None
    assert process.stderr is not None
    assert process.stdout.readline() == b"ready\n"
    return process, process.stderr.read(8 * acknowledged)


@pytest.mark.parametrize("count", [1, 150, 400])
def test_killed_it_loses_the_last_moments_at_most(tmp_path: Path, count: int):
    process, told = recorder(tmp_path, count)
    process.kill()
    assert process.stderr is not None
    acknowledged = np.frombuffer(told + process.stderr.read(), np.int64)
    process.wait()
    assert len(acknowledged) >= count
    episode = read_episode(tmp_path / "a.mcap.active")
    ball = episode.signals.get("/ball/pose")
    kept = 0 if ball is None else len(ball.values)
    if ball is not None:
        assert np.array_equal(ball.values[:, 0], np.arange(kept))
    lost = acknowledged[kept:]
    assert len(lost) < 2 or lost[-1] - lost[0] < 0.1e9  # all of one chunk that was still open
    assert any("end of the file is missing" in warning for warning in episode.warnings)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("count", [0, 120, pytest.param(400, marks=pytest.mark.slow)])
def test_stopped_by_a_signal_the_log_is_whole(tmp_path: Path, number: int, count: int):
    process, _ = recorder(tmp_path, count)
    process.send_signal(number)
    assert process.wait(60) == 0
    episode = read_episode(tmp_path / "a.mcap")
    assert not episode.warnings
    written = episode.info.counts["written"]
    assert written >= count
    ball = episode.signals.get("/ball/pose")
    assert written == (0 if ball is None else len(ball.values))


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


@pytest.mark.parametrize("count", [0, 3])
def test_pictures_are_packed_with_little_effort(tmp_path: Path, opened: Opened, count: int):
    """A chunk that cannot be packed says that it is, as all do, and every reader reads it."""
    path, pictures = tmp_path / "a.mcap", [os.urandom(100_000) for _ in range(count)]
    output = McapOutput(opened(path), "ros2", "ours")
    channel = output.add_channel("/a", "cdr", output.add_schema("a", "ros2msg", "float64 x"))
    for number, data in enumerate(pictures):
        output.add_message(channel, number, number, number, data)
    output.end("last", {})
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert [message.data for *_, message in reader.iter_messages()] == pictures
        summary = reader.get_summary()
        assert summary is not None
        assert {one.compression for one in summary.chunk_indexes} == ({"zstd"} if count else set())


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
