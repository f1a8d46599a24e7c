"""Networks, their training data, and training: laws, the same bits from anywhere, and learning."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.tunenet.dying import dies, dies_once
from tests.conftest import Command
from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    Antisymmetrised,
    DifferenceNetwork,
)
from tunenet_logs.analysis.experiment import Training
from tunenet_logs.analysis.parallel import HERE, Cluster, on_cluster
from tunenet_logs.analysis.payload.detection import TRAININGS as PAYLOADS
from tunenet_logs.analysis.tunenet import network as networks
from tunenet_logs.analysis.tunenet.network import (
    NETWORKS,
    Model,
    Network,
    PaperNetwork,
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

Seen = tuple[Array, Array]  # what is proposed, and the target
# Those of tunings, and of the evaluation's ablation.
EVERY: dict[str, Network] = {
    **NETWORKS,
    "difference": DifferenceNetwork(),
    "antisymmetrised": Antisymmetrised(PaperNetwork()),
}
each_network = pytest.mark.parametrize("network", EVERY.values(), ids=EVERY)


def weights(network: Network, outputs: int = 2) -> dict[str, Array]:
    return initial_weights(network, 30, outputs, np.random.default_rng(0))


@pytest.fixture
def observations() -> Seen:
    rng = np.random.default_rng(1)
    return rng.normal(size=(7, 30)), rng.normal(size=(7, 30))


@each_network
def test_torch_and_numpy_agree(network: Network, observations: Seen):
    import torch

    proposed, target = observations
    here = network.residual(weights(network), proposed, target)
    tensors = {name: torch.from_numpy(value) for name, value in weights(network).items()}
    there = network.residual(tensors, torch.from_numpy(proposed), torch.from_numpy(target))
    assert here.shape == (7, 2)
    assert np.allclose(here, there.numpy(), atol=1e-12)


@each_network
def test_what_is_not_seen_does_not_count(network: Network):
    none, one = np.zeros(1), np.ones(1)
    model = Model(network, weights(network, 1), Scaling(none, one, none, one))
    rng = np.random.default_rng(2)
    proposed, target = rng.normal(size=(1, 30, 1)), rng.normal(size=(1, 30, 1))
    target[:, 20:] = np.nan
    other = proposed.copy()
    other[:, 20:] += 1
    assert np.array_equal(model(proposed, target), model(other, target))
    assert np.isfinite(model(proposed, target)).all()


@each_network
def test_only_the_papers_own_networks_are_not_antisymmetric(network: Network, observations: Seen):
    proposed, target = observations
    same = network.residual(weights(network), target, target)
    forth = network.residual(weights(network), proposed, target)
    back = network.residual(weights(network), target, proposed)
    assert forth.any()
    is_antisymmetric = not same.any() and np.allclose(forth, -back)
    assert is_antisymmetric == (network.kind not in ("paper", "difference"))


def test_twice_the_torques_are_twice_the_residual(observations: Seen):
    network = NETWORKS["homogeneous"]
    proposed, target = observations
    once = network.residual(weights(network), proposed, target)
    twice = network.residual(weights(network), 2 * proposed, 2 * target)
    assert twice == pytest.approx(2 * once)


def test_the_difference_sees_nothing_but_the_difference_of_both_outputs(observations: Seen):
    network, (proposed, target) = EVERY["difference"], observations
    same = weights(network)
    same |= {f"target.{part}": same[f"proposed.{part}"] for part in ("weight", "bias")}
    at_rest = network.residual(same, 0 * proposed, 0 * proposed)
    assert network.residual(same, target, target) == pytest.approx(at_rest)
    assert network.residual(same, proposed, target) != pytest.approx(at_rest)


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


def _made_here(name: str) -> bytes:
    return _made(PRESETS[name], 1).tobytes()


@pytest.mark.live
def test_a_cluster_makes_the_same_bits_and_raises_what_its_work_raises():
    pytest.importorskip("ray")
    names = ("payload default", "drop default", "nothing")
    found: dict[str, bytes] = {}

    def collect() -> None:
        for at, made in on_cluster(Cluster(HERE, 1), _made_here, names, _made_here):
            found[names[at]] = made

    with pytest.raises(KeyError, match="nothing"):
        collect()
    assert found == {name: _made_here(name) for name in names[:2]}


@pytest.mark.parametrize("name", PRESETS)
def test_bits_do_not_depend_on_who_makes_them_or_how_they_are_cut(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    found = [_made(PRESETS[name], 1).tobytes()]
    found += [_made(PRESETS[name], 2).tobytes()] * name.endswith("default")
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


def test_what_a_dead_worker_had_is_made_again(tmp_path: Path):
    found = observe_all(partial(dies_once, tmp_path), range(300), 2, QUIET)
    assert (tmp_path / "died").exists()
    assert np.array_equal(found[:, 0, 0], np.arange(300))


def test_a_worker_that_always_dies_is_one_error():
    with pytest.raises(TuneNetError, match="died each time"):
        observe_all(dies, range(4), 2, QUIET)


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
