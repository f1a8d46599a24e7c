"""Open the camera or video file that the user names.

The address's scheme, or the kind of a name without one, selects the opener. Video sent as plain
bytes, by TCP, UDP, a FIFO or standard input, is opened here; HTTP, RTSP and devices next door.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from tunenet_logs.addresses import scheme_of
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.camera.base import Source
from tunenet_logs.recorders.camera.device import CameraDevice, Settings, VideoFile, opened_within
from tunenet_logs.recorders.camera.feeds import ByteFeed, PipeFeed, TcpFeed, TimedFeed, UdpFeed
from tunenet_logs.recorders.camera.network import (
    OPENING_S,
    Deadline,
    NetworkOptions,
    answering,
    camera_address,
    with_scheme,
)
from tunenet_logs.recorders.camera.reading import Transcoded
from tunenet_logs.recorders.camera.streams import PacketStream, stream_of

# By a setting's name, the option that asks for it: an error names what the user wrote.
_SETTING_OPTIONS = {
    "size": "--size",
    "rate_hz": "--rate",
    "exposure_ms": "--exposure",
    "white_balance_k": "--white-balance",
    "focus": "--focus",
}

# Beyond what opening a network camera allows: for name servers, and for its own, clearer error.
_SPARE_S = 5.0


@dataclass(frozen=True)
class SourceOptions:
    """Options of a source; see `open_source`."""

    settings: Settings
    filmed_hz: float | None
    timeout_s: float
    network: NetworkOptions
    transcode: bool


def open_source(
    text: str,
    *,
    settings: Settings | None = None,
    filmed_hz: float | None = None,
    timeout_s: float = 5.0,
    network: NetworkOptions | None = None,
    transcode: bool = False,
) -> Source:
    """Open a camera or a video file."""
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
    wishes = SourceOptions(
        settings or Settings(), filmed_hz, timeout_s, network or NetworkOptions(), transcode
    )
    if kind != "a device" and wishes.settings.asked():
        option = _SETTING_OPTIONS[wishes.settings.asked()[0]]
        raise UsageError(f"{option} is for a camera that is plugged in; leave it out")
    if kind != "a file" and wishes.filmed_hz is not None:
        raise UsageError("--fps is for a video file; a camera's rate is measured")
    if kind in ("a device", "a file") and wishes.transcode:
        raise UsageError("--transcode is for a camera that sends video; leave it out")
    wishes.network.check(kind)
    return OPENERS[kind](text, wishes)


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


def _device(text: str, wishes: SourceOptions) -> Source:
    path = Path(f"/dev/video{int(text)}" if _is_number(text) else text)
    # Drivers try for seconds, at each setting too.
    return opened_within(30.0, str(path), lambda: CameraDevice(path, wishes.settings))


def _http(text: str, wishes: SourceOptions) -> Source:
    from tunenet_logs.recorders.camera.http import open_http

    address = wishes.network.known(camera_address(text))
    return _opened(
        address.shown, wishes, lambda: open_http(address, wishes.timeout_s, wishes.network.trust)
    )


def _rtsp(text: str, wishes: SourceOptions) -> Source:
    from tunenet_logs.recorders.camera.rtsp import RtspStream

    timeout_s, network = wishes.timeout_s, wishes.network
    address = network.known(camera_address(text))
    return _opened(
        address.shown,
        wishes,
        lambda: RtspStream(address, timeout_s, network.trust, network.rtsp_transport),
        2 * timeout_s,  # to learn what the stream holds
    )


def _bytes(text: str, wishes: SourceOptions) -> Source:
    def opened() -> Source:
        # The program that sends the first picture may have to start.
        longest_s = max(OPENING_S, wishes.timeout_s)
        deadline = Deadline(longest_s, longest_s)
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
        source = stream_of(TimedFeed(feed, deadline, wishes.timeout_s), shown, live=live)
        deadline.silence_s = wishes.timeout_s
        return source

    return _opened(text, wishes, opened)


def _opened(
    shown: str, wishes: SourceOptions, opening: Callable[[], Source], more_s: float = 0.0
) -> Source:
    """Open a network or piped source, transcoded where asked, or where no log holds its codec."""

    def opened() -> Source:
        source = opening()
        if isinstance(source, PacketStream) and (wishes.transcode or source.needs_decoding):
            return Transcoded(source)
        return source

    longest_s = max(OPENING_S, wishes.timeout_s) + more_s + _SPARE_S
    return opened_within(longest_s, shown, opened)


# By an address's scheme, or by the kind of what has none.
OPENERS: Mapping[str, Callable[[str, SourceOptions], Source]] = MappingProxyType(
    {
        "a device": _device,
        "a file": lambda text, wishes: VideoFile(Path(text), wishes.filmed_hz),
        "a pipe": _bytes,
        "http": _http,
        "https": _http,
        "rtsp": _rtsp,
        "rtsps": _rtsp,
        "tcp": _bytes,
        "udp": _bytes,
    }
)

# Of these, those that can be reconnected.
_ASKED_AGAIN = frozenset({"http", "https", "rtsp", "rtsps", "tcp"})

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
