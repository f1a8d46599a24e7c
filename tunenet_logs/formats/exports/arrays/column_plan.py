"""Infer the meaning of named numeric columns before any of them is read."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from tunenet_logs.episode import UNSTATED
from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.arrays.said_columns import said_groups, said_index
from tunenet_logs.formats.exports.robots.joint_fields import (
    JointChoice,
    JointField,
    choose_fields,
    joint_fields,
)
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.column_names import meaning_of
from tunenet_logs.formats.tables.layout import (
    MAX_COLUMNS,
    TableLayout,
    clock_of,
    run_columns,
    table_layout_of,
)
from tunenet_logs.formats.tables.meaning import LENGTHS, TimeColumn, UnusedColumn, lowered, words_of
from tunenet_logs.formats.tables.times import Clock
from tunenet_logs.terminal import listed

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
