"""Write a microphone's sound to a log in short blocks beside the pictures."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

import numpy as np

from recorders.microphone.base import SoundPiece, SoundSource
from recorders.microphone.sample_clock import SampleClock, TimedPiece
from recorders.topic_queue import TopicQueue
from tunenet_logs.messages import AUDIO_TOPIC
from tunenet_logs.sound_notes import BLOCK_S, WARNINGS_NOTE, rate_notes
from tunenet_logs.writer import EpisodeWriter

_QUEUE_BYTES = 8 * 1024 * 1024  # of sound that came and is not yet timed: over a minute of it
# Of sound before the first picture: pictures come late, so the first was taken a while ago.
_KEPT_S = 10.0

_SILENT_S = 3.0  # after which a microphone that delivers nothing is worth a word
# Samples that come faster than that, so many seconds ahead, are of no clock.
_TOO_FAST, _SPARE_S = 1.1, 5.0

# Between a piece's time and where the one before it ends, that one block may hold both.
_SAME_NS = 1_000_000


class LiveSound:
    """Takes blocks from a source, stamps them, and writes them as they come.

    What ends the sound never ends the recording: it is reported at once, and noted in the log.

    Args:
        source: opened, not started.
        say: reports to the user that no more sound comes.

    Attributes:
        written: number of messages.
    """

    def __init__(self, source: SoundSource, say: Callable[[str], None]) -> None:
        self.written = 0
        self._source = source
        self._say = say
        self._clock = SampleClock(source.rate_hz)
        self._queue: TopicQueue[SoundPiece] = TopicQueue(_QUEUE_BYTES, drops=True)
        self._waiting: deque[TimedPiece] = deque()
        self._waiting_samples = 0
        self._begin_ns: int | None = None
        self._block: list[TimedPiece] = []
        self._block_samples = 0
        self._heard_samples = 0
        self._heard_at = 0.0
        self._first_ns: int | None = None
        self._why_ended = ""
        self._is_said_silent = False

    def notes(self) -> dict[str, str]:
        """Return the log's initial notes on the sound."""
        rate_hz = self._source.rate_hz
        return rate_notes(f"{self._source.name}, {rate_hz:g} Hz, mono", rate_hz, rate_hz)

    def start(self) -> None:
        """Start the source.

        Raises:
            MicrophoneError: it does not start.
        """
        self._heard_at = time.monotonic()
        self._source.start(self._take)

    def write_until(self, writer: EpisodeWriter, stamp_ns: int) -> None:
        """Write the sound so far; the first call's stamp, the first picture's, begins it."""
        if self._begin_ns is None:
            self._begin_ns = stamp_ns
            for piece in self._waiting:
                self._write(writer, piece)
            self._waiting.clear()
        self.tick(writer)

    def tick(self, writer: EpisodeWriter) -> None:
        """Process the blocks that came; call it often."""
        while (item := self._queue.take()) is not None:
            self._heard_at = time.monotonic()
            if self._is_too_fast(item.payload, item.received_ns):
                self._end(writer, f"it delivers far more than {self._source.rate_hz:g} samples/s")
            else:
                for piece in self._clock.timed(item.payload, item.received_ns):
                    self._pass_on(writer, piece)
        if self._source.ended:
            self._end(writer, self._source.ended)
        elif not self._is_said_silent and time.monotonic() - self._heard_at > _SILENT_S:
            self._is_said_silent = True
            self._warn(writer, f"nothing came from it for {_SILENT_S:g} s")

    def finish(self, writer: EpisodeWriter, until_ns: int) -> None:
        """Stop, write the sound before a stamp, and note measured rate and warnings."""
        self._source.close()
        self._queue.close()
        self.tick(writer)
        for piece in self._clock.rest():
            self._pass_on(writer, piece, until_ns)
        self._write_block(writer)
        if rate_hz := self._clock.measured_hz():
            about = f"{self._source.name}, {self._source.rate_hz:g} Hz, mono"
            for name, text in rate_notes(about, rate_hz, self._source.rate_hz).items():
                writer.note(name, text)
        if warnings := self.warnings():
            writer.note(WARNINGS_NOTE, "; ".join(warnings))

    def warnings(self) -> list[str]:
        """Return warnings for the user."""
        said = [self._why_ended] if self._why_ended else []
        if self._is_said_silent:
            said.append(f"nothing came from the microphone for {_SILENT_S:g} s or more")
        if self._clock.losses:
            times = "once" if self._clock.losses == 1 else f"{self._clock.losses} times"
            said.append(f"sound was lost {times}, {self._clock.lost_s:.2f} s in all")
        if dropped := self._queue.dropped:
            said.append(f"{dropped} pieces of sound were dropped: this machine could not keep up")
        if self._clock.left_out_s:
            said.append(f"{self._clock.left_out_s:.2f} s of sound that came too early are left out")
        if not self.written and not said:
            said.append("the microphone delivered nothing")
        return said

    def in_words(self) -> str:
        """Summarize the sound for the recorder's last line."""
        words = f"{self._heard_samples / self._source.rate_hz:.1f} s of sound"
        warnings = self.warnings()
        return words + (f" ({'; '.join(warnings)})" if warnings else "")

    def close(self) -> None:
        """Close the microphone."""
        self._source.close()

    def _take(self, piece: SoundPiece) -> None:
        self._queue.put(AUDIO_TOPIC, piece.begin_ns, piece, piece.pcm.nbytes)

    def _is_too_fast(self, piece: SoundPiece, arrived_ns: int) -> bool:
        if self._first_ns is None:
            self._first_ns = arrived_ns
        passed_s = (arrived_ns - self._first_ns) * 1e-9
        return piece.first > self._source.rate_hz * (_TOO_FAST * passed_s + _SPARE_S)

    def _end(self, writer: EpisodeWriter, why: str) -> None:
        if self._why_ended:
            return
        self._why_ended = f"the sound ended: {why}"
        self._source.close()
        self._warn(writer, why)

    def _warn(self, writer: EpisodeWriter, why: str) -> None:
        self._say(f"{self._source.name}: {why}; the pictures are recorded on")
        writer.note_at_once(WARNINGS_NOTE, "; ".join(self.warnings()))

    def _pass_on(self, writer: EpisodeWriter, piece: TimedPiece, until_ns: int = 2**63) -> None:
        if piece.stamp_ns >= until_ns:
            return
        if self._begin_ns is not None:
            self._write(writer, piece)
            return
        self._waiting.append(piece)
        self._waiting_samples += len(piece.pcm)
        while self._waiting_samples > _KEPT_S * self._source.rate_hz:
            self._waiting_samples -= len(self._waiting.popleft().pcm)

    def _write(self, writer: EpisodeWriter, piece: TimedPiece) -> None:
        if self._begin_ns is None or self._end_of([piece]) <= self._begin_ns:
            return
        if self._block and abs(piece.stamp_ns - self._end_of(self._block)) > _SAME_NS:
            self._write_block(writer)
        self._block.append(piece)
        self._block_samples += len(piece.pcm)
        if self._block_samples >= BLOCK_S * self._source.rate_hz:
            self._write_block(writer)

    def _end_of(self, pieces: list[TimedPiece]) -> int:
        samples = sum(len(piece.pcm) for piece in pieces)
        return pieces[0].stamp_ns + round(samples * 1e9 / self._source.rate_hz)

    def _write_block(self, writer: EpisodeWriter) -> None:
        block, self._block, self._block_samples = self._block, [], 0
        if not block:
            return
        pcm = np.concatenate([piece.pcm for piece in block])[:, None]
        rate_hz, arrived_ns = round(self._source.rate_hz), block[-1].arrived_ns
        writer.write_sound(AUDIO_TOPIC, max(block[0].stamp_ns, 0), pcm, rate_hz, arrived_ns)
        self.written += 1
        self._heard_samples += len(pcm)
