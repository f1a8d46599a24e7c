"""Who competes in the second experiment, by name, and what each needs for it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from analysis.estimators.tunenet import TuneNet
from analysis.estimators.tunenet_line import TuneNetLine
from analysis.evaluation import drop_networks as nets
from analysis.evaluation.drop_methods import Method
from analysis.evaluation.drop_networks import Networks
from analysis.evaluation.methods.neural_posterior import NeuralPosterior, Posterior
from analysis.optional_dependencies import needed
from analysis.tunenet.network import Model
from tunenet_logs.arrays import Array
from tunenet_logs.errors import UsageError

Table = Literal["paper", "calibrated", "ablation"]
"""On the paper's simulator; on the calibrated one; what the parts of the network are worth."""


NPE = "npe"
"""The method that has a posterior, see `train_posteriors`; only on the paper's simulator."""


@dataclass(frozen=True)
class _Needs:
    """What a method takes: networks of `drop_networks.NETWORKS`, and optional libraries."""

    networks: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()


_PAPERS = {
    "mean": _Needs(),
    "entropy-search": _Needs(libraries=("sklearn",)),
    "cma-es": _Needs(libraries=("cma",)),
    "direct": _Needs((nets.DIRECT,)),
    "tunenet-paper": _Needs((nets.PAPER,)),
    "tunenet-paper-code": _Needs((nets.PAPER_CODE,)),
}
_USERS = {
    "secant": _Needs(),
    "brent": _Needs(),
    "least-squares": _Needs(),
    "tpe": _Needs(libraries=("optuna",)),
    NPE: _Needs(libraries=("sbi",)),
}
_OURS = {
    "network": _Needs((nets.OURS, nets.OURS_CALIBRATED)),
    "ours": _Needs((nets.OURS, nets.OURS_CALIBRATED)),
}
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
_ALL: Mapping[str, _Needs] = {**_PAPERS, **_USERS, **_OURS, **_ABLATION}

NAMES = tuple(_ALL)
"""What `--methods` takes, in the order of the tables."""

_ITERATIONS = 100
_OUR_ROLLOUTS = 40


@dataclass(frozen=True)
class Roster:
    """Those chosen, and what they need.

    Attributes:
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
        """Those of one table, ready.

        Args:
            table: which one.
            networks: by name, trained.
            truths: true restitutions of the cell's targets. Only two of the paper's baselines look
                at them, as its authors' do: the mean, and the range that entropy search covers.
            seed: of the methods that draw.
            posterior: for the noise of the cell's targets, trained; None where it is not wanted.
        """
        everyone = {
            "paper": lambda: _competitors(networks, truths, seed, posterior),
            "calibrated": lambda: _on_calibrated(networks, seed),
            "ablation": lambda: _ablation(networks),
        }[table]()
        return [method for method in everyone if method.name in self.names]


def roster(names: Iterable[str] | None) -> Roster:
    """Those named; all for None.

    Raises:
        UsageError: a name is unknown, or a library is not installed.
    """
    wanted = set(NAMES if names is None else names)
    for name in sorted(wanted.difference(NAMES)):
        raise UsageError(f"there is no method {name!r}; there is: {', '.join(NAMES)}")
    chosen = {name: needs for name, needs in _ALL.items() if name in wanted}
    for library in sorted({one for needs in chosen.values() for one in needs.libraries}):
        needed(library)
    networks = frozenset(one for needs in chosen.values() for one in needs.networks)
    return Roster(tuple(chosen), networks)


def _competitors(
    networks: Networks, truths: Array, seed: int, posterior: Posterior | None
) -> list[Method]:
    from analysis.evaluation.drop_methods import paper_methods, user_methods

    trained: dict[str, Any] = {name: networks.get(name) for name in nets.NETWORKS}
    bins = (float(truths.min()), float(truths.max()))
    papers = paper_methods(trained, float(truths.mean()), bins, seed)
    users = [*user_methods(seed), *_neural(posterior)]
    return [*papers, *users, *_ours(networks.get(nets.OURS))]


def _on_calibrated(networks: Networks, seed: int) -> list[Method]:
    from analysis.evaluation.drop_methods import user_methods

    return [*user_methods(seed), *_ours(networks.get(nets.OURS_CALIBRATED))]


def _neural(posterior: Posterior | None) -> list[Method]:
    """A library's posterior, of whoever has no network of ours; none where it was not chosen."""
    if posterior is None:
        return []
    return [Method(NPE, "Neural posterior (sbi)", "user", NeuralPosterior(posterior), 0)]


def _ours(network: Model | None) -> list[Method]:
    """Ours, by the network for the cell's simulator; none where neither was chosen."""
    if network is None:
        return []
    return [
        Method("network", "Our network alone", "ours", TuneNet(network), _ITERATIONS),
        Method("ours", "Our network, then fits", "ours", TuneNetLine(network), _OUR_ROLLOUTS),
    ]


def _ablation(networks: Networks) -> list[Method]:
    return [
        Method(name, _ABLATION_LABELS[name], "paper", TuneNet(networks[network]), _ITERATIONS)
        for name, needs in _ABLATION.items()
        for network in needs.networks
        if network in networks
    ]
