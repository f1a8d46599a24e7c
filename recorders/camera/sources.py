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
from tunenet_logs.recorders.camera.feeds import (
    ByteFeed,
    PipeFeed,
    TcpFeed,
    TimedFeed,
    UdpFeed,
    opened_pipe,
)
from tunenet_logs.recorders.camera.network import (
    OPENING_S,
    Deadline,
    NetworkOptions,
    answering,
    camera_address,
    with_scheme,
)
from tunenet_logs.recorders.camera.reading import as_kept
from tunenet_logs.recorders.camera.streams import PacketStream, stream_of

# ---- Plain bytes: TCP, UDP, a FIFO or standard input


def open_tcp(text: str, timeout_s: float) -> Source:
    """Open a camera that streams to whoever connects to tcp://HOST:PORT.

    Raises:
        UsageError, CameraError: see `TcpFeed` and `stream_of`.
    """
    address, deadline = camera_address(text), _opening(timeout_s)
    with answering(address.shown, deadline):
        feed = TcpFeed(address, deadline)
    return _stream(feed, address.shown, deadline, timeout_s)


def open_udp(text: str, timeout_s: float) -> Source:
    """Open a stream sent to a UDP port of this machine.

    Raises:
        UsageError, CameraError: see `UdpFeed` and `stream_of`.
    """
    deadline = _opening(timeout_s)
    return _stream(UdpFeed(text, deadline), text, deadline, timeout_s)


def open_pipe(text: str, timeout_s: float) -> Source:
    """Open what a program writes to standard input or a FIFO, or a file redirected there.

    Raises:
        UsageError, CameraError: see `opened_pipe` and `stream_of`.
    """
    deadline = _opening(timeout_s)
    pipe = opened_pipe(text)
    feed = PipeFeed(pipe.descriptor, deadline)
    return _stream(feed, pipe.shown, deadline, timeout_s, live=pipe.is_written_to)


def _opening(timeout_s: float) -> Deadline:
    """Make the first picture's deadline: the program that sends it may have to start."""
    longest_s = max(OPENING_S, timeout_s)
    return Deadline(longest_s, longest_s)


def _stream(
    feed: ByteFeed, shown: str, deadline: Deadline, timeout_s: float, *, live: bool = True
) -> Source:
    source = stream_of(TimedFeed(feed, deadline, timeout_s), shown, live=live)
    deadline.silence_s = timeout_s
    return source


# ---- Opening by scheme, or by kind

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

_MAX_DEVICE_S = 30.0  # to open a plugged-in camera: drivers try for seconds, each setting too


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
    """Open a camera or a video file.

    Args:
        text: a device's number or /dev/... path, an address, "-" for standard input, a FIFO, or a
            file.
        settings: what to ask of a device.
        filmed_hz: rate at which a file was filmed, where its tags do not say so.
        timeout_s: the longest silence of a live camera.
        network: options of a network camera.
        transcode: whether pictures of a camera that sends video are to become JPEGs.

    Raises:
        UsageError: an option does not apply to this source, or an address is invalid.
        CameraError: it cannot be opened.
        LogError: a file that is no video.
    """
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
    _refuse_what_is_others(kind, wishes)
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


def _refuse_what_is_others(kind: str, wishes: SourceOptions) -> None:
    if kind != "a device" and wishes.settings.asked():
        option = _SETTING_OPTIONS[wishes.settings.asked()[0]]
        raise UsageError(f"{option} is for a camera that is plugged in; leave it out")
    if kind != "a file" and wishes.filmed_hz is not None:
        raise UsageError("--fps is for a video file; a camera's rate is measured")
    if kind in ("a device", "a file") and wishes.transcode:
        raise UsageError("--transcode is for a camera that sends video; leave it out")
    wishes.network.check(kind)


def _device(text: str, wishes: SourceOptions) -> Source:
    path = Path(f"/dev/video{int(text)}" if _is_number(text) else text)
    return opened_within(_MAX_DEVICE_S, str(path), lambda: CameraDevice(path, wishes.settings))


def _file(text: str, wishes: SourceOptions) -> Source:
    return VideoFile(Path(text), wishes.filmed_hz)


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
    opener = {"tcp": open_tcp, "udp": open_udp}.get(scheme_of(text), open_pipe)
    return _opened(text, wishes, lambda: opener(text, wishes.timeout_s))


def _opened(
    shown: str, wishes: SourceOptions, opening: Callable[[], Source], more_s: float = 0.0
) -> Source:
    """Open a network or piped source, transcoded where the log cannot hold its codec."""

    def opened() -> Source:
        source = opening()
        if isinstance(source, PacketStream):
            return as_kept(source, transcode=wishes.transcode)
        return source

    longest_s = max(OPENING_S, wishes.timeout_s) + more_s + _SPARE_S
    return opened_within(longest_s, shown, opened)


# By an address's scheme, or by the kind of what has none.
OPENERS: Mapping[str, Callable[[str, SourceOptions], Source]] = MappingProxyType(
    {
        "a device": _device,
        "a file": _file,
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
