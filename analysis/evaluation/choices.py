"""Choices of `tunenet-eval`: methods, sections, and how much of each is the whole."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from tunenet_logs.errors import UsageError

# Those of `drop.method_registry`, which takes a second to load.
METHODS = (
    *("mean", "entropy-search", "cma-es", "direct", "tunenet-paper", "tunenet-paper-code"),
    *("secant", "brent", "least-squares", "tpe", "npe"),
    *("network", "ours"),
    *("concatenation", "difference", "antisymmetric"),
)

# Those of `video.sections`, which takes a second to load, and of `clips`.
SECTIONS = ("set-A", "set-B", "set-C", "slope", "drag", "bad", "clips", "transformed")

SHOT_SECTIONS = ("campaigns", "drops")  # policies in the hidden world, and verdicts on its drops
REAL_SECTIONS = ("positions", "balls", "films")  # those of `real_balls.run`
# Drops of a cell for each seed; fewer make fewer of the table's balls in proportion.
FULL_REAL = 200

FULL_SHOT = 60  # trials of a campaign; fewer make fewer drops in proportion
# Users' models tuned, with a parameter that a log cannot tell, of another machine, by another
# toolbox, and by the network's first step.
SYSID_SECTIONS = ("tuned", "untold", "wrong", "toolbox", "network")

FULL_SYSID = 200  # logs of a machine and section for each seed; a twentieth for the network
# Bounces by their sound alone, the same by phyphox's way, sounds that are no bounce, films with
# their sound, and tracks with a sound that is not theirs; balls whose impacts differ, alone and in
# films.
SOUND_SECTIONS = (
    *("alone", "phyphox", "negatives", "films", "unrelated"),
    *("uneven", "uneven-films"),
)

FULL_SOUND = 200  # clips at a ratio, sounds, films and tracks for each seed
FULL_ENGINES = 10  # targets of a range for each seed and pair of engines
# Table 1 of the paper, logs like a real driver's, arms that share no code with the fit, and what
# their drivers mean by torque.
PAYLOAD_SECTIONS = ("masses", "logs", "strangers", "conventions")

# Those that are made where none is named: the others take over an hour.
TYPICAL_PAYLOAD_SECTIONS = ("masses", "logs")

FULL_PAYLOAD = 300  # targets of a set for each seed, and two thirds as many logs of a case in all
# Logs of a cell in all, and logs whose drivers mean different things by torque.
FULL_STRANGERS, FULL_CONVENTIONS = 400, 1000

FULL_VIDEO = 200  # tracks for each seed and line of `video`; fewer make fewer clips in proportion


def chosen_sections(
    arguments: argparse.Namespace, available: Sequence[str], usual: Sequence[str] = ()
) -> Sequence[str]:
    """Return the tables that `--sections` lists, or the usual ones, or all.

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
    """Return the names that an option lists; None where it is not given.

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
