"""Train h on pairs (eq. 4 of the paper), by the paper's recipes or ours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.tunenet.network import Model, Network, Scaling, initial_weights
from analysis.tunenet.pairs import PairSet
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

if TYPE_CHECKING:
    import torch


# Share of an observation that a short recording may lack at its beginning: the fall.
_LATEST_BEGIN = 0.18


@dataclass(frozen=True)
class Recipe:
    """Hyperparameters of a training.

    Attributes:
        optimizer: "sgd" (no momentum) or "adamw" (one-cycle learning rate).
        learning_rate: At first ("sgd") or at most ("adamw").
        decay: Factor of the rate every `decay_epochs` ("sgd").
        weight_decay: L2 constant.
        loss: "squared", "norm" (unsquared, the paper's eq. 4), or "relative": squared, over
            (|residual| + 0.1)^2, so that small residuals count as they do in the last steps.
        scaling: "raw", "unit" (inputs and outputs to [0, 1]), "standard" (of inputs), or "ranges"
            (also each output by its parameter's range); "unit-inputs" and "z-score" scale each
            channel of the inputs alone.
        noise: Up to this standard deviation is added to o_T, in the observation's unit.
        cut_share: Share of pairs that begin late and end early, as a short recording does.
    """

    optimizer: str
    learning_rate: float
    weight_decay: float
    loss: str
    scaling: str
    epochs: int
    batch: int
    decay: float = 1.0
    decay_epochs: int = 1
    noise: float = 0.0
    cut_share: float = 0.0


def train(network: Network, pairs: PairSet, recipe: Recipe, seed: int, progress: Progress) -> Model:
    """Train a network with torch, on its default device.

    The same seed on the same machine gives the same weights.
    """
    import torch

    torch.set_num_threads(1)  # for networks this small, a second thread mostly waits for the first
    rng = np.random.default_rng(seed)
    scaling = _scaling(pairs, recipe.scaling)
    bank = (pairs.observations.reshape(len(pairs.values), -1) - scaling.input_offset) * (
        scaling.input_gain
    )
    shown = torch.from_numpy(np.isfinite(bank))
    complete = bool(shown.all())
    noise = float(np.mean(recipe.noise * scaling.input_gain))
    wanted = (pairs.residuals - scaling.output_offset) / scaling.output_gain
    outputs = wanted.shape[1]
    weights = {
        name: torch.tensor(value, dtype=torch.float32, requires_grad=True)
        for name, value in initial_weights(network, bank.shape[1], outputs, rng).items()
    }
    inputs = torch.tensor(np.nan_to_num(bank), dtype=torch.float32)
    residuals = torch.tensor(wanted, dtype=torch.float32)
    proposed, target = torch.from_numpy(pairs.proposed), torch.from_numpy(pairs.target)
    batches = int(np.ceil(len(proposed) / recipe.batch))
    optimizer, schedule = _optimizer(recipe, list(weights.values()), batches)
    generator = torch.Generator().manual_seed(seed)
    with progress.bar(recipe.epochs, "training", "epoch") as bar:
        for _ in range(recipe.epochs):
            order = torch.randperm(len(proposed), generator=generator)
            for chosen in order.split(recipe.batch):
                first, second = proposed[chosen], target[chosen]
                o_p, o_t = inputs.index_select(0, first), inputs.index_select(0, second)
                if not complete:
                    both = shown[first] & shown[second]  # as `Scaling.inputs` has it
                    o_p, o_t = o_p * both, o_t * both
                o_p, o_t = _augment(o_p, o_t, noise, recipe.cut_share, generator)
                found = network.residual(weights, o_p, o_t)
                loss = _loss(recipe.loss, found, residuals[chosen])
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                if recipe.optimizer == "adamw":
                    schedule.step()
            if recipe.optimizer == "sgd":
                schedule.step()
            bar.update(1)
    trained = {name: value.detach().numpy().astype(np.float64) for name, value in weights.items()}
    return Model(network, trained, scaling)


def one_step_error(model: Model, pairs: PairSet) -> float:
    """Return the mean absolute error of zeta_P + h(o_P, o_T) (K = 1 in the paper's table)."""
    found = model(pairs.observations[pairs.proposed], pairs.observations[pairs.target])
    return float(np.mean(np.abs(found - pairs.residuals)))


def _scaling(pairs: PairSet, how: str) -> Scaling:
    flat = pairs.observations.reshape(len(pairs.values), -1)
    none, one = np.zeros(1), np.ones(1)
    if how == "raw":
        return Scaling(none, one, none, one)
    if how in ("unit-inputs", "z-score"):
        return Scaling(*_by_channel(pairs.observations, how == "unit-inputs"), none, one)
    if how == "unit":
        low, high = np.array([np.nanmin(flat)]), np.array([np.nanmax(flat)])
        least, most = pairs.residuals.min(axis=0), pairs.residuals.max(axis=0)
        return Scaling(low, 1 / (high - low), least, most - least)
    spread = np.nanstd(flat, axis=0).mean()
    ranges = np.ptp(pairs.values, axis=0) if how == "ranges" else one
    return Scaling(np.nanmean(flat, axis=0), np.array([1 / spread]), none, ranges)


def _by_channel(observations: Array, to_unit: bool) -> tuple[Array, Array]:
    """Return offset and gain of each input, one pair per channel."""
    if to_unit:
        offset = np.nanmin(observations, axis=(0, 1))
        spread = np.nanmax(observations, axis=(0, 1)) - offset
    else:
        offset, spread = np.nanmean(observations, axis=(0, 1)), np.nanstd(observations, axis=(0, 1))
    length = observations.shape[1]
    return np.tile(offset, length), np.tile(1 / np.maximum(spread, 1e-12), length)


def _optimizer(recipe: Recipe, weights: list[torch.Tensor], batches: int) -> tuple[Any, Any]:
    import torch
    from torch.optim.lr_scheduler import OneCycleLR, StepLR

    settings: dict[str, Any] = {"lr": recipe.learning_rate, "weight_decay": recipe.weight_decay}
    if recipe.optimizer == "sgd":
        sgd = torch.optim.SGD(weights, **settings)
        return sgd, StepLR(sgd, step_size=recipe.decay_epochs, gamma=recipe.decay)
    adamw = torch.optim.AdamW(weights, **settings)
    steps = recipe.epochs * batches
    return adamw, OneCycleLR(adamw, max_lr=recipe.learning_rate, total_steps=steps)


def _augment(
    proposed: torch.Tensor,
    target: torch.Tensor,
    noise: float,
    cut_share: float,
    generator: torch.Generator,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Augment with noise on the target, and with late begins and early ends (0 in both)."""
    import torch

    count, length = target.shape
    if noise:
        sd = noise * torch.rand(count, 1, generator=generator) ** 2
        target = target + sd * torch.randn(count, length, generator=generator)
    if cut_share:
        cut = torch.rand(count, 1, generator=generator) < cut_share
        end = 0.25 + 0.75 * torch.rand(count, 1, generator=generator)
        begin = _LATEST_BEGIN * torch.rand(count, 1, generator=generator)
        places = torch.arange(length)
        seen = ~cut | ((places < end * length) & (places >= begin * length))
        proposed, target = proposed * seen, target * seen
    return proposed, target


def _loss(kind: str, found: torch.Tensor, wanted: torch.Tensor) -> torch.Tensor:
    off = found - wanted
    if kind == "squared":
        return (off**2).mean()
    if kind == "norm":
        return off.norm(dim=1).mean()
    return ((off / (wanted.abs() + 0.1)) ** 2).mean()
