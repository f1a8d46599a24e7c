"""Sound on its way into a log, in short blocks beside the pictures."""

from __future__ import annotations

from typing import Protocol

from tunenet_logs.messages import AUDIO_TOPIC
from tunenet_logs.sound import Sound
from tunenet_logs.sound_notes import sound_blocks
from tunenet_logs.writer import EpisodeWriter


class WritesSound(Protocol):
    """What writes sound while pictures are written.

    Attributes:
        written: messages.
    """

    written: int

    def write_until(self, writer: EpisodeWriter, stamp_ns: int) -> None:
        """A picture of that stamp is to be written next."""
        ...

    def tick(self, writer: EpisodeWriter) -> None:
        """Nothing comes from the camera at the moment."""
        ...

    def finish(self, writer: EpisodeWriter, until_ns: int) -> None:
        """No more pictures come; sound that begins before a stamp is wanted still."""
        ...

    def in_words(self) -> str:
        """For the last line that a recorder prints."""
        ...


class SoundBlocks:
    """Writes a sound as far as the pictures have come.

    Attributes:
        written: messages.

    Args:
        sound: all of it.
    """

    def __init__(self, sound: Sound) -> None:
        self.written = 0
        self._heard_s = 0.0
        self._rate_hz = round(sound.rate_hz)
        self._blocks = sound_blocks(sound)
        self._next = next(self._blocks, None)

    def in_words(self) -> str:
        """For the last line that a recorder prints."""
        return f"{self._heard_s:.1f} s of sound"

    def write_until(self, writer: EpisodeWriter, stamp_ns: int) -> None:
        """Write what begins before a stamp and was not yet written."""
        while self._next is not None and self._next[0] < stamp_ns:
            block_ns, pcm = self._next
            writer.write_sound(AUDIO_TOPIC, block_ns, pcm, self._rate_hz)
            self.written += 1
            self._heard_s += len(pcm) / self._rate_hz
            self._next = next(self._blocks, None)

    def tick(self, writer: EpisodeWriter) -> None:
        """Nothing: it is written with the pictures."""

    def finish(self, writer: EpisodeWriter, until_ns: int) -> None:
        """Write the rest that begins before a stamp."""
        self.write_until(writer, until_ns)
