"""Parse the times in messages of ROS 1, ROS 2, protobuf and JSON."""

from __future__ import annotations

from typing import Any

# What ROS 2, protobuf, Foxglove's JSON and ROS 1 call the parts of a time.
STAMP_FIELDS = (("sec", "nanosec"), ("seconds", "nanos"), ("sec", "nsec"), ("secs", "nsecs"))


def time_ns(time: Any) -> int:
    """Convert a time of ROS, protobuf or JSON to ns.

    Raises:
        ValueError: it has no known pair of fields.
    """
    for whole, part in STAMP_FIELDS:
        if hasattr(time, whole) and hasattr(time, part):
            return int(getattr(time, whole)) * 1_000_000_000 + int(getattr(time, part))
    raise ValueError("it holds no time that is understood")


def ros_stamp_ns(message: Any) -> int:
    """Return the stamp of a message's header [ns]."""
    stamp = message.header.stamp
    try:
        return stamp.sec * 1_000_000_000 + stamp.nanosec
    except AttributeError:
        return time_ns(stamp)
