"""Read a plugged-in camera through Video4Linux."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from recorders.camera.base import Shot
from recorders.camera.settings import Settings, apply, in_words
from tunenet_logs.clock import wall_ns
from tunenet_logs.episode import Frame
from tunenet_logs.errors import CameraError
from tunenet_logs.jpeg import from_bgr, is_whole

# A driver's stamp that is further from the monotonic clock is of another clock, or 0.
_PLAUSIBLE_NS = 5_000_000_000


class CameraDevice:
    """A Video4Linux camera; the JPEGs it makes are kept byte for byte.

    A frame's stamp is the driver's, which is monotonic and taken when the frame was received;
    where that is missing, when the frame was read.

    Raises:
        CameraError: it is missing, is no camera, or is in use by another program.
    """

    live = True
    returns = False
    dropped = 0

    def __init__(self, path: Path, settings: Settings) -> None:
        if not path.exists():
            raise CameraError(f"{path}: no such camera; {_those_there_are()}")
        import cv2

        cv2.utils.logging.setLogLevel(
            cv2.utils.logging.LOG_LEVEL_SILENT
        )  # it would print its own lines beside ours
        self._capture = cv2.VideoCapture(str(path), cv2.CAP_V4L2)
        if not self._capture.isOpened():
            raise CameraError(
                f"{path}: cannot be opened as a camera, or another program has it; "
                + _those_there_are()
            )
        apply(settings, self._capture)
        self._notes = in_words(settings, self._capture)
        # Else OpenCV would decode the camera's JPEGs, only for them to be compressed again.
        self._makes_jpegs = self._notes["format"] in ("MJPG", "JPEG")
        self._capture.set(cv2.CAP_PROP_CONVERT_RGB, 0 if self._makes_jpegs else 1)
        self.name = f"camera {path}"
        self.ended = ""
        self.damaged = 0
        self._path = path
        self._closed = False
        self._reading = False
        self._has_driver_stamps: bool | None = None

    def notes(self) -> dict[str, str]:
        """Return the settings asked and accepted, and how frames are stamped."""
        notes = dict(self._notes)
        if self._has_driver_stamps is not None:
            notes["stamps"] = "driver" if self._has_driver_stamps else "arrival"
        return notes

    def frames(self) -> Iterator[Shot]:
        """Yield the frames as they come, until the camera is unplugged."""
        import cv2

        self._reading = True
        try:
            while not self._closed:
                is_read, picture = self._capture.read()
                monotonic_ns = time.monotonic_ns()
                if not self._path.exists():  # after an unplug some drivers repeat the last frame
                    self.ended = "the camera was unplugged"
                    return
                if not is_read:
                    self.ended = "the camera delivers no more frames"
                    return
                driver_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
                plausible = abs(driver_ns - monotonic_ns) < _PLAUSIBLE_NS
                self._has_driver_stamps = plausible
                data = self._jpeg(picture)
                if data is None:
                    self.damaged += 1
                else:
                    stamp_ns = wall_ns(driver_ns if plausible else monotonic_ns)
                    yield Shot(Frame(stamp_ns, "jpeg", data))
        finally:
            self._capture.release()

    def close(self) -> None:
        """End a running `frames` with the next frame; it releases the device."""
        self._closed = True
        if not self._reading:
            self._capture.release()

    def _jpeg(self, picture: np.ndarray) -> bytes | None:
        """Return a frame as a JPEG; None where it is damaged."""
        is_decoded = picture.ndim == 3 and picture.shape[2] == 3
        if is_decoded or not self._makes_jpegs:
            return from_bgr(picture)
        data = picture.tobytes().rstrip(b"\0")  # the rest of the driver's buffer
        return data if is_whole(data) else None


def _those_there_are() -> str:
    devices = sorted(str(device) for device in Path("/dev").glob("video*"))
    if not devices:
        return "no camera is plugged in (there is no /dev/video*)"
    return "there is " + ", ".join(devices)
