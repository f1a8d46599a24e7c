"""A live MJPEG camera in a process of its own, on a port of its own, that may come and go.

`python -m tests.recorders.coming_camera PORT RATE_HZ LOG START_NS` shows, to whoever asks for any
path, the pictures of a log over and over: the one that is due since START_NS (monotonic), whenever
it was started. So what it shows goes on while nobody can see it, as a room before a camera does.
Its process can be stopped, killed and started again; SIGUSR1 cuts every connection.
"""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from tests.recorders.live_wait import free_port
from tunenet_logs.reader import read_episode

ROOT = Path(__file__).resolve().parents[2]


class _Handler(BaseHTTPRequestHandler):
    rate_hz: float
    start_s: float
    pictures: list[bytes]
    callers: list[socket.socket]

    def log_message(self, format: str, *_words: object) -> None:  # noqa: A002
        pass

    def do_GET(self) -> None:
        self.callers.append(self.connection)
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        number = int((time.monotonic() - self.start_s) * self.rate_hz) + 1
        with suppress(OSError):
            while True:
                late_s = time.monotonic() - self.start_s - number / self.rate_hz
                if late_s > 1 / self.rate_hz:  # stopped meanwhile: what was not filmed is not shown
                    number += int(late_s * self.rate_hz)
                time.sleep(max(0.0, -late_s))
                data = self.pictures[number % len(self.pictures)]
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                self.wfile.write(head.encode() + data + b"\r\n")
                number += 1


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True


def main() -> None:
    port, rate_hz, log, start_ns = sys.argv[1:]
    _Handler.pictures = [frame.data for frame in read_episode(Path(log)).frames()]
    _Handler.rate_hz, _Handler.start_s = float(rate_hz), int(start_ns) * 1e-9
    _Handler.callers = []
    server = _Server(("127.0.0.1", int(port)), _Handler)

    def cut(*_words: object) -> None:
        while _Handler.callers:
            with suppress(OSError):
                _Handler.callers.pop().shutdown(socket.SHUT_RDWR)

    signal.signal(signal.SIGUSR1, cut)
    print("ready", flush=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    while True:
        signal.pause()


class ComingCamera:
    """That camera, as a test wants it.

    Args:
        log: whose pictures it shows.
        rate_hz: at which.

    Attributes:
        address: where it is, or will be.
    """

    def __init__(self, log: Path, rate_hz: float = 60.0) -> None:
        self._port = free_port()
        self.address = f"http://127.0.0.1:{self._port}/video"
        self._words = self._server(log, rate_hz)
        self._process: subprocess.Popen[str] | None = None

    def _server(self, log: Path, rate_hz: float) -> list[str]:
        """The command that serves; it says so in a line."""
        words = [self._port, rate_hz, log, time.monotonic_ns()]
        return [sys.executable, "-m", "tests.recorders.coming_camera", *map(str, words)]

    def come(self) -> None:
        """Start it; it answers afterwards."""
        self._process = subprocess.Popen(self._words, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert self._process.stdout.readline()

    def send(self, number: int) -> None:
        """A signal for its process."""
        assert self._process is not None
        self._process.send_signal(number)

    def go(self) -> None:
        """Kill it; nothing is left of it afterwards, not even on its port."""
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


class ComingRtspCamera(ComingCamera):
    """The same by GStreamer's RTSP server, which begins with the first picture for each caller."""

    def _server(self, log: Path, rate_hz: float) -> list[str]:
        self.address = f"rtsp://127.0.0.1:{self._port}/stream"
        folder = log.with_suffix(".pictures")
        if not folder.exists():
            folder.mkdir()
            for number, frame in enumerate(read_episode(log).frames()):
                (folder / f"{number:05d}.jpg").write_bytes(frame.data)
        pipeline = (
            f"( multifilesrc location={folder}/%05d.jpg loop=true "
            f"caps=image/jpeg,framerate={rate_hz:.0f}/1 ! jpegdec ! videoconvert "
            "! x264enc tune=zerolatency speed-preset=ultrafast bitrate=4000 key-int-max=15 "
            "! rtph264pay name=pay0 pt=96 )"
        )
        server = Path(__file__).with_name("gst_rtsp_server.py")
        return ["/usr/bin/python3", str(server), pipeline, "--port", str(self._port)]


if __name__ == "__main__":
    main()
