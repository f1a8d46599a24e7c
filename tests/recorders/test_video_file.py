"""Video files: every frame at its own time, its bytes kept where it is a JPEG."""

from __future__ import annotations

import wave
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from tests.conftest import real
from tests.recorders.conftest import Record, Refuses
from tests.recorders.films import numbered, numbers, write_jpegs, write_moved, write_video
from tests.recorders.mjpeg_camera import number_in, picture
from tunenet_logs.episode import FRAME_NS, Episode, Frame
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.images import image_size
from tunenet_logs.reader import read_episode
from tunenet_logs.video import open_video

CONSTANT = list(range(0, 600, 10))
UNEVEN = [0, 10, 20, 35, 40, 70, 80, 90, 200, 210, 215]


def recorded(record: Record, video: Path, *options: object) -> tuple[Episode, list[Frame], str]:
    log = video.parent / "a.mcap"
    result = record("--camera", video, "-o", log, "--overwrite", *options)
    assert (result.returncode, result.stderr) == (0, "")
    episode = read_episode(log)
    assert not episode.warnings
    return episode, list(episode.frames()), result.stdout


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
@pytest.mark.parametrize("ticks", [CONSTANT, UNEVEN, [0]], ids=["even", "uneven", "one frame"])
def test_frames_keep_their_order_and_times(record: Record, tmp_path: Path, name, ticks):
    episode, frames, out = recorded(record, write_video(tmp_path / name, ticks))
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
    _, frames, _ = recorded(record, write_jpegs(tmp_path / name, 40))
    assert [frame.data for frame in frames] == [picture(number) for number in range(40)]


@pytest.mark.parametrize("codec", ["libx264", "mjpeg"])
def test_recording_a_file_twice_gives_the_same_bytes(record: Record, tmp_path: Path, codec: str):
    video = write_video(tmp_path / "a.mkv", CONSTANT, codec)
    both = []
    for _ in range(2):
        recorded(record, video)
        both.append((tmp_path / "a.mcap").read_bytes())
    assert both[0] == both[1]
    assert str(tmp_path).encode() not in both[0]


def test_what_is_said_of_a_film_and_its_ball_goes_into_the_log(record: Record, tmp_path: Path):
    video = write_video(tmp_path / "a.mp4", CONSTANT)
    options = ("--ball", "red rubber", "--ball-diameter", 0.04, "--ball-mass", 0.02)
    episode, frames, _ = recorded(record, video, *options, "--drop-height", 1.5, "--seconds", 0.5)
    assert len(frames) == 30
    rig = {"ball_diameter_m": 0.04, "ball_mass_kg": 0.02, "drop_height_m": 1.5}
    assert (episode.info.rig, episode.info.notes["ball"]) == (rig, "red rubber")
    options = ("--ball", "table-tennis", "--ball-mass", 0.0026, "--fps", 240)  # a slow motion
    episode, frames, _ = recorded(record, video, *options)
    assert np.allclose(np.diff([frame.stamp_ns for frame in frames]), 1e9 / 240, atol=2)
    assert float(episode.info.notes["measured_hz"]) == pytest.approx(240, abs=0.01)
    assert episode.info.rig == {"ball_diameter_m": 0.04, "ball_mass_kg": 0.0026}
    assert episode.info.notes["ball"] == "table-tennis"


def test_a_real_phone_clip_is_upright_and_at_its_true_rate(record: Record, tmp_path: Path):
    log = tmp_path / "a.mcap"
    clip = real("videos/red_ball_drop_120fps.mp4")
    result = record("--camera", clip, "-o", log)
    assert result.returncode == 0, result.stderr
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
    episode, frames, _ = recorded(record, cut)
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


def test_a_file_that_breaks_off_keeps_its_first_frames(record: Record, tmp_path: Path):
    video = write_video(tmp_path / "a.mkv", CONSTANT, "mjpeg")
    whole = video.read_bytes()
    video.write_bytes(whole[: len(whole) * 2 // 3])
    result = record("--camera", video, "-o", "a.mcap")
    assert result.returncode in (0, 1)
    assert result.stderr.count("\n") == result.returncode
    seen = numbers(read_episode(tmp_path / "a.mcap"))[:-1]
    assert len(seen) >= 20
    assert seen == list(range(len(seen)))


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


def test_a_picture_of_a_forged_size_is_none(refuses: Refuses, tmp_path: Path):
    path = write_jpegs(tmp_path / "forged.avi", 40)
    at = picture(0).index(b"\xff\xc0")
    stated = picture(0)[at : at + 9]
    data = path.read_bytes()
    assert data.count(stated) == 40
    path.write_bytes(data.replace(stated, stated[:5] + b"\x75\x30\x75\x30"))
    refuses(1, "--camera", path, says=str(path))


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
