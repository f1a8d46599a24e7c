"""Train the networks of the second experiment from one seed."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

from analysis.drop.presets import TRAININGS
from analysis.evaluation.drop.ablation import Antisymmetrised, DifferenceNetwork
from analysis.evaluation.drop.our_networks import train_on_calibrated, train_on_papers
from analysis.tunenet.network import Model, Network, PaperNetwork
from analysis.tunenet.pairs import PairSet
from analysis.tunenet.training import train
from tunenet_logs.terminal import Progress

Networks = Mapping[str, Model]  # by the names in `NETWORKS`
PAPER = "paper"
PAPER_CODE = "paper-code"
DIRECT = "direct"
DIFFERENCE = "difference"
ANTISYMMETRIC = "antisymmetric"
OURS = "ours"
OURS_CALIBRATED = "ours-calibrated"


@dataclass(frozen=True)
class _NetworkPlan:
    """Architecture, and the preset whose recipe trains it."""

    network: Network
    preset: str


_PLANS: Mapping[str, _NetworkPlan] = {
    PAPER: _NetworkPlan(PaperNetwork(), "paper"),
    PAPER_CODE: _NetworkPlan(PaperNetwork(), "paper-code"),
    DIRECT: _NetworkPlan(PaperNetwork(), "paper-code"),
    DIFFERENCE: _NetworkPlan(DifferenceNetwork(), "paper-code"),
    ANTISYMMETRIC: _NetworkPlan(Antisymmetrised(PaperNetwork()), "paper-code"),
}

_OURS = {OURS: train_on_papers, OURS_CALIBRATED: train_on_calibrated}

NETWORKS = (*_PLANS, *_OURS)


@dataclass(frozen=True)
class Effort:
    """Amount of training in place of the presets', to try things out.

    Attributes:
        pairs: training pairs.
        epochs: passes over them.
    """

    pairs: int | None = None
    epochs: int | None = None


def train_networks(
    wanted: Collection[str],
    seed: int,
    jobs: int | None,
    progress: Progress,
    effort: Effort | None = None,
) -> Networks:
    """Train the wanted networks; the paper's all on the same 800 pairs, ours on their own."""
    effort = effort or Effort()
    trained = {
        name: training(seed, jobs, progress, effort.epochs)
        for name, training in _OURS.items()
        if name in wanted
    }
    plans = {name: plan for name, plan in _PLANS.items() if name in wanted}
    if not plans:
        return trained
    pairs = TRAININGS["paper-code"].make_pairs(effort.pairs, seed, jobs, progress)
    for name, plan in plans.items():
        recipe = TRAININGS[plan.preset].recipe
        if effort.epochs is not None:
            recipe = replace(recipe, epochs=effort.epochs)
        trained[name] = train(plan.network, _seen(name, pairs), recipe, seed, progress)
    return trained


def _seen(name: str, pairs: PairSet) -> PairSet:
    """Return the pairs a network learns from."""
    if name != DIRECT:
        return pairs
    from analysis.evaluation.methods.direct import direct_pairs

    return direct_pairs(pairs)
