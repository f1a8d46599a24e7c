"""Resolve the columns that a user names with `--columns`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from tunenet_logs.episode import UNSTATED
from tunenet_logs.errors import LogError
from tunenet_logs.formats.exports.robots.joint_fields import joint_fields
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.tables.column_names import meaning_of
from tunenet_logs.formats.tables.meaning import LENGTHS, CoordinateColumn, lowered, words_of
from tunenet_logs.terminal import listed

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
        units = [_length(meant[said[axis]]) for axis in axes]
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
            groups.append(_joints(path, quantity, unit, numbers, said, meant, options))
    return groups


def _joints(
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


def _length(name: str) -> tuple[str, float]:
    """Return the length unit in a coordinate's name, and the scale to it."""
    meaning = meaning_of(name)
    if isinstance(meaning, CoordinateColumn):
        return meaning.unit or UNSTATED, meaning.scale
    words = lowered(words_of(name, camel=False))
    if len(words) > 1 and words[-1] in LENGTHS:
        return "m", LENGTHS[words[-1]]
    is_pixels = len(words) > 1 and words[-1] in ("px", "pixel", "pixels")
    return ("px" if is_pixels else UNSTATED), 1.0
