"""Containers and RTSP as FFmpeg opens them, recorded as the camera compressed them."""

from __future__ import annotations

import re
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from tests.recorders.conftest import Record, Refuses
from tests.recorders.films import PATIENT, numbered, numbers, pixels_of, recorded, write_video
from tests.recorders.live_wait import LAST_RESORT_S, wait_until
from tests.recorders.mjpeg_camera import number_in, times_in
from tests.recorders.programs import file_pictures, gst_rtsp_server
from tests.recorders.servers import SDP, datagrams, rtsp_camera
from tunenet_logs.episode import Frame
from tunenet_logs.messages import CAMERA_TOPIC, VIDEO_TOPIC
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera import reading
from tunenet_logs.recorders.camera.base import CapturedFrame
from tunenet_logs.recorders.camera.network import NetworkOptions
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.reading import Transcoded
from tunenet_logs.recorders.camera.rtsp import Description, FragmentJoiner, RtpPorts
from tunenet_logs.recorders.camera.sources import open_source
from tunenet_logs.recorders.camera.streams import PacketStream, head_of
from tunenet_logs.recorders.local_page import PreviewVideo
from tunenet_logs.timing.stamps import now_ns

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
def test_a_torn_picture_in_mpeg_ts_is_not_mistaken(tmp_path: Path, torn: int, missing: list[int]):
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


# ---- Video that becomes JPEGs beside the thread that reads it; what is too much is counted


class Held(PacketStream):
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


def test_what_does_not_fit_is_dropped_and_counted(tmp_path: Path, monkeypatch):
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

    def is_shown_another(first: int) -> bool:
        for shot in shots[first:]:
            video.offer(shot.frame)
        return bool(shown)

    try:
        wait_until(lambda: is_shown_another(0), "a picture")
        assert (shown[0].encoding, number_in(shown[0].decode())) == ("jpeg", 0)
        video.skip()  # nobody looked for a while
        shown.clear()
        wait_until(lambda: is_shown_another(25), "a picture after a pause")
        assert number_in(shown[-1].decode()) >= 30  # from the next key frame on
    finally:
        video.close()
        video.join(LAST_RESORT_S)
    assert not video.is_alive()


# ---- RTSP cameras: every picture at its time, over TCP and UDP; and what is lost is known

live = pytest.mark.live
STALL_S = 0.5
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
        record(*words)
        path = "answers 404 Not Found to DESCRIBE; check the path"
        refuses(1, "--camera", f"rtsp://{address}er", says=path)
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


def test_packets_come_from_the_camera_alone_and_the_pictures_beside_a_loss_are_known():
    step = TICKS_HZ // RATE_HZ
    first_ticks = 2**32 - 2 * step  # they begin anew while it runs
    lost = {13, 29, 30, 31, 50}  # of packets, three a picture: inside; most of two; an end

    def packet(number: int) -> bytes:
        ticks = first_ticks + number // 3 * step & 0xFFFFFFFF
        return struct.pack(">BBHII", 0x80, 96, number + 65_530 & 0xFFFF, ticks, 1)

    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname()) as control,
        closing(RtpPorts(control)) as ports,
        datagrams() as camera,
        datagrams("127.0.0.2") as stranger,
    ):
        place = ("127.0.0.1", ports.numbers[0])
        stranger.sendto(packet(13), place)
        for data in (b"", b"short", *map(packet, sorted(set(range(60)) - lost))):
            camera.sendto(data, place)
        came: list[bytes] = []

        def have_all_come() -> bool:
            came.extend(bytes(one) for _, one in ports.packets())
            return len(came) == 60 - len(lost)

        wait_until(have_all_come, "all packets that were sent")
        torn = [number for number in range(20) if ports.is_torn(number * step)]
        assert torn == [4, 9, 10, 16, 17]
        assert ports.lost == len(lost)


def test_a_description_gives_ffmpeg_nothing_that_names_a_place():
    hostile = SDP.replace("s=camera", "s=camera\r\nc=IN IP4 239.0.0.1\r\na=control:rtsp://a.b/c")
    hostile += (
        "a=key-mgmt:x\r\na=fmtp:96 packetization-mode=1\r\na=source-filter: incl IN IP4 * 1\r\n"
    )
    text = Description.of(hostile).text("video")
    assert not any(one in text for one in ("239", "a.b", "source-filter"))
    assert "a=fmtp:96 packetization-mode=1" in text


# ---- Fragments of pictures are put together, and nothing is hidden

FIRST, LAST = 0x80, 0x40
HEADS = {"H264": b"\x7c", "H265": b"\x62\x01"}  # of a NAL unit that comes in fragments


def fragments(data: bytes, number: int, coding: str) -> list[bytes]:
    """RTP packets of one unit, a thousand bytes each."""
    packets = []
    for at in range(0, len(data), 1000):
        is_last = at + 1000 >= len(data)
        numbers = (number + at // 1000 & 0xFFFF, 9, 7)
        rtp = struct.pack(">BBHII", 0x80, 96 | 0x80 * is_last, *numbers)
        head = HEADS[coding] + bytes((5 | FIRST * (not at) | LAST * is_last,))
        packets.append(rtp + head + data[at : at + 1000])
    return packets


def joined(
    packets: list[bytes], coding: str, joiner: FragmentJoiner | None = None
) -> list[tuple[int, bytes]]:
    """Number and payload of each packet that FFmpeg is given."""
    sent = b"".join(struct.pack(">cBH", b"$", 0, len(one)) + one for one in packets)
    joiner = joiner or FragmentJoiner(coding, 0)
    out, found = bytes(joiner.joined(memoryview(sent))), []
    while out:
        _, _, size, _, number = struct.unpack_from(">cBHHH", out)
        found.append((number, out[16 : 4 + size]))
        out = out[4 + size :]
    return found


@pytest.mark.parametrize("coding", HEADS)
@pytest.mark.parametrize("begins", [0, 65_530])
def test_a_picture_in_pieces_is_one_packet_and_what_is_lost_stays_missing(coding, begins):
    data = bytes(range(256)) * 30  # eight pieces
    pieces, head = fragments(data, begins, coding), HEADS[coding] + bytes((5 | FIRST,))
    assert joined(pieces, coding) == [(begins, head + data)]  # with LAST it would be an error
    (first, before), (second, after) = joined(pieces[:2] + pieces[3:], coding)
    assert (first, second) == (begins, begins + 2)
    assert before + after[len(head) :] == head + data[:2000] + data[3000:]
    report = struct.pack(">BBHIII", 0x81, 201, 4, 1, 2, 3) + b"\x09\xf0"  # a whole unit
    assert joined([*pieces[:2], report, *pieces[2:]], coding)[1][1] == report[12:]
    large = joined(fragments(bytes(200_000), begins, coding), coding)
    assert max(len(payload) for _, payload in large) < 60_000
    assert b"".join(payload[len(head) :] for _, payload in large) == bytes(200_000)


@pytest.mark.parametrize("coding", HEADS)
def test_a_picture_whose_end_did_not_come_is_open(coding: str):
    pieces, joiner = fragments(bytes(5000), 0, coding), FragmentJoiner(coding, 0)
    joined(pieces[:-1], coding, joiner)
    assert joiner.is_open(0)
    joined(pieces[-1:], coding, joiner)
    assert not joiner.is_open(0)
