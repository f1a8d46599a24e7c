"""Plugged-in cameras, microphones and video files: frames, samples, stamps, settings.

No test machine has a camera or the kernel module that would stand in for one, so a stand-in takes
the place of OpenCV's capture here: it answers as V4L2 does, and unplugs itself. A played file takes
the place of a microphone.
"""

from __future__ import annotations

import time
import wave
from collections.abc import Callable
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from tests.conftest import Command, real
from tests.recorders.conftest import Record, Refuses
from tests.recorders.films import numbered, numbers, recorded, write_jpegs, write_moved, write_video
from tests.recorders.mjpeg_camera import number_in, picture, playing
from tunenet_logs.analysis.evaluation.worlds.audio import write_sound
from tunenet_logs.episode import FRAME_NS, Episode, Frame
from tunenet_logs.errors import MicrophoneError, UsageError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.images import image_size
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.device import CameraDevice
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.cli import build_parser
from tunenet_logs.recorders.microphone import InputDevice, SampleClock, SoundPiece, chosen
from tunenet_logs.timing.stamps import MAX_SPEED_CAMERA_HZ, measured_hz, wall_ns
from tunenet_logs.video import open_video

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


def test_without_stamps_and_jpegs_of_the_driver_arrival_counts(recorded_by):
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


def test_the_first_camera_is_meant_when_none_is_named():
    assert build_parser().parse_args(["--camera", "-o", "a.mcap"]).camera == "0"


# ---- Video files: every frame at its own time, its bytes kept where it is a JPEG

CONSTANT = list(range(0, 600, 10))
UNEVEN = [0, 10, 20, 35, 40, 70, 80, 90, 200, 210, 215]


def from_file(record: Record, video: Path, *options: object) -> tuple[Episode, list[Frame], str]:
    log = video.parent / "a.mcap"
    result = record("--camera", video, "-o", log, "--overwrite", *options)
    assert not result.stderr
    episode = read_episode(log)
    assert not episode.warnings
    return episode, list(episode.frames()), result.stdout


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
@pytest.mark.parametrize("ticks", [CONSTANT, UNEVEN, [0]], ids=["even", "uneven", "one frame"])
def test_frames_keep_their_order_and_times(record: Record, tmp_path: Path, name, ticks):
    episode, frames, out = from_file(record, write_video(tmp_path / name, ticks))
    assert numbers(episode) == list(range(len(ticks)))
    stamps_ns = np.array([frame.stamp_ns for frame in frames])
    tolerance_ns = 600_000 if name == "a.mkv" else 2  # Matroska counts milliseconds
    assert np.allclose(stamps_ns, np.array(ticks) / 600 * 1e9, atol=tolerance_ns, rtol=0)
    assert all(frame.encoding == "jpeg" for frame in frames)
    assert episode.info.counts == {"captured": len(ticks), "written": len(ticks), "dropped": 0}
    assert (episode.info.kind, episode.info.source) == ("drop", f"video file {name}")
    assert "ended" not in episode.info.notes
    assert ("measured_hz" in episode.info.notes) == (len(ticks) > 1)
    assert f"{len(ticks)} frames captured, {len(ticks)} written, 0 dropped" in out
    if name == "a.mp4":  # the colours survive at full resolution
        stored = next(open_video(tmp_path / name).frames()).decode()
        assert np.sqrt(np.mean((frames[0].decode().astype(int) - stored) ** 2)) < 2


@pytest.mark.parametrize("name", ["a.avi", "a.mkv"])
def test_a_cameras_own_jpegs_stay_byte_for_byte(record: Record, tmp_path: Path, name: str):
    _, frames, _ = from_file(record, write_jpegs(tmp_path / name, 40))
    assert [frame.data for frame in frames] == [picture(number) for number in range(40)]


@pytest.mark.parametrize("codec", ["libx264", "mjpeg"])
def test_recording_a_file_twice_gives_the_same_bytes(record: Record, tmp_path: Path, codec: str):
    video = write_video(tmp_path / "a.mkv", CONSTANT, codec)
    both = []
    for _ in range(2):
        from_file(record, video)
        both.append((tmp_path / "a.mcap").read_bytes())
    assert both[0] == both[1]
    assert str(tmp_path).encode() not in both[0]


def test_what_is_said_of_a_film_and_its_ball_goes_into_the_log(record: Record, tmp_path: Path):
    video = write_video(tmp_path / "a.mp4", CONSTANT)
    options = ("--ball", "red rubber", "--ball-diameter", 0.04, "--ball-mass", 0.02)
    episode, frames, _ = from_file(record, video, *options, "--drop-height", 1.5, "--seconds", 0.5)
    assert len(frames) == 30
    rig = {"ball_diameter_m": 0.04, "ball_mass_kg": 0.02, "drop_height_m": 1.5}
    assert (episode.info.rig, episode.info.notes["ball"]) == (rig, "red rubber")
    options = ("--ball", "table-tennis", "--ball-mass", 0.0026, "--fps", 240)  # a slow motion
    episode, frames, _ = from_file(record, video, *options)
    assert np.allclose(np.diff([frame.stamp_ns for frame in frames]), 1e9 / 240, atol=2)
    assert float(episode.info.notes["measured_hz"]) == pytest.approx(240, abs=0.01)
    assert episode.info.rig == {"ball_diameter_m": 0.04, "ball_mass_kg": 0.0026}
    assert episode.info.notes["ball"] == "table-tennis"


def test_a_real_phone_clip_is_upright_and_at_its_true_rate(record: Record, tmp_path: Path):
    log = tmp_path / "a.mcap"
    clip = real("videos/red_ball_drop_120fps.mp4")
    record("--camera", clip, "-o", log)
    episode = read_episode(log)
    frames = list(episode.frames())
    assert len(frames) == 327
    assert {image_size(frame.data) for frame in frames} == {(172, 1716)}
    assert float(episode.info.notes["measured_hz"]) == pytest.approx(120, rel=0.001)
    counts = {"captured": 327 + 26, "written": 327 + 26, "dropped": 0}  # and pieces of sound
    assert episode.info.counts == counts
    kept, filmed = (
        np.array([one.stamp_ns for one in each]) for each in (frames, read_episode(clip).frames())
    )
    assert np.array_equal(kept - kept[0], filmed - filmed[0])


# ---- What was cut or is damaged


def test_what_a_phone_cut_off_is_not_shown_and_shifts_no_stamp(record: Record, tmp_path: Path):
    """It cuts without compressing anew: the pictures stay, an edit list hides those before."""
    whole, cut = write_video(tmp_path / "a.mp4", UNEVEN), tmp_path / "cut.mp4"
    write_moved(whole, cut, 35 / 600)
    episode, frames, _ = from_file(record, cut)
    assert numbers(episode) == list(range(3, len(UNEVEN)))
    stamps_ns = np.array([frame.stamp_ns for frame in frames])
    assert np.allclose(stamps_ns, (np.array(UNEVEN[3:]) - 35) / 600 * 1e9, atol=2, rtol=0)
    assert read_episode(cut).channels[0].messages == len(frames)
    whole = write_video(tmp_path / "a.mp4", CONSTANT)
    video = open_video(write_moved(whole, cut, 10 * 10 / 600, avoid_negative_ts="disabled"))
    kept = [number_in(frame.decode()) for frame in video.frames()]
    assert kept == list(range(10, 60))
    assert len(video.clock.stamps_ns) == 50


def test_a_cut_where_pictures_need_others_begins_at_the_first_whole_one(tmp_path: Path):
    """A picture's time tells which it is, so that none takes the time of one that is missing."""
    whole = write_video(tmp_path / "a.mkv", range(0, 300, 10), g="6", bf="0")
    episode = read_episode(write_moved(whole, tmp_path / "b.mkv", 0, first=3))
    assert numbers(episode) == list(range(6, 30))
    assert episode.channels[0].messages == 24
    assert "its first 3 pictures need others that were cut off" in episode.warnings


def test_a_file_that_breaks_off(command: Command, refuses: Refuses, tmp_path: Path):
    video = write_video(tmp_path / "a.mkv", CONSTANT, "mjpeg")
    whole = video.read_bytes()
    video.write_bytes(whole[: len(whole) * 2 // 3])
    result = command("tunenet-record", "--camera", video, "-o", tmp_path / "a.mcap")
    assert result.returncode in (0, 1)
    assert result.stderr.count("\n") == result.returncode
    seen = numbers(read_episode(tmp_path / "a.mcap"))[:-1]
    assert len(seen) >= 20
    assert seen == list(range(len(seen)))
    half = write_video(tmp_path / "a.mp4", CONSTANT)
    half.write_bytes(half.read_bytes()[: half.stat().st_size // 2])  # its index is at its end
    refuses(1, "--camera", half, "-o", "b.mcap", says=str(half))


def test_pictures_behind_damaged_ones_keep_their_times(tmp_path: Path):
    path = tmp_path / "a.mp4"
    wall = np.random.default_rng(0).integers(0, 255, (180, 320, 3))

    def busy(number: int) -> np.ndarray:
        pixels = numbered(number)
        pixels[60:] = np.roll(wall, number, axis=1)  # or a packet is too small to be hurt
        return pixels

    def stamps_ns() -> dict[int, int]:
        frames = read_episode(path).frames("video")
        return {number_in(frame.decode()): frame.stamp_ns for frame in frames}

    write_video(path, range(60), "mpeg4", ticks_hz=60, drawn=busy, g="10")
    whole = stamps_ns()
    with av.open(str(path)) as file:
        packets = [one for one in file.demux(file.streams.video[0]) if one.size]
        at, size = packets[22].pos, packets[22].size
    assert at is not None
    data = bytearray(path.read_bytes())
    data[at + size // 2 : at + size // 2 + 20] = bytes(20)
    path.write_bytes(data)
    assert stamps_ns() == {number: whole[number] for number in range(60) if not 22 <= number < 30}


def test_sound_alone_is_sent_to_where_it_is_tuned(refuses: Refuses, tmp_path: Path):
    path = tmp_path / "bounce.wav"
    with wave.open(str(path), "wb") as file:
        file.setparams((1, 2, 8000, 0, "NONE", ""))
        file.writeframes(bytes(16_000))
    said = refuses(1, "--camera", path, says="is sound alone")
    assert said.endswith(f"tunenet-tune {path}\n")


# ---- Films whose rate a user says: streams without a container, and stamps that are not even

BARE = {"a.h264": "libx264", "a.h265": "libx265", "a.y4m": "wrapped_avframe"}


@pytest.mark.parametrize("name", BARE)
def test_a_stream_without_a_container_is_read_at_the_rate_said(tmp_path: Path, name: str):
    options: dict[str, Any] = {"x265-params": "log-level=none"} if name == "a.h265" else {}
    path = write_video(tmp_path / name, range(20), BARE[name], ticks_hz=60, **options)
    for rate_hz in (None, 240.0):
        episode = read_episode(path, ReadOptions(fps=rate_hz))
        assert numbers(episode) == list(range(20))
        stamps_ns = np.array([frame.stamp_ns for frame in episode.frames()])
        assert np.allclose(np.diff(stamps_ns), 1e9 / (rate_hz or 60), atol=2)  # its header's


def test_a_stream_without_any_rate_counts_frames(refuses: Refuses, tmp_path: Path):
    path = tmp_path / "a.mjpeg"
    path.write_bytes(b"".join(picture(number) for number in range(20)))
    episode = read_episode(path)
    assert episode.frames_untimed
    assert episode.info.notes["rate_hz"] == "unknown"
    assert [frame.stamp_ns for frame in episode.frames()] == [n * FRAME_NS for n in range(20)]
    assert not read_episode(path, ReadOptions(fps=50)).frames_untimed
    refuses(1, "--camera", path, "-o", "a.mcap", says="add --fps")


def test_the_rate_said_goes_before_uneven_stamps(tmp_path: Path):
    episode = read_episode(write_video(tmp_path / "a.mp4", UNEVEN), ReadOptions(fps=100))
    stamps_ns = [frame.stamp_ns for frame in episode.frames()]
    assert stamps_ns == [10_000_000 * number for number in range(len(UNEVEN))]
    assert "100 pictures a second were said" in episode.warnings[0]
