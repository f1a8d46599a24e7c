"""Who competes in the second experiment: the paper's methods, a user's, ours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from analysis.drop.flight_secant import Secant
from analysis.estimators.base import Estimator
from analysis.estimators.brent import Brent
from analysis.estimators.cma_es import CmaEs
from analysis.estimators.least_squares import LeastSquares
from analysis.estimators.tpe import Tpe
from analysis.estimators.tunenet import TuneNet
from analysis.evaluation.methods.constant import Constant
from analysis.evaluation.methods.direct import Direct
from analysis.evaluation.methods.entropy_search import EntropySearch
from analysis.tunenet.network import Model

MOST_ROLLOUTS = 100
"""As in the paper's table 2."""

_SECANT_ROLLOUTS = 10


@dataclass(frozen=True)
class Method:
    """A row of the table.

    Attributes:
        name: as JSON, CSV and `--methods` have it.
        label: as the table has it.
        group: whose it is.
        estimator: the method, ready to be asked.
        budget: rollouts after which it gives nothing new, or the most of the experiment.
        free_release: it is given the height of release as a second parameter to find.
    """

    name: str
    label: str
    group: Literal["paper", "user", "ours"]
    estimator: Estimator
    budget: int
    free_release: bool = False


def paper_methods(
    networks: Mapping[str, Model], mean: float, bins: tuple[float, float], seed: int
) -> tuple[Method, ...]:
    """The methods of the paper's table 2.

    Args:
        networks: "paper" and "paper-code", trained by those presets, and "direct", trained on
            `direct_pairs`.
        mean: of the test set's targets.
        bins: smallest and largest value that entropy search looks at.
        seed: of the methods that draw.
    """
    most = MOST_ROLLOUTS
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
    """What a user would pick who has no network; `seed` is of the methods that draw."""
    most = MOST_ROLLOUTS
    return (
        Method("secant", "Secant on the first flight", "user", Secant(), _SECANT_ROLLOUTS),
        Method("brent", "Brent", "user", Brent(), most),
        Method("least-squares", "Least squares, many starts", "user", LeastSquares(), most),
        Method("tpe", "TPE", "user", Tpe(seed), most),
    )
