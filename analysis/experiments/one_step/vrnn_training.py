"""Trains the VRNN hybrid: the evidence lower bound, along the drops, a piece at a time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from analysis.experiments.one_step.data import EngineStep, Transitions
from analysis.experiments.one_step.layers import (
    Weights,
    as_arrays,
    as_tensors,
    first_weights,
    one_thread,
)
from analysis.experiments.one_step.vrnn import Scales, Sizes, VrnnHybrid, gaussian, remember
from tunenet_logs.progress import Progress

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class VrnnRecipe:
    """How the network is trained: Adam, one cycle of the learning rate.

    The whole of it takes half a minute on one core. Twice the epochs, a finer `least_deviation`
    and half the batch all leave the figures where they are, to a twentieth: what is left is the
    impact of a ball that the network does not know yet.

    Attributes:
        piece: steps along which gradients flow; the memory is carried on from piece to piece.
        batch: drops at a time.
        least_deviation: of the decoder, in standard deviations of the residual.
        most_gradient: its norm is clipped there.
    """

    sizes: Sizes = field(default_factory=Sizes)
    epochs: int = 10
    batch: int = 100
    piece: int = 100
    learning_rate: float = 5e-3
    least_deviation: float = 0.01
    most_gradient: float = 1.0


def train_vrnn(drops: Transitions, recipe: VrnnRecipe, seed: int, progress: Progress) -> VrnnHybrid:
    """Train on whole drops.

    Args:
        drops: the true states and what the simulator made of them.
        recipe: how.
        seed: of first weights, order and samples of z; the same one gives the same network.
        progress: shows the epochs.
    """
    import torch

    scales = Scales.of(drops)
    residuals = scales.scaled(drops.states[:, 1:] - drops.simulated)
    conditions = scales.condition(drops.states[:, :-1], drops.simulated)
    # Time first: a step of all drops is then one block of memory.
    seen = torch.tensor(residuals.swapaxes(0, 1), dtype=torch.float32)
    given = torch.tensor(conditions.swapaxes(0, 1), dtype=torch.float32)
    rng = np.random.default_rng(seed)
    weights = as_tensors(first_weights(recipe.sizes.layers(), rng))
    optimizer = torch.optim.Adam(weights.values())
    count, steps = seen.shape[1], seen.shape[0]
    updates = int(np.ceil(count / recipe.batch) * np.ceil(steps / recipe.piece))
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, recipe.learning_rate, total_steps=recipe.epochs * updates
    )
    generator = torch.Generator().manual_seed(seed)
    with one_thread(), progress.bar(recipe.epochs, "training VRNN hybrid", "epoch") as bar:
        for _ in range(recipe.epochs):
            for chosen in torch.randperm(count, generator=generator).split(recipe.batch):
                memory = torch.zeros(len(chosen), recipe.sizes.memory)
                for at in range(0, steps, recipe.piece):
                    piece = slice(at, at + recipe.piece)
                    residual, condition = seen[piece, chosen], given[piece, chosen]
                    loss, memory = _loss(weights, recipe, residual, condition, memory, generator)
                    optimizer.zero_grad()
                    loss.backward()
                    torch.nn.utils.clip_grad_norm_(weights.values(), recipe.most_gradient)
                    optimizer.step()
                    schedule.step()
            bar.update(1)
    return VrnnHybrid(as_arrays(weights), recipe.sizes, scales, EngineStep())


def _loss(
    weights: Weights,
    recipe: VrnnRecipe,
    residual: torch.Tensor,
    condition: torch.Tensor,
    memory: torch.Tensor,
    generator: torch.Generator,
) -> tuple[torch.Tensor, torch.Tensor]:
    """The negative evidence lower bound of one piece, a step; and the memory after it.

    Only what the memory needs is done step by step; prior and decoder are asked once for all.
    """
    import torch

    noise = torch.randn(*residual.shape[:2], recipe.sizes.latent, generator=generator)
    memories, latents, means, logs = [], [], [], []
    for x, c, draw in zip(residual, condition, noise, strict=True):
        mean, log = gaussian(weights, "encoder", x, memory, c)
        latent = mean + log.exp() * draw
        memories.append(memory)
        latents.append(latent)
        means.append(mean)
        logs.append(log)
        memory = remember(weights, memory, x, c, latent)
    before, latent = torch.stack(memories), torch.stack(latents)
    q_mean, q_log = torch.stack(means), torch.stack(logs)
    p_mean, p_log = gaussian(weights, "prior", before, condition)
    gap = ((q_mean - p_mean) ** 2 + (2 * q_log).exp()) / (2 * p_log).exp()
    divergence = (p_log - q_log + (gap - 1) / 2).sum(dim=-1)
    mean, log = gaussian(weights, "decoder", latent, before, condition)
    deviation = log.exp() + recipe.least_deviation
    surprise = (((residual - mean) / deviation) ** 2 / 2 + deviation.log()).sum(dim=-1)
    return (surprise + divergence).mean(), memory.detach()
