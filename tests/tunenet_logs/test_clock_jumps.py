"""Clocks that jump while a log is recorded, and pauses that are no jumps."""

import numpy as np
import pytest

from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.timing.stamps import (
    filmed_part,
    order_samples,
    part_on_grid,
    sorted_stamps,
    sound_part,
    trim_clock_jumps,
    written_part,
)

SECOND = 10**9
EVEN = 1_700_000_000 * SECOND + np.arange(400) * 10_000_000


def shifted(rows: slice | int, by_s: float) -> np.ndarray:
    stamps = EVEN.copy()
    stamps[rows] += round(by_s * SECOND)
    return stamps


@pytest.mark.parametrize("at", [0, 200, 399])
@pytest.mark.parametrize("off_s", [3600, 86400, 8_640_000, 1_577_836_800, -3600, -86400])
def test_a_stamp_that_is_off_is_left_out_alone(at: int, off_s: float) -> None:
    _, stamps, _, _ = sorted_stamps(shifted(at, off_s))
    part = sound_part(stamps)
    assert len(part.keep) == 399
    assert np.ptp(stamps[part.keep]) < 5 * SECOND
    assert "1 of 400 samples: not used" in part.words[0]


@pytest.mark.parametrize("pause_s", [0.5, 60, 3600, 36_000])
def test_a_pause_is_no_jump(pause_s: float) -> None:
    stamps = shifted(slice(150, None), pause_s)
    for part in (sound_part(stamps), written_part(stamps), filmed_part(stamps)):
        assert len(part.keep) == 400
        assert not part.words


def test_impacts_with_long_pauses_are_all_kept() -> None:
    stamps = np.array([0, 1, 1.8, 2.4, 2000, 2001, 2001.8, 2002.4, 9000, 9001, 9001.8]) * SECOND
    assert not sound_part(stamps.astype(np.int64)).words


def test_a_clock_that_hears_of_today_leaves_the_longer_part() -> None:
    stamps = EVEN.copy()
    stamps[:100] = np.arange(100) * 10_000_000
    part = sound_part(stamps)
    assert part.keep.tolist() == list(range(100, 400))
    assert (
        "after sample 100 of 400: the longer part, after it, is used (300 samples)"
        in (part.words[0])
    )


def test_a_sample_without_a_stamp_is_called_so() -> None:
    stamps = EVEN.copy()
    stamps[0] = 0
    assert sound_part(stamps).words == ("1 of 400 samples without a stamp: not used",)


def test_the_first_and_last_stamps_that_fit_are_no_overflow() -> None:
    stamps = np.array([-(2**63), *EVEN.tolist(), 2**63 - 1])
    assert len(sound_part(stamps).keep) == 400


@pytest.mark.parametrize("back_s", [0.5, 2.0])
def test_a_clock_that_is_set_back_is_not_sorted_into_itself(back_s: float) -> None:
    stamps = shifted(slice(250, None), -back_s + 0.003)
    keep, ordered, notes, _ = sorted_stamps(stamps)
    assert keep.tolist() == list(range(250))
    assert np.array_equal(ordered, EVEN[:250])
    assert "is set back by" in notes[0]
    assert "before it, is used (250 samples)" in notes[0]


def test_samples_that_overtake_each_other_are_sorted() -> None:
    order = np.arange(400)
    for at in range(20, 380, 40):
        order[at : at + 4] = order[[at + 2, at + 3, at, at + 1]]
    keep, ordered, notes, _ = sorted_stamps(EVEN[order])
    assert np.array_equal(ordered, EVEN)
    assert len(keep) == 400
    assert notes == ["9 samples out of order were sorted"]


def test_stretches_in_another_order_are_sorted() -> None:
    stamps = np.concatenate([EVEN[200:], EVEN[:200]])
    assert len(sorted_stamps(stamps)[0]) == 400
    assert len(sorted_stamps(EVEN[::-1])[0]) == 400


@pytest.mark.parametrize("by_s", [-0.5, -1e9, 86400])
def test_a_header_that_jumps_gives_way_to_the_logs_own_times(by_s: float) -> None:
    keep, stamps, notes, _ = order_samples(shifted(slice(200, None), by_s), EVEN + 5)
    assert len(keep) == 400
    assert np.array_equal(stamps, EVEN + 5)
    assert "so the log's own times are used" in notes[0]


def test_pictures_before_a_step_back_are_those_that_are_used() -> None:
    part = filmed_part(shifted(slice(250, None), -60))
    assert part.keep.tolist() == list(range(250))
    assert "is set back by" in part.words[0]


def test_a_late_first_picture_hides_no_other() -> None:
    part = filmed_part(shifted(0, 86400))
    assert part.keep.tolist() == list(range(1, 400))


def test_a_grid_is_bounded_whatever_the_pauses_are() -> None:
    steps = np.where(np.arange(20_000) % 2, 0.01, 5.0 + np.arange(20_000) * 1e-3)
    seconds = np.cumsum(steps)
    part = part_on_grid(seconds, 1000.0)
    assert np.ptp(seconds[part.keep]) <= 1000.0
    assert len(part.words) == 1
    assert len(part_on_grid(seconds[:100], 1000.0).keep) == 100


def test_an_episode_says_once_what_is_cut_of_it() -> None:
    stamps = shifted(slice(300, None), 86400)
    values = np.arange(800.0).reshape(400, 2)
    signals = {
        f"/joints.{part}": Signal(f"/joints.{part}", stamps, values, ("a", "b"), "rad")
        for part in ("position", "velocity")
    }
    whole = Episode(EpisodeInfo(), signals, warnings=("something else",))
    cut = trim_clock_jumps(whole)
    assert [len(one.stamps_ns) for one in cut.signals.values()] == [300, 300]
    assert np.array_equal(cut.signals["/joints.position"].values, values[:300])
    assert len(cut.warnings) == 2
    assert trim_clock_jumps(cut).warnings == cut.warnings
    assert len(whole.signals["/joints.position"].stamps_ns) == 400
