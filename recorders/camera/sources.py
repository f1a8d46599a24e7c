"""From what the user names to the source that it is."""

from __future__ import annotations

import re
from pathlib import Path

from recorders.camera.base import Source
from recorders.camera.opening import opened_within
from recorders.camera.settings import Settings
from tunenet_logs.errors import UsageError

_OPTIONS = {
    "size": "--size",
    "rate_hz": "--rate",
    "exposure_ms": "--exposure",
    "white_balance_k": "--white-balance",
    "focus": "--focus",
}
"""By a setting's name, the option that asks for it: an error names what the user wrote."""

_SPARE_S = 5.0
"""Beyond what a camera's own reading allows: for name servers, and for its own, clearer error."""

_DEVICE_S = 30.0
"""For a plugged-in camera: drivers try some seconds long, and each setting may take its own."""

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
"""What an address begins with, by RFC 3986; a device or a file has none."""


def open_source(
    text: str,
    *,
    settings: Settings | None = None,
    filmed_hz: float | None = None,
    timeout_s: float = 5.0,
) -> Source:
    """Open a camera or a video.

    Args:
        text: a device's number or /dev/... path, an http, https or rtsp address, or a file.
        settings: what to ask of a device.
        filmed_hz: rate at which a file was filmed, where its tags do not say so.
        timeout_s: the longest silence of a network camera.

    Raises:
        UsageError: an option that is not for this source, or an address that is none.
        CameraError: it cannot be opened.
        LogError: a file that is no video.
    """
    settings = settings or Settings()
    scheme = found.group(1).lower() if (found := _SCHEME.match(text)) else ""
    is_number = text.isascii() and text.isdecimal() and len(text) < 5
    is_device = is_number or text.startswith("/dev/")
    if not is_device and settings.asked():
        option = _OPTIONS[settings.asked()[0]]
        raise UsageError(f"{option} is for a camera that is plugged in; leave it out")
    if (is_device or scheme) and filmed_hz is not None:
        raise UsageError("--fps is for a video file; a camera's rate is measured")
    # Each pulls in its own library, so that a file needs no network code and the other way round.
    if is_device:
        from recorders.camera.device import CameraDevice

        path = Path(f"/dev/video{int(text)}" if is_number else text)
        return opened_within(_DEVICE_S, str(path), lambda: CameraDevice(path, settings))
    if scheme in ("http", "https"):
        from recorders.camera.address import Address
        from recorders.camera.mjpeg_stream import OPENING_S, MjpegStream

        address = Address.of(text)
        longest_s = max(OPENING_S, timeout_s) + _SPARE_S
        return opened_within(longest_s, address.shown, lambda: MjpegStream(address, timeout_s))
    if scheme == "rtsp":
        from recorders.camera.address import Address
        from recorders.camera.rtsp_stream import RtspStream

        address = Address.of(text)
        # Connecting and learning what the stream holds have the time-out each.
        longest_s = 2 * timeout_s + _SPARE_S
        return opened_within(longest_s, address.shown, lambda: RtspStream(address, timeout_s))
    if scheme:
        raise UsageError(f"--camera: {scheme} is not recorded; use http, https, rtsp or a file")
    from recorders.camera.video_file import VideoFile

    return VideoFile(Path(text), filmed_hz)
