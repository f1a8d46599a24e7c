"""Write a camera's queued frames to the log, in the main thread, until the recording ends."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

from recorders.camera.camera_time import CameraTime, Timed
from recorders.camera.reading_thread import ReadingThread
from recorders.camera.sound_blocks import WritesSound
from tunenet_logs.clock import now_ns
from tunenet_logs.errors import LogError
from tunenet_logs.gaps import Gap, gap_note
from tunenet_logs.images import image_size
from tunenet_logs.messages import CAMERA_TOPIC, VIDEO_FORMATS, VIDEO_TOPIC, typestore
from tunenet_logs.terminal import Bar
from tunenet_logs.writer import EpisodeWriter

# Between two pictures of one connection, and of the step before: then it was away meanwhile.
_SILENT_NS, _SILENT_STEPS = 1_000_000_000, 5

_MAX_GAPS = 1000  # after which a camera that comes and goes is of no use
_LAST_NS = 2**63 - 1  # a stamp behind all others
_SPARE_S = 0.5  # of silence beyond what is allowed: for a source to end by itself, and to say why

if TYPE_CHECKING:
    from recorders.camera.capture import Limits
    from recorders.camera.preview import Preview

WORTH_A_WORD_S = 0.5  # of lateness: the recording falls behind


class WritingLoop:
    """Takes frames from the queue, stamps, writes and shows them.

    Args:
        reader: whose queue it is; running.
        bar: moved by each picture.
        preview: shows the pictures; they are written once "record" was pressed there.
        sound: written beside them.

    Attributes:
        clock: maps the camera's timestamps to ours.
        longest_lag_s: longest time that a picture waited for the one before it to be written [s].
        gaps: in what was written so far.
    """

    def __init__(
        self,
        reader: ReadingThread,
        writer: EpisodeWriter,
        limits: Limits,
        bar: Bar,
        preview: Preview | None,
        sound: WritesSound | None = None,
    ) -> None:
        typestore()  # made here, or the first picture would wait for it
        self.clock = CameraTime(is_told=limits.stamps == "camera")
        self.gaps: list[Gap] = []
        self.longest_lag_s = 0.0
        self._written_ns: int | None = None
        self._reader = reader
        self._writer = writer
        self._limits = limits
        self._bar = bar
        self._preview = preview
        self._sound = sound
        self._sound_until_ns = _LAST_NS
        self._is_recording = preview is None
        self._first_ns: int | None = None
        self._newest_ns: int | None = None
        self._step_ns = 0

    def run(self, stop: threading.Event) -> str:
        """Write until there are no more frames; return why, "" at the source's end."""
        queue, source, stall_s = self._reader.queue, self._reader.source, self._limits.stall_s
        ended = ""
        heard = time.monotonic()
        patience_s = max(stall_s, self._limits.wait_s) + _SPARE_S
        while not queue.is_done:
            self._begin_if_pressed()
            if not ended and (ended := self._why_stopped(stop)):
                queue.close()
            item = queue.take()
            if item is not None:
                self._pass_on(self.clock.timed(item))
                heard, patience_s = time.monotonic(), stall_s + _SPARE_S
                continue
            self._pass_on(self.clock.due(now_ns()))
            if source.live and not ended and time.monotonic() - heard > patience_s:
                ended = f"no frame for {patience_s - _SPARE_S:.1f} s"
                queue.close()
            if self._sound is not None:
                self._sound.tick(self._writer)
            self._writer.tick()
            queue.pause()
        self._pass_on(self.clock.rest())
        if self._sound is not None:
            is_cut = bool(ended) and not source.live
            self._sound.finish(self._writer, 0 if is_cut else self._sound_until_ns)
        failure = "" if self._reader.error is None else str(self._reader.error)
        return ended or source.ended or failure

    def _begin_if_pressed(self) -> None:
        if self._is_recording or self._preview is None or not self._preview.record.is_set():
            return
        for _before in self.clock.rest():
            pass
        self._is_recording = True
        self._reader.queue.start()

    def _why_stopped(self, stop: threading.Event) -> str:
        if stop.is_set():
            return "stopped by a signal"
        if len(self.gaps) >= _MAX_GAPS:
            return f"the camera went and came back {_MAX_GAPS} times"
        is_pressed = self._preview is not None and self._preview.stop.is_set()
        return "stopped on the page" if is_pressed else ""

    def _pass_on(self, pictures: Iterator[Timed]) -> None:
        queue, writer = self._reader.queue, self._writer
        for frame, arrived_ns, begins_anew in pictures:
            if self._is_recording:
                if self._is_enough(frame.stamp_ns):
                    self._sound_until_ns = frame.stamp_ns
                    queue.cut(CAMERA_TOPIC, 1 + sum(1 for _ in pictures))
                    return
                if not writer.accepted:
                    self._note_size(frame.data)
                self._note_gap(frame.stamp_ns, begins_anew=begins_anew)
                if self._sound is not None:
                    self._sound.write_until(writer, frame.stamp_ns)
                is_video = frame.encoding in VIDEO_FORMATS
                writer.write_frame(VIDEO_TOPIC if is_video else CAMERA_TOPIC, frame, arrived_ns)
                self._bar.set_postfix_str(self._in_words(arrived_ns), refresh=False)
                self._bar.update(1)
            if self._preview is not None:
                self._preview.show(frame, self._reader.dropped)

    def _in_words(self, arrived_ns: int) -> str:
        """Describe losses and lag for the progress bar.

        Lag is how long a picture had been here when the one before it was written. A picture's own
        wait says less: that it is whole is often known by the next one alone.
        """
        before_ns, self._written_ns = self._written_ns, now_ns()
        words = f"{self._reader.dropped} dropped"
        if not self._reader.source.live or not self.clock.is_placed or before_ns is None:
            return words
        lag_s = (before_ns - arrived_ns) * 1e-9
        self.longest_lag_s = max(self.longest_lag_s, lag_s)
        return f"{words}, {lag_s:.1f} s late" if lag_s > WORTH_A_WORD_S else words

    def _is_enough(self, stamp_ns: int) -> bool:
        """Return whether the requested duration is reached before this picture."""
        if self._first_ns is None:
            self._first_ns = stamp_ns
        seconds = self._limits.seconds
        return seconds is not None and stamp_ns - self._first_ns >= seconds * 1e9

    def _note_gap(self, stamp_ns: int, *, begins_anew: bool) -> None:
        """Note at once in the log that the camera was away before a picture, if it was."""
        if self._newest_ns is None:
            self._newest_ns = stamp_ns
            return
        gap = Gap(self._newest_ns, stamp_ns)
        longest_ns = max(_SILENT_NS, _SILENT_STEPS * self._step_ns)
        self._newest_ns, self._step_ns = max(gap), stamp_ns - gap.last_ns
        if begins_anew or (self._step_ns > longest_ns and self._reader.source.live):
            self.gaps.append(gap)
            self._writer.note_at_once(*gap_note(self.gaps))

    def _note_size(self, data: bytes) -> None:
        try:
            width, height = image_size(data)
        except LogError:  # a file's own JPEG, kept however it is
            return
        self._writer.note("size_px", f"{width}x{height}")
