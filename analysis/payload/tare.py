"""A tare: a run of the same arm with nothing in its gripper."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from analysis.payload.arm_log import ArmLog, has_joints, read_arm_log
from analysis.payload.arm_motion import ArmMotion, arm_motion
from recorders.simulators.arm.description import Arm
from recorders.simulators.arm.payload import PAYLOAD_MASS
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.reader import read_episode

_SAME_SHARE = 0.5
"""Share of a log's torques that no other run repeats to the last bit."""


@dataclass(frozen=True, eq=False)
class Tare:
    """What was read of an empty run."""

    log: ArmLog
    motion: ArmMotion


def read_tare(tare: Path | Episode, arm: Arm, log: ArmLog, topic: str | None) -> Tare:
    """Read an empty run.

    Args:
        tare: its log, or what was read of one.
        arm: whose joints are looked for.
        log: of the run with the payload.
        topic: which to prefer, as in that log; None for the one of its torques.

    Raises:
        NotFoundError: it cannot be used, or is no empty run.
    """
    name = f" {tare}" if isinstance(tare, Path) else ""
    try:
        episode = read_episode(tare) if isinstance(tare, Path) else tare
        prefer = topic or log.effort.topic
        empty = read_arm_log(episode, arm, topic=prefer if has_joints(episode, prefer) else None)
        _check_empty(episode, empty, log)
        return Tare(empty, arm_motion(empty))
    except (LogError, NotFoundError) as error:
        reason = str(error).removeprefix(f"{tare}: ")
        raise NotFoundError(f"--tare{name}: {reason}") from error


def _check_empty(episode: Episode, empty: ArmLog, log: ArmLog) -> None:
    """Refuse a run that held something."""
    mass_kg = episode.info.truth.get(PAYLOAD_MASS.name, 0.0)
    if mass_kg > 0:
        raise NotFoundError(
            f"held {mass_kg:g} kg, as it says: name a run with nothing in the gripper"
        )
    known = {row.tobytes() for row in empty.effort.values}
    same = sum(row.tobytes() in known for row in log.effort.values)
    if same > _SAME_SHARE * len(log.effort.values):
        raise NotFoundError(
            "has the torques of the log itself: name another run, with nothing in the gripper"
        )
