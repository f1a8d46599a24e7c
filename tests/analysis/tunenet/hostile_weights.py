"""Weights that a stranger changed: the header of a real file, edited; its digest made to fit."""

from __future__ import annotations

import hashlib
import json
import random
import struct
from collections.abc import Callable
from typing import Any

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


DTYPES = (
    "F8_E4M3",
    "F8_E5M2",
    "C64",
    "I8",
    "U8",
    "BOOL",
    "F16",
    "BF16",
    "F32",
    "I64",
    "X",
    7,
    None,
)
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


def edits(header: Header, chance: random.Random) -> Header:
    """One value of the header changed."""
    name = chance.choice([one for one in header if one != "__metadata__"])
    place = chance.choice([*3 * ["dtype", "shape", "data_offsets"], "entry", "name", "words"])
    if place in ("dtype", "shape", "data_offsets"):
        value = chance.choice({"dtype": DTYPES, "shape": SHAPES, "data_offsets": OFFSETS}[place])
        return {**header, name: {**header[name], place: value}}
    if place == "entry":
        return {**header, name: chance.choice([None, 7, [], {}, "x", {"dtype": "F64"}])}
    if place == "name":
        other = chance.choice(["", "x", "scaling.x", "\x1b[31m", "y" * 10_000])
        return {one if one != name else other: value for one, value in header.items()}
    told = dict(header["__metadata__"])
    told[chance.choice([*told, "new"])] = chance.choice(WORDS)
    return {**header, "__metadata__": chance.choice([told, told, told, None, [], "x"])}


def forged(data: bytes, chance: random.Random) -> bytes:
    """A real file with one thing wrong with it; now and then one that is whole after all."""
    header, tensors = parted(data)
    text = json.dumps(header)
    ways: tuple[Callable[[], bytes], ...] = (
        *6 * [lambda: joined(with_own_digest(edits(header, chance), tensors), tensors)],
        lambda: joined(edits(header, chance), tensors),
        lambda: struct.pack("<Q", chance.choice([0, 1, 2**20, 2**40, 2**64 - 1])) + data[8:],
        lambda: joined(
            text.replace('"__metadata__"', '"__metadata__": {}, "__metadata__"'), tensors
        ),
        lambda: joined(text[:-1] + "," + text[1:], tensors),
        lambda: joined("[" * chance.choice([100, 10_000, 60_000]), tensors),
        lambda: joined('{"a":' * 10_000, tensors),
        lambda: joined(" " * chance.choice([8, 100_000]) + text, tensors),
        lambda: data[: chance.randrange(len(data))],
        lambda: data + bytes(chance.choice([1, 8, 100_000])),
        lambda: _flipped(data, chance),
    )
    return chance.choice(ways)()


def _flipped(data: bytes, chance: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(chance.randint(1, 8)):
        changed[chance.randrange(len(data))] = chance.randrange(256)
    return bytes(changed)
