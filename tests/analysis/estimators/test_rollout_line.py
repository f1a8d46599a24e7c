"""Our estimator: what its straight lines find, and what it pays for it."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.estimators.methods import TuneNetThenLine, line_through
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    EASY,
    HARD,
    DropProblems,
    DropTarget,
    draw_targets,
)
from tunenet_logs.analysis.tunenet.network import Model
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.recorders.simulators.base import CALIBRATED, PAPER


@pytest.fixture(scope="module")
def paper() -> DropProblems:
    return DropProblems(PAPER)


@needs_pybullet
@pytest.mark.parametrize("truth", [0.1, 0.45, 0.7, 0.93])
def test_a_line_through_two_rollouts_lands_on_the_target(paper: DropProblems, truth: float):
    problem = paper.pose(DropTarget(4.4, 0.5, truth))
    places = (truth + 0.03, truth + 0.02)
    visited = [(one, problem.misfit(problem.evaluate(np.array([one])))) for one in places]
    line = line_through(visited, problem)
    assert line is not None
    assert line.value == pytest.approx(truth, abs=1e-4)


@needs_pybullet
def test_rollouts_that_do_not_differ_make_no_line(paper: DropProblems):
    problem = paper.pose(DropTarget(4.4, 0.5, 0.6))
    misfit = problem.misfit(problem.evaluate(np.array([0.5])))
    assert line_through([(0.5, misfit), (0.5, misfit)], problem) is None


@pytest.mark.parametrize(
    "contact", [pytest.param(PAPER, marks=needs_pybullet), CALIBRATED], ids=lambda one: one.name
)
@pytest.mark.parametrize(
    ("noise_m", "most"), [(0.0, 1e-4), pytest.param(0.01, 0.002, marks=pytest.mark.slow)]
)
def test_five_rollouts_are_enough(contact, noise_m: float, most: float):
    problems = DropProblems(contact)
    preset = "default" if contact is CALIBRATED else "paper-code"
    estimator = TuneNetThenLine(shipped_model(TRAININGS[preset].purpose))
    off = []
    for target in draw_targets(EASY, 20, -1, noise_m):
        trace = estimator.estimate(problems.pose(target), 5)
        off.append(abs(trace.after(5)[0] - target.truth))
    assert np.median(off) < most


@needs_pybullet
@pytest.mark.slow
def test_more_rollouts_search_near_by(paper: DropProblems):
    estimator = TuneNetThenLine(shipped_model(TRAININGS["paper-code"].purpose))
    off = []
    for target in draw_targets(HARD, 20, -1):
        trace = estimator.estimate(paper.pose(target), 40)
        off.append(abs(trace.after(40)[0] - target.truth))
    assert np.median(off) < 1e-5


@needs_pybullet
@pytest.mark.parametrize("rollouts", [0, 1, 2, 3, 10, 11, 40])
def test_what_it_spends_is_what_it_was_given(paper: DropProblems, rollouts: int):
    problem = paper.pose(DropTarget(4.2, 0.4, 0.66))
    estimator = TuneNetThenLine(shipped_model(TRAININGS["paper-code"].purpose))
    trace = estimator.estimate(problem, rollouts)
    counts = [step.rollouts for step in trace.steps]
    assert problem.rollouts <= rollouts
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert all(0 <= step.values[0] <= 1 for step in trace.steps)


@needs_pybullet
def test_a_dead_network_is_helped_by_a_probe(paper: DropProblems):
    """It gives the same place twice, so that the first two rollouts are alike."""
    problem = paper.pose(DropTarget(4.2, 0.4, 0.41))
    still = cast("Model", lambda proposed, _: np.zeros((len(proposed), 1)))
    trace = TuneNetThenLine(still).estimate(problem, 8)
    assert trace.estimate[0] == pytest.approx(0.41, abs=1e-4)


@needs_pybullet
@pytest.mark.parametrize("truth", [0.7, 0.93])
def test_a_line_between_two_rollouts_uses_the_longest_beginning_that_fits(truth: float):
    problem = DropProblems(PAPER).pose(DropTarget(4.4, 0.5, truth, noise_m=0.01))
    near = [np.array([truth + off]) for off in (0.0075, 0.005)]
    line = line_through(
        [(float(one[0]), problem.misfit(problem.evaluate(one))) for one in near], problem
    )
    assert line is not None
    assert line.samples > 100
    assert abs(line.value - truth) < 1e-3
