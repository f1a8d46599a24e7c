"""A network camera's address, with what must never be shown kept apart."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote, urlsplit, urlunsplit

from tunenet_logs.errors import UsageError

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
"""What an address begins with, by RFC 3986; a device or a file has none."""

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
"""How an address begins that was written without http://, as browsers take it."""

_LOGIN = re.compile(r"[^/@\s]*:[^/@\s]*@[^/@\s]")
"""User and password before a host, whatever the host: a file of that name would be shown."""


def scheme_of(text: str) -> str:
    """What an address begins with, in lower case; "" where it is none."""
    return found[1].lower() if (found := _SCHEME.match(text)) else ""


def with_scheme(text: str) -> str:
    """What was meant: http:// before what is an address without it, and no file that is there."""
    if scheme_of(text) or not (_BARE.match(text) or _LOGIN.match(text)):
        return text
    first = text.partition("/")[0]
    if Path(text).exists() or (first != text and Path(first).is_dir()):
        return text
    return f"http://{text}"


@dataclass(frozen=True)
class Address:
    """Where a network camera is.

    Attributes:
        shown: scheme, host, port and path: for messages and logs. Cameras take passwords in the
            query too, so that is left out.
        url: the same with the query, without user and password.
        full_url: as it was given.
    """

    shown: str
    url: str = field(repr=False)
    full_url: str = field(repr=False)
    user: str = field(default="", repr=False)
    password: str = field(default="", repr=False)

    @classmethod
    def of(cls, text: str) -> Address:
        """Take an address apart.

        Raises:
            UsageError: it has no host, a port that is none, or characters that no address has.
        """
        try:
            parts = urlsplit(text)
            host, _port = parts.hostname, parts.port
        except ValueError:
            host, parts = None, None
        if parts is None or not host or not text.isascii() or not text.isprintable() or " " in text:
            scheme = text.partition(":")[0]
            raise UsageError(
                f"--camera: that is no {scheme} address; "
                f"write it like {scheme}://192.168.1.20:8080/video"
            )
        place = parts.netloc.rpartition("@")[2]
        return cls(
            shown=urlunsplit((parts.scheme, place, parts.path, "", "")),
            url=urlunsplit((parts.scheme, place, parts.path, parts.query, "")),
            full_url=text,
            user=unquote(parts.username or ""),
            password=unquote(parts.password or ""),
        )

    def host_and_port(self) -> tuple[str, int]:
        """Of an address that is nothing more, such as tcp://192.168.1.20:5000.

        Raises:
            UsageError: it has no port, or more than that.
        """
        parts = urlsplit(self.full_url)
        more = parts.path.strip("/") or parts.query or parts.username is not None
        if parts.port is None or more:
            raise UsageError(
                f"--camera: a {parts.scheme} address has a host and a port alone; "
                f"write it like {parts.scheme}://192.168.1.20:5000"
            )
        return parts.hostname or "", parts.port
