"""Connect to a network camera: address, deadline, TLS, login, and the user's options.

A deadline bounds a whole exchange, however slowly bytes trickle in. Certificates are verified by a
known authority, by fingerprint, or not at all. Logins are basic or digest, for HTTP and RTSP (RFC
7617, 7616 and 2617).
"""

from __future__ import annotations

import hashlib
import re
import secrets
import socket
import ssl
import threading
import time
from base64 import b64encode
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from enum import Enum
from hashlib import sha256
from http.client import HTTPException
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from tunenet_logs.addresses import Address, scheme_of
from tunenet_logs.errors import CameraAwayError, CameraError, UsageError
from tunenet_logs.passwords import netrc_login
from tunenet_logs.recorders.session import closed_on_failure
from tunenet_logs.terminal import listed, short_name

# ---- Address: as people write it

# How an address begins that was written without http://, as browsers take it.
_BARE = re.compile(
    r"""
    (?: [^/@\s]+ @ )?                               # user:password@
    (?: \d{1,3}(?:\.\d{1,3}){3} (?= [:/] | $)        # 192.168.1.20
      | \[[0-9A-Fa-f:.]+\] (?= [:/] | $)             # [fe80::1]
      | [A-Za-z0-9][A-Za-z0-9-]* (?:\.[A-Za-z0-9-]+)* (?= :\d{1,5} (?:/|$))   # camera:8080
      | [A-Za-z0-9][A-Za-z0-9-]* (?:\.[A-Za-z0-9-]+)* \.[A-Za-z]{2,}
        (?= / (?! .* \.(?:mp4|m4v|mov|avi|mkv|webm|mcap) $))                    # cam.local/stream
    )
    """,
    re.VERBOSE,
)

# User and password before a host, whatever the host: a file of that name would be shown.
_LOGIN = re.compile(r"[^/@\s:]*:[^/@\s]*@[^/@\s]")


def with_scheme(text: str) -> str:
    """Prepend http:// to an address without a scheme, unless a file of that name exists."""
    if scheme_of(text) or not (_BARE.match(text) or _LOGIN.match(text)):
        return text
    first = text.partition("/")[0]
    if Path(text).exists() or (first != text and Path(first).is_dir()):
        return text
    return f"http://{text}"


def camera_address(text: str) -> Address:
    """Parse a camera's address.

    Raises:
        UsageError: it has no host, an invalid port, or characters that no address has.
    """
    scheme = scheme_of(text)
    with suppress(UsageError):
        if text.isascii() and text.isprintable() and " " not in text:
            return Address.of(text)
    raise UsageError(
        f"--camera: that is no {scheme} address; write it like {scheme}://192.168.1.20:8080/video"
    )


def host_and_port(address: Address) -> tuple[str, int]:
    """Return host and port of a bare address such as tcp://192.168.1.20:5000.

    Raises:
        UsageError: it has no port, or more than host and port.
    """
    parts = urlsplit(address.url)
    more = parts.path.strip("/") or parts.query or address.full_url != address.url
    if parts.port is None or more:
        raise UsageError(
            f"--camera: a {parts.scheme} address has a host and a port alone; "
            f"write it like {parts.scheme}://192.168.1.20:5000"
        )
    return parts.hostname or "", parts.port


# ---- Deadline: shared by all reads of a connection


class Deadline:
    """A time by which the other side must have answered.

    Args:
        silence_s: the longest to wait for the next byte.
        whole_s: the longest to wait for all of it.
    """

    def __init__(self, silence_s: float, whole_s: float) -> None:
        self.silence_s = silence_s
        self._sockets: list[socket.socket] = []
        self._lock = threading.Lock()
        self._is_broken_off = False
        self.renew(whole_s)

    def renew(self, whole_s: float) -> None:
        """Restart the wait."""
        self.whole_s = whole_s
        self._end = time.monotonic() + whole_s

    @property
    def is_over(self) -> bool:
        """Whether the deadline has passed."""
        return time.monotonic() >= self._end

    def next_s(self) -> float:
        """Return how long the next read may take [s].

        Raises:
            TimeoutError: the deadline has passed.
        """
        if self.is_over:
            raise TimeoutError("too late")
        return max(1e-3, min(self.silence_s, self._end - time.monotonic()))

    def watch(self, connected: socket.socket) -> None:
        """Let `break_off` shut this socket down, until it is closed."""
        with self._lock:
            self._sockets = [one for one in self._sockets if one.fileno() >= 0]
            self._sockets.append(connected)
            if self._is_broken_off:
                _shut(connected)

    def break_off(self) -> None:
        """End running reads, from any thread."""
        with self._lock:
            self._is_broken_off = True
            for connected in self._sockets:
                _shut(connected)


def with_deadline(kind: type[socket.socket], deadline: Deadline) -> type[socket.socket]:
    """Make a socket class whose reads share a deadline: a socket's own time-out is per read."""

    class Limited(kind):
        def recv_into(self, *words: Any, **more: Any) -> int:
            self.settimeout(deadline.next_s())
            return super().recv_into(*words, **more)

        def sendall(self, *words: Any, **more: Any) -> None:
            self.settimeout(deadline.silence_s)  # of which all of the call must end
            return super().sendall(*words, **more)

    return Limited


def _shut(connected: socket.socket) -> None:
    with suppress(OSError):  # it is closed already
        socket.socket.shutdown(connected, socket.SHUT_RDWR)  # not TLS's, which is not for threads


# ---- TLS: verify the certificate before anything is sent

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


# ---- Connection: plain or TLS; errors begin with the camera's address

# For redirects, login and headers together, unless the user allows a longer silence.
OPENING_S = 10.0

# Status codes, of HTTP and RTSP, of a server that is starting or overloaded: worth another try.
PASSING = (404, 408, 425, 429, 453, 500, 502, 503, 504)

_ANY_CERTIFICATE = Trust(is_insecure=True)


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
        with secured(_plain(host, port, deadline), host, _ANY_CERTIFICATE, deadline) as unverified:
            shown = fingerprint(unverified)
        raise CameraError(
            f"its certificate cannot be verified ({error}); to believe this one, add "
            f"--fingerprint {shown}; to believe any, add --insecure"
        ) from error
    deadline.watch(connected)
    return connected


# ---- Login: basic and digest authentication

_MAX_CHALLENGE = 4000  # characters of a challenge that are parsed
_MAX_SCHEMES = 10  # of one response that are considered; the strongest is taken
# In a challenge: a scheme, or a name with its value, which may stand in quotes.
_WORD = re.compile(r'([^\s,="]+)(?:\s*=\s*("(?:[^"\\]|\\.)*"|[^\s,]*))?')

# Digest algorithms by their names in RFC 7616, from weak to strong; servers vary in their case.
_HASHES = {"MD5": "md5", "SHA-256": "sha256", "SHA-512-256": "sha512_256"}


@dataclass(frozen=True)
class _Challenge:
    """An authentication scheme that a server offers."""

    scheme: str
    values: dict[str, str]

    @property
    def algorithm(self) -> str:
        """Digest hash algorithm."""
        return self.values.get("algorithm", "MD5").upper().removesuffix("-SESS")

    @property
    def is_session(self) -> bool:
        """Whether a digest hashes the password with the nonces, once for all requests."""
        return self.values.get("algorithm", "").upper().endswith("-SESS")

    @property
    def qualities(self) -> list[str]:
        """Digest qop values: the request (auth) or its body too (auth-int)."""
        return re.findall(r"[^\s,]+", self.values.get("qop", "").lower())

    @property
    def strength(self) -> int:
        """Rank of the scheme, higher is stronger; 0 if unsupported."""
        if self.scheme == "basic":
            return 1
        is_possible = not self.qualities or "auth" in self.qualities
        if self.scheme != "digest" or self.algorithm not in _HASHES or not is_possible:
            return 0
        return 2 + list(_HASHES).index(self.algorithm)

    @property
    def in_words(self) -> str:
        """Scheme, and a digest's algorithm and qop."""
        words = [self.scheme, *(self.values.get(name, "") for name in ("algorithm", "qop"))]
        return short_name(" ".join(word for word in words if word))


class Login:
    """Credentials, sent with every request once a server has asked for them.

    Args:
        user, password: "" for none.
        trouble: why none is known, where there is a reason.

    Raises:
        UsageError: they hold characters that would end the header line.
    """

    def __init__(self, user: str, password: str, trouble: str = "") -> None:
        if not f"{user}{password}".isprintable():
            raise UsageError("--camera: a user or password has characters that nobody can type")
        self._user = user
        self._password = password
        self._trouble = trouble
        self._challenge: _Challenge | None = None
        self._own_nonce = ""
        self._uses = 0

    @classmethod
    def of(cls, address: Address) -> Login:
        """Return the login in an address, else that of its host in `~/.netrc`."""
        if address.password is not None:
            return cls(address.user, address.password)
        known = netrc_login(urlsplit(address.url).hostname or "", address.user)
        return cls(known.user, known.password, known.trouble)

    @property
    def is_known(self) -> bool:
        """Whether there are credentials."""
        return bool(self._user or self._password)

    def header(self, method: str, uri: str) -> str | None:
        """Return a request's `Authorization` header; None before a server asked for one."""
        if self._challenge is None:
            return None
        self._uses += 1
        if self._challenge.scheme == "basic":
            return "Basic " + b64encode(f"{self._user}:{self._password}".encode()).decode()
        return self._digest(self._challenge, method, uri)

    def take(self, challenges: Iterable[str]) -> None:
        """Take the strongest supported challenge of a 401.

        Args:
            challenges: its `WWW-Authenticate`, in one header or several.

        Raises:
            CameraError: there are no credentials, no scheme is supported, or the server refused
                the right answer to its last challenge.
        """
        if not self.is_known:
            why = f": {self._trouble}" if self._trouble else ""
            raise CameraError(
                f"wants a password (401{why}); put USER@ before the host, and the password into "
                "~/.netrc or a file of its own (--password-file)"
            )
        offers = list(_offers(challenges))
        best = max(offers, key=lambda offer: offer.strength, default=None)
        if best is None or not best.strength:
            asked = listed(offer.in_words for offer in offers) or "nothing"
            raise CameraError(
                f"asks for a login by {asked} (401); basic is known, and digest with MD5 or "
                "SHA-256 of the request (qop auth)"
            )
        if self._uses == 1 and best.values.get("stale", "").lower() != "true":
            why = f": {self._trouble}" if self._trouble else ""
            raise CameraError(f"refuses this user and password (401{why}); check both")
        self._challenge = best
        self._own_nonce = secrets.token_hex(8)
        self._uses = 0

    def _digest(self, challenge: _Challenge, method: str, uri: str) -> str:
        """Compute the digest response (RFC 7616, 3.4; without a qop that of RFC 2069)."""
        values = challenge.values
        realm, nonce = values.get("realm", ""), values.get("nonce", "")
        uses = f"{self._uses:08x}"

        def hashed(*words: str) -> str:
            return hashlib.new(_HASHES[challenge.algorithm], ":".join(words).encode()).hexdigest()

        secret = hashed(self._user, realm, self._password)
        if challenge.is_session:
            secret = hashed(secret, nonce, self._own_nonce)
        request = hashed(method, uri)
        fields = {"username": self._user, "realm": realm, "nonce": nonce, "uri": uri}
        plain = {name: values[name] for name in ("algorithm",) if name in values}
        if challenge.qualities:
            fields["response"] = hashed(secret, nonce, uses, self._own_nonce, "auth", request)
            plain |= {"qop": "auth", "nc": uses}
        else:
            fields["response"] = hashed(secret, nonce, request)
        if challenge.qualities or challenge.is_session:
            fields["cnonce"] = self._own_nonce
        if "opaque" in values:
            fields["opaque"] = values["opaque"]
        quoted = (f"{name}={_quoted(value)}" for name, value in fields.items())
        return "Digest " + ", ".join([*quoted, *(f"{name}={plain[name]}" for name in plain)])


def _offers(challenges: Iterable[str]) -> Iterator[_Challenge]:
    """Yield the challenges of `WWW-Authenticate` headers (RFC 9110, 11.6.1)."""
    found = [match for text in challenges for match in _WORD.finditer(text[:_MAX_CHALLENGE])]
    starts = [at for at, match in enumerate(found) if match[2] is None][:_MAX_SCHEMES]
    for start, end in pairwise([*starts, len(found)]):
        values = {match[1].lower(): _unquoted(match[2]) for match in found[start + 1 : end]}
        yield _Challenge(found[start][1].lower(), values)


def _quoted(text: str) -> str:
    escaped = re.sub(r'(["\\])', r"\\\1", text)
    return f'"{escaped}"'


def _unquoted(text: str) -> str:
    return re.sub(r"\\(.)", r"\1", text[1:-1]) if text.startswith('"') else text


# ---- Options of a network camera beyond its address

_KNOWN_AUTHORITIES = Trust()

# The option that names a file with a password, and the environment variable that holds one.
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

    trust: Trust = _KNOWN_AUTHORITIES
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
