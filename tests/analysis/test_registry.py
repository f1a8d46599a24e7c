"""A new estimator and a new experiment are a file each and a line: here both are made and run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import record, tune_all
from tunenet_logs.analysis.checks import Check, CrossCheck
from tunenet_logs.analysis.estimators.base import (
    Estimator,
    FitResult,
    Observation,
    Problem,
    Step,
    Trace,
)
from tunenet_logs.analysis.experiment import Claim, Preset
from tunenet_logs.analysis.options import Subject, TuneOptions
from tunenet_logs.analysis.record import Motion, Rebound, read_record, to_json
from tunenet_logs.analysis.registry import EXPERIMENTS, METHODS, experiment_named, method_named
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)


class Halving(Estimator):
    """Bisection on the sum of the misfit: a method of somebody's own."""

    name = "halving"

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """See `Estimator.estimate`."""
        low, high = (
            np.array(ends) for ends in zip(*(p.bounds for p in problem.parameters), strict=True)
        )
        steps = [Step(problem.initial, 0)]
        for _ in range(rollouts):
            middle = (low + high) / 2
            evaluation = problem.evaluate(middle)
            if problem.misfit(evaluation).sum() > 0:
                high = middle
            else:
                low = middle
            steps.append(Step(middle, problem.rollouts, evaluation))
        return Trace(tuple(steps))


RATE = Parameter("decay_rate", "1/s", (0.0, 10.0), (0.0, 10.0), 5.0)
SECONDS = np.arange(50) / 25


class DecaySimulator:
    """A cup of tea that cools: exp(-rate t)."""

    parameters = (RATE,)
    engine = "closed form"
    step_hz = 25.0

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """See `Simulator.rollout`."""
        return tea(RATE.checked(values[RATE.name]))


def tea(rate: float) -> Episode:
    stamps_ns = np.round(SECONDS * 1e9).astype(np.int64)
    values = np.exp(-rate * SECONDS)[:, None]
    return Episode(
        EpisodeInfo(kind="tea"), {"/tea": Signal("/tea", stamps_ns, values, ("x",), "K")}
    )


class TeaDetection:
    """The whole signal."""

    topic, warnings, left_out = "/tea", (), ()
    window: Mapping[str, float] = {"start_s": 0.0, "end_s": 1.96}
    extent = ("cooling", "2 s")

    def __init__(self, values: Array) -> None:
        self.values = values


class TeaExperiment:
    """An experiment without a network: no weights are needed for it."""

    name = kind = "tea"
    occasion = "cup"
    observed = "temperatures of a cup"
    accepted_options: frozenset[Subject] = frozenset()
    presets: Mapping[str, Preset] = {"default": Preset(True, (RATE,), method="brent")}

    def claim(self, episode: Episode, topic: str | None) -> Claim:
        """See `Experiment.claim`."""
        return Claim.CERTAIN if "/tea" in episode.signals else Claim.NONE

    def detect(self, episode: Episode, selection: TuneOptions, preset: str) -> TeaDetection:
        """See `Experiment.detect`."""
        if "/tea" not in episode.signals:
            raise NotFoundError("no tea in it")
        return TeaDetection(episode.signals["/tea"].values)

    def problem(self, detection: TeaDetection, initial: Array) -> Problem:
        """See `Experiment.problem`."""

        def observe(episode: Episode) -> Observation:
            return Observation(episode.signals["/tea"].values.copy(), SECONDS, "t [s]", ("T",))

        target = Observation(detection.values.copy(), SECONDS, "t [s]", ("T",))
        return Problem(target, DecaySimulator(), observe, initial)

    def checks(
        self, detection: TeaDetection, last: Step, fit: FitResult | None
    ) -> tuple[Check, ...]:
        """See `Experiment.checks`."""
        return (Check("cools", bool(last.values[0] > 0), f"{last.values[0]:.2f} 1/s"),)

    def cross_check(self, detection: TeaDetection, estimate: Array) -> CrossCheck | None:
        """See `Experiment.cross_check`."""

    def motion(self, detection: TeaDetection, trace: Trace) -> Motion | None:
        """See `Experiment.motion`."""

    def rebounds(self, detection: TeaDetection, trace: Trace) -> tuple[Rebound, ...]:
        """See `Experiment.rebounds`."""
        return ()

    def review(self, stream, tuning):
        """See `Experiment.review`."""
        import rerun.blueprint as rrb

        return rrb.Horizontal(rrb.TextDocumentView(origin="/result"))


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_is_there_under_its_name(name: str):
    experiment = experiment_named(name)
    assert experiment.name == name
    assert experiment.kind == name.partition("-")[0]
    for preset in experiment.presets.values():
        assert preset.method in METHODS


@pytest.mark.parametrize("name", METHODS)
def test_every_method_is_there_under_its_name(name: str):
    assert method_named(name).name == name


def test_a_new_estimator_is_one_line(monkeypatch: pytest.MonkeyPatch, drop_log: Path):
    monkeypatch.setitem(METHODS, "halving", f"{__name__}:Halving")
    tuning = tune_log(drop_log, TuneOptions(method="halving", iterations=3))
    assert tuning.method == "halving"
    assert tuning.rollouts == 4  # the initial guess is simulated too, to be shown
    assert tuning.interval95 is None


def test_a_new_experiment_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    from tunenet_logs.analysis.experiment import record_of
    from tunenet_logs.analysis.review.tuning import write_review

    monkeypatch.setitem(EXPERIMENTS, "tea", f"{__name__}:TeaExperiment")
    tuning = tune_episode(tea(3.0), TuneOptions(iterations=40))
    assert tuning.verdict == "ok"
    assert tuning.estimate is not None
    assert tuning.estimate[0] == pytest.approx(3.0, abs=1e-3)
    made = record_of(tuning)
    (tmp_path / "tea.json").write_text(to_json(made))
    again = read_record(tmp_path / "tea.json")
    assert again.task == "tea"
    assert again.estimates == made.estimates
    write_review(tuning, made, tmp_path / "tea.rrd")
    assert (tmp_path / "tea.rrd").stat().st_size > 1000
    with pytest.raises(UsageError, match="needs a network"):
        tune_episode(tea(2.0), TuneOptions(method="tunenet+line"))


@pytest.mark.parametrize(
    ("method", "said"),
    [
        ("secant", "it is for drops"),
        ("line", None),
        ("brent", None),
        ("least-squares", None),
    ],
)
def test_methods_are_offered_as_far_as_they_fit(
    monkeypatch: pytest.MonkeyPatch, method: str, said: str | None
):
    monkeypatch.setitem(EXPERIMENTS, "tea", f"{__name__}:TeaExperiment")
    tuning = tune_episode(tea(3.0), TuneOptions(method=method, iterations=40))
    if said is None:
        assert tuning.estimate is not None
        assert tuning.estimate[0] == pytest.approx(3.0, abs=0.01)
    else:
        assert tuning.verdict == "rejected"
        assert said in (tuning.reason or "")


@pytest.mark.parametrize("method", METHODS)
def test_every_method_answers_a_drop(drop_log: Path, method: str):
    if method == "tpe":
        pytest.importorskip("optuna")
    tuning = tune_log(drop_log, TuneOptions(method=method, iterations=12))
    assert tuning.trace is not None, tuning.reason
    exact = method in ("tunenet+refine", "tunenet", "fit", "tunenet+line", "line", "secant")
    assert abs(float(tuning.trace.estimate[0]) - 0.7) < (1e-3 if exact else 0.25)
    assert (tuning.trace.fit is not None) == (method in ("tunenet+refine", "fit"))


def test_the_exact_fit_needs_no_network_and_no_start(drop_log: Path):
    both, alone, far = (
        tune_log(drop_log, options)
        for options in (
            TuneOptions(),
            TuneOptions(method="fit"),
            TuneOptions(method="fit", initial=(0.2,)),
        )
    )
    assert alone.digest == ""
    assert alone.rollouts == 2
    for tuning in (alone, far):
        assert tuning.estimate == pytest.approx(both.estimate, abs=1e-6)


def test_weights_that_a_method_does_not_use_are_said(drop_log: Path):
    tuning = tune_log(drop_log, TuneOptions(method="fit", weights=drop_log))
    assert "--weights not used: the method fit has no network" in tuning.warnings


def test_a_log_that_a_method_does_not_fit_never_stops_the_others(tmp_path: Path):
    good = record(tmp_path / "a.mcap", restitution=0.6, height_m=1.0)
    arm = Path(__file__).resolve().parents[2] / "sample_logs" / "payload.mcap"
    results = tune_all([arm, good], TuneOptions(method="secant"), tmp_path / "out", 1, QUIET)
    assert [result.row.record.verdict for result in results][1] != "rejected"
    assert "it is for drops" in (results[0].row.record.reason or "")
