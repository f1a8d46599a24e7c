"""A camera at 60 Hz and an arm at 1 kHz, recorded in a process that may be ended at any moment.

`python -m tests.recorders.live_recorder FOLDER LOG TOPIC...` records LOG until a signal ends it. In
FOLDER/progress it keeps how many messages of each stream it has put, when the last one was,
and how many of all streams were acknowledged as written by then. What a message holds follows from
its number alone.
"""

from __future__ import annotations

import mmap
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.serde import SerdeError

from tests.recorders.mjpeg_camera import picture
from tunenet_logs import messages
from tunenet_logs.copying import recover
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import LiveRecording, stop_flag
from tunenet_logs.timing.stamps import now_ns

ROOT = Path(__file__).resolve().parents[2]
PICTURES = "/camera/image_raw/compressed"
JOINTS = "/joint_states"
NAMES = tuple(f"joint_{number}" for number in range(1, 8))
RATES_HZ = {PICTURES: 60.0, JOINTS: 1000.0}
_DISTINCT = 4
_SLOTS = 3


@cache
def _jpeg(number: int) -> bytes:
    return picture(number, (640, 480))


def frame_of(number: int) -> bytes:
    """The number-th picture: a JPEG with its number behind the end."""
    return _jpeg(number % _DISTINCT) + number.to_bytes(8, "little")


def joints_of(number: int) -> np.ndarray:
    """The number-th state: position, velocity and effort of seven joints, shape (3, 7)."""
    return np.arange(21.0).reshape(3, 7) + number


class Progress:
    """What was put, in a file that outlives the process.

    Of each topic (count, last stamp [ns], acknowledged messages of all topics by then).
    """

    def __init__(self, path: Path) -> None:
        size = 8 * _SLOTS * len(RATES_HZ)
        if not path.exists():
            path.write_bytes(bytes(size))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), size)
        self._table = np.frombuffer(self._map, np.int64).reshape(len(RATES_HZ), _SLOTS)

    def row(self, topic: str) -> np.ndarray:
        """The row of a topic, shared with whoever has the file open."""
        return self._table[list(RATES_HZ).index(topic)]


def put(recording: LiveRecording, topic: str, progress: Progress) -> None:
    """Put a stream at its rate until the recording is over."""
    row, period_s = progress.row(topic), 1 / RATES_HZ[topic]
    start, number, is_on = time.monotonic(), 0, True
    while is_on:
        time.sleep(max(0.0, start + number * period_s - time.monotonic()))
        stamp_ns = now_ns()
        if topic == PICTURES:
            is_on = recording.put_frame(topic, Frame(stamp_ns, "jpeg", frame_of(number)))
        else:
            is_on = recording.put_joints(topic, stamp_ns, NAMES, *joints_of(number))
        if is_on:
            number += 1
            row[:] = number, stamp_ns, recording.written


def main() -> int:
    folder, log = map(Path, sys.argv[1:3])
    progress = Progress(folder / "progress")
    for number in range(_DISTINCT):
        frame_of(number)
    try:
        with (
            stop_flag() as stop,
            LiveRecording(log, EpisodeInfo(kind="test"), stop=stop) as recording,
        ):
            threads = [
                threading.Thread(target=put, args=(recording, topic, progress))
                for topic in sys.argv[3:]
            ]
            for thread in threads:
                thread.start()
            print("ready", flush=True)
            recording.wait()
            for thread in threads:
                thread.join()
    except LogError as error:
        print(error)
        return error.exit_code
    print(recording.summary.in_words("messages"))
    return 0


def started(
    folder: Path,
    topics: Iterable[str] = RATES_HZ,
    log: Path | None = None,
    environment: Mapping[str, str] | None = None,
) -> subprocess.Popen[str]:
    """The recorder in a process of its own, once it records; to FOLDER/a.mcap if not told."""
    words = [str(folder), str(log or folder / "a.mcap"), *topics]
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.recorders.live_recorder", *words],
        cwd=ROOT, stdout=subprocess.PIPE, text=True, env=os.environ | dict(environment or {}),
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return process


@dataclass(frozen=True)
class Found:
    """What a log holds of one stream.

    Attributes:
        messages: in the log.
        wrong: those that are not what their number says, in order from 0.
        last_ns: stamp of the last one.
        received_ns: when that was received.
    """

    messages: int = 0
    wrong: int = 0
    last_ns: int = 0
    received_ns: int = 0


def found_in(log: Path) -> dict[str, Found]:
    """Read a log with the mcap library and rosbags, whole or not; what it holds of each topic."""
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    found = {topic: Found() for topic in RATES_HZ}
    with log.open("rb") as file:
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = record
                elif isinstance(record, Message):
                    channel = channels[record.channel_id]
                    before = found[channel.topic]
                    type_name = schemas[channel.schema_id].name
                    stamp_ns, is_right = _judge(record, type_name, before)
                    found[channel.topic] = Found(
                        before.messages + 1,
                        before.wrong + (not is_right),
                        stamp_ns,
                        record.log_time,
                    )
        except Exception:  # noqa: BLE001 (the end of a log that was cut; what counts is above)
            pass
    return found


def _judge(record: Message, type_name: str, before: Found) -> tuple[int, bool]:
    number = before.messages
    try:
        message: Any = messages.typestore().deserialize_cdr(record.data, type_name)
    except SerdeError:
        return 0, False
    stamp_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
    if type_name == messages.COMPRESSED_IMAGE:
        is_right = message.data.tobytes() == frame_of(number)
    else:
        values = np.array([message.position, message.velocity, message.effort])
        is_right = tuple(message.name) == NAMES and np.array_equal(values, joints_of(number))
    # The one before was received before this one was made.
    is_right &= before.received_ns <= stamp_ns <= record.log_time
    is_right &= record.publish_time == stamp_ns
    return stamp_ns, is_right and record.sequence == number + 1


def missing_s(folder: Path, log: Path) -> float:
    """Check a killed recording; the data that it lacks at its end, in the worse stream [s].

    Raises:
        AssertionError: a message is wrong, one that was acknowledged is missing, or what our reader
            gives is not what is there.
    """
    progress, found = Progress(folder / "progress"), found_in(log)
    check_killed_file(log, found)
    acknowledged = max(int(progress.row(topic)[2]) for topic in found)
    assert sum(one.messages for one in found.values()) >= acknowledged
    worst_s = 0.0
    for topic, one in found.items():
        count, last_ns, _ = (int(value) for value in progress.row(topic))
        assert one.wrong == 0, f"{one.wrong} of {one.messages} messages on {topic} are wrong"
        assert one.messages <= count + 1
        if count > one.messages:
            started_ns = last_ns - round((count - 1) / RATES_HZ[topic] * 1e9)
            worst_s = max(worst_s, (last_ns - (one.last_ns or started_ns)) * 1e-9)
    return worst_s


def check_killed_file(log: Path, found: dict[str, Found]) -> None:
    """Check that a log without an end opens and gives what is in it."""
    episode = read_episode(log)
    assert any("end of the file is missing" in warning for warning in episode.warnings)
    if found[PICTURES].messages:
        frames = [frame.data for frame in episode.frames(PICTURES)]
        assert frames == [frame_of(number) for number in range(found[PICTURES].messages)]
    total = sum(one.messages for one in found.values())
    if not total:
        return
    saved = log.with_name("saved.mcap")
    recovered = recover(log, saved, overwrite=True).messages
    assert recovered >= total  # of a chunk that was cut while it was written, some are saved, too
    again = found_in(saved).values()
    assert (sum(one.messages for one in again), sum(one.wrong for one in again)) == (recovered, 0)
    with saved.open("rb") as file:
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) == recovered
    words = [Path(sys.executable).with_name("rerun"), "mcap", "convert", saved]
    subprocess.run(
        [*words, "-o", log.with_name("saved.rrd")], check=True, capture_output=True, timeout=60
    )


def check_whole_file(log: Path, said: str) -> None:
    """Check a log that was ended by a signal, and that all its counts agree.

    Raises:
        AssertionError: they do not, or a message is wrong.
    """
    assert not log.with_name(log.name + ".active").exists()
    found = found_in(log)
    assert not any(one.wrong for one in found.values())
    total = sum(one.messages for one in found.values())
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
        file.seek(0)
        streamed = NonSeekingReader(file, validate_crcs=True)
        assert len(list(streamed.iter_messages(log_time_order=False))) == total
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == total
    by_topic = {
        summary.channels[number].topic: count
        for number, count in summary.statistics.channel_message_counts.items()
    }
    assert by_topic == {topic: one.messages for topic, one in found.items() if one.messages}
    episode = read_episode(log)
    assert not episode.warnings
    counts = episode.info.counts
    assert counts["captured"] == counts["written"] + counts["dropped"]
    assert (counts["written"], counts["dropped"]) == (total, 0)
    assert episode.info.notes["ended"] == "stopped by a signal"
    assert f"{total} messages captured, {total} written, 0 dropped" in said


if __name__ == "__main__":
    sys.exit(main())
