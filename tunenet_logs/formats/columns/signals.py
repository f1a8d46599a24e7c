"""Make the signals of a plan from the rows of its columns, and an episode of these.

A reader that has to know which columns to read before it reads them asks `plan_columns`, fills
`ColumnRows` with those that are needed, and calls `episode_of_rows`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tunenet_logs.episode import (
    FRAME_NS,
    INCOMPLETE,
    UNREADABLE,
    UNSTATED,
    Channel,
    Episode,
    EpisodeInfo,
    Signal,
    added,
    in_proportion,
)
from tunenet_logs.errors import EXPORT_AGAIN, LogError
from tunenet_logs.formats.columns.cells import (
    MAX_NS,
    Clock,
)
from tunenet_logs.formats.columns.names import (
    LENGTHS,
    short_list,
)
from tunenet_logs.formats.columns.plan import (
    POWER,
    ColumnPlan,
    Group,
    name_of_run,
    with_angles,
)
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.timing.stamps import fill_holes, order_samples, sorted_stamps

# ---- What all exports share: stamps, and the signal of a position.


def time_stamps(seconds: ArrayLike) -> NDArray[np.int64]:
    """Convert times [s] to stamps [ns], shape (T,); ValueError if one is out of range."""
    values = np.asarray(seconds, np.float64)
    if not np.all(np.abs(values) < MAX_NS * 1e-9):  # NaN is not
        raise ValueError("a time is none")
    return np.round(values * 1e9).astype(np.int64)


def frame_stamps(
    frames: ArrayLike, rate_hz: float | None, options: ReadOptions
) -> tuple[NDArray[np.int64], bool]:
    """Convert frame numbers to stamps [ns], shape (T,), and say whether their rate is unknown."""
    rate = options.fps or rate_hz
    period_s = FRAME_NS * 1e-9 if not rate else 1 / rate
    return time_stamps(np.asarray(frames, np.float64) * period_s), not rate


def exact_seconds(
    times: NDArray[np.float64], frames: NDArray[np.float64], rate_hz: float | None
) -> NDArray[np.float64]:
    """Return times [s] without rounding error, from frames and rate where these agree with them."""
    if not rate_hz:
        return times
    rounding_s = 0.6e-3  # of a time in a file: some are written with three decimals
    by_frame = times[0] + (frames - frames[0]) / rate_hz
    with np.errstate(invalid="ignore", over="ignore"):
        agrees = np.all(np.abs(by_frame - times) < min(rounding_s, 0.3 / rate_hz))
    if not agrees:
        return times
    offset = times[0] - frames[0] / rate_hz  # of whole frames: then it is rounding as well
    frames_off = np.round(offset * rate_hz)
    if abs(offset - frames_off / rate_hz) < rounding_s:
        return (frames + frames_off) / rate_hz
    return by_frame


def in_metres(
    values: NDArray[np.float64], unit: str, options: ReadOptions
) -> tuple[NDArray[np.float64], str]:
    """Convert positions to metres and say their unit: "m", "px" or `UNSTATED`.

    `--length-unit` stands in for a unit that the file does not state, or for pixels.
    """
    unit = unit if unit in LENGTHS else options.length_unit or unit
    return (values * LENGTHS[unit], "m") if unit in LENGTHS else (values, unit or UNSTATED)


def export_episode(
    path: Path,
    what: str,
    signals: Sequence[Signal],
    *,
    channels: Sequence[Channel] | None = None,
    unused: Mapping[str, str] | None = None,
    warnings: Sequence[str] = (),
    losses: Sequence[str] = (),
    encoding: str = "export",
) -> Episode:
    """Build the episode of an export."""
    none: NDArray[np.int64] = np.empty(0, np.int64)
    made = [
        Channel(one.name, _type_of(one.columns, one.unit), encoding, one.stamps_ns)
        for one in (signals if channels is None else ())
    ]
    left = [
        Channel(name[:200], "", encoding, none, skipped=why) for name, why in (unused or {}).items()
    ]
    by_signal = {one.name: one for one in signals if len(one.stamps_ns)}
    every = (*(channels or ()), *made, *left)
    info = EpisodeInfo(source=f"{what} {path.name}")
    return Episode(info, by_signal, every, (*losses, *warnings), tuple(losses))


def _type_of(columns: Sequence[str], unit: str, note: str = "") -> str:
    shown = ", ".join(columns) if len(columns) <= 8 else f"{len(columns)} columns"
    return f"{shown} [{unit or '?'}]{f': {note}' if note else ''}"


def unique_names(names: Iterable[str], form: str = "{} {}", longest: int = 60) -> list[str]:
    """Shorten names and make them unique: the second "a" is "a 2"."""
    counts: Counter[str] = Counter()
    found: dict[str, None] = {}
    for name in names:
        short = " ".join("".join(filter(str.isprintable, name)).split())[:longest] or "unnamed"
        chosen = short
        while chosen in found:
            counts[short] += 1
            chosen = form.format(short, counts[short] + 1)
        found[chosen] = None
    return list(found)


# ---- Split stacked runs, by a column that numbers them or where the times restart.

_MAX_RUNS = 500  # of a table; each is a signal of its own
MAX_TRACKS = 1000  # of a table of tracks, the longest; of cells there are many thousands
_MIN_ROWS = 5  # of a run that only its times show
_ZONE_NS = 900 * 10**9  # local time is set by multiples of this, as at the end of summer time
RowSet = NDArray[np.intp] | slice  # which rows


class RunNames:
    """Runs of a table in order of appearance, by columns of some kinds: "run", "ball", ..."""

    def __init__(self, kinds: Sequence[str]) -> None:
        self._kinds = kinds
        self._numbers: dict[tuple[str, ...], int] = {}
        self._by_name: dict[tuple[str, ...], int] = {}

    @property
    def names(self) -> list[str]:
        """Names such as "run1" for a number, else the table's own; "run1.ball" for two columns."""
        parts = list(self._by_name)
        told = [at for at in range(len(self._kinds)) if len({each[at] for each in parts}) > 1]
        return [".".join(each[at] for at in told) or ".".join(each) for each in parts]

    @property
    def note(self) -> str:
        """Note that a task takes one of several objects; "" for runs, or for one object."""
        names = self.names
        if len(names) < 2 or set(self._kinds) <= {"run"}:
            return ""
        shown = ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
        return f"rows are of {len(names)} things ({shown}): each is a signal; see --topic"

    def number(self, cells: Sequence[str]) -> int:
        """Return the index of a run in `names`, by the cells of its columns."""
        texts = tuple(cell.strip()[:40] for cell in cells)
        if (number := self._numbers.get(texts)) is None:
            parts = tuple(map(_name_of, texts, self._kinds))
            number = self._numbers[texts] = self._by_name.setdefault(parts, len(self._by_name))
        return number


def _name_of(text: str, kind: str) -> str:
    """Name a run: "run2" for "2", "2.0" and "Run 2"; others keep their name."""
    if found := re.fullmatch(rf"(?:{kind}\W{{0,3}})?0*(\d{{1,15}})(?:[.,]0*)?", text, re.I | re.A):
        return f"{kind}{found[1]}"
    return re.sub(r"\W+", "_", text).strip("_").lower() or f"no_{kind}"


def told_apart(plan: ColumnPlan, rows: Sequence[Sequence[str]]) -> ColumnPlan:
    """Find the column that identifies objects, where several of the first rows share a stamp.

    A column that merely counts the rows identifies none. Of those whose names say nothing one is
    taken that makes all pairs of stamp and cell unique: names before numbers, few objects before
    many.
    """
    is_few = len(rows) < _MIN_ROWS  # numbers that all differ may still be those of objects
    runs = [one for one in plan.runs if is_few or len({row[one[0]] for row in rows}) < len(rows)]
    plan = replace(plan, runs=tuple(runs))
    if len(plan.clocks) != 1 or not plan.clocks[0].indices:
        return plan
    told = (*plan.clocks[0].indices, *(at for at, _ in runs))
    times = [tuple(row[at] for at in told) for row in rows]
    if len(set(times)) == len(times):
        return plan
    taken = {*plan.needed, *plan.labels.values()}
    found: list[tuple[bool, int, int]] = []
    for at in (at for at in range(len(plan.names)) if at not in taken):
        cells = [row[at] for row in rows]
        things = len(set(cells))
        is_told = 1 < things <= len(cells) // 3 and all(map(str.strip, cells))
        if is_told and len(set(zip(times, cells, strict=True))) == len(times):
            has_numbers = any(re.fullmatch(r"[+-]?[\d.,]+", cell.strip()) for cell in cells)
            found.append((has_numbers, things, at))
    if not found:
        return plan
    at = min(found)[2]
    name = re.sub(r"\W+", "_", plan.names[at].strip()).strip("_").lower()
    return replace(plan, runs=(*runs, (at, name[:20] or "object")))


def rows_of_runs(
    times_ns: NDArray[np.int64], runs: NDArray[np.int64], names: Sequence[str]
) -> list[tuple[str, RowSet]]:
    """Return name and rows of each run or object; the name is "" where there is only one.

    A column of run numbers separates runs where times restart with another number, or where
    numbers alternate: an object whose number changes once and for all is one object. `runs` are
    indices in `names`, empty where the table numbers none; ValueError if they are too many.
    """
    changes = np.diff(runs) != 0
    backwards = np.flatnonzero(np.diff(times_ns) <= 0)
    comes_and_goes = np.count_nonzero(changes) > max(0.5 * len(runs), len(names))
    if len(runs) and (comes_and_goes or np.any(changes[backwards])):
        numbers = np.unique(runs)
        if 2 * len(numbers) <= len(runs):  # else each row has a number of its own
            _check_count(len(numbers))
            return [(str(names[one]), np.flatnonzero(runs == one)) for one in numbers.tolist()]
    starts = _restarts(times_ns, backwards)
    if len(starts) == 1:
        return [("", slice(None))]
    _check_count(len(starts))
    pairs = zip(starts, [*starts[1:], len(times_ns)], strict=True)
    return [(f"run{number}", slice(*pair)) for number, pair in enumerate(pairs, 1)]


def _check_count(count: int) -> None:
    if count > _MAX_RUNS:
        raise ValueError(f"holds {count} runs, over the limit of {_MAX_RUNS}; split it")


def _restarts(times_ns: NDArray[np.int64], backwards: NDArray[np.intp]) -> list[int]:
    """Return where runs begin; a few rows out of order begin none."""
    starts = [0]
    if not len(backwards):
        return starts
    # Rows from there to the next that is back.
    rising = np.diff(backwards, append=len(times_ns) - 1)
    for at in (backwards[rising >= _MIN_ROWS] + 1).tolist():
        begin = starts[-1]
        ahead = times_ns[at : at + _MIN_ROWS]
        if at - begin < _MIN_ROWS:
            continue
        last, first = int(times_ns[at - 1]), int(times_ns[begin])
        back = last - int(times_ns[at])
        period_ns = (last - first) / (at - 1 - begin)
        is_local = back > _ZONE_NS / 2 and -back % _ZONE_NS <= 10 * period_ns
        if times_ns[at] < first and is_local:
            continue  # one run, whose clock was set
        around = times_ns[begin : begin + max(2 * (at - begin), 128)]
        if fill_holes(around, at - begin):
            continue  # one run, whose rows overtook each other
        if back > 0.8 * (last - first) > 0 and ahead[-1] < last:
            starts.append(at)
    return starts


def check_one_thing(times_ns: NDArray[np.int64], values: NDArray[np.float64], remedy: str) -> None:
    """Refuse rows that are of several objects, or whose stamps are truncated.

    In stacked rows of several objects, the second row of each stamp is near the second row of the
    next; of one object with coarse stamps, it is near the first of its own. Raises ValueError.
    """
    order = np.argsort(times_ns, kind="stable")
    times, rows = times_ns[order], values[order]
    is_same = np.diff(times) == 0
    if not np.any(is_same):
        return
    steps = _steps(rows)
    shared = int(np.count_nonzero(is_same & ((steps > 0) | bool(remedy))))
    if shared <= 0.1 * len(times):  # some messages are sent twice
        return
    firsts = np.flatnonzero(np.concatenate([[True], ~is_same]))
    rank = np.arange(len(times)) - np.repeat(firsts, np.diff(firsts, append=len(times)))
    by_rank = np.argsort(rank, kind="stable")
    alike = _steps(rows[by_rank])[np.diff(rank[by_rank]) == 0]
    are_things = len(alike) > 0 and np.median(alike) < 0.5 * np.median(steps[is_same])
    # With fewer stamps than one for five rows, no motion shows.
    if not are_things and len(firsts) > 0.2 * len(times) and not remedy:
        return
    what = "the stamps have too few digits; write times with all their digits"
    if are_things:
        what = (
            "several things, or stamps of too few digits; say which column separates the objects: "
            "--columns object=NAME, or write times with all their digits"
        )
    raise ValueError(
        f"{shared} of {len(times)} rows have the stamp of another row and other values: "
        f"{remedy or what}"
    )


def _steps(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the largest change from each row to the next, shape (T - 1,); 0 where missing."""
    return np.nan_to_num(np.abs(np.diff(rows, axis=0))).max(axis=1, initial=0.0)


# ---- Rows of a plan's columns, and the signals that they make.


class Times(NamedTuple):
    """What a clock says in each row."""

    stamps_ns: NDArray[np.int64]  # shape (T,); of counted frames one second for each
    known: NDArray[np.bool_]  # which rows have one, shape (T,)
    doubts: Sequence[str] = ()  # about their unit or zone, in words


@dataclass(frozen=True, eq=False)
class ColumnRows:
    """The columns that a plan needs."""

    # values by the index of their column, NaN where there is none, shape (T,) each
    numbers: Mapping[int, NDArray[np.float64]]
    times: Mapping[Clock, Times]  # of each clock
    # the index in `names` of each row's run or object, -1 for none, shape (T,); empty where the
    # table numbers none
    runs: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    names: Sequence[str] = ()  # of the runs or objects
    note: str = ""  # about these, for the user


class Made(NamedTuple):
    """Signals of a table, their channels, what is unused besides, and notes on repairs."""

    signals: list[Signal]
    channels: list[Channel]
    unused: dict[str, str]
    notes: list[str]


def signals_of(
    path: Path,
    plan: ColumnPlan,
    rows: ColumnRows,
    options: ReadOptions,
    rate_hz: float | None = None,
    encoding: str = "export",
) -> Made:
    """Make the signals of a plan: one for each group, run and object."""
    plan, notes = with_angles(path, plan, rows.numbers, options)
    made = Made([], [], dict(plan.unused), notes)
    # Which rows have a sample of each group that is sure, and how many lack some coordinate.
    seen: dict[str, tuple[NDArray[np.bool_], int]] = {}
    untimed: dict[Clock, NDArray[np.bool_]] = {}
    starts, unsure = [0], 0
    for group in plan.groups:
        times, incomplete = rows.times[group.clock], 0
        is_seen = times.known if group.is_impacts else group.seen(rows.numbers)
        if group.is_track:
            some = group.seen(rows.numbers, in_part=True)
            incomplete = int(np.count_nonzero(some & ~is_seen))
        if group.sure is not None:
            is_unsure = rows.numbers[group.sure[0]] < group.sure[1]
            unsure += int(np.count_nonzero(is_seen & is_unsure))
            is_seen &= ~is_unsure
        seen[group.name] = is_seen, incomplete
        untimed[group.clock] = untimed.get(group.clock, False) | (is_seen & ~times.known)
        if (is_seen & times.known).any():
            starts.append(int(times.stamps_ns[is_seen & times.known].min()))
    made.notes.extend(
        f"{count} rows without a time were left out"
        for lost in untimed.values()
        if (count := int(np.count_nonzero(lost)))
    )
    doubts = dict.fromkeys(doubt for times in rows.times.values() for doubt in times.doubts)
    made.notes.extend(doubt for doubt in doubts if "time zone" in doubt)
    if (first_ns := min(starts)) < 0:
        made.notes.append(f"times begin at {first_ns / 1e9:.9g} s; they were moved to begin at 0")
    named = 0
    for group in plan.groups:
        try:
            count = _add(
                made, group, plan, rows, options, *seen[group.name], first_ns, rate_hz, encoding
            )
        except ValueError as error:
            raise LogError(f"{path}: {error}") from error
        named += count > 1
    if named and rows.note and not plan.is_stacked:
        made.notes.append(rows.note)
    made.notes.extend(doubt for doubt in doubts if "time zone" not in doubt)
    if unsure:
        least = min(group.sure[1] for group in plan.groups if group.sure)
        made.notes.append(f"{unsure} places with a likelihood below {least} were left out")
    return made


def _add(
    made: Made,
    group: Group,
    plan: ColumnPlan,
    rows: ColumnRows,
    options: ReadOptions,
    is_seen: NDArray[np.bool_],
    incomplete: int,
    first_ns: int,
    rate_hz: float | None,
    encoding: str,
) -> int:
    """Add the signals of one group, and return how many they are."""
    times = rows.times[group.clock]
    at = np.flatnonzero(is_seen & times.known)
    if plan.is_stacked:
        at = at[rows.runs[at] >= 0]
    arrivals = times.stamps_ns[at] - min(first_ns, 0)
    counts_frames = group.clock.counts_frames
    if counts_frames:
        arrivals, counts_frames = frame_stamps(arrivals / 1e9, rate_hz, options)
    if group.is_impacts:
        wrong = np.flatnonzero(np.diff(arrivals) <= 0)
        if len(wrong):
            last = int(wrong[0])
            raise ValueError(
                f"times of impacts do not increase: {arrivals[last] * 1e-9:.13g} s is followed by "
                f"{arrivals[last + 1] * 1e-9:.13g} s; give times since a start, not intervals"
            )
    values, unit = _values_of(group, plan, rows, at, made.notes), group.unit
    if group.is_track:
        values, unit = in_metres(values, unit, options)
    stamps = None if group.stamp is None else rows.times[group.stamp].stamps_ns[at]
    runs = rows.runs[at] if len(rows.runs) else rows.runs
    if plan.is_stacked:
        parts = _tracks_in(runs, rows.names, made.unused)
    elif group.is_impacts:
        parts = [("", slice(None))]
    else:
        parts = rows_of_runs(arrivals, runs, rows.names)
    lost = {UNREADABLE: int(np.count_nonzero(is_seen & ~times.known))}
    if rows.note and stamps is None and group.columns == _ONE_JOINT and len(parts) > 1:
        group, arrivals, values, more = _beside_each_other(
            group, parts, arrivals, values, made.notes
        )
        parts, lost = [("", slice(None))], added(lost, more)
    if len(parts) > 1 and isinstance(parts[0][1], slice):
        made.notes.append(
            f"{group.name}: its times begin again {len(parts) - 1} times: runs, or a clock that "
            "was set back; each is a signal by itself; see --topic"
        )
    for run, part in parts:
        name = run if plan.is_stacked and run else name_of_run(group.name, run)
        own = arrivals[part]
        if not group.is_impacts and (plan.remedy or not plan.is_stacked):
            check_one_thing(own, values[part], plan.remedy)
        if stamps is not None and len(own) > 1:
            keep, ordered, repairs, left_out = order_samples(stamps[part], own, (values[part],))
        else:
            keep, ordered, repairs, left_out = sorted_stamps(own, (values[part],))
        lacking = {INCOMPLETE: in_proportion(len(own), incomplete, len(arrivals))}
        signal = Signal(
            name,
            ordered,
            values[part][keep],
            group.columns,
            unit,
            counts_frames=counts_frames,
            drives=group.drives,
            left_out=added(added(left_out, lacking), lost),
        )
        made.signals.append(signal)
        kind = _type_of(group.columns, unit, group.note)
        made.channels.append(Channel(name, kind, encoding, own, drives=group.drives))
        made.notes.extend(f"{name}: {repair}" for repair in repairs)
    if incomplete:
        made.notes.append(
            f"{group.name}: {incomplete} samples without all coordinates were left out"
        )
    return len(parts)


_ONE_JOINT = ("joint1",)  # columns that do not say which joint they are of
_MAX_STACKED = 20_000_000  # values of joints that a table stacks


def _beside_each_other(
    group: Group,
    parts: Sequence[tuple[str, RowSet]],
    arrivals: NDArray[np.int64],
    values: NDArray[np.float64],
    notes: list[str],
) -> tuple[Group, NDArray[np.int64], NDArray[np.float64], dict[str, int]]:
    """Make one signal of joints that a table stacks: a column each, NaN where another is told.

    Returned with the samples that are left out, by reason.
    """
    orders = [sorted_stamps(arrivals[own], (values[own],)) for _, own in parts]
    stamps = np.unique(np.concatenate([one.stamps_ns for one in orders]))
    if len(stamps) * len(parts) > _MAX_STACKED:
        raise ValueError(
            f"{len(parts)} joints at {len(stamps)} times are too many; take a shorter part"
        )
    beside, lost = np.full((len(stamps), len(parts)), np.nan), dict[str, int]()
    for place, ((name, own), order) in enumerate(zip(parts, orders, strict=True)):
        beside[np.searchsorted(stamps, order.stamps_ns), place] = values[own][order.keep, 0]
        notes.extend(f"{group.name}, {name}: {repair}" for repair in order.notes)
        lost = added(lost, order.left_out)
    return replace(group, columns=tuple(name for name, _ in parts)), stamps, beside, lost


def _values_of(
    group: Group, plan: ColumnPlan, rows: ColumnRows, at: NDArray[np.intp], notes: list[str]
) -> NDArray[np.float64]:
    """Return the values of a group's rows `at`, in its unit, shape (T, C); 1 for impacts."""
    if group.is_impacts:
        return np.ones((len(at), 1))
    values = np.full((len(at), len(group.columns)), 0.0 if group.is_track else np.nan)
    for one in group.used:
        values[:, one.place] = (rows.numbers[one.column][at] - one.zero) * one.scale
    values[~np.isfinite(values)] = np.nan
    if group.name.endswith(POWER) and (off := int((values == 0).any(axis=1).sum())):
        names = short_list([plan.names[one] for one in {used.column: 0 for used in group.used}])
        notes.append(
            f"{group.name}: in {off} of {len(at)} rows {names} is off: what is commanded there "
            "counts for nothing, and the joint is loose"
        )
    return values


def _tracks_in(
    runs: NDArray[np.int64], names: Sequence[str], unused: dict[str, str]
) -> list[tuple[str, RowSet]]:
    """Return name and rows of each object, the longest ones where there are very many."""
    order = np.argsort(runs, kind="stable")
    found, starts, counts = np.unique(runs[order], return_index=True, return_counts=True)
    longest = np.sort(np.argsort(-counts, kind="stable")[:MAX_TRACKS])
    if (rest := len(found) - len(longest)) > 0:
        unused[f"{rest} more tracks"] = f"they are no longer than the {MAX_TRACKS} longest"
    for number in sorted(set(range(len(names))).difference(found.tolist()))[:MAX_TRACKS]:
        unused[names[number]] = "it is seen in no row"
    parts = np.split(order, starts[1:])
    return [(names[int(found[one])], parts[one]) for one in longest.tolist()]


def episode_of_rows(
    path: Path,
    what: str,
    plan: ColumnPlan,
    rows: ColumnRows,
    options: ReadOptions,
    *,
    rate_hz: float | None = None,
    unused: Mapping[str, str] | None = None,
    warnings: Sequence[str] = (),
    losses: Sequence[str] = (),
    unread: tuple[int, int] = (0, 1),
    encoding: str = "export",
) -> Episode:
    """Build the episode of a file's rows.

    `rate_hz` is the row rate that the file states, `unused` what else it holds, with the reason,
    `warnings` are of reading it, `losses` damage found in it, and `unread` the number of rows that
    could not be read, and of those that could.
    """
    made = signals_of(path, plan, rows, options, rate_hz, encoding)
    signals = [one for one in made.signals if len(one.stamps_ns)]
    if not signals:
        if sure := [group.sure[1] for group in plan.groups if group.sure]:
            why = f"nothing is seen with a likelihood of {min(sure)}"
            raise LogError(f"{path}: {why}", "label more frames, train and analyse again")
        named = ", ".join(group.name for group in plan.groups)
        raise LogError(f"{path}: no row has a time and a value of {named}", EXPORT_AGAIN)
    for at, one in enumerate(signals) if unread[0] else ():
        lost = {UNREADABLE: in_proportion(len(one.stamps_ns), *unread)}
        signals[at] = replace(one, left_out=added(one.left_out, lost))
    return export_episode(
        path,
        what,
        signals,
        channels=made.channels,
        unused={**plan.unused, **(unused or {}), **made.unused},
        warnings=[*warnings, *made.notes],
        losses=losses,
        encoding=encoding,
    )
