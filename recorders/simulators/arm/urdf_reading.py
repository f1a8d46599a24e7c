"""Read the links and joints of a URDF: untrusted XML, read strictly and within bounds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from recorders.simulators.arm.rigid_bodies import NOTHING, Inertial, Transform, inertial
from recorders.simulators.strangers_xml import MAX_XML_BYTES, parse_xml, refuse_xacro
from tunenet_logs.errors import UsageError
from tunenet_logs.small_files import read_small_file
from tunenet_logs.terminal import short_name

if TYPE_CHECKING:
    import xml.etree.ElementTree as ET

_MAX_PARTS = 1000  # links of a file: more than any arm's; what has more is refused before it costs
# More than any arm has: a larger value is in other units.
_MAX_M, _MAX_RAD, _MAX_KG, _MAX_KG_M2 = 100.0, 1000.0, 10_000.0, 1e6

_MAX_LIMIT = 1e9  # of a joint's position [rad or m]: files write large numbers for "none"
# Of a link's largest moment of inertia, that stands for one below 0: engines take 0 for none.
_MIN_SHARE = 1e-3

_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True, eq=False)
class FileJoint:
    """A joint as in the file.

    Attributes:
        origin: the child's frame in the parent's, at 0.
        axis: unit, in the child's frame.
        limits: lower and upper; infinite where there are none.
        is_mimic: it follows another joint.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Transform
    axis: tuple[float, float, float]
    limits: tuple[float, float]
    max_velocity: float
    max_effort: float
    is_mimic: bool


@dataclass(frozen=True)
class FileRobot:
    """A robot as in the file.

    Attributes:
        links: inertia of each; `NOTHING` where it is one of `faults`.
        joints: by the child's name.
        faults: links whose `<inertial>` is invalid: of a base, which never moves, it does not
            count.
        mended: links with a moment of inertia below 0, and what was done, in words.
    """

    name: str
    links: Mapping[str, Inertial]
    joints: Mapping[str, FileJoint]
    faults: Mapping[str, UsageError]
    mended: Mapping[str, str]


def read_urdf(path: Path) -> FileRobot:
    """Read links and joints; shapes, materials and extensions are left out.

    Raises:
        UsageError: not a URDF, or something in it is invalid; with file, element and value. Where
            it is only a link's inertia, that is in `faults` instead.
    """
    root = _root(path)
    links: dict[str, Inertial] = {}
    faults: dict[str, UsageError] = {}
    mended: dict[str, str] = {}
    for element in root.findall("link"):
        place = _Place(path, element)
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
        place = _Place(path, element)
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


def _root(path: Path) -> ET.Element:
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
    if len(root) > 10 * _MAX_PARTS or len(root.findall("link")) > _MAX_PARTS:
        raise UsageError(f"{path}: over {_MAX_PARTS} links, so no URDF of an arm")
    return root


class _Place:
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
        x, y, z = self.numbers(tag, "xyz", 3, _MAX_M, "0 0 0")
        roll, pitch, yaw = self.numbers(tag, "rpy", 3, _MAX_RAD, "0 0 0")
        return (x, y, z), (roll, pitch, yaw)


def _inertial(place: _Place) -> tuple[Inertial, str]:
    """Read a link's inertia; raise a moment below 0, as identified ones may have, with words."""
    if place.element.find("inertial") is None:
        return NOTHING, ""
    (mass_kg,) = place.numbers("inertial/mass", "value", 1, _MAX_KG)
    if mass_kg < 0:
        raise place.wrong(f"weighs {mass_kg:g} kg; give its mass, or 0")
    moments = [place.numbers("inertial/inertia", key, 1, _MAX_KG_M2, "0")[0] for key in _MOMENTS]
    own = Inertial(mass_kg, (0.0, 0.0, 0.0), tuple(moments))  # pyright: ignore[reportArgumentType]
    frame = Transform.at(*place.frame("inertial/origin"))
    principal, axes = np.linalg.eigh(own.tensor())
    least = float(principal[0])
    if least >= -1e-9 * max(map(abs, moments)):
        return own.seen_from(frame), ""
    raised = np.maximum(principal, _MIN_SHARE * np.abs(principal).max())
    nearest = inertial(mass_kg, np.zeros(3), axes @ np.diag(raised) @ axes.T)
    fault = place.wrong(
        f"has a principal moment of inertia of {least:.3g} kg m²; none is below 0: "
        f"{raised[0]:.3g} is taken, correct its <inertia>"
    )
    return nearest.seen_from(frame), str(fault)


def _joint(place: _Place, links: Mapping[str, Inertial]) -> FileJoint:
    kind = place.element.get("type", "")
    if kind not in _TYPES:
        raise place.wrong(f'has type="{short_name(kind)}"; known are {", ".join(_TYPES)}')
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
        (low,) = place.numbers("limit", "lower", 1, _MAX_LIMIT, "0")
        (high,) = place.numbers("limit", "upper", 1, _MAX_LIMIT, "0")
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
