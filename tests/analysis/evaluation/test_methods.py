"""Laws of every method that competes in the second experiment, and what each of them finds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import TRAININGS, FlightSecant
from tunenet_logs.analysis.estimators.base import Problem, Trace
from tunenet_logs.analysis.evaluation.studies import drop_methods as drop
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.episode import Episode
from tunenet_logs.recorders.simulators.base import CALIBRATED, PAPER, Simulator

_SHIPPED = shipped_model(TRAININGS["paper-code"].purpose)
NETWORKS: drop.Networks = dict.fromkeys(("paper", "paper-code", "direct"), _SHIPPED)
SEARCHES = ["entropy-search", "cma-es", "secant", "brent", "least-squares", "tpe"]
NAMES = ["mean", "direct", "tunenet-paper", "tunenet-paper-code", *SEARCHES]
DEAR = ("entropy-search", "cma-es", "tpe")  # they take long, or their libraries load for long

CASE = drop.DropTarget(release_m=4.3, initial=0.38, truth=0.61)
DEAD = replace(CASE, truth=0.0)


def methods(seed: int = 0) -> dict[str, drop.Method]:
    registry = drop.MethodRegistry(tuple(NAMES), frozenset())
    found = registry.methods("paper", NETWORKS, np.array([0.0, 1.0]), seed)
    return {one.name: one for one in found}


def each(names: Iterable[str]) -> pytest.MarkDecorator:
    """A test for each method; the dear ones are slow."""
    slow = {name: pytest.mark.slow if name in DEAR else () for name in names}
    return pytest.mark.parametrize("name", [pytest.param(one, marks=slow[one]) for one in slow])


@pytest.fixture(scope="module")
def problems() -> drop.DropProblems:
    return drop.DropProblems(PAPER)


Solve = Callable[..., tuple[Trace, Problem]]


@pytest.fixture(scope="module")
def solve(problems: drop.DropProblems) -> Solve:
    def run(name: str, budget: int, case: drop.DropTarget = CASE, seed: int = 0):
        method = methods(seed)[name]
        problem = problems.pose(case, free_release=method.free_release)
        return method.estimator.estimate(problem, budget), problem

    return run


def told(trace: Trace) -> list[tuple[int, list[float]]]:
    return [(step.rollouts, step.values.tolist()) for step in trace.steps]


# A target, and what may be spent on it: first guesses at a bound, and a ball that never bounces.
LAWFUL = [
    *((CASE, budget) for budget in (0, 1, 13)),
    *((replace(CASE, initial=initial), 12) for initial in (0.0, 1.0)),
    *((replace(DEAD, initial=initial), 12) for initial in (0.0, 0.5)),
]


@needs_pybullet
@each(NAMES)
def test_no_method_spends_more_than_it_has_or_leaves_the_range(solve: Solve, name: str):
    for case, budget in LAWFUL:
        trace, problem = solve(name, budget, case)
        counts = [step.rollouts for step in trace.steps]
        assert counts == sorted(counts)
        assert counts[0] == 0
        assert counts[-1] <= problem.rollouts <= budget
        low, high = np.array([one.bounds for one in problem.parameters]).T
        for step in trace.steps:
            assert step.values.shape == (len(problem.parameters),)
            assert ((low <= step.values) & (step.values <= high)).all()
        assert problem.rollouts > 0 or budget < 12 or name not in SEARCHES
        if name == "mean":
            assert trace.steps[0].values[0] == 0.5
        elif name != "direct":
            assert trace.steps[0].values[0] == case.initial


@needs_pybullet
@each(NAMES)
def test_a_target_costs_the_same_whoever_came_before(name: str):
    targets = drop.draw_targets(drop.HARD, 2, seed=4, noise_m=0.01)
    method = methods(3)[name]
    most = min(10, method.budget)
    together, first, second = (
        drop.errors_of(drop.TargetBatch(method, tuple(some), PAPER, most))
        for some in (targets, targets[:1], targets[1:])
    )
    assert together.shape == (2, 1 + most)
    assert np.array_equal(together, np.concatenate([first, second]))
    few = drop.errors_of(drop.TargetBatch(method, tuple(targets), PAPER, min(5, most)))
    assert np.array_equal(few, together[:, : few.shape[1]])


class Silent:
    """A simulator whose episodes do not say how they were made."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self.parameters = simulator.parameters
        self.engine, self.step_hz = simulator.engine, simulator.step_hz

    def rollout(self, values: Mapping[str, float]) -> Episode:
        episode = self._simulator.rollout(values)
        return replace(episode, info=replace(episode.info, truth={}))


@needs_pybullet
@each(NAMES)
def test_no_method_reads_the_truth(problems: drop.DropProblems, solve: Solve, name: str):
    method = methods()[name]
    problem = problems.pose(CASE, free_release=method.free_release)
    silent = Problem(
        problem.target,
        Silent(problem.simulator),  # pyright: ignore[reportPrivateUsage]
        problem._observe,  # pyright: ignore[reportPrivateUsage]
        problem.initial,
    )
    assert told(method.estimator.estimate(silent, 13)) == told(solve(name, 13)[0])


FOUND = {
    "brent": (30, 0.02),
    "least-squares": (100, 0.03),  # a local minimum beside the truth
    "tpe": (100, 0.02),
    "cma-es": (100, 0.03),
    "entropy-search": (60, 0.03),
}


@needs_pybullet
@each(FOUND)
def test_a_search_finds_what_is_there(solve: Solve, name: str):
    rollouts, tolerance = FOUND[name]
    for truth in (0.45, 0.61):
        trace, _ = solve(name, rollouts, replace(CASE, initial=0.5, truth=truth))
        assert trace.after(rollouts)[0] == pytest.approx(truth, abs=tolerance)


# Of the secant: targets, rollouts, and how near each answer must be. From a ball that does not
# bounce, to one, flights too short to be seen, above a step too far, and clean first flights.
SECANTS = {
    "easy": (drop.draw_targets(drop.EASY, 20, 5), 4, 3e-4),
    "from no bounce": ([drop.DropTarget(4.3, 0.0, 0.61)], 6, 3e-4),
    "to no bounce": ([drop.DropTarget(4.3, 0.6, 0.0)], 6, 0.1),
    "beside no bounce": ([drop.DropTarget(4.3, 0.02, 0.0)], 10, 0.01),
    "short flights": (
        [
            drop.DropTarget(release_m, initial, truth)
            for truth in (0.03, 0.0858, 0.1038, 0.12)
            for initial in (0.05, 0.6)
            for release_m in (4.1, 4.6, 4.9)
        ],
        10,
        3e-3,
    ),
    "low": (
        [one for one in drop.draw_targets(drop.HARD, 100, -3) if 0.1 < one.truth < 0.25],
        10,
        2e-3,
    ),
    "clean": (drop.draw_targets(drop.EASY, 20, -1), 10, 2e-9),
}


@needs_pybullet
@pytest.mark.parametrize("name", SECANTS)
def test_the_secant_is_exact_and_gets_away_from_where_nothing_is_seen(
    problems: drop.DropProblems, name: str
):
    targets, rollouts, off = SECANTS[name]
    for target in targets:
        problem = problems.pose(target)
        trace = FlightSecant().estimate(problem, rollouts)
        assert trace.estimate[0] == pytest.approx(target.truth, abs=off)
        assert problem.rollouts <= rollouts


def test_the_secant_needs_four_rollouts_on_the_calibrated_simulator():
    problems = drop.DropProblems(CALIBRATED)
    for target in drop.draw_targets(drop.EASY, 20, 5):
        trace = FlightSecant().estimate(problems.pose(target), 4)
        assert trace.estimate[0] == pytest.approx(target.truth, abs=3e-4)


@needs_pybullet
def test_the_secant_bears_a_centimetre_of_noise(problems: drop.DropProblems):
    targets = drop.draw_targets(drop.EASY, 20, 5, noise_m=0.01)
    off = [
        FlightSecant().estimate(problems.pose(one), 5).estimate[0] - one.truth for one in targets
    ]
    assert np.mean(np.abs(off)) < 0.002
