"""Open what `--microphone` names, to record it beside a live camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from recorders.camera.opening import opened_within
from recorders.camera.sources import is_file
from tunenet_logs.errors import CameraAwayError, MicrophoneError, UsageError

if TYPE_CHECKING:
    from recorders.microphone.base import SoundSource
    from recorders.microphone.live_sound import LiveSound

_OPENING_S = 15.0  # for a driver, or the sound server of a desktop, to open a microphone


@contextmanager
def opened_microphone(
    wanted: str | None, camera: str, say: Callable[[str], None]
) -> Iterator[LiveSound | None]:
    """Open a microphone for the time of a recording; None where none is asked for.

    Args:
        wanted: a device's number or a part of its name, or a sound file; "" for the default device.
        camera: the source it is recorded beside.
        say: reports to the user that no more sound comes.

    Raises:
        UsageError: the camera is not live, or the microphone library is not installed.
        MicrophoneError: it is not there, or cannot be opened.
        LogError: a file that holds no sound.
    """
    if wanted is None:
        yield None
        return
    if is_file(camera):
        raise UsageError(
            "--microphone is for a live camera; a film's own sound is recorded with it, "
            "so leave it out"
        )
    from recorders.microphone.live_sound import LiveSound

    with closing(LiveSound(_source(wanted), say)) as sound:
        yield sound


def _source(wanted: str) -> SoundSource:
    path = Path(wanted)
    if wanted and path.is_file():
        from recorders.microphone.played_file import PlayedFile

        return PlayedFile(path)
    from recorders.microphone.portaudio import PortAudioMicrophone

    shown = f"--microphone {wanted!r}" if wanted else "--microphone"
    try:
        return opened_within(
            _OPENING_S, shown, lambda: PortAudioMicrophone(wanted), what="microphone"
        )
    except CameraAwayError as error:
        raise MicrophoneError(error.what, error.remedy) from error
