"""Write sound to a log in short blocks beside the pictures."""

from __future__ import annotations

from typing import Protocol

from tunenet_logs.messages import AUDIO_TOPIC
from tunenet_logs.sound import Sound
from tunenet_logs.sound_notes import sound_blocks
from tunenet_logs.writer import EpisodeWriter


class WritesSound(Protocol):
    """A writer of sound beside pictures.

    Attributes:
        written: number of messages.
    """

    written: int

    def write_until(self, writer: EpisodeWriter, stamp_ns: int) -> None:
        """Write sound up to the stamp of the next picture."""
        ...

    def tick(self, writer: EpisodeWriter) -> None:
        """Write what is due while no picture comes."""
        ...

    def finish(self, writer: EpisodeWriter, until_ns: int) -> None:
        """Write the remaining sound that begins before a stamp."""
        ...

    def in_words(self) -> str:
        """Summarize the sound for the recorder's last line."""
        ...


class SoundBlocks:
    """Writes a sound as far as the pictures have come.

    Attributes:
        written: number of messages.
    """

    def __init__(self, sound: Sound) -> None:
        self.written = 0
        self._heard_s = 0.0
        self._rate_hz = round(sound.rate_hz)
        self._blocks = sound_blocks(sound)
        self._next = next(self._blocks, None)

    def in_words(self) -> str:
        """Summarize the sound for the recorder's last line."""
        return f"{self._heard_s:.1f} s of sound"

    def write_until(self, writer: EpisodeWriter, stamp_ns: int) -> None:
        """Write blocks that begin before a stamp and are not yet written."""
        while self._next is not None and self._next[0] < stamp_ns:
            block_ns, pcm = self._next
            writer.write_sound(AUDIO_TOPIC, block_ns, pcm, self._rate_hz)
            self.written += 1
            self._heard_s += len(pcm) / self._rate_hz
            self._next = next(self._blocks, None)

    def tick(self, writer: EpisodeWriter) -> None:
        """Do nothing: the sound is written with the pictures."""

    def finish(self, writer: EpisodeWriter, until_ns: int) -> None:
        """Write the remaining blocks that begin before a stamp."""
        self.write_until(writer, until_ns)
