"""Record a camera to a log: one thread reads, another writes, and losses are counted.

`WritingLoop` takes the queued frames in the main thread, stamps them and writes them with the
sound that belongs beside them; `record_camera` sets all up and sums up the counts;
`record_camera_as_asked` does so as a command line wants it.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tunenet_logs.audio import sound_blocks, sound_notes_of, why_not_kept
from tunenet_logs.console import given
from tunenet_logs.episode import EpisodeInfo, Sound
from tunenet_logs.errors import CameraError, LogError, MicrophoneError, UsageError
from tunenet_logs.images import image_size
from tunenet_logs.messages import AUDIO_TOPIC, CAMERA_TOPIC, VIDEO_FORMATS, VIDEO_TOPIC, typestore
from tunenet_logs.passwords import read_password
from tunenet_logs.recorders.camera.base import Source
from tunenet_logs.recorders.camera.clock import CameraTime, Timed, stamp_evenly
from tunenet_logs.recorders.camera.device import VideoFile
from tunenet_logs.recorders.camera.network import (
    PASSWORD_OPTION,
    PASSWORD_VARIABLE,
    NetworkOptions,
    Trust,
)
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.reading import ReadingThread
from tunenet_logs.recorders.camera.reconnecting import lasting_camera
from tunenet_logs.recorders.camera.sources import is_asked_again, open_source, shows_password
from tunenet_logs.recorders.session import Summary, stop_flag
from tunenet_logs.terminal import Bar, Progress
from tunenet_logs.timing.arrivals import STAMPS_NOTE
from tunenet_logs.timing.stamps import (
    MAX_SPEED_CAMERA_HZ,
    MAX_SPEED_HZ,
    Gap,
    gap_note,
    measured_hz,
    now_ns,
)
from tunenet_logs.writing.owned_path import check_log_name
from tunenet_logs.writing.writer import EpisodeWriter

if TYPE_CHECKING:
    from tunenet_logs.recorders.local_page import Preview
    from tunenet_logs.recorders.microphone import LiveSound


_SPARE_S = 0.5  # of silence beyond what is allowed: for a source to end by itself, and to say why
_MIN_REPORTED_LAG_S = 0.5  # with a longer one the recording falls behind


class FilmSoundWriter:
    """Writes a film's sound as far as the pictures have come; nothing where it has none.

    A live source's sound is written by a `LiveSound` of the microphone, which has the same methods.
    """

    def __init__(self, sound: Sound | None) -> None:
        self.written = 0  # number of messages
        self._heard_s = 0.0
        self._rate_hz = round(sound.rate_hz) if sound else 0
        self._blocks = sound_blocks(sound) if sound else iter(())
        self._next = next(self._blocks, None)

    def in_words(self) -> str:
        """Summarize the sound for the recorder's last line."""
        return f"{self._heard_s:.1f} s of sound" if self._rate_hz else ""

    def write_until(self, writer: EpisodeWriter, stamp_ns: int) -> None:
        """Write blocks that begin before a stamp and are not yet written."""
        while self._next is not None and self._next[0] < stamp_ns:
            block_ns, pcm = self._next
            writer.write_sound(AUDIO_TOPIC, block_ns, pcm, self._rate_hz)
            self.written += 1
            self._heard_s += len(pcm) / self._rate_hz
            self._next = next(self._blocks, None)

    finish = write_until

    def tick(self, writer: EpisodeWriter) -> None:
        """Do nothing: the sound is written with the pictures."""


class WritingLoop:
    """Takes frames from the queue, stamps, writes and shows them."""

    def __init__(
        self,
        reader: ReadingThread,
        writer: EpisodeWriter,
        limits: Limits,
        bar: Bar,
        preview: Preview | None,
        sound: LiveSound | FilmSoundWriter,
    ) -> None:
        typestore()  # made here, or the first picture would wait for it
        # Maps the camera's timestamps to ours.
        self.clock = CameraTime(is_told=limits.stamps == "camera")
        self.gaps: list[Gap] = []  # in what was written so far
        self.longest_lag_s = 0.0  # that a picture waited for the one before it to be written [s]
        self._written_ns: int | None = None
        self._reader = reader
        self._writer = writer
        self._limits = limits
        self._bar = bar
        self._preview = preview
        self._sound = sound
        self._sound_until_ns = 2**63 - 1
        self._is_recording = preview is None  # else once "record" is pressed there
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
            if not self._is_recording and self._preview and self._preview.record.is_set():
                for _before in self.clock.rest():
                    pass
                self._is_recording = True
                queue.start()
            if not ended:
                if stop.is_set():
                    ended = "stopped by a signal"
                elif len(self.gaps) >= 1000:  # such a camera is of no use
                    ended = f"the camera went and came back {len(self.gaps)} times"
                elif self._preview is not None and self._preview.stop.is_set():
                    ended = "stopped on the page"
                if ended:
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
            self._sound.tick(self._writer)
            self._writer.tick()
            queue.pause()
        self._pass_on(self.clock.rest())
        is_cut = bool(ended) and not source.live
        self._sound.finish(self._writer, 0 if is_cut else self._sound_until_ns)
        failure = "" if self._reader.error is None else str(self._reader.error)
        return ended or source.ended or failure

    def _pass_on(self, pictures: Iterator[Timed]) -> None:
        queue, writer = self._reader.queue, self._writer
        for frame, arrived_ns, begins_anew in pictures:
            if self._is_recording:
                # Cut what comes once the requested duration is reached.
                if self._first_ns is None:
                    self._first_ns = frame.stamp_ns
                seconds = self._limits.seconds
                if seconds is not None and frame.stamp_ns - self._first_ns >= seconds * 1e9:
                    self._sound_until_ns = frame.stamp_ns
                    queue.cut(CAMERA_TOPIC, 1 + sum(1 for _ in pictures))
                    return
                if not writer.accepted:
                    with suppress(LogError):  # a file's own JPEG, kept however it is
                        writer.note("size_px", "{}x{}".format(*image_size(frame.data)))
                self._note_gap(frame.stamp_ns, begins_anew=begins_anew)
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
        return f"{words}, {lag_s:.1f} s late" if lag_s > _MIN_REPORTED_LAG_S else words

    def _note_gap(self, stamp_ns: int, *, begins_anew: bool) -> None:
        """Note at once in the log that the camera was away before a picture, if it was."""
        if self._newest_ns is None:
            self._newest_ns = stamp_ns
            return
        gap = Gap(self._newest_ns, stamp_ns)
        # It was where two frames of one connection are over a second, and five steps, apart.
        longest_ns = max(1_000_000_000, 5 * self._step_ns)
        self._newest_ns, self._step_ns = max(gap), stamp_ns - gap.last_ns
        if begins_anew or (self._step_ns > longest_ns and self._reader.source.live):
            self.gaps.append(gap)
            self._writer.note_at_once(*gap_note(self.gaps))


@dataclass(frozen=True)
class Limits:
    """When a recording ends by itself, and how much may be buffered."""

    seconds: float | None = None  # by the frames' stamps; None: to the end, or a signal
    stall_s: float = 5.0  # longest silence of a live source
    wait_s: float = 0.0  # longest wait for its first frame, where that is longer
    queue_bytes: int = 64 * 1024 * 1024  # pictures read and not yet written
    min_free_bytes: int = 0  # space to leave free on the disk; 0 for no such bound
    stamps: Literal["camera", "arrival"] = "camera"  # which clock the frames are stamped by


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
    """Record a source's frames to a log until it ends, stalls or is stopped."""
    # With a preview, recording begins when "record" is pressed there. A microphone records beside a
    # live source, from its first frame on.
    heard_notes = microphone.notes() if microphone else {}
    notes = {**info.notes, **source.notes(), **heard_notes}
    info = replace(info, source=source.name, notes=notes)
    with (
        closing(source),
        stop_flag() as stop,
        EpisodeWriter(
            path, info, overwrite=overwrite, live=source.live, min_free_bytes=limits.min_free_bytes
        ) as writer,
        progress.bar(None, "recording", "frame") as bar,
    ):
        reader = ReadingThread(source, limits.queue_bytes, counts=preview is None)
        sound = microphone or _film_sound(source, writer)

        def tally() -> dict[str, int]:
            reader.queue.close()
            damaged = {"damaged": source.damaged} if source.damaged else {}
            return {"captured": reader.captured + sound.written, **damaged}

        writer.tally = tally
        loop = WritingLoop(reader, writer, limits, bar, preview, sound)
        if microphone is not None:
            try:
                microphone.start()
            except MicrophoneError:
                writer.discard()
                raise
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
        lag_s = loop.longest_lag_s if loop.longest_lag_s > _MIN_REPORTED_LAG_S else 0.0
        if lag_s:
            writer.note("longest_lag_s", f"{lag_s:.2f}")
        clock_notes = loop.clock.notes() if source.live else {}
        for name, text in {**clock_notes, **source.notes()}.items():
            writer.note(name, text)
        if preview is not None and preview.click is not None:
            writer.note("ball_at_px", f"{preview.click.x_px:.1f},{preview.click.y_px:.1f}")
            writer.note("ball_at_stamp_ns", str(preview.click.stamp_ns))
        writer.close(ended)
        stamps = _stamped(path, writer.info.notes, limits) if source.live else ""
    frames = writer.written - sound.written
    if reader.error is not None:
        raise CameraError(
            f"{reader.error}; the {frames} frames before that are kept in {path}"
        ) from reader.error
    return Summary(
        reader.captured,
        frames,
        reader.dropped,
        ended,
        source.damaged,
        rate_hz=rate_hz,
        lag_s=lag_s,
        gaps=tuple(loop.gaps),
        stamps=stamps,
        sound=sound.in_words(),
    )


def _film_sound(source: Source, writer: EpisodeWriter) -> FilmSoundWriter:
    """Return a video file's sound to write; a note of the log says what it is, or why not."""
    sound = source.sound() if isinstance(source, VideoFile) else None
    why_not = why_not_kept(sound) if sound else ""
    if why_not:
        writer.note("sound_warnings", f"not kept: {why_not}")
    elif sound:
        for name, text in sound_notes_of(sound).items():
            writer.note(name, text)
    return FilmSoundWriter(None if why_not else sound)


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


def record_camera_as_asked(arguments: argparse.Namespace, path: Path) -> str:
    """Record the camera; return the summary for the last line.

    Raises:
        TuneNetError: it cannot be opened, read or written.
    """
    from tunenet_logs.recorders.microphone import opened_microphone

    asked = CameraOptions(**given(arguments, CameraOptions))
    progress = Progress(quiet=arguments.quiet)
    limits = Limits(
        seconds=asked.seconds,
        stall_s=asked.stall_s,
        wait_s=asked.wait_s,
        min_free_bytes=round(arguments.min_free * 1e6),
        stamps=asked.stamps,
    )
    with ExitStack() as opened:
        microphone = opened.enter_context(
            opened_microphone(asked.microphone, arguments.camera, progress.say)
        )
        notes = {"ball": asked.ball} if asked.ball else {}
        info = EpisodeInfo(kind="drop", rig=asked.rig, notes=notes)
        network = _network(asked, progress)
        open_camera = partial(open_source, arguments.camera, asked, network)
        if is_asked_again(arguments.camera):
            check_log_name(path, overwrite=arguments.overwrite)  # not after having waited
            source = lasting_camera(
                open_camera, wait_s=asked.wait_s, stall_s=asked.stall_s, say=progress.say
            )
        elif asked.wait_s:
            raise UsageError("--wait is for a camera in a network; leave it out")
        else:
            source = open_camera()
        if shows_password(arguments.camera):
            progress.say(
                "tunenet-record: the password in the address shows in the list of processes (ps); "
                "write it into a file for --password-file, or into ~/.netrc"
            )
        summary = record_camera(
            source,
            info,
            path,
            limits=limits,
            overwrite=arguments.overwrite,
            progress=progress,
            preview=opened.enter_context(_preview(source.live)) if asked.preview else None,
            microphone=microphone,
        )
    return f"{source.name}; {summary.in_words('frames')}"


def _network(asked: CameraOptions, progress: Progress) -> NetworkOptions:
    """Collect the network camera's options, with its password."""
    file = asked.password_file
    password = os.environ.get(PASSWORD_VARIABLE) or None
    if file is not None:
        password, is_public = read_password(file, PASSWORD_OPTION)
        if is_public:
            progress.say(f"tunenet-record: {file}: others can read this password; chmod 600 {file}")
    return NetworkOptions(
        Trust.of(asked.fingerprint, asked.insecure),
        asked.rtsp_transport,
        password,
        must_serve=file is not None,
    )


def _preview(is_live: bool) -> closing[Preview]:
    if not is_live:
        raise UsageError("--preview is for a live camera; a video can be looked at as it is")
    from tunenet_logs.recorders.local_page import Preview

    preview = Preview()
    print(f"preview at {preview.url}", file=sys.stderr, flush=True)
    return closing(preview)
