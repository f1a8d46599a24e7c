"""RTSP cameras: every picture at its time, over TCP and UDP; and what is lost is known."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.recorders.conftest import Record, Refuses
from tests.recorders.films import PATIENT, numbered, numbers, pixels_of, recorded, write_video
from tests.recorders.live_wait import LAST_RESORT_S, wait_until
from tests.recorders.mjpeg_camera import times_in
from tests.recorders.programs import file_pictures, gst_rtsp_server
from tests.recorders.servers import SDP, rtsp_camera
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.network import NetworkOptions
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.rtsp import Description, FragmentJoiner, RtpPorts
from tunenet_logs.recorders.camera.sources import open_source
from tunenet_logs.timing.stamps import now_ns

live = pytest.mark.live
RATE_HZ, FRAMES, STALL_S = 50, 40, 0.5
TICKS_HZ = 90_000
CAMERA = ("--stall", LAST_RESORT_S, "--seconds", 1, "-o", "a.mcap", "--camera")


@live
@pytest.mark.parametrize("stall", [False, True])
def test_its_frames_arrive_in_order_at_their_times(tmp_path: Path, stall: bool):
    started_ns = now_ns()
    pictures = [numbered(number) for number in range(FRAMES)]
    options = CameraOptions(stall_s=STALL_S) if stall else PATIENT
    with rtsp_camera(pictures, RATE_HZ, stall=stall) as address:
        source = open_source(f"rtsp://me:secret@{address}", options)
        summary, episode = recorded(source, tmp_path / "a.mcap")
    assert numbers(episode) == list(range(FRAMES))
    stamps_ns = np.array([frame.stamp_ns for frame in episode.frames()])
    assert np.allclose(np.diff(stamps_ns), 1e9 / RATE_HZ, atol=1)
    _, received_ns = times_in(tmp_path / "a.mcap")[-1]
    # The last may be looked at too late to place the clock: they came before they were due.
    assert started_ns < stamps_ns[-1] <= received_ns + 1e9 / RATE_HZ
    why = f"no data for {STALL_S} s" if stall else "the stream was closed by the camera"
    assert summary.ended == why
    assert "secret" not in str(episode.info.to_strings())
    assert episode.info.notes["codec"] == "h264"
    assert episode.info.source == f"camera rtsp://{address}"


@live
def test_a_camera_without_frames_is_one_line(record: Record):
    with rtsp_camera([numbered(0)], RATE_HZ, stall=True) as address:
        result = record("--camera", f"rtsp://me:secret@{address}", "--stall", 0.5, "--quiet")
    assert result.returncode in (0, 1)  # the one frame may or may not come out
    assert result.stderr.count("\n") == result.returncode
    assert "secret" not in result.stderr + result.stdout


# ---- GStreamer's server


@live
@pytest.mark.parametrize(
    ("transports", "options", "transport"),
    [
        ("tcp,udp", (), "tcp"),
        ("udp", (), "udp"),
        ("tcp,udp", ("--rtsp-transport", "udp"), "udp"),
        ("tcp", ("--rtsp-transport", "udp"), ""),
        ("udp", ("--rtsp-transport", "tcp"), ""),
    ],
)
def test_packets_come_as_server_and_user_want_it(
    record: Record, refuses: Refuses, tmp_path: Path, transports: str, options, transport: str
):
    with gst_rtsp_server(transports=transports) as address:
        words = (*CAMERA, f"rtsp://{address}", *options)
        if not transport:
            refuses(1, *words, says=f"refuses {options[1].upper()} (461)")
            return
        result = record(*words)
        path = "answers 404 Not Found to DESCRIBE; check the path"
        refuses(1, "--camera", f"rtsp://{address}er", says=path)
    assert result.returncode == 0, result.stderr
    episode = read_episode(tmp_path / "a.mcap")
    assert len(list(episode.frames())) == 30
    assert episode.info.notes["transport"] == transport
    assert "lost_packets" not in episode.info.notes


@live
@pytest.mark.parametrize("transport", ["tcp", "udp"])
def test_a_log_holds_every_picture_at_its_time(tmp_path: Path, transport: Any):
    codec = "h264"
    coding: dict[str, Any] = {"preset": "veryfast", "bf": "2"}
    if transport == "udp":
        codec, coding = "h265", {"x265-params": "log-level=none:bframes=0:keyint=10"}
    path = tmp_path / "a.mp4"
    write_video(path, range(60), codec.replace("h", "libx"), ticks_hz=RATE_HZ, g="10", **coding)
    with gst_rtsp_server(file_pictures(path, codec)) as address:
        source = open_source(f"rtsp://{address}", PATIENT, NetworkOptions(rtsp_transport=transport))
        summary, episode = recorded(source, tmp_path / "a.mcap")
    frames = list(episode.frames())
    assert [frame.data for frame in frames] == list(pixels_of(path))
    assert (summary.captured, summary.damaged, summary.dropped) == (60, 0, 0)
    off_ns = np.array([frame.stamp_ns for frame in frames]) - frames[0].stamp_ns
    assert np.ptp(off_ns - np.arange(60) * 1e9 / RATE_HZ) < 20_000  # two ticks of RTP's clock
    assert episode.info.notes["stamps"] == "camera"
    assert ("b_frames" in episode.info.notes) == (codec == "h264")


# ---- What is lost, and what is said to FFmpeg


def test_the_pictures_beside_a_loss_are_known():
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname()) as control,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        ports = RtpPorts(control)
        step = TICKS_HZ // RATE_HZ
        first_ticks = 2**32 - 2 * step  # they begin anew while it runs
        lost = {13, 29, 30, 31, 50}  # of packets, three a picture: inside; most of two; an end
        for number in set(range(60)) - lost:
            ticks = first_ticks + number // 3 * step & 0xFFFFFFFF
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


def test_a_description_gives_ffmpeg_nothing_that_names_a_place():
    hostile = SDP.replace("s=camera", "s=camera\r\nc=IN IP4 239.0.0.1\r\na=control:rtsp://a.b/c")
    hostile += (
        "a=key-mgmt:x\r\na=fmtp:96 packetization-mode=1\r\na=source-filter: incl IN IP4 * 1\r\n"
    )
    text = Description.of(hostile).text("video")
    assert not any(one in text for one in ("239", "a.b", "source-filter"))
    assert "a=fmtp:96 packetization-mode=1" in text


# ---- Fragments of pictures are put together, and nothing else is changed or hidden

FIRST, LAST = 0x80, 0x40
HEADS = {"H264": b"\x7c", "H265": b"\x62\x01"}  # of a NAL unit that comes in fragments


class Packet(NamedTuple):
    channel: int
    number: int
    ticks: int
    is_marked: bool
    payload: bytes


def wire(packets: list[Packet]) -> memoryview:
    out = bytearray()
    for channel, number, ticks, is_marked, payload in packets:
        rtp = struct.pack(">BBHII", 0x80, 96 | 0x80 * is_marked, number & 0xFFFF, ticks, 7)
        out += struct.pack(">cBH", b"$", channel, len(rtp + payload)) + rtp + payload
    return memoryview(out)


def read(data: bytearray | memoryview) -> Iterator[Packet]:
    at = 0
    while at < len(data):
        dollar, channel, size = struct.unpack_from(">cBH", data, at)
        assert dollar == b"$"
        _, kind, number, ticks, _ = struct.unpack_from(">BBHII", data, at + 4)
        payload = bytes(data[at + 16 : at + 4 + size])
        yield Packet(channel, number, ticks, bool(kind & 0x80), payload)
        at += 4 + size


def joined(packets: list[Packet], joiner: FragmentJoiner | None = None) -> list[Packet]:
    return list(read((joiner or FragmentJoiner("H264", 0)).joined(wire(packets))))


def pieces_of(data: bytes, number: int = 0, ticks: int = 0, coding: str = "H264") -> list[Packet]:
    """One unit in fragments of a thousand bytes."""
    packets: list[Packet] = []
    for at in range(0, len(data), 1000):
        is_last = at + 1000 >= len(data)
        head = HEADS[coding] + bytes((5 | FIRST * (not at) | LAST * is_last,))
        packets.append(Packet(0, number + at // 1000, ticks, is_last, head + data[at : at + 1000]))
    return packets


@pytest.mark.parametrize("coding", ["H264", "H265"])
@pytest.mark.parametrize("begins", [0, 65_530])
def test_a_picture_in_pieces_is_one_packet(coding: str, begins: int):
    data = bytes(range(256)) * 100
    pieces = [one for at in range(3) for one in pieces_of(data, begins + 26 * at, at, coding)]
    joiner = FragmentJoiner(coding, 0)
    whole = joined(pieces[:52], joiner) + joined(pieces[52:], joiner)
    payload = HEADS[coding] + bytes((5 | FIRST,)) + data  # and LAST would be an error
    wanted = [Packet(0, begins + at & 0xFFFF, at, True, payload) for at in range(3)]
    assert whole == wanted


def test_no_packet_is_too_large_and_what_is_lost_stays_missing():
    whole = joined(pieces_of(bytes(200_000)))
    assert len(whole) == 4
    assert max(len(one.payload) for one in whole) < 60_000
    assert b"".join(one.payload[2:] for one in whole) == bytes(200_000)
    assert [one.payload[1] & (FIRST | LAST) for one in whole] == [FIRST, 0, 0, LAST]
    pieces = pieces_of(bytes(5000)) + pieces_of(bytes(5000), 5, 1)
    del pieces[2]
    # after two and two
    assert [(one.number, len(one.payload)) for one in joined(pieces)] == [
        (0, 2002), (2, 2002), (3, 5002),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("channel", "payload"),
    [(1, bytes(20)), (0, b"\x7c"), (0, b"\x09\xf0")],
    ids=["a report", "cut off", "a whole unit"],
)
def test_what_is_no_fragment_stays_where_it_is(channel: int, payload: bytes):
    pieces = pieces_of(bytes(4000))
    found = joined([*pieces[:2], Packet(channel, 2, 0, False, payload), *pieces[2:]])
    assert found[1].payload == payload
    assert [len(one.payload) for one in found[::2]] == [2002, 2002]


def test_a_picture_whose_end_did_not_come_is_open():
    pieces = pieces_of(bytes(5000), 9, 1000) + pieces_of(bytes(5000), 14, 4000)
    joiner = FragmentJoiner("H264", 0)
    joiner.joined(wire(pieces[:-1]))
    assert [joiner.is_open(ticks) for ticks in (None, 0, 3000)] == [False, False, True]
    joiner.joined(wire(pieces[-1:]))
    assert not joiner.is_open(3000)
    other = wire(pieces_of(bytes(4000)))
    assert FragmentJoiner("JPEG", 0).joined(other) is other
