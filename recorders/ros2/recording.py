"""Record topics of a ROS 2 graph to a log: messages are kept as they came, gaps counted.

`TopicProbe` finds out which joints a topic has, `Pace` measures its rate and gaps by its stamps;
`record_joints` records until a signal, the end of the duration, or silence.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.serde import SerdeError

from tunenet_logs import messages
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import TopicError
from tunenet_logs.formats.base import DAMAGED
from tunenet_logs.recorders.ros2.graph import WIRE_TYPES, Node, Publisher, Subscription
from tunenet_logs.recorders.session import LiveRecording, Summary, stop_flag
from tunenet_logs.terminal import Bar, Progress, listed, one_line

# ---- Joints: what messages report of them, as far as a recording needs it


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


# ---- Pace: sample rate and gaps by a topic's own stamps

# Intervals that are judged in one go: a median for each message would cost more than the rest.
_JUDGED_INTERVALS = 100

# Intervals whose median is the usual one: 0.2 s at 1 kHz, so a rate that changes is followed.
_USUAL_INTERVALS = 200
_MIN_INTERVALS = 5  # without which there is no usual one

# A gap is longer than so many usual intervals: a sample is missing, whatever the jitter. And it is
# longer than 10 ms: an arm does not get far in less, and without a real-time kernel computers are
# late by that.
_MIN_GAP_PERIODS, _MIN_GAP_NS = 2.5, 10_000_000

_MIN_INTERVAL_NS = 10_000  # samples that are closer came in one piece, and show no rate


class Pace:
    """Sample rate and gaps, in constant memory.

    DDS counts the samples it knows to be lost, but not those that overflowed its own buffer. So the
    stamps are checked: a gap is an interval of more than 2.5 median ones, and of 10 ms.
    """

    def __init__(self) -> None:
        self.samples = 0
        self._gaps = 0
        self._longest_gap_ns = 0
        self._last_ns: int | None = None
        self._recent: deque[int] = deque(maxlen=_USUAL_INTERVALS)
        self._fresh: list[int] = []

    def add(self, stamp_ns: int) -> None:
        """Add the next sample, taken at `stamp_ns`."""
        self.samples += 1
        if self._last_ns is not None and stamp_ns > self._last_ns:
            self._fresh.append(stamp_ns - self._last_ns)
            if len(self._fresh) >= _JUDGED_INTERVALS:
                self._settle()
        self._last_ns = stamp_ns

    @property
    def rate_hz(self) -> float:
        """Rate of the last 200 samples, by their median interval [Hz]; 0 if unknown."""
        self._settle()
        if len(self._recent) < _MIN_INTERVALS or self._usual_ns() < _MIN_INTERVAL_NS:
            return 0.0
        return 1e9 / self._usual_ns()

    @property
    def gaps(self) -> int:
        """Number of gaps so far."""
        self._settle()
        return self._gaps

    @property
    def longest_gap_s(self) -> float:
        """Longest interval with a gap, from sample to sample [s]; 0 without a gap."""
        self._settle()
        return self._longest_gap_ns * 1e-9

    def in_words(self) -> str:
        """Describe rate and gaps, such as "999.8 Hz, 2 gaps (0.50 s at most)"."""
        if not self.gaps:
            return f"{self.rate_hz:.1f} Hz, no gap"
        plural = "" if self.gaps == 1 else "s"
        return (
            f"{self.rate_hz:.1f} Hz, {self.gaps} gap{plural} ({self.longest_gap_s:.2f} s at most)"
        )

    def _settle(self) -> None:
        """Judge the intervals since the last time."""
        if len(self._recent) + len(self._fresh) < _MIN_INTERVALS:
            return
        fresh, self._fresh = self._fresh, []
        self._recent.extend(fresh)
        longest_ns = max(_MIN_GAP_PERIODS * self._usual_ns(), _MIN_GAP_NS)
        gaps = [interval_ns for interval_ns in fresh if interval_ns > longest_ns]
        self._gaps += len(gaps)
        self._longest_gap_ns = max(self._longest_gap_ns, *gaps, 0)

    def _usual_ns(self) -> float:
        return float(np.median(np.array(self._recent)))


# ---- Recording: several topics to one log

_MAX_WAIT_S = 0.1  # for a message: a signal to stop is heard within it
_SHOW_S = 0.5  # between two updates of the line on the terminal
_MEETING_S = 1.0  # for which a topic is probed before it is judged: it may have several publishers
_MAX_TURN_S = 0.25  # counted of a turn of the loop: a process that was stopped was not waiting


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
            self._node.wait(_MAX_WAIT_S)
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
