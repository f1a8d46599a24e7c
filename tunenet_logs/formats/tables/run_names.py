"""Split side-by-side runs of a table by the names of their columns."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from tunenet_logs.formats.tables.column_names import meaning_of
from tunenet_logs.formats.tables.meaning import TimeColumn

# A run before the name: "Data Set 1:Time(s)".
_BEFORE = re.compile(
    r"\s*((?:run|trial|data ?set|set|latest|remote data|drop|take|experiment)\b[^:]{0,40})"
    r":\s*(\S.*)",
    re.IGNORECASE,
)

# A run behind the name, and a unit behind it, perhaps: "Time (s) Run #1".
_BEHIND = re.compile(
    r"(.*\S)[\s,_]+((?:run|trial|data ?set)\s*#?\s*\d{1,6})(\s*\([^()]*\))?\s*", re.IGNORECASE
)

# A number behind the name: "t1", "Height 2 (m)".
_NUMBERED = re.compile(r"(.*[^\W\d_])[\s_]*#?(\d{1,6})(\s*\([^()]*\))?\s*")

_MAX_LENGTH = 80  # of a name that is looked at


def runs_of(header: Sequence[str]) -> list[tuple[str, str]]:
    """Return the run of each column ("" where it is of none), and its name without it."""
    marked = [without_run(name) for name in header]
    if any(run for run, _ in marked):
        return _labelled(marked)
    if by_prefix := _prefixed(header):
        return by_prefix
    return _blocks(header) or _numbered(header) or marked


def without_run(name: str) -> tuple[str, str]:
    """Split the run ("" where there is none) from a column's name."""
    if len(name) > _MAX_LENGTH:
        return "", name
    if found := _BEFORE.fullmatch(name):
        return found[1].strip().lower(), found[2]
    has_mark = any(word in name.lower() for word in ("run", "trial", "set"))
    if has_mark and (found := _BEHIND.fullmatch(name)):
        return found[2].lower(), found[1] + (found[3] or "")
    return "", name


def _prefixed(header: Sequence[str]) -> list[tuple[str, str]]:
    """Split runs named by a user, each with a time: "Bounce:Time(s)"; empty for other tables."""
    parts = [name[:_MAX_LENGTH].partition(":") for name in header]
    runs = {run for run, mark, name in parts if mark and "/" not in run and _is_time(name)}
    if not runs:
        return []
    pairs = zip(parts, header, strict=True)
    marked = [(run.strip(), rest) if run in runs else ("", name) for (run, _, rest), name in pairs]
    return _labelled(marked)


def _labelled(marked: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """Shorten run names: "run1", "latest"; empty where there is only one run."""
    runs = list(dict.fromkeys(run for run, _ in marked if run))
    if len(runs) == 1:
        return [("", name) for _, name in marked]
    short = {run: _short(run) for run in runs}
    if len(set(short.values())) < len(runs):
        short = {run: re.sub(r"\W+", "_", run).strip("_") for run in runs}
    if len(set(short.values())) < len(runs):
        short = {run: f"run{number}" for number, run in enumerate(runs, 1)}
    return [(short.get(run, ""), name) for run, name in marked]


def _short(run: str) -> str:
    digits = re.search(r"\d+", run)
    return f"run{int(digits[0])}" if digits else re.sub(r"\W+", "_", run).strip("_")


def _blocks(header: Sequence[str]) -> list[tuple[str, str]]:
    """Split runs as blocks of equal names, each of which begins with a time."""
    names = [name.strip().lower() for name in header]
    if len(set(filter(None, names))) == len(names):
        return []
    first = next((at for at, name in enumerate(names) if name and _is_time(name)), None)
    if first is None or names.count(names[first]) < 2:
        return []
    starts = [at for at, name in enumerate(names) if name == names[first]]
    ends = [*starts[1:], len(names)]
    blocks = [tuple(filter(None, names[a:b])) for a, b in zip(starts, ends, strict=True)]
    if len(set(blocks)) > 1 or len(blocks[0]) < 2:
        return []
    found = [("", name) for name in header]
    for number, (start, end) in enumerate(zip(starts, ends, strict=True), 1):
        found[start:end] = [(f"run{number}", name) for name in header[start:end]]
    return found


def _numbered(header: Sequence[str]) -> list[tuple[str, str]]:
    """Split runs by numbers behind the names, where several times are numbered and none is not."""
    if not header or len(header[0]) > _MAX_LENGTH or any(map(_is_time, header)):
        return []
    found = [_NUMBERED.fullmatch(name) if len(name) <= _MAX_LENGTH else None for name in header]
    parts = [(f"run{int(one[2])}", one[1] + (one[3] or "")) if one else None for one in found]
    times = Counter(part[0] for part in parts if part and _is_time(part[1]))
    if len(times) < 2 or max(times.values()) > 1:
        return []
    return [
        part if part and part[0] in times else ("", name)
        for part, name in zip(parts, header, strict=True)
    ]


def _is_time(name: str) -> bool:
    return isinstance(meaning_of(name), TimeColumn)
