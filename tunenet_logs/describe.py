"""Describe a log: in words (`tunenet-logs info`) and in JSON (`info --json`, `check --json`).

The words are one fact a line, a table of the channels and a timeline. The JSON keys are a contract
(docs/logs.md): new ones may be added, and none is ever left out.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Channel, Episode
from tunenet_logs.formats.registry import file_bytes
from tunenet_logs.terminal import one_line, short_name
from tunenet_logs.timing.stamps import gaps_in_words, measured_hz, noted_gaps

if TYPE_CHECKING:
    from tunenet_logs.copying import Health


_MAX_ROWS = 100  # channels that are shown, and warnings; a log of thousands is no reason to scroll
_MANY = 9  # channels that differ by a number: the first stands for all
_COLUMNS = 60  # characters of the timeline: with a short topic's name it fits a terminal of 80


def describe(path: Path, episode: Episode) -> str:
    """Describe a log, one fact a line: its info, damage, channels and timeline."""
    info, span, text = episode.info, _span_fields(episode.channels), ""
    if (start_ns := span["start_ns"]) is not None:
        text = f", {(span['end_ns'] - start_ns) * 1e-9:.2f} s"
        # Stamps before September 2001 are times of a simulator or video, not dates.
        if start_ns >= 1_000_000_000 * 10**9:
            text += f" from {datetime.fromtimestamp(start_ns // 10**9, UTC):%Y-%m-%d %H:%M:%S} UTC"
    lines = [f"{path}: {file_bytes(path)} bytes{text}"]
    facts: dict[str, str] = {"kind": info.kind, "source": info.source, "preset": info.preset}
    for name in ("rig", "truth", "counts", "notes"):
        facts[name] = ", ".join(f"{key} {value}" for key, value in getattr(info, name).items())
    lines += [f"  {name}: {value}" for name, value in facts.items() if value]
    if gaps := noted_gaps(info.notes):
        lines.append(f"  away: {gaps_in_words(gaps, start_ns or 0)}")
    lines += [f"  warning: {warning}" for warning in episode.warnings[:_MAX_ROWS]]
    lines += _more(len(episode.warnings), "warnings")
    alike = _alike(episode.channels)
    if len(alike) > _MAX_ROWS:  # those that can be used first
        alike.sort(key=lambda some: some[0].skipped is not None)
    lines += _table(alike[:_MAX_ROWS]) if alike else ["  no channels"]
    lines += _more(len(alike), "channels")
    timeline = _timeline([some[0] for some in alike[:_MAX_ROWS]])
    return "\n".join(one_line(line) for line in (*lines, *timeline))


def _more(count: int, what: str) -> list[str]:
    return [f"  and {count - _MAX_ROWS} more {what}"] if count > _MAX_ROWS else []


def _alike(channels: Sequence[Channel]) -> list[list[Channel]]:
    """Group channels that differ by a number alone, as a data set's episodes do, if many."""
    keys = [(re.sub(r"\d+", "#", one.topic), one.type_name, _use_of(one)) for one in channels]
    groups: dict[tuple[str, str, str], list[Channel]] = {}
    for key, one in zip(keys, channels, strict=True):
        groups.setdefault(key, []).append(one)
    own = ((one, groups[key]) for key, one in zip(keys, channels, strict=True))
    return [
        some if len(some) >= _MANY else [one]
        for one, some in own
        if len(some) < _MANY or some[0] is one
    ]


def _table(alike: Sequence[Sequence[Channel]]) -> list[str]:
    rows = [("topic", "type", "messages", "rate", "duration", "gaps", "use")]
    for one, *others in alike:
        gaps, rate_hz = gaps_s(one.log_ns), measured_hz(one.log_ns)
        duration_s = float(np.ptp(one.log_ns)) * 1e-9 if one.messages else 0.0
        rows.append(
            (
                short_name(one.topic),
                short_name(one.type_name) or "-",
                str(one.messages),
                f"{rate_hz:.1f} Hz" if rate_hz else "-",
                f"{duration_s:.2f} s",
                f"{len(gaps)} to {gaps.max():.2f} s" if len(gaps) else "-",
                _use_of(one) + (f", and {len(others)} more like it" if others else ""),
            )
        )
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    cells = ([cell.ljust(width) for cell, width in zip(row, widths, strict=True)] for row in rows)
    return ["  " + "  ".join(row).rstrip() for row in cells]


def gaps_s(stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the intervals between messages that are much longer than usual, shape (K,) [s]."""
    periods = np.diff(np.sort(stamps_ns)) * 1e-9
    if len(periods) < 2:
        return np.empty(0)
    # Jitter and one missing sample are none.
    return periods[periods > 3.0 * max(float(np.quantile(periods, 0.75)), 1e-3)]


def _timeline(channels: Sequence[Channel]) -> list[str]:
    """Draw when each channel had messages: `#` as often as usual, `.` fewer, blank none."""
    heard = [channel for channel in channels if channel.messages > 1]
    start = min((float(channel.log_ns.min()) for channel in heard), default=0.0)
    span = max((float(channel.log_ns.max()) for channel in heard), default=0.0) - start
    if span <= 0:
        return []
    width = max(len(short_name(channel.topic)) for channel in heard)
    lines = [f"  timeline, {span * 1e-9 / _COLUMNS:.3g} s a column:"]
    for channel in heard:
        columns = (channel.log_ns - start) / span * _COLUMNS
        counts = np.bincount(np.minimum(columns.astype(int), _COLUMNS - 1), minlength=_COLUMNS)
        usual = float(np.median(counts[counts > 0]))
        marks = ("#" if count >= usual / 2 else "." if count else " " for count in counts)
        lines.append(f"  {short_name(channel.topic).ljust(width)} |{''.join(marks)}|")
    return lines


def _use_of(channel: Channel) -> str:
    if channel.skipped is not None:
        return f"no: {channel.skipped}"
    return "with --model" if channel.drives else "yes"


# ---- JSON of `info` and `check`


def info_fields(path: Path, episode: Episode) -> dict[str, Any]:
    """Return the JSON fields of `info` for a log that was read."""
    info = episode.info
    return {
        "log": str(path),
        "error": None,
        "bytes": file_bytes(path),
        **_span_fields(episode.channels),
        "kind": info.kind or None,
        "source": info.source or None,
        "preset": info.preset or None,
        "rig": info.rig,
        "truth": info.truth,
        "counts": info.counts,
        "notes": info.notes,
        "away": [
            {"start_ns": gap.last_ns, "end_ns": gap.next_ns} for gap in noted_gaps(info.notes)
        ],
        "warnings": episode.warnings,
        "damage": episode.losses,
        "channels": [_channel_fields(channel) for channel in episode.channels],
    }


def check_fields(path: Path, health: Health) -> dict[str, Any]:
    """Return the JSON fields of `check` for a log that was read."""
    channels = health.episode.channels
    return {
        "log": str(path),
        "error": None,
        "whole": health.whole,
        "messages": sum(channel.messages for channel in channels),
        "channels": len(channels),
        "damage": health.damage,
        "left_out": [
            {"name": one.name, "used": one.used, "by_reason": dict(one.by_reason)}
            for one in health.left_out
        ],
        "notes": health.doubts,
    }


def unread_info(path: Path, error: str) -> dict[str, Any]:
    """Return the fields of `info` for a log that could not be read: all null but the reason."""
    names = "bytes start_ns end_ns duration_s kind source preset rig truth counts notes away"
    fields = dict.fromkeys((*names.split(), "warnings", "damage", "channels"))
    return {"log": str(path), "error": error, **fields}


def unread_check(path: Path, error: str) -> dict[str, Any]:
    """Return the fields of `check` for a log that could not be read: not whole, the rest null."""
    fields = dict.fromkeys(("messages", "channels", "damage", "left_out", "notes"))
    return {"log": str(path), "error": error, "whole": False, **fields}


def _span_fields(channels: Sequence[Channel]) -> dict[str, Any]:
    """Return when a log, or a channel of it, begins and ends; null without messages."""
    heard = [channel for channel in channels if channel.messages]
    if not heard:
        return {"start_ns": None, "end_ns": None, "duration_s": None}
    start_ns = min(int(channel.log_ns.min()) for channel in heard)
    end_ns = max(int(channel.log_ns.max()) for channel in heard)
    return {"start_ns": start_ns, "end_ns": end_ns, "duration_s": (end_ns - start_ns) / 1e9}


def _channel_fields(channel: Channel) -> dict[str, Any]:
    gaps = gaps_s(channel.log_ns)
    return {
        "topic": channel.topic,
        "type": channel.type_name or None,
        "encoding": channel.encoding or None,
        "messages": channel.messages,
        "rate_hz": float(measured_hz(channel.log_ns)) or None,
        **_span_fields([channel]),
        "gaps": len(gaps),
        "longest_gap_s": float(gaps.max()) if len(gaps) else None,
        "used": channel.skipped is None,
        "drives": channel.drives,
        "not_used_because": channel.skipped,
    }
