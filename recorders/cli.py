"""tunenet-record: from a source of episodes to a log."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from tunenet_logs.commandline import Parser, number, run, whole

_DESCRIPTION = """\
Record an episode to an MCAP log. Today's source is a simulator (--simulate drop): a
ball that falls on a table, in PyBullet, with contact settings in which the ball has
the restitution that was set."""

_EXAMPLES = """\
  tunenet-record --simulate drop --restitution 0.75 --height 1.2 -o drop.mcap
  tunenet-record --simulate drop --seed 7              (draws restitution and height)
  tunenet-record --simulate drop --rate 240 --noise 0.001 --hold 0.5 -o mocap.mcap
  tunenet-record --simulate drop --preset paper        (the paper's 60 Hz settings)"""


def build_parser() -> Parser:
    """The command's arguments."""
    parser = Parser("tunenet-record", _DESCRIPTION, _EXAMPLES)
    add = parser.add_argument
    add("--simulate", choices=["drop"], required=True, help="what to simulate")
    add(
        "-o",
        "--output",
        type=Path,
        metavar="LOG",
        help="log to write (default: drop_DATE_TIME.mcap here)",
    )
    add(
        "--restitution",
        type=number(0, 1),
        metavar="E",
        help="coefficient of restitution, 0 to 1 (default: drawn from .1 to .95)",
    )
    add(
        "--height",
        type=number(0.01, 1000, "m"),
        metavar="M",
        help="drop height, from the ball's underside to the table [m] (default: drawn, .3 to 5)",
    )
    add(
        "--radius",
        type=number(0.001, 10, "m"),
        metavar="M",
        help="of the ball [m] (default: .05; preset paper: .5)",
    )
    add(
        "--rate", type=number(10, 10_000, "Hz"), metavar="HZ", help="samples a second (default: 60)"
    )
    add(
        "--seconds",
        type=number(0.1, 600, "s"),
        metavar="S",
        help="how long, after the release (default: 400/60, the paper's)",
    )
    add(
        "--hold",
        type=number(0, 600, "s"),
        default=0.0,
        metavar="S",
        help="hold the ball before letting go [s] (default: 0)",
    )
    add(
        "--noise",
        type=number(0, 1, "m"),
        default=0.0,
        metavar="M",
        help="standard deviation of the sensor's noise [m] (default: 0)",
    )
    add(
        "--preset",
        choices=["default", "paper"],
        default="default",
        help="contact settings: calibrated, or PyBullet's defaults at 60 Hz as in the paper",
    )
    add(
        "--seed",
        type=whole(0, 2**32 - 1),
        default=0,
        metavar="N",
        help="for what is drawn: restitution, height, noise (default: 0)",
    )
    add("--overwrite", action="store_true", help="replace an existing log")
    add("--quiet", action="store_true", help="no progress bar")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of `tunenet-record`."""
    return run(build_parser(), _record, argv)


def _record(arguments: argparse.Namespace) -> int:
    from recorders.session import record_episode
    from recorders.simulated_drop import DropOrder, simulate_drop
    from tunenet_logs.progress import Progress

    order = DropOrder(
        restitution=arguments.restitution,
        height_m=arguments.height,
        radius_m=arguments.radius,
        rate_hz=arguments.rate,
        seconds=arguments.seconds,
        hold_s=arguments.hold,
        noise_m=arguments.noise,
        preset=arguments.preset,
        seed=arguments.seed,
    )
    path = arguments.output or Path(f"drop_{datetime.now():%Y%m%d_%H%M%S}.mcap")
    episode = simulate_drop(order)
    progress = Progress(quiet=arguments.quiet)
    summary = record_episode(episode, path, overwrite=arguments.overwrite, progress=progress)
    truth, rig = episode.info.truth, episode.info.rig
    print(
        f"{path}: restitution {truth['restitution']:.4f}, "
        f"drop height {rig['drop_height_m']:.3f} m; "
        f"{summary.captured} samples captured, {summary.written} written, {summary.dropped} dropped"
        + (f" ({summary.ended})" if summary.ended else "")
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
