"""Tables and words: what a terminal and a review show of a tuning."""

from __future__ import annotations

from pathlib import Path

import pytest

from analysis.record import Tuning, record_of
from analysis.report import Row, interval_words, result_words, row_of, table
from analysis.selection import Options
from analysis.tuning import tune_log


def rowed(tuning: Tuning) -> Row:
    return row_of(tuning, record_of(tuning))


def test_the_table_shows_the_truth_only_where_a_log_states_one(drop_log: Path, tmp_path: Path):
    (tmp_path / "b.mcap").write_text("no log")
    known, unknown = (rowed(tune_log(path, Options())) for path in (drop_log, tmp_path / "b.mcap"))
    assert "truth" in table([known, unknown]).splitlines()[0]
    assert "truth" not in table([unknown]).splitlines()[0]
    assert "is not an MCAP log" in table([unknown])


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (0.61981, 0.62032, "0.6198 to 0.6203"),
        (0.7000012, 0.7000391, "0.70000 to 0.70004"),
        (0.3500001, 0.3500034, "0.350000 to 0.350003"),
        (0.34999996, 0.35000003, "0.349999 to 0.350001"),
        (0.0, 0.00002, "0.00000 to 0.00002"),
    ],
)
def test_an_interval_has_as_many_decimals_as_its_width_asks_for(
    low: float, high: float, words: str
):
    assert interval_words(low, high) == words


def test_no_interval_reads_as_certainty(drop_log: Path):
    tuning = tune_log(drop_log, Options())
    assert tuning.interval95 is not None
    words = interval_words(*tuning.interval95[0])
    low, high = words.split(" to ")
    assert low != high
    assert words in table([rowed(tuning)])
    assert f"95 %: {words}" in result_words(record_of(tuning), tuning.preset, "drop")
