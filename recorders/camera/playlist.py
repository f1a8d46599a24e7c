"""Playlists of HLS (RFC 8216): which pieces a stream has, as far as a recorder needs them."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from urllib.parse import urljoin

from tunenet_logs.errors import CameraError

MOST_BYTES = 1024 * 1024
_MOST_PIECES = 20_000
"""Of a playlist: half a day of them."""

_DEFAULT_TARGET_S, _LONGEST_TARGET_S = 10.0, 600.0
_ATTRIBUTE = re.compile(r'(?<![A-Z0-9-])([A-Z0-9-]++)=("[^"]*"|[^",]*)')
_SECONDS = re.compile(r"\s*(\d{1,6}(?:\.\d{1,6})?)")


@dataclass(frozen=True)
class Variant:
    """One way in which a stream is offered.

    Attributes:
        bits_per_s: the most that it needs.
    """

    url: str
    bits_per_s: int


@dataclass(frozen=True)
class Segment:
    """A part of the stream.

    Attributes:
        number: by which it is known in later versions of the playlist.
        start_url: what stands before its bytes (the start of an MP4); "" for nothing.
    """

    url: str
    number: int
    start_url: str


@dataclass
class Playlist:
    """What a playlist says.

    Attributes:
        variants: other playlists, one of which is to be read instead; none in most.
        pieces: their numbers count up.
        target_s: length of the longest piece [s].
        has_ended: whether no more pieces will come.
    """

    variants: list[Variant] = field(default_factory=list)
    pieces: list[Segment] = field(default_factory=list)
    target_s: float = _DEFAULT_TARGET_S
    has_ended: bool = False


def read_playlist(data: bytes, url: str) -> Playlist:
    """Read a playlist.

    Args:
        data: its text.
        url: where it is, for what it names.

    Raises:
        CameraError: it is none, or its pieces are encrypted or parts of one file; without the
            camera's name.
    """
    lines = [line.strip() for line in data.decode("utf-8-sig", "replace").splitlines()]
    if not lines or not lines[0].startswith("#EXTM3U"):
        raise CameraError("names a playlist that is none; is it the address of its video?")
    reader = _Reader(url)
    for line in lines:
        if line.startswith("#"):
            tag, _, value = line.partition(":")
            reader.take_tag(tag, value)
        elif line:
            reader.take_place(line)
    return reader.playlist


class _Reader:
    """A playlist as far as it is read, and what goes for the next place."""

    def __init__(self, url: str) -> None:
        self.playlist = Playlist()
        self._url = url
        self._number = 0
        self._start_url = ""
        self._bits_per_s: int | None = None

    def take_tag(self, tag: str, value: str) -> None:
        _refuse_what_is_not_recorded(tag, value)
        if tag == "#EXT-X-TARGETDURATION" and (found := _SECONDS.match(value)):
            self.playlist.target_s = min(max(float(found[1]), 0.1), _LONGEST_TARGET_S)
        elif tag == "#EXT-X-MEDIA-SEQUENCE":
            self._number = _whole(value)
        elif tag == "#EXT-X-MAP":
            self._start_url = urljoin(self._url, _attributes(value).get("URI", ""))
        elif tag == "#EXT-X-STREAM-INF":
            self._bits_per_s = _whole(_attributes(value).get("BANDWIDTH", ""))
        elif tag == "#EXT-X-ENDLIST":
            self.playlist.has_ended = True

    def take_place(self, place: str) -> None:
        url = urljoin(self._url, place)
        pieces, variants = self.playlist.pieces, self.playlist.variants
        if self._bits_per_s is None:
            pieces.append(Segment(url, self._number + len(pieces), self._start_url))
        else:
            variants.append(Variant(url, self._bits_per_s))
            self._bits_per_s = None
        if len(pieces) + len(variants) > _MOST_PIECES:
            raise CameraError(f"names over {_MOST_PIECES} pieces; let it keep the newest alone")


def _refuse_what_is_not_recorded(tag: str, value: str) -> None:
    what = ""
    if tag == "#EXT-X-KEY" and _attributes(value).get("METHOD", "NONE") != "NONE":
        what = "encrypts its pieces (EXT-X-KEY)"
    elif tag == "#EXT-X-BYTERANGE" or (tag == "#EXT-X-MAP" and "BYTERANGE" in value):
        what = "keeps its pieces in one file (EXT-X-BYTERANGE)"
    if what:
        raise CameraError(
            f"{what}, which is not recorded; let it write each to a file as it is, or give the "
            "camera's RTSP or MJPEG address"
        )


def _attributes(text: str) -> dict[str, str]:
    return {name: value.strip('"') for name, value in _ATTRIBUTE.findall(text)}


def _whole(text: str) -> int:
    text = text.strip()
    return int(text[:18]) if text.isascii() and text.isdecimal() else 0
