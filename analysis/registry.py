"""Registry of experiments and estimation methods by name.

The entries are texts, so that a command can list the names without importing anything.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

from tunenet_logs.errors import UsageError

if TYPE_CHECKING:
    from analysis.estimators.base import Estimator
    from analysis.experiment import Experiment
    from tunenet_logs.episode import Episode

# Name -> module:class. One kind of experiment may be observed in several ways: KIND-WAY.
EXPERIMENTS = {
    "drop": "analysis.drop.from_positions:DropFromPositions",
    "drop-video": "analysis.drop.from_film:DropFromFilm",
    "drop-times": "analysis.drop.from_times:DropFromTimes",
    "payload": "analysis.payload.experiment:PayloadExperiment",
}

# Name -> module:class, the usual one first.
METHODS = {
    "tunenet+refine": "analysis.estimators.tunenet:TuneNetThenFit",
    "tunenet": "analysis.estimators.tunenet:TuneNet",
    "fit": "analysis.estimators.tunenet:ExactFit",
    "tunenet+line": "analysis.estimators.rollout_line:TuneNetThenLine",
    "line": "analysis.estimators.rollout_line:RolloutLine",
    "secant": "analysis.drop.flight_secant:FlightSecant",
    "brent": "analysis.estimators.brent:Brent",
    "least-squares": "analysis.estimators.least_squares:LeastSquares",
    "tpe": "analysis.estimators.tpe:Tpe",
    "cma-es": "analysis.estimators.cma_es:ScaledCmaEs",
}


def kinds() -> tuple[str, ...]:
    """List the kinds of experiments, as logs and `--task` name them."""
    return tuple(dict.fromkeys(name.partition("-")[0] for name in EXPERIMENTS))


def experiment_named(name: str) -> Experiment:
    """Import the experiment of that name in `EXPERIMENTS`."""
    return _loaded(EXPERIMENTS[name])()


def method_named(name: str) -> type[Estimator]:
    """Import the method of that name.

    Raises:
        UsageError: There is none; the message lists those that exist.
    """
    if name not in METHODS:
        raise UsageError(f"there is no method {name!r}; choose one of: {', '.join(METHODS)}")
    return _loaded(METHODS[name])


def experiments_of(kind: str) -> tuple[Experiment, ...]:
    """List all ways of observing one kind of experiment; none if the kind is unknown."""
    return tuple(experiment_named(name) for name in EXPERIMENTS if name.partition("-")[0] == kind)


def kinds_in(episode: Episode, topic: str | None) -> tuple[str, ...]:
    """Return the kinds whose claim on an episode is the strongest."""
    claims = {
        kind: max(way.claim(episode, topic) for way in experiments_of(kind)) for kind in kinds()
    }
    best = max(claims.values())
    return tuple(kind for kind, claim in claims.items() if claim and claim == best)


@cache
def _loaded(where: str) -> Any:
    module, _, name = where.partition(":")
    return getattr(import_module(module), name)
