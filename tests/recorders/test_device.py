"""What is done with a plugged-in camera's frames, stamps and settings.

No test machine has a camera or the kernel module that would stand in for one, so a stand-in takes
the place of OpenCV's capture here: it answers as V4L2 does, and unplugs itself.
"""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.recorders.live_wait import LAST_RESORT_S
from tests.recorders.mjpeg_camera import number_in, picture
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.images import image_size
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.device import CameraDevice
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.recording import Limits, record_camera
from tunenet_logs.terminal import Progress
from tunenet_logs.timing.stamps import MAX_SPEED_CAMERA_HZ, measured_hz, wall_ns

pytestmark = pytest.mark.live

FRAMES = 20
EARLIER_NS = 20_000_000  # before a frame is read, its driver stamped it


class StandIn:
    """Answers as an opened V4L2 camera does, with a frame at once; unplugged after so many.

    Attributes:
        path: of the device.
        read_ns: monotonic time when each frame was read.
    """

    makes_jpegs = True
    has_stamps = True
    path: Path
    read_ns: list[int]

    def __init__(self, path: str, backend: int) -> None:
        assert backend == cv2.CAP_V4L2
        assert path == str(self.path)
        self.values = {
            cv2.CAP_PROP_AUTO_EXPOSURE: 3.0,
            cv2.CAP_PROP_EXPOSURE: 156.0,
            cv2.CAP_PROP_AUTO_WB: 1.0,
            cv2.CAP_PROP_WB_TEMPERATURE: 4600.0,
            cv2.CAP_PROP_AUTOFOCUS: -1.0,
            cv2.CAP_PROP_FOCUS: -1.0,
            cv2.CAP_PROP_FRAME_WIDTH: 320.0,
            cv2.CAP_PROP_FRAME_HEIGHT: 240.0,
            cv2.CAP_PROP_FPS: 30.0,
        }
        self.number = -1

    def isOpened(self) -> bool:  # noqa: N802
        return True

    def set(self, name: int, value: float) -> bool:
        if name == cv2.CAP_PROP_FPS:
            value = min(value, 60.0)
        if name == cv2.CAP_PROP_FOURCC and not self.makes_jpegs:
            value = cv2.VideoWriter.fourcc(*"YUYV")
        self.values[name] = value
        return True

    def get(self, name: int) -> float:
        if name == cv2.CAP_PROP_POS_MSEC:
            return (self.read_ns[-1] - EARLIER_NS) / 1e6 if self.has_stamps else 0.0
        return self.values.get(name, -1.0)

    def read(self) -> tuple[bool, np.ndarray | None]:
        self.number += 1
        self.read_ns.append(time.monotonic_ns())
        if self.number == FRAMES:
            self.path.unlink()  # and goes on with the last frame
        data = np.frombuffer(picture(min(self.number, FRAMES - 1)) + bytes(999), np.uint8)
        if self.values[cv2.CAP_PROP_CONVERT_RGB]:
            return True, cv2.imdecode(data, cv2.IMREAD_COLOR)
        if self.number == 5:
            data = data[: len(data) // 2]
        return True, data.reshape(1, -1)

    def release(self) -> None:
        pass


def record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, settings: CameraOptions, **traits: object
) -> Episode:
    path = tmp_path / "video0"
    path.touch()
    stand_in = type("OneStandIn", (StandIn,), {"path": path, "read_ns": [], **traits})
    monkeypatch.setattr(cv2, "VideoCapture", stand_in)
    record_camera(
        CameraDevice(path, settings),
        EpisodeInfo(),
        tmp_path / "a.mcap",
        limits=Limits(stall_s=LAST_RESORT_S),
        overwrite=False,
        progress=Progress(quiet=True),
    )
    return read_episode(tmp_path / "a.mcap")


def test_jpegs_stay_untouched_and_have_the_drivers_stamps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    read_ns: list[int] = []
    episode = record(tmp_path, monkeypatch, CameraOptions(), read_ns=read_ns)
    frames = list(episode.frames())
    whole = [number for number in range(FRAMES) if number != 5]
    assert [frame.data for frame in frames] == [picture(number) for number in whole]
    stamps_ns = np.array([frame.stamp_ns for frame in frames])
    stamped_ns = np.array([wall_ns(read_ns[number] - EARLIER_NS) for number in whole])
    assert np.abs(stamps_ns - stamped_ns).max() < 10_000
    assert episode.info.counts == {"captured": 19, "written": 19, "dropped": 0, "damaged": 1}
    assert episode.info.notes["stamps"] == "driver"
    assert episode.info.notes["ended"] == "the camera was unplugged"


def test_without_stamps_of_the_driver_arrival_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    read_ns: list[int] = []
    episode = record(
        tmp_path, monkeypatch, CameraOptions(), read_ns=read_ns, has_stamps=False, makes_jpegs=False
    )
    assert episode.info.notes["stamps"] == "arrival"
    stamps_ns = [frame.stamp_ns for frame in episode.frames()]
    for number, stamp_ns in enumerate(stamps_ns):
        assert wall_ns(read_ns[number]) <= stamp_ns < wall_ns(read_ns[number + 1])
    rate_hz = measured_hz(stamps_ns, MAX_SPEED_CAMERA_HZ)
    assert float(episode.info.notes["measured_hz"]) == pytest.approx(rate_hz, abs=0.001)


def test_a_camera_without_jpegs_has_its_pixels_compressed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    episode = record(tmp_path, monkeypatch, CameraOptions(), makes_jpegs=False)
    frames = list(episode.frames())
    assert [number_in(frame.decode()) for frame in frames] == list(range(FRAMES))
    assert image_size(frames[0].data) == (320, 240)
    assert episode.info.notes["format"] == "YUYV"


def test_settings_are_put_down_as_asked_and_as_accepted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    asked = CameraOptions(size_px=(640, 480), rate_hz=120, exposure_ms=4, white_balance_k=5000)
    notes = record(tmp_path, monkeypatch, asked).info.notes
    assert notes["setting.size_px"] == "asked 640x480, accepted 640x480"
    assert notes["setting.rate_hz"] == "asked 120, accepted 60"
    assert notes["setting.exposure_ms"] == "asked 4, accepted manual 4"
    assert notes["setting.white_balance_k"] == "asked 5000, accepted manual 5000"
    assert notes["setting.focus"] == "not asked, is fixed"


def test_what_is_not_asked_is_left_alone_and_put_down(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    notes = record(tmp_path, monkeypatch, CameraOptions()).info.notes
    assert notes["setting.exposure_ms"] == "not asked, is automatic 15.6"
    assert notes["setting.white_balance_k"] == "not asked, is automatic 4600"
    assert notes["setting.rate_hz"] == "not asked, is 30"
