"""Save and load trained weights: safetensors with their purpose, which is checked.

Files are read strictly, the header before the tensors. The format: 8 bytes with the header's
length, little-endian; the header, a JSON object with dtype, shape and place of each tensor by name,
and strings under `__metadata__`; the tensors' bytes.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import struct
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from tunenet_logs.analysis.tunenet.network import NETWORKS, Model, Scaling
from tunenet_logs.episode import Array
from tunenet_logs.errors import LogError, WeightsError
from tunenet_logs.files import parse_json, read_small_file
from tunenet_logs.terminal import one_line, short_name
from tunenet_logs.writing.owned_path import OutputPlace

REMEDY = "train the network again, or copy its file again"
_MAX_FILE_BYTES = 32 * 1024 * 1024  # thirty times the largest network of ours
_MAX_HEADER_BYTES = 64 * 1024  # thirty times what a header of ours takes
# Strings in a header, and characters in one: several times what ours have.
_MAX_NOTES, _MAX_CHARACTERS = 64, 4000
_MAX_SIZE = 1e9  # of a weight: no product of a network's layers is then infinite
_DTYPE, _NUMPY_DTYPE = "F64", np.dtype("<f8")  # what `tunenet-train` writes


@dataclass(frozen=True)
class WeightsFile:
    """Safetensors file with a valid header."""

    path: Path
    metadata: Mapping[str, str]  # its strings by name
    entries: Mapping[str, Any]  # the header's entry of each tensor
    data: bytes  # the tensors' bytes

    def tensors(self, wanted: Mapping[str, Collection[tuple[int, ...]]]) -> dict[str, Array]:
        """Read exactly the `wanted` tensors, each in one of its shapes, contiguous in the file."""
        found: dict[str, Array] = {}
        places: list[tuple[int, int, str]] = []
        for name in self.entries:
            if name not in wanted:
                raise self._wrong(f"tensor {short_name(name)!r} is none of this network")
        for name, shapes in wanted.items():
            entry = self.entries.get(name)
            if entry is None:
                raise self._wrong(f"tensor {name!r} is missing")
            if not isinstance(entry, dict) or entry.keys() != {"dtype", "shape", "data_offsets"}:
                raise self._wrong(f"tensor {name!r} has no dtype, shape and data_offsets")
            kind, shape, offsets = entry["dtype"], entry["shape"], entry["data_offsets"]
            if kind != _DTYPE:
                what = short_name(kind)
                raise self._wrong(f"tensor {name!r} has the dtype {what}, not {_DTYPE}")
            if not _are_whole(shape) or tuple(shape) not in shapes:
                known = " or ".join(map(str, sorted(set(shapes))))
                raise self._wrong(f"tensor {name!r} is misshapen: {short_name(shape)}, not {known}")
            count = math.prod(shape)
            size = count * _NUMPY_DTYPE.itemsize
            if not _are_whole(offsets) or len(offsets) != 2 or offsets[1] - offsets[0] != size:
                what = short_name(offsets)
                raise self._wrong(f"tensor {name!r} has data_offsets {what} for {size} bytes")
            start = offsets[0]
            places.append((start, start + size, name))
            if start + size > len(self.data):
                raise self._wrong(f"tensor {name!r} goes beyond the file's end")
            flat = np.frombuffer(self.data, _NUMPY_DTYPE, count, offset=start)
            found[name] = flat.reshape(shape)
        ends = [0, *(end for _, end, _ in sorted(places))]
        for (start, _, name), end_before in zip(sorted(places), ends, strict=False):
            if start != end_before:
                raise self._wrong(f"tensor {name!r} does not begin where the one before it ends")
        if ends[-1] != len(self.data):
            raise self._wrong(f"{len(self.data) - ends[-1]} bytes after its tensors")
        for name, tensor in found.items():
            if not np.all(np.abs(tensor) <= _MAX_SIZE):
                raise self._wrong(f"tensor {name!r} is not finite, or beyond {_MAX_SIZE:g}")
        return found

    def _wrong(self, what: str) -> WeightsError:
        return WeightsError(f"{self.path}: {what}; {REMEDY}")


def in_one_order(content: bytes) -> bytes:
    """Sort the header's strings: the library writes them in any order."""
    (length,) = struct.unpack_from("<Q", content)
    header = json.loads(content[8 : 8 + length])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    written = json.dumps(header, separators=(",", ":"), ensure_ascii=False).encode()
    written += b" " * (-len(written) % 8)  # the tensors begin at a multiple of 8
    return struct.pack("<Q", len(written)) + written + content[8 + length :]


def read_weights_file(path: Path) -> WeightsFile:
    """Read a file and check its header."""
    try:
        content = read_small_file(path, _MAX_FILE_BYTES)
        # Split into the tensors' bytes, and the header.
        if len(content) < 8:
            raise ValueError(f"{len(content)} bytes")
        (length,) = struct.unpack_from("<Q", content)
        if length > _MAX_HEADER_BYTES:
            raise ValueError(f"a header of {length} bytes; {_MAX_HEADER_BYTES} at most")
        if 8 + length > len(content):
            raise ValueError(f"a header of {length} bytes in a file of {len(content)}")
        header = parse_json(content[8 : 8 + length])
        if not isinstance(header, dict):
            raise ValueError("its header is no object")
        data = content[8 + length :]
    except FileNotFoundError as error:
        raise WeightsError(f"{path}: no such file") from error
    except LogError as error:
        raise WeightsError(str(error)) from error
    except OSError as error:
        raise WeightsError(f"{path}: cannot be read ({error.strerror}); {REMEDY}") from error
    except ValueError as error:
        why = one_line(error)
        raise WeightsError(f"{path}: is no readable safetensors file ({why}); {REMEDY}") from error
    metadata = header.pop("__metadata__", {})
    if not isinstance(metadata, dict) or len(metadata) > _MAX_NOTES:
        raise WeightsError(f"{path}: its __metadata__ is no list of a few strings; {REMEDY}")
    for name, text in metadata.items():
        if not isinstance(text, str) or max(len(text), len(name)) > _MAX_CHARACTERS:
            what = f"{short_name(name)!r} in its __metadata__"
            raise WeightsError(
                f"{path}: {what} is no string of at most {_MAX_CHARACTERS} characters; {REMEDY}"
            )
    return WeightsFile(path, metadata, header, data)


def _are_whole(values: Any) -> bool:
    """Return whether this is a short list of non-negative integers."""
    return (
        isinstance(values, list)
        and len(values) <= 4
        and all(type(value) is int and value >= 0 for value in values)
    )


# ---- Weights: a network's tensors with its purpose and a digest of both.

FORMAT = "tunenet-weights/1"
# How a file of ours begins, and in how many bytes that shows.
_HEADER = re.compile(
    rb'.{8}\{[^{]{0,40000}"__metadata__": ?\{[^}]{0,40000}"format": ?"tunenet-weights/', re.DOTALL
)
_SCALING = tuple(one.name for one in fields(Scaling))


@dataclass(frozen=True)
class Purpose:
    """Purpose that a network was trained for; weights fit only the same one."""

    task: str  # "drop"
    preset: str  # see `Preset`
    observation: str  # input of the network, with its grid
    inputs: int  # number of values in one observation
    outputs: int  # number of parameters
    rates_hz: tuple[float, ...]  # sampling rates that it was trained with


def save_model(path: Path, model: Model, purpose: Purpose, notes: Mapping[str, str]) -> str:
    """Write weights atomically, and return the digest."""
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
        return () if _HEADER.match(file.read(65536)) else None

    return OutputPlace(path, "file of weights", knows)


@lru_cache(maxsize=8)
def shipped_model(purpose: Purpose) -> Model:
    """Load the weights that come with the package."""
    name = f"{purpose.task}-{purpose.preset}.safetensors"
    with as_file(files("tunenet_logs.analysis.tunenet") / "weights" / name) as path:
        return load_model(path, purpose)


def load_model(path: Path, purpose: Purpose) -> Model:
    """Load weights; refuse damaged ones and those for another purpose."""
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
    try:
        rates = parse_json(header.get("rates_hz", ""))
    except ValueError:
        rates = None
    # A hundred rates of one network at most, up to 1 MHz.
    if (
        not isinstance(rates, list)
        or not 0 < len(rates) <= 100
        or not all(type(rate) in (int, float) and 0 < rate <= 1e6 for rate in rates)
    ):
        raise WeightsError(f"{path}: rates_hz is no list of rates; {REMEDY}")
    digest = header.pop("digest", "")
    network = NETWORKS.get(header.get("network", ""))
    if network is None:
        kind = short_name(header.get("network", ""))
        raise WeightsError(f"{path}: network {kind!r} is none of {', '.join(NETWORKS)}; {REMEDY}")
    shapes = network.shapes(purpose.inputs, purpose.outputs)
    # The scaling's shapes: one number for all inputs or outputs, or one for each.
    tensors = file.tensors(
        {name: [shape] for name, shape in shapes.items()}
        | {
            f"scaling.{name}": [(1,), (purpose.inputs if "input" in name else purpose.outputs,)]
            for name in _SCALING
        }
    )
    if digest != _digest(tensors, header):
        raise WeightsError(f"{path}: the weights are damaged (wrong digest); {REMEDY}")
    scaling = Scaling(*(tensors[f"scaling.{name}"] for name in _SCALING))
    return Model(network, {name: tensors[name] for name in shapes}, scaling, digest)


def _strings(purpose: Purpose) -> dict[str, str]:
    texts = {name: getattr(purpose, name) for name in ("task", "preset", "observation")}
    return {**texts, "rates_hz": json.dumps(list(purpose.rates_hz))}


def _digest(tensors: Mapping[str, NDArray[np.float64]], header: Mapping[str, str]) -> str:
    state = hashlib.sha256(json.dumps(sorted(header.items())).encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        state.update(f"{name} {tensor.dtype} {tensor.shape}".encode())
        state.update(np.ascontiguousarray(tensor).tobytes())
    return state.hexdigest()
