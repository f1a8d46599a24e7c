"""Command-line options of `tunenet-record --simulate payload`, and the recording they ask for."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from recorders.simulators.arm.known_arms import ARMS, DEFAULT
from tunenet_logs.commandline import number
from tunenet_logs.errors import UsageError

if TYPE_CHECKING:
    from recorders.simulated_payload import PayloadOrder


def payload_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options of the simulated arm; None where they are not given."""
    add = group.add_argument
    return [
        add(
            "--mass",
            type=number(0, 20, "kg"),
            metavar="KG",
            help="of what the gripper holds [kg] (default: drawn from .1 to 1.5)",
        ),
        add(
            "--com",
            type=_offset,
            metavar="X,Y,Z",
            help="its centre of mass in the tool frame [m], x along the Jaco's gripper "
            "(default: 0,0,0)",
        ),
        add(
            "--empty",
            action="store_true",
            default=None,
            help="hold nothing: the tare of the run with the same --seed and options",
        ),
        add(
            "--path",
            metavar="PATH",
            help="circle (the paper's), random, or a CSV: time_s, then a column of rad for each "
            "joint (default: circle; of another arm than a Jaco with 7 joints random)",
        ),
        add(
            "--save-path",
            type=Path,
            metavar="CSV",
            help="write the path for a real arm, from rest to rest, 100 rows a second unless "
            "--rate, and record nothing",
        ),
        add("--arm", metavar="NAME", help=f"which: {', '.join(ARMS)} (default: {DEFAULT})"),
        add("--urdf", type=Path, metavar="FILE", help="any other serial arm"),
        add("--tool-link", metavar="NAME", help="the link of that file that holds the payload"),
        *_driver_options(group),
    ]


def _driver_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options that make ideal torques a real driver's."""
    add = group.add_argument
    return [
        add(
            "--driver",
            action="store_true",
            default=None,
            help="as a real arm's driver: all that follows, links 5 %% off, 65 messages a second "
            "with jitter and stale repeats (--rate 10: a slow one)",
        ),
        add(
            "--torque-noise",
            type=number(0, 100, "N·m"),
            metavar="NM",
            help="standard deviation of a torque [N·m] (default: 0; --driver: .2)",
        ),
        add(
            "--friction",
            type=number(0, 100, "N·m"),
            metavar="NM",
            help="of each joint, drawn: standard deviation of the viscous [N·m s/rad] and of "
            "Coulomb's [N·m] (default: 0; --driver: .5)",
        ),
        add(
            "--joint-offsets",
            type=number(0, 100, "N·m"),
            metavar="NM",
            help="drawn likewise, of each joint's torque [N·m] (default: 0; --driver: .3)",
        ),
        add(
            "--gain-error",
            type=number(0, 0.2),
            metavar="SHARE",
            help="drawn likewise (default: 0; --driver: .03)",
        ),
        add(
            "--lag",
            type=number(0, 1000, "ms"),
            metavar="MS",
            help="torques are those of so long ago [ms] (default: 0; --driver: drawn, 0 to 30)",
        ),
    ]


def record_payload_as_asked(arguments: argparse.Namespace, path: Path) -> str:
    """Record a simulated arm; return the summary for the last line.

    Raises:
        TuneNetError: a value is invalid, or the log cannot be written.
    """
    from recorders.session import record_episode
    from recorders.simulated_payload import simulate_payload
    from tunenet_logs.terminal import Progress

    episode = simulate_payload(_order(arguments))
    summary = record_episode(
        episode,
        path,
        overwrite=arguments.overwrite,
        progress=Progress(quiet=arguments.quiet),
        min_free_bytes=round(arguments.min_free * 1e6),
    )
    held = "no payload" if arguments.empty else f"{episode.info.truth['payload_mass']:.4f} kg"
    return f"{held}, by {episode.info.source}; {summary.in_words('samples')}"


def save_path_as_asked(arguments: argparse.Namespace) -> str:
    """Write the path for a real arm to follow; return the summary line.

    Raises:
        TuneNetError: as `record_payload_as_asked`.
    """
    from recorders.simulated_payload import command_path
    from recorders.simulators.arm.path_file import write_path_file

    if arguments.output is not None:
        raise UsageError("--save-path records nothing; leave -o out")
    arm, path = command_path(_order(arguments))
    write_path_file(
        arguments.save_path,
        arm.joint_names,
        path.seconds,
        path.position_rad,
        overwrite=arguments.overwrite,
    )
    return (
        f"{len(path.seconds)} rows, {path.seconds[-1]:.2f} s from rest to rest; bring the arm to "
        "the first row slowly before"
    )


def _order(arguments: argparse.Namespace) -> PayloadOrder:
    from recorders.simulated_payload import PayloadOrder

    if arguments.empty and (arguments.mass is not None or arguments.com is not None):
        raise UsageError("--empty holds nothing; leave --mass and --com out, or --empty")
    if arguments.size is not None:
        raise UsageError("--size is a picture's; it does not go with --simulate payload")
    given = {
        "mass_kg": arguments.mass,
        "com_m": arguments.com,
        "is_empty": arguments.empty,
        "path": arguments.path,
        "arm": arguments.arm,
        "urdf": arguments.urdf,
        "tool_link": arguments.tool_link,
        "rate_hz": arguments.rate,
        "seconds": arguments.seconds,
        "is_driver": arguments.driver,
        "torque_noise_nm": arguments.torque_noise,
        "friction_nm": arguments.friction,
        "offset_nm": arguments.joint_offsets,
        "gain_error": arguments.gain_error,
        "lag_s": None if arguments.lag is None else arguments.lag * 1e-3,
        "preset": arguments.preset,
        "seed": arguments.seed,
    }
    return PayloadOrder(**{name: value for name, value in given.items() if value is not None})


def _offset(text: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) != 3 or not all(abs(value) <= 1 for value in values):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not X,Y,Z in meters, each within 1, such as 0.02,0,0.01"
        )
    return values
