"""Networks h(o_P, o_T): the paper's, an antisymmetric one, and one without biases.

Each forward pass is written once, with operations that NumPy arrays and torch tensors share: torch
trains it, NumPy applies it, and tuning a log never waits for torch to load.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from tunenet_logs.arrays import Array

Weights = Mapping[str, Any]  # arrays or tensors by name


class Network(Protocol):
    """Architecture: the shapes of its weights, and h."""

    @property
    def kind(self) -> str:
        """Name in a checkpoint."""
        ...

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """Return the weights' shapes for `inputs` observed values and `outputs` parameters."""
        ...

    def residual(self, weights: Weights, proposed: Any, target: Any) -> Any:
        """Evaluate h(o_P, o_T), shape (B, outputs), on two batches of shape (B, inputs)."""
        ...


class PaperNetwork:
    """The paper's network: 32 units per observation, concatenated, 32 more, tanh."""

    kind = "paper"
    width = 32

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """See `Network.shapes`."""
        return {
            **layer("proposed", inputs, self.width),
            **layer("target", inputs, self.width),
            **layer("joint", 2 * self.width, self.width),
            **layer("out", self.width, outputs),
        }

    def residual(self, weights: Weights, proposed: Any, target: Any) -> Any:
        """See `Network.residual`."""
        of_proposed = relu(linear(weights, "proposed", proposed))
        of_target = relu(linear(weights, "target", target))
        joint = relu(_joint(weights, "joint", of_proposed, of_target))
        return tanh(linear(weights, "out", joint))


class AntisymmetricNetwork:
    """h(o_P, o_T) = (g(o_P, o_T) - g(o_T, o_P)) / 2: exactly 0 where the two are equal.

    The paper's network is biased at its fixed point. This one cannot be, so its iterations end at
    the target. g shares one first layer for both sides and has no tanh.
    """

    kind = "antisymmetric"
    width = 64

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """See `Network.shapes`."""
        return {
            **layer("curve", inputs, self.width),
            **layer("joint", 2 * self.width, self.width),
            **layer("out", self.width, outputs),
        }

    def residual(self, weights: Weights, proposed: Any, target: Any) -> Any:
        """See `Network.residual`."""
        of_proposed = relu(linear(weights, "curve", proposed))
        of_target = relu(linear(weights, "curve", target))
        forth = relu(_joint(weights, "joint", of_proposed, of_target))
        back = relu(_joint(weights, "joint", of_target, of_proposed))
        return (linear(weights, "out", forth) - linear(weights, "out", back)) / 2


class WideNetwork(AntisymmetricNetwork):
    """Antisymmetric network for several parameters: twice as wide."""

    kind = "wide"
    width = 128


class HomogeneousNetwork:
    """Antisymmetric network without biases: h(a o_P, a o_T) = a h(o_P, o_T) for any a > 0.

    For observations that are linear in the parameter, as torques are in a mass: what it has learnt
    of small values holds for large ones.
    """

    kind = "homogeneous"
    width = 64

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """See `Network.shapes`."""
        layers = AntisymmetricNetwork().shapes(inputs, outputs)
        return {name: shape for name, shape in layers.items() if name.endswith(".weight")}

    def residual(self, weights: Weights, proposed: Any, target: Any) -> Any:
        """See `Network.residual`."""
        unbiased = {**weights, **{f"{name}.bias": 0.0 for name in ("curve", "joint", "out")}}
        return AntisymmetricNetwork().residual(unbiased, proposed, target)


NETWORKS: dict[str, Network] = {
    network.kind: network
    for network in (PaperNetwork(), AntisymmetricNetwork(), WideNetwork(), HomogeneousNetwork())
}


@dataclass(frozen=True, eq=False)
class Scaling:
    """Normalisation of a network's inputs and outputs.

    Inputs are (values - offset) * gain; residuals are outputs * gain + offset. A value that either
    observation lacks is 0 in both.
    """

    input_offset: Array
    input_gain: Array
    output_offset: Array
    output_gain: Array

    def inputs(self, proposed: Array, target: Array) -> tuple[Array, Array]:
        """Normalise two batches of observations, shape (B, L, C), to inputs, (B, L * C)."""
        flat_p = proposed.reshape(len(proposed), -1)
        flat_t = target.reshape(len(target), -1)
        seen = np.isfinite(flat_p) & np.isfinite(flat_t)
        scaled_p = np.where(seen, (flat_p - self.input_offset) * self.input_gain, 0.0)
        scaled_t = np.where(seen, (flat_t - self.input_offset) * self.input_gain, 0.0)
        return scaled_p, scaled_t


@dataclass(frozen=True, eq=False)
class Model:
    """Trained network, which estimates the residual of the P parameters from two observations.

    Attributes:
        digest: SHA-256 of everything in it, hexadecimal.
    """

    network: Network
    weights: Mapping[str, Array]
    scaling: Scaling
    digest: str = ""

    def __call__(self, proposed: Array, target: Array) -> Array:
        """Estimate zeta_T - zeta_P, shape (B, P), from observations of shape (B, L, C)."""
        inputs = self.scaling.inputs(proposed, target)
        outputs = self.network.residual(self.weights, *inputs)
        return outputs * self.scaling.output_gain + self.scaling.output_offset


def initial_weights(
    network: Network, inputs: int, outputs: int, rng: np.random.Generator
) -> dict[str, Array]:
    """Draw weights uniformly within 1 / sqrt(fan-in), as torch.nn.Linear does."""
    shapes = network.shapes(inputs, outputs)
    weights: dict[str, Array] = {}
    for name, shape in shapes.items():
        fan_in = shapes[f"{name.split('.')[0]}.weight"][0]
        weights[name] = rng.uniform(-1.0, 1.0, shape) / np.sqrt(fan_in)
    return weights


def layer(name: str, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of a linear layer's weights."""
    return {f"{name}.weight": (inputs, outputs), f"{name}.bias": (outputs,)}


def linear(weights: Weights, name: str, values: Any) -> Any:
    """Apply a linear layer to a batch of shape (B, inputs)."""
    return values @ weights[f"{name}.weight"] + weights[f"{name}.bias"]


def _joint(weights: Weights, name: str, first: Any, second: Any) -> Any:
    """Apply a linear layer to two concatenated inputs."""
    matrix = weights[f"{name}.weight"]
    half = matrix.shape[0] // 2
    return first @ matrix[:half] + second @ matrix[half:] + weights[f"{name}.bias"]


def relu(values: Any) -> Any:
    """Return max(values, 0) of an array or a tensor."""
    return values.clip(min=0)


def tanh(values: Any) -> Any:
    """Return tanh of an array or a tensor."""
    return np.tanh(values) if isinstance(values, np.ndarray) else values.tanh()
