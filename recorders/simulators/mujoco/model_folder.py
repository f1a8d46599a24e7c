"""Find and read a model's files, only in its own folder, bounded in size and number."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePosixPath

from recorders.simulators.strangers_xml import MAX_XML_BYTES
from tunenet_logs.errors import CHECK_DISK, LogError, UsageError
from tunenet_logs.regular_file import real_path
from tunenet_logs.small_files import read_small_file
from tunenet_logs.terminal import short_name

# Of a mesh or height field, of all files together, and of all XML.
_MAX_FILE_BYTES, _MAX_BYTES, _MAX_XML = 64_000_000, 256_000_000, 16_000_000

_MAX_FILES = 2000
_MAX_PARENTS = 32

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
        if self._bytes > _MAX_BYTES or self._xml_bytes > _MAX_XML:
            limit = "256 MB" if self._bytes > _MAX_BYTES else "16 MB of XML"
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
