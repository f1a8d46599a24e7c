"""tunenet-logs: what is in a log."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.commandline import Parser, run

if TYPE_CHECKING:
    from tunenet_logs.episode import Channel, Episode, EpisodeInfo

_DESCRIPTION = """\
Show what is in a log: what recorded it, its channels with their types, counts and
rates, which of them can be used and why not the others, and what is damaged."""

_EXAMPLES = """\
  tunenet-logs info drop.mcap
  tunenet-logs info drop.mcap.active     (what a killed recording left)"""


def build_parser() -> Parser:
    """The command's arguments."""
    parser = Parser("tunenet-logs", _DESCRIPTION, _EXAMPLES)
    verbs = parser.add_subparsers(dest="verb", metavar="{info}", required=True)
    info = verbs.add_parser(
        "info", prog="tunenet-logs info", description=_DESCRIPTION, examples=_EXAMPLES
    )
    info.add_argument("log", type=Path, metavar="LOG")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `tunenet-logs`."""
    return run(build_parser(), _info, argv)


def _info(arguments: argparse.Namespace) -> int:
    from tunenet_logs.reader import read_episode

    print(describe(arguments.log, read_episode(arguments.log)))
    return 0


def describe(path: Path, episode: Episode) -> str:
    """The log in words, one fact a line."""
    files = path.iterdir() if path.is_dir() else (path,)
    lines = [f"{path}: {sum(one.stat().st_size for one in files if one.is_file())} bytes"]
    lines += [f"  {line}" for line in _episode_lines(episode.info)]
    lines += [f"  warning: {warning}" for warning in episode.warnings]
    rows = [("topic", "type", "messages", "rate", "duration", "use")]
    rows += [_channel_row(one) for one in episode.channels]
    if len(rows) == 1:
        return "\n".join([*lines, "  no channels"])
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        lines.append("  " + "  ".join(cells).rstrip())
    return "\n".join(lines)


def _episode_lines(info: EpisodeInfo) -> list[str]:
    facts = [("kind", info.kind), ("source", info.source), ("preset", info.preset)]
    lines = [f"{name}: {value}" for name, value in facts if value]
    for name in ("rig", "truth", "counts", "notes"):
        group = getattr(info, name)
        if group:
            lines.append(f"{name}: " + ", ".join(f"{key} {value}" for key, value in group.items()))
    return lines


def _channel_row(channel: Channel) -> tuple[str, ...]:
    import numpy as np

    duration_s = float(np.ptp(channel.log_ns)) * 1e-9 if channel.messages else 0.0
    rate = f"{(channel.messages - 1) / duration_s:.1f} Hz" if duration_s > 0 else "-"
    return (
        channel.topic,
        channel.type_name or "-",
        str(channel.messages),
        rate,
        f"{duration_s:.2f} s",
        "yes" if channel.skipped is None else f"no: {channel.skipped}",
    )


if __name__ == "__main__":
    sys.exit(main())
