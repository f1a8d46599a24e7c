"""Tune a log of a machine: by ours, the toolbox, and the network's first step."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from analysis.evaluation.sysid.model_log import ModelLog
from analysis.evaluation.sysid.targets import MACHINES
from analysis.selection import Options
from analysis.sysid.experiment import SimulatorExperiment
from analysis.sysid.fit import SimulatorFit
from analysis.sysid.source import ModelSource
from analysis.tuning import tune_episode

Section = Literal["tuned", "untold", "wrong", "toolbox", "network"]


@dataclass(frozen=True)
class MachineTrial:
    """Log to be tuned.

    Attributes:
        section: what is asked of it.
        machine: its number in `MACHINES`.
        seed: of it.
        noise: times the usual one.
    """

    section: Section
    machine: int
    seed: int
    noise: float = 1.0


@dataclass(frozen=True)
class FoundValue:
    """Estimate of one parameter.

    Attributes:
        address: which.
        truth: of the machine; NaN where the model is another's.
        value: NaN where none was given.
        low: end of the 95 % interval; NaN without one.
        high: likewise.
        range: that it was looked for in, its width.
        is_told: whether the result reports it as identifiable.
        can_be_told: whether it is identifiable.
    """

    address: str
    truth: float
    value: float
    low: float
    high: float
    range: float
    is_told: bool = True
    can_be_told: bool = True

    @property
    def is_covered(self) -> bool:
        """Whether the interval holds the truth."""
        return self.low <= self.truth <= self.high


@dataclass(frozen=True)
class SysidOutcome:
    """Result for one log.

    Attributes:
        trial: which.
        what: of several models of one log.
        verdict: "" of the toolbox, which gives none.
        found: by parameter.
        rollouts: simulated in all.
        seconds: of the processor.
    """

    trial: MachineTrial
    what: str
    verdict: str
    found: tuple[FoundValue, ...]
    rollouts: int
    seconds: float


def outcomes_of(trial: MachineTrial) -> list[SysidOutcome]:
    """Run a trial."""
    machine = MACHINES[trial.machine]
    if trial.section == "untold":
        return [_tuned(trial, machine.untold(trial.seed, trial.noise))]
    log = machine.log(trial.seed, trial.noise)
    if trial.section == "tuned":
        return [_tuned(trial, log)]
    if trial.section == "toolbox":
        return [_by_toolbox(trial, log)]
    if trial.section == "network":
        return [_first_steps(trial, log)]
    models = machine.wrong(log)
    return [_tuned(trial, replace(log, model=model), what) for what, model in models.items()]


def _source(log: ModelLog, folder: str) -> ModelSource:
    path = Path(folder) / "model.xml"
    path.write_text(log.model)
    return ModelSource(path, log.tune)


def _tuned(trial: MachineTrial, log: ModelLog, what: str = "") -> SysidOutcome:
    with tempfile.TemporaryDirectory() as folder:
        began_s = time.process_time()
        tuning = tune_episode(log.episode, Options(source=_source(log, folder)))
        seconds = time.process_time() - began_s
    found: list[FoundValue] = []
    if tuning.trace is not None and tuning.trace.fit is not None:
        fit: SimulatorFit = tuning.trace.fit.detail
        untold = {one.name for one in fit.untold}
        for one, value, ends in zip(
            tuning.parameters, tuning.trace.estimate, tuning.trace.fit.interval95, strict=True
        ):
            low, high = one.training_range
            found.append(
                FoundValue(
                    one.name,
                    np.nan if what else log.truth[one.name],
                    float(value),
                    *map(float, ends),
                    range=high - low,
                    is_told=one.name not in untold,
                    can_be_told=one.name not in log.untold,
                )
            )
    return SysidOutcome(trial, what, tuning.verdict, tuple(found), tuning.rollouts, seconds)


def _by_toolbox(trial: MachineTrial, log: ModelLog) -> SysidOutcome:
    from analysis.evaluation.sysid.baseline import toolbox_answer

    answer = toolbox_answer(log, tunes_start=True)
    found = tuple(
        FoundValue(address, truth, answer.values[address], *answer.intervals[address], np.nan)
        for address, truth in log.truth.items()
    )
    return SysidOutcome(trial, "", "", found, answer.rollouts, answer.seconds)


_STARTS = 20  # random places in the ranges from which the network makes its first step


def _first_steps(trial: MachineTrial, log: ModelLog) -> SysidOutcome:
    """Take one step of the network from each of many random starts: a row a start and value."""
    from analysis.estimators.tunenet import residual_of
    from analysis.selection import Selection
    from analysis.sysid.network import ROLLOUTS

    with tempfile.TemporaryDirectory() as folder:
        began_s = time.process_time()
        experiment = SimulatorExperiment(_source(log, folder))
        detection = experiment.detect(log.episode, Selection(), "default")
        parameters = experiment.source.parameters
        problem = experiment.problem(detection, np.array([one.initial for one in parameters]))
        assert problem.train is not None
        model = problem.train()
        seconds = time.process_time() - began_s
    rng = np.random.default_rng((trial.seed, 77))
    found: list[FoundValue] = []
    for _ in range(_STARTS):
        start = np.array([rng.uniform(*one.training_range) for one in parameters])
        seen = problem.evaluate(start).observation.values
        stepped = start + residual_of(model, problem, seen, problem.target.values)
        for one, value in zip(parameters, problem.clamp(stepped), strict=True):
            low, high = one.training_range
            row = (one.name, log.truth[one.name], float(value), np.nan, np.nan, high - low)
            found.append(FoundValue(*row))
    return SysidOutcome(trial, "", "", tuple(found), ROLLOUTS, seconds)


def trials(
    sections: Sequence[str], seeds: Sequence[int], logs: int, noises: Sequence[float]
) -> list[MachineTrial]:
    """List all trials.

    Args:
        sections: which.
        seeds: each with its own logs.
        logs: for each seed, machine and section; a fifth of them where the noise is another than
            the usual one, a twentieth for the network.
        noises: times the usual one, of the section "tuned".
    """
    found: list[MachineTrial] = []
    for machine in range(len(MACHINES)):
        for seed in seeds:
            own = range(seed * 1_000_000, seed * 1_000_000 + logs)
            fewer, few = own[: max(1, logs // 5)], own[: max(1, logs // 20)]
            for section in ("tuned", "untold", "wrong", "toolbox", "network"):
                if section not in sections:
                    continue
                for noise in noises if section == "tuned" else (1.0,):
                    chosen = own if noise == 1.0 else fewer
                    chosen = few if section == "network" else chosen
                    found += [MachineTrial(section, machine, one, noise) for one in chosen]
    return found
