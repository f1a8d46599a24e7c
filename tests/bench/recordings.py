"""Measure how logs are read, written, recorded in real time: sections of `python -m tests.bench`.

Those of a network camera need GStreamer's server (Debian's gir1.2-gst-rtsp-server-1.0 and
python3-gi) and FFmpeg.
"""

from __future__ import annotations

import math
import os
import queue
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import av
import cv2
import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from tests.bench import ROOT, Figures, best_s
from tests.recorders.live_recorder import JOINTS, NAMES, PICTURES
from tests.recorders.live_wait import wait_until
from tests.recorders.mjpeg_camera import picture, playing
from tests.recorders.programs import file_pictures, gst_rtsp_server
from tests.recorders.ros2_publisher import NAMES as ARM_NAMES
from tests.recorders.ros2_publisher import STATES, expect, publishing, values_of
from tunenet_logs import messages
from tunenet_logs.episode import Array, EpisodeInfo, Frame
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import LiveRecording, TopicQueue
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
        log = Path(folder) / "a.mcap"
        for name, many, kind, put, make in (
            ("joint states", count, messages.JOINT_STATE, put_state, partial(_state, states)),
            ("JPEG frames", max(count // 16, 1), messages.COMPRESSED_IMAGE, put_frame,
             lambda number: messages.frame(frame(number))[1]),
        ):  # fmt: skip
            works = [partial(write, put, many, live=live) for live in (True, False)]
            live_s, file_s, bare_s = best_s(
                [*works, partial(_write_bare, log, kind, make, many)], rounds
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


# ---- A camera on the network.

# GStreamer's codec and FFmpeg's encoder of a film, and how it is told.
CODERS = {
    "h264": ("h264", "libx264", ("-bf", "0")),
    "h264, B-frames": ("h264", "libx264", ("-bf", "2")),
    "h265": ("h265", "libx265", ("-x265-params", "log-level=none:bframes=0")),
    "h265, B-frames": ("h265", "libx265", ("-x265-params", "log-level=none:bframes=3")),
    "mjpeg": ("jpeg", "mjpeg", ("-pix_fmt", "yuvj420p", "-huffman", "default", "-q:v", "5")),
}
# How a film comes, and when a network passes on what came so long after the first [s].
WAYS: dict[str, Callable[[float], float] | None] = {
    "udp": None,
    "tcp": None,
    "tcp, jitter": lambda since_s: since_s + random.uniform(0, 0.04),
    "tcp, bursts": lambda since_s: math.ceil(since_s / 0.1) * 0.1,
    "tcp, stall": lambda since_s: max(since_s, 4.0) if since_s > 2.0 else since_s,
}
_SPARE_S = 1e-4  # beyond a film's last picture, for its recording: stamps of RTP are rounded


def network_load(seconds: float) -> Figures:
    """Record 4K at 30 Hz and 1080p at 60 Hz, H.264, while another process keeps a core busy."""
    for name, size, rate_hz, bits in (
        ("4K", "3840x2160", 30, "16M"),
        ("1080p", "1920x1080", 60, "8M"),
    ):
        with tempfile.TemporaryDirectory() as folder:
            short, long, log = (Path(folder) / one for one in ("a.mp4", "long.mp4", "a.mcap"))
            _encode(short, size, rate_hz, 4, "libx264", "-bf", "0", "-b:v", bits)
            looped = "-stream_loop", "-1", "-i", short, "-t", f"{seconds:g}", "-c", "copy"
            _ffmpeg(*looped, long)
            with (
                gst_rtsp_server(file_pictures(long)) as address,
                subprocess.Popen([sys.executable, "-c", "while True: pass"]) as busy,
            ):
                process = _recorder(address, log, seconds - 1 / rate_hz + _SPARE_S)
                active = log.with_name(f"{log.name}.active")
                wait_until(lambda: active.exists() and active.stat().st_size > 500_000, "pictures")  # noqa: B023
                time.sleep(seconds / 4)
                early_s, early_mib = _used(process.pid)
                time.sleep(seconds / 2)
                late_s, late_mib = _used(process.pid)
                yield f"{name}: last line", _last_line(process)
                busy.kill()
            with av.open(str(long)) as container:
                sent = sum(bool(packet.size) for packet in container.demux(video=0))
            info = read_episode(log).info
            yield f"{name}: pictures sent", sent
            yield f"{name}: lost", sent - info.counts["written"]
            yield f"{name}: longest lag [s]", str(info.notes.get("longest_lag_s", "under 0.5"))
            cpu_ms = 1e3 * (late_s - early_s) / (rate_hz * seconds / 2)
            yield f"{name}: processor a picture, after the start [ms]", cpu_ms
            yield f"{name}: memory after a quarter [MiB]", early_mib
            yield f"{name}: memory after three [MiB]", late_mib


def network_films(seconds: float) -> Figures:
    """Record codecs at 30 to 120 Hz over UDP, TCP, and TCP in a network that delays."""
    for name, (codec, coder, options) in CODERS.items():
        for rate_hz in (30, 60, 120):
            with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor() as pool:
                path = Path(folder) / "a.mov"
                _encode(path, "640x360", rate_hz, seconds, coder, *options)
                length_s = seconds - 1 / rate_hz + _SPARE_S
                jobs = [pool.submit(_come, path, codec, length_s, way) for way in WAYS]
                for way, job in zip(WAYS, jobs, strict=True):
                    for what, value in job.result().items():
                        yield f"{name}, {rate_hz} Hz, {way}: {what}", value


def _encode(path: Path, size: str, rate_hz: int, seconds: float, coder: str, *options: str) -> None:
    """Encode a moving test picture with noise as cameras do: a key frame every second."""
    scene = f"testsrc2=size={size}:rate={rate_hz}:duration={seconds:g},noise=alls=12:allf=t"
    words = "-f", "lavfi", "-i", scene, "-c:v", coder, "-preset", "ultrafast"
    _ffmpeg(*words, "-g", rate_hz, "-pix_fmt", "yuv420p", *options, path)


def _ffmpeg(*words: object) -> None:
    program = shutil.which("ffmpeg")
    if program is None:
        sys.exit("ffmpeg is not installed; it makes the films")
    subprocess.run([program, "-v", "error", "-y", *map(str, words)], check=True)


def _recorder(address: str, log: Path, seconds: float, *options: str) -> subprocess.Popen[str]:
    """Record for as long as the film is, which the server begins anew for each caller."""
    words = ["--camera", f"rtsp://{address}", "-o", str(log), *options]
    return subprocess.Popen(
        [*RECORD, *words, "--quiet", "--seconds", str(seconds)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def _last_line(process: subprocess.Popen[str]) -> str:
    out, err = process.communicate()
    return (out.strip() or err.strip()).splitlines()[-1]


def _used(process: int) -> tuple[float, float]:
    """Return processor time [s] and memory [MiB] of a process so far."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
    ticks = int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK"), pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _come(path: Path, codec: str, seconds: float, way: str) -> dict[str, float | str]:
    """Record a film that comes in such a way; compare pictures and stamps with its own."""
    log = path.with_name(f"{way}.mcap")
    with gst_rtsp_server(file_pictures(path, codec)) as address, slowed(address, way) as near:
        line = _last_line(_recorder(near, log, seconds, "--rtsp-transport", way[:3]))
    same, stamps_ns, film_s = 0, [], []
    with av.open(str(path)) as container:
        frames = read_episode(log).frames()
        for one in container.decode(video=0):
            film_s.append(one.time or 0.0)
            if (frame := next(frames, None)) is not None:
                stamps_ns.append(frame.stamp_ns)
                same += _pixels(frame) == one.to_ndarray(format="rgb24").tobytes()
    told = {"pictures of the film": len(film_s), "the same": same, "last line": line}
    if not stamps_ns:
        return told
    stamps_s = (np.array(stamps_ns[: len(film_s)]) - stamps_ns[0]) * 1e-9
    off_ms = 1e3 * (stamps_s - (np.array(film_s[: len(stamps_s)]) - film_s[0]))
    return told | {"stamps off by [ms]": float(np.ptp(off_ms) / 2)}


def _pixels(frame: Frame) -> bytes:
    """Decode a log's picture, as FFmpeg does a film's."""
    if frame.encoding != "jpeg":
        return frame.data
    decoder = av.CodecContext.create("mjpeg", "r")
    assert isinstance(decoder, av.VideoCodecContext)
    return decoder.decode(av.Packet(frame.data))[0].to_ndarray(format="rgb24").tobytes()


@contextmanager
def slowed(address: str, way: str) -> Iterator[str]:
    """Open the same address by way of such a network: it delays what the server sends, in a process
    of its own, and loses nothing.
    """
    if WAYS[way] is None:
        yield address
        return
    host, _, path = address.partition("/")
    code = f"from tests.bench.recordings import delay; delay({host.rpartition(':')[2]}, {way!r})"
    words = [sys.executable, "-c", code]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        assert process.stdout is not None
        yield f"127.0.0.1:{int(process.stdout.readline())}/{path}"
    finally:
        process.kill()
        process.communicate()


def delay(port: int, way: str) -> None:
    """Pass one connection on to a port of this machine, and say at which port."""
    how = WAYS[way]
    assert how is not None
    with socket.create_server(("127.0.0.1", 0)) as listener:
        print(listener.getsockname()[1], flush=True)
        caller, _ = listener.accept()
    server = socket.create_connection(("127.0.0.1", port))
    for one in (caller, server):
        one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    held: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()

    def pass_on_at_once() -> None:
        with suppress(OSError):
            while data := caller.recv(65536):
                server.sendall(data)
            server.shutdown(socket.SHUT_WR)

    def hold_back() -> None:
        """Queue what the server sends with its due time; nothing in the end."""
        start_s, data = time.monotonic(), b"any"
        while data:
            try:
                data = server.recv(65536)
            except OSError:
                data = b""
            held.put((start_s + how(time.monotonic() - start_s), data))

    for work in (pass_on_at_once, hold_back):
        threading.Thread(target=work, daemon=True).start()
    with suppress(OSError):
        while (piece := held.get())[1]:
            time.sleep(max(0.0, piece[0] - time.monotonic()))
            caller.sendall(piece[1])
    caller.close()
