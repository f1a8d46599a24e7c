"""Build signals of what drives a robot from decoded messages: plain numbers, and wrenches."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

import numpy as np

from tunenet_logs.episode import Signal
from tunenet_logs.formats.base import BeyondLimitError, UnusableError
from tunenet_logs.formats.message_types import NumbersSample, WrenchSample
from tunenet_logs.one_frame import OneFrame
from tunenet_logs.sample_order import order_samples, sorted_stamps

_MAX_COLUMNS = 1000  # numbers of one message; more are no commands, but a picture or a cloud
_MAX_BYTES = 64 * 1024  # of a message of numbers: so many as are read, as text, with a layout


@dataclass(eq=False)
class NumberRows:
    """Unlabelled numbers of one topic: one signal, of unit "1"."""

    topic: str
    _lengths: dict[int, tuple[array[int], array[float]]] = field(default_factory=dict, init=False)

    def check(self, data: bytes | memoryview) -> None:
        """Refuse a message that is too large to be decoded.

        Raises:
            BeyondLimitError: it is larger than any with as many numbers as are read.
        """
        if len(data) > _MAX_BYTES:
            raise BeyondLimitError(
                f"a message of {len(data)} bytes is over the limit of {_MAX_BYTES}"
            )

    def add(self, log_ns: int, numbers: NumbersSample) -> None:
        """Append the numbers of one message.

        Raises:
            UnusableError: there are none.
            BeyondLimitError: there are more than a message may have.
            ValueError, TypeError: they are none.
        """
        values = np.asarray(numbers, np.float64)
        if not values.size:
            raise UnusableError("it holds no number")
        if values.size > _MAX_COLUMNS:
            raise BeyondLimitError(f"over {_MAX_COLUMNS} numbers")
        own_ns, stored = self._lengths.setdefault(values.size, (array("q"), array("d")))
        own_ns.append(log_ns)
        stored.frombytes(values.tobytes())

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Return the messages of the most frequent length, and notes on what was left out."""
        if not self._lengths:
            return [], []
        length = max(self._lengths, key=lambda one: len(self._lengths[one][0]))
        own_ns, stored = self._lengths[length]
        numbers = np.frombuffer(stored, np.float64).reshape(-1, length)
        keep, stamps_ns, notes, left_out = sorted_stamps(
            np.frombuffer(own_ns, np.int64), (numbers,)
        )
        others = sum(len(own) for own, _ in self._lengths.values()) - len(own_ns)
        if others:
            notes.append(f"{others} messages of another length than {length} were left out")
        values = numbers[keep]
        values[~np.isfinite(values)] = np.nan
        columns = tuple(map(str, range(length)))
        signal = Signal(self.topic, stamps_ns, values, columns, "1", drives=True, left_out=left_out)
        return [signal], [f"{self.topic}: {note}" for note in notes]


@dataclass(eq=False)
class WrenchRows:
    """Forces [N] and torques [N·m] of one topic, each a signal."""

    topic: str
    _header_ns: array[int] = field(default_factory=lambda: array("q"), init=False)
    _log_ns: array[int] = field(default_factory=lambda: array("q"), init=False)
    _values: array[float] = field(default_factory=lambda: array("d"), init=False)
    _frames: OneFrame = field(default_factory=OneFrame, init=False)

    _QUANTITIES = (("force", "N"), ("torque", "N·m"))
    """Name and unit of each signal, in the order of a `WrenchSample`."""

    def check(self, data: bytes | memoryview) -> None:
        """Accept every message."""

    def add(self, log_ns: int, wrench: WrenchSample) -> None:
        """Append one message.

        Raises:
            OverflowError: its stamp lies beyond the year 2262.
        """
        stamp_ns, frame, *six = wrench
        self._frames.add(frame)
        self._header_ns.append(stamp_ns)
        self._log_ns.append(log_ns)
        self._values.extend(six)

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Return force and torque where they have any value, and notes on what was repaired."""
        wrenches = np.frombuffer(self._values, np.float64).reshape(-1, 6)
        keep, stamps_ns, notes, left_out = order_samples(
            np.frombuffer(self._header_ns, np.int64),
            np.frombuffer(self._log_ns, np.int64),
            (wrenches,),
        )
        values = wrenches[keep]
        values[~np.isfinite(values)] = np.nan
        found = [
            Signal(
                f"{self.topic}.{label}",
                stamps_ns,
                three,
                ("x", "y", "z"),
                unit,
                drives=True,
                frame=self._frames.name,
                left_out=left_out,
            )
            for (label, unit), three in zip(
                self._QUANTITIES, (values[:, :3], values[:, 3:]), strict=True
            )
            if np.isfinite(three).any()
        ]
        return found, [f"{self.topic}: {note}" for note in notes]
