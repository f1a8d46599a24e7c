"""Group image files into sequences by their names, in order, and stamp them."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise
from math import gcd
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import FRAME_NS
from tunenet_logs.formats.read_options import ReadOptions

# Of files that are taken for pictures.
SUFFIXES = frozenset(
    {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm", ".pnm"}
)

MAX_PICTURES = 200_000  # of one folder or archive
_NUMBER = re.compile(r"\d+")

_MAX_NUMBER = 19  # digits of a number that counts or is a time; a longer one is a digest's
# Of the numbers from the first to the last: where more are missing, they count something else.
_MAX_LEFT_OUT = 0.5

# A time since 1970 in a name, as data sets of cameras write it.
_SECONDS = re.compile(r"(?<!\d)(\d{10})\.(\d{1,9})(?!\d)")

# Nanoseconds of a time's unit, by how many digits a time of this century has in it.
_TIME_DIGITS = {19: 1, 16: 1000, 13: 1_000_000}

_TIMES_NS = (10**18, 4 * 10**18)  # from 2001 to 2096


@dataclass(frozen=True)
class Series:
    """One image sequence.

    Attributes:
        name: common part of the file names.
        files: their names, in order.
        numbers: counters in the names, shape (T,), strictly increasing; empty without one counter.
    """

    name: str
    files: tuple[str, ...]
    numbers: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class PictureTimes:
    """Stamps of an image sequence.

    Attributes:
        stamps_ns: int64, shape (T,), strictly increasing.
        rate: in words.
        is_timed: whether the stamps are times; else they count frames, `FRAME_NS` each.
        warnings: what is doubtful, in words.
    """

    stamps_ns: NDArray[np.int64]
    rate: str
    is_timed: bool
    warnings: tuple[str, ...]


def series_of(names: Iterable[str]) -> list[Series]:
    """Group file names into image sequences, the longest first."""
    alike: dict[str, list[str]] = defaultdict(list)
    for name in names:
        alike[_NUMBER.sub("#", name)].append(name)
    found = [one for group in alike.values() for one in _divided(group)]
    shared = Counter(one.name for one in found)
    found = [
        Series(one.name + PurePosixPath(one.files[0]).suffix, one.files, one.numbers)
        if shared[one.name] > 1
        else one
        for one in found
    ]
    return sorted(found, key=lambda one: (-len(one.files), one.name))


def taken(series: Series, options: ReadOptions) -> PictureTimes:
    """Stamp a sequence by `--fps`, else by the times in its names, else by counting frames."""
    times_ns = _times_ns(series.files)
    rate_hz = options.rate_hz
    if rate_hz is None and times_ns is not None:
        return PictureTimes(times_ns, "by the times in the names", is_timed=True, warnings=())
    counts, warnings = _counts(series) if times_ns is None else (np.arange(len(series.files)), [])
    if rate_hz is not None:
        stamps_ns = np.round(counts * (1e9 / rate_hz)).astype(np.int64)
        return PictureTimes(
            stamps_ns, f"{rate_hz:g}, as said", is_timed=True, warnings=tuple(warnings)
        )
    warnings.append(
        f"{series.name}: nothing says how many pictures a second there are; say it with --fps"
    )
    return PictureTimes(counts * FRAME_NS, "unknown", is_timed=False, warnings=tuple(warnings))


def _divided(names: list[str]) -> list[Series]:
    """Split names that differ in numbers alone by all of these but the counter."""
    texts = {name: _NUMBER.findall(name) for name in names}
    columns = list(zip(*texts.values(), strict=True))
    if not columns or max(len(text) for column in columns for text in column) > _MAX_NUMBER:
        return [Series(name, (name,), ()) for name in names]
    kinds = [len(set(column)) for column in columns]
    counter = max(range(len(kinds)), key=lambda at: (kinds[at], at))
    takes: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for name, numbers in texts.items():
        takes[(*numbers[:counter], *numbers[counter + 1 :])].append(name)
    if 2 * len(takes) > len(names):  # dates and times: all of them count together
        ordered = sorted(names, key=lambda name: ([int(text) for text in texts[name]], name))
        return [Series(_label(ordered[0], -1), tuple(ordered), ())]
    return [_counted(take, texts, counter) for take in takes.values()]


def _counted(names: list[str], texts: dict[str, list[str]], counter: int) -> Series:
    """Return the sequence of names that one number counts."""
    ordered = sorted(names, key=lambda name: (int(texts[name][counter]), name))
    numbers = [int(texts[name][counter]) for name in ordered]
    is_strict = all(first < second for first, second in pairwise(numbers))
    return Series(_label(ordered[0], counter), tuple(ordered), tuple(numbers) if is_strict else ())


def _label(name: str, counter: int) -> str:
    """Return a name without its suffix and its counter; -1 is the last number."""
    stem = str(PurePosixPath(name).with_suffix(""))
    found = list(_NUMBER.finditer(stem))
    if not -len(found) <= counter < len(found):
        return stem
    begin, end = found[counter].span()
    return (stem[:begin] + stem[end:]).strip(" ._-/()") or "pictures"


def _counts(series: Series) -> tuple[NDArray[np.int64], list[str]]:
    """Return frame counts that keep the gaps in the numbers, shape (T,), and doubts."""
    ranks = np.arange(len(series.files))
    if len(series.numbers) < 3:
        return ranks, []
    steps = [second - first for first, second in pairwise(series.numbers)]
    unit = gcd(*steps)
    last = sum(steps) // unit
    missing = last - ranks[-1]
    if missing > _MAX_LEFT_OUT * last:
        return ranks, [f"{series.name}: their numbers leap; the pictures are counted instead"]
    counts = np.concatenate([[0], np.cumsum(np.array(steps, np.int64) // unit)])
    said = f"{series.name}: {missing} numbers between the first and the last have no picture"
    return counts, [said] if missing else []


def _times_ns(names: tuple[str, ...]) -> NDArray[np.int64] | None:
    """Return the times since 1970 in the names, shape (T,); None where they state none."""
    found = [_time_ns(PurePosixPath(name).stem) for name in names]
    if len(found) < 2 or None in found:
        return None
    stamps_ns = np.array(found, np.int64)
    return stamps_ns if np.all(np.diff(stamps_ns) > 0) else None


def _time_ns(stem: str) -> int | None:
    if match := _SECONDS.search(stem):
        return int(match[1]) * 10**9 + int(match[2].ljust(9, "0"))
    for text in _NUMBER.findall(stem):
        stamp_ns = int(text) * _TIME_DIGITS.get(len(text), 0)
        if _TIMES_NS[0] <= stamp_ns < _TIMES_NS[1]:
            return stamp_ns
    return None
