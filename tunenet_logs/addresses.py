"""Parse addresses of logs and cameras, keeping logins and signatures apart from what may be shown.

An address is public by accident: it stands in ledgers, recordings and terminals that people hand
on. So `str()` of one is what may be shown, and what else it holds is asked for by name.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from urllib.parse import unquote, urlsplit

from tunenet_logs.errors import UsageError

# What an address begins with, by RFC 3986; a device or a file has none.
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
# Schemes of addresses whose path is a key: any character may stand in it.
_OBJECT_STORES = ("s3", "gs", "gcs", "az", "abfs")
_AT_ACCOUNTS = ("az", "abfs")  # of these, those that are written container@account: no login
# User and password before a host, as RFC 3986 has them.
_LOGIN = re.compile(r"[^\s/?#]*@")
# The same with a `/`, `?` or `#` left in the password.
_UNQUOTED_LOGIN = re.compile(r"[^\s/?#@:\[]*:(?!\d{1,5}(?:[/?#]|$))[^\s@]*@")
# A host of one word, a port and an @ behind: it may as well be a password that begins so.
_LIKE_A_LOGIN = re.compile(r"(?!localhost\b)[^\s/?#@:\[.]+:\d{1,5}[/?#]\S*@")
_LOGIN_IN_TEXT = re.compile(
    r"(\b\w{1,10}:/{1,3})(?!@)"
    r"([^\s/?#]{0,400}@|[^\s/?#@:\[]{0,100}:(?!\d{1,5}(?:[/?#]|$))\S{0,400}@)(?=[^\s@])"
)
# One without a scheme before it, as in `user:password@192.168.1.20/video`.
_BARE_LOGIN = re.compile(
    r"(?<![^\s'\"(])[^/@\s:'\"]{0,100}:[^/@\s]{1,400}@(?=\[|\d+\.\d+\.\d+\.|[\w.-]+(?:/|:\d))"
)
_VALUE_IN_TEXT = re.compile(r"(?<=[?&;#])([\w.%-]+)=([^\s&;,#'\"<>()\[\]]+)")
_TOKEN_IN_TEXT = re.compile(r"(?<=\?)[^\s=&?'\"<>()\[\]]{12,}")  # a query without a name
# In the name of a query's parameter: it is, or belongs to, what proves a right.
_SECRET_PARTS = re.compile(
    r"signature|token|secret|passw|passphrase|credential|api-?key|access-?key|auth-?key|"
    r"private-?key|subscription-?key|key-?pair|oauth|authori[sz]|authent|hmac|jwt|rl-?key|"
    r"session-?id|access-?id|bearer|temp-?auth|temp-?url|expire|login|hdnea|hdnts|hdntl|cookie"
)
# The same as a whole word of such a name.
_SECRET_WORDS = re.compile(r"sig|sign|sas|pass|pwd|pw|psw|pswd|auth|gda|cred|creds|verify")
# Of names that belong to the signatures of object stores.
_SECRET_STARTS = ("x-amz-", "x-goog-", "x-oss-", "x-cos-", "x-obs-", "x-tos-", "x-ms-", "q-")
# Names beside `sig` in a shared access signature.
_AZURE = re.compile(
    r"sv|ss|srt|sp|se|st|spr|sr|si|sip|sdd|ses|skoid|sktid|skt|ske|sks|skv|saoid|suoid|scid|"
    r"rscc|rscd|rsce|rscl|rsct"
)
# Names that go with a signature where there is one; alone they may pick what is sent.
_BESIDE = re.compile(
    r"user|username|usr|u|policy|key|kid|ak|algorithm|hash-algorithm|alg|md5|hash|h|s|e|t|st|et|"
    r"ts|exp|deadline|timestamp|nonce|tid"
)
# Names that may be a password's, or may pick what is sent.
_GUESSABLE = re.compile(r"user|username|usr|key|code|pin|ticket|session|sid|u|p|k|s|h")
# Names whose values are long, and no secrets.
_PICKS = re.compile(r"version-id|version|generation|snapshot|ref|rev|revision|commit|sha")
_FILE = re.compile(r"(?:.*/)?[^/]+\.([A-Za-z]\w{1,6})", re.DOTALL)  # what names a file; its ending


def scheme_of(text: str) -> str:
    """Return the scheme of an address in lower case; "" where there is none."""
    return found[1].lower() if (found := _SCHEME.match(text)) else ""


@dataclass(frozen=True)
class Address:
    """Address of a log or a network camera; equality ignores credentials."""

    # Without login and signature; it is the address's `str()`. A parameter of the query that picks
    # what is sent stays, as a digest where it could be a secret.
    identity: str
    shown: str = field(compare=False)  # scheme, host, port and path alone
    url: str = field(repr=False, compare=False)  # to ask with: as given, but for the login
    full_url: str = field(repr=False, compare=False)  # as it was given
    user: str = field(default="", repr=False, compare=False)  # "" for none
    password: str | None = field(default=None, repr=False, compare=False)  # None: there is none

    def __str__(self) -> str:
        """Return what may be shown."""
        return self.identity

    @classmethod
    def of(cls, text: str) -> Address:
        """Parse an address."""
        scheme = scheme_of(text)
        rest = text[len(scheme) + 3 :]
        found = _LOGIN.match(rest)
        if found and scheme in _AT_ACCOUNTS and ":" not in found[0]:
            found = None
        if not found and scheme in _OBJECT_STORES:  # secret keys have a / in them
            found = _UNQUOTED_LOGIN.match(rest)
        login = found[0][:-1] if found else ""
        rest = rest[found.end() :] if found else rest
        url = f"{text[: len(scheme) + 3]}{rest}"
        is_torn = _UNQUOTED_LOGIN.match(rest) or (found and "@" in rest.partition("/")[0])
        is_doubtful = not found and scheme not in _OBJECT_STORES and _LIKE_A_LOGIN.match(rest)
        if is_torn or is_doubtful:
            raise UsageError(
                f"that is no {scheme} address; write / ? # @ % as %2F %3F %23 %40 %25, in a "
                "password and @ in a path, too"
            )
        if not scheme or not _has_host(url, scheme):
            scheme = scheme or "http"
            raise UsageError(f"that is no {scheme} address; write it like {scheme}://HOST/PATH")
        place, mark, query = rest.partition("?")
        if scheme not in _OBJECT_STORES:
            url, place, query = (one.partition("#")[0] for one in (url, place, query))
        elif not any(_is_secret(name) for name, _ in _parameters(query)):
            place, mark, query = rest, "", ""  # all of it is a key
        place = re.sub(
            r";([^;=/]+)=[^;/]*", lambda one: "" if _is_secret(one[1]) else one[0], place
        )
        picked = "&".join(_picking(query))
        shown = f"{scheme}://{place}"
        user, colon, password = login.partition(":")
        return cls(
            f"{shown}?{picked}" if mark and picked else shown,
            shown,
            url,
            text,
            unquote(user),
            unquote(password) if colon else None,
        )

    @property
    def name(self) -> str:
        """Name of the log: the last part of the path, or the file name in the query."""
        place, _, query = self.identity.partition("?")
        name = PurePosixPath(place).name
        # Not what a server runs to send a file that the query names.
        programs = ("php", "cgi", "asp", "aspx", "jsp")
        if (found := _FILE.fullmatch(name)) and found[1].lower() not in programs:
            return name
        named = (re.split(r"/|=|%2F|%3D", one)[-1] for _, one in _parameters(query))
        return next((one for one in named if _FILE.fullmatch(one)), name)

    @property
    def parent_name(self) -> str:
        """Name of the parent folder, or of the host."""
        return PurePosixPath(self.shown).parent.name

    def beside(self, url: str) -> Address:
        """Return another address, with the same login if it is on the same host."""
        if scheme_of(url) not in _OBJECT_STORES:
            url = url.replace("@", "%40")  # of a path: whose login it is stands in this one
        other, own = Address.of(url), urlsplit(self.url)
        if (own.scheme, own.netloc) != urlsplit(other.url)[:2]:
            return other
        return Address(
            other.identity, other.shown, other.url, other.full_url, self.user, self.password
        )


def without_secrets(text: str) -> str:
    """Replace each login and signature in the addresses of a text by `…`."""
    # For what libraries say: they quote the addresses that they were given.
    if "@" in text:
        text = _LOGIN_IN_TEXT.sub(_without_login, text)
        text = _BARE_LOGIN.sub("…@", text)
    if "?" in text:
        text = _TOKEN_IN_TEXT.sub(lambda found: found[0] if _is_plain(found[0]) else "…", text)
    return _VALUE_IN_TEXT.sub(_hidden, text) if "=" in text else text


def _has_host(url: str, scheme: str) -> bool:
    """Check whether there is a host, and that its port is valid."""
    if scheme in _OBJECT_STORES:
        return bool(re.match(r"[^/?#]", url[len(scheme) + 3 :]))
    try:
        parts = urlsplit(url)
        return bool(parts.hostname) and (parts.port is None or parts.port > 0)
    except ValueError:
        return False


def _parameters(query: str) -> list[tuple[str, str]]:
    pairs = (part.partition("=") for part in query.split("&") if part)
    return [(name, value) for name, _, value in pairs]


def _picking(query: str) -> list[str]:
    """Return the parameters that select what is sent, sorted by name."""
    pairs = [(name, value, _plain_name(name)) for name, value in _parameters(query)]
    is_signed = any(_is_secret(name) for name, _, _ in pairs)
    is_azure = any(plain == "sig" for _, _, plain in pairs)
    found: list[tuple[str, str]] = []
    for name, value, plain in pairs:
        belongs = _BESIDE.fullmatch(plain) and not _is_file(value)
        if plain in ("t", "timestamp"):  # a time within a log is short
            belongs = len(value) > 8
        if _is_secret(name) or (is_signed and belongs) or (is_azure and _AZURE.fullmatch(plain)):
            continue
        if not value and not _is_plain(name):
            found.append((_digest(unquote(name)), ""))  # a token that has no name
        else:
            found.append((name, value if _is_told(plain, value) else _digest(unquote(value))))
    return [
        f"{name}={value}" if value else name
        for name, value in sorted(found, key=lambda one: one[0])
    ]


def _digest(value: str) -> str:
    """Return a short SHA-256 digest, which tells a value from others without revealing it."""
    from hashlib import sha256  # every command imports this file, few get here

    return "~" + sha256(value.encode(errors="replace")).hexdigest()[:12]


def _plain_name(name: str) -> str:
    """Return a parameter's name in lower case, its words joined with `-`."""
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", unquote(name))
    return re.sub(r"[^a-z0-9]+", "-", words.lower()).strip("-")


def _is_secret(name: str) -> bool:
    plain = _plain_name(name)
    return (
        bool(_SECRET_PARTS.search(plain))
        or any(_SECRET_WORDS.fullmatch(word) for word in plain.split("-"))
        or plain.startswith(_SECRET_STARTS)
    )


def _is_told(name: str, value: str) -> bool:
    """Check whether a value is no secret, by its name and by itself."""
    if _PICKS.fullmatch(name) or not _is_plain(value):
        return _PICKS.fullmatch(name) is not None
    return len(value) < 2 or not _GUESSABLE.fullmatch(name) or _is_file(value)


def _is_file(value: str) -> bool:
    return _FILE.fullmatch(unquote(value)) is not None


def _is_plain(value: str) -> bool:
    """Check whether a value is what people write (words, numbers, paths) and not a token."""
    words = re.findall(r"[A-Za-z0-9]+", unquote(value))  # shorter where letters and digits mix
    return all(len(one) < (20 if one.isdecimal() or one.isalpha() else 12) for one in words)


def _without_login(found: re.Match[str]) -> str:
    is_account = found[1].partition(":")[0].lower() in _AT_ACCOUNTS and ":" not in found[2]
    return found[0] if is_account else found[1]


def _hidden(found: re.Match[str]) -> str:
    """Hide the value of a parameter within a text where it could be a secret."""
    name, value = found[1], found[2]
    is_secret = _is_secret(name) or not _is_told(_plain_name(name), value)
    return f"{name}=…" if is_secret and not value.startswith("~") else found[0]
