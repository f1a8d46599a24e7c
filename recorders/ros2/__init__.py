"""Record joint states and torques live from ROS 2, without a ROS installation.

Here: names of topics and types, and how ROS 2 maps them to DDS (its design article "Topic and
Service name mapping to DDS").
"""

from __future__ import annotations

import re

from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import short_name

_PREFIX = "rt/"  # of a topic's DDS name; services and actions have others


def checked_topic(text: str) -> str:
    """Validate a topic name; return it as ROS 2 writes it, from the root."""
    topic = text.strip()
    topic = topic if topic.startswith("/") else f"/{topic}"
    # Words between slashes, none of which begins with a digit. DDS takes 255 characters, of which
    # ROS 2 needs some for its prefixes.
    is_name = re.fullmatch(r"(/[A-Za-z_][A-Za-z0-9_]*)+", topic) and "__" not in topic
    if len(topic) > 200 or not is_name:
        raise UsageError(f"{short_name(text)!r} is no name of a ROS 2 topic, such as /joint_states")
    return topic


def dds_topic(topic: str) -> str:
    """Return the DDS name of a topic."""
    return _PREFIX + topic.removeprefix("/")


def ros_topic(dds_name: str) -> str | None:
    """Return the ROS 2 topic of a DDS name; None for a service, or what is not ROS."""
    return f"/{dds_name.removeprefix(_PREFIX)}" if dds_name.startswith(_PREFIX) else None


def ros_type(dds_name: str) -> str:
    """Return a type as in "sensor_msgs/msg/JointState"; one that is not ROS 2's as it is."""
    # A DDS name is like "sensor_msgs::msg::dds_::JointState_".
    found = re.fullmatch(r"(\w+)::(msg|srv|action)::dds_::(\w+)_", dds_name)
    return "/".join(found.groups()) if found else dds_name
