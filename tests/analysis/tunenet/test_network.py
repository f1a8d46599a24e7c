"""Laws over all networks, and the one that sets the antisymmetric one apart."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.tunenet.network import NETWORKS, Model, Network, Scaling, initial_weights

NONE, ONE = np.zeros(1), np.ones(1)


def weights(network: Network, outputs: int = 2) -> dict[str, np.ndarray]:
    return initial_weights(network, 30, outputs, np.random.default_rng(0))


@pytest.fixture(params=NETWORKS.values(), ids=list(NETWORKS))
def network(request: pytest.FixtureRequest) -> Network:
    return request.param


@pytest.fixture
def observations() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return rng.normal(size=(7, 30)), rng.normal(size=(7, 30))


def test_torch_and_numpy_agree(network: Network, observations):
    import torch

    proposed, target = observations
    here = network.residual(weights(network), proposed, target)
    tensors = {name: torch.from_numpy(value) for name, value in weights(network).items()}
    there = network.residual(tensors, torch.from_numpy(proposed), torch.from_numpy(target))
    assert here.shape == (7, 2)
    assert np.allclose(here, there.numpy(), atol=1e-12)


def test_a_batch_is_its_members(network: Network, observations):
    proposed, target = observations
    together = network.residual(weights(network), proposed, target)
    alone = [network.residual(weights(network), proposed[[k]], target[[k]])[0] for k in range(7)]
    assert np.allclose(together, alone)


def test_what_is_not_seen_does_not_count(network: Network):
    model = Model(network, weights(network, 1), Scaling(NONE, ONE, NONE, ONE))
    rng = np.random.default_rng(2)
    proposed, target = rng.normal(size=(1, 30, 1)), rng.normal(size=(1, 30, 1))
    target[:, 20:] = np.nan
    other = proposed.copy()
    other[:, 20:] += 1
    assert np.array_equal(model(proposed, target), model(other, target))
    assert np.isfinite(model(proposed, target)).all()


def test_antisymmetric_is_zero_at_equal_observations(observations):
    network = NETWORKS["antisymmetric"]
    proposed, target = observations
    assert np.array_equal(network.residual(weights(network), proposed, proposed), np.zeros((7, 2)))
    forth = network.residual(weights(network), proposed, target)
    back = network.residual(weights(network), target, proposed)
    assert np.allclose(forth, -back)


def test_the_papers_has_the_papers_shape():
    shapes = NETWORKS["paper"].shapes(400, 1)
    assert shapes["proposed.weight"] == shapes["target.weight"] == (400, 32)
    assert shapes["joint.weight"] == (64, 32)
    assert shapes["out.weight"] == (32, 1)
