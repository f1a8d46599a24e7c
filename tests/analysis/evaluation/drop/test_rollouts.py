"""The second experiment with few rollouts: columns are left out, and no figure changes."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.analysis.evaluation.drop.test_drop import EASY_CELL, QUIET, ready_methods, share
from tunenet_logs.analysis.evaluation.studies.drop import (
    DropExperiment,
    draw_figure,
    drop_json,
    drop_markdown,
    drop_rows,
    drop_tables,
    error_curves,
    run_drop,
)
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    HARD,
    DropResults,
    Method,
    draw_targets,
    errors_of,
)
from tunenet_logs.analysis.evaluation.study import short

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("method", ready_methods(), ids=lambda one: one.name)
def test_an_answer_does_not_depend_on_how_many_rollouts_are_left(method: Method):
    targets = draw_targets(HARD, 2, seed=-4, noise_m=0.01)
    few, many = errors_of(share(method, targets, 5)), errors_of(share(method, targets))
    assert np.array_equal(few, many[:, : few.shape[1]])


@pytest.fixture(scope="module")
def few() -> DropResults:
    methods = ("mean", "secant", "brent")
    return run_drop(DropExperiment((1, 2), 2, methods, 2, rollouts=5), QUIET)


@pytest.fixture(scope="module")
def full() -> DropResults:
    return run_drop(DropExperiment((1, 2), 2, ("secant",), 2), QUIET)


def test_fewer_rollouts_leave_out_columns_and_nothing_else(few: DropResults, full: DropResults):
    assert {one.allowed for one in few.outcomes} == {0, 5}
    assert {row["rollouts"] for row in drop_rows(few)} == {1, 5}
    assert json.loads(drop_json(few))["most_rollouts"] == 5
    text = drop_tables(few) + drop_markdown(few)
    assert "K=5" in text
    assert not any(words in text for words in ("K=10", "K = 10", "at 10", "K=40"))
    for secant in full.outcomes:
        cut = next(one for one in few.of(secant.cell) if one.method == "secant")
        assert np.array_equal(cut.errors, secant.errors[:, :, :6])


def test_fewer_rollouts_end_the_curves_and_the_published_points(few: DropResults):
    curves = error_curves(few, "Easy")
    assert {len(curve.mean) for curve in curves} == {6}
    assert [rollouts for rollouts, _ in curves[0].paper] == [1, 5]
    one, *_ = draw_figure(few).axes
    assert one.get_xlim()[1] < 6


def test_the_worst_seed_stands_beside_the_mean(few: DropResults):
    brent = next(one for one in few.of(EASY_CELL) if one.method == "brent")
    means = brent.errors_after(5).mean(axis=1)
    assert brent.figures(5).highest == max(means)
    alone = drop_tables(replace(few, outcomes=(brent,)))
    assert f"–{short(max(means))}]" in alone
    assert f"(worst: seed {1 + means.argmax()}, {short(max(means))})" in alone
    assert "worst: seed" not in drop_tables(DropResults((1,), 2, (brent,)))
