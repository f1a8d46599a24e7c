"""Read a network camera that speaks RTSP, over TCP or UDP."""

from __future__ import annotations

from collections.abc import Iterator

from recorders.camera.base import Shot
from recorders.camera.connection import OPENING_S, answering
from recorders.camera.network_options import Transport
from recorders.camera.packet_stream import NOT_PARSED, PacketStream
from recorders.camera.rtsp_client import RtspClient
from recorders.camera.rtsp_relay import RtspRelay
from recorders.camera.tls import Trust
from recorders.closing import closed_on_failure
from recorders.deadline import Deadline
from tunenet_logs.addresses import Address
from tunenet_logs.errors import CameraAwayError

_SPARE_S = 2.0  # that FFmpeg waits longer than the relay, which can say why nothing comes
_OPTIONS = {
    "rtsp_transport": "tcp",  # to the relay, whatever the camera is asked by
    "protocol_whitelist": "tcp",
    "probesize": "32",  # the description says what comes; a second of pictures would say no more
    **NOT_PARSED,
}


class RtspStream(PacketStream):
    """An RTSP stream.

    Args:
        timeout_s: the longest silence. Opening may take 10 s, or so long where that is longer.
        trust: which certificates are trusted.
        transport: None falls back to UDP where the camera refuses TCP.

    Raises:
        CameraError: nothing answers there, or not with a video.
    """

    def __init__(
        self, address: Address, timeout_s: float, trust: Trust, transport: Transport | None
    ) -> None:
        import av
        from av import logging
        from av.error import FFmpegError

        logging.set_level(None)  # errors come as exceptions
        deadline = Deadline(timeout_s, max(OPENING_S, timeout_s))
        with answering(address.shown, deadline):
            client = RtspClient(address, deadline, trust, transport)
        self._transport = Transport.UDP if client.ports else Transport.TCP
        self._relay = RtspRelay(client, timeout_s)
        with closed_on_failure(self._relay):
            try:
                container = av.open(
                    self._relay.url,
                    "r",
                    format="rtsp",
                    options=_OPTIONS,
                    timeout=timeout_s + _SPARE_S,
                )
            except FFmpegError as error:
                why = self._relay.ended_by() or error.strerror
                raise CameraAwayError(f"{address.shown}: gives no video ({why})") from error
            super().__init__(container, address.shown, timeout_s, is_damaged=self._relay.is_torn)

    def notes(self) -> dict[str, str]:
        """Return the codec, the transport, and the number of lost packets."""
        lost = {"lost_packets": str(self._relay.lost)} if self._relay.lost else {}
        return super().notes() | {"transport": self._transport.value} | lost

    def frames(self) -> Iterator[Shot]:
        """Yield the pictures as they come, until the stream ends or falls silent."""
        try:
            yield from super().frames()
        finally:
            self.ended = self._relay.ended_by() or self.ended

    def close(self) -> None:
        """End a running `frames`; the camera is told to stop."""
        super().close()
        self._relay.close()
