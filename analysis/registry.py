"""Registry of experiments and estimation methods by name.

The entries are texts, so that a command can list the names without importing anything.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

from tunenet_logs.errors import UsageError, pip_install

if TYPE_CHECKING:
    from tunenet_logs.analysis.estimators.base import Estimator
    from tunenet_logs.analysis.experiment import Experiment
    from tunenet_logs.episode import Episode


# ---- Optional libraries: import one, or say how to install it.


def needed(module: str, extra: str = "eval") -> ModuleType:
    """Import an optional library, or say how to install it."""
    top = module.split(".", maxsplit=1)[0]
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != top:
            raise  # it is there, and lacks something of its own
        raise UsageError(f"{top} is not installed; {pip_install(extra)}") from error


# ---- Experiments and methods: name -> module:class.

# One kind of experiment may be observed in several ways: KIND-WAY.
EXPERIMENTS = {
    "drop": "tunenet_logs.analysis.drop.experiments:DropFromPositions",
    "drop-video": "tunenet_logs.analysis.drop.experiments:DropFromFilm",
    "drop-times": "tunenet_logs.analysis.drop.experiments:DropFromTimes",
    "payload": "tunenet_logs.analysis.payload.experiment:PayloadExperiment",
}

# The usual one first.
METHODS = {
    "tunenet+refine": "tunenet_logs.analysis.estimators.methods:TuneNetThenFit",
    "tunenet": "tunenet_logs.analysis.estimators.methods:TuneNet",
    "fit": "tunenet_logs.analysis.estimators.methods:ExactFit",
    "tunenet+line": "tunenet_logs.analysis.estimators.methods:TuneNetThenLine",
    "line": "tunenet_logs.analysis.estimators.methods:RolloutLine",
    "secant": "tunenet_logs.analysis.drop.presets:FlightSecant",
    "brent": "tunenet_logs.analysis.estimators.methods:Brent",
    "least-squares": "tunenet_logs.analysis.estimators.methods:LeastSquares",
    "tpe": "tunenet_logs.analysis.estimators.methods:Tpe",
    "cma-es": "tunenet_logs.analysis.estimators.methods:ScaledCmaEs",
}


def kinds() -> tuple[str, ...]:
    """List the kinds of experiments, as logs and `--task` name them."""
    return tuple(dict.fromkeys(name.partition("-")[0] for name in EXPERIMENTS))


def experiment_named(name: str) -> Experiment:
    """Import the experiment of that name in `EXPERIMENTS`."""
    return _loaded(EXPERIMENTS[name])()


def method_named(name: str) -> type[Estimator]:
    """Import the method of that name."""
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
