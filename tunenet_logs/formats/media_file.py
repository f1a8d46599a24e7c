"""Open image and sound files with FFmpeg, of formats that cannot refer to other files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from tunenet_logs.errors import CHECK_DISK, COPY_AGAIN, LogError
from tunenet_logs.formats.mp4_claims import CheckedFile
from tunenet_logs.regular_file import open_regular
from tunenet_logs.stopping import stop_now

if TYPE_CHECKING:
    from av.container import InputContainer

FILMS = "mov,matroska,avi,mpeg,mpegts,flv,ogg,asf,mjpeg,h264,hevc,m4v,gif,apng,ivf,nut,"
FILMS += "yuv4mpegpipe,obu,av1"
"""Only what holds pictures itself: a playlist could name any other file or host."""

SOUNDS = "wav,w64,aiff,caf,au,mp3,flac,ogg,aac,amr,mov,matroska,asf"  # only what holds sound itself
_JPEG_START = b"\xff\xd8\xff"  # of a stream of JPEGs, which FFmpeg takes for a single picture


@contextmanager
def opened_media(path: Path, formats: str, what: str) -> Iterator[InputContainer]:
    """Open a file with FFmpeg.

    Args:
        path: the file.
        formats: allowed ones, by FFmpeg's names.
        what: expected kind, in words.

    Raises:
        LogError: it is of another kind, is damaged, or claims more than it can hold.
    """
    import av
    from av import logging
    from av.error import FFmpegError

    logging.set_level(None)  # errors come as exceptions; its printing would only disturb
    options = {"format_whitelist": formats, "protocol_whitelist": "file,pipe"}
    try:
        with open_regular(path) as file:
            form = "mjpeg" if file.read(3) == _JPEG_START else None
            file.seek(0)
            checked = CheckedFile(file)
            try:
                with av.open(
                    checked, "r", format=form, options=options, metadata_errors="replace"
                ) as container:
                    yield container
            finally:
                stop_now()
                if checked.refused is not None:
                    raise LogError(f"{path}: {checked.refused}; cut the drop out of it")
    except (FFmpegError, ValueError, OverflowError, MemoryError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise LogError(f"{path}: is no {what} that can be read ({reason})", COPY_AGAIN) from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})", CHECK_DISK) from error
