"""Group the joint quantities of a table into signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from tunenet_logs.formats.tables.group import Group, Used, plain_words, stamp_for
from tunenet_logs.formats.tables.meaning import JointColumn, Meaning
from tunenet_logs.formats.tables.times import Clock

# Units of the signals of joints.
_UNITS = {"position": "rad", "velocity": "rad/s", "effort": "N·m", "current": "A"}


def joints_of(
    header: Sequence[str],
    meanings: Mapping[int, Meaning],
    clock: Clock,
    stamps: Sequence[Clock],
    unused: dict[str, str],
) -> list[Group]:
    """Group joint columns by robot and quantity; all groups of one robot have the same joints.

    Args:
        header: the names of all columns.
        meanings: of columns, by index.
        clock: of the rows.
        stamps: of messages.
        unused: reasons by name; to be added to.
    """
    values = {at: meaning for at, meaning in meanings.items() if isinstance(meaning, JointColumn)}
    if all(one.is_bare and one.quantity != "effort" for one in values.values()):
        for at in values:
            unused[header[at]] = "it says not of what; name it x, y, z, height_m or JOINT_position"
        return []
    tables = _tables(header, values, unused)
    robots: dict[str, dict[str, int]] = {}
    for (robot, _), labels in tables.items():
        rows = robots.setdefault(robot, {})
        for label in labels:
            rows.setdefault(label, len(rows))
    groups: list[Group] = []
    for (robot, quantity), labels in tables.items():
        if not labels:
            continue
        rows = robots[robot]
        used = tuple(Used(at, rows[label], values[at].scale) for label, at in labels.items())
        numbers = {one.label: one.number for one in values.values() if one.number}
        stamp = stamp_for(plain_words(header[used[0].index]), stamps)
        name, unit = f"{robot}.{quantity}", _UNITS[quantity]
        groups.append(Group(name, tuple(rows), unit, used, False, clock, stamp, numbers))
    return groups


def _tables(
    header: Sequence[str], values: Mapping[int, JointColumn], unused: dict[str, str]
) -> dict[tuple[str, str], dict[str, int]]:
    """Return the column of each joint, by robot and quantity, without ambiguous ones."""
    tables: dict[tuple[str, str], dict[str, list[int]]] = {}
    for at, meaning in values.items():
        found = tables.setdefault((meaning.group, meaning.quantity), {})
        found.setdefault(meaning.label, []).append(at)
    for (_, quantity), labels in tables.items():
        for label in [label for label, found in labels.items() if len(found) > 1]:
            for at in labels.pop(label):
                unused[header[at]] = f"several columns are the {quantity} of {label!r}"
    return {key: {one: at for one, (at,) in labels.items()} for key, labels in tables.items()}


def with_torques(groups: Sequence[Group], constants: Sequence[float]) -> list[Group]:
    """Convert motor currents to torques where none are measured.

    Args:
        groups: of a table.
        constants: N·m for each A, joint by joint; none leaves currents as they are.

    Raises:
        ValueError: there are fewer or more constants than joints with currents.
    """
    found: list[Group] = []
    measured = {group.name for group in groups}
    for group in groups:
        name = f"{group.name.removesuffix('.current')}.effort"
        if constants and group.name.endswith(".current") and name not in measured:
            if len(constants) != len(group.used):
                raise ValueError(
                    f"has currents of {len(group.used)} joints, and --torque-constants gives "
                    f"{len(constants)}; give one for each joint"
                )
            scaled = tuple(
                replace(used, scale=used.scale * constant)
                for used, constant in zip(group.used, constants, strict=True)
            )
            note = "currents times --torque-constants"
            group = replace(group, name=name, unit=_UNITS["effort"], used=scaled, note=note)  # noqa: PLW2901
        found.append(group)
    return found
