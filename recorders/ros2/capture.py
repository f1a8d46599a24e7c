"""Record topics of a ROS 2 graph to a log: messages are kept as they came, gaps counted."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from recorders.live import LiveRecording
from recorders.ros2.joint_message import TopicProbe, stamp_of
from recorders.ros2.node import Node, Publisher
from recorders.ros2.pace import Pace
from recorders.ros2.subscription import Subscription
from recorders.ros2.wire_types import WIRE_TYPES
from recorders.session import Summary, stop_flag
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import TopicError
from tunenet_logs.terminal import Bar, Progress, listed, one_line

_WAIT_S = 0.1  # the longest wait for a message: a signal to stop is heard within it
_SHOW_S = 0.5  # between two updates of the line on the terminal
# How long a topic is looked at before it is judged: it may have several publishers.
_MEETING_S = 1.0

# What a turn of the loop counts for at most: a process that was stopped has not been waiting.
_MAX_TURN_S = 0.25


@dataclass(frozen=True)
class JointOrder:
    """What to record.

    Attributes:
        topics: as ROS 2 writes them.
        joint_names: required joints; for messages without names, theirs in order.
        seconds: duration from the first message on; None: until a signal.
        timeout_s: the longest to wait for a publisher, or that a topic may be silent.
        domain: as ROS_DOMAIN_ID, 0 to 232.
        is_loopback: whether to stay on this machine.
        min_free_bytes: space to leave free on the disk; 0 for no such bound.
    """

    topics: tuple[str, ...]
    joint_names: tuple[str, ...] = ()
    seconds: float | None = None
    timeout_s: float = 5.0
    domain: int = 0
    is_loopback: bool = False
    min_free_bytes: int = 0

    @property
    def source(self) -> str:
        """The topics, in words."""
        return f"ros2 {', '.join(self.topics)}"


@dataclass(frozen=True)
class JointSummary:
    """Summary of a recording.

    Attributes:
        counts: messages of all topics.
        topics: rate and gaps of each topic, in words.
    """

    counts: Summary
    topics: Mapping[str, str]

    def in_words(self) -> str:
        """Summarize the recording for the recorder's last line."""
        each = "; ".join(f"{topic} {words}" for topic, words in self.topics.items())
        return f"{each}; {self.counts.in_words('messages')}"


def record_joints(
    order: JointOrder,
    path: Path,
    *,
    overwrite: bool,
    progress: Progress,
    warn: Callable[[str], None],
) -> JointSummary:
    """Record topics to a log until a signal, the end of the duration, or silence.

    `warn` is told what a user should know while it can still be changed.

    Raises:
        TopicError: a topic is not published, of an unsupported type, silent, or lacks the named
            joints; no log is left.
        LogError: `path` exists or cannot be written, or its disk has too little space; what was
            written before is kept.
    """
    notes = {"domain": str(order.domain)}
    if order.joint_names:
        notes["joint_names"] = ",".join(order.joint_names)
    info = EpisodeInfo(kind="payload", source=order.source, notes=notes)
    with (
        stop_flag() as stop,
        LiveRecording(
            path, info, overwrite=overwrite, min_free_bytes=order.min_free_bytes
        ) as recording,
        progress.bar(None, "recording", "message") as bar,
    ):
        try:
            session = _Session(order, recording, stop, bar, warn)
            ended = session.run()
        except Exception as error:
            if isinstance(error, TopicError) or not recording.captured:
                recording.discard()
            raise
        session.count()
        summary = recording.close(ended)
    return JointSummary(summary, {heard.name: heard.in_words() for heard in session.heard})


@dataclass
class _Heard:
    """A topic's state while recording.

    Attributes:
        meeting: probe of its joints.
        meeting_s: how long it has been probed.
        is_known: whether the probe is over.
        silent_s: time since the last message.
    """

    subscription: Subscription
    meeting: TopicProbe
    pace: Pace = field(default_factory=Pace)
    meeting_s: float = 0.0
    is_known: bool = False
    silent_s: float = 0.0

    @property
    def name(self) -> str:
        return self.subscription.topic

    def in_words(self) -> str:
        """Describe rate, gaps and losses."""
        return f"{self.pace.in_words()}, {self.subscription.lost} lost"

    def silence(self) -> str:
        """Describe how long nothing came, and why as far as DDS knows."""
        subscription = self.subscription
        words = f"no message on {subscription.topic} for {self.silent_s:.1f} s"
        if subscription.unmatched and not subscription.publishers:
            return f"{words}: its publisher's {subscription.why_unmatched} does not go with ours"
        return words if subscription.publishers else f"{words}: its publisher is gone"


class _Session:
    """One recording.

    Raises:
        TopicError: a topic is not published, or of an unsupported type.
    """

    def __init__(
        self,
        order: JointOrder,
        recording: LiveRecording,
        stop: threading.Event,
        bar: Bar,
        warn: Callable[[str], None],
    ) -> None:
        self._order = order
        self._recording = recording
        self._stop = stop
        self._bar = bar
        self._warn = warn
        self._node = Node(order.domain, is_loopback=order.is_loopback)
        published = self._node.wait_for(order.topics, order.timeout_s, stop.is_set)
        if not published.keys() >= set(order.topics):
            raise TopicError(self._not_published(published))
        types = {topic: _known_type(published[topic]) for topic in order.topics}
        self.heard = [
            _Heard(
                self._node.subscribe(published[topic], types[topic]),
                TopicProbe(topic, types[topic], order.joint_names),
            )
            for topic in order.topics
        ]

    def run(self) -> str:
        """Record; return why it ended, "" for its usual end.

        Raises:
            TopicError: nothing came, or not the named joints.
        """
        try:
            ended = self._receive()
            for heard in self.heard:
                self._judge(heard)
        except TopicError as error:
            if not self._is_heard:
                raise
            ended = str(error)
        if not self._recording.captured:
            raise TopicError(f"{self._order.source}: {ended}; no log is left")
        return ended

    def count(self) -> None:
        """Write the counts to the log."""
        for heard in self.heard:
            self._recording.count(f"received.{heard.name}", heard.pace.samples)
            self._recording.count(f"gaps.{heard.name}", heard.pace.gaps)
            self._recording.count(f"lost.{heard.name}", heard.subscription.lost)
            gap_ms = round(heard.pace.longest_gap_s * 1000)
            self._recording.count(f"longest_gap_ms.{heard.name}", gap_ms)
            self._recording.note(f"measured_hz.{heard.name}", f"{heard.pace.rate_hz:.3f}")
            if heard.subscription.unmatched:
                self._recording.note(
                    f"unmatched.{heard.name}",
                    f"{heard.subscription.unmatched} publishers not heard",
                )

    @property
    def _is_heard(self) -> bool:
        return all(heard.meeting.is_met for heard in self.heard)

    def _receive(self) -> str:
        turn_s = shown_s = time.monotonic()
        first_s: float | None = None
        while True:
            self._node.wait(_WAIT_S)
            is_stopped = self._stop.is_set()
            now_s = time.monotonic()
            passed_s, turn_s = min(now_s - turn_s, _MAX_TURN_S), now_s
            for heard in self.heard:
                if not self._take(heard, passed_s):
                    return ""  # the log ended by itself; closing it says why
            if first_s is None and self._recording.captured:
                first_s = now_s
            if ended := self._ending(is_stopped=is_stopped):
                return ended
            seconds = self._order.seconds
            if seconds is not None and first_s is not None and now_s - first_s >= seconds:
                return ""
            if now_s - shown_s >= _SHOW_S:
                shown_s = now_s
                self._bar.set_postfix_str(
                    "; ".join(f"{heard.name} {heard.in_words()}" for heard in self.heard),
                    refresh=False,
                )

    def _take(self, heard: _Heard, passed_s: float) -> bool:
        """Write a topic's new messages to the log; False once that is over."""
        count = 0
        subscription = heard.subscription
        for stamp_ns, cdr in subscription.take():
            if not heard.is_known:
                heard.meeting.hear(cdr)
            if not self._recording.put_message(heard.name, subscription.type_name, stamp_ns, cdr):
                return False
            heard.pace.add(stamp_of(subscription.type_name, cdr) or stamp_ns)
            count += 1
        heard.meeting_s += passed_s if heard.pace.samples else 0.0
        if heard.meeting.is_complete or heard.meeting_s >= _MEETING_S:
            self._judge(heard)
        heard.silent_s = 0.0 if count else heard.silent_s + passed_s
        if count:
            self._bar.update(count)
        return True

    def _judge(self, heard: _Heard) -> None:
        """Check a topic's joints by its messages so far, once.

        Raises:
            TopicError: it lacks the named joints.
        """
        if heard.is_known:
            return
        heard.meeting.check()
        heard.is_known = True
        met = [other.meeting for other in self.heard if other.is_known and other.meeting.is_met]
        if len(met) == len(self.heard):
            lacking = [] if any(other.has_positions for other in met) else ["positions"]
            lacking += [] if any(other.has_efforts for other in met) else ["torques (effort)"]
            if lacking:
                self._warn(
                    f"no {' and no '.join(lacking)} in {', '.join(self._order.topics)}: a payload "
                    "needs both; name the topic that has them too"
                )

    def _ending(self, *, is_stopped: bool) -> str:
        if is_stopped:
            captured = self._recording.captured
            return "stopped by a signal" if captured else "stopped by a signal before a message"
        silent = [heard for heard in self.heard if heard.silent_s > self._order.timeout_s]
        return silent[0].silence() if silent else ""

    def _not_published(self, published: Mapping[str, Publisher]) -> str:
        missing = [topic for topic in self._order.topics if topic not in published]
        where = f"domain {self._order.domain}"
        if self._order.is_loopback:
            where += " of this machine"
        if self._stop.is_set():
            return f"{listed(missing)}: stopped by a signal before it was published; no log is left"
        found = [
            f"{publisher.topic} ({', '.join(publisher.types)})" for publisher in published.values()
        ]
        there = f"there are {listed(found)}" if found else "no topic is published there"
        return one_line(
            f"{listed(missing)}: not published on {where} within {self._order.timeout_s:g} s; "
            f"{there}; check the name, --domain and the network"
        )


def _known_type(publisher: Publisher) -> str:
    known = [name for name in publisher.types if name in WIRE_TYPES]
    if not known:
        raise TopicError(
            one_line(
                f"{publisher.topic}: it is {' and '.join(publisher.types)}; what can be recorded "
                f"live is {' and '.join(WIRE_TYPES)}"
            )
        )
    return known[0]
