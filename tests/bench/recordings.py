"""Measure reading, writing and recording in real time: sections of `python -m tests.bench`."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import zstandard
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from tests import hostile
from tests.bench import ROOT, Figures, best_s
from tests.recorders.live_recorder import JOINTS, NAMES, PICTURES
from tests.recorders.mjpeg_camera import picture, playing
from tests.recorders.ros2_publisher import NAMES as ARM_NAMES
from tests.recorders.ros2_publisher import STATES, expect, publishing, values_of
from tunenet_logs import messages
from tunenet_logs.episode import Array, EpisodeInfo, Frame
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import LiveRecording, TopicQueue
from tunenet_logs.recorders.simulators.arm.description import Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import eased, random_path
from tunenet_logs.recorders.simulators.arm.payload import joint_efforts_nm
from tunenet_logs.timing.stamps import now_ns
from tunenet_logs.writing.writer import EpisodeWriter

RECORD = [sys.executable, "-m", "tunenet_logs.recorders.cli"]
_CAMERA_HZ, _JOINTS_HZ = 60.0, 1000.0


class Ended(NamedTuple):
    """What an ended process took."""

    code: int
    cpu_s: float
    peak_mib: float


def ended(process: subprocess.Popen) -> Ended:
    """Wait for a process."""
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return Ended(process.returncode, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def _told(what: str, done: Ended, wall_s: float) -> Figures:
    yield f"{what}: % of a core", 100 * done.cpu_s / wall_s
    yield f"{what}: memory at most [MiB]", done.peak_mib
    yield f"bad: {what}: exit code", done.code


# ---- Reading and writing.


def reading(count: int, rounds: int) -> Figures:
    """Read a log of seven joints at 1 kHz into arrays, by rosbags and by us in turns."""

    def by_rosbags() -> Array:
        rows = []
        with AnyReader([path]) as reader:
            for connection, _, raw in reader.messages():
                message: Any = reader.deserialize(raw, connection.msgtype)
                _ = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                rows.append((message.position, message.velocity, message.effort))
        return np.array(rows).reshape(len(rows), -1)

    def by_us() -> Array:
        signals = read_episode(path).signals
        parts = ("position", "velocity", "effort")
        return np.hstack([signals[f"{JOINTS}.{part}"].values for part in parts])

    states = np.random.default_rng(0).normal(size=(count, 3, 7))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "joints.mcap"
        _write_bare(path, messages.JOINT_STATE, partial(_state, states), count, rate_hz=1000)
        assert np.array_equal(by_us(), by_rosbags())
        rosbags_s, ours_s = best_s([by_rosbags, by_us], rounds)
    yield "messages a second", count / ours_s
    yield "speed over that of rosbags", rosbags_s / ours_s


def long_joints(count: int) -> Figures:
    """Tune an arm of 1 kHz from its log alone: in chunks, beside a sensor of other lengths, and
    without chunks. An arm's minute with .8 kg is repeated, its torques with new noise.
    """
    arm = jaco()
    path = eased(random_path(arm, 3, 1000.0, 60.0), 1.0, 1000.0)
    torques = joint_efforts_nm(arm, path, Payload(0.8))
    marks = np.arange(21.0).reshape(3, 7) + 0.123456789
    stamp_ns = int.from_bytes(bytes(range(1, 5)), "big") * 10**9 + 0x05060708
    state = messages.joint_state(stamp_ns, [one.name for one in arm.joints], *marks)
    blank = hostile.message(0, messages.encode(state, messages.JOINT_STATE))
    beside = hostile.message(1, b"\0\1\0\0" + bytes(320))
    at, places = len(hostile.message()), [blank.index(mark.tobytes()) for mark in marks]
    fields = {"log_ns": ("<u8", 15), "publish_ns": ("<u8", 23), "sec": ("<u4", at + 4)}
    fields["nanosec"] = ("<u4", at + 8)
    fields |= {f"{k}": ("7<f8", place) for k, place in enumerate(places)}
    names, (kinds, offsets) = list(fields), zip(*fields.values(), strict=True)
    kind = {"names": names, "formats": kinds, "offsets": offsets, "itemsize": len(blank)}
    schemas = [messages.JOINT_STATE.encode(), messages.definition(messages.JOINT_STATE).encode()]
    described = hostile.schema(1, schemas[0], b"ros2msg", schemas[1])
    described += hostile.schema(2, b"std_msgs/msg/String", b"ros2msg", b"string data")
    described += hostile.channel(0, 1, JOINTS.encode()) + hostile.channel(1, 2, b"/chat")
    pack, rng = zstandard.ZstdCompressor(1).compress, np.random.default_rng(0)

    def write(log: Path, others: int, *, chunks: bool) -> None:
        turn = len(path.seconds)
        with log.open("wb") as file:
            file.write(hostile.mcap(described))
            for first in range(0, count, 2000):
                numbers = np.arange(first, min(first + 2000, count))
                there = numbers % (2 * turn)  # and back
                rows, way = np.minimum(there, 2 * turn - 1 - there), np.where(there < turn, 1, -1)
                made = np.frombuffer(bytearray(blank * len(numbers)), np.dtype(kind))  # pyright: ignore
                stamps_ns = 10**18 + numbers * 10**6
                made["log_ns"] = made["publish_ns"] = stamps_ns + 200_000
                made["sec"], made["nanosec"] = np.divmod(stamps_ns, 10**9)
                noise = rng.normal(0, (1e-5, 0.05), (len(numbers), 7, 2))
                made["0"] = path.position_rad[rows] + noise[..., 0]
                made["1"] = way[:, None] * path.velocity_rad_s[rows]
                made["2"] = torques[rows] + noise[..., 1]
                plain = made.view(np.uint8).reshape(len(numbers), -1)
                other = np.frombuffer(beside, np.uint8)[None].repeat(len(numbers), axis=0)
                plain = np.hstack([plain, *[other] * others]).tobytes()
                file.write(hostile.chunk(b"zstd", len(plain), pack(plain)) if chunks else plain)
            file.write(hostile.record(15, bytes(4)) + hostile.record(2, bytes(20)) + hostile.MAGIC)

    for name, others, chunks in (
        ("in chunks", 0, True), ("beside others", 1, True), ("without chunks", 0, False)
    ):  # fmt: skip
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "a.mcap"
            write(log, others, chunks=chunks)
            words = [
                sys.executable,
                "-m",
                "tunenet_logs.analysis.cli.tune",
                str(log),
                "--no-review",
            ]
            start_s = time.perf_counter()
            process = subprocess.Popen(
                [*words, "--no-review", "-o", folder],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
            )
            assert process.stderr is not None
            process.stderr.readline()
            first_s = time.perf_counter() - start_s
            process.stderr.read()
            done = ended(process)
            found = json.loads((Path(folder) / "a.json").read_text())
        yield f"{name}: CPU [s]", done.cpu_s
        yield f"{name}: memory at most [MiB]", done.peak_mib
        yield f"{name}: first line after [s]", first_s
        yield f"{name}: verdict", f"{found['verdict']} {found.get('reason') or ''}"


def writing(count: int, rounds: int) -> Figures:
    """Write joint states and JPEG frames by EpisodeWriter and by bare mcap: the same options, the
    same serialisation by rosbags, nobody waiting for the disk. A live recording's queue is apart.
    """
    states = np.random.default_rng(0).normal(size=(count, 3, 7))
    jpegs = [picture(number, (640, 480)) for number in range(32)]

    def frame(number: int) -> Frame:
        return Frame(number + 1, "jpeg", jpegs[number % len(jpegs)])

    def put_state(writer: EpisodeWriter, number: int) -> None:
        writer.write_joints(JOINTS, number + 1, NAMES, *states[number])

    def put_frame(writer: EpisodeWriter, number: int) -> None:
        writer.write_frame(PICTURES, frame(number))

    def write(put: Callable[[EpisodeWriter, int], None], count: int, *, live: bool) -> None:
        with EpisodeWriter(log, EpisodeInfo(), overwrite=True, live=live) as writer:
            for number in range(count):
                put(writer, number)

    sync, os.fdatasync = os.fdatasync, lambda _file: None  # the disk is not what is measured
    with tempfile.TemporaryDirectory() as folder:
        log, bare = Path(folder) / "a.mcap", Path(folder) / "bare.mcap"
        for name, many, kind, put, make in (
            ("joint states", count, messages.JOINT_STATE, put_state, partial(_state, states)),
            ("JPEG frames", max(count // 16, 1), messages.COMPRESSED_IMAGE, put_frame,
             lambda number: messages.frame(frame(number))[1]),
        ):  # fmt: skip
            works = [partial(write, put, many, live=live) for live in (True, False)]
            live_s, file_s, bare_s = best_s(
                [*works, partial(_write_bare, bare, kind, make, many)], rounds
            )
            yield f"{name}, live: a second", many / live_s
            yield f"{name}, live: speed over that of bare mcap", bare_s / live_s
            yield f"{name}, from a file: speed over that of bare mcap", bare_s / file_s
    os.fdatasync = sync
    data = _state(states, 0)

    def through_a_queue() -> None:
        queue: TopicQueue[bytes] = TopicQueue(2**40, drops=True)
        for number in range(count):
            queue.put(JOINTS, number, data, len(data))
        while queue.take() is not None:
            pass

    yield "put in a queue and taken: a second", count / best_s([through_a_queue], rounds)[0]


def _state(states: Array, number: int) -> bytes:
    state = messages.joint_state(number + 1, NAMES, *states[number])
    return messages.encode(state, messages.JOINT_STATE)


def _write_bare(
    log: Path, kind: str, make: Callable[[int], bytes], count: int, rate_hz: int = 10**9
) -> None:
    """Write by the mcap library alone."""
    with log.open("wb") as file:
        writer = Writer(
            file, chunk_size=64 * 1024, compression=CompressionType.ZSTD, enable_data_crcs=True
        )
        writer.start(profile="ros2")
        schema = writer.register_schema(kind, "ros2msg", messages.definition(kind).encode())
        channel = writer.register_channel(JOINTS, "cdr", schema)
        for number in range(count):
            stamp_ns = 1 + number * (10**9 // rate_hz)
            writer.add_message(channel, stamp_ns, make(number), stamp_ns, number)
        writer.finish()


# ---- A camera and an arm.


def recording(seconds: float) -> Figures:
    """Record 640 x 480 at 60 Hz by the command; then JPEGs made at 60 Hz and joints at 1 kHz, in
    the process that makes them, beside one that makes them and takes nothing.
    """
    frames = round(seconds * _CAMERA_HZ)
    plan = {"frames": frames, "rate_hz": _CAMERA_HZ, "size": (640, 480), "distinct": 120}
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "stream.mcap"
        with playing(**plan) as address:
            start_s = time.perf_counter()
            words = [*RECORD, "--camera", f"http://{address}", "-o", str(log)]
            done = ended(subprocess.Popen(words, stdout=subprocess.DEVNULL))
        wall_s = time.perf_counter() - start_s
        yield "stream: pictures sent", frames
        yield "stream: lost", frames - read_episode(log).info.counts["written"]
        yield from _told("stream", done, wall_s)
        log = Path(folder) / "live.mcap"
        shares = []
        for path in (log, ""):
            code = f"from tests.bench.recordings import make; make({str(path)!r}, {seconds})"
            start_s = time.perf_counter()
            done = ended(subprocess.Popen([sys.executable, "-c", code], cwd=ROOT))
            wall_s = time.perf_counter() - start_s
            if path:
                yield (
                    "live: messages due",
                    round(seconds * _CAMERA_HZ) + round(seconds * _JOINTS_HZ),
                )
                for name, count in read_episode(log).info.counts.items():
                    yield f"live: {name}", count
                yield from _told("live", done, wall_s)
            shares.append(100 * done.cpu_s / wall_s)
        yield "live: % of a core for making the messages", shares[1]


def make(log: str, seconds: float) -> None:
    """Make noisy JPEGs and joint states on time, and record them; nowhere where `log` is ""."""
    rng = np.random.default_rng(0)
    ramp = np.linspace(60, 200, 640)[None, :, None] + np.zeros((480, 1, 3))
    scenes = [(ramp + rng.normal(0, 12, ramp.shape)).clip(0, 255).astype(np.uint8) for _ in "1234"]
    states = rng.normal(size=(1000, 3, 7))
    live = LiveRecording(Path(log), EpisodeInfo(source="benchmark")) if log else None

    def film(number: int) -> None:
        quality = [cv2.IMWRITE_JPEG_QUALITY, 90]
        data = cv2.imencode(".jpg", scenes[number % len(scenes)], quality)[1].tobytes()
        if live:
            live.put_frame(PICTURES, Frame(now_ns(), "jpeg", data))

    def feel(number: int) -> None:
        stamp_ns, values = now_ns(), states[number % len(states)]
        if live:
            live.put_joints(JOINTS, stamp_ns, NAMES, *values)

    def repeat(work: Callable[[int], None], rate_hz: float) -> None:
        """Repeat work at a rate; what is late is made up for."""
        start_s = time.monotonic()
        for number in range(round(rate_hz * seconds)):
            time.sleep(max(0.0, start_s + number / rate_hz - time.monotonic()))
            work(number)

    def both() -> None:
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(repeat, (film, feel), (_CAMERA_HZ, _JOINTS_HZ)))

    if live is None:
        both()
        return
    with live:
        both()


def live_joints(seconds: float, kept: int, buffer: int, *, best_effort: bool) -> Figures:
    """Publish JointState at 1 kHz over loopback and DDS; stop the recorder twice for 0.5 s.

    `kept` is how many messages the publisher keeps to send again; `buffer`, how many bytes the
    system holds for the recorder (212992 on a Linux as it is installed; 0 as it comes);
    `best_effort` publishes without sending again.
    """
    count = round(seconds * _JOINTS_HZ)
    plan = {
        "topics": {STATES: "states"}, "messages": count, "rate_hz": _JOINTS_HZ, "kept": kept,
        "reliable": not best_effort, "longest_s": seconds + 60,
    }  # fmt: skip
    environment = dict(os.environ)
    if buffer:
        text = f'<SocketReceiveBufferSize min="default" max="{buffer}B"/>'
        asked = f"<CycloneDDS><Domain><Internal>{text}</Internal></Domain></CycloneDDS>"
        environment["CYCLONEDDS_URI"] = asked
    with tempfile.TemporaryDirectory() as folder, publishing(77, **plan) as publisher:
        log = Path(folder) / "a.mcap"
        words = ["--joint-states", STATES, "--loopback", "--domain", "77", "-o", str(log)]
        start_s = time.perf_counter()
        process = subprocess.Popen([*RECORD, *words], env=environment, stdout=subprocess.DEVNULL)
        expect(publisher, "matched")
        first_s = time.perf_counter()
        for share in (0.25, 0.65):
            time.sleep(max(0.0, first_s + share * seconds - time.perf_counter()))
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.5)
            process.send_signal(signal.SIGCONT)
        first_ns, _ = expect(publisher, "sent")
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        done = ended(process)
        wall_s = time.perf_counter() - start_s
        signals = read_episode(log).signals
    parts = [signals[f"{STATES}.{label}"] for label in ("position", "velocity", "effort")]
    due_ns = int(first_ns) + np.round(np.arange(count) * 1e9 / _JOINTS_HZ).astype(np.int64)
    numbers = np.searchsorted(due_ns, parts[0].stamps_ns).clip(0, count - 1)
    expected = np.array([values_of(int(number)) for number in numbers])
    values = np.stack([one.values for one in parts], axis=1)
    is_right = np.all(values == expected, axis=(1, 2)) & (due_ns[numbers] == parts[0].stamps_ns)
    is_right &= all(one.columns == ARM_NAMES for one in parts)
    yield "sent", count
    yield "missing", count - len(np.unique(numbers[is_right]))
    yield "bad: messages that are not what was sent", int(np.count_nonzero(~is_right))
    yield from _told("recorder", done, wall_s)
