"""Containers as FFmpeg opens them, recorded as the camera compressed them, and read again."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from tests.recorders.live_wait import LAST_RESORT_S
from tests.recorders.mjpeg_camera import number_in
from tests.recorders.test_video_file import SIZE, numbered
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.messages import CAMERA_TOPIC, VIDEO_TOPIC
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.base import Source
from tunenet_logs.recorders.camera.reading import Transcoded
from tunenet_logs.recorders.camera.recording import Limits, record_camera
from tunenet_logs.recorders.camera.streams import PacketStream, head_of
from tunenet_logs.recorders.session import Summary
from tunenet_logs.terminal import Progress

FRAMES, RATE_HZ = 60, 50
QUIET_265 = {"x265-params": "log-level=none:bframes=0:keyint=10"}


@dataclass(frozen=True)
class Film:
    """How a film of `numbered` pictures is encoded.

    Attributes:
        codec: FFmpeg's encoder.
        name: of the file; its ending says the container.
        options: of the encoder.
    """

    codec: str
    name: str
    options: tuple[tuple[str, str], ...] = ()

    def write(self, folder: Path) -> Path:
        path = folder / self.name
        with av.open(str(path), "w") as container:
            stream: Any = container.add_stream(self.codec, rate=RATE_HZ, options=dict(self.options))
            (stream.width, stream.height), stream.gop_size = SIZE, 10
            stream.pix_fmt = "yuvj420p" if self.codec == "mjpeg" else "yuv420p"
            stream.time_base = Fraction(1, RATE_HZ)
            for number in range(FRAMES):
                frame = av.VideoFrame.from_ndarray(numbered(number), format="rgb24")
                frame.pts = number
                container.mux(stream.encode(frame))
            container.mux(stream.encode())
        return path


X264 = (("preset", "ultrafast"), ("tune", "zerolatency"))
H264_MP4, H264_TS = Film("libx264", "a.mp4", X264), Film("libx264", "a.ts", X264)
B_FRAMES = Film("libx264", "b.mp4", (("preset", "veryfast"), ("bf", "2")))
H265_MP4 = Film("libx265", "a.mp4", tuple(QUIET_265.items()))
H265_MKV = Film("libx265", "a.mkv", tuple(QUIET_265.items()))
VP9_MKV = Film("libvpx-vp9", "a.webm", (("cpu-used", "8"), ("lag-in-frames", "0")))
MPEG4, MJPEG = Film("mpeg4", "a.avi"), Film("mjpeg", "a.mkv")


def opened(path: Path) -> PacketStream:
    return PacketStream(av.open(str(path)), path.name, LAST_RESORT_S)


def recorded(source: Source, path: Path) -> tuple[Summary, Episode]:
    summary = record_camera(
        source,
        EpisodeInfo(kind="drop"),
        path,
        limits=Limits(stall_s=LAST_RESORT_S),
        overwrite=False,
        progress=Progress(quiet=True),
    )
    return summary, read_episode(path)


def pixels_of(path: Path) -> Iterator[bytes]:
    with av.open(str(path)) as container:
        for picture in container.decode(video=0):
            yield picture.to_ndarray(format="rgb24").tobytes()


@pytest.mark.parametrize("film", [H264_MP4, H264_TS, B_FRAMES, H265_MP4, H265_MKV, VP9_MKV])
def test_a_log_of_packets_holds_the_pictures_of_the_film(tmp_path: Path, film: Film):
    path = film.write(tmp_path)
    summary, episode = recorded(opened(path), tmp_path / "a.mcap")
    assert (summary.captured, summary.written, summary.dropped) == (FRAMES, FRAMES, 0)
    assert episode.picture_topics == (VIDEO_TOPIC,)
    assert not episode.warnings
    frames = list(episode.frames())
    assert [frame.decode().tobytes() for frame in frames] == list(pixels_of(path))
    stamps_ns = np.array([frame.stamp_ns for frame in frames])
    assert (
        np.abs(np.diff(stamps_ns) - 1e9 / RATE_HZ).max()
        < 1.2e6
        * film.name.endswith(
            ("mkv", "webm")  # which count milliseconds
        )
        + 2e4
    )
    assert summary.rate_hz == pytest.approx(RATE_HZ, rel=0.02)
    assert ("b_frames" in episode.info.notes) == (film == B_FRAMES)


@pytest.mark.parametrize("film", [H264_MP4, H265_MKV, MPEG4, MJPEG])
def test_what_a_log_cannot_hold_and_what_shall_not_stay_becomes_jpegs(tmp_path: Path, film: Film):
    source = Transcoded(opened(film.write(tmp_path)))
    summary, episode = recorded(source, tmp_path / "a.mcap")
    assert (summary.captured, summary.written, summary.damaged) == (FRAMES, FRAMES, 0)
    assert episode.picture_topics == (CAMERA_TOPIC,)
    frames = list(episode.frames())
    assert {frame.encoding for frame in frames} == {"jpeg"}
    assert [number_in(frame.decode()) for frame in frames] == list(range(FRAMES))
    assert np.allclose(np.diff([frame.stamp_ns for frame in frames]), 1e9 / RATE_HZ, atol=1.2e6)


def test_jpegs_stay_as_they_are(tmp_path: Path):
    path = MJPEG.write(tmp_path)
    _, episode = recorded(opened(path), tmp_path / "a.mcap")
    with av.open(str(path)) as container:
        sent = [bytes(packet) for packet in container.demux(video=0) if packet.size]
    assert [frame.data for frame in episode.frames()] == sent


@pytest.mark.parametrize("film", [H264_MP4, H264_TS, H265_MP4])
def test_every_key_frame_carries_what_a_decoder_needs(tmp_path: Path, film: Film):
    shots = list(opened(film.write(tmp_path)).frames())
    keys = [number for number, shot in enumerate(shots) if shot.stands_alone]
    assert keys == list(range(0, FRAMES, 10))
    for number in keys:
        stands_alone, parameter_sets = head_of(
            shots[number].frame.data, shots[number].frame.encoding
        )
        assert stands_alone
        assert parameter_sets
    assert all(shot.frame.data.startswith((b"\0\0\1", b"\0\0\0\1")) for shot in shots)


def test_a_damaged_picture_is_left_out_with_those_made_from_it(tmp_path: Path):
    path = H264_MP4.write(tmp_path)
    container = av.open(str(path))
    base = container.streams.video[0].time_base
    assert base is not None
    lost = {round(number / RATE_HZ / base) for number in (25, 47)}
    source = PacketStream(container, "a", LAST_RESORT_S, is_damaged=lost.__contains__)
    summary, episode = recorded(source, tmp_path / "a.mcap")
    kept = [*range(25), *range(30, 47), *range(50, 60)]
    assert [number_in(frame.decode()) for frame in episode.frames()] == kept
    assert summary.damaged == FRAMES - len(kept)
    assert episode.info.counts["damaged"] == FRAMES - len(kept)


@pytest.mark.parametrize(("torn", "missing"), [(18, [18, 19]), (20, [*range(20, 30)])])
def test_of_a_torn_picture_in_mpeg_ts_neither_it_nor_the_one_before_is_mistaken(
    tmp_path: Path, torn: int, missing: list[int]
):
    path = tmp_path / "a.ts"
    packets = re.findall(rb"G.{187}", H264_TS.write(tmp_path).read_bytes(), re.DOTALL)
    starts = [at for at, packet in enumerate(packets) if packet[1:3] == b"\x41\0"]  # of pictures
    assert len(starts) == FRAMES
    inside = starts[torn] + 1
    assert packets[inside][1:3] == b"\x01\0"
    path.write_bytes(b"".join(packets[:inside] + packets[inside + 1 :]))
    source = opened(path)
    source_stamp_ns = np.array([shot.source_stamp_ns for shot in source.frames()])
    numbers = np.round((source_stamp_ns - source_stamp_ns[0]) * RATE_HZ / 1e9)
    assert set(range(FRAMES)) - set(numbers) == set(missing)
    assert source.damaged == len(missing)


def test_a_container_without_times_is_stamped_by_arrival(tmp_path: Path):
    path = tmp_path / "a.h264"
    film = H264_TS.write(tmp_path)
    with av.open(str(film)) as container:
        path.write_bytes(b"".join(bytes(packet) for packet in container.demux(video=0)))
    shots = list(opened(path).frames())
    assert len(shots) == FRAMES
    assert {shot.source_stamp_ns for shot in shots} == {None}


def test_a_picture_without_a_start_code_is_none():
    for data in (b"", b"\0\0\1", b"\0\0\1\x65", b"x" * 100, b"\0\0\1\x67" * 1000):
        assert not head_of(data, "h264")[0]
