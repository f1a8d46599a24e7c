"""Play a sound file in a microphone's place, in real time."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np

from recorders.microphone.base import PIECE_S, SoundPiece, Take
from tunenet_logs.clock import now_ns
from tunenet_logs.formats.sound_file import read_sound
from tunenet_logs.messages import AUDIO_TOPIC
from tunenet_logs.sound_notes import as_pcm, why_not_kept


class PlayedFile:
    """A sound file played in real time, as if recorded by a microphone.

    It plays from when it is started, to rehearse a recording and check its sound without a
    microphone.

    Raises:
        LogError: it holds no sound.
    """

    def __init__(self, path: Path) -> None:
        sound = read_sound(path).sounds(AUDIO_TOPIC)
        why_not = "it holds no sound" if sound is None else why_not_kept(sound)
        if sound is None or why_not:
            from tunenet_logs.errors import LogError

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
            self._thread.join(10 * PIECE_S)

    def _play(self, take: Take) -> None:
        step, start_ns = max(1, round(PIECE_S * self.rate_hz)), now_ns()
        for first in range(0, len(self._pcm), step):
            pcm = self._pcm[first : first + step]
            heard_ns = start_ns + round((first + len(pcm)) * 1e9 / self.rate_hz)
            if self._is_over.wait(max(0.0, (heard_ns - now_ns()) * 1e-9)):
                return
            take(SoundPiece(first, start_ns + round(first * 1e9 / self.rate_hz), np.array(pcm)))
        self.ended = "the sound file is at its end"
