"""From decoded messages, one at a time, to the signals of an episode."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Signal
from tunenet_logs.formats.base import BeyondLimitError
from tunenet_logs.formats.message_types import JointSample, PictureSample, PositionSample
from tunenet_logs.timestamp_correction import order_samples, sorted_stamps, trusts_header

_MOST_NAMES = 1000
"""Bodies or joints of one topic; more are no robot's, but a damaged or hostile log's."""
_NAMES = tuple(f"joint{number}" for number in range(1, _MOST_NAMES + 2))
"""What joints without names are called; one more than there may be, so that too many are seen."""

_NOTHING = array("d", [float("nan")] * _MOST_NAMES).tobytes()
"""A quantity that a message does not give, as the bytes of its values."""


@dataclass
class _SampleBuffer:
    """Samples with the same columns, flat: a log of an hour must fit.

    A header stamp goes in first: it may not fit, where it lies beyond the year 2262.
    """

    header_ns: array[int] = field(default_factory=lambda: array("q"))
    log_ns: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))


class PositionRows:
    """Positions of one topic, apart by body and frame."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._rows: dict[tuple[str, str], _SampleBuffer] = {}

    def add(self, log_ns: int, positions: Iterable[PositionSample]) -> None:
        """The positions of one message.

        Raises:
            BeyondLimitError: more bodies than a topic may have.
            ValueError, OverflowError: they make no sense.
        """
        for stamp_ns, name, frame, x, y, z in positions:
            rows = self._rows.get((name, frame))
            if rows is None:
                if len(self._rows) >= _MOST_NAMES:
                    raise BeyondLimitError(f"over {_MOST_NAMES} names")
                rows = self._rows[name, frame] = _SampleBuffer()
            rows.header_ns.append(stamp_ns)
            rows.log_ns.append(log_ns)
            rows.values.extend((x, y, z))

    def signals(self) -> tuple[list[Signal], list[str]]:
        """A signal [m] for each body and frame, and what was repaired."""
        found: list[Signal] = []
        notes: list[str] = []
        taken: set[str] = set()
        for (name, frame), rows in self._rows.items():
            full = f"{self._topic}.{name}" if name else self._topic
            if full in taken:
                full = f"{full}@{frame}"
                notes.append(f"{full}: {name} has a place in several frames, each is by itself")
            taken.add(full)
            values = np.frombuffer(rows.values, np.float64).reshape(-1, 3)
            keep, stamps_ns, repairs = order_samples(
                np.frombuffer(rows.header_ns, np.int64), np.frombuffer(rows.log_ns, np.int64)
            )
            found.append(_signal(full, stamps_ns, values[keep], ("x", "y", "z"), "m"))
            notes += [f"{full}: {repair}" for repair in repairs]
        return found, notes


class JointRows:
    """Joints of one topic: positions, velocities and efforts, each a signal."""

    _QUANTITIES = (("position", "rad"), ("velocity", "rad/s"), ("effort", "N·m"))

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._blocks: dict[tuple[str, ...], tuple[_SampleBuffer, tuple[array[float], ...]]] = {}

    def add(self, log_ns: int, sample: JointSample) -> None:
        """One message.

        Raises:
            ValueError, OverflowError: it makes no sense.
        """
        stamp_ns, names, *given = sample
        position, velocity, effort = (np.asarray(values, np.float64).tobytes() for values in given)
        names = names or _NAMES[: max(len(position), len(velocity), len(effort)) // 8]
        block = self._blocks.get(names)
        if block is None:
            if sum(map(len, self._blocks)) + len(names) > _MOST_NAMES:
                raise BeyondLimitError(f"over {_MOST_NAMES} joints")
            if len(set(names)) < len(names):
                raise ValueError("two joints have one name")
            block = self._blocks[names] = (_SampleBuffer(), (array("d"), array("d"), array("d")))
        rows, (positions, velocities, efforts) = block
        width = 8 * len(names)
        if not {len(position), len(velocity), len(effort)} <= {0, width}:
            raise ValueError(f"a message has {len(names)} names but another number of values")
        rows.header_ns.append(stamp_ns)
        rows.log_ns.append(log_ns)
        positions.frombytes(position or _NOTHING[:width])
        velocities.frombytes(velocity or _NOTHING[:width])
        efforts.frombytes(effort or _NOTHING[:width])

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Those of the three quantities that have any value, and what was repaired.

        Messages with one stamp and different joints make one sample: several may publish them.
        """
        blocks = list(self._blocks.items())
        if not blocks:
            return [], []
        columns = tuple(dict.fromkeys(name for names in self._blocks for name in names))
        headers = [np.frombuffer(rows.header_ns, np.int64) for _, (rows, _) in blocks]
        logs = [np.frombuffer(rows.log_ns, np.int64) for _, (rows, _) in blocks]
        is_header, notes = trusts_header(np.concatenate(headers))
        ordered = [sorted_stamps(own_ns) for own_ns in (headers if is_header else logs)]
        notes += [repair for _, _, repairs in ordered for repair in repairs]
        stamps_ns = np.unique(np.concatenate([own_ns for _, own_ns, _ in ordered]))
        found: list[Signal] = []
        for quantity, (label, unit) in enumerate(self._QUANTITIES):
            values = np.full((len(stamps_ns), len(columns)), np.nan)
            for (names, (_, stores)), (keep, own_ns, _) in zip(blocks, ordered, strict=True):
                block = np.frombuffer(stores[quantity], np.float64).reshape(-1, len(names))[keep]
                indices = np.array([columns.index(name) for name in names])
                cells = np.ix_(np.searchsorted(stamps_ns, own_ns), indices)
                values[cells] = np.where(np.isnan(values[cells]), block, values[cells])
            if np.isfinite(values).any():
                found.append(_signal(f"{self._topic}.{label}", stamps_ns, values, columns, unit))
        return found, [f"{self._topic}: {note}" for note in dict.fromkeys(notes)]


class PictureStamps:
    """When the pictures of one topic were taken; they themselves are read when asked for."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._header_ns: array[int] = array("q")

    def add(self, _log_ns: int, picture: PictureSample) -> None:
        """One picture.

        Raises:
            OverflowError: its stamp lies beyond the year 2262.
        """
        self._header_ns.append(picture.stamp_ns)

    def trusts_header(self) -> tuple[bool, list[str]]:
        """Whether the pictures' own stamps tell the time, and if not, why not."""
        is_header, reasons = trusts_header(np.array(self._header_ns, np.int64))
        return is_header, [f"{self._topic}: {reason}" for reason in reasons]


def with_joint_names(signal: Signal, names: Sequence[str]) -> Signal:
    """The same with these names for joints, where its messages carry none.

    Args:
        signal: of joints, or of anything else, which stays as it is.
        names: as many as it has joints, else it stays as it is.
    """
    if signal.columns != _NAMES[: len(names)] or len(set(names)) < len(names):
        return signal
    return replace(signal, columns=tuple(names))


def _signal(
    name: str,
    stamps_ns: NDArray[np.int64],
    values: NDArray[np.float64],
    columns: tuple[str, ...],
    unit: str,
) -> Signal:
    values[~np.isfinite(values)] = np.nan
    return Signal(name, stamps_ns, values, columns, unit)
