"""When the pictures of a video were taken, by what its file says."""

from __future__ import annotations

from fractions import Fraction

from tunenet_logs.media import StoredTimes, clock_of


def test_three_pictures_far_apart_have_a_rate_too():
    times = StoredTimes(ticks=[0, 10, 110], count=3, base_s=Fraction(1, 100), rate_hz=None, tags={})
    clock = clock_of(times, None)
    assert clock.stamps_ns.tolist() == [0, 100_000_000, 1_100_000_000]
    assert clock.stored_hz == 1 / 0.55
