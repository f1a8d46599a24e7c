"""No RTSP camera makes the recorder call another host, wait without end, or guess."""

from __future__ import annotations

import socket
import struct
import threading
from contextlib import closing

import pytest

from tests.recorders.hostile_rtsp import SDP, hostile_rtsp, ok
from tests.recorders.live_wait import LAST_RESORT_S, wait_until
from tests.recorders.rtsp_camera import rtsp_camera
from tests.recorders.test_video_file import numbered
from tunenet_logs.errors import CameraError
from tunenet_logs.recorders.camera.options import CameraOptions
from tunenet_logs.recorders.camera.rtsp import Description, Reply, RtpPorts, RtspWire
from tunenet_logs.recorders.camera.sources import open_source

pytestmark = pytest.mark.live

STALL_S = 1.0


def moved(place: str) -> bytes:
    return f"RTSP/1.0 302 Moved\r\nCSeq: 1\r\nLocation: {place}\r\n\r\n".encode()


def described(sdp: str) -> bytes:
    return f"RTSP/1.0 200 OK\r\nCSeq: 1\r\nContent-Length: {len(sdp)}\r\n\r\n{sdp}".encode()


def transport(said: str) -> bytes:
    return f"RTSP/1.0 200 OK\r\nCSeq: 1\r\nSession: 1\r\nTransport: {said}\r\n\r\n".encode()


@pytest.mark.parametrize(
    ("replies", "says"),
    [
        ({"DESCRIBE": moved("rtsp://u:p@10.0.0.9/x?q")}, "sends on to rtsp://10.0.0.9/x; if that"),
        ({"DESCRIBE": moved("file:///etc/passwd")}, "sends on to file:///etc/passwd, which is no"),
        ({"DESCRIBE": moved("http://[")}, "sends on to what is no address"),
        ({"OPTIONS": b"RTSP/1.0 302 M\r\n\r\n"}, "sends on to"),
        ({"OPTIONS": b"HTTP/1.1 400 Bad Request\r\n\r\n"}, "does not speak RTSP"),
        ({"OPTIONS": b"RTSP/1.0 200 OK\r\nContent-Length: 99999999\r\n\r\n"}, "not speak RTSP"),
        ({"OPTIONS": b"RTSP/1.0 200 OK\r\nContent-Length: -5\r\n\r\n"}, "not speak RTSP"),
        ({"OPTIONS": b"RTSP/1.0 200 OK\r\n" + b"X: y\r\n" * 9000}, "not speak RTSP"),
        ({"OPTIONS": b"RTSP/1.0 abc\r\n\r\n"}, "does not speak RTSP"),
        ({"DESCRIBE": b"RTSP/1.0 503 Full\r\n\r\n"}, "answers 503 Full to DESCRIBE"),
        ({"DESCRIBE": described("v=0\r\nm=audio 0 RTP/AVP 0\r\n")}, "holds no video"),
        ({"DESCRIBE": described(SDP.replace("RTP/AVP", "RTP/SAVP"))}, "by RTP/SAVP"),
        ({"SETUP": transport("RTP/AVP;multicast;destination=239.0.0.1")}, "asked for TCP and"),
        ({"SETUP": transport("RTP/AVP/TCP;multicast")}, "asked for TCP and"),
        ({"SETUP": b"garbage"}, "does not speak RTSP"),
        ({"SETUP": b"RTSP/1.0 461 No\r\n\r\n"}, "refuses TCP and UDP"),
        ({"DESCRIBE": b'RTSP/1.0 401 No\r\nWWW-Authenticate: Basic realm="x"\r\n\r\n'}, "password"),
    ],
)
def test_each_refusal_is_one_true_line(replies: dict[str, bytes], says: str):
    with hostile_rtsp(replies) as address, pytest.raises(CameraError, match=says) as error:
        open_source(f"rtsp://{address}", CameraOptions(stall_s=LAST_RESORT_S))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("replies", "again", "drips", "says"),
    [
        ({"OPTIONS": b"RTSP/1.0 200 OK\r\nX: "}, b"a", True, "does not answer within"),
        ({"OPTIONS": b""}, b"\r\n", True, "does not answer within"),
        ({"OPTIONS": b""}, b"\r\n" * 9000, False, "does not answer within"),
        ({"OPTIONS": b""}, b"$\x00\x00\x00", True, "does not answer within"),
        ({"OPTIONS": b""}, b"$\x00\xff\xff" + bytes(65535), False, "sends packets and no reply"),
        ({"OPTIONS": b"RTSP/1.0 200 OK\r\n"}, b"X: y\r\n" * 900, False, "does not speak RTSP"),
        ({}, b"\r\n", True, "no data for 1.0 s"),
        ({}, b"RTSP/1.0 200 OK\r\n\r\n", True, "no data for 1.0 s"),
        ({}, b"noise without a packet", True, "no data for 1.0 s"),
    ],
)
def test_an_opening_has_an_end(
    monkeypatch: pytest.MonkeyPatch,
    replies: dict[str, bytes],
    again: bytes,
    drips: bool,
    says: str,
):
    monkeypatch.setattr("tunenet_logs.recorders.camera.network.OPENING_S", 2.0)
    with hostile_rtsp(replies, again, drips=drips) as address:
        assert says in why_it_ended(f"rtsp://{address}")


def test_nothing_is_sent_to_the_source_that_a_camera_names():
    with (
        closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as named,
        closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as elsewhere,
    ):
        named.bind(("127.0.0.1", 0))
        port = named.getsockname()[1]
        elsewhere.bind(("127.0.0.2", port))
        said = f"RTP/AVP;unicast;source=127.0.0.2;destination=127.0.0.2;server_port={port}-{port}"
        refused = b"RTSP/1.0 461 No\r\n\r\n"
        setups = iter([refused, transport(said)])

        class Replies(dict[str, bytes]):
            def __getitem__(self, method: str) -> bytes:
                return next(setups) if method == "SETUP" else ok(method)

        with hostile_rtsp(Replies(SETUP=b"")) as address:
            assert "no data for 1.0 s over UDP" in why_it_ended(f"rtsp://{address}")
        assert named.recv(100)
        elsewhere.setblocking(False)
        with pytest.raises(BlockingIOError):
            elsewhere.recv(100)


def why_it_ended(url: str) -> str:
    """Why nothing comes, be it found at opening or at reading."""
    try:
        source = open_source(url, CameraOptions(stall_s=STALL_S))
    except CameraError as error:
        return str(error)
    assert not list(source.frames())
    return source.ended


def packet(number: int) -> bytes:
    return struct.pack(">BBHII", 0x80, 96, number, 0, 1)


def test_packets_are_taken_from_the_camera_alone_and_counted():
    with (
        closing(socket.create_server(("127.0.0.1", 0))) as camera,
        closing(socket.create_connection(camera.getsockname())) as control,
        closing(RtpPorts(control)) as ports,
        closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as friend,
        closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as stranger,
    ):
        friend.bind(("127.0.0.1", 0))
        stranger.bind(("127.0.0.2", 0))
        place = ("127.0.0.1", ports.numbers[0])
        stranger.sendto(packet(0), place)
        for data in (b"", b"short", packet(65534), packet(65535), packet(2), packet(1)):
            friend.sendto(data, place)
        came: list[bytes] = []

        def has_all() -> bool:
            came.extend(bytes(one) for _channel, one in ports.packets())
            return len(came) >= 4

        wait_until(has_all, "four packets")
        assert came == [packet(65534), packet(65535), packet(2), packet(1)]
        assert ports.lost == 1


@pytest.mark.parametrize(
    "noise", [b"$\x00\xff\xff" + b"x" * 9, b"noise", b"\r\nRTSP/1.0 x\r\n\r\n"]
)
@pytest.mark.parametrize("size", [1, 7, 100_000])
def test_noise_between_packets_costs_no_more_than_it_covers(noise: bytes, size: int):
    one = b"$\x00\x00\x0c" + packet(1)
    sent = one * 10 + noise + one * 20_000
    ours, theirs = socket.socketpair()
    with closing(ours), closing(theirs):
        threading.Thread(target=in_pieces, args=(theirs, sent, size), daemon=True).start()
        wire = RtspWire(ours)
        came = bytearray()
        while wire.fill():
            while (some := wire.take(is_playing=True)) is not None:
                assert not isinstance(some, Reply)
                came += some
    assert came.startswith(one * 10)
    assert came.endswith(one * 10_000)


def in_pieces(writer: socket.socket, data: bytes, size: int) -> None:
    """Send the beginning in pieces of that size, then the rest."""
    for at in range(0, 400, size):
        writer.sendall(data[at : min(at + size, 400)])
    writer.sendall(data[400:])
    writer.shutdown(socket.SHUT_WR)


def test_a_description_gives_ffmpeg_nothing_that_names_a_place():
    hostile = SDP.replace("s=camera", "s=camera\r\nc=IN IP4 239.0.0.1\r\na=control:rtsp://a.b/c")
    hostile += (
        "a=key-mgmt:x\r\na=fmtp:96 packetization-mode=1\r\na=source-filter: incl IN IP4 * 1\r\n"
    )
    text = Description.of(hostile).text("video")
    assert "239" not in text
    assert "a.b" not in text
    assert "source-filter" not in text
    assert "a=fmtp:96 packetization-mode=1" in text


def test_closing_ends_a_read_that_waits():
    with rtsp_camera([numbered(number) for number in range(20)], 50, stall=True) as address:
        source = open_source(f"rtsp://{address}", CameraOptions(stall_s=LAST_RESORT_S))
        reading = threading.Thread(target=lambda: list(source.frames()), daemon=True)
        reading.start()
        source.close()
        reading.join(LAST_RESORT_S / 2)
        assert not reading.is_alive()
