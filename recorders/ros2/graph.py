"""Discover the publishers of a ROS 2 graph through DDS, and receive their messages as they come.

Only cyclonedds reads the message types: what arrives goes into the log as it came. It evaluates
their annotations, so they cannot wait as text (`from __future__ import annotations`).
"""

import os
import time
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import (
    DDSException,
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float32, float64, int32, sequence, uint32
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from tunenet_logs.errors import TopicError
from tunenet_logs.messages import JOINT_ANGLES, JOINT_STATE
from tunenet_logs.recorders.ros2 import dds_topic, ros_topic, ros_type
from tunenet_logs.timing.stamps import now_ns

# ---- Message types: fields as in sensor_msgs, std_msgs, builtin_interfaces and kinova_msgs


@final
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    """builtin_interfaces/msg/Time."""

    sec: int32
    nanosec: uint32


@final
@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    """std_msgs/msg/Header."""

    stamp: Time
    frame_id: str


@final
@dataclass
class JointState(IdlStruct, typename="sensor_msgs::msg::dds_::JointState_"):
    """sensor_msgs/msg/JointState [rad, rad/s, N·m]."""

    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@final
@dataclass
class JointAngles(IdlStruct, typename="kinova_msgs::msg::dds_::JointAngles_"):
    """kinova_msgs/msg/JointAngles: degrees, or N·m on a topic of torques."""

    joint1: float32
    joint2: float32
    joint3: float32
    joint4: float32
    joint5: float32
    joint6: float32
    joint7: float32


# By their names in ROS 2.
WIRE_TYPES: dict[str, type[IdlStruct]] = {JOINT_STATE: JointState, JOINT_ANGLES: JointAngles}


# ---- Subscription: the messages of one topic

_ANY_STATE = SampleState.Any | ViewState.Any | InstanceState.Any  # each sample is taken once
_MAX_AT_ONCE = 1000  # messages taken in one call: a second at 1 kHz; bounds memory after a pause
# Takes samples as they came; None in a version of cyclonedds without it.
_PRIVATE_TAKE: Any = getattr(import_module("cyclonedds._clayer"), "ddspy_take", None)
_Taken = tuple[bytes, Any]  # CDR, and what DDS knows of it: a `cyclonedds.internal.SampleInfo`


class Subscription:
    """A subscription to one topic, made by `Node.subscribe`.

    Keeps all that arrived until it is taken (KEEP_ALL): with a short history, a moment's pause of
    this process loses messages that nothing counts. Volatile durability, XCDR1 and the publisher's
    own reliability match every publisher of ROS 2.
    """

    def __init__(
        self, participant: DomainParticipant, topic: str, type_name: str, *, is_reliable: bool
    ) -> None:
        self.topic = topic  # as ROS 2 writes it
        self.type_name = type_name  # as ROS 2 writes it
        qos = Qos(
            Policy.Reliability.Reliable(max_blocking_time=duration(milliseconds=100))
            if is_reliable
            else Policy.Reliability.BestEffort,
            Policy.Durability.Volatile,
            Policy.History.KeepAll,
            # More than a minute and a half at 1 kHz.
            Policy.ResourceLimits(
                max_samples=100_000, max_instances=-1, max_samples_per_instance=-1
            ),
            Policy.DataRepresentation(use_cdrv0_representation=True),
            Policy.TypeConsistency.AllowTypeCoercion(),
        )
        self._topic = Topic(participant, dds_topic(topic), WIRE_TYPES[type_name])
        self._reader: DataReader[Any] = DataReader(participant, self._topic, qos=qos)
        self.condition = ReadCondition(self._reader, _ANY_STATE)  # something can be taken

    def take(self) -> Iterator[tuple[int, bytes]]:
        """Yield the messages since the last call: source timestamp [ns] and CDR."""
        is_more = True
        while is_more:
            with dds_failure(f"{self.topic}: receiving failed"):
                taken = take_raw(self._reader)
            is_more = len(taken) >= _MAX_AT_ONCE
            for data, info in taken:
                if info.valid_data:
                    stamp_ns = info.source_timestamp
                    # DDS writes infinity as this: such a stamp is no time
                    yield (stamp_ns if 0 < stamp_ns < 2**63 - 1 else now_ns()), data

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
        # Those that we request and a publisher may not offer, by DDS's numbers.
        named = {6: "ownership", 11: "reliability", 24: "definition of the type"}
        named[25] = "encoding (it offers no XCDR1)"
        number = int(self._reader.get_requested_incompatible_qos_status().last_policy_id)
        return named.get(number, f"QoS policy {number}")


def take_raw(reader: DataReader[Any]) -> Sequence[_Taken]:
    """Take messages as they came, as `DataReader.take` does before decoding."""
    # By a private name of cyclonedds: where a later version lacks it, `take_decoded` does it.
    if _PRIVATE_TAKE is None:
        return take_decoded(reader)
    taken = _PRIVATE_TAKE(reader._ref, _ANY_STATE, _MAX_AT_ONCE)
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


# ---- Node: discover publishers, and subscribe to them

# Finds nodes on this machine by multicast, and those that are configured to do without it.
_LOOPBACK = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/>\
</Interfaces></General><Discovery><ParticipantIndex>auto</ParticipantIndex>\
<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""


@dataclass(frozen=True)
class Publisher:
    """A published topic, of one publisher or several."""

    topic: str  # as ROS 2 writes it
    types: tuple[str, ...]  # the published types, as ROS 2 writes them
    is_reliable: bool  # whether every publisher's reliability is RELIABLE


class Node:
    """A participant of a DDS domain, as a ROS 2 node is; CYCLONEDDS_URI applies here, too."""

    def __init__(self, domain: int, *, is_loopback: bool) -> None:
        with dds_failure(
            f"domain {domain} cannot be joined; check network and CYCLONEDDS_URI, or try --loopback"
        ):
            if is_loopback:
                asked = os.environ.get("CYCLONEDDS_URI", "")
                self._domain = Domain(domain, ",".join(filter(None, (asked, _LOOPBACK))))
            self._participant = DomainParticipant(domain)
            self._waitset = WaitSet(self._participant)
            self._published = BuiltinDataReader(self._participant, BuiltinTopicDcpsPublication)

    def publishers(self) -> dict[str, Publisher]:
        """Return the publishers known now, by topic."""
        found: dict[str, list[tuple[str, bool]]] = {}
        for publication in self._published.read(100_000):  # more than any network of robots has
            topic = ros_topic(publication.topic_name)
            if topic is not None and publication.sample_info.instance_state == InstanceState.Alive:
                # Where it is unknown it is neither, and best effort matches.
                reliability = publication.qos[Policy.Reliability]
                is_reliable = isinstance(reliability, Policy.Reliability.Reliable)
                found.setdefault(topic, []).append((ros_type(publication.type_name), is_reliable))
        return {
            topic: Publisher(
                topic,
                tuple(sorted({type_name for type_name, _ in every})),
                all(is_reliable for _, is_reliable in every),
            )
            for topic, every in sorted(found.items())
        }

    def wait_for(
        self, topics: Collection[str], timeout_s: float, is_stopped: Callable[[], bool]
    ) -> dict[str, Publisher]:
        """Wait until all topics are published, or the time-out; return the publishers."""
        end = time.monotonic() + timeout_s
        while True:
            found = self.publishers()
            if found.keys() >= set(topics) or is_stopped() or time.monotonic() > end:
                return found
            time.sleep(0.02)  # [s]; discovery takes some tens of milliseconds

    def subscribe(self, publisher: Publisher, type_name: str) -> Subscription:
        """Subscribe to a topic."""
        with dds_failure(f"{publisher.topic} cannot be received"):
            made = Subscription(
                self._participant, publisher.topic, type_name, is_reliable=publisher.is_reliable
            )
            self._waitset.attach(made.condition)
        return made

    def wait(self, seconds: float) -> None:
        """Wait for a sample of any subscription, at most `seconds`."""
        with dds_failure("waiting for messages failed"):
            self._waitset.wait(duration(seconds=seconds))
