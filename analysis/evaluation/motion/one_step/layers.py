"""Network layers whose forward pass NumPy arrays and torch tensors share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from tunenet_logs.arrays import Array

if TYPE_CHECKING:
    import torch

Weights = Mapping[str, Any]  # arrays or tensors by name


def first_weights(
    sizes: Mapping[str, tuple[int, int]], rng: np.random.Generator
) -> dict[str, Array]:
    """Draw weights uniform within 1 / sqrt(inputs), for (inputs, outputs), as torch starts."""
    weights: dict[str, Array] = {}
    for name, (inputs, outputs) in sizes.items():
        reach = 1 / np.sqrt(inputs)
        weights[f"{name}.weight"] = rng.uniform(-reach, reach, (inputs, outputs))
        weights[f"{name}.bias"] = rng.uniform(-reach, reach, outputs)
    return weights


def linear(weights: Weights, name: str, values: Any) -> Any:
    """Apply a layer without its nonlinearity."""
    return values @ weights[f"{name}.weight"] + weights[f"{name}.bias"]


def tanh(values: Any) -> Any:
    """Return the hyperbolic tangent."""
    return np.tanh(values) if isinstance(values, np.ndarray) else values.tanh()


def sigmoid(values: Array) -> Array:
    """Return the logistic function, by way of tanh, which cannot overflow."""
    return np.tanh(values / 2) / 2 + 0.5


def as_tensors(weights: Mapping[str, Array]) -> dict[str, torch.Tensor]:
    """Convert to tensors, to be trained."""
    import torch

    return {
        name: torch.tensor(value, dtype=torch.float32, requires_grad=True)
        for name, value in weights.items()
    }


def as_arrays(weights: Mapping[str, torch.Tensor]) -> dict[str, Array]:
    """Convert to arrays, to be applied."""
    return {name: value.detach().numpy().astype(np.float64) for name, value in weights.items()}


@contextmanager
def one_thread() -> Iterator[None]:
    """Restrict torch to one thread in a block: networks this small gain nothing from two."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
