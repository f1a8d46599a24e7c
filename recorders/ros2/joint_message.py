"""What one message says of joints, as far as a recording has to know."""

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
    """What a message holds.

    Attributes:
        names: of its joints; empty where it carries none.
        joints: how many there are.
        has_positions: whether it says where they are.
        has_efforts: whether it says their torques.
    """

    names: tuple[str, ...]
    joints: int
    has_positions: bool
    has_efforts: bool


def read_message(topic: str, type_name: str, cdr: bytes) -> JointMessage:
    """Look into a message.

    Raises:
        TopicError: it is not what its type says.
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
    """What the publishers of a topic say of joints, until that is known.

    There may be several, such as an arm's and a gripper's: whichever comes first says nothing of
    the others.

    Attributes:
        is_met: its messages so far have the joints that the user named, or any if none were named.
        has_positions: from then on, one says where they are.
        has_efforts: likewise, their torques.

    Args:
        topic: as ROS 2 writes it.
        type_name: likewise.
        expected: joints that the user named.
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
        """Whether further messages cannot tell more."""
        return self.is_met and self.has_positions and self.has_efforts

    def hear(self, cdr: bytes) -> None:
        """Look at a message."""
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
        """Check that what was heard, if anything was, has the joints.

        Raises:
            TopicError: it has not; see `read_message` and `check_names`.
        """
        if self._doubt is not None and not self.is_met:
            raise self._doubt


def check_names(topic: str, message: JointMessage, expected: Sequence[str]) -> None:
    """Check that the joints are those that the user named, if any were named.

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
    """The header's stamp [ns]; 0 where it is not set or there is none."""
    if type_name != messages.JOINT_STATE or len(cdr) < 12:
        return 0
    order = "little" if cdr[1] & 1 else "big"
    seconds = int.from_bytes(cdr[4:8], order, signed=True)
    return seconds * 1_000_000_000 + int.from_bytes(cdr[8:12], order)
