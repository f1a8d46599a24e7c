"""Containers as FFmpeg opens them, recorded as the camera compressed them, and read again."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from tests.recorders.films import numbers, pixels_of, recorded, write_video
from tests.recorders.live_wait import LAST_RESORT_S, wait_until
from tests.recorders.mjpeg_camera import number_in
from tunenet_logs.episode import Frame
from tunenet_logs.messages import CAMERA_TOPIC, VIDEO_TOPIC
from tunenet_logs.recorders.camera import reading
from tunenet_logs.recorders.camera.base import CapturedFrame
from tunenet_logs.recorders.camera.reading import Transcoded
from tunenet_logs.recorders.camera.streams import PacketStream, head_of
from tunenet_logs.recorders.local_page import PreviewVideo

FRAMES, RATE_HZ = 60, 50
X264: dict[str, Any] = {"preset": "ultrafast", "tune": "zerolatency"}
X265: dict[str, Any] = {"x265-params": "log-level=none:bframes=0:keyint=10"}
# By the film's name, which says the container: FFmpeg's encoder and its options.
FILMS: dict[str, tuple[str, dict[str, Any]]] = {
    "h264.mp4": ("libx264", X264),
    "h264.ts": ("libx264", X264),
    "b_frames.mp4": ("libx264", {"preset": "veryfast", "bf": "2"}),
    "h265.mp4": ("libx265", X265),
    "h265.mkv": ("libx265", X265),
    "vp9.webm": ("libvpx-vp9", {"cpu-used": "8", "lag-in-frames": "0"}),
    "mpeg4.avi": ("mpeg4", {}),
    "jpegs.mkv": ("mjpeg", {}),
}


def written(folder: Path, name: str) -> Path:
    """A film of numbered pictures, every tenth of which stands alone."""
    codec, coding = FILMS[name]
    return write_video(folder / name, range(FRAMES), codec, ticks_hz=RATE_HZ, g="10", **coding)


def opened(path: Path) -> PacketStream:
    return PacketStream(av.open(str(path)), path.name, LAST_RESORT_S)


@pytest.mark.parametrize("name", list(FILMS)[:6])
def test_a_log_of_packets_holds_the_pictures_of_the_film(tmp_path: Path, name: str):
    path = written(tmp_path, name)
    summary, episode = recorded(opened(path), tmp_path / "a.mcap")
    assert (summary.captured, summary.dropped) == (FRAMES, 0)
    assert episode.picture_topics == (VIDEO_TOPIC,)
    frames = list(episode.frames())
    assert [frame.decode().tobytes() for frame in frames] == list(pixels_of(path))
    counts_ms = name.endswith(("mkv", "webm"))
    off_ns = np.diff([frame.stamp_ns for frame in frames]) - 1e9 / RATE_HZ
    assert np.abs(off_ns).max() < 2e4 + 1.2e6 * counts_ms
    assert summary.rate_hz == pytest.approx(RATE_HZ, rel=0.02)
    assert ("b_frames" in episode.info.notes) == (name == "b_frames.mp4")


@pytest.mark.parametrize("name", ["h264.mp4", "h265.mkv", "mpeg4.avi", "jpegs.mkv"])
def test_what_a_log_cannot_hold_and_what_shall_not_stay_becomes_jpegs(tmp_path: Path, name: str):
    source = Transcoded(opened(written(tmp_path, name)))
    summary, episode = recorded(source, tmp_path / "a.mcap")
    assert (summary.captured, summary.written, summary.damaged) == (FRAMES, FRAMES, 0)
    assert episode.picture_topics == (CAMERA_TOPIC,)
    frames = list(episode.frames())
    assert {frame.encoding for frame in frames} == {"jpeg"}
    assert numbers(episode) == list(range(FRAMES))
    assert np.allclose(np.diff([frame.stamp_ns for frame in frames]), 1e9 / RATE_HZ, atol=1.2e6)


def test_jpegs_stay_as_they_are(tmp_path: Path):
    path = written(tmp_path, "jpegs.mkv")
    _, episode = recorded(opened(path), tmp_path / "a.mcap")
    with av.open(str(path)) as container:
        sent = [bytes(packet) for packet in container.demux(video=0) if packet.size]
    assert [frame.data for frame in episode.frames()] == sent


@pytest.mark.parametrize("name", ["h264.mp4", "h264.ts", "h265.mp4"])
def test_every_key_frame_carries_what_a_decoder_needs(tmp_path: Path, name: str):
    shots = list(opened(written(tmp_path, name)).frames())
    keys = [number for number, shot in enumerate(shots) if shot.stands_alone]
    assert keys == list(range(0, FRAMES, 10))
    for number in keys:
        stands_alone, parameters = head_of(shots[number].frame.data, shots[number].frame.encoding)
        assert stands_alone
        assert parameters
    assert all(shot.frame.data.startswith((b"\0\0\1", b"\0\0\0\1")) for shot in shots)


def test_a_damaged_picture_is_left_out_with_those_made_from_it(tmp_path: Path):
    container = av.open(str(written(tmp_path, "h264.mp4")))
    base = container.streams.video[0].time_base
    assert base is not None
    lost = {round(number / RATE_HZ / base) for number in (25, 47)}
    source = PacketStream(container, "a", LAST_RESORT_S, is_damaged=lost.__contains__)
    summary, episode = recorded(source, tmp_path / "a.mcap")
    kept = [*range(25), *range(30, 47), *range(50, 60)]
    assert numbers(episode) == kept
    assert summary.damaged == episode.info.counts["damaged"] == FRAMES - len(kept)


@pytest.mark.parametrize(("torn", "missing"), [(18, [18, 19]), (20, [*range(20, 30)])])
def test_of_a_torn_picture_in_mpeg_ts_neither_it_nor_the_one_before_is_mistaken(
    tmp_path: Path, torn: int, missing: list[int]
):
    whole = written(tmp_path, "h264.ts").read_bytes()
    packets = re.findall(rb"G.{187}", whole, re.DOTALL)
    starts = [at for at, packet in enumerate(packets) if packet[1:3] == b"\x41\0"]  # of pictures
    assert len(starts) == FRAMES
    inside = starts[torn] + 1
    assert packets[inside][1:3] == b"\x01\0"
    path = tmp_path / "a.ts"
    path.write_bytes(b"".join(packets[:inside] + packets[inside + 1 :]))
    source = opened(path)
    stamps_ns = np.array([shot.source_stamp_ns for shot in source.frames()])
    seen = np.round((stamps_ns - stamps_ns[0]) * RATE_HZ / 1e9)
    assert set(range(FRAMES)) - set(seen) == set(missing)
    assert source.damaged == len(missing)


def test_a_container_without_times_is_stamped_by_arrival(tmp_path: Path):
    path = tmp_path / "a.h264"
    with av.open(str(written(tmp_path, "h264.ts"))) as container:
        path.write_bytes(b"".join(bytes(packet) for packet in container.demux(video=0)))
    shots = list(opened(path).frames())
    assert len(shots) == FRAMES
    assert {shot.source_stamp_ns for shot in shots} == {None}


# ---- Video that becomes JPEGs beside the thread that reads it; what is too much is counted


class Held(PacketStream):
    """Falls silent after some pictures until it is let go."""

    def __init__(self, path: Path, shown: int) -> None:
        super().__init__(av.open(str(path)), path.name, LAST_RESORT_S)
        self.go_on = threading.Event()
        self._shown = shown

    def decoder(self) -> av.VideoCodecContext:
        one = super().decoder()
        one.thread_count = 1  # each more would hold back a picture
        return one

    def frames(self) -> Iterator[CapturedFrame]:
        for number, shot in enumerate(super().frames()):
            if number == self._shown:
                self.go_on.wait(LAST_RESORT_S)
            yield shot


def test_what_does_not_fit_is_dropped_up_to_the_next_key_frame_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = written(tmp_path, "h264.mp4")
    sizes = [len(shot.frame.data) for shot in opened(path).frames()]
    monkeypatch.setattr(reading, "_MAX_WAITING_BYTES", sum(sizes[1:15]))
    source = Held(path, 1)
    made = Transcoded(source)
    shots = made.frames()
    seen = [next(shots)]  # held by whoever looks at it, while all others come
    source.go_on.set()
    wait_until(lambda: made._reader.queue.captured == FRAMES, "all packets come")
    seen += list(shots)
    kept = [number_in(shot.frame.decode()) for shot in seen]
    assert kept == list(range(len(kept)))
    assert 10 < len(kept) <= 20
    assert (made.dropped, made.damaged) == (FRAMES - len(kept), 0)


def test_what_still_waits_at_the_end_is_counted(tmp_path: Path):
    made = Transcoded(opened(written(tmp_path, "h264.mp4")))
    shots = made.frames()
    next(shots)
    wait_until(lambda: made._reader.queue.captured == FRAMES, "all packets come")
    shots.close()  # type: ignore[attr-defined]
    assert made.dropped == FRAMES


def test_a_decoder_s_word_on_damage_is_counted(tmp_path: Path):
    class Damaged(PacketStream):
        def frames(self) -> Iterator[CapturedFrame]:
            for number, shot in enumerate(super().frames()):
                broken = Frame(shot.frame.stamp_ns, "h264", b"\0\0\1\x65" + b"\xa5" * 50)
                yield shot._replace(frame=broken) if number == 30 else shot

    path = written(tmp_path, "h264.mp4")
    source = Transcoded(Damaged(av.open(str(path)), "a", LAST_RESORT_S))
    summary, _ = recorded(source, tmp_path / "a.mcap")
    assert summary.damaged > 0
    assert summary.written + summary.damaged + summary.dropped == FRAMES


def test_a_viewer_sees_a_few_pictures_of_a_video(tmp_path: Path):
    shots = list(opened(written(tmp_path, "h264.mp4")).frames())
    shown: list[Frame] = []
    video = PreviewVideo(shown.append)
    video.start()
    try:
        for shot in shots:
            video.offer(shot.frame)
        wait_until(lambda: bool(shown), "a picture")
        assert shown[0].encoding == "jpeg"
        assert number_in(shown[0].decode()) == 0
        video.skip()  # nobody looked for a while
        count = len(shown)
        for shot in shots[25:30]:
            video.offer(shot.frame)

        def is_shown_another() -> bool:
            for shot in shots[30:]:
                video.offer(shot.frame)
            return len(shown) > count

        wait_until(is_shown_another, "a picture after a pause")
        assert number_in(shown[-1].decode()) >= 30  # from the next key frame on
    finally:
        video.close()
        video.join(LAST_RESORT_S)
    assert not video.is_alive()
