"""A serial arm: joints, links with their inertias, and the tool frame that holds a payload."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET  # writes only
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from recorders.simulators.arm.rigid_bodies import (
    IDENTITY,
    Inertial,
    Transform,
    combined,
    rpy_from_rotation,
    solid_sphere,
)
from recorders.simulators.arm.urdf_reading import FileJoint, FileRobot, read_urdf
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import listed, short_name

# Of the solid ball that stands for a payload: torques do not identify its own inertia.
PAYLOAD_RADIUS_M = 0.04

JACO_URDF = Path(__file__).with_name("known") / "jaco7-robotiq85.urdf"
JACO_TOOL_LINK = "tool_mount"

# More than any arm has: what is beyond is in other units, or no arm.
_MAX_JOINTS, _MAX_PAYLOAD_KG, _MAX_OFFSET_M = 32, 1000.0, 10.0

_UNLIMITED = 1e9  # stands for infinity in a URDF [rad, rad/s or N·m]: engines read no "inf"


@dataclass(frozen=True)
class Joint:
    """A moving joint with the link that it carries.

    Attributes:
        is_prismatic: it slides: rad, rad/s and N·m are then m, m/s and N.
        origin_m: the joint's frame in the one before it, at 0.
        origin_rpy: likewise, roll, pitch and yaw.
        axis: unit, in the joint's frame.
        limits_rad: -inf, inf for a continuous joint.
        max_velocity_rad_s: inf where none is known.
        max_effort_nm: likewise.
        link: inertia up to the next moving joint, fixed parts and fingers lumped in.
    """

    name: str
    is_prismatic: bool
    origin_m: tuple[float, float, float]
    origin_rpy: tuple[float, float, float]
    axis: tuple[float, float, float]
    limits_rad: tuple[float, float]
    max_velocity_rad_s: float
    max_effort_nm: float
    link: Inertial


@dataclass(frozen=True)
class Payload:
    """The payload that the arm holds.

    Attributes:
        mass_kg: 0 for nothing.
        com_m: its centre of mass in the tool frame.

    Raises:
        UsageError: not finite, or nothing that an arm holds.
    """

    mass_kg: float
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not 0 <= self.mass_kg <= _MAX_PAYLOAD_KG:
            raise UsageError(f"payload mass {self.mass_kg:g} is not from 0 to 1000 kg")
        if len(self.com_m) != 3 or not all(abs(value) <= _MAX_OFFSET_M for value in self.com_m):
            raise UsageError(f"payload centre {self.com_m} is not three numbers within 10 m")


@dataclass(frozen=True)
class Arm:
    """A serial arm on a fixed base.

    Attributes:
        joints: from the base to the tool.
        tool_from_last_m: the tool frame, where a payload sits, in the last joint's frame.
        tool_from_last_rpy: likewise, roll, pitch and yaw.
        remarks: doubts about its description, and how they were resolved.
    """

    name: str
    joints: tuple[Joint, ...]
    tool_from_last_m: tuple[float, float, float]
    tool_from_last_rpy: tuple[float, float, float]
    remarks: tuple[str, ...] = ()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names, from the base to the tool."""
        return tuple(joint.name for joint in self.joints)

    def without_limits(self) -> Arm:
        """Copy the arm without joint limits: measured positions may exceed a description's."""
        endless = (-math.inf, math.inf)
        joints = (replace(joint, limits_rad=endless) for joint in self.joints)
        return replace(self, joints=tuple(joints))

    def urdf(self, payload: Payload | None = None) -> str:
        """Write the arm as a URDF for a physics engine: joints and inertias, no shapes.

        Every link has an inertia, along its principal axes (PyBullet gives 1 kg to a link that has
        none). A continuous joint is a revolute one with far limits, so that it has one coordinate
        everywhere. Names are ours, `joint_1` and `link_1` for the first: engines end at a duplicate
        name. A payload with mass is a link `payload` on a fixed joint.
        """
        robot = ET.Element("robot", name="arm")
        _link(robot, "base", solid_sphere(1.0, 0.1))
        parent = "base"
        for number, joint in enumerate(self.joints, 1):
            child = f"link_{number}"
            _link(robot, child, joint.link)
            kind = "prismatic" if joint.is_prismatic else "revolute"
            element = ET.SubElement(robot, "joint", name=f"joint_{number}", type=kind)
            _ends(element, parent, child, joint.origin_m, joint.origin_rpy)
            ET.SubElement(element, "axis", xyz=_numbers(joint.axis))
            low, high = joint.limits_rad
            ET.SubElement(
                element,
                "limit",
                lower=repr(max(low, -_UNLIMITED)),
                upper=repr(min(high, _UNLIMITED)),
                velocity=repr(min(joint.max_velocity_rad_s, _UNLIMITED)),
                effort=repr(min(joint.max_effort_nm, _UNLIMITED)),
            )
            parent = child
        if payload is not None and payload.mass_kg > 0:
            ball = solid_sphere(payload.mass_kg, PAYLOAD_RADIUS_M)
            _link(robot, "payload", replace(ball, com_m=payload.com_m))
            element = ET.SubElement(robot, "joint", name="payload_mount", type="fixed")
            _ends(element, parent, "payload", self.tool_from_last_m, self.tool_from_last_rpy)
        return ET.tostring(robot, encoding="unicode")


def read_arm(path: Path, tool_link: str) -> Arm:
    """Read the chain of a URDF from its base to a link, the tool frame.

    Parts that are fixed to the chain, and what moves beside it (fingers), are lumped into the
    chain's links with their joints at 0.

    Args:
        path: the URDF of any serial arm; of what hangs on its base, only the chain counts.
        tool_link: the link in whose frame the payload is.

    Raises:
        UsageError: the file, a value in it or the chain is invalid; names the remedy. The mass of
            a link that no joint of the chain moves may be anything.
    """
    robot = read_urdf(path)
    chain = _chain(path, robot, tool_link)
    carried = _carried(path, robot, {joint.child for joint in chain if joint.kind != "fixed"})
    joints: list[Joint] = []
    before = IDENTITY
    for joint in chain:
        before = before @ joint.origin
        if joint.kind == "fixed":
            continue
        link = combined(carried[joint.child].values())
        if link.mass_kg <= 0:
            raise UsageError(
                f"{path}: joint {short_name(joint.name)} carries no mass; give link "
                f"{short_name(joint.child)} its <inertial>"
            )
        origin_m, origin_rpy = _as_tuples(before)
        joints.append(
            Joint(
                joint.name,
                joint.kind == "prismatic",
                origin_m,
                origin_rpy,
                joint.axis,
                joint.limits,
                joint.max_velocity,
                joint.max_effort,
                link,
            )
        )
        before = IDENTITY
    mended = (
        words
        for link, words in robot.mended.items()
        if any(link in one for one in carried.values())
    )
    return Arm(robot.name, tuple(joints), *_as_tuples(before), tuple(mended))


def jaco() -> Arm:
    """Load Kinova's Jaco with 7 joints and a spherical wrist (j2s7s300), with a Robotiq 85.

    The tool frame is 0.15 m from the gripper's base: x along the gripper, y as its fingers open.
    """
    return read_arm(JACO_URDF, JACO_TOOL_LINK)


def _chain(path: Path, robot: FileRobot, tool_link: str) -> list[FileJoint]:
    """Return the joints from the base to the tool.

    Raises:
        UsageError: no such link, a loop, or joints that are not an arm's.
    """
    if tool_link not in robot.links:
        raise UsageError(
            f"{path}: has no link {short_name(tool_link)}; --tool-link is one of "
            f"{listed(short_name(name) for name in robot.links)}"
        )
    chain: list[FileJoint] = []
    link, seen = tool_link, {tool_link}
    while (joint := robot.joints.get(link)) is not None:
        chain.append(joint)
        link = joint.parent
        if link in seen:
            raise UsageError(f"{path}: link {short_name(link)} hangs on itself in a loop")
        seen.add(link)
    movers = [joint for joint in reversed(chain) if joint.kind != "fixed"]
    others = [name for name in robot.links if name not in robot.joints and name != link]
    if not movers and others:
        raise UsageError(
            f"{path}: no joint carries link {short_name(link)}, so {short_name(tool_link)} is on "
            "no arm; add a fixed joint from the arm's last link to it, or name that link with "
            "--tool-link"
        )
    if not 1 <= len(movers) <= _MAX_JOINTS:
        raise UsageError(
            f"{path}: {len(movers)} joints move link {short_name(tool_link)}, an arm has 1 to "
            f"{_MAX_JOINTS}; name the link that holds the payload with --tool-link"
        )
    for joint in movers:
        name = short_name(joint.name)
        if joint.kind in ("floating", "planar"):
            raise UsageError(
                f"{path}: joint {name} is {joint.kind}; an arm's are revolute, continuous or "
                "prismatic, on a fixed base"
            )
        if joint.is_mimic:
            raise UsageError(
                f"{path}: joint {name} follows another one (<mimic>) but is on the way to "
                f"{short_name(tool_link)}; choose a --tool-link before the fingers"
            )
    return chain[::-1]


def _carried(path: Path, robot: FileRobot, movers: set[str]) -> dict[str, dict[str, Inertial]]:
    """Return the links that each of the chain's moving links carries, in its frame.

    Raises:
        UsageError: an inertia is invalid, or a link hangs on itself.
    """
    carried: dict[str, dict[str, Inertial]] = {child: {} for child in movers}
    placed: dict[str, tuple[str, Transform]] = {}
    for link, own in robot.links.items():
        trail: list[str] = []
        at = link
        while at not in placed and at not in movers and at in robot.joints:
            if len(trail) > len(robot.links):
                raise UsageError(f"{path}: link {short_name(link)} hangs on itself in a loop")
            trail.append(at)
            at = robot.joints[at].parent
        holder, frame = placed.get(at, (at if at in movers else "", IDENTITY))
        for child in reversed(trail):
            frame = frame @ robot.joints[child].origin
            placed[child] = holder, frame
        if holder and link in robot.faults:
            raise robot.faults[link]
        if holder:
            carried[holder][link] = own.seen_from(frame)
    return carried


def _as_tuples(
    frame: Transform,
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    x, y, z = (float(value) for value in frame.origin_m)
    return (x, y, z), rpy_from_rotation(frame.rotation)


def _link(robot: ET.Element, name: str, weight: Inertial) -> None:
    moments, axes = weight.principal()
    element = ET.SubElement(ET.SubElement(robot, "link", name=name), "inertial")
    rpy = rpy_from_rotation(axes)
    ET.SubElement(element, "origin", xyz=_numbers(weight.com_m), rpy=_numbers(rpy))
    ET.SubElement(element, "mass", value=repr(weight.mass_kg))
    xx, yy, zz = (repr(float(moment)) for moment in moments)
    ET.SubElement(element, "inertia", ixx=xx, ixy="0", ixz="0", iyy=yy, iyz="0", izz=zz)


def _ends(
    joint: ET.Element, parent: str, child: str, origin_m: Sequence[float], rpy: Sequence[float]
) -> None:
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "origin", xyz=_numbers(origin_m), rpy=_numbers(rpy))


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
