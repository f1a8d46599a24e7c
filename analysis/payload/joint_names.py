"""Which columns of a log are an arm's joints: by name, or by how the names end."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from tunenet_logs.errors import NotFoundError
from tunenet_logs.wording import listed, short_name

_NOT_OF_THE_ARM = re.compile(r"finger|gripper|knuckle|thumb|wheel", re.I)


def match_joints(joints: Sequence[str], columns: Sequence[str]) -> tuple[int, ...]:
    """The place of each joint's column.

    Drivers give a joint several names: `j2s7s300_joint_3`, `left_joint_3`, `joint3`. So names are
    compared whole first, then by their ending, then by the number that they end in.

    Args:
        joints: the arm's, base to tool.
        columns: of a signal; more than the arm's, and in any order.

    Returns:
        A place in `columns` for each joint.

    Raises:
        NotFoundError: a joint has no column, or several; the message lists what is there.
    """
    for rule in (_whole, _ending, _joint_number, _number):
        found = [_places(rule(joint), columns) for joint in joints]
        if all(len(places) == 1 for places in found):
            chosen = tuple(places[0] for places in found)
            if len(set(chosen)) == len(chosen):
                return chosen
        if twice := [at for at, places in enumerate(found) if len(places) > 1]:
            names = " and ".join(short_name(columns[place]) for place in found[twice[0]][:2])
            raise NotFoundError(
                f"joint {joints[twice[0]]} could be {names}: name an arm whose joints are called "
                "as one of them (--urdf FILE --tool-link LINK)"
            )
    missing = [name for name in joints if not _places(_joint_number(name), columns)]
    there = listed(map(short_name, columns))
    raise NotFoundError(
        f"no joint of the log is {', '.join(missing or joints)} (there: {there}): record all "
        "joints of the arm, or name the arm with --urdf FILE --tool-link LINK"
    )


def _places(is_it: Callable[[str], bool], columns: Sequence[str]) -> list[int]:
    return [place for place, name in enumerate(columns) if is_it(name)]


def _whole(joint: str) -> Callable[[str], bool]:
    return lambda name: name == joint


def _ending(joint: str) -> Callable[[str], bool]:
    """One name is the other's ending, after a separator: `left/joint_3`, `joint_3`."""

    def is_it(name: str) -> bool:
        longer, shorter = sorted((name.lower(), joint.lower()), key=len, reverse=True)
        return bool(shorter) and bool(re.search(rf"(^|[^a-z0-9]){re.escape(shorter)}$", longer))

    return is_it


def _joint_number(joint: str) -> Callable[[str], bool]:
    """`joint_3`, `joint3` or `j3` at the end."""
    return _numbered(joint, r"j(oint)?[ _\-.]*")


def _number(joint: str) -> Callable[[str], bool]:
    """Any name that ends in the number."""
    return _numbered(joint, r"(^|[^0-9])")


def _numbered(joint: str, before: str) -> Callable[[str], bool]:
    number = re.search(r"\d+$", joint)
    if number is None:
        return lambda _name: False
    pattern = re.compile(rf"{before}0*{int(number[0])}$", re.I)
    return lambda name: bool(pattern.search(name)) and not _NOT_OF_THE_ARM.search(name)
