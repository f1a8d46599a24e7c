"""Check the integrity of a log: every record, checksum, message and picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.read_options import AS_IT_SAYS, ReadOptions
from tunenet_logs.left_out import LeftOut, left_out_of
from tunenet_logs.one_clock import on_one_clock
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress, one_line


@dataclass(frozen=True, eq=False)
class Health:
    """Result of an integrity check.

    Attributes:
        damage: what is wrong and where, one a line; empty for a whole log.
        doubts: what is no damage but should be known.
        left_out: of which so much is left out that the log is not whole, though not damaged.
    """

    episode: Episode
    damage: tuple[str, ...]
    doubts: tuple[str, ...]
    left_out: tuple[LeftOut, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether nothing is damaged and everything is used."""
        return not self.damage and not self.left_out


def check(path: Path, progress: Progress, options: ReadOptions = AS_IT_SAYS) -> Health:
    """Check a log by reading all of it and decoding all of its pictures and sound.

    Raises:
        LogError: nothing of it can be read.
    """
    with progress.stages(one_line(path)):
        episode = read_episode(path, options)
    damage = list(episode.losses)
    for topic in episode.picture_topics:
        damage += _picture_damage(episode, topic, progress)
    heard: list[str] = []
    for topic in episode.sound_topics:
        heard += [f"{topic}: {said}" for said in _heard(episode, topic)]
    lost = set(episode.losses)
    doubts = tuple(warning for warning in episode.warnings if warning not in lost)
    left_out = tuple(one for one in left_out_of(on_one_clock(episode)) if one.is_much)
    return Health(episode, tuple(damage), (*doubts, *heard), left_out)


def _heard(episode: Episode, topic: str) -> tuple[str, ...]:
    """Return the warnings on the sound of a topic."""
    sound = episode.sounds(topic)
    return () if sound is None else sound.warnings


def _picture_damage(episode: Episode, topic: str, progress: Progress) -> list[str]:
    """List the pictures of a topic that cannot be decoded, beside damaged messages."""
    stated = sum(channel.messages for channel in episode.channels if channel.topic == topic)
    bad: list[int] = []
    count = 0
    found: list[str] = []
    with progress.bar(stated, topic, "picture") as bar:
        try:
            for frame in episode.frames(topic):
                count += 1
                bar.update(1)
                try:
                    frame.decode()
                except LogError:
                    bad.append(frame.stamp_ns)
        except LogError as error:
            found.append(f"{topic}: reading ends after {count} of {stated} pictures: {error}")
    if bad:
        found.append(f"{topic}: {len(bad)} of {count} pictures are damaged, first {bad[0]} ns")
    return found
