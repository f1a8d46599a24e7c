"""Trained weights on disk: safetensors with what they are for, checked when they are read."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from analysis.tunenet.network import NETWORKS, Model, Scaling
from tunenet_logs.errors import WeightsError

FORMAT = "tunenet-weights/1"
_MAX_BYTES = 256 * 1024 * 1024
_SCALING = ("input_offset", "input_gain", "output_offset", "output_gain")


@dataclass(frozen=True)
class Purpose:
    """What a network was trained for; weights fit only the same purpose.

    Attributes:
        task: "drop".
        preset: see `Preset`.
        observation: what a network sees, with its grid.
        inputs: values in one observation.
        outputs: parameters.
        rates_hz: sampling rates that it was trained with.
    """

    task: str
    preset: str
    observation: str
    inputs: int
    outputs: int
    rates_hz: tuple[float, ...]


def save_model(path: Path, model: Model, purpose: Purpose, notes: Mapping[str, str]) -> str:
    """Write atomically; returns the digest.

    Args:
        path: the file; replaced if it exists.
        model: what to save; its own digest is ignored.
        purpose: what it was trained for.
        notes: how it was trained, in words; part of the digest.

    Raises:
        WeightsError: the file cannot be written.
    """
    tensors = {name: np.ascontiguousarray(value) for name, value in model.weights.items()}
    tensors |= {f"scaling.{name}": getattr(model.scaling, name) for name in _SCALING}
    header = {"format": FORMAT, "network": model.network.kind, **_strings(purpose), **notes}
    header["digest"] = _digest(tensors, header)
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_bytes(save(tensors, header))
        partial.replace(path)
    except OSError as error:
        raise WeightsError(f"{path}: cannot be written ({error.strerror})") from error
    return header["digest"]


def shipped_model(purpose: Purpose) -> Model:
    """The weights that come with the package."""
    name = f"{purpose.task}-{purpose.preset}.safetensors"
    with as_file(files("analysis.tunenet") / "weights" / name) as path:
        return load_model(path, purpose)


def load_model(path: Path, purpose: Purpose) -> Model:
    """Read weights, and refuse what is damaged or meant for something else.

    Raises:
        WeightsError: says which, and what to do.
    """
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise WeightsError(f"{path}: is larger than any weights of this project")
        with safe_open(path, framework="numpy") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (no dict)
            header = file.metadata() or {}
    except FileNotFoundError as error:
        raise WeightsError(f"{path}: no such file") from error
    except (OSError, SafetensorError, TypeError, ValueError) as error:
        raise WeightsError(f"{path}: is not a readable safetensors file ({error})") from error
    if header.get("format") != FORMAT:
        raise WeightsError(f"{path}: holds no weights of tunenet-train")
    for name, wanted in _strings(purpose).items():
        if name != "rates_hz" and header.get(name) != wanted:
            raise WeightsError(
                f"{path}: weights for {name} {header.get(name, '')[:80]!r}, not {wanted!r}; "
                f"make fitting ones with tunenet-train {purpose.task} --preset {purpose.preset}"
            )
    digest = header.pop("digest", "")
    network = NETWORKS.get(header.get("network", ""))
    if network is None or digest != _digest(tensors, header):
        raise WeightsError(
            f"{path}: the weights are damaged (wrong digest); train or copy them again"
        )
    expected = network.shapes(purpose.inputs, purpose.outputs)
    expected |= {f"scaling.{name}": () for name in _SCALING}
    for name, shape in expected.items():
        tensor = tensors.get(name)
        fits = tensor is not None and (name.startswith("scaling.") or tensor.shape == shape)
        if tensor is None or not fits or not np.isfinite(tensor).all():
            raise WeightsError(f"{path}: tensor {name!r} is missing, misshapen or not finite")
    scaling = Scaling(*(tensors[f"scaling.{name}"] for name in _SCALING))
    weights = {name: tensors[name] for name in network.shapes(purpose.inputs, purpose.outputs)}
    return Model(network, weights, scaling, digest)


def _strings(purpose: Purpose) -> dict[str, str]:
    return {
        "task": purpose.task,
        "preset": purpose.preset,
        "observation": purpose.observation,
        "rates_hz": json.dumps(list(purpose.rates_hz)),
    }


def _digest(tensors: Mapping[str, NDArray[np.float64]], header: Mapping[str, str]) -> str:
    state = hashlib.sha256(json.dumps(sorted(header.items())).encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        state.update(f"{name} {tensor.dtype} {tensor.shape}".encode())
        state.update(np.ascontiguousarray(tensor).tobytes())
    return state.hexdigest()
