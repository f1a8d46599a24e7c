"""How a network camera is asked, where the user says more than its address."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

from recorders.camera.tls import Trust
from tunenet_logs.addresses import Address
from tunenet_logs.errors import UsageError

_TRUST = Trust()

PASSWORD_OPTION, PASSWORD_VARIABLE = "--password-file", "TUNENET_CAMERA_PASSWORD"
"""What names a file with a password, and the variable of the environment that holds one."""


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
        password: of the user whom the address names; None where it, or `~/.netrc`, has it.
        must_serve: whether a password that is for no camera is a mistake.
    """

    trust: Trust = _TRUST
    rtsp_transport: Transport | None = None
    password: str | None = field(default=None, repr=False)
    must_serve: bool = False

    def known(self, address: Address) -> Address:
        """An address with the password that is known for it.

        Raises:
            UsageError: there are two passwords, or there is no user whose it is.
        """
        if self.password is None or not (self.must_serve or address.user):
            return address
        if address.password is not None:
            if self.must_serve:
                raise UsageError(
                    f"{PASSWORD_OPTION}: the address has a password, too; leave one out"
                )
            return address
        if not address.user:
            raise UsageError(f"{PASSWORD_OPTION}: whose is it? Write USER@ before the host")
        return replace(address, password=self.password)

    def check(self, scheme: str) -> None:
        """Check that all of it is for a camera of that kind.

        Args:
            scheme: of its address; "" for none.

        Raises:
            UsageError: something is for another kind.
        """
        if self.trust.option and scheme not in ("https", "rtsps"):
            raise UsageError(f"{self.trust.option} is for an https or rtsps camera; leave it out")
        if self.must_serve and scheme not in ("http", "https", "rtsp", "rtsps"):
            raise UsageError(f"{PASSWORD_OPTION} is for a camera that asks for one; leave it out")
        if self.rtsp_transport is None:
            return
        if scheme not in ("rtsp", "rtsps"):
            raise UsageError("--rtsp-transport is for an rtsp camera; leave it out")
        if scheme == "rtsps" and self.rtsp_transport is Transport.UDP:
            raise UsageError("--rtsp-transport udp: rtsps encrypts TCP alone; leave it out")
