"""Build the signals of an episode from decoded messages, one at a time.

A class for each kind gathers the messages of one topic in flat arrays, as an hour of them must fit:
joints, pictures and sound (their stamps), numbers, wrenches, planned trajectories, positions. Its
`signals` then sorts them, and separates two publishers or objects on one topic (`two_sources`).
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from heapq import heappop, heappush
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import COMMANDS, Array, OneFrame, Signal, added
from tunenet_logs.formats.base import BeyondLimitError, UnusableError
from tunenet_logs.formats.message_types import (
    JointSample,
    PictureSample,
    PlanSample,
    PositionSample,
    SoundSample,
    Values,
    WrenchSample,
)
from tunenet_logs.terminal import listed, short_name
from tunenet_logs.timing.stamps import (
    LAST_NS,
    distinct,
    filmed_part,
    order_samples,
    places_ahead,
    sorted_stamps,
    trusts_header,
)

# ---- Two sources on one topic: separate series that take turns, by nearest neighbour
# Nothing in a message says who sent it. But two series that take turns jump to and fro, and each of
# them alone does not: each sample goes to the series whose last one is nearest.

# Fewer samples show no two series; of more, so many are looked at first, since it takes long.
_MIN_SAMPLES, _FIRST_SAMPLES = 40, 20_000
_CALMER = 0.3  # of the way that the samples make in their order: two series make less
# Of the samples, in the smaller series at least; and of these, how often the other follows.
_SHARE, _TURNS = 0.1, 0.1
# Mean steps of a series: one of the two goes over more, and both are farther from each other.
_MOVES = 10.0


def two_sources(values: Array) -> NDArray[np.bool_] | None:
    """Separate two interleaved series by nearest neighbour, of values in order of arrival, (T, C).

    Returns which samples are of the second, shape (T,): the one that never moves, else the one that
    comes later; None where there is but one, or two that are not clearly apart.
    """
    first = values[:_FIRST_SAMPLES]
    is_known = np.isfinite(first).all(axis=0)
    first = first[:, is_known]
    if len(first) < _MIN_SAMPLES or not first.shape[1] or not _jumps(first):
        return None
    found = _told_apart(first)
    if found is None or len(values) <= _FIRST_SAMPLES:
        return found
    values = values[:, is_known]
    return _told_apart(values) if np.isfinite(values).all() else None


def take_turns(first_ns: NDArray[np.int64], second_ns: NDArray[np.int64]) -> bool:
    """Check whether two sorted series of times are interleaved, not one after the other."""
    if not len(first_ns) or not len(second_ns):
        return False
    places = np.searchsorted(np.sort(first_ns), second_ns)
    turns = len(np.unique(places[(places > 0) & (places < len(first_ns))]))
    return bool(turns > _TURNS * min(len(first_ns), len(second_ns)))


def disagree(
    first: tuple[NDArray[np.int64], Array], second: tuple[NDArray[np.int64], Array]
) -> bool:
    """Check whether series of times [ns], (T,), and values, (T, C), are of different motions."""
    (first_ns, ours), (second_ns, theirs) = first, second
    for one, other in zip(ours.T, theirs.T, strict=True):
        known, told = np.isfinite(one), np.isfinite(other)
        if np.count_nonzero(known) < 2 or np.count_nonzero(told) < 2:
            continue
        at = np.interp(second_ns[told], first_ns[known], one[known])
        steps = np.mean(np.abs(np.diff(one[known]))) + np.mean(np.abs(np.diff(other[told])))
        if np.median(np.abs(other[told] - at)) > _MOVES * steps:
            return True
    return False


def _jumps(values: Array) -> bool:
    """Check whether most samples are near one of the few before, but not near the last."""
    steps = np.linalg.norm(np.diff(values, axis=0), axis=1)
    nearest = steps.copy()
    for back in range(2, 6):
        ways = np.linalg.norm(values[back:] - values[:-back], axis=1)
        nearest[back - 1 :] = np.minimum(nearest[back - 1 :], ways)
    return float(nearest.sum()) < _CALMER * float(steps.sum())


def _told_apart(values: Array) -> NDArray[np.bool_] | None:
    # The two of the first samples that are farthest apart begin the series.
    seeds = values[:16]
    ways = np.linalg.norm(seeds[:, None] - seeds[None], axis=2)
    first, second = np.unravel_index(int(ways.argmax()), ways.shape)
    lasts = [values[min(first, second)].tolist(), values[max(first, second)].tolist()]
    found: list[tuple[bool, float, float]] = []  # of the second, way to its own and to the other
    for row in values.tolist():
        ways_2 = [sum((a - b) ** 2 for a, b in zip(row, last, strict=True)) for last in lasts]
        is_second = ways_2[1] < ways_2[0]
        lasts[is_second] = row
        found.append((is_second, ways_2[is_second], ways_2[not is_second]))
    rows, near, far = (np.array(one) for one in zip(*found, strict=True))
    near, far = np.sqrt(near), np.sqrt(far)
    fewest = min(np.count_nonzero(rows), np.count_nonzero(~rows))
    turns = np.count_nonzero(rows[1:] != rows[:-1])
    if fewest < _SHARE * len(rows) or turns < _TURNS * fewest:
        return None
    # Nearly every sample is nearer to its own series, by far.
    if np.mean(near <= 0.25 * far) < 0.98:
        return None
    if near.sum() > _CALMER * np.linalg.norm(np.diff(values, axis=0), axis=1).sum():
        return None
    # The mean distance between samples of each, and the largest range along an axis.
    both = values[rows], values[~rows]
    steps = [float(np.linalg.norm(np.diff(one, axis=0), axis=1).mean()) for one in both]
    spans = [float(np.ptp(one, axis=0).max()) for one in both]
    moves = any(span > _MOVES * step for step, span in zip(steps, spans, strict=True))
    changes = np.abs(np.diff(np.sort(values, axis=0), axis=0))
    smallest = float(changes[changes > 0].min(initial=np.inf))
    apart = float(np.median(far))
    # Nearer series are two values that one was rounded to.
    if not moves or apart < _MOVES * max(steps) or apart < 20.0 * smallest:
        return None
    if spans[0] == 0 or spans[1] == 0:  # what never moves is the second
        return rows if spans[0] == 0 else ~rows
    return rows if not rows[0] else ~rows


# ---- Joints: states of one topic, by publisher

# Bodies or joints of one topic; more are no robot's, but a damaged or hostile log's.
_MAX_NAMES = 1000
# What joints without names are called; one more than there may be, so that too many are seen.
_NAMES = tuple(f"joint{number}" for number in range(1, _MAX_NAMES + 2))
# Of the joints of a topic, as many as seven have in 25 minutes at 1 kHz: 268 MB.
MAX_NUMBERS = 2**25
# Name of an interface in ros2_control: a joint and what of it.
_TURN = 3.0  # between two positions [rad or deg]: no joint moves so far from message to message
_INTERFACE = re.compile(
    r"(.*[^/.])[/.](position|velocity|effort|acceleration|current|voltage|temperature|torque)"
)
# A quantity that a message does not give, as the bytes of its values.
_NOTHING = array("d", [float("nan")] * _MAX_NAMES).tobytes()


@dataclass(eq=False)
class _Samples:
    """Samples of one source, flat; of very many the means of two, four, eight ... in a row."""

    widths: tuple[int, ...]  # values of each quantity in a sample
    header_ns: array[int] = field(default_factory=lambda: array("q"))
    log_ns: array[int] = field(default_factory=lambda: array("q"))
    quantities: tuple[array[float], ...] = ()
    step: int = 1  # so many messages make one sample
    settled: int = 0  # samples so far; the messages behind them wait for `settle`
    count: int = 0  # messages so far
    is_mixed: bool = False  # whether two publishers took turns: of these the first is kept

    def __post_init__(self) -> None:
        self.quantities = self.quantities or tuple(array("d") for _ in self.widths)

    @property
    def stamps(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Header and log stamps [ns], shape (T,) each."""
        return np.frombuffer(self.header_ns, np.int64), np.frombuffer(self.log_ns, np.int64)

    def add(self, header_ns: int, log_ns: int, quantities: Sequence[bytes]) -> None:
        """Append one message; OverflowError where a stamp lies beyond the year 2262."""
        self.header_ns.append(header_ns)  # first: it may not fit
        self.log_ns.append(log_ns)
        for store, width, values in zip(self.quantities, self.widths, quantities, strict=True):
            store.frombytes(values or _NOTHING[: 8 * width])
        self.count += 1

    def add_all(self, samples: Sequence[NDArray[Any]]) -> None:
        """Append messages: header and log stamps, shape (N,), and quantities, shape (N, width)."""
        stores = (self.header_ns, self.log_ns, *self.quantities)
        for store, values in zip(stores, samples, strict=True):
            store.frombytes(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
        self.count += len(samples[0])

    def values(self, quantity: int) -> NDArray[np.float64]:
        """Return one quantity, shape (T, width)."""
        width = self.widths[quantity]
        return np.frombuffer(self.quantities[quantity], np.float64).reshape(-1, width)

    @property
    def places(self) -> NDArray[np.float64]:
        """The first quantity with any value: positions or, without, velocities or efforts."""
        for quantity in range(len(self.quantities)):
            if np.isfinite(values := self.values(quantity)).any():
                return values
        return self.values(0)

    @property
    def is_still(self) -> bool:
        """Whether it never changes."""
        return not np.any(np.nan_to_num(self.places - self.places[:1]))

    def part(self, rows: NDArray[np.bool_]) -> _Samples:
        """Return the samples in a mask `rows`, shape (T,)."""
        every = (*self.stamps, *map(self.values, range(len(self.widths))))
        return self.like(self.widths, [one[rows] if len(one) else one for one in every])

    def like(self, widths: tuple[int, ...], columns: Sequence[NDArray[Any]]) -> _Samples:
        """Return others, of as many messages."""
        made = _Samples(widths)
        made.add_all(columns)
        made.step, made.count, made.is_mixed = self.step, self.count, self.is_mixed
        made.settled = len(made.log_ns)
        return made

    def settle(self, *, is_end: bool = False) -> None:
        """Average what came since the last time, `step` messages to a sample; a rest waits."""
        last = len(self.log_ns) - (len(self.log_ns) - self.settled) % self.step
        if self.step > 1:
            self._halve(self.settled, last, self.step.bit_length() - 1)
        self.settled += (last - self.settled) // self.step
        if is_end:
            del self.header_ns[self.settled :], self.log_ns[self.settled :]
            for store, width in zip(self.quantities, self.widths, strict=True):
                del store[self.settled * width :]

    def thin(self) -> None:
        """Average the samples in pairs; one without another stays."""
        if self.step == 1:
            self.is_mixed = two_sources(self.places[:_FIRST_SAMPLES]) is not None
        self.settle()
        self._halve(0, self.settled // 2 * 2, 1)
        self.settled -= self.settled // 2
        self.step *= 2

    def _halve(self, first: int, last: int, times: int) -> None:
        """Average samples of a range in pairs, so many times."""
        stores: list[tuple[array[Any], int]] = [(self.header_ns, 1), (self.log_ns, 1)]
        stores += list(zip(self.quantities, self.widths, strict=True))
        for store, width in stores:
            values = np.frombuffer(store[first * width : last * width], store.typecode)
            values = values.reshape(-1, width)
            for _ in range(times):
                one, values = values[::2], values[1::2]
                if self.is_mixed:
                    values = one
                    continue
                with np.errstate(invalid="ignore"):
                    apart = values - one
                # Between some there is nothing: a turn of a joint, or a value that is not given.
                is_near = np.abs(apart) < (_TURN if store is self.quantities[0] else np.inf)
                half = apart // 2 if store.typecode == "q" else apart / 2
                values = one + np.where(is_near, half, 0)
            behind = store[last * width :]
            del store[first * width :]
            store.frombytes(np.ascontiguousarray(values).tobytes())
            store.extend(behind)


# Names of joints, and what messages with these say.
_Block = tuple[tuple[str, ...], _Samples]


@dataclass(eq=False)
class JointRows:
    """Joint states of one topic: positions [rad], velocities [rad/s] and efforts [N·m]."""

    topic: str
    most_numbers: float = MAX_NUMBERS  # that are kept; of more messages some are left out, evenly
    _blocks: dict[tuple[str, ...], _Samples] = field(default_factory=dict, init=False)

    QUANTITIES = (("position", "rad"), ("velocity", "rad/s"), ("effort", "N·m"))
    """Name and unit of each signal, in the order of a `JointSample` and a `PlanPoint`."""

    def add(self, log_ns: int, sample: JointSample) -> None:
        """Append one message; ValueError or OverflowError where it makes no sense."""
        stamp_ns, names, *given = sample
        values = [np.asarray(quantity, np.float64).tobytes() for quantity in given]
        names = names or _NAMES[: max(map(len, values)) // 8]
        block = self._block(names, {len(quantity) // 8 for quantity in values})
        block.add(stamp_ns, log_ns, values)
        if not block.count % 1024:  # it takes long
            self._bound()

    def add_all(self, parts: Sequence[tuple[NDArray[np.intp], NDArray[np.int64], Any]]) -> None:
        """Append messages of one layout or several, all or none (ValueError).

        Each part: places among all, log stamps [ns], (N,), and a sample of arrays, (N, joints).
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

    def _block(self, names: tuple[str, ...], widths: set[int]) -> _Samples:
        """Return the block of these joints, whose quantities must have `widths` values or none."""
        block = self._blocks.get(names)
        if block is None:
            if sum(map(len, self._blocks)) + len(names) > _MAX_NAMES:
                raise BeyondLimitError(f"over {_MAX_NAMES} joints")
            if len(set(names)) < len(names):
                raise ValueError("two joints have one name")
        if not widths <= {0, len(names)}:
            raise ValueError(f"a message has {len(names)} names but another number of values")
        if block is None:
            block = self._blocks[names] = _Samples((len(names),) * 3)
        return block

    def signals(self, joint_names: tuple[str, ...] = ()) -> tuple[list[Signal], list[str]]:
        """Return the quantities that have any value as signals, and notes on what was repaired.

        Messages with one stamp and different joints make one sample; publishers that say different
        things of the same joints are apart. Joints without names are called `joint_names`.
        """
        for block in self._blocks.values():
            block.settle(is_end=True)
        found: list[Signal] = []
        notes: list[str] = []
        every = [_by_interface(*one, notes) for one in self._blocks.items() if one[0]]
        if nameless := self._blocks.get(()):
            notes.append(f"{nameless.count} messages are of no joint")
        publishers = self._publishers(every)
        notes = [f"{self.topic}: {note}" for note in dict.fromkeys(notes)]
        if len(publishers) > 1:
            counts = [sum(len(samples.log_ns) for _, samples in blocks) for blocks in publishers]
            many = {2: "two", 3: "three"}.get(len(counts), "several")
            notes.append(
                f"{self.topic}: {many} publishers on {self.topic}: "
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

    def _publishers(self, every: list[_Block]) -> list[list[_Block]]:
        """Group blocks by publisher: blocks that contradict each other are of different ones."""
        if len(every) > 50:  # that are compared in pairs
            return [every]
        found: list[list[_Block]] = []
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
        if len(found) > 1:  # what never changes comes last
            found.sort(key=lambda blocks: all(one.is_still for _, one in blocks))
        return found

    def _signals_of(
        self, topic: str, blocks: list[_Block], joint_names: tuple[str, ...]
    ) -> tuple[list[Signal], list[str]]:
        """Build the signals of one publisher, or of several that agree."""
        columns = tuple(dict.fromkeys(name for names, _ in blocks for name in names))
        trusts = [trusts_header(*block.stamps) for _, block in blocks]
        is_header = all(is_own for is_own, _ in trusts)
        notes = [reason for _, reasons in trusts for reason in reasons]
        ordered = [
            sorted_stamps(block.stamps[0 if is_header else 1], [block.values(k) for k in range(3)])
            for _, block in blocks
        ]
        left_out: dict[str, int] = {}
        for one in ordered:
            notes += one.notes
            left_out = added(left_out, one.left_out)
        most = max((samples for _, samples in blocks), key=lambda samples: samples.step)
        if most.step > 1:
            mixed = ", of two publishers that are not distinguishable" if most.is_mixed else ""
            notes.append(
                f"of {most.count} messages{mixed} the means of {most.step} in a row are used, as "
                "many as are held; cut the log where a part is to be used with all of them"
            )
        stamps_ns = ordered[0].stamps_ns
        if len(blocks) > 1:
            stamps_ns = distinct(np.concatenate([one.stamps_ns for one in ordered]))
        found: list[Signal] = []
        is_given = columns == _NAMES[: len(joint_names)] and len(set(joint_names)) == len(columns)
        shown = joint_names if is_given else columns
        for quantity, (label, unit) in enumerate(self.QUANTITIES):
            parts: list[NDArray[np.float64]] = []
            for (_, samples), own in zip(blocks, ordered, strict=True):
                part, keep = samples.values(quantity), own.keep
                is_all = len(keep) == len(part) and np.all(keep[1:] > keep[:-1])
                parts.append(part if is_all else part[keep])  # a copy only where it needs one
            values = parts[0]
            if len(blocks) > 1:
                values = np.full((len(stamps_ns), len(columns)), np.nan)
                for (names, _), own, part in zip(blocks, ordered, parts, strict=True):
                    indices = np.array([columns.index(name) for name in names])
                    cells = np.ix_(np.searchsorted(stamps_ns, own.stamps_ns), indices)
                    values[cells] = np.where(np.isnan(values[cells]), part, values[cells])
            if np.isfinite(values).any():
                name = f"{topic}.{label}"
                signal = Signal(name, stamps_ns, _finite(values), shown, unit, left_out=left_out)
                found.append(signal)
        return found, [f"{topic}: {note}" for note in dict.fromkeys(notes)]

    def _bound(self) -> None:
        """Average in the largest block while too many numbers are held."""

        def numbers(block: _Samples) -> int:
            return sum(map(len, block.quantities))

        for block in self._blocks.values():
            block.settle()
        while sum(map(numbers, self._blocks.values())) > self.most_numbers:
            max(self._blocks.values(), key=numbers).thin()


class ControllerRows:
    """Measured and commanded joints of one topic; the commands end with `.commands`."""

    def __init__(self, topic: str, most_numbers: float = MAX_NUMBERS) -> None:
        self._states, self._commands = JointRows(topic, most_numbers), JointRows("", most_numbers)
        self.topic = topic

    @property
    def topic(self) -> str:
        """Its topic, or the name that it goes by."""
        return self._states.topic

    @topic.setter
    def topic(self, topic: str) -> None:
        self._states.topic, self._commands.topic = topic, f"{topic}.{COMMANDS}"

    def add(self, log_ns: int, samples: tuple[JointSample, JointSample]) -> None:
        """Append one message; ValueError or OverflowError where it makes no sense."""
        for rows, sample in zip((self._states, self._commands), samples, strict=True):
            if any(len(values) for values in sample[2:]):
                rows.add(log_ns, sample)

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Return the quantities that have any value, and notes on what was repaired."""
        states, notes = self._states.signals()
        commands, more = self._commands.signals()
        return [*states, *(replace(one, drives=True) for one in commands)], [*notes, *more]


def _finite(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return NaN for what is not finite; read-only, so that a `Signal` makes no copy."""
    known = np.isfinite(values)
    values = values if known.all() else np.where(known, values, np.nan)
    values.flags.writeable = False
    return values


def _by_interface(
    names: tuple[str, ...], samples: _Samples, notes: list[str]
) -> tuple[tuple[str, ...], _Samples]:
    """Split joints named after ros2_control's interfaces ("joint_1/position") into quantities."""
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
    return joints, samples.like((len(joints),) * 3, [*samples.stamps, *quantities])


def _contradict(one: _Block, two: _Block) -> bool:
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


# ---- Pictures and sound: their stamps alone


@dataclass(eq=False)
class MediaStamps:
    """Acquisition stamps of one topic's pictures or pieces of sound, which are read on demand."""

    topic: str
    is_sound: bool = False
    is_video: bool = False  # whether a picture may be shown before one that was written first
    cut: int = field(default=0, init=False)  # pictures beyond a jump of their clock
    ahead: int = field(default=0, init=False)  # places by which pictures overtook each other
    _samples: _Samples = field(default_factory=lambda: _Samples(()), init=False)

    def add(self, log_ns: int, one: PictureSample | SoundSample) -> None:
        """Append one; OverflowError where its stamp lies beyond the year 2262."""
        self._samples.add(one.stamp_ns, log_ns, ())

    def trusts_header(self) -> tuple[bool, list[str]]:
        """Check whether header stamps can be trusted, and why not; sets `cut` and `ahead`, too."""
        header_ns, log_ns = self._samples.stamps
        if self.is_video:
            # In the order in which a decoder shows them, which holds 16 at most (H.264, H.265);
            # those that jump stay jumps.
            waiting: list[int] = []
            shown: list[int] = []
            for stamp_ns in header_ns.tolist():
                heappush(waiting, stamp_ns)
                if len(waiting) > 16:
                    shown.append(heappop(waiting))
            header_ns = np.array(shown + sorted(waiting), np.int64)
        is_header, reasons = trusts_header(header_ns, log_ns)
        if not self.is_sound:
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


# ---- Commands and forces: plain numbers, and wrenches

_MAX_COLUMNS = 1000  # numbers of one message; more are no commands, but a picture or a cloud


def _check_size(data: bytes | memoryview, most: int) -> None:
    """Refuse a message that is larger than any that is read, before it is decoded."""
    if len(data) > most:
        raise BeyondLimitError(f"a message of {len(data)} bytes is over the limit of {most}")


@dataclass(eq=False)
class NumberRows:
    """Unlabelled numbers of one topic: one signal, of unit "1"."""

    topic: str
    _lengths: dict[int, _Samples] = field(default_factory=dict, init=False)

    def check(self, data: bytes | memoryview) -> None:
        """Refuse a message that is larger than any with as many numbers as are read, as text."""
        _check_size(data, 64 * 1024)

    def add(self, log_ns: int, numbers: Values) -> None:
        """Append the numbers of one message; UnusableError where there are none."""
        values = np.asarray(numbers, np.float64)
        if not values.size:
            raise UnusableError("it holds no number")
        if values.size > _MAX_COLUMNS:
            raise BeyondLimitError(f"over {_MAX_COLUMNS} numbers")
        samples = self._lengths.setdefault(values.size, _Samples((values.size,)))
        samples.add(log_ns, log_ns, (values.tobytes(),))

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Return the messages of the most frequent length, and notes on what was left out."""
        if not self._lengths:
            return [], []
        length = max(self._lengths, key=lambda one: self._lengths[one].count)
        samples = self._lengths[length]
        numbers = samples.values(0)
        keep, stamps_ns, notes, left_out = sorted_stamps(samples.stamps[1], (numbers,))
        others = sum(one.count for one in self._lengths.values()) - samples.count
        if others:
            notes.append(f"{others} messages of another length than {length} were left out")
        values, columns = _finite(numbers[keep]), tuple(map(str, range(length)))
        signal = Signal(self.topic, stamps_ns, values, columns, "1", drives=True, left_out=left_out)
        return [signal], [f"{self.topic}: {note}" for note in notes]


@dataclass(eq=False)
class WrenchRows:
    """Forces [N] and torques [N·m] of one topic, each a signal."""

    topic: str
    _samples: _Samples = field(default_factory=lambda: _Samples((6,)), init=False)
    _frames: OneFrame = field(default_factory=OneFrame, init=False)

    def check(self, data: bytes | memoryview) -> None:
        """Accept every message."""

    def add(self, log_ns: int, wrench: WrenchSample) -> None:
        """Append one message; OverflowError where its stamp lies beyond the year 2262."""
        stamp_ns, frame, *six = wrench
        self._frames.add(frame)
        self._samples.add(stamp_ns, log_ns, (array("d", six).tobytes(),))

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Return force and torque where they have any value, and notes on what was repaired."""
        wrenches = self._samples.values(0)
        keep, stamps_ns, notes, left_out = order_samples(*self._samples.stamps, (wrenches,))
        values, frame = _finite(wrenches[keep]), self._frames.name
        found: list[Signal] = []
        for at, label, unit in ((0, "force", "N"), (3, "torque", "N·m")):
            three = values[:, at : at + 3]
            if np.isfinite(three).any():
                one = Signal(f"{self.topic}.{label}", stamps_ns, three, ("x", "y", "z"), unit)
                found.append(replace(one, drives=True, frame=frame, left_out=left_out))
        return found, [f"{self.topic}: {note}" for note in notes]


# ---- Planned trajectories: what of them no later one replaced

_MAX_POINTS = 100_000  # of a message: a minute and a half of a controller at 1 kHz
# Points of one topic, and messages without any, times its joints: a table of them must fit.
_MAX_CELLS = 10_000_000


class PointBudget:
    """Budget of trajectory points still to be read of a log of `log_bytes`."""

    def __init__(self, log_bytes: int) -> None:
        # Of any log, whatever its size is, and its bytes for each beyond.
        self._most = self._left = 200_000 + log_bytes // 50

    def check(self) -> None:
        """Refuse what comes once the budget is exhausted."""
        if self._left <= 0:
            raise BeyondLimitError(f"the log's trajectories have over {self._most} points")

    def spend(self, points: int) -> None:
        """Deduct points that were read; BeyondLimitError where there are not as many left."""
        self._left -= points
        if self._left < 0:
            self.check()


@dataclass(eq=False)
class PlannedRows:
    """Joint trajectory planned on one topic: positions [rad], velocities [rad/s], efforts [N·m].

    A later message replaces what an earlier one planned for its joints and the time after its own
    start; one without points replaces it by nothing, for all joints.
    """

    topic: str
    budget: PointBudget  # of points, shared by all topics of the log
    _log_ns: array[int] = field(default_factory=lambda: array("q"), init=False)
    _start_ns: array[int] = field(default_factory=lambda: array("q"), init=False)
    _stops: array[int] = field(default_factory=lambda: array("q"), init=False)
    # by joints: of each point its stamp [ns], the number of its message, and three quantities
    _plans: dict[tuple[str, ...], _Samples] = field(default_factory=dict, init=False)
    _joints: dict[str, None] = field(default_factory=dict, init=False)
    _points: int = field(default=0, init=False)

    def check(self, data: bytes | memoryview) -> None:
        """Refuse a message that is too large to be decoded, or beyond the budget."""
        _check_size(data, 4 * 1024 * 1024)  # its points become objects, larger than themselves
        self.budget.check()

    def add(self, log_ns: int, plan: PlanSample) -> None:
        """Append one message; UnusableError where its points do not follow each other in time."""
        points = plan.points
        self.budget.spend(len(points))
        if len(points) > _MAX_POINTS:
            raise BeyondLimitError(f"over {_MAX_POINTS} points")
        start_ns = plan.stamp_ns or log_ns
        after_ns = [point[0] for point in points]
        if any(one < 0 for one in after_ns[:1]) or any(b <= a for a, b in pairwise(after_ns)):
            raise UnusableError("the times of its points do not increase from 0")
        if not -LAST_NS <= start_ns <= LAST_NS - max(after_ns, default=0):
            raise OverflowError("a time of it lies beyond the year 2262")
        columns = [_filled(points, place, len(plan.names)) for place in (1, 2, 3)]
        names = plan.names
        plans = self._plans.get(names)
        if points and plans is None:
            if not names or len(set(names)) < len(names):
                raise ValueError("two joints have one name" if names else "it names no joint")
            if sum(map(len, self._plans)) + len(names) > _MAX_NAMES:
                raise BeyondLimitError(f"over {_MAX_NAMES} joints")
        joints = self._joints | dict.fromkeys(names) if points else self._joints
        if (self._points + max(1, len(points))) * len(joints) > _MAX_CELLS:
            raise BeyondLimitError(f"over {_MAX_CELLS} values planned")
        number = len(self._log_ns)
        if points:
            plans = plans or self._plans.setdefault(names, _Samples((len(names),) * 3))
            stamps_ns = np.array([start_ns + one for one in after_ns], np.int64)
            plans.add_all([stamps_ns, np.full(len(points), number), *columns])
        else:
            self._stops.append(number)
        self._joints = joints
        self._points += max(1, len(points))
        self._log_ns.append(log_ns)
        self._start_ns.append(start_ns)

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Return the quantities that have any value as signals; nothing is ever repaired."""
        columns = tuple(self._joints)
        parts = [(column, *self._kept_of(column)) for column in columns]
        if not parts:
            return [], []
        stamps_ns = np.unique(np.concatenate([own_ns for _, own_ns, _ in parts]))
        places = {name: place for place, name in enumerate(columns)}
        found: list[Signal] = []
        for quantity, (label, unit) in enumerate(JointRows.QUANTITIES):
            values = np.full((len(stamps_ns), len(columns)), np.nan)
            for column, own_ns, three in parts:
                values[np.searchsorted(stamps_ns, own_ns), places[column]] = three[quantity]
            if np.isfinite(values).any():
                name = f"{self.topic}.{label}"
                found.append(Signal(name, stamps_ns, _finite(values), columns, unit, drives=True))
        return found, []

    def _kept_of(self, joint: str) -> tuple[NDArray[np.int64], tuple[NDArray[np.float64], ...]]:
        """Return what was planned for a joint and not replaced: stamps [ns], three quantities."""
        groups = [(names, plans) for names, plans in self._plans.items() if joint in names]
        arrived, starts = (np.frombuffer(one, np.int64) for one in (self._log_ns, self._start_ns))
        # A message's plan ends at the first start of a later one, shape (M,) [ns]; meant for the
        # messages for this joint alone, and those that stop all.
        own = [np.unique(plans.stamps[1]) for _, plans in groups]
        every = np.concatenate([*own, np.frombuffer(self._stops, np.int64)])
        sent = every[np.lexsort((every, arrived[every]))]
        ends_ns = np.full(len(starts), LAST_NS)
        ends_ns[sent[:-1]] = np.minimum.accumulate(starts[sent][::-1])[::-1][1:]
        stamps: list[NDArray[np.int64]] = []
        ranks: list[NDArray[np.int64]] = []
        values: list[list[NDArray[np.float64]]] = []
        for names, plans in groups:
            own_ns, numbers = plans.stamps
            keep = own_ns <= ends_ns[numbers]
            stamps.append(own_ns[keep])
            ranks.append(numbers[keep])
            place = names.index(joint)
            values.append([plans.values(k)[keep, place] for k in range(3)])
        rank = np.concatenate(ranks)
        order = np.lexsort((rank, arrived[rank]))  # what comes later goes before, at one stamp
        three = tuple(np.concatenate(one)[order] for one in zip(*values, strict=True))
        return np.concatenate(stamps)[order], three


def _filled(points: Sequence[Sequence], place: int, width: int) -> NDArray[np.float64]:
    """Stack one quantity of all points, shape (points, joints); NaN where a point has none."""
    values = np.full((len(points), width), np.nan)
    for row, point in zip(values, points, strict=True):
        given = point[place]
        if len(given):
            if len(given) != width:
                raise ValueError(f"it has {width} names but another number of values")
            row[:] = given
    return values


# ---- Positions and orientations of bodies

ORIENTATION = "orientation"  # how the signal that stands beside one of positions ends


@dataclass(eq=False)
class PositionRows:
    """Positions of one topic, apart by body and, where it names bodies, by frame."""

    topic: str
    unit: str = "m"  # of the positions
    scale: float = 1.0  # from the unit of the messages to that
    # whether each message is of one body, whose name counts only among several
    names_one: bool = False
    _rows: dict[tuple[str, str], _Samples] = field(default_factory=dict, init=False)

    def add(self, log_ns: int, positions: Iterable[PositionSample]) -> None:
        """Append the positions of one message."""
        for stamp_ns, name, where, x, y, z, *turn in positions:
            # Of a body without a name, what calls itself a frame so often is a counter.
            is_counter = not name and len(self._rows) >= 100
            frame = "" if is_counter and (name, where) not in self._rows else where
            rows = self._rows.get((name, frame))
            if rows is None:
                if len(self._rows) >= _MAX_NAMES:
                    raise BeyondLimitError(f"over {_MAX_NAMES} names")
                rows = self._rows[name, frame] = _Samples((3, 4))
            rows.header_ns.append(stamp_ns)  # first: it may not fit
            rows.log_ns.append(log_ns)
            rows.quantities[0].extend((x, y, z))
            rows.quantities[1].extend(turn)

    def add_all(self, parts: Sequence[tuple[NDArray[np.intp], NDArray[np.int64], Any]]) -> None:
        """Append messages of one layout or several, all or none (ValueError).

        Each part: places among all, log stamps [ns], (N,), and samples of arrays, (N,).
        """
        found: dict[tuple[str, str], list[list[NDArray[Any]]]] = {}
        for places, log_ns, samples in parts:
            for stamp_ns, name, where, x, y, z, *turn in samples:
                three = np.column_stack([x, y, z]).astype(np.float64, copy=False)
                # of a point without orientation: none
                four = np.column_stack(turn) if turn else np.empty((len(places), 0))
                columns = [places, stamp_ns, log_ns, three, four]
                found.setdefault((name, where), []).append(columns)
        if len(self._rows.keys() | found.keys()) >= 100:  # counters may be among them
            raise ValueError("too many names or frames")
        for key, samples in found.items():
            places, *columns = (np.concatenate(column) for column in zip(*samples, strict=True))
            if len(samples) > 1:
                order = np.argsort(places, kind="stable")
                columns = [column[order] for column in columns]
            self._rows.setdefault(key, _Samples((3, 4))).add_all(columns)

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Return positions and, where it ever turns, `.orientation` of each body; and repairs."""
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
            second = two_sources(rows.values(0))
            if second is None:
                found += self._signals_of(full, frame, rows, taken, notes)
                continue
            other = f"{full}@2"
            taken.add(other)
            more = np.count_nonzero(second)
            notes.append(
                f"two publishers on {full}, or two objects: its samples are of two series by turns "
                f"({len(second) - more} and {more}); the second goes by {other} (--topic)"
            )
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
            logs = [rows.stamps[1] for _, rows in parts]
            if name or any(take_turns(*both) for both in pairwise(logs)):
                yield from ((name, frame, rows) for frame, rows in parts)
            elif len(parts) == 1:
                yield name, *parts[0]
            else:  # it was called otherwise from some time on
                joined = _Samples((3, 4))
                for _, one in sorted(parts, key=lambda part: part[1].log_ns[0]):
                    joined.add_all([*one.stamps, one.values(0), one.values(1)])
                yield name, "", joined

    def _signals_of(
        self, full: str, frame: str, rows: _Samples, taken: set[str], notes: list[str]
    ) -> Iterator[Signal]:
        """Yield the signals of one body; `taken` and `notes` get what is to be known."""
        places, turns = rows.values(0), rows.values(1)
        keep, stamps_ns, repairs, left_out = order_samples(*rows.stamps, (places,))
        values = places[keep] if self.scale == 1.0 else places[keep] * self.scale
        axes = ("x", "y", "z")
        yield Signal(
            full, stamps_ns, _finite(values), axes, self.unit, frame=frame, left_out=left_out
        )
        notes += [f"{full}: {repair}" for repair in repairs]
        label = f"{full}.{ORIENTATION}"
        # Sources of positions alone send no rotation: of a quaternion's vector, less is none.
        if len(turns) and label not in taken and (np.abs(turns[keep, :3]) > 1e-9).any():
            taken.add(label)
            axes = ("x", "y", "z", "w")
            yield Signal(label, stamps_ns, turns[keep], axes, "1", frame=frame, left_out=left_out)
