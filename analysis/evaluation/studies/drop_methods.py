"""Methods of the second experiment, their test cases, and their errors beside the paper's table 2.

The paper's methods, what a user would pick, and ours stand in a registry, each by name and with
what it needs: networks that are trained here from a seed, optional libraries. `drop` runs them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Literal, cast

import numpy as np

from tunenet_logs.analysis.drop import presets
from tunenet_logs.analysis.estimators.base import Estimator, Observation, Problem
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
from tunenet_logs.analysis.evaluation.studies.positions import fraction_error
from tunenet_logs.analysis.evaluation.study import METHODS, Order, Row, figure, scored
from tunenet_logs.analysis.evaluation.worlds.ball import TEST_SEEDS
from tunenet_logs.analysis.parallel import Piece, parallel_map
from tunenet_logs.analysis.registry import needed
from tunenet_logs.analysis.tunenet import network as nets
from tunenet_logs.episode import Array, Episode
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
            **nets.layer("proposed", inputs, self.width),
            **nets.layer("target", inputs, self.width),
            **nets.layer("joint", self.width, self.width),
            **nets.layer("out", self.width, outputs),
        }

    def residual(self, weights: nets.Weights, proposed: Any, target: Any) -> Any:
        """See `Network.residual`."""
        of_proposed = nets.relu(nets.linear(weights, "proposed", proposed))
        of_target = nets.relu(nets.linear(weights, "target", target))
        joint = nets.relu(nets.linear(weights, "joint", of_target - of_proposed))
        return nets.tanh(nets.linear(weights, "out", joint))


class Antisymmetrised:
    """h(o_P, o_T) = (g(o_P, o_T) - g(o_T, o_P)) / 2 of another network g, with g's weights.

    It is exactly 0 where both observations are equal, for any weights.
    """

    def __init__(self, network: nets.Network) -> None:
        self._network = network
        self.kind = f"antisymmetric {network.kind}"

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """See `Network.shapes`."""
        return self._network.shapes(inputs, outputs)

    def residual(self, weights: nets.Weights, proposed: Any, target: Any) -> Any:
        """See `Network.residual`."""
        forth = self._network.residual(weights, proposed, target)
        return (forth - self._network.residual(weights, target, proposed)) / 2


# ---- Our networks, trained on the paper's budget, and for the calibrated simulator.
# Each height of release hits the plane at another phase of the engine's steps, which moves the
# rebound by more than a network may err (docs/physics.md): both sides of a pair have one height.

_HEIGHTS, _RESTITUTIONS = 160, 10  # 1600 rollouts, as many as the paper's 800 pairs take
_PAIRS = 51_200  # drawn from those rollouts: each is in many


def train_on_papers(
    seed: int, jobs: int | None, progress: Progress, epochs: int | None = None
) -> nets.Model:
    """Train our network on the paper's simulator; `epochs` in place of the recipe's."""
    pairs = grouped_pairs(seed, jobs, progress)
    epochs = epochs or presets.OUR_TRAINING.epochs
    # noise twice that of the noisy cells
    recipe = replace(presets.OUR_TRAINING, noise=0.02, cut_share=0.0, epochs=epochs)
    return nets.train(nets.AntisymmetricNetwork(), pairs, recipe, seed, progress)


def train_on_calibrated(
    seed: int, jobs: int | None, progress: Progress, epochs: int | None = None
) -> nets.Model:
    """Train what the package ships (preset `default`), with another seed."""
    ours = presets.TRAININGS["default"]
    recipe = replace(ours.recipe, epochs=epochs or ours.recipe.epochs)
    return nets.train(
        ours.network, ours.make_pairs(None, seed, jobs, progress), recipe, seed, progress
    )


def grouped_pairs(seed: int, jobs: int | None, progress: Progress) -> nets.PairSet:
    """Simulate pairs within groups of one height; restitutions uniform over [0, 1] in each."""
    rng = np.random.default_rng(seed)
    low, high = RESTITUTION.training_range
    heights = np.repeat(rng.uniform(*presets.PAPER_HEIGHT_M, _HEIGHTS), _RESTITUTIONS)
    ranks = np.tile(np.arange(_RESTITUTIONS), _HEIGHTS)
    values = low + (high - low) * (ranks + rng.random(len(ranks))) / _RESTITUTIONS
    observations = presets.observe_paper_drops(heights, values, jobs, progress)
    # any two of a group, and 3 of 10 neighbours in restitution: fine corrections are learnt too
    first_of_group = _RESTITUTIONS * rng.integers(_HEIGHTS, size=_PAIRS)
    proposed, anywhere = rng.integers(_RESTITUTIONS, size=(2, _PAIRS))
    beside = np.clip(proposed + rng.choice([-1, 1], _PAIRS), 0, _RESTITUTIONS - 1)
    target = np.where(rng.random(_PAIRS) < 0.3, beside, anywhere)
    return nets.PairSet(
        observations, values[:, None], first_of_group + proposed, first_of_group + target
    )


# ---- All networks of one seed, by name.

Networks = Mapping[str, nets.Model]  # by the names in `NETWORKS`


PAPER_CODE, OURS, OURS_CALIBRATED = "paper-code", "ours", "ours-calibrated"
# Architecture of the paper's, and the preset whose recipe trains it.
_PLANS: Mapping[str, tuple[nets.Network, str]] = {
    "paper": (nets.PaperNetwork(), "paper"),
    PAPER_CODE: (nets.PaperNetwork(), "paper-code"),
    "direct": (nets.PaperNetwork(), "paper-code"),
    "difference": (DifferenceNetwork(), "paper-code"),
    "antisymmetric": (Antisymmetrised(nets.PaperNetwork()), "paper-code"),
}

_OURS = {OURS: train_on_papers, OURS_CALIBRATED: train_on_calibrated}

NETWORKS = (*_PLANS, *_OURS)


def train_networks(
    wanted: Collection[str], seed: int, order: Order, progress: Progress
) -> Networks:
    """Train the wanted networks; the paper's all on the same 800 pairs, ours on their own."""
    trained = {
        name: training(seed, order.jobs, progress, order.epochs)
        for name, training in _OURS.items()
        if name in wanted
    }
    plans = {name: plan for name, plan in _PLANS.items() if name in wanted}
    if not plans:
        return trained
    pairs = presets.TRAININGS["paper-code"].make_pairs(order.pairs, seed, order.jobs, progress)
    for name, (network, preset) in plans.items():
        recipe = presets.TRAININGS[preset].recipe
        recipe = replace(recipe, epochs=order.epochs or recipe.epochs)
        seen = direct_pairs(pairs) if name == "direct" else pairs
        trained[name] = nets.train(network, seen, recipe, seed, progress)
    return trained


# ---- Registry: methods by name, and what each needs.

Simulator = Literal["paper", "calibrated"]
Table = Literal[Simulator, "ablation"]  # on one of them, or the parts of the network compared

Group = Literal["paper", "user", "ours"]  # whose a method is
# The method that has a posterior, see `train_posteriors`; only on the paper's simulator.
NPE = "npe"

MAX_ROLLOUTS = 100  # rollouts a target: the last column of the paper's table 2


@dataclass(frozen=True)
class Method:
    """Method to compare, a row of the table."""

    name: str  # as JSON, CSV and `--methods` have it
    label: str  # as the table has it
    group: Group  # whose it is
    estimator: Estimator  # the method, ready to estimate
    budget: int  # rollouts after which it gives nothing new, or the most of the experiment
    free_release: bool = False  # it is given the height of release as a second parameter to find


@dataclass(frozen=True, eq=False)
class _Given:
    """What methods are made of in one cell."""

    table: Table
    networks: Networks  # by name, trained
    # true restitutions of the cell's targets, shape (N,). Only two of the paper's baselines look at
    # them, as its authors' do: the mean, and the range that entropy search covers
    truths: Array
    seed: int  # of the methods that draw
    # for the noise of the cell's targets, trained; None where it is not wanted
    posterior: Posterior | None

    @property
    def ours(self) -> nets.Model:
        """Our network for the cell's simulator."""
        return self.networks[OURS if self.table == "paper" else OURS_CALIBRATED]


@dataclass(frozen=True)
class _Row:
    """Method of the registry, how it is made, and what that takes."""

    label: str
    group: Group
    make: Callable[[_Given], Estimator]
    budget: int = MAX_ROLLOUTS  # fewer where it has converged then, and gives nothing new
    networks: tuple[str, ...] = ()  # of `NETWORKS`
    library: str = ""  # an optional one
    free_release: bool = False
    is_ablation: bool = False

    @property
    def tables(self) -> tuple[Table, ...]:
        """Where it competes: the paper's methods and posteriors on the paper's simulator alone."""
        if self.is_ablation:
            return ("ablation",)
        is_papers = self.group == "paper" or self.library == "sbi"
        return ("paper",) if is_papers else ("paper", "calibrated")


def _network(label: str, network: str, *, is_ablation: bool = False) -> _Row:
    """Return the paper's method with one of its networks."""

    def make(given: _Given) -> Estimator:
        return TuneNet(given.networks[network])

    return _Row(label, "paper", make, networks=(network,), is_ablation=is_ablation)


_BOTH = (OURS, OURS_CALIBRATED)
_ROWS: Mapping[str, _Row] = {
    "mean": _Row("Mean", "paper", lambda given: Constant(float(given.truths.mean())), 0),
    "entropy-search": _Row(
        *("Entropy search", "paper"),
        lambda given: EntropySearch((given.truths.min(), given.truths.max()), given.seed),
        library="sklearn",
    ),
    "cma-es": _Row(
        "CMA-ES", "paper", lambda given: CmaEs(given.seed), library="cma", free_release=True
    ),
    "direct": _Row(
        *("Direct prediction", "paper", lambda given: Direct(given.networks["direct"]), 0),
        networks=("direct",),
    ),
    "tunenet-paper": _network("TuneNet, the paper's text", "paper"),
    "tunenet-paper-code": _network("TuneNet, its authors' code", PAPER_CODE),
    "secant": _Row("Secant on the first flight", "user", lambda _: presets.FlightSecant(), 10),
    "brent": _Row("Brent", "user", lambda _: Brent()),
    "least-squares": _Row("Least squares, many starts", "user", lambda _: LeastSquares()),
    "tpe": _Row("TPE", "user", lambda given: Tpe(given.seed), library="optuna"),
    NPE: _Row(
        *("Neural posterior (sbi)", "user"),
        *(lambda given: NeuralPosterior(cast(Posterior, given.posterior)), 0),
        library="sbi",
    ),
    "network": _Row("Our network alone", "ours", lambda given: TuneNet(given.ours), networks=_BOTH),
    "ours": _Row(
        *("Our network, then fits", "ours", lambda given: TuneNetThenLine(given.ours), 40),
        networks=_BOTH,
    ),
    "concatenation": _network("Side by side (the paper's)", PAPER_CODE, is_ablation=True),
    "difference": _network("Difference", "difference", is_ablation=True),
    "antisymmetric": _network("Side by side, antisymmetric", "antisymmetric", is_ablation=True),
}


@dataclass(frozen=True)
class MethodRegistry:
    """Chosen methods and their requirements."""

    names: tuple[str, ...]  # of those chosen
    networks: frozenset[str]  # to be trained for them, see `train_networks`

    @property
    def has_curves(self) -> bool:
        """Whether the figure has anything to show: the ablation is a table only."""
        return any("paper" in _ROWS[name].tables for name in self.names)

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
        """Return the chosen methods of one table, ready to estimate; see `_Given`."""
        given = _Given(table, networks, truths, seed, posterior)
        rows = {name: _ROWS[name] for name in self.names if table in _ROWS[name].tables}
        return [
            Method(name, row.label, row.group, row.make(given), row.budget, row.free_release)
            for name, row in rows.items()
            if name != NPE or posterior is not None
        ]


def choose_methods(names: Iterable[str] | None) -> MethodRegistry:
    """Select methods by names of `study.METHODS`; all for None.

    Raises:
        UsageError: a library is not installed.
    """
    every = [name for some in METHODS.values() for name in some]
    chosen = tuple(name for name in every if names is None or name in names)
    rows = [_ROWS[name] for name in chosen]
    networks = frozenset(network for row in rows for network in row.networks)
    libraries = {row.library for row in rows if row.library}
    for library in sorted(libraries | {"torch"} if networks else libraries):
        needed(library)
    return MethodRegistry(chosen, networks)


# ---- Test cases: balls, heights and observation.

# Height of the ball's centre, where a method has to find it too; 4.5 m is the paper's middle.
RELEASE = Parameter("release_m", "m", (0.6, 10.0), presets.PAPER_HEIGHT_M, 4.5)


@dataclass(frozen=True)
class TargetSet:
    """Test set: ranges from which its restitutions are drawn."""

    name: str  # as `tunenet-eval` prints it
    initial: tuple[float, float]  # range of the first guess
    target: tuple[float, float]  # range of what is to be found


EASY = TargetSet("Easy", presets.PAPER_RESTITUTION, presets.PAPER_RESTITUTION)
HARD = TargetSet("Hard", (0.0, 1.0), (0.0, 1.0))
# As the paper's text has it; what its authors' code draws is `HARD`.
HARD_TARGET = TargetSet("Hard (target only)", presets.PAPER_RESTITUTION, (0.0, 1.0))

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
    heights = rng.uniform(*presets.PAPER_HEIGHT_M, count)
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

    The paper's simulator has 400 samples of z at 60 Hz, the calibrated one the canonical
    observation of the same drop.
    """

    def __init__(self, contact: ContactSettings = PAPER) -> None:
        self._contact = contact
        self._world = DropSimulator(paper_rig(presets.PAPER_HEIGHT_M[0]), contact)

    def pose(self, target: DropTarget, *, free_release: bool = False) -> Problem:
        """Pose one test case; `free_release` makes the height of release a second parameter."""
        rig = paper_rig(target.release_m)
        simulator = self._world.with_rig(rig)
        episode = simulator.rollout({RESTITUTION.name: target.truth})
        observe = presets.paper_rollout
        if self._contact == CALIBRATED:
            observe = partial(_canonical, rig=rig)
        signal = episode.signals[TOPIC]
        values = signal.values.copy()
        values[:, 2] += np.random.default_rng(target.seed).normal(0, target.noise_m, len(values))
        seen = replace(episode, signals={**episode.signals, TOPIC: replace(signal, values=values)})
        if free_release:
            guess = np.array([target.initial, target.release_m])
            return Problem(observe(seen), _AnyRelease(simulator), observe, guess)
        return Problem(observe(seen), simulator, observe, np.array([target.initial]))


def paper_rig(release_m: float) -> DropRig:
    """Return the paper's drop from a height of the ball's centre."""
    return DropRig(
        release_m - presets.PAPER_RADIUS_M,
        presets.PAPER_RADIUS_M,
        presets.PAPER_RATE_HZ,
        presets.PAPER_SAMPLES,
    )


def _canonical(episode: Episode, rig: DropRig) -> Observation:
    return presets.canonical(presets.rollout_drop(episode, rig, CALIBRATED))


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
        spent = [step.rollouts for step in trace.steps]
        if problem.rollouts > batch.rollouts:
            raise OverspentError(f"{method.name} spent {problem.rollouts} of {batch.rollouts}")
        if spent[0] != 0 or spent != sorted(spent) or spent[-1] > problem.rollouts:
            raise OverspentError(f"{method.name} says {spent} of {problem.rollouts} rollouts")
        row[:] = [abs(trace.after(n)[0] - target.truth) for n in range(batch.rollouts + 1)]
    return errors


@cache
def problems_in(contact: ContactSettings) -> DropProblems:
    """Return the test cases' problems in a simulator; one world a process."""
    return DropProblems(contact)


# ---- Published figures: table 2 of Allevato et al. 2019 (table 3 stands in `motion.ROWS`).

PUBLISHED_ROLLOUTS = (1, 5, 10, 100)  # the columns of table 2, K
_TABLE_2: Mapping[str, Mapping[str, tuple[float, float, float, float]]] = {
    "Easy": {
        "mean": (0.0968, 0.0968, 0.0968, 0.0968),
        "entropy-search": (0.1433, 0.0622, 0.0553, 0.0533),
        "cma-es": (0.0540, 0.0540, 0.0540, 0.0097),
        "direct": (0.0120, 0.0120, 0.0120, 0.0120),
        "tunenet-paper": (0.0145, 0.0050, 0.0053, 0.0053),
    },
    "Hard": {
        "mean": (0.2353, 0.2353, 0.2353, 0.2353),
        "entropy-search": (0.2876, 0.1021, 0.1153, 0.0939),
        "cma-es": (0.2766, 0.2766, 0.2766, 0.0605),
        "direct": (0.0493, 0.0493, 0.0493, 0.0493),
        "tunenet-paper": (0.1103, 0.0212, 0.0145, 0.0175),
    },
}


def published_error(which: str, method: str, rollouts: int) -> float | None:
    """Return the mean absolute error of restitution in table 2; None where there is none.

    Its text describes one Hard and its code draws another; its figures stand beside both.
    """
    row = _TABLE_2.get(which.removesuffix(" (target only)"), {}).get(method.removesuffix("-code"))
    if row is None or rollouts not in PUBLISHED_ROLLOUTS:
        return None
    return row[PUBLISHED_ROLLOUTS.index(rollouts)]


# ---- Results: errors of every target, and the figures drawn from them.

Experiment = Literal["drop", "ablation"]

# Budgets at which methods are compared: the paper's K, and 40, our method's.
ROLLOUTS = (1, 5, 10, 40, 100)


GIVEN_NOTE = "* is given the mean / the range of the test targets, as by its authors: not ranked."


@dataclass(frozen=True)
class Cell:
    """Conditions of a comparison: the same targets, observed alike, in the same simulator."""

    experiment: Experiment  # which table it belongs to
    simulator: Simulator
    which: str  # name of the `TargetSet`
    noise_m: float  # standard deviation of the noise of each height of the target [m]

    @property
    def keys(self) -> Row:
        """Names of these as files have them."""
        return {
            "experiment": self.experiment,
            "simulator": self.simulator,
            "set": self.which,
            "noise_m": self.noise_m,
        }


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
        """Whether it is given what no method could know of the test targets: it is not ranked."""
        return self.method in ("mean", "entropy-search")

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


@dataclass(frozen=True, eq=False)
class DropResults:
    """Results of the second experiment."""

    seeds: tuple[int, ...]  # of training and of the targets
    targets: int  # test cases for each seed and cell
    outcomes: tuple[MethodErrors, ...]  # every method in every cell
    # coverage of neural posteriors' 95 % credible intervals, a row a cell; empty without any
    credible: tuple[Row, ...] = ()
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


# ---- Curves of the figure: error against rollouts.

Color = tuple[int, int, int]

PANELS = ("Easy", "Hard")  # the paper's left and right
FLOOR = 1e-6  # of restitution: a smaller error is drawn here, for a logarithm
_COLORS: dict[str, Color] = {
    "mean": (140, 140, 140),
    "entropy-search": (148, 103, 189),
    "cma-es": (140, 86, 75),
    "direct": (227, 119, 194),
    "tunenet-paper": (127, 176, 222),
    "tunenet-paper-code": (31, 119, 210),
    "secant": (23, 170, 150),
    "brent": (120, 170, 30),
    "least-squares": (188, 160, 34),
    "tpe": (255, 150, 40),
    "npe": (140, 0, 120),
}


@dataclass(frozen=True, eq=False)
class ErrorCurve:
    """Error curve of a method."""

    method: str
    label: str
    is_ours: bool
    is_users: bool
    color: Color
    # mean over the seeds of the mean absolute error after 0, 1, ... rollouts, shape (R,)
    mean: Array
    low: Array  # of the best seed, shape (R,)
    high: Array  # of the worst, shape (R,)
    paper: tuple[tuple[int, float], ...]  # (rollouts, error) of the published points

    @property
    def rollouts(self) -> Array:
        """0, 1, ..., shape (R,)."""
        return np.arange(len(self.mean), dtype=np.float64)


def error_curves(results: DropResults, panel: str) -> list[ErrorCurve]:
    """Return the curves of a target set's clean cell; beyond a budget a line goes on.

    Points that the paper gives for two methods of ours are the last one's.
    """
    outcomes = results.of(Cell("drop", "paper", panel, 0.0))
    ours = [one.method for one in outcomes if one.group == "ours"]
    colors = _COLORS | dict(zip(ours, ((220, 40, 40), (240, 110, 90)), strict=False))
    most = max(1, *(one.allowed for one in outcomes)) if outcomes else 1
    budgets = [n for n in PUBLISHED_ROLLOUTS if n <= (results.rollouts or MAX_ROLLOUTS)]
    curves: list[ErrorCurve] = []
    for one in outcomes:
        reach = [n for n in range(min(most, MAX_ROLLOUTS) + 1) if one.knows(n)]
        means = np.column_stack([one.errors_after(n).mean(axis=1) for n in reach])
        paper = [(n, published_error(one.cell.which, one.method, n)) for n in budgets]
        mean, low, high = (np.maximum(of(means, axis=0), FLOOR) for of in (np.mean, np.min, np.max))
        points = tuple((n, error) for n, error in paper if error is not None)
        whose = one.group == "ours", one.group == "user"
        color = colors[one.method]
        curves.append(ErrorCurve(one.method, one.label, *whose, color, mean, low, high, points))
    last = {curve.paper: curve.method for curve in curves}
    return [
        curve if last[curve.paper] == curve.method else replace(curve, paper=()) for curve in curves
    ]


# ---- Neural posteriors: training, and the coverage of their intervals.

Posteriors = Mapping[tuple[int, float], SbiPosterior]  # by seed and noise of the target [m]
_Training = tuple[Array, Array, tuple[float, float], int, int | None]  # of `train_posterior`


def train_posteriors(noises_m: Collection[float], order: Order, progress: Progress) -> Posteriors:
    """Train a network for each seed and noise: a sensor's noise is known to its user.

    Those of one seed learn from the same drops. The networks are the same for any `jobs`.
    """
    count = 2 * (order.pairs or 800)  # drops: as many as the paper's 800 pairs take
    trainings: dict[tuple[int, float], Piece[_Training]] = {}
    for seed in order.seeds:
        rng = np.random.default_rng([seed, *b"posterior"])
        releases_m = rng.uniform(*presets.PAPER_HEIGHT_M, count)
        restitutions = rng.uniform(*RESTITUTION.training_range, count)
        drops = presets.observe_paper_drops(releases_m, restitutions, order.jobs, progress)
        heights_m = drops[:, :, 0]
        for noise_m in noises_m:
            rng = np.random.default_rng([seed, *b"noise of a posterior"])
            observed = heights_m + rng.normal(0.0, noise_m, heights_m.shape)
            work = (observed, restitutions, RESTITUTION.training_range, seed, order.epochs)
            trainings[seed, noise_m] = Piece(work, 1, f"seed {seed}")
    pieces, what = list(trainings.values()), ("training posteriors", "network")
    found = parallel_map(_trained, pieces, order.jobs, progress, what)
    return dict(zip(trainings, found, strict=True))


def _trained(work: _Training) -> SbiPosterior:
    return train_posterior(*work)


def credible_coverage(
    work: Sequence[tuple[Cell, Sequence[TargetBatch]]], order: Order, progress: Progress
) -> tuple[Row, ...]:
    """Measure the empirical coverage of posteriors' credible intervals, one row a cell."""
    rows: list[Row] = []
    for cell, batches in work:
        cases = [Piece(one, len(one.targets), one.method.name) for one in batches]
        what = ("credible intervals", "target")
        low, high = np.array(scored(ends_of, {"": cases}, order, progress, what)[""]).T
        truths = np.array([target.truth for batch in batches for target in batch.targets])
        covered = (low <= truths) & (truths <= high)
        rows.append(
            {
                **cell.keys,
                "method": batches[0].method.name,
                "targets": len(covered),
                "held": figure(covered),
                "held_se": fraction_error(covered),
                "width": figure(high - low, np.median),
            }
        )
    return tuple(rows)


def ends_of(batch: TargetBatch) -> list[tuple[float, float]]:
    """Return the 95 % credible intervals of a posterior's targets."""
    estimator = batch.method.estimator
    assert isinstance(estimator, NeuralPosterior)
    problems = problems_in(batch.contact)
    return [estimator.density(problems.pose(target).target).interval() for target in batch.targets]
