"""Options that commands share, and those that say what is known of ball or arm."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from recorders.simulators.balls import BALLS, UNKNOWN_BALL, Ball, ball_named, contradict
from tunenet_logs.commandline import number, whole
from tunenet_logs.errors import UsageError


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
        help="a run of the same arm with nothing in its gripper, best along the same motion: what "
        "friction, offsets and the model's errors do is then known",
    )
    add(
        "--urdf",
        type=Path,
        metavar="FILE",
        help="another serial arm than Kinova's Jaco with 7 joints and a Robotiq 85",
    )
    add("--tool-link", metavar="NAME", help="the link of that URDF in whose frame the payload is")


def known_arm(arguments: argparse.Namespace) -> tuple[Path, str] | None:
    """The URDF and its link; None for the arm that is built in.

    Raises:
        UsageError: one without the other.
    """
    urdf, link = arguments.urdf, arguments.tool_link
    if (urdf is None) != (link is None):
        missing = "--tool-link" if link is None else "--urdf"
        raise UsageError(f"--urdf and --tool-link go together; add {missing}")
    return None if urdf is None else (urdf, link)
