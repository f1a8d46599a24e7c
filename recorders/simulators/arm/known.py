"""Common arms by name: their URDFs, and the joint names of their drivers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import short_name

if TYPE_CHECKING:
    from tunenet_logs.recorders.simulators.arm.description import Arm

FOLDER = Path(__file__).with_name("known")

# The paper's arm: taken where neither a user nor a log says which one it is.
DEFAULT = "jaco7-robotiq85"


@dataclass(frozen=True)
class KnownArm:
    """An arm that can be named instead of described."""

    name: str  # as `--arm` takes it, and the stem of its URDF
    words: str  # its make and model, with what is on its flange
    tool_link: str  # where a payload sits: on a bare flange, or between a hand's fingertips
    joint_names: tuple[tuple[str, ...], ...]  # of its usual drivers, one tuple each
    is_said_by_names: bool = True  # whether no other make's arm has such names
    doubt: str = ""  # what a user should know is uncertain; "" for nothing

    @property
    def urdf(self) -> Path:
        """Path of its URDF."""
        return FOLDER / f"{self.name}.urdf"

    def arm(self, columns: Sequence[str] = ()) -> Arm:
        """Read the arm, its joints named as by the driver that gives these columns."""
        # It needs numpy, help does not.
        from tunenet_logs.recorders.simulators.arm.description import read_arm

        arm = read_arm(self.urdf, self.tool_link)
        names = self.names_in(columns)
        if names is None:
            return arm
        pairs = zip(arm.joints, names, strict=True)
        return replace(arm, joints=tuple(replace(joint, name=name) for joint, name in pairs))

    def names_in(self, columns: Sequence[str]) -> tuple[str, ...] | None:
        """Return the first driver's names found in the columns, prefixed or not, or None."""
        for names in self.joint_names:
            called = [re.compile(rf"(^|[^a-z0-9]){re.escape(name)}$", re.I) for name in names]
            if all(any(map(one.search, columns)) for one in called):
                return names
        return None


def _numbered(before: str, count: int, after: str = "", first: int = 1) -> tuple[str, ...]:
    return tuple(f"{before}{number}{after}" for number in range(first, first + count))


_UR = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
_JACO7, _JACO6, _JACO6_BENT = (
    (_numbered(f"j2{kind}300_joint_", int(kind[1])),) for kind in ("s7s", "s6s", "n6s")
)
_PANDA, _GEN3, _XARM = ((_numbered(name, 7),) for name in ("panda_joint", "joint_", "joint"))
_LWR_AXES = ("a1", "a2", "e1", "a3", "a4", "a5", "a6")
_LWR = (tuple(f"lwr_{axis}_joint" for axis in _LWR_AXES), _numbered("lwr_arm_", 7, "_joint", 0))
_XARM_DOUBT = "what moves weighs 8.2 to 11.8 kg by its make, 10.4 kg here; record a tare"

_ARMS = (
    KnownArm(DEFAULT, "Kinova Jaco, 7 joints, with a Robotiq 85", "tool_mount", _JACO7),
    KnownArm("jaco7", "Kinova Jaco, 7 joints, with its own hand", "j2s7s300_end_effector", _JACO7),
    KnownArm(
        "jaco6",
        "Kinova Jaco, 6 joints, spherical wrist, with its own hand",
        "j2s6s300_end_effector",
        _JACO6,
    ),
    KnownArm(
        "jaco6-robotiq85",
        "Kinova Jaco, 6 joints, spherical wrist, with a Robotiq 85",
        "tool_mount",
        _JACO6,
    ),
    KnownArm(
        "jaco6-bent",
        "Kinova Jaco, 6 joints, bent wrist, with its own hand",
        "j2n6s300_end_effector",
        _JACO6_BENT,
    ),
    KnownArm("ur5e", "Universal Robots UR5e", "tool0", (_UR,), is_said_by_names=False),
    KnownArm("ur10e", "Universal Robots UR10e", "tool0", (_UR,), is_said_by_names=False),
    KnownArm("panda", "Franka Emika Panda, with its hand", "panda_hand_tcp", _PANDA),
    KnownArm("panda-bare", "Franka Emika Panda", "panda_link8", _PANDA),
    KnownArm(
        "fr3",
        "Franka Research 3, with its hand",
        "fr3_hand_tcp",
        (_numbered("fr3_joint", 7),),
        doubt="its links' masses are the Panda's, as its makers' first description had them",
    ),
    KnownArm(
        "lwr",
        "KUKA LWR 4+",
        "lwr_arm_ee_link",
        _LWR,
        doubt="its links' masses are round figures that nobody measured: without a tare the answer "
        "can be wrong by a kilogram",
    ),
    KnownArm("gen3", "Kinova Gen3, 7 joints", "end_effector_link", _GEN3, is_said_by_names=False),
    KnownArm(
        "gen3-robotiq85",
        "Kinova Gen3, 7 joints, with a Robotiq 85",
        "tool_mount",
        _GEN3,
        is_said_by_names=False,
    ),
    KnownArm(
        "xarm7", "UFACTORY xArm 7", "link_eef", _XARM, is_said_by_names=False, doubt=_XARM_DOUBT
    ),
    KnownArm(
        "xarm7-gripper",
        "UFACTORY xArm 7, with its gripper",
        "link_tcp",
        _XARM,
        is_said_by_names=False,
        doubt=_XARM_DOUBT,
    ),
)

# By name; of those with the same drivers' names, the usual one first.
ARMS = {known.name: known for known in _ARMS}


def known_arm(name: str) -> KnownArm:
    """Look up an arm by name."""
    found = ARMS.get(name.lower())
    if found is None:
        near = get_close_matches(name.lower(), ARMS, 3, 0.5)
        there = f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(ARMS)};"
        raise UsageError(
            f"--arm {short_name(name)}: no such arm; {there} any other arm is "
            "--urdf FILE --tool-link LINK"
        )
    return found


def name_alone(name: str, urdf: Path | None, tool_link: str | None) -> str:
    """Check a known arm's name; return it as `ARMS` has it."""
    for option, value in (("--urdf", urdf), ("--tool-link", tool_link)):
        if value is not None:
            raise UsageError(f"--arm {short_name(name)} does not go with {option}; leave one out")
    return known_arm(name).name


def arms_called(columns: Sequence[str]) -> tuple[KnownArm, ...]:
    """Find the arms whose drivers give these columns, the usual one first."""
    # Names that only one make has take precedence over common ones, such as `joint_1`.
    found = tuple(known for known in _ARMS if known.names_in(columns) is not None)
    return tuple(known for known in found if known.is_said_by_names) or found


def in_words(arms: Iterable[KnownArm]) -> str:
    """List the arms as `--arm` options."""
    return " or ".join(f"--arm {known.name}" for known in arms)
