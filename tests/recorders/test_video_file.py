"""Video files: every frame at its own time, its bytes kept where it is a JPEG."""

from __future__ import annotations

import wave
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from tests.conftest import Command, real
from tests.recorders.mjpeg_camera import number_in, picture
from tunenet_logs.images import image_size
from tunenet_logs.reader import read_episode
from tunenet_logs.video import open_video

SIZE = (320, 240)


def numbered(number: int) -> np.ndarray:
    """RGB pixels that hold a number, as blocks that survive a video codec."""
    width, height = SIZE
    pixels = np.full((height, width, 3), (200, 40, 90), np.uint8)
    for bit in range(16):
        pixels[:16, bit * 16 : bit * 16 + 16] = 255 if number >> bit & 1 else 0
    return pixels


def write_video(
    path: Path, ticks: list[int], codec: str = "libx264", tags: dict[str, str] | None = None
) -> Path:
    """A video with a frame at each tick [1/600 s]."""
    with av.open(str(path), "w") as container:
        container.metadata.update(tags or {})
        stream: Any = container.add_stream(codec, rate=60, time_base=Fraction(1, 600))
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        stream.codec_context.time_base = Fraction(1, 600)
        for number, tick in enumerate(ticks):
            frame = av.VideoFrame.from_ndarray(numbered(number), format="rgb24")
            frame.pts, frame.time_base = tick, Fraction(1, 600)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def write_jpegs(path: Path, count: int) -> Path:
    """A video that holds given JPEGs as its packets, as a webcam's file does."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("mjpeg", rate=60)
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuvj420p"
        for number in range(count):
            packet = av.Packet(picture(number))
            packet.stream, packet.pts, packet.dts = stream, number, number
            packet.time_base = Fraction(1, 60)
            container.mux(packet)
    return path


def recorded(command: Command, video: Path, *options: object):
    log = video.parent / "a.mcap"
    words = ("tunenet-record", "--camera", video, "-o", log, "--overwrite")
    result = command(*words, *options)
    assert result.returncode == 0, result.stderr
    assert not result.stderr
    episode = read_episode(log)
    assert not episode.warnings
    return episode, list(episode.frames()), result.stdout


CONSTANT = list(range(0, 600, 10))
UNEVEN = [0, 10, 20, 35, 40, 70, 80, 90, 200, 210, 215]


@pytest.mark.parametrize("name", ["a.mp4", "a.mkv"])
@pytest.mark.parametrize("ticks", [CONSTANT, UNEVEN])
def test_frames_keep_their_order_and_times(
    command: Command, tmp_path: Path, name: str, ticks: list[int]
):
    episode, frames, out = recorded(command, write_video(tmp_path / name, ticks))
    assert [number_in(frame.decode()) for frame in frames] == list(range(len(ticks)))
    stamps_ns = np.array([frame.stamp_ns for frame in frames])
    tolerance_ns = 600_000 if name == "a.mkv" else 2  # Matroska counts milliseconds
    assert np.allclose(stamps_ns, np.array(ticks) / 600 * 1e9, atol=tolerance_ns, rtol=0)
    assert all(frame.encoding == "jpeg" for frame in frames)
    assert episode.info.counts == {"captured": len(ticks), "written": len(ticks), "dropped": 0}
    assert episode.info.source == f"video file {name}"
    assert episode.info.kind == "drop"
    assert "ended" not in episode.info.notes
    assert f"{len(ticks)} frames captured, {len(ticks)} written, 0 dropped" in out


def test_what_a_phone_cut_off_is_not_shown_and_shifts_no_stamp(command: Command, tmp_path: Path):
    """It cuts without compressing anew: the pictures stay, those before the cut unshown."""
    whole, cut = write_video(tmp_path / "a.mp4", UNEVEN), tmp_path / "cut.mp4"
    with av.open(str(whole)) as source, av.open(str(cut), "w") as container:
        stream = container.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None and packet.pts is not None and packet.time_base is not None:
                moved = round(35 / 600 / packet.time_base)
                packet.pts, packet.dts = packet.pts - moved, packet.dts - moved
                packet.stream = stream
                container.mux(packet)
    _, frames, _ = recorded(command, cut)
    assert [number_in(frame.decode()) for frame in frames] == list(range(3, len(UNEVEN)))
    stamps_ns = np.array([frame.stamp_ns for frame in frames])
    assert np.allclose(stamps_ns, (np.array(UNEVEN[3:]) - 35) / 600 * 1e9, atol=2, rtol=0)
    assert read_episode(cut).channels[0].messages == len(frames)


@pytest.mark.parametrize("name", ["a.avi", "a.mkv"])
def test_a_cameras_own_jpegs_stay_byte_for_byte(command: Command, tmp_path: Path, name: str):
    _, frames, _ = recorded(command, write_jpegs(tmp_path / name, 40))
    assert [frame.data for frame in frames] == [picture(number) for number in range(40)]


@pytest.mark.parametrize("codec", ["libx264", "mjpeg"])
def test_recording_a_file_twice_gives_the_same_bytes(command: Command, tmp_path: Path, codec: str):
    video = write_video(tmp_path / "a.mkv", CONSTANT, codec)
    recorded(command, video)
    first = (tmp_path / "a.mcap").read_bytes()
    recorded(command, video)
    assert (tmp_path / "a.mcap").read_bytes() == first
    assert str(tmp_path).encode() not in first


def test_the_colours_survive_at_full_resolution(command: Command, tmp_path: Path):
    _, frames, _ = recorded(command, write_video(tmp_path / "a.mp4", CONSTANT))
    stored = next(open_video(tmp_path / "a.mp4").frames()).decode()
    off = frames[0].decode().astype(int) - stored
    assert np.sqrt(np.mean(off**2)) < 2


def test_the_users_rate_stretches_a_slow_motion(command: Command, tmp_path: Path):
    video = write_video(tmp_path / "a.mp4", CONSTANT)
    episode, frames, _ = recorded(command, video, "--fps", 240)
    assert np.allclose(np.diff([frame.stamp_ns for frame in frames]), 1e9 / 240, atol=2)
    assert float(episode.info.notes["measured_hz"]) == pytest.approx(240, abs=0.01)


def test_so_many_seconds_of_a_file(command: Command, tmp_path: Path):
    _, frames, _ = recorded(command, write_video(tmp_path / "a.mp4", CONSTANT), "--seconds", 0.5)
    assert len(frames) == 30


def test_what_is_known_of_the_ball_goes_into_the_log(command: Command, tmp_path: Path):
    options = ("--ball", "red rubber", "--ball-diameter", 0.04, "--ball-mass", 0.02)
    video = write_video(tmp_path / "a.mp4", CONSTANT)
    episode, _, _ = recorded(command, video, *options, "--drop-height", 1.5)
    rig = {"ball_diameter_m": 0.04, "ball_mass_kg": 0.02, "drop_height_m": 1.5}
    assert episode.info.rig == rig
    assert episode.info.notes["ball"] == "red rubber"


def test_a_ball_of_the_table_is_known_by_its_name(command: Command, tmp_path: Path):
    video = write_video(tmp_path / "a.mp4", CONSTANT)
    options = ("--ball", "table-tennis", "--ball-mass", 0.0026)
    episode, _, _ = recorded(command, video, *options)
    assert episode.info.rig == {"ball_diameter_m": 0.04, "ball_mass_kg": 0.0026}
    assert episode.info.notes["ball"] == "table-tennis"


def test_a_real_phone_clip_is_upright_and_at_its_true_rate(command: Command, tmp_path: Path):
    log = tmp_path / "a.mcap"
    clip = real("videos/red_ball_drop_120fps.mp4")
    result = command("tunenet-record", "--camera", clip, "-o", log)
    assert result.returncode == 0, result.stderr
    episode = read_episode(log)
    frames = list(episode.frames())
    assert len(frames) == 327
    assert {image_size(frame.data) for frame in frames} == {(172, 1716)}
    assert float(episode.info.notes["measured_hz"]) == pytest.approx(120, rel=0.001)
    counts = {"captured": 327 + 26, "written": 327 + 26, "dropped": 0}  # and pieces of sound
    assert episode.info.counts == counts
    kept, filmed = (
        [one.stamp_ns for one in each] for each in (frames, read_episode(clip).frames())
    )
    assert np.array_equal(np.array(kept) - kept[0], np.array(filmed) - filmed[0])


def test_one_frame_is_a_recording(command: Command, tmp_path: Path):
    episode, frames, _ = recorded(command, write_video(tmp_path / "a.mp4", [0]))
    assert len(frames) == 1
    assert "measured_hz" not in episode.info.notes


def forged_size(path: Path) -> None:
    """A file whose pictures claim 30000 x 30000 px."""
    write_jpegs(path, 40)
    at = picture(0).index(b"\xff\xc0")
    stated = picture(0)[at : at + 9]
    data = path.read_bytes()
    assert data.count(stated) == 40
    path.write_bytes(data.replace(stated, stated[:5] + b"\x75\x30\x75\x30"))


def sound(path: Path) -> None:
    with wave.open(str(path), "wb") as file:
        file.setparams((1, 2, 8000, 0, "NONE", ""))
        file.writeframes(bytes(16_000))


BAD = {
    "missing.mp4": lambda path: None,
    "empty.mp4": lambda path: path.touch(),
    "folder.mp4": lambda path: path.mkdir(),
    "text.mp4": lambda path: path.write_text("ball\n" * 1000),
    "page.html": lambda path: path.write_text("<html><body>hello</body></html>"),
    "sound.wav": sound,
    "noise.mp4": lambda path: path.write_bytes(np.random.default_rng(0).bytes(50_000)),
    "forged.avi": forged_size,
    "cut.mp4": lambda path: path.write_bytes(
        write_video(path, CONSTANT).read_bytes()[: path.stat().st_size // 2]
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_video_is_one_line_that_names_it(command: Command, tmp_path: Path, name: str):
    folder = tmp_path / "out"
    folder.mkdir()
    BAD[name](tmp_path / name)
    result = command("tunenet-record", "--camera", tmp_path / name, cwd=folder)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert str(tmp_path / name) in result.stderr
    assert not list(folder.iterdir())


def test_sound_alone_is_sent_to_where_it_is_tuned(command: Command, tmp_path: Path):
    sound(tmp_path / "bounce.wav")
    result = command("tunenet-record", "--camera", tmp_path / "bounce.wav", cwd=tmp_path)
    assert result.returncode == 1
    assert "is sound alone" in result.stderr
    assert result.stderr.endswith(f"tunenet-tune {tmp_path / 'bounce.wav'}\n")


def test_a_file_that_breaks_off_keeps_its_first_frames(command: Command, tmp_path: Path):
    video = write_video(tmp_path / "a.mkv", CONSTANT, "mjpeg")
    whole = video.read_bytes()
    video.write_bytes(whole[: len(whole) * 2 // 3])
    log = tmp_path / "a.mcap"
    result = command("tunenet-record", "--camera", video, "-o", log)
    assert result.returncode in (0, 1)
    assert result.stderr.count("\n") == result.returncode
    frames = list(read_episode(log).frames())
    assert len(frames) > 20
    assert [number_in(frame.decode()) for frame in frames[:-1]] == list(range(len(frames) - 1))


def test_pictures_behind_damaged_ones_keep_their_times(tmp_path: Path):
    path = tmp_path / "a.mp4"
    wall = np.random.default_rng(0).integers(0, 255, (180, 320, 3))
    with av.open(str(path), "w") as file:
        stream = file.add_stream("mpeg4", rate=60, options={"g": "10"})
        (stream.width, stream.height), stream.pix_fmt = SIZE, "yuv420p"
        for number in range(60):
            pixels = numbered(number)
            pixels[60:] = np.roll(wall, number, axis=1)  # or a packet is too small to be hurt
            file.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        file.mux(stream.encode())

    def stamps_ns() -> dict[int, int]:
        frames = read_episode(path).frames("video")
        return {number_in(frame.decode()): frame.stamp_ns for frame in frames}

    whole = stamps_ns()
    with av.open(str(path)) as file:
        packets = [one for one in file.demux(file.streams.video[0]) if one.size]
        at, size = packets[22].pos, packets[22].size
    assert at is not None
    data = bytearray(path.read_bytes())
    data[at + size // 2 : at + size // 2 + 20] = bytes(20)
    path.write_bytes(data)
    left = stamps_ns()
    assert left == {number: whole[number] for number in range(60) if not 22 <= number < 30}


def test_pictures_before_a_phones_cut_are_none(tmp_path: Path):
    """They stay in the file, for later ones are made from them; its edit list hides them."""
    whole, cut = write_video(tmp_path / "a.mp4", CONSTANT), tmp_path / "b.mp4"
    with (
        av.open(str(whole)) as source,
        av.open(str(cut), "w", options={"avoid_negative_ts": "disabled"}) as target,
    ):
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.pts is None or packet.dts is None:
                continue
            shift = int(10 * 10 / 600 / packet.time_base)
            packet.pts, packet.dts = packet.pts - shift, packet.dts - shift
            packet.stream = stream
            target.mux(packet)
    video = open_video(cut)
    frames = list(video.frames())
    assert len(video.clock.stamps_ns) == len(frames) == 50
    assert [number_in(frame.decode()) for frame in frames] == list(range(10, 60))


def test_a_cut_where_pictures_need_others_begins_at_the_first_whole_one(tmp_path: Path):
    """A picture's time tells which it is, so that none takes the time of one that is missing."""
    whole, cut = tmp_path / "a.mkv", tmp_path / "b.mkv"
    with av.open(str(whole), "w") as container:
        stream: Any = container.add_stream("libx264", rate=60, options={"g": "6", "bf": "0"})
        (stream.width, stream.height), stream.pix_fmt = SIZE, "yuv420p"
        for number in range(30):
            container.mux(
                stream.encode(av.VideoFrame.from_ndarray(numbered(number), format="rgb24"))
            )
        container.mux(stream.encode())
    with av.open(str(whole)) as source, av.open(str(cut), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in [one for one in source.demux(video=0) if one.size][3:]:
            packet.stream = stream
            target.mux(packet)
    episode = read_episode(cut)
    frames = list(episode.frames())
    assert [number_in(frame.decode()) for frame in frames] == list(range(6, 30))
    assert episode.channels[0].messages == len(frames)
    assert "its first 3 pictures need others that were cut off" in episode.warnings
