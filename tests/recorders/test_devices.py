"""Plugged-in cameras and microphones: frames, samples, stamps, settings.

No test machine has a camera or the kernel module that would stand in for one, so a stand-in takes
the place of OpenCV's capture here: it answers as V4L2 does, and unplugs itself. A played file takes
the place of a microphone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.recorders.conftest import Record
from tests.recorders.films import numbers, recorded
from tests.recorders.mjpeg_camera import picture, playing
from tunenet_logs.analysis.evaluation.worlds.audio import write_sound
from tunenet_logs.episode import Episode
from tunenet_logs.errors import MicrophoneError, UsageError
from tunenet_logs.images import image_size
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.device import CameraDevice
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.microphone import InputDevice, SampleClock, SoundPiece, chosen
from tunenet_logs.timing.stamps import MAX_SPEED_CAMERA_HZ, measured_hz, wall_ns

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
        assert (path, backend) == (str(self.path), cv2.CAP_V4L2)
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


@pytest.fixture
def recorded_by(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., tuple[Episode, list[int]]]:
    """Record by a stand-in with options and traits of its own; the log, and when it was read."""

    def make(options: CameraOptions, **traits: object) -> tuple[Episode, list[int]]:
        path, read_ns = tmp_path / "video0", list[int]()
        path.touch()
        stand_in = type("OneStandIn", (StandIn,), {"path": path, "read_ns": read_ns, **traits})
        monkeypatch.setattr(cv2, "VideoCapture", stand_in)
        _, episode = recorded(CameraDevice(path, options), tmp_path / "a.mcap")
        return episode, read_ns

    return make


def test_jpegs_stay_untouched_and_have_the_drivers_stamps(recorded_by):
    episode, read_ns = recorded_by(CameraOptions())
    frames, notes = list(episode.frames()), episode.info.notes
    whole = [number for number in range(FRAMES) if number != 5]
    assert [frame.data for frame in frames] == [picture(number) for number in whole]
    stamps_ns = np.array([frame.stamp_ns for frame in frames])
    stamped_ns = np.array([wall_ns(read_ns[number] - EARLIER_NS) for number in whole])
    assert np.abs(stamps_ns - stamped_ns).max() < 10_000
    assert episode.info.counts == {"captured": 19, "written": 19, "dropped": 0, "damaged": 1}
    assert notes["stamps"] == "driver"
    assert notes["ended"] == "the camera was unplugged"
    # what is not asked is left alone and put down
    assert notes["setting.exposure_ms"] == "not asked, is automatic 15.6"
    assert notes["setting.white_balance_k"] == "not asked, is automatic 4600"
    assert notes["setting.rate_hz"] == "not asked, is 30"


def test_without_stamps_of_the_driver_and_jpegs_arrival_counts_and_pixels_are_compressed(
    recorded_by,
):
    episode, read_ns = recorded_by(CameraOptions(), has_stamps=False, makes_jpegs=False)
    assert numbers(episode) == list(range(FRAMES))
    assert image_size(next(episode.frames()).data) == (320, 240)
    assert episode.info.notes["format"] == "YUYV"
    assert episode.info.notes["stamps"] == "arrival"
    stamps_ns = [frame.stamp_ns for frame in episode.frames()]
    for number, stamp_ns in enumerate(stamps_ns):
        assert wall_ns(read_ns[number]) <= stamp_ns < wall_ns(read_ns[number + 1])
    rate_hz = measured_hz(stamps_ns, MAX_SPEED_CAMERA_HZ)
    assert float(episode.info.notes["measured_hz"]) == pytest.approx(rate_hz, abs=0.001)


def test_settings_are_put_down_as_asked_and_as_accepted(recorded_by):
    asked = CameraOptions(size_px=(640, 480), rate_hz=120, exposure_ms=4, white_balance_k=5000)
    notes = recorded_by(asked)[0].info.notes
    assert {name: notes[f"setting.{name}"] for name in (
        "size_px", "rate_hz", "exposure_ms", "white_balance_k", "focus"
    )} == {
        "size_px": "asked 640x480, accepted 640x480",
        "rate_hz": "asked 120, accepted 60",
        "exposure_ms": "asked 4, accepted manual 4",
        "white_balance_k": "asked 5000, accepted manual 5000",
        "focus": "not asked, is fixed",
    }  # fmt: skip


# ---- Sound beside a live camera

RATE_HZ = 16_000
PIECE = 320
START_NS = 1_700_000_000_000_000_000


@pytest.mark.live
def test_a_played_file_is_recorded_beside_the_pictures_of_a_camera(record: Record, tmp_path: Path):
    seconds = np.arange(20 * RATE_HZ) / RATE_HZ
    sweep = tmp_path / "sweep.wav"  # a tone that rises: each moment of it is told from all others
    write_sound((0.5 * np.sin(200 * seconds**2)).astype(np.float32), RATE_HZ, sweep)
    with playing(frames=90, rate_hz=60.0) as address:
        result = record("--camera", f"http://{address}", "--microphone", sweep, "-o", "a.mcap")
    assert result.returncode == 0, result.stderr
    assert "s of sound" in result.stdout + result.stderr
    episode = read_episode(tmp_path / "a.mcap")
    sound, played = episode.sounds("/audio"), read_episode(sweep).sounds(None)
    assert sound is not None
    assert played is not None
    assert sound.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    assert next(episode.frames()).stamp_ns == pytest.approx(sound.start_ns, abs=60_000_000)
    # what was kept is one whole stretch of the file, sample by sample
    assert len(sound.samples) > RATE_HZ / 2
    at = int(np.correlate(played.samples, sound.samples[: RATE_HZ // 4], "valid").argmax())
    whole = played.samples[at : at + len(sound.samples)]
    assert np.abs(whole - sound.samples).max() < 2 / 32768


def times_ms(clock: SampleClock, lost_after: int | None = None, *, told: bool = True):
    """Times of ten seconds whose told ones jitter by 4 ms; .1 s is lost after so many pieces."""
    rng, found = np.random.default_rng(3), []
    for number in range(10 * RATE_HZ // PIECE):
        is_late = lost_after is not None and number > lost_after
        begin_s = number * PIECE / RATE_HZ + 0.1 * is_late + 0.004 * rng.uniform(-1, 1)
        follows = told and lost_after is not None and number == lost_after + 1
        pcm, begin_ns = np.full(PIECE, number, np.int16), START_NS + round(1e9 * begin_s)
        found += clock.timed(SoundPiece(number * PIECE, begin_ns, pcm, follows), begin_ns)
    return np.array([one.stamp_ns - START_NS for one in [*found, *clock.rest()]]) * 1e-6


def test_a_driver_s_jitter_is_not_in_the_samples_times():
    clock = SampleClock(RATE_HZ)
    at_ms = times_ms(clock)
    assert len(at_ms) == 10 * RATE_HZ // PIECE
    assert np.abs(at_ms - np.arange(len(at_ms)) * 20.0).max() < 1.5
    assert np.abs(np.diff(at_ms) - 20).max() < 0.3
    assert clock.losses == 0


@pytest.mark.parametrize("told", [True, False], ids=["told by the device", "found by its times"])
def test_samples_that_are_lost_leave_a_gap_and_are_told(told: bool):
    clock = SampleClock(RATE_HZ)
    at_ms = times_ms(clock, 200, told=told)
    due_ms = np.arange(len(at_ms)) * 20.0 + 100.0 * (np.arange(len(at_ms)) > 200)
    assert clock.losses == 1
    assert clock.lost_s == pytest.approx(0.1, abs=0.004)
    assert np.abs(at_ms - due_ms).max() < 4


def test_a_microphone_is_named_by_number_or_part_of_its_name():
    devices = (
        InputDevice(0, "HDA Intel PCH: ALC257 (hw:0,0)", 2, 44_100.0),
        InputDevice(4, "Blue Yeti: USB Audio (hw:1,0)", 2, 48_000.0),
        InputDevice(6, "default", 32, 44_100.0),
    )
    for wanted, number in (("", 6), ("yeti", 4), ("0", 0), ("DEFAULT", 6)):
        assert chosen(wanted, devices, 6).number == number
    with pytest.raises(MicrophoneError, match="Blue Yeti"):
        chosen("rode", devices, 6)
    with pytest.raises(UsageError, match="2 are called so"):
        chosen("hw:", devices, 6)
    with pytest.raises(MicrophoneError, match="no microphone is plugged in"):
        chosen("", (), -1)
