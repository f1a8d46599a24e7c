"""Pictures that come late over a socket, stamped by the clock of the camera that took them."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from tests.recorders.mjpeg_camera import picture, playing
from tunenet_logs.copying import check
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.messages import CAMERA_TOPIC
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.clock import stamp_evenly
from tunenet_logs.recorders.cli import main
from tunenet_logs.terminal import Progress
from tunenet_logs.timing.arrivals import BY_ARRIVALS, STAMPS_NOTE
from tunenet_logs.writing.writer import EpisodeWriter, header_stamps_ns

PERIOD_NS = 1_000_000_000 // 60


def log_times_ns(path: Path) -> list[int]:
    with path.open("rb") as log:
        return [message.log_time for *_, message in make_reader(log).iter_messages()]


@pytest.mark.live
def test_a_delayed_stream_is_stamped_evenly_and_keeps_its_arrivals(tmp_path: Path):
    path = tmp_path / "late.mcap"
    note = ""
    for _ in range(4):  # a machine that is busy for most of two seconds leaves nothing to find
        with playing(frames=120, rate_hz=60.0, jitter_s=0.02) as address:
            words = ["--camera", f"http://{address}", "-o", str(path), "--quiet", "--overwrite"]
            assert main(words) == 0
        note = read_episode(path).info.notes[STAMPS_NOTE]
        if note.startswith(BY_ARRIVALS):
            break
    stamps, arrived = np.array(header_stamps_ns(path, CAMERA_TOPIC)), np.array(log_times_ns(path))
    assert len(stamps) == 120
    assert note.startswith(BY_ARRIVALS)
    steps = np.diff(stamps) / PERIOD_NS
    assert np.abs(steps - np.round(steps)).max() < 0.01
    assert np.diff(arrived).std() > 5 * np.diff(stamps).std()
    assert np.all(stamps <= arrived)


@pytest.mark.live
def test_arrivals_for_those_who_want_them(tmp_path: Path):
    path = tmp_path / "late.mcap"
    with playing(frames=90, rate_hz=60.0, jitter_s=0.02) as address:
        words = ["--camera", f"http://{address}", "-o", str(path), "--quiet", "--stamps", "arrival"]
        assert main(words) == 0
    assert header_stamps_ns(path, CAMERA_TOPIC) == log_times_ns(path)
    assert read_episode(path).info.notes[STAMPS_NOTE] == "arrival"


def written(path: Path, arrivals_ns: list[int], notes: dict[str, str]) -> Path:
    """A log of a live camera that told no times."""
    info = EpisodeInfo(kind="drop", notes={STAMPS_NOTE: "arrival", **notes})
    with EpisodeWriter(path, info) as writer:
        for number, stamp_ns in enumerate(arrivals_ns):
            frame = Frame(stamp_ns, "jpeg", picture(number))
            writer.write_frame(CAMERA_TOPIC, frame, stamp_ns)
    return path


def late(first: int, count: int, seed: int) -> list[int]:
    rng = random.Random(seed)
    came = 0
    found: list[int] = []
    for tick in range(count):
        came = max(came + 1000, first + tick * PERIOD_NS + round(rng.expovariate(1 / 10e6)))
        found.append(came)
    return found


def test_all_else_in_the_log_stays(tmp_path: Path):
    arrivals = late(10**18, 200, 1)
    path = written(tmp_path / "a.mcap", arrivals, {"ball": "tennis"})
    before = [frame.data for frame in read_episode(path).frames()]
    said = stamp_evenly(path, read_episode(path).info.notes, 0)
    assert said.startswith(f"{BY_ARRIVALS} (60.00 Hz")
    episode = read_episode(path)
    assert [frame.data for frame in episode.frames()] == before
    assert [frame.stamp_ns for frame in episode.frames()] == arrivals
    assert log_times_ns(path) == arrivals
    assert episode.info.notes["ball"] == "tennis"
    assert episode.info.counts["written"] == 200
    assert not check(path, Progress(quiet=True)).damage
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]


def test_each_part_between_gaps_has_a_clock_of_its_own(tmp_path: Path):
    first, second = late(10**18, 120, 2), late(10**18 + 4 * 10**9 + 7_000_000, 120, 3)
    note = f"{first[-1]}-{second[0]}"
    path = written(tmp_path / "a.mcap", first + second, {"gaps": note})
    assert stamp_evenly(path, {"gaps": note}, 0).count("60.00 Hz") == 2
    stamps = np.array(header_stamps_ns(path, CAMERA_TOPIC))
    assert np.abs(np.diff(stamps[:120]) - PERIOD_NS).max() < 20_000
    assert np.abs(np.diff(stamps[120:]) - PERIOD_NS).max() < 20_000


def test_a_camera_that_slows_down_keeps_its_arrivals_and_says_why(tmp_path: Path):
    rng = np.random.default_rng(4)
    came = np.cumsum(np.linspace(33e6, 80e6, 150)) + rng.uniform(0, 20e6, 150)
    arrivals = (10**18 + np.maximum.accumulate(came).astype(np.int64) + np.arange(150)).tolist()
    path = written(tmp_path / "a.mcap", arrivals, {})
    assert "rate of the pictures goes from" in stamp_evenly(path, {}, 0)
    assert header_stamps_ns(path, CAMERA_TOPIC) == arrivals


def test_no_room_for_a_copy_leaves_the_arrivals(tmp_path: Path):
    arrivals = late(10**18, 100, 5)
    path = written(tmp_path / "a.mcap", arrivals, {})
    assert "no room" in stamp_evenly(path, {}, 1 << 60)
    assert header_stamps_ns(path, CAMERA_TOPIC) == arrivals
