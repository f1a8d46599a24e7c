"""Read a camera in a thread that fills a queue, and transcode its video to JPEGs."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace

from tunenet_logs.errors import CameraError, TuneNetError
from tunenet_logs.messages import CAMERA_TOPIC, compressed
from tunenet_logs.recorders.camera.base import CapturedFrame, Source
from tunenet_logs.recorders.camera.streams import PacketStream
from tunenet_logs.recorders.session import Item, TopicQueue
from tunenet_logs.video import Packet, decoded

_MAX_WAITING_BYTES = 16 * 1024 * 1024  # compressed, before the decoder: some seconds of a camera


class ReadingThread(threading.Thread):
    """A thread that queues a source's frames; its failure waits in `error`.

    A daemon: a camera that fell silent must not keep the process. At most `queue_bytes` of pictures
    wait; they count from the beginning, or (`counts`) from `queue.start` on.
    """

    def __init__(self, source: Source, queue_bytes: int, *, counts: bool) -> None:
        super().__init__(name="camera", daemon=True)
        self.source = source
        self.queue: TopicQueue[CapturedFrame] = TopicQueue(
            queue_bytes, drops=source.live, counts=counts
        )
        self.error: TuneNetError | None = None

    def run(self) -> None:
        """Read until the source ends or fails, or the queue is closed."""
        connection, ahead_ns = None, 0
        try:
            with closing(self.source.frames()) as shots:  # type: ignore[type-var]
                for shot in shots:
                    arrived_ns, told_ns = shot.frame.stamp_ns, shot.source_stamp_ns
                    if shot.connection != connection:  # in each the camera may count anew
                        connection = shot.connection
                        ahead_ns = 0 if told_ns is None else arrived_ns - told_ns
                    stamp_ns = arrived_ns if told_ns is None else told_ns + ahead_ns
                    size, alone = len(shot.frame.data), shot.stands_alone
                    if not self.queue.put(
                        CAMERA_TOPIC, stamp_ns, shot, size, arrived_ns, stands_alone=alone
                    ):
                        return
        except TuneNetError as error:
            self.error = error
        except Exception as error:  # noqa: BLE001 (in a thread, else nobody would hear of it)
            what = f"{type(error).__name__}: {error}"
            self.error = CameraError(f"{self.source.name}: reading failed ({what})")
            self.error.__cause__ = error
        finally:
            self.queue.close()

    @property
    def captured(self) -> int:
        """Number of pictures that came, including those dropped."""
        return self.queue.captured + self.source.dropped

    @property
    def dropped(self) -> int:
        """Number of pictures dropped."""
        return self.queue.dropped + self.source.dropped

    def stop(self) -> None:
        """Close queue and source, and wait a moment for the thread to end."""
        self.queue.close()
        self.source.close()
        self.join(0.3)  # [s]; Ctrl-C shall be quick though a camera is silent


class Transcoded:
    """A source whose pictures become JPEGs; those that are JPEGs stay.

    Where this machine cannot keep up, pictures are dropped before they are decoded, and with them
    those predicted from them, up to the next that stands alone. All are counted.
    """

    def __init__(self, source: PacketStream) -> None:
        self.name = source.name
        self.live = source.live
        self._source = source  # what the camera compressed; it is closed with this
        self._reader = ReadingThread(source, _MAX_WAITING_BYTES, counts=True)
        self._given = self._before = self._shown = self._undecoded = 0
        self._is_over = False
        self._next: Item[CapturedFrame] | None = None

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
        queue, decoded_of = self._reader.queue, self._before + self._shown + self._undecoded
        return queue.captured - decoded_of if self._is_over else queue.dropped

    def notes(self) -> dict[str, str]:
        """Return the source's notes, and that it was transcoded."""
        return {**self._source.notes(), "transcoded": "jpeg"}

    def frames(self) -> Iterator[CapturedFrame]:
        """Yield the pictures in order of time, each when it was decoded."""
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

    def _run(self) -> Iterator[CapturedFrame]:
        """Decode up to the next drop: a decoder must not predict from missing pictures."""
        waiting: dict[int, CapturedFrame] = {}
        begun, shown = self._given, 0
        for picture in decoded(self._packets(waiting), lambda _name: self._source.decoder()):
            shot = waiting.pop(picture.stamp_ns)
            if not self._shown:
                self._before = begun = picture.stamp_ns
            made = compressed(replace(picture, stamp_ns=shot.frame.stamp_ns))
            yield CapturedFrame(made, shot.source_stamp_ns)
            shown += 1
            self._shown += 1
        self._undecoded += self._given - begun - shown

    def _packets(self, waiting: dict[int, CapturedFrame]) -> Iterator[Packet]:
        """Yield one decoder's packets, stamped by a picture's number."""
        while self._next is not None:
            shot = self._next.payload
            waiting[self._given] = shot
            if len(waiting) > 256:  # no decoder holds back so many
                del waiting[next(iter(waiting))]
            self._given += 1
            yield Packet(self._given - 1, shot.frame.encoding, shot.frame.data)
            self._next = self._taken()
            if self._next is not None and self._next.follows_drop:
                return

    def _taken(self) -> Item[CapturedFrame] | None:
        """Wait for the next picture; None at the end."""
        queue = self._reader.queue
        while not queue.is_done:
            if (item := queue.take()) is not None:
                return item
            queue.pause()
        return None
