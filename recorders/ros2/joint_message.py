"""Inspect the joints in a ROS 2 message as far as a recording needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from rosbags.serde import SerdeError

from tunenet_logs import messages
from tunenet_logs.errors import TopicError
from tunenet_logs.formats.base import DAMAGED
from tunenet_logs.terminal import listed, one_line


@dataclass(frozen=True)
class JointMessage:
    """The joints in a message.

    Attributes:
        names: empty where the message carries none.
        joints: number of joints.
        has_positions: whether it has positions.
        has_efforts: whether it has efforts.
    """

    names: tuple[str, ...]
    joints: int
    has_positions: bool
    has_efforts: bool


def read_message(topic: str, type_name: str, cdr: bytes) -> JointMessage:
    """Read the joints of a message.

    Raises:
        TopicError: it does not match its type.
    """
    try:
        message: Any = messages.typestore().deserialize_cdr(cdr, type_name)
    except (SerdeError, *DAMAGED) as error:
        raise TopicError(f"{topic}: a message is no {type_name} ({error})") from error
    if type_name == messages.JOINT_ANGLES:
        is_torque = "torque" in topic.rpartition("/")[2]
        return JointMessage((), 7, has_positions=not is_torque, has_efforts=is_torque)
    parts = (message.name, message.position, message.velocity, message.effort)
    return JointMessage(
        tuple(message.name),
        max(len(part) for part in parts),
        has_positions=len(message.position) > 0,
        has_efforts=len(message.effort) > 0,
    )


class TopicProbe:
    """What a topic's publishers report of joints, gathered until it is complete.

    There may be several, such as an arm's and a gripper's: the first to come says nothing of the
    others.

    Args:
        expected: joints that the user named.

    Attributes:
        is_met: whether its messages so far have the named joints, or any if none were named.
        has_positions: whether one of them since then has positions.
        has_efforts: likewise, efforts.
    """

    def __init__(self, topic: str, type_name: str, expected: Sequence[str]) -> None:
        self.is_met = False
        self.has_positions = False
        self.has_efforts = False
        self._topic = topic
        self._type_name = type_name
        self._expected = expected
        self._there: tuple[str, ...] = ()
        self._doubt: TopicError | None = None

    @property
    def is_complete(self) -> bool:
        """Whether further messages cannot add anything."""
        return self.is_met and self.has_positions and self.has_efforts

    def hear(self, cdr: bytes) -> None:
        """Inspect a message."""
        try:
            message = read_message(self._topic, self._type_name, cdr)
            if message.names:
                self._there = tuple(dict.fromkeys((*self._there, *message.names)))
                message = replace(message, names=self._there)
            check_names(self._topic, message, self._expected)
        except TopicError as error:
            self._doubt = error
            return
        self.is_met = True
        self.has_positions |= message.has_positions
        self.has_efforts |= message.has_efforts

    def check(self) -> None:
        """Check that the messages so far, if any, have the named joints.

        Raises:
            TopicError: they lack one; see `read_message` and `check_names`.
        """
        if self._doubt is not None and not self.is_met:
            raise self._doubt


def check_names(topic: str, message: JointMessage, expected: Sequence[str]) -> None:
    """Check that a message has the joints that the user named, if any.

    Raises:
        TopicError: a name is missing, or a message without names has another number of joints.
    """
    if not expected:
        return
    if not message.names and message.joints != len(expected):
        raise TopicError(
            f"{topic}: its messages carry no names and {message.joints} joints, but --joint-names "
            f"has {len(expected)}"
        )
    missing = [name for name in expected if name not in message.names]
    if message.names and missing:
        raise TopicError(
            one_line(
                f"{topic}: no joint {listed(missing)}; there are {listed(message.names)}: "
                "correct --joint-names"
            )
        )


def stamp_of(type_name: str, cdr: bytes) -> int:
    """Return the header stamp [ns]; 0 where it is not set or there is none."""
    if type_name != messages.JOINT_STATE or len(cdr) < 12:
        return 0
    order = "little" if cdr[1] & 1 else "big"
    seconds = int.from_bytes(cdr[4:8], order, signed=True)
    return seconds * 1_000_000_000 + int.from_bytes(cdr[8:12], order)
