"""What a user of `tunenet-tune` says of an arm, as options."""

from __future__ import annotations

import argparse
from pathlib import Path

from tunenet_logs.errors import UsageError


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


def arm_as_told(arguments: argparse.Namespace) -> tuple[Path, str] | None:
    """The URDF and its link; None for the arm that is built in.

    Raises:
        UsageError: one without the other.
    """
    urdf, link = arguments.urdf, arguments.tool_link
    if (urdf is None) != (link is None):
        missing = "--tool-link" if link is None else "--urdf"
        raise UsageError(f"--urdf and --tool-link go together; add {missing}")
    return None if urdf is None else (urdf, link)
