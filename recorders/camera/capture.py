"""Record a camera to a log: one thread reads, another writes, and losses are counted."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from recorders.camera.base import Source
from recorders.camera.even_stamps import stamp_evenly
from recorders.camera.reading_thread import ReadingThread
from recorders.camera.sound_blocks import SoundBlocks, WritesSound
from recorders.camera.video_file import VideoFile
from recorders.camera.writing_loop import WORTH_A_WORD_S, WritingLoop
from recorders.session import Summary, stop_flag
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.errors import CameraError, LogError, MicrophoneError
from tunenet_logs.late_stamps import STAMPS_NOTE
from tunenet_logs.measured_rate import MAX_SPEED_CAMERA_HZ, MAX_SPEED_HZ, measured_hz
from tunenet_logs.messages import CAMERA_TOPIC
from tunenet_logs.sound_notes import sound_notes_of, why_not_kept
from tunenet_logs.terminal import Progress
from tunenet_logs.writer import EpisodeWriter

if TYPE_CHECKING:
    from recorders.camera.preview import Preview
    from recorders.microphone.live_sound import LiveSound


@dataclass(frozen=True)
class Limits:
    """When a recording ends by itself, and how much may be buffered.

    Attributes:
        seconds: duration by the frames' stamps; None: until the source ends, or a signal.
        stall_s: longest silence of a live source.
        wait_s: longest wait for its first frame, where that is longer.
        queue_bytes: pictures read and not yet written.
        min_free_bytes: space to leave free on the disk; 0 for no such bound.
        stamps: which clock the frames are stamped by.
    """

    seconds: float | None = None
    stall_s: float = 5.0
    wait_s: float = 0.0
    queue_bytes: int = 64 * 1024 * 1024
    min_free_bytes: int = 0
    stamps: Literal["camera", "arrival"] = "camera"


def record_camera(
    source: Source,
    info: EpisodeInfo,
    path: Path,
    *,
    limits: Limits,
    overwrite: bool,
    progress: Progress,
    preview: Preview | None = None,
    microphone: LiveSound | None = None,
) -> Summary:
    """Record a source's frames to a log until it ends, stalls or is stopped.

    With a preview, recording begins when "record" is pressed there. A microphone records beside a
    live source, from its first frame on.

    Raises:
        MicrophoneError: it does not start (no log is left).
        CameraError: no frame came (no log is left), or the source failed (what came is kept).
        LogError: `path` exists or cannot be written, or its disk has too little space; what was
            written before is kept.
    """
    heard_notes = microphone.notes() if microphone else {}
    notes = {**info.notes, **source.notes(), **heard_notes}
    info = replace(info, source=source.name, notes=notes)
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
        reader = ReadingThread(source, limits.queue_bytes, counts=preview is None)
        blocks = microphone or _sound_of(source, writer)
        writer.tally = partial(_tally, reader, blocks)
        loop = WritingLoop(reader, writer, limits, bar, preview, blocks)
        _listen(microphone, writer)
        reader.start()
        try:
            ended = loop.run(stop)
        finally:
            reader.stop()
        if not reader.captured:
            writer.discard()
            raise reader.error or CameraError(_nothing_came(source, ended))
        fastest_hz = MAX_SPEED_CAMERA_HZ if source.live else MAX_SPEED_HZ
        rate_hz = measured_hz(reader.queue.tally(CAMERA_TOPIC).stamps_ns, fastest_hz)
        if rate_hz:
            writer.note("measured_hz", f"{rate_hz:.3f}")
        lag_s = loop.longest_lag_s if loop.longest_lag_s > WORTH_A_WORD_S else 0.0
        if lag_s:
            writer.note("longest_lag_s", f"{lag_s:.2f}")
        clock_notes = loop.clock.notes() if source.live else {}
        for name, text in {**clock_notes, **source.notes()}.items():
            writer.note(name, text)
        if preview is not None and preview.click is not None:
            writer.note("ball_at_px", f"{preview.click.x_px:.1f},{preview.click.y_px:.1f}")
            writer.note("ball_at_stamp_ns", str(preview.click.stamp_ns))
        writer.close(ended)
        heard = blocks.written if blocks else 0
        stamps = _stamped(path, writer.info.notes, limits) if source.live else ""
    if reader.error is not None:
        raise CameraError(
            f"{reader.error}; the {writer.written - heard} frames before that are kept in {path}"
        ) from reader.error
    return Summary(
        reader.captured,
        writer.written - heard,
        reader.dropped,
        ended,
        source.damaged,
        rate_hz=rate_hz,
        lag_s=lag_s,
        gaps=tuple(loop.gaps),
        stamps=stamps,
        sound=blocks.in_words() if blocks else "",
    )


def _listen(microphone: LiveSound | None, writer: EpisodeWriter) -> None:
    if microphone is None:
        return
    try:
        microphone.start()
    except MicrophoneError:
        writer.discard()
        raise


def _sound_of(source: Source, writer: EpisodeWriter) -> SoundBlocks | None:
    """Return a video file's sound to write; a note of the log says what it is, or why not."""
    sound = source.sound() if isinstance(source, VideoFile) else None
    if sound is None:
        return None
    why_not = why_not_kept(sound)
    notes = {"sound_warnings": f"not kept: {why_not}"} if why_not else sound_notes_of(sound)
    for name, text in notes.items():
        writer.note(name, text)
    return None if why_not else SoundBlocks(sound)


def _tally(reader: ReadingThread, sound: WritesSound | None) -> dict[str, int]:
    """Count the frames that came and the blocks of sound written beside them."""
    counts = reader.tally()
    counts["captured"] += sound.written if sound else 0
    return counts


def _stamped(path: Path, notes: Mapping[str, str], limits: Limits) -> str:
    """Restamp frames that came without a time by the uniform clock behind them; say how."""
    if limits.stamps == "arrival" or notes.get(STAMPS_NOTE) != "arrival":
        return ""
    try:
        said = stamp_evenly(path, notes, limits.min_free_bytes)
    except LogError as error:
        said = f"arrival: {error}"
    return "" if said == "arrival" else f"stamps: {said}"


def _nothing_came(source: Source, ended: str) -> str:
    if ended.startswith("stopped"):
        return f"{source.name}: {ended} before a frame was recorded; no log is left"
    why = ended or "it holds none"
    damaged = f", {source.damaged} parts were no whole JPEG" if source.damaged else ""
    remedy = "try again with a longer --stall" if source.live else "is it whole?"
    return f"{source.name}: no frame came ({why}{damaged}); {remedy}"
