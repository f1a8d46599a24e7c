"""Train a posterior network by the defaults of `sbi`: the one bridge to the library.

Its words on standard output and its warnings stay here, and so do its logs for TensorBoard.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array

# The library's own limit, which is none: training ends when it no longer helps.
_ENDLESS = 2**31 - 1

_PATIENCE = 100
_BATCH = 50
_RATE = 1e-3
# Passes without improvement, simulations in a step, learning rate, units of a layer. The library's
# 20, 200, 5e-4 and 50 leave larger errors (chosen on seeds that no table is made of).
_HIDDEN = 256


@dataclass(frozen=True, eq=False)
class SbiPosterior:
    """Trained network as plain numbers, which travel between processes; see `Posterior`.

    Attributes:
        bounds: of the uniform prior.
        inputs: L, numbers in an observation.
        weights: by the library's names, the offsets and gains of its standardisation among them.
    """

    bounds: tuple[float, float]
    inputs: int
    weights: Mapping[str, NDArray[Any]]

    def log_density(self, observation: Array, values: Array) -> Array:
        """See `Posterior.log_density`."""
        import torch

        condition = torch.tensor(observation[None], dtype=torch.float32)
        parameters = torch.tensor(values[:, None, None], dtype=torch.float32)
        with torch.no_grad():
            logs = self._network.log_prob(parameters, condition)
        return logs[:, 0].numpy().astype(np.float64)

    @cached_property
    def _network(self) -> Any:
        """Network of the library; built once a process."""
        import torch

        with _quietly():
            some = torch.arange(2.0)[:, None]  # gives shapes; the scaling is among the weights
            network = _builder()(some, some.repeat(1, self.inputs))
        network.load_state_dict({name: torch.tensor(one) for name, one in self.weights.items()})
        return network.eval()

    def __getstate__(self) -> dict[str, Any]:
        """Return the numbers alone, for another process."""
        return {name: getattr(self, name) for name in ("bounds", "inputs", "weights")}


def train_posterior(
    observations: Array,
    values: Array,
    bounds: tuple[float, float],
    seed: int,
    epochs: int | None = None,
) -> SbiPosterior:
    """Train by neural posterior estimation (NPE-C of Greenberg et al. 2019, in one round).

    The same seed on the same machine gives the same weights, and torch's own generator is left as
    it was.

    Args:
        observations: of the simulations, shape (N, L).
        values: their parameters, drawn evenly from `bounds`, shape (N,).
        bounds: of the uniform prior.
        seed: of the first weights, the validation set and the batches.
        epochs: most passes; None for as many as the library finds useful.
    """
    import torch

    torch.set_num_threads(1)  # as in `train`; the count of threads decides the last bits
    with _quietly(), torch.random.fork_rng(devices=[]):
        from sbi.inference import NPE
        from sbi.utils import BoxUniform

        torch.manual_seed(seed)
        low, high = (torch.tensor([bound]) for bound in bounds)
        inference = NPE(
            BoxUniform(low, high), _builder(), show_progress_bars=False, tracker=_NoTracker()
        )
        seen = torch.tensor(observations, dtype=torch.float32)
        wanted = torch.tensor(values[:, None], dtype=torch.float32)
        inference.append_simulations(wanted, seen)
        network = inference.train(
            training_batch_size=_BATCH,
            learning_rate=_RATE,
            stop_after_epochs=_PATIENCE,
            max_num_epochs=epochs or _ENDLESS,
        )
    weights = {name: one.numpy().copy() for name, one in network.state_dict().items()}
    return SbiPosterior(bounds, observations.shape[1], weights)


def _builder() -> Any:
    """Make a builder of mixture density networks: 10 Gaussians, standardised inputs.

    For one parameter the library's default, an autoregressive flow, is a single Gaussian.
    """
    from sbi.neural_nets import posterior_nn

    return posterior_nn("mdn", z_score_x="independent", hidden_features=_HIDDEN)


@contextmanager
def _quietly() -> Iterator[None]:
    """Silence what the library prints or warns of."""
    nowhere = io.StringIO()
    with warnings.catch_warnings(), redirect_stdout(nowhere), redirect_stderr(nowhere):
        warnings.simplefilter("ignore")
        yield


class _NoTracker:
    """Tracker that logs nothing: the library's default makes a folder of logs where it stands."""

    log_dir = None

    def log_metric(self, name: str, value: float, step: int | None = None) -> None:
        """Log nothing."""

    def log_metrics(self, metrics: dict[str, float], step: int | None = None) -> None:
        """Log nothing."""

    def log_params(self, params: dict[str, Any]) -> None:
        """Log nothing."""

    def add_figure(self, name: str, figure: Any, step: int | None = None) -> None:
        """Log nothing."""

    def flush(self) -> None:
        """Flush nothing."""
