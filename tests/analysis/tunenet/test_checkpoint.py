"""Weights fit their purpose, and damage never passes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from analysis.drop.presets import TRAININGS
from analysis.tunenet.checkpoint import Purpose, load_model, save_model, shipped_model
from analysis.tunenet.network import NETWORKS, Model, Scaling, initial_weights
from tunenet_logs.errors import WeightsError

PURPOSE = Purpose("drop", "default", "a curve", 12, 1, (60.0,))


def make(scale: float = 1.0) -> Model:
    network = NETWORKS["antisymmetric"]
    weights = initial_weights(network, 12, 1, np.random.default_rng(0))
    weights["out.weight"] = weights["out.weight"] * scale
    return Model(network, weights, Scaling(np.zeros(12), np.ones(1), np.zeros(1), np.ones(1)))


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    save_model(tmp_path / "w.safetensors", make(), PURPOSE, {"seed": "0"})
    return tmp_path / "w.safetensors"


def test_comes_back_as_it_was(saved: Path):
    model = load_model(saved, PURPOSE)
    for name, value in make().weights.items():
        assert np.array_equal(model.weights[name], value)
    assert len(model.digest) == 64


@pytest.mark.parametrize(
    ("field", "value"), [("preset", "paper"), ("task", "payload"), ("observation", "other")]
)
def test_weights_for_something_else_are_refused(saved: Path, field: str, value: str):
    with pytest.raises(WeightsError, match=value):
        load_model(saved, replace(PURPOSE, **{field: value}))


def test_any_flipped_bit_is_refused(saved: Path):
    whole = saved.read_bytes()
    rng = np.random.default_rng(0)
    for at in rng.integers(0, len(whole), 300):
        damaged = bytearray(whole)
        damaged[at] ^= 1 << int(rng.integers(8))
        saved.write_bytes(bytes(damaged))
        with pytest.raises(WeightsError):
            load_model(saved, PURPOSE)


@pytest.mark.parametrize("content", [b"", b"hello", b"\xff" * 100, b"\x80\x04K\x01."])
def test_what_are_no_weights_is_refused(tmp_path: Path, content: bytes):
    (tmp_path / "w").write_bytes(content)
    with pytest.raises(WeightsError, match="safetensors"):
        load_model(tmp_path / "w", PURPOSE)


def test_a_missing_file_is_refused(tmp_path: Path):
    with pytest.raises(WeightsError, match="no such file"):
        load_model(tmp_path / "w", PURPOSE)


@pytest.mark.parametrize("change", [np.nan, np.inf])
def test_weights_that_are_not_finite_are_refused(tmp_path: Path, change: float):
    save_model(tmp_path / "w", make(change), PURPOSE, {})
    with pytest.raises(WeightsError, match="not finite"):
        load_model(tmp_path / "w", PURPOSE)


def test_wrong_shapes_are_refused(saved: Path):
    with pytest.raises(WeightsError, match="misshapen"):
        load_model(saved, replace(PURPOSE, inputs=13))


@pytest.mark.parametrize("name", TRAININGS)
def test_the_package_ships_weights_for_every_preset(name: str):
    preset = TRAININGS[name]
    model = shipped_model(preset.purpose)
    assert model.network.kind == preset.network.kind
