"""What comes out of a container that FFmpeg opened: pictures as the camera compressed them."""

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

KEPT = {"h264": "h264", "hevc": "h265", "vp9": "vp9", "av1": "av1"}
"""From FFmpeg's codec to the format that a log's messages of video have."""

_TO_ANNEX_B = {"h264": "h264_mp4toannexb", "hevc": "hevc_mp4toannexb"}
"""By codec, what rewrites packets of MP4, Matroska and their like; it leaves others as they are."""

_PLAYS_RTP = frozenset({"rtsp", "rtp", "sdp"})
"""Containers whose packets are pieces of pictures, each with the time that RTP gives it."""

_CUT_ANYHOW = frozenset({"mpegts", "mpeg"})
"""Containers whose packets need not be pictures: FFmpeg's parser cuts them."""

NOT_PARSED = {"fflags": "noparse+nofillin"}
"""With which containers of `_PLAYS_RTP` are to be opened."""


class PacketStream:
    """The video of an opened container, as it comes; nothing is decoded.

    H.264 and H.265 become pictures of Annex B that carry their parameter sets wherever a decoder
    can begin, VP9 and AV1 stay as they are, and so do JPEGs. What comes before the first picture
    that stands alone is none. A frame of any other codec has its name for an encoding, and
    `needs_decoding` is true: see `recorders.camera.transcoded`.

    FFmpeg hands over what is left of a picture as if it were whole, and decoders make something of
    it that looks like one. So where a loss is known, the picture is left out and counted as
    damaged, and so are those made from it.

    Args:
        container: opened, with a time-out; closed here. One that plays RTP with `NOT_PARSED`.
        shown: the camera, as it may be shown to anybody.
        timeout_s: the longest silence that it was opened with.
        is_damaged: whether something was lost of a picture or just before it, by its time in the
            stream's own units, of RTP from 0 for the first; asked in order.
        arrived_ns: when a packet's first byte was here; the default is when FFmpeg gives it.

    Attributes:
        returns: not once a film is over, which has a length; a live camera has none.
        needs_decoding: whether no log can hold what this camera compressed.

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
        """The codec."""
        return {"codec": self._codec}

    def decoder(self) -> VideoCodecContext:
        """A decoder that knows what the container says of the stream as a whole."""
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
        """The pictures as they come, until the camera ends the stream or falls silent."""
        self._reading = True
        try:
            for unit in self._units():
                if self._closed:
                    return
                yield from self._shots(unit)
        finally:
            self._container.close()

    def close(self) -> None:
        """End running `frames` with the next packet; the connection is closed there."""
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
        """Until the stream ends, breaks, or is silent for too long."""
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
        """A picture with all that a decoder needs to begin with it, and whether one can."""
        stands_alone, sets = head_of(data, self._format)
        if sets:
            self._sets = sets
        elif stands_alone:
            data = self._sets + data
        return data, stands_alone

    def _told_ns(self, ticks: int | None) -> int | None:
        base = self._stream.time_base if self._has_times else None
        return None if base is None or ticks is None else round(ticks * base * 10**9)
