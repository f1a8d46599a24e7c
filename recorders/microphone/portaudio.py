"""Read a microphone through PortAudio."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from recorders.microphone.base import PIECE_S, SoundPiece, Take
from tunenet_logs.clock import now_ns
from tunenet_logs.errors import MicrophoneError, UsageError
from tunenet_logs.formats.gathered_sound import RATES_HZ
from tunenet_logs.terminal import listed, short_name

# No sample waits longer before it is delivered: a time that says so is of another clock.
_PLAUSIBLE_S = 5.0

_MAX_CHANNELS = 8  # of a device that has neither one nor two
# For a driver to let go of a device: a recording's end shall be quick though it hangs.
_CLOSING_S = 1.0


@dataclass(frozen=True)
class InputDevice:
    """A microphone, or what the system offers as one.

    Attributes:
        number: PortAudio's.
        channels: at most.
        rate_hz: its default.
    """

    number: int
    name: str
    channels: int
    rate_hz: float


class PortAudioMicrophone:
    """An input of PortAudio, mixed down to one channel.

    A sample's time is PortAudio's `inputBufferAdcTime`, as an age on the stream's clock; where that
    is missing, the block's arrival less its length.

    Args:
        wanted: a device's number, or a part of its name; "" for the default.

    Raises:
        UsageError: the library is not installed, or the name is ambiguous.
        MicrophoneError: there is none, or it cannot be opened.
    """

    def __init__(self, wanted: str) -> None:
        self._library = _library()
        device = chosen(wanted, _inputs(self._library), _default(self._library))
        self.name = f"microphone {short_name(device.name)}"
        self.rate_hz = device.rate_hz
        self.ended = ""
        self._take: Take | None = None
        self._heard = 0
        self._is_closed = False
        self._stream = self._opened(device)

    def start(self, take: Take) -> None:
        """Begin to deliver blocks.

        Raises:
            MicrophoneError: it does not start.
        """
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
        closing = threading.Thread(target=self._close, name="microphone closing", daemon=True)
        closing.start()
        closing.join(_CLOSING_S)

    def _close(self) -> None:
        with suppress(self._library.PortAudioError):
            self._stream.abort()
        with suppress(self._library.PortAudioError):
            self._stream.close()

    def _opened(self, device: InputDevice) -> Any:
        low_hz, high_hz = RATES_HZ
        if not low_hz <= device.rate_hz <= high_hz:
            raise MicrophoneError(
                f"{self.name}: has {device.rate_hz:g} samples a second", "choose another"
            )
        why = ""
        for channels in sorted({1, min(2, device.channels), min(_MAX_CHANNELS, device.channels)}):
            try:
                with _silent_libraries():
                    return self._library.InputStream(
                        device=device.number,
                        samplerate=device.rate_hz,
                        blocksize=round(PIECE_S * device.rate_hz),
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
        if not (times.inputBufferAdcTime and 0 <= age_s < _PLAUSIBLE_S):
            age_s = frames / self.rate_hz
        pcm = data[:, 0].copy() if data.shape[1] == 1 else _mixed(data)
        if self._take is not None:
            is_lost = bool(status.input_overflow)
            self._take(SoundPiece(self._heard, at_ns - round(age_s * 1e9), pcm, is_lost))
        self._heard += frames

    def _has_finished(self) -> None:
        if not self._is_closed:
            self.ended = "it was unplugged, or the system took it away"


def chosen(wanted: str, devices: Sequence[InputDevice], default: int) -> InputDevice:
    """Select the device that the user names.

    Args:
        wanted: its number, its name or a part of it, in any case; "" for the default.
        devices: those available.
        default: the number of the system's.

    Raises:
        UsageError: the name is ambiguous.
        MicrophoneError: there is none.
    """
    if not devices:
        raise MicrophoneError(
            "--microphone: no microphone is plugged in (PortAudio finds no input)",
            "plug one in, or leave --microphone out",
        )
    if wanted.isascii() and wanted.isdecimal():
        found = [one for one in devices if one.number == int(wanted[:9])]
    elif wanted:
        names = [one.name.casefold() for one in devices]
        whole = [one for one in devices if one.name.casefold() == wanted.casefold()]
        part = [one for one, name in zip(devices, names, strict=True) if wanted.casefold() in name]
        found = whole or part
    else:
        found = [one for one in devices if one.number == default]
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
        raise UsageError(
            "--microphone needs sounddevice; pip install 'tunenet-logs[microphone]'"
        ) from error
    except OSError as error:
        raise UsageError(
            "--microphone needs PortAudio, which this system lacks; apt install libportaudio2"
        ) from error
    return sounddevice


def _inputs(library: ModuleType) -> list[InputDevice]:
    try:
        devices = library.query_devices()
    except library.PortAudioError as error:
        raise MicrophoneError(
            f"--microphone: the system's devices cannot be listed ({_short(error)})",
            "plug a microphone in again",
        ) from error
    return [
        InputDevice(
            number,
            str(one["name"]),
            int(one["max_input_channels"]),
            float(one["default_samplerate"]),
        )
        for number, one in enumerate(devices)
        if one["max_input_channels"] > 0
    ]


def _default(library: ModuleType) -> int:
    try:
        return int(library.default.device[0])
    except (TypeError, ValueError):
        return -1


def _mixed(data: np.ndarray) -> np.ndarray:
    """Return the mean of all channels, shape (N,)."""
    return np.round(data.mean(axis=1)).astype(np.int16)


def _short(error: Exception) -> str:
    return str(error.args[0]) if error.args else type(error).__name__


@contextmanager
def _silent_libraries() -> Iterator[None]:
    """Silence what ALSA and PortAudio print to the process's standard error."""
    kept = os.dup(2)
    try:
        with open(os.devnull, "wb") as nothing:
            os.dup2(nothing.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
