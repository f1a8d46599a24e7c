"""Read a camera in a thread that fills a queue."""

from __future__ import annotations

import threading
from contextlib import closing

from recorders.camera.base import Shot, Source
from recorders.topic_queue import TopicQueue
from tunenet_logs.errors import CameraError, TuneNetError
from tunenet_logs.messages import CAMERA_TOPIC

# For a camera to notice that it is over: Ctrl-C shall be quick though one is silent.
_NOTICE_S = 0.3


class ReadingThread(threading.Thread):
    """A thread that queues a source's frames; its failure waits in `error`.

    A daemon: a camera that fell silent must not keep the process.

    Args:
        queue_bytes: pictures that may wait in the queue.
        counts: whether pictures count from the beginning; else from `queue.start` on.
    """

    def __init__(self, source: Source, queue_bytes: int, *, counts: bool) -> None:
        super().__init__(name="camera", daemon=True)
        self.source = source
        self.queue: TopicQueue[Shot] = TopicQueue(queue_bytes, drops=source.live, counts=counts)
        self.error: TuneNetError | None = None

    def run(self) -> None:
        """Read until the source ends or fails, or the queue is closed."""
        try:
            self._read()
        except TuneNetError as error:
            self.error = error
        except Exception as error:  # noqa: BLE001 (in a thread, else nobody would hear of it)
            self.error = CameraError(
                f"{self.source.name}: reading failed ({type(error).__name__}: {error})"
            )
            self.error.__cause__ = error
        finally:
            self.queue.close()

    def _read(self) -> None:
        connection, ahead_ns = None, 0
        with closing(self.source.frames()) as shots:  # type: ignore[type-var]
            for shot in shots:
                arrived_ns = shot.frame.stamp_ns
                told_ns = arrived_ns if shot.told_ns is None else shot.told_ns
                if shot.connection != connection:  # in each the camera may count anew
                    connection, ahead_ns = shot.connection, arrived_ns - told_ns
                if not self.queue.put(
                    CAMERA_TOPIC,
                    told_ns + ahead_ns if shot.told_ns is not None else arrived_ns,
                    shot,
                    len(shot.frame.data),
                    arrived_ns,
                    stands_alone=shot.stands_alone,
                ):
                    return

    @property
    def captured(self) -> int:
        """Number of pictures that came, including those dropped."""
        return self.queue.captured + self.source.dropped

    @property
    def dropped(self) -> int:
        """Number of pictures dropped."""
        return self.queue.dropped + self.source.dropped

    def tally(self) -> dict[str, int]:
        """Close the queue; return the counts."""
        self.queue.close()
        damaged = {"damaged": self.source.damaged} if self.source.damaged else {}
        return {"captured": self.captured, **damaged}

    def stop(self) -> None:
        """Close queue and source, and wait a moment for the thread to end."""
        self.queue.close()
        self.source.close()
        self.join(_NOTICE_S)
