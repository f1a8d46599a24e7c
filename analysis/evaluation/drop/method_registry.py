"""Register the methods of the second experiment: the paper's, a user's, ours.

Each by name, and with what it needs: networks that are trained for it, optional libraries.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from analysis.drop.flight_secant import FlightSecant
from analysis.estimators.base import Estimator
from analysis.estimators.brent import Brent
from analysis.estimators.least_squares import LeastSquares
from analysis.estimators.rollout_line import TuneNetThenLine
from analysis.estimators.tpe import Tpe
from analysis.estimators.tunenet import TuneNet
from analysis.evaluation.drop import networks as nets
from analysis.evaluation.drop.networks import Networks
from analysis.evaluation.methods.cma_es import CmaEs
from analysis.evaluation.methods.constant import Constant
from analysis.evaluation.methods.direct import Direct
from analysis.evaluation.methods.entropy_search import EntropySearch
from analysis.evaluation.methods.neural_posterior import NeuralPosterior, Posterior
from analysis.optional_dependencies import needed
from analysis.tunenet.network import Model
from tunenet_logs.arrays import Array
from tunenet_logs.errors import UsageError

# On the paper's simulator; on the calibrated one; the parts of the network compared.
Table = Literal["paper", "calibrated", "ablation"]

Group = Literal["paper", "user", "ours"]  # whose a method is
# The method that has a posterior, see `train_posteriors`; only on the paper's simulator.
NPE = "npe"

MAX_ROLLOUTS = 100  # rollouts a target: the last column of the paper's table 2
_SECANT_ROLLOUTS = 10
# Rollouts after which the secant and our fits have converged, and give nothing new.
_OUR_ROLLOUTS = 40


@dataclass(frozen=True)
class Method:
    """Method to compare, a row of the table.

    Attributes:
        name: as JSON, CSV and `--methods` have it.
        label: as the table has it.
        group: whose it is.
        estimator: the method, ready to estimate.
        budget: rollouts after which it gives nothing new, or the most of the experiment.
        free_release: it is given the height of release as a second parameter to find.
    """

    name: str
    label: str
    group: Group
    estimator: Estimator
    budget: int
    free_release: bool = False


@dataclass(frozen=True)
class _Needs:
    """Requirements of a method: networks of `networks.NETWORKS`, and optional libraries."""

    networks: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()


_ABLATION = {
    "concatenation": _Needs((nets.PAPER_CODE,)),
    "difference": _Needs((nets.DIFFERENCE,)),
    "antisymmetric": _Needs((nets.ANTISYMMETRIC,)),
}
_ABLATION_LABELS = {
    "concatenation": "Side by side (the paper's)",
    "difference": "Difference",
    "antisymmetric": "Side by side, antisymmetric",
}
_ALL: Mapping[str, _Needs] = {
    "mean": _Needs(),
    "entropy-search": _Needs(libraries=("sklearn",)),
    "cma-es": _Needs(libraries=("cma",)),
    "direct": _Needs((nets.DIRECT,)),
    "tunenet-paper": _Needs((nets.PAPER,)),
    "tunenet-paper-code": _Needs((nets.PAPER_CODE,)),
    "secant": _Needs(),
    "brent": _Needs(),
    "least-squares": _Needs(),
    "tpe": _Needs(libraries=("optuna",)),
    NPE: _Needs(libraries=("sbi",)),
    "network": _Needs((nets.OURS, nets.OURS_CALIBRATED)),
    "ours": _Needs((nets.OURS, nets.OURS_CALIBRATED)),
    **_ABLATION,
}

NAMES = tuple(_ALL)  # what `--methods` takes, in the order of the tables


@dataclass(frozen=True)
class MethodRegistry:
    """Chosen methods and their requirements.

    Attributes:
        names: of those chosen.
        networks: to be trained for them, see `train_networks`.
    """

    names: tuple[str, ...]
    networks: frozenset[str]

    @property
    def has_curves(self) -> bool:
        """Whether the figure has anything to show: the ablation is a table only."""
        return not _ABLATION.keys() >= set(self.names)

    @property
    def has_posteriors(self) -> bool:
        """Whether neural posteriors are to be trained for them."""
        return NPE in self.names

    def methods(
        self,
        table: Table,
        networks: Networks,
        truths: Array,
        seed: int,
        posterior: Posterior | None = None,
    ) -> list[Method]:
        """Return the chosen methods of one table, ready to estimate.

        Args:
            table: which one.
            networks: by name, trained.
            truths: true restitutions of the cell's targets, shape (N,). Only two of the paper's
                baselines look at them, as its authors' do: the mean, and the range that entropy
                search covers.
            seed: of the methods that draw.
            posterior: for the noise of the cell's targets, trained; None where it is not wanted.
        """
        if table == "ablation":
            compared = _ablation_methods(networks)
        elif table == "calibrated":
            compared = [*user_methods(seed), *_our_methods(networks.get(nets.OURS_CALIBRATED))]
        else:
            trained: dict[str, Any] = {name: networks.get(name) for name in nets.NETWORKS}
            bins = (float(truths.min()), float(truths.max()))
            compared = [
                *paper_methods(trained, float(truths.mean()), bins, seed),
                *user_methods(seed),
            ]
            if posterior is not None:
                estimator = NeuralPosterior(posterior)
                compared.append(Method(NPE, "Neural posterior (sbi)", "user", estimator, 0))
            compared += _our_methods(networks.get(nets.OURS))
        return [method for method in compared if method.name in self.names]


def choose_methods(names: Iterable[str] | None) -> MethodRegistry:
    """Select methods by name; all for None.

    Raises:
        UsageError: a name is unknown, or a library is not installed.
    """
    wanted = set(NAMES if names is None else names)
    for name in sorted(wanted.difference(NAMES)):
        raise UsageError(f"there is no method {name!r}; there is: {', '.join(NAMES)}")
    chosen = {name: needs for name, needs in _ALL.items() if name in wanted}
    networks = frozenset(network for needs in chosen.values() for network in needs.networks)
    libraries = {library for needs in chosen.values() for library in needs.libraries}
    for library in sorted(libraries | {"torch"} if networks else libraries):
        needed(library)
    return MethodRegistry(tuple(chosen), networks)


def paper_methods(
    networks: Mapping[str, Model], mean: float, bins: tuple[float, float], seed: int
) -> tuple[Method, ...]:
    """Return the methods of the paper's table 2.

    Args:
        networks: "paper" and "paper-code", trained by those presets, and "direct", trained on
            `direct_pairs`.
        mean: of the test set's targets.
        bins: smallest and largest value that entropy search looks at.
        seed: of the methods that draw.
    """
    most = MAX_ROLLOUTS
    text, code = TuneNet(networks["paper"]), TuneNet(networks["paper-code"])
    cma = CmaEs(seed)
    entropy = EntropySearch(bins, seed)
    return (
        Method("mean", "Mean", "paper", Constant(mean), 0),
        Method("entropy-search", "Entropy search", "paper", entropy, most),
        Method("cma-es", "CMA-ES", "paper", cma, most, free_release=True),
        Method("direct", "Direct prediction", "paper", Direct(networks["direct"]), 0),
        Method("tunenet-paper", "TuneNet, the paper's text", "paper", text, most),
        Method("tunenet-paper-code", "TuneNet, its authors' code", "paper", code, most),
    )


def user_methods(seed: int) -> tuple[Method, ...]:
    """Return what a user without a network would pick; `seed` is of the methods that draw."""
    most = MAX_ROLLOUTS
    return (
        Method("secant", "Secant on the first flight", "user", FlightSecant(), _SECANT_ROLLOUTS),
        Method("brent", "Brent", "user", Brent(), most),
        Method("least-squares", "Least squares, many starts", "user", LeastSquares(), most),
        Method("tpe", "TPE", "user", Tpe(seed), most),
    )


def _our_methods(network: Model | None) -> list[Method]:
    """Return our methods, by the network for the cell's simulator; none without one."""
    if network is None:
        return []
    return [
        Method("network", "Our network alone", "ours", TuneNet(network), MAX_ROLLOUTS),
        Method("ours", "Our network, then fits", "ours", TuneNetThenLine(network), _OUR_ROLLOUTS),
    ]


def _ablation_methods(networks: Networks) -> list[Method]:
    return [
        Method(name, _ABLATION_LABELS[name], "paper", TuneNet(networks[network]), MAX_ROLLOUTS)
        for name, needs in _ABLATION.items()
        for network in needs.networks
        if network in networks
    ]
