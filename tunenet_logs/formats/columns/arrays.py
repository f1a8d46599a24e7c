"""Build episodes from named columns of numbers, whatever file they come from.

`plan_columns` says which columns to read and what they are, before any of them is read: those that
the user names with `--columns`, else by their own names. `columns_episode` makes the signals of
them, with times as exact as the file's. `arrays_episode` does both for the 1-D and 2-D arrays of a
file.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import UNREADABLE, UNSTATED, Episode, Signal, added
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.columns.cells import (
    Clock,
    DayTurns,
    TimeUnit,
    is_of_day,
    says_its_unit,
    unit_of_times,
)
from tunenet_logs.formats.columns.names import (
    LENGTHS,
    CoordinateColumn,
    JointChoice,
    JointField,
    TimeColumn,
    UnusedColumn,
    choose_fields,
    joint_fields,
    lowered,
    meaning_of,
    words_of,
)
from tunenet_logs.formats.columns.table import (
    MAX_COLUMNS,
    RunNames,
    TableLayout,
    check_one_thing,
    clock_of,
    export_episode,
    frame_stamps,
    name_of_run,
    position_signal,
    restarts_note,
    rows_of_runs,
    run_columns,
    table_layout_of,
)
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.terminal import listed
from tunenet_logs.timing.stamps import sorted_stamps

# What `--columns` calls them, and the units of their signals.
_QUANTITIES = {"position": "rad", "velocity": "rad/s", "effort": "N·m", "current": "N·m"}

# Name, columns, unit and used columns (index, place, scale) of a signal.
SaidGroup = tuple[str, tuple[str, ...], str, tuple[tuple[int, int, float], ...]]


def said_index(path: Path, said: str, names: Sequence[str]) -> int:
    """Find the column that a user names, by name or by number from 1.

    The third column of an array `ball` is `ball[2]` or `ball.2`.

    Raises:
        LogError: there is none of that name, or several.
    """
    for same in (_as_is, _plain):
        found = [at for at, name in enumerate(names) if same(name) == same(said)]
        if len(found) > 1:
            numbers = " and ".join(str(at + 1) for at in found[:2])
            raise LogError(f"{path}: columns {numbers} are both {said!r}; name it by its number")
        if found:
            return found[0]
    if said.isascii() and said.isdecimal() and 1 <= int(said[:9]) <= len(names):
        return int(said) - 1
    there = listed([name[:40] for name in names]) or "none"
    what = f"{path}: no column is called {said[:60]!r} (there is: {there})"
    raise LogError(what, "name one of these, or its number from 1")


def _as_is(name: str) -> str:
    return name


def _plain(name: str) -> str:
    """Normalize a name: `Ball [2]` and `ball.2` are one."""
    return re.sub(r"[.\[(]\s*(\d+)\s*[\])]?$", r".\1", name.strip()).replace(" ", "").lower()


def said_groups(
    path: Path, said: Mapping[str, int], meant: Sequence[str], options: ReadOptions
) -> list[SaidGroup]:
    """Group the user's columns into signals.

    Args:
        path: for messages.
        said: the index of each column that was named.
        meant: the names to interpret.
        options: the user's.

    Raises:
        LogError: coordinates differ in their units, or torque constants do not fit.
    """
    groups: list[SaidGroup] = []
    if axes := [axis for axis in "xyz" if axis in said]:
        units = [_said_length(meant[said[axis]]) for axis in axes]
        if len({unit for unit, _ in units}) > 1:
            raise LogError(f"{path}: {', '.join(axes)} are in several units; convert them to one")
        used = tuple(
            (said[axis], "xyz".index(axis), scale)
            for axis, (_, scale) in zip(axes, units, strict=True)
        )
        groups.append(("track", ("x", "y", "z"), units[0][0], used))
    for quantity, unit in _QUANTITIES.items():
        numbers = sorted(
            int(target.rpartition("_")[2]) for target in said if target.startswith(f"{quantity}_")
        )
        if numbers and not (quantity == "effort" and "current_1" in said):
            groups.append(_said_joints(path, quantity, unit, numbers, said, meant, options))
    return groups


def _said_joints(
    path: Path,
    quantity: str,
    unit: str,
    numbers: Sequence[int],
    said: Mapping[str, int],
    meant: Sequence[str],
    options: ReadOptions,
) -> SaidGroup:
    constants = options.torque_constants if quantity == "current" else (1.0,) * len(numbers)
    if len(constants) != len(numbers):
        raise LogError(
            f"{path}: {len(numbers)} currents and {len(constants)} torque constants; give each "
            "joint's torque for each A with --torque-constants"
        )
    used: list[tuple[int, int, float]] = []
    for row, (number, constant) in enumerate(zip(numbers, constants, strict=True)):
        at = said[f"{quantity}_{number}"]
        scales = [field.scale for field in joint_fields([meant[at]]) if field.quantity == quantity]
        used.append((at, row, constant * (scales[0] if scales else 1.0)))
    ending = "effort" if quantity == "current" else quantity
    return f"joints.{ending}", tuple(f"joint{number}" for number in numbers), unit, tuple(used)


def _said_length(name: str) -> tuple[str, float]:
    """Return the length unit in a coordinate's name, and the scale to it."""
    meaning = meaning_of(name)
    if isinstance(meaning, CoordinateColumn):
        return meaning.unit or UNSTATED, meaning.scale
    words = lowered(words_of(name, camel=False))
    if len(words) > 1 and words[-1] in LENGTHS:
        return "m", LENGTHS[words[-1]]
    is_pixels = len(words) > 1 and words[-1] in ("px", "pixel", "pixels")
    return ("px" if is_pixels else UNSTATED), 1.0


# ---- Plan which columns to read: the user's, else by their names.

# What a column of frame numbers is called.
_FRAMES = {("frame",), ("frame", "index"), ("frame", "number"), ("frame", "no"), ("frame", "idx")}

# What people call quantities of a ball: an array of two or three columns is no arm's.
_OF_A_THING = {"pos", "position", "positions", "vel", "velocity", "velocities", "speed"}

JOINT_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N·m"}  # of the signals of joints


@dataclass(frozen=True)
class PlannedSignal:
    """Columns that make up one signal.

    Attributes:
        name: of the signal.
        columns: of the signal.
        unit: of the signal: of a position one of `LENGTHS`, "px" or `UNSTATED`.
        used: index, place in the signal and scale of each column in the file.
        clock: columns of its own times, where these differ from the plan's.
        is_track: whether it is a position over time.
    """

    name: str
    columns: tuple[str, ...]
    unit: str
    used: tuple[tuple[int, int, float], ...]
    clock: Clock | None = None
    is_track: bool = False


@dataclass(frozen=True)
class ColumnPlan:
    """Plan of what to read of a file of named columns.

    Attributes:
        names: of all columns, as the file has them.
        clock: time columns; None where rows or frames are counted.
        frames: the index of the column that counts frames; None where rows count.
        impacts: the column of impact times.
        runs: the columns that identify run and object of a row, with the kind of each.
        unused: the other columns, with the reason.
    """

    names: tuple[str, ...]
    signals: tuple[PlannedSignal, ...]
    clock: Clock | None = None
    frames: int | None = None
    impacts: Clock | None = None
    runs: tuple[tuple[int, str], ...] = ()
    unused: dict[str, str] = field(default_factory=dict)

    @property
    def needed(self) -> tuple[int, ...]:
        """Sorted indices of the columns to read."""
        clocks = [self.clock, self.impacts, *(signal.clock for signal in self.signals)]
        wanted = {at for clock in clocks if clock is not None for at in clock.indices}
        wanted.update(at for signal in self.signals for at, _, _ in signal.used)
        wanted.update(at for at, _ in self.runs)
        wanted.update(at for at in (self.frames,) if at is not None)
        return tuple(sorted(wanted))


def spread_names(name: str, width: int) -> tuple[list[str], list[str]]:
    """Name the columns of a 2-D array: their own names, and the names to interpret."""
    own = [f"{name}[{at}]" for at in range(width)]
    words = words_of(name, camel=False)
    is_place = bool(_OF_A_THING.intersection(lowered(words)))
    if width not in (2, 3) or (joint_fields(own) and not is_place):
        return own, own
    bare = name
    unit = ""
    if len(words) > 1 and words[-1].lower() in LENGTHS:
        bare, unit = "_".join(words[:-1]), f" ({words[-1]})"
    if isinstance(meaning_of(f"{bare.lower().removesuffix('s')} x"), UnusedColumn):
        bare = bare.lower().removesuffix("s")  # "forces" are no more places than a force
    return own, [f"{bare} {axis}{unit}" for axis in "xyz"[:width]]


def plan_columns(
    path: Path,
    names: Sequence[str],
    options: ReadOptions,
    meant: Sequence[str] | None = None,
    left_out: Mapping[str, str] | None = None,
) -> ColumnPlan:
    """Plan which columns to read, from the user's names or else by the columns' own.

    Args:
        path: of the file, for messages.
        names: of the columns, as the file has them.
        options: the user's.
        meant: the names to interpret, where these differ from `names`.
        left_out: what else the file holds, with the reason: for the refusal.

    Raises:
        LogError: there are too many, a column that was named is not there, the torque constants
            fit no currents, or nothing is of use.
    """
    if len(names) > MAX_COLUMNS:
        raise LogError(
            f"{path}: has {len(names)} columns, over the limit of {MAX_COLUMNS}; leave out those "
            "that are not needed"
        )
    said = {target: name for target, name in options.columns.items() if target != "object"}
    plan = (
        _said_plan(path, names, meant or names, replace(options, columns=said))
        if said
        else _found_plan(path, names, _with_franka_times(meant or names), options)
    )
    if "object" in options.columns:
        thing = said_index(path, options.columns["object"], names)
        plan = replace(plan, runs=((thing, "object"),))
    if not plan.signals and plan.impacts is None:
        others = {**(left_out or {}), **plan.unused}
        reasons = [f"{name[:60]!r}: {why}" for name, why in others.items()]
        why = "; ".join(reasons[:4]) or f"columns: {listed([name[:40] for name in names])}"
        raise LogError(
            f"{path}: no column is a place or a joint's ({why}); name them: --columns t=NAME,z=NAME"
        )
    return plan


def _with_franka_times(meant: Sequence[str]) -> list[str]:
    """Add the unit to libfranka's times, which are in ms without saying so."""
    words = [lowered(words_of(name, camel=False)) for name in meant]
    is_franka = ("success", "rate") in words and bool(joint_fields(meant))
    return [
        "time (ms)" if is_franka and word in (("duration",), ("time",)) else name
        for name, word in zip(meant, words, strict=True)
    ]


def _said_plan(
    path: Path, names: Sequence[str], meant: Sequence[str], options: ReadOptions
) -> ColumnPlan:
    """Plan only the columns that the user names."""
    said = {target: said_index(path, name, names) for target, name in options.columns.items()}
    clocks = {
        target: Clock(names[said[target]], (said[target],), _power(meant[said[target]]))
        for target in ("t", "times")
        if target in said
    }
    signals = [
        PlannedSignal(name, columns, unit, used, is_track=columns == ("x", "y", "z"))
        for name, columns, unit, used in said_groups(path, said, meant, options)
    ]
    taken = set(said.values())
    unused = {name: "not named in --columns" for at, name in enumerate(names) if at not in taken}
    clock, frames = clocks.get("t"), said.get("frame")
    if clock is None and frames is None and signals:
        found = clock_of(meant)
        clock = None if found is None else Clock(names[found.indices[0]], *_rest(found))
    return ColumnPlan(
        tuple(names), tuple(signals), clock, frames, clocks.get("times"), _runs(names), unused
    )


def _rest(clock: Clock) -> tuple[tuple[int, ...], int | None]:
    return clock.indices, clock.power


def _power(name: str) -> int | None:
    meaning = meaning_of(name)
    return meaning.power if isinstance(meaning, TimeColumn) else None


def _found_plan(
    path: Path, names: Sequence[str], meant: Sequence[str], options: ReadOptions
) -> ColumnPlan:
    """Plan columns by their own names."""
    fields = joint_fields(meant)
    choice = choose_fields(fields)
    taken = {at for at, name in enumerate(meant) if joint_fields([name])}
    clock = clock_of(meant)
    others = [name if at not in taken else "" for at, name in enumerate(meant)]
    layout = table_layout_of([*others, "t"] if clock is None else [*others, ""], ",")
    unused: dict[str, str] = {}
    frames = next((at for at, name in enumerate(names) if _words(name) in _FRAMES), None)
    joints = _joints(path, choice, options, unused)
    unused |= _unused(names, others, layout)
    tracks = _tracks(layout, {signal.name for signal in joints}, meant, unused)
    signals = (*joints, *tracks)
    if clock is None and not options.rate_hz:  # a joint's rows are no frames of a film
        for signal in signals:
            if not signal.is_track:
                unused[signal.name] = "nothing says when; say --columns t=NAME or --fps RATE"
        signals = tuple(signal for signal in signals if signal.is_track)
    uses_frames = clock is None and frames is not None
    return ColumnPlan(
        tuple(names),
        signals,
        clock,
        frames if uses_frames else None,
        runs=_runs(names),
        unused=unused,
    )


def _words(name: str) -> tuple[str, ...]:
    return lowered(words_of(name, camel=False))


def _runs(names: Sequence[str]) -> tuple[tuple[int, str], ...]:
    return run_columns(dict(enumerate(map(meaning_of, names))))


def _unused(
    names: Sequence[str], others: Sequence[str], layout: TableLayout | None
) -> dict[str, str]:
    """Return why columns that are not a joint's are not used."""
    reasons = {} if layout is None else layout.unused
    alike: dict[tuple[str, str], list[str]] = {}
    for name, other in zip(names, others, strict=True):
        if other in reasons and other:
            key = (re.sub(r"(?<!\d)\d++(?=\W*$)", "#", name), reasons[other])
            alike.setdefault(key, []).append(name)
    return {
        found[0] if len(found) == 1 else f"{found[0]} to {found[-1]}": why
        for (_, why), found in alike.items()
    }


def _tracks(
    layout: TableLayout | None, taken: set[str], meant: Sequence[str], unused: dict[str, str]
) -> list[PlannedSignal]:
    """Return the tracks that the table reader recognizes in the remaining columns."""
    found: list[PlannedSignal] = []
    for group in layout.groups if layout is not None else ():
        used = tuple((one.index, one.row, one.scale) for one in group.used)
        is_track = group.columns == ("x", "y", "z")
        if group.name in taken:
            for at, _, _ in used:
                unused[meant[at]] = f"other columns are {group.name}"
            continue
        clock = (
            group.stamp
            if group.stamp is not None and max(group.stamp.indices) < len(meant)
            else None
        )
        unit = group.unit or UNSTATED
        if is_track and not any(_names_unit(meant[at]) for at, _, _ in used):
            unit = UNSTATED
        found.append(PlannedSignal(group.name, group.columns, unit, used, clock, is_track))
    return found


def _names_unit(name: str) -> bool:
    """Return whether a coordinate's name states its unit."""
    return bool(getattr(meaning_of(name), "unit", ""))


def _joints(
    path: Path, choice: JointChoice, options: ReadOptions, unused: dict[str, str]
) -> list[PlannedSignal]:
    """Return the signals of an arm's fields, including torques computed from currents."""
    for one, why in choice.unused:
        unused[one.title] = why
    by_key = {(one.side, one.quantity): one for one in choice.used}
    constants = options.torque_constants
    if constants and not any(quantity == "current" for _, quantity in by_key):
        there = listed([one.stem for one in choice.used]) or "none"
        raise LogError(
            f"{path}: --torque-constants: there are no measured currents of joints (columns of "
            f"joints: {there})",
            "leave it out, or name their columns: --columns current_1=...",
        )
    signals: list[PlannedSignal] = []
    for (side, quantity), one in by_key.items():
        scales = [one.scale] * len(one.columns)
        if quantity == "current":
            if not constants:
                unused[one.title] = (
                    "currents [A] are no torques; say each joint's torque for each A with "
                    f"--torque-constants {_example(len(one.columns))}"
                )
                continue
            scales = [one.scale * constant for constant in _checked(path, one, constants)]
        elif quantity == "effort" and constants and (side, "current") in by_key:
            unused[one.title] = "the currents with --torque-constants are used"
            continue
        signals.append(_joint_signal(side or "joints", one, choice, scales))
    return signals


def _example(count: int) -> str:
    return ",".join(f"K{number}" for number in range(1, min(count, 3) + 1)) + (
        f",...,K{count}" if count > 3 else ""
    )


def _checked(path: Path, one: JointField, constants: Sequence[float]) -> Sequence[float]:
    if len(constants) != len(one.columns):
        raise LogError(
            f"{path}: --torque-constants has {len(constants)} numbers, {one.stem} "
            f"{len(one.columns)} joints; give each joint one"
        )
    return constants


def _joint_signal(
    group: str, one: JointField, choice: JointChoice, scales: Sequence[float]
) -> PlannedSignal:
    quantity = "effort" if one.quantity == "current" else one.quantity
    numbers = sorted(one.columns)
    used = tuple(
        (one.columns[number], row, scale)
        for row, (number, scale) in enumerate(zip(numbers, scales, strict=True))
    )
    labels = tuple(choice.labels[number] for number in numbers)
    return PlannedSignal(f"{group}.{quantity}", labels, JOINT_UNITS[quantity], used)


# ---- Convert time columns to stamps, exact where the file's own numbers are.

_LOOK_ROWS = 100  # that show whether times state their own unit
_MAX_NS = 2**62  # half of what int64 holds, so that differences fit as well


def column_stamps(
    clock: Clock, columns: Sequence[NDArray[Any]], *, is_sampled: bool = True
) -> tuple[NDArray[np.int64], NDArray[np.bool_], str]:
    """Convert one time column to stamps [ns], or two: seconds and nanoseconds, or date and time.

    Args:
        clock: meaning of the columns.
        columns: whole numbers, floats, dates (datetime64) or texts, shape (T,) each.
        is_sampled: see `unit_of_times`.

    Returns:
        Stamps, 0 where invalid, shape (T,); the mask of valid rows, shape (T,); and any doubt about
        their unit, in words.

    Raises:
        ValueError: they have no unit that a log has.
    """
    if len(columns) == 1 or (clock.has_date and columns[1].dtype.kind in "iufbM"):
        return _stamps(columns[-1], clock.power, clock, is_sampled)
    if clock.has_date:
        return _text_stamps(columns, TimeUnit(10 ** (9 + (clock.power or 0))), clock)
    seconds, some, _ = _stamps(columns[0], 0, clock)
    rest, others, _ = _stamps(columns[1], -9, clock)
    return seconds + rest, some & others, ""


def _stamps(
    values: NDArray[Any], power: int | None, clock: Clock, is_sampled: bool = True
) -> tuple[NDArray[np.int64], NDArray[np.bool_], str]:
    if values.dtype.kind == "M":
        known = ~np.isnat(values)
        known &= np.abs(values.astype("M8[s]").astype(np.int64)) < _MAX_NS // 10**9
        return np.where(known, values.astype("M8[ns]").astype(np.int64), 0), known, ""
    if values.dtype.kind not in "iufb":
        texts = [str(value).strip() for value in values.tolist() if value is not None]
        unit = TimeUnit(10 ** (9 + (power or 0)))
        if not any(map(says_its_unit, texts[:_LOOK_ROWS])):
            unit = unit_of_times(clock.name, texts, power, is_sampled=is_sampled)
        return _text_stamps([values], unit, clock)
    unit = unit_of_times(clock.name, values.tolist(), power, is_sampled=is_sampled)
    if values.dtype.kind in "iub":
        fits = np.abs(values.astype(np.float64)) * unit.ns < _MAX_NS
        return np.where(fits, values, 0).astype(np.int64) * unit.ns, fits, unit.doubt
    with np.errstate(over="ignore", invalid="ignore"):
        nanoseconds = np.round(values.astype(np.float64) * unit.ns)
        fits = np.abs(nanoseconds) < _MAX_NS  # NaN does not
    return np.where(fits, nanoseconds, 0).astype(np.int64), fits, unit.doubt


def _text_stamps(
    columns: Sequence[NDArray[Any]], unit: TimeUnit, clock: Clock
) -> tuple[NDArray[np.int64], NDArray[np.bool_], str]:
    rows = [
        ["" if cell is None else str(cell).strip() for cell in cells]
        for cells in zip(*(column.tolist() for column in columns), strict=True)
    ]
    stamps = np.zeros(len(rows), np.int64)
    fits = np.zeros(len(rows), np.bool_)
    of_day = next((texts[-1] for texts in rows if is_of_day(texts[-1])), None)
    turned = DayTurns(of_day) if of_day is not None and len(columns) == 1 else None
    one = replace(clock, indices=tuple(range(len(columns))))
    for row, texts in enumerate(rows):
        with suppress(ValueError):
            time_ns = one.read(texts, unit.ns)
            stamps[row], fits[row] = (turned(time_ns) if turned else time_ns), True
    return stamps, fits, unit.doubt


# ---- Build the episode of planned columns: the part that all array formats share.

MAX_ROWS = 2_000_000  # of a file: an hour at 500 Hz
_MAX_PLACES = 500_000  # of a track: 8 minutes at 1 kHz; tuning takes over 512 bytes for each
_MAX_VALUES = 16_000_000  # of all its signals
NamedArrays = Mapping[int, NDArray[Any]]  # columns by their index, shape (T,) each


@dataclass(frozen=True, eq=False)
class _Times:
    """Stamps of a file's rows.

    Attributes:
        stamps_ns: shape (T,).
        known: which rows have one, shape (T,).
        counts_frames: see `Signal`.
    """

    stamps_ns: NDArray[np.int64]
    known: NDArray[np.bool_]
    counts_frames: bool = False

    def taken(self, rows: NDArray[np.intp]) -> _Times:
        """Return the times of some rows."""
        return replace(self, stamps_ns=self.stamps_ns[rows], known=self.known[rows])


def columns_episode(
    path: Path,
    what: str,
    plan: ColumnPlan,
    arrays: NamedArrays,
    options: ReadOptions,
    *,
    rate_hz: float | None = None,
    unused: Mapping[str, str] | None = None,
    warnings: Sequence[str] = (),
    losses: Sequence[str] = (),
) -> Episode:
    """Build the episode of a file's columns.

    Args:
        path: of the file.
        what: kind of file, in words.
        plan: meaning of its columns.
        arrays: the columns that the plan needs.
        options: the user's.
        rate_hz: row rate stated by the file; None where it is unstated.
        unused: what else it holds, with the reason.
        warnings: of reading it.
        losses: damage found in it.

    Raises:
        LogError: it is too large, or no row has a time and a value.
    """
    check_rows(path, max(map(len, arrays.values()), default=0), plan)
    notes = list(warnings)
    signals: list[Signal] = []
    if plan.impacts is not None:
        signals.append(_impacts(plan.impacts, arrays))
    if plan.signals:
        reading = _Reading(path, plan, arrays, options, rate_hz)
        for run, rows in reading.runs():
            for planned in plan.signals:
                name = name_of_run(planned.name, run, is_joints=_is_joints(planned.name))
                signal, repairs = reading.signal(name, planned, rows)
                signals.append(signal)
                notes += repairs
        notes += reading.notes
    signals, moved = _from_zero([signal for signal in signals if len(signal.stamps_ns)])
    if not signals:
        named = ", ".join(signal.name for signal in plan.signals) or "impacts"
        raise LogError(f"{path}: no row has a time and a value of {named}", EXPORT_AGAIN)
    return export_episode(
        path,
        what,
        signals,
        unused={**plan.unused, **(unused or {})},
        warnings=[*notes, *moved],
        losses=losses,
    )


def check_rows(path: Path, count: int, plan: ColumnPlan) -> None:
    """Refuse a file of too many rows with a LogError."""
    width = sum(len(signal.columns) for signal in plan.signals)
    is_track = any(signal.columns == ("x", "y", "z") for signal in plan.signals)
    rows = _MAX_PLACES if is_track else MAX_ROWS
    if count > rows or count * width > _MAX_VALUES:
        most = min(rows, _MAX_VALUES // max(width, 1))
        raise LogError(f"{path}: has over {most} rows, the limit; split it")


class _Reading:
    """Rows of a file with their stamps."""

    def __init__(
        self,
        path: Path,
        plan: ColumnPlan,
        arrays: NamedArrays,
        options: ReadOptions,
        rate_hz: float | None,
    ) -> None:
        self._path = path
        self._plan = plan
        self._arrays = arrays
        self._options = options
        self.notes: list[str] = []
        self._clocks: dict[Clock, _Times] = {}
        self._times = self._main_times(plan, rate_hz)

    def _main_times(self, plan: ColumnPlan, rate_hz: float | None) -> _Times:
        if plan.clock is not None:
            times = self._of(plan.clock)
            lost = int(np.count_nonzero(~times.known))
            if lost:
                self.notes.append(f"{lost} rows without a time were left out")
            return times
        count = len(next(iter(self._arrays.values())))
        numbers = np.arange(count, dtype=np.float64)
        if plan.frames is not None:
            numbers = _floats(self._arrays[plan.frames])
        elif not (self._options.rate_hz or rate_hz):
            self.notes.append(
                "nothing says when; rows were counted as frames (--fps, or --columns t=NAME)"
            )
        known = np.isfinite(numbers) & (np.abs(numbers) < 2.0**50)
        stamps, counts_frames = frame_stamps(np.where(known, numbers, 0), rate_hz, self._options)
        return _Times(stamps, known, counts_frames)

    def _of(self, clock: Clock) -> _Times:
        if clock not in self._clocks:
            columns = [self._arrays[at] for at in clock.indices]
            try:
                stamps, known, doubt = column_stamps(clock, columns)
            except ValueError as error:
                raise LogError(f"{self._path}: {error}") from error
            self.notes += [doubt] if doubt else []
            self._clocks[clock] = _Times(stamps, known)
        return self._clocks[clock]

    def runs(self) -> list[tuple[str, NDArray[np.intp]]]:
        """Return the name and rows of each run or object; rows without a stamp are left out.

        Raises:
            LogError: there are too many runs.
        """
        rows = np.flatnonzero(self._times.known)
        columns = [self._arrays[at].tolist() for at, _ in self._plan.runs]
        found = RunNames([kind for _, kind in self._plan.runs])
        cells = [[_label(column[row]) for column in columns] for row in rows.tolist() if columns]
        numbers = np.array([found.number(texts) for texts in cells], np.int64)
        try:
            parts = rows_of_runs(self._times.stamps_ns[rows], numbers, found.names)
        except ValueError as error:
            raise LogError(f"{self._path}: {error}") from error
        self.notes += [found.note] if len(parts) > 1 and found.note else restarts_note(parts)
        return [(name, rows[of_run]) for name, of_run in parts]

    def signal(
        self, name: str, planned: PlannedSignal, rows: NDArray[np.intp]
    ) -> tuple[Signal, list[str]]:
        """Return the signal of some rows, and notes on what was repaired."""
        times = self._times if planned.clock is None else self._of(planned.clock)
        times = times.taken(rows)
        values = np.full((len(rows), len(planned.columns)), 0.0 if planned.is_track else np.nan)
        for at, place, scale in planned.used:
            values[:, place] = _floats(self._arrays[at])[rows] * scale
        values[~np.isfinite(values)] = np.nan
        untimed = {UNREADABLE: int(np.count_nonzero(~times.known))}
        values, stamps = values[times.known], times.stamps_ns[times.known]
        some = np.isfinite(values).any(axis=1)
        try:
            check_one_thing(stamps[some], values[some])
        except ValueError as error:
            raise LogError(f"{self._path}: {error}") from error
        if planned.is_track:
            signal, notes = position_signal(
                name, stamps, values, planned.unit, self._options, counts_frames=times.counts_frames
            )
            return replace(signal, left_out=added(signal.left_out, untimed)), notes
        some = np.isfinite(values).any(axis=1)
        keep, ordered, notes, left_out = sorted_stamps(stamps[some], (values[some],))
        columns, unit = planned.columns, planned.unit
        left_out = added(left_out, untimed)
        signal = Signal(name, ordered, values[some][keep], columns, unit, left_out=left_out)
        return signal, [f"{name}: {note}" for note in notes]


def _floats(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return a column as floats, NaN where it is no number, shape (T,)."""
    if values.dtype.kind in "iufb":
        return values.astype(np.float64)
    found = np.full(len(values), np.nan)
    for row, value in enumerate(values.tolist()):
        try:
            found[row] = float(value)
        except (TypeError, ValueError, OverflowError):
            continue
    return found


def _is_joints(name: str) -> bool:
    return name.rpartition(".")[2] in JOINT_UNITS


def _label(value: object) -> str:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return str(value)


def _impacts(clock: Clock, arrays: NamedArrays) -> Signal:
    """Return the impact times as a signal."""
    columns = [arrays[at] for at in clock.indices]
    stamps, known, _ = column_stamps(clock, columns, is_sampled=False)
    ordered = sorted_stamps(stamps[known]).stamps_ns
    return Signal("impacts", ordered, np.ones((len(ordered), 1)), ("impact",), "1")


def _from_zero(signals: list[Signal]) -> tuple[list[Signal], list[str]]:
    """Shift signals so that no stamp is negative, and note the shift."""
    first = min((int(signal.stamps_ns[0]) for signal in signals), default=0)
    if first >= 0:
        return signals, []
    moved = [replace(signal, stamps_ns=signal.stamps_ns - first) for signal in signals]
    return moved, [f"times begin at {first / 1e9:.9g} s; they were moved to begin at 0"]


# ---- Interpret the 1-D and 2-D arrays of one file as columns of equal length.

MAX_ARRAY_BYTES = 128 * 1024**2  # of all arrays of a file
_MAX_WIDTH = 200  # columns of one array
_MIN_ROWS = 3  # of an array that is no setting
# Names of a scalar that is the rate of rows [Hz].
_RATES = frozenset(("fps", "fs", "hz", "rate", "sampling_rate", "sample_rate", "frame_rate"))

# Names of a scalar that is the time from row to row [s].
_PERIODS = frozenset(("dt", "ts", "timestep", "time_step", "sample_time", "period"))

# Words behind a name that only say that there are many values.
_LISTS = frozenset(("list", "arr", "array", "data", "vec", "hist", "history", "log", "values"))

_PLURALS = {"ts": "t", "xs": "x", "ys": "y", "zs": "z"}  # what people call many of them
Arrays = Mapping[str, NDArray[Any]]  # arrays by their names
_NAME_THEM = "save a table of time and x, y, z, or say which is which with --columns t=..,z=.."


def arrays_episode(
    path: Path, what: str, arrays: Arrays, options: ReadOptions, unused: Mapping[str, str]
) -> Episode:
    """Build an episode from arrays: those as long as the times are its columns.

    Args:
        path: of the file.
        what: kind of file, in words.
        arrays: numbers, texts or dates; of two dimensions with a row (or column) a time.
        options: the user's.
        unused: what else the file holds, with the reason.

    Raises:
        LogError: nothing is of use.
    """
    plain = _without_records(arrays)
    left_out = dict(unused)
    count = _length(plain, options)
    names: list[str] = []
    meant: list[str] = []
    columns: list[NDArray[Any]] = []
    for name, array in plain.items():
        rows = _rows(array, count)
        if isinstance(rows, str):
            if array.size > 1 or name not in (*_RATES, *_PERIODS):
                left_out[name] = rows
            continue
        own, said = [name], [_bare(name)]
        if rows.ndim == 2:
            own = spread_names(name, rows.shape[1])[0]
            said = spread_names(_bare(name), rows.shape[1])[1]
        names += own
        meant += said
        columns += [rows] if rows.ndim == 1 else list(rows.T)
    if not columns:
        reasons = "; ".join(f"{name[:40]!r}: {why}" for name, why in list(left_out.items())[:4])
        raise LogError(
            f"{path}: holds no array of numbers that is a place over time ({reasons})", _NAME_THEM
        )
    plan = plan_columns(path, names, options, meant, left_out)
    needed = {at: columns[at] for at in plan.needed}
    return columns_episode(path, what, plan, needed, options, rate_hz=_rate(plain), unused=left_out)


def _bare(name: str) -> str:
    """Strip a name of its plural or container suffix: `t_list`, `zs`."""
    words = name.split("_")
    if len(words) > 1 and words[-1].lower() in _LISTS:
        name = "_".join(words[:-1])
    return _PLURALS.get(name, name)


def _without_records(arrays: Arrays) -> dict[str, NDArray[Any]]:
    """Replace structured arrays by one array per field."""
    plain: dict[str, NDArray[Any]] = {}
    for name, array in arrays.items():
        fields = array.dtype.names
        if fields is None:
            plain[name] = array
            continue
        for one in fields:
            plain[f"{name}.{one}" if len(arrays) > 1 else one] = array[one]
    return plain


def _length(arrays: Arrays, options: ReadOptions) -> int:
    """Return the number of rows: that of the times, else the most common length."""
    said = [options.columns[one] for one in ("t", "frame", "times") if one in options.columns]
    said = said or list(options.columns.values())[:1]
    for name in said:
        if (array := arrays.get(re.sub(r"(?:\[\d+\]|\.\d+)$", "", name))) is not None:
            return max(array.shape, default=1)
    lengths = {name: max(array.shape, default=1) for name, array in arrays.items()}
    times = [
        name
        for name, length in lengths.items()
        if length >= _MIN_ROWS
        and arrays[name].size == length
        and isinstance(meaning_of(_bare(name)), TimeColumn)
    ]
    if times:
        return lengths[min(times, key=lambda name: len(words_of(name, camel=True)))]
    common = Counter(length for length in lengths.values() if length >= _MIN_ROWS)
    return max(common, key=lambda length: (common[length], length), default=0)


def _rows(array: NDArray[Any], count: int) -> NDArray[Any] | str:
    """Return an array with one row per time, shape (T,) or (T, K), or why it has none."""
    shape = " x ".join(map(str, array.shape))
    if array.dtype.kind == "O" or array.dtype.kind not in "biufMUS":
        return "it holds no numbers"
    if array.size == 1 and count != 1:
        return "one number, no column"
    if array.size == count:
        return array.reshape(count)
    if array.ndim == 2 and count in array.shape:
        rows = array if array.shape[0] == count else array.T
        if rows.shape[1] > _MAX_WIDTH:
            return f"its {rows.shape[1]} columns are more than an arm or a ball has"
        return rows
    return f"its shape {shape} has not the {count} rows that there are times"


def _rate(arrays: Arrays) -> float | None:
    """Return the sampling rate [Hz] stated by a scalar of the file; None where there is none."""
    for name, array in arrays.items():
        word = "_".join(lowered(words_of(name, camel=False)))
        if array.size != 1 or array.dtype.kind not in "iuf":
            continue
        value = float(array.reshape(()))
        if word in _RATES and 0.01 < value < 1e6:
            return value
        if word in _PERIODS and 1e-6 < value < 100:
            return 1 / value
    return None


def number_names(array: NDArray[Any], path: Path, options: ReadOptions) -> dict[str, NDArray[Any]]:
    """Return the columns of an unnamed array by their numbers from 1.

    Raises:
        LogError: the user names no columns, or it is no table.
    """
    shape = " x ".join(map(str, array.shape)) or "one number"
    if array.ndim == 1 and array.size:
        array = array.reshape(-1, 1)
    if array.ndim != 2 or not array.size or array.dtype.kind not in "biuf":
        raise LogError(f"{path}: is an array ({shape}) that is no table of numbers", _NAME_THEM)
    if array.shape[0] < array.shape[1]:
        array = array.T
    if array.shape[1] > _MAX_WIDTH:
        raise LogError(
            f"{path}: is an array ({shape}), which is more than an arm or a ball has", _NAME_THEM
        )
    if not options.columns:
        raise LogError(
            f"{path}: is an array ({shape}) whose columns have no names; say which is which by "
            "number from 1: --columns t=1,z=2"
        )
    return {str(at + 1): np.ascontiguousarray(column) for at, column in enumerate(array.T)}
