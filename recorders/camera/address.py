"""A network camera's address, with what must never be shown kept apart."""

from __future__ import annotations

from dataclasses import dataclass, field
from urllib.parse import unquote, urlsplit, urlunsplit

from tunenet_logs.errors import UsageError


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
