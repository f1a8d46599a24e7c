"""Estimators on plain functions and drops: how near they come, and what they spend."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.estimators.base import Observation, Problem
from tunenet_logs.analysis.estimators.methods import (
    ScaledCmaEs,
    TuneNet,
    TuneNetThenLine,
    line_through,
)
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    EASY,
    HARD,
    DropProblems,
    DropTarget,
    draw_targets,
)
from tunenet_logs.analysis.tunenet.network import Model
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.ball import RESTITUTION
from tunenet_logs.recorders.simulators.base import CALIBRATED, PAPER, Parameter


class Line:
    """A simulator whose observation is its parameter."""

    parameters = (RESTITUTION,)
    engine = "none"
    step_hz = 1.0

    def rollout(self, values: Mapping[str, float]) -> Episode:
        return Episode(EpisodeInfo(truth=values), {})


def observe(episode: Episode) -> Observation:
    value = np.array([[episode.info.truth["restitution"]]])
    return Observation(value, np.zeros(1), "nothing", ("value",))


def problem(target: float, initial: float = 0.0) -> Problem:
    wanted = Observation(np.array([[target]]), np.zeros(1), "nothing", ("value",))
    return Problem(wanted, Line(), observe, np.array([initial]))


def network(gain: float) -> Model:
    """The residual, times a gain: what a trained network is, near enough."""
    return cast("Model", lambda proposed, target: gain * (target - proposed)[:, :, 0])


def test_each_iteration_is_one_rollout_and_stays_within_what_physics_allows():
    asked = problem(0.8)
    trace = TuneNet(network(0.5)).estimate(asked, 4)
    assert [step.rollouts for step in trace.steps] == [0, 1, 2, 3, 4]
    assert asked.rollouts == 4
    values = [float(step.values[0]) for step in trace.steps]
    assert values == pytest.approx([0, 0.4, 0.6, 0.7, 0.75])
    assert trace.estimate[0] == pytest.approx(0.75)
    trace = TuneNet(network(5.0)).estimate(problem(0.9), 3)
    assert all(0 <= step.values[0] <= 1 for step in trace.steps)
    assert trace.steps[1].values[0] == 1


def test_a_value_that_no_parameter_has_never_reaches_the_simulator():
    for initial in (-0.1, 1.5, np.nan):
        with pytest.raises(UsageError, match="restitution"):
            problem(0.5, initial)
    mass: Any = Parameter("payload_mass", "kg", (0.0, 5.0), (0.0, 2.0), 1.0)
    assert mass.checked(2) == 2.0
    with pytest.raises(UsageError, match="payload_mass"):
        mass.checked(-1)


needs_cma = pytest.mark.skipif(find_spec("cma") is None, reason="needs cma")


@needs_cma
def test_cma_es_finds_the_truth_and_is_the_same_twice_and_never_worse_than_the_first_guess():
    for truth in (0.0, 0.31, 0.72, 1.0):
        for rollouts in (0, 1, 7, 150):
            asked, again = problem(truth, 0.5), problem(truth, 0.5)
            found = float(ScaledCmaEs(3).estimate(asked, rollouts).estimate[0])
            assert abs(found - truth) < (0.003 if rollouts == 150 else abs(0.5 - truth) + 1e-9)
            assert asked.rollouts <= rollouts
            assert found == ScaledCmaEs(3).estimate(again, rollouts).estimate[0]


@needs_cma
def test_cma_es_leaves_everything_else_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    np.random.seed(1)  # noqa: NPY002 (the one that a library might draw from)
    expected = np.random.random(3)  # noqa: NPY002
    np.random.seed(1)  # noqa: NPY002
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ScaledCmaEs(3).estimate(problem(0.3), 50)
    np.testing.assert_array_equal(np.random.random(3), expected)  # noqa: NPY002
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")
    monkeypatch.setitem(sys.modules, "cma", None)
    with pytest.raises(UsageError, match=r"cma is not installed; pip install .*\[eval\]"):
        ScaledCmaEs(0).estimate(problem(0.3), 10)


@pytest.fixture(scope="module")
def paper() -> DropProblems:
    return DropProblems(PAPER)


@pytest.mark.parametrize(
    ("contact", "targets", "noise_m", "rollouts", "most"),
    [
        pytest.param(PAPER, EASY, 0.0, 5, 1e-4, marks=needs_pybullet),
        (CALIBRATED, EASY, 0.0, 5, 1e-4),
        pytest.param(PAPER, EASY, 0.01, 5, 0.002, marks=[needs_pybullet, pytest.mark.slow]),
        pytest.param(CALIBRATED, EASY, 0.01, 5, 0.002, marks=pytest.mark.slow),
        pytest.param(PAPER, HARD, 0.0, 40, 1e-5, marks=[needs_pybullet, pytest.mark.slow]),
    ],
)
def test_five_rollouts_are_enough_and_more_search_near_by(
    contact: Any, targets: Any, noise_m: float, rollouts: int, most: float
):
    problems = DropProblems(contact)
    preset = "default" if contact is CALIBRATED else "paper-code"
    estimator = TuneNetThenLine(shipped_model(TRAININGS[preset].purpose))
    off = []
    for target in draw_targets(targets, 20, -1, noise_m):
        trace = estimator.estimate(problems.pose(target), rollouts)
        off.append(abs(trace.after(rollouts)[0] - target.truth))
    assert np.median(off) < most


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
@pytest.mark.parametrize(
    ("truth", "noise_m", "places", "off"),
    [
        *((truth, 0.0, (0.03, 0.02), 1e-4) for truth in (0.1, 0.45, 0.7, 0.93)),
        *((truth, 0.01, (0.0075, 0.005), 1e-3) for truth in (0.7, 0.93)),
    ],
)
def test_a_line_through_two_rollouts_lands_on_the_target(
    paper: DropProblems, truth: float, noise_m: float, places: tuple[float, ...], off: float
):
    """By the longest beginning that fits."""
    problem = paper.pose(DropTarget(4.4, 0.5, truth, noise_m=noise_m))
    visited = [
        (truth + one, problem.misfit(problem.evaluate(np.array([truth + one])))) for one in places
    ]
    line = line_through(visited, problem)
    assert line is not None
    assert line.value == pytest.approx(truth, abs=off)
    assert not noise_m or line.samples > 100
    assert line_through([visited[0], visited[0]], problem) is None  # they do not differ
