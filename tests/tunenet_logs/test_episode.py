"""Signals are checked once; what is known of an episode survives its way through strings."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunenet_logs.episode import Episode, EpisodeInfo, Signal


def signal(stamps: list[int], rows: int | None = None) -> Signal:
    count = len(stamps) if rows is None else rows
    return Signal("/a", np.array(stamps, np.int64), np.zeros((count, 2)), ("x", "y"), "m")


def test_signal_refuses_stamps_that_do_not_increase():
    with pytest.raises(ValueError, match="increase"):
        signal([1, 2, 2])


def test_signal_refuses_a_wrong_shape_and_names_both():
    with pytest.raises(ValueError, match=r"\(3, 2\).*\(2, 2\)"):
        signal([1, 2], rows=3)


def test_signal_is_a_read_only_copy():
    values = np.zeros((2, 1))
    made = Signal("/a", np.array([0, 10**7]), values, ("x",), "m")
    values[0] = 5
    assert made.values[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        made.values[0] = 1
    assert made.rate_hz == pytest.approx(100)


def test_pandas_table_keeps_stamps_and_names():
    table = Episode(EpisodeInfo(), {"/a": signal([5, 7])}).to_pandas()
    assert list(table.index) == [5, 7]
    assert list(table.columns) == [("/a", "x"), ("/a", "y")]


words = st.text(max_size=20)
names = st.from_regex(r"[a-z_]{1,10}", fullmatch=True)
numbers = st.floats(allow_nan=False, allow_infinity=False)


@given(
    words,
    words,
    st.dictionaries(names, numbers, max_size=3),
    st.dictionaries(names, st.integers(0, 10**12), max_size=3),
    st.dictionaries(names, words, max_size=3),
)
def test_info_survives_strings(
    kind: str, source: str, rig: dict[str, float], counts: dict[str, int], notes: dict[str, str]
):
    info = EpisodeInfo(kind=kind, source=source, rig=rig, truth=rig, counts=counts, notes=notes)
    assert EpisodeInfo.from_strings(info.to_strings()) == info


@given(st.dictionaries(st.text(max_size=30), st.text(max_size=30), max_size=8))
def test_any_strings_make_an_info(record: dict[str, str]):
    EpisodeInfo.from_strings(record)


def test_numbers_that_are_not_finite_are_left_out():
    info = EpisodeInfo.from_strings({"truth.restitution": "nan", "rig.ball_diameter_m": "1e999"})
    assert not info.truth
    assert not info.rig
