"""Read a container opened by FFmpeg: pictures as the camera compressed them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from recorders.camera.access_units import Unit, joined_units, whole_units
from recorders.camera.annex_b import head_of
from recorders.camera.base import Shot
from tunenet_logs.clock import now_ns
from tunenet_logs.episode import Frame
from tunenet_logs.errors import CameraError
from tunenet_logs.images import MAX_PIXELS
from tunenet_logs.jpeg import is_whole

if TYPE_CHECKING:
    from av import Packet, VideoCodecContext
    from av.container import InputContainer

# From FFmpeg's codec to the format that a log's messages of video have.
KEPT = {"h264": "h264", "hevc": "h265", "vp9": "vp9", "av1": "av1"}

# By codec, what rewrites packets of MP4, Matroska and their like; it leaves others as they are.
_TO_ANNEX_B = {"h264": "h264_mp4toannexb", "hevc": "hevc_mp4toannexb"}

# Containers whose packets are pieces of pictures, each with the time that RTP gives it.
_PLAYS_RTP = frozenset({"rtsp", "rtp", "sdp"})

# Containers whose packets need not be pictures: FFmpeg's parser cuts them.
_CUT_ANYHOW = frozenset({"mpegts", "mpeg"})

# With which containers of `_PLAYS_RTP` are to be opened.
NOT_PARSED = {"fflags": "noparse+nofillin"}


class PacketStream:
    """The video of an open container as it comes; nothing is decoded.

    H.264 and H.265 become Annex B pictures that carry their parameter sets at every random access
    point; VP9, AV1 and JPEGs stay as they are. What precedes the first picture that stands alone is
    skipped. A frame of any other codec has the codec's name for an encoding, and `needs_decoding`
    is true: see `recorders.camera.transcoded`.

    FFmpeg returns the rest of a damaged picture as if it were whole, and decoders make something of
    it that looks like one. So where a loss is known, the picture is left out and counted as
    damaged, and so are those predicted from it.

    Args:
        container: opened, with a time-out; closed here. For RTP it is opened with `NOT_PARSED`.
        shown: the camera's public name.
        timeout_s: the longest silence that it was opened with.
        is_damaged: whether packets were lost in a picture or just before it, by its time in the
            stream's time base (of RTP from 0 for the first); called in order.
        arrived_ns: when a packet's first byte arrived; by default when FFmpeg returns it.

    Attributes:
        returns: False once a video file is over, which has a duration; a live camera has none.
        needs_decoding: whether the log cannot hold this codec.

    Raises:
        CameraError: it holds no video.
    """

    live = True
    dropped = 0

    def __init__(
        self,
        container: InputContainer,
        shown: str,
        timeout_s: float,
        *,
        is_damaged: Callable[[int | None], bool] | None = None,
        arrived_ns: Callable[[Packet], int] = lambda _packet: now_ns(),
    ) -> None:
        from av.format import Flags

        if not container.streams.video:
            container.close()
            raise CameraError(f"{shown}: holds no video; give the address of its video")
        self.name = f"camera {shown}"
        self.ended = ""
        self.returns = True
        self.damaged = 0
        self._container = container
        self._stream = container.streams.video[0]
        self._codec = self._stream.codec_context.name
        self._format = KEPT.get(self._codec, self._codec)
        self._formats = frozenset(container.format.name.split(","))
        self._is_rtp = bool(self._formats & _PLAYS_RTP)
        self.needs_decoding = self._codec not in KEPT and self._codec != "mjpeg"
        self._has_times = not container.format.flags & Flags.no_timestamps.value
        self._sets = b""
        self._began = False
        self._is_damaged = is_damaged
        self._is_broken = False
        self._timeout_s = timeout_s
        self._arrived_ns = arrived_ns
        self._closed = False
        self._reading = False

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

    def frames(self) -> Iterator[Shot]:
        """Yield the pictures as they come, until the stream ends or falls silent."""
        self._reading = True
        try:
            for unit in self._units():
                if self._closed:
                    return
                yield from self._shots(unit)
        finally:
            self._container.close()

    def close(self) -> None:
        """End a running `frames` with the next packet; it closes the connection."""
        self._closed = True
        if not self._reading:
            self._container.close()

    def _units(self) -> Iterator[Unit]:
        if self._is_rtp:
            self._sets = self._stream.codec_context.extradata or b""
            return joined_units(self._packets(), self._arrived_ns)
        packets = self._packets()
        if self._codec in _TO_ANNEX_B:
            packets = self._as_annex_b(packets)
        is_cut = not self._formats.isdisjoint(_CUT_ANYHOW)
        return whole_units(packets, self._arrived_ns, is_cut=is_cut)

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

        rewrite = BitStreamFilterContext(_TO_ANNEX_B[self._codec], self._stream)
        for packet in packets:
            if not packet.size:
                continue
            try:
                yield from rewrite.filter(packet)
            except FFmpegError:
                self.damaged += 1

    def _shots(self, unit: Unit) -> Iterator[Shot]:
        data, stands_alone = unit.data, unit.is_key
        if self._codec == "mjpeg":
            if is_whole(data):
                yield Shot(Frame(unit.arrived_ns, "jpeg", data), self._told_ns(unit.ticks))
            else:
                self.damaged += 1
            return
        if self._codec in _TO_ANNEX_B:
            data, stands_alone = self._with_sets(data)
        if not self._began and not stands_alone and not self.needs_decoding:
            return
        is_damaged = unit.is_corrupt or bool(self._is_damaged and self._is_damaged(unit.ticks))
        self._is_broken = is_damaged or (self._is_broken and not stands_alone)
        if self._is_broken:
            self.damaged += 1
            return
        self._began = True
        if self.needs_decoding and self._is_rtp:  # where it can begin, its decoder alone knows
            stands_alone = True
        frame = Frame(unit.arrived_ns, self._format, data)
        yield Shot(frame, self._told_ns(unit.ticks), stands_alone)

    def _with_sets(self, data: bytes) -> tuple[bytes, bool]:
        """Add parameter sets to a random access point that lacks them; return whether it is one."""
        stands_alone, sets = head_of(data, self._format)
        if sets:
            self._sets = sets
        elif stands_alone:
            data = self._sets + data
        return data, stands_alone

    def _told_ns(self, ticks: int | None) -> int | None:
        base = self._stream.time_base if self._has_times else None
        return None if base is None or ticks is None else round(ticks * base * 10**9)
