"""Connect to a network camera: address, deadline, TLS, login, and the user's options.

A deadline bounds a whole exchange, however slowly bytes trickle in. Certificates are verified by a
known authority, by fingerprint, or not at all. Logins are basic or digest, for HTTP and RTSP (RFC
7617, 7616 and 2617).
"""

from __future__ import annotations

import hashlib
import re
import secrets
import select
import socket
import ssl
import threading
import time
from base64 import b64encode
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from hashlib import sha256
from http.client import HTTPException
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple
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
    """Parse a camera's address, which has a host and no characters that no address has."""
    scheme = scheme_of(text)
    with suppress(UsageError):
        if text.isascii() and text.isprintable() and " " not in text:
            return Address.of(text)
    raise UsageError(
        f"--camera: that is no {scheme} address; write it like {scheme}://192.168.1.20:8080/video"
    )


# ---- Deadline: shared by all reads of a connection


class Deadline:
    """A time by which the other side must have answered, and the longest silence until then."""

    def __init__(self, silence_s: float, whole_s: float) -> None:
        self.silence_s = silence_s
        self._sockets: list[socket.socket] = []
        self._lock = threading.Lock()
        self._is_broken_off = False
        self.renew(whole_s)

    @classmethod
    def opening(cls) -> Deadline:
        """Return the deadline for redirections, login and headers together."""
        return cls(OPENING_S, OPENING_S)

    def await_pictures(self, silence_s: float) -> None:
        """Wait from now on, when it has answered, for pictures between such silences."""
        self.silence_s = silence_s
        self.renew(longest_begin_s(silence_s))

    def renew(self, whole_s: float) -> None:
        """Restart the wait."""
        self.whole_s = whole_s
        self._end = time.monotonic() + whole_s

    @property
    def is_over(self) -> bool:
        """Whether the deadline has passed."""
        return time.monotonic() >= self._end

    def next_s(self) -> float:
        """Return how long the next read may take [s]."""
        if self.is_over:
            raise TimeoutError("too late")
        return max(1e-3, min(self.silence_s, self._end - time.monotonic()))

    def is_ready(self, readable: int | socket.socket) -> bool:
        """Wait until something can be read; False where `break_off` came first."""
        until = time.monotonic() + self.next_s()
        while not self._is_broken_off:
            left_s = until - time.monotonic()
            # Every 0.1 s, look whether the wait was broken off.
            if select.select([readable], [], [], max(0.0, min(0.1, left_s)))[0]:
                return True
            if left_s <= 0:
                raise TimeoutError("nothing came")
        return False

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


@dataclass(frozen=True)
class Trust:
    """Which certificates are trusted; by default those that a known authority signed."""

    fingerprint: str = ""  # SHA-256 of the only trusted certificate, in 64 capital hex digits
    is_insecure: bool = False  # whether any certificate is trusted

    @classmethod
    def of(cls, fingerprint: str | None, is_insecure: bool) -> Trust:
        """Parse the user's options; colons between the fingerprint's hex digits are optional."""
        if fingerprint is None:
            return cls(is_insecure=is_insecure)
        if is_insecure:
            raise UsageError("--insecure or --fingerprint: believe any certificate, or one")
        digits = fingerprint.replace(":", "").replace(" ", "").upper()
        if not re.fullmatch(r"[0-9A-F]{64}", digits):
            raise UsageError(
                "--fingerprint: a certificate's SHA-256 is 64 hex digits; leave it out to see it"
            )
        return cls(digits)

    @property
    def option(self) -> str:
        """Name of the given option; "" if there is none."""
        return "--fingerprint" if self.fingerprint else "--insecure" if self.is_insecure else ""


# ---- Connection: plain or TLS; errors begin with the camera's address

OPENING_S = 10.0  # until a camera has answered


def longest_begin_s(silence_s: float) -> float:
    """Return how long what has answered may take to its first picture [s]."""
    return max(OPENING_S, silence_s)


# Status codes, of HTTP and RTSP, of a server that is starting or overloaded: worth another try.
_PASSING = (404, 408, 425, 429, 453, 500, 502, 503, 504)


def connect(host: str, port: int, deadline: Deadline, trust: Trust | None) -> socket.socket:
    """Connect to a host, by TLS unless `trust` is None; `deadline` bounds all later reads, too."""
    try:
        plain = _plain(host, port, deadline)
        if trust is None:
            return plain
        try:
            connected = _secured(plain, host, deadline, is_verified=not trust.option)
        except ssl.SSLCertVerificationError as error:
            # The certificate is shown for the user to compare; nothing else is sent.
            again = _plain(host, port, deadline)
            with _secured(again, host, deadline, is_verified=False) as unverified:
                shown = _fingerprint(unverified)
            raise CameraError(
                f"its certificate cannot be verified ({error.verify_message}); to believe this "
                f"one, add --fingerprint {shown}; to believe any, add --insecure"
            ) from error
        if trust.fingerprint and (shown := _fingerprint(connected)) != trust.fingerprint:
            connected.close()
            raise CameraError(
                f"its certificate's fingerprint is {shown}, not {trust.fingerprint} as "
                "--fingerprint says: it has a new certificate, or another answers in its place"
            )
        deadline.watch(connected)
        return connected
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
    """Re-raise failures to talk to a camera as errors that begin with its address, `shown`."""
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


def refused(status: int, reason: str, to: str = "") -> CameraError:
    """Make the error of a status, of HTTP or RTSP, that is no success."""
    remedy = "check the path" if status == 404 else "check the address"
    kind = CameraAwayError if status in _PASSING else CameraError
    return kind(f"answers {status} {short_name(reason)}{to}; {remedy}")


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


def _secured(
    plain: socket.socket, host: str, deadline: Deadline, *, is_verified: bool
) -> ssl.SSLSocket:
    """Start TLS on a connection, which is closed with what is returned, and where this fails."""
    context = ssl.create_default_context()
    if not is_verified:
        context.check_hostname = False
        context.verify_mode = ssl.CERT_NONE
    context.sslsocket_class = with_deadline(ssl.SSLSocket, deadline)  # type: ignore[assignment]
    plain.settimeout(deadline.next_s())
    with closed_on_failure(plain):
        return context.wrap_socket(plain, server_hostname=host)


def _fingerprint(connected: ssl.SSLSocket) -> str:
    return sha256(connected.getpeercert(binary_form=True) or b"").hexdigest().upper()


# ---- Login: basic and digest authentication

# In a challenge: a scheme, or a name with its value, which may stand in quotes.
_WORD = re.compile(r'([^\s,="]+)(?:\s*=\s*("(?:[^"\\]|\\.)*"|[^\s,]*))?')

# Digest algorithms by their names in RFC 7616, from weak to strong; servers vary in their case.
_HASHES = {"MD5": "md5", "SHA-256": "sha256", "SHA-512-256": "sha512_256"}


class _Challenge(NamedTuple):
    """An authentication scheme that a server offers, and its parameters."""

    scheme: str
    values: dict[str, str]

    @property
    def algorithm(self) -> str:
        """Digest hash algorithm, in capitals."""
        return self.values.get("algorithm", "MD5").upper()

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
        algorithm = self.algorithm.removesuffix("-SESS")
        if self.scheme != "digest" or algorithm not in _HASHES or not is_possible:
            return 0
        return 2 + list(_HASHES).index(algorithm)


class Login:
    """Credentials, sent with every request once a server has asked for them."""

    def __init__(self, user: str, password: str, trouble: str = "") -> None:
        if not f"{user}{password}".isprintable():
            raise UsageError("--camera: a user or password has characters that nobody can type")
        self._user = user  # "" for none
        self._password = password
        self._trouble = trouble  # why none is known, where there is a reason
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
        """Take the strongest supported challenge of a 401."""
        why = f": {self._trouble}" if self._trouble else ""
        if not self.is_known:
            raise CameraError(
                f"wants a password (401{why}); put USER@ before the host, and the password into "
                "~/.netrc or a file of its own (--password-file)"
            )
        # The challenges of `WWW-Authenticate` headers (RFC 9110, 11.6.1): of each header 4000
        # characters are parsed, of its schemes the first ten.
        found = [match for text in challenges for match in _WORD.finditer(text[:4000])]
        starts = [at for at, match in enumerate(found) if match[2] is None][:10]
        offers: list[_Challenge] = []
        for start, end in pairwise([*starts, len(found)]):
            values = {match[1].lower(): match[2] for match in found[start + 1 : end]}
            for name, value in values.items():
                if value.startswith('"'):
                    values[name] = re.sub(r"\\(.)", r"\1", value[1:-1])
            offers.append(_Challenge(found[start][1].lower(), values))
        best = max(offers, key=lambda offer: offer.strength, default=None)
        if best is None or not best.strength:
            words = (
                (one.scheme, one.values.get("algorithm"), one.values.get("qop")) for one in offers
            )
            asked = listed(short_name(" ".join(filter(None, one))) for one in words) or "nothing"
            raise CameraError(
                f"asks for a login by {asked} (401); basic is known, and digest with MD5 or "
                "SHA-256 of the request (qop auth)"
            )
        if self._uses == 1 and best.values.get("stale", "").lower() != "true":
            raise CameraError(f"refuses this user and password (401{why}); check both")
        self._challenge = best
        self._own_nonce = secrets.token_hex(8)
        self._uses = 0

    def _digest(self, challenge: _Challenge, method: str, uri: str) -> str:
        """Compute the digest response (RFC 7616, 3.4; without a qop that of RFC 2069)."""
        values = challenge.values
        realm, nonce = values.get("realm", ""), values.get("nonce", "")
        uses = f"{self._uses:08x}"
        is_session = challenge.algorithm.endswith("-SESS")
        kind = _HASHES[challenge.algorithm.removesuffix("-SESS")]

        def hashed(*words: str) -> str:
            return hashlib.new(kind, ":".join(words).encode()).hexdigest()

        secret = hashed(self._user, realm, self._password)
        if is_session:  # the password is hashed with the nonces, once for all requests
            secret = hashed(secret, nonce, self._own_nonce)
        request = hashed(method, uri)
        fields = {"username": self._user, "realm": realm, "nonce": nonce, "uri": uri}
        plain = {"algorithm": values["algorithm"]} if "algorithm" in values else {}
        if challenge.qualities:
            fields["response"] = hashed(secret, nonce, uses, self._own_nonce, "auth", request)
            plain |= {"qop": "auth", "nc": uses}
        else:
            fields["response"] = hashed(secret, nonce, request)
        if challenge.qualities or is_session:
            fields["cnonce"] = self._own_nonce
        if "opaque" in values:
            fields["opaque"] = values["opaque"]
        escaped = {name: re.sub(r'(["\\])', r"\\\1", value) for name, value in fields.items()}
        words = [f'{name}="{value}"' for name, value in escaped.items()]
        return "Digest " + ", ".join([*words, *(f"{name}={one}" for name, one in plain.items())])


# ---- Options of a network camera beyond its address

PASSWORD_OPTION, PASSWORD_VARIABLE = "--password-file", "TUNENET_CAMERA_PASSWORD"
Transport = Literal["tcp", "udp"]  # of an RTSP camera's packets


@dataclass(frozen=True)
class NetworkOptions:
    """The user's options for a network camera."""

    trust: Trust = Trust()  # which certificates are trusted
    rtsp_transport: Transport | None = None  # None falls back to UDP where a camera refuses TCP
    password: str | None = field(default=None, repr=False)  # None: the address or netrc has it
    must_serve: bool = False  # whether a password that no camera uses is an error

    def known(self, address: Address) -> Address:
        """Add the password to an address that lacks one."""
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
        """Check that the options apply to an address's scheme ("" for none)."""
        if self.trust.option and scheme not in ("https", "rtsps"):
            raise UsageError(f"{self.trust.option} is for an https or rtsps camera; leave it out")
        if self.must_serve and scheme not in ("http", "https", "rtsp", "rtsps"):
            raise UsageError(f"{PASSWORD_OPTION} is for a camera that asks for one; leave it out")
        if self.rtsp_transport is not None and scheme not in ("rtsp", "rtsps"):
            raise UsageError("--rtsp-transport is for an rtsp camera; leave it out")
        if scheme == "rtsps" and self.rtsp_transport == "udp":
            raise UsageError("--rtsp-transport udp: rtsps encrypts TCP alone; leave it out")
