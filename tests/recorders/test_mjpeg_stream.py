"""A network camera over real sockets: what it sends arrives, whatever else it does."""

from __future__ import annotations

import hashlib
import io
import itertools
import re
import signal
import subprocess
import threading
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import BIN
from tests.recorders.live_wait import LAST_RESORT_S, Terminal, ending, wait_until
from tests.recorders.mjpeg_camera import check_times, number_in, picture, playing
from tests.recorders.server_thread import beside
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.errors import CameraError
from tunenet_logs.messages import is_whole
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.recording import Limits, record_camera
from tunenet_logs.recorders.camera.sources import open_source
from tunenet_logs.recorders.camera.streams import MultipartParser
from tunenet_logs.recorders.session import Summary
from tunenet_logs.terminal import Bar, Progress
from tunenet_logs.timing.stamps import MAX_SPEED_CAMERA_HZ, measured_hz

pytestmark = pytest.mark.live

QUIET = Progress(quiet=True)


def record(address: str, path: Path, **limits: object) -> tuple[Summary, Episode]:
    """Record to `path` in this process, and read it back."""
    source = open_source(f"http://{address}", CameraOptions(stall_s=LAST_RESORT_S))
    summary = record_camera(
        source,
        EpisodeInfo(kind="drop"),
        path,
        limits=Limits(**{"stall_s": LAST_RESORT_S, **limits}),  # type: ignore[arg-type]
        overwrite=False,
        progress=QUIET,
    )
    episode = read_episode(path)
    counts = dict(episode.info.counts)
    assert not episode.warnings
    assert not path.with_name(path.name + ".active").exists()
    assert counts["captured"] == counts["written"] + counts["dropped"]
    assert counts["written"] == len(list(episode.frames())) == summary.written
    return summary, episode


def numbers(episode: Episode) -> list[int]:
    return [number_in(frame.decode()) for frame in episode.frames()]


@pytest.mark.parametrize("rate_hz", [pytest.param(30.0, marks=pytest.mark.slow), 120.0])
def test_every_frame_arrives_in_order_with_its_bytes_and_time(tmp_path: Path, rate_hz: float):
    with playing(frames=60, rate_hz=rate_hz) as address:
        summary, episode = record(address, tmp_path / "a.mcap", stamps="arrival")
        check_times(tmp_path / "a.mcap", address)
    assert summary.dropped == 0
    assert [frame.data for frame in episode.frames()] == [picture(index) for index in range(60)]
    assert np.all(np.diff([frame.stamp_ns for frame in episode.frames()]) > 0)


def test_the_log_says_where_it_came_from_and_how_fast(tmp_path: Path):
    with playing(frames=20, rate_hz=200.0) as address:
        summary, episode = record(address, tmp_path / "a.mcap")
    info = episode.info
    assert info.kind == "drop"
    assert info.source == f"camera http://{address}"
    assert info.notes["size_px"] == "320x240"
    rate_hz = measured_hz([frame.stamp_ns for frame in episode.frames()], MAX_SPEED_CAMERA_HZ)
    assert float(info.notes["measured_hz"]) == pytest.approx(rate_hz, abs=0.001)
    assert summary.rate_hz == pytest.approx(rate_hz, abs=0.001)
    assert "closed" in info.notes["ended"]


@pytest.mark.parametrize("boundary", ["frame", "--frame", '"frame"', ""])
@pytest.mark.parametrize("with_length", [True, False])
def test_senders_differ_in_their_delimiters(tmp_path: Path, boundary: str, with_length: bool):
    plan = {"frames": 20, "rate_hz": 500.0, "boundary": boundary, "with_length": with_length}
    with playing(**plan) as address:
        _, episode = record(address, tmp_path / "a.mcap")
    assert [frame.data for frame in episode.frames()] == [picture(index) for index in range(20)]


def test_a_connection_that_closes_ends_the_recording_with_the_reason(tmp_path: Path):
    with playing(frames=60, rate_hz=200.0, close_after=30) as address:
        summary, episode = record(address, tmp_path / "a.mcap")
    assert numbers(episode) == list(range(30))
    assert "closed by the camera" in summary.ended
    assert episode.info.notes["ended"] == summary.ended


def test_a_camera_that_falls_silent_ends_the_recording_with_the_reason(tmp_path: Path):
    plan = {"rate_hz": 0, "size": (256, 16)}  # in one piece that sockets hold: no pause before
    with playing(frames=60, stall_after=30, **plan) as address:
        _, episode = record(address, tmp_path / "a.mcap", stall_s=1.0)
    assert numbers(episode) == list(range(30))
    assert episode.info.notes["ended"] == "no frame for 1.0 s"


def test_a_camera_that_is_silent_from_the_beginning_is_told_and_leaves_no_log(tmp_path: Path):
    words = r"no frame came \(no frame for 0.3 s\); try again with a longer --stall"
    with playing(slow_start_s=3600) as address, pytest.raises(CameraError, match=words):
        record(address, tmp_path / "a.mcap", stall_s=0.3)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("with_length", [True, False])
@pytest.mark.parametrize("cut_lies", [False, True])
def test_cut_pictures_are_counted_and_skipped(tmp_path: Path, with_length: bool, cut_lies: bool):
    plan = {"frames": 30, "cut_every": 10, "with_length": with_length, "cut_lies": cut_lies}
    with playing(rate_hz=200.0, **plan) as address:
        summary, episode = record(address, tmp_path / "a.mcap")
    assert numbers(episode) == [number for number in range(30) if number % 10 != 9]
    assert summary.damaged == episode.info.counts["damaged"] == 3
    assert summary.captured == 27


def test_jitter_and_a_slow_start_lose_nothing(tmp_path: Path):
    plan = {"frames": 60, "rate_hz": 120.0, "jitter_s": 0.005, "slow_start_s": 0.3}
    with playing(**plan) as address:
        summary, episode = record(address, tmp_path / "a.mcap", stamps="arrival")
        check_times(tmp_path / "a.mcap", address)
    assert numbers(episode) == list(range(60))
    assert summary.dropped == 0


def test_a_slow_writer_drops_the_newest_and_counts(tmp_path: Path):
    class SlowBar(Progress):
        """Holds the writer up, as a slow disk does, until the camera's reader has read it all."""

        @contextmanager
        def bar(self, total: int | None, what: str, unit: str) -> Iterator[Bar]:
            yield self

        def set_postfix_str(self, text: str, /, *, refresh: bool) -> None:
            pass

        def update(self, _done: int, /) -> None:
            for thread in threading.enumerate():
                if thread.name == "camera":
                    thread.join(LAST_RESORT_S)

    with playing(frames=60, rate_hz=500.0) as address:
        summary = record_camera(
            open_source(f"http://{address}", CameraOptions(stall_s=LAST_RESORT_S)),
            EpisodeInfo(),
            tmp_path / "a.mcap",
            limits=Limits(queue_bytes=100_000, stall_s=LAST_RESORT_S),
            overwrite=False,
            progress=SlowBar(),
        )
    sizes = np.cumsum([len(picture(number)) for number in range(60)])
    fit = int(np.count_nonzero(sizes <= 100_000))  # beside the one that is taken out first
    seen = numbers(read_episode(tmp_path / "a.mcap"))
    assert fit > 2
    assert seen[:fit] == list(range(fit))
    assert seen == sorted(set(seen))
    assert len(seen) == summary.written <= fit + 1
    assert (summary.captured, summary.dropped) == (60, 60 - len(seen))
    counts = read_episode(tmp_path / "a.mcap").info.counts
    assert counts == {"captured": 60, "written": len(seen), "dropped": 60 - len(seen)}


def test_so_many_seconds_by_the_frames_own_clock(tmp_path: Path):
    with playing(frames=100_000, rate_hz=100.0, distinct=20) as address:
        summary, episode = record(address, tmp_path / "a.mcap", seconds=0.5)
    stamps_ns = [frame.stamp_ns for frame in episode.frames()]
    assert stamps_ns[-1] - stamps_ns[0] < 500_000_000
    assert numbers(episode) == [number % 20 for number in range(summary.written)]
    assert "ended" not in episode.info.notes


def recorder(
    folder: Path, address: str, stderr: int = subprocess.PIPE
) -> AbstractContextManager[subprocess.Popen[str]]:
    """The command, recording a.mcap in a process of its own."""
    words = [BIN / "tunenet-record", "--camera", f"http://{address}", "-o", "a.mcap"]
    return ending(
        subprocess.Popen(
            [*words, "--stall", str(LAST_RESORT_S)],
            cwd=folder, text=True, stdout=subprocess.PIPE, stderr=stderr,
        )
    )  # fmt: skip


def holds(log: Path, size: int) -> bool:
    """Whether so many bytes are in a log."""
    return log.exists() and log.stat().st_size >= size


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_real_process_cleanly(tmp_path: Path, number: int):
    with (
        playing(frames=100_000, rate_hz=100.0, distinct=20) as address,
        recorder(tmp_path, address) as process,
    ):
        wait_until(lambda: holds(tmp_path / "a.mcap.active", 300_000), "so many bytes of frames")
        process.send_signal(number)
        out, err = process.communicate(timeout=LAST_RESORT_S)
    assert process.returncode == 0, err
    assert "stopped by a signal" in out
    assert not err
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]
    episode = read_episode(tmp_path / "a.mcap")
    seen = numbers(episode)
    assert len(seen) == episode.info.counts["written"] > 5
    assert seen == [number % 20 for number in range(len(seen))]
    assert not episode.warnings


def test_killed_it_keeps_what_was_in_the_file(tmp_path: Path):
    active = tmp_path / "a.mcap.active"
    with (
        playing(frames=100_000, rate_hz=100.0, distinct=20) as address,
        recorder(tmp_path, address) as process,
    ):
        wait_until(lambda: holds(active, 300_000), "so many bytes of frames")
        process.kill()
        process.communicate()
    frames = [frame.data for frame in read_episode(active).frames()]
    assert frames == [picture(number % 20) for number in range(len(frames))]
    chunk = 64 * 1024 + max(len(one) for one in frames)
    assert sum(len(one) for one in frames) > active.stat().st_size - chunk  # the one that was cut


def test_a_terminal_shows_frames_rate_and_losses(tmp_path: Path):
    with closing(Terminal()) as terminal, playing(frames=100_000, distinct=20) as address:
        with recorder(tmp_path, address, terminal.theirs) as process:
            terminal.wait_for(r"recording: \d+frame .*frame/s, 0 dropped")
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=LAST_RESORT_S)
        assert process.returncode == 0


def test_user_and_password_by_digest(tmp_path: Path):
    class Handler(BaseHTTPRequestHandler):
        """Wants a digest (RFC 2617, without qop, as older cameras do)."""

        def log_message(self, format: str, *_words: object) -> None:  # noqa: A002
            pass

        def do_GET(self) -> None:
            given = dict(re.findall(r'(\w+)="([^"]*)"', self.headers.get("Authorization", "")))
            secrets = ("me:camera:secret", f"GET:{self.path}")
            first, second = (hashlib.md5(one.encode()).hexdigest() for one in secrets)
            wanted = hashlib.md5(f"{first}:n0:{second}".encode()).hexdigest()
            if given.get("response") != wanted:
                self.send_response(401)
                self.send_header("WWW-Authenticate", 'Digest realm="camera", nonce="n0"')
                self.end_headers()
                return
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            for number in range(5):
                self.wfile.write(b"--frame\r\n\r\n" + picture(number) + b"\r\n")

    with beside(HTTPServer(("127.0.0.1", 0), Handler)) as place:
        _, episode = record(f"me:secret@{place}/video", tmp_path / "a.mcap")
    assert numbers(episode) == list(range(5))


STREAM = b"".join(
    b"--frame\r\nContent-Type: image/jpeg\r\n" + length + b"\r\n" + picture(number) + b"\r\n"
    for number, length in enumerate([b"", b"Content-Length: %d\r\n" % len(picture(1)), b""])
)


def parts_of(data: bytes, sizes: list[int], boundary: str = "frame") -> list[bytes]:
    """The parts of a stream that arrives in pieces of these sizes."""
    file = io.BytesIO(data)
    lengths = itertools.chain(sizes, itertools.repeat(100_000))

    def read(most: int) -> bytes:
        return file.read(min(most, next(lengths)))

    return [part.data for part in MultipartParser(read, boundary, lambda: 0).parts()]


@given(st.lists(st.integers(1, 3000), max_size=60), st.sampled_from(["frame", "--frame", ""]))
def test_it_does_not_matter_how_a_stream_is_cut_on_its_way(sizes: list[int], boundary: str):
    assert parts_of(STREAM, sizes, boundary) == [picture(number) for number in range(3)]


@given(st.lists(st.integers(1, 3000), max_size=60))
def test_a_part_has_the_time_of_the_read_that_brought_its_first_byte(sizes: list[int]):
    file = io.BytesIO(STREAM)
    reads: list[int] = []
    lengths = itertools.chain(sizes, itertools.repeat(100_000))

    def read(most: int) -> bytes:
        reads.append(file.tell())
        return file.read(min(most, next(lengths)))

    parts = list(MultipartParser(read, "frame", lambda: len(reads)).parts())
    firsts = [STREAM.index(picture(number)) for number in range(3)]
    assert [part.arrived_ns for part in parts] == [bisect_right(reads, one) for one in firsts]


@given(st.binary(max_size=400), st.integers(0, len(STREAM)), st.integers(0, 400))
def test_damage_costs_the_part_that_it_hits_and_no_more_than_the_next(
    noise: bytes, at: int, lost: int
):
    damaged = STREAM[:at] + noise + STREAM[at + lost :] + STREAM
    with suppress(CameraError):
        assert parts_of(damaged, [])[-2:] == [picture(1), picture(2)]


@pytest.mark.parametrize("filler", [b"-", b"--frame", b" ", b"\xff\xd9", b"\n", b"--frame\r\n"])
def test_a_stream_of_nothing_but_delimiters_does_not_hang(filler: bytes):
    with suppress(CameraError):
        parts = parts_of(filler * (400_000 // len(filler)), [])
        assert not any(is_whole(part) for part in parts)
