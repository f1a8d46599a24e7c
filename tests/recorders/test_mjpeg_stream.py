"""A network camera over real sockets: what it sends arrives, whatever else it does."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from recorders.camera.capture import Limits, record_camera
from recorders.camera.sources import open_source
from recorders.session import Summary
from tests.conftest import BIN, Command
from tests.recorders.mjpeg_camera import number_in, picture, playing
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.errors import CameraError, LogError
from tunenet_logs.progress import Bar, Progress
from tunenet_logs.reader import read_episode

QUIET = Progress(quiet=True)


def record(address: str, path: Path, **limits: float) -> tuple[Summary, Episode]:
    """Record to `path` in this process, and read it back."""
    source = open_source(f"http://{address}", timeout_s=5.0)
    summary = record_camera(
        source,
        EpisodeInfo(kind="drop"),
        path,
        limits=Limits(**limits),  # type: ignore[arg-type]
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


@pytest.mark.parametrize("rate_hz", [30.0, 60.0])
def test_every_frame_arrives_in_order_with_its_bytes_and_time(tmp_path: Path, rate_hz: float):
    sent = tmp_path / "sent.json"
    with playing(frames=90, rate_hz=rate_hz, sent=str(sent)) as address:
        summary, episode = record(address, tmp_path / "a.mcap")
        while not sent.exists() or not sent.read_text():
            time.sleep(0.01)
    assert summary.dropped == 0
    assert summary.rate_hz == pytest.approx(rate_hz, rel=0.1)
    assert [frame.data for frame in episode.frames()] == [picture(index) for index in range(90)]
    stamps = np.array([frame.stamp_ns for frame in episode.frames()])
    assert np.all(np.diff(stamps) > 0)
    anchor = time.time_ns() - time.monotonic_ns()
    late_ms = (stamps - anchor - np.array(json.loads(sent.read_text()))) / 1e6
    assert abs(np.median(late_ms)) < 5


def test_the_log_says_where_it_came_from_and_how_fast(tmp_path: Path):
    with playing(frames=40) as address:
        _, episode = record(address, tmp_path / "a.mcap")
    info = episode.info
    assert info.kind == "drop"
    assert info.source == f"camera http://{address}"
    assert info.notes["size_px"] == "320x240"
    assert float(info.notes["measured_hz"]) == pytest.approx(60, rel=0.1)
    assert "closed" in info.notes["ended"]


@pytest.mark.parametrize("boundary", ["frame", "--frame", '"frame"', ""])
@pytest.mark.parametrize("with_length", [True, False])
def test_senders_differ_in_their_delimiters(tmp_path: Path, boundary: str, with_length: bool):
    plan = {"frames": 20, "rate_hz": 200.0, "boundary": boundary, "with_length": with_length}
    with playing(**plan) as address:
        _, episode = record(address, tmp_path / "a.mcap")
    assert [frame.data for frame in episode.frames()] == [picture(index) for index in range(20)]


def test_a_connection_that_closes_ends_the_recording_with_the_reason(tmp_path: Path):
    with playing(frames=90, close_after=30) as address:
        summary, episode = record(address, tmp_path / "a.mcap")
    assert numbers(episode) == list(range(30))
    assert "closed by the camera" in summary.ended
    assert episode.info.notes["ended"] == summary.ended


def test_a_camera_that_falls_silent_ends_the_recording_with_the_reason(tmp_path: Path):
    with playing(frames=90, stall_after=30) as address:
        _, episode = record(address, tmp_path / "a.mcap", stall_s=2.0)
    assert numbers(episode) == list(range(30))
    assert episode.info.notes["ended"] == "no frame for 2.0 s"


@pytest.mark.parametrize("with_length", [True, False])
@pytest.mark.parametrize("cut_lies", [False, True])
def test_cut_pictures_are_counted_and_skipped(tmp_path: Path, with_length: bool, cut_lies: bool):
    plan = {"frames": 60, "cut_every": 10, "with_length": with_length, "cut_lies": cut_lies}
    with playing(**plan) as address:
        summary, episode = record(address, tmp_path / "a.mcap")
    assert numbers(episode) == [number for number in range(60) if number % 10 != 9]
    assert summary.damaged == episode.info.counts["damaged"] == 6
    assert summary.captured == 54


def test_jitter_and_a_slow_start_lose_nothing(tmp_path: Path):
    with playing(frames=90, jitter_s=0.01, slow_start_s=1.0) as address:
        summary, episode = record(address, tmp_path / "a.mcap")
    assert numbers(episode) == list(range(90))
    assert summary.dropped == 0


def test_a_slow_writer_drops_the_newest_and_counts(tmp_path: Path):
    class SlowBar(Progress):
        """Takes its time with each frame, as a slow disk does."""

        @contextmanager
        def bar(self, total: int | None, what: str, unit: str) -> Iterator[Bar]:  # noqa: ARG002
            yield self

        def set_postfix_str(self, text: str, /, *, refresh: bool) -> None:
            pass

        def update(self, _done: int, /) -> None:
            time.sleep(0.05)

    with playing(frames=90) as address:
        source = open_source(f"http://{address}")
        summary = record_camera(
            source,
            EpisodeInfo(),
            tmp_path / "a.mcap",
            limits=Limits(queue_bytes=100_000),
            overwrite=False,
            progress=SlowBar(),
        )
    episode = read_episode(tmp_path / "a.mcap")
    seen = numbers(episode)
    assert summary.captured == 90
    assert summary.dropped > 20
    assert summary.captured == summary.written + summary.dropped
    assert len(seen) == summary.written == episode.info.counts["written"]
    assert seen == sorted(set(seen))
    assert seen[:2] == [0, 1]


def test_so_many_seconds_by_the_frames_own_clock(tmp_path: Path):
    with playing(frames=300, rate_hz=50.0) as address:
        summary, episode = record(address, tmp_path / "a.mcap", seconds=1.0)
    assert 45 <= summary.written <= 51
    assert numbers(episode) == list(range(summary.written))
    assert "ended" not in episode.info.notes


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_real_process_cleanly(tmp_path: Path, number: int):
    with playing(frames=3000, distinct=200) as address:
        process = subprocess.Popen(
            [BIN / "tunenet-record", "--camera", f"http://{address}", "-o", "a.mcap"],
            cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        active = tmp_path / "a.mcap.active"
        while not active.exists() or active.stat().st_size < 500_000:
            time.sleep(0.02)
        process.send_signal(number)
        out, err = process.communicate(timeout=20)
    assert process.returncode == 0, err
    assert "stopped by a signal" in out
    assert not err
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]
    episode = read_episode(tmp_path / "a.mcap")
    seen = numbers(episode)
    assert len(seen) == episode.info.counts["written"] > 5
    assert seen == [number % 200 for number in range(len(seen))]
    assert not episode.warnings


def test_user_and_password_are_sent_and_never_shown(command: Command, tmp_path: Path):
    with playing(frames=20, user="me:se cret") as address:
        url = f"http://me:se%20cret@{address}?pwd=hidden"
        good = command("tunenet-record", "--camera", url, "-o", "a.mcap", cwd=tmp_path)
        wrong = command("tunenet-record", "--camera", url.replace("me:", "you:"), cwd=tmp_path)
        without = command("tunenet-record", "--camera", f"http://{address}", cwd=tmp_path)
    assert good.returncode == 0, good.stderr
    for result in (wrong, without):
        assert result.returncode == 1
        assert result.stderr.count("\n") == 1
        assert "401" in result.stderr
    log = tmp_path / "a.mcap"
    info = read_episode(log).info
    shown = good.stdout + good.stderr + wrong.stderr + str(info.to_strings())
    assert "cret" not in shown
    assert "hidden" not in shown
    assert f"camera http://{address}" == info.source
    assert b"cret" not in log.read_bytes()
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize(
    ("plan", "says"),
    [
        ({"status": 404}, "404"),
        ({"kind": "text/html", "body": "<html>hello</html>"}, "text/html"),
        ({"kind": "image/jpeg", "body": "x"}, "image/jpeg"),
        ({"kind": "multipart/x-mixed-replace; boundary=frame", "body": "x" * 999}, "no frame came"),
        ({"cut_every": 1, "frames": 12}, "12 parts were no whole JPEG"),
        ({"stall_after": 0, "slow_start_s": 60.0}, "no frame came"),
    ],
)
def test_what_is_no_stream_is_one_line_and_leaves_no_file(
    command: Command, tmp_path: Path, plan: dict[str, object], says: str
):
    with playing(**plan) as address:
        words = ("tunenet-record", "--camera", f"http://{address}", "--stall", 1)
        result = command(*words, cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert says in result.stderr
    assert address in result.stderr
    assert not list(tmp_path.iterdir())


def closed_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@pytest.mark.parametrize(
    ("source", "code"),
    [
        (f"http://127.0.0.1:{closed_port()}/video", 1),
        (f"rtsp://me:secret@127.0.0.1:{closed_port()}/video", 1),
        ("http://", 2),
        ("http://me:secret@host:port/", 2),
        ("http://host/a path", 2),
        ("ftp://me:secret@host/video", 2),
    ],
)
def test_an_address_that_does_not_answer_is_one_line(
    command: Command, tmp_path: Path, source: str, code: int
):
    result = command("tunenet-record", "--camera", source, cwd=tmp_path)
    assert result.returncode == code
    assert result.stderr.count("\n") == 1
    assert "secret" not in result.stderr
    assert not list(tmp_path.iterdir())


def answering_once(answer: bytes) -> str:
    """A server that sends `answer` to its first caller, whatever is asked."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with listener:
            caller, _ = listener.accept()
            with caller, suppress(ConnectionError):  # it may have heard enough
                caller.recv(65536)
                caller.sendall(answer)

    threading.Thread(target=serve, daemon=True).start()
    return f"127.0.0.1:{listener.getsockname()[1]}/video"


STREAM = b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=frame\r\n\r\n"


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
    with pytest.raises(CameraError, match=r"127\.0\.0\.1"):
        record(answering_once(answer), tmp_path / "a.mcap", stall_s=2.0)
    assert not list(tmp_path.iterdir())


def test_a_picture_of_a_forged_size_is_damage(tmp_path: Path):
    whole = picture(1)
    at = whole.index(b"\xff\xc0")
    forged = whole[: at + 5] + b"\x75\x30\x75\x30" + whole[at + 9 :]
    parts = b"".join(b"--frame\r\n\r\n" + one + b"\r\n" for one in (whole, forged, whole))
    summary, _ = record(answering_once(STREAM + parts), tmp_path / "a.mcap")
    assert (summary.written, summary.damaged) == (2, 1)


def test_a_part_without_an_end_keeps_what_came_before(tmp_path: Path):
    whole = b"--frame\r\n\r\n" + picture(1) + b"\r\n"
    endless = b"--frame\r\n\r\n" + bytes(40 * 1024 * 1024)
    with pytest.raises(CameraError, match="the 1 frames before that are kept in"):
        record(answering_once(STREAM + whole + endless), tmp_path / "a.mcap")
    episode = read_episode(tmp_path / "a.mcap")
    assert [frame.data for frame in episode.frames()] == [picture(1)]
    assert "more than" in episode.info.notes["ended"]


def test_a_failure_in_the_reading_thread_reaches_the_user(tmp_path: Path):
    class Breaks:
        """A source with a defect of its own."""

        name, live, ended, damaged = "camera broken", True, "", 0

        def notes(self):
            return {}

        def frames(self):
            from tunenet_logs.episode import Frame

            yield Frame(1, "jpeg", picture(1))
            raise ZeroDivisionError("oops")

        def close(self):
            pass

    with pytest.raises(CameraError, match=r"camera broken: .*ZeroDivisionError.*1 frames before"):
        record_camera(
            Breaks(),
            EpisodeInfo(),
            tmp_path / "a.mcap",
            limits=Limits(),
            overwrite=False,
            progress=QUIET,
        )
    assert len(list(read_episode(tmp_path / "a.mcap").frames())) == 1


def test_a_log_that_exists_stays(tmp_path: Path):
    (tmp_path / "a.mcap").write_bytes(b"mine")
    with playing(frames=20) as address, pytest.raises(LogError, match="--overwrite"):
        record(address, tmp_path / "a.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == b"mine"


def test_a_full_disk_ends_it_and_keeps_what_was_written(tmp_path: Path):
    code = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, 600_000))
from recorders.cli import main
sys.exit(main(["--camera", sys.argv[1], "-o", "a.mcap"]))
"""
    with playing(frames=900) as address:
        words = [sys.executable, "-c", code, f"http://{address}"]
        result = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=60)
    assert result.returncode == 1
    assert "writing failed" in result.stderr
    assert result.stderr.count("\n") == 1
    seen = numbers(read_episode(tmp_path / "a.mcap.active"))
    assert len(seen) > 3
    assert seen == list(range(len(seen)))
