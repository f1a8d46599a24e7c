"""Make an episode of a file's columns, whatever the file: the one engine of all tables.

`episode_of_table` does all for named columns. A reader that has to know which columns to read
before it reads them asks `plan_columns` what each is, by its name or by `--columns`, fills
`ColumnRows` with those that are needed, and calls `episode_of_rows`. Layouts with fixed columns
make their `ColumnPlan` themselves.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from math import isclose
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tunenet_logs.episode import (
    COMMANDS,
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
from tunenet_logs.formats.columns.angles import (
    PERCENT,
    REMEDY,
    SHOWING,
    UNTOLD,
    AngleUnit,
    of_joint,
    told_by_values,
    unit_of,
)
from tunenet_logs.formats.columns.cells import (
    MAX_COLUMNS,
    MAX_NS,
    UNIT_ROWS,
    Clock,
    TextClock,
    number_of,
    unit_of_times,
)
from tunenet_logs.formats.columns.names import (
    ASKED_OF_NONE,
    IN_PIXELS,
    JOINT_UNITS,
    LENGTHS,
    CoordinateColumn,
    DateColumn,
    FrameColumn,
    ImpactColumn,
    ImpactNumberColumn,
    JointColumn,
    JointField,
    JointNameColumn,
    Meaning,
    Reading,
    RunColumn,
    SwitchColumn,
    TimeColumn,
    UnusedColumn,
    Words,
    by_name,
    choose_fields,
    contradiction_of,
    is_controllers,
    is_of_joints,
    joint_fields,
    lowered,
    meaning_of,
    places_of,
    reasons_of,
    runs_of,
    said_reading,
    short_list,
    spread_names,
    states_angle,
    with_counterparts,
    with_franka_times,
    without_joint_unit,
    words_of,
)
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.terminal import listed
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


# ---- A plan: which columns make up which signal.


class Used(NamedTuple):
    """One column: `place` of the signal, in its unit, is `scale` times what exceeds `zero`."""

    column: int
    place: int
    scale: float
    zero: float = 0.0  # in the column's own unit


def joints_name(robot: str, quantity: str, *, is_command: bool) -> str:
    """Name the signal of a robot's joints: "joints.position", "commands.position", "commands".

    Commands have this one home, whatever a file calls them; `quantity` is "" where it is unstated.
    """
    if is_command:
        robot = COMMANDS if robot == "joints" else f"{robot}.{COMMANDS}"
    return f"{robot}.{quantity}" if quantity else robot


def name_of_run(name: str, run: str) -> str:
    """Return the name of a run's signal; a joint signal's ends with its quantity."""
    if not run:
        return name
    is_joints = name.rpartition(".")[2] in JOINT_UNITS
    robot, _, quantity = name.rpartition(".") if is_joints else (name, "", "")
    return ".".join(filter(None, (robot, run, quantity)))


@dataclass(frozen=True)
class Group:
    """Columns that make up one signal."""

    name: str  # of the signal
    columns: tuple[str, ...]  # of the signal; an axis may have no column in the table
    unit: str  # of the signal: of a position as in `in_metres`
    used: tuple[Used, ...]  # the columns
    clock: Clock  # time of arrival, or of acquisition, of a row
    # time of acquisition, where the table states it beside that of arrival
    stamp: Clock | None = None
    is_track: bool = False  # whether it is a position, which a row holds whole or not at all
    is_impacts: bool = False  # whether its samples are impacts: the clock's times, with the value 1
    drives: bool = False  # whether it is a command; see `Signal.drives`
    # of the joints named by a number alone, by column
    numbers: Mapping[str, str] = field(default_factory=dict)
    note: str = ""  # for the user
    # the column that says how sure the place is, and the least that counts as seen
    sure: tuple[int, float] | None = None

    def seen(
        self, numbers: Mapping[int, NDArray[np.float64]], *, in_part: bool = False
    ) -> NDArray[np.bool_]:
        """Return which rows have a sample, by the numbers of columns: a place needs all axes."""
        finite = [np.isfinite(numbers[one.column]) for one in self.used]
        needs_all = self.is_track and not in_part
        return (np.logical_and if needs_all else np.logical_or).reduce(finite)


@dataclass(frozen=True)
class ColumnPlan:
    """What to read of a table, and what it means."""

    names: tuple[str, ...]  # of all columns, with their units
    groups: tuple[Group, ...]
    # columns that identify run and object of a row, with the kind of each
    runs: tuple[tuple[int, str], ...] = ()
    unused: Mapping[str, str] = field(default_factory=dict)  # why a column is not used, by its name
    # columns of joint names, by joint number
    labels: Mapping[str, int] = field(default_factory=dict)
    reading: Reading = by_name  # interpreter of the columns
    kind: str = ""  # of table, where the names tell: "robot's table",
    is_stacked: bool = False  # whether each object is a signal of its own name; see `ColumnRows`
    # names the object of a row by the cells of its `runs`, "" for none
    thing_of: Callable[[Sequence[str]], str] | None = None
    remedy: str = ""  # where several objects share a time and nothing tells them apart

    @property
    def clocks(self) -> tuple[Clock, ...]:
        """All clocks; those of acquisition last."""
        stamps = [group.stamp for group in self.groups if group.stamp is not None]
        return tuple(dict.fromkeys((*(group.clock for group in self.groups), *stamps)))

    @property
    def numbers(self) -> tuple[int, ...]:
        """Indices of the columns that hold values."""
        used = [one.column for group in self.groups for one in group.used]
        sure = [group.sure[0] for group in self.groups if group.sure]
        return tuple(dict.fromkeys((*used, *sure)))

    @property
    def switches(self) -> tuple[int, ...]:
        """Indices of the columns that are switches, true or false."""
        power = [group for group in self.groups if group.name.endswith(POWER)]
        return tuple(dict.fromkeys(one.column for group in power for one in group.used))

    @property
    def needed(self) -> tuple[int, ...]:
        """Sorted indices of the columns to read."""
        wanted = {at for clock in self.clocks for at in clock.indices}
        return tuple(sorted(wanted.union(self.numbers, (at for at, _ in self.runs))))

    def is_sampled(self, clock: Clock) -> bool:
        """Whether a clock's rows follow at a rate; impacts do not."""
        timed = [group for group in self.groups if clock in (group.clock, group.stamp)]
        return not all(group.is_impacts for group in timed)

    def named_by(self, row: Sequence[str]) -> ColumnPlan:
        """Rename numbered joints by the names that stand in a row."""
        groups: list[Group] = []
        for group in self.groups:
            names = {
                column: row[self.labels[number]].strip()
                for column, number in group.numbers.items()
                if number in self.labels
            }
            named = tuple(names.get(column) or column for column in group.columns)
            is_clear = len(set(named)) == len(named)
            groups.append(replace(group, columns=named) if is_clear else group)
        return replace(self, groups=tuple(groups))


ROWS = Clock("row", (), 0, counts_frames=True)  # where a row is a frame


def layout_of(
    names: Sequence[str], reading: Reading = by_name, *, counts_rows: bool = False
) -> ColumnPlan | None:
    """Say what columns are; None where no name is a time, and so they are no header.

    `counts_rows`: a row is a frame where no column is a time.
    """
    least = 2 if reading is by_name and not counts_rows else 1
    if not least <= len(names) <= MAX_COLUMNS:
        return None
    names = with_franka_times(names)
    columns = runs_of(names) if reading is by_name else [("", name) for name in names]
    plain = [name for _, name in columns]
    fields = joint_fields(names) if reading is by_name else ()
    fields = fields if is_controllers(names, fields) else ()
    taken = {at for one in fields for at in one.columns.values()}
    taken |= {at for at, name in enumerate(names) if fields and joint_fields([name])}
    meanings = {at: reading(at, name) for at, name in enumerate(plain)}
    meanings = with_counterparts(meanings, plain) if reading is by_name else meanings
    unused = {
        names[at]: meaning.reason
        for at, meaning in meanings.items()
        if isinstance(meaning, UnusedColumn) and at not in taken
    }
    groups: list[Group] = []
    clock: Clock | None = None
    for run in dict.fromkeys(sorted((run for run, _ in columns), key=bool)):
        part = {at: meanings[at] for at, (of, _) in enumerate(columns) if of == run}
        part = {at: meaning for at, meaning in part.items() if at not in taken}
        clocks = _clocks(plain, part)
        # The clock of the rows: the shortest name, arrival before header stamps; else frames.
        arrivals = [one for is_header, one in clocks if not is_header] or [one for _, one in clocks]
        frames = [at for at, one in part.items() if isinstance(one, FrameColumn)]
        if arrivals:
            clock = min(arrivals, key=lambda one: len(words_of(one.name, camel=True)))
        elif clock is None and frames:
            clock = Clock(plain[frames[0]], (frames[0],), 0, counts_frames=True)
        clock = clock or (ROWS if counts_rows else None)
        if clock is None:
            continue
        stamps = [one for is_header, one in clocks if is_header]
        arm = [] if run else _arms_of(fields, clock, unused)
        found = [
            *filter(None, map(partial(_power_of, part), arm)),
            *tracks_of(plain, part, clock, stamps, unused),
            *joints_of(plain, part, clock, stamps, unused),
            *(_impact_group(clock) for one in part.values() if isinstance(one, ImpactColumn)),
        ]
        if IN_PIXELS.intersection(names):
            found = [replace(one, unit=one.unit or "px") if one.is_track else one for one in found]
        power = {one.column for each in found if each.name.endswith(POWER) for one in each.used}
        unused |= {
            names[at]: one.reason
            for at, one in part.items()
            if isinstance(one, SwitchColumn) and at not in power
        }
        known = {one.name for one in arm}
        for one in (one for one in found if one.name in known):
            unused.update(
                {names[used.column]: f"other columns are {one.name}" for used in one.used}
            )
        found = [*arm, *(one for one in found if one.name not in known)]
        groups += [replace(one, name=name_of_run(one.name, run)) if run else one for one in found]
    if clock is None:
        return None
    if not groups and any(isinstance(one, ImpactNumberColumn) for one in meanings.values()):
        groups = [_impact_group(clock)]
    if not clock.counts_frames:
        frames = (names[at] for at, one in meanings.items() if isinstance(one, FrameColumn))
        unused.update(dict.fromkeys(frames, "there is a column of times"))
    texts = {one.number: at for at, one in meanings.items() if isinstance(one, JointNameColumn)}
    kind = "robot's table" if fields else ""
    return ColumnPlan(
        tuple(names), tuple(groups), run_columns(meanings), unused, texts, reading, kind
    )


def run_columns(meanings: Mapping[int, Meaning]) -> tuple[tuple[int, str], ...]:
    """Return the columns that identify run and object of a row, with the kind of each."""
    counts = [(at, one.kind) for at, one in meanings.items() if isinstance(one, RunColumn)]
    runs = [one for one in counts if one[1] == "run"]
    things = sorted((one for one in counts if one[1] != "run"), key=lambda one: one[1] == "object")
    return (*runs[:1], *things[:1])


# ---- Clocks of a header.


def _clocks(header: Sequence[str], meanings: Mapping[int, Meaning]) -> list[tuple[bool, Clock]]:
    """Return all clocks, and which are of acquisition; seconds and nanoseconds are one."""
    times = {at: meaning for at, meaning in meanings.items() if isinstance(meaning, TimeColumn)}
    rests = {
        plain_words(header[at])[:-1]: at
        for at, meaning in times.items()
        if meaning.part == "nanosec"
    }
    dates = [at for at, meaning in meanings.items() if isinstance(meaning, DateColumn)]
    pairs = {
        at: rest
        for at, meaning in times.items()
        if meaning.part == "sec" and (rest := rests.get(plain_words(header[at])[:-1])) is not None
    }
    clocks = [
        (times[at].is_header, Clock(header[at], (at, rest), 0, times[at].scope))
        for at, rest in pairs.items()
    ]
    for at, meaning in times.items():
        if at not in pairs and at not in pairs.values():
            has_date = bool(dates) and meaning.power is None and not meaning.is_header
            indices = (dates[0], at) if has_date else (at,)
            clock = Clock(header[at], indices, meaning.power, meaning.scope, has_date=has_date)
            clocks.append((meaning.is_header, clock))
    if dates and not times:
        clocks.append((False, Clock(header[dates[0]], (dates[0],), None)))
    clocks += [
        (False, Clock(header[at], (at,), meaning.power, counts_frames=meaning.counts_frames))
        for at, meaning in meanings.items()
        if isinstance(meaning, ImpactColumn)
    ]
    return clocks


def _impact_group(clock: Clock) -> Group:
    return Group("impacts", ("impact",), "1", (), clock, is_impacts=True)


def _stamp_for(name: str, stamps: Sequence[Clock]) -> Clock | None:
    """Return the stamp of the message that a column belongs to, by the longest common prefix."""
    words = plain_words(name)
    fitting = [clock for clock in stamps if words[: len(clock.scope)] == clock.scope]
    return max(fitting, key=lambda clock: len(clock.scope), default=None)


def plain_words(name: str) -> Words:
    """Split a name into lower-case words, not at capitals."""
    return lowered(words_of(name, camel=False))


# ---- Joints of a header: by their names, or the fields of a controller.


POWER = ".power"  # ends the name of what says when motors are on
_BARE = "it says not of what; name it x, y, z, height_m or JOINT_position"


def joints_of(
    header: Sequence[str],
    meanings: Mapping[int, Meaning],
    clock: Clock,
    stamps: Sequence[Clock],
    unused: dict[str, str],
) -> list[Group]:
    """Group joint columns by robot and quantity; all groups of one robot have the same joints."""
    values = {at: meaning for at, meaning in meanings.items() if isinstance(meaning, JointColumn)}
    states = [one for one in values.values() if not one.is_command]
    # A bare position is a servo's where a bare command stands beside it.
    has_bare = any(one.is_bare for one in states)
    is_servo = any(one.is_bare and one.is_command for one in values.values())
    is_servo = is_servo and any(one.is_bare and one.quantity == "position" for one in states)
    is_servo |= any(is_of_joints(one) for one in meanings.values())  # rows say of which joint
    if not is_servo and all(one.is_bare and one.quantity != "effort" for one in states):
        for at in [at for at, one in values.items() if one.is_bare]:
            unused[header[at]] = ASKED_OF_NONE if values.pop(at).is_command else _BARE
        has_bare = False
    known = {(one.group, one.label) for one in states}
    for at, one in list(values.items()):
        is_of_none = not one.quantity and (one.group, one.label) not in known
        is_vague = one.is_bare and not has_bare and len(known) > 1
        if one.is_command and (is_of_none or is_vague):
            unused[header[at]] = ASKED_OF_NONE
            del values[at]
    tables: dict[tuple[str, bool, str], dict[str, list[int]]] = {}
    for at, meaning in values.items():
        key = meaning.group, meaning.is_command, meaning.quantity
        tables.setdefault(key, {}).setdefault(meaning.label, []).append(at)
    for (_, is_command, quantity), labels in tables.items():
        for label in [label for label, found in labels.items() if len(found) > 1]:
            what = f"{'commanded ' if is_command else ''}{quantity}" if quantity else "command"
            why = f"several columns are the {what} of {label!r}"
            found = sorted(labels.pop(label), key=lambda at: -values[at].scale)
            sizes = {values[at].scale for at in found}
            stems = {without_joint_unit(header[at]) for at in found}
            if len(sizes) == len(found) and len(stems) == 1:  # one quantity, in several units
                labels[label] = found[:1]
                why = f"the same as {header[found.pop(0)]!r}"
            unused.update({header[at]: why for at in found})
    robots: dict[tuple[str, bool], dict[str, int]] = {}
    for (robot, is_command, _), labels in tables.items():
        rows = robots.setdefault((robot, is_command), {})
        for label in labels:
            rows.setdefault(label, len(rows))
    numbers = {one.label: one.number for one in values.values() if one.number}
    groups: list[Group] = []
    for (robot, is_command, quantity), labels in tables.items():
        if labels:
            rows = robots[robot, is_command]
            used = tuple(Used(at, rows[one], values[at].scale) for one, (at,) in labels.items())
            stamp = _stamp_for(header[used[0].column], stamps)
            name = joints_name(robot, quantity, is_command=is_command)
            unit = JOINT_UNITS.get(quantity, "1")
            group = Group(name, tuple(rows), unit, used, clock, stamp, numbers=numbers)
            groups.append(replace(group, drives=is_command))
    return groups + [one for one in map(partial(_power_of, meanings), groups) if one is not None]


def _power_of(meanings: Mapping[int, Meaning], commands: Group) -> Group | None:
    """Return when the motors of commanded positions were on, 1 or 0; None where nothing says so."""
    switches = {one.label: at for at, one in meanings.items() if isinstance(one, SwitchColumn)}
    # A controller's Motor 1 is its joint1.
    switches |= {re.sub(r".*?(\d+)$", r"joint\1", one): at for one, at in switches.items()}
    if not switches or not commands.name.endswith(f"{COMMANDS}.position"):
        return None
    places = {one: switches.get(one, switches.get("")) for one in commands.columns}
    found = {one: at for one, at in places.items() if at is not None}
    used = tuple(Used(at, place, 1.0) for place, at in enumerate(found.values()))
    name = f"{commands.name.removesuffix('.position')}{POWER}"
    made = replace(commands, name=name, columns=tuple(found), unit="1", used=used, note="")
    return made if used else None


def _arms_of(fields: Sequence[JointField], clock: Clock, unused: dict[str, str]) -> list[Group]:
    """Group the measured and commanded fields of a controller; say why others are not used."""
    chosen, others, names = choose_fields(fields)
    unused.update({one.title: why for one, why in others})
    groups: list[Group] = []
    for one in chosen:
        columns = sorted(one.columns.items())
        used = tuple(Used(at, row, one.scale) for row, (_, at) in enumerate(columns))
        labels = tuple(names[number] for number, _ in columns)
        name = joints_name(one.side or "joints", one.quantity, is_command=one.is_command)
        group = Group(name, labels, JOINT_UNITS.get(one.quantity, "1"), used, clock)
        groups.append(replace(group, note=one.title, drives=one.is_command))
    return groups


def _with_torques(path: Path, plan: ColumnPlan, options: ReadOptions) -> ColumnPlan:
    """Make torques of motors' currents with the user's constants [N·m/A], joint by joint.

    Currents of a controller without constants are not used, and say which option makes them useful.
    """
    constants, unused = options.torque_constants, dict(plan.unused)
    names = {group.name for group in plan.groups}
    has_joints = any(name.rpartition(".")[2] in JOINT_UNITS for name in names)
    if constants and has_joints and not any(name.endswith(".current") for name in names):
        there = listed([group.name for group in plan.groups])
        raise LogError(
            f"{path}: --torque-constants: there are no measured currents of joints (there are: "
            f"{there})",
            "leave it out, or name their columns: --columns current_1=...",
        )
    groups: list[Group] = []
    for group in plan.groups:
        robot, _, quantity = group.name.rpartition(".")
        count, title = len(group.used), group.note or group.name
        if quantity == "effort" and constants and f"{robot}.current" in names:
            unused[title] = "the currents with --torque-constants are used"
        elif quantity == "current" and constants:
            if len(constants) != count:
                raise LogError(
                    f"{path}: --torque-constants has {len(constants)} numbers for the {count} "
                    f"joints of {title}; give one for each joint"
                )
            used = tuple(
                one._replace(scale=one.scale * constant)
                for one, constant in zip(group.used, constants, strict=True)
            )
            name, unit = f"{robot}.effort", JOINT_UNITS["effort"]
            note = "currents times --torque-constants"
            groups.append(replace(group, name=name, unit=unit, used=used, note=note))
        elif quantity == "current" and plan.kind:
            shown = ",".join(f"K{number}" for number in range(1, min(count, 3) + 1))
            shown += f",...,K{count}" if count > 3 else ""
            unused[title] = (
                "currents [A] are no torques; say each joint's torque for each A with "
                f"--torque-constants {shown}"
            )
        else:
            groups.append(replace(group, note="") if plan.kind and not group.is_track else group)
    return replace(plan, groups=tuple(groups), unused=unused)


# ---- Units of joint angles, and quantities of commands, that names do not state.


def with_angles(
    path: Path, plan: ColumnPlan, numbers: Mapping[int, NDArray[np.float64]], options: ReadOptions
) -> tuple[ColumnPlan, list[str]]:
    """Apply the unit of angles that the user names or the values show to a plan's joints.

    Commands that do not say their quantity are of positions where they follow these. Returns the
    plan, and notes for the user; LogError where a name and the user state two units.
    """
    said = unit_of(options.angle_unit) if options.angle_unit else None
    plan = replace(plan, groups=tuple(_with_quantity(one, plan, numbers) for one in plan.groups))
    notes: list[str] = []
    units: dict[str, AngleUnit | None] = {}  # by robot
    for group in plan.groups:
        if _quantity_of(group) == "position" and not group.drives and group.unit != PERCENT:
            robot = group.name.rpartition(".")[0]
            units[robot] = said or _shown(group, plan, numbers)
            unit = units[robot]
            if said is None and unit is UNTOLD:
                notes.append(f"{group.name}: its unit is not rad, and nothing tells it: {REMEDY}")
            elif said is None and unit is not None and unit.words != "rad":
                why = f"its values are an encoder's in {unit.words}: read as such"
                notes.append(f"{group.name}: {why}; if they are not, {REMEDY}")
    found: list[Group] = []
    unused = dict(plan.unused)
    for group in plan.groups:
        # Commands of another name, such as LeRobot's, are those of the one robot.
        unit = units.get(_robot_of(group), next(iter(units.values())) if len(units) == 1 else said)
        is_angle = _quantity_of(group) in ("position", "velocity") and group.unit != PERCENT
        if unit is None or not is_angle:
            found.append(group)
            continue
        stated = [one for one in group.used if states_angle(plan.names[one.column])]
        if stated and said is not None:
            name = plan.names[stated[0].column][:60]
            raise LogError(
                f"{path}: column {name!r} states its unit, and --angle-unit says "
                f"{options.angle_unit}; leave it out"
            )
        if stated:
            found.append(group)
        elif _quantity_of(group) == "position":
            own = {one: of_joint(unit, group.columns[one.place]) for one in group.used}
            used = tuple(one._replace(scale=own[one].scale, zero=own[one].zero) for one in own)
            found.append(replace(group, used=used, unit=unit.unit))
        elif unit.speed_scale is None:
            unused[group.name] = f"speeds beside positions in {unit.words}: their unit is not told"
        else:
            used = tuple(one._replace(scale=unit.speed_scale) for one in group.used)
            found.append(replace(group, used=used))
    return replace(plan, groups=tuple(found), unused=unused), notes


def _quantity_of(group: Group) -> str:
    """Return which quantity of joints a group is; "" if it is none."""
    last = group.name.rpartition(".")[2]
    return last if last in JOINT_UNITS and not group.is_track else ""


def _robot_of(group: Group) -> str:
    """Return the name of the states that a group of joints belongs to."""
    robot = group.name.rpartition(".")[0]
    return (robot.removesuffix(COMMANDS).rstrip(".") or "joints") if group.drives else robot


def _shown(
    group: Group, plan: ColumnPlan, numbers: Mapping[int, NDArray[np.float64]]
) -> AngleUnit | None:
    """Return the unit that the values of positions show, where no name states one."""
    own = [plan.names[one.column] for one in group.used]
    if any(map(states_angle, own)):
        return None
    columns = [numbers[one.column][:SHOWING] for one in group.used]
    every = np.concatenate(columns)
    every = every[np.isfinite(every)]
    if len(every) and np.abs(every).max() > 100 and np.all(every == np.round(every)):
        # Of Feetech's and Dynamixel's registers; those of 10 bits are of other turns.
        is_register = all("present" in name.lower() for name in own) and every.min() >= 0
        return unit_of("ticks") if is_register and 1023 < every.max() < 4096 else UNTOLD
    names = [group.columns[one.place] for one in group.used]
    unit = told_by_values(names, columns)
    is_lerobots = all(name.startswith("observation.") or name.endswith(".pos") for name in own)
    if unit is not None and unit.unit == PERCENT and not is_lerobots:
        return UNTOLD  # of several encoders, as the lattices are; nobody else writes per cent
    return unit


def _with_quantity(
    group: Group, plan: ColumnPlan, numbers: Mapping[int, NDArray[np.float64]]
) -> Group:
    """Return commands that say no quantity as those of positions where these follow them.

    Where they do not, as the raw actions of a policy, only the user knows what they are.
    """
    if not group.drives or group.unit != "1" or group.name.endswith(POWER):
        return group
    robot = _robot_of(replace(group, name=f"{group.name}.position"))
    states = [one for one in plan.groups if _quantity_of(one) == "position" and not one.drives]
    states = [one for one in states if one.name == f"{robot}.position"] or states
    places = states[0] if len(states) == 1 else None
    if places is None:
        return group
    own = {places.columns[one.place]: numbers[one.column] for one in places.used}
    pairs = [
        (numbers[one.column], own[group.columns[one.place]])
        for one in group.used
        if group.columns[one.place] in own
    ]
    name = f"{group.name}.position"
    is_taken = any(one.name == name for one in plan.groups)
    if len(pairs) < len(group.used) or is_taken or not follow(pairs):
        return replace(group, unit=UNSTATED)
    return replace(group, name=name, unit=places.unit)


def follow(pairs: Iterable[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> bool:
    """Return whether measured positions follow commands, pairs of (T,) each: in the same unit.

    Of what every moving joint does its command explains half of the variance, as it is.
    """
    moving = 0
    for commands, places in pairs:
        known = np.isfinite(commands) & np.isfinite(places)
        if not known.any():
            return False
        spread = float(np.std(places[known]))
        if spread > 0:
            moving += 1
            off = commands[known] - places[known]
            if np.sqrt(np.mean(off**2)) > 0.7 * spread:
                return False
    return moving > 0


# ---- Tracks of a header: coordinates, by moving object.

# Why a coordinate is not used where there is one of a better name.
_INSTEAD = ("there is a column z", "there is a column of heights", "there is a column of positions")


def tracks_of(
    header: Sequence[str],
    meanings: Mapping[int, Meaning],
    clock: Clock,
    stamps: Sequence[Clock],
    unused: dict[str, str],
) -> list[Group]:
    """Group coordinate columns by moving object; see `joints_of`."""
    things: dict[str, dict[int, CoordinateColumn]] = {}
    # Interpret pairs (u, v) as image coordinates x and y; u alone is a control input.
    names = {plain_words(header[at]): at for at in meanings}
    found = dict(meanings)
    for words, at in names.items():
        partner = names.get((*words[:-1], "v")) if words[-1:] == ("u",) else None
        if partner is not None and all(
            isinstance(meanings[one], UnusedColumn) for one in (at, partner)
        ):
            thing = "_".join(words[:-1]) or "track"
            found[at] = CoordinateColumn(thing, 0, 1.0, "px")
            found[partner] = CoordinateColumn(thing, 1, 1.0, "px")
    for at, meaning in found.items():
        if isinstance(meaning, CoordinateColumn):
            unused.pop(header[at], None)
            things.setdefault(meaning.thing, {})[at] = meaning
    groups: list[Group] = []
    for thing, places in things.items():
        has_one_axis = len({one.axis for one in places.values()}) < 2
        if has_one_axis and all(one.is_doubtful for one in places.values()):
            why = f"it is the one column of {thing!r}; name it {thing}_x"
            unused.update(dict.fromkeys((header[at] for at in places), why))
            continue
        has_lengths = any(one.unit != "px" for one in places.values())
        in_pixels = {at for at, one in places.items() if has_lengths and one.unit == "px"}
        why = "there are columns in a unit of length"
        unused.update(dict.fromkeys((header[at] for at in in_pixels), why))
        chosen = _best(header, {a: b for a, b in places.items() if a not in in_pixels}, unused)
        if len({one.axis for one in chosen.values()}) < len(chosen):
            why = f"several columns are a coordinate of {thing!r}"
            unused.update(dict.fromkeys((header[at] for at in chosen), why))
            continue
        sizes = {one.scale for one in chosen.values() if one.unit == "m"}
        # A column without a unit beside others with one is in theirs.
        unit = "m" if sizes else next(iter(chosen.values())).unit
        default = next(iter(sizes)) if len(sizes) == 1 else 1.0
        used = tuple(
            Used(at, one.axis, one.scale if one.unit else default) for at, one in chosen.items()
        )
        stamp = _stamp_for(header[next(iter(chosen))], stamps)
        is_line = any(one.rank > 1 for one in chosen.values())  # a motion sensor's one coordinate
        note = "a distance along one line, up or down" if is_line else ""
        xyz = ("x", "y", "z")
        groups.append(Group(thing, xyz, unit, used, clock, stamp, is_track=True, note=note))
    return groups


def _best(
    header: Sequence[str], places: Mapping[int, CoordinateColumn], unused: dict[str, str]
) -> dict[int, CoordinateColumn]:
    """Return the columns of the best kind of name for each axis."""
    axes: dict[int, dict[int, CoordinateColumn]] = {}
    has_axes = {0, 1}.issubset(one.axis for one in places.values())
    for at, one in places.items():
        if has_axes and one.rank == 3:  # a bare distance is then that from the start, and no z
            unused[header[at]] = "there are columns x and y"
        else:
            axes.setdefault(one.axis, {})[at] = one
    chosen: dict[int, CoordinateColumn] = {}
    for found in axes.values():
        best = min(one.rank for one in found.values())
        chosen |= {at: one for at, one in found.items() if one.rank == best}
        unused.update({header[at]: _INSTEAD[best] for at, one in found.items() if one.rank > best})
    return chosen


# ---- Plan which columns of a file to read: the user's, else by their names.


def plan_columns(
    path: Path,
    names: Sequence[str],
    options: ReadOptions,
    meant: Sequence[str] | None = None,
    left_out: Mapping[str, str] | None = None,
    rate_hz: float | None = None,
) -> ColumnPlan:
    """Plan which columns to read of a file that may count its rows as frames.

    `meant` are the names to interpret, where these differ from `names`; `left_out` is what else the
    file holds, with the reason, for the refusal; `rate_hz` its row rate.
    """
    if len(names) > MAX_COLUMNS:
        raise LogError(
            f"{path}: has {len(names)} columns, over the limit of {MAX_COLUMNS}; leave out those "
            "that are not needed"
        )
    try:
        plan = layout_of(meant or names, said_by(options, names), counts_rows=True)
    except ValueError as error:
        raise LogError(f"{path}: {error}") from error
    plan = plan or ColumnPlan(tuple(names), ())
    own = dict(zip(meant or names, names, strict=True))
    unused = _ranges({own.get(name, name): why for name, why in plan.unused.items()})
    groups = plan.groups
    if not (options.fps or rate_hz):  # a joint's rows are no frames of a film
        untimed = [one for one in groups if one.clock is ROWS and not one.is_track]
        why = "nothing says when; say --columns t=NAME or --fps RATE"
        unused.update({one.name: why for one in untimed})
        groups = tuple(one for one in groups if one not in untimed)
    plan = replace(plan, names=tuple(names), groups=groups, unused=unused)
    if not groups:
        reasons = reasons_of({**(left_out or {}), **unused})
        why = reasons or f"columns: {listed([name[:40] for name in names])}"
        what = f"no column that has a time is a place or a joint's ({why})"
        raise LogError(f"{path}: {what}; name them: --columns t=NAME,z=NAME")
    return fitted(path, plan, options)


def said_by(options: ReadOptions, names: Sequence[str]) -> Reading:
    """Return the interpreter of columns by the user's names, if any; ValueError if one is none."""
    if not options.columns:
        return by_name
    if why := contradiction_of(options.columns):
        raise ValueError(why)
    places, missing = places_of(options.columns, names)
    if missing:
        raise ValueError(
            f"has no column {missing[0][:60]!r}; its columns are {short_list(names) or 'none'}; "
            "name one of them"
        )
    return said_reading(places)


def fitted(path: Path, plan: ColumnPlan, options: ReadOptions) -> ColumnPlan:
    """Apply the user's torque constants and unit of length to a plan; LogError if they do not fit.

    A unit that the table states is not overruled.
    """
    for group in plan.groups if options.length_unit else ():
        for column in group.used if group.unit == "m" else ():
            if options.length_m is None or not isclose(column.scale, options.length_m):
                named = next(name for name, size in LENGTHS.items() if size == column.scale)
                raise LogError(
                    f"{path}: column {plan.names[column.column][:60]!r} is in {named}, and "
                    f"--length-unit says {options.length_unit}; leave it out"
                )
    return _with_torques(path, plan, options)


def _ranges(reasons: Mapping[str, str]) -> dict[str, str]:
    """Join columns that differ in their number alone: "a[0] to a[5]"."""
    alike: dict[tuple[str, str], list[str]] = {}
    for name, why in reasons.items():
        alike.setdefault((re.sub(r"(?<!\d)\d++(?=\W*$)", "#", name), why), []).append(name)
    return {
        found[0] if len(found) == 1 else f"{found[0]} to {found[-1]}": why
        for (_, why), found in alike.items()
    }


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


# ---- Named arrays as a table.

MAX_ARRAY_BYTES = 128 * 1024**2  # of all arrays of a file
MAX_ROWS = 2_000_000  # of a file: an hour at 500 Hz
MAX_PLACES = 500_000  # of a track: 8 minutes at 1 kHz; tuning takes over 512 bytes for each
MAX_WIDTH = 200  # columns of one array
# Names of a scalar that is the rate of rows [Hz], or the time from row to row [s].
_RATES = frozenset(("fps", "fs", "hz", "rate", "sampling_rate", "sample_rate", "frame_rate"))
_PERIODS = frozenset(("dt", "ts", "timestep", "time_step", "sample_time", "period"))
# Words behind a name that only say that there are many values.
_LISTS = frozenset(("list", "arr", "array", "data", "vec", "hist", "history", "log", "values"))
# What a list of the joints of the other arrays is called.
_NAMED = {(what, "names") for what in ("joint", "dof", "motor", "servo", "actuator")}
Arrays = Mapping[str, NDArray[Any]]  # arrays by their names
_NAME_THEM = "save a table of time and x, y, z, or say which is which with --columns t=..,z=.."


@dataclass(frozen=True, eq=False)
class Table:
    """What a file holds, as named columns."""

    what: str  # kind of file, in words
    # numbers, texts or dates (datetime64), by name; of two dimensions with a row (or column) a
    # time. Those as long as the times are used
    columns: Arrays
    # what else the file holds, with the reason
    unused: Mapping[str, str] = field(default_factory=dict)
    rate_hz: float | None = None  # row rate stated by the file; None where it is unstated
    name: str = ""  # of the table, where there are several
    names: Mapping[str, str] = field(default_factory=dict)  # of columns, by the file's full ones
    loss: str = ""  # what was damaged; "" where nothing was


def episode_of_table(path: Path, table: Table, options: ReadOptions) -> Episode:
    """Build an episode of a file's named columns."""
    plain: dict[str, NDArray[Any]] = {}
    for name, array in table.columns.items():
        fields = array.dtype.names or ()  # of a structured array, each of which is a column
        several = len(table.columns) > 1
        plain |= {f"{name}.{one}" if several else one: array[one] for one in fields}
        plain |= {} if fields else {name: array}
    left_out = dict(table.unused)
    count = _length(plain, options)
    named, joints = _joint_names(plain)
    plain.pop(named, None)
    names: list[str] = []
    meant: list[str] = []
    columns: list[NDArray[Any]] = []
    for name, array in plain.items():
        rows = _rows(array, count)
        if isinstance(rows, str):
            if array.size > 1 or name not in (*_RATES, *_PERIODS):
                left_out[name] = rows
            continue
        if rows.ndim == 2:
            names += spread_names(name, rows.shape[1])[0]
            of_joints = [f"{joint} {_bare(name)}" for joint in joints]
            if len(joints) == rows.shape[1] and all(map(_is_joint, of_joints)):
                meant += of_joints
            else:
                meant += spread_names(_bare(name), rows.shape[1])[1]
            columns.extend(rows.T)
        else:
            names.append(name)
            meant.append(_bare(name))
            columns.append(rows)
    if not columns:
        reasons = reasons_of(left_out)
        raise LogError(
            f"{path}: holds no array of numbers that is a place over time ({reasons})", _NAME_THEM
        )
    rate = table.rate_hz or _rate(plain)
    plan = plan_columns(path, names, options, meant, left_out, rate)
    if not options.columns:
        first = zip(*(_texts(column[:UNIT_ROWS]) for column in columns), strict=True)
        plan = told_apart(plan, list(first))
    return episode_of_columns(
        path,
        table.what,
        plan,
        {at: columns[at] for at in plan.needed},
        options,
        rate_hz=rate,
        unused=left_out,
        losses=[table.loss] if table.loss else [],
    )


def episode_of_columns(
    path: Path,
    what: str,
    plan: ColumnPlan,
    columns: Mapping[int, NDArray[Any]],
    options: ReadOptions,
    **more: Any,
) -> Episode:
    """Build an episode of the columns that a plan needs; `more` as in `episode_of_rows`."""
    count = max(map(len, columns.values()), default=0)
    check_rows(path, count, plan)
    try:
        times = {clock: column_times(clock, columns, count, plan) for clock in plan.clocks}
    except ValueError as error:
        raise LogError(f"{path}: {error}") from error
    runs = RunNames([kind for _, kind in plan.runs])
    told = zip(*(_texts(columns[at]) for at, _ in plan.runs), strict=True)
    numbers = np.array([runs.number(texts) for texts in told], np.int64)
    values = {at: floats(columns[at]) for at in plan.numbers}
    rate_hz = options.fps or more.get("rate_hz")
    if any(group.clock is ROWS for group in plan.groups) and not rate_hz:
        counted = "nothing says when; rows were counted as frames (--fps, or --columns t=NAME)"
        more["warnings"] = [*more.get("warnings", ()), counted]
    rows = ColumnRows(values, times, numbers, runs.names, runs.note)
    return episode_of_rows(path, what, plan, rows, options, **more)


def check_rows(path: Path, count: int, plan: ColumnPlan) -> None:
    """Refuse a file of too many rows with a LogError."""
    width = sum(len(group.columns) for group in plan.groups)
    rows = MAX_PLACES if any(group.is_track for group in plan.groups) else MAX_ROWS
    most = min(rows, 16_000_000 // max(width, 1))  # values of all signals
    if count > most:
        raise LogError(f"{path}: has over {most} rows, the limit; split it")


def column_times(
    clock: Clock, columns: Mapping[int, NDArray[Any]], count: int, plan: ColumnPlan
) -> Times:
    """Convert a clock's columns to stamps, exact as the numbers; ValueError without a unit."""
    own = [columns[at] for at in clock.indices]
    if not own:
        return Times(np.arange(count) * 10**9, np.ones(count, np.bool_))
    is_sampled = plan.is_sampled(clock)
    if clock.has_date and own[1].dtype.kind in "iufbM":
        own = own[1:]
    if len(own) == 2 and not clock.has_date and all(one.dtype.kind in "iufb" for one in own):
        seconds, rest = (
            _numeric_times(one, power, clock) for one, power in zip(own, (0, -9), strict=True)
        )
        return Times(seconds.stamps_ns + rest.stamps_ns, seconds.known & rest.known)
    if len(own) == 1 and own[0].dtype.kind in "iufbM":
        power = 0 if clock.counts_frames else clock.power
        return _numeric_times(own[0], power, clock, is_sampled)
    texts = list(zip(*map(_texts, own), strict=True))
    reader = TextClock(clock, texts[:UNIT_ROWS], is_sampled)
    stamps, known = np.zeros(count, np.int64), np.zeros(count, np.bool_)
    for row, cells in enumerate(texts):
        with suppress(ValueError):
            stamps[row], known[row] = reader.read(cells), True
    return Times(stamps, known, reader.doubts)


def _numeric_times(
    values: NDArray[Any], power: int | None, clock: Clock, is_sampled: bool = True
) -> Times:
    if values.dtype.kind == "M":
        known = ~np.isnat(values)
        known &= np.abs(values.astype("M8[s]").astype(np.int64)) < MAX_NS // 10**9
        return Times(np.where(known, values.astype("M8[ns]").astype(np.int64), 0), known)
    first = values[:UNIT_ROWS].tolist()
    unit_ns, doubt = unit_of_times(clock.name, first, power, is_sampled=is_sampled)
    doubts = [doubt] if doubt else []
    if values.dtype.kind in "iub":
        fits = np.abs(values.astype(np.float64)) * unit_ns < MAX_NS
        return Times(np.where(fits, values, 0).astype(np.int64) * unit_ns, fits, doubts)
    with np.errstate(over="ignore", invalid="ignore"):
        nanoseconds = np.round(values.astype(np.float64) * unit_ns)
        fits = np.abs(nanoseconds) < MAX_NS  # NaN does not
    return Times(np.where(fits, nanoseconds, 0).astype(np.int64), fits, doubts)


def floats(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return a column as floats, NaN where it is no number, shape (T,)."""
    if values.dtype.kind in "iufb":
        return values.astype(np.float64)
    return np.fromiter(map(number_of, values.tolist()), np.float64, len(values))


def _texts(values: NDArray[Any]) -> list[str]:
    """Return a column as it would stand in a table of text."""
    if values.dtype.kind == "M":
        return np.datetime_as_string(values).tolist()
    found: list[str] = []
    for one in values.tolist():
        if isinstance(one, bytes):
            found.append(one.decode("utf-8", "replace").strip())
        else:
            is_whole = isinstance(one, float) and one.is_integer()
            found.append("" if one is None else str(int(one) if is_whole else one).strip())
    return found


def _bare(name: str) -> str:
    """Strip a name of its plural or container suffix: `t_list`, `zs`."""
    words = name.split("_")
    if len(words) > 1 and words[-1].lower() in _LISTS:
        name = "_".join(words[:-1])
    return name[0] if name in ("ts", "xs", "ys", "zs") else name


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
        if length >= 3
        and arrays[name].size == length
        and isinstance(meaning_of(_bare(name)), TimeColumn)
    ]
    if times:
        return lengths[min(times, key=lambda name: len(words_of(name, camel=True)))]
    common = Counter(length for length in lengths.values() if length >= 3)
    return max(common, key=lambda length: (common[length], length), default=0)


def _rows(array: NDArray[Any], count: int) -> NDArray[Any] | str:
    """Return an array with one row per time, shape (T,) or (T, K), or why it has none."""
    if array.dtype.kind not in "biufMUS":
        return "it holds no numbers"
    if array.size == 1 and count != 1:
        return "one number, no column"
    if array.size == count:
        return array.reshape(count)
    if array.ndim == 2 and count in array.shape:
        rows = array if array.shape[0] == count else array.T
        if rows.shape[1] > MAX_WIDTH:
            return f"its {rows.shape[1]} columns are more than an arm or a ball has"
        return rows
    shape = " x ".join(map(str, array.shape))
    return f"its shape {shape} has not the {count} rows that there are times"


def _joint_names(arrays: Arrays) -> tuple[str, Sequence[str]]:
    """Return which array names the joints, and their names; "" and none where none does."""
    for name, array in arrays.items():
        if (
            array.dtype.kind == "U"
            and 1 < array.size <= MAX_WIDTH
            and plain_words(name)[-2:] in _NAMED
        ):
            joints = [str(one) for one in array.ravel().tolist()]
            if len(set(joints)) == len(joints) and all(map(str.strip, joints)):
                return name, joints
    return "", ()


def _is_joint(name: str) -> bool:
    return isinstance(meaning_of(name), JointColumn)


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
    """Return the columns of an unnamed array by their numbers from 1."""
    shape = " x ".join(map(str, array.shape)) or "one number"
    if array.ndim == 1 and array.size:
        array = array.reshape(-1, 1)
    if array.ndim != 2 or not array.size or array.dtype.kind not in "biuf":
        raise LogError(f"{path}: is an array ({shape}) that is no table of numbers", _NAME_THEM)
    if array.shape[0] < array.shape[1]:
        array = array.T
    if array.shape[1] > MAX_WIDTH:
        raise LogError(
            f"{path}: is an array ({shape}), which is more than an arm or a ball has", _NAME_THEM
        )
    if not options.columns:
        raise LogError(
            f"{path}: is an array ({shape}) whose columns have no names; say which is which by "
            "number from 1: --columns t=1,z=2"
        )
    return {str(at + 1): np.ascontiguousarray(column) for at, column in enumerate(array.T)}
