"""Predict the next state by a neural network, without a simulator (Ajay et al. 2018)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.evaluation.motion.one_step.layers import (
    Weights,
    as_arrays,
    as_tensors,
    first_weights,
    linear,
    one_thread,
    tanh,
)
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress


@dataclass(frozen=True)
class NeuralRecipe:
    """Training recipe: AdamW, one-cycle learning rate, squared error.

    Theirs (layers, optimizer, epochs, whether it had a memory) is not known to us. This takes 20
    to 30 s on one core. With 60 epochs instead of 40 its rollouts err by 7.4 cm instead of 7.8;
    the best that it could learn, the simulator at the middle restitution, by 6.5 cm.
    """

    width: int = 64
    epochs: int = 40
    batch: int = 512
    learning_rate: float = 5e-3


class Neural:
    """Network of two hidden layers for the change of height and speed over one step.

    A ball's restitution is no part of its state, and the network does not see it: at an
    impact it gives the mean over all balls.
    """

    def __init__(self, weights: Weights, offset: Array, spread: Array, change: Array) -> None:
        self._weights = weights
        self._offset, self._spread, self._change = offset, spread, change

    def __call__(self, states: Array) -> Array:
        """Return the states one step later; both of shape (N, 2)."""
        outputs = _changes(self._weights, (states - self._offset) / self._spread)
        return states + outputs * self._change


def train_neural(states: Array, recipe: NeuralRecipe, seed: int, progress: Progress) -> Neural:
    """Train on all steps of all drops, shape (N, T + 1, 2), in any order."""
    import torch

    before, after = states[:, :-1].reshape(-1, 2), states[:, 1:].reshape(-1, 2)
    offset, spread = before.mean(axis=0), before.std(axis=0)
    change = (after - before).std(axis=0)
    inputs = torch.tensor((before - offset) / spread, dtype=torch.float32)
    wanted = torch.tensor((after - before) / change, dtype=torch.float32)
    sizes = {
        "first": (2, recipe.width),
        "second": (recipe.width, recipe.width),
        "out": (recipe.width, 2),
    }
    weights = as_tensors(first_weights(sizes, np.random.default_rng(seed)))
    optimizer = torch.optim.AdamW(weights.values(), weight_decay=0.0)
    batches = int(np.ceil(len(inputs) / recipe.batch))
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, recipe.learning_rate, total_steps=recipe.epochs * batches
    )
    generator = torch.Generator().manual_seed(seed)
    with one_thread(), progress.bar(recipe.epochs, "training Neural", "epoch") as bar:
        for _ in range(recipe.epochs):
            for chosen in torch.randperm(len(inputs), generator=generator).split(recipe.batch):
                off = _changes(weights, inputs[chosen]) - wanted[chosen]
                optimizer.zero_grad()
                (off**2).mean().backward()
                optimizer.step()
                schedule.step()
            bar.update(1)
    return Neural(as_arrays(weights), offset, spread, change)


def _changes(weights: Weights, inputs: Any) -> Any:
    hidden = tanh(linear(weights, "first", inputs))
    return linear(weights, "out", tanh(linear(weights, "second", hidden)))
