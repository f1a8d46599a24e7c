"""Parse a network camera's address as people write it."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

from tunenet_logs.addresses import Address, scheme_of
from tunenet_logs.errors import UsageError

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
