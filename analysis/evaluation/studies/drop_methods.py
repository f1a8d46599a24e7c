"""Methods of the second experiment, their test cases, and their errors beside the paper's table 2.

The paper's methods, what a user would pick, and ours stand in a registry, each by name and with
what it needs: networks that are trained here from a seed, optional libraries. `drop` runs them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop.presets import (
    OUR_TRAINING,
    PAPER_HEIGHT_M,
    PAPER_RADIUS_M,
    PAPER_RATE_HZ,
    PAPER_RESTITUTION,
    PAPER_SAMPLES,
    TRAININGS,
    FlightSecant,
    canonical,
    observe_paper_drops,
    paper_rollout,
    rollout_drop,
)
from tunenet_logs.analysis.estimators.base import Estimator, Observation, Problem, Trace
from tunenet_logs.analysis.estimators.methods import (
    Brent,
    LeastSquares,
    Tpe,
    TuneNet,
    TuneNetThenLine,
)
from tunenet_logs.analysis.evaluation.studies.baselines import (
    CmaEs,
    Constant,
    Direct,
    EntropySearch,
    NeuralPosterior,
    Posterior,
    SbiPosterior,
    direct_pairs,
    train_posterior,
)
from tunenet_logs.analysis.evaluation.worlds.ball import TEST_SEEDS
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece, parallel_map
from tunenet_logs.analysis.registry import needed
from tunenet_logs.analysis.tunenet.network import (
    AntisymmetricNetwork,
    Model,
    Network,
    PairSet,
    PaperNetwork,
    Weights,
    layer,
    linear,
    observe_all,
    relu,
    tanh,
    train,
)
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.recorders.simulators.ball import RESTITUTION, TOPIC, DropRig, DropSimulator
from tunenet_logs.recorders.simulators.base import CALIBRATED, PAPER, ContactSettings, Parameter
from tunenet_logs.terminal import Progress

# ---- Ablation: two other ways to combine a network's two observations than the paper's.


class DifferenceNetwork:
    """Paper's network with the difference of its two intermediate outputs, not both.

    The paper found the concatenation better (its section on the network).
    """

    kind = "difference"
    width = 32

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """See `Network.shapes`."""
        return {
            **layer("proposed", inputs, self.width),
            **layer("target", inputs, self.width),
            **layer("joint", self.width, self.width),
            **layer("out", self.width, outputs),
        }

    def residual(self, weights: Weights, proposed: Any, target: Any) -> Any:
        """See `Network.residual`."""
        of_proposed = relu(linear(weights, "proposed", proposed))
        of_target = relu(linear(weights, "target", target))
        joint = relu(linear(weights, "joint", of_target - of_proposed))
        return tanh(linear(weights, "out", joint))


class Antisymmetrised:
    """h(o_P, o_T) = (g(o_P, o_T) - g(o_T, o_P)) / 2 of another network g, with g's weights.

    It is exactly 0 where both observations are equal, for any weights.
    """

    def __init__(self, network: Network) -> None:
        self._network = network

    @property
    def kind(self) -> str:
        """See `Network.kind`."""
        return f"antisymmetric {self._network.kind}"

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """See `Network.shapes`."""
        return self._network.shapes(inputs, outputs)

    def residual(self, weights: Weights, proposed: Any, target: Any) -> Any:
        """See `Network.residual`."""
        forth = self._network.residual(weights, proposed, target)
        return (forth - self._network.residual(weights, target, proposed)) / 2


# ---- Our networks, trained on the paper's budget, and for the calibrated simulator.
# Each height of release hits the plane at another phase of the engine's steps, which moves the
# rebound by more than a network may err (docs/physics.md): both sides of a pair have one height.


HEIGHTS = 160
RESTITUTIONS = 10  # 1600 rollouts, as many as the paper's 800 pairs take
_PAIRS = 51_200  # drawn from those rollouts: each is in many
# Fraction of the pairs that are neighbours in restitution: fine corrections are learnt too.
_NEAR_SHARE = 0.3

_NOISE_M = 0.02  # of training: twice that of the noisy cells
_TRAINING = replace(OUR_TRAINING, noise=_NOISE_M, cut_share=0.0)


def train_on_papers(
    seed: int, jobs: int | None, progress: Progress, epochs: int | None = None
) -> Model:
    """Train our network on the paper's simulator; `epochs` in place of the recipe's."""
    pairs = grouped_pairs(seed, jobs, progress)
    recipe = replace(_TRAINING, epochs=epochs or _TRAINING.epochs)
    return train(AntisymmetricNetwork(), pairs, recipe, seed, progress)


def train_on_calibrated(
    seed: int, jobs: int | None, progress: Progress, epochs: int | None = None
) -> Model:
    """Train what the package ships (preset `default`), with another seed."""
    ours = TRAININGS["default"]
    recipe = replace(ours.recipe, epochs=epochs or ours.recipe.epochs)
    return train(ours.network, ours.make_pairs(None, seed, jobs, progress), recipe, seed, progress)


def grouped_pairs(seed: int, jobs: int | None, progress: Progress) -> PairSet:
    """Simulate pairs within groups of one height; restitutions uniform over [0, 1] in each."""
    rng = np.random.default_rng(seed)
    low, high = RESTITUTION.training_range
    heights = np.repeat(rng.uniform(*PAPER_HEIGHT_M, HEIGHTS), RESTITUTIONS)
    ranks = np.tile(np.arange(RESTITUTIONS), HEIGHTS)
    values = low + (high - low) * (ranks + rng.random(len(ranks))) / RESTITUTIONS
    observations = observe_paper_drops(heights, values, jobs, progress)
    return PairSet(observations, values[:, None], *_pairs_within_groups(rng))


def _pairs_within_groups(
    rng: np.random.Generator,
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Draw any two of a group, and some that are neighbours in restitution."""
    first_of_group = RESTITUTIONS * rng.integers(HEIGHTS, size=_PAIRS)
    proposed, anywhere = rng.integers(RESTITUTIONS, size=(2, _PAIRS))
    beside = np.clip(proposed + rng.choice([-1, 1], _PAIRS), 0, RESTITUTIONS - 1)
    target = np.where(rng.random(_PAIRS) < _NEAR_SHARE, beside, anywhere)
    return first_of_group + proposed, first_of_group + target


# ---- All networks of one seed, by name.


Networks = Mapping[str, Model]  # by the names in `NETWORKS`
PAPER_NETWORK = "paper"
PAPER_CODE = "paper-code"
DIRECT = "direct"
DIFFERENCE = "difference"
ANTISYMMETRIC = "antisymmetric"
OURS = "ours"
OURS_CALIBRATED = "ours-calibrated"


@dataclass(frozen=True)
class _NetworkPlan:
    """Architecture, and the preset whose recipe trains it."""

    network: Network
    preset: str


_PLANS: Mapping[str, _NetworkPlan] = {
    PAPER_NETWORK: _NetworkPlan(PaperNetwork(), "paper"),
    PAPER_CODE: _NetworkPlan(PaperNetwork(), "paper-code"),
    DIRECT: _NetworkPlan(PaperNetwork(), "paper-code"),
    DIFFERENCE: _NetworkPlan(DifferenceNetwork(), "paper-code"),
    ANTISYMMETRIC: _NetworkPlan(Antisymmetrised(PaperNetwork()), "paper-code"),
}

_OURS = {OURS: train_on_papers, OURS_CALIBRATED: train_on_calibrated}

NETWORKS = (*_PLANS, *_OURS)


@dataclass(frozen=True)
class Effort:
    """Amount of training in place of the presets', to try things out."""

    pairs: int | None = None  # training pairs
    epochs: int | None = None  # passes over them


def train_networks(
    wanted: Collection[str],
    seed: int,
    jobs: int | None,
    progress: Progress,
    effort: Effort | None = None,
) -> Networks:
    """Train the wanted networks; the paper's all on the same 800 pairs, ours on their own."""
    effort = effort or Effort()
    trained = {
        name: training(seed, jobs, progress, effort.epochs)
        for name, training in _OURS.items()
        if name in wanted
    }
    plans = {name: plan for name, plan in _PLANS.items() if name in wanted}
    if not plans:
        return trained
    pairs = TRAININGS["paper-code"].make_pairs(effort.pairs, seed, jobs, progress)
    for name, plan in plans.items():
        recipe = TRAININGS[plan.preset].recipe
        if effort.epochs is not None:
            recipe = replace(recipe, epochs=effort.epochs)
        trained[name] = train(plan.network, _seen(name, pairs), recipe, seed, progress)
    return trained


def _seen(name: str, pairs: PairSet) -> PairSet:
    """Return the pairs a network learns from."""
    if name != DIRECT:
        return pairs
    return direct_pairs(pairs)


# ---- Registry: methods by name, and what each needs.


# On the paper's simulator; on the calibrated one; the parts of the network compared.
Table = Literal["paper", "calibrated", "ablation"]

Group = Literal["paper", "user", "ours"]  # whose a method is
# The method that has a posterior, see `train_posteriors`; only on the paper's simulator.
NPE = "npe"

MAX_ROLLOUTS = 100  # rollouts a target: the last column of the paper's table 2
# Rollouts after which the secant and our fits have converged, and give nothing new.
_SECANT_ROLLOUTS, _OUR_ROLLOUTS = 10, 40


@dataclass(frozen=True)
class Method:
    """Method to compare, a row of the table."""

    name: str  # as JSON, CSV and `--methods` have it
    label: str  # as the table has it
    group: Group  # whose it is
    estimator: Estimator  # the method, ready to estimate
    budget: int  # rollouts after which it gives nothing new, or the most of the experiment
    free_release: bool = False  # it is given the height of release as a second parameter to find


@dataclass(frozen=True)
class _Needs:
    """Requirements of a method: networks of `NETWORKS`, and optional libraries."""

    networks: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()


_ABLATION = {
    "concatenation": _Needs((PAPER_CODE,)),
    "difference": _Needs((DIFFERENCE,)),
    "antisymmetric": _Needs((ANTISYMMETRIC,)),
}
_ABLATION_LABELS = {
    "concatenation": "Side by side (the paper's)",
    "difference": "Difference",
    "antisymmetric": "Side by side, antisymmetric",
}
_ALL: Mapping[str, _Needs] = {
    "mean": _Needs(),
    "entropy-search": _Needs(libraries=("sklearn",)),
    "cma-es": _Needs(libraries=("cma",)),
    "direct": _Needs((DIRECT,)),
    "tunenet-paper": _Needs((PAPER_NETWORK,)),
    "tunenet-paper-code": _Needs((PAPER_CODE,)),
    "secant": _Needs(),
    "brent": _Needs(),
    "least-squares": _Needs(),
    "tpe": _Needs(libraries=("optuna",)),
    NPE: _Needs(libraries=("sbi",)),
    "network": _Needs((OURS, OURS_CALIBRATED)),
    "ours": _Needs((OURS, OURS_CALIBRATED)),
    **_ABLATION,
}

NAMES = tuple(_ALL)  # what `--methods` takes, in the order of the tables


@dataclass(frozen=True)
class MethodRegistry:
    """Chosen methods and their requirements."""

    names: tuple[str, ...]  # of those chosen
    networks: frozenset[str]  # to be trained for them, see `train_networks`

    @property
    def has_curves(self) -> bool:
        """Whether the figure has anything to show: the ablation is a table only."""
        return not _ABLATION.keys() >= set(self.names)

    @property
    def has_posteriors(self) -> bool:
        """Whether neural posteriors are to be trained for them."""
        return NPE in self.names

    def methods(
        self,
        table: Table,
        networks: Networks,
        truths: Array,
        seed: int,
        posterior: Posterior | None = None,
    ) -> list[Method]:
        """Return the chosen methods of one table, ready to estimate.

        Args:
            table: which one.
            networks: by name, trained.
            truths: true restitutions of the cell's targets, shape (N,). Only two of the paper's
                baselines look at them, as its authors' do: the mean, and the range that entropy
                search covers.
            seed: of the methods that draw.
            posterior: for the noise of the cell's targets, trained; None where it is not wanted.
        """
        if table == "ablation":
            compared = _ablation_methods(networks)
        elif table == "calibrated":
            compared = [*user_methods(seed), *_our_methods(networks.get(OURS_CALIBRATED))]
        else:
            trained: dict[str, Any] = {name: networks.get(name) for name in NETWORKS}
            bins = (float(truths.min()), float(truths.max()))
            compared = [
                *paper_methods(trained, float(truths.mean()), bins, seed),
                *user_methods(seed),
            ]
            if posterior is not None:
                estimator = NeuralPosterior(posterior)
                compared.append(Method(NPE, "Neural posterior (sbi)", "user", estimator, 0))
            compared += _our_methods(networks.get(OURS))
        return [method for method in compared if method.name in self.names]


def choose_methods(names: Iterable[str] | None) -> MethodRegistry:
    """Select methods by name; all for None.

    Raises:
        UsageError: a name is unknown, or a library is not installed.
    """
    wanted = set(NAMES if names is None else names)
    for name in sorted(wanted.difference(NAMES)):
        raise UsageError(f"there is no method {name!r}; there is: {', '.join(NAMES)}")
    chosen = {name: needs for name, needs in _ALL.items() if name in wanted}
    networks = frozenset(network for needs in chosen.values() for network in needs.networks)
    libraries = {library for needs in chosen.values() for library in needs.libraries}
    for library in sorted(libraries | {"torch"} if networks else libraries):
        needed(library)
    return MethodRegistry(tuple(chosen), networks)


def paper_methods(
    networks: Mapping[str, Model], mean: float, bins: tuple[float, float], seed: int
) -> tuple[Method, ...]:
    """Return the methods of the paper's table 2.

    Args:
        networks: "paper" and "paper-code", trained by those presets, and "direct", trained on
            `direct_pairs`.
        mean: of the test set's targets.
        bins: smallest and largest value that entropy search looks at.
        seed: of the methods that draw.
    """
    most = MAX_ROLLOUTS
    text, code = TuneNet(networks["paper"]), TuneNet(networks["paper-code"])
    cma = CmaEs(seed)
    entropy = EntropySearch(bins, seed)
    return (
        Method("mean", "Mean", "paper", Constant(mean), 0),
        Method("entropy-search", "Entropy search", "paper", entropy, most),
        Method("cma-es", "CMA-ES", "paper", cma, most, free_release=True),
        Method("direct", "Direct prediction", "paper", Direct(networks["direct"]), 0),
        Method("tunenet-paper", "TuneNet, the paper's text", "paper", text, most),
        Method("tunenet-paper-code", "TuneNet, its authors' code", "paper", code, most),
    )


def user_methods(seed: int) -> tuple[Method, ...]:
    """Return what a user without a network would pick; `seed` is of the methods that draw."""
    most = MAX_ROLLOUTS
    return (
        Method("secant", "Secant on the first flight", "user", FlightSecant(), _SECANT_ROLLOUTS),
        Method("brent", "Brent", "user", Brent(), most),
        Method("least-squares", "Least squares, many starts", "user", LeastSquares(), most),
        Method("tpe", "TPE", "user", Tpe(seed), most),
    )


def _our_methods(network: Model | None) -> list[Method]:
    """Return our methods, by the network for the cell's simulator; none without one."""
    if network is None:
        return []
    return [
        Method("network", "Our network alone", "ours", TuneNet(network), MAX_ROLLOUTS),
        Method("ours", "Our network, then fits", "ours", TuneNetThenLine(network), _OUR_ROLLOUTS),
    ]


def _ablation_methods(networks: Networks) -> list[Method]:
    return [
        Method(name, _ABLATION_LABELS[name], "paper", TuneNet(networks[network]), MAX_ROLLOUTS)
        for name, needs in _ABLATION.items()
        for network in needs.networks
        if network in networks
    ]


# ---- Test cases: balls, heights and observation.


# Height of the ball's centre, where a method has to find it too; 4.5 m is the paper's middle.
RELEASE = Parameter("release_m", "m", (0.6, 10.0), PAPER_HEIGHT_M, 4.5)


@dataclass(frozen=True)
class TargetSet:
    """Test set: ranges from which its restitutions are drawn."""

    name: str  # as `tunenet-eval` prints it
    initial: tuple[float, float]  # range of the first guess
    target: tuple[float, float]  # range of what is to be found


EASY = TargetSet("Easy", PAPER_RESTITUTION, PAPER_RESTITUTION)
HARD = TargetSet("Hard", (0.0, 1.0), (0.0, 1.0))
# As the paper's text has it; what its authors' code draws is `HARD`.
HARD_TARGET = TargetSet("Hard (target only)", PAPER_RESTITUTION, (0.0, 1.0))

TARGET_SETS = (EASY, HARD, HARD_TARGET)


@dataclass(frozen=True)
class DropTarget:
    """Test case."""

    release_m: float  # height of the ball's centre when it is let go
    initial: float  # the first guess of the restitution, alike for every method
    truth: float  # the restitution of the target; no method sees it
    noise_m: float = 0.0  # standard deviation of what is added to each height of the target
    seed: int = 0  # of that noise


def draw_targets(which: TargetSet, count: int, seed: int, noise_m: float = 0.0) -> list[DropTarget]:
    """Draw `count` test cases; the same seed gives the same ones, for any noise."""
    rng = np.random.default_rng([TEST_SEEDS + seed, *which.name.encode()])
    heights = rng.uniform(*PAPER_HEIGHT_M, count)
    initial = rng.uniform(*which.initial, count)
    truth = rng.uniform(*which.target, count)
    seeds = rng.integers(2**31, size=count)
    rows = zip(heights, initial, truth, seeds, strict=True)
    return [
        DropTarget(float(height), float(first), float(last), noise_m, int(noise_seed))
        for height, first, last, noise_seed in rows
    ]


class _AnyRelease:
    """Drop simulator with the height of release as a second parameter."""

    parameters = (RESTITUTION, RELEASE)

    def __init__(self, simulator: DropSimulator) -> None:
        self._simulator = simulator
        self.engine, self.step_hz = simulator.engine, simulator.step_hz

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """See `Simulator.rollout`."""
        rig = self._simulator.rig
        drop_height_m = RELEASE.checked(values[RELEASE.name]) - rig.radius_m
        moved = DropRig(drop_height_m, rig.radius_m, rig.rate_hz, rig.samples)
        rest = {RESTITUTION.name: values[RESTITUTION.name]}
        return self._simulator.with_rig(moved).rollout(rest)


class DropProblems:
    """Problems of the test cases, all in one world of the engine.

    Args:
        contact: the paper's simulator (400 samples of z at 60 Hz), or the calibrated one (the
            canonical observation of the same drop).
    """

    def __init__(self, contact: ContactSettings = PAPER) -> None:
        self._contact = contact
        self._world = DropSimulator(_rig(PAPER_HEIGHT_M[0]), contact)

    def pose(self, target: DropTarget, *, free_release: bool = False) -> Problem:
        """Pose one test case; `free_release` makes the height of release a second parameter."""
        rig = _rig(target.release_m)
        simulator = self._world.with_rig(rig)
        episode = simulator.rollout({RESTITUTION.name: target.truth})
        observe = paper_rollout
        if self._contact == CALIBRATED:
            observe = partial(_canonical, rig=rig)
        seen = _with_noise(episode, target)
        if free_release:
            guess = np.array([target.initial, target.release_m])
            return Problem(observe(seen), _AnyRelease(simulator), observe, guess)
        return Problem(observe(seen), simulator, observe, np.array([target.initial]))


def _rig(release_m: float) -> DropRig:
    return DropRig(release_m - PAPER_RADIUS_M, PAPER_RADIUS_M, PAPER_RATE_HZ, PAPER_SAMPLES)


def _canonical(episode: Episode, rig: DropRig) -> Observation:
    return canonical(rollout_drop(episode, rig, CALIBRATED))


def _with_noise(episode: Episode, target: DropTarget) -> Episode:
    if not target.noise_m:
        return episode
    signal = episode.signals[TOPIC]
    rng = np.random.default_rng(target.seed)
    noise_m = rng.normal(0.0, target.noise_m, len(signal.values))
    noisy = replace(signal, values=signal.values + np.array([0.0, 0.0, 1.0]) * noise_m[:, None])
    return replace(episode, signals={**episode.signals, TOPIC: noisy})


# ---- Run methods on test cases, spread over processes, with the same figures for any number.


class OverspentError(Exception):
    """Method that took more rollouts than it was allowed, or miscounts them: a defect."""


@dataclass(frozen=True)
class TargetBatch:
    """Method and some of the targets of a cell: what one process does in one go."""

    method: Method  # the method, ready to estimate
    targets: tuple[DropTarget, ...]  # the test cases
    contact: ContactSettings  # of the simulator that it may roll out
    rollouts: int  # most that it may spend on a target


def errors_of(batch: TargetBatch) -> Array:
    """Return the absolute errors after 0, 1, ... rollouts, shape (targets, 1 + rollouts).

    Raises:
        OverspentError: the method miscounts its rollouts.
    """
    problems = problems_in(batch.contact)
    method = batch.method
    errors = np.empty((len(batch.targets), batch.rollouts + 1))
    for row, target in zip(errors, batch.targets, strict=True):
        problem = problems.pose(target, free_release=method.free_release)
        trace = method.estimator.estimate(problem, batch.rollouts)
        _check_spending(method, problem, trace, batch.rollouts)
        row[:] = [abs(trace.after(n)[0] - target.truth) for n in range(batch.rollouts + 1)]
    return errors


@cache
def problems_in(contact: ContactSettings) -> DropProblems:
    """Return the test cases' problems in a simulator; one world a process."""
    return DropProblems(contact)


def _check_spending(method: Method, problem: Problem, trace: Trace, allowed: int) -> None:
    spent = [step.rollouts for step in trace.steps]
    if problem.rollouts > allowed:
        raise OverspentError(f"{method.name} spent {problem.rollouts} rollouts of {allowed}")
    if spent[0] != 0 or spent != sorted(spent) or spent[-1] > problem.rollouts:
        raise OverspentError(f"{method.name} says {spent} of {problem.rollouts} rollouts")


def estimate_batches(
    batches: Sequence[TargetBatch], jobs: int | None, progress: Progress
) -> list[Array]:
    """Run `errors_of` on every batch, in order, in `jobs` processes (default: all cores)."""
    pieces = [Piece(batch, len(batch.targets), batch.method.name) for batch in batches]
    return parallel_map(errors_of, pieces, jobs, progress, ("estimating", "target"))


# ---- Coverage of the 95 % interval of recorded drops, through the whole of `tunenet-tune`.
# The engine simulates them, and noise is added; nothing of the rig is given.


DRAWN_RESTITUTION = (0.1, 0.95)  # drawn evenly: nearly all balls
# Standard deviation of a height, drawn evenly: up to twice that of the noisy cells.
DRAWN_NOISE_M = (0.0, 0.02)

PER_TARGET = 2  # recordings of each kind for each target of the experiment


@dataclass(frozen=True)
class Recording:
    """Kind of recording."""

    label: str  # of its row; its recordings are drawn from it
    drop_heights_m: tuple[float, float]  # range of the fall
    rates_hz: tuple[float, ...]  # sampling rates, one of which is drawn
    hold_s: float  # how long the ball is held before it is let go


RECORDINGS = (
    Recording("falls of 3.5 to 4.5 m, 60 Hz", (3.5, 4.5), (60.0,), 0.0),
    Recording("falls of 0.3 to 5 m, 60 to 240 Hz", (0.3, 5.0), (60.0, 120.0, 240.0), 0.5),
)


@dataclass(frozen=True)
class Coverage:
    """Interval coverage for one kind of recording.

    A figure over no recordings is None.
    """

    label: str
    targets: int  # how many were recorded
    fitted: int  # how many of them were not rejected
    # fraction of the fitted whose interval contains the truth, for any verdict
    covered: float | None
    covered_se: float | None  # its standard error
    ok: float  # fraction of all with the verdict "ok", which show their interval
    ok_covered: float | None  # fraction of those whose interval contains the truth
    ok_covered_se: float | None  # its standard error
    width: float | None  # median of the intervals' widths
    mae: float | None  # mean absolute error of the fitted
    network_mae: float | None  # that of the network's steps alone


def interval_coverages(
    seeds: tuple[int, ...], targets: int, jobs: int | None, progress: Progress
) -> tuple[Coverage, ...]:
    """Measure every kind of recording, `PER_TARGET * targets` for each seed."""
    count = PER_TARGET * targets
    return tuple(interval_coverage(one, seeds, count, jobs, progress) for one in RECORDINGS)


def interval_coverage(
    recording: Recording,
    seeds: tuple[int, ...],
    count: int,
    jobs: int | None,
    progress: Progress,
) -> Coverage:
    """Measure `count` recordings for each seed, of uniform noise and restitution."""
    orders = [order for seed in seeds for order in _orders(recording, count, seed)]
    return coverage_of(recording.label, observe_all(_tuned, orders, jobs, progress))


def coverage_of(label: str, rows: Array) -> Coverage:
    """Compute figures of rows (truth, value, interval, network's value, is ok), shape (N, 6)."""
    fitted = rows[np.isfinite(rows[:, 0])]
    truth, value, low, high, network, ok = fitted.T
    covered, is_ok = (low <= truth) & (truth <= high), ok > 0
    return Coverage(
        label=label,
        targets=len(rows),
        fitted=len(fitted),
        covered=_mean(covered),
        covered_se=fraction_error(covered),
        ok=float(is_ok.sum() / len(rows)),
        ok_covered=_mean(covered[is_ok]),
        ok_covered_se=fraction_error(covered[is_ok]),
        width=float(np.median(high - low)) if len(fitted) else None,
        mae=_mean(np.abs(value - truth)),
        network_mae=_mean(np.abs(network - truth)),
    )


def _mean(values: NDArray[Any]) -> float | None:
    return float(values.mean()) if len(values) else None


def fraction_error(hits: NDArray[np.bool_]) -> float | None:
    """Return the standard error of a fraction by Agresti and Coull (1998): never 0.

    Two hits and two misses are added, so that it is defined for any; `hits` has shape (N,).
    """
    if not len(hits):
        return None
    fraction = (hits.sum() + 2) / (len(hits) + 4)
    return float(np.sqrt(fraction * (1 - fraction) / (len(hits) + 4)))


def _orders(recording: Recording, count: int, seed: int) -> list[DropOrder]:
    rng = np.random.default_rng([TEST_SEEDS + seed, *recording.label.encode()])
    return [
        DropOrder(
            restitution=float(rng.uniform(*DRAWN_RESTITUTION)),
            height_m=float(rng.uniform(*recording.drop_heights_m)),
            rate_hz=float(rng.choice(recording.rates_hz)),
            hold_s=recording.hold_s,
            noise_m=float(rng.uniform(*DRAWN_NOISE_M)),
            seed=int(rng.integers(2**31)),
        )
        for _ in range(count)
    ]


def _tuned(orders: Sequence[DropOrder]) -> Array:
    """Return the rows of `coverage_of`, shape (N, 6)."""
    rows = np.full((len(orders), 6), np.nan)
    for row, order in zip(rows, orders, strict=True):
        tuning = tune_episode(simulate_drop(order), TuneOptions())
        if tuning.estimate is None or tuning.trace is None or tuning.trace.fit is None:
            continue
        ends = tuning.trace.fit.interval95[0]
        network = tuning.trace.steps[-2].values[0]
        row[:] = [order.restitution, tuning.estimate[0], *ends, network, tuning.verdict == "ok"]
    return rows


# ---- Published figures: table 2 of Allevato et al. 2019 (table 3 stands in `motion.ROWS`).


PUBLISHED_ROLLOUTS = (1, 5, 10, 100)  # the columns of table 2, K
_TABLE_2: Mapping[str, Mapping[str, tuple[float, float, float, float]]] = {
    "Easy": {
        "mean": (0.0968, 0.0968, 0.0968, 0.0968),
        "entropy-search": (0.1433, 0.0622, 0.0553, 0.0533),
        "cma-es": (0.0540, 0.0540, 0.0540, 0.0097),
        "direct": (0.0120, 0.0120, 0.0120, 0.0120),
        "tunenet": (0.0145, 0.0050, 0.0053, 0.0053),
    },
    "Hard": {
        "mean": (0.2353, 0.2353, 0.2353, 0.2353),
        "entropy-search": (0.2876, 0.1021, 0.1153, 0.0939),
        "cma-es": (0.2766, 0.2766, 0.2766, 0.0605),
        "direct": (0.0493, 0.0493, 0.0493, 0.0493),
        "tunenet": (0.1103, 0.0212, 0.0145, 0.0175),
    },
}

# Our names of its methods; its text and its authors' code are two of ours.
_OURS_OF = {
    "mean": "mean",
    "entropy-search": "entropy-search",
    "cma-es": "cma-es",
    "direct": "direct",
    "tunenet-paper": "tunenet",
    "tunenet-paper-code": "tunenet",
}

# Its text describes one Hard and its code draws another; its figures stand beside both.
_SETS = {"Easy": "Easy", "Hard": "Hard", "Hard (target only)": "Hard"}


def published_error(which: str, method: str, rollouts: int) -> float | None:
    """Return the mean absolute error of restitution in table 2; None where there is none."""
    row = _TABLE_2.get(_SETS.get(which, ""), {}).get(_OURS_OF.get(method, ""))
    if row is None or rollouts not in PUBLISHED_ROLLOUTS:
        return None
    return row[PUBLISHED_ROLLOUTS.index(rollouts)]


# ---- Results: errors of every target, and the figures drawn from them.


Experiment = Literal["drop", "ablation"]

# Budgets at which methods are compared: the paper's K, and 40, our method's.
ROLLOUTS = (1, 5, 10, 40, 100)

# Methods that are given of the test targets what no method could know.
GIVEN_TRUTHS = ("mean", "entropy-search")

GIVEN_NOTE = "* is given the mean / the range of the test targets, as by its authors: not ranked."


@dataclass(frozen=True)
class Cell:
    """Conditions of a comparison: the same targets, observed alike, in the same simulator."""

    experiment: Experiment  # which table it belongs to
    simulator: str  # "paper" or "calibrated"
    which: str  # name of the `TargetSet`
    noise_m: float  # standard deviation of the noise of each height of the target [m]


@dataclass(frozen=True)
class Figures:
    """Figures of one method in one cell after some number of rollouts."""

    mae: float  # mean over the seeds of the mean absolute error over the targets
    median: float  # of the errors of all targets of all seeds
    lowest: float  # mean absolute error of the best seed
    highest: float  # of the worst seed
    paper: float | None  # what the paper has in its place


@dataclass(frozen=True, eq=False)
class MethodErrors:
    """Errors of one method in one cell."""

    cell: Cell  # where it competed
    method: str  # its name
    label: str  # as tables have it
    group: Group  # whose it is
    budget: int  # rollouts after which it gives nothing new
    # absolute error of the restitution of the answer after 0, 1, ... rollouts, shape (seeds,
    # targets, 1 + rollouts that it was allowed)
    errors: Array

    @property
    def is_given_truths(self) -> bool:
        """Whether it is given something of the test targets, so that it cannot be ranked."""
        return self.method in GIVEN_TRUTHS

    @property
    def shown(self) -> str:
        """Label; with a star where it `is_given_truths`."""
        return self.label + "*" * self.is_given_truths

    @property
    def allowed(self) -> int:
        """Number of rollouts that it was allowed."""
        return self.errors.shape[2] - 1

    def knows(self, rollouts: int) -> bool:
        """Check whether its answer after that many is known: it had them, or needs none."""
        return rollouts <= self.allowed or self.budget <= self.allowed

    def errors_after(self, rollouts: int) -> Array:
        """Return absolute errors, shape (seeds, targets); beyond its budget its answer stands.

        Raises:
            ValueError: it was not allowed as many, and might have used them.
        """
        if not self.knows(rollouts):
            raise ValueError(f"{self.method} was allowed {self.allowed} rollouts, not {rollouts}")
        return self.errors[:, :, min(rollouts, self.allowed)]

    def figures(self, rollouts: int) -> Figures:
        """Return mean, median and spread over the seeds after that many rollouts."""
        errors = self.errors_after(rollouts)
        means = errors.mean(axis=1)
        comparable = self.cell.simulator == "paper" and not self.cell.noise_m
        paper = published_error(self.cell.which, self.method, rollouts) if comparable else None
        lowest, highest = float(means.min()), float(means.max())
        return Figures(float(means.mean()), float(np.median(errors)), lowest, highest, paper)


@dataclass(frozen=True)
class Credible:
    """Coverage of the 95 % credible intervals of a posterior in a cell."""

    cell: Cell
    method: str  # name of the one that has a posterior
    targets: int  # of all seeds
    held: float  # fraction of them whose interval contains the truth
    held_se: float  # its standard error
    width: float  # median of the intervals' widths


@dataclass(frozen=True, eq=False)
class DropResults:
    """Results of the second experiment."""

    seeds: tuple[int, ...]  # of training and of the targets
    targets: int  # test cases for each seed and cell
    outcomes: tuple[MethodErrors, ...]  # every method in every cell
    # of the intervals of recorded drops; empty where it was not measured
    coverage: tuple[Coverage, ...] = ()
    # coverage of neural posteriors' intervals; empty where there was none
    credible: tuple[Credible, ...] = ()
    # most that any method was allowed; None where the cells' own limits applied
    rollouts: int | None = None

    @property
    def columns(self) -> tuple[int, ...]:
        """Budgets of `ROLLOUTS` that were run."""
        return tuple(n for n in ROLLOUTS if self.rollouts is None or n <= self.rollouts)

    @property
    def cells(self) -> tuple[Cell, ...]:
        """Cells in the order in which they were run."""
        return tuple(dict.fromkeys(one.cell for one in self.outcomes))

    def of(self, cell: Cell) -> Sequence[MethodErrors]:
        """Return every method of a cell."""
        return [one for one in self.outcomes if one.cell == cell]


# ---- Neural posteriors: training, and the coverage of their intervals.


Posteriors = Mapping[tuple[int, float], SbiPosterior]  # by seed and noise of the target [m]
SIMULATIONS = 1600  # drops: as many as the paper's 800 pairs take


@dataclass(frozen=True, eq=False)
class _Training:
    """Training data of one network."""

    observations: Array  # z of the drops [m], as they are observed, shape (N, L)
    restitutions: Array  # shape (N,)
    seed: int
    epochs: int | None  # most passes; None for the library's rule


def train_posteriors(
    seeds: Collection[int],
    noises_m: Collection[float],
    jobs: int | None,
    progress: Progress,
    effort: Effort | None = None,
) -> Posteriors:
    """Train a network for each seed and noise: a sensor's noise is known to its user.

    Those of one seed learn from the same drops. The networks are the same for any `jobs`.
    """
    effort = effort or Effort()
    count = 2 * effort.pairs if effort.pairs else SIMULATIONS
    keys: list[tuple[int, float]] = []
    trainings: list[_Training] = []
    for seed in seeds:
        heights_m, restitutions = _simulated(count, seed, jobs, progress)
        for noise_m in noises_m:
            keys.append((seed, noise_m))
            rng = np.random.default_rng([seed, *b"noise of a posterior"])
            observed = heights_m + rng.normal(0.0, noise_m, heights_m.shape)
            trainings.append(_Training(observed, restitutions, seed, effort.epochs))
    pieces = [Piece(training, 1, f"seed {training.seed}") for training in trainings]
    found = parallel_map(_trained, pieces, jobs, progress, ("training posteriors", "network"))
    return dict(zip(keys, found, strict=True))


def _simulated(count: int, seed: int, jobs: int | None, progress: Progress) -> tuple[Array, Array]:
    """Simulate heights over time [m], shape (N, L), and draw restitutions, shape (N,)."""
    rng = np.random.default_rng([seed, *b"posterior"])
    releases_m = rng.uniform(*PAPER_HEIGHT_M, count)
    restitutions = rng.uniform(*RESTITUTION.training_range, count)
    return observe_paper_drops(releases_m, restitutions, jobs, progress)[:, :, 0], restitutions


def _trained(training: _Training) -> SbiPosterior:
    return train_posterior(
        training.observations,
        training.restitutions,
        RESTITUTION.training_range,
        training.seed,
        training.epochs,
    )


def credible_coverage(
    work: Sequence[tuple[Cell, Sequence[TargetBatch]]], jobs: int | None, progress: Progress
) -> tuple[Credible, ...]:
    """Measure the empirical coverage of posteriors' credible intervals, one row a cell."""
    if not work:
        return ()
    pieces = [
        Piece(batch, len(batch.targets), batch.method.name)
        for _, batches in work
        for batch in batches
    ]
    found = iter(parallel_map(ends_of, pieces, jobs, progress, ("credible intervals", "target")))
    rows = []
    for cell, batches in work:
        ends = np.concatenate([next(found) for _ in batches])
        truths = np.array([target.truth for batch in batches for target in batch.targets])
        covered = (ends[:, 0] <= truths) & (truths <= ends[:, 1])
        width = float(np.median(ends[:, 1] - ends[:, 0]))
        error = fraction_error(covered)
        assert error is not None  # there is a target
        name = batches[0].method.name
        rows.append(Credible(cell, name, len(covered), float(covered.mean()), error, width))
    return tuple(rows)


def ends_of(batch: TargetBatch) -> Array:
    """Return the 95 % credible intervals of a posterior's targets, shape (targets, 2)."""
    estimator = batch.method.estimator
    assert isinstance(estimator, NeuralPosterior)
    problems = problems_in(batch.contact)
    return np.array(
        [estimator.density(problems.pose(target).target).interval() for target in batch.targets]
    )
