"""Which certificate of a camera is believed."""

from __future__ import annotations

import re
import socket
import ssl
from dataclasses import dataclass
from hashlib import sha256

from recorders.closing import closed_on_failure
from recorders.deadline import Deadline, with_deadline
from tunenet_logs.errors import CameraError, UsageError

_FINGERPRINT = re.compile(r"[0-9A-F]{64}")


@dataclass(frozen=True)
class Trust:
    """Which certificate is believed: one that a known authority signed, where nothing is said.

    Attributes:
        fingerprint: SHA-256 of the one certificate that is believed, in 64 capital hex digits;
            its names, its dates and who signed it then do not matter.
        is_insecure: whether any certificate is believed.
    """

    fingerprint: str = ""
    is_insecure: bool = False

    @classmethod
    def of(cls, fingerprint: str | None, is_insecure: bool) -> Trust:
        """Take what a user says.

        Args:
            fingerprint: in hex digits, with or without colons between them.
            is_insecure: whether any certificate is to be believed.

        Raises:
            UsageError: that is no fingerprint, or both are said.
        """
        if fingerprint is None:
            return cls(is_insecure=is_insecure)
        if is_insecure:
            raise UsageError("--insecure or --fingerprint: believe any certificate, or one")
        digits = fingerprint.replace(":", "").replace(" ", "").upper()
        if not _FINGERPRINT.fullmatch(digits):
            raise UsageError(
                "--fingerprint: a certificate's SHA-256 is 64 hex digits; leave it out to see it"
            )
        return cls(digits)

    @property
    def option(self) -> str:
        """The option that was given; "" if none was."""
        return "--fingerprint" if self.fingerprint else "--insecure" if self.is_insecure else ""


class UntrustedCertificateError(CameraError):
    """A certificate that no known authority vouches for."""


def secured(plain: socket.socket, host: str, trust: Trust, deadline: Deadline) -> ssl.SSLSocket:
    """TLS on a connection; the certificate is believed or this fails before a word is said.

    Args:
        plain: the connection, which is closed with what is returned, and where this fails.
        host: whose certificate it has to be.
        trust: what is believed.
        deadline: for all that is read later, too.

    Raises:
        UntrustedCertificateError: no known authority vouches for it. Its fingerprint is not known
            then: `fingerprint` asks for it.
        CameraError: it is another than the one that is believed.
        OSError: there is no TLS.
    """
    context = ssl.create_default_context()
    if trust.option:
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    context.sslsocket_class = with_deadline(ssl.SSLSocket, deadline)  # type: ignore[assignment]
    plain.settimeout(deadline.next_s())
    with closed_on_failure(plain):
        try:
            connected = context.wrap_socket(plain, server_hostname=host)
        except ssl.SSLCertVerificationError as error:
            raise UntrustedCertificateError(error.verify_message) from error
    if trust.fingerprint and (shown := fingerprint(connected)) != trust.fingerprint:
        connected.close()
        raise CameraError(
            f"its certificate's fingerprint is {shown}, not {trust.fingerprint} as --fingerprint "
            "says: it has a new certificate, or another answers in its place"
        )
    return connected


def fingerprint(connected: ssl.SSLSocket) -> str:
    """SHA-256 of the other side's certificate, in capital hex digits."""
    return sha256(connected.getpeercert(binary_form=True) or b"").hexdigest().upper()
