"""Connect to a camera, plain or by TLS, with a deadline for every byte."""

from __future__ import annotations

import socket
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPException
from urllib.parse import urlsplit

from recorders.camera.tls import Trust, UntrustedCertificateError, fingerprint, secured
from recorders.deadline import Deadline, with_deadline
from tunenet_logs.errors import CameraAwayError, CameraError
from tunenet_logs.terminal import short_name

# For redirections, passwords and headers together, where no longer silence is allowed.
OPENING_S = 10.0

# Answers, of HTTP and RTSP, of a server that starts, or has too much to do.
PASSING = (404, 408, 425, 429, 453, 500, 502, 503, 504)

_ANY = Trust(is_insecure=True)


def connect(host: str, port: int, deadline: Deadline, trust: Trust | None) -> socket.socket:
    """Connect to a host, by TLS unless `trust` is None; `deadline` bounds all later reads, too.

    Raises:
        CameraError: nothing answers there, or its certificate is not trusted.
        TimeoutError: it does not answer in time.
    """
    try:
        plain = _plain(host, port, deadline)
        return plain if trust is None else _by_tls(plain, host, port, deadline, trust)
    except TimeoutError:
        raise
    except ssl.SSLError as error:
        why = short_name(error.reason or error)
        raise CameraError(f"cannot agree on encryption ({why}); does it do without?") from error
    except OSError as error:
        why = short_name(error.strerror or error)
        raise CameraAwayError(
            f"cannot be reached ({why}); is the camera on, and the address right?"
        ) from error


@contextmanager
def answering(shown: str, deadline: Deadline) -> Iterator[None]:
    """Re-raise failures to talk to a camera as errors that begin with its address, `shown`.

    Raises:
        CameraError: anything failed, or `deadline` passed.
    """
    try:
        yield
    except CameraError as error:
        if str(error).startswith(shown):
            raise
        raise type(error)(f"{shown}: {error}") from error
    except TimeoutError as error:
        seconds = deadline.whole_s if deadline.is_over else deadline.silence_s
        raise CameraAwayError(
            f"{shown}: does not answer within {seconds:g} s; is the camera on?"
        ) from error
    except (OSError, HTTPException, ValueError) as error:
        kind = CameraAwayError if isinstance(error, OSError) else CameraError
        raise kind(
            f"{shown}: does not answer as a camera does ({type(error).__name__}); check the address"
        ) from error


def sent_on(url: str, schemes: tuple[str, ...]) -> CameraError:
    """Make the error of a refused redirect: only the user chooses another host."""
    try:
        parts = urlsplit(url)
        place = f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"
    except ValueError:
        return CameraError("sends on to what is no address; check the address")
    if parts.scheme not in schemes:
        return CameraError(f"sends on to {short_name(place)}, which is no camera's address")
    return CameraError(f"sends on to {short_name(place)}; if that is right, give that address")


def _plain(host: str, port: int, deadline: Deadline) -> socket.socket:
    plain = socket.create_connection((host, port), timeout=deadline.next_s())
    connected = with_deadline(socket.socket, deadline)(fileno=plain.detach())
    deadline.watch(connected)
    return connected


def _by_tls(
    plain: socket.socket, host: str, port: int, deadline: Deadline, trust: Trust
) -> socket.socket:
    try:
        connected = secured(plain, host, trust, deadline)
    except UntrustedCertificateError as error:
        with secured(_plain(host, port, deadline), host, _ANY, deadline) as unverified:
            shown = fingerprint(unverified)
        raise CameraError(
            f"its certificate cannot be verified ({error}); to believe this one, add "
            f"--fingerprint {shown}; to believe any, add --insecure"
        ) from error
    deadline.watch(connected)
    return connected
