"""Describe an episode and its health in JSON: `tunenet-logs info --json` and `check --json`.

The keys are a contract (docs/logs.md): new ones may be added, and none is ever left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tunenet_logs.describe import gaps_s
from tunenet_logs.episode import Channel, Episode
from tunenet_logs.formats.registry import file_bytes
from tunenet_logs.gaps import noted_gaps
from tunenet_logs.measured_rate import measured_hz

if TYPE_CHECKING:
    from tunenet_logs.checking import Health

_INFO_KEYS = (
    *("bytes", "start_ns", "end_ns", "duration_s", "kind", "source", "preset", "rig", "truth"),
    *("counts", "notes", "away", "warnings", "damage", "channels"),
)
_CHECK_KEYS = ("whole", "messages", "channels", "damage", "left_out", "notes")


def info_fields(path: Path, episode: Episode) -> dict[str, Any]:
    """Return the JSON fields of `info` for a log that was read."""
    info = episode.info
    return {
        "log": str(path),
        "error": None,
        "bytes": file_bytes(path),
        **_span(episode.channels),
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
    return {"log": str(path), "error": error, **dict.fromkeys(_INFO_KEYS)}


def unread_check(path: Path, error: str) -> dict[str, Any]:
    """Return the fields of `check` for a log that could not be read: not whole, the rest null."""
    return {"log": str(path), "error": error, **dict.fromkeys(_CHECK_KEYS), "whole": False}


def _span(channels: Sequence[Channel]) -> dict[str, Any]:
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
        **_span([channel]),
        "gaps": len(gaps),
        "longest_gap_s": float(gaps.max()) if len(gaps) else None,
        "used": channel.skipped is None,
        "not_used_because": channel.skipped,
    }
