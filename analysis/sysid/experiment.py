"""A user's own simulator as an experiment, tuned from any log of what it simulates.

It is tuned by least squares, by a search, or by a TuneNet trained for it and the log.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tunenet_logs.analysis.checks import Check, CrossCheck
from tunenet_logs.analysis.estimators.base import (
    Evaluation,
    FitResult,
    Observation,
    Problem,
    Step,
    Trace,
)
from tunenet_logs.analysis.experiment import Claim, Preset, drop_invalid_samples
from tunenet_logs.analysis.options import RUN, Subject, TuneOptions
from tunenet_logs.analysis.record import Motion, Rebound
from tunenet_logs.analysis.sysid.actuators import choose
from tunenet_logs.analysis.sysid.checks import (
    fit_checks,
    match_check,
    other_checks,
    recording_checks,
    untold_check,
    whole_check,
)
from tunenet_logs.analysis.sysid.columns import ComparedColumns
from tunenet_logs.analysis.sysid.fit import Begun, SimulatorFit, fit_simulator
from tunenet_logs.analysis.sysid.horizons import Unseen, anew, predicted
from tunenet_logs.analysis.sysid.least_squares import Run
from tunenet_logs.analysis.sysid.matching import runs_of
from tunenet_logs.analysis.sysid.source import (
    Connected,
    ModelSource,
    Rollouts,
    SimulatorDetection,
    SimulatorSource,
    part_of,
    tuned_first,
    with_joints,
)
from tunenet_logs.analysis.sysid.together import held_out_log, names_of, together
from tunenet_logs.analysis.tunenet.network import Model, PairSet, Recipe, WideNetwork, train
from tunenet_logs.analysis.tunenet.weights import Purpose, load_model, save_model
from tunenet_logs.episode import Array, Episode, LeftOut
from tunenet_logs.errors import LogError, NotFoundError, TuneNetError, UsageError
from tunenet_logs.files import real_path
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.terminal import Progress, listed, told
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
    from scipy.stats import qmc

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

    def __init__(
        self, connected: Connected, initial: Array, digest: str, chosen: Array | None = None
    ) -> None:
        self._connected, self._chosen = connected, chosen
        simulator, target = connected.simulator, connected.target
        self._all = tuned_first(simulator.parameters)
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

    def _charged(self, unseen: Unseen) -> Unseen:
        """Wrap what is held out: each rollout that begins in it is charged as one."""

        def charged(begun: Begun | None) -> Begun | None:
            if begun is None:
                return None
            finer = None if begun.finer is None else self._charging(begun.finer)
            return replace(begun, run=self._charging(begun.run), finer=finer)

        def begin(from_s: float, until_s: float) -> Begun | None:
            return unseen.begin and charged(unseen.begin(from_s, until_s))

        return replace(unseen, begin=begin, whole=charged(unseen.whole))

    def _charging(self, run: Run) -> Run:
        def charging(values: Array) -> Array:
            self.rollouts += len(values)
            return run(values)

        return charging

    def _fit(self, start: Array) -> FitResult:
        connected = self._connected
        if self._chosen is not None and np.array_equal(start, self.initial):
            start = self._chosen  # where its terms were chosen
        self.rollouts += connected.spent
        finer, predict = connected.finer, None
        fitted = [self._charged(one) for one in connected.unseen]
        unseen = fitted if connected.held_out is None else [self._charged(connected.held_out)]
        if unseen:
            given = np.array([one.initial for one in self.parameters])
            predict = partial(predicted, unseen, given)
        fit = fit_simulator(
            self._counted(connected.rollouts),
            None if finer is None else self._counted(finer),
            connected.target,
            self._all,
            start,
            np.array([connected.unresolved.get(one.name, 0.0) for one in self._all]),
            predict,
            connected.later,
            connected.logs,
            [self._charging(one) for one in connected.omitted],
            partial(anew, fitted) if fitted else None,
            connected.joints,
        )
        found: SimulatorFit = fit.detail
        self._rest = found.solution.values[len(start) : len(self._all)]
        return fit


# ---- The experiment


@dataclass(frozen=True)
class SimulatorExperiment:
    """See `Experiment`."""

    source: SimulatorSource  # of the simulator
    log: Path = Path()  # that an episode is of

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
        for one in (*(selection.together or ()), selection.hold_out):
            if isinstance(one, Path) and real_path(one) == real_path(self.log):
                raise UsageError(f"{one} is named twice; name each run of the machine once")
        runs, held_out = self._runs(episode, selection)
        parts, connected = self._all_connected(runs, selection)
        if isinstance(self.source, ModelSource) and self.source.is_to_choose:
            choice = choose(connected, self.source)
            chosen = replace(self, source=self.source.choosing(choice.values))
            parts, connected = chosen._all_connected(runs, selection)
            omitted = choice.omitted(tuned_first(connected.simulator.parameters))
            doubts = (*connected.doubts, *choice.words)
            connected = replace(connected, doubts=doubts, omitted=omitted, spent=choice.rollouts)
            return chosen._held_out(connected, parts, runs, held_out, selection)
        return self._held_out(connected, parts, runs, held_out, selection)

    def _all_connected(
        self, runs: Mapping[str, _Run], selection: TuneOptions
    ) -> tuple[list[Connected], Connected]:
        """Connect each run, and all together."""
        parts = [
            self._connected(one, selection, said if number else None)
            for number, (said, one) in enumerate(runs.values())
        ]
        return parts, together(tuple(runs), parts) if len(parts) > 1 else parts[0]

    def _runs(
        self, episode: Episode, selection: TuneOptions
    ) -> tuple[dict[str, _Run], dict[str, _Run]]:
        """Return the runs that are fitted, and one that is held out if any is, by their names."""
        logs = [self.log, *(_path_of(one, "log") for one in selection.together or ())]
        every = [episode, *(_read(one, selection) for one in selection.together or ())]
        held = selection.hold_out
        told = RUN.fullmatch(str(held)) if isinstance(held, Path) else None
        runs: dict[str, _Run] = {}
        for name, log, whole in zip(names_of(logs), logs, every, strict=True):
            is_split = selection.together is not None or told is not None
            for run, one in (runs_of(whole) if is_split else {"": whole}).items():
                shown = f"{name} {run}" if run and len(logs) > 1 else run or name
                runs[shown] = f"{log} {run}".strip(), one
        held_out: dict[str, _Run] = {}
        if told is not None:
            wanted = f"{told[1]}{'_' * (told[1] == 'demo')}{told[2]}"
            name = wanted if len(logs) == 1 else f"{names_of(logs)[0]} {wanted}"
            if name not in runs or len(runs) == 1:
                there = f"there is: {listed(runs)}" if len(runs) > 1 else "it holds one run alone"
                raise UsageError(f"{self.log}: has no {held} to hold out; {there}")
            held_out[f"{name} (held out)"] = runs.pop(name)
            if selection.together is None:
                runs = dict([next(iter(runs.items()))])
        elif held is not None:
            log = _path_of(held, "held out")
            name = f"{names_of([log])[0]} (held out)" if log.suffix else log.name
            held_out[name] = str(log), _read(held, selection)
        if selection.together == () and len(runs) + len(held_out) == 1:
            what = "--together is for two logs or runs, or more"
            raise UsageError(f"{self.log}: holds one run; {what}", "name another log")
        return runs, held_out

    def _held_out(
        self,
        connected: Connected,
        parts: Sequence[Connected],
        runs: Mapping[str, _Run],
        held_out: Mapping[str, _Run],
        selection: TuneOptions,
    ) -> SimulatorDetection:
        """Make the detection, with the run that is held out."""
        episodes = [episode for _, episode in runs.values()]
        episode = episodes[0]
        others = {name: one for name, (_, one) in [*runs.items()][1:]}
        for name, (said, one) in held_out.items():
            others[name] = one
            unseen = held_out_log(name, self._connected(one, selection, said))
            nothing = np.zeros(len(connected.target.values), dtype=np.bool_)
            connected = replace(connected, held_out=unseen, later=nothing)
        first_ns = min(int(one.stamps_ns[0]) for one in episode.signals.values())
        offset_s = (connected.target.start_ns - first_ns) * 1e-9
        lacking = [
            LeftOut.of_signal(one.signals[signal])
            for part, one in zip(parts, episodes, strict=True)
            for signal in sorted({column.signal for column in part.target.columns})
        ]
        return SimulatorDetection(self.source, connected, offset_s, tuple(lacking), others)

    def _connected(self, episode: Episode, selection: TuneOptions, said: str | None) -> Connected:
        """Connect a run; what is wrong with another than the first names it."""
        try:
            return self.source.connect(part_of(episode, selection.start_s, selection.end_s))
        except (NotFoundError, LogError) as error:
            if said is None:
                raise
            raise type(error)(f"{said}: {error.what}", error.remedy) from error

    def problem(self, detection: SimulatorDetection, initial: Array) -> Problem:
        """Pose least squares by rollouts; see `Experiment.problem`."""
        source, chosen = detection.source, None
        if isinstance(source, ModelSource) and source.chosen is not None:  # as the log told
            kept = [one.name in source.chosen for one in self.source.parameters]
            chosen = np.array([source.chosen[one.name] for one in source.parameters])
            initial = initial[kept]
        return SimulatorProblem(detection.connected, initial, source.digest, chosen)

    def checks(
        self, detection: SimulatorDetection, last: Step, fit: FitResult | None
    ) -> tuple[Check, ...]:
        """See `Experiment.checks`."""
        assert last.evaluation is not None
        target = detection.connected.target
        residuals = target.seen_in(last.evaluation.episode) - target.values
        if fit is not None and fit.detail.is_begun_anew:
            residuals = fit.detail.solution.residuals
        whole = whole_check(last.evaluation.episode)
        checks = (*recording_checks(target), *([whole] if whole else []))
        others = other_checks(detection, fit.detail if fit else None)
        found = fit.detail if fit else None
        checks = (*checks, *others, match_check(target, residuals, found))
        return (*checks, *(fit_checks(found) if found else [untold_check(len(last.values))]))

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


_Run = tuple[str, Episode]  # what it is called in errors, and its signals


def _path_of(log: Path | Episode, name: str) -> Path:
    """Return a log's path; of an episode in memory what it is called."""
    return log if isinstance(log, Path) else Path(name)


def _read(log: Path | Episode, selection: TuneOptions) -> Episode:
    """Read another log of the machine; LogError if it cannot be."""
    episode = log if isinstance(log, Episode) else read_episode(log, selection.reading)
    return trim_clock_jumps(drop_invalid_samples(episode))


# ---- Plan: how a log would drive a model and be compared with it, before tuning


def print_plan(log: Path, options: TuneOptions) -> None:
    """Print the plan, a line per signal and parameter."""
    assert options.source is not None
    parameters = options.source.parameters
    try:
        episode = trim_clock_jumps(read_episode(log, options.reading))
    except LogError as error:
        raise LogError(with_joints(str(error), options.source)) from error
    experiment = SimulatorExperiment(options.source, log)
    runs, held_out = experiment._runs(episode, options)
    plans = {
        name: experiment._connected(one, options, said)
        for name, (said, one) in {**runs, **held_out}.items()
    }
    connected = plans[next(iter(runs))]
    print(f"{log}: {connected.target.end_s:.2f} s of {options.source.name}")
    for words in connected.used:
        print(f"  {words}")
    if others := [*runs][1:]:
        total_s = sum(plans[name].target.end_s for name in others)
        print(f"  together with {listed(others, 6)}, {total_s:.2f} s")
    for name in held_out:
        told = name.removesuffix(" (held out)")
        print(f"  held out: {told}, {plans[name].target.end_s:.2f} s")
    for words in connected.unused:
        print(f"  not used: {words}")
    for words in connected.doubts:
        print(f"  doubtful: {words}")
    for one in parameters:
        low, high = one.training_range
        print(f"  tuned: {one.name} from {one.initial:g} in {low:g} to {high:g}{_unit(one)}")
    if isinstance(options.source, ModelSource) and options.source.is_to_choose:
        print("  of servos' terms beyond their first four only those that the log tells")
    for one in connected.simulator.parameters[len(parameters) :]:
        print(f"  begins: {one.name} {one.initial:.4g} ± {one.prior_sd:.2g}{_unit(one)}")


def _unit(parameter: Parameter) -> str:
    return "" if parameter.unit == "1" else f" {parameter.unit}"
