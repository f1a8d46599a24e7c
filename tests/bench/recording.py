"""Measure recording in real time: messages dropped, and the share of a core it takes.

`python -m tests.bench.recording` runs, for a minute each:

- `stream`: 640 x 480 at 60 Hz from a loopback camera in a process of its own, to `tunenet-record`
  in another;
- `live`: noisy 640 x 480 pictures, compressed to JPEG at 60 Hz, and seven joints at 1 kHz, in one
  process through LiveRecording; beside it the same process with a recording that takes nothing,
  so that it shows what making the messages costs.

Name one to run it alone; `--seconds` changes the minute.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from tests.recorders.live_recorder import JOINTS, NAMES, PICTURES
from tests.recorders.mjpeg_camera import playing
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.session import LiveRecording
from tunenet_logs.timing.stamps import now_ns

BIN = Path(sys.executable).parent
_SIZE = (640, 480)
_CAMERA_HZ, _JOINTS_HZ = 60.0, 1000.0
_QUALITY = 90


def measured(words: list[object]) -> tuple[float, float, str]:
    """Run a process; return wall and processor time [s], and a line on memory and exit."""
    start = time.perf_counter()
    process = subprocess.Popen([str(word) for word in words], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    wall_s = time.perf_counter() - start
    process.returncode = os.waitstatus_to_exitcode(status)
    ended = f"{usage.ru_maxrss / 1024:.0f} MiB of memory at most; exit code {process.returncode}"
    return wall_s, usage.ru_utime + usage.ru_stime, ended


def in_words(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items())


def run_stream(seconds: float) -> None:
    """Record a network camera through the command."""
    frames = round(seconds * _CAMERA_HZ)
    plan = {"frames": frames, "rate_hz": _CAMERA_HZ, "size": _SIZE, "distinct": 120}
    with playing(**plan) as address, tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "a.mcap"
        words = [BIN / "tunenet-record", "--camera", f"http://{address}", "-o", log]
        wall_s, cpu_s, ended = measured(words)
        counts = read_episode(log).info.counts
        size = log.stat().st_size
    print(f"stream: sent {frames}, {in_words(counts)}")
    print(f"  lost {frames - counts['written']} frames; {size / frames / 1000:.1f} kB a frame")
    print(f"  {wall_s:.1f} s, {cpu_s:.1f} s of processor: {100 * cpu_s / wall_s:.1f} % of a core")
    print(f"  {ended}")


def run_live(seconds: float) -> None:
    """Record pictures and joints through LiveRecording, and make them alone."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "a.mcap"
        program = [sys.executable, "-m", "tests.bench.recording", "--seconds", seconds]
        wall_s, cpu_s, ended = measured([*program, "--write", log])
        counts = read_episode(log).info.counts
        size = log.stat().st_size
        _, bare_s, _ = measured([*program, "--write", "nothing"])
    due = round(seconds * _CAMERA_HZ) + round(seconds * _JOINTS_HZ)
    print(f"live: due {due}, {in_words(counts)}; {size / 1e6:.0f} MB")
    print(f"  {wall_s:.1f} s, {cpu_s:.1f} s of processor: {100 * cpu_s / wall_s:.1f} % of a core")
    print(f"  of which making the messages: {100 * bare_s / wall_s:.1f} %")
    print(f"  {ended}")


def _write(log: str, seconds: float) -> None:
    """Make messages on time and record them, in the measured process."""
    if log == "nothing":
        _make(seconds, lambda _stamp_ns, _data: True, lambda _stamp_ns, _values: True)
        return
    with LiveRecording(Path(log), EpisodeInfo(source="benchmark")) as recording:
        _make(
            seconds,
            lambda stamp_ns, data: recording.put_frame(PICTURES, Frame(stamp_ns, "jpeg", data)),
            lambda stamp_ns, values: recording.put_joints(JOINTS, stamp_ns, NAMES, *values),
        )


def _make(
    seconds: float,
    put_picture: Callable[[int, bytes], bool],
    put_joints: Callable[[int, np.ndarray], bool],
) -> None:
    import cv2

    rng = np.random.default_rng(0)
    width, height = _SIZE
    ramp = np.linspace(60, 200, width)[None, :, None] + np.zeros((height, 1, 3))
    scenes = [(ramp + rng.normal(0, 12, ramp.shape)).clip(0, 255).astype(np.uint8) for _ in "1234"]
    states = rng.normal(size=(1000, 3, 7))
    quality = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]

    def film(number: int) -> None:
        data = cv2.imencode(".jpg", scenes[number % len(scenes)], quality)[1].tobytes()
        put_picture(now_ns(), data)

    def feel(number: int) -> None:
        put_joints(now_ns(), states[number % len(states)])

    threads = [
        threading.Thread(target=_repeat, args=(film, _CAMERA_HZ, seconds)),
        threading.Thread(target=_repeat, args=(feel, _JOINTS_HZ, seconds)),
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def _repeat(work: Callable[[int], None], rate_hz: float, seconds: float) -> None:
    """Repeat work at a rate; what is late is made up for."""
    start = time.monotonic()
    for number in range(round(rate_hz * seconds)):
        if (early_s := start + number / rate_hz - time.monotonic()) > 0:
            time.sleep(early_s)
        work(number)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="*", choices=[[], "stream", "live"], help="default: both")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--write", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.write:
        _write(arguments.write, arguments.seconds)
        return
    if not arguments.what or "stream" in arguments.what:
        run_stream(arguments.seconds)
    if not arguments.what or "live" in arguments.what:
        run_live(arguments.seconds)


if __name__ == "__main__":
    main()
