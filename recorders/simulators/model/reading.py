"""Read an untrusted MuJoCo model or URDF strictly, and compile and run it in a sandboxed process.

MuJoCo itself opens no file: the XML is checked and normalised here, and its files are read from its
own folder alone, bounded in size and number. MuJoCo's errors are reported on one line.
"""

from __future__ import annotations

import json
import math
import os
import pickle
import re
import signal
import subprocess
import sys
import weakref
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tunenet_logs.episode import Array
from tunenet_logs.errors import CHECK_DISK, LogError, UsageError
from tunenet_logs.files import (
    MAX_XML_BYTES,
    check_depth,
    parse_xml,
    read_small_file,
    real_path,
    refuse_xacro,
)
from tunenet_logs.process import end_child, signals_held
from tunenet_logs.recorders.simulators.model.child import (
    COMPILING_S,
    MAX_ROLLOUT_S,
    MEMORY_BYTES,
    PIECE_S,
)
from tunenet_logs.recorders.simulators.mujoco import mujoco
from tunenet_logs.terminal import one_line, short_name

# ---- XML: no foreign code, finite numbers, few copies

_MAX_COPIES = 100_000  # elements of a model after <replicate> and <flexcomp>
_MAX_VALUES = 100_000  # of each counter in <size>: user values and keyframes
# Legacy sizes of the working memory, and what replaces them: a thousand contacts fit.
_OLD_SIZES, _MEMORY = ("njmax", "nconmax", "nstack"), "100M"
_CODE_TAGS = ("plugin", "extension")
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
        if tag in _CODE_TAGS:
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


# ---- Files: only from the model's own folder, bounded in size and number

# Of a mesh or height field, of all files together, and of all XML.
_MAX_FILE_BYTES, _MAX_ALL_BYTES, _MAX_ALL_XML_BYTES = 64_000_000, 256_000_000, 16_000_000

_MAX_FILES = 2000
_MAX_PARENTS = 32  # folders above the model where its package is sought
_SCHEME = re.compile(r"(package|model|file)://+(.*)", re.DOTALL)


class ModelFolder:
    """A reader of a model's files that opens none outside its folder or its package.

    Args:
        home: the folder that its files may come from; by default its own, and the package that it
            lies in (the nearest folder above with a package.xml).

    Attributes:
        path: the model's file, links resolved.
        folder: its folder.
    """

    def __init__(self, path: Path, home: Path | None) -> None:
        self.named = path
        self.path = real_path(path)
        self.folder = self.path.parent
        parents = [self.folder, *self.folder.parents][:_MAX_PARENTS]
        package = next((one for one in parents if (one / "package.xml").is_file()), self.folder)
        self._homes = [self.folder, package, *([real_path(home)] if home else [])]
        self._parents = parents
        self._bytes = self._xml_bytes = self._files = 0

    def names(self, tag: str, reference: str) -> str:
        """Begin an error message on a file that `<tag>` names."""
        return f'{self.named}: <{tag}> names "{short_name(reference)}", which'

    def find(self, references: Sequence[str], places: Sequence[Path], tag: str) -> Path:
        """Resolve a file that `<tag>` names to its real path.

        Args:
            references: ways to name it, the model's own among them: a path, or package://NAME/PATH.
            places: folders that a path starts from, the first first.
            tag: of the element that names it.

        Raises:
            UsageError: it is not there, or outside the model's folder.
        """
        is_outside = False
        for reference in references:
            for candidate in self._candidates(reference, places):
                real = real_path(candidate)
                if not any(real.is_relative_to(home) for home in self._homes):
                    is_outside = True
                elif _is_there(real):
                    return real
        named = self.names(tag, references[0])
        if is_outside:
            raise UsageError(
                f"{named} is outside the model's folder {short_name(self.folder)}",
                "copy it there, with the model",
            )
        raise UsageError(f"{named} is not there", "copy it beside the model, or correct the name")

    def read(self, path: Path, named: str, *, is_xml: bool = False) -> bytes:
        """Read a file that `find` returned, with tighter limits for XML.

        Raises:
            UsageError: it is no regular file, cannot be read, or is too large; `named` begins it.
        """
        try:
            data = read_small_file(path, MAX_XML_BYTES if is_xml else _MAX_FILE_BYTES)
        except LogError as error:
            raise UsageError(f"{named} is no regular file", "copy it to one") from error
        except OSError as error:
            raise UsageError(f"{named} cannot be read ({error.strerror})", CHECK_DISK) from error
        except ValueError as error:
            raise UsageError(f"{named} {error}", "make it smaller") from error
        self._files += 1
        self._bytes += len(data)
        self._xml_bytes += len(data) if is_xml else 0
        if self._files > _MAX_FILES:
            raise UsageError(f"{self.named}: names over {_MAX_FILES} files", "remove some")
        if self._bytes > _MAX_ALL_BYTES or self._xml_bytes > _MAX_ALL_XML_BYTES:
            limit = "256 MB" if self._bytes > _MAX_ALL_BYTES else "16 MB of XML"
            raise UsageError(f"{self.named}: its files have over {limit}", "make meshes smaller")
        return data

    def _candidates(self, reference: str, places: Sequence[Path]) -> Iterator[Path]:
        scheme = _SCHEME.fullmatch(reference)
        if scheme is None:
            yield from (place / _posix(reference) for place in places)
        elif scheme[1] == "file":
            yield Path("/") / _posix(scheme[2])
        else:
            package, _, rest = scheme[2].partition("/")
            yield from self._in_package(package, _posix(rest))

    def _in_package(self, package: str, rest: PurePosixPath) -> Iterator[Path]:
        """Yield a package file's candidates, from the model's folder up to the package's."""
        names = [one.name for one in self._parents]
        if package in names:
            inside = self._parents[: names.index(package) + 1]
            if _is_a_project(inside[-1]):
                if inside[-1] not in self._homes:
                    self._homes.append(inside[-1])
                yield from (parent / rest for parent in reversed(inside))
        for home in self._homes:
            yield home / package / rest
            yield home / rest


def _is_there(path: Path) -> bool:
    try:
        path.stat()
    except (OSError, ValueError):
        return False
    return True


def _is_a_project(folder: Path) -> bool:
    """Return whether a folder may be a package: no system folder, nor above a home."""
    return len(folder.parts) > 2 and not real_path(Path.home()).is_relative_to(folder)


def _posix(reference: str) -> PurePosixPath:
    return PurePosixPath(reference.replace("\\", "/"))


# ---- Process: compiles and runs a model; limited in memory and time, and its crashes stay there

_CHILD = Path(__file__).with_name("child.py")

_MAX_ANSWER_BYTES = 1_000_000  # of an answer's line of JSON
_MIN_STEP_S, _MAX_STEP_S = 1e-5, 0.1
_MAX_CHARACTERS = 240  # of an error of MuJoCo

# Line and element numbers in errors: they count in the XML that MuJoCo got, not in the user's.
_LINES = re.compile(r",? \(?line \d+\)?|, id \d+")

# Begins of error lines that name nothing in the file.
_WORTHLESS = ("Element name ''", "The static bodies of the spec were fused")

# By words of MuJoCo's error.
_REMEDIES = {
    "mass and inertia": "give that body or link a mass and inertias",
    "inertia must": "correct its <inertia>; in a URDF, "
    '<mujoco><compiler balanceinertia="true"/></mujoco> raises what is too small',
    "global coordinates": "save it with MuJoCo 2.3.3 first",
}

_FEWER = (
    "take fewer copies (<replicate>, <flexcomp>), smaller meshes, height fields or textures, fewer "
    "<option iterations>"
)


@dataclass(frozen=True)
class ModelText:
    """A model as passed to MuJoCo, with all its files by name.

    Attributes:
        xml: the model's.
        models: XML of models that are attached.
        files: meshes and height fields.
    """

    xml: str
    models: dict[str, bytes] = field(default_factory=dict[str, bytes])
    files: dict[str, bytes] = field(default_factory=dict[str, bytes])


class ModelProcess:
    """A process, limited in memory and time, that compiles and runs a model.

    It is started when first asked, and ends with this object, an error, or a signal.

    Attributes:
        path: the model's file in errors.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._child: subprocess.Popen[bytes] | None = None
        self._end: Callable[[], object] | None = None
        self._loaded: Any = None

    def check_compiles(self, text: ModelText) -> None:
        """Compile a model, and step it once.

        Raises:
            UsageError: MuJoCo does not compile it within 10 s and 400 MB, more with large files, or
                it exceeds the size limits.
        """
        path, xml = self.path, text.xml.encode()
        found, _ = self._ask("compile", xml=xml, models=text.models, files=text.files)
        if found["beyond"]:
            raise UsageError(
                f"{path}: has {found['beyond'][0]}", "keep what moved, and remove the rest"
            )
        if found["infinite"]:
            what = ", ".join(found["infinite"][:4])
            raise UsageError(
                f"{path}: compiles to values that are not finite ({what})",
                "look for sizes and masses that are too large for it",
            )
        step_s = found["timestep_s"]
        if not _MIN_STEP_S <= step_s <= _MAX_STEP_S:
            raise UsageError(
                f"{path}: has a timestep of {step_s:g} s",
                f"give one of {_MIN_STEP_S:g} to {_MAX_STEP_S:g} s in <option timestep=...>",
            )

    def run(self, model: Any, **wishes: Any) -> tuple[list[int], list[str], dict[str, Array]]:
        """Roll out a compiled model; see `child`.

        Returns:
            Of each rollout, the number of steps, and what stopped it early: "" or MuJoCo's name of
            it; and arrays of all.

        Raises:
            LogError: one of them takes too much time or memory, or crashes.
        """
        try:
            if self._loaded is not model or self._child is None:
                self._ask("load", model=model)
                self._loaded = model
            found, arrays = self._ask("run", **wishes)
        except UsageError as error:  # another log may be simulated well
            raise LogError(error.what, error.remedy) from error
        return found["kept"], found["why"], arrays

    def _ask(self, kind: str, **arguments: Any) -> tuple[dict[str, Any], dict[str, Array]]:
        """Send a request to the child; return its answer."""
        try:
            child = self._child or self._started()
            assert child.stdin is not None
            assert child.stdout is not None
            with suppress(BrokenPipeError):  # how it ended says why
                pickle.dump((kind, arguments), child.stdin, pickle.HIGHEST_PROTOCOL)
                child.stdin.flush()
            line = child.stdout.readline(_MAX_ANSWER_BYTES)
            if not line.endswith(b"\n"):
                raise self._ended(child.wait())
            found, arrays = json.loads(line), {}
            for name, shape in found["arrays"].items():
                data = child.stdout.read(8 * math.prod(shape))
                if len(data) < 8 * math.prod(shape):
                    raise self._ended(child.wait())
                arrays[name] = np.frombuffer(data).reshape(shape)
        except BaseException:  # Ctrl-C, too: what it works on is wanted no more
            self.close()
            raise
        if "error" in found:
            self.close()
            raise _refused(self.path, found["error"])
        return found, arrays

    def _started(self) -> subprocess.Popen[bytes]:
        empty = TemporaryDirectory()  # where MuJoCo leaves its log of warnings
        with signals_held():
            child = subprocess.Popen(  # noqa: S603 (our own script, without a shell)
                [sys.executable, "-P", str(_CHILD)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                cwd=empty.name,
                env={**os.environ, "MALLOC_ARENA_MAX": "2"},
            )
        self._child, self._end = child, weakref.finalize(self, _end, child, empty)
        return child

    def close(self) -> None:
        """End the process; the next request starts another."""
        if self._end is not None:
            self._end()
        self._child = self._end = self._loaded = None

    def _ended(self, code: int) -> UsageError:
        """Make the error of a process that ended."""
        if -code in (signal.SIGKILL, signal.SIGXCPU):  # the limits
            limit = COMPILING_S if self._loaded is None else PIECE_S
            return UsageError(f"{self.path}: takes MuJoCo over {limit} s at once", _FEWER)
        return UsageError(
            f"{self.path}: MuJoCo {mujoco().__version__} crashes on it (code {code})",
            "take parts away until it runs, to find the one",
        )


def _end(child: subprocess.Popen[bytes], folder: TemporaryDirectory[str]) -> None:
    end_child(child)
    folder.cleanup()


def _refused(path: Path, said: str) -> UsageError:
    """Make the error for what MuJoCo says, on one line."""
    if "ould not allocate" in said or "unknown exception" in said:
        return UsageError(
            f"{path}: takes MuJoCo over {MEMORY_BYTES // 1_000_000} MB",
            _FEWER + ", less <size memory>",
        )
    if said.startswith("slow"):
        return UsageError(
            f"{path}: one rollout would take MuJoCo {said.removeprefix('slow: ')}, over the limit "
            f"of {MAX_ROLLOUT_S:g} s",
            "choose a part of the log with --start and --end, a longer <option timestep>, fewer "
            "<option iterations>, or touch less",
        )
    lines = [line.strip() for line in _LINES.sub("", said).splitlines()]
    kept = [line for line in lines if line and not line.startswith(_WORTHLESS)]
    why = "; ".join(kept).removeprefix("XML ").removeprefix("Error: ").rstrip(".")
    remedies = (remedy for words, remedy in _REMEDIES.items() if words in why)
    return UsageError(
        f"{path}: MuJoCo {mujoco().__version__} does not take it: "
        f"{short_name(one_line(why), _MAX_CHARACTERS)}",
        next(remedies, "correct that in the file"),
    )


# ---- Model: its XML with all includes, and its files renamed to be passed to MuJoCo

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
