"""Command-line options of `tunenet-record --joint-states`, and the recording they ask for."""

from __future__ import annotations

import argparse
import os
import sys
from importlib import import_module
from pathlib import Path

from recorders.ros2.names import checked_topic
from tunenet_logs.commandline import number, whole
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import Progress, one_line, short_name

_LAST_DOMAIN = 232  # of DDS: the ports of a higher domain's discovery would be over 65535
# More than any robot has: what is longer is a mistake in the command.
_MAX_TOPICS, _MAX_JOINTS = 16, 100


def ros2_options(group: argparse._ArgumentGroup) -> list[argparse.Action]:
    """Add the options of joint states."""
    add = group.add_argument
    return [
        add(
            "--joint-names",
            type=_joint_names,
            metavar="A,B,...",
            help="joints that must be there; of messages without names, theirs in order",
        ),
        add(
            "--domain",
            type=whole(0, _LAST_DOMAIN),
            metavar="N",
            help=f"ROS 2 domain, 0 to {_LAST_DOMAIN} (default: ROS_DOMAIN_ID, else 0)",
        ),
        add(
            "--loopback",
            action="store_true",
            default=None,
            help="stay on this machine (also where ROS_LOCALHOST_ONLY is 1)",
        ),
        add(
            "--timeout",
            type=number(0.1, 3600, "s"),
            metavar="S",
            help="end when a topic is not published or silent for so long [s] (default: 5)",
        ),
    ]


def record_joints_as_asked(arguments: argparse.Namespace, path: Path) -> str:
    """Record the topics; return the summary for the last line.

    Raises:
        TuneNetError: they cannot be received or written, or cyclonedds is not installed.
    """
    for option, value in (("--rate", arguments.rate), ("--size", arguments.size)):
        if value is not None:
            raise UsageError(f"{option} does not go with --joint-states; leave it out")
    topics = _topics(arguments.joint_states)
    domain = _domain_of_environment() if arguments.domain is None else arguments.domain
    try:
        import_module("cyclonedds")
    except ModuleNotFoundError as error:
        raise UsageError(
            "--joint-states needs cyclonedds; pip install 'tunenet-logs[ros2]'"
        ) from error
    from recorders.ros2.capture import JointOrder, record_joints

    order = JointOrder(
        topics=topics,
        joint_names=arguments.joint_names or (),
        seconds=arguments.seconds,
        timeout_s=arguments.timeout or JointOrder.timeout_s,
        domain=domain,
        is_loopback=bool(arguments.loopback) or os.environ.get("ROS_LOCALHOST_ONLY") == "1",
        min_free_bytes=round(arguments.min_free * 1e6),
    )
    summary = record_joints(
        order,
        path,
        overwrite=arguments.overwrite,
        progress=Progress(quiet=arguments.quiet),
        warn=_warn,
    )
    return f"{order.source}; {summary.in_words()}"


def _warn(text: str) -> None:
    print(one_line(f"tunenet-record: {text}"), file=sys.stderr, flush=True)


def _topics(words: list[str]) -> tuple[str, ...]:
    """Parse the topics, given once or several times, with commas or without."""
    named = [part for word in words for part in word.split(",") if part.strip()]
    topics = tuple(dict.fromkeys(checked_topic(part) for part in named))
    if not 0 < len(topics) <= _MAX_TOPICS:
        raise UsageError(f"--joint-states: {len(topics)} topics; name 1 to {_MAX_TOPICS}")
    return topics


def _domain_of_environment() -> int:
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    try:
        return whole(0, _LAST_DOMAIN)(text)
    except argparse.ArgumentTypeError as error:
        raise UsageError(f"ROS_DOMAIN_ID: {error}; or give --domain") from error


def _joint_names(text: str) -> tuple[str, ...]:
    names = tuple(part.strip() for part in text.split(","))
    if not all(name and name.isprintable() for name in names) or len(names) > _MAX_JOINTS:
        raise argparse.ArgumentTypeError(
            f"{short_name(text)!r} is not a list of joints, such as joint_1,joint_2"
        )
    if len(set(names)) < len(names):
        raise argparse.ArgumentTypeError(f"{short_name(text)!r} names a joint twice")
    return names
