"""How a network camera is asked, where the user says more than its address."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from recorders.camera.tls import Trust
from tunenet_logs.errors import UsageError

_TRUST = Trust()


class Transport(Enum):
    """How an RTSP camera's packets come: over the connection, or beside it."""

    TCP = "tcp"
    UDP = "udp"


@dataclass(frozen=True)
class NetworkOptions:
    """What the user says of a network camera.

    Attributes:
        trust: which certificate of an encrypted camera is believed.
        rtsp_transport: None takes UDP where a camera refuses TCP.
    """

    trust: Trust = _TRUST
    rtsp_transport: Transport | None = None

    def check(self, scheme: str) -> None:
        """Check that all of it is for a camera of that kind.

        Args:
            scheme: of its address; "" for none.

        Raises:
            UsageError: something is for another kind.
        """
        if self.trust.option and scheme not in ("https", "rtsps"):
            raise UsageError(f"{self.trust.option} is for an https or rtsps camera; leave it out")
        if self.rtsp_transport is None:
            return
        if scheme not in ("rtsp", "rtsps"):
            raise UsageError("--rtsp-transport is for an rtsp camera; leave it out")
        if scheme == "rtsps" and self.rtsp_transport is Transport.UDP:
            raise UsageError("--rtsp-transport udp: rtsps encrypts TCP alone; leave it out")
