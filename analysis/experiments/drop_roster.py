"""Who may compete in the second experiment, by name, and what each needs for it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.estimators.tunenet import TuneNet
from analysis.experiments import drop_networks as nets
from analysis.experiments.drop_methods import Method
from analysis.experiments.drop_networks import Networks
from analysis.experiments.extras import needed
from analysis.experiments.results import Experiment
from tunenet_logs.errors import UsageError

Array = NDArray[np.float64]
Make = Callable[[Networks, Array], Method]
"""From the seed's networks and the true restitutions of a cell's targets, shape (targets,).

Only the mean of the test set, one of the paper's baselines, looks at the latter.
"""

_ITERATIONS = 100


@dataclass(frozen=True)
class Entrant:
    """A method before there are networks.

    Attributes:
        name: of the `Method`.
        make: the method itself.
        networks: of `drop_networks.NETWORKS`, what it needs.
        libraries: optional ones that it needs.
        experiment: in which table it competes.
        calibrated: for the calibrated simulator, not the paper's.
    """

    name: str
    make: Make
    networks: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()
    experiment: Experiment = "drop"
    calibrated: bool = False


def _tunenet(
    name: str, label: str, network: str, experiment: Experiment = "drop"
) -> Entrant:
    def make(networks: Networks, _: Array) -> Method:
        return Method(name, label, "paper", TuneNet(networks[network]), _ITERATIONS)

    return Entrant(name, make, (network,), experiment=experiment)


_ENTRANTS = (
    _tunenet("tunenet-paper", "TuneNet, paper's text", nets.PAPER),
    _tunenet("tunenet-paper-code", "TuneNet, authors' code", nets.PAPER_CODE),
    _tunenet("concatenation", "both outputs (the paper's)", nets.PAPER_CODE, "ablation"),
    _tunenet("difference", "their difference", nets.DIFFERENCE, "ablation"),
    _tunenet("antisymmetric", "both, antisymmetric", nets.ANTISYMMETRIC, "ablation"),
)

NAMES = tuple(dict.fromkeys(one.name for one in _ENTRANTS))


def entrants(names: Iterable[str] | None) -> tuple[Entrant, ...]:
    """Those named, in the order of the tables; all for None.

    Raises:
        UsageError: a name is unknown, or a library is not installed.
    """
    wanted = set(NAMES if names is None else names)
    for name in sorted(wanted.difference(NAMES)):
        raise UsageError(f"no method {name!r}; there is: {', '.join(NAMES)}")
    chosen = tuple(one for one in _ENTRANTS if one.name in wanted)
    for library in sorted({library for one in chosen for library in one.libraries}):
        needed(library)
    return chosen
