"""Tables and words: what a terminal and a review show of a tuning."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.presentation import Row, interval_words, result_words, row_of, table
from tunenet_logs.analysis.record import Equivalent, Equivalents, Motion
from tunenet_logs.analysis.tuning import tune_log


def rowed(tuning: Tuning) -> Row:
    return row_of(tuning, record_of(tuning))


def test_the_table_shows_the_truth_only_where_a_log_states_one(drop_log: Path, tmp_path: Path):
    (tmp_path / "b.mcap").write_text("no log")
    known, unknown = (
        rowed(tune_log(path, TuneOptions())) for path in (drop_log, tmp_path / "b.mcap")
    )
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
    assert interval_words((low, high)) == words


def test_no_interval_reads_as_certainty(drop_log: Path):
    tuning = tune_log(drop_log, TuneOptions())
    assert tuning.interval95 is not None
    words = interval_words(tuple(tuning.interval95[0]))
    low, high = words.split(" to ")
    assert low != high
    assert words in table([rowed(tuning)])
    assert f" | {words} |" in result_words(record_of(tuning), tuning.preset, "drop")


def test_the_table_has_slope_drag_and_how_well_the_simulator_fits(drop_log: Path):
    header, line = table([rowed(tune_log(drop_log, TuneOptions()))]).splitlines()
    for name in ("slope", "drag [1/m]", "fits", "95 % interval"):
        assert name in header
    assert "0.00 %" in line
    paper = table([rowed(tune_log(drop_log, TuneOptions(method="brent")))]).splitlines()[0]
    assert "slope" not in paper
    assert "drag" not in paper


def test_what_an_airless_simulator_needs_and_what_the_log_leaves_open_is_said(drop_log: Path):
    tuning = tune_log(drop_log, TuneOptions())
    record = record_of(tuning)
    without = Equivalents(Equivalent(0.486, 1.05, (6.7,)), Equivalent(0.49, 1.0, (6.7,)))
    said = replace(
        record, motion=Motion(equivalents=without, unidentifiable=("drag and slope: no",))
    )
    words = table([replace(row_of(tuning, record), record=said)])
    assert "  without air: 0.486 for the first rebound (1.1 % rms), 0.490 for all (1.0 %)" in words
    assert "  drag and slope: no" in words
    assert "without air" not in table([rowed(tuning)])  # the same there


def test_a_suspects_interval_is_marked_as_such(drop_log: Path):
    tuning = tune_log(drop_log, TuneOptions())
    checks = tuple(
        replace(check, passed=check.name != "hold-out prediction") for check in tuning.checks
    )
    tuning = replace(tuning, checks=checks, verdict="suspect", reason="hold-out prediction: no")
    assert " (suspect)" in table([rowed(tuning)])
    words = result_words(record_of(tuning), tuning.preset, "drop")
    assert "95 % interval (suspect)" in words
    assert words.index("hold-out prediction") < words.index("| restitution")


def test_an_interval_is_given_unless_a_check_doubts_the_value_itself(drop_log: Path):
    tuning = tune_log(drop_log, TuneOptions())
    for name, has in (
        ("no samples missing", True),
        ("first flight seen", True),
        ("simulation fits", False),
        ("gravity", False),
    ):
        assert name in {check.name for check in tuning.checks}
        checks = tuple(replace(check, passed=check.name != name) for check in tuning.checks)
        doubted = replace(tuning, checks=checks, verdict="suspect", reason=name)
        assert (doubted.interval95 is not None) == has, name
