"""Apply settings to a plugged-in camera, read them back, and describe both."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import cv2

_MANUAL_EXPOSURE = 1.0  # V4L2_EXPOSURE_MANUAL of V4L2
_EXPOSURES_PER_MS = 10.0  # V4L2 gives an exposure in units of 100 µs


@dataclass(frozen=True)
class Settings:
    """Requested camera settings; None leaves one as it is.

    Attributes:
        size: (width, height) [px].
        white_balance_k: colour temperature [K].
        focus: in the camera's own units.
    """

    size: tuple[int, int] | None = None
    rate_hz: float | None = None
    exposure_ms: float | None = None
    white_balance_k: float | None = None
    focus: float | None = None

    def asked(self) -> list[str]:
        """Return the names of the requested settings."""
        return [field.name for field in fields(self) if getattr(self, field.name) is not None]


def apply(settings: Settings, capture: cv2.VideoCapture) -> None:
    """Apply the settings, format and size first, because they reset the rate."""
    import cv2

    capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
    if settings.size is not None:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, settings.size[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, settings.size[1])
    if settings.rate_hz is not None:
        capture.set(cv2.CAP_PROP_FPS, settings.rate_hz)
    if settings.exposure_ms is not None:
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
        capture.set(cv2.CAP_PROP_EXPOSURE, round(settings.exposure_ms * _EXPOSURES_PER_MS))
    if settings.white_balance_k is not None:
        capture.set(cv2.CAP_PROP_AUTO_WB, 0)
        capture.set(cv2.CAP_PROP_WB_TEMPERATURE, settings.white_balance_k)
    if settings.focus is not None:
        capture.set(cv2.CAP_PROP_AUTOFOCUS, 0)
        capture.set(cv2.CAP_PROP_FOCUS, settings.focus)


def in_words(settings: Settings, capture: cv2.VideoCapture) -> dict[str, str]:
    """Describe requested and accepted settings for the log."""
    import cv2

    get = capture.get
    width, height = get(cv2.CAP_PROP_FRAME_WIDTH), get(cv2.CAP_PROP_FRAME_HEIGHT)
    code = int(get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF
    is_manual = get(cv2.CAP_PROP_AUTO_EXPOSURE) == _MANUAL_EXPOSURE
    exposure_ms = get(cv2.CAP_PROP_EXPOSURE) / _EXPOSURES_PER_MS
    asked_size = None if settings.size is None else f"{settings.size[0]}x{settings.size[1]}"
    balance = _mode(get(cv2.CAP_PROP_AUTO_WB), get(cv2.CAP_PROP_WB_TEMPERATURE))
    focus = _mode(get(cv2.CAP_PROP_AUTOFOCUS), get(cv2.CAP_PROP_FOCUS))
    return {
        "format": code.to_bytes(4, "little").decode("latin-1").strip("\0 "),
        "setting.size_px": _both(asked_size, f"{width:g}x{height:g}"),
        "setting.rate_hz": _both(settings.rate_hz, f"{get(cv2.CAP_PROP_FPS):g}"),
        "setting.exposure_ms": _both(
            settings.exposure_ms, f"{'manual' if is_manual else 'automatic'} {exposure_ms:g}"
        ),
        "setting.white_balance_k": _both(settings.white_balance_k, balance),
        "setting.focus": _both(settings.focus, focus),
    }


def _mode(automatic: float, value: float) -> str:
    """Describe a control as automatic, manual or, where OpenCV answers -1, fixed."""
    if automatic < 0 and value < 0:
        return "fixed"
    return f"{'automatic' if automatic > 0 else 'manual'} {value:g}"


def _both(asked: float | str | None, accepted: str) -> str:
    if asked is None:
        return f"not asked, is {accepted}"
    return f"asked {asked if isinstance(asked, str) else f'{asked:g}'}, accepted {accepted}"
