"""Weights fit their purpose, and damage never passes."""

from __future__ import annotations

import hashlib
import json
import os
import struct
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.tunenet.network import NETWORKS, Model, Scaling, initial_weights
from tunenet_logs.analysis.tunenet.weights import Purpose, load_model, save_model, shipped_model
from tunenet_logs.errors import WeightsError

Header = dict[str, Any]


def parted(data: bytes) -> tuple[Header, bytes]:
    """Header and tensors of a whole file."""
    (length,) = struct.unpack_from("<Q", data)
    return json.loads(data[8 : 8 + length]), data[8 + length :]


def joined(header: Header | str, tensors: bytes) -> bytes:
    text = header if isinstance(header, str) else json.dumps(header)
    return struct.pack("<Q", len(text.encode())) + text.encode() + tensors


def with_own_digest(header: Header, tensors: bytes) -> Header:
    """As one who knows how it is made would write it; as it was where there is none to make."""
    try:
        told = {name: text for name, text in header["__metadata__"].items() if name != "digest"}
        state = hashlib.sha256(json.dumps(sorted(told.items())).encode())
        for name in sorted(name for name in header if name != "__metadata__"):
            start, end = header[name]["data_offsets"]
            state.update(f"{name} float64 {tuple(header[name]['shape'])}".encode())
            state.update(tensors[start:end])
    except (LookupError, TypeError, ValueError, AttributeError):
        return header
    return {**header, "__metadata__": {**told, "digest": state.hexdigest()}}


DTYPES: tuple[Any, ...] = (
    "F8_E4M3", "F8_E5M2", "C64", "I8", "U8", "BOOL", "F16", "BF16", "F32", "I64", "X", 7, None
)  # fmt: skip
SHAPES: tuple[Any, ...] = (
    [], [0], [1], [2, 2], [-1], [2**63], [2**32, 2**32], [1.0], ["1"], None, 1, "x", [1] * 5000,
)  # fmt: skip
OFFSETS: tuple[Any, ...] = (
    [0, 0], [0, 8], [8, 0], [0, 2**63], [-8, 0], [0], [0, 8, 16], None, "0", [0.0, 8.0], [True, 8],
)  # fmt: skip
WORDS: tuple[Any, ...] = (
    "", "nan", "[NaN]", "[1e999]", "[]", "[-60]", "\x1b[31mred\nline", "x" * 100_000, 7, None, [[]],
    "9" * 5000, "[" * 5000,
)  # fmt: skip
PLACES = {"dtype": DTYPES, "shape": SHAPES, "data_offsets": OFFSETS}
ENTRIES: tuple[Any, ...] = (None, 7, [], {}, "x", {"dtype": "F64"})
NAMES = ("", "x", "scaling.x", "\x1b[31m", "y" * 10_000)


def edited(header: Header) -> Iterator[Header]:
    """One value of the header changed."""
    told = header["__metadata__"]
    for name in set(header) - {"__metadata__"}:
        for place, values in PLACES.items():
            yield from ({**header, name: {**header[name], place: value}} for value in values)
        yield from ({**header, name: entry} for entry in ENTRIES)
        others = {one: value for one, value in header.items() if one != name}
        yield from ({**others, other: header[name]} for other in NAMES)
    for key in (*told, "new"):
        yield from ({**header, "__metadata__": {**told, key: word}} for word in WORDS)
    yield from ({**header, "__metadata__": one} for one in (None, [], "x"))


def forged(data: bytes) -> Iterator[bytes]:
    """Real files with one thing wrong with each; a few are whole after all."""
    header, tensors = parted(data)
    for one in edited(header):
        yield joined(with_own_digest(one, tensors), tensors)
    text = json.dumps(header)
    twice = text.replace('"__metadata__"', '"__metadata__": {}, "__metadata__"')
    nested = ("[" * 60_000, '{"a":' * 10_000, " " * 100_000 + text)
    for words in (twice, text[:-1] + "," + text[1:], *nested):
        yield joined(words, tensors)
    for length in (0, 1, 2**20, 2**40, 2**64 - 1):
        yield struct.pack("<Q", length) + data[8:]
    yield from (data[:end] for end in range(0, len(data), len(data) // 20))
    yield from (data + bytes(more) for more in (1, 8, 100_000))


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


def test_any_flipped_bit_is_refused(saved: Path):
    whole = saved.read_bytes()
    rng = np.random.default_rng(0)
    for at in rng.integers(0, len(whole), 300):
        damaged = bytearray(whole)
        damaged[at] ^= 1 << int(rng.integers(8))
        saved.write_bytes(bytes(damaged))
        with pytest.raises(WeightsError):
            load_model(saved, PURPOSE)


@pytest.mark.parametrize("name", TRAININGS)
def test_the_package_ships_weights_for_every_preset(name: str):
    preset = TRAININGS[name]
    model = shipped_model(preset.purpose)
    assert model.network.kind == preset.network.kind


def test_nothing_but_our_own_error_comes_of_a_forged_file(saved: Path):
    forgeries = list(forged(saved.read_bytes()))
    said: list[str] = []
    tracemalloc.start()
    for data in forgeries:
        saved.write_bytes(data)
        try:
            load_model(saved, PURPOSE)
        except WeightsError as error:
            said.append(str(error))
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(said) > 0.9 * len(forgeries) > 300
    for line in said:
        assert line.isprintable()
        assert len(line.removeprefix(f"{saved}: ")) < min(400, len(line))
    assert peak_bytes < 4_000_000


NO_FILES = {
    **dict.fromkeys((b"", b"hello", b"\xff" * 100, b"\x80\x04K\x01."), "safetensors"),
    "missing": "no such file",
    "pipe": "regular file",
}


@pytest.mark.parametrize("content", NO_FILES)
def test_what_are_no_weights_is_refused(tmp_path: Path, content: bytes | str):
    if isinstance(content, bytes):
        (tmp_path / "w").write_bytes(content)
    elif content == "pipe":
        os.mkfifo(tmp_path / "w")
    with pytest.raises(WeightsError, match=NO_FILES[content]):
        load_model(tmp_path / "w", PURPOSE)


def with_offset(values: int) -> Model:
    scaling = Scaling(np.zeros(12), np.ones(1), np.zeros(values), np.ones(1))
    return replace(make(), scaling=scaling)


@pytest.mark.parametrize(
    ("model", "purpose", "says"),
    [
        (make(np.nan), {}, "not finite"),
        (make(np.inf), {}, "not finite"),
        (make(1e200), {}, "beyond"),
        (make(), {"inputs": 13}, "misshapen"),
        *((with_offset(values), {}, r"scaling\.output_offset.*misshapen") for values in (2, 3, 12)),
        *((make(), {name: "other"}, "other") for name in ("preset", "task", "observation")),
    ],
)
def test_weights_that_do_not_fit_are_refused(
    tmp_path: Path, model: Model, purpose: dict[str, Any], says: str
):
    save_model(tmp_path / "w", model, PURPOSE, {})
    with pytest.raises(WeightsError, match=says):
        load_model(tmp_path / "w", replace(PURPOSE, **purpose))


@pytest.mark.parametrize("rates", ["[NaN]", "[]", "[1e999]", "[-60]", "[true]", "60", "[" * 5000])
def test_rates_that_a_stranger_rewrites_are_refused(saved: Path, rates: str):
    header, tensors = parted(saved.read_bytes())
    header["__metadata__"]["rates_hz"] = rates
    saved.write_bytes(joined(with_own_digest(header, tensors), tensors))
    with pytest.raises(WeightsError, match="rates_hz"):
        load_model(saved, PURPOSE)
