"""Read sound files, as voice recorders write them: .wav, .m4a, .mp3, .flac, .ogg."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tunenet_logs.episode import Channel, Episode, EpisodeInfo
from tunenet_logs.errors import COPY_AGAIN, LogError
from tunenet_logs.formats.media_file import SOUNDS, opened_media
from tunenet_logs.formats.read_options import AS_IT_SAYS, ReadOptions
from tunenet_logs.formats.sound_track import PacketTimes, SoundTrack, sound_stream
from tunenet_logs.formats.video_clock import creation_ns
from tunenet_logs.messages import AUDIO_TOPIC
from tunenet_logs.sound import Sound

# How such files are mostly called; what they are, their contents tell.
SUFFIXES = (".wav", ".m4a", ".mp3", ".flac", ".ogg", ".opus", ".aac", ".aiff", ".aif", ".caf")

# The remedy for sound that is written as few programs do.
_SAVE_AS_WAV = "save it as WAV of 16 bits a sample"


def named_as_sound(path: Path) -> bool:
    """Return whether a file is named as sound, regardless of its content."""
    return path.suffix.lower() in SUFFIXES


def is_sound_alone(path: Path) -> bool:
    """Return whether a file holds sound and no video."""
    try:
        with opened_media(path, SOUNDS, "sound") as container:
            return sound_stream(container) is not None and not _has_film(container)
    except LogError:
        return False


def read_sound(path: Path, _options: ReadOptions = AS_IT_SAYS) -> Episode:
    """Read a sound file as an episode without signals, beginning at its creation time, or 0.

    Raises:
        LogError: no sound is in it, or it is damaged from its beginning on.
    """
    try:
        return _read(path)
    except LogError as error:
        if not named_as_sound(path) or error.remedy != COPY_AGAIN:
            raise
        what = f"{error.what}: it has {path.stat().st_size} bytes"
        raise LogError(what, f"copy it again, or {_SAVE_AS_WAV}") from error


def _read(path: Path) -> Episode:
    with opened_media(path, SOUNDS, "sound") as container:
        stream = sound_stream(container)
        if stream is None:
            raise LogError(f"{path}: holds no sound that can be decoded", _SAVE_AS_WAV)
        start_ns = creation_ns({**stream.metadata, **container.metadata}.get("creation_time", ""))
        times = PacketTimes(stream)
        for packet in container.demux(stream):
            times.add(packet)
            if times.is_enough:
                break
        track = times.track(path, SOUNDS)
    if not len(track.packets_s):
        raise LogError(f"{path}: holds no sound", COPY_AGAIN)
    channel = Channel(
        topic=AUDIO_TOPIC,
        type_name=track.codec,
        encoding="audio",
        log_ns=start_ns + np.round((track.packets_s - track.packets_s[0]) * 1e9).astype(np.int64),
        sounds=True,
    )
    info = EpisodeInfo(source=f"sound file {path.name}", notes=sound_notes(track))

    def opened(_topic: str) -> Sound:
        return track.sound(start_ns)

    return Episode(info, {}, (channel,), open_sound=opened)


def sound_notes(track: SoundTrack) -> dict[str, str]:
    """Describe a sound track for the notes of a log."""
    return {"sound": f"{track.codec}, {track.rate_hz:g} Hz, {_channels(track.channels)}"}


def _channels(count: int) -> str:
    return {1: "mono", 2: "stereo"}.get(count, f"{count} channels")


def _has_film(container: object) -> bool:
    """Return whether a container holds video other than cover art."""
    from av.container import InputContainer
    from av.stream import Disposition

    assert isinstance(container, InputContainer)
    return any(
        not stream.disposition & Disposition.attached_pic for stream in container.streams.video
    )
