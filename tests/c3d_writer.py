"""The bytes of a C3D file, after its user guide: https://www.c3d.org/docs/C3D_User_Guide.pdf."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

_KINDS = {"intel": 84, "dec": 85, "mips": 86}


def c3d_bytes(
    points: Mapping[str, NDArray[np.float64]],
    first_frame: int,
    rate_hz: float,
    unit: str,
    *,
    processor: str = "intel",
    scale: float = -1.0,
    analogs: int = 0,
) -> bytes:
    """A whole file.

    Args:
        points: by name, in `unit`, NaN where unseen, shape (T, 3) each.
        first_frame: its number.
        rate_hz: of the frames.
        unit: named in the file.
        processor: "intel", "dec" or "mips".
        scale: units for each step of whole numbers; negative for floating data.
        analogs: channels of other sensors, sampled once a frame.
    """
    names = list(points)
    frames = len(next(iter(points.values())))
    order = ">" if processor == "mips" else "<"
    groups: dict[str, dict[str, bytes]] = {
        "POINT": {
            "USED": _words(order, len(names)),
            "SCALE": _float(processor, scale),
            "RATE": _float(processor, rate_hz),
            "FRAMES": _words(order, min(65535, frames)),
            "LABELS": _texts(names),
            "UNITS": _texts([unit], is_one=True),
        },
        "ANALOG": {
            "USED": _words(order, analogs),
            "RATE": _float(processor, rate_hz),
            "GEN_SCALE": _float(processor, 1.0),
            "SCALE": _float(processor, *[1.0] * analogs),
            "OFFSET": _words(order, *[0] * analogs),
            "LABELS": _texts([f"Channel {at + 1}" for at in range(analogs)]),
            "UNITS": _texts(["V"] * analogs),
        },
    }
    records = b""
    for number, (group, parameters) in enumerate(groups.items(), start=1):
        records += _record(order, group, -number, b"\0")
        for name, body in parameters.items():
            records += _record(order, name, number, body + b"\0")
    blocks = -(-(len(records) + 5) // 512)
    section = bytes([1, 80, blocks, _KINDS[processor]]) + records
    last = min(65535, first_frame + frames - 1)
    header = b"\x02\x50" + struct.pack(f"{order}5H", len(names), analogs, first_frame, last, 10)
    header += _floats(processor, np.array([scale]))
    header += struct.pack(f"{order}2H", 2 + blocks, bool(analogs))
    header += _floats(processor, np.array([rate_hz]))
    rows = np.zeros((frames, 4 * len(names) + analogs))
    for at, xyz in enumerate(points.values()):
        is_seen = np.isfinite(xyz[:, :1])
        rows[:, 4 * at : 4 * at + 3] = np.where(is_seen, xyz, 0) / (scale if scale > 0 else 1)
        rows[:, 4 * at + 3] = np.where(is_seen[:, 0], 0, -1)
    data = (
        np.round(rows).astype(f"{order}i2").tobytes()
        if scale > 0
        else _floats(processor, rows.ravel())
    )
    whole = header.ljust(512, b"\0") + section.ljust(512 * blocks, b"\0") + data
    return whole + bytes(-len(whole) % 512)


def _record(order: str, name: str, group: int, body: bytes) -> bytes:
    """A group or a parameter, with the way to the next."""
    head = struct.pack("<bb", len(name), group) + name.encode()
    return head + struct.pack(f"{order}H", len(body) + 2) + body


def _words(order: str, *values: int) -> bytes:
    return _shape(2, len(values)) + struct.pack(f"{order}{len(values)}H", *values)


def _float(processor: str, *values: float) -> bytes:
    return _shape(4, len(values)) + _floats(processor, np.array(values))


def _shape(kind: int, count: int) -> bytes:
    return struct.pack("<bB", kind, 0) if count == 1 else struct.pack("<bBB", kind, 1, count)


def _texts(texts: Sequence[str], *, is_one: bool = False) -> bytes:
    width = max(map(len, texts), default=0)
    body = b"".join(text.encode().ljust(width) for text in texts)
    shape = [width] if is_one else [width, len(texts)]
    return struct.pack("<bB", -1, len(shape)) + bytes(shape) + body


def _floats(processor: str, values: NDArray[np.float64]) -> bytes:
    """Numbers of 32 bits; DEC's F format is IEEE's with 4 for 1 and its halves swapped."""
    if processor == "mips":
        return values.astype(">f4").tobytes()
    if processor == "dec":
        return (4 * values).astype("<f4").view("<u2").reshape(-1, 2)[:, ::-1].tobytes()
    return values.astype("<f4").tobytes()
