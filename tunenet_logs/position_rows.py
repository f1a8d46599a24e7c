"""From decoded messages, one at a time, to signals of positions and orientations."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from tunenet_logs.arrays import Array
from tunenet_logs.episode import Signal
from tunenet_logs.formats.base import BeyondLimitError
from tunenet_logs.formats.position_types import PositionSample
from tunenet_logs.one_frame import OneFrame
from tunenet_logs.sample_order import order_samples

ORIENTATION = "orientation"
"""How the signal of orientations that stands beside one of positions ends."""

_MOST_NAMES = 1000
"""Bodies of one topic; more are no robot's, but a damaged or hostile log's."""

_TURNED = 1e-9
"""Of a quaternion's vector: less is no rotation."""


@dataclass
class _Samples:
    """Samples of one body, flat: a log of an hour must fit.

    A header stamp goes in first: it may not fit, where it lies beyond the year 2262.
    """

    header_ns: array[int] = field(default_factory=lambda: array("q"))
    log_ns: array[int] = field(default_factory=lambda: array("q"))
    positions: array[float] = field(default_factory=lambda: array("d"))
    quaternions: array[float] = field(default_factory=lambda: array("d"))
    frame: OneFrame = field(default_factory=OneFrame)


@dataclass(eq=False)
class PositionRows:
    """Positions of one topic, apart by body and, where it names bodies, by frame.

    Attributes:
        topic: its name.
        unit: of the positions.
        scale: what makes it of the messages' own.
    """

    topic: str
    unit: str = "m"
    scale: float = 1.0
    _rows: dict[tuple[str, str], _Samples] = field(default_factory=dict, init=False)

    def add(self, log_ns: int, positions: Iterable[PositionSample]) -> None:
        """The positions of one message.

        Raises:
            BeyondLimitError: more bodies than a topic may have.
            ValueError, OverflowError: they make no sense.
        """
        for stamp_ns, name, frame, x, y, z, *turn in positions:
            key = (name, frame if name else "")
            rows = self._rows.get(key)
            if rows is None:
                if len(self._rows) >= _MOST_NAMES:
                    raise BeyondLimitError(f"over {_MOST_NAMES} names")
                rows = self._rows[key] = _Samples()
            rows.header_ns.append(stamp_ns)
            rows.log_ns.append(log_ns)
            rows.positions.extend((x, y, z))
            rows.quaternions.extend(turn)
            rows.frame.add(frame)

    def signals(self) -> tuple[list[Signal], list[str]]:
        """For each body and frame its positions and, where it ever turns, its orientations.

        Returns:
            Signals of x, y, z in `unit`, and of unit quaternions x, y, z, w under the same name
            and `.orientation`; and what was repaired.
        """
        found: list[Signal] = []
        notes: list[str] = []
        taken: set[str] = set()
        for (name, frame), rows in self._rows.items():
            full = f"{self.topic}.{name}" if name else self.topic
            if full in taken:
                full = f"{full}@{frame}"
                notes.append(f"{full}: {name} has a place in several frames, each is by itself")
            taken.add(full)
            keep, stamps_ns, repairs = order_samples(
                np.frombuffer(rows.header_ns, np.int64), np.frombuffer(rows.log_ns, np.int64)
            )
            values = np.frombuffer(rows.positions, np.float64).reshape(-1, 3)[keep]
            values[~np.isfinite(values)] = np.nan
            if self.scale != 1.0:
                values = values * self.scale
            own = rows.frame.name
            found.append(Signal(full, stamps_ns, values, ("x", "y", "z"), self.unit, frame=own))
            notes += [f"{full}: {repair}" for repair in repairs]
            turns = np.frombuffer(rows.quaternions, np.float64).reshape(-1, 4)
            label = f"{full}.{ORIENTATION}"
            if len(turns) and label not in taken and _is_told(turns[keep]):
                taken.add(label)
                columns = ("x", "y", "z", "w")
                found.append(Signal(label, stamps_ns, turns[keep], columns, "1", frame=own))
        return found, notes


def _is_told(quaternions: Array) -> bool:
    """Whether any of shape (T, 4) is a rotation: who knows positions alone says that none is."""
    sizes = np.abs(quaternions[:, :3])
    return bool((sizes > _TURNED).any())
