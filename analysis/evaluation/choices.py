"""What can be chosen in `tunenet-eval`: methods, sections, and how much of each is the whole."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from tunenet_logs.errors import UsageError

METHODS = (
    *("mean", "entropy-search", "cma-es", "direct", "tunenet-paper", "tunenet-paper-code"),
    *("secant", "brent", "least-squares", "tpe", "npe"),
    *("network", "ours"),
    *("concatenation", "difference", "antisymmetric"),
)
"""Those of `drop.method_registry`, which takes a second to load."""

SECTIONS = ("set-A", "set-B", "set-C", "slope", "drag", "bad", "clips", "transformed")
"""Those of `video.sections`, which takes a second to load, and of `clips`."""

SHOT_SECTIONS = ("campaigns", "drops")
"""Policies in the hidden world, and verdicts on its drops."""

REAL_SECTIONS = ("positions", "balls", "films")
"""Those of `real_balls.run`."""

FULL_REAL = 200
"""Drops of a cell for each seed; fewer make fewer of the table's balls in proportion."""

FULL_SHOT = 60
"""Trials of a campaign; fewer make fewer drops in proportion."""

SYSID_SECTIONS = ("tuned", "untold", "wrong", "toolbox", "network")
"""Users' models tuned, with a parameter that a log cannot tell, of another machine, by another
toolbox, and by the network's first step."""

FULL_SYSID = 200
"""Logs of a machine and section for each seed; a twentieth for the network."""

SOUND_SECTIONS = (
    *("alone", "phyphox", "negatives", "films", "unrelated"),
    *("uneven", "uneven-films"),
)
"""Bounces by their sound alone, the same by phyphox's way, sounds that are no bounce, films with
their sound, and tracks with a sound that is not theirs; balls whose impacts differ, alone and in
films."""

FULL_SOUND = 200
"""Clips at a ratio, sounds, films and tracks for each seed."""

FULL_ENGINES = 10
"""Targets of a range for each seed and pair of engines."""

PAYLOAD_SECTIONS = ("masses", "logs", "strangers", "conventions")
"""Table 1 of the paper, logs like a real driver's, arms that share no code with the fit, and what
their drivers mean by torque."""

USUAL_PAYLOAD_SECTIONS = ("masses", "logs")
"""Those that are made where none is named: the others take over an hour."""

FULL_PAYLOAD = 300
"""Targets of a set for each seed, and two thirds as many logs of a case in all."""

FULL_STRANGERS, FULL_CONVENTIONS = 400, 1000
"""Logs of a cell in all, and logs whose drivers mean different things by torque."""

FULL_VIDEO = 200
"""Tracks for each seed and line of `video`; fewer make fewer clips in proportion."""


def chosen_sections(
    arguments: argparse.Namespace, available: Sequence[str], usual: Sequence[str] = ()
) -> Sequence[str]:
    """The tables that `--sections` lists.

    Args:
        arguments: of the command.
        available: what there is.
        usual: what is made where it is not given; nothing for all.

    Raises:
        UsageError: one is not available.
    """
    wanted = chosen_names(arguments, "sections", available) or usual or available
    for name in wanted:
        if name not in available:
            raise UsageError(f"no section {name!r}; there is: {', '.join(available)}")
    return wanted


def chosen_names(
    arguments: argparse.Namespace, option: str, available: Sequence[str]
) -> tuple[str, ...] | None:
    """The names that an option lists; None where it is not given.

    Raises:
        UsageError: it lists none.
    """
    listed = getattr(arguments, option)
    if listed is None:
        return None
    names = tuple(filter(None, (name.strip() for name in listed.split(","))))
    if not names:
        raise UsageError(f"--{option} names none; there is: {', '.join(available)}")
    return names
