"""Options that commands share, and those that describe the ball or the arm."""

from __future__ import annotations

import argparse
from pathlib import Path

from analysis.tune_options import RANGES, effort_unit
from recorders.simulators.arm.known_arms import ARMS, DEFAULT
from recorders.simulators.balls import BALLS
from tunenet_logs.commandline import number, whole
from tunenet_logs.completion import offering
from tunenet_logs.errors import UsageError
from tunenet_logs.regular_file import real_path


def preset_option(parser: argparse.ArgumentParser) -> None:
    """Add `--preset`."""
    parser.add_argument(
        "--preset",
        choices=["default", "paper", "paper-code"],
        default="default",
        help="simulator, observation and network: ours, or those of the paper's text or code",
    )


def jobs_option(parser: argparse.ArgumentParser, what: str) -> None:
    """Add `--jobs`: `what` at a time."""
    parser.add_argument(
        "--jobs", type=whole(1, 256), metavar="N", help=f"{what} (default: all cores)"
    )


def json_option(group: argparse._ActionsContainer, what: str, *names: str) -> None:
    """Add `--json`: `what` to a file, or to standard output."""
    group.add_argument(
        *names,
        "--json",
        type=Path,
        metavar="FILE",
        help=f"{what} to FILE, or with - to standard output in place of all else",
    )


def ray_option(parser: argparse._ActionsContainer, what: str) -> None:
    """Add `--ray`: `what` on a cluster."""
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
    """Parse the address of a Ray cluster; refuse a log behind `--ray`."""
    host, _, port = text.removeprefix("ray://").rpartition(":")
    if text not in ("local", "auto") and not (host and port.isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is no HOST:PORT; write logs before --ray")
    return text


def ball_options(group: argparse._ArgumentGroup) -> None:
    """Add the options that describe the ball."""
    add = group.add_argument
    ball = add("--ball", metavar="NAME", help=f"a ball of known size and mass: {', '.join(BALLS)}")
    offering(ball, BALLS)
    add(
        "--ball-diameter",
        type=number(*RANGES["ball_diameter_m"]),
        metavar="M",
        help="of the ball [m]; lets the frame rate be checked, too",
    )
    add(
        "--ball-mass",
        type=number(*RANGES["ball_mass_kg"]),
        metavar="KG",
        help="of the ball [kg], with its diameter: what the air does to it follows",
    )


def arm_options(group: argparse._ArgumentGroup) -> None:
    """Add the options of the payload experiment."""
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
    arm = add(
        "--arm",
        metavar="NAME",
        help=f"whose torques these are: {', '.join(ARMS)} (default: as the joints' names say, else "
        f"{DEFAULT})",
    )
    offering(arm, ARMS)
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
    """Parse an effort unit for argparse: N·m in one of its spellings, or A."""
    try:
        return effort_unit(text)
    except UsageError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def check_card_place(arguments: argparse.Namespace) -> None:
    """Check before the work that the arm card can be written.

    Raises:
        UsageError: It cannot, or there are several logs.
    """
    saved, logs = arguments.save_arm_card, arguments.logs
    if saved is None:
        return
    from analysis.payload.card_saving import card_place

    if len({real_path(log) for log in logs}) != 1:
        raise UsageError(f"--save-arm-card is for one log, not {len(logs)}; name one")
    card_place(saved, None, overwrite=True).check()
