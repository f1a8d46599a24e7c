"""The times that servers write beside their pictures: used where they are a clock's."""

from __future__ import annotations

import io

import pytest

from tests.recorders.mjpeg_camera import picture
from tunenet_logs.recorders.camera.streams import MultipartParser, ToldTimes

SECOND_NS = 1_000_000_000


def told(*headers: str) -> list[int | None]:
    parts = [f"--x\r\n{one}\r\nContent-Length: 4\r\n\r\nabcd\r\n".encode() for one in headers]
    stream = io.BytesIO(b"".join(parts))
    return [part.source_stamp_ns for part in MultipartParser(stream.read, "x", lambda: 0).parts()]


def test_what_servers_write():
    assert told(
        "X-Timestamp: 1700000000.123456",
        "x-timestamp:12.5",
        "Timestamp: 3.000000001",
        "X-Timestamp: 9.5\r\nX-UStreamer-Grab-Begin-Time: 8.25",
    ) == [1_700_000_000_123_456_000, 12_500_000_000, 3_000_000_001, 8_250_000_000]


@pytest.mark.parametrize(
    "header",
    [
        "X-Timestamp: 1700000000", "X-Timestamp: -1.5", "X-Timestamp: nan", "X-Timestamp: 1e9.5",
        "Timestamp: 2026-01-01T00:00:00", "X-Timestamp: 999999999999.5", "X-Framerate: 30.0",
    ],
)  # fmt: skip
def test_what_tells_no_time(header: str):
    assert told(header) == [None]


def taken(times_s: list[float], period_s: float = 1 / 30) -> tuple[list[int | None], bool]:
    clock = ToldTimes()
    seen = [
        clock.taken_ns(round(one * SECOND_NS), round(index * period_s * SECOND_NS))
        for index, one in enumerate(times_s)
    ]
    return seen, clock.is_trusted


def test_a_clock_is_believed_though_it_is_set_once():
    even = [100 + index / 30 for index in range(90)]
    seen, is_trusted = taken([*even, *(one - 50 for one in even)])
    assert is_trusted
    assert sum(one is None for one in seen) == 1


@pytest.mark.parametrize(
    "times_s",
    [
        [5.0] * 90,
        [float(f"{index // 30}.{index % 30 * 33_333}") for index in range(300)],  # not padded
        [index * 33.3 for index in range(300)],  # milliseconds
        [index / 30_000 for index in range(300)],
    ],
)
def test_what_is_no_clock_is_left_out(times_s: list[float]):
    assert not taken(times_s)[1]


def test_jitter_and_bursts_do_not_matter():
    clock = ToldTimes()
    for index in range(300):
        arrived_ns = index // 15 * 15 * SECOND_NS // 30
        assert clock.taken_ns(index * SECOND_NS // 30, arrived_ns) is not None
    assert clock.is_trusted


def test_a_picture_has_the_time_of_its_part():
    part = b"--x\r\nX-Timestamp: 7.25\r\n\r\n" + picture(1) + b"\r\n--x--\r\n"
    (only,) = MultipartParser(io.BytesIO(part).read, "x", lambda: 5).parts()
    assert (only.source_stamp_ns, only.arrived_ns, only.data) == (7_250_000_000, 5, picture(1))
