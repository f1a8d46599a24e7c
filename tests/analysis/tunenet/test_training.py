"""Networks, their training data, and training: laws, the same bits from anywhere, and learning."""

from __future__ import annotations

import hashlib
import os
import signal
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Command
from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop import presets as film_presets
from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.experiment import Training
from tunenet_logs.analysis.parallel import HERE, Cluster
from tunenet_logs.analysis.payload.detection import TRAININGS as PAYLOADS
from tunenet_logs.analysis.tunenet import network as networks
from tunenet_logs.analysis.tunenet.network import (
    NETWORKS,
    Model,
    Network,
    Scaling,
    Workers,
    initial_weights,
    observe_all,
    one_step_error,
    train,
)
from tunenet_logs.episode import Array
from tunenet_logs.errors import TuneNetError
from tunenet_logs.terminal import Progress

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


QUIET = Progress(quiet=True)
PRESETS = {
    "drop default": TRAININGS["default"],
    "drop paper-code": TRAININGS["paper-code"],
    "payload default": PAYLOADS["default"],
    "payload paper": PAYLOADS["paper"],
}
_FEW, _SEED = 60, 3


def _made(preset: Training, workers: Workers) -> Array:
    return preset.make_pairs(_FEW, _SEED, workers, QUIET).observations


@pytest.mark.live
@pytest.mark.parametrize(
    "name", [pytest.param("drop paper-code", marks=pytest.mark.slow), "payload default"]
)
def test_a_cluster_makes_the_same_bits(name: str):
    pytest.importorskip("ray")
    assert _made(PRESETS[name], 1).tobytes() == _made(PRESETS[name], Cluster(HERE, 2)).tobytes()


@pytest.mark.parametrize("name", PRESETS)
def test_bits_do_not_depend_on_who_makes_them_or_how_they_are_cut(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    found = [_made(PRESETS[name], 1).tobytes(), _made(PRESETS[name], 2).tobytes()]
    monkeypatch.setattr(networks, "_CHUNKS", 1)
    for most in (1, 7):
        monkeypatch.setattr(networks, "_MAX_AT_A_TIME", most)
        found.append(_made(PRESETS[name], 1).tobytes())
    assert len(set(found)) == 1


def _weights_sha256(command: Command, path: Path, *words: str) -> str:
    small = ("--preset", "paper-code", "--pairs", "40", "--epochs", "3", "--quiet")
    done = command("tunenet-train", "drop", *small, "-o", str(path), *words)
    assert done.returncode == 0, done.stderr
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    "words",
    [
        ("--jobs", "2"),
        pytest.param(("--ray", "--jobs", "2"), marks=[pytest.mark.live, pytest.mark.slow]),
    ],
)
def test_weights_do_not_depend_on_where_their_pairs_were_made(
    command: Command, tmp_path: Path, words: tuple[str, ...]
):
    pytest.importorskip("torch")
    if "--ray" in words:
        pytest.importorskip("ray")
    one = _weights_sha256(command, tmp_path / "1.safetensors", "--jobs", "1")
    assert _weights_sha256(command, tmp_path / "2.safetensors", *words) == one


def _dies_once(folder: Path, items: Sequence[int]) -> Array:
    """The process of the first chunk dies, the first time."""
    if 0 in items:
        mark = folder / "died"
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return np.array(items, float)[:, None, None]


def _dies(items: Sequence[int]) -> Array:
    os.kill(os.getpid(), signal.SIGKILL)
    return np.array(items, float)[:, None, None]


@pytest.mark.parametrize("on", ["processes", pytest.param("ray", marks=pytest.mark.live)])
def test_what_a_dead_worker_had_is_made_again(on: str, tmp_path: Path):
    if on == "ray":
        pytest.importorskip("ray")
    workers = Cluster(HERE, 2) if on == "ray" else 2
    found = observe_all(partial(_dies_once, tmp_path), range(300), workers, QUIET)
    assert (tmp_path / "died").exists()
    assert np.array_equal(found[:, 0, 0], np.arange(300))


def test_a_worker_that_always_dies_is_one_error():
    with pytest.raises(TuneNetError, match="died each time"):
        observe_all(_dies, range(4), 2, QUIET)


def _fails(items: Sequence[int]) -> Array:
    raise ValueError(f"no {items[0]}")


@pytest.mark.live
def test_a_cluster_raises_what_its_work_raises():
    pytest.importorskip("ray")
    with pytest.raises(ValueError, match="no 0"):
        observe_all(_fails, [0], Cluster(HERE, 1), QUIET)


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=[pytest.mark.slow] * (one != "default")) for one in TRAININGS]
)
def test_a_short_training_beats_no_training(name: str):
    preset = TRAININGS[name]
    pairs = preset.make_pairs(100, 0, 1, QUIET)
    recipe = replace(preset.recipe, epochs=40)
    model = train(preset.network, pairs, recipe, 0, QUIET)
    fresh = preset.make_pairs(100, 99, 1, QUIET)
    rng = np.random.default_rng(0)
    inputs = pairs.observations.shape[1]
    untrained = replace(
        model, weights=initial_weights(preset.network, inputs, preset.purpose.outputs, rng)
    )
    assert one_step_error(model, fresh) < 0.5 * one_step_error(untrained, fresh)


@needs_pybullet
def test_the_papers_pairs_of_films_show_z_beside_the_pictures_y():
    pairs = film_presets.FILM_TRAININGS["paper"].make_pairs(12, 0, 1, QUIET)
    simulated, filmed = pairs.observations[pairs.proposed], pairs.observations[pairs.target]
    assert simulated.shape == filmed.shape == (12, 400, 1)
    assert 0.78 < simulated[:, 0].min() <= simulated[:, 0].max() < 1.02
    assert (simulated[:, 0] > simulated[:, -1]).all()
    assert (filmed >= 0).all()
    assert (filmed <= 1).all()
    assert (filmed[:, 0] < filmed[:, -1]).all()


def test_the_same_seed_gives_the_same_weights():
    preset = TRAININGS["default"]
    pairs = preset.make_pairs(100, 0, 1, QUIET)
    recipe = replace(preset.recipe, epochs=2)
    first, again = (train(preset.network, pairs, recipe, 5, QUIET) for _ in range(2))
    other = train(preset.network, pairs, recipe, 6, QUIET)
    for name, weight in first.weights.items():
        assert np.array_equal(weight, again.weights[name])
    assert not np.array_equal(first.weights["out.weight"], other.weights["out.weight"])


@needs_pybullet
def test_what_one_of_a_pair_lacks_is_not_learnt_from_the_other():
    preset = TRAININGS["paper-code"]
    pairs = preset.make_pairs(50, 0, 1, QUIET)
    whole = pairs.observations
    recipe = replace(preset.recipe, epochs=1)
    trained = []
    for seen, there in ((np.nan, 1.0), (np.nan, 9.0), (2.0, 1.0), (2.0, 9.0)):
        observations = whole.copy()
        observations[pairs.target, 30:60] = seen
        observations[pairs.proposed, 30:60] = there
        model = train(preset.network, replace(pairs, observations=observations), recipe, 0, QUIET)
        trained.append(model.weights["proposed.weight"])
    assert np.array_equal(trained[0], trained[1])
    assert not np.array_equal(trained[2], trained[3])


@needs_pybullet
def test_the_papers_pairs_share_their_height_and_keep_its_range():
    pairs = TRAININGS["paper-code"].make_pairs(30, 0, 1, QUIET)
    first = pairs.observations[:, 0, 0]
    assert np.array_equal(first[pairs.proposed], first[pairs.target])
    assert 3.99 < first.min() < first.max() < 5
    assert 0.3 <= pairs.values.min() < pairs.values.max() <= 0.7
    assert pairs.observations.shape == (60, 400, 1)
    shapes = NETWORKS["paper"].shapes(400, 1)
    assert shapes["proposed.weight"] == shapes["target.weight"] == (400, 32)
    assert (shapes["joint.weight"], shapes["out.weight"]) == ((64, 32), (32, 1))
