"""The pictures of a recording as a page shows them: few, small, and at their own time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.recorders.test_video_file import write_video
from tunenet_logs.analysis.tracking import picker as thumbnails
from tunenet_logs.analysis.tracking.picker import album_of
from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame
from tunenet_logs.errors import UsageError
from tunenet_logs.reader import read_episode


def picture(width: int = 64, height: int = 48, quality: int = 90) -> bytes:
    pixels = np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)
    return cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def episode_of(frames: list[Frame]) -> Episode:
    stamps = [frame.stamp_ns for frame in frames]
    channel = Channel("/eye", "", "", np.array(stamps), pictures=True)
    return Episode(EpisodeInfo(), {}, (channel,), open_frames=lambda _topic: iter(frames))


def test_long_recordings_are_thinned_evenly(monkeypatch: pytest.MonkeyPatch):
    data = picture()
    monkeypatch.setattr(thumbnails, "MAX_BYTES", 20 * len(data))
    frames = [Frame(10**9 + number * 10**7, "jpeg", data) for number in range(500)]
    kept = album_of(episode_of(frames), "/eye")
    seconds = [thumbnail.seconds for thumbnail in kept.thumbnails]
    assert 10 <= len(seconds) <= 20
    assert seconds[0] == 0
    assert np.ptp(np.diff(seconds)) < 1e-9


def test_a_video_is_made_smaller_and_its_marks_are_not(tmp_path: Path):
    stamps = [number * 10 for number in range(350)]
    path = write_video(tmp_path / "a.mp4", stamps)
    video = read_episode(path)
    kept = album_of(video, "video")
    assert 150 <= len(kept.thumbnails) <= thumbnails.MAX_REDUCED
    assert all(thumbnail.data.startswith(b"\xff\xd8") for thumbnail in kept.thumbnails)
    pixels = np.zeros((1000, 2000, 3), np.uint8)
    large = Frame(0, "rgb8", pixels.tobytes(), (2000, 1000))
    kept = album_of(episode_of([large]), "/eye")
    assert kept.size_px == (2000, 1000)
    shown = cv2.imdecode(np.frombuffer(kept.thumbnails[0].data, np.uint8), cv2.IMREAD_COLOR)
    assert shown is not None
    assert shown.shape == (480, 960, 3)
    heavy = Frame(0, "jpeg", picture(1200, 900, quality=100))
    (thumbnail,) = album_of(episode_of([heavy]), "/eye").thumbnails
    assert len(thumbnail.data) < len(heavy.data)


def test_what_cannot_be_shown_is_left_out():
    whole = picture()
    good = Frame(0, "jpeg", whole)
    frames = [
        Frame(0, "jpeg", b"none"),
        replace(good, stamp_ns=10**9),
        Frame(2 * 10**9, "jpeg", whole[:-200]),  # cut off
        replace(good, stamp_ns=10**9),  # time stands still
        Frame(3 * 10**9, "jpeg", picture(32, 32)),  # of another size
        Frame(4 * 10**9, "jpeg", whole[:30]),
        replace(good, stamp_ns=5 * 10**9),
    ]
    kept = album_of(episode_of(frames), "/eye")
    assert [thumbnail.seconds for thumbnail in kept.thumbnails] == [1, 5]
    kept = album_of(episode_of(frames), "/eye", start_s=0.5, end_s=4.5)
    assert [thumbnail.seconds for thumbnail in kept.thumbnails] == [1]
    with pytest.raises(UsageError, match="no picture"):
        album_of(episode_of(frames[:1]), "/eye")
