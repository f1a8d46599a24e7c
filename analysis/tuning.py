"""Pipeline of one log: read, detect, pose the problem, estimate, check; for any experiment."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_args

import numpy as np

from tunenet_logs.analysis.checks import judge, log_checks
from tunenet_logs.analysis.estimators.base import Estimator, Step
from tunenet_logs.analysis.experiment import Experiment, Preset, Tuning, drop_invalid_samples
from tunenet_logs.analysis.options import RUN, Subject, TuneOptions
from tunenet_logs.analysis.record import Provenance
from tunenet_logs.analysis.registry import experiments_of, kinds, kinds_in, method_named
from tunenet_logs.analysis.result_files import known_sha256
from tunenet_logs.analysis.tunenet.weights import load_model, shipped_model
from tunenet_logs.episode import Array, Episode
from tunenet_logs.errors import LogError, NotFoundError, TuneNetError, UsageError
from tunenet_logs.reader import read_episode, said_unused, without_commands
from tunenet_logs.terminal import short_name
from tunenet_logs.timing.stamps import trim_clock_jumps

# ---- Provenance: SHA-256 of log and tares, options, versions.


def provenance_of(tuning: Tuning, sha256: str, options: TuneOptions) -> Provenance:
    """Build the provenance of a tuning; `sha256` of its log is "" if it could not be read."""
    return Provenance(
        version=version("tunenet-logs"),
        log_sha256=sha256,
        options={**options.provenance, **_other_runs(options)},
        tares=tuple(
            {"log": tare.name, "sha256": known_sha256(tare)}
            for tare in options.tares
            if isinstance(tare, Path)
        ),
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        engine=None if tuning.simulator is None else tuning.simulator["engine"],
        model=options.source.origin if options.source and tuning.simulator else None,
    )


def _other_runs(options: TuneOptions) -> dict[str, Any]:
    """Return name and SHA-256 of the other runs of a user's machine, as JSON values."""

    def told(log: Path | Episode) -> dict[str, str] | None:
        if isinstance(log, Episode):
            return None
        if RUN.fullmatch(str(log)):
            return {"run": str(log)}
        return {"log": log.name, "sha256": known_sha256(log)}

    found: dict[str, Any] = {}
    if options.together is not None:
        found["together"] = [told(log) for log in options.together]
    if options.hold_out is not None:
        found["hold_out"] = told(options.hold_out)
    return found


# ---- Unused options: those that have no effect on a log.


def unused_options(
    options: TuneOptions,
    experiment: Experiment,
    method: type[Estimator],
    episode: Episode | None,
    detection: Any,
) -> list[str]:
    """List options without effect, one line each with the reason."""
    found: list[str] = []
    ways = experiments_of(experiment.kind)
    of_its_kind = {about for way in ways for about in way.accepted_options}
    said = episode.warnings if episode else ()
    of_methods: Mapping[Subject, tuple[bool, str]] = {
        "network": (method.uses_network, "has no network"),
        "start": (method.takes_steps, "needs no start"),
        "rollouts": (method.takes_steps, "spends none"),
    }
    for about in get_args(Subject):
        names = [name for name in options.given(about) if not said_unused(name, said)]
        if about in experiment.accepted_options or about in of_methods or not names:
            continue
        why = f"it is tuned by {experiment.observed}"
        if about not in of_its_kind:
            why = f"this is a {experiment.kind}"
        elif about == "pictures" and episode and episode.picture_topics:
            why += f" (to use its pictures: --topic {episode.picture_topics[0]})"
        found.append(f"{', '.join(names)} not used: {why}")
    ball = options.given_ball
    only_size = ball.diameter_m is not None and ball.mass_kg is None
    takes_ball = "ball" in experiment.accepted_options
    if detection and only_size and takes_ball and not detection.uses_ball:
        found.append(
            "--ball-diameter not used: without --ball-mass it does not say what the air does"
        )
    for about, (uses_it, why) in of_methods.items():
        names = () if uses_it else options.given(about)
        found += [f"{name} not used: the method {method.name} {why}" for name in names]
    return found


# ---- Pipeline: from a log, an episode or a detection to its tuning.


class Stopwatch:
    """Wall time by stage [s]."""

    def __init__(self) -> None:
        self._start = self._last = time.perf_counter()
        self.seconds: dict[str, float] = {}

    def lap(self, name: str) -> None:
        """Record the time of stage `name` and start the next."""
        now = time.perf_counter()
        self.seconds[name] = now - self._last
        self.seconds["total"] = now - self._start
        self._last = now


def tune_log(path: Path, options: TuneOptions) -> Tuning:
    """Tune from one log; one that cannot be tuned is returned as "rejected", with the reason."""
    watch = Stopwatch()
    try:
        episode = read_episode(path, options.reading)
        if options.source is None:  # what drives a simulator, others must not take for a motion
            episode = without_commands(episode)
        episode = drop_invalid_samples(episode)
    except TuneNetError as error:
        watch.lap("read")
        reason = str(error).removeprefix(f"{path}: ")
        if options.source is not None:
            from tunenet_logs.analysis.sysid.source import with_joints

            reason = with_joints(reason, options.source)
        return Tuning(path, options.task, options.preset, "rejected", reason, seconds=watch.seconds)
    watch.lap("read")
    return tune_episode(episode, options, path, watch)


def tune_episode(
    episode: Episode, options: TuneOptions, path: Path = Path(), watch: Stopwatch | None = None
) -> Tuning:
    """Tune from an episode in memory, as `tune_log` does from a file."""
    if options.source is not None:
        from tunenet_logs.analysis.sysid.experiment import SimulatorExperiment

        experiment = SimulatorExperiment(options.source, path)
        episode = trim_clock_jumps(episode)
    else:
        if options.together is not None or options.hold_out is not None:
            what = "--together and --hold-out are about a model of one's own"
            raise UsageError(what, "name it with --model")
        episode = trim_clock_jumps(without_commands(episode))
        topic = options.topic
        kind = options.task or episode.info.kind
        if not kind:
            shown = kinds_in(episode, topic)
            if len(shown) > 1:
                choices = " or ".join(f"--task {name}" for name in shown)
                what = f"holds what may be a {' or a '.join(shown)}"
                raise UsageError(f"{path}: {what}; say {choices}")
            kind = next(iter(shown or kinds()))
        ways = experiments_of(kind)
        if not ways:
            known = " or ".join(f"--task {name}" for name in sorted(kinds()))
            reason = f"holds a {short_name(kind)!r}, which is not tuned; say what it shows: {known}"
            seconds = watch.seconds if watch else {}
            return Tuning(path, options.task, options.preset, "rejected", reason, seconds=seconds)
        # The first way that finds what it looks at; else the first, to say what it misses.
        experiment = next((way for way in ways if way.claim(episode, topic)), ways[0])

    def detect() -> Any:
        return experiment.detect(episode, options, options.preset)

    return tune_detected(experiment, detect, options, watch or Stopwatch(), path, episode)


def tune_detected(
    experiment: Experiment,
    detect: Callable[[], Any],
    options: TuneOptions,
    watch: Stopwatch,
    path: Path = Path(),
    episode: Episode | None = None,
) -> Tuning:
    """Tune to a detection: pose the problem, estimate, evaluate, check, judge."""
    if options.preset not in experiment.presets:
        known = ", ".join(experiment.presets)
        raise UsageError(f"{experiment.name} has no preset {options.preset!r}; there is: {known}")
    preset = experiment.presets[options.preset]
    method = method_named(options.method or preset.method)
    estimator = _built(preset, method, options)
    said = episode.warnings if episode else ()
    rejected = Tuning(
        path, experiment.kind, options.preset, "rejected", None, experiment, episode, warnings=said
    )
    initial = _initial(preset, method, options)
    detection = None
    try:
        detection = detect()
        problem = experiment.problem(detection, initial)
        watch.lap("observe")
        trace = estimator.estimate(problem, options.iterations)
        # Iterates without a rollout get one: what is checked was simulated and counted.
        steps = [
            step
            if step.evaluation is not None
            else Step(step.values, step.rollouts, problem.evaluate(step.values))
            for step in trace.steps
        ]
        trace = replace(trace, steps=tuple(steps))
    except (NotFoundError, LogError) as error:
        watch.lap("observe")
        return replace(
            rejected,
            reason=str(error).removeprefix(f"{path}: "),
            refused=detection,
            warnings=(*said, *unused_options(options, experiment, method, episode, None)),
            seconds=watch.seconds,
        )
    checks = experiment.checks(detection, trace.steps[-1], trace.fit)
    checks = (*log_checks(episode, detection.left_out), *checks) if episode else checks
    cross_check = experiment.cross_check(detection, trace.estimate)
    watch.lap("tune")
    verdict, reason = judge(checks, cross_check, experiment.occasion)
    unused = unused_options(options, experiment, method, episode, detection)
    return replace(
        rejected,
        verdict=verdict,
        reason=reason,
        detection=detection,
        trace=trace,
        parameters=problem.parameters,
        rollouts=problem.rollouts,
        cross_check=cross_check,
        checks=checks,
        warnings=(*said, *detection.warnings, *unused),
        simulator={
            "engine": problem.simulator.engine,
            "preset": options.preset,
            "step_hz": round(problem.simulator.step_hz, 3),
        },
        method=trace.method or method.name,
        digest=estimator.model.digest if estimator.model else "",
        seconds=watch.seconds,
    )


def _initial(preset: Preset, method: type[Estimator], options: TuneOptions) -> Array:
    """Return the user's initial values, completed by the defaults, shape (P,)."""
    parameters = preset.parameters[:1] if method.takes_one_parameter else preset.parameters
    given = list(options.initial or ())
    if len(given) > len(parameters):
        names = ", ".join(parameter.name for parameter in parameters)
        raise UsageError(f"{len(given)} initial values; at most one for each of: {names}")
    as_given = method.uses_network or preset.starts_as_given
    usual = [one.initial if as_given else sum(one.training_range) / 2 for one in parameters]
    return np.array([*given, *usual[len(given) :]])


def _built(preset: Preset, method: type[Estimator], options: TuneOptions) -> Estimator:
    """Build the method; weights are read only if it uses them."""
    if not method.uses_network or (preset.training is None and preset.starts_as_given):
        return method()  # without a network, or the problem trains its own
    if preset.training is None:
        raise UsageError(f"method {method.name} needs a network, which this task has not")
    purpose = preset.training.purpose
    if options.weights is not None:
        return method(load_model(options.weights, purpose))
    return method(shipped_model(purpose))
