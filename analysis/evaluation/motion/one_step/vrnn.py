"""VRNN hybrid: a simulator, and a variational recurrent network for its residual.

Ajay et al. 2018 add the residual of a variational recurrent network (Chung et al. 2015) to each
step of a simulator. What follows is Chung's network, each of its parts conditioned on c = (the
present state, the simulator's step from it):

    prior     p(z | h, c)        what may happen, by all that was seen
    encoder   q(z | x, h, c)     what did happen, once the residual x is known
    decoder   p(x | z, h, c)     the residual of the simulator's step
    memory    h <- GRU((x, c), h)

Chung's memory takes z too. Theirs is a "decoupled conditional" network; what it decouples, the
sizes of its layers, its training, and which restitution their simulator was given are not known
to us. Here the memory is decoupled from z: as z says nothing that x does not, nothing is lost
once x was seen, and torch's own recurrent unit can run a whole drop. The ball's restitution is
hidden: it shows in the residuals of past impacts only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from analysis.evaluation.motion.one_step.base import Memory
from analysis.evaluation.motion.one_step.data import EngineStep, Transitions
from analysis.evaluation.motion.one_step.layers import Weights, linear, sigmoid, tanh
from tunenet_logs.arrays import Array

RESIDUALS = 2
# Numbers in x (height and speed) and in c (the state, and the simulator's step from it).
CONDITION = 4


@dataclass(frozen=True)
class VrnnSizes:
    """Sizes of the layers, latent variable and memory."""

    hidden: int = 32
    latent: int = 4
    memory: int = 32

    def layers(self) -> dict[str, tuple[int, int]]:
        """Return (inputs, outputs) of each layer by name."""
        seen = self.memory + CONDITION
        return {
            "prior": (seen, self.hidden),
            "prior.out": (self.hidden, 2 * self.latent),
            "encoder": (RESIDUALS + seen, self.hidden),
            "encoder.out": (self.hidden, 2 * self.latent),
            "decoder": (self.latent + seen, self.hidden),
            "decoder.out": (self.hidden, 2 * RESIDUALS),
            "memory.input": (RESIDUALS + CONDITION, 3 * self.memory),
            "memory.own": (self.memory, 3 * self.memory),
        }


@dataclass(frozen=True, eq=False)
class Scales:
    """Normalisation of states and residuals.

    Attributes:
        offset: mean state, shape (2,).
        spread: standard deviation of states, shape (2,).
        residual: what a residual of 1 is, shape (2,): a tenth of the largest, about that of a
            middling impact. They are too rare for their standard deviation to be of use.
    """

    offset: Array
    spread: Array
    residual: Array

    @staticmethod
    def of(drops: Transitions) -> Scales:
        """Compute the scales of training data."""
        states = drops.states.reshape(-1, 2)
        residuals = (drops.states[:, 1:] - drops.simulated).reshape(-1, 2)
        return Scales(states.mean(axis=0), states.std(axis=0), np.abs(residuals).max(axis=0) / 10)

    def condition(self, states: Array, simulated: Array) -> Array:
        """Return c, shape (..., 4), of states and the simulator's step, shape (..., 2)."""
        both = [(one - self.offset) / self.spread for one in (states, simulated)]
        return np.concatenate(both, axis=-1)

    def scaled(self, residuals: Array) -> Array:
        """Normalise residuals in metres and metres a second."""
        return residuals / self.residual


def gaussian(weights: Weights, name: str, *inputs: Any) -> tuple[Any, Any]:
    """Return mean and log standard deviation from a part of the network."""
    outputs = linear(weights, f"{name}.out", tanh(linear(weights, name, joined(*inputs))))
    half = outputs.shape[-1] // 2
    return outputs[..., :half], outputs[..., half:]


def remember(weights: Weights, memory: Array, *inputs: Array) -> Array:
    """Apply one step of the gated recurrent unit, as `torch.nn.GRU` has it, to (x, c)."""
    given = linear(weights, "memory.input", joined(*inputs))
    own = linear(weights, "memory.own", memory)
    size = memory.shape[-1]
    gates = sigmoid(given[:, : 2 * size] + own[:, : 2 * size])
    reset, keep = gates[:, :size], gates[:, size:]
    candidate = np.tanh(given[:, 2 * size :] + reset * own[:, 2 * size :])
    return keep * memory + (1 - keep) * candidate


def joined(*values: Any) -> Any:
    """Concatenate along the last axis."""
    if isinstance(values[0], np.ndarray):
        return np.concatenate(values, axis=-1)
    import torch

    return torch.cat(values, dim=-1)


class VrnnHybrid:
    """Simulator's step plus the mean of the network's prediction of its residual.

    z is at its prior's mean: no sample is drawn, so the same run gives the same forecast. The
    encoder has a part in training alone.
    """

    def __init__(
        self, weights: Weights, sizes: VrnnSizes, scales: Scales, engine: EngineStep
    ) -> None:
        self._weights = weights
        self._sizes = sizes
        self._scales = scales
        self._engine = engine

    def start(self, count: int) -> Memory:
        """See `Stepper.start`."""
        return np.zeros((count, self._sizes.memory))

    def forecast(self, memory: Memory, states: Array) -> tuple[Array, Memory]:
        """See `Stepper.forecast`."""
        simulated = self._engine(states)
        condition = self._scales.condition(states, simulated)
        latent, _ = gaussian(self._weights, "prior", memory, condition)
        residual, _ = gaussian(self._weights, "decoder", latent, memory, condition)
        forecast = simulated + residual * self._scales.residual
        return forecast, (memory, simulated, condition, residual)

    def learn(self, memory: Memory, states: Array | None) -> Memory:
        """See `Stepper.learn`."""
        before, simulated, condition, residual = memory
        if states is not None:
            residual = self._scales.scaled(states - simulated)
        return remember(self._weights, before, residual, condition)
