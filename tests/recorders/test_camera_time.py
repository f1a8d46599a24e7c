"""When a picture was taken: the camera's clock placed on ours, told times, and even stamps."""

from __future__ import annotations

import io
import random
from pathlib import Path

import numpy as np
import pytest

from tests.recorders.conftest import Record
from tests.recorders.mjpeg_camera import picture, playing, times_in
from tunenet_logs.copying import check
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.messages import CAMERA_TOPIC
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.base import CapturedFrame
from tunenet_logs.recorders.camera.clock import CameraTime, stamp_evenly
from tunenet_logs.recorders.camera.streams import MultipartParser, ToldTimes
from tunenet_logs.recorders.session import Item
from tunenet_logs.terminal import Progress
from tunenet_logs.timing.arrivals import BY_ARRIVALS, STAMPS_NOTE
from tunenet_logs.writing.writer import EpisodeWriter, header_stamps_ns

MS, SECOND = 1_000_000, 1_000_000_000
START_NS = 1_700_000_000 * SECOND
PERIOD_NS = SECOND // 60

# ---- The camera's clock, placed on ours: (arrival, told) [ns], the arrival from `START_NS` on

Times = list[tuple[int, int | None]]


def shots(times: Times) -> list[Item[CapturedFrame]]:
    return [
        Item("", 0, START_NS + came, CapturedFrame(Frame(START_NS + came, "jpeg", b"x"), told), 1)
        for came, told in times
    ]


def stamps_ns(clock: CameraTime, times: Times) -> list[int]:
    timed = [one for item in shots(times) for one in clock.timed(item)]
    return [one.frame.stamp_ns - START_NS for one in [*timed, *clock.rest()]]


STEPS = [number * 20 * MS for number in range(100)]
ANEW = [SECOND // 4 + one for one in STEPS]
AHEAD = [100 * SECOND + one for one in STEPS]
SECONDS = [number * SECOND for number in range(5)]
DUE = [number * 20 * MS for number in range(300)]


@pytest.mark.parametrize(
    ("times", "wanted", "notes"),
    [
        (  # ten pictures wait while the stream is looked at; the rest comes 3 ms after its time
            [(max(one, 200 * MS) + 3 * MS, 7 * SECOND + one) for one in STEPS],
            [one + 3 * MS for one in STEPS],
            {"stamps": "camera"},
        ),
        (  # it begins anew, and leaps ahead
            list(zip(DUE, STEPS + ANEW + AHEAD, strict=True)),
            DUE,
            {"stamps": "camera", "camera_clock_leaps": "2"},
        ),
        ([(5, None), (5, None), (9, None)], [5, 6, 9], {"stamps": "arrival"}),
        (
            [(one + 7, None) if one == 3 * SECOND else (one, one) for one in SECONDS],
            [one + 7 * (one == 3 * SECOND) for one in SECONDS],
            {"stamps": "camera, 1 by arrival"},
        ),
    ],
)
def test_pictures_are_placed_by_what_came_at_once(times: Times, wanted: list[int], notes: dict):
    clock = CameraTime()
    assert stamps_ns(clock, times) == wanted
    assert clock.notes() == notes


def test_nothing_waits_longer_than_the_hold():
    clock = CameraTime()
    for one in shots([(0, 5), (20 * MS, 20 * MS + 5)]):
        assert not list(clock.timed(one))
    assert not list(clock.due(START_NS + 499 * MS))
    due = [one.frame.stamp_ns for one in clock.due(START_NS + 500 * MS)]
    assert due == [START_NS, START_NS + 20 * MS]
    assert not list(clock.rest())


def test_steps_are_the_cameras_to_the_nanosecond_whatever_the_network_does():
    rng = random.Random(0)
    told = [round(number * SECOND / 59.94) for number in range(600)]
    came, times = 0, []
    for number, source_stamp_ns in enumerate(told):
        stalled = told[200] + 2500 * MS if 200 <= number < 350 else 0
        came = max(came, source_stamp_ns + rng.randrange(40 * MS), stalled)
        times.append((came, source_stamp_ns))
    seen = stamps_ns(CameraTime(), times)
    assert [stamp - seen[0] for stamp in seen] == told
    assert all(stamp <= came + 40 * MS for stamp, (came, _) in zip(seen, times, strict=True))


def test_pictures_that_change_places_are_no_leap():
    order = [0, 3, 1, 2, 6, 4, 5, *range(7, 60)]
    clock = CameraTime()
    times: Times = [(60 * MS + at * 20 * MS, one * 20 * MS) for at, one in enumerate(order)]
    seen = stamps_ns(clock, times)
    assert [stamp - seen[0] for stamp in seen] == [number * 20 * MS for number in order]
    assert clock.leaps == 0


# ---- The times that servers write beside their pictures: used where they are a clock's


@pytest.mark.parametrize(
    ("header", "stamp_ns"),
    [
        ("X-Timestamp: 1700000000.123456", 1_700_000_000_123_456_000),
        ("x-timestamp:12.5", 12_500_000_000),
        ("Timestamp: 3.000000001", 3_000_000_001),
        ("X-Timestamp: 9.5\r\nX-UStreamer-Grab-Begin-Time: 8.25", 8_250_000_000),
        ("X-Timestamp: 1700000000", None),
        ("X-Timestamp: -1.5", None),
        ("X-Timestamp: nan", None),
        ("X-Timestamp: 1e9.5", None),
        ("Timestamp: 2026-01-01T00:00:00", None),
        ("X-Timestamp: 999999999999.5", None),
        ("X-Framerate: 30.0", None),
    ],
)
@pytest.mark.parametrize("data", [b"abcd", picture(1)], ids=["some bytes", "a picture"])
def test_what_servers_write(header: str, stamp_ns: int | None, data: bytes):
    part = f"--x\r\n{header}\r\nContent-Length: {len(data)}\r\n\r\n".encode() + data + b"\r\n"
    (only,) = MultipartParser(io.BytesIO(part).read, "x", lambda: 5).parts()
    assert (only.source_stamp_ns, only.arrived_ns, only.data) == (stamp_ns, 5, data)


EVEN_S = [100 + index / 30 for index in range(90)]


@pytest.mark.parametrize(
    ("times_s", "every", "left_out"),
    [
        ([*EVEN_S, *(one - 50 for one in EVEN_S)], 1, 1),  # a clock that is set once
        ([index / 30 for index in range(300)], 15, 0),  # whose pictures come in bursts
        ([5.0] * 90, 1, None),
        ([float(f"{index // 30}.{index % 30 * 33_333}") for index in range(300)], 1, None),
        ([index * 33.3 for index in range(300)], 1, None),  # milliseconds
        ([index / 30_000 for index in range(300)], 1, None),
    ],
)
def test_what_is_no_clock_is_left_out(times_s: list[float], every: int, left_out: int | None):
    clock = ToldTimes()
    seen = [
        clock.taken_ns(round(one * SECOND), index // every * every * SECOND // 30)
        for index, one in enumerate(times_s)
    ]
    assert clock.is_trusted is (left_out is not None)
    assert left_out is None or sum(one is None for one in seen) == left_out


# ---- Pictures that come late, of a camera that tells no times


@pytest.mark.live
def test_a_delayed_stream_is_stamped_evenly_and_keeps_its_arrivals(record: Record, tmp_path: Path):
    path, note = tmp_path / "late.mcap", ""
    for _ in range(4):  # a machine that is busy for most of two seconds leaves nothing to find
        with playing(frames=120, rate_hz=60.0, jitter_s=0.02) as address:
            words = ("--camera", f"http://{address}", "-o", path, "--quiet", "--overwrite")
            record(*words)
        note = read_episode(path).info.notes[STAMPS_NOTE]
        if note.startswith(BY_ARRIVALS):
            break
    stamps, arrived = np.array(times_in(path)).T
    assert len(stamps) == 120
    assert note.startswith(BY_ARRIVALS)
    steps = np.diff(stamps) / PERIOD_NS
    assert np.abs(steps - np.round(steps)).max() < 0.01
    assert np.diff(arrived).std() > 5 * np.diff(stamps).std()
    assert np.all(stamps <= arrived)


def written(path: Path, arrivals_ns: list[int], **notes: str) -> Path:
    """A log of a live camera that told no times."""
    info = EpisodeInfo(kind="drop", notes={STAMPS_NOTE: "arrival", **notes})
    with EpisodeWriter(path, info) as writer:
        for number, stamp_ns in enumerate(arrivals_ns):
            frame = Frame(stamp_ns, "jpeg", picture(number))
            writer.write_frame(CAMERA_TOPIC, frame, stamp_ns)
    return path


def late(first: int, count: int, seed: int) -> list[int]:
    rng, came = random.Random(seed), 0
    found: list[int] = []
    for tick in range(count):
        came = max(came + 1000, first + tick * PERIOD_NS + round(rng.expovariate(1 / 10e6)))
        found.append(came)
    return found


def test_all_else_in_the_log_stays(tmp_path: Path):
    arrivals = late(10**18, 200, 1)
    path = written(tmp_path / "a.mcap", arrivals, ball="tennis")
    before = [frame.data for frame in read_episode(path).frames()]
    said = stamp_evenly(path, read_episode(path).info.notes, 0)
    assert said.startswith(f"{BY_ARRIVALS} (60.00 Hz")
    episode = read_episode(path)
    assert [frame.data for frame in episode.frames()] == before
    assert [frame.stamp_ns for frame in episode.frames()] == arrivals
    assert [received_ns for _, received_ns in times_in(path)] == arrivals
    assert episode.info.notes["ball"] == "tennis"
    assert episode.info.counts["written"] == 200
    assert not check(path, Progress(quiet=True)).damage
    assert [one.name for one in tmp_path.iterdir()] == ["a.mcap"]


def test_each_part_between_gaps_has_a_clock_of_its_own(tmp_path: Path):
    first, second = late(10**18, 120, 2), late(10**18 + 4 * 10**9 + 7_000_000, 120, 3)
    gaps = f"{first[-1]}-{second[0]}"
    path = written(tmp_path / "a.mcap", first + second, gaps=gaps)
    assert stamp_evenly(path, {"gaps": gaps}, 0).count("60.00 Hz") == 2
    stamps = np.array(header_stamps_ns(path, CAMERA_TOPIC)).reshape(2, 120)
    assert np.abs(np.diff(stamps) - PERIOD_NS).max() < 20_000


def slowing() -> list[int]:
    rng = np.random.default_rng(4)
    came = np.cumsum(np.linspace(33e6, 80e6, 150)) + rng.uniform(0, 20e6, 150)
    return (10**18 + np.maximum.accumulate(came).astype(np.int64) + np.arange(150)).tolist()


@pytest.mark.parametrize(
    ("arrivals", "min_free", "says"),
    [(slowing(), 0, "rate of the pictures goes from"), (late(10**18, 100, 5), 1 << 60, "no room")],
    ids=["a camera that slows down", "no room for a copy"],
)
def test_arrivals_stay_where_there_is_a_reason(tmp_path: Path, arrivals, min_free, says: str):
    path = written(tmp_path / "a.mcap", arrivals)
    assert says in stamp_evenly(path, {}, min_free)
    assert header_stamps_ns(path, CAMERA_TOPIC) == arrivals
