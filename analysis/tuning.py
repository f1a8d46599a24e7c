"""One log from end to end: read, observe, estimate, check, verdict."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from analysis.drop.checks import Check, log_checks
from analysis.drop.from_film import DropVideoTask
from analysis.estimators.base import Problem, Step, Trace
from analysis.estimators.tunenet import TuneNet
from analysis.experiment import (
    CrossCheck,
    Detection,
    ExtraEstimate,
    FitResult,
    Preset,
    Selection,
    Task,
)
from analysis.registry import KINDS, kinds_of, task_for
from analysis.tracking.track import Track
from analysis.tunenet.checkpoint import load_model, shipped_model
from analysis.tunenet.network import Model
from recorders.simulators.base import Parameter
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError, NotFoundError, TuneNetError, UsageError
from tunenet_logs.reader import read_episode

Verdict = Literal["ok", "suspect", "rejected"]

NETWORK = TuneNet.name
REFINED = f"{TuneNet.name}+refine"
METHODS = (REFINED, NETWORK)
"""What a user may ask for; the first is the default where the log and the preset allow it."""


@dataclass(frozen=True)
class Options:
    """What a user may choose; see `tunenet-tune --help`.

    Attributes:
        task: None to go by the log.
        initial: None for the task's own first guess.
        method: one of `METHODS`; None for the best that there is.
        weights: None for those that the package ships.
    """

    task: str | None = None
    preset: str = "default"
    iterations: int = 5
    initial: float | None = None
    method: str | None = None
    weights: Path | None = None
    selection: Selection = field(default_factory=Selection)


@dataclass(frozen=True, eq=False)
class Tuning:
    """What came out for one log.

    Attributes:
        occasion: what a user would do again, e.g. "drop".
        reason: why the verdict is not "ok"; None if it is.
        episode: the log as it was read; None if it could not be.
        found: what the task found in it, a `Detection`; None if nothing.
        trace: the iterates with their rollouts, the last one's too; None where there are none.
        refined: what follows the network's steps, and the last of the iterates; None without.
        rollouts: all simulator runs, that of the last iterate too.
        digest: of the weights.
        step_hz: the simulator's steps a second.
        seconds: wall time of "read", "observe", "tune", "total".
    """

    log: Path
    task: str | None
    preset: str
    verdict: Verdict
    reason: str | None
    parameters: tuple[Parameter, ...] = ()
    occasion: str = "recording"
    episode: Episode | None = None
    found: Any = None
    trace: Trace | None = None
    refined: FitResult | None = None
    rollouts: int = 0
    cross_check: CrossCheck | None = None
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()
    digest: str = ""
    physical: bool = True
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def estimate(self) -> NDArray[np.float64] | None:
        """The tuned values, shape (P,); None for a rejected log."""
        if self.trace is None or self.verdict == "rejected":
            return None
        return self.trace.estimate

    @property
    def further(self) -> tuple[ExtraEstimate, ...]:
        """What was found beside the tuned values; nothing for a rejected log."""
        return () if self.estimate is None or self.refined is None else self.refined.further

    @property
    def method(self) -> str:
        """How the values were found."""
        return REFINED if self.refined else NETWORK

    @property
    def interval95(self) -> NDArray[np.float64] | None:
        """Of the tuned values, shape (P, 2); None where none is honest.

        An interval tells of noise. Where a check doubts the model behind it, it would only look
        sure.
        """
        if self.refined is None or self.estimate is None:
            return None
        doubts = [one for one in self.checks if not one.passed and one is not self.refined.check]
        if doubts or (self.cross_check is not None and not self.cross_check.agrees):
            return None
        return self.refined.interval95


class _Stopwatch:
    def __init__(self) -> None:
        self._start = self._last = time.perf_counter()
        self.seconds: dict[str, float] = {}

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.seconds[name] = now - self._last
        self.seconds["total"] = now - self._start
        self._last = now


def tune_log(path: Path, options: Options) -> Tuning:
    """Tune from one log. What cannot be tuned comes back as "rejected", with the reason.

    Raises:
        UsageError, WeightsError: the options fit no log: preset, initial value or weights.
    """
    watch = _Stopwatch()
    try:
        episode = read_episode(path)
    except TuneNetError as error:
        watch.lap("read")
        reason = str(error).removeprefix(f"{path}: ")
        return Tuning(path, options.task, options.preset, "rejected", reason, seconds=watch.seconds)
    watch.lap("read")
    return _tune(path, episode, options, watch)


def tune_episode(episode: Episode, options: Options) -> Tuning:
    """Tune from an episode in memory, as `tune_log` does from a file."""
    return _tune(Path(), episode, options, _Stopwatch())


def tune_track(track: Track, options: Options) -> Tuning:
    """Tune from the track of a filmed ball, as `tune_log` does once it has found one."""
    task = DropVideoTask()
    preset = _preset(task, options)
    rejected = Tuning(
        Path(),
        task.kind,
        options.preset,
        "rejected",
        None,
        task.parameters,
        task.occasion,
        physical=preset.physical,
    )
    start_ns = int(track.stamps_ns[0])
    find = partial(task.find_in_track, track, start_ns, options.selection, options.preset)
    return _tune_found(rejected, task, find, options, _Stopwatch())


def _tune(path: Path, episode: Episode, options: Options, watch: _Stopwatch) -> Tuning:
    rejected = Tuning(path, options.task, options.preset, "rejected", None, seconds=watch.seconds)
    kind = options.task or episode.info.kind or _only_kind(path, episode, options)
    task = task_for(kind, episode, options.selection.topic)
    if task is None:
        known = ", ".join(sorted(KINDS))
        return replace(rejected, reason=f"holds a {kind!r}; what can be tuned is: {known}")
    rejected = replace(
        rejected,
        task=task.kind,
        episode=episode,
        parameters=task.parameters,
        occasion=task.occasion,
        checks=log_checks(episode),
        warnings=episode.warnings,
        physical=_preset(task, options).physical,
    )
    find = partial(task.find, episode, options.selection, options.preset)
    return _tune_found(rejected, task, find, options, watch)


def _only_kind(path: Path, episode: Episode, options: Options) -> str:
    """What a log that does not say so shows.

    Raises:
        UsageError: it may be one or the other.
    """
    kinds = kinds_of(episode, options.selection.topic)
    if len(kinds) > 1:
        choices = " or ".join(f"--task {kind}" for kind in kinds)
        raise UsageError(f"{path}: holds what may be a {' or a '.join(kinds)}; say {choices}")
    return kinds[0] if kinds else KINDS[0]


def _tune_found(
    rejected: Tuning,
    task: Task,
    find: Callable[[], Detection],
    options: Options,
    watch: _Stopwatch,
) -> Tuning:
    """Tune to what `find` finds; `rejected` says what is known without it."""
    rejected = replace(rejected, seconds=watch.seconds)
    model = _model(_preset(task, options), options)
    try:
        found = find()
        problem = task.problem(found, _initial(task, options))
    except (NotFoundError, LogError) as error:
        watch.lap("observe")
        reason = str(error).removeprefix(f"{rejected.log}: ")
        return replace(rejected, reason=reason, checks=())
    watch.lap("observe")
    trace = TuneNet(model).estimate(problem, options.iterations)
    refined = None if options.method == NETWORK else task.refine(found, trace.estimate)
    trace = _looked_at(trace, refined, problem)
    checks = (*rejected.checks, *task.checks(found, trace.steps[-1], refined))
    cross_check = task.cross_check(found, trace.estimate)
    watch.lap("tune")
    verdict, reason = _judge(checks, cross_check, rejected.occasion)
    return replace(
        rejected,
        verdict=verdict,
        reason=reason,
        found=found,
        trace=trace,
        refined=refined,
        rollouts=problem.rollouts,
        cross_check=cross_check,
        checks=checks,
        warnings=(*rejected.warnings, *found.warnings, *_unrefined(options, refined)),
        digest=model.digest,
    )


def _preset(task: Task, options: Options) -> Preset:
    if options.preset not in task.presets:
        known = ", ".join(task.presets)
        raise UsageError(f"{task.name} has no preset {options.preset!r}; there is: {known}")
    return task.presets[options.preset]


def _unrefined(options: Options, refined: FitResult | None) -> tuple[str, ...]:
    if options.method != REFINED or refined is not None:
        return ()
    return (f"method {REFINED} is for the preset default; {NETWORK} was used",)


def _initial(task: Task, options: Options) -> NDArray[np.float64]:
    values = [
        one.initial if options.initial is None else options.initial for one in task.parameters
    ]
    return np.array(values)


def _model(preset: Preset, options: Options) -> Model:
    if options.weights is not None:
        return load_model(options.weights, preset.purpose)
    return shipped_model(preset.purpose)


def _looked_at(trace: Trace, refined: FitResult | None, problem: Problem) -> Trace:
    """Simulate the last iterate and the refined one: they are checked and shown, and counted."""
    last = trace.steps[-1]
    steps = [*trace.steps[:-1], Step(last.values, last.rollouts, problem.evaluate(last.values))]
    if refined is not None:
        spent = problem.rollouts
        steps.append(Step(refined.values, spent, problem.evaluate(refined.values)))
    return Trace(tuple(steps))


def _judge(
    checks: tuple[Check, ...], cross_check: CrossCheck | None, occasion: str
) -> tuple[Verdict, str | None]:
    """The verdict and its reason in one line, with what to do about what is named first."""
    failed = [check for check in checks if not check.passed]
    fatal = [check for check in failed if check.fatal]
    reasons = [f"{check.name}: {check.detail}" for check in fatal or failed]
    orders = [check.advice for check in fatal or failed]
    if cross_check is not None and not cross_check.agrees:
        reasons.append(f"cross-check: {cross_check.value:.3f} by {cross_check.method}")
        orders.append(cross_check.advice)
    if not reasons:
        return "ok", None
    advice = f"; at the next {occasion}: {orders[0]}" if orders[0] else ""
    if fatal:
        return "rejected", reasons[0] + advice
    return "suspect", "; ".join(reasons) + advice
