"""Record a microphone beside a live camera: PortAudio, or a sound file played in its place.

A `SoundSource` delivers blocks of samples. `SampleClock` stamps them by sample number and rate,
aligned to our clock by the times that the device reports. `LiveSound` writes them to the log.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from types import ModuleType
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.audio import (
    BLOCK_S,
    RATES_HZ,
    WARNINGS_NOTE,
    as_pcm,
    rate_notes,
    read_sound,
    why_not_kept,
)
from tunenet_logs.errors import CameraAwayError, LogError, MicrophoneError, UsageError, pip_install
from tunenet_logs.messages import AUDIO_TOPIC
from tunenet_logs.recorders.camera.device import opened_within
from tunenet_logs.recorders.camera.sources import is_file
from tunenet_logs.recorders.session import TopicQueue
from tunenet_logs.terminal import listed, short_name
from tunenet_logs.timing.stamps import now_ns
from tunenet_logs.writing.writer import EpisodeWriter

# ---- Sound sources: their interface

_PIECE_S = 0.02  # of sound in one block, where the source may choose


class SoundPiece(NamedTuple):
    """A block of samples as it came."""

    # Number of its first sample since the start; samples lost on the way from the device are not
    # counted, since nobody knows how many they were.
    first: int
    begin_ns: int  # that sample's capture time as the device reports it, with jitter, on our clock
    pcm: NDArray[np.int16]  # 16-bit samples of all channels together, shape (N,)
    follows_loss: bool = False  # whether the device reports samples lost before it


# Called with each block, from a thread of the source; it never waits.
Take = Callable[[SoundPiece], object]


class SoundSource(Protocol):
    """An open microphone, or a file played in its place."""

    name: str  # what is recorded, in words
    rate_hz: float  # nominal sample rate

    @property
    def ended(self) -> str:
        """Why no more sound comes; "" while it does."""
        ...

    def start(self, take: Take) -> None:
        """Begin to deliver blocks, once; MicrophoneError if it does not start."""
        ...

    def close(self) -> None:
        """Stop and close the source. Safe to call twice."""
        ...


# ---- Sample clock: sample numbers mapped to our clock

_HOLD_S = 0.5  # of sound held back to align the clocks, at first and after a leap


class TimedPiece(NamedTuple):
    """A block of samples with its time."""

    stamp_ns: int  # capture time of the first sample
    pcm: NDArray[np.int16]  # shape (N,)
    arrived_ns: int


class SampleClock:
    """Maps sample numbers to our clock [ns].

    A block's time is its first sample's number divided by the rate, plus one offset: the median
    over the first half second of reported times. So no jitter of device, driver or machine enters.
    The offset then tracks the device's clock slowly, by at most 200 ppm.

    Where samples are lost, the offset jumps: at once where the device reports it, else where
    reported times are 30 ms off for half a second. Sound that would overlap earlier sound is left
    out, so that times never run backwards.
    """

    def __init__(self, rate_hz: float) -> None:
        self.losses = 0  # how often samples were lost
        self.lost_s = self.left_out_s = 0.0  # total duration of the losses
        self._rate_hz = rate_hz  # nominal sample rate
        self._held: list[tuple[SoundPiece, int, int]] = []  # and its offset, and when it came [ns]
        self._held_samples = 0
        self._is_told_lost = False
        self._offset_ns: int | None = None
        self._end_ns: int | None = None
        self._window: list[int] = []
        self._window_samples = 0
        self._drift = _Line()
        self._longest = self._drift

    def timed(self, piece: SoundPiece, arrived_ns: int) -> Iterator[TimedPiece]:
        """Yield the blocks whose time is known by now, in order."""
        if piece.follows_loss and self._offset_ns is not None:
            yield from self.rest()
            self._is_told_lost = True
        offset_ns = piece.begin_ns - self._length_ns(piece.first)
        at_ns = self._offset_ns
        # A reported time that is 30 ms off is no jitter, if it lasts.
        if at_ns is None or self._is_told_lost or abs(offset_ns - at_ns) > 30_000_000:
            self._held.append((piece, offset_ns, arrived_ns))
            self._held_samples += len(piece.pcm)
            if self._held_samples >= _HOLD_S * self._rate_hz:
                yield from self.rest()
            return
        yield from self._released()  # what was held came merely at an odd time
        yield from self._placed(piece, arrived_ns)
        self._window.append(offset_ns)
        self._window_samples += len(piece.pcm)
        # A second of sound is one measurement of the offset, the median of its blocks'. The clock
        # follows a tenth of it, by 200 ppm at most.
        if self._window_samples < self._rate_hz or self._offset_ns is None:
            return
        measured_ns = round(median(self._window))
        self._drift.add(piece.first / self._rate_hz, measured_ns)
        step_ns = round(0.1 * (measured_ns - self._offset_ns))
        self._offset_ns += max(-200_000, min(step_ns, 200_000))
        self._window, self._window_samples = [], 0

    def rest(self) -> Iterator[TimedPiece]:
        """Yield all blocks still held back, aligning the clock to them where needed."""
        is_enough = self._held_samples >= _HOLD_S * self._rate_hz
        if self._held and (self._offset_ns is None or self._is_told_lost or is_enough):
            offset_ns = round(median(offset_ns for _, offset_ns, _ in self._held))
            before_ns, is_told, self._is_told_lost = self._offset_ns, self._is_told_lost, False
            step_ns = 0 if before_ns is None else offset_ns - before_ns
            # A shorter loss cannot be told from jitter, even if the device reports it.
            if before_ns is None or not is_told or step_ns >= 2_000_000:
                if step_ns > 0:
                    self.losses += 1
                    self.lost_s += step_ns * 1e-9
                self._offset_ns = offset_ns
                self._window, self._window_samples = [], 0
                self._longest = max(self._longest, self._drift, key=lambda one: one.count)
                self._drift = _Line()
        yield from self._released()

    def measured_hz(self) -> float | None:
        """Return the sample rate on our clock; None where it is not yet known."""
        line = max(self._longest, self._drift, key=lambda one: one.count)
        slope, known_to = line.slope()
        # To a standard error of 10 ppm; no sound card's crystal is a thousandth off its rate.
        if line.count < 10 or known_to > 10e-6 or abs(slope) > 1e-3:
            return None
        return self._rate_hz / (1 + slope)

    def _length_ns(self, samples: int) -> int:
        return round(samples * 1_000_000_000 / self._rate_hz)

    def _released(self) -> Iterator[TimedPiece]:
        held, self._held, self._held_samples = self._held, [], 0
        for piece, _, arrived_ns in held:
            yield from self._placed(piece, arrived_ns)

    def _placed(self, piece: SoundPiece, arrived_ns: int) -> Iterator[TimedPiece]:
        assert self._offset_ns is not None
        stamp_ns = self._offset_ns + self._length_ns(piece.first)
        # Blocks may overlap by 5 ms: the clock has to follow a device that runs fast.
        if self._end_ns is not None and stamp_ns < self._end_ns - 5_000_000:
            self.left_out_s += len(piece.pcm) / self._rate_hz
            return
        self._end_ns = stamp_ns + self._length_ns(len(piece.pcm))
        yield TimedPiece(stamp_ns, piece.pcm, arrived_ns)


class _Line:
    """Online least-squares line, in constant memory."""

    def __init__(self) -> None:
        self.count = 0
        self._begin = (0.0, 0)
        self._mean_x = self._mean_y = 0.0
        self._xx = self._xy = self._yy = 0.0

    def add(self, x_s: float, y_ns: int) -> None:
        if not self.count:
            self._begin = x_s, y_ns
        x, y = x_s - self._begin[0], (y_ns - self._begin[1]) * 1e-9
        self.count += 1
        dx, dy = x - self._mean_x, y - self._mean_y
        self._mean_x += dx / self.count
        self._mean_y += dy / self.count
        self._xx += dx * (x - self._mean_x)
        self._xy += dx * (y - self._mean_y)
        self._yy += dy * (y - self._mean_y)

    def slope(self) -> tuple[float, float]:
        """Return the slope and its standard error [s/s]; of three points or more."""
        if self._xx <= 0 or self.count < 3:
            return 0.0, math.inf
        slope = self._xy / self._xx
        rest = max(0.0, self._yy - slope * self._xy)
        return slope, math.sqrt(rest / (self.count - 2) / self._xx)


# ---- Live sound: blocks that are stamped and written as they come

_SILENT_S = 3.0  # a microphone that delivers nothing for so long is reported


class LiveSound:
    """Takes blocks from a source, stamps them, and writes them as they come."""

    def __init__(self, source: SoundSource, say: Callable[[str], None]) -> None:
        self.written = 0  # number of messages
        self._source = source  # opened, not started
        self._say = say  # reports to the user that no more sound comes
        self._clock = SampleClock(source.rate_hz)
        # Over a minute of sound that is not yet stamped.
        self._queue: TopicQueue[SoundPiece] = TopicQueue(8 * 1024 * 1024, drops=True)
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

    def notes(self, measured_hz: float | None = None) -> dict[str, str]:
        """Return the log's notes on the sound; at first its rate is not measured."""
        rate_hz = self._source.rate_hz
        about = f"{self._source.name}, {rate_hz:g} Hz, mono"
        return rate_notes(about, measured_hz or rate_hz, rate_hz)

    def start(self) -> None:
        """Start the source."""
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
            if self._first_ns is None:
                self._first_ns = item.received_ns
            passed_s = (item.received_ns - self._first_ns) * 1e-9
            # Samples that come a tenth too fast, and 5 s ahead, are of no clock.
            if item.payload.first > self._source.rate_hz * (1.1 * passed_s + 5.0):
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
            for name, text in self.notes(rate_hz).items():
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
        # Ten seconds are kept for the first picture, which was taken a while before it came.
        while self._waiting_samples > 10.0 * self._source.rate_hz:
            self._waiting_samples -= len(self._waiting.popleft().pcm)

    def _write(self, writer: EpisodeWriter, piece: TimedPiece) -> None:
        if self._begin_ns is None or self._end_of([piece]) <= self._begin_ns:
            return
        # A message may hold pieces of sound with a millisecond between them.
        if self._block and abs(piece.stamp_ns - self._end_of(self._block)) > 1_000_000:
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


# ---- Opening: what `--microphone` names


@contextmanager
def opened_microphone(
    wanted: str | None, camera: str, say: Callable[[str], None]
) -> Iterator[LiveSound | None]:
    """Open a microphone for the time of a recording; None where none is asked for."""
    if wanted is None:
        yield None
        return
    if is_file(camera):
        raise UsageError(
            "--microphone is for a live camera; a film's own sound is recorded with it, "
            "so leave it out"
        )
    with closing(LiveSound(_source(wanted), say)) as sound:
        yield sound


def _source(wanted: str) -> SoundSource:
    if wanted and Path(wanted).is_file():
        return PlayedFile(Path(wanted))
    shown = f"--microphone {wanted!r}" if wanted else "--microphone"
    try:
        return opened_within(
            15.0,  # [s] for a driver, or the sound server of a desktop
            shown,
            lambda: PortAudioMicrophone(wanted),
            what="microphone",
        )
    except CameraAwayError as error:
        raise MicrophoneError(error.what, error.remedy) from error


# ---- Played file: a sound file in a microphone's place, in real time


class PlayedFile:
    """A sound file played in real time, to rehearse a recording without a microphone."""

    def __init__(self, path: Path) -> None:
        sound = read_sound(path).sounds(AUDIO_TOPIC)
        why_not = "it holds no sound" if sound is None else why_not_kept(sound)
        if sound is None or why_not:
            raise LogError(f"{path}: {why_not}", "name another file, or a microphone")
        self.name = f"sound file {path.name}"
        self.rate_hz = sound.rate_hz
        self.ended = ""
        self._pcm = as_pcm(sound.samples)
        self._is_over = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, take: Take) -> None:
        """Begin to play."""
        self._thread = threading.Thread(
            target=self._play, args=(take,), name="played file", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop playing."""
        self._is_over.set()
        if self._thread is not None:
            self._thread.join(10 * _PIECE_S)

    def _play(self, take: Take) -> None:
        step, start_ns = max(1, round(_PIECE_S * self.rate_hz)), now_ns()
        for first in range(0, len(self._pcm), step):
            pcm = self._pcm[first : first + step]
            heard_ns = start_ns + round((first + len(pcm)) * 1e9 / self.rate_hz)
            if self._is_over.wait(max(0.0, (heard_ns - now_ns()) * 1e-9)):
                return
            take(SoundPiece(first, start_ns + round(first * 1e9 / self.rate_hz), np.array(pcm)))
        self.ended = "the sound file is at its end"


# ---- PortAudio: the system's microphones


@dataclass(frozen=True)
class InputDevice:
    """A microphone, or what the system offers as one."""

    number: int  # PortAudio's
    name: str
    channels: int  # at most
    rate_hz: float  # its default


class PortAudioMicrophone:
    """An input of PortAudio, mixed down to one channel.

    A sample's time is PortAudio's `inputBufferAdcTime`, as an age on the stream's clock; where that
    is missing, the block's arrival less its length.
    """

    def __init__(self, wanted: str) -> None:
        self._library = _library()
        device = chosen(wanted, *_inputs(self._library))
        self.name = f"microphone {short_name(device.name)}"
        self.rate_hz = device.rate_hz
        self.ended = ""
        self._take: Take | None = None
        self._heard = 0
        self._is_closed = False
        self._stream = self._opened(device)

    def start(self, take: Take) -> None:
        """Begin to deliver blocks."""
        self._take = take
        try:
            self._stream.start()
        except self._library.PortAudioError as error:
            raise MicrophoneError(
                f"{self.name}: does not start ({_short(error)})", "is another program using it?"
            ) from error

    def close(self) -> None:
        """Stop and close the device."""
        if self._is_closed:
            return
        self._is_closed = True

        def close() -> None:
            for end in (self._stream.abort, self._stream.close):
                with suppress(self._library.PortAudioError):
                    end()

        closing = threading.Thread(target=close, name="microphone closing", daemon=True)
        closing.start()
        closing.join(1.0)  # [s]; a recording's end shall be quick though a driver hangs

    def _opened(self, device: InputDevice) -> Any:
        low_hz, high_hz = RATES_HZ
        if not low_hz <= device.rate_hz <= high_hz:
            raise MicrophoneError(
                f"{self.name}: has {device.rate_hz:g} samples a second", "choose another"
            )
        why = ""
        for channels in sorted({1, min(2, device.channels), min(8, device.channels)}):
            try:
                return self._library.InputStream(
                    device=device.number,
                    samplerate=device.rate_hz,
                    blocksize=round(_PIECE_S * device.rate_hz),
                    channels=channels,
                    dtype="int16",
                    latency="high",
                    callback=self._hear,
                    finished_callback=self._has_finished,
                )
            except self._library.PortAudioError as error:
                why = why or _short(error)
        raise MicrophoneError(
            f"{self.name}: cannot be opened ({why})", "is another program using it?"
        )

    def _hear(self, data: np.ndarray, frames: int, times: Any, status: Any) -> None:
        """Copy a block: PortAudio's callback."""
        at_ns, stream_s = now_ns(), self._stream.time  # side by side: they are the same moment
        age_s = stream_s - times.inputBufferAdcTime
        # A sample of over 5 s has the time of another clock.
        if not (times.inputBufferAdcTime and 0 <= age_s < 5.0):
            age_s = frames / self.rate_hz
        pcm = np.round(data.mean(axis=1)).astype(np.int16)
        if self._take is not None:
            is_lost = bool(status.input_overflow)
            self._take(SoundPiece(self._heard, at_ns - round(age_s * 1e9), pcm, is_lost))
        self._heard += frames

    def _has_finished(self) -> None:
        if not self._is_closed:
            self.ended = "it was unplugged, or the system took it away"


def chosen(wanted: str, devices: Sequence[InputDevice], default: int) -> InputDevice:
    """Select the device that the user names."""
    if not devices:
        raise MicrophoneError(
            "--microphone: no microphone is plugged in (PortAudio finds no input)",
            "plug one in, or leave --microphone out",
        )
    if wanted and not (wanted.isascii() and wanted.isdecimal()):
        name = wanted.casefold()
        found = [one for one in devices if one.name.casefold() == name]
        found = found or [one for one in devices if name in one.name.casefold()]
    else:
        number = int(wanted[:9]) if wanted else default
        found = [one for one in devices if one.number == number]
    if len(found) == 1:
        return found[0]
    if len(found) > 1:
        raise UsageError(
            f"--microphone {wanted!r}: {len(found)} are called so ({_those(found)})",
            "name its number",
        )
    what = f"--microphone {wanted!r}: no such microphone" if wanted else "--microphone: no default"
    raise MicrophoneError(f"{what}; there is {_those(devices)}")


def _those(devices: Sequence[InputDevice]) -> str:
    return listed(f"{one.number} {short_name(one.name)!r}" for one in devices)


def _library() -> ModuleType:
    try:
        import sounddevice
    except ModuleNotFoundError as error:
        raise UsageError(f"--microphone needs sounddevice; {pip_install('microphone')}") from error
    except OSError as error:
        raise UsageError(
            "--microphone needs PortAudio, which this system lacks; apt install libportaudio2"
        ) from error
    return sounddevice


def _inputs(library: ModuleType) -> tuple[list[InputDevice], int]:
    """Return the devices that record, and the number of the default one; -1 for none."""
    try:
        devices = library.query_devices()
    except library.PortAudioError as error:
        raise MicrophoneError(
            f"--microphone: the system's devices cannot be listed ({_short(error)})",
            "plug a microphone in again",
        ) from error
    found: list[InputDevice] = []
    for number, one in enumerate(devices):
        if channels := int(one["max_input_channels"]):
            rate_hz = float(one["default_samplerate"])
            found.append(InputDevice(number, str(one["name"]), channels, rate_hz))
    with suppress(TypeError, ValueError):
        return found, int(library.default.device[0])
    return found, -1


def _short(error: Exception) -> str:
    return str(error.args[0]) if error.args else type(error).__name__
