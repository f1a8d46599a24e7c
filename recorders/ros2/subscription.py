"""Receive the messages of one ROS 2 topic as they come over DDS."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from cyclonedds.core import (
    DDSException,
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
)
from cyclonedds.domain import DomainParticipant
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from recorders.ros2.names import dds_topic
from recorders.ros2.wire_types import WIRE_TYPES
from tunenet_logs.clock import now_ns
from tunenet_logs.errors import TopicError

# Samples in whatever state: each is taken once.
_ANY = SampleState.Any | ViewState.Any | InstanceState.Any

# Messages taken in one call: a second at 1 kHz, and bounded memory after a pause.
_MAX_AT_ONCE = 1000

_MAX_WAITING = 100_000  # messages of a topic; more than a minute and a half at 1 kHz
_LAST_NS = 2**63 - 1  # DDS writes infinity as this: such a stamp is no time
# What ours asks for that a publisher may not offer, by DDS's numbers.
_POLICIES = {
    6: "ownership",
    11: "reliability",
    25: "encoding (it offers no XCDR1)",
    24: "definition of the type",
}

# Takes samples as they came; None in a version of cyclonedds without it.
_PRIVATE_TAKE: Any = getattr(import_module("cyclonedds._clayer"), "ddspy_take", None)

_Taken = tuple[bytes, Any]  # CDR, and what DDS knows of it: a `cyclonedds.internal.SampleInfo`


class Subscription:
    """A subscription to one topic, made by `Node.subscribe`.

    Keeps all that arrived until it is taken (KEEP_ALL): with a short history, a moment's pause of
    this process loses messages that nothing counts. Volatile durability, XCDR1 and the publisher's
    own reliability match every publisher of ROS 2.

    Attributes:
        topic: as ROS 2 writes it.
        type_name: as ROS 2 writes it.
        condition: triggered while there is something to take.

    Raises:
        DDSException: DDS refuses.
    """

    def __init__(
        self, participant: DomainParticipant, topic: str, type_name: str, *, is_reliable: bool
    ) -> None:
        self.topic = topic
        self.type_name = type_name
        qos = Qos(
            Policy.Reliability.Reliable(max_blocking_time=duration(milliseconds=100))
            if is_reliable
            else Policy.Reliability.BestEffort,
            Policy.Durability.Volatile,
            Policy.History.KeepAll,
            Policy.ResourceLimits(
                max_samples=_MAX_WAITING, max_instances=-1, max_samples_per_instance=-1
            ),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.TypeConsistency.AllowTypeCoercion(),
        )
        self._topic = Topic(participant, dds_topic(topic), WIRE_TYPES[type_name])
        self._reader: DataReader[Any] = DataReader(participant, self._topic, qos=qos)
        self.condition = ReadCondition(self._reader, _ANY)

    def take(self) -> Iterator[tuple[int, bytes]]:
        """Yield the messages since the last call: source timestamp [ns] and CDR.

        Raises:
            TopicError: DDS failed.
        """
        is_more = True
        while is_more:
            with dds_failure(f"{self.topic}: receiving failed"):
                taken = take_raw(self._reader)
            is_more = len(taken) >= _MAX_AT_ONCE
            for data, info in taken:
                if info.valid_data:
                    stamp_ns = info.source_timestamp
                    yield (stamp_ns if 0 < stamp_ns < _LAST_NS else now_ns()), data

    @property
    def lost(self) -> int:
        """Number of messages that DDS knows to be lost."""
        return int(self._reader.get_sample_lost_status().total_count)

    @property
    def publishers(self) -> int:
        """Number of publishers matched now."""
        return int(self._reader.get_subscription_matched_status().current_count)

    @property
    def unmatched(self) -> int:
        """Number of publishers so far with incompatible QoS."""
        return int(self._reader.get_requested_incompatible_qos_status().total_count)

    @property
    def why_unmatched(self) -> str:
        """The QoS policy in which the last of those is incompatible."""
        number = int(self._reader.get_requested_incompatible_qos_status().last_policy_id)
        return _POLICIES.get(number, f"QoS policy {number}")


def take_raw(reader: DataReader[Any]) -> Sequence[_Taken]:
    """Take messages as they came, as `DataReader.take` does before decoding.

    By a private name of cyclonedds: where a later version lacks it, `take_decoded` does it.
    """
    if _PRIVATE_TAKE is None:
        return take_decoded(reader)
    taken = _PRIVATE_TAKE(reader._ref, _ANY, _MAX_AT_ONCE)
    if isinstance(taken, int):
        raise DDSException(taken)
    return taken


def take_decoded(reader: DataReader[Any]) -> Sequence[_Taken]:
    """Take messages by the public interface of cyclonedds: decoded, and encoded again."""
    return [
        (
            sample.serialize(use_version_2=False) if sample.sample_info.valid_data else b"",
            sample.sample_info,
        )
        for sample in reader.take(_MAX_AT_ONCE)
    ]


@contextmanager
def dds_failure(what: str) -> Iterator[None]:
    """Raise a failure of DDS as a `TopicError` of one line."""
    try:
        yield
    except DDSException as error:
        raise TopicError(f"ROS 2: {what} ({error})") from error
