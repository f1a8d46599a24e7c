"""Record video from a network camera: what is lost, how late it is, its cost and stamps.

`python -m tests.bench.network_video` plays films over RTSP by GStreamer's server (Debian's
gir1.2-gst-rtsp-server-1.0 and python3-gi), each to `tunenet-record` in a process of its own:

- `load`: 4K at 30 Hz and 1080p at 60 Hz, H.264, for a minute each, while another process keeps a
  core busy: pictures lost, the longest lag, processor time a picture without the start of the
  command, and memory after a quarter of the time and at its end;
- `films`: H.264, H.265, B-frames, MJPEG, at 30 to 120 Hz, over UDP, TCP, and TCP in a network that
  delays (see `tests.bench.slow_network`): pictures that are those of the film, and stamps against
  its own.

Name one to run it alone; `--seconds` changes the minute.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import av
import numpy as np

from tests.bench.slow_network import slowed
from tests.recorders.live_wait import wait_until
from tests.recorders.rtsp_servers import file_pictures, gst_rtsp_server
from tunenet_logs.episode import Frame
from tunenet_logs.reader import read_episode

# Name, size, rate [Hz] and bits a second, as IP cameras have them.
LOADS = (("4K", "3840x2160", 30, "16M"), ("1080p", "1920x1080", 60, "8M"))

# GStreamer's codec and FFmpeg's encoder of a film, and how it is told.
CODERS = {
    "h264": ("h264", "libx264", ("-bf", "0")),
    "h264, B-frames": ("h264", "libx264", ("-bf", "2")),
    "h265": ("h265", "libx265", ("-x265-params", "log-level=none:bframes=0")),
    "h265, B-frames": ("h265", "libx265", ("-x265-params", "log-level=none:bframes=3")),
    "mjpeg": ("jpeg", "mjpeg", ("-pix_fmt", "yuvj420p", "-huffman", "default", "-q:v", "5")),
}

# How a film comes, and what a network does to it.
WAYS = {
    "udp": "",
    "tcp": "",
    "tcp, jitter": "jitter",
    "tcp, bursts": "bursts",
    "tcp, stall": "stall",
}

RATES_HZ = (30, 60, 120)
_LOOP_S = 4
_SPARE_S = 1e-4  # beyond a film's last picture, for its recording: stamps of RTP are rounded
_BEGUN_BYTES = 500_000
_BUSY = "while True: pass"


def film(path: Path, size: str, rate_hz: int, seconds: float, coder: str, *options: str) -> Path:
    """Encode a moving test picture with noise as cameras do: a key frame every second."""
    scene = f"testsrc2=size={size}:rate={rate_hz}:duration={seconds:g},noise=alls=12:allf=t"
    words = ["-f", "lavfi", "-i", scene, "-c:v", coder, "-preset", "ultrafast"]
    words += ["-g", str(rate_hz), "-pix_fmt", "yuv420p", *options, str(path)]
    _ffmpeg(words)
    return path


def looped(path: Path, seconds: float) -> Path:
    """Loop the same film."""
    long = path.with_name("long.mp4")
    words = ["-stream_loop", "-1", "-i", str(path), "-t", f"{seconds:g}", "-c", "copy", str(long)]
    _ffmpeg(words)
    return long


def _ffmpeg(words: list[str]) -> None:
    program = shutil.which("ffmpeg")
    if program is None:
        sys.exit("ffmpeg is not installed; it makes the films")
    subprocess.run([program, "-v", "error", "-y", *words], check=True)


@contextmanager
def busy_core() -> Iterator[None]:
    process = subprocess.Popen([sys.executable, "-c", _BUSY])
    try:
        yield
    finally:
        process.kill()
        process.wait()


class Watched:
    """Recording in a process of its own, and what it uses.

    The server begins its film anew for each caller, so the recording is as long as the film.
    """

    def __init__(self, address: str, log: Path, seconds: float, *options: str) -> None:
        words = [
            "-m",
            "tunenet_logs.recorders.cli",
            "--camera",
            f"rtsp://{address}",
            "-o",
            log,
            *options,
        ]
        words += ["--quiet", "--seconds", seconds]
        self._active = log.with_name(f"{log.name}.active")
        self.process = subprocess.Popen(
            [sys.executable, *map(str, words)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def has_begun(self) -> bool:
        """Check whether pictures are in the log, so that what belongs to the start is over."""
        return self._active.exists() and self._active.stat().st_size > _BEGUN_BYTES

    def used(self) -> tuple[float, float]:
        """Return processor time [s] and memory [MiB] so far."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        ticks = int(fields[11]) + int(fields[12])
        pages = int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1])
        page_bytes = os.sysconf("SC_PAGE_SIZE")
        return ticks / os.sysconf("SC_CLK_TCK"), pages * page_bytes / 2**20

    def last_line(self) -> str:
        """Return what it said last."""
        out, err = self.process.communicate()
        return (out.strip() or err.strip()).splitlines()[-1]


def run_load(seconds: float) -> None:
    """Record large and fast pictures, with another core busy."""
    for name, size, rate_hz, bits in LOADS:
        with tempfile.TemporaryDirectory() as folder, busy_core():
            short = film(
                Path(folder) / "a.mp4", size, rate_hz, _LOOP_S, "libx264", "-bf", "0", "-b:v", bits
            )
            long = looped(short, seconds)
            log = Path(folder) / "a.mcap"
            with gst_rtsp_server(file_pictures(long)) as address:
                watched = Watched(address, log, seconds - 1 / rate_hz + _SPARE_S)
                wait_until(watched.has_begun, "pictures")
                time.sleep(seconds / 4)
                early_s, early_mib = watched.used()
                time.sleep(seconds / 2)
                late_s, late_mib = watched.used()
                line = watched.last_line()
            with av.open(str(long)) as container:
                sent = sum(bool(packet.size) for packet in container.demux(video=0))
            info = read_episode(log).info
            lost = sent - info.counts["written"]
            lag_s = info.notes.get("longest_lag_s", "under 0.5")
            cpu_ms = 1e3 * (late_s - early_s) / (rate_hz * seconds / 2)
            kilobytes = log.stat().st_size / 1000 / sent
        print(f"{name} at {rate_hz} Hz, {kilobytes:.0f} kB a picture: sent {sent}, lost {lost}")
        print(f"  longest lag {lag_s} s; {cpu_ms:.2f} ms of processor a picture")
        print(f"  memory {early_mib:.0f} MiB after a quarter, {late_mib:.0f} MiB after three")
        print(f"  {line}")


def run_films(seconds: float) -> None:
    """Record codecs, rates and ways: pictures and stamps against the film's own."""
    for name, (codec, coder, options) in CODERS.items():
        for rate_hz in RATES_HZ:
            with tempfile.TemporaryDirectory() as name_of_folder, ThreadPoolExecutor() as pool:
                path = Path(name_of_folder) / "a.mov"
                film(path, "640x360", rate_hz, seconds, coder, *options)

                length_s = seconds - 1 / rate_hz + _SPARE_S

                def come(
                    way: str, path: Path = path, codec: str = codec, length_s: float = length_s
                ) -> str:
                    return _come(path, codec, length_s, way)

                for way, said in zip(WAYS, pool.map(come, WAYS), strict=True):
                    print(f"{name}, {rate_hz} Hz, {way}: {said}", flush=True)


def _come(path: Path, codec: str, seconds: float, way: str) -> str:
    """Record a film that comes in such a way; return how the log differs."""
    log = path.with_name(f"{way}.mcap")
    with gst_rtsp_server(file_pictures(path, codec)) as address, slowed(address, WAYS[way]) as near:
        line = Watched(near, log, seconds, "--rtsp-transport", way[:3]).last_line()
    return f"{_compared(path, log)}\n  {line}"


def _compared(path: Path, log: Path) -> str:
    """Compare a log's pictures and stamps with the film's."""
    same, stamps_ns, film_s = 0, [], []
    with av.open(str(path)) as container:
        frames = read_episode(log).frames()
        for picture in container.decode(video=0):
            film_s.append(picture.time or 0.0)
            frame = next(frames, None)
            if frame is not None:
                stamps_ns.append(frame.stamp_ns)
                same += _pixels(frame) == picture.to_ndarray(format="rgb24").tobytes()
    count = min(len(stamps_ns), len(film_s))
    if not count:
        return f"none of {len(film_s)} pictures"
    stamps_s = (np.array(stamps_ns[:count]) - stamps_ns[0]) * 1e-9
    off_ms = 1e3 * (stamps_s - (np.array(film_s[:count]) - film_s[0]))
    off_ms -= (off_ms.max() + off_ms.min()) / 2
    return f"{same} of {len(film_s)} pictures the same; stamps off by {np.abs(off_ms).max():.4f} ms"


def _pixels(frame: Frame) -> bytes:
    """Decode a log's picture, as FFmpeg does a film's."""
    if frame.encoding != "jpeg":
        return frame.data
    decoder = av.CodecContext.create("mjpeg", "r")
    assert isinstance(decoder, av.VideoCodecContext)
    return decoder.decode(av.Packet(frame.data))[0].to_ndarray(format="rgb24").tobytes()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="*", choices=[[], "load", "films"], help="default: both")
    parser.add_argument("--seconds", type=float, default=60.0)
    arguments = parser.parse_args()
    if not arguments.what or "load" in arguments.what:
        run_load(arguments.seconds)
    if not arguments.what or "films" in arguments.what:
        run_films(min(arguments.seconds, 5.0))


if __name__ == "__main__":
    main()
