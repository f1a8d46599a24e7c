"""Films whose rate a user says: streams without a container, and stamps that are not even."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from tests.conftest import Command
from tests.recorders.mjpeg_camera import number_in, picture
from tests.recorders.test_video_file import SIZE, UNEVEN, numbered, write_video
from tunenet_logs.episode import FRAME_NS
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode

BARE = {"a.h264": "libx264", "a.h265": "libx265", "a.y4m": "wrapped_avframe"}


@pytest.mark.parametrize("name", BARE)
def test_a_stream_without_a_container_is_read_at_the_rate_said(tmp_path: Path, name: str):
    path = tmp_path / name
    options = {"x265-params": "log-level=none"} if name == "a.h265" else {}
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(BARE[name], rate=60, options=options)
        (stream.width, stream.height), stream.pix_fmt = SIZE, "yuv420p"
        for number in range(20):
            container.mux(
                stream.encode(av.VideoFrame.from_ndarray(numbered(number), format="rgb24"))
            )
        container.mux(stream.encode())
    for rate_hz in (None, 240.0):
        episode = read_episode(path, ReadOptions(fps=rate_hz))
        frames = list(episode.frames())
        assert [number_in(frame.decode()) for frame in frames] == list(range(20))
        stamps_ns = np.array([frame.stamp_ns for frame in frames])
        assert np.allclose(np.diff(stamps_ns), 1e9 / (rate_hz or 60), atol=2)  # its header's


def test_a_stream_without_any_rate_counts_frames(command: Command, tmp_path: Path):
    path = tmp_path / "a.mjpeg"
    path.write_bytes(b"".join(picture(number) for number in range(20)))
    episode = read_episode(path)
    assert episode.frames_untimed
    assert episode.info.notes["rate_hz"] == "unknown"
    assert [frame.stamp_ns for frame in episode.frames()] == [n * FRAME_NS for n in range(20)]
    assert not read_episode(path, ReadOptions(fps=50)).frames_untimed
    result = command("tunenet-record", "--camera", path, "-o", tmp_path / "a.mcap")
    assert result.returncode == 1
    assert "add --fps" in result.stderr


def test_the_rate_said_goes_before_uneven_stamps(tmp_path: Path):
    path = write_video(tmp_path / "a.mp4", UNEVEN)
    episode = read_episode(path, ReadOptions(fps=100))
    assert [frame.stamp_ns for frame in episode.frames()] == [
        10_000_000 * number for number in range(len(UNEVEN))
    ]
    assert "100 pictures a second were said" in episode.warnings[0]
