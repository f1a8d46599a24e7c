"""The figures of studies are those of a calculation by hand, and stand in their columns."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.studies.drop import drop_markdown, drop_tables, factor
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    Cell,
    DropResults,
    Group,
    MethodErrors,
    published_error,
)
from tunenet_logs.analysis.evaluation.studies.engines import (
    EXACT,
    METHODS,
    RANGES,
    engine_tables,
    line_of,
)
from tunenet_logs.analysis.evaluation.studies.intervals import coverage_of, coverage_table
from tunenet_logs.analysis.evaluation.studies.motion import (
    ROWS,
    MotionError,
    motion_lines,
    motion_records,
    with_figures,
)
from tunenet_logs.analysis.evaluation.studies.payload import METHODS as MASS_METHODS
from tunenet_logs.analysis.evaluation.studies.payload import (
    OUTCOMES,
    PLAIN,
    STRANGER_CASES,
    LogCase,
    StrangerAnswer,
    log_row,
    mass_table,
    outcome,
    stranger_row,
)
from tunenet_logs.analysis.evaluation.studies.payload import SETS as MASS_SETS
from tunenet_logs.analysis.evaluation.studies.real_balls import (
    LIGHT,
    Found,
    Score,
    lines_of,
    section_tables,
)
from tunenet_logs.analysis.evaluation.studies.video import (
    BAD,
    DRAG,
    SETS,
    TRACK_SECTIONS,
    clip_table,
    figures_of,
    overall,
    section_table,
    transformed_table,
)
from tunenet_logs.analysis.evaluation.study import STUDIES, Order, Row, short
from tunenet_logs.analysis.evaluation.worlds.camera import TRACK_FAULTS
from tunenet_logs.analysis.payload.torque_model import Convention

NAN = np.nan
near = pytest.approx

# ---- drop: errors by rollouts, who is ahead, coverage.


EASY = Cell("drop", "paper", "Easy", 0.0)


def errors(values: list[list[list[float]]], budget: int, cell: Cell = EASY) -> MethodErrors:
    return MethodErrors(cell, "cma-es", "CMA-ES", "paper", budget, np.array(values))


def test_errors_over_seeds_and_targets():
    # two seeds, three targets, after 0 and 1 rollouts
    one = errors([[[9, 0.1], [9, 0.2], [9, 0.6]], [[9, 0.0], [9, 0.1], [9, 0.2]]], budget=1)
    figures = one.figures(1)
    assert (figures.mae, figures.median) == near((0.2, 0.15))
    assert (figures.lowest, figures.highest) == near((0.1, 0.3))
    assert figures.paper == 0.0540
    assert (one.figures(100).mae, one.figures(0).mae) == (figures.mae, 9)


def test_what_a_method_was_not_allowed_is_not_known():
    noisy = errors([[[0.3, 0.2, 0.1]]], budget=100, cell=Cell("drop", "paper", "Easy", 0.01))
    assert noisy.knows(2)
    assert not noisy.knows(5)
    with pytest.raises(ValueError, match="2 rollouts, not 5"):
        noisy.figures(5)
    assert noisy.figures(1).paper is None


def test_published_figures_stand_beside_what_they_were_measured_as():
    assert published_error("Easy", "tunenet-paper-code", 5) == 0.0050
    assert published_error("Hard", "tunenet-paper", 100) == 0.0175
    assert published_error("Hard (target only)", "entropy-search", 10) == 0.1153
    assert published_error("Easy", "brent", 5) is None
    assert published_error("Easy", "mean", 40) is None


def method(name: str, error: float, group: Group = "user") -> MethodErrors:
    return MethodErrors(EASY, name, name.upper(), group, 10, np.full((1, 2, 11), error))


def test_one_method_is_ours_and_those_that_know_targets_are_not_ranked():
    told = (method("mean", 1e-4, "paper"), method("entropy-search", 1e-4, "paper"))
    ours = (method("network", 1e-3, "ours"), method("ours", 0.01, "ours"))
    results = DropResults((1,), 2, (*told, method("secant", 0.02), *ours))
    table, _, ahead = drop_tables(results).partition("Who is ahead")
    assert "at  5: OURS, .0100" in ahead
    assert "OURS at 5 (.0100): 2 times ahead of SECANT at 10 (.0200)" in ahead
    assert not any(name in ahead for name in ("MEAN", "ENTROPY", "NETWORK"))
    assert "MEAN* " in table
    assert "* is given the mean" in table
    assert "\\* is given" in drop_markdown(results)
    assert "| MEAN* |" in drop_markdown(results)
    assert "Who is ahead" not in drop_tables(DropResults((1,), 2, told))


def test_the_worst_seed_stands_beside_the_mean():
    values = np.full((2, 3, 6), 0.02)
    values[1] = 0.04
    one = MethodErrors(EASY, "brent", "Brent", "user", 10, values)
    text = drop_tables(DropResults((1, 2), 3, (one,), rollouts=5))
    assert f"–{short(0.04)}]" in text
    assert f"(worst: seed 2, {short(0.04)})" in text
    assert not any(words in text for words in ("K=10", "at 10", "K=40"))
    alone = MethodErrors(EASY, "brent", "Brent", "user", 10, values[:1])
    assert "worst: seed" not in drop_tables(DropResults((1,), 3, (alone,)))


@pytest.mark.parametrize(
    ("mine", "theirs", "says"),
    [
        (1e-12, 1e-15, "level with"),
        (0.0, 9e-10, "level with"),
        (0.0, 0.1, "without error, ahead of"),
        (0.2, 0.1, "2 times behind"),
    ],
)
def test_errors_that_print_as_nothing_are_level(mine: float, theirs: float, says: str):
    assert factor(mine, theirs) == says


def test_credible_intervals_are_counted_where_there_is_a_posterior():
    cell = Cell("drop", "paper", "Hard (target only)", 0.01)
    one = MethodErrors(cell, "npe", "Neural posterior (sbi)", "user", 0, np.full((2, 5, 1), 0.004))
    held = {"method": "npe", "targets": 10, "held": 0.9, "held_se": 0.1, "width": 0.02}
    results = DropResults((1, 2), 5, (one,), ({**cell.keys, **held},))
    assert "10       90.0 ± 10.0 %  .0200" in drop_tables(results)
    assert "95 % credible" not in drop_tables(DropResults((1, 2), 5, (one,)))


def coverage_rows(count: int, held: int, ok: int) -> np.ndarray:
    """Truth .5 and intervals of .1, the first `held` of which hold it."""
    rows = np.tile([0.5, 0.51, 0.45, 0.55, 0.53, 0.0], (count, 1))
    rows[held:, 2] = 0.505
    rows[:ok, 5] = 1
    return rows


@pytest.mark.filterwarnings("error")
def test_coverage_is_counted_with_its_error_and_of_nothing_is_a_dash():
    one = coverage_of("drops", np.vstack([coverage_rows(600, 570, 300), np.full((2, 6), NAN)]))
    assert (one["targets"], one["fitted"]) == (602, 600)
    assert (one["covered"], one["ok"], one["ok_covered"]) == near((0.95, 300 / 602, 1.0))
    assert one["covered_se"] == near(0.0090, abs=3e-4)
    assert one["ok_covered_se"] > 0
    assert "95.0 ± 0.9 %" in coverage_table([one])
    nothing = coverage_of("drops", np.full((3, 6), NAN))
    none_ok = coverage_of("others", coverage_rows(4, 4, 0))
    table = coverage_table([nothing, none_ok]).splitlines()
    assert table[2].split() == ["drops", "3", "0", "-", "0.0", "%", "-", "-"]
    assert table[3].strip() == "mean error -; the network's alone -"
    assert [nothing[key] for key in ("covered", "covered_se", "width", "mae")] == [None] * 4
    assert (none_ok["covered"], none_ok["ok_covered"]) == (1.0, None)


# ---- video: tracks, clips.


OUTCOMES_OF_TRACKS = np.array(
    [
        # truth, value, low, high, shown, verdict
        [0.5, 0.51, 0.48, 0.52, 1, 0],
        [0.5, 0.47, 0.46, 0.48, 0, 1],
        [0.5, 0.60, 0.55, 0.61, 1, 0],
        [0.5, NAN, NAN, NAN, 0, 2],
    ]
)


def test_tracks_of_a_kind():
    found = figures_of(OUTCOMES_OF_TRACKS)
    assert (found["targets"], found["answered"], found["rejected"]) == (4, 0.75, 0.25)
    assert (found["ok"], found["suspect"], found["wrong"]) == (0.5, 0.25, 0.25)
    assert (found["mae"], found["median"]) == near((0.14 / 3, 0.03))
    assert (found["bias"], found["p95"]) == near((0.08 / 3, 0.03 + 0.9 * 0.07))
    assert (found["covered"], found["shown"], found["shown_covered"]) == near((1 / 3, 2 / 3, 0.5))
    assert found["width"] == near(0.04)
    row = {"tracks": "kind", **found}
    words = ["kind", "4", "75.0", "25.0", "25.0", ".0467", ".0300", ".0930", "33.3", ".0400"]
    assert section_table(SETS[0], [row]).splitlines()[2].split() == words
    assert "+.0267" in section_table(DRAG, [row])
    bad = section_table(BAD, [row]).splitlines()[2]
    assert bad.split() == ["kind", "4", "50.0", "25.0", "25.0", "25.0"]
    text = overall([OUTCOMES_OF_TRACKS] * 3)
    assert text.startswith("A, B and C: 12 tracks, 25.0 % rejected.")
    assert "33.3 % contain the truth, in the worst line 33.3 %; median width .0400" in text


def test_tracks_without_a_bounce_or_an_answer_have_no_figure():
    rows = OUTCOMES_OF_TRACKS[[0, 3]].copy()
    rows[:, 0] = NAN
    found = figures_of(rows)
    assert (found["ok"], found["wrong"], found["rejected"]) == (0.5, 0.5, 0.5)
    assert (found["mae"], found["covered"], found["width"]) == (None, None, None)
    nothing = figures_of(np.tile(OUTCOMES_OF_TRACKS[3], (3, 1)))
    assert (nothing["answered"], nothing["rejected"]) == (0.0, 1.0)
    assert {nothing[name] for name in ("mae", "p95", "covered", "shown", "width")} == {None}
    assert "interval" not in overall([OUTCOMES_OF_TRACKS[3:]])


def test_every_class_and_set_of_tracks_has_its_line():
    names = (*(one.name for one in TRACK_SECTIONS), "clips", "transformed", "bound")
    assert names == tuple(STUDIES["video"].sections)
    assert [kind.fault for kind in BAD.kinds] == [one.name for one in TRACK_FAULTS]
    kinds = [(kind.tracks.name, kind.balls, kind.noises_px) for one in SETS for kind in one.kinds]
    assert len(set(kinds)) == len(kinds) == 12


def test_clips_that_were_answered_are_counted():
    good: Row = {"truth": 0.5, "estimate": 0.504, "interval": [0.49, 0.51], "verdict": "ok"}
    good |= {"off_px": 0.2}
    bad = {**good, "estimate": 0.52, "interval": [0.515, 0.525], "verdict": "suspect"}
    none = {**good, "estimate": None, "interval": None, "verdict": "rejected", "off_px": None}
    table = clip_table([good, bad, none])
    assert table.splitlines()[-1].split()[:4] == ["3", "2", "1", ".0120"]
    assert "1 of 2" in table
    assert "nan" not in clip_table([none])
    clips = [
        {"estimates": [0.5, 0.51, 0.5], "spread": 0.01},
        {"estimates": [None, 0.51, 0.5], "spread": 0.01},
        {"estimates": [None, None, 0.5], "spread": None},
    ]
    assert transformed_table(clips).splitlines()[-1].split()[:2] == ["3", "1"]


# ---- real balls.


def found_ball(error: float, half: float, verdict: str = "ok", path: float = 0.01) -> Found:
    """Restitution and its interval alone."""
    values = np.array([0.7 + error, NAN, NAN])
    ends = np.full((3, 2), NAN)
    ends[0] = values[0] - half, values[0] + half
    return Found(TRUTH, values, ends, verdict, path)


TRUTH = np.array([0.7, 0.05, 0.1])
REFERENCE = Found(TRUTH, TRUTH + 0.001, TRUTH[:, None] + np.array([-0.002, 0.003]), "", 1e-4)
DROPS = [
    Score(found_ball(0.002, 0.005), REFERENCE),
    Score(found_ball(-0.006, 0.005), REFERENCE),
    Score(found_ball(0.001, NAN, "suspect", 0.03), REFERENCE),
    Score(found_ball(NAN, NAN, "rejected", NAN), REFERENCE),
]


def test_balls_in_air_beside_the_reference():
    lines = lines_of("x 1, 1 mm", DROPS)
    first, slope, drag, path = lines
    assert (first["drops"], first["answered"], first["intervals"]) == (4, 3, 2)
    assert (first["ok"], first["suspect"], first["rejected"]) == (0.5, 0.25, 0.25)
    assert (first["mean"], first["median"], first["worst"]) == near((0.003, 0.002, 0.006))
    assert first["reference_mean"] == near(0.001)
    assert (first["covered"], first["reference_covered"]) == (0.5, 1.0)
    assert (first["width"], first["widest"]) == near((2.0, 2.0))
    assert {slope[name] for name in ("mean", "worst", "covered", "width")} == {None}
    assert (drag["answered"], slope["reference_worst"]) == (0, near(0.001))
    assert (path["worst"], path["reference_p99"]) == near((0.03, 1e-4))
    tables = list(section_tables("positions", lines))
    ours = ["x", "1,", "1", "mm", "4", "50.0", "25.0", ".0030", ".0060", "50.0", "(2)"]
    assert tables[0].splitlines()[2].split() == [*ours, ".0010", ".0010", "100.0", "2.00", "2.00"]
    assert tables[1].splitlines()[2].split()[7:10] == ["-"] * 3
    of_path = ["3", "1.667", "1.000", "2.960", "3.000", "0.010", "0.010", "0.010"]
    assert tables[3].splitlines()[2].split()[4:] == of_path


def test_motions_that_were_foretold():
    names = ("ours", "paper", "first_rebound", "best_airless")
    moved = [
        Score(DROPS[0].ours, None, dict(zip(names, (0.002, 0.2, 0.03, 0.02), strict=True)), "ok"),
        Score(
            DROPS[3].ours, None, dict(zip(names, (NAN, 0.1, 0.01, 0.01), strict=True)), "rejected"
        ),
    ]
    row = list(section_tables("balls", lines_of("golf", moved)))[-1].splitlines()[4].split()
    assert row[:4] == ["golf", "1", "of", "2"]
    assert row[4:] == ["0.200,", "0.200", "15.0,", "20.0", "2.000,", "3.000", "1.500,", "2.000"]
    films = lines_of("golf", [Score(DROPS[0].ours, None, {"ours": 0.01})])
    light = lines_of(LIGHT[1], [Score(DROPS[0].ours)])
    tables = list(section_tables("films", [*films, *light]))
    assert LIGHT[1] in tables[0]
    assert LIGHT[1] not in tables[-1]
    assert tables[-1].splitlines()[4].split() == ["golf", "1", "of", "1", "1.000,", "1.000"]


# ---- payload.


def test_the_table_of_masses_has_the_papers_figures():
    rows = [
        {"method": one.name, "set": which, "mae_kg": 0.0, "percent": 0.0}
        for one in MASS_METHODS
        for which in MASS_SETS
    ]
    text = mass_table(rows, Order((1, 2), 60))
    assert len(text.splitlines()) == 4 + len(MASS_METHODS)
    for figure in ("(0.011)", "(0.198)", "(13.2)", "(0.504)", "(0.255)", "(28)", "(17.1)"):
        assert figure in text


def test_logs_of_a_driver():
    nothing = {"truth": 0.5, "value": None, "ok": False}
    first = {**nothing, "value": 0.52, "low": 0.4, "high": 0.6, "bound": 0.1, "secant": 0.6}
    first |= {"ok": True, "centre_mm": None}
    second = {**first, "value": 0.44, "high": 0.46, "secant": 0.5, "ok": False}
    second["centre_mm"] = np.array([10.0, 2.0, 0.0])
    row = log_row(LogCase("some", True), [first, second, nothing])
    assert (row["logs"], row["answered"], row["ok"]) == (3, near(2 / 3), near(1 / 3))
    assert (row["mae"], row["held"], row["width"]) == near((0.04, 0.5, 0.13))
    assert (row["secant"], row["told"], row["told_mae"]) == near((0.05, 0.5, 0.06))
    assert row["centre_mm"] == near((10.0, 2.0, 0.0))
    empty = log_row(LogCase("some", True), [nothing])
    assert {empty[name] for name in ("mae", "held", "width", "told")} == {None}


def said(mass_kg: float, *, is_ok: bool = True, sign: int = 1) -> StrangerAnswer:
    convention = Convention(sign, True)
    return StrangerAnswer(mass_kg, mass_kg - 0.01, mass_kg + 0.01, is_ok, convention)


def log_of(answer: StrangerAnswer | None, least_squares_kg: float) -> Row:
    """Of 1 kg, which a subtracted tare finds."""
    both = {"least_squares": least_squares_kg, "tare_subtracted": 1.0}
    return {"truth": 1.0, **both, "bounds": (0.1, 0.1), "answers": (answer, answer)}


def test_strangers_logs_beside_the_baselines():
    case = STRANGER_CASES[0]
    logs = [
        log_of(said(1.005), 1.2),
        log_of(said(1.031), 1.2),  # more than three half widths off
        log_of(said(0.98, is_ok=False), 0.81),
        log_of(said(1.0, sign=-1), 1.2),
        log_of(None, 9.0),
    ]
    row = stranger_row(case, logs, has_tare=True)
    assert (row["logs"], row["answered"], row["ok"]) == (5, near(0.8), near(0.6))
    assert (row["mae_g"], row["median_g"], row["worst_g"]) == near((14.0, 12.5, 31.0))
    assert (row["held"], row["width_g"]) == near((0.5, 20.0))
    assert row["bound_g"] == near(100 * np.sqrt(2 / np.pi))
    assert (row["far_ok"], row["wrong_ok"]) == (near(0.2), 1)
    assert (row["least_squares_mae_g"], row["least_squares_standing"]) == (near(197.5), "ahead")
    assert row["tare_subtracted_standing"] == "behind"
    assert "tare_subtracted_mae_g" not in stranger_row(case, logs, has_tare=False)
    nothing = stranger_row(case, logs[4:], has_tare=True)
    assert (nothing["answered"], nothing["mae_g"]) == (0.0, None)
    level = [log_of(said(1.01), 1.02), log_of(said(1.02), 1.01)]
    assert stranger_row(case, level, has_tare=False)["least_squares_standing"] == "level"


def test_outcomes_of_conventions():
    good, doubted = said(1.0), said(1.0, is_ok=False)
    other = Convention(-1, True)
    told = [outcome(PLAIN, good), outcome(PLAIN, doubted), outcome(other, good)]
    assert [*told, outcome(other, doubted), outcome(PLAIN, None)] == list(OUTCOMES)


# ---- engines, motion.


def engine_line(*off: float, suspect: tuple[float, ...] = (), at: int = -1) -> Row:
    """Of the default method, or of another."""
    scores = [
        {"method": METHODS[at], "error": abs(one), "apart_percent": 0.1, "is_ok": is_ok}
        for some, is_ok in ((off, True), (suspect, False))
        for one in some
    ]
    return line_of(RANGES[0], "mujoco", EXACT, METHODS[at], 3, scores)


def test_a_promise_of_engines_is_kept_by_the_worst_that_is_ok():
    assert engine_line(0.001, -0.0029)["is_kept"] is True
    assert engine_line(0.001, -0.0031)["is_kept"] is False
    assert engine_line(0.001, suspect=(0.1,))["is_kept"] is True
    assert engine_line(suspect=(0.001,))["is_kept"] is None
    assert engine_line(0.1, at=0)["is_kept"] is None
    rows = [engine_line(0.2, at=0), engine_line(0.004, suspect=(0.02,))]
    table = engine_tables(rows, Order((1,), 3))
    (row,) = [one for one in table.splitlines() if one.startswith("mujoco")]
    answered, network = ["1", "2", "of", "3"], [".2000", ".2000", ".1000", "%"]
    default = [".0120", ".0200", ".1000", "%", ".0040", "missed"]
    assert row.split()[2:] == [*answered, *network, *default]
    assert "kept by 0 of 1 pairs" in table
    absent = [{**engine_line(at=at), "missing": "pybullet"} for at in (0, 1)]
    assert "not run: pybullet is not installed" in engine_tables(absent, Order((1,), 3))


def test_the_table_of_motion_holds_means_spread_and_the_papers_figures():
    names = [row.name for row in ROWS if row.name != "tunenet-obs"]
    first = {name: MotionError(2.0 + index, 0.004) for index, name in enumerate(names)}
    second = {name: MotionError(4.0 + index, 0.006) for index, name in enumerate(names)}
    rows = with_figures([first, second])
    text = motion_lines(rows, Order((1, 2), 100))
    lines = [" ".join(line.split()) for line in text.splitlines()]
    zero = "Zero 1 rollout 3.00 (100) [2.00–4.00] 0.0050 (97) [0.0040–0.0060]"
    assert any(line.startswith(zero) for line in lines)
    assert any(line.startswith("TuneNet (Obs) 8 rollout - (6.03) - (5.7)") for line in lines)
    records = motion_records(rows, (1, 2))
    assert len(records) == 2 * (len(ROWS) - 1) + 1
    one, again = [row for row in records if row["method"] == "zero"]
    assert (one["seed"], one["percent"], one["paper_cm"]) == (1, 2.0, 97.0)
    assert (again["seed"], again["cm"]) == (2, 0.006)
