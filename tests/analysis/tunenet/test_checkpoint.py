"""Weights fit their purpose, and damage never passes."""

from __future__ import annotations

import os
import random
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.tunenet.hostile_weights import (
    DTYPES,
    Header,
    forged,
    joined,
    parted,
    with_own_digest,
)
from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.tunenet.network import NETWORKS, Model, Scaling, initial_weights
from tunenet_logs.analysis.tunenet.weights import Purpose, load_model, save_model, shipped_model
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


def rewritten(path: Path, change: Callable[[Header], Header]) -> None:
    """Change the header, and make the digest fit."""
    header, tensors = parted(path.read_bytes())
    path.write_bytes(joined(with_own_digest(change(header), tensors), tensors))


def test_what_a_stranger_rewrites_is_as_good_as_ours(saved: Path):
    rewritten(saved, lambda header: header)
    assert load_model(saved, PURPOSE).network.kind == "antisymmetric"


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_tensor_of_another_kind_is_refused(saved: Path, dtype: object):
    tensor = "scaling.input_gain"
    rewritten(saved, lambda header: {**header, tensor: {**header[tensor], "dtype": dtype}})
    with pytest.raises(WeightsError, match=r"scaling\.input_gain.*has the dtype"):
        load_model(saved, PURPOSE)


@pytest.mark.parametrize("values", [2, 3, 12])
def test_a_scaling_of_a_shape_that_fits_nothing_is_refused(tmp_path: Path, values: int):
    scaling = Scaling(np.zeros(12), np.ones(1), np.zeros(values), np.ones(1))
    save_model(tmp_path / "w", replace(make(), scaling=scaling), PURPOSE, {})
    with pytest.raises(WeightsError, match=r"scaling\.output_offset.*misshapen"):
        load_model(tmp_path / "w", PURPOSE)


@pytest.mark.parametrize("rates", ["[NaN]", "[]", "[1e999]", "[-60]", "[true]", "60", "[" * 5000])
def test_rates_that_are_none_are_refused(saved: Path, rates: str):
    def change(header: Header) -> Header:
        return {**header, "__metadata__": {**header["__metadata__"], "rates_hz": rates}}

    rewritten(saved, change)
    with pytest.raises(WeightsError, match="rates_hz"):
        load_model(saved, PURPOSE)


def test_a_weight_that_no_network_has_is_refused(tmp_path: Path):
    save_model(tmp_path / "w", make(1e200), PURPOSE, {})
    with pytest.raises(WeightsError, match="beyond"):
        load_model(tmp_path / "w", PURPOSE)


def test_a_pipe_is_refused_at_once(tmp_path: Path):
    os.mkfifo(tmp_path / "w")
    with pytest.raises(WeightsError, match="regular file"):
        load_model(tmp_path / "w", PURPOSE)


def test_nothing_but_our_own_error_comes_of_a_forged_file(saved: Path):
    whole, chance = saved.read_bytes(), random.Random(0)
    said: list[str] = []
    tracemalloc.start()
    for _ in range(600):
        saved.write_bytes(forged(whole, chance))
        try:
            load_model(saved, PURPOSE)
        except WeightsError as error:
            said.append(str(error))
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(said) > 500
    for line in said:
        assert line.isprintable()
        assert len(line.removeprefix(f"{saved}: ")) < min(400, len(line))
    assert peak_bytes < 4_000_000
