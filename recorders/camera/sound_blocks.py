"""Sound on its way into a log, in short blocks beside the pictures."""

from __future__ import annotations

from tunenet_logs.messages import AUDIO_TOPIC
from tunenet_logs.sound import Sound
from tunenet_logs.sound_notes import sound_blocks
from tunenet_logs.writer import EpisodeWriter


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
