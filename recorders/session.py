"""Common parts of recorders: stop on signals, queue and count messages, write them, summarize.

`record_episode` writes a simulated episode; `LiveRecording` takes live messages from any thread,
by way of a `TopicQueue`.
"""

from __future__ import annotations

import math
import signal
import threading
from array import array
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Generic, NamedTuple, Protocol, Self, TypeVar

from numpy.typing import ArrayLike

from tunenet_logs import messages
from tunenet_logs.copying import joint_states, joint_topics
from tunenet_logs.episode import Episode, EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.messages import CAMERA_TOPIC
from tunenet_logs.process import heard_wait
from tunenet_logs.recorders.simulators.arm.description import Arm
from tunenet_logs.terminal import Progress
from tunenet_logs.timing.stamps import Gap, now_ns
from tunenet_logs.writing.drawn import DrawnBall
from tunenet_logs.writing.writer import EpisodeWriter

# ---- Start and end: half-made objects, signals to stop, the summary


class Closable(Protocol):
    """What can be closed."""

    def close(self) -> None: ...  # noqa: D102


@contextmanager
def closed_on_failure(thing: Closable) -> Iterator[None]:
    """Close `thing` if the block raises; else leave it open."""
    with ExitStack() as failed:
        failed.callback(thing.close)
        yield
        failed.pop_all()


@dataclass(frozen=True)
class Summary:
    """Counts of a recording."""

    captured: int
    written: int
    dropped: int
    ended: str = ""  # why it ended before its source did; "" if it did not
    damaged: int = 0  # incomplete pictures; not in `captured`
    rate_hz: float = 0.0  # measured, of a camera
    gaps: tuple[Gap, ...] = ()  # in which the camera was away
    lag_s: float = 0.0  # longest lag of the writer, where it is worth mentioning
    stamps: str = ""  # which clock they come from, where it had to be fitted
    sound: str = ""  # what was recorded beside them, in words

    def in_words(self, unit: str) -> str:
        """Summarize the recording for the recorder's last line."""
        words = f"{self.captured} {unit} captured, {self.written} written, {self.dropped} dropped"
        if self.damaged:
            words += f", {self.damaged} damaged"
        if self.rate_hz:
            words += f", {self.rate_hz:.1f} Hz"
        if self.sound:
            words += f", {self.sound}"
        if self.gaps:
            all_s = sum(gap.seconds for gap in self.gaps)
            words += ", 1 gap of" if len(self.gaps) == 1 else f", {len(self.gaps)} gaps of together"
            words += f" {all_s:.1f} s"
        if self.stamps:
            words += f", {self.stamps}"
        if self.lag_s:
            words += f", up to {self.lag_s:.1f} s late"
        return words + (f" ({self.ended})" if self.ended else "")


@contextmanager
def stop_flag() -> Iterator[threading.Event]:
    """Yield an event that SIGINT, SIGTERM and SIGHUP set: raising would leave a torn log."""
    # SIGHUP, which a closed terminal or a lost connection sends, stays ignored under `nohup`.
    event = threading.Event()
    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    previous = {number: signal.signal(number, lambda *_: event.set()) for number in numbers}
    try:
        yield event
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


# ---- Simulated episode: written as if from sensors


def record_episode(
    episode: Episode,
    path: Path,
    *,
    overwrite: bool,
    progress: Progress,
    min_free_bytes: int = 0,
    arm: Arm | None = None,
) -> Summary:
    """Record positions, joints and pictures of a simulated episode as if from sensors.

    An `arm` that moves in it is drawn.
    """
    samples = list(_samples(episode, arm))
    total = len(samples) + sum(channel.messages for channel in episode.channels)
    write_frame = partial(EpisodeWriter.write_frame, topic=CAMERA_TOPIC)
    with (
        stop_flag() as stop,
        EpisodeWriter(
            path, episode.info, overwrite=overwrite, live=False, min_free_bytes=min_free_bytes
        ) as writer,
        progress.bar(total, "recording", "sample") as bar,
    ):
        frames = (partial(write_frame, frame=frame) for frame in episode.frames())
        for write in chain(samples, frames):
            if stop.is_set():
                break
            write(writer)
            bar.update(1)
        ended = "stopped by a signal" if stop.is_set() else ""
        writer.close(ended)
    return Summary(writer.accepted, writer.written, writer.accepted - writer.written, ended)


def _samples(episode: Episode, arm: Arm | None) -> Iterator[Callable[[EpisodeWriter], None]]:
    """Yield a writer call for each position and joint state, topic by topic, and what draws it."""
    joints = joint_topics(episode)
    of_joints = {id(part) for parts in joints.values() for part in parts.values()}
    radius_m = episode.info.rig.get("ball_diameter_m", 0.0) / 2
    is_drop = episode.info.kind == "drop" and bool(episode.info.truth)  # over a table at z = 0
    for topic, positions in episode.signals.items():
        if id(positions) not in of_joints:
            ball = DrawnBall(topic, radius_m, stands_on_table=is_drop)
            for stamp_ns, at_m in zip(positions.stamps_ns.tolist(), positions.values, strict=True):
                yield partial(ball.write, stamp_ns=stamp_ns, position_m=at_m)
    for topic, parts in joints.items():
        for _, _, write in joint_states(topic, parts):
            yield write
    if arm is not None:
        from tunenet_logs.recorders.simulators.arm.drawn import drawn_arm

        topic, parts = next(iter(joints.items()))
        for _, _, write in drawn_arm(arm, topic, parts["position"]):
            yield write


# ---- Queue: from the receiving threads to the writing one

Payload = TypeVar("Payload")


class Item(NamedTuple, Generic[Payload]):
    """A queued message."""

    topic: str
    stamp_ns: int  # of its acquisition
    received_ns: int  # when it came, on the clock of `tunenet_logs.timing.stamps`; never decreasing
    payload: Payload
    size_bytes: int  # of the payload
    follows_drop: bool = False  # whether the one before it on its topic was dropped


@dataclass
class Tally:
    """Counts of one topic."""

    captured: int = 0  # messages put in, including those dropped
    dropped: int = 0  # messages that found the queue full
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))  # the first 100,000


class TopicQueue(Generic[Payload]):
    """A counting queue for any number of topics and threads, bounded in bytes.

    Bounded in bytes, not in messages: a picture is a thousand times larger than a joint state. A
    message that is larger than the bound alone passes through an empty queue.
    """

    def __init__(self, limit_bytes: int, *, drops: bool, counts: bool = True) -> None:
        self._tallies: dict[str, Tally] = {}
        self._limit_bytes = limit_bytes  # of all messages that wait
        self._drops = drops  # the newest message where the queue is full; else `put` waits
        self._counts = counts  # whether messages count from the beginning; else from `start` on
        self._items: deque[Item[Payload]] = deque()
        self._held_bytes = 0
        self._closed = False
        self._last_ns = 0
        self._broken: set[str] = set()
        self._changed = threading.Condition()

    def put(
        self,
        topic: str,
        stamp_ns: int,
        payload: Payload,
        size_bytes: int,
        received_ns: int | None = None,
        *,
        stands_alone: bool = True,
    ) -> bool:
        """Add a message; False once the queue is closed: it is not counted then."""
        # One that does not stand alone is dropped where the one before it on its topic was.
        with self._changed:
            while not self._drops and self._is_full(size_bytes) and not self._closed:
                self._changed.wait()
            if self._closed:
                return False
            follows_drop = topic in self._broken
            is_full = self._is_full(size_bytes) or (follows_drop and not stands_alone)
            if self._counts:
                tally = self._tallies.get(topic)
                if tally is None:
                    tally = self._tallies[topic] = Tally()
                tally.captured += 1
                tally.dropped += is_full
                if len(tally.stamps_ns) < 100_000:  # half an hour of a camera, to measure its rate
                    tally.stamps_ns.append(stamp_ns)
            if is_full:
                self._broken.add(topic)
            else:
                self._broken.discard(topic)
                # Stamped under the lock, so that receipts never run backwards in the log.
                came_ns = now_ns() if received_ns is None else received_ns
                self._last_ns = max(self._last_ns, came_ns)
                self._items.append(
                    Item(topic, stamp_ns, self._last_ns, payload, size_bytes, follows_drop)
                )
                self._held_bytes += size_bytes
            return True

    def take(self) -> Item[Payload] | None:
        """Return the oldest message without waiting; None when there is none."""
        with self._changed:
            if not self._items:
                return None
            item = self._items.popleft()
            self._held_bytes -= item.size_bytes
            if not self._drops:
                self._changed.notify_all()
            return item

    def pause(self) -> None:
        """Let messages gather for a moment; return at once when the queue is closed."""
        # Messages do not end it: at a thousand a second, waking up for each is most of the work.
        # It is a small part of the 0.25 s that may be lost with the process.
        with self._changed:
            self._changed.wait_for(lambda: self._closed, 0.03)

    def start(self) -> None:
        """Discard the queued messages, and count from here on."""
        with self._changed:
            self._counts = True
            self._forget()

    def close(self) -> None:
        """Accept no more messages; those inside can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def cut(self, topic: str, taken: int) -> None:
        """Accept no more messages; those inside count as if they had never come."""
        with self._changed:
            if topic in self._tallies:
                self._tallies[topic].captured -= len(self._items) + taken
            self._closed = True
            self._forget()

    def tally(self, topic: str) -> Tally:
        """Return the counts of a topic so far."""
        with self._changed:
            return self._tallies.get(topic) or Tally()

    @property
    def topics(self) -> tuple[str, ...]:
        """Topics with messages, in order of their first."""
        with self._changed:
            return tuple(self._tallies)

    @property
    def captured(self) -> int:
        """Number of messages put in, including those dropped."""
        with self._changed:
            return sum(tally.captured for tally in self._tallies.values())

    @property
    def dropped(self) -> int:
        """Number of messages that found the queue full."""
        with self._changed:
            return sum(tally.dropped for tally in self._tallies.values())

    @property
    def is_done(self) -> bool:
        """Whether it is closed and empty."""
        with self._changed:
            return self._closed and not self._items

    def _forget(self) -> None:
        self._items.clear()
        self._held_bytes = 0
        self._changed.notify_all()

    def _is_full(self, size_bytes: int) -> bool:
        return bool(self._items) and self._held_bytes + size_bytes > self._limit_bytes


# ---- Live recording: several streams, from several threads, to one log


class LiveRecording:
    """A log that any thread may put messages into; a thread of its own writes it.

    Messages are encoded in the thread that puts them, so arrays may be reused afterwards, and
    encoding errors are raised there. When the writer falls behind by `queue_bytes`, the newest
    messages are dropped and counted. A context manager, it raises at the end what ended it early.

        with stop_flag() as stop, LiveRecording(path, info, stop=stop) as recording:
            ...  # threads that put
            recording.wait()
        print(recording.summary.in_words("messages"))
    """

    def __init__(
        self,
        path: Path,
        info: EpisodeInfo,
        *,
        stop: threading.Event | None = None,
        overwrite: bool = False,
        queue_bytes: int = 64 * 1024 * 1024,
        min_free_bytes: int = 0,
    ) -> None:
        self.error: LogError | None = None  # what ended the recording early; None if nothing did
        self.summary = Summary(0, 0, 0)  # counts, once it is over
        self._writer = EpisodeWriter(path, info, overwrite=overwrite, min_free_bytes=min_free_bytes)
        self._writer.tally = self._count
        # Type name and CDR.
        self._queue: TopicQueue[tuple[str, bytes]] = TopicQueue(queue_bytes, drops=True)
        # Ends the recording once it is set, as `stop_flag` does.
        self._stop = stop or threading.Event()
        self._types: dict[str, str] = {}
        self._ended = ""
        self._counted: dict[str, int] = {}
        self._is_discarded = False
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="log writer")
        self._thread.start()

    def put_frame(self, topic: str, frame: Frame) -> bool:
        """Put an image as it is; False once the recording is over."""
        type_name, data = messages.frame(frame)
        return self.put_message(topic, type_name, frame.stamp_ns, data)

    def put_joints(
        self,
        topic: str,
        stamp_ns: int,
        names: Sequence[str],
        position_rad: ArrayLike,
        velocity_rad_s: ArrayLike = (),
        effort_nm: ArrayLike = (),
    ) -> bool:
        """Put a JointState; False once the recording is over."""
        # The quantities have shape (joints,) [rad, rad/s, N·m]; one that is not known is empty.
        state = messages.joint_state(stamp_ns, names, position_rad, velocity_rad_s, effort_nm)
        data = messages.encode(state, messages.JOINT_STATE)
        return self.put_message(topic, messages.JOINT_STATE, stamp_ns, data)

    def put_message(self, topic: str, type_name: str, stamp_ns: int, cdr: bytes) -> bool:
        """Put a message already encoded as CDR; False once the recording is over."""
        known = self._types.get(topic)
        if known is None:
            messages.definition(type_name)
            known = self._types.setdefault(topic, type_name)
        if known != type_name:
            raise ValueError(f"{topic} holds {known}, so it cannot hold {type_name}")
        return self._queue.put(topic, stamp_ns, (type_name, cdr), len(cdr))

    def note(self, name: str, text: str) -> None:
        """Add a note to the log's info while recording."""
        self._writer.note(name, text)

    def count(self, name: str, number: int) -> None:
        """Add a number to the counts of the log's info, such as samples lost on a bus."""
        self._counted[name] = number

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until the recording is over, at most `seconds`; True if it is over."""
        return heard_wait(self._is_over.wait, math.inf if seconds is None else seconds)

    def close(self, ended: str = "") -> Summary:
        """End the recording, and wait until the log is complete. Safe to call twice."""
        self._ended = ended
        self._queue.close()
        self._thread.join()
        if self.error is not None:
            raise self.error
        return self.summary

    def discard(self) -> None:
        """End the recording and leave no log."""
        self._is_discarded = True
        self.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_more: object) -> None:
        self.close("" if kind is None else f"broke off ({kind.__name__})")

    @property
    def captured(self) -> int:
        """Number of messages put so far, including those dropped."""
        return self._queue.captured

    @property
    def dropped(self) -> int:
        """Number of messages dropped so far."""
        return self._queue.dropped

    @property
    def written(self) -> int:
        """Number of messages in the file, which survive a crash of this process."""
        return self._writer.written

    def _run(self) -> None:
        ended = ""
        try:
            with self._writer:
                queue, writer = self._queue, self._writer
                while not queue.is_done:
                    if not ended and self._stop.is_set():
                        ended = "stopped by a signal"
                        queue.close()
                    if (item := queue.take()) is None:
                        writer.tick()
                        queue.pause()
                    else:
                        kind, data = item.payload
                        writer.write_message(
                            item.topic, kind, item.stamp_ns, data, item.received_ns
                        )
                ended = ended or self._ended
                if self._is_discarded:
                    writer.discard()
                else:
                    writer.close(ended)
        except LogError as error:
            self.error = error
        except Exception as error:  # noqa: BLE001 (in a thread, else nobody would hear of it)
            self.error = LogError(f"{self._writer.path}: writing failed ({error!r})")
            self.error.__cause__ = error
        finally:
            self._queue.close()
            counts = self._writer.info.counts
            captured, written, dropped = map(counts.get, ("captured", "written", "dropped"))
            why = ended if self.error is None else str(self.error)
            self.summary = Summary(captured or 0, written or 0, dropped or 0, why)
            self._is_over.set()

    def _count(self) -> dict[str, int]:
        """Close the queue; return the counts."""
        self._queue.close()
        counts = {"captured": self._queue.captured}
        for topic in self._queue.topics:
            if dropped := self._queue.tally(topic).dropped:
                counts[f"dropped.{topic}"] = dropped
        return counts | self._counted
