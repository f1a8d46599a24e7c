"""The camera's clock, placed on ours."""

from __future__ import annotations

import random

from tunenet_logs.episode import Frame
from tunenet_logs.recorders.camera.base import CapturedFrame
from tunenet_logs.recorders.camera.clock import CameraTime, Timed
from tunenet_logs.recorders.session import Item

MS = 1_000_000
SECOND = 1000 * MS
START_NS = 1_700_000_000 * SECOND


def shots(times: list[tuple[int, int | None]]) -> list[Item[CapturedFrame]]:
    """Of (arrival, told) [ns], the arrival from `START_NS` on."""
    return [
        Item("", 0, START_NS + came, CapturedFrame(Frame(START_NS + came, "jpeg", b"x"), told), 1)
        for came, told in times
    ]


def all_timed(clock: CameraTime, times: list[tuple[int, int | None]]) -> list[Timed]:
    timed = [one for item in shots(times) for one in clock.timed(item)]
    return timed + list(clock.rest())


def stamps_ns(clock: CameraTime, times: list[tuple[int, int | None]]) -> list[int]:
    return [one.frame.stamp_ns - START_NS for one in all_timed(clock, times)]


def test_what_was_read_ahead_is_placed_by_what_came_at_once():
    told = [7 * SECOND + number * 20 * MS for number in range(100)]
    # Ten pictures wait while the stream is looked at; what follows comes 3 ms after its time.
    came = [max(number * 20, 200) * MS + 3 * MS for number in range(100)]
    clock = CameraTime()
    assert stamps_ns(clock, list(zip(came, told, strict=True))) == [
        number * 20 * MS + 3 * MS for number in range(100)
    ]
    assert clock.notes() == {"stamps": "camera"}


def test_nothing_waits_longer_than_the_hold():
    clock = CameraTime()
    first, second = shots([(0, 5), (20 * MS, 20 * MS + 5)])
    assert not list(clock.timed(first))
    assert not list(clock.timed(second))
    assert not list(clock.due(START_NS + 499 * MS))
    assert [one.frame.stamp_ns for one in clock.due(START_NS + 500 * MS)] == [
        START_NS, START_NS + 20 * MS,
    ]  # fmt: skip
    assert not list(clock.rest())


def test_steps_are_the_cameras_to_the_nanosecond_whatever_the_network_does():
    rng = random.Random(0)
    told = [round(number * SECOND / 59.94) for number in range(600)]
    came = 0
    times: list[tuple[int, int | None]] = []
    for number, source_stamp_ns in enumerate(told):
        stalled = 2500 * MS if 200 <= number < 350 else 0
        came = max(
            came, source_stamp_ns + rng.randrange(40 * MS), told[200] + stalled if stalled else 0
        )
        times.append((came, source_stamp_ns))
    seen = stamps_ns(CameraTime(), times)
    assert [stamp - seen[0] for stamp in seen] == told
    assert all(stamp <= came + 40 * MS for stamp, (came, _) in zip(seen, times, strict=True))


def test_a_clock_that_begins_anew_or_leaps_ahead_is_placed_anew():
    told = [number * 20 * MS for number in range(100)]
    again = [SECOND // 4 + number * 20 * MS for number in range(100)]
    ahead = [100 * SECOND + number * 20 * MS for number in range(100)]
    clock = CameraTime()
    times = [(number * 20 * MS, one) for number, one in enumerate(told + again + ahead)]
    assert stamps_ns(clock, list(times)) == [number * 20 * MS for number in range(300)]
    assert clock.notes() == {"stamps": "camera", "camera_clock_leaps": "2"}


def test_pictures_that_change_places_are_no_leap():
    order = [0, 3, 1, 2, 6, 4, 5, *range(7, 60)]
    clock = CameraTime()
    times: list[tuple[int, int | None]] = [
        (60 * MS + place * 20 * MS, number * 20 * MS) for place, number in enumerate(order)
    ]
    seen = stamps_ns(clock, times)
    assert [stamp - seen[0] for stamp in seen] == [number * 20 * MS for number in order]
    assert clock.leaps == 0


def test_without_told_times_the_arrival_is_the_stamp_and_two_never_share_one():
    clock = CameraTime()
    assert stamps_ns(clock, [(5, None), (5, None), (9, None)]) == [5, 6, 9]
    assert clock.notes() == {"stamps": "arrival"}


def test_a_picture_without_a_told_time_among_others_is_counted():
    clock = CameraTime()
    times: list[tuple[int, int | None]] = [
        (number * SECOND, number * SECOND) for number in range(5)
    ]
    times[3] = (3 * SECOND + 7, None)
    assert stamps_ns(clock, times) == [0, SECOND, 2 * SECOND, 3 * SECOND + 7, 4 * SECOND]
    assert clock.notes() == {"stamps": "camera, 1 by arrival"}
