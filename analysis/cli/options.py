"""Options that commands share, and those that say what is known of ball or arm."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from recorders.simulators.arm.known_arms import ARMS, DEFAULT, name_alone
from recorders.simulators.balls import BALLS, UNKNOWN_BALL, Ball, ball_named, contradict
from tunenet_logs.commandline import number, whole
from tunenet_logs.errors import UsageError
from tunenet_logs.regular_file import real_path

if TYPE_CHECKING:
    from analysis.payload.arm_card import ArmCard
    from tunenet_logs.formats.read_options import ReadOptions


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


def ray_option(parser: argparse._ActionsContainer, what: str) -> None:
    """`--ray`: `what` on a cluster."""
    parser.add_argument(
        "--ray",
        nargs="?",
        const="local",
        type=_cluster,
        metavar="ADDRESS",
        help=f"{what} on a Ray cluster, by its head's address HOST:PORT, or auto; without one, on "
        "a cluster that is started here",
    )


def _cluster(text: str) -> str:
    """The address of a Ray cluster; a log behind `--ray` is none."""
    host, _, port = text.removeprefix("ray://").rpartition(":")
    if text not in ("local", "auto") and not (host and port.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is no HOST:PORT; write logs before --ray")
    return text


def ball_options(group: argparse._ArgumentGroup) -> None:
    """Add the options that say what was dropped."""
    add = group.add_argument
    add("--ball", metavar="NAME", help=f"a ball of known size and mass: {', '.join(BALLS)}")
    add(
        "--ball-diameter",
        type=number(0.001, 10, "m"),
        metavar="M",
        help="of the ball [m]; lets the frame rate be checked, too",
    )
    add(
        "--ball-mass",
        type=number(0.0001, 1000, "kg"),
        metavar="KG",
        help="of the ball [kg], with its diameter: what the air does to it follows",
    )


def known_ball(arguments: argparse.Namespace) -> Ball:
    """The ball of the options; what was measured goes before the table.

    Raises:
        UsageError: no such ball, one that cannot be, or options that contradict each other.
    """
    diameter_m, mass_kg = arguments.ball_diameter, arguments.ball_mass
    if arguments.ball is None and diameter_m is None and mass_kg is None:
        return UNKNOWN_BALL
    ball = UNKNOWN_BALL if arguments.ball is None else ball_named(arguments.ball)
    if contradict(Ball(diameter_m, mass_kg), ball):
        print(
            f"tunenet-tune: the ball {arguments.ball} has {ball.words}; what was measured is used",
            file=sys.stderr,
        )
    if diameter_m is not None:
        ball = replace(ball, diameter_m=diameter_m, mass_kg=None if mass_kg else ball.mass_kg)
    if mass_kg is not None:
        if ball.diameter_m is None:
            raise UsageError(
                "--ball-mass says nothing without the ball's size; add --ball-diameter"
            )
        ball = replace(ball, mass_kg=mass_kg)
    if ball.is_denser_than_metal:
        print(
            f"tunenet-tune: a ball of {ball.diameter_m:g} m and {ball.mass_kg:g} kg is denser than "
            "any metal; --ball-mass is in kg",
            file=sys.stderr,
        )
    return ball


def arm_options(group: argparse._ArgumentGroup) -> None:
    """Add the options that are the payload's alone."""
    add = group.add_argument
    add(
        "--tare",
        type=Path,
        metavar="LOG",
        action="append",
        help="a run of the same arm with nothing in its gripper, best along the same motion: what "
        "friction, offsets and the model's errors do is then known. May be given several times",
    )
    add(
        "--arm-card",
        type=Path,
        metavar="FILE",
        help="what earlier runs of the same arm said of its friction, sensors and links, as "
        "--save-arm-card wrote it; with and without --tare",
    )
    add(
        "--save-arm-card",
        type=Path,
        metavar="FILE",
        help="write what the log, its tares and the --arm-card say of the arm; for one log",
    )
    add(
        "--arm",
        metavar="NAME",
        help=f"whose torques these are: {', '.join(ARMS)} (default: as the joints' names say, else "
        f"{DEFAULT})",
    )
    add("--urdf", type=Path, metavar="FILE", help="any other serial arm")
    add("--tool-link", metavar="NAME", help="the link of that URDF in whose frame the payload is")
    add(
        "--gravity",
        choices=["included", "compensated"],
        help="whether the arm's own weight is in the torques (default: as the log shows)",
    )
    add(
        "--effort-sign",
        choices=["joint", "load"],
        help="whose torques these are: what the joint exerts, or the load, the opposite (default: "
        "as the log shows)",
    )
    add(
        "--effort-unit",
        type=_effort_unit,
        metavar="{N·m,A}",
        help="of the torques; with A they are currents, and --torque-constants makes them torques: "
        "one number a joint from base to tool, or one for all (default: N·m)",
    )


def _effort_unit(text: str) -> str:
    """An argparse type: N·m in one of its spellings, or A."""
    unit = "N·m" if text in ("N·m", "Nm", "N.m", "N*m") else text
    if unit not in ("N·m", "A"):
        raise argparse.ArgumentTypeError(f"{text[:20]!r} is neither N·m (or Nm) nor A")
    return unit


def known_tares(arguments: argparse.Namespace) -> tuple[Path, ...]:
    """The empty runs.

    Raises:
        UsageError: one is named twice.
    """
    found: dict[Path, Path] = {}
    for tare in arguments.tare or ():
        if found.setdefault(real_path(tare), tare) is not tare:
            raise UsageError(f"--tare {tare} is named twice; name each empty run once")
    return tuple(found.values())


def known_card(arguments: argparse.Namespace, tares: Sequence[Path]) -> ArmCard | None:
    """What is known of the arm, after a check of where what is learnt of it shall go.

    Raises:
        UsageError: the card is none, or has one of these runs already; or none can be saved.
    """
    saved, logs = arguments.save_arm_card, arguments.logs
    if saved is not None:
        from analysis.result_files import check_writable

        if len({real_path(log) for log in logs}) != 1:
            raise UsageError(f"--save-arm-card is for one log, not {len(logs)}; name one")
        check_writable(saved, "--save-arm-card")
    if arguments.arm_card is None:
        return None
    from analysis.payload.arm_card import read_arm_card
    from analysis.result_files import log_sha256

    card = read_arm_card(arguments.arm_card)
    for run in (*logs, *tares):
        with suppress(OSError):  # reading it says why in our own words
            card.check_new(run, log_sha256(run))
    return card


def of_efforts(
    arguments: argparse.Namespace, reading: ReadOptions
) -> tuple[ReadOptions, tuple[float, ...]]:
    """How to read a log, and the torque for each A of its efforts [N·m/A] if these are currents.

    Where they are, the constants are theirs, and none of a table's currents.

    Raises:
        UsageError: they are currents, and nobody says what these do.
    """
    constants = reading.torque_constants
    if arguments.effort_unit != "A":
        return reading, ()
    if not constants:
        raise UsageError(
            "--effort-unit A needs each joint's torque for each A; add --torque-constants K1,K2,..."
        )
    return replace(reading, torque_constants=()), constants


def known_arm(arguments: argparse.Namespace) -> str | tuple[Path, str] | None:
    """The arm's name, or its URDF and the link; None to go by the log.

    Raises:
        UsageError: no such arm, or options that do not go together.
    """
    urdf, link = arguments.urdf, arguments.tool_link
    if arguments.arm is not None:
        return name_alone(arguments.arm, urdf, link)
    if (urdf is None) != (link is None):
        missing = "--tool-link" if link is None else "--urdf"
        raise UsageError(f"--urdf and --tool-link go together; add {missing}")
    return None if urdf is None else (urdf, link)
