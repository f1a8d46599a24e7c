"""Read an untrusted MuJoCo model or URDF strictly: MuJoCo itself opens no file."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET  # writes; `strangers_xml` parses
from collections.abc import Mapping
from pathlib import Path, PureWindowsPath
from typing import Any

from recorders.simulators.mujoco.library import mujoco
from recorders.simulators.mujoco.model_elements import (
    check_elements,
    file_stem,
    give_memory,
    keep_physics,
    make_plain,
    without_namespace,
)
from recorders.simulators.mujoco.model_folder import ModelFolder
from recorders.simulators.mujoco.model_process import ModelProcess, ModelText
from recorders.simulators.strangers_xml import parse_xml, refuse_xacro
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import short_name

_WANTED = "--model takes a MuJoCo model (MJCF) or a URDF"
_KIND = "MuJoCo model or URDF"

_MAX_DEPTH = 16  # files that include or attach each other
_WITH_FILE = ("mesh", "flexcomp", "hfield", "skin")
_MESHES = (".stl", ".obj", ".msh")


def read_model(path: Path, home: Path | None = None, process: ModelProcess | None = None) -> Any:
    """Read a model, ready to compile; textures are plain, a URDF's visual shapes left out.

    Args:
        path: an MJCF or a URDF.
        home: another folder that its meshes and included files may come from; beside its own, and
            the ROS package that it lies in.
        process: where it is compiled once before; by default one of its own.

    Returns:
        A `mujoco.MjSpec`, with its meshes in it.

    Raises:
        UsageError: it cannot be read, names files outside its folder, runs foreign code, or
            MuJoCo does not compile it within bounds of time, memory and size; with the path first.
    """
    folder = ModelFolder(path, home)
    reader = _ModelReader(folder)
    data = folder.read(folder.path, f"{path}:", is_xml=True)
    text = ModelText(reader.prepared(folder.path, data, ()), reader.models, reader.files)
    (process or ModelProcess(path)).check_compiles(text)
    try:
        return mujoco().MjSpec.from_string(text.xml, include=text.models, assets=text.files)
    except (ValueError, RuntimeError) as error:  # it was read a moment ago
        raise UsageError(f"{path}: MuJoCo does not read it", "try it again") from error


class _ModelReader:
    """Gathers the files of a model, and renames them in its XML."""

    def __init__(self, folder: ModelFolder) -> None:
        self.folder = folder
        self.models: dict[str, bytes] = {}
        self.files: dict[str, bytes] = {}
        self._names: dict[Path, str] = {}

    def prepared(self, path: Path, data: bytes, above: tuple[Path, ...]) -> str:
        """Return a model's XML, includes resolved; `above` are the models that attach it."""
        named = path if above else self.folder.named
        root = parse_xml(data, named, _KIND, _WANTED)
        without_namespace(root)
        folders = [path.parent]
        if root.tag == "mujoco":
            self._include(root, folders, {path}, 1)
        elif root.tag == "robot":
            refuse_xacro(root, named)
            keep_physics(root)
        else:
            raise UsageError(f"{named}: begins with <{short_name(root.tag)}>", _WANTED)
        check_elements(root, named)
        give_memory(root)
        self._gather(root, folders, (*above, path))
        return ET.tostring(root, encoding="unicode")

    def _include(self, root: ET.Element, folders: list[Path], seen: set[Path], depth: int) -> None:
        """Replace each <include> by its file's content."""
        for parent in list(root.iter()):
            for child in [one for one in parent if one.tag.lower() == "include"]:
                reference = child.get("file", "")
                path = self.folder.find([reference], folders, "include")
                if path in seen or depth >= _MAX_DEPTH:
                    why = "twice, or in itself" if path in seen else f"over {_MAX_DEPTH} deep"
                    raise UsageError(
                        f"{self.folder.named}: includes {short_name(reference)} {why}",
                        "include each file once",
                    )
                seen.add(path)
                data = self.folder.read(path, self.folder.names("include", reference), is_xml=True)
                part = parse_xml(data, path, _KIND, "include the XML of a MuJoCo model")
                if part.tag not in ("mujoco", "mujocoinclude"):
                    raise UsageError(
                        f"{path}: begins with <{short_name(part.tag)}>",
                        "include the XML of a MuJoCo model, which begins with <mujoco>",
                    )
                if path.parent not in folders:
                    folders.append(path.parent)
                self._include(part, folders, seen, depth + 1)
                index = list(parent).index(child)
                parent[index : index + 1] = list(part)

    def _gather(self, root: ET.Element, folders: list[Path], above: tuple[Path, ...]) -> None:
        """Read the files that elements name, and rename them."""
        is_urdf = root.tag == "robot"
        options = _compiler(root)
        folder = options.get("meshdir", options.get("assetdir", "")).replace("\\", "/")
        places = [place / folder for place in folders] + (folders if is_urdf else [])
        key = "filename" if is_urdf else "file"
        for element in root.iter():
            tag, reference = element.tag, element.get(key)
            if tag == "texture":
                make_plain(element)
            elif tag == "model" and reference is not None:
                element.set(key, self._attached(reference, folders, above))
            elif tag in _WITH_FILE and reference is not None:
                if not is_urdf and tag in ("mesh", "hfield"):
                    element.attrib.setdefault("name", file_stem(reference))
                ways = _references(reference, options.get("strippath"), is_urdf=is_urdf)
                element.set(key, self._file(tag, ways, places))
            for name, value in element.attrib.items():
                if name.lower().startswith("file") and value not in self._names.values():
                    raise UsageError(
                        f"{self.folder.named}: <{short_name(tag)} {short_name(name)}=...> names a "
                        "file, which MuJoCo reads in no such element",
                        "remove it",
                    )

    def _attached(self, reference: str, folders: list[Path], above: tuple[Path, ...]) -> str:
        path = self.folder.find([reference], folders, "model")
        if path in above or len(above) >= _MAX_DEPTH:
            why = "itself" if path in above else f"models over {_MAX_DEPTH} deep"
            raise UsageError(
                f"{self.folder.named}: attaches {why} by {short_name(reference)}",
                "attach another model",
            )
        if path not in self._names:
            data = self.folder.read(path, self.folder.names("model", reference), is_xml=True)
            xml = self.prepared(path, data, above).encode()
            self.models[self._new_name(path)] = xml
        return self._names[path]

    def _file(self, tag: str, references: list[str], places: list[Path]) -> str:
        path = self.folder.find(references, places, tag)
        if tag == "mesh" and path.suffix.lower() not in _MESHES:
            raise UsageError(
                f"{self.folder.names(tag, references[0])} cannot be a mesh; MuJoCo reads "
                f"{', '.join(_MESHES)}",
                "convert it to .obj",
            )
        if path not in self._names:
            data = self.folder.read(path, self.folder.names(tag, references[0]))
            self.files[self._new_name(path)] = data
        return self._names[path]

    def _new_name(self, path: Path) -> str:
        """Make a unique name without a folder, not differing in case alone."""
        stem = re.sub(r"[^\w-]", "_", path.stem)[:60]
        taken = {name.lower() for name in self._names.values()}
        name = f"{stem}{path.suffix.lower()}"
        if name.lower() in taken:
            name = f"{stem}-{len(taken)}{path.suffix.lower()}"
        self._names[path] = name
        return name


def _compiler(root: ET.Element) -> Mapping[str, str]:
    """Merge the settings of all <compiler>s, the last first, and drop those of files."""
    found: dict[str, str] = {}
    for element in root.iter("compiler"):
        found |= element.attrib
        for key in ("meshdir", "texturedir", "assetdir", "strippath"):
            element.attrib.pop(key, None)
    return found


def _references(reference: str, strippath: str | None, *, is_urdf: bool) -> list[str]:
    """Return the paths to try for a file: MuJoCo strips folders if `strippath` is set."""
    bare = PureWindowsPath(reference).name
    if strippath == "true":
        return [bare, reference]
    return [reference, bare] if is_urdf and strippath is None else [reference]
