"""What ROS 2 calls topics and types, and what they are called on the wire (DDS)."""

from __future__ import annotations

import re

from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import short_name

# How ROS 2 names map to DDS (its design article "Topic and Service name mapping to DDS").
_PREFIX = "rt/"
"""Of a topic; services and actions have others."""

_TOPIC = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
"""A topic from the root: words between slashes, none of which begins with a digit."""

_TYPE = re.compile(r"(\w+)::(msg|srv|action)::dds_::(\w+)_")
"""A type on the wire: "sensor_msgs::msg::dds_::JointState_"."""

_LONGEST = 200
"""Characters: DDS takes 255, of which ROS 2 needs some for its prefixes and services."""


def checked_topic(text: str) -> str:
    """A topic as ROS 2 writes it, from its root.

    Raises:
        UsageError: no name that a topic can have.
    """
    topic = text.strip()
    topic = topic if topic.startswith("/") else f"/{topic}"
    if len(topic) > _LONGEST or not _TOPIC.fullmatch(topic) or "__" in topic:
        raise UsageError(f"{short_name(text)!r} is no name of a ROS 2 topic, such as /joint_states")
    return topic


def dds_topic(topic: str) -> str:
    """What "/joint_states" is called on the wire."""
    return _PREFIX + topic.removeprefix("/")


def ros_topic(dds_name: str) -> str | None:
    """A topic of ROS 2; None for what is something else: a service, or not ROS."""
    return f"/{dds_name.removeprefix(_PREFIX)}" if dds_name.startswith(_PREFIX) else None


def ros_type(dds_name: str) -> str:
    """Such as "sensor_msgs/msg/JointState"; a type that is not ROS 2's as it is."""
    found = _TYPE.fullmatch(dds_name)
    return "/".join(found.groups()) if found else dds_name
