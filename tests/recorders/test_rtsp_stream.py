"""An RTSP camera over a real socket."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Command
from tests.recorders.live_wait import LAST_RESORT_S
from tests.recorders.mjpeg_camera import number_in, times_in
from tests.recorders.rtsp_camera import rtsp_camera
from tests.recorders.test_video_file import numbered
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.recording import Limits, record_camera
from tunenet_logs.recorders.camera.sources import open_source
from tunenet_logs.terminal import Progress
from tunenet_logs.timing.stamps import now_ns

pytestmark = pytest.mark.live

RATE_HZ = 50
FRAMES = 40
STALL_S = 1.0


@pytest.mark.parametrize("stall", [False, True])
def test_its_frames_arrive_in_order_at_their_times(tmp_path: Path, stall: bool):
    started_ns = now_ns()
    pictures = [numbered(number) for number in range(FRAMES)]
    with rtsp_camera(pictures, RATE_HZ, stall=stall) as address:
        timeout_s = STALL_S if stall else LAST_RESORT_S
        summary = record_camera(
            open_source(f"rtsp://me:secret@{address}", CameraOptions(stall_s=timeout_s)),
            EpisodeInfo(kind="drop"),
            tmp_path / "a.mcap",
            limits=Limits(stall_s=LAST_RESORT_S),
            overwrite=False,
            progress=Progress(quiet=True),
        )
    episode = read_episode(tmp_path / "a.mcap")
    frames = list(episode.frames())
    seen = [number_in(frame.decode()) for frame in frames]
    assert seen == list(range(FRAMES))
    stamps_ns = np.array([frame.stamp_ns for frame in frames])
    assert np.allclose(np.diff(stamps_ns), 1e9 / RATE_HZ, atol=1)
    _, received_ns = times_in(tmp_path / "a.mcap")[-1]
    # The last may be looked at too late to place the clock: they came before they were due.
    assert started_ns < stamps_ns[-1] <= received_ns + 1e9 / RATE_HZ
    assert summary.ended == (
        f"no data for {STALL_S} s" if stall else "the stream was closed by the camera"
    )
    assert "secret" not in str(episode.info.to_strings())
    assert episode.info.notes["codec"] == "h264"
    assert episode.info.source == f"camera rtsp://{address}"


def test_a_camera_without_frames_is_one_line(command: Command, tmp_path: Path):
    with rtsp_camera([numbered(0)], RATE_HZ, stall=True) as address:
        url = f"rtsp://me:secret@{address}"
        result = command("tunenet-record", "--camera", url, "--stall", 0.5, "--quiet", cwd=tmp_path)
    assert result.returncode in (0, 1)  # the one frame may or may not come out
    assert result.stderr.count("\n") == result.returncode
    assert "secret" not in result.stderr + result.stdout
