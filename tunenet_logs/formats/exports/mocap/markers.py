"""Tracks side by side, as motion capture exports them: three columns for each body or marker."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from tunenet_logs.episode import UNSTATED
from tunenet_logs.formats.tables.meaning import LENGTHS

_UNLABELED = re.compile(r"(?:.*:)?(?:\*\d+|unlabell?ed.*|unidentified.*|new ?\d+)", re.IGNORECASE)


@dataclass(frozen=True)
class MarkerTrack:
    """One body or marker.

    Attributes:
        name: as the file has it, each once.
        columns: of x, y and z.
        unit: of its coordinates, as in `position_signal`.
        is_unlabeled: whether no one named it: its name says nothing, and there may be hundreds.
    """

    name: str
    columns: tuple[int, int, int]
    unit: str
    is_unlabeled: bool = False


@dataclass(frozen=True)
class MarkerTracks:
    """What a file's header says of its tracks.

    Attributes:
        what: the file is: "OptiTrack Motive export", ...
        tracks: in the order in which they are to be shown.
        frame: column of the frame's number; None: rows are counted.
        time: column of the time [s]; None where there is none.
        sub_frame: column of parts of a frame.
        rate_hz: frames a second; None where the file does not say.
        frames: as many as the file says that it holds; None where it does not.
        zero_is_unseen: whether 0, 0, 0 is how a marker is written that was not seen.
        unused: what else it holds, by name: why that is not used.
        warnings: what is doubtful, in words.
    """

    what: str
    tracks: Sequence[MarkerTrack]
    frame: int | None = None
    time: int | None = None
    sub_frame: int | None = None
    rate_hz: float | None = None
    frames: int | None = None
    zero_is_unseen: bool = False
    unused: Mapping[str, str] = field(default_factory=dict)
    warnings: Sequence[str] = ()

    @property
    def named(self) -> str:
        """What the file is, with its article."""
        return f"{'an' if self.what[:1] in 'AEIO' else 'a'} {self.what}"

    @property
    def columns(self) -> list[int]:
        """All that are to be read, increasing."""
        clocks = (self.frame, self.time, self.sub_frame)
        used = {index for track in self.tracks for index in track.columns}
        return sorted(used | {index for index in clocks if index is not None})


def is_unlabeled(name: str) -> bool:
    """Whether a program made a name up, for a marker that no one named."""
    return not name or _UNLABELED.fullmatch(name) is not None


def unique(names: Iterable[str]) -> list[str]:
    """The same names, with " (2)", " (3)" behind those that stand there again."""
    used: dict[str, int] = {}
    found: list[str] = []
    for name in names:
        taken = name or "unnamed"
        while taken in used:
            used[name] = used.get(name, 1) + 1
            taken = f"{name or 'unnamed'} ({used[name]})"
        used.setdefault(taken, 1)
        found.append(taken)
    return found


def unit_of(text: str) -> str:
    """A unit of length as a file names it, one of `LENGTHS`; `UNSTATED` where it is none."""
    unit = text.strip().lower()
    return unit if unit in LENGTHS else UNSTATED


def rate_of(text: str | None) -> float | None:
    """A rate as a file names it [Hz]; None where it is none."""
    try:
        value = float((text or "").replace(",", "."))
    except ValueError:
        return None
    return value if math.isfinite(value) and 0.01 < value < 1e6 else None


def count_of(text: str | None) -> int | None:
    """A count as a file names it; None where it is none."""
    text = re.sub(r"\.0*$", "", (text or "").strip())
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 12 else None
