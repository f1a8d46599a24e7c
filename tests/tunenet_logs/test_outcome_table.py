"""Outcomes written down in a table."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest

from tunenet_logs.errors import LogError
from tunenet_logs.outcomes import Outcome, read_outcomes

GOOD = """\
ball,success,attempt,time,shot_height_m,miss_m,reason,weather
red gel,success,1,2026-11-22 14:30Z,0.62,0.004,,sunny
red gel,failure,2,2026-11-22 14:35Z,0.62,,"short, rim",sunny
"""


def test_columns_go_by_their_names(tmp_path: Path):
    table = tmp_path / "outcomes.csv"
    table.write_text(GOOD)
    first, second = read_outcomes(table)
    assert first == Outcome(
        task="bounce-shot",
        ball="red gel",
        attempt=1,
        success=True,
        stamp_ns=1_795_357_800_000_000_000,
        shot_height_m=0.62,
        miss_m=0.004,
    )
    assert (second.success, second.miss_m, second.reason) == (False, None, "short, rim")
    assert read_outcomes(tmp_path) == (first, second)


def test_a_short_table_of_another_country(tmp_path: Path):
    table = tmp_path / "outcomes.csv"
    table.write_text("Ball;Result;Miss\ngel;yes;0,012\nracquetball;no;0,08\ngel;no;\n")
    found = {(one.ball, one.attempt): one for one in read_outcomes(table)}
    assert found["gel", 1].miss_m == 0.012
    assert not found["gel", 2].success
    assert not found["racquetball", 1].success


def test_a_row_that_begins_with_a_hash_is_a_row(tmp_path: Path):
    table = tmp_path / "outcomes.csv"
    table.write_text("# a windy day\nball,success\n#1 red,yes\n#2 red,no\n")
    assert [one.ball for one in read_outcomes(table)] == ["#1 red", "#2 red"]


def test_what_was_not_numbered_is_numbered_over_all_tables(tmp_path: Path):
    (tmp_path / "a.csv").write_text("ball,success,attempt\ngel,yes,2\ngel,no,\nfoam,no,\n")
    (tmp_path / "b.tsv").write_text("ball\tsuccess\ngel\tyes\n")
    found = read_outcomes(tmp_path)
    assert sorted((one.ball, one.attempt) for one in found) == [
        ("foam", 1),
        ("gel", 2),
        ("gel", 3),
        ("gel", 4),
    ]


def test_a_time_beyond_all_clocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TZ", "America/New_York")
    time.tzset()
    table = tmp_path / "outcomes.csv"
    table.write_text("ball,success,time\na,1,9999-12-31 23:59\n")
    with pytest.raises(LogError, match=r"line 2, column 'time': '9999-12-31 23:59' cannot be read"):
        read_outcomes(table)
    monkeypatch.undo()
    time.tzset()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "is empty"),
        ("ball,attempt\na,1\n", "no column 'success' (there are: ball, attempt)"),
        ("ball,success\na,perhaps\n", "line 2, column 'success': 'perhaps' cannot be read; write"),
        ("ball,success\na,1\nb,\n", "line 3, column 'success': ''"),
        ("ball,success,miss\na,1,far\n", "line 2, column 'miss': 'far' is no number; write a num"),
        ("ball,success,attempt\na,1,1.5\n", "line 2, column 'attempt': '1.5'"),
        ("ball,success,time\na,1,noon\n", "line 2, column 'time': 'noon' cannot be read; write"),
        ("ball,success\n,1\n", "line 2: ball is empty; correct that line"),
        ("ball,success\na,1,2\n", "line 2 has 3 cells under 2 names"),
        ("ball,success\n", "holds no outcome"),
    ],
)
def test_what_is_wrong_is_one_line_with_its_place(tmp_path: Path, text: str, told: str):
    table = tmp_path / "outcomes.csv"
    table.write_text(text)
    with pytest.raises(LogError, match=re.escape(told)) as caught:
        read_outcomes(table)
    assert str(caught.value).startswith(str(table))
    assert "\n" not in str(caught.value)
