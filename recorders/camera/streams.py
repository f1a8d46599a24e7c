"""Split a camera's byte stream into compressed pictures, and open it by its first bytes.

A container or bare stream is demuxed by FFmpeg, which opens nothing itself: `PacketStream` makes
whole pictures (access units) of its packets, and decodes none. MJPEG is split by our own parser. A
hostile camera chooses these bytes: every one is looked at a bounded number of times.
"""

from __future__ import annotations

import re
import string
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple, NoReturn

from tunenet_logs.episode import Frame
from tunenet_logs.errors import CameraError, LogError
from tunenet_logs.images import MAX_PIXELS
from tunenet_logs.media import Mp4Claims
from tunenet_logs.messages import is_whole
from tunenet_logs.recorders.camera.base import BaseSource, CapturedFrame, Source
from tunenet_logs.recorders.camera.feeds import MAX_PICTURE_BYTES, MULTIPART, TimedFeed
from tunenet_logs.recorders.camera.network import answering
from tunenet_logs.recorders.session import closed_on_failure
from tunenet_logs.timing.stamps import now_ns, wall_ns

if TYPE_CHECKING:
    from av import Packet, VideoCodecContext
    from av.container import InputContainer


# ---- Access units: packets as whole pictures, with timestamp and time of arrival


class Unit(NamedTuple):
    """One compressed picture (access unit)."""

    data: bytes
    ticks: int | None  # presentation timestamp in the stream's time base, if it has any
    arrived_ns: int  # when its first byte arrived [ns]
    is_key: bool  # whether the container marks it as a key frame
    is_corrupt: bool  # whether FFmpeg reports data missing from it


def whole_units(
    packets: Iterable[Packet], arrived_ns: Callable[[Packet], int], *, is_cut: bool
) -> Iterator[Unit]:
    """Yield one unit per non-empty packet of a parsed stream."""
    # Where the parser searches for a picture's end (`is_cut`), it finds it in the next picture, and
    # reports what is missing from that one on the picture before.
    is_next_corrupt = False
    for packet in packets:
        if packet.size:
            came_ns = arrived_ns(packet)
            is_corrupt = is_next_corrupt if is_cut else packet.is_corrupt
            is_next_corrupt = packet.is_corrupt
            yield Unit(bytes(packet), packet.pts, came_ns, packet.is_keyframe, is_corrupt)


def joined_units(packets: Iterable[Packet], arrived_ns: Callable[[Packet], int]) -> Iterator[Unit]:
    """Yield one unit per run of packets with one timestamp, which in RTP is one picture."""
    # FFmpeg's parser, which would join them too, loses the time of the first picture, and returns
    # each so late that its arrival is the next one's.
    pieces: list[Packet] = []
    came_ns = size = 0

    def joined() -> Unit:
        data = b"".join(map(bytes, pieces))
        is_key = any(piece.is_keyframe for piece in pieces)
        is_corrupt = any(piece.is_corrupt for piece in pieces)
        return Unit(data, pieces[0].pts, came_ns, is_key, is_corrupt)

    for packet in packets:
        if not packet.size:
            continue
        is_next = bool(pieces) and packet.pts is not None and packet.pts != pieces[0].pts
        if is_next or size > MAX_PICTURE_BYTES:
            yield joined()
            pieces, size = [], 0
        if not pieces:
            came_ns = arrived_ns(packet)
        pieces.append(packet)
        size += packet.size
    if pieces:
        yield joined()


# ---- H.264 and H.265: random access points and parameter sets (Rec. ITU-T, annex B)
# Each NAL unit follows a start code; its type is in its first byte.

_START = b"\0\0\1"

# Types of NAL units: parameter sets (VPS in H.265, SPS, PPS), slices, which hold the pixels, and of
# those the ones from which a decoder can begin.
_SETS = {"h264": (7, 8), "h265": (32, 33, 34)}
_SLICES = {"h264": range(1, 6), "h265": range(32)}
_STANDS_ALONE = {"h264": range(5, 6), "h265": range(16, 24)}


def head_of(data: bytes, codec: str) -> tuple[bool, bytes]:
    """Parse one picture's NAL units up to its first slice; `codec` is "h264" or "h265".

    Returns whether it is a random access point, where a decoder can begin, and the parameter sets
    that it carries (VPS, SPS, PPS), with their start codes.
    """
    recovers = False
    sets: list[bytes] = []
    at = data.find(_START)
    for _ in range(64):  # encoders write a handful of NAL units before the first slice
        if not 0 <= at < len(data) - 4:
            break
        at += 3
        kind = data[at] & 31 if codec == "h264" else data[at] >> 1 & 63
        if kind in _SLICES[codec]:
            return recovers or kind in _STANDS_ALONE[codec], b"".join(sets)
        # An SEI unit of H.264, and its message that a decoder can begin here.
        recovers = recovers or (codec == "h264" and kind == 6 and data[at + 1] == 6)
        following = data.find(_START, at)
        if kind in _SETS[codec]:
            unit = data[at : following if following >= 0 else len(data)]
            sets += [b"\0", _START, unit.rstrip(b"\0")]
        at = following
    return False, b"".join(sets)


# ---- Packets: the video of an open container

# From FFmpeg's codec to the format that a log's messages have.
_LOG_FORMATS = {"h264": "h264", "hevc": "h265", "vp9": "vp9", "av1": "av1", "mjpeg": "jpeg"}

# By codec, the filter that rewrites packets of MP4, Matroska and the like, and leaves others.
_TO_ANNEX_B = {"h264": "h264_mp4toannexb", "hevc": "hevc_mp4toannexb"}

NOT_PARSED = {"fflags": "noparse+nofillin"}  # to open RTP with


class PacketStream(BaseSource):
    """The video of an open container as it comes; nothing is decoded.

    H.264 and H.265 become Annex B pictures that carry their parameter sets at every random access
    point; VP9, AV1 and JPEGs stay as they are. What precedes the first picture that stands alone is
    skipped. A frame of any other codec has the codec's name for an encoding, and `needs_decoding`
    is true: see `tunenet_logs.recorders.camera.reading`.

    FFmpeg returns the rest of a damaged picture as if it were whole, and decoders make something of
    it that looks like one. So where a loss is known, the picture is left out and counted as
    damaged, and so are those predicted from it.
    """

    def __init__(
        self,
        container: InputContainer,  # opened, with a time-out, of RTP with `NOT_PARSED`; closed here
        shown: str,
        timeout_s: float,  # the longest silence that it was opened with
        *,
        # Whether packets were lost in a picture or just before it, by its time in the stream's time
        # base (of RTP from 0 for the first); called in order.
        is_damaged: Callable[[int | None], bool] = lambda _ticks: False,
        # When a packet's first byte arrived; by default when FFmpeg returns it.
        arrived_ns: Callable[[Packet], int] = lambda _packet: now_ns(),
    ) -> None:
        from av.format import Flags

        streams = [one for one in container.streams.video if one.codec_context is not None]
        if not streams:
            container.close()
            raise CameraError(f"{shown}: holds no video; give the address of its video")
        super().__init__(f"camera {shown}")
        self._container = container
        self._stream = streams[0]
        self._codec = self._stream.codec_context.name
        self._format = _LOG_FORMATS.get(self._codec, self._codec)
        self._formats = frozenset(container.format.name.split(","))
        # Whether packets are pieces of pictures, each with its RTP time.
        self._is_rtp = bool(self._formats & {"rtsp", "rtp", "sdp"})
        # Whether the log cannot hold this codec.
        self.needs_decoding = self._codec not in _LOG_FORMATS
        self._has_times = not container.format.flags & Flags.no_timestamps.value
        self._sets = b""
        self._is_damaged = is_damaged
        self._timeout_s = timeout_s
        self._arrived_ns = arrived_ns

    def notes(self) -> dict[str, str]:
        """Return the codec."""
        return {"codec": self._codec}

    def decoder(self) -> VideoCodecContext:
        """Make a decoder set up with the container's stream parameters."""
        import av

        said = self._stream.codec_context
        decoder = av.CodecContext.create(self._codec, "r")
        assert isinstance(decoder, av.VideoCodecContext)
        decoder.thread_type = "AUTO"
        decoder.options = {"max_pixels": str(MAX_PIXELS)}
        if said.extradata and self._codec not in _TO_ANNEX_B:  # which carry their own
            decoder.extradata = said.extradata
        if said.pix_fmt and said.width:  # bare pixels say nothing of themselves
            decoder.width, decoder.height, decoder.pix_fmt = said.width, said.height, said.pix_fmt
        return decoder

    def _release(self) -> None:
        self._container.close()

    def _packets(self) -> Iterator[Packet]:
        """Demux until the stream ends, breaks, or is silent for too long."""
        from av.error import ExitError, FFmpegError

        try:
            yield from self._container.demux(self._stream)
            self.returns = self._container.duration is None  # what has one is a film
            self.ended = "the stream was closed by the camera"
        except ExitError:  # the time-out interrupts the read
            self.ended = f"no data for {self._timeout_s:.1f} s"
        except FFmpegError as error:
            self.ended = f"the stream broke ({error.strerror})"

    def _as_annex_b(self, packets: Iterator[Packet]) -> Iterator[Packet]:
        from av.bitstream import BitStreamFilterContext
        from av.error import FFmpegError

        if self._codec not in _TO_ANNEX_B:
            yield from packets
            return
        rewrite = BitStreamFilterContext(_TO_ANNEX_B[self._codec], self._stream)
        for packet in packets:
            if not packet.size:
                continue
            try:
                yield from rewrite.filter(packet)
            except FFmpegError:
                self.damaged += 1

    def _shots(self) -> Iterator[CapturedFrame]:
        is_broken, has_begun = False, self.needs_decoding
        if self._is_rtp:
            self._sets = self._stream.codec_context.extradata or b""
            units = joined_units(self._packets(), self._arrived_ns)
        else:
            # Of these packets need not be whole pictures: FFmpeg's parser cuts them.
            is_cut = bool(self._formats & {"mpegts", "mpeg"})
            packets = self._as_annex_b(self._packets())
            units = whole_units(packets, self._arrived_ns, is_cut=is_cut)
        for unit in units:
            data, stands_alone = unit.data, unit.is_key
            if self._codec == "mjpeg":
                if is_whole(data):
                    yield self._shot(unit, data)
                else:
                    self.damaged += 1
                continue
            if self._codec in _TO_ANNEX_B:
                stands_alone, sets = head_of(data, self._format)
                if sets:
                    self._sets = sets
                elif stands_alone:  # a random access point carries its parameter sets
                    data = self._sets + data
            if not has_begun and not stands_alone:
                continue
            is_damaged = unit.is_corrupt or self._is_damaged(unit.ticks)
            is_broken = is_damaged or (is_broken and not stands_alone)
            if is_broken:
                self.damaged += 1
                continue
            has_begun = True
            # Where it can begin, the decoder of a codec that is decoded here alone knows.
            alone = stands_alone or (self.needs_decoding and self._is_rtp)
            yield self._shot(unit, data, stands_alone=alone)

    def _shot(self, unit: Unit, data: bytes, *, stands_alone: bool = True) -> CapturedFrame:
        base = self._stream.time_base if self._has_times else None
        told_ns = None if base is None or unit.ticks is None else round(unit.ticks * base * 10**9)
        return CapturedFrame(Frame(unit.arrived_ns, self._format, data), told_ns, stands_alone)


# ---- Containers (MPEG-TS, MP4, Matroska, FLV, ...) and bare streams (H.264, JPEG)

_OPTIONS = {
    "analyzeduration": "1000000",  # [us]; FLV would be read for 5 s before its first picture
    "max_pixels": str(MAX_PIXELS),
    "protocol_whitelist": "",
}


class ContainerStream(PacketStream):
    """The video in a byte stream, demuxed by FFmpeg, which opens nothing itself."""

    def __init__(self, feed: TimedFeed, kind: str, shown: str, *, live: bool) -> None:
        self._bytes = _Bytes(feed, kind)
        super().__init__(
            _opened(self._bytes, kind),
            shown,
            feed.timeout_s,
            arrived_ns=lambda packet: wall_ns(feed.arrived_ns(packet.pos)),
        )
        # Pictures of formats without times are stamped as they come, even from a file.
        self.live = live or kind in ("h264", "hevc", "mjpeg")
        self.returns = self.live
        self._feed = feed
        self._shown = shown  # where the bytes come from, for errors

    def close(self) -> None:
        """End a running `frames`, which closes the feed."""
        self._feed.deadline.break_off()
        super().close()

    def _shots(self) -> Iterator[CapturedFrame]:
        self._feed.got_picture()
        for shot in super()._shots():
            self._feed.got_picture()
            if self.live:
                yield shot
            elif shot.source_stamp_ns is not None:
                frame = replace(shot.frame, stamp_ns=shot.source_stamp_ns)
                yield CapturedFrame(frame, None, shot.stands_alone)
        broken = self._bytes.broken
        if isinstance(broken, CameraError):
            with answering(self._shown, self._feed.deadline):
                raise broken
        if broken is not None:
            self.ended = self._feed.why_broken(broken)
        elif not self.live:
            self.ended = ""

    def _release(self) -> None:
        super()._release()
        self._feed.close()


class _Bytes:
    """A feed as FFmpeg's input: a broken feed ends, and what came before is kept.

    An exception would be lost on its way through FFmpeg, or printed.
    """

    def __init__(self, feed: TimedFeed, kind: str) -> None:
        self.broken: OSError | CameraError | None = None  # the error that ended it
        self._feed = feed
        self._claims = Mp4Claims() if kind == "mov" else None

    def read(self, most: int) -> bytes:
        """See `ByteFeed`."""
        if self.broken is not None:
            return b""
        try:
            data = self._feed.read(most)
            if self._claims is not None:
                self._claims.check(data)
        except (OSError, CameraError) as error:
            self.broken = error
        except LogError as error:
            self.broken = CameraError(str(error))
        else:
            return data
        return b""


def _opened(feed: _Bytes, kind: str) -> InputContainer:
    import av
    from av import logging
    from av.error import FFmpegError

    logging.set_level(None)  # its lines would stand beside ours
    try:
        return av.open(feed, "r", format=kind, options=_OPTIONS, io_open=_refuse)
    except (FFmpegError, ValueError) as error:
        if feed.broken is not None:
            raise feed.broken from error
        why = getattr(error, "strerror", None) or type(error).__name__
        raise CameraError(
            f"begins like {kind} and cannot be read as such ({why}); is it a video's address?"
        ) from error


def _refuse(*_words: object) -> NoReturn:
    """Refuse to open what a container names, be it a file of this machine or another host."""
    raise CameraError("names other files or hosts; only what it holds itself is recorded")


# ---- Multipart: split the stream into parts, tolerating sloppy senders

# In a delimiter: RFC 2046 has two dashes and 70 characters; some senders repeat the dashes.
_MAX_DASHES, _MAX_TOKEN = 70, 70
_TAIL_BYTES = 512  # longer than any delimiter with its blanks: so much of what was searched is kept

# What a boundary may contain (RFC 2046), without the blank.
_TOKEN = (string.ascii_letters + string.digits + "'()+_,./:=?-").encode()

_ENDS = (b" ", b"\t", b"\r", b"\n")
_JPEG_END = b"\xff\xd9"

# Headers in which servers report a picture's time [s]; capture first, then sending.
_TIMES = (
    b"x-ustreamer-grab-begin-time",
    b"x-ustreamer-grab-time",
    b"x-ustreamer-grab-timestamp",
    b"x-timestamp",
    b"timestamp",
)


class Part(NamedTuple):
    """One part of the stream."""

    arrived_ns: int  # monotonic time at which its first byte arrived
    data: bytes
    source_stamp_ns: int | None = None  # the time in its headers, of an unknown clock


class MultipartParser:
    """Splits a byte stream into parts.

    A part ends after its Content-Length where it states one, else at the next delimiter. Senders
    differ in whether the boundary they announce has its two leading dashes already: both are
    accepted, and so is a stream that announces none ("").
    """

    def __init__(
        self, read: Callable[[int], bytes], boundary: str, clock_ns: Callable[[], int]
    ) -> None:
        self._token = boundary.lstrip("-").encode("latin-1", "replace")
        self._mark = b"--" + self._token
        self._read = read  # up to so many bytes, as soon as there are any; b"" at the end
        self._clock_ns = clock_ns  # monotonic time
        self._buffer = bytearray()
        self._arrived_ns = 0
        self._at_end = False
        self.is_closed = False  # whether the last delimiter ended the stream

    def parts(self) -> Iterator[Part]:
        """Yield the parts in order; one that is cut short is delivered as it is."""
        while self._skip_delimiter():
            headers = self._headers()
            if not self._buffer and not self._fill():
                return
            arrived_ns = self._arrived_ns
            text = headers.get(b"content-length", b"")
            stated = int(text[:18]) if text.isdigit() else 0
            has_length = 0 < stated <= MAX_PICTURE_BYTES
            data = self._take(stated) if has_length else self._until_delimiter()
            # A time to fractions of a second: whole seconds are no help.
            seconds = re.compile(rb"(\d{1,11})\.(\d{1,9})\d*")
            told = (seconds.fullmatch(headers.get(name, b"")) for name in _TIMES)
            stamps_ns = (int(one[1]) * 10**9 + int(one[2].ljust(9, b"0")) for one in told if one)
            yield Part(arrived_ns, data, next(stamps_ns, None))

    def _fill(self) -> bool:
        data = b"" if self._at_end else self._read(256 * 1024)  # a few pictures
        self._arrived_ns = self._clock_ns()
        self._at_end = not data
        self._buffer += data
        return bool(data)

    def _skip_delimiter(self) -> bool:
        """Skip past the next whole delimiter line; False at the end of the stream."""
        skipped = looked = 0
        while True:
            while (at := self._buffer.find(b"\n", looked)) >= 0:
                looked = at + 1
                line = bytes(self._buffer[max(0, at - _TAIL_BYTES) : at])
                line = line.removesuffix(b"\r").rstrip(b" \t")
                if self._token:
                    is_delimiter = line.endswith((self._mark, self._mark + b"--"))
                else:  # a run of token characters that ends with dashes and a token
                    run = line[len(line.rstrip(_TOKEN)) :][-_MAX_DASHES - _MAX_TOKEN :]
                    is_delimiter = 0 <= run.find(b"--") < len(run) - 2
                if is_delimiter:
                    del self._buffer[:looked]
                    self.is_closed = bool(self._token) and not line.endswith(self._mark)
                    return not self.is_closed
            surplus = max(0, len(self._buffer) - _TAIL_BYTES)
            del self._buffer[:surplus]
            looked = len(self._buffer)
            skipped += surplus
            if max(skipped, looked) > MAX_PICTURE_BYTES:
                raise CameraError("sends no part of a multipart stream; is it a camera's stream?")
            if not self._fill():
                return False

    def _headers(self) -> dict[bytes, bytes]:
        """Read a part's headers, by their names in lower case."""
        headers: dict[bytes, bytes] = {}
        left = 16 * 1024  # [bytes]; a camera sends about 100
        while True:
            while (end := self._buffer.find(b"\n")) < 0 and len(self._buffer) <= 16 * 1024:
                if not self._fill():
                    return headers
            left -= max(end, 0)
            if end < 0 or left < 0:
                raise CameraError("sends a part whose headers have no end")
            line = bytes(self._buffer[:end]).strip()
            del self._buffer[: end + 1]
            if not line:
                return headers
            name, _, value = line.partition(b":")
            headers[name.strip().lower()] = value.strip()

    def _take(self, length: int) -> bytes:
        while len(self._buffer) < length and self._fill():
            pass
        body = bytes(self._buffer[:length])
        if not body.rstrip(b"\0 \t\r\n").endswith(_JPEG_END):  # less came than was stated?
            cut, _ = self._end_of_body(body, 0, is_all=True)
            body = body[:cut]
        del self._buffer[: len(body)]
        return body

    def _until_delimiter(self) -> bytes:
        looked = 0
        while True:
            end, looked = self._end_of_body(self._buffer, looked, is_all=self._at_end)
            if end is not None or self._at_end:
                break
            if len(self._buffer) > MAX_PICTURE_BYTES:
                raise CameraError(f"sends a part of more than {MAX_PICTURE_BYTES} bytes")
            self._fill()
        body = bytes(self._buffer[:end])
        del self._buffer[: len(body)]
        return body.removesuffix(b"\r\n") if end is None else body

    def _end_of_body(
        self, buffer: bytearray | bytes, start: int, *, is_all: bool
    ) -> tuple[int | None, int]:
        """Find the end of the first body from `start` on; also where to resume.

        With a token, the end lies before the line break of a delimiter. Without one a picture may
        hold what looks like a delimiter, so one counts only after the end of a JPEG. `is_all` says
        that nothing more comes. One pass: a regular expression may backtrack over hostile bytes
        with the whole process waiting.
        """
        mark = self._mark if self._token else _JPEG_END
        while (at := buffer.find(mark, start)) >= 0:
            end = at + len(mark)
            behind = bytes(buffer[end : end + _TAIL_BYTES])
            found = _ends_line(behind) if self._token else _leads_to_any(behind)
            if found is None and not is_all and len(behind) < _TAIL_BYTES:
                return None, at
            if found and not self._token:
                return end, end
            if found:  # the line break before the delimiter's dashes
                head = bytes(buffer[max(0, at - _MAX_DASHES - 2) : at])
                before = head.rstrip(b"-")
                if before.endswith(b"\n"):
                    cut = at - len(head) + len(before.removesuffix(b"\n").removesuffix(b"\r"))
                    return cut, cut
            start = at + 1
        return None, max(start, len(buffer) - len(mark) + 1)


def _ends_line(behind: bytes) -> bool | None:
    """Return whether a delimiter ends here; None where more bytes are needed."""
    rest = behind.removeprefix(b"--")
    return None if rest in (b"", b"-") else rest[:1] in _ENDS


def _leads_to_any(behind: bytes) -> bool | None:
    """Return whether blanks and any delimiter follow; None as in `_ends_line`."""
    rest = behind.lstrip(b" \t\r\n\f\v\0")
    run = len(rest) - len(rest.lstrip(_TOKEN))
    if run == len(rest):
        return None if b"--".startswith(rest[:2]) and run <= _MAX_DASHES + _MAX_TOKEN else False
    is_delimiter = rest.startswith(b"--") and 2 < run <= _MAX_DASHES + _MAX_TOKEN
    return is_delimiter and rest[run : run + 1] in _ENDS


# ---- Reported times: whether those that a server sends come from a clock


class ToldTimes:
    """A filter that passes reported timestamps until they prove not to be a clock's."""

    def __init__(self) -> None:
        self.is_trusted = True  # whether they may still be a clock's
        self._first: tuple[int, int] | None = None
        self._latest_ns = 0
        self._count = self._faults = 0

    def taken_ns(self, source_stamp_ns: int | None, arrived_ns: int) -> int | None:
        """Return a picture's reported time [ns]; None where it is not to be trusted."""
        if source_stamp_ns is None or not self.is_trusted:
            return None
        if self._first is None:
            self._first = source_stamp_ns, arrived_ns
            self._latest_ns = source_stamp_ns
            return source_stamp_ns
        self._count += 1
        latest_ns, self._latest_ns = self._latest_ns, source_stamp_ns
        if source_stamp_ns <= latest_ns:
            self._faults += 1
            self._first = source_stamp_ns, arrived_ns
            # A clock that is set goes back once; what is no clock does so often.
            self.is_trusted = self._faults <= 2 + 0.01 * self._count
            return None
        since = source_stamp_ns - self._first[0], arrived_ns - self._first[1]
        shortest_ns, longest_ns = sorted(since)
        # Jitter and bursts are shorter than a second; no clock is wrong by half, another unit is.
        self.is_trusted = longest_ns < 1_000_000_000 or longest_ns < 2.0 * shortest_ns
        return source_stamp_ns if self.is_trusted else None


# ---- MJPEG (multipart/x-mixed-replace), as most cheap cameras send it


class MjpegStream(BaseSource):
    """An MJPEG stream; its JPEGs are kept byte for byte.

    A frame's reported time is that of its part's headers, where those are a clock's.
    """

    def __init__(self, feed: TimedFeed, shown: str, boundary: str = "") -> None:
        super().__init__(f"camera {shown}")
        self._shown = shown
        self._feed = feed
        self._parser = MultipartParser(feed.read, boundary, feed.arrived_ns)
        self._told = ToldTimes()

    def notes(self) -> dict[str, str]:
        """Return a note where the reported times were left out."""
        return {} if self._told.is_trusted else {"told_times": "left out: they are no clock's"}

    def close(self) -> None:
        """End a running `frames`, which closes the connection."""
        self._feed.deadline.break_off()
        super().close()

    def _shots(self) -> Iterator[CapturedFrame]:
        self._feed.got_picture()
        try:
            for part in self._parser.parts():
                if is_whole(part.data):
                    told_ns = self._told.taken_ns(part.source_stamp_ns, part.arrived_ns)
                    yield CapturedFrame(Frame(wall_ns(part.arrived_ns), "jpeg", part.data), told_ns)
                    self._feed.got_picture()
                else:
                    self.damaged += 1
            self.returns = not self._parser.is_closed
            self.ended = "the stream was closed by the camera"
        except OSError as error:
            self.ended = self._feed.why_broken(error)
        except CameraError as error:
            raise CameraError(f"{self._shown}: {error}") from error

    def _release(self) -> None:
        self._feed.close()


# ---- Opening: by the format that the first bytes reveal


def stream_of(feed: TimedFeed, shown: str, *, live: bool) -> Source:
    """Open the source that a feed's first bytes call for."""
    with closed_on_failure(feed), answering(shown, feed.deadline):
        kind = feed.format()
        if kind == MULTIPART:
            return MjpegStream(feed, shown)
        return ContainerStream(feed, kind, shown, live=live)
