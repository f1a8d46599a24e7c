"""Parse untrusted XML within bounds, and without a document type, where its dangers lie."""

from __future__ import annotations

import xml.etree.ElementTree as ET  # what is dangerous in it is refused
from pathlib import Path

from tunenet_logs.errors import UsageError

# Of a file: more than any robot's; what has more is refused before it costs.
MAX_XML_BYTES, _MAX_TAGS, _MAX_DEPTH = 4_000_000, 100_000, 200


def parse_xml(data: bytes, path: Path, kind: str, wanted: str) -> ET.Element:
    """Parse a file's XML; return the root element.

    Args:
        data: its bytes, at most `MAX_XML_BYTES`.
        path: its name in errors.
        kind: what it should be, such as "URDF".
        wanted: a remedy, such as "--urdf takes a robot's URDF".

    Raises:
        UsageError: it is not XML, or has more or deeper elements than any robot.
    """
    try:
        text = data.decode("utf-8-sig").lstrip()
    except UnicodeDecodeError as error:
        raise UsageError(
            f"{path}: is no text in UTF-8, so no {kind} that can be read", wanted
        ) from error
    if text.count("<") > _MAX_TAGS:
        raise UsageError(f"{path}: over {_MAX_TAGS} tags, so no {kind} of a robot", wanted)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise UsageError(
            f"{path}: has a document type, which no {kind} needs; remove <!DOCTYPE ...>"
        )
    try:
        root = ET.fromstring(text)  # noqa: S314  (bounded, and without a document type)
    except (ET.ParseError, ValueError) as error:
        raise UsageError(f"{path}: is not XML ({error})", wanted) from error
    check_depth(root, path)
    return root


def check_depth(root: ET.Element, path: Path) -> None:
    """Refuse deeply nested elements.

    Raises:
        UsageError: they are over 200 deep.
    """
    level, depth = [root], 1
    while level := [child for element in level for child in element]:
        depth += 1
        if depth > _MAX_DEPTH:
            raise UsageError(
                f"{path}: has elements in elements, over {_MAX_DEPTH} deep", "make them fewer"
            )


def refuse_xacro(root: ET.Element, path: Path) -> None:
    """Refuse an unexpanded xacro file.

    Raises:
        UsageError: it contains xacro.
    """
    is_xacro = any(
        "xacro" in element.tag or any("${" in value for value in element.attrib.values())
        for element in root.iter()
    )
    if is_xacro:
        stem = path.name.removesuffix(".xacro").removesuffix(".urdf")
        expanded = f"{stem}.urdf" if path.suffix == ".xacro" else f"{stem}_expanded.urdf"
        raise UsageError(f"{path}: is xacro; expand it first: xacro {path.name} > {expanded}")
