"""Choose the arm of a log: the one that the user names, else by its joint names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from analysis.payload.arm_log import JOINT_UNITS
from analysis.payload.driver_quirks import match_joints
from recorders.simulators.arm.description import Arm, read_arm
from recorders.simulators.arm.known_arms import DEFAULT, KnownArm, arms_called, in_words, known_arm
from tunenet_logs.episode import Episode
from tunenet_logs.errors import NotFoundError
from tunenet_logs.terminal import FEW_NAMES, listed, short_name

# Joints that are only numbered, one fewer than the default arm has.
_SIX = tuple(f"joint_{number}" for number in range(1, 7))

_OTHER = "--urdf FILE --tool-link LINK for any other"


@dataclass(frozen=True)
class ChosenArm:
    """Arm that a log is taken to be of.

    Attributes:
        arm: Its joints named as in the log, if its drivers have several names for them.
        remarks: Why this one, and what is not known of it.
    """

    arm: Arm
    remarks: tuple[str, ...]


def which_arm(
    episode: Episode, named: str | tuple[Path, str] | None, topic: str | None
) -> ChosenArm:
    """Choose the arm of a log.

    Args:
        episode: The log's.
        named: A known arm's name, or a URDF and the link that holds the payload; None if the user
            names none.
        topic: Channel to go by; None for all, those with torques first.

    Raises:
        UsageError: The name is no arm's, or the URDF is invalid.
        NotFoundError: No arm is named, and it could be several, none of them the default.
    """
    if isinstance(named, tuple):
        arm = read_arm(*named)
        return ChosenArm(arm, arm.remarks)
    there = _columns(episode, topic)
    if named is not None:
        known = known_arm(named)
        return _chosen(known, there, f"arm: {known.words}, as --arm says")
    for columns in there:
        if called := arms_called(columns):
            return _by_names(called, columns, there)
    seven = known_arm(DEFAULT).joint_names[0]
    has_torques = any(signal.unit in ("N·m", "A") for signal in episode.signals.values())
    if has_torques and not any(_fits(seven, columns) for columns in there):
        for columns in there:
            if _fits(_SIX, columns):
                raise NotFoundError(
                    "joints that do not say whose they are "
                    f"({listed(map(short_name, columns), FEW_NAMES)})",
                    f"name the arm with --arm, such as --arm jaco6, or {_OTHER}",
                )
    return _default(there)


def _by_names(
    called: tuple[KnownArm, ...], columns: Sequence[str], there: Sequence[Sequence[str]]
) -> ChosenArm:
    """Choose the usual one of the arms that have these names."""
    first, *others = called
    if first.is_said_by_names:
        variants = f"; with another hand, or none: {in_words(others)}" if others else ""
        return _chosen(first, there, f"arm: {first.words}, by its joints' names{variants}")
    if _fits(known_arm(DEFAULT).joint_names[0], columns):
        return _default(there)
    raise NotFoundError(
        f"its joints are those of {' or '.join(one.words for one in called)}, and their names do "
        f"not say which: add {in_words(called)}, or {_OTHER}"
    )


def _default(there: Sequence[Sequence[str]]) -> ChosenArm:
    known = known_arm(DEFAULT)
    return _chosen(
        known,
        there,
        f"the joints' names do not say which arm this is: taken for a {known.words}; name "
        f"it with --arm, or {_OTHER}",
    )


def _chosen(known: KnownArm, there: Sequence[Sequence[str]], why: str) -> ChosenArm:
    """Build a known arm, its joints named as the columns that have all of them."""
    columns = next((one for one in there if known.names_in(one)), ())
    doubts = (f"arm: {known.doubt}",) if known.doubt else ()
    return ChosenArm(known.arm(columns), (why, *doubts))


def _columns(episode: Episode, topic: str | None) -> list[tuple[str, ...]]:
    """List the joint names of each field, the preferred topic's and those of torques first."""
    fields = [signal for signal in episode.signals.values() if signal.unit in JOINT_UNITS]
    wanted = {signal.name for signal in episode.signals_of(topic)} if topic else set()
    fields.sort(key=lambda signal: (signal.name not in wanted, signal.unit != "N·m"))
    return list(dict.fromkeys(signal.columns for signal in fields))


def _fits(joints: Sequence[str], columns: Sequence[str]) -> bool:
    try:
        match_joints(joints, columns)
    except NotFoundError:
        return False
    return True
