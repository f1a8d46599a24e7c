"""Record topics of a ROS 2 graph to a log: messages are kept as they came, gaps counted.

`Pace` measures a topic's rate and gaps by its stamps; `record_joints` records until a signal, the
end of the duration, or silence.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.serde import SerdeError

from tunenet_logs import messages
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import TopicError
from tunenet_logs.formats.base import DAMAGED
from tunenet_logs.recorders.orders import JointOrder
from tunenet_logs.recorders.ros2.graph import WIRE_TYPES, Node, Publisher, Subscription
from tunenet_logs.recorders.session import LiveRecording, Summary, stop_flag
from tunenet_logs.terminal import Bar, Progress, listed, one_line

# ---- Pace: sample rate and gaps by a topic's own stamps

# Intervals whose median is the usual one: 0.2 s at 1 kHz, so a rate that changes is followed.
_MIN_INTERVALS = 5  # without which there is no usual one


class Pace:
    """Sample rate and gaps, by the stamps: DDS does not count what overflowed its own buffer."""

    def __init__(self) -> None:
        self.samples = 0
        self._gaps = 0
        self._longest_gap_ns = 0
        self._last_ns: int | None = None
        self._recent: deque[int] = deque(maxlen=200)
        self._fresh: list[int] = []

    def add(self, stamp_ns: int) -> None:
        """Add the next sample, taken at `stamp_ns`."""
        self.samples += 1
        if self._last_ns is not None and stamp_ns > self._last_ns:
            self._fresh.append(stamp_ns - self._last_ns)
            # A median for each message would cost more than the rest.
            if len(self._fresh) >= 100:
                self._settle()
        self._last_ns = stamp_ns

    @property
    def rate_hz(self) -> float:
        """Rate of the last 200 samples, by their median interval [Hz]; 0 if unknown."""
        self._settle()
        # Samples that are closer than 10 us came in one piece, and show no rate.
        if len(self._recent) < _MIN_INTERVALS or self._usual_ns() < 10_000:
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
        # In a longer one a sample is missing, whatever the jitter. An arm does not get far in
        # 10 ms, and without a real-time kernel computers are late by that.
        longest_ns = max(2.5 * self._usual_ns(), 10_000_000)
        gaps = [interval_ns for interval_ns in fresh if interval_ns > longest_ns]
        self._gaps += len(gaps)
        self._longest_gap_ns = max(self._longest_gap_ns, *gaps, 0)

    def _usual_ns(self) -> float:
        return float(np.median(np.array(self._recent)))


# ---- Recording: several topics to one log


@dataclass(frozen=True)
class JointSummary:
    """Summary of a recording."""

    counts: Summary  # messages of all topics
    topics: Mapping[str, str]  # rate and gaps of each topic, in words

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
    """Record topics to a log until a signal, the end of the duration, or silence."""
    # `warn` is told what a user should know while it can still be changed.
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


class _Topic:
    """A topic while it is recorded: its pace, and what its messages say of joints."""

    def __init__(self, subscription: Subscription, expected: Sequence[str]) -> None:
        self.subscription = subscription
        self.name = subscription.topic
        self.pace = Pace()
        self.probed_s = 0.0
        self.is_known = False  # whether its joints have been judged
        self.silent_s = 0.0  # time since the last message
        self.is_met = False  # whether its messages have the named joints, or any
        self.has_positions = self.has_efforts = False  # whether one of them since then has
        self._expected = expected  # joints that the user named
        self._there: tuple[str, ...] = ()
        self._doubt: TopicError | None = None

    def hear(self, cdr: bytes) -> None:
        """Find out which joints a message has."""
        kind = self.subscription.type_name
        try:
            message: Any = messages.typestore().deserialize_cdr(cdr, kind)
        except (SerdeError, *DAMAGED) as error:
            self._doubt = TopicError(f"{self.name}: a message is no {kind} ({error})")
            return
        if kind == messages.JOINT_ANGLES:
            count, has_efforts = 7, "torque" in self.name.rpartition("/")[2]
            has_positions = not has_efforts
        else:
            parts = (message.name, message.position, message.velocity, message.effort)
            count = max(len(part) for part in parts)
            has_positions, has_efforts = len(message.position) > 0, len(message.effort) > 0
            self._there = tuple(dict.fromkeys((*self._there, *message.name)))
        expected, there = self._expected, self._there
        missing = [name for name in expected if name not in there]
        if expected and not there and count != len(expected):
            self._doubt = TopicError(
                f"{self.name}: its messages carry no names and {count} joints, but --joint-names "
                f"has {len(expected)}"
            )
        elif there and missing:
            self._doubt = TopicError(
                one_line(
                    f"{self.name}: no joint {listed(missing)}; there are {listed(there)}: "
                    "correct --joint-names"
                )
            )
        else:
            self.is_met = True
            self.has_positions |= has_positions
            self.has_efforts |= has_efforts

    @property
    def is_complete(self) -> bool:
        """Whether further messages cannot add anything."""
        return self.is_met and self.has_positions and self.has_efforts

    def check(self) -> None:
        """Check that the messages so far, if any, have the named joints."""
        if self._doubt is not None and not self.is_met:
            raise self._doubt

    def in_words(self) -> str:
        """Describe rate, gaps and losses."""
        return f"{self.pace.in_words()}, {self.subscription.lost} lost"

    def silence(self) -> str:
        """Describe how long nothing came, and why as far as DDS knows."""
        subscription = self.subscription
        words = f"no message on {self.name} for {self.silent_s:.1f} s"
        if subscription.unmatched and not subscription.publishers:
            return f"{words}: its publisher's {subscription.why_unmatched} does not go with ours"
        return words if subscription.publishers else f"{words}: its publisher is gone"


class _Session:
    """One recording."""

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
            _Topic(self._node.subscribe(published[topic], kind), order.joint_names)
            for topic, kind in types.items()
        ]

    def run(self) -> str:
        """Record; return why it ended, "" for its usual end."""
        try:
            ended = self._receive()
            for heard in self.heard:
                self._judge(heard)
        except TopicError as error:
            if not all(heard.is_met for heard in self.heard):
                raise
            ended = str(error)
        if not self._recording.captured:
            raise TopicError(f"{self._order.source}: {ended}; no log is left")
        return ended

    def count(self) -> None:
        """Write the counts to the log."""
        for heard in self.heard:
            pace, subscription = heard.pace, heard.subscription
            for what, number in (
                ("received", pace.samples),
                ("gaps", pace.gaps),
                ("lost", subscription.lost),
                ("longest_gap_ms", round(pace.longest_gap_s * 1000)),
            ):
                self._recording.count(f"{what}.{heard.name}", number)
            self._recording.note(f"measured_hz.{heard.name}", f"{pace.rate_hz:.3f}")
            if subscription.unmatched:
                said = f"{subscription.unmatched} publishers not heard"
                self._recording.note(f"unmatched.{heard.name}", said)

    def _receive(self) -> str:
        turn_s = shown_s = time.monotonic()
        first_s: float | None = None
        while True:
            self._node.wait(0.1)  # a signal to stop is heard within it
            is_stopped = self._stop.is_set()
            now_s = time.monotonic()
            # A process that was stopped was not waiting: a turn counts for a quarter of a second.
            passed_s, turn_s = min(now_s - turn_s, 0.25), now_s
            for heard in self.heard:
                if not self._take(heard, passed_s):
                    return ""  # the log ended by itself; closing it says why
            if first_s is None and self._recording.captured:
                first_s = now_s
            if is_stopped:
                before = "" if self._recording.captured else " before a message"
                return f"stopped by a signal{before}"
            for heard in self.heard:
                if heard.silent_s > self._order.timeout_s:
                    return heard.silence()
            seconds = self._order.seconds
            if seconds is not None and first_s is not None and now_s - first_s >= seconds:
                return ""
            if now_s - shown_s >= 0.5:
                shown_s = now_s
                self._bar.set_postfix_str(
                    "; ".join(f"{heard.name} {heard.in_words()}" for heard in self.heard),
                    refresh=False,
                )

    def _take(self, heard: _Topic, passed_s: float) -> bool:
        """Write a topic's new messages to the log; False once that is over."""
        count = 0
        subscription = heard.subscription
        for stamp_ns, cdr in subscription.take():
            if not heard.is_known:
                heard.hear(cdr)
            if not self._recording.put_message(heard.name, subscription.type_name, stamp_ns, cdr):
                return False
            told_ns = 0  # the header's stamp, where it is set
            if subscription.type_name == messages.JOINT_STATE and len(cdr) >= 12:
                order = "little" if cdr[1] & 1 else "big"
                seconds = int.from_bytes(cdr[4:8], order, signed=True)
                told_ns = seconds * 10**9 + int.from_bytes(cdr[8:12], order)
            heard.pace.add(told_ns or stamp_ns)
            count += 1
        heard.probed_s += passed_s if heard.pace.samples else 0.0
        # A topic is probed for a second before it is judged: it may have several publishers.
        if heard.is_complete or heard.probed_s >= 1.0:
            self._judge(heard)
        heard.silent_s = 0.0 if count else heard.silent_s + passed_s
        if count:
            self._bar.update(count)
        return True

    def _judge(self, heard: _Topic) -> None:
        """Check a topic's joints by its messages so far, once."""
        if heard.is_known:
            return
        heard.check()
        heard.is_known = True
        met = [other for other in self.heard if other.is_known and other.is_met]
        if len(met) == len(self.heard):
            lacking = [] if any(other.has_positions for other in met) else ["positions"]
            lacking += [] if any(other.has_efforts for other in met) else ["torques (effort)"]
            if lacking:
                self._warn(
                    f"no {' and no '.join(lacking)} in {', '.join(self._order.topics)}: a payload "
                    "needs both; name the topic that has them too"
                )

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
