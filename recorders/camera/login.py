"""Basic and digest authentication for HTTP and RTSP (RFC 7617, 7616 and 2617)."""

from __future__ import annotations

import hashlib
import re
import secrets
from base64 import b64encode
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from urllib.parse import urlsplit

from tunenet_logs.addresses import Address
from tunenet_logs.errors import CameraError, UsageError
from tunenet_logs.passwords import netrc_login
from tunenet_logs.terminal import listed, short_name

_MAX_HEADER = 4000  # characters of a challenge that are looked at
_MAX_SCHEMES = 10  # that one answer offers, of which the best is taken
# In a challenge: a scheme, or a name with its value, which may stand in quotes.
_WORD = re.compile(r'([^\s,="]+)(?:\s*=\s*("(?:[^"\\]|\\.)*"|[^\s,]*))?')

# Of a digest, by the names of RFC 7616, from weak to strong; servers write them as they like.
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
    found = [match for text in challenges for match in _WORD.finditer(text[:_MAX_HEADER])]
    starts = [at for at, match in enumerate(found) if match[2] is None][:_MAX_SCHEMES]
    for start, end in pairwise([*starts, len(found)]):
        values = {match[1].lower(): _unquoted(match[2]) for match in found[start + 1 : end]}
        yield _Challenge(found[start][1].lower(), values)


def _quoted(text: str) -> str:
    escaped = re.sub(r'(["\\])', r"\\\1", text)
    return f'"{escaped}"'


def _unquoted(text: str) -> str:
    return re.sub(r"\\(.)", r"\1", text[1:-1]) if text.startswith('"') else text
