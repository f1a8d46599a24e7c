"""The networks of the ablation: one forward pass for both libraries, and what each is for."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.studies.drop_methods import Antisymmetrised, DifferenceNetwork
from tunenet_logs.analysis.tunenet.network import Network, PaperNetwork, initial_weights

NETWORKS = [DifferenceNetwork(), Antisymmetrised(PaperNetwork())]
INPUTS = 7


def drawn(network: Network, seed: int = 0):
    rng = np.random.default_rng(seed)
    weights = initial_weights(network, INPUTS, 2, rng)
    return weights, rng.normal(size=(5, INPUTS)), rng.normal(size=(5, INPUTS))


@pytest.mark.slow
@pytest.mark.parametrize("network", NETWORKS, ids=lambda one: one.kind)
def test_numpy_and_torch_agree(network: Network):
    import torch

    weights, proposed, target = drawn(network)
    tensors = {name: torch.from_numpy(value) for name, value in weights.items()}
    found = network.residual(tensors, torch.from_numpy(proposed), torch.from_numpy(target))
    expected = network.residual(weights, proposed, target)
    assert expected.shape == (5, 2)
    assert found.numpy() == pytest.approx(expected, abs=1e-12)


def test_the_antisymmetric_form_is_zero_for_equal_observations_and_turns_its_sign():
    network = Antisymmetrised(PaperNetwork())
    weights, proposed, target = drawn(network)
    assert not network.residual(weights, target, target).any()
    assert PaperNetwork().residual(weights, target, target).any()
    forth = network.residual(weights, proposed, target)
    assert network.residual(weights, target, proposed) == pytest.approx(-forth)
    assert forth.any()


def test_the_difference_sees_nothing_but_the_difference_of_both_outputs():
    network = DifferenceNetwork()
    weights, proposed, target = drawn(network)
    same = {**weights}
    for part in ("weight", "bias"):
        same[f"target.{part}"] = weights[f"proposed.{part}"]
    nothing = np.zeros_like(proposed)
    at_rest = network.residual(same, nothing, nothing)
    assert network.residual(same, target, target) == pytest.approx(at_rest)
    assert network.residual(same, proposed, target) != pytest.approx(at_rest)
