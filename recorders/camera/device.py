"""Read frames from a plugged-in camera (Video4Linux) or a video file."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import closing, suppress
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from tunenet_logs.audio import is_sound_alone
from tunenet_logs.episode import Frame, Sound
from tunenet_logs.errors import CameraAwayError, CameraError, LogError
from tunenet_logs.messages import compressed, from_bgr, is_whole
from tunenet_logs.process import heard_wait
from tunenet_logs.recorders.camera.base import BaseSource, CapturedFrame
from tunenet_logs.recorders.session import Closable
from tunenet_logs.terminal import short_name
from tunenet_logs.timing.stamps import wall_ns
from tunenet_logs.video import open_video, video_notes

if TYPE_CHECKING:
    import cv2

    from tunenet_logs.recorders.camera.options import CameraOptions


SETTINGS = ("size_px", "rate_hz", "exposure_ms", "white_balance_k", "focus")  # of `CameraOptions`

_MANUAL_EXPOSURE = 1.0  # V4L2_EXPOSURE_MANUAL; V4L2 gives an exposure in units of 100 µs


def apply_settings(asked: CameraOptions, capture: cv2.VideoCapture) -> None:
    """Apply the settings, format and size first, because they reset the rate."""
    import cv2

    capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
    if asked.size_px is not None:
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, asked.size_px[0])
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, asked.size_px[1])
    if asked.rate_hz is not None:
        capture.set(cv2.CAP_PROP_FPS, asked.rate_hz)
    if asked.exposure_ms is not None:
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
        capture.set(cv2.CAP_PROP_EXPOSURE, round(10.0 * asked.exposure_ms))
    if asked.white_balance_k is not None:
        capture.set(cv2.CAP_PROP_AUTO_WB, 0)
        capture.set(cv2.CAP_PROP_WB_TEMPERATURE, asked.white_balance_k)
    if asked.focus is not None:
        capture.set(cv2.CAP_PROP_AUTOFOCUS, 0)
        capture.set(cv2.CAP_PROP_FOCUS, asked.focus)


def describe_settings(asked: CameraOptions, capture: cv2.VideoCapture) -> dict[str, str]:
    """Describe requested and accepted settings for the log."""
    import cv2

    get = capture.get
    width, height = get(cv2.CAP_PROP_FRAME_WIDTH), get(cv2.CAP_PROP_FRAME_HEIGHT)
    code = int(get(cv2.CAP_PROP_FOURCC)) & 0xFFFFFFFF
    is_manual = get(cv2.CAP_PROP_AUTO_EXPOSURE) == _MANUAL_EXPOSURE
    exposure_ms = get(cv2.CAP_PROP_EXPOSURE) / 10.0
    size = None if asked.size_px is None else "{}x{}".format(*asked.size_px)
    balance = _mode(get(cv2.CAP_PROP_AUTO_WB), get(cv2.CAP_PROP_WB_TEMPERATURE))
    focus = _mode(get(cv2.CAP_PROP_AUTOFOCUS), get(cv2.CAP_PROP_FOCUS))
    return {
        "format": code.to_bytes(4, "little").decode("latin-1").strip("\0 "),
        "setting.size_px": _both(size, f"{width:g}x{height:g}"),
        "setting.rate_hz": _both(asked.rate_hz, f"{get(cv2.CAP_PROP_FPS):g}"),
        "setting.exposure_ms": _both(
            asked.exposure_ms, f"{'manual' if is_manual else 'automatic'} {exposure_ms:g}"
        ),
        "setting.white_balance_k": _both(asked.white_balance_k, balance),
        "setting.focus": _both(asked.focus, focus),
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


class CameraDevice(BaseSource):
    """A Video4Linux camera; the JPEGs it makes are kept byte for byte.

    A frame's stamp is the driver's, which is monotonic and taken when the frame was received;
    where that is missing, when the frame was read.
    """

    def __init__(self, path: Path, asked: CameraOptions) -> None:
        if not path.exists():
            raise CameraError(f"{path}: no such camera; {_those_there_are()}")
        import cv2

        # Else it would print its own lines beside ours.
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        self._capture = cv2.VideoCapture(str(path), cv2.CAP_V4L2)
        if not self._capture.isOpened():
            what = f"{path}: cannot be opened as a camera, or another program has it"
            raise CameraError(f"{what}; {_those_there_are()}")
        super().__init__(f"camera {path}", returns=False)
        apply_settings(asked, self._capture)
        self._notes = describe_settings(asked, self._capture)
        # Else OpenCV would decode the camera's JPEGs, only for them to be compressed again.
        self._makes_jpegs = self._notes["format"] in ("MJPG", "JPEG")
        self._capture.set(cv2.CAP_PROP_CONVERT_RGB, 0 if self._makes_jpegs else 1)
        self._path = path

    def notes(self) -> dict[str, str]:
        """Return the settings asked and accepted, and how frames are stamped."""
        return dict(self._notes)

    def _shots(self) -> Iterator[CapturedFrame]:
        import cv2

        while not self._is_closed:
            is_read, picture = self._capture.read()
            monotonic_ns = time.monotonic_ns()
            is_there = self._path.exists()  # after an unplug some drivers repeat the last frame
            if not is_there or not is_read:
                self.ended = "the camera " + (
                    "delivers no more frames" if is_there else "was unplugged"
                )
                return
            driver_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
            # A driver's stamp that is further from the monotonic clock is of another clock, or 0.
            is_driver = abs(driver_ns - monotonic_ns) < 5_000_000_000
            self._notes["stamps"] = "driver" if is_driver else "arrival"
            if not self._makes_jpegs or (picture.ndim == 3 and picture.shape[2] == 3):
                data = from_bgr(picture)
            else:
                data = picture.tobytes().rstrip(b"\0")  # the rest of the driver's buffer
            if not is_whole(data):
                self.damaged += 1
                continue
            stamp_ns = wall_ns(driver_ns if is_driver else monotonic_ns)
            yield CapturedFrame(Frame(stamp_ns, "jpeg", data))

    def _release(self) -> None:
        self._capture.release()


def _those_there_are() -> str:
    devices = ", ".join(sorted(map(str, Path("/dev").glob("video*"))))
    return f"there is {devices}" if devices else "no camera is plugged in (there is no /dev/video*)"


_MAX_OPENING_S = 10.0  # of a camera that is listed
_SETTLING = 10  # pictures in which a camera finds its exposure


def list_cameras() -> list[str]:
    """Describe each plugged-in camera, and save a picture of it here as `camera_N.jpg`.

    Raises:
        CameraError: none is plugged in.
    """
    from tunenet_logs.recorders.camera.options import CameraOptions

    devices = sorted(Path("/dev").glob("video*"))
    if not devices:
        raise CameraError(_those_there_are(), "plug one in, or name a stream or a video file")
    return [_listed(path, CameraOptions()) for path in devices]


def _listed(path: Path, asked: CameraOptions) -> str:
    number = path.name.removeprefix("video")
    name = ""
    with suppress(OSError):
        name = Path(f"/sys/class/video4linux/{path.name}/name").read_text(errors="replace").strip()
    said = f"{number}  {path}  {short_name(name, 40)}"
    try:
        camera = opened_within(_MAX_OPENING_S, str(path), lambda: CameraDevice(path, asked))
    except LogError:
        return f"{said}  gives no pictures"
    with closing(camera):
        shots = list(islice(camera.frames(), _SETTLING))
        about = [camera.notes()[f"setting.{one}"].rpartition(" ")[2] for one in SETTINGS[:2]]
    if not shots:
        return f"{said}  gives no pictures"
    picture = Path(f"camera_{number}.jpg")
    try:
        with picture.open("xb") as file:
            file.write(shots[-1].frame.data)
        kept = f"a picture: {picture}"
    except OSError as error:
        kept = f"no picture kept: {picture}: {error.strerror}"
    return f"{said}  {about[0]} px, {about[1]} Hz  {kept}"


Opened = TypeVar("Opened", bound=Closable)


def opened_within(
    seconds: float, shown: str, open_source: Callable[[], Opened], *, what: str = "camera"
) -> Opened:
    """Open a source within `seconds`, raising the errors of `open_source` here."""
    # Name servers, drivers and libraries in C block the thread that calls them, and no signal is
    # handled there until they return. What opens too late is closed.
    opening: Future[Opened] = Future()

    def run() -> None:
        try:
            source = open_source()
        except BaseException as error:  # noqa: BLE001 (it is raised again where it is waited for)
            if opening.set_running_or_notify_cancel():
                opening.set_exception(error)
            return
        if opening.set_running_or_notify_cancel():
            opening.set_result(source)
        else:
            source.close()

    # A daemon: a camera that never opens must not keep the process.
    threading.Thread(target=run, name="opening", daemon=True).start()
    try:
        heard_wait(lambda piece_s: wait([opening], piece_s).done, seconds)
        if opening.cancel():
            said = f"{shown}: cannot be opened within {seconds:g} s; is the {what} on?"
            raise CameraAwayError(said)
        return opening.result()
    except BaseException:
        opening.cancel()
        raise


class VideoFile(BaseSource):
    """A video file."""

    live = False

    def __init__(self, path: Path, filmed_hz: float | None = None) -> None:
        if path.is_dir():
            raise CameraError(f"{path}: is a directory; name a video file inside it")
        if not path.exists():
            raise CameraError(f"{path}: no such file; name a video, a camera's number or address")
        if not path.is_file():
            raise CameraError(f"{path}: is neither a file nor a camera device")
        if not path.stat().st_size:
            raise CameraError(f"{path}: is empty; copy the video again")
        try:
            self._video = open_video(path, filmed_hz)
        except LogError as error:
            if not is_sound_alone(path):
                raise
            what = f"{path}: is sound alone, and no film"
            raise CameraError(what, f"tune it as it is: tunenet-tune {path}") from error
        if not self._video.clock.is_timed:
            raise CameraError(f"{path}: does not say how many pictures a second it has; add --fps")
        super().__init__(f"video file {path.name}", returns=False)

    def notes(self) -> dict[str, str]:
        """Return codec, size, rates and warnings."""
        notes = video_notes(self._video)
        if self._video.warnings:
            notes["warnings"] = "; ".join(self._video.warnings)
        return notes

    def _shots(self) -> Iterator[CapturedFrame]:
        # The file's JPEGs stay as they are, all else is recompressed.
        return (CapturedFrame(compressed(frame)) for frame in self._video.frames())

    def _release(self) -> None:
        pass  # nothing is held open

    def sound(self) -> Sound | None:
        """Return the sound track, on the clock of the pictures; None where there is none."""
        return self._video.sound.sound() if self._video.sound else None
