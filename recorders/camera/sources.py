"""Open the camera or video file that the user names.

The address's scheme, or the kind of a name without one, selects the opener. Video sent as plain
bytes, by TCP, UDP, a FIFO or standard input, is opened here; HTTP, RTSP and devices next door.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType

from tunenet_logs.addresses import scheme_of
from tunenet_logs.console import options_in
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.camera.base import Source
from tunenet_logs.recorders.camera.device import SETTINGS, CameraDevice, VideoFile, opened_within
from tunenet_logs.recorders.camera.feeds import ByteFeed, PipeFeed, TcpFeed, TimedFeed, UdpFeed
from tunenet_logs.recorders.camera.network import (
    Deadline,
    NetworkOptions,
    answering,
    camera_address,
    longest_begin_s,
    with_scheme,
)
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.reading import Transcoded
from tunenet_logs.recorders.camera.streams import PacketStream, stream_of


def open_source(
    text: str, asked: CameraOptions | None = None, network: NetworkOptions | None = None
) -> Source:
    """Open a camera or a video file, which may be silent for `asked.stall_s`."""
    asked, network = asked or CameraOptions(), network or NetworkOptions()
    text = with_scheme(text)
    kind = _kind_of(text)
    if kind in _BY_OTHERS:
        raise UsageError(
            f"--camera: {kind} is not read here; let a program that does write it to standard "
            f"input: {_BY_OTHERS[kind]} | tunenet-record --camera -"
        )
    if kind not in OPENERS:
        known = ", ".join(name for name in OPENERS if name.isalpha())
        raise UsageError(
            f"--camera: {kind}:// is not recorded; there is {known}, and files by their bare names"
        )
    for name in SETTINGS:
        if kind != "a device" and getattr(asked, name) is not None:
            flag = options_in(CameraOptions)[name].flag_of(name)
            raise UsageError(f"{flag} is for a camera that is plugged in; leave it out")
    if kind != "a file" and asked.fps is not None:
        raise UsageError("--fps is for a video file; a camera's rate is measured")
    if kind in ("a device", "a file") and asked.transcode:
        raise UsageError("--transcode is for a camera that sends video; leave it out")
    network.check(kind)
    return OPENERS[kind](text, asked, network)


def is_asked_again(text: str) -> bool:
    """Return whether a source is a network camera that can be reconnected."""
    return _kind_of(with_scheme(text)) in _ASKED_AGAIN


def is_file(text: str) -> bool:
    """Return whether a source is a file rather than a live camera."""
    return _kind_of(with_scheme(text)) == "a file"


def shows_password(text: str) -> bool:
    """Return whether a camera's address contains a password."""
    return is_asked_again(text) and bool(camera_address(with_scheme(text)).password)


def _kind_of(text: str) -> str:
    """Return the scheme of an address, else the kind of source."""
    if scheme := scheme_of(text):
        return scheme
    if _is_number(text) or text.startswith("/dev/"):
        return "a device"
    return "a pipe" if text == "-" or Path(text).is_fifo() else "a file"


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) < 5


def _device(text: str, asked: CameraOptions, _network: NetworkOptions) -> Source:
    path = Path(f"/dev/video{int(text)}" if _is_number(text) else text)
    # Drivers try for seconds, at each setting too.
    return opened_within(30.0, str(path), lambda: CameraDevice(path, asked))


def _http(text: str, asked: CameraOptions, network: NetworkOptions) -> Source:
    from tunenet_logs.recorders.camera.http import open_http

    address = network.known(camera_address(text))
    return _opened(
        address.shown,
        asked,
        lambda: open_http(address, asked.stall_s, network.trust),
        longest_begin_s(asked.stall_s),  # of what has no parts, the first bytes tell what it is
    )


def _rtsp(text: str, asked: CameraOptions, network: NetworkOptions) -> Source:
    from tunenet_logs.recorders.camera.rtsp import RtspStream

    address = network.known(camera_address(text))
    return _opened(
        address.shown,
        asked,
        lambda: RtspStream(address, asked.stall_s, network.trust, network.rtsp_transport),
        2 * asked.stall_s,  # to learn what the stream holds
    )


def _bytes(text: str, asked: CameraOptions, _network: NetworkOptions) -> Source:
    begin_s = longest_begin_s(asked.stall_s)

    def opened() -> Source:
        deadline = Deadline.opening()
        shown, live, scheme = text, True, scheme_of(text)
        feed: ByteFeed
        if scheme == "tcp":
            address = camera_address(text)
            shown = address.shown
            with answering(shown, deadline):
                feed = TcpFeed(address, deadline)
        elif scheme == "udp":
            feed = UdpFeed(text, deadline)
        else:
            feed = pipe = PipeFeed(text, deadline)
            shown, live = pipe.shown, pipe.is_written_to
        deadline.await_pictures(begin_s)  # the program that sends may have to start
        source = stream_of(TimedFeed(feed, deadline, asked.stall_s), shown, live=live)
        deadline.silence_s = asked.stall_s
        return source

    return _opened(text, asked, opened, begin_s)


def _opened(
    shown: str, asked: CameraOptions, opening: Callable[[], Source], more_s: float
) -> Source:
    """Open a network or piped source, transcoded where asked, or where no log holds its codec."""

    def opened() -> Source:
        source = opening()
        if isinstance(source, PacketStream) and (asked.transcode or source.needs_decoding):
            return Transcoded(source)
        return source

    # 5 s more are for name servers, and for the source's own, clearer error.
    longest_s = Deadline.opening().whole_s + more_s + 5.0
    return opened_within(longest_s, shown, opened)


# By an address's scheme, or by the kind of what has none.
OPENERS: Mapping[str, Callable[[str, CameraOptions, NetworkOptions], Source]] = MappingProxyType(
    {
        "a device": _device,
        "a file": lambda text, asked, _network: VideoFile(Path(text), asked.fps),
        "a pipe": _bytes,
        "http": _http,
        "https": _http,
        "rtsp": _rtsp,
        "rtsps": _rtsp,
        "tcp": _bytes,
        "udp": _bytes,
    }
)

_ASKED_AGAIN = frozenset({"http", "https", "rtsp", "rtsps", "tcp"})  # that can be reconnected

_FFMPEG = "ffmpeg -loglevel error -i {}://... -c copy -f matroska -"

# By a scheme that is not read here: the command that reads it instead. Without its jitter buffer
# GStreamer stamps what comes by RTP when it came, not when it was taken.
_BY_OTHERS: Mapping[str, str] = MappingProxyType(
    {
        "srt": "gst-launch-1.0 -q srtsrc uri=srt://... ! fdsink",
        "rtp": "gst-launch-1.0 -q udpsrc port=5004 "
        "caps=application/x-rtp,media=video,encoding-name=H264,clock-rate=90000 ! "
        "rtpjitterbuffer ! rtph264depay ! h264parse ! matroskamux streamable=true ! fdsink",
        "rtmp": _FFMPEG.format("rtmp"),
        "rtmps": _FFMPEG.format("rtmps"),
    }
)
