"""Record several live streams, from several threads, to one log."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from numpy.typing import ArrayLike

from recorders.session import Summary
from recorders.topic_queue import TopicQueue
from tunenet_logs import messages
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.writer import EpisodeWriter

_Encoded = tuple[str, bytes]  # type name, CDR


class LiveRecording:
    """A log that any thread may put messages into; a thread of its own writes it.

    Messages are encoded in the thread that puts them, so arrays may be reused afterwards, and
    encoding errors are raised there. When the writer falls behind by `queue_bytes`, the newest
    messages are dropped and counted. A context manager, it raises at the end what ended it early.

        with stop_flag() as stop, LiveRecording(path, info, stop=stop) as recording:
            ...  # threads that put
            recording.wait()
        print(recording.summary.in_words("messages"))

    Args:
        path: the finished log.
        info: metadata beside the samples.
        stop: ends the recording once it is set, as `session.stop_flag` does.
        overwrite: replace an existing log.
        queue_bytes: messages received and not yet written.
        min_free_bytes: space to leave free on the disk; 0 for no such bound.

    Attributes:
        error: what ended the recording early; None if nothing did.
        summary: counts, once it is over.

    Raises:
        LogError: `path` exists or cannot be written, or its disk has too little space.
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
        self.error: LogError | None = None
        self.summary = Summary(0, 0, 0)
        self._writer = EpisodeWriter(path, info, overwrite=overwrite, min_free_bytes=min_free_bytes)
        self._writer.tally = self._count
        self._queue: TopicQueue[_Encoded] = TopicQueue(queue_bytes, drops=True)
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
        """Put a JointState; False once the recording is over.

        The quantities have shape (joints,) [rad, rad/s, N·m]; one that is not known is empty.

        Raises:
            ValueError: a quantity is neither empty nor one number a joint.
        """
        state = messages.joint_state(stamp_ns, names, position_rad, velocity_rad_s, effort_nm)
        data = messages.encode(state, messages.JOINT_STATE)
        return self.put_message(topic, messages.JOINT_STATE, stamp_ns, data)

    def put_message(self, topic: str, type_name: str, stamp_ns: int, cdr: bytes) -> bool:
        """Put a message already encoded as CDR; False once the recording is over.

        Raises:
            ValueError: the type is unknown, or differs from the topic's.
        """
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
        return self._is_over.wait(seconds)

    def close(self, ended: str = "") -> Summary:
        """End the recording, and wait until the log is complete. Safe to call twice.

        Args:
            ended: why, where that is not its usual end.

        Raises:
            LogError: writing failed, or the disk is nearly full; it says how much is kept, where.
        """
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
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
                ended = self._write()
                if self._is_discarded:
                    self._writer.discard()
                else:
                    self._writer.close(ended)
        except LogError as error:
            self.error = error
        except Exception as error:  # noqa: BLE001 (in a thread, else nobody would hear of it)
            self.error = LogError(f"{self._writer.path}: writing failed ({error!r})")
            self.error.__cause__ = error
        finally:
            self._queue.close()
            counts = self._writer.info.counts
            self.summary = Summary(
                counts.get("captured", 0),
                counts.get("written", 0),
                counts.get("dropped", 0),
                ended if self.error is None else str(self.error),
            )
            self._is_over.set()

    def _write(self) -> str:
        """Write until the queue is done; return why, "" for the usual end."""
        queue, writer = self._queue, self._writer
        ended = ""
        while not queue.is_done:
            if not ended and self._stop.is_set():
                ended = "stopped by a signal"
                queue.close()
            item = queue.take()
            if item is None:
                writer.tick()
                queue.pause()
            else:
                type_name, data = item.payload
                writer.write_message(item.topic, type_name, item.stamp_ns, data, item.received_ns)
        return ended or self._ended

    def _count(self) -> dict[str, int]:
        """Close the queue; return the counts."""
        self._queue.close()
        counts = {"captured": self._queue.captured}
        for topic in self._queue.topics:
            if dropped := self._queue.tally(topic).dropped:
                counts[f"dropped.{topic}"] = dropped
        return counts | self._counted
