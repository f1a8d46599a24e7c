"""Which clock is believed, and what is repaired."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tunenet_logs.timing.stamps import order_samples


def order(header: list[int], log: list[int]):
    return order_samples(np.array(header, np.int64), np.array(log, np.int64))


def test_header_stamps_are_preferred():
    keep, stamps, notes, _ = order([10, 20, 30], [1, 2, 3])
    assert list(stamps) == [10, 20, 30]
    assert list(keep) == [0, 1, 2]
    assert not notes


def test_a_clock_that_starts_at_zero_is_set():
    assert list(order([0, 20, 30], [7, 8, 9])[1]) == [0, 20, 30]


def test_unset_header_stamps_give_way_to_the_logs_times():
    assert list(order([0, 0, 0], [7, 8, 9])[1]) == [7, 8, 9]


def test_a_late_sample_is_sorted_in_and_counted():
    header = [*range(10, 300, 10), 205]
    keep, stamps, notes, _ = order(header, list(range(30)))
    assert list(stamps) == sorted(header)
    assert keep[20] == 29
    assert notes == ["1 samples out of order were sorted"]


def test_stamps_that_run_backwards_all_over_are_not_believed():
    _, stamps, notes, _ = order([30, 20, 10], [1, 2, 3])
    assert list(stamps) == [1, 2, 3]
    assert "backwards" in notes[0]


def test_duplicates_are_left_out_and_counted():
    keep, stamps, notes, _ = order([10, 20, 20, 30], [1, 2, 3, 4])
    assert list(stamps) == [10, 20, 30]
    assert list(keep) == [0, 1, 3]
    assert "1 samples" in notes[0]


def test_no_samples():
    assert len(order([], [])[1]) == 0


times = st.lists(st.integers(0, 1000), max_size=40)


@given(times)
def test_stamps_always_increase_and_belong_to_their_samples(header: list[int]):
    keep, stamps, _, _ = order(header, list(range(len(header))))
    assert np.all(np.diff(stamps) > 0)
    source = {tuple(np.array(header, np.int64)[keep]), tuple(keep)}
    assert tuple(stamps) in source


def test_header_stamps_that_never_change_are_not_believed():
    _, stamps, notes, _ = order([5] * 40, list(range(40)))
    assert list(stamps) == list(range(40))
    assert "hardly change" in notes[0]
