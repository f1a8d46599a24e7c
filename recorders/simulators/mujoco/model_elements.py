"""Check and normalise a model's XML: no foreign code, finite numbers, few copies."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET  # elements; `strangers_xml` parses
from contextlib import suppress
from pathlib import Path, PureWindowsPath

from recorders.simulators.strangers_xml import check_depth
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import short_name

_MAX_COPIES = 100_000  # elements of a model after <replicate> and <flexcomp>
_MAX_VALUES = 100_000  # of each counter in <size>: user values and keyframes
# Of a model's working memory: a thousand contacts fit.
_OLD_SIZES, _MEMORY = ("njmax", "nconmax", "nstack"), "100M"

_CODE = ("plugin", "extension")
_NAMES = ("name", "class", "childclass", "prefix")
_NOT_FINITE = re.compile(r"nan|inf|e\+?\d{3}", re.IGNORECASE)


def check_elements(root: ET.Element, path: Path) -> None:
    """Refuse elements that run code, are not finite, or make a model excessively large.

    Raises:
        UsageError: there is such an element; `path` stands first.
    """
    check_depth(root, path)
    stack, total = [(root, 1)], 0
    while stack:
        element, copies = stack.pop()
        tag = element.tag.lower()
        if tag in _CODE:
            raise UsageError(
                f"{path}: has a <{tag}>, and plugins run code of others, which is never done here",
                "remove it, and what it does",
            )
        _check_values(element, path)
        own = copies * _copies(element, tag)
        total += own
        if total > _MAX_COPIES:
            raise UsageError(
                f"{path}: has over {_MAX_COPIES} elements, copies of <{tag}> counted",
                "lower the count in <replicate> or <flexcomp>",
            )
        stack += [(child, own) for child in element]


def give_memory(root: ET.Element) -> None:
    """Replace the three legacy memory sizes, some of which take GBs, by `memory`."""
    for size in root.iter("size"):
        old = [size.attrib.pop(key) for key in _OLD_SIZES if key in size.attrib]
        if old:
            size.attrib.setdefault("memory", _MEMORY)


def without_namespace(root: ET.Element) -> None:
    """Strip the root element's XML namespace from all elements."""
    if root.tag.startswith("{"):
        space = root.tag[: root.tag.index("}") + 1]
        for element in root.iter():
            element.tag = element.tag.removeprefix(space)


def keep_physics(robot: ET.Element) -> None:
    """Remove from a URDF what moves no link: visual shapes, and extensions."""
    robot[:] = [part for part in robot if part.tag in ("link", "joint", "mujoco")]
    for part in robot:
        if part.tag == "link":
            part[:] = [one for one in part if one.tag in ("inertial", "collision")]
        elif part.tag == "mujoco":
            part[:] = [one for one in part if one.tag.lower() != "include"]


def make_plain(texture: ET.Element) -> None:
    """Replace a texture's files by one colour: physics sees none."""
    files = [value for key, value in texture.attrib.items() if key.startswith("file")]
    if files:
        said, kept = dict(texture.attrib), {"name", "type", "class"} & texture.attrib.keys()
        texture.attrib.clear()
        texture.attrib |= {"name": file_stem(files[0])} | {key: said[key] for key in kept}
        texture.attrib |= {"builtin": "flat", "width": "1", "height": "1"}


def file_stem(reference: str) -> str:
    """Return MuJoCo's name for an element that has a file and no name."""
    return PureWindowsPath(reference).stem


def _check_values(element: ET.Element, path: Path) -> None:
    for key, value in element.attrib.items():
        what = f'{path}: <{short_name(element.tag)} {short_name(key)}="{short_name(value)}">'
        if key not in _NAMES and _NOT_FINITE.search(value) and not _is_finite(value):
            raise UsageError(f"{what} is not finite", "give a finite number")
        is_counter = element.tag == "size" and key.startswith(("nuser", "nkey"))
        if is_counter and (_number(value) or 0) > _MAX_VALUES:
            raise UsageError(f"{what} is over the limit of {_MAX_VALUES}", "lower it")


def _is_finite(text: str) -> bool:
    """Return whether a text is no list of numbers, or one of finite ones."""
    numbers = [_number(word) for word in text.split()]
    return None in numbers or all(map(math.isfinite, numbers))  # pyright: ignore[reportArgumentType]


def _copies(element: ET.Element, tag: str) -> int:
    """Count the copies of an element and all in it."""
    if tag not in ("replicate", "flexcomp"):
        return 1
    counts = [_number(word) or 1.0 for word in element.get("count", "1").split()]
    return int(min(max(math.prod(counts), 1.0), 1e9))


def _number(text: str) -> float | None:
    with suppress(ValueError):
        return float(text)
    return None
