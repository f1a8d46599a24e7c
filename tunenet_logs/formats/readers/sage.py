"""Read a motion as SAGE records it: commands and measured states of joints in a table each.

`control.csv` and `state_motor.csv` lie side by side, on one clock, beside `joint_list.txt`; each
cell is a list of all joints (https://github.com/isaac-sim2real/sage).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path

from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError
from tunenet_logs.files import open_regular, real_path
from tunenet_logs.formats.columns.cells import cells_of, lines_of
from tunenet_logs.formats.kinds import Start, start_of
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.formats.readers.csv import read_lines

_STATES, _COMMANDS, _NAMES = "state_motor", "control", "joint_list.txt"
_HEADER = ("type", "timestamp", "positions")
_MAX_JOINTS = 200


def is_sage(start: Start) -> bool:
    """Return whether a file is a table of SAGE's commands or states."""
    rows = [tuple(cells_of(line, ",")) for line in start.lines[:2]]
    if len(rows) < 2 or rows[0][:3] != _HEADER or len(rows[1]) != len(rows[0]):
        return False
    return rows[1][0].lower() in (_STATES, _COMMANDS) and rows[1][2].startswith("[")


def is_sage_folder(folder: Path) -> bool:
    """Return whether a folder is one motion with its commands; raise OSError."""
    files = [folder / f"{one}.csv" for one in (_STATES, _COMMANDS)]
    return all(file.is_file() and is_sage(start_of(file)) for file in files)


def read_sage_folder(folder: Path, options: ReadOptions) -> Episode:
    """Read the motion of a folder."""
    return read_sage(folder / f"{_STATES}.csv", options)


def read_sage(path: Path, options: ReadOptions) -> Episode:
    """Read states and commands, whichever of the two tables is named."""
    tables = [_table(path, options)]
    if (other := _beside(path)) is not None:
        tables.append(_table(other, options))
    tables.sort(key=lambda one: any(signal.drives for signal in one.signals.values()))
    warnings = [words for one in tables for words in one.warnings]
    if len(tables) > 1 and any("moved to begin at 0" in words for words in warnings):
        what = f"{path}: a time is before 0, and commands and states share a clock"
        raise LogError(what, "write both again with times from 0")
    signals = [one for table in tables for one in table.signals.values()]
    channels = [one for table in tables for one in table.channels if one.topic != "type"]
    names = _joint_names(path)
    widths = {len(one.columns) for one in signals}
    if names and widths == {len(names)}:
        signals = [replace(one, columns=names) for one in signals]
        channels = [_named(one, names) for one in channels]
    elif names:
        warnings.append(f"{_NAMES} names {len(names)} joints, the tables have others: not used")
    if len(widths) > 1:
        # Numbers would match joints that need not be the same.
        signals = [_apart(one) for one in signals]
        warnings.append(
            "the tables of commands and of states have different numbers of joints: which command "
            "is whose, --map commands.position.COLUMN=actuator/NAME says"
        )
    if len(tables) > 1:
        spans = [one.seconds[-1] for one in signals]
        if max(spans) > 2 * min(spans):
            warnings.append(
                f"commands and states last {max(spans):.4g} and {min(spans):.4g} s: their clocks "
                "need not be one"
            )
    return Episode(
        EpisodeInfo(source=f"SAGE's tables {path.name}"),
        {one.name: one for one in signals},
        tuple(channels),
        tuple(dict.fromkeys(warnings)),
        tuple(words for one in tables for words in one.losses),
    )


def _table(path: Path, options: ReadOptions) -> Episode:
    """Read one table; its columns get the unit of their times, and say whether they command."""
    lines = lines_of(path)
    first = [line or "" for line in _few(lines)]
    header, *rows = (cells_of(line, ",") for line in first)
    times: list[float] = []
    with suppress(ValueError, IndexError):
        times = [float(row[1]) for row in rows]
    # The real robot's times are in us, the simulated one's in s.
    is_us = len(times) > 1 and times[-1] - times[0] > len(times)
    header[1] = f"timestamp ({'us' if is_us else 's'})"
    header[2:] = [f"joint_{name}" for name in header[2:]]
    if rows and rows[0][0].lower() == _COMMANDS:
        header[2] = "command_joint_positions"
    return read_lines(path, chain([",".join(header)], first[1:], lines), options)


def _few(lines: Iterator[str | None]) -> Iterator[str | None]:
    for _, line in zip(range(10), lines, strict=False):
        yield line


def _beside(path: Path) -> Path | None:
    """Return the table of commands beside one of states, or the other way; None without one."""
    name = path.name
    for own, other in ((_STATES, _COMMANDS), (_COMMANDS, _STATES)):
        if own in name:
            found = path.with_name(name.replace(own, other))
            is_beside = found.is_file() and real_path(found).parent == real_path(path).parent
            return found if is_beside and is_sage(start_of(found)) else None
    return None


def _joint_names(path: Path) -> tuple[str, ...]:
    """Read the joints' names beside a table; empty where there are none, or not one each."""
    found = path.with_name(_NAMES)
    if not found.is_file() or real_path(found).parent != real_path(path).parent:
        return ()
    with open_regular(found) as file:
        names = file.read(64 * 1024).decode("utf-8", "replace").split("\n")
    known = tuple(name.strip()[:80] for name in names if name.strip())
    is_clear = len(set(known)) == len(known) <= _MAX_JOINTS
    return known if is_clear and all(map(str.isprintable, known)) else ()


def _named(channel: Channel, names: tuple[str, ...]) -> Channel:
    """Return a channel whose description has the joints' names."""
    _, _, unit = channel.type_name.partition(" [")
    return replace(channel, type_name=f"{', '.join(names)} [{unit}" if unit else channel.type_name)


def _apart(signal: Signal) -> Signal:
    """Return commands whose columns are no joint's name."""
    names = tuple(f"command{number}" for number in range(1, len(signal.columns) + 1))
    return replace(signal, columns=names) if signal.drives else signal
