"""Describe a serial arm: joints, links with inertias, and the tool frame that holds a payload.

An arm is the chain of a URDF from its base to one link. URDFs are untrusted XML, read strictly and
within bounds.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import atan2, cos, hypot, sin
from pathlib import Path

import numpy as np

from tunenet_logs.episode import Array
from tunenet_logs.errors import UsageError
from tunenet_logs.files import MAX_XML_BYTES, parse_xml, read_small_file, refuse_xacro
from tunenet_logs.terminal import listed, short_name

# ---- Transforms and inertias of rigid bodies: moved, combined, diagonalised


def rotation_from_rpy(rpy: Sequence[float]) -> Array:
    """Compute R = Rz(yaw) Ry(pitch) Rx(roll) [rad], URDF's convention, shape (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = zip(*((cos(angle), sin(angle)) for angle in rpy), strict=True)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def rpy_from_rotation(rotation: Array) -> tuple[float, float, float]:
    """Compute roll, pitch, yaw [rad] of a (3, 3) rotation; in gimbal lock, yaw is 0."""
    level = hypot(rotation[0, 0], rotation[1, 0])
    pitch = atan2(-rotation[2, 0], level)
    if level < 1e-9:  # pitch is 90 degrees: roll and yaw turn about the same axis
        return atan2(-rotation[1, 2], rotation[1, 1]), pitch, 0.0
    return (atan2(rotation[2, 1], rotation[2, 2]), pitch, atan2(rotation[1, 0], rotation[0, 0]))


@dataclass(frozen=True, eq=False)
class Transform:
    """A rigid transform: the pose of a frame in its parent."""

    origin_m: Array  # the frame's origin in the parent, shape (3,)
    rotation: Array  # the frame's axes in the parent, as columns, shape (3, 3)

    @classmethod
    def at(cls, origin_m: Sequence[float], rpy: Sequence[float]) -> Transform:
        """Make a transform from an origin [m], and roll, pitch and yaw [rad]."""
        return cls(np.array(origin_m, np.float64), rotation_from_rpy(rpy))

    def __matmul__(self, inner: Transform) -> Transform:
        """Compose: map `inner`, given in this frame, to this frame's parent."""
        return Transform(
            self.origin_m + self.rotation @ inner.origin_m, self.rotation @ inner.rotation
        )


IDENTITY = Transform.at((0, 0, 0), (0, 0, 0))


@dataclass(frozen=True)
class Inertial:
    """Mass, centre of mass and inertia of a link, as in a URDF's `<inertial>`."""

    mass_kg: float  # over 0 where a joint moves it
    com_m: tuple[float, float, float]  # centre of mass in the link's frame
    inertia_kg_m2: tuple[float, float, float, float, float, float]  # about that: xx xy xz yy yz zz

    def tensor(self) -> Array:
        """Return the inertia tensor, shape (3, 3) [kg m²]."""
        xx, xy, xz, yy, yz, zz = self.inertia_kg_m2
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def seen_from(self, frame: Transform) -> Inertial:
        """Transform to the parent of `frame`, the link's."""
        com_m = frame.origin_m + frame.rotation @ np.array(self.com_m)
        return inertial(self.mass_kg, com_m, frame.rotation @ self.tensor() @ frame.rotation.T)

    def principal(self) -> tuple[Array, Array]:
        """Diagonalise: principal moments [kg m²], shape (3,), and axes as columns, (3, 3)."""
        # Where rounding in a file breaks the triangle inequality of the moments, the largest is
        # lowered to the sum of the others: PyBullet would take all of them for 0.
        tensor = self.tensor()
        if np.any(tensor - np.diag(np.diag(tensor))):
            moments, axes = np.linalg.eigh(tensor)
            axes[:, 2] *= np.sign(np.linalg.det(axes))
        else:
            moments, axes = np.diag(tensor), np.eye(3)
        most = (moments.sum() - moments) * (1 - 1e-9)
        return np.minimum(moments, most), axes


NOTHING = Inertial(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))  # a link without mass


def inertial(mass_kg: float, com_m: Array, tensor: Array) -> Inertial:
    """Make from arrays: centre of mass [m], shape (3,), and inertia [kg m²], shape (3, 3)."""
    x, y, z = (float(value) for value in com_m)
    xx, xy, xz, yy, yz, zz = (float(value) for value in tensor[np.triu_indices(3)])
    return Inertial(mass_kg, (x, y, z), (xx, xy, xz, yy, yz, zz))


def combined(parts: Iterable[Inertial]) -> Inertial:
    """Combine bodies fixed to each other (parallel axis theorem); `NOTHING` if massless."""
    heavy = [part for part in parts if part != NOTHING]
    mass_kg = sum(part.mass_kg for part in heavy)
    if mass_kg <= 0:
        return NOTHING
    if len(heavy) == 1:
        return heavy[0]
    com_m = sum((part.mass_kg * np.array(part.com_m) for part in heavy), np.zeros(3)) / mass_kg
    tensor = np.zeros((3, 3))
    for part in heavy:
        away = np.array(part.com_m) - com_m
        tensor += part.tensor() + part.mass_kg * (away @ away * np.eye(3) - np.outer(away, away))
    return inertial(mass_kg, com_m, tensor)


def solid_sphere(mass_kg: float, radius_m: float) -> Inertial:
    """Return the inertia of a solid sphere about its centre."""
    moment = 0.4 * mass_kg * radius_m**2
    return Inertial(mass_kg, (0.0, 0.0, 0.0), (moment, 0.0, 0.0, moment, 0.0, moment))


# ---- URDF: links and joints as the file has them

_MAX_LINKS = 1000  # of a file: more than any arm's; what has more is refused before it costs

_JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True, eq=False)
class FileJoint:
    """A joint as in the file."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Transform  # the child's frame in the parent's, at 0
    axis: tuple[float, float, float]  # unit, in the child's frame
    limits: tuple[float, float]  # lower and upper; infinite where there are none
    max_velocity: float
    max_effort: float
    is_mimic: bool  # it follows another joint


@dataclass(frozen=True)
class FileRobot:
    """A robot as in the file."""

    name: str
    links: Mapping[str, Inertial]  # inertia of each; `NOTHING` where it is one of `faults`
    joints: Mapping[str, FileJoint]  # by the child's name
    faults: Mapping[str, UsageError]  # of links with an invalid `<inertial>`: of a base, none
    mended: Mapping[str, str]  # links with a moment of inertia below 0, and what was done, in words


def read_urdf(path: Path) -> FileRobot:
    """Read links and joints; shapes, materials and extensions are left out."""
    try:
        data = read_small_file(path, MAX_XML_BYTES)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; --urdf takes a robot's URDF file") from error
    except ValueError as error:
        raise UsageError(f"{path}: {error}, so no URDF of an arm") from error
    root = parse_xml(data, path, "URDF", "--urdf takes a robot's URDF")
    if root.tag != "robot":
        raise UsageError(f"{path}: begins with <{short_name(root.tag)}>, a URDF with <robot>")
    refuse_xacro(root, path)
    if len(root) > 10 * _MAX_LINKS or len(root.findall("link")) > _MAX_LINKS:
        raise UsageError(f"{path}: over {_MAX_LINKS} links, so no URDF of an arm")
    links: dict[str, Inertial] = {}
    faults: dict[str, UsageError] = {}
    mended: dict[str, str] = {}
    for element in root.findall("link"):
        place = _Element(path, element)
        if place.name in links:
            raise place.wrong("is there twice; rename one")
        try:
            links[place.name], words = _inertial(place)
            mended |= {place.name: words} if words else {}
        except UsageError as error:
            links[place.name], faults[place.name] = NOTHING, error
    joints: dict[str, FileJoint] = {}
    names: set[str] = set()
    for element in root.findall("joint"):
        place = _Element(path, element)
        joint = _joint(place, links)
        if joint.name in names:
            raise place.wrong("is there twice; rename one")
        if joint.child in joints:
            other = joints[joint.child].name
            raise place.wrong(
                f"and joint {short_name(other)} both carry link {short_name(joint.child)}; "
                "a link hangs on one joint"
            )
        names.add(joint.name)
        joints[joint.child] = joint
    return FileRobot(root.get("name", "") or path.stem, links, joints, faults, mended)


class _Element:
    """A link or joint element, to read from and to name in errors."""

    def __init__(self, path: Path, element: ET.Element) -> None:
        self.path = path
        self.element = element
        self.name = element.get("name", "")
        if not self.name.strip() or len(self.name) > 200:
            raise UsageError(f"{path}: a <{element.tag}> has no name of 1 to 200 characters")

    def wrong(self, what: str) -> UsageError:
        """Make the error that something is wrong here."""
        return UsageError(f"{self.path}: {self.element.tag} {short_name(self.name)} {what}")

    def numbers(
        self, tag: str, key: str, count: int, most: float, default: str | None = None
    ) -> tuple[float, ...]:
        """Parse `count` numbers in an attribute of the child `tag`, e.g. "inertial/origin"."""
        child = self.element.find(tag)
        text = default if child is None else child.get(key, default)
        if text is None:
            raise self.wrong(f"has no <{tag} {key}=...>; add it")
        try:
            values = tuple(float(part) for part in text.split())
        except ValueError:
            values = ()
        if len(values) != count or not all(math.isfinite(value) for value in values):
            wanted = "a finite number" if count == 1 else f"{count} finite numbers"
            raise self.wrong(f'has <{tag} {key}="{short_name(text)}">, which is not {wanted}')
        if max(map(abs, values)) > most:
            raise self.wrong(
                f'has <{tag} {key}="{short_name(text)}">, beyond the {most:g} of any arm; '
                "lengths are in m, angles in rad, masses in kg"
            )
        return values

    def frame(self, tag: str) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Parse origin [m], and roll, pitch and yaw [rad], of the child `tag`."""
        # More than any arm has: a larger value is in other units.
        x, y, z = self.numbers(tag, "xyz", 3, 100.0, "0 0 0")
        roll, pitch, yaw = self.numbers(tag, "rpy", 3, 1000.0, "0 0 0")
        return (x, y, z), (roll, pitch, yaw)


def _inertial(place: _Element) -> tuple[Inertial, str]:
    """Read a link's inertia; raise a moment below 0, as identified ones may have, with words."""
    if place.element.find("inertial") is None:
        return NOTHING, ""
    (mass_kg,) = place.numbers("inertial/mass", "value", 1, 10_000.0)
    if mass_kg < 0:
        raise place.wrong(f"weighs {mass_kg:g} kg; give its mass, or 0")
    moments = [place.numbers("inertial/inertia", key, 1, 1e6, "0")[0] for key in _MOMENTS]
    own = Inertial(mass_kg, (0.0, 0.0, 0.0), tuple(moments))  # pyright: ignore[reportArgumentType]
    frame = Transform.at(*place.frame("inertial/origin"))
    principal, axes = np.linalg.eigh(own.tensor())
    least = float(principal[0])
    if least >= -1e-9 * max(map(abs, moments)):
        return own.seen_from(frame), ""
    # Not to 0, which engines take for none.
    raised = np.maximum(principal, 1e-3 * np.abs(principal).max())
    nearest = inertial(mass_kg, np.zeros(3), axes @ np.diag(raised) @ axes.T)
    fault = place.wrong(
        f"has a principal moment of inertia of {least:.3g} kg m²; none is below 0: "
        f"{raised[0]:.3g} is taken, correct its <inertia>"
    )
    return nearest.seen_from(frame), str(fault)


def _joint(place: _Element, links: Mapping[str, Inertial]) -> FileJoint:
    kind = place.element.get("type", "")
    if kind not in _JOINT_TYPES:
        raise place.wrong(f'has type="{short_name(kind)}"; known are {", ".join(_JOINT_TYPES)}')
    ends: list[str] = []
    for tag in ("parent", "child"):
        element = place.element.find(tag)
        link = "" if element is None else element.get("link", "")
        if link not in links:
            raise place.wrong(f'has <{tag} link="{short_name(link)}">, which is no link here')
        ends.append(link)
    axis = np.array(place.numbers("axis", "xyz", 3, 1e6, "1 0 0"))
    length = float(np.linalg.norm(axis))
    if kind in ("revolute", "continuous", "prismatic") and length < 1e-6:
        raise place.wrong('has an <axis> of no direction; give one, such as xyz="0 0 1"')
    x, y, z = (float(value) for value in axis / max(length, 1e-6))
    limits = (-math.inf, math.inf)
    if kind in ("revolute", "prismatic") and place.element.find("limit") is not None:
        (low,) = place.numbers("limit", "lower", 1, _UNLIMITED, "0")
        (high,) = place.numbers("limit", "upper", 1, _UNLIMITED, "0")
        if low > high:
            raise place.wrong(f"has a lower limit of {low:g} and an upper one of {high:g}")
        limits = (low, high)
    # A greatest speed or effort of 0 stands for none.
    (velocity,) = place.numbers("limit", "velocity", 1, math.inf, "0")
    (effort,) = place.numbers("limit", "effort", 1, math.inf, "0")
    return FileJoint(
        name=place.name,
        kind=kind,
        parent=ends[0],
        child=ends[1],
        origin=Transform.at(*place.frame("origin")),
        axis=(x, y, z),
        limits=limits,
        max_velocity=velocity if velocity > 0 else math.inf,
        max_effort=effort if effort > 0 else math.inf,
        is_mimic=place.element.find("mimic") is not None,
    )


# ---- Arm: the chain from base to tool, with what hangs on it

# Of the solid ball that stands for a payload: torques do not identify its own inertia.
PAYLOAD_RADIUS_M = 0.04

JACO_URDF = Path(__file__).with_name("known") / "jaco7-robotiq85.urdf"
JACO_TOOL_LINK = "tool_mount"

_MAX_JOINTS = 32  # more than any arm has

# Stands for infinity in a URDF [rad, rad/s or N·m]: engines read no "inf", and files write large
# numbers for "none".
_UNLIMITED = 1e9


@dataclass(frozen=True)
class Joint:
    """A moving joint with the link that it carries."""

    name: str
    is_prismatic: bool  # it slides: rad, rad/s and N·m are then m, m/s and N
    origin_m: tuple[float, float, float]  # the joint's frame in the one before it, at 0
    origin_rpy: tuple[float, float, float]  # likewise, roll, pitch and yaw
    axis: tuple[float, float, float]  # unit, in the joint's frame
    limits_rad: tuple[float, float]  # -inf, inf for a continuous joint
    max_velocity_rad_s: float  # inf where none is known
    max_effort_nm: float  # likewise
    link: Inertial  # inertia up to the next moving joint, fixed parts and fingers lumped in


@dataclass(frozen=True)
class Payload:
    """The payload that the arm holds."""

    mass_kg: float  # 0 for nothing
    com_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # its centre of mass in the tool frame

    def __post_init__(self) -> None:
        # More is in other units, or of no arm.
        if not 0 <= self.mass_kg <= 1000:
            raise UsageError(f"payload mass {self.mass_kg:g} is not from 0 to 1000 kg")
        if len(self.com_m) != 3 or not all(abs(value) <= 10 for value in self.com_m):
            raise UsageError(f"payload centre {self.com_m} is not three numbers within 10 m")


@dataclass(frozen=True)
class Arm:
    """A serial arm on a fixed base."""

    name: str
    joints: tuple[Joint, ...]  # from the base to the tool
    tool_from_last_m: tuple[float, float, float]  # of the payload, in the last joint's frame
    tool_from_last_rpy: tuple[float, float, float]  # likewise, roll, pitch and yaw
    remarks: tuple[str, ...] = ()  # doubts about its description, and how they were resolved

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
        carried = [("base", solid_sphere(1.0, 0.1), "", ((0.0,) * 3, (0.0,) * 3), "")]
        for number, joint in enumerate(self.joints, 1):
            kind = "prismatic" if joint.is_prismatic else "revolute"
            low, high = joint.limits_rad
            velocity = min(joint.max_velocity_rad_s, _UNLIMITED)
            motion = (
                f'<axis xyz="{_numbers(joint.axis)}" />'
                f'<limit lower="{max(low, -_UNLIMITED)!r}" upper="{min(high, _UNLIMITED)!r}"'
                f' velocity="{velocity!r}" effort="{min(joint.max_effort_nm, _UNLIMITED)!r}" />'
            )
            head = f'<joint name="joint_{number}" type="{kind}">'
            pose = joint.origin_m, joint.origin_rpy
            carried.append((f"link_{number}", joint.link, head, pose, motion))
        if payload is not None and payload.mass_kg > 0:
            ball = replace(solid_sphere(payload.mass_kg, PAYLOAD_RADIUS_M), com_m=payload.com_m)
            head = '<joint name="payload_mount" type="fixed">'
            pose = self.tool_from_last_m, self.tool_from_last_rpy
            carried.append(("payload", ball, head, pose, ""))
        parts, parent = ['<robot name="arm">'], ""
        for name, weight, head, (origin_m, rpy), motion in carried:
            moments, axes = weight.principal()
            xx, yy, zz = map(float, moments)
            parts.append(
                f'<link name="{name}"><inertial><origin xyz="{_numbers(weight.com_m)}" '
                f'rpy="{_numbers(rpy_from_rotation(axes))}" /><mass value="{weight.mass_kg!r}" />'
                f'<inertia ixx="{xx!r}" ixy="0" ixz="0" iyy="{yy!r}" iyz="0" izz="{zz!r}" />'
                "</inertial></link>"
            )
            if parent:
                parts.append(
                    f'{head}<parent link="{parent}" /><child link="{name}" />'
                    f'<origin xyz="{_numbers(origin_m)}" rpy="{_numbers(rpy)}" />{motion}</joint>'
                )
            parent = name
        return "".join((*parts, "</robot>"))


def read_arm(path: Path, tool_link: str) -> Arm:
    """Read the chain of a URDF from its base to a link, the tool frame.

    Parts that are fixed to the chain, and what moves beside it (fingers), are lumped into the
    chain's links with their joints at 0.
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
        is_prismatic = joint.kind == "prismatic"
        motion = joint.axis, joint.limits, joint.max_velocity, joint.max_effort
        joints.append(Joint(joint.name, is_prismatic, *_as_tuples(before), *motion, link))
        before = IDENTITY
    of_chain = {link for one in carried.values() for link in one}
    mended = (words for link, words in robot.mended.items() if link in of_chain)
    return Arm(robot.name, tuple(joints), *_as_tuples(before), tuple(mended))


def jaco() -> Arm:
    """Load Kinova's Jaco with 7 joints and a spherical wrist (j2s7s300), with a Robotiq 85."""
    # The tool frame is 0.15 m from the gripper's base: x along the gripper, y as its fingers open.
    return read_arm(JACO_URDF, JACO_TOOL_LINK)


def _chain(path: Path, robot: FileRobot, tool_link: str) -> list[FileJoint]:
    """Return the joints from the base to the tool."""
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
    """Return the links that each of the chain's moving links carries, in its frame."""
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


def _as_tuples(frame: Transform) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    x, y, z = (float(value) for value in frame.origin_m)
    return (x, y, z), rpy_from_rotation(frame.rotation)


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
