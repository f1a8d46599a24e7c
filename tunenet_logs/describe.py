"""An episode in words: what `tunenet-logs info` prints."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import Channel, Episode, EpisodeInfo
from tunenet_logs.formats.registry import file_bytes
from tunenet_logs.terminal import one_line, short_name

_MOST_ROWS = 100
"""Channels that are shown, and warnings; a log of thousands is no reason to scroll."""

_COLUMNS = 60
"""Characters of the timeline: with a short topic's name it fits a terminal of 80."""

_GAP_PERIODS = 3.0
"""Usual intervals: a gap is longer, which jitter and one missing sample do not make it."""

_FASTEST_HZ = 1e5
"""Messages that came faster came in one piece: their times tell no rate."""

_EARLIEST_DATE_NS = 1_000_000_000 * 10**9
"""Stamps before September 2001 are times of a simulator or video, not dates."""


def describe(path: Path, episode: Episode) -> str:
    """The log, one fact a line: its info, its damage, its channels and when they were heard."""
    lines = [f"{path}: {file_bytes(path)} bytes{_span(episode.channels)}"]
    lines += [f"  {line}" for line in _episode_lines(episode.info)]
    lines += [f"  warning: {warning}" for warning in episode.warnings[:_MOST_ROWS]]
    lines += _more(len(episode.warnings), "warnings")
    shown = _shown(episode.channels)
    lines += _table(shown) if shown else ["  no channels"]
    lines += _more(len(episode.channels), "channels")
    return "\n".join(one_line(line) for line in (*lines, *_timeline(shown)))


def _shown(channels: Sequence[Channel]) -> Sequence[Channel]:
    """The channels of the table: of too many, those that can be used first."""
    if len(channels) <= _MOST_ROWS:
        return channels
    return sorted(channels, key=lambda channel: channel.skipped is not None)[:_MOST_ROWS]


def _more(count: int, what: str) -> list[str]:
    return [f"  and {count - _MOST_ROWS} more {what}"] if count > _MOST_ROWS else []


def _table(channels: Sequence[Channel]) -> list[str]:
    rows = [("topic", "type", "messages", "rate", "duration", "gaps", "use")]
    rows += [_channel_row(channel) for channel in channels]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    cells = ([cell.ljust(width) for cell, width in zip(row, widths, strict=True)] for row in rows)
    return ["  " + "  ".join(row).rstrip() for row in cells]


def gaps_s(stamps_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """The K intervals between messages that are much longer than usual, shape (K,) [s]."""
    periods = np.diff(np.sort(stamps_ns)) * 1e-9
    if len(periods) < 2:
        return np.empty(0)
    return periods[periods > _GAP_PERIODS * max(float(np.quantile(periods, 0.75)), 1e-3)]


def _span(channels: Sequence[Channel]) -> str:
    stamps_ns = [channel.log_ns for channel in channels if channel.messages]
    if not stamps_ns:
        return ""
    start_ns = min(int(of_channel.min()) for of_channel in stamps_ns)
    end_ns = max(int(of_channel.max()) for of_channel in stamps_ns)
    text = f", {(end_ns - start_ns) * 1e-9:.2f} s"
    if start_ns >= _EARLIEST_DATE_NS:
        text += f" from {datetime.fromtimestamp(start_ns // 10**9, UTC):%Y-%m-%d %H:%M:%S} UTC"
    return text


def _episode_lines(info: EpisodeInfo) -> list[str]:
    facts = [("kind", info.kind), ("source", info.source), ("preset", info.preset)]
    lines = [f"{name}: {value}" for name, value in facts if value]
    for name in ("rig", "truth", "counts", "notes"):
        group = getattr(info, name)
        if group:
            lines.append(f"{name}: " + ", ".join(f"{key} {value}" for key, value in group.items()))
    return lines


def _channel_row(channel: Channel) -> tuple[str, ...]:
    duration_s = float(np.ptp(channel.log_ns)) * 1e-9 if channel.messages else 0.0
    periods = channel.messages - 1
    has_rate = duration_s * _FASTEST_HZ >= periods > 0
    rate = f"{periods / duration_s:.1f} Hz" if has_rate else "-"
    gaps = gaps_s(channel.log_ns)
    return (
        short_name(channel.topic),
        short_name(channel.type_name) or "-",
        str(channel.messages),
        rate,
        f"{duration_s:.2f} s",
        f"{len(gaps)} to {gaps.max():.2f} s" if len(gaps) else "-",
        "yes" if channel.skipped is None else f"no: {channel.skipped}",
    )


def _timeline(channels: Sequence[Channel]) -> list[str]:
    """When each channel was heard: `#` as often as usual, `.` less, blank not at all."""
    heard = [channel for channel in channels if channel.messages > 1]
    if not heard:
        return []
    start = min(float(channel.log_ns.min()) for channel in heard)
    span = max(float(channel.log_ns.max()) for channel in heard) - start
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
