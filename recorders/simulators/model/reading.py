"""Read an untrusted MuJoCo model or URDF strictly, and compile and run it in a sandboxed process.

MuJoCo itself opens no file: the XML is checked and normalised here, and its files are read from its
own folder alone, bounded in size and number. MuJoCo's errors are reported on one line.
"""

from __future__ import annotations

import hashlib
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path, PurePosixPath, PureWindowsPath
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
from tunenet_logs.formats.sandbox import Sandbox, SandboxError
from tunenet_logs.recorders.simulators.model import child
from tunenet_logs.recorders.simulators.mujoco import mujoco
from tunenet_logs.terminal import one_line, short_name

# ---- XML: no foreign code, finite numbers, few copies

_MAX_COPIES = 100_000  # elements of a model after <replicate> and <flexcomp>
_MAX_VALUES = 100_000  # of each counter in <size>: user values and keyframes
_NAMES = ("name", "class", "childclass", "prefix")
_NOT_FINITE = re.compile(r"nan|inf|e\+?\d{3}", re.IGNORECASE)


def check_elements(root: ET.Element, path: Path) -> None:
    """Refuse elements that run code, are not finite, or make a model excessively large."""
    check_depth(root, path)
    stack, total = [(root, 1)], 0
    while stack:
        element, copies = stack.pop()
        tag = element.tag.lower()
        if tag in ("plugin", "extension"):
            raise UsageError(
                f"{path}: has a <{tag}>, and plugins run code of others, which is never done here",
                "remove it, and what it does",
            )
        for key, value in element.attrib.items():
            what = f'{path}: <{short_name(element.tag)} {short_name(key)}="{short_name(value)}">'
            if key not in _NAMES and _NOT_FINITE.search(value):
                numbers = [_number(word) for word in value.split()]
                if None not in numbers and not all(math.isfinite(one or 0.0) for one in numbers):
                    raise UsageError(f"{what} is not finite", "give a finite number")
            is_counter = element.tag == "size" and key.startswith(("nuser", "nkey"))
            if is_counter and (_number(value) or 0) > _MAX_VALUES:
                raise UsageError(f"{what} is over the limit of {_MAX_VALUES}", "lower it")
        own = copies
        if tag in ("replicate", "flexcomp"):
            counts = [_number(word) or 1.0 for word in element.get("count", "1").split()]
            own *= int(min(max(math.prod(counts), 1.0), 1e9))
        total += own
        if total > _MAX_COPIES:
            raise UsageError(
                f"{path}: has over {_MAX_COPIES} elements, copies of <{tag}> counted",
                "lower the count in <replicate> or <flexcomp>",
            )
        stack += [(inner, own) for inner in element]


def file_stem(reference: str) -> str:
    """Return MuJoCo's name for an element that has a file and no name."""
    return PureWindowsPath(reference).stem


def _number(text: str) -> float | None:
    with suppress(ValueError):
        return float(text)
    return None


# ---- Process: compiles and runs a model; limited in memory and time, and its crashes stay there

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


class ModelProcess:
    """A sandbox that compiles and runs a model.

    It is started when first asked, and ends with this object, an error, or a signal.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._empty = TemporaryDirectory()  # where MuJoCo leaves its log of warnings
        self._sandbox = Sandbox(
            "mujoco",
            memory_bytes=None,  # it limits its own
            cpu_s=child.COMPILING_S,
            wall_s=None,
            folder=self._empty.name,
        )
        self._loaded: Any = None
        self.models: dict[Any, Any] = {}  # compiled ones, by what they sense and what is tuned

    def close(self) -> None:
        """End it; the next request starts another."""
        self._sandbox.close()
        self._loaded = None

    def check_compiles(
        self, xml: str, models: Mapping[str, bytes], files: Mapping[str, bytes]
    ) -> None:
        """Compile a model of its XML, that of attached models and other files, and step it once.

        UsageError where MuJoCo does not compile it within 10 s and 400 MB, more with large files,
        or it exceeds the size limits.
        """
        path = self.path
        every = {"": xml.encode(), **models, **files}
        arrays = {name: np.frombuffer(data, np.uint8) for name, data in every.items()}
        found, _ = self._ask(child.compile_model, list(models), arrays=arrays)
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

    def run(
        self,
        model: Any,
        *,
        rows: Sequence[child.Row],
        controls: Sequence[Array],
        columns: Sequence[int],
        wants_qpos: bool,
        **settings: Any,
    ) -> tuple[list[int], list[str], dict[str, Array]]:
        """Roll out a compiled model; see `child`.

        Returns the number of steps of each rollout, what stopped it early ("" or MuJoCo's name of
        it), and arrays of all. LogError where one takes too much time or memory, or crashes.
        """
        words, arrays = child.packed(rows, controls)
        settings["columns"] = [int(one) for one in columns]
        try:
            if self._loaded is not model or not self._sandbox.is_running:
                self._ask(child.load, arrays=child.saved(model))
                self._loaded = model
            found, made = self._ask(child.run, words, settings, wants_qpos, arrays=arrays)
        except UsageError as error:  # another log may be simulated well
            raise LogError(error.what, error.remedy) from error
        return found["kept"], found["why"], made

    def _ask(
        self, function: Any, *arguments: Any, arrays: Mapping[str, NDArray[Any]]
    ) -> tuple[Any, dict[str, Array]]:
        """Send a request to the child; return its answer."""
        try:
            return self._sandbox.ask(function, *arguments, arrays=arrays)
        except SandboxError as error:
            was_loaded, self._loaded = self._loaded is not None, None
            if error.kind == "memory":
                raise _refused(self.path, "Could not allocate memory") from error
            if error.kind == "damaged":
                raise _refused(self.path, error.said or error.raised) from error
            if error.kind == "time":
                limit = child.PIECE_S if was_loaded else child.COMPILING_S
                raise UsageError(
                    f"{self.path}: takes MuJoCo over {limit} s at once", _FEWER
                ) from error
            raise UsageError(
                f"{self.path}: MuJoCo {mujoco().__version__} crashes on it (code {error.code})",
                "take parts away until it runs, to find the one",
            ) from error


def _refused(path: Path, said: str) -> UsageError:
    """Make the error for what MuJoCo says, on one line."""
    if "ould not allocate" in said or "unknown exception" in said:
        return UsageError(
            f"{path}: takes MuJoCo over {child.MEMORY_BYTES // 1_000_000} MB",
            _FEWER + ", less <size memory>",
        )
    if said.startswith("slow"):
        return UsageError(
            f"{path}: one rollout would take MuJoCo {said.removeprefix('slow: ')}, over the limit "
            f"of {child.MAX_ROLLOUT_S:g} s",
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


# ---- Model: its XML with all includes, and its files, bounded and renamed to be passed to MuJoCo

_WANTED = "--model takes a MuJoCo model (MJCF) or a URDF"
_KIND = "MuJoCo model or URDF"

_MAX_DEPTH = 16  # files that include or attach each other
_WITH_FILE = ("mesh", "flexcomp", "hfield", "skin")
_MESHES = (".stl", ".obj", ".msh")
# Of a mesh or height field, of all files together, and of all XML.
_MAX_FILE_BYTES, _MAX_ALL_BYTES, _MAX_ALL_XML_BYTES = 64_000_000, 256_000_000, 16_000_000

_MAX_FILES = 2000
_SCHEME = re.compile(r"(package|model|file)://+(.*)", re.DOTALL)


def read_model(path: Path, home: Path | None = None, process: ModelProcess | None = None) -> Any:
    """Read a model, ready to compile; textures are plain, a URDF's visual shapes left out."""
    return ModelFiles(path, home).spec(process)


class ModelFiles:
    """A model's files, none outside its folder or package, renamed in its XML as MuJoCo gets it.

    Attributes:
        xml: The model's XML, includes resolved.
        texts: Text of the model and of what it includes, by their real paths, its own first.
        includes: Path of each included file, by that of the including one and the name in it.
        models: XML of attached models, by their new names.
        files: Meshes and height fields, by their new names.
    """

    def __init__(
        self, path: Path, home: Path | None = None, texts: Mapping[Path, bytes] | None = None
    ) -> None:
        """Read all files; `texts` are read in place of what is on the disk."""
        self.named, self._instead = path, texts or {}
        self.path = real_path(path)  # the model's file, links resolved
        self.folder = self.path.parent  # its folder
        parents = [self.folder, *self.folder.parents][:32]  # where its package is sought
        package = next((one for one in parents if (one / "package.xml").is_file()), self.folder)
        self._homes = [self.folder, package, *([real_path(home)] if home else [])]
        self._parents = parents
        self._bytes = self._xml_bytes = self._count = 0
        self.models: dict[str, bytes] = {}
        self.files: dict[str, bytes] = {}
        self._names: dict[Path, str] = {}
        self.includes: dict[tuple[Path, str], Path] = {}
        own = self.read(self.path, f"{path}:", is_xml=True)
        self.texts = {self.path: own}
        self.xml = self.prepared(self.path, own, ())

    @property
    def sha256(self) -> str:
        """SHA-256 of what MuJoCo gets: comments, pictures and spaces between elements aside."""
        state = hashlib.sha256(re.sub(r">\s+<", "><", self.xml).encode())
        for name, data in sorted({**self.models, **self.files}.items()):
            state.update(f"\0{name}\0{len(data)}\0".encode() + data)
        return state.hexdigest()

    def spec(self, process: ModelProcess | None = None) -> Any:
        """Check in a child that it compiles, and return its spec; else UsageError."""
        path = self.named
        (process or ModelProcess(path)).check_compiles(self.xml, self.models, self.files)
        try:
            return mujoco().MjSpec.from_string(self.xml, include=self.models, assets=self.files)
        except (ValueError, RuntimeError) as error:  # it was read a moment ago
            raise UsageError(f"{path}: MuJoCo does not read it", "try it again") from error

    def names(self, tag: str, reference: str) -> str:
        """Begin an error message on a file that `<tag>` names."""
        return f'{self.named}: <{tag}> names "{short_name(reference)}", which'

    def find(self, references: Sequence[str], places: Sequence[Path], tag: str) -> Path:
        """Resolve a file that `<tag>` names to its real path."""
        is_outside = False
        for reference in references:
            for candidate in self._candidates(reference, places):
                real = real_path(candidate)
                if not any(real.is_relative_to(home) for home in self._homes):
                    is_outside = True
                else:
                    with suppress(OSError, ValueError):
                        real.stat()
                        return real
        named = self.names(tag, references[0])
        if is_outside:
            raise UsageError(
                f"{named} is outside the model's folder {short_name(self.folder)}",
                "copy it there, with the model",
            )
        raise UsageError(f"{named} is not there", "copy it beside the model, or correct the name")

    def read(self, path: Path, named: str, *, is_xml: bool = False) -> bytes:
        """Read a file that `find` returned, with tighter limits for XML."""
        try:
            data = self._instead.get(path)
            if data is None:
                data = read_small_file(path, MAX_XML_BYTES if is_xml else _MAX_FILE_BYTES)
        except LogError as error:
            raise UsageError(f"{named} is no regular file", "copy it to one") from error
        except OSError as error:
            raise UsageError(f"{named} cannot be read ({error.strerror})", CHECK_DISK) from error
        except ValueError as error:
            raise UsageError(f"{named} {error}", "make it smaller") from error
        self._count += 1
        self._bytes += len(data)
        self._xml_bytes += len(data) if is_xml else 0
        if self._count > _MAX_FILES:
            raise UsageError(f"{self.named}: names over {_MAX_FILES} files", "remove some")
        if self._bytes > _MAX_ALL_BYTES or self._xml_bytes > _MAX_ALL_XML_BYTES:
            limit = "256 MB" if self._bytes > _MAX_ALL_BYTES else "16 MB of XML"
            raise UsageError(f"{self.named}: its files have over {limit}", "make meshes smaller")
        return data

    def _candidates(self, reference: str, places: Sequence[Path]) -> Iterator[Path]:
        scheme = _SCHEME.fullmatch(reference)
        if scheme is None:
            yield from (place / _posix(reference) for place in places)
            return
        if scheme[1] == "file":
            yield Path("/") / _posix(scheme[2])
            return
        # A package file's candidates, from the model's folder up to the package's.
        package, _, inner = scheme[2].partition("/")
        rest, names = _posix(inner), [one.name for one in self._parents]
        if package in names:
            inside = self._parents[: names.index(package) + 1]
            folder = inside[-1]
            if len(folder.parts) > 2 and not real_path(Path.home()).is_relative_to(folder):
                if folder not in self._homes:
                    self._homes.append(folder)
                yield from (parent / rest for parent in reversed(inside))
        for home in self._homes:
            yield home / package / rest
            yield home / rest

    def prepared(self, path: Path, data: bytes, above: tuple[Path, ...]) -> str:
        """Return a model's XML, includes resolved; `above` are the models that attach it."""
        named = path if above else self.named
        root = parse_xml(data, named, _KIND, _WANTED)
        if root.tag.startswith("{"):  # without its XML namespace
            space = root.tag[: root.tag.index("}") + 1]
            for element in root.iter():
                element.tag = element.tag.removeprefix(space)
        folders = [path.parent]
        if root.tag == "mujoco":
            self._include(root, path, folders, {path})
        elif root.tag == "robot":
            refuse_xacro(root, named)
            # Remove what moves no link: visual shapes, and extensions.
            root[:] = [part for part in root if part.tag in ("link", "joint", "mujoco")]
            for part in root:
                if part.tag == "link":
                    part[:] = [one for one in part if one.tag in ("inertial", "collision")]
                elif part.tag == "mujoco":
                    part[:] = [one for one in part if one.tag.lower() != "include"]
        else:
            raise UsageError(f"{named}: begins with <{short_name(root.tag)}>", _WANTED)
        check_elements(root, named)
        # Some legacy sizes of the working memory take GBs: a thousand contacts fit in 100 MB.
        for size in root.iter("size"):
            sizes = ("njmax", "nconmax", "nstack")
            old = [size.attrib.pop(key) for key in sizes if key in size.attrib]
            if old:
                size.attrib.setdefault("memory", "100M")
        self._gather(root, folders, (*above, path))
        return ET.tostring(root, encoding="unicode")

    def _include(
        self, root: ET.Element, own: Path, folders: list[Path], seen: set[Path], depth: int = 1
    ) -> None:
        """Replace each <include> of a file by that file's content."""
        for parent in list(root.iter()):
            for found in [one for one in parent if one.tag.lower() == "include"]:
                reference = found.get("file", "")
                path = self.find([reference], folders, "include")
                if path in seen or depth >= _MAX_DEPTH:
                    why = "twice, or in itself" if path in seen else f"over {_MAX_DEPTH} deep"
                    raise UsageError(
                        f"{self.named}: includes {short_name(reference)} {why}",
                        "include each file once",
                    )
                seen.add(path)
                data = self.read(path, self.names("include", reference), is_xml=True)
                self.texts[path], self.includes[own, reference] = data, path
                part = parse_xml(data, path, _KIND, "include the XML of a MuJoCo model")
                if part.tag not in ("mujoco", "mujocoinclude"):
                    raise UsageError(
                        f"{path}: begins with <{short_name(part.tag)}>",
                        "include the XML of a MuJoCo model, which begins with <mujoco>",
                    )
                if path.parent not in folders:
                    folders.append(path.parent)
                self._include(part, path, folders, seen, depth + 1)
                index = list(parent).index(found)
                parent[index : index + 1] = list(part)

    def _gather(self, root: ET.Element, folders: list[Path], above: tuple[Path, ...]) -> None:
        """Read the files that elements name, and rename them."""
        is_urdf = root.tag == "robot"
        # Merge the settings of all <compiler>s, the last first, and drop those of files.
        options: dict[str, str] = {}
        for element in root.iter("compiler"):
            options |= element.attrib
            for key in ("meshdir", "texturedir", "assetdir", "strippath"):
                element.attrib.pop(key, None)
        folder = options.get("meshdir", options.get("assetdir", "")).replace("\\", "/")
        places = [place / folder for place in folders] + (folders if is_urdf else [])
        key = "filename" if is_urdf else "file"
        for element in root.iter():
            tag, reference = element.tag, element.get(key)
            if tag == "texture":
                # One colour in place of its files: physics sees none.
                if files := [value for name, value in element.items() if name.startswith("file")]:
                    kept = {"name", "type", "class"} & element.attrib.keys()
                    said = {name: element.attrib[name] for name in kept}
                    element.attrib.clear()
                    element.attrib |= {"name": file_stem(files[0])} | said
                    element.attrib |= {"builtin": "flat", "width": "1", "height": "1"}
            elif tag == "model" and reference is not None:
                path = self.find([reference], folders, "model")
                if path in above or len(above) >= _MAX_DEPTH:
                    why = "itself" if path in above else f"models over {_MAX_DEPTH} deep"
                    raise UsageError(
                        f"{self.named}: attaches {why} by {short_name(reference)}",
                        "attach another model",
                    )
                if path not in self._names:
                    data = self.read(path, self.names("model", reference), is_xml=True)
                    xml = self.prepared(path, data, above).encode()
                    self.models[self._new_name(path)] = xml
                element.set(key, self._names[path])
            elif tag in _WITH_FILE and reference is not None:
                if not is_urdf and tag in ("mesh", "hfield"):
                    element.attrib.setdefault("name", file_stem(reference))
                # MuJoCo strips folders where `strippath` is set; in a URDF where it is not, too.
                bare, strips = PureWindowsPath(reference).name, options.get("strippath")
                ways = [bare, reference] if strips == "true" else [reference]
                if is_urdf and strips is None:
                    ways.append(bare)
                element.set(key, self._file(tag, ways, places))
            for name, value in element.attrib.items():
                if name.lower().startswith("file") and value not in self._names.values():
                    raise UsageError(
                        f"{self.named}: <{short_name(tag)} {short_name(name)}=...> names a "
                        "file, which MuJoCo reads in no such element",
                        "remove it",
                    )

    def _file(self, tag: str, references: list[str], places: list[Path]) -> str:
        path = self.find(references, places, tag)
        if tag == "mesh" and path.suffix.lower() not in _MESHES:
            raise UsageError(
                f"{self.names(tag, references[0])} cannot be a mesh; MuJoCo reads "
                f"{', '.join(_MESHES)}",
                "convert it to .obj",
            )
        if path not in self._names:
            data = self.read(path, self.names(tag, references[0]))
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


def _posix(reference: str) -> PurePosixPath:
    return PurePosixPath(reference.replace("\\", "/"))
