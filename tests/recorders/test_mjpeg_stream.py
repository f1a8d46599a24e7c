"""A network camera over real sockets: what it sends arrives, whatever else it or the disk does."""

from __future__ import annotations

import io
import itertools
import signal
import socket
import subprocess
import sys
import threading
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import BIN
from tests.recorders.conftest import Refuses
from tests.recorders.contender import OF_OURS
from tests.recorders.films import PATIENT, MadeSource, numbers, recorded
from tests.recorders.live_wait import LAST_RESORT_S, Terminal, ending, wait_until
from tests.recorders.mjpeg_camera import check_times, picture, playing
from tests.recorders.servers import PART, STREAM, answering
from tunenet_logs.episode import Episode, Frame
from tunenet_logs.errors import CameraError, LogError
from tunenet_logs.messages import is_whole
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.base import CapturedFrame
from tunenet_logs.recorders.camera.sources import open_source
from tunenet_logs.recorders.camera.streams import MultipartParser
from tunenet_logs.recorders.session import Summary
from tunenet_logs.terminal import Bar, Progress
from tunenet_logs.timing.stamps import MAX_SPEED_CAMERA_HZ, measured_hz, now_ns

pytestmark = pytest.mark.live

CAMERA = ("--stall", LAST_RESORT_S, "--camera")
ENDLESS = {"frames": 100_000, "rate_hz": 100.0, "distinct": 20}


def record_from(address: str, path: Path, **limits: Any) -> tuple[Summary, Episode]:
    return recorded(open_source(f"http://{address}", PATIENT), path, **limits)


@pytest.mark.parametrize(
    "plan",
    [
        {"frames": 60, "rate_hz": 120.0},
        {"frames": 60, "rate_hz": 120.0, "jitter_s": 0.005, "slow_start_s": 0.3},
        pytest.param({"frames": 60, "rate_hz": 30.0}, marks=pytest.mark.slow),
    ],
)
def test_every_frame_arrives_in_order_with_its_bytes_and_time(tmp_path: Path, plan: dict):
    with playing(**plan) as address:
        summary, episode = record_from(address, tmp_path / "a.mcap", stamps="arrival")
        check_times(tmp_path / "a.mcap", address)
    assert summary.dropped == 0
    assert [frame.data for frame in episode.frames()] == [picture(index) for index in range(60)]
    stamps_ns = [frame.stamp_ns for frame in episode.frames()]
    assert np.all(np.diff(stamps_ns) > 0)
    info, rate_hz = episode.info, measured_hz(stamps_ns, MAX_SPEED_CAMERA_HZ)
    assert (info.kind, info.source) == ("drop", f"camera http://{address}")
    assert info.notes["size_px"] == "320x240"
    assert float(info.notes["measured_hz"]) == pytest.approx(rate_hz, abs=0.001)
    assert summary.rate_hz == pytest.approx(rate_hz, abs=0.001)
    assert "closed" in info.notes["ended"]


@pytest.mark.parametrize("boundary", ["frame", "--frame", '"frame"', ""])
@pytest.mark.parametrize("with_length", [True, False])
def test_senders_differ_in_their_delimiters(tmp_path: Path, boundary: str, with_length: bool):
    plan = {"frames": 20, "rate_hz": 500.0, "boundary": boundary, "with_length": with_length}
    with playing(**plan) as address:
        _, episode = record_from(address, tmp_path / "a.mcap")
    assert [frame.data for frame in episode.frames()] == [picture(index) for index in range(20)]


@pytest.mark.parametrize(
    ("plan", "says"),
    [
        ({"rate_hz": 200.0, "close_after": 30}, "the stream was closed by the camera"),
        # in one piece that sockets hold, so that nothing pauses before
        ({"rate_hz": 0, "size": (256, 16), "stall_after": 30}, "no frame for 0.5 s"),
    ],
)
def test_a_camera_that_closes_or_falls_silent_ends_it_with_the_reason(tmp_path: Path, plan, says):
    stall_s = 0.5 if "stall_after" in plan else LAST_RESORT_S
    with playing(frames=60, **plan) as address:
        summary, episode = record_from(address, tmp_path / "a.mcap", stall_s=stall_s)
    assert numbers(episode) == list(range(30))
    assert says in summary.ended
    assert episode.info.notes["ended"] == summary.ended


def test_a_camera_that_is_silent_from_the_beginning_is_told_and_leaves_no_log(tmp_path: Path):
    words = r"no frame came \(no frame for 0.3 s\); try again with a longer --stall"
    with playing(slow_start_s=3600) as address, pytest.raises(CameraError, match=words):
        record_from(address, tmp_path / "a.mcap", stall_s=0.3)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("with_length", [True, False])
@pytest.mark.parametrize("cut_lies", [False, True])
def test_cut_pictures_are_counted_and_skipped(tmp_path: Path, with_length: bool, cut_lies: bool):
    plan = {"frames": 30, "cut_every": 10, "with_length": with_length, "cut_lies": cut_lies}
    with playing(rate_hz=200.0, **plan) as address:
        summary, episode = record_from(address, tmp_path / "a.mcap")
    assert numbers(episode) == [number for number in range(30) if number % 10 != 9]
    assert summary.damaged == episode.info.counts["damaged"] == 3


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


def test_a_slow_writer_drops_the_newest_and_counts(tmp_path: Path):
    with playing(frames=60, rate_hz=500.0) as address:
        source = open_source(f"http://{address}", PATIENT)
        held: dict[str, Any] = {"progress": SlowBar(), "queue_bytes": 100_000}
        summary, episode = recorded(source, tmp_path / "a.mcap", **held)
    sizes = np.cumsum([len(picture(number)) for number in range(60)])
    fit = int(np.count_nonzero(sizes <= 100_000))  # beside the one that is taken out first
    seen = numbers(episode)
    assert fit > 2
    assert seen[:fit] == list(range(fit))
    assert seen == sorted(set(seen))
    assert len(seen) <= fit + 1
    assert (summary.captured, summary.dropped) == (60, 60 - len(seen))
    assert episode.info.counts == {"captured": 60, "written": len(seen), "dropped": 60 - len(seen)}


def test_so_many_seconds_by_the_frames_own_clock(tmp_path: Path):
    with playing(**ENDLESS) as address:
        summary, episode = record_from(address, tmp_path / "a.mcap", seconds=0.5)
    stamps_ns = [frame.stamp_ns for frame in episode.frames()]
    assert stamps_ns[-1] - stamps_ns[0] < 500_000_000
    assert numbers(episode) == [number % 20 for number in range(summary.written)]
    assert "ended" not in episode.info.notes


# ---- In a process of its own


def recorder(
    folder: Path, address: str, stderr: int = subprocess.PIPE
) -> AbstractContextManager[subprocess.Popen[str]]:
    """The command, recording a.mcap."""
    words = [BIN / "tunenet-record", *CAMERA, f"http://{address}", "-o", "a.mcap"]
    out = subprocess.PIPE
    return ending(
        subprocess.Popen([*map(str, words)], cwd=folder, text=True, stdout=out, stderr=stderr)
    )


def wait_for_bytes(log: Path) -> None:
    """Until there are some twenty pictures."""
    wait_until(lambda: log.exists() and log.stat().st_size >= 300_000, "so many bytes of frames")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_real_process_cleanly(tmp_path: Path, number: int):
    with playing(**ENDLESS) as address, recorder(tmp_path, address) as process:
        wait_for_bytes(tmp_path / "a.mcap.active")
        process.send_signal(number)
        out, err = process.communicate(timeout=LAST_RESORT_S)
    assert (process.returncode, err) == (0, "")
    assert "stopped by a signal" in out
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]
    episode = read_episode(tmp_path / "a.mcap")
    seen = numbers(episode)
    assert len(seen) == episode.info.counts["written"] > 5
    assert seen == [number % 20 for number in range(len(seen))]
    assert not episode.warnings


def test_killed_it_keeps_what_was_in_the_file(tmp_path: Path):
    active = tmp_path / "a.mcap.active"
    with playing(**ENDLESS) as address, recorder(tmp_path, address) as process:
        wait_for_bytes(active)
        process.kill()
        process.communicate()
    frames = [frame.data for frame in read_episode(active).frames()]
    assert frames == [picture(number % 20) for number in range(len(frames))]
    chunk = 64 * 1024 + max(len(one) for one in frames)
    assert sum(len(one) for one in frames) > active.stat().st_size - chunk  # the one that was cut


def test_a_terminal_shows_frames_rate_and_losses(tmp_path: Path):
    with closing(Terminal()) as terminal, playing(**ENDLESS) as address:
        with recorder(tmp_path, address, terminal.theirs) as process:
            terminal.wait_for(r"recording: \d+frame .*frame/s, 0 dropped")
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=LAST_RESORT_S)
        assert process.returncode == 0


def test_a_full_disk_ends_it_and_keeps_what_was_written(tmp_path: Path):
    code = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, 600_000))
from tunenet_logs.recorders.cli import main
sys.exit(main([*sys.argv[1:], "-o", "a.mcap"]))
"""
    with playing(frames=100_000, rate_hz=200.0, distinct=60) as address:
        words = [sys.executable, "-c", code, *map(str, CAMERA), f"http://{address}"]
        result = subprocess.run(
            words, cwd=tmp_path, capture_output=True, text=True, timeout=LAST_RESORT_S
        )
    assert (result.returncode, result.stderr.count("\n")) == (1, 1)
    episode = read_episode(tmp_path / "a.mcap")
    assert not episode.warnings
    seen, counts = numbers(episode), episode.info.counts
    assert len(seen) > 3
    assert seen == list(range(len(seen)))
    assert counts["captured"] == counts["written"] + counts["dropped"]
    kept = f"{len(seen)} of {counts['captured']} messages are kept in a.mcap"
    assert all(one in result.stderr for one in ("writing failed", kept))
    assert "writing failed" in episode.info.notes["ended"]


# ---- Cameras that are none, answer nonsense or break


@pytest.mark.parametrize(
    ("plan", "says"),
    [
        ({"status": 404}, "404"),
        ({"kind": "text/html", "body": "<html>hello</html>"}, "answers with a web page"),
        ({"kind": "image/jpeg", "body": "x"}, "is no video that is known here"),
        ({"kind": "multipart/x-mixed-replace; boundary=frame", "body": "x" * 999}, "no frame came"),
        ({"cut_every": 1, "frames": 12, "rate_hz": 500.0}, "12 parts were no whole JPEG"),
        ({"slow_start_s": 3600.0}, "0.5 s"),  # for which it sent no frame, or did not even answer
    ],
)
def test_what_is_no_stream_is_one_line_and_leaves_no_file(refuses: Refuses, plan: dict, says: str):
    stall_s = 0.5 if "slow_start_s" in plan else LAST_RESORT_S
    with playing(**plan) as address:
        refuses(1, "--camera", f"http://{address}", "--stall", stall_s, says=(says, address))


@pytest.mark.parametrize("scheme", ["http://", "rtsp://me:secret@"])
def test_a_port_where_nobody_listens_is_one_line(refuses: Refuses, scheme: str):
    with socket.socket() as one:  # nobody else gets it meanwhile
        one.bind(("127.0.0.1", 0))
        said = refuses(1, *CAMERA, f"{scheme}127.0.0.1:{one.getsockname()[1]}/video")
    assert "secret" not in said


@pytest.mark.parametrize(
    "answer",
    [
        b"SSH-2.0-OpenSSH_9.6\r\n",
        b"",
        STREAM + b"--frame\r\n" + b"X-Header: 1\r\n" * 5000,
        STREAM + b"--frame\r\n" + b"x" * 100_000,
        STREAM + b"--frame\r\nContent-Length: 99999999999999\r\n\r\n" + b"\xff\xd8",
        STREAM + b"--frame\r\nContent-Length: -5\r\n\r\n\r\n--frame--\r\n",
    ],
)
def test_nonsense_is_one_clear_error(tmp_path: Path, answer: bytes):
    with answering(answer) as server, pytest.raises(CameraError, match=r"127\.0\.0\.1"):
        record_from(server.place, tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_a_picture_of_a_forged_size_is_damage(tmp_path: Path):
    whole = picture(1)
    at = whole.index(b"\xff\xc0")
    forged = whole[: at + 5] + b"\x75\x30\x75\x30" + whole[at + 9 :]
    parts = b"".join(PART + one + b"\r\n" for one in (whole, forged, whole))
    with answering(STREAM + parts) as server:
        summary, _ = record_from(server.place, tmp_path / "a.mcap")
    assert (summary.written, summary.damaged) == (2, 1)


def test_a_part_without_an_end_keeps_what_came_before(tmp_path: Path):
    stream = STREAM + PART + picture(1) + b"\r\n" + PART + bytes(80 * 1024 * 1024)
    words = "the 1 frames before that are kept in"
    with answering(stream) as server, pytest.raises(CameraError, match=words):
        record_from(server.place, tmp_path / "a.mcap")
    episode = read_episode(tmp_path / "a.mcap")
    assert [frame.data for frame in episode.frames()] == [picture(1)]
    assert "more than" in episode.info.notes["ended"]


def test_a_failure_in_the_reading_thread_reaches_the_user(tmp_path: Path):
    def breaking() -> Iterator[CapturedFrame]:
        yield CapturedFrame(Frame(1, "jpeg", picture(1)))
        raise ZeroDivisionError("oops")

    with pytest.raises(CameraError, match=r"camera made up: .*ZeroDivisionError.*1 frames before"):
        recorded(MadeSource(breaking()), tmp_path / "a.mcap")
    assert len(list(read_episode(tmp_path / "a.mcap").frames())) == 1


@pytest.mark.parametrize(("arrivals_s", "is_late"), [((-9, -9), True), ((-9, 9), False)])
def test_late_is_what_waits_to_be_written(tmp_path: Path, arrivals_s, is_late: bool):
    """A picture that is known to be whole by the next one alone does not wait meanwhile."""
    shots = (
        CapturedFrame(Frame(now_ns() + arrival_s * 10**9, "jpeg", picture(number)))
        for number, arrival_s in enumerate(arrivals_s)
    )
    summary, episode = recorded(MadeSource(shots), tmp_path / "a.mcap")
    assert (summary.lag_s > 8) is is_late
    assert ("longest_lag_s" in episode.info.notes) is is_late


def test_a_log_that_exists_stays(tmp_path: Path):
    for data, remedy in ((OF_OURS, "--overwrite"), (b"mine", "move it away")):
        (tmp_path / "a.mcap").write_bytes(data)
        with playing() as address, pytest.raises(LogError, match=remedy):
            record_from(address, tmp_path / "a.mcap")
        assert (tmp_path / "a.mcap").read_bytes() == data


# ---- The stream of parts

PARTS = b"".join(
    b"--frame\r\nContent-Type: image/jpeg\r\n" + length + b"\r\n" + picture(number) + b"\r\n"
    for number, length in enumerate([b"", b"Content-Length: %d\r\n" % len(picture(1)), b""])
)


def parser_of(data: bytes, sizes: list[int], boundary: str = "frame"):
    """A parser of a stream that arrives in pieces of these sizes, and where each piece began."""
    file, reads = io.BytesIO(data), list[int]()
    lengths = itertools.chain(sizes, itertools.repeat(100_000))

    def read(most: int) -> bytes:
        reads.append(file.tell())
        return file.read(min(most, next(lengths)))

    return MultipartParser(read, boundary, lambda: len(reads)).parts(), reads


@given(st.lists(st.integers(1, 3000), max_size=60), st.sampled_from(["frame", "--frame", ""]))
def test_it_does_not_matter_how_a_stream_is_cut_on_its_way(sizes: list[int], boundary: str):
    """And a part has the time of the read that brought its first byte."""
    parts, reads = parser_of(PARTS, sizes, boundary)
    found = list(parts)
    assert [part.data for part in found] == [picture(number) for number in range(3)]
    if boundary == "frame":
        firsts = [PARTS.index(picture(number)) for number in range(3)]
        assert [part.arrived_ns for part in found] == [bisect_right(reads, one) for one in firsts]


@given(st.binary(max_size=400), st.integers(0, len(PARTS)), st.integers(0, 400))
def test_damage_costs_the_part_that_it_hits_and_no_more_than_the_next(noise, at: int, lost: int):
    damaged = PARTS[:at] + noise + PARTS[at + lost :] + PARTS
    with suppress(CameraError):
        found = [part.data for part in parser_of(damaged, [])[0]]
        assert found[-2:] == [picture(1), picture(2)]


@pytest.mark.parametrize("filler", [b"-", b"--frame", b" ", b"\xff\xd9", b"\n", b"--frame\r\n"])
def test_a_stream_of_nothing_but_delimiters_does_not_hang(filler: bytes):
    with suppress(CameraError):
        parts, _ = parser_of(filler * (400_000 // len(filler)), [])
        assert not any(is_whole(part.data) for part in parts)
