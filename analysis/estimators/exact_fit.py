"""The experiment's exact fit, alone or after the network's steps."""

from __future__ import annotations

from dataclasses import replace

from analysis.estimators.base import Estimator, Problem, Setup, Step, Trace
from analysis.estimators.tunenet import TuneNet
from tunenet_logs.errors import NotFoundError


class ExactFit(Estimator):
    """Fits the closed-form model to every sample, from the middle of the parameters' ranges."""

    name = "fit"

    def estimate(self, problem: Problem, rollouts: int) -> Trace:  # noqa: ARG002 (needs none)
        """No rollout; see `Estimator.estimate`."""
        trace = fitted(Trace((Step(problem.initial, problem.rollouts),)), problem)
        if trace.fit is None:
            raise NotFoundError("the log shows too little for the exact fit; try --method tunenet")
        return trace


class TuneNetThenFit(Estimator):
    """TuneNet's steps, then the exact fit from where they end."""

    name = "tunenet+refine"
    uses_network = True

    def __init__(self, network: TuneNet) -> None:
        self._network = network

    @classmethod
    def build(cls, setup: Setup) -> TuneNetThenFit:
        """See `Estimator.build`."""
        return cls(TuneNet.build(setup))

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """All rollouts are the network's; see `Estimator.estimate`."""
        trace = fitted(self._network.estimate(problem, rollouts), problem)
        return trace if trace.fit is not None else replace(trace, method=TuneNet.name)


def fitted(trace: Trace, problem: Problem) -> Trace:
    """A trace that goes on to the exact fit near its estimate; the same where the fit fails.

    Raises:
        NotFoundError: the problem has no exact fit.
    """
    if problem.exact_fit is None:
        raise NotFoundError("no exact fit exists under this preset; use --method tunenet")
    fit = problem.exact_fit(trace.estimate)
    if fit is None:
        return trace
    return Trace((*trace.steps, Step(fit.values, problem.rollouts)), fit)
