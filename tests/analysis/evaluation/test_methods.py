"""Laws of every method that competes in the second experiment, and what each of them finds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import TRAININGS, FlightSecant
from tunenet_logs.analysis.estimators.base import Problem, Trace
from tunenet_logs.analysis.evaluation.studies.baselines import Direct, EntropySearch, direct_pairs
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    EASY,
    HARD,
    Antisymmetrised,
    DifferenceNetwork,
    DropProblems,
    DropTarget,
    Method,
    MethodRegistry,
    draw_targets,
)
from tunenet_logs.analysis.tunenet.network import (
    Model,
    Network,
    PaperNetwork,
    Scaling,
    initial_weights,
    train,
)
from tunenet_logs.episode import Episode
from tunenet_logs.recorders.simulators.base import CALIBRATED, PAPER, Simulator
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)
PRESET = TRAININGS["paper-code"]
RNG = np.random.default_rng(0)
RAW = Scaling(np.zeros(1), np.ones(1), np.zeros(1), np.ones(1))
UNTRAINED = Model(PaperNetwork(), initial_weights(PaperNetwork(), 400, 1, RNG), RAW)
NETWORKS: dict[str, Model] = dict.fromkeys(("paper", "paper-code", "direct"), UNTRAINED)
SEARCHES = ["entropy-search", "cma-es", "secant", "brent", "least-squares", "tpe"]
NAMES = ["mean", "direct", "tunenet-paper", "tunenet-paper-code", *SEARCHES]

CASE = DropTarget(release_m=4.3, initial=0.38, truth=0.61)
DEAD = replace(CASE, truth=0.0)


def methods(seed: int = 0) -> dict[str, Method]:
    registry = MethodRegistry(tuple(NAMES), frozenset())
    return {
        one.name: one for one in registry.methods("paper", NETWORKS, np.array([0.0, 1.0]), seed)
    }


DEAR = ("entropy-search", "cma-es", "tpe")


def each(names: Iterable[str]) -> pytest.MarkDecorator:
    """A test for each method; those that take long, or whose libraries load for long, are slow."""
    slow = {name: pytest.mark.slow if name in DEAR else () for name in names}
    return pytest.mark.parametrize("name", [pytest.param(one, marks=slow[one]) for one in slow])


@pytest.fixture(scope="module")
def problems() -> DropProblems:
    return DropProblems(PAPER)


Solve = Callable[..., tuple[Trace, Problem]]


@pytest.fixture(scope="module")
def solve(problems: DropProblems) -> Solve:
    def run(name: str, budget: int, case: DropTarget = CASE, seed: int = 0):
        method = methods(seed)[name]
        problem = problems.pose(case, free_release=method.free_release)
        return method.estimator.estimate(problem, budget), problem

    return run


def told(trace: Trace) -> list[tuple[int, list[float]]]:
    return [(step.rollouts, step.values.tolist()) for step in trace.steps]


def check_laws(trace: Trace, problem: Problem, budget: int) -> None:
    counts = [step.rollouts for step in trace.steps]
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert counts[-1] <= problem.rollouts <= budget
    low, high = np.array([one.bounds for one in problem.parameters]).T
    for step in trace.steps:
        assert step.values.shape == (len(problem.parameters),)
        assert (low <= step.values).all()
        assert (step.values <= high).all()


@needs_pybullet
@pytest.mark.parametrize("budget", [0, 1, 13])
@each(NAMES)
def test_no_method_spends_more_than_it_has(solve: Solve, name: str, budget: int):
    trace, problem = solve(name, budget)
    check_laws(trace, problem, budget)
    first = trace.steps[0].values[0]
    if name == "mean":
        assert first == 0.5
    elif name != "direct":
        assert first == CASE.initial


@needs_pybullet
@each(SEARCHES)
@pytest.mark.parametrize("initial", [0.0, 1.0])
def test_the_first_guess_may_be_at_a_bound(solve: Solve, name: str, initial: float):
    trace, problem = solve(name, 12, replace(CASE, initial=initial))
    check_laws(trace, problem, 12)
    assert problem.rollouts > 0


@needs_pybullet
@each(SEARCHES)
def test_a_target_that_never_bounces_breaks_nothing(solve: Solve, name: str):
    for initial in (0.0, 0.5):
        trace, problem = solve(name, 12, replace(DEAD, initial=initial))
        check_laws(trace, problem, 12)


@needs_pybullet
@each(NAMES)
def test_the_same_seed_says_the_same(solve: Solve, name: str):
    assert told(solve(name, 13)[0]) == told(solve(name, 13)[0])


@needs_pybullet
@each(["entropy-search", "cma-es", "tpe"])
def test_another_seed_says_something_else(solve: Solve, name: str):
    assert told(solve(name, 20)[0]) != told(solve(name, 20, seed=1)[0])


class Silent:
    """A simulator whose episodes do not say how they were made."""

    engine = "none"
    step_hz = 1.0

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self.parameters = simulator.parameters
        self.engine, self.step_hz = simulator.engine, simulator.step_hz

    def rollout(self, values: Mapping[str, float]) -> Episode:
        episode = self._simulator.rollout(values)
        return replace(episode, info=replace(episode.info, truth={}))


@needs_pybullet
@each(NAMES)
def test_no_method_reads_the_truth(problems: DropProblems, solve: Solve, name: str):
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
    "secant": (4, 3e-4),
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


@pytest.mark.parametrize(
    "contact", [pytest.param(PAPER, marks=needs_pybullet), CALIBRATED], ids=["paper", "calibrated"]
)
def test_the_secant_needs_four_rollouts(contact):
    problems = DropProblems(contact)
    for target in draw_targets(EASY, 20, 5):
        trace = FlightSecant().estimate(problems.pose(target), 4)
        assert trace.after(4)[0] == pytest.approx(target.truth, abs=3e-4)


@needs_pybullet
def test_the_secant_bears_a_centimetre_of_noise(problems: DropProblems):
    targets = draw_targets(EASY, 20, 5, noise_m=0.01)
    off = [
        FlightSecant().estimate(problems.pose(one), 5).estimate[0] - one.truth for one in targets
    ]
    assert np.mean(np.abs(off)) < 0.002


@needs_pybullet
@pytest.mark.slow
def test_noise_about_a_ball_at_rest_is_no_flight(problems: DropProblems):
    for truth in (0.0, 0.02, 0.04):
        for seed in range(10):
            problem = problems.pose(DropTarget(4.6, 0.4, truth, 0.01, seed))
            assert FlightSecant().estimate(problem, 4).estimate[0] < 0.1


# Truth, first guess, rollouts, how near the answer must be, and heights of release: from a ball
# that does not bounce, to one, and flights too short to be seen.
HARD_FOR_THE_SECANT = [
    (0.61, 0.0, 6, 3e-4, (4.3,)),
    (0.0, 0.6, 6, 0.1, (4.3,)),
    (0.0, 0.02, 10, 0.01, (4.3,)),
    *(
        (truth, initial, 10, 3e-3, (4.1, 4.6, 4.9))
        for truth in (0.03, 0.0858, 0.1038, 0.12)
        for initial in (0.05, 0.6)
    ),
]


@needs_pybullet
@pytest.mark.parametrize(("truth", "initial", "rollouts", "off", "releases_m"), HARD_FOR_THE_SECANT)
def test_the_secant_gets_away_from_where_nothing_is_seen(
    problems: DropProblems,
    truth: float,
    initial: float,
    rollouts: int,
    off: float,
    releases_m: tuple[float, ...],
):
    for release_m in releases_m:
        problem = problems.pose(DropTarget(release_m, initial, truth))
        trace = FlightSecant().estimate(problem, rollouts)
        assert trace.estimate[0] == pytest.approx(truth, abs=off)
        assert problem.rollouts <= rollouts


# Targets, and how near the answers must be: above a step too far, and clean first flights.
SECANT_SETS = [
    ([one for one in draw_targets(HARD, 100, -3) if 0.1 < one.truth < 0.25], 2e-3),
    (draw_targets(EASY, 20, -1), 2e-9),
]


@needs_pybullet
@pytest.mark.parametrize(("targets", "off"), SECANT_SETS, ids=["low", "clean"])
def test_the_secant_is_exact(problems: DropProblems, targets: list[DropTarget], off: float):
    assert len(targets) > 5
    for target in targets:
        trace = FlightSecant().estimate(problems.pose(target), 10)
        assert trace.estimate[0] == pytest.approx(target.truth, abs=off)


@needs_pybullet
@pytest.mark.slow
def test_cma_es_answers_with_its_mean_after_whole_generations(solve: Solve):
    trace, problem = solve("cma-es", 25)
    assert [step.rollouts for step in trace.steps] == [0, 10, 20]
    assert problem.rollouts == 20
    assert trace.after(9)[0] == CASE.initial
    assert not list(Path().glob("outcmaes*"))


@needs_pybullet
@pytest.mark.slow
def test_entropy_search_stops_when_its_estimate_stays(problems: DropProblems):
    spent = {}
    for patience in (1, 2, None):
        problem = problems.pose(CASE)
        EntropySearch((0.0, 1.0), 0, patience).estimate(problem, 30)
        spent[patience] = problem.rollouts
    assert spent[1] < 30
    assert spent[1] <= spent[2] <= spent[None] == 30


@needs_pybullet
@pytest.mark.slow
def test_entropy_search_answers_with_bins_of_its_range(problems: DropProblems):
    trace = EntropySearch((0.3, 0.7), 0).estimate(problems.pose(CASE), 10)
    bins = np.linspace(0.3, 0.7, 50)
    assert len(trace.steps) > 1
    assert all(np.isclose(bins, step.values[0]).any() for step in trace.steps[1:])


@needs_pybullet
@each(["brent", "least-squares", "tpe"])
def test_what_keeps_the_best_never_gets_worse(solve: Solve, name: str):
    trace, problem = solve(name, 25)
    looks = [step.evaluation for step in trace.steps if step.evaluation is not None]
    costs = [float(np.linalg.norm(problem.misfit(look))) for look in looks]
    assert len(costs) > 1
    assert costs == sorted(costs, reverse=True)


@needs_pybullet
@pytest.mark.slow
def test_direct_prediction_learns_the_value_itself(problems: DropProblems):
    pairs = PRESET.make_pairs(200, 0, 1, QUIET)
    direct = direct_pairs(pairs)
    assert np.array_equal(direct.residuals, pairs.values[pairs.target])
    assert not direct.observations[direct.proposed].any()
    model = train(PRESET.network, direct, replace(PRESET.recipe, epochs=60), 0, QUIET)
    zeros, _ = model.scaling.inputs(np.zeros((1, 400, 1)), pairs.observations[:1])
    assert not zeros.any()
    off = []
    for target in draw_targets(EASY, 30, 5):
        problem = problems.pose(target)
        trace = Direct(model).estimate(problem, 100)
        assert problem.rollouts == 0
        off.append(abs(trace.estimate[0] - target.truth))
    assert np.mean(off) < 0.03  # the mean of the targets is off by 0.1


@needs_pybullet
@pytest.mark.slow
def test_no_search_is_lost_where_the_first_guess_is_far(problems: DropProblems):
    targets = draw_targets(HARD, 10, 5)
    bounds = {"secant": (6, 0.002), "brent": (30, 0.05), "least-squares": (60, 0.03)}
    for name, (rollouts, most) in bounds.items():
        estimator = methods()[name].estimator
        traces = [estimator.estimate(problems.pose(one), rollouts) for one in targets]
        off = [trace.estimate[0] - one.truth for trace, one in zip(traces, targets, strict=True)]
        assert np.mean(np.abs(off)) < most, name


# ---- Networks of the ablation: one forward pass for both libraries, and what each is for.

COMPARED = [DifferenceNetwork(), Antisymmetrised(PaperNetwork())]
INPUTS = 7


def drawn(network: Network, seed: int = 0):
    rng = np.random.default_rng(seed)
    weights = initial_weights(network, INPUTS, 2, rng)
    return weights, rng.normal(size=(5, INPUTS)), rng.normal(size=(5, INPUTS))


@pytest.mark.slow
@pytest.mark.parametrize("network", COMPARED, ids=lambda one: one.kind)
def test_numpy_and_torch_agree(network: Network):
    import torch

    weights, proposed, target = drawn(network)
    tensors = {name: torch.from_numpy(value) for name, value in weights.items()}
    found = network.residual(tensors, torch.from_numpy(proposed), torch.from_numpy(target))
    expected = network.residual(weights, proposed, target)
    assert expected.shape == (5, 2)
    assert found.numpy() == pytest.approx(expected, abs=1e-12)


def test_the_antisymmetric_form_is_zero_for_equal_observations_and_turns_its_sign():
    network = Antisymmetrised(PaperNetwork())
    weights, proposed, target = drawn(network)
    assert not network.residual(weights, target, target).any()
    assert PaperNetwork().residual(weights, target, target).any()
    forth = network.residual(weights, proposed, target)
    assert network.residual(weights, target, proposed) == pytest.approx(-forth)
    assert forth.any()


def test_the_difference_sees_nothing_but_the_difference_of_both_outputs():
    network = DifferenceNetwork()
    weights, proposed, target = drawn(network)
    same = {**weights}
    for part in ("weight", "bias"):
        same[f"target.{part}"] = weights[f"proposed.{part}"]
    nothing = np.zeros_like(proposed)
    at_rest = network.residual(same, nothing, nothing)
    assert network.residual(same, target, target) == pytest.approx(at_rest)
    assert network.residual(same, proposed, target) != pytest.approx(at_rest)
