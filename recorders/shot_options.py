"""Command-line options of `tunenet-record --simulate bounce-shot`, and their recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from tunenet_logs.errors import UsageError

# A flight between two impacts lasts some tenths of a second; a lower rate leaves few samples.
_MIN_RATE_HZ = 50.0


def shot_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options of the bounce shot; None where they are not given."""
    add = group.add_argument
    return [
        add(
            "--rig",
            type=Path,
            metavar="FILE.yaml",
            help="plane, hoop and ball (default: the built-in rig; see tunenet-plan --save-rig)",
        ),
    ]


def record_shot_as_asked(arguments: argparse.Namespace, path: Path) -> str:
    """Record a simulated shot; return the summary for the last line.

    Raises:
        TuneNetError: a value is invalid, or the log cannot be written.
    """
    from recorders.session import record_episode
    from recorders.simulated_shot import ShotOrder, simulate_shot
    from recorders.simulators.shot.rig import ShotRig
    from recorders.simulators.shot.rig_file import read_rig
    from tunenet_logs.terminal import Progress

    for name, why in (("size", "a picture's"), ("seconds", "for what has no end of its own")):
        if getattr(arguments, name) is not None:
            raise UsageError(f"--{name} is {why}; it does not go with --simulate bounce-shot")
    if arguments.preset == "paper":
        raise UsageError("--preset paper is for drop and payload; leave it out")
    if arguments.rate is not None and arguments.rate < _MIN_RATE_HZ:
        raise UsageError(f"--rate {arguments.rate:g} is too slow for a shot; 50 Hz or more")
    given = {
        "rig": ShotRig() if arguments.rig is None else read_rig(arguments.rig),
        "restitution": arguments.restitution,
        "slope": arguments.slope,
        "drag_1_m": arguments.drag,
        "height_m": arguments.height,
        "rate_hz": arguments.rate,
        "seed": arguments.seed,
    }
    episode = simulate_shot(
        ShotOrder(**{name: value for name, value in given.items() if value is not None})
    )
    summary = record_episode(
        episode,
        path,
        overwrite=arguments.overwrite,
        progress=Progress(quiet=arguments.quiet),
        min_free_bytes=round(arguments.min_free * 1e6),
    )
    truth, rig = episode.info.truth, episode.info.rig
    outcome = "through the hoop" if truth["success"] else "not through the hoop"
    return (
        f"restitution {truth['restitution']:.4f}, from {rig['shot_height_m']:.3f} m, {outcome}, by "
        f"{episode.info.source}; " + summary.in_words("samples")
    )
