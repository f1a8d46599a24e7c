"""Build the signals of an episode from decoded messages, one at a time."""

from __future__ import annotations

import re
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.clock_jumps import filmed_part
from tunenet_logs.episode import Signal
from tunenet_logs.formats.base import BeyondLimitError
from tunenet_logs.formats.message_types import JointSample, PictureSample, SoundSample
from tunenet_logs.left_out import added
from tunenet_logs.sample_order import distinct, places_ahead, sorted_stamps, trusts_header
from tunenet_logs.sources import disagree, take_turns, two_sources
from tunenet_logs.terminal import listed, short_name

# Bodies or joints of one topic; more are no robot's, but a damaged or hostile log's.
_MAX_NAMES = 1000

# What joints without names are called; one more than there may be, so that too many are seen.
_NAMES = tuple(f"joint{number}" for number in range(1, _MAX_NAMES + 2))

# Of the joints of a topic, as many as seven have in 25 minutes at 1 kHz: 268 MB.
MAX_NUMBERS = 2**25

_SOMETIMES = 1024  # messages after which it is looked whether there are too many
_LOOKED_AT = 20_000  # messages that tell whether two publishers take turns
# Of ros2_control: a joint and what of it.
_INTERFACE = re.compile(
    r"(.*[^/.])[/.](position|velocity|effort|acceleration|current|voltage|temperature|torque)"
)

_MAX_BLOCKS = 50  # sets of joints that are compared each with each
_SEVERAL = {2: "two", 3: "three"}

# A quantity that a message does not give, as the bytes of its values.
_NOTHING = array("d", [float("nan")] * _MAX_NAMES).tobytes()

# Pictures that a video's decoder holds until they are shown, by H.264 and H.265.
_MAX_REORDERED = 16


@dataclass(eq=False)
class _JointBlock:
    """Samples of the same joints; of very many every second, fourth, eighth ... alone.

    A header stamp goes in first: it may not fit, where it lies beyond the year 2262.

    Attributes:
        width: joints.
        step: of so many messages the first is kept.
        count: messages so far.
        is_mixed: whether two publishers took turns before some were left out.
    """

    width: int
    header_ns: array[int] = field(default_factory=lambda: array("q"))
    log_ns: array[int] = field(default_factory=lambda: array("q"))
    quantities: tuple[array[float], ...] = field(
        default_factory=lambda: (array("d"), array("d"), array("d"))
    )
    step: int = 1
    count: int = 0
    is_mixed: bool = False

    @property
    def numbers(self) -> int:
        """How many are kept."""
        return len(self.quantities) * len(self.quantities[0])

    def add(self, header_ns: int, log_ns: int, quantities: Sequence[bytes]) -> None:
        """Append one message."""
        if self.count % self.step == 0:
            self.header_ns.append(header_ns)
            self.log_ns.append(log_ns)
            for store, values in zip(self.quantities, quantities, strict=True):
                store.frombytes(values or _NOTHING[: 8 * self.width])
        self.count += 1

    def add_all(self, samples: Sequence[NDArray[Any]]) -> None:
        """Append messages: header and log stamps, shape (N,), and quantities, shape (N, width)."""
        stores = (self.header_ns, self.log_ns, *self.quantities)
        rows = slice(-self.count % self.step, None, self.step)
        for store, values in zip(stores, samples, strict=True):
            store.frombytes(np.ascontiguousarray(values[rows]).data.cast("B"))
        self.count += len(samples[0])

    def values(self, quantity: int) -> NDArray[np.float64]:
        """Return one quantity, shape (T, width)."""
        return np.frombuffer(self.quantities[quantity], np.float64).reshape(-1, self.width)

    @property
    def places(self) -> NDArray[np.float64]:
        """Positions or, without any, velocities or efforts, shape (T, width)."""
        for quantity in range(len(self.quantities)):
            if np.isfinite(values := self.values(quantity)).any():
                return values
        return self.values(0)

    @property
    def is_still(self) -> bool:
        """Whether it never changes."""
        return not np.any(np.nan_to_num(self.places - self.places[:1]))

    def part(self, rows: NDArray[np.bool_]) -> _JointBlock:
        """Return the samples in a mask `rows`, shape (T,)."""
        stamps = [np.frombuffer(own, np.int64)[rows] for own in (self.header_ns, self.log_ns)]
        part = _JointBlock(self.width)
        part.add_all([*stamps, *(self.values(k)[rows] for k in range(len(self.quantities)))])
        part.step, part.count, part.is_mixed = self.step, self.count, self.is_mixed
        return part

    def thin(self) -> None:
        """Decimate the samples by two."""
        if self.step == 1:
            self.is_mixed = two_sources(self.places[:_LOOKED_AT]) is not None
        self.step *= 2
        self.header_ns, self.log_ns = self.header_ns[::2], self.log_ns[::2]
        thinned = []
        for store in self.quantities:
            half = np.frombuffer(store).reshape(-1, self.width)[::2]
            thinned.append(array("d", half.tobytes()))
        self.quantities = tuple(thinned)


# Names of joints, and what messages with these say.
_Blocks = list[tuple[tuple[str, ...], _JointBlock]]


@dataclass(eq=False)
class JointRows:
    """Joint states of one topic: positions [rad], velocities [rad/s] and efforts [N·m].

    Attributes:
        topic: its name.
        most_numbers: that are kept; of more messages some are left out, evenly.
    """

    topic: str
    most_numbers: float = MAX_NUMBERS
    _blocks: dict[tuple[str, ...], _JointBlock] = field(default_factory=dict, init=False)

    QUANTITIES = (("position", "rad"), ("velocity", "rad/s"), ("effort", "N·m"))
    """Name and unit of each signal, in the order of a `JointSample`."""

    def add(self, log_ns: int, sample: JointSample) -> None:
        """Append one message.

        Raises:
            ValueError, OverflowError: it makes no sense.
        """
        stamp_ns, names, *given = sample
        values = [np.asarray(quantity, np.float64).tobytes() for quantity in given]
        names = names or _NAMES[: max(map(len, values)) // 8]
        block = self._block(names, {len(quantity) // 8 for quantity in values})
        block.add(stamp_ns, log_ns, values)
        if not block.count % _SOMETIMES:
            self._bound()

    def add_all(self, parts: Sequence[tuple[NDArray[np.intp], NDArray[np.int64], Any]]) -> None:
        """Append messages of one layout or several, all or none.

        Args:
            parts: of each layout the places of its messages among all, shape (N,), the log's stamps
                [ns], shape (N,), and a sample whose numbers are arrays of shape (N, joints).

        Raises:
            ValueError: one makes no sense.
        """
        found: dict[tuple[str, ...], list[list[NDArray[Any]]]] = {}
        for places, log_ns, (stamp_ns, names, *given) in parts:
            widths = [quantity.shape[1] for quantity in given]
            own = names or _NAMES[: max(widths)]
            self._block(own, set(widths))
            nothing = np.full((len(places), len(own)), np.nan)
            values = [one if one.shape[1] else nothing for one in given]
            found.setdefault(own, []).append([places, stamp_ns, log_ns, *values])
        for names, samples in found.items():
            places, *columns = (np.concatenate(column) for column in zip(*samples, strict=True))
            if len(samples) > 1:
                order = np.argsort(places)
                columns = [column[order] for column in columns]
            self._blocks[names].add_all(columns)
        self._bound()

    def _block(self, names: tuple[str, ...], widths: set[int]) -> _JointBlock:
        """Return the block of these joints, whose quantities must have `widths` values or none.

        Raises:
            ValueError: names repeat, are too many, or do not match the values.
        """
        block = self._blocks.get(names)
        if block is None:
            if sum(map(len, self._blocks)) + len(names) > _MAX_NAMES:
                raise BeyondLimitError(f"over {_MAX_NAMES} joints")
            if len(set(names)) < len(names):
                raise ValueError("two joints have one name")
        if not widths <= {0, len(names)}:
            raise ValueError(f"a message has {len(names)} names but another number of values")
        if block is None:
            block = self._blocks[names] = _JointBlock(len(names))
        return block

    def signals(self, joint_names: tuple[str, ...] = ()) -> tuple[list[Signal], list[str]]:
        """Return the quantities that have any value as signals, and notes on what was repaired.

        Messages with one stamp and different joints make one sample: several may publish them. Of
        publishers that say different things of the same joints, each is by itself.

        Args:
            joint_names: what the joints are called where messages carry no names; ignored unless
                there are as many as joints, each another.
        """
        found: list[Signal] = []
        notes: list[str] = []
        publishers = self._publishers([_by_interface(*one, notes) for one in self._blocks.items()])
        notes = [f"{self.topic}: {note}" for note in dict.fromkeys(notes)]
        if len(publishers) > 1:
            counts = [sum(len(samples.log_ns) for _, samples in blocks) for blocks in publishers]
            notes.append(
                f"{self.topic}: {_SEVERAL.get(len(counts), 'several')} publishers on {self.topic}: "
                f"by turns they say different things of {short_name(publishers[0][0][0][0])} "
                f"({listed(map(str, counts))} messages); what comes later, or never changes, "
                f"goes by {self.topic}@2 (--topic)"
            )
        for number, blocks in enumerate(publishers, 1):
            topic = self.topic if number == 1 else f"{self.topic}@{number}"
            signals, repairs = self._signals_of(topic, blocks, joint_names)
            found += signals
            notes += repairs
        return found, notes

    def _publishers(self, every: _Blocks) -> list[_Blocks]:
        """Group blocks by publisher: blocks that contradict each other are of different ones."""
        if len(every) > _MAX_BLOCKS:
            return [every]
        found: list[_Blocks] = []
        for names, samples in every:
            second = two_sources(samples.places)
            parts = [samples] if second is None else [samples.part(~second), samples.part(second)]
            for part in parts:
                block = (names, part)
                kept = [one for one in found if not any(_contradict(block, two) for two in one)]
                if kept:
                    kept[0].append(block)
                else:
                    found.append([block])
        if len(found) > 1:
            found.sort(key=lambda blocks: all(one.is_still for _, one in blocks))
        return found

    def _signals_of(
        self, topic: str, blocks: _Blocks, joint_names: tuple[str, ...]
    ) -> tuple[list[Signal], list[str]]:
        """Build the signals of one publisher, or of several that agree."""
        columns = tuple(dict.fromkeys(name for names, _ in blocks for name in names))
        headers = [np.frombuffer(block.header_ns, np.int64) for _, block in blocks]
        logs = [np.frombuffer(block.log_ns, np.int64) for _, block in blocks]
        trusts = [trusts_header(*both) for both in zip(headers, logs, strict=True)]
        is_header = all(is_own for is_own, _ in trusts)
        notes = [reason for _, reasons in trusts for reason in reasons]
        ordered = [
            sorted_stamps(own_ns, [block.values(k) for k in range(len(block.quantities))])
            for own_ns, (_, block) in zip(headers if is_header else logs, blocks, strict=True)
        ]
        left_out: dict[str, int] = {}
        for one in ordered:
            notes += one.notes
            left_out = added(left_out, one.left_out)
        notes += _thinned(blocks)
        stamps_ns = ordered[0].stamps_ns
        if len(blocks) > 1:
            stamps_ns = distinct(np.concatenate([one.stamps_ns for one in ordered]))
        stamps_ns.flags.writeable = False
        found: list[Signal] = []
        is_given = columns == _NAMES[: len(joint_names)] and len(set(joint_names)) == len(columns)
        shown = joint_names if is_given else columns
        for quantity, (label, unit) in enumerate(self.QUANTITIES):
            parts: list[NDArray[np.float64]] = []
            for (_, samples), own in zip(blocks, ordered, strict=True):
                parts.append(_taken(samples.values(quantity), own.keep))
            values = parts[0]
            if len(blocks) > 1:
                values = np.full((len(stamps_ns), len(columns)), np.nan)
                for (names, _), own, part in zip(blocks, ordered, parts, strict=True):
                    indices = np.array([columns.index(name) for name in names])
                    cells = np.ix_(np.searchsorted(stamps_ns, own.stamps_ns), indices)
                    values[cells] = np.where(np.isnan(values[cells]), part, values[cells])
            is_finite = np.isfinite(values)
            if is_finite.any():
                values = values if is_finite.all() else np.where(is_finite, values, np.nan)
                values.flags.writeable = False
                name = f"{topic}.{label}"
                found.append(Signal(name, stamps_ns, values, shown, unit, left_out=left_out))
        return found, [f"{topic}: {note}" for note in dict.fromkeys(notes)]

    def _bound(self) -> None:
        """Decimate the largest block while too many numbers are held."""
        while sum(block.numbers for block in self._blocks.values()) > self.most_numbers:
            max(self._blocks.values(), key=lambda block: block.numbers).thin()


def _by_interface(
    names: tuple[str, ...], samples: _JointBlock, notes: list[str]
) -> tuple[tuple[str, ...], _JointBlock]:
    """Split joints named after ros2_control interfaces ("joint_1/position") into quantities.

    ros2_control names states so, all in one field. `notes` gets what is to be said.
    """
    found = [_INTERFACE.fullmatch(name) for name in names]
    given = [k for k in range(3) if np.isfinite(samples.values(k)).any()]
    if len(given) != 1 or not names or not all(found):
        return names, samples
    told = {(one[1], one[2]): column for column, one in enumerate(found) if one}
    joints = tuple(dict.fromkeys(joint for joint, _ in told))
    kinds = [label for label, _ in JointRows.QUANTITIES]
    if not {kind for _, kind in told} & set(kinds):
        return names, samples
    values = samples.values(given[0])
    stamps = [np.frombuffer(own, np.int64) for own in (samples.header_ns, samples.log_ns)]
    quantities = [np.full((len(values), len(joints)), np.nan) for _ in kinds]
    others: set[str] = set()
    for (joint, kind), column in told.items():
        if kind in kinds:
            quantities[kinds.index(kind)][:, joints.index(joint)] = values[:, column]
        else:
            others.add(kind)
    said = f"; not read: {listed(sorted(others))}" if others else ""
    notes.append(
        f"its names are those of interfaces, such as {short_name(names[0])}: read as such{said}"
    )
    made = _JointBlock(len(joints))
    made.add_all([*stamps, *quantities])
    made.step, made.count, made.is_mixed = samples.step, samples.count, samples.is_mixed
    return joints, made


def _contradict(
    one: tuple[tuple[str, ...], _JointBlock], two: tuple[tuple[str, ...], _JointBlock]
) -> bool:
    """Check whether two series of messages disagree on the same joints by turns."""
    shared = [name for name in one[0] if name in two[0]]
    if not shared or not take_turns(*(np.array(part.log_ns, np.int64) for _, part in (one, two))):
        return False
    for quantity in range(len(one[1].quantities)):
        series = []
        for names, samples in (one, two):
            own_ns = np.array(samples.log_ns, np.int64)
            order = np.argsort(own_ns, kind="stable")
            columns = [names.index(name) for name in shared]
            series.append((own_ns[order], samples.values(quantity)[order][:, columns]))
        if disagree(*series):
            return True
    return False


def _thinned(blocks: _Blocks) -> list[str]:
    """Say what was left out of too many messages."""
    most = max((samples for _, samples in blocks), key=lambda samples: samples.step)
    if most.step == 1:
        return []
    mixed = ", of two publishers that are not told apart" if most.is_mixed else ""
    return [
        f"of {most.count} messages{mixed} every {most.step}th is used, as many as are held; "
        "cut the log where a part is to be used with all of them"
    ]


@dataclass(eq=False)
class PictureStamps:
    """Acquisition stamps of one topic's pictures, which are themselves read on demand.

    Attributes:
        topic: the topic.
        is_video: whether a picture may be shown before one that was written first.
        cut: pictures beyond a jump of their clock, once `trusts_header` was asked.
        ahead: places by which they overtook each other, likewise.
    """

    topic: str
    is_video: bool = False
    cut: int = field(default=0, init=False)
    ahead: int = field(default=0, init=False)
    _header_ns: array[int] = field(default_factory=lambda: array("q"), init=False)
    _log_ns: array[int] = field(default_factory=lambda: array("q"), init=False)

    def add(self, log_ns: int, picture: PictureSample) -> None:
        """Append one picture.

        Raises:
            OverflowError: its stamp lies beyond the year 2262.
        """
        self._header_ns.append(picture.stamp_ns)
        self._log_ns.append(log_ns)

    def trusts_header(self) -> tuple[bool, list[str]]:
        """Check whether the header stamps can be trusted; if not, say why, and where they jump."""
        header_ns, log_ns = (np.array(own, np.int64) for own in (self._header_ns, self._log_ns))
        if self.is_video:
            header_ns = _as_shown(header_ns)
        is_header, reasons = trusts_header(header_ns, log_ns)
        used_ns = np.where(header_ns == 0, log_ns, header_ns) if is_header else log_ns
        self.ahead = 0 if self.is_video else places_ahead(used_ns)
        if self.ahead:
            count = np.count_nonzero(used_ns[1:] < used_ns[:-1])
            reasons.append(f"{count} pictures out of order were sorted")
            used_ns = np.sort(used_ns)
        part = filmed_part(used_ns)
        reasons += part.words
        self.cut = len(used_ns) - len(part.keep)
        return is_header, [f"{self.topic}: {reason}" for reason in reasons]


@dataclass(eq=False)
class SoundStamps:
    """Acquisition stamps of the pieces of one topic's sound, which are read on demand.

    Attributes:
        topic: the topic.
    """

    topic: str
    _header_ns: array[int] = field(default_factory=lambda: array("q"), init=False)
    _log_ns: array[int] = field(default_factory=lambda: array("q"), init=False)

    def add(self, log_ns: int, sound: SoundSample) -> None:
        """Append one piece.

        Raises:
            OverflowError: its stamp lies beyond the year 2262.
        """
        self._header_ns.append(sound.stamp_ns)
        self._log_ns.append(log_ns)

    def trusts_header(self) -> tuple[bool, list[str]]:
        """Check whether the header stamps of the pieces can be trusted; if not, say why."""
        header_ns, log_ns = (np.array(own, np.int64) for own in (self._header_ns, self._log_ns))
        is_header, reasons = trusts_header(header_ns, log_ns)
        return is_header, [f"{self.topic}: {reason}" for reason in reasons]


def _taken(values: NDArray[np.float64], rows: NDArray[np.intp]) -> NDArray[np.float64]:
    """Select some rows in order, without a copy where they are all."""
    if len(rows) == len(values) and np.all(rows[1:] > rows[:-1]):
        return values
    return values[rows]


def _as_shown(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return stamps of a video [ns] in decoder output order; those that jump stay jumps."""
    waiting: list[int] = []
    shown: list[int] = []
    for stamp_ns in stamps_ns.tolist():
        heappush(waiting, stamp_ns)
        if len(waiting) > _MAX_REORDERED:
            shown.append(heappop(waiting))
    return np.array(shown + sorted(waiting), np.int64)
