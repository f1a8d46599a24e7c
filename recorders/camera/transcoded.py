"""Transcode a camera's video to JPEGs, beside the thread that reads it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from recorders.camera.base import Shot, Source
from recorders.camera.packet_stream import PacketStream
from recorders.camera.reading_thread import ReadingThread
from recorders.topic_queue import Item
from tunenet_logs.formats.video_messages import Packet, decoded
from tunenet_logs.jpeg import compressed

# Of compressed pictures that wait for the decoder: some seconds of a camera.
_WAITING_BYTES = 16 * 1024 * 1024

_MAX_WAITING = 256  # pictures that a decoder may hold back; none holds so many


class Transcoded:
    """A source whose pictures become JPEGs; those that are JPEGs stay.

    Where this machine cannot keep up, pictures are dropped before they are decoded, and with them
    those predicted from them, up to the next that stands alone. All are counted.

    Args:
        source: what the camera compressed; it is closed with this.
    """

    def __init__(self, source: PacketStream) -> None:
        self.name = source.name
        self.live = source.live
        self._source = source
        self._reader = ReadingThread(source, _WAITING_BYTES, counts=True)
        self._given = self._before = self._shown = self._undecoded = 0
        self._is_over = False
        self._next: Item[Shot] | None = None

    @property
    def returns(self) -> bool:
        """Whether reconnecting may bring more frames."""
        return self._source.returns

    @property
    def ended(self) -> str:
        """Why there are no more frames."""
        return self._source.ended

    @property
    def damaged(self) -> int:
        """Number of incomplete pictures, and of those that no decoder could decode."""
        return self._source.damaged + self._undecoded

    @property
    def dropped(self) -> int:
        """Number not decoded in time; in the end also those that still waited."""
        queue = self._reader.queue
        if not self._is_over:
            return queue.dropped
        return queue.captured - self._before - self._shown - self._undecoded

    def notes(self) -> dict[str, str]:
        """Return the source's notes, and that it was transcoded."""
        return {**self._source.notes(), "transcoded": "jpeg"}

    def frames(self) -> Iterator[Shot]:
        """Yield the pictures in order of time, each when it was decoded.

        Raises:
            TuneNetError: the source failed, or there is no decoder for it.
        """
        self._reader.start()
        try:
            self._next = self._taken()
            while self._next is not None:
                yield from self._run()
        finally:
            self._is_over = True
            self._reader.stop()
        if self._reader.error is not None:
            raise self._reader.error

    def close(self) -> None:
        """End a running `frames` soon."""
        self._reader.queue.close()
        self._source.close()

    def _run(self) -> Iterator[Shot]:
        """Decode up to the next drop: a decoder must not predict from missing pictures."""
        waiting: dict[int, Shot] = {}
        begun, shown = self._given, 0
        for picture in decoded(self._packets(waiting), lambda _name: self._source.decoder()):
            shot = waiting.pop(picture.stamp_ns)
            if not self._shown:
                self._before = begun = picture.stamp_ns
            made = compressed(replace(picture, stamp_ns=shot.frame.stamp_ns))
            yield Shot(made, shot.told_ns)
            shown += 1
            self._shown += 1
        self._undecoded += self._given - begun - shown

    def _packets(self, waiting: dict[int, Shot]) -> Iterator[Packet]:
        """Yield one decoder's packets, stamped by a picture's number."""
        while self._next is not None:
            shot = self._next.payload
            waiting[self._given] = shot
            if len(waiting) > _MAX_WAITING:
                del waiting[next(iter(waiting))]
            self._given += 1
            yield Packet(self._given - 1, shot.frame.encoding, shot.frame.data)
            self._next = self._taken()
            if self._next is not None and self._next.follows_drop:
                return

    def _taken(self) -> Item[Shot] | None:
        """Wait for the next picture; None at the end."""
        queue = self._reader.queue
        while not queue.is_done:
            item = queue.take()
            if item is not None:
                return item
            queue.pause()
        return None


def as_kept(stream: PacketStream, *, transcode: bool) -> Source:
    """Return a stream as logs can hold it, transcoded to JPEGs where needed or asked.

    Args:
        stream: opened.
        transcode: whether they are to be JPEGs in any case.
    """
    return Transcoded(stream) if transcode or stream.needs_decoding else stream
