"""Options of a network camera beyond its address."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

from recorders.camera.tls import Trust
from tunenet_logs.addresses import Address
from tunenet_logs.errors import UsageError

_TRUST = Trust()

# What names a file with a password, and the variable of the environment that holds one.
PASSWORD_OPTION, PASSWORD_VARIABLE = "--password-file", "TUNENET_CAMERA_PASSWORD"


class Transport(Enum):
    """Transport of an RTSP camera's packets."""

    TCP = "tcp"
    UDP = "udp"


@dataclass(frozen=True)
class NetworkOptions:
    """The user's options for a network camera.

    Attributes:
        trust: which certificates are trusted.
        rtsp_transport: None falls back to UDP where a camera refuses TCP.
        password: of the address's user; None where the address, or `~/.netrc`, has it.
        must_serve: whether a password that no camera uses is an error.
    """

    trust: Trust = _TRUST
    rtsp_transport: Transport | None = None
    password: str | None = field(default=None, repr=False)
    must_serve: bool = False

    def known(self, address: Address) -> Address:
        """Add the password to an address that lacks one.

        Raises:
            UsageError: there are two passwords, or no user for one.
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
        """Check that the options apply to an address's scheme ("" for none).

        Raises:
            UsageError: an option is for another kind of camera.
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
