"""Common parts of recorders: stop on signals, summarize, and record a simulated episode."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType

from tunenet_logs.episode import Episode
from tunenet_logs.gaps import Gap
from tunenet_logs.importing import JOINT_PARTS, joint_topics
from tunenet_logs.messages import CAMERA_TOPIC
from tunenet_logs.terminal import Progress
from tunenet_logs.writer import EpisodeWriter


@dataclass(frozen=True)
class Summary:
    """Counts of a recording.

    Attributes:
        ended: why it ended before its source did; "" if it did not.
        damaged: incomplete pictures; not in `captured`.
        rate_hz: measured, of a camera.
        gaps: in which the camera was away.
        lag_s: longest lag of the writer, where it is worth mentioning.
        stamps: which clock they come from, where it had to be fitted.
        sound: what was recorded beside them, in words.
    """

    captured: int
    written: int
    dropped: int
    ended: str = ""
    damaged: int = 0
    rate_hz: float = 0.0
    gaps: tuple[Gap, ...] = ()
    lag_s: float = 0.0
    stamps: str = ""
    sound: str = ""

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
    """Yield an event that SIGINT, SIGTERM and SIGHUP set: raising would leave a torn log.

    SIGHUP, which a closed terminal or a lost connection sends, stays ignored under `nohup`.
    """
    event = threading.Event()

    def stop(_signal: int, _frame: FrameType | None) -> None:
        event.set()

    numbers = [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    previous = {number: signal.signal(number, stop) for number in numbers}
    try:
        yield event
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def record_episode(
    episode: Episode, path: Path, *, overwrite: bool, progress: Progress, min_free_bytes: int = 0
) -> Summary:
    """Record positions, joints and pictures of a simulated episode as if from sensors.

    Raises:
        LogError: `path` exists or cannot be written, or its disk has less than `min_free_bytes`
            left; what was written before is kept.
    """
    samples = list(_samples(episode))
    total = len(samples) + sum(channel.messages for channel in episode.channels)
    with (
        stop_flag() as stop,
        EpisodeWriter(
            path, episode.info, overwrite=overwrite, live=False, min_free_bytes=min_free_bytes
        ) as writer,
        progress.bar(total, "recording", "sample") as bar,
    ):
        for write in samples:
            if stop.is_set():
                break
            write(writer)
            bar.update(1)
        for frame in episode.frames():
            if stop.is_set():
                break
            writer.write_frame(CAMERA_TOPIC, frame)
            bar.update(1)
        ended = "stopped by a signal" if stop.is_set() else ""
        writer.close(ended)
    return Summary(writer.accepted, writer.written, writer.accepted - writer.written, ended)


def _samples(episode: Episode) -> Iterator[Callable[[EpisodeWriter], None]]:
    """Yield a writer call for each position and joint state, topic by topic."""
    joints = joint_topics(episode)
    of_joints = {id(part) for parts in joints.values() for part in parts.values()}
    for topic, positions in episode.signals.items():
        if id(positions) not in of_joints:
            for stamp_ns, position_m in zip(
                positions.stamps_ns.tolist(), positions.values, strict=True
            ):
                yield partial(
                    EpisodeWriter.write_pose,
                    topic=topic,
                    stamp_ns=stamp_ns,
                    position_m=position_m,
                )
    for topic, parts in joints.items():
        position, velocity, effort = (parts.get(part) for part in JOINT_PARTS)
        first = next(iter(parts.values()))
        for row, stamp_ns in enumerate(first.stamps_ns.tolist()):
            yield partial(
                EpisodeWriter.write_joints,
                topic=topic,
                stamp_ns=stamp_ns,
                names=first.columns,
                position_rad=() if position is None else position.values[row],
                velocity_rad_s=() if velocity is None else velocity.values[row],
                effort_nm=() if effort is None else effort.values[row],
            )
