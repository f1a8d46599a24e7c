"""Video from GStreamer's RTSP server, against the film that it plays; and packets that UDP lost."""

from __future__ import annotations

import socket
import struct
from pathlib import Path

import numpy as np
import pytest

from tests.recorders.live_wait import LAST_RESORT_S, wait_until
from tests.recorders.rtsp_servers import file_pictures, gst_rtsp_server
from tests.recorders.test_packet_stream import (
    B_FRAMES,
    FRAMES,
    H265_MP4,
    RATE_HZ,
    Film,
    pixels_of,
    recorded,
)
from tunenet_logs.recorders.camera.network import NetworkOptions, Transport
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.rtsp import RtpPorts
from tunenet_logs.recorders.camera.sources import open_source

pytestmark = pytest.mark.live

TICKS_HZ = 90_000


@pytest.mark.parametrize(
    ("film", "codec", "transport"),
    [(B_FRAMES, "h264", "tcp"), (H265_MP4, "h265", "udp")],
)
def test_a_log_holds_every_picture_at_its_time(
    tmp_path: Path, film: Film, codec: str, transport: Transport
):
    path = film.write(tmp_path)
    with gst_rtsp_server(file_pictures(path, codec)) as address:
        network = NetworkOptions(rtsp_transport=transport)
        source = open_source(f"rtsp://{address}", CameraOptions(stall_s=LAST_RESORT_S), network)
        summary, episode = recorded(source, tmp_path / "a.mcap")
    frames = list(episode.frames())
    assert [frame.data for frame in frames] == list(pixels_of(path))
    assert (summary.captured, summary.damaged, summary.dropped) == (FRAMES, 0, 0)
    off_ns = np.array([frame.stamp_ns for frame in frames]) - frames[0].stamp_ns
    off_ns = off_ns - np.arange(FRAMES) * 1e9 / RATE_HZ
    assert np.ptp(off_ns) < 20_000  # two ticks of RTP's clock
    assert episode.info.notes["stamps"] == "camera"
    assert ("b_frames" in episode.info.notes) == (film == B_FRAMES)


def test_the_pictures_beside_a_loss_are_known():
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname()) as control,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        ports = RtpPorts(control)
        first_ticks = 2**32 - 2 * TICKS_HZ // RATE_HZ  # they begin anew while it runs
        step = TICKS_HZ // RATE_HZ
        lost = {13, 29, 30, 31, 50}  # of packets, three a picture: inside; most of two; an end
        for number in range(60):
            ticks = first_ticks + number // 3 * step & 0xFFFFFFFF
            if number not in lost:
                packet = struct.pack(">BBHII", 0x80, 96, number + 65_530 & 0xFFFF, ticks, 1)
                sender.sendto(packet, ("127.0.0.1", ports.numbers[0]))
        came: list[int] = []

        def have_all_come() -> bool:
            came.extend(channel for channel, _ in ports.packets())
            return len(came) == 60 - len(lost)

        wait_until(have_all_come, "all packets that were sent")
        torn = [number for number in range(20) if ports.is_torn(number * step)]
        assert torn == [4, 9, 10, 16, 17]
        assert ports.lost == len(lost)
        ports.close()
