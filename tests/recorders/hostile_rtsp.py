"""RTSP cameras that mean harm, over real sockets: they answer as they are told."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from tests.recorders.hostile_cameras import send_on, serving_each

SDP = (
    "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=camera\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\n"
    "a=rtpmap:96 H264/90000\r\na=control:track\r\n"
)
HEADS = {
    "OPTIONS": "Public: OPTIONS, DESCRIBE, SETUP, PLAY\r\n",
    "DESCRIBE": f"Content-Type: application/sdp\r\nContent-Length: {len(SDP)}\r\n",
    "SETUP": "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\nSession: 1\r\n",
    "PLAY": "",
}


def ok(method: str) -> bytes:
    """What an honest camera replies."""
    body = SDP if method == "DESCRIBE" else ""
    return f"RTSP/1.0 200 OK\r\nCSeq: 1\r\n{HEADS.get(method, '')}\r\n{body}".encode()


@contextmanager
def hostile_rtsp(
    replies: Mapping[str, bytes], again: bytes = b"", *, drips: bool = False
) -> Iterator[str]:
    """A camera; its address without a scheme.

    Args:
        replies: by method, instead of an honest reply; b"" for none.
        again: what comes without end after the first of those replies, or else after PLAY.
        drips: whether there is a moment before each.
    """
    last = next(iter(replies), "PLAY")

    def answer(caller: socket.socket, ended: threading.Event) -> None:
        file = caller.makefile("rb")
        while line := file.readline():
            method = line.decode().partition(" ")[0]
            while file.readline().strip():
                pass
            caller.sendall(replies[method] if method in replies else ok(method))
            if method == last:
                send_on(caller, again, ended, drips=drips)

    with serving_each(answer) as place:
        yield f"{place}/stream"
