"""An RTSP camera on the loopback: H.264 in RTP, interleaved on the one TCP connection."""

from __future__ import annotations

import base64
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from typing import Any

import av
import numpy as np

_CLOCK_HZ = 90_000
_MTU_BYTES = 1400


def encoded(pictures: list[np.ndarray], rate_hz: int) -> list[list[bytes]]:
    """The NAL units of each picture, RGB (H, W, 3)."""
    height, width = pictures[0].shape[:2]
    coder: Any = av.CodecContext.create("libx264", "w")
    coder.width, coder.height, coder.pix_fmt = width, height, "yuv420p"
    coder.time_base, coder.gop_size = Fraction(1, rate_hz), 10
    coder.options = {"tune": "zerolatency", "preset": "ultrafast"}
    packets = []
    for index, picture in enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
        frame.pts = index
        packets += coder.encode(frame)
    packets += coder.encode(None)
    units = [bytes(one).replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1") for one in packets]
    return [[unit for unit in one if unit] for one in units]


def rtp(units: list[bytes], number: int, sequence: int, rate_hz: int) -> list[bytes]:
    """One picture's NAL units as RTP packets (RFC 6184: whole units, or fragments FU-A)."""
    payloads = []
    for unit in units:
        if len(unit) <= _MTU_BYTES:
            payloads.append(unit)
            continue
        pieces = [unit[at : at + _MTU_BYTES] for at in range(1, len(unit), _MTU_BYTES)]
        for index, piece in enumerate(pieces):
            edges = (0x80 if index == 0 else 0) | (0x40 if index == len(pieces) - 1 else 0)
            payloads.append(bytes([unit[0] & 0xE0 | 28, edges | unit[0] & 0x1F]) + piece)
    ticks = 123_456 + number * _CLOCK_HZ // rate_hz
    return [
        struct.pack(
            ">BBHII", 0x80, 96 | (0x80 if index == len(payloads) - 1 else 0),
            (sequence + index) & 0xFFFF, ticks, 1,
        ) + payload
        for index, payload in enumerate(payloads)
    ]  # fmt: skip


@contextmanager
def rtsp_camera(pictures: list[np.ndarray], rate_hz: int, *, stall: bool = False) -> Iterator[str]:
    """Plays the pictures to its first caller, then hangs up, or falls silent; its address.

    They are sent in one piece, so that no delay between them looks like silence; their times are
    those of the rate.
    """
    frames = encoded(pictures, rate_hz)
    ended = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with suppress(OSError), listener:
            caller, _ = listener.accept()
            with caller:
                _shake_hands(caller, frames[0])
                _play(caller, frames, rate_hz)
                if stall:
                    ended.wait()

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield f"127.0.0.1:{listener.getsockname()[1]}/stream"
    finally:
        ended.set()


def _shake_hands(caller: socket.socket, first: list[bytes]) -> None:
    sets = ",".join(base64.b64encode(one).decode() for one in first if one[0] & 0x1F in (7, 8))
    sdp = (
        "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=camera\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\n"
        f"a=rtpmap:96 H264/90000\r\na=fmtp:96 packetization-mode=1;sprop-parameter-sets={sets}\r\n"
        "a=control:track\r\n"
    )
    heads = {
        "OPTIONS": "Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN\r\n",
        "DESCRIBE": f"Content-Type: application/sdp\r\nContent-Length: {len(sdp)}\r\n",
        "SETUP": "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\n",
        "PLAY": "RTP-Info: url=track;seq=0;rtptime=123456\r\n",
    }
    file = caller.makefile("rb")
    method = ""
    while method != "PLAY":
        method = file.readline().decode().partition(" ")[0]
        sequence = ""
        while (line := file.readline().strip()) != b"":
            name, _, value = line.decode().partition(":")
            sequence = value.strip() if name.lower() == "cseq" else sequence
        answer = f"RTSP/1.0 200 OK\r\nCSeq: {sequence}\r\nSession: 1\r\n{heads[method]}\r\n"
        caller.sendall((answer + (sdp if method == "DESCRIBE" else "")).encode())


def _play(caller: socket.socket, frames: list[list[bytes]], rate_hz: int) -> None:
    packets: list[bytes] = []
    for number, units in enumerate(frames):
        packets += rtp(units, number, len(packets), rate_hz)
    heads = [struct.pack(">cBH", b"$", 0, len(packet)) for packet in packets]
    caller.sendall(b"".join(head + packet for head, packet in zip(heads, packets, strict=True)))
