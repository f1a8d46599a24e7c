"""From decoded messages, one at a time, to the signals of an episode."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.clock_jumps import filmed_part
from tunenet_logs.episode import Signal
from tunenet_logs.formats.base import BeyondLimitError
from tunenet_logs.formats.message_types import JointSample, PictureSample, SoundSample
from tunenet_logs.sample_order import (
    jumps_alone,
    sorted_stamps,
    trusts_header,
)

_MOST_NAMES = 1000
"""Bodies or joints of one topic; more are no robot's, but a damaged or hostile log's."""

_NAMES = tuple(f"joint{number}" for number in range(1, _MOST_NAMES + 2))
"""What joints without names are called; one more than there may be, so that too many are seen."""

_NOTHING = array("d", [float("nan")] * _MOST_NAMES).tobytes()
"""A quantity that a message does not give, as the bytes of its values."""

_MOST_REORDERED = 16
"""Pictures that a video's decoder holds until they are shown, by H.264 and H.265."""


@dataclass
class _SampleStamps:
    """When samples with the same columns were taken.

    A header stamp goes in first: it may not fit, where it lies beyond the year 2262.
    """

    header_ns: array[int] = field(default_factory=lambda: array("q"))
    log_ns: array[int] = field(default_factory=lambda: array("q"))


@dataclass(eq=False)
class JointRows:
    """Joints of one topic: positions [rad], velocities [rad/s] and efforts [N·m], each a signal."""

    topic: str
    _blocks: dict[tuple[str, ...], tuple[_SampleStamps, tuple[array[float], ...]]] = field(
        default_factory=dict, init=False
    )

    _QUANTITIES = (("position", "rad"), ("velocity", "rad/s"), ("effort", "N·m"))
    """Name and unit of each signal, in the order of a `JointSample`."""

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
            block = self._blocks[names] = (_SampleStamps(), (array("d"), array("d"), array("d")))
        rows, (positions, velocities, efforts) = block
        width = 8 * len(names)
        if not {len(position), len(velocity), len(effort)} <= {0, width}:
            raise ValueError(f"a message has {len(names)} names but another number of values")
        rows.header_ns.append(stamp_ns)
        rows.log_ns.append(log_ns)
        positions.frombytes(position or _NOTHING[:width])
        velocities.frombytes(velocity or _NOTHING[:width])
        efforts.frombytes(effort or _NOTHING[:width])

    def signals(self, joint_names: tuple[str, ...] = ()) -> tuple[list[Signal], list[str]]:
        """Those of the three quantities that have any value, and what was repaired.

        Messages with one stamp and different joints make one sample: several may publish them.

        Args:
            joint_names: what the joints are called where messages carry no names; ignored unless
                there are as many as joints, each another.
        """
        blocks = list(self._blocks.items())
        if not blocks:
            return [], []
        columns = tuple(dict.fromkeys(name for names in self._blocks for name in names))
        headers = [np.frombuffer(rows.header_ns, np.int64) for _, (rows, _) in blocks]
        logs = [np.frombuffer(rows.log_ns, np.int64) for _, (rows, _) in blocks]
        is_header, notes = trusts_header(np.concatenate(headers))
        reasons = (jumps_alone(*both) for both in zip(headers, logs, strict=True))
        if is_header and (reason := next(filter(None, reasons), "")):
            is_header, notes = False, [reason]
        ordered = [sorted_stamps(own_ns) for own_ns in (headers if is_header else logs)]
        notes += [repair for _, _, repairs in ordered for repair in repairs]
        stamps_ns = np.unique(np.concatenate([own_ns for _, own_ns, _ in ordered]))
        found: list[Signal] = []
        is_given = columns == _NAMES[: len(joint_names)] and len(set(joint_names)) == len(columns)
        shown = joint_names if is_given else columns
        for quantity, (label, unit) in enumerate(self._QUANTITIES):
            values = np.full((len(stamps_ns), len(columns)), np.nan)
            for (names, (_, stores)), (keep, own_ns, _) in zip(blocks, ordered, strict=True):
                block = np.frombuffer(stores[quantity], np.float64).reshape(-1, len(names))[keep]
                indices = np.array([columns.index(name) for name in names])
                cells = np.ix_(np.searchsorted(stamps_ns, own_ns), indices)
                values[cells] = np.where(np.isnan(values[cells]), block, values[cells])
            is_finite = np.isfinite(values)
            if is_finite.any():
                values[~is_finite] = np.nan
                found.append(Signal(f"{self.topic}.{label}", stamps_ns, values, shown, unit))
        return found, [f"{self.topic}: {note}" for note in dict.fromkeys(notes)]


@dataclass(eq=False)
class PictureStamps:
    """When the pictures of one topic were taken; they themselves are read when asked for.

    Attributes:
        topic: the topic.
        is_video: whether a picture may be shown before one that was written first.
    """

    topic: str
    is_video: bool = False
    _header_ns: array[int] = field(default_factory=lambda: array("q"), init=False)
    _log_ns: array[int] = field(default_factory=lambda: array("q"), init=False)

    def add(self, log_ns: int, picture: PictureSample) -> None:
        """One picture.

        Raises:
            OverflowError: its stamp lies beyond the year 2262.
        """
        self._header_ns.append(picture.stamp_ns)
        self._log_ns.append(log_ns)

    def trusts_header(self) -> tuple[bool, list[str]]:
        """Whether the pictures' own stamps tell the time, and why not, or where they jump."""
        header_ns, log_ns = (np.array(own, np.int64) for own in (self._header_ns, self._log_ns))
        if self.is_video:
            header_ns = _as_shown(header_ns)
        is_header, reasons = trusts_header(header_ns)
        if is_header and (reason := jumps_alone(header_ns, log_ns)):
            is_header, reasons = False, [reason]
        used_ns = np.where(header_ns == 0, log_ns, header_ns) if is_header else log_ns
        reasons += filmed_part(used_ns).words
        return is_header, [f"{self.topic}: {reason}" for reason in reasons]


@dataclass(eq=False)
class SoundStamps:
    """When the pieces of one topic's sound were taken; they are read when asked for.

    Attributes:
        topic: the topic.
    """

    topic: str
    _header_ns: array[int] = field(default_factory=lambda: array("q"), init=False)
    _log_ns: array[int] = field(default_factory=lambda: array("q"), init=False)

    def add(self, log_ns: int, sound: SoundSample) -> None:
        """One piece.

        Raises:
            OverflowError: its stamp lies beyond the year 2262.
        """
        self._header_ns.append(sound.stamp_ns)
        self._log_ns.append(log_ns)

    def trusts_header(self) -> tuple[bool, list[str]]:
        """Whether the pieces' own stamps tell the time, and why not."""
        header_ns, log_ns = (np.array(own, np.int64) for own in (self._header_ns, self._log_ns))
        is_header, reasons = trusts_header(header_ns)
        if is_header and (reason := jumps_alone(header_ns, log_ns)):
            is_header, reasons = False, [reason]
        return is_header, [f"{self.topic}: {reason}" for reason in reasons]


def _as_shown(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Stamps of a video's pictures as a decoder gives them out; those that jump stay jumps.

    Args:
        stamps_ns: in the order in which they were written, shape (T,) [ns].
    """
    waiting: list[int] = []
    shown: list[int] = []
    for stamp_ns in stamps_ns.tolist():
        heappush(waiting, stamp_ns)
        if len(waiting) > _MOST_REORDERED:
            shown.append(heappop(waiting))
    return np.array(shown + sorted(waiting), np.int64)
