"""A camera at 60 Hz and an arm at 1 kHz, recorded in a process that may be ended at any moment.

`python -m tests.recorders.live_recorder FOLDER LOG TOPIC...` records LOG until a signal ends it. In
FOLDER/progress it keeps how many messages of each stream it has put, when the last one was,
and how many of all streams were acknowledged as written by then. What a message holds follows from
its number alone.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel, Header, Message, Schema
from mcap.stream_reader import StreamReader
from rosbags.serde import SerdeError

from tests.recorders.live_wait import ended
from tests.recorders.mjpeg_camera import picture
from tunenet_logs import messages
from tunenet_logs.copying import check, recover
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import LiveRecording, stop_flag
from tunenet_logs.terminal import Progress
from tunenet_logs.timing.stamps import now_ns
from tunenet_logs.writing.writer import MAGIC, EpisodeWriter, bytes_of

ROOT = Path(__file__).resolve().parents[2]
PICTURES = "/camera/image_raw/compressed"
JOINTS = "/joint_states"
NAMES = tuple(f"joint_{number}" for number in range(1, 8))
RATES_HZ = {PICTURES: 60.0, JOINTS: 1000.0}
_DISTINCT = 4


@cache
def _jpeg(number: int) -> bytes:
    return picture(number, (640, 480))


def frame_of(number: int) -> bytes:
    """The number-th picture: a JPEG with its number behind the end."""
    return _jpeg(number % _DISTINCT) + number.to_bytes(8, "little")


def joints_of(number: int) -> np.ndarray:
    """The number-th state: position, velocity and effort of seven joints, shape (3, 7)."""
    return np.arange(21.0).reshape(3, 7) + number


def progress_of(folder: Path, topic: str) -> np.ndarray:
    """What was put, shared by a file that outlives the process.

    Count, last stamp [ns], and the messages of all topics that were acknowledged by then.
    """
    path, shape = folder / "progress", (len(RATES_HZ), 3)
    table = np.memmap(path, np.int64, "r+" if path.exists() else "w+", shape=shape)
    return table[list(RATES_HZ).index(topic)]


def put(recording: LiveRecording, topic: str, row: np.ndarray) -> None:
    period_s = 1 / RATES_HZ[topic]
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
    for number in range(_DISTINCT):
        frame_of(number)
    try:
        with (
            stop_flag() as stop,
            LiveRecording(log, EpisodeInfo(kind="test"), stop=stop) as recording,
        ):
            threads = [
                threading.Thread(target=put, args=(recording, topic, progress_of(folder, topic)))
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
    with log.open("rb") as file, suppress(Exception):  # the end of a log that was cut
        for record in StreamReader(file, validate_crcs=True).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                before = found[channel.topic]
                stamp_ns, is_right = _judge(record, schemas[channel.schema_id].name, before)
                wrong = before.wrong + (not is_right)
                found[channel.topic] = Found(before.messages + 1, wrong, stamp_ns, record.log_time)
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

    No message may be wrong, none that was acknowledged be missing, and our reader gives what is
    there.
    """
    found = found_in(log)
    check_killed_file(log, found)
    acknowledged = max(int(progress_of(folder, topic)[2]) for topic in found)
    assert sum(one.messages for one in found.values()) >= acknowledged
    worst_s = 0.0
    for topic, one in found.items():
        count, last_ns, _ = (int(value) for value in progress_of(folder, topic))
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


def check_whole_file(log: Path, said: str) -> None:
    """Check a log that was ended by a signal: no message is wrong, and all its counts agree."""
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


# ---- What others do to a file that is being recorded: record to its name, or take it away

MESSAGES = 20


# The beginning of a log of ours, by which it is known.
OF_OURS = MAGIC + bytes_of(Header("ros2", "tunenet-logs 0.1.0"))


def _write(orders: Any) -> None:
    """Open a log at a moment, write messages that hold a number, end it when that is told."""
    while order := orders.recv():
        log, number, overwrite, moment_ns = order
        while time.monotonic_ns() < moment_ns:
            pass
        try:
            writer = EpisodeWriter(log, EpisodeInfo(), overwrite=overwrite)
        except LogError as error:
            orders.send(str(error))
            continue
        for index in range(MESSAGES):
            writer.write_pose("/ball", index, np.array([number, index, 0.0]))
        orders.send("won")
        orders.recv()
        try:
            writer.close()
            orders.send("kept")
        except LogError as error:
            orders.send(str(error))


@contextmanager
def contenders(count: int) -> Iterator[list[Connection]]:
    """So many processes that write, by what is sent to them and what they answer."""
    spawn = get_context("spawn")
    with ExitStack() as stack:
        every = []
        for _ in range(count):
            ours, theirs = spawn.Pipe()
            process = spawn.Process(target=_write, args=(theirs,), daemon=True)
            process.start()
            stack.callback(process.join)
            stack.callback(ours.send, None)
            every.append(ours)
        yield every


def contend(
    every: list[Connection], folder: Path, rng: random.Random, *, overwrite: bool, left: str
) -> None:
    """Have all record to one name at one moment; exactly one may win, and all of it must be kept.

    The folder is empty, and is emptied again; what lies there already is "", a "log" or an "active"
    one. They begin up to 0.5 ms apart.
    """
    log = folder / "a.mcap"
    if left:
        (folder / {"log": "a.mcap", "active": "a.mcap.active"}[left]).write_bytes(OF_OURS)
    begin_ns = time.monotonic_ns() + 1_000_000
    for number, one in enumerate(every):
        one.send((log, number, overwrite, begin_ns + rng.randrange(500_000)))
    said = [one.recv() for one in every]
    assert said.count("won") == 1, said
    winner = said.index("won")
    refused = said[:winner] + said[winner + 1 :]
    assert all("a.mcap.active: is being written by another" in why for why in refused), refused
    every[winner].send("end")
    assert (answer := every[winner].recv()) == "kept", answer
    assert [one.name for one in folder.iterdir()] == ["a.mcap"]
    health = check(log, Progress(quiet=True))
    assert not health.damage
    ball = health.episode.signals["/ball"].values
    assert np.array_equal(ball[:, 0], np.full(MESSAGES, winner))
    assert np.array_equal(ball[:, 1], np.arange(MESSAGES))
    log.unlink()


# ---- A file that is taken away

STRANGER = b"not a log, and not yours"
_KEPT = re.compile(r"; (\d+) of \d+ messages are kept in (.+?); ")


def _remove_folder(active: Path) -> None:
    # The recorder's own files may come in between; a person would try again, too.
    while active.parent.exists():
        shutil.rmtree(active.parent, ignore_errors=True)


def _replace(active: Path, copies: bool = False) -> None:
    other = active.with_name("other")
    other.write_bytes(active.read_bytes() if copies else STRANGER)
    other.replace(active)


def _link_to_nothing(active: Path) -> None:
    active.unlink()
    active.symlink_to(active.with_name("nothing"))


def _put_pipe(active: Path) -> None:
    active.unlink()
    os.mkfifo(active)


ATTACKS: dict[str, Callable[[Path], object]] = {
    "removed": Path.unlink,
    "folder removed": _remove_folder,
    "replaced": _replace,
    "replaced by a link to nothing": _link_to_nothing,
    "replaced by a pipe": _put_pipe,
    "moved": lambda active: active.rename(active.with_name("moved.mcap")),
    "folder renamed": lambda active: active.parent.rename(active.parent.with_name("renamed")),
    "replaced by its copy": lambda active: _replace(active, copies=True),
}


def attack(
    folder: Path, how: str, seconds: float, *, ends: bool = False, acknowledged: int = 0
) -> str:
    """Record, take the file away after so long, and look for every acknowledged message.

    Args:
        folder: empty; its folder "logs" is recorded to, its folder "tmp" is the temporary one.
        how: one of `ATTACKS`.
        seconds: from the moment on when it records.
        ends: whether a signal ends the recording right after the attack.
        acknowledged: messages that are waited for before the attack.

    Returns:
        The last line of the recorder.
    """
    logs, temporary = folder / "logs", folder / "tmp"
    logs.mkdir()
    temporary.mkdir()
    process = started(folder, [JOINTS], logs / "a.mcap", {"TMPDIR": str(temporary)})
    row = progress_of(folder, JOINTS)
    time.sleep(seconds)
    while row[2] < acknowledged and process.poll() is None:
        time.sleep(0.01)
    ATTACKS[how](logs / "a.mcap.active")
    if ends:
        process.send_signal(signal.SIGTERM)
    said = ended(process, code=1)[0].strip()
    assert "\n" not in said
    kept = _KEPT.search(said)
    assert kept, said
    log = logs / kept[2]
    assert not check(log, Progress(quiet=True)).damage
    found = found_in(log)[JOINTS]
    assert found.wrong == 0
    assert found.messages == int(kept[1]) >= int(row[2])
    if how == "replaced":
        assert (logs / "a.mcap.active").read_bytes() == STRANGER
    assert not (logs / "a.mcap").exists()
    return said


if __name__ == "__main__":
    sys.exit(main())
