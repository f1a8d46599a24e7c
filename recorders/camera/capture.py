"""From a camera to a log: one thread reads, the other writes, and what is lost is counted."""

from __future__ import annotations

import threading
import time
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from recorders.camera.base import Source
from recorders.camera.measured_rate import measured_hz
from recorders.session import Summary, stop_flag
from recorders.topic_queue import TopicQueue
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import CameraError, LogError, TuneNetError
from tunenet_logs.images import image_size
from tunenet_logs.messages import CAMERA_TOPIC
from tunenet_logs.terminal import Bar, Progress
from tunenet_logs.writer import EpisodeWriter

if TYPE_CHECKING:
    from recorders.camera.preview import Preview


_NOTICE_S = 0.3
"""For a camera to notice that it is over: Ctrl-C shall be quick though one is silent."""


@dataclass(frozen=True)
class Limits:
    """When a recording ends by itself, and what may wait in memory.

    Attributes:
        seconds: length by the frames' stamps; None: until the source ends, or a signal.
        stall_s: the longest a live source may deliver nothing.
        queue_bytes: pictures read and not yet written.
        min_free_bytes: what is to stay free on the disk; 0 for no such bound.
    """

    seconds: float | None = None
    stall_s: float = 5.0
    queue_bytes: int = 64 * 1024 * 1024
    min_free_bytes: int = 0


def record_camera(
    source: Source,
    info: EpisodeInfo,
    path: Path,
    *,
    limits: Limits,
    overwrite: bool,
    progress: Progress,
    preview: Preview | None = None,
) -> Summary:
    """Write a source's frames to a log until it ends, stalls, or is stopped.

    With a preview, from the moment that "record" is pressed there.

    Raises:
        CameraError: no frame came (no log is left), or the source failed (what came is kept).
        LogError: `path` exists or cannot be written, or its disk has too little space; what was
            written before is kept.
    """
    info = replace(info, source=source.name, notes={**info.notes, **source.notes()})
    with (
        closing(source),
        stop_flag() as stop,
        EpisodeWriter(
            path,
            info,
            overwrite=overwrite,
            live=source.live,
            min_free_bytes=limits.min_free_bytes,
        ) as writer,
        progress.bar(None, "recording", "frame") as bar,
    ):
        reader = _Reader(source, limits, counts=preview is None)
        writer.tally = reader.tally
        reader.start()
        try:
            ended = _write_frames(reader, writer, stop, bar, preview)
        finally:
            reader.stop()
        queue = reader.queue
        if not queue.captured:
            writer.discard()
            raise reader.error or CameraError(_nothing_came(source, ended))
        rate_hz = measured_hz(queue.tally(CAMERA_TOPIC).stamps_ns, live=source.live)
        if rate_hz:
            writer.note("measured_hz", f"{rate_hz:.3f}")
        for name, text in source.notes().items():
            writer.note(name, text)
        if preview is not None and preview.click is not None:
            writer.note("ball_at_px", f"{preview.click.x_px:.1f},{preview.click.y_px:.1f}")
            writer.note("ball_at_stamp_ns", str(preview.click.stamp_ns))
        writer.close(ended)
    if reader.error is not None:
        raise CameraError(
            f"{reader.error}; the {writer.written} frames before that are kept in {path}"
        ) from reader.error
    return Summary(
        queue.captured, writer.written, queue.dropped, ended, source.damaged, rate_hz=rate_hz
    )


class _Reader(threading.Thread):
    """Puts a source's frames into a queue; its failure waits in `error`.

    A daemon: a camera that fell silent must not keep the process.
    """

    def __init__(self, source: Source, limits: Limits, *, counts: bool) -> None:
        super().__init__(name="camera", daemon=True)
        self.source = source
        self.limits = limits
        self.queue: TopicQueue[Frame] = TopicQueue(
            limits.queue_bytes, drops=source.live, counts=counts
        )
        self.error: TuneNetError | None = None

    def run(self) -> None:
        try:
            self._read()
        except TuneNetError as error:
            self.error = error
        except Exception as error:  # noqa: BLE001 (in a thread, else nobody would hear of it)
            self.error = CameraError(
                f"{self.source.name}: reading failed ({type(error).__name__}: {error})"
            )
            self.error.__cause__ = error
        finally:
            self.queue.close()

    def _read(self) -> None:
        seconds = self.limits.seconds
        last_ns: int | None = None
        with closing(self.source.frames()) as frames:  # type: ignore[type-var]
            for frame in frames:
                stamp_ns = frame.stamp_ns
                if last_ns is not None and stamp_ns <= last_ns:  # both in one read
                    stamp_ns = last_ns + 1
                last_ns = stamp_ns
                if seconds is not None and self._since_first_ns(stamp_ns) >= seconds * 1e9:
                    return
                stamped = replace(frame, stamp_ns=stamp_ns)
                if not self.queue.put(CAMERA_TOPIC, stamp_ns, stamped, len(frame.data)):
                    return

    def _since_first_ns(self, stamp_ns: int) -> int:
        """Time from the first frame that counted [ns]; 0 before that."""
        stamps_ns = self.queue.tally(CAMERA_TOPIC).stamps_ns
        return stamp_ns - stamps_ns[0] if stamps_ns else 0

    def tally(self) -> dict[str, int]:
        """What came; nothing more comes after that."""
        self.queue.close()
        damaged = {"damaged": self.source.damaged} if self.source.damaged else {}
        return {"captured": self.queue.captured, **damaged}

    def stop(self) -> None:
        """Take no more frames, and wait a moment for the source to notice."""
        self.queue.close()
        self.source.close()
        self.join(_NOTICE_S)


def _write_frames(
    reader: _Reader,
    writer: EpisodeWriter,
    stop: threading.Event,
    bar: Bar,
    preview: Preview | None,
) -> str:
    """Write frames until there are no more; why there are none, "" at the end of the source."""
    queue, source, stall_s = reader.queue, reader.source, reader.limits.stall_s
    is_recording = preview is None
    ended = ""
    heard = time.monotonic()
    while not queue.is_done:
        if preview is not None and preview.record.is_set() and not is_recording:
            is_recording = True
            queue.start()
        if not ended and (ended := _why_stopped(stop, preview)):
            queue.close()
        item = queue.take()
        if item is not None:
            frame = item.payload
            if is_recording:
                if not writer.accepted:
                    _note_size(writer, frame.data)
                writer.write_frame(CAMERA_TOPIC, frame, item.received_ns)
                bar.set_postfix_str(f"{queue.dropped} dropped", refresh=False)
                bar.update(1)
            if preview is not None:
                preview.show(frame, queue.dropped)
            heard = time.monotonic()
            continue
        if source.live and not ended and time.monotonic() - heard > stall_s:
            ended = f"no frame for {stall_s:.1f} s"
            queue.close()
        writer.tick()
        queue.pause()
    failure = "" if reader.error is None else str(reader.error)
    return ended or source.ended or failure


def _why_stopped(stop: threading.Event, preview: Preview | None) -> str:
    if stop.is_set():
        return "stopped by a signal"
    return "stopped on the page" if preview is not None and preview.stop.is_set() else ""


def _note_size(writer: EpisodeWriter, data: bytes) -> None:
    try:
        width, height = image_size(data)
    except LogError:  # a file's own JPEG, kept however it is
        return
    writer.note("size_px", f"{width}x{height}")


def _nothing_came(source: Source, ended: str) -> str:
    if ended.startswith("stopped"):
        return f"{source.name}: {ended} before a frame was recorded; no log is left"
    why = ended or "it holds none"
    damaged = f", {source.damaged} parts were no whole JPEG" if source.damaged else ""
    remedy = "try again with a longer --stall" if source.live else "is it whole?"
    return f"{source.name}: no frame came ({why}{damaged}); {remedy}"
