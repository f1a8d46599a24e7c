"""Verify a camera's TLS certificate: by a known authority, by fingerprint, or not at all."""

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
    """Which certificates are trusted; by default those that a known authority signed.

    Attributes:
        fingerprint: SHA-256 of the only trusted certificate, in 64 capital hex digits; its names,
            dates and issuer then do not matter.
        is_insecure: whether any certificate is trusted.
    """

    fingerprint: str = ""
    is_insecure: bool = False

    @classmethod
    def of(cls, fingerprint: str | None, is_insecure: bool) -> Trust:
        """Parse the user's options; colons between the fingerprint's hex digits are optional.

        Raises:
            UsageError: it is no fingerprint, or both options are given.
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
        """Name of the given option; "" if there is none."""
        return "--fingerprint" if self.fingerprint else "--insecure" if self.is_insecure else ""


class UntrustedCertificateError(CameraError):
    """A certificate that no known authority signed."""


def secured(plain: socket.socket, host: str, trust: Trust, deadline: Deadline) -> ssl.SSLSocket:
    """Start TLS on a connection and verify the certificate before anything is sent.

    Args:
        plain: the connection, which is closed with what is returned, and where this fails.
        host: the name that the certificate must be for.
        trust: which certificates are trusted.
        deadline: for all later reads, too.

    Raises:
        UntrustedCertificateError: no known authority signed it. Its fingerprint is unknown then;
            see `fingerprint`.
        CameraError: it has another fingerprint than the trusted one.
        OSError: the TLS handshake failed.
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
    """Return the SHA-256 of the peer's certificate, in capital hex digits."""
    return sha256(connected.getpeercert(binary_form=True) or b"").hexdigest().upper()
