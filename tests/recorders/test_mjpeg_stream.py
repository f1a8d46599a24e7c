"""A network camera over real sockets: what it sends arrives, whatever else it does."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from recorders.camera.capture import Limits, record_camera
from recorders.camera.sources import open_source
from recorders.session import Summary
from tests.conftest import BIN
from tests.recorders.mjpeg_camera import number_in, picture, playing
from tunenet_logs.episode import Episode, EpisodeInfo
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
