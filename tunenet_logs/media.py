"""Open media files with FFmpeg, and time the frames of a video.

An MP4 that claims an absurd number of samples is refused before FFmpeg allocates them. `clock_of`
stamps the frames: by the user's frame rate, else by the file's times, slow motion undone.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.episode import FRAME_NS
from tunenet_logs.errors import CHECK_DISK, COPY_AGAIN, LogError
from tunenet_logs.files import open_regular
from tunenet_logs.process import called_by_c, is_stopping, stop_now

if TYPE_CHECKING:
    from av.container import InputContainer


_TABLES = (b"stsz", b"stz2", b"trun")  # MP4's boxes that claim samples
# Where they say how many samples follow: a few bytes, for which FFmpeg makes a list.
_COUNTS = re.compile(
    rb"stsz\x00{4}.{4}(.{4})"  # of a film
    rb"|stz2\x00{7}.(.{4})"
    rb"|trun[\x00\x01]\x00[\x00-\x0f][\x00\x01\x04\x05](.{4})",  # of a fragment
    re.DOTALL,
)


class Mp4Claims:
    """Running count of the samples that an MP4 claims while it is read.

    Its size is `file_bytes`; where that is not known, each byte counts as it comes.
    """

    def __init__(self, file_bytes: int = 0) -> None:
        self._tail = b""
        self._claimed = 0
        self._counts_on = not file_bytes
        self._bytes = file_bytes

    def check(self, data: bytes) -> None:
        """Count the samples claimed in the next bytes; raise LogError for more than they hold."""
        seen = self._tail + data
        end = 0
        if any(name in seen for name in _TABLES):  # far quicker than the pattern
            for found in _COUNTS.finditer(seen):
                end = found.end()
                count = next(group for group in found.groups() if group is not None)
                self._claimed += int.from_bytes(count, "big")
        # The longest match has 16 bytes, and one may be cut in two.
        self._tail = seen[max(end, len(seen) - 15) :]
        if self._counts_on:
            self._bytes += len(data)
        # Any file may claim 100 s of bare sound, days of pictures; and more for each byte.
        if self._claimed > 5_000_000 + self._bytes / 16:
            raise LogError(f"claims {self._claimed} samples in {self._bytes} bytes")

    def skip(self) -> None:
        """Note that the next bytes do not follow upon the last."""
        self._tail = b""


class CheckedFile:
    """File object for FFmpeg that ends where the file claims too much.

    An exception would be lost on its way through FFmpeg, or printed: `refused` says why it ended.
    """

    def __init__(self, file: BufferedReader) -> None:
        self.name = file.name
        self.refused: LogError | None = None
        self._file = file
        self._claims = Mp4Claims(os.fstat(file.fileno()).st_size)

    @called_by_c
    def read(self, most: int) -> bytes:
        """Read the next bytes; none once the file is refused."""
        if self.refused is None and not is_stopping():
            data = self._file.read(most)
            try:
                self._claims.check(data)
            except LogError as error:
                self.refused = error
            else:
                return data
        return b""

    @called_by_c
    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to another position."""
        self._claims.skip()
        return self._file.seek(offset, whence)

    @called_by_c
    def tell(self) -> int:
        """Return the position of the next byte."""
        return self._file.tell()


# ---- Opening, of formats that cannot refer to other files

# Only what holds pictures itself: a playlist could name any other file or host.
FILMS = "mov,matroska,avi,mpeg,mpegts,flv,ogg,asf,mjpeg,h264,hevc,m4v,gif,apng,ivf,nut,"
FILMS += "yuv4mpegpipe,obu,av1"
SOUNDS = "wav,w64,aiff,caf,au,mp3,flac,ogg,aac,amr,mov,matroska,asf"  # only what holds sound itself


@contextmanager
def opened_media(path: Path, formats: str, what: str) -> Iterator[InputContainer]:
    """Open a file with FFmpeg, as one of `formats` by FFmpeg's names; `what` is that in words."""
    import av
    from av import logging
    from av.error import FFmpegError

    logging.set_level(None)  # errors come as exceptions; its printing would only disturb
    options = {"format_whitelist": formats, "protocol_whitelist": "file,pipe"}
    try:
        with open_regular(path) as file:
            # FFmpeg takes a stream of JPEGs for a single picture.
            form = "mjpeg" if file.read(3) == b"\xff\xd8\xff" else None
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


# ---- Clock: acquisition stamps of a video's frames


@dataclass(frozen=True)
class StoredTimes:
    """Times stored in a video file."""

    # of the frames shown, increasing; None where they have no times, and are in display order
    ticks: Sequence[int] | None
    count: int  # of the frames shown
    base_s: Fraction  # one tick [s]
    rate_hz: float | None  # stated by the file, for frames without times; None where it is unstated
    tags: dict[str, str]


@dataclass(frozen=True, eq=False)
class VideoClock:
    """Acquisition stamps of a video file's frames."""

    # of all frames shown, int64, shape (T,), strictly increasing; from the file's creation tag on,
    # else from 0
    stamps_ns: NDArray[np.int64]
    stored_hz: float  # playback rate; 0 where it is unstated
    filmed_hz: float  # the user's, else that of a slow-motion tag, else the playback rate
    is_timed: bool  # whether the stamps are times; else they count frames, `FRAME_NS` each
    warnings: tuple[str, ...]  # what was repaired or is doubtful, in words


def clock_of(times: StoredTimes, said_hz: float | None) -> VideoClock:
    """Build the clock from `said_hz`, the user's frame rate, else from the file.

    Frames are counted, regardless of their times, where the user knows better.
    """
    start_ns = creation_ns(times.tags.get("creation_time", ""))
    counts = np.arange(times.count)
    # The playback rate: 0 for a single frame, and where it is unstated.
    fresh = sorted(set(times.ticks or ()))
    stored_hz = (times.rate_hz or 0.0) if times.ticks is None else 0.0
    if len(fresh) > 1:
        periods = np.diff(np.array(fresh, np.int64))
        median = np.median(periods)
        usual = periods[np.abs(periods - median) <= 0.2 * median]  # none of two that are far apart
        mean = np.mean(usual) if len(usual) else median
        stored_hz = float(1 / (mean * float(times.base_s)))
    if said_hz is not None or times.ticks is None:
        rate_hz = said_hz or times.rate_hz
        step_ns = 1e9 / rate_hz if rate_hz else FRAME_NS
        stamps_ns = start_ns + np.round(counts * step_ns).astype(np.int64)
        said: tuple[str, ...] = ()
        if said_hz is not None:
            plays = f"it plays at {stored_hz:.4g}" if stored_hz else "it states none"
            said = (f"{said_hz:g} pictures a second were said; {plays}",)
        elif not rate_hz:
            said = ("nothing says how many pictures a second there are; say it with --fps",)
        return VideoClock(stamps_ns, stored_hz, said_hz or stored_hz, rate_hz is not None, said)
    doubled = times.count - len(fresh)
    warnings = (f"{doubled} frames have a stamp of another",) if doubled else ()
    # Android's tag of slow motion, which is what a camera can film at, and faster.
    rate_hz = stored_hz
    with suppress(ValueError):
        tagged_hz = float(times.tags.get("com.android.capture.fps", ""))
        if max(1.0, stored_hz * 1.05) <= tagged_hz <= 100_000:
            rate_hz = tagged_hz
    slow = Fraction(stored_hz / rate_hz) if stored_hz else Fraction(1)
    origin = times.ticks[0]
    step_ns = times.base_s * slow * 10**9
    stamps_ns = np.array(
        [start_ns + round((tick - origin) * step_ns) for tick in times.ticks], np.int64
    )
    if doubled:  # keep one stamp a frame, in order
        stamps_ns = np.maximum.accumulate(stamps_ns) + counts
    return VideoClock(stamps_ns, stored_hz, rate_hz, is_timed=True, warnings=warnings)


def creation_ns(text: str) -> int:
    """Parse a file's creation tag [ns]; 0 where it is not a date."""
    try:
        stamp = datetime.fromisoformat(text)
    except ValueError:
        return 0
    return max(0, round(stamp.timestamp()) * 10**9)
