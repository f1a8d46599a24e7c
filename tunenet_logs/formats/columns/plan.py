"""Plan which columns of a file make up which signal: by their names, or as a user says.

`plan_columns` does all; layouts with fixed columns make their `ColumnPlan` themselves.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import isclose
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import (
    COMMANDS,
    UNSTATED,
)
from tunenet_logs.errors import LogError
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
    Clock,
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
    places_of,
    reasons_of,
    runs_of,
    said_reading,
    short_list,
    states_angle,
    with_counterparts,
    with_franka_times,
    without_joint_unit,
    words_of,
)
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.terminal import listed

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
