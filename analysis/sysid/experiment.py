"""A user's own simulator as an experiment, tuned from any log of what it simulates.

It is tuned by least squares, by a search, or by a TuneNet trained for it and the log.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import qmc

from tunenet_logs.analysis.checks import Check, CrossCheck
from tunenet_logs.analysis.estimators.base import (
    Evaluation,
    FitResult,
    Observation,
    Problem,
    Step,
    Trace,
)
from tunenet_logs.analysis.experiment import Claim, Preset
from tunenet_logs.analysis.options import Subject, TuneOptions
from tunenet_logs.analysis.record import Motion, Rebound
from tunenet_logs.analysis.sysid.checks import (
    fit_checks,
    match_check,
    recording_checks,
    whole_check,
)
from tunenet_logs.analysis.sysid.fit import ComparedColumns, SimulatorFit, fit_simulator
from tunenet_logs.analysis.sysid.source import (
    Connected,
    Rollouts,
    SimulatorDetection,
    SimulatorSource,
    part_of,
    with_joints,
)
from tunenet_logs.analysis.tunenet.network import Model, PairSet, Recipe, WideNetwork, train
from tunenet_logs.analysis.tunenet.weights import Purpose, load_model, save_model
from tunenet_logs.episode import Array, Episode, LeftOut
from tunenet_logs.errors import LogError, TuneNetError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.terminal import Progress, told
from tunenet_logs.timing.stamps import trim_clock_jumps

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

    from tunenet_logs.analysis.experiment import Tuning


# ---- TuneNet trained for one simulator and one log, and cached

ROLLOUTS = 2000  # that a network is trained with
_PAIRS_EACH = 40
_GRID = 100  # moments at which it looks
# Spreads that an observation reaches from the log's mean; what is further off looks the same.
MAX_SPREADS = 20.0
_BATCH = 50
_RECIPE = Recipe(
    optimizer="adamw",
    learning_rate=2e-3,
    weight_decay=0.1,
    epochs=30,
    batch=512,
    scaling="ranges",
    loss="squared",
)


def observation(target: ComparedColumns, values: Array) -> Observation:
    """Observe all columns on one grid, normalised by the log's mean and spread: `values` (M,)."""
    grid_s = np.linspace(0.0, target.end_s, _GRID)
    seen: list[Array] = []
    for number, column in enumerate(target.columns):
        mine = values[target.which == number]
        good = np.isfinite(mine)
        shown = np.full(_GRID, np.nan)
        if good.sum() > 1:
            shown = np.interp(grid_s, column.seconds[good], mine[good])
        centre = float(np.mean(column.values))
        scaled = (shown - centre) / max(column.spread, 1e-12)
        seen.append(np.clip(scaled, -MAX_SPREADS, MAX_SPREADS))
    names = tuple(f"{column.label} [spreads]" for column in target.columns)
    return Observation(np.column_stack(seen), grid_s, "time [s]", names)


def trained_network(
    rollouts: Rollouts,
    target: ComparedColumns,
    parameters: tuple[Parameter, ...],
    tuned: int,
    digest: str,
) -> Model:
    """Train the network for one simulator and one log, or load it from the cache."""
    count = ROLLOUTS
    shape = f"{_GRID} moments of {', '.join(column.label for column in target.columns)}"
    inputs = _GRID * len(target.columns)
    purpose = Purpose("simulator", "default", shape, inputs, tuned, (1.0,))
    kept: Path | None = None
    if digest:  # the cache's file, keyed by model, parameters, and log
        root = os.environ.get("XDG_CACHE_HOME")
        folder = Path(root) if root else Path.home() / ".cache"
        state = hashlib.sha256(digest.encode())
        state.update(f"{count} {_GRID}".encode())
        for one in parameters:
            state.update(f"{one.name} {one.training_range} {one.initial}".encode())
        state.update(target.seconds.tobytes() + target.values.tobytes())
        kept = folder / "tunenet-logs" / f"{state.hexdigest()[:32]}.safetensors"
    if kept is not None and kept.is_file():
        with suppress(TuneNetError):
            return load_model(kept, purpose)
    # Roll out over the ranges from the log's initial state (Halton), and draw pairs.
    low, high = np.array([one.training_range for one in parameters[:tuned]]).T
    values = qmc.scale(qmc.Halton(tuned, rng=0).random(count), low, high)
    rest = np.array([one.initial for one in parameters[tuned:]])
    rows = np.column_stack([values, np.repeat(rest[None], count, axis=0)])
    seen: list[Array] = []
    for first in told(range(0, count, _BATCH), "simulating to train", -(-count // _BATCH)):
        episodes = rollouts(rows[first : first + _BATCH])
        seen += [observation(target, target.seen_in(one)).values for one in episodes]
    rng = np.random.default_rng(0)
    proposed = rng.integers(count, size=_PAIRS_EACH * count)
    other = rng.integers(count, size=_PAIRS_EACH * count)
    pairs = PairSet(np.stack(seen), values, proposed, other)
    model = train(WideNetwork(), pairs, _RECIPE, 0, Progress(quiet=True))
    if kept is not None:
        with suppress(TuneNetError, OSError):
            kept.parent.mkdir(parents=True, exist_ok=True)
            save_model(kept, model, purpose, {"rollouts": str(count)})
    return model


# ---- Estimation problem of a simulator's parameters and uncertain initial state


class SimulatorProblem(Problem):
    """See `Problem`; uncertain initial states are fitted, too."""

    def __init__(self, connected: Connected, initial: Array, digest: str) -> None:
        self._connected = connected
        simulator, target = connected.simulator, connected.target
        self._all = tuple(sorted(simulator.parameters, key=lambda one: one.prior_sd is not None))
        self._rest = np.array([one.initial for one in self._all[len(initial) :]])
        # Of each column, by its spread: no simulator is right to all digits.
        shares = [one.noise / max(one.spread, 1e-12) for one in target.columns]
        self._noises = np.maximum(shares, 0.01)
        super().__init__(
            observation(target, target.values),
            simulator,
            lambda episode: observation(target, target.seen_in(episode)),
            initial,
            self._fit,
            train=lambda: trained_network(
                connected.rollouts, target, self._all, len(initial), digest
            ),
        )
        self.parameters = self._all[: len(initial)]

    def evaluate(self, values: Array) -> Evaluation:
        """Roll out once, by default from the initial state of the fit."""
        self.rollouts += 1
        row = np.concatenate([values, self._rest[len(values) - len(self.parameters) :]])
        episode = self._connected.rollouts(row[None])[0]
        return Evaluation(episode, self._observe(episode))

    @property
    def searched(self) -> tuple[Parameter, ...]:
        """Tuned parameters, then uncertain initial states."""
        return self._all

    @property
    def ranges(self) -> Array:
        """The user's ranges, and those of priors; widened to contain the start."""
        ends: list[tuple[float, float]] = []
        for one in self._all:
            reach = 3.0 * (one.prior_sd or 0.0)  # standard deviations to each side
            near = max(one.initial - reach, one.bounds[0]), min(one.initial + reach, one.bounds[1])
            ends.append(one.training_range if one.prior_sd is None else near)
        low, high = np.array(ends).T
        return np.stack([np.minimum(low, self.start), np.maximum(high, self.start)], axis=1)

    @property
    def start(self) -> Array:
        """See `Problem.start`."""
        return np.concatenate([self.initial, self._rest])

    def misfit(self, evaluation: Evaluation) -> Array:
        """See `Problem.misfit`; by each column's noise, and the largest where one is lost."""
        is_lost = np.isnan(evaluation.observation.values) & np.isfinite(self.target.values)
        off = np.where(is_lost.ravel(), MAX_SPREADS, super().misfit(evaluation))
        return (off.reshape(is_lost.shape) / self._noises).ravel()

    def _counted(self, rollouts: Rollouts) -> Callable[[Array], Array]:
        """Wrap rollouts, observed at the log's stamps; each is charged."""
        target = self._connected.target

        def run(values: Array) -> Array:
            self.rollouts += len(values)
            return np.stack([target.seen_in(episode) for episode in rollouts(values)])

        return run

    def _fit(self, start: Array) -> FitResult:
        finer = self._connected.finer
        fit = fit_simulator(
            self._counted(self._connected.rollouts),
            None if finer is None else self._counted(finer),
            self._connected.target,
            self._all,
            start,
            np.array([self._connected.unresolved.get(one.name, 0.0) for one in self._all]),
        )
        found: SimulatorFit = fit.detail
        self._rest = found.solution.values[len(start) :]
        return fit


# ---- The experiment


@dataclass(frozen=True)
class SimulatorExperiment:
    """See `Experiment`."""

    source: SimulatorSource  # of the simulator

    name = "simulator"
    kind = "simulator"
    occasion = "run"
    observed = "what the simulator shows, too"
    accepted_options: frozenset[Subject] = frozenset()

    @property
    def presets(self) -> Mapping[str, Preset]:
        """One: the simulator as given."""
        return {"default": Preset(True, self.source.parameters, "fit", starts_as_given=True)}

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """Claim every episode: the user named the simulator."""
        del episode, topic
        return Claim.CERTAIN

    def detect(self, episode: Episode, selection: TuneOptions, preset: str) -> SimulatorDetection:
        """Match the log's signals with the simulator's; see `Experiment.detect`."""
        del preset
        part = part_of(episode, selection.start_s, selection.end_s)
        connected = self.source.connect(part)
        first_ns = min(int(one.stamps_ns[0]) for one in episode.signals.values())
        offset_s = (connected.target.start_ns - first_ns) * 1e-9
        names = {column.signal for column in connected.target.columns}
        lacking = tuple(LeftOut.of_signal(episode.signals[name]) for name in sorted(names))
        return SimulatorDetection(self.source, connected, offset_s, lacking)

    def problem(self, detection: SimulatorDetection, initial: Array) -> Problem:
        """Pose least squares by rollouts; see `Experiment.problem`."""
        return SimulatorProblem(detection.connected, initial, detection.source.digest)

    def checks(
        self, detection: SimulatorDetection, last: Step, fit: FitResult | None
    ) -> tuple[Check, ...]:
        """See `Experiment.checks`."""
        assert last.evaluation is not None
        target = detection.connected.target
        residuals = target.seen_in(last.evaluation.episode) - target.values
        whole = whole_check(last.evaluation.episode)
        checks = (*recording_checks(target), *([whole] if whole else []))
        checks = (*checks, match_check(target, residuals))
        return (*checks, *fit_checks(fit.detail)) if fit else checks

    def cross_check(self, detection: SimulatorDetection, estimate: Array) -> CrossCheck | None:
        """Return None: the hold-out is the check; see `Experiment.cross_check`."""
        del detection, estimate

    def motion(self, detection: SimulatorDetection, trace: Trace) -> Motion | None:
        """Return None: a simulator may show many signals, which are the review's."""
        del detection, trace

    def rebounds(self, detection: SimulatorDetection, trace: Trace) -> tuple[Rebound, ...]:
        """Return none; see `Experiment.rebounds`."""
        del detection, trace
        return ()

    def example(self, stream: rr.RecordingStream) -> rrb.View | None:  # noqa: ARG002
        """Return None: any smooth motion will do."""
        return None

    def review(self, stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container | None:
        """See `Experiment.review`."""
        if tuning.detection is None:
            return None
        from tunenet_logs.analysis.sysid.review import log_simulator

        return log_simulator(stream, tuning)


# ---- Plan: how a log would drive a model and be compared with it, before tuning


def print_plan(log: Path, options: TuneOptions) -> None:
    """Print the plan, a line per signal and parameter."""
    assert options.source is not None
    parameters = options.source.parameters
    try:
        episode = trim_clock_jumps(read_episode(log, options.reading))
    except LogError as error:
        raise LogError(with_joints(str(error), options.source)) from error
    connected = options.source.connect(part_of(episode, options.start_s, options.end_s))
    print(f"{log}: {connected.target.end_s:.2f} s of {options.source.name}")
    for words in connected.used:
        print(f"  {words}")
    for words in connected.unused:
        print(f"  not used: {words}")
    for words in connected.doubts:
        print(f"  doubtful: {words}")
    for one in parameters:
        low, high = one.training_range
        print(f"  tuned: {one.name} from {one.initial:g} in {low:g} to {high:g}{_unit(one)}")
    for one in connected.simulator.parameters[len(parameters) :]:
        print(f"  begins: {one.name} {one.initial:.4g} ± {one.prior_sd:.2g}{_unit(one)}")


def _unit(parameter: Parameter) -> str:
    return "" if parameter.unit == "1" else f" {parameter.unit}"
