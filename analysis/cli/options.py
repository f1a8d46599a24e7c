"""Options that tuning and training share."""

from __future__ import annotations

import argparse

from tunenet_logs.commandline import whole


def preset_option(parser: argparse.ArgumentParser) -> None:
    """`--preset`."""
    parser.add_argument(
        "--preset",
        choices=["default", "paper", "paper-code"],
        default="default",
        help="simulator, observation and network: ours, or those of the paper's text or code",
    )


def jobs_option(parser: argparse.ArgumentParser, what: str) -> None:
    """`--jobs`: `what` at a time."""
    parser.add_argument(
        "--jobs", type=whole(1, 256), metavar="N", help=f"{what} (default: all cores)"
    )
