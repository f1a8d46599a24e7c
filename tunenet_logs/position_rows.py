"""Build signals of positions and orientations from decoded messages, one at a time."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.arrays import Array
from tunenet_logs.episode import Signal
from tunenet_logs.formats.base import BeyondLimitError
from tunenet_logs.formats.position_types import PositionSample
from tunenet_logs.sample_order import order_samples
from tunenet_logs.sources import take_turns, two_sources, two_sources_words
from tunenet_logs.terminal import listed

# How the signal of orientations that stands beside one of positions ends.
ORIENTATION = "orientation"

_MAX_NAMES = 1000  # bodies of one topic; more are no robot's, but a damaged or hostile log's
_MAX_FRAMES = 100  # of a body without a name; more are none
_TURNED = 1e-9  # of a quaternion's vector: less is no rotation


@dataclass
class _Samples:
    """Samples of one body, flat: a log of an hour must fit.

    A header stamp goes in first: it may not fit, where it lies beyond the year 2262.
    """

    header_ns: array[int] = field(default_factory=lambda: array("q"))
    log_ns: array[int] = field(default_factory=lambda: array("q"))
    positions: array[float] = field(default_factory=lambda: array("d"))
    quaternions: array[float] = field(default_factory=lambda: array("d"))

    @property
    def places(self) -> Array:
        """Positions, shape (T, 3)."""
        return np.frombuffer(self.positions, np.float64).reshape(-1, 3)

    @property
    def stores(self) -> tuple[array[Any], ...]:
        """All arrays."""
        return self.header_ns, self.log_ns, self.positions, self.quaternions

    def part(self, rows: NDArray[np.bool_]) -> _Samples:
        """Return the samples in a mask `rows`, shape (T,)."""
        parts: list[array[Any]] = []
        for store in self.stores:
            every = np.frombuffer(store, store.typecode).reshape(len(rows), -1)
            parts.append(array(store.typecode, every[rows].tobytes()))
        return _Samples(*parts)

    @classmethod
    def joined(cls, samples: Sequence[_Samples]) -> _Samples:
        """Concatenate several, in the order in which they begin."""
        joined = cls()
        for one in sorted(samples, key=lambda one: one.log_ns[0]):
            for store, more in zip(joined.stores, one.stores, strict=True):
                store.extend(more)
        return joined


@dataclass(eq=False)
class PositionRows:
    """Positions of one topic, apart by body and, where it names bodies, by frame.

    Attributes:
        topic: its name.
        unit: of the positions.
        scale: from the unit of the messages to that.
        names_one: whether each message is of one body, whose name counts only among several.
    """

    topic: str
    unit: str = "m"
    scale: float = 1.0
    names_one: bool = False
    _rows: dict[tuple[str, str], _Samples] = field(default_factory=dict, init=False)

    def add(self, log_ns: int, positions: Iterable[PositionSample]) -> None:
        """Append the positions of one message.

        Raises:
            BeyondLimitError: more bodies than a topic may have.
            ValueError, OverflowError: they make no sense.
        """
        for stamp_ns, name, where, x, y, z, *turn in positions:
            is_counter = not name and len(self._rows) >= _MAX_FRAMES  # what calls itself a frame
            frame = "" if is_counter and (name, where) not in self._rows else where
            rows = self._rows.get((name, frame))
            if rows is None:
                if len(self._rows) >= _MAX_NAMES:
                    raise BeyondLimitError(f"over {_MAX_NAMES} names")
                rows = self._rows[name, frame] = _Samples()
            rows.header_ns.append(stamp_ns)
            rows.log_ns.append(log_ns)
            rows.positions.extend((x, y, z))
            rows.quaternions.extend(turn)

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Return positions and, where it ever turns, orientations of each body and frame.

        Returns:
            Signals of x, y, z in `unit`, and of unit quaternions x, y, z, w under the same name
            and `.orientation`; and what was repaired.
        """
        found: list[Signal] = []
        notes: list[str] = []
        taken: set[str] = set()
        for name, frame, rows in self._bodies(notes):
            full = f"{self.topic}.{name}" if name else self.topic
            if full in taken:
                full = f"{full}@{frame}"
                notes.append(
                    f"{full}: {name or self.topic} has a place in several frames, each is by itself"
                )
            taken.add(full)
            second = two_sources(rows.places)
            if second is None:
                found += self._signals_of(full, frame, rows, taken, notes)
                continue
            other = f"{full}@2"
            taken.add(other)
            notes.append(two_sources_words(full, second, other))
            found += self._signals_of(full, frame, rows.part(~second), taken, notes)
            found += self._signals_of(other, frame, rows.part(second), taken, notes)
        return found, notes

    def _bodies(self, notes: list[str]) -> Iterator[tuple[str, str, _Samples]]:
        """Yield name, frame and samples of each body; the frame is "" where it changes."""
        is_one = self.names_one and len({name for name, _ in self._rows}) == 1
        frames: dict[str, list[tuple[str, _Samples]]] = {}
        for (name, frame), rows in self._rows.items():
            frames.setdefault("" if is_one else name, []).append((frame, rows))
        if self.names_one and len(frames) > 1:
            notes.append(f"{self.topic}: several bodies, by child_frame_id: {listed(frames)}")
        for name, parts in frames.items():
            logs = [np.array(rows.log_ns, np.int64) for _, rows in parts]
            if name or any(take_turns(*both) for both in pairwise(logs)):
                yield from ((name, frame, rows) for frame, rows in parts)
            elif len(parts) == 1:
                yield name, *parts[0]
            else:  # it was called otherwise from some time on
                yield name, "", _Samples.joined([rows for _, rows in parts])

    def _signals_of(
        self, full: str, frame: str, rows: _Samples, taken: set[str], notes: list[str]
    ) -> Iterator[Signal]:
        """Yield the signals of one body; `taken` and `notes` get what is to be known."""
        header_ns, log_ns = (np.frombuffer(own, np.int64) for own in (rows.header_ns, rows.log_ns))
        keep, stamps_ns, repairs, left_out = order_samples(header_ns, log_ns, (rows.places,))
        values = rows.places[keep]
        values[~np.isfinite(values)] = np.nan
        if self.scale != 1.0:
            values = values * self.scale
        axes = ("x", "y", "z")
        yield Signal(full, stamps_ns, values, axes, self.unit, frame=frame, left_out=left_out)
        notes += [f"{full}: {repair}" for repair in repairs]
        turns = np.frombuffer(rows.quaternions, np.float64).reshape(-1, 4)
        label = f"{full}.{ORIENTATION}"
        if len(turns) and label not in taken and _is_told(turns[keep]):
            taken.add(label)
            columns = ("x", "y", "z", "w")
            yield Signal(
                label, stamps_ns, turns[keep], columns, "1", frame=frame, left_out=left_out
            )


def _is_told(quaternions: Array) -> bool:
    """Check for a rotation among (T, 4) quaternions: sources of positions alone send none."""
    sizes = np.abs(quaternions[:, :3])
    return bool((sizes > _TURNED).any())
