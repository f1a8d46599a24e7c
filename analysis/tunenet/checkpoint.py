"""Save and load trained weights: safetensors with their purpose, which is checked."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from analysis.tunenet.network import NETWORKS, Model, Scaling
from analysis.tunenet.weights_file import REMEDY, in_one_order, read_weights_file
from tunenet_logs.errors import LogError, WeightsError
from tunenet_logs.output.owned_file import OutputPlace
from tunenet_logs.small_files import parse_json
from tunenet_logs.terminal import one_line, short_name

FORMAT = "tunenet-weights/1"
_HEADER = re.compile(
    rb'.{8}\{[^{]{0,40000}"__metadata__": ?\{[^}]{0,40000}"format": ?"tunenet-weights/', re.DOTALL
)
_HEADER_BYTES = 65536  # how a file of ours begins, and in how many bytes that shows
_MAX_RATES, _MAX_HZ = 100, 1e6  # sampling rates of one network, and the highest
_SCALING = ("input_offset", "input_gain", "output_offset", "output_gain")


@dataclass(frozen=True)
class Purpose:
    """Purpose that a network was trained for; weights fit only the same one.

    Attributes:
        task: "drop".
        preset: See `Preset`.
        observation: Input of the network, with its grid.
        inputs: Number of values in one observation.
        outputs: Number of parameters.
        rates_hz: Sampling rates that it was trained with.
    """

    task: str
    preset: str
    observation: str
    inputs: int
    outputs: int
    rates_hz: tuple[float, ...]


def save_model(path: Path, model: Model, purpose: Purpose, notes: Mapping[str, str]) -> str:
    """Write weights atomically, and return the digest.

    Args:
        path: The file; other weights there are replaced.
        model: To save; its own digest is ignored.
        purpose: That it was trained for.
        notes: How it was trained, in words; part of the digest.

    Raises:
        WeightsError: The file cannot be written.
    """
    tensors = {name: np.ascontiguousarray(value) for name, value in model.weights.items()}
    tensors |= {f"scaling.{name}": getattr(model.scaling, name) for name in _SCALING}
    header = {"format": FORMAT, "network": model.network.kind, **_strings(purpose), **notes}
    header["digest"] = _digest(tensors, header)
    try:
        with weights_place(path).replacing() as partial:
            partial.write_bytes(in_one_order(save(tensors, header)))
    except LogError as error:
        raise WeightsError(str(error)) from error
    except OSError as error:
        raise WeightsError(f"{path}: cannot be written ({error.strerror})") from error
    return header["digest"]


def weights_place(path: Path) -> OutputPlace:
    """Return the output place of weights, which may replace other weights."""

    def knows(file: BinaryIO) -> Sequence[str] | None:
        return () if _HEADER.match(file.read(_HEADER_BYTES)) else None

    return OutputPlace(path, "file of weights", knows)


def shipped_model(purpose: Purpose) -> Model:
    """Load the weights that come with the package."""
    name = f"{purpose.task}-{purpose.preset}.safetensors"
    with as_file(files("analysis.tunenet") / "weights" / name) as path:
        return load_model(path, purpose)


def load_model(path: Path, purpose: Purpose) -> Model:
    """Load weights; refuse damaged ones and those for another purpose.

    Raises:
        WeightsError: Which of these, and the remedy.
    """
    file = read_weights_file(path)
    header = dict(file.metadata)
    if header.get("format") != FORMAT:
        raise WeightsError(f"{path}: holds no weights of tunenet-train; give --weights such a file")
    for name, wanted in _strings(purpose).items():
        told = header.get(name, "")
        if name != "rates_hz" and told != wanted:
            raise WeightsError(
                f"{path}: weights for {name} {one_line(told[:80])!r}, not {wanted!r}; "
                f"make fitting ones with tunenet-train {purpose.task} --preset {purpose.preset}"
            )
    if not _are_rates(header.get("rates_hz", "")):
        raise WeightsError(f"{path}: rates_hz is no list of rates; {REMEDY}")
    digest = header.pop("digest", "")
    network = NETWORKS.get(header.get("network", ""))
    if network is None:
        kind = short_name(header.get("network", ""))
        raise WeightsError(f"{path}: network {kind!r} is none of {', '.join(NETWORKS)}; {REMEDY}")
    shapes = network.shapes(purpose.inputs, purpose.outputs)
    tensors = file.tensors(
        {name: [shape] for name, shape in shapes.items()} | _scaling_shapes(purpose)
    )
    if digest != _digest(tensors, header):
        raise WeightsError(f"{path}: the weights are damaged (wrong digest); {REMEDY}")
    scaling = Scaling(*(tensors[f"scaling.{name}"] for name in _SCALING))
    return Model(network, {name: tensors[name] for name in shapes}, scaling, digest)


def _scaling_shapes(purpose: Purpose) -> dict[str, list[tuple[int, ...]]]:
    """Return the scaling's shapes: one number for all inputs or outputs, or one for each."""
    return {
        f"scaling.{name}": [(1,), (purpose.inputs if "input" in name else purpose.outputs,)]
        for name in _SCALING
    }


def _are_rates(text: str) -> bool:
    try:
        rates = parse_json(text)
    except ValueError:
        return False
    return (
        isinstance(rates, list)
        and 0 < len(rates) <= _MAX_RATES
        and all(type(rate) in (int, float) and 0 < rate <= _MAX_HZ for rate in rates)
    )


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
