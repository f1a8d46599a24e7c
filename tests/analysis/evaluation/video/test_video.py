"""tunenet-eval video: what is printed and written is what came of the tracks."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.cli import main
from tunenet_logs.analysis.evaluation.studies.video import (
    BAD,
    COLUMNS,
    DRAG,
    SETS,
    SLOPE,
    TRACK_SECTIONS,
    Portion,
    Section,
    VideoOrder,
    VideoRow,
    figures_of,
    outcomes_of,
    overall,
    section_table,
    track_sections,
    video_blocks,
    video_csv,
    video_json,
)
from tunenet_logs.analysis.evaluation.study import SECTIONS
from tunenet_logs.analysis.evaluation.worlds.camera import TRACK_FAULTS
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)
NAN = np.nan
OUTCOMES = np.array(
    [
        # truth, value, low, high, shown, verdict
        [0.5, 0.51, 0.48, 0.52, 1, 0],
        [0.5, 0.47, 0.46, 0.48, 0, 1],
        [0.5, 0.60, 0.55, 0.61, 1, 0],
        [0.5, NAN, NAN, NAN, 0, 2],
    ]
)


def test_figures_are_those_of_the_answers():
    found = figures_of(OUTCOMES)
    assert (found.targets, found.answered, found.rejected) == (4, 0.75, 0.25)
    assert (found.ok, found.suspect, found.wrong) == (0.5, 0.25, 0.25)
    assert found.mae == pytest.approx(0.14 / 3)
    assert found.median == pytest.approx(0.03)
    assert found.bias == pytest.approx(0.08 / 3)
    assert found.p95 == pytest.approx(0.03 + 0.9 * 0.07)
    assert found.covered == pytest.approx(1 / 3)
    assert (found.shown, found.shown_covered) == (pytest.approx(2 / 3), 0.5)
    assert found.width == pytest.approx(0.04)


def test_no_restitution_is_right_where_nothing_bounces():
    rows = OUTCOMES[[0, 3]].copy()
    rows[:, 0] = NAN
    found = figures_of(rows)
    assert (found.ok, found.wrong, found.rejected) == (0.5, 0.5, 0.5)
    assert (found.mae, found.covered, found.width) == (None, None, None)


def test_without_an_answer_there_is_no_figure():
    found = figures_of(np.tile(OUTCOMES[3], (3, 1)))
    assert (found.answered, found.rejected) == (0.0, 1.0)
    assert {found.mae, found.p95, found.covered, found.shown, found.width} == {None}


def test_a_table_holds_its_figures_in_their_columns():
    section = SETS[0]
    line = section_table(section, [VideoRow(section.name, "kind", OUTCOMES)]).splitlines()[2]
    words = ["kind", "4", "75.0", "25.0", "25.0", ".0467", ".0300", ".0930", "33.3", ".0400"]
    assert line.split() == words
    bias = section_table(DRAG, [VideoRow("drag", "kind", OUTCOMES)])
    assert "+.0267" in bias
    bad = section_table(BAD, [VideoRow("bad", "kind", OUTCOMES)]).splitlines()[2]
    assert bad.split() == ["kind", "4", "50.0", "25.0", "25.0", "25.0"]


def test_what_all_sets_say_comes_once_all_of_them_are_done():
    order = VideoOrder((1, 2, 3), 4)
    done = [(one, [VideoRow(one.name, "kind", OUTCOMES)]) for one in TRACK_SECTIONS]
    blocks = list(video_blocks(order, done))
    assert "seeds 1 to 3, 4 tracks each" in blocks[0]
    assert blocks[4].startswith("A, B and C: 12 tracks, 25.0 % rejected.")
    assert "33.3 % contain the truth, in the worst line 33.3 %; median width .0400" in blocks[4]
    assert len(blocks) == len(TRACK_SECTIONS) + 2
    assert len(list(video_blocks(order, done[1:]))) == len(TRACK_SECTIONS)
    assert max(len(line) for block in blocks for line in block.splitlines()) <= 100
    assert "interval" not in overall([VideoRow("set-A", "kind", OUTCOMES[3:])])


def test_json_and_csv_hold_one_record_for_each_line():
    rows = [VideoRow("set-A", "kind", OUTCOMES), VideoRow("bad", "other", OUTCOMES[3:])]
    told = json.loads(video_json(rows, VideoOrder((1, 2), 4)))
    assert (told["experiment"], told["seeds"], told["targets"]) == ("video", [1, 2], 4)
    table = list(csv.DictReader(video_csv(rows).splitlines()))
    assert tuple(table[0]) == COLUMNS
    for mine, other in zip(table, told["rows"], strict=True):
        assert {key: "" if value is None else str(value) for key, value in other.items()} == mine
    assert (table[1]["section"], table[1]["rejected"], table[1]["mae"]) == ("bad", "1.0", "")


def test_every_class_and_set_has_its_line():
    assert (*(one.name for one in TRACK_SECTIONS), "clips", "transformed") == SECTIONS
    assert [kind.fault for kind in BAD.kinds] == [one.name for one in TRACK_FAULTS]
    assert sum(len(one.kinds) for one in SETS) == 12
    kinds = [(kind.tracks.name, kind.balls, kind.noises_px) for one in SETS for kind in one.kinds]
    assert len(set(kinds)) == 12


@pytest.mark.slow
def test_the_same_figures_however_many_processes_there_are():
    kinds = (SETS[1].kinds[0], BAD.kinds[0])
    section = Section("few", "a few", kinds)
    runs = []
    for jobs in (1, 2):
        ((_, rows),) = track_sections(VideoOrder((-1, -2), 11, jobs), QUIET, (section,))
        assert [row.label for row in rows] == [kind.label for kind in kinds]
        runs.append([row.outcomes for row in rows])
    for one, other in zip(*runs, strict=True):
        assert one.shape == (22, 6)
        assert np.array_equal(one, other, equal_nan=True)
    good, still = runs[0]
    again = outcomes_of(Portion(kinds[0], -2, range(3, 5)))
    assert np.array_equal(good[14:16], again, equal_nan=True)
    assert np.nanmedian(np.abs(good[:, 1] - good[:, 0])) < 0.01
    assert np.isnan(still[:, 0]).all()
    assert (still[:, 5] == 2).all()


@pytest.mark.slow
def test_light_balls_are_the_same_told_or_not():
    given, _, unknown = DRAG.kinds
    with_air, without = (outcomes_of(Portion(one, -1, range(2))) for one in (given, unknown))
    assert np.array_equal(with_air[:, 0], without[:, 0])
    assert SLOPE.kinds[0].balls.slope == (0.05, 0.2)


@pytest.mark.slow
def test_the_command_prints_and_writes_the_tables_it_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path = tmp_path / "video.json"
    words = ("--seeds", "1", "--first-seed", "1000", "--targets", "2", "--jobs", "1")
    assert main(("video", *words, "--sections", "slope, set-B", "--json", str(path))) == 0
    told = capsys.readouterr()
    assert not told.err
    assert told.out.index("Set B: falls") < told.out.index("falls with speed")
    assert "Bad tracks" not in told.out
    rows = json.loads(path.read_text())["rows"]
    assert [row["section"] for row in rows] == ["set-B"] * 4 + ["slope"] * 2
    assert all(row["targets"] == 2 for row in rows)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("video", "--sections", "set-D"), "no section 'set-D'; there is: set-A, set-B"),
        (("video", "--sections", ","), "--sections names none; there is: set-A"),
        (
            ("drop", "--sections", "bad"),
            "is for video, payload, real-balls, bounce-shot, sysid and sound, not",
        ),
        (("video", "--methods", "mean"), "--methods is for drop, not video"),
        (("video", "--rrd", "a.rrd"), "--rrd is for drop, not video"),
    ],
)
def test_wrong_usage_is_one_line(
    words: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
):
    assert main(words) == 2
    told = capsys.readouterr()
    assert says in told.err
    assert told.err.count("\n") == 1
    assert not told.out
