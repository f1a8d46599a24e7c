"""Cameras that are none, answer nonsense or break; and logs that cannot be written."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from tests.conftest import Command
from tests.recorders.contender import OF_OURS
from tests.recorders.live_wait import LAST_RESORT_S
from tests.recorders.made_source import MadeSource
from tests.recorders.mjpeg_camera import picture, playing
from tests.recorders.test_mjpeg_stream import QUIET, numbers, record
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import CameraError, LogError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.base import CapturedFrame
from tunenet_logs.recorders.camera.recording import Limits, record_camera
from tunenet_logs.recorders.session import Summary
from tunenet_logs.timing.stamps import now_ns

pytestmark = pytest.mark.live

CAMERA = ("tunenet-record", "--stall", LAST_RESORT_S, "--camera")


def test_user_and_password_are_sent_and_never_shown(command: Command, tmp_path: Path):
    with playing(frames=20, rate_hz=500.0, user="me:se cret") as address:
        url = f"http://me:se%20cret@{address}?pwd=hidden"
        good = command(*CAMERA, url, "-o", "a.mcap", cwd=tmp_path)
        wrong = command(*CAMERA, url.replace("me:", "you:"), cwd=tmp_path)
        without = command(*CAMERA, f"http://{address}", cwd=tmp_path)
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
        ({"kind": "text/html", "body": "<html>hello</html>"}, "answers with a web page"),
        ({"kind": "image/jpeg", "body": "x"}, "is no video that is known here"),
        ({"kind": "multipart/x-mixed-replace; boundary=frame", "body": "x" * 999}, "no frame came"),
        ({"cut_every": 1, "frames": 12, "rate_hz": 500.0}, "12 parts were no whole JPEG"),
    ],
)
def test_what_is_no_stream_is_one_line_and_leaves_no_file(
    command: Command, tmp_path: Path, plan: dict[str, object], says: str
):
    with playing(**plan) as address:
        result = command(*CAMERA, f"http://{address}", cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert says in result.stderr
    assert address in result.stderr
    assert not list(tmp_path.iterdir())


def test_how_long_a_camera_may_be_silent_is_an_option(command: Command, tmp_path: Path):
    with playing(slow_start_s=3600.0) as address:
        words = ("tunenet-record", "--camera", f"http://{address}", "--stall", 0.5)
        result = command(*words, cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert address in result.stderr
    assert "0.5 s" in result.stderr  # for which it sent no frame, or did not even answer
    assert not list(tmp_path.iterdir())


@contextmanager
def closed_port() -> Iterator[int]:
    """A port that nobody else gets meanwhile, and where nobody listens."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        yield one.getsockname()[1]


@pytest.mark.parametrize(
    ("source", "code"),
    [
        ("http://127.0.0.1:PORT/video", 1),
        ("rtsp://me:secret@127.0.0.1:PORT/video", 1),
        ("http://", 2),
        ("http://me:secret@host:port/", 2),
        ("http://host/a path", 2),
        ("ftp://me:secret@host/video", 2),
    ],
)
def test_an_address_that_does_not_answer_is_one_line(
    command: Command, tmp_path: Path, source: str, code: int
):
    with closed_port() as port:
        result = command(*CAMERA, source.replace("PORT", str(port)), cwd=tmp_path)
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
        record(answering_once(answer), tmp_path / "a.mcap")
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
    endless = b"--frame\r\n\r\n" + bytes(80 * 1024 * 1024)
    with pytest.raises(CameraError, match="the 1 frames before that are kept in"):
        record(answering_once(STREAM + whole + endless), tmp_path / "a.mcap")
    episode = read_episode(tmp_path / "a.mcap")
    assert [frame.data for frame in episode.frames()] == [picture(1)]
    assert "more than" in episode.info.notes["ended"]


def recorded(shots: Iterator[CapturedFrame], path: Path) -> Summary:
    return record_camera(
        MadeSource(shots),
        EpisodeInfo(),
        path,
        limits=Limits(stall_s=LAST_RESORT_S),
        overwrite=False,
        progress=QUIET,
    )


def test_a_failure_in_the_reading_thread_reaches_the_user(tmp_path: Path):
    def breaking() -> Iterator[CapturedFrame]:
        yield CapturedFrame(Frame(1, "jpeg", picture(1)))
        raise ZeroDivisionError("oops")

    with pytest.raises(CameraError, match=r"camera made up: .*ZeroDivisionError.*1 frames before"):
        recorded(breaking(), tmp_path / "a.mcap")
    assert len(list(read_episode(tmp_path / "a.mcap").frames())) == 1


@pytest.mark.parametrize(("arrivals_s", "is_late"), [((-9, -9), True), ((-9, 9), False)])
def test_late_is_what_waits_to_be_written(
    tmp_path: Path, arrivals_s: tuple[int, ...], is_late: bool
):
    """A picture that is known to be whole by the next one alone does not wait meanwhile."""
    shots = (
        CapturedFrame(Frame(now_ns() + arrival_s * 10**9, "jpeg", picture(number)))
        for number, arrival_s in enumerate(arrivals_s)
    )
    summary = recorded(shots, tmp_path / "a.mcap")
    assert (summary.lag_s > 8) is is_late
    assert ("longest_lag_s" in read_episode(tmp_path / "a.mcap").info.notes) is is_late


def test_a_log_that_exists_stays(tmp_path: Path):
    for data, remedy in ((OF_OURS, "--overwrite"), (b"mine", "move it away")):
        (tmp_path / "a.mcap").write_bytes(data)
        with playing() as address, pytest.raises(LogError, match=remedy):
            record(address, tmp_path / "a.mcap")
        assert (tmp_path / "a.mcap").read_bytes() == data


def test_a_full_disk_ends_it_and_keeps_what_was_written(tmp_path: Path):
    code = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (600_000, 600_000))
from tunenet_logs.recorders.cli import main
sys.exit(main([*sys.argv[1:], "-o", "a.mcap"]))
"""
    with playing(frames=100_000, rate_hz=200.0, distinct=60) as address:
        words = [sys.executable, "-c", code, *(str(one) for one in CAMERA[1:])]
        result = subprocess.run(
            [*words, f"http://{address}"],
            cwd=tmp_path, capture_output=True, text=True, timeout=LAST_RESORT_S,
        )  # fmt: skip
    assert result.returncode == 1
    assert "writing failed" in result.stderr
    assert result.stderr.count("\n") == 1
    episode = read_episode(tmp_path / "a.mcap")
    assert not episode.warnings
    seen = numbers(episode)
    assert len(seen) > 3
    assert seen == list(range(len(seen)))
    counts = episode.info.counts
    assert counts["written"] == len(seen)
    assert counts["captured"] == counts["written"] + counts["dropped"]
    kept = f"{len(seen)} of {counts['captured']} messages are kept in a.mcap"
    assert kept in result.stderr
    assert "writing failed" in episode.info.notes["ended"]
