"""Discover publishers in a ROS 2 graph through DDS, and subscribe to them."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import InstanceState, Policy, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.util import duration

from recorders.ros2.names import ros_topic, ros_type
from recorders.ros2.subscription import Subscription, dds_failure

# Finds nodes by multicast on that interface, and those that were told to do without.
_LOOPBACK = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface address="127.0.0.1"/>\
</Interfaces></General><Discovery><ParticipantIndex>auto</ParticipantIndex>\
<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""

_MAX_PUBLISHERS = 100_000  # read from discovery at once: more than any network of robots has
_LOOK_AGAIN_S = 0.02  # between two looks for publishers: discovery takes some tens of milliseconds


@dataclass(frozen=True)
class Publisher:
    """A published topic, of one publisher or several.

    Attributes:
        topic: as ROS 2 writes it.
        types: the published types, as ROS 2 writes them.
        is_reliable: whether every publisher's reliability is RELIABLE.
    """

    topic: str
    types: tuple[str, ...]
    is_reliable: bool


class Node:
    """A participant of a DDS domain, as a ROS 2 node is; CYCLONEDDS_URI applies here, too.

    Args:
        domain: as ROS_DOMAIN_ID, 0 to 232.
        is_loopback: whether to stay on this machine.

    Raises:
        TopicError: the domain cannot be joined.
    """

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
        for publication in self._published.read(_MAX_PUBLISHERS):
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
            time.sleep(_LOOK_AGAIN_S)

    def subscribe(self, publisher: Publisher, type_name: str) -> Subscription:
        """Subscribe to a topic.

        Raises:
            TopicError: DDS refuses.
        """
        with dds_failure(f"{publisher.topic} cannot be received"):
            made = Subscription(
                self._participant, publisher.topic, type_name, is_reliable=publisher.is_reliable
            )
            self._waitset.attach(made.condition)
        return made

    def wait(self, seconds: float) -> None:
        """Wait for a sample of any subscription, at most `seconds`.

        Raises:
            TopicError: DDS failed.
        """
        with dds_failure("waiting for messages failed"):
            self._waitset.wait(duration(seconds=seconds))
