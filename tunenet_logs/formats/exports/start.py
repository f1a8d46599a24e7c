"""First bytes of a file, from which its format is detected."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from tunenet_logs.formats.tables.lines import encoding_of, is_text
from tunenet_logs.regular_file import open_regular

_BYTES = 65536  # looked at of a file


@dataclass(frozen=True, eq=False)
class Start:
    """The first bytes of a file.

    Attributes:
        path: of the file.
        data: up to 64 KiB.
    """

    path: Path
    data: bytes

    @property
    def suffix(self) -> str:
        """Suffix of the file's name, in lower case, with the dot."""
        return self.path.suffix.lower()

    @property
    def is_text(self) -> bool:
        """Whether the file is text, regardless of its name."""
        return is_text(self.data, self.suffix)

    @cached_property
    def lines(self) -> tuple[str, ...]:
        """Lines of the text, the last one perhaps cut; empty for a binary file."""
        encoding = encoding_of(self.data)
        if not self.is_text or (b"\0" in self.data and encoding in (None, "utf-8-sig", "cp1252")):
            return ()
        return tuple(self.data.decode(encoding or "utf-8", "replace").splitlines())


def start_of(path: Path) -> Start:
    """Read the first bytes of a file.

    Raises:
        OSError: it cannot be read.
    """
    with open_regular(path) as file:
        return Start(path, file.read(_BYTES))
