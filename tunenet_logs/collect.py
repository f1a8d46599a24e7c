"""From decoded messages, one at a time, to the signals of an episode."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Signal
from tunenet_logs.formats.kinds import JointSample, Picture, Place
from tunenet_logs.stamps import order_samples, trusts_header

_MOST_NAMES = 1000
"""Bodies or joints of one topic; more are no robot's, but a damaged or hostile log's."""
_NOTHING = array("d", [float("nan")] * _MOST_NAMES).tobytes()


@dataclass
class _Rows:
    """Samples with the same columns, flat: a log of an hour must fit."""

    header_ns: array[int] = field(default_factory=lambda: array("q"))
    log_ns: array[int] = field(default_factory=lambda: array("q"))
    order: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def add(self, header_ns: int, log_ns: int, order: int) -> None:
        """The stamps of a sample; the first may not fit.

        Raises:
            OverflowError: it lies beyond the year 2262.
        """
        self.header_ns.append(header_ns)
        self.log_ns.append(log_ns)
        self.order.append(order)


class PositionRows:
    """Places of one topic, apart by what they are the place of."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._rows: dict[str, _Rows] = {}
        self._count = 0

    def add(self, log_ns: int, places: Iterable[Place]) -> None:
        """The places of one message.

        Raises:
            ValueError, OverflowError: they make no sense.
        """
        for stamp_ns, name, x, y, z in places:
            rows = self._rows.get(name)
            if rows is None:
                if len(self._rows) >= _MOST_NAMES:
                    raise ValueError(f"over {_MOST_NAMES} names in {self._topic}")
                rows = self._rows[name] = _Rows()
            self._count += 1
            rows.add(stamp_ns, log_ns, self._count)
            rows.values.extend((x, y, z))

    def signals(self) -> tuple[list[Signal], list[str]]:
        """One for each thing that has a place, and what was repaired."""
        found: list[Signal] = []
        notes: list[str] = []
        for name, rows in self._rows.items():
            full = f"{self._topic}.{name}" if name else self._topic
            values = np.frombuffer(rows.values, np.float64).reshape(-1, 3)
            signal, repairs = _signal(full, _stamps(rows), values, ("x", "y", "z"), "m")
            found.append(signal)
            notes += repairs
        return found, notes


class JointRows:
    """Joints of one topic: positions, velocities and efforts, each a signal."""

    _PARTS = (("position", "rad"), ("velocity", "rad/s"), ("effort", "N·m"))

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._blocks: dict[tuple[str, ...], tuple[_Rows, tuple[array[float], ...]]] = {}
        self._count = 0

    def add(self, log_ns: int, sample: JointSample) -> None:
        """One message.

        Raises:
            ValueError, OverflowError: it makes no sense.
        """
        stamp_ns, names, *said = sample
        position, velocity, effort = (np.asarray(part, np.float64).tobytes() for part in said)
        names = names or _numbered(max(len(position), len(velocity), len(effort)) // 8)
        block = self._blocks.get(names)
        if block is None:
            block = self._new_block(names)
        rows, (positions, velocities, efforts) = block
        width = 8 * len(names)
        if not {len(position), len(velocity), len(effort)} <= {0, width}:
            raise ValueError(f"a message has {len(names)} names but another number of values")
        self._count += 1
        rows.add(stamp_ns, log_ns, self._count)
        positions.frombytes(position or _NOTHING[:width])
        velocities.frombytes(velocity or _NOTHING[:width])
        efforts.frombytes(effort or _NOTHING[:width])

    def _new_block(self, names: tuple[str, ...]) -> tuple[_Rows, tuple[array[float], ...]]:
        known = sum(len(one) for one in self._blocks)
        if known + len(names) > _MOST_NAMES or len(set(names)) < len(names):
            raise ValueError(f"too many joints, or two of one name, in {self._topic}")
        self._blocks[names] = (_Rows(), (array("d"), array("d"), array("d")))
        return self._blocks[names]

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Those of the three that say anything, and what was repaired."""
        columns = tuple(dict.fromkeys(name for names in self._blocks for name in names))
        blocks = list(self._blocks.items())
        if not blocks:
            return [], []
        order = np.concatenate([np.frombuffer(rows.order, np.int64) for _, (rows, _) in blocks])
        stamps = np.concatenate([_stamps(rows) for _, (rows, _) in blocks])
        ranks = np.argsort(order)
        found: list[Signal] = []
        notes: list[str] = []
        for part, (label, unit) in enumerate(self._PARTS):
            values = np.full((len(order), len(columns)), np.nan)
            row = 0
            for names, (_, stores) in blocks:
                block = np.frombuffer(stores[part], np.float64).reshape(-1, len(names))
                places = [columns.index(one) for one in names]
                values[row : row + len(block), places] = block
                row += len(block)
            if np.isfinite(values).any():
                full = f"{self._topic}.{label}"
                signal, repairs = _signal(full, stamps[ranks], values[ranks], columns, unit)
                found.append(signal)
                notes = [note.replace(f"{full}:", f"{self._topic}:", 1) for note in repairs]
        return found, notes


class PictureStamps:
    """When the pictures of one topic were taken; they themselves are read when asked for."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._header_ns: array[int] = array("q")

    def add(self, _log_ns: int, picture: Picture) -> None:
        """One picture.

        Raises:
            OverflowError: its stamp lies beyond the year 2262.
        """
        self._header_ns.append(picture.stamp_ns)

    def trusts_header(self) -> tuple[bool, list[str]]:
        """Whether the pictures' own stamps tell the time, and if not, why not."""
        is_header, reasons = trusts_header(np.array(self._header_ns, np.int64))
        return is_header, [f"{self._topic}: {reason}" for reason in reasons]


def _numbered(count: int) -> tuple[str, ...]:
    return tuple(f"joint{number}" for number in range(1, count + 1))


def _stamps(rows: _Rows) -> NDArray[np.int64]:
    """Header and log stamps, shape (T, 2)."""
    header_ns = np.frombuffer(rows.header_ns, np.int64)
    return np.column_stack([header_ns, np.frombuffer(rows.log_ns, np.int64)])


def _signal(
    name: str,
    stamps: NDArray[np.int64],
    values: NDArray[np.float64],
    columns: tuple[str, ...],
    unit: str,
) -> tuple[Signal, list[str]]:
    keep, stamps_ns, repairs = order_samples(stamps[:, 0], stamps[:, 1])
    kept = values[keep]
    kept[~np.isfinite(kept)] = np.nan
    return Signal(name, stamps_ns, kept, columns, unit), [f"{name}: {note}" for note in repairs]
