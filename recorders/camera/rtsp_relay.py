"""Relay an RTSP camera's packets to FFmpeg, which itself connects to this machine alone.

FFmpeg can depacketize pictures. But it follows a camera to any host, trusts any certificate, and
knows one digest of five; so `rtsp_client` talks to the camera, and FFmpeg connects here.
"""

from __future__ import annotations

import secrets
import select
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import suppress

from recorders.camera.rtp_joining import FragmentJoiner
from recorders.camera.rtsp_client import RtspClient
from recorders.camera.rtsp_wire import Reply

_VIDEO = "video"  # what FFmpeg is told that the one video is called
_READER_S = 10.0  # for FFmpeg to call: it is asked to at once
_ENDING_S = 0.2  # for what ends by itself to say why
_MAX_WAIT_S = 1.0  # for a packet, before anything else is looked after
# From what was passed on to what is read next, over TCP, which keeps it: the pieces of a picture
# are passed on together then, and the first of them at once, as its time of arrival wants it.
_GATHERING_S = 0.003

_MAX_REQUEST_BYTES = 16 * 1024


class RtspRelay:
    """A loopback RTSP server for one reader.

    Args:
        client: the camera, playing; it is closed here.
        silence_s: the longest time without a packet.
    """

    def __init__(self, client: RtspClient, silence_s: float) -> None:
        self._ended = ""
        self._client = client
        self._joiner = FragmentJoiner(client.description.codec, client.channel)
        self._silence_s = silence_s
        self._is_closed = False
        self._path = secrets.token_hex(8)  # others on this machine may call, but do not know it
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(_READER_S)
        self._reader: socket.socket | None = None
        self._thread = threading.Thread(target=self._run, name="rtsp relay", daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """URL of the relayed video."""
        return f"rtsp://127.0.0.1:{self._listener.getsockname()[1]}/{self._path}"

    @property
    def lost(self) -> int:
        """Number of lost packets; 0 over TCP."""
        return self._client.ports.lost if self._client.ports else 0

    def is_torn(self, ticks: int | None) -> bool:
        """Return whether packets were lost in or beside a picture, or its end never came.

        Args:
            ticks: its time, from 0 for the first; asked in order, when more has come or none will.
        """
        ports = self._client.ports
        return self._joiner.is_open(ticks) or (ports is not None and ports.is_torn(ticks))

    def close(self) -> None:
        """Stop relaying, from any thread, and close the camera."""
        self._is_closed = True
        for one in (self._client.socket, self._listener, self._reader):
            if one is not None:
                with suppress(OSError):  # it is closed already
                    socket.socket.shutdown(one, socket.SHUT_RD)
        if self._reader is not None:
            with suppress(OSError):
                self._reader.shutdown(socket.SHUT_RDWR)

    def ended_by(self) -> str:
        """Stop relaying; return why it had ended, "" where it was still running."""
        is_asked = self._is_closed
        self._thread.join(_ENDING_S)
        was_running = self._thread.is_alive()
        self.close()
        return "" if is_asked or was_running else self._ended

    def _run(self) -> None:
        try:
            with self._listener:
                self._reader, _ = self._listener.accept()
            with self._reader as reader:
                reader.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._ended = self._played(reader)
                self._client.close()
                reader.shutdown(socket.SHUT_WR)
                while reader.recv(65536):  # closed before it is read out, it would lose packets
                    pass
        except OSError:
            pass  # nobody reads any more
        finally:
            self._client.close()

    def _played(self, reader: socket.socket) -> str:
        """Serve FFmpeg; return why there is no more, "" if FFmpeg hung up."""
        try:
            self._greet(reader)
            return self._pass_on(reader)
        except TimeoutError:
            ports = self._client.ports
            hint = " over UDP; if a firewall is between, try --rtsp-transport tcp"
            said = hint if ports and not ports.has_any else ""
            return f"no data for {self._silence_s:.1f} s{said}"
        except OSError as error:
            why = error.strerror or type(error).__name__
            return f"the connection to the camera broke ({why})"

    def _greet(self, reader: socket.socket) -> None:
        """Answer FFmpeg's requests up to PLAY."""
        description = self._client.description.text(_VIDEO)
        channel = self._client.channel
        answers = {
            "OPTIONS": "Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN\r\n\r\n",
            "DESCRIBE": "Content-Type: application/sdp\r\n"
            f"Content-Length: {len(description)}\r\n\r\n{description}",
            "SETUP": f"Transport: RTP/AVP/TCP;unicast;interleaved={channel}-{channel + 1}\r\n\r\n",
            "PLAY": "\r\n",
        }
        method, said = "", bytearray()
        while method != "PLAY":
            while (end := said.find(b"\r\n\r\n")) < 0:
                if len(said) > _MAX_REQUEST_BYTES or not (more := reader.recv(4096)):
                    raise ConnectionError("nobody reads")
                said += more
            request, *lines = said[:end].decode("latin-1").split("\r\n")
            del said[: end + 4]
            method, place = (*request.split(" "), "")[:2]
            number = next(line for line in lines if line.lower().startswith("cseq"))
            if self._path not in place or method not in answers:
                raise ConnectionError("a stranger reads")
            head = f"RTSP/1.0 200 OK\r\n{number}\r\nSession: 1\r\n"
            reader.sendall((head + answers[method]).encode())

    def _pass_on(self, reader: socket.socket) -> str:
        """Relay packets until one side ends."""
        client, wire = self._client, self._client.wire
        udp = client.ports.sockets if client.ports else ()
        reader.sendall(self._joiner.joined(memoryview(wire.early)))
        passed_s = time.monotonic()
        while not self._is_closed:
            for packets in self._come():
                reader.sendall(self._joiner.joined(packets))
                passed_s = time.monotonic()
            left_s = passed_s + self._silence_s - time.monotonic()
            wait_s = min(client.refresh(), left_s, _MAX_WAIT_S)
            if wait_s <= 0:
                raise TimeoutError
            ready, _, _ = select.select([client.socket, reader, *udp], [], [], wait_s)
            if reader in ready and not reader.recv(65536):  # its reports are not passed on
                return ""
            if client.socket in ready:
                if not udp:
                    time.sleep(max(0.0, passed_s + _GATHERING_S - time.monotonic()))
                if not wire.fill():
                    return "the stream was closed by the camera"
        return ""

    def _come(self) -> Iterator[memoryview]:
        """Yield the received packets, interleaved."""
        while (came := self._client.wire.take(is_playing=True)) is not None:
            if isinstance(came, Reply):
                self._client.replied(came)
            else:
                yield came
        if self._client.ports is None:
            return
        beside = bytearray()
        for channel, packet in self._client.ports.packets():
            beside += struct.pack(">cBH", b"$", channel, len(packet))
            beside += packet
        if beside:
            yield memoryview(beside)
