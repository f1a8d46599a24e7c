"""A stream that comes in pieces (HLS): they are fetched one after the other, from one host."""

from __future__ import annotations

from collections.abc import Callable
from urllib.parse import urlsplit

from recorders.camera.playlist import MOST_BYTES, Playlist, Segment, read_playlist
from recorders.camera.timed_feed import ByteFeed
from recorders.camera.ts_piece import TsPiece
from recorders.deadline import Deadline
from tunenet_logs.errors import CameraError
from tunenet_logs.terminal import short_name

_READ_BYTES = 65536


class HlsFeed:
    """The pieces of a playlist, joined; of a live one from the newest piece on.

    Args:
        url: of the playlist.
        first: what is sent there; closed here.
        ask: for what is at a place that a playlist names; it refuses other hosts.
        deadline: of all that is read.

    Raises:
        CameraError: it is no playlist that can be recorded.
        OSError: see `ByteFeed.read`.
    """

    def __init__(
        self, url: str, first: ByteFeed, ask: Callable[[str], ByteFeed], deadline: Deadline
    ) -> None:
        self._ask = ask
        self._deadline = deadline
        self._piece: ByteFeed | None = None
        self._start_url = ""
        self._url = url
        self._list = self._with_pieces(read_playlist(_all_of(first), url))
        self._next = self._beginning()

    @property
    def live(self) -> bool:
        """Whether pieces are added still."""
        return not self._list.has_ended

    @property
    def target_s(self) -> float:
        """About how far apart pieces come [s]."""
        return self._list.target_s

    def read(self, most: int) -> bytes:
        """See `ByteFeed`."""
        while self._piece is not None or self._begin_next():
            assert self._piece is not None
            data = self._piece.read(most)
            if data:
                return data
            self._piece.close()
            self._piece = None
        return b""

    def close(self) -> None:
        """See `ByteFeed`."""
        if self._piece is not None:
            self._piece.close()

    def _begin_next(self) -> bool:
        """Ask for the next piece, or for what stands before it; False at the end."""
        while (piece := self._next_listed()) is None:
            if self._list.has_ended or not self._deadline.pause(self._list.target_s / 2):
                return False
            self._list = self._with_pieces(self._listed())
            self._begin_anew_if_numbers_do()
        if piece.start_url != self._start_url:
            self._start_url = piece.start_url
            self._piece = self._ask(piece.start_url)
        else:
            follows = piece.number == self._next  # else pieces are missing, and pictures
            self._next = piece.number + 1
            self._piece = self._ask(piece.url)
            if follows:
                self._piece = TsPiece(self._piece)
        return True

    def _next_listed(self) -> Segment | None:
        pieces = self._list.pieces
        at = max(0, self._next - pieces[0].number) if pieces else 0
        return pieces[at] if at < len(pieces) else None

    def _begin_anew_if_numbers_do(self) -> None:
        """They do where the camera was started again."""
        pieces = self._list.pieces
        if pieces and pieces[-1].number + len(pieces) < self._next:
            self._next = self._beginning()

    def _beginning(self) -> int:
        pieces = self._list.pieces
        if not pieces:
            return 0
        return pieces[0].number if self._list.has_ended else pieces[-1].number

    def _with_pieces(self, playlist: Playlist) -> Playlist:
        """The playlist; or of its variants that of most bits which this host has."""
        if not playlist.variants:
            return playlist
        host = urlsplit(self._url).hostname
        own = [one for one in playlist.variants if urlsplit(one.url).hostname == host]
        if not own:
            other = short_name(urlsplit(playlist.variants[0].url).netloc.rpartition("@")[2])
            raise CameraError(f"has its video on {other}; if that is right, give that address")
        self._url = max(own, key=lambda one: one.bits_per_s).url
        playlist = self._listed()
        if playlist.variants:
            raise CameraError("names playlists of playlists of playlists; give the last one's")
        return playlist

    def _listed(self) -> Playlist:
        return read_playlist(_all_of(self._ask(self._url)), self._url)


def _all_of(feed: ByteFeed) -> bytes:
    """A playlist's text.

    Raises:
        CameraError: it has no end.
        OSError: see `ByteFeed.read`.
    """
    text = bytearray()
    try:
        while data := feed.read(_READ_BYTES):
            text += data
            if len(text) > MOST_BYTES:
                raise CameraError(f"sends a playlist of over {MOST_BYTES >> 20} MiB")
    finally:
        feed.close()
    return bytes(text)
