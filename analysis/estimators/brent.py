"""Brent's method on the cost: a baseline for one parameter."""

from __future__ import annotations

from analysis.estimators.base import Estimator, Problem, Trace
from analysis.estimators.search import Search, check_one_parameter

_CLOSE = 1e-6


class Brent(Estimator):
    """Bounded Brent search (golden section and parabolic steps) over one parameter's range.

    It ignores the initial guess, and finds one local minimum of the cost: there are dozens.
    """

    name = "brent"
    takes_one_parameter = True

    def estimate(self, problem: Problem, rollouts: int) -> Trace:
        """Return the best rollout so far; see `Estimator.estimate`."""
        from scipy.optimize import minimize_scalar

        check_one_parameter(problem, self.name)
        search = Search(problem, rollouts)
        options = {"xatol": _CLOSE, "maxiter": max(rollouts, 1)}
        return search.run(
            lambda: minimize_scalar(
                search.cost, bounds=problem.ranges[0], method="bounded", options=options
            )
        )
