"""Crash-safe, schema'd MCAP: what was acknowledged stays readable, whatever happens next."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from tunenet_logs import __version__, messages
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.messages import INFO_RECORD

ACTIVE_SUFFIX = ".active"
_CHUNK_BYTES = 64 * 1024
_FLUSH_SECONDS = 0.1


class EpisodeWriter:
    """Writes one episode to `path` (ROS 2 CDR in MCAP).

    The file is named `NAME.mcap.active` until it is whole. Chunks are small and, for a live
    source, closed at least every 0.1 s, so a killed recorder loses the last moments at most. The
    first write error ends the recording: the file keeps its whole chunks, stays readable under its
    `.active` name, and LogError says so.

    Args:
        path: the finished log.
        info: written at once, and again with the final counts at the end.
        overwrite: replace an existing log (only once the new one is whole).
        live: whether the source is gone once it is missed. Then chunks are closed by the clock;
            else by their size alone, and the same episode gives the same bytes.

    Raises:
        LogError: `path` exists, or the folder cannot be written to.
    """

    def __init__(
        self, path: Path, info: EpisodeInfo, *, overwrite: bool = False, live: bool = True
    ) -> None:
        if path.is_dir():
            raise LogError(f"{path}: is a directory; name a file to write")
        self.path = path
        self.info = info
        self.active_path = path.with_name(path.name + ACTIVE_SUFFIX)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._sequences: dict[str, int] = {}
        self._failed = False
        self._live = live
        if path.exists() and not overwrite:
            raise LogError(f"{path}: exists; choose another name with -o, or pass --overwrite")
        if self.active_path.exists() and not overwrite:
            raise LogError(
                f"{self.active_path}: is left from a recording that did not end; "
                "move it away, or pass --overwrite"
            )
        try:
            self._file = open(self.active_path, "wb")  # noqa: SIM115 (closed by close)
        except OSError as error:
            raise LogError(f"{self.active_path}: cannot be written ({error.strerror})") from error
        self._writer = Writer(
            self._file,
            chunk_size=_CHUNK_BYTES,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,
        )
        with self._guarded():
            self._writer.start(profile="ros2", library=f"tunenet-logs {__version__}")
            self._writer.add_metadata(INFO_RECORD, info.to_strings())
            self._flush()

    def write_pose(self, topic: str, stamp_ns: int, position_m: NDArray[np.float64]) -> None:
        """Write a PoseStamped in frame "world" [m]."""
        self._write(topic, messages.POSE, stamp_ns, messages.pose(stamp_ns, "world", position_m))

    def write_frame(self, topic: str, frame: Frame) -> None:
        """Write an image as it is."""
        message = messages.compressed_image(frame.stamp_ns, "camera", frame.encoding, frame.data)
        self._write(topic, messages.COMPRESSED_IMAGE, frame.stamp_ns, message)

    @property
    def written(self) -> int:
        """Messages accepted so far."""
        return sum(self._sequences.values())

    def note(self, name: str, text: str) -> None:
        """Say something in the log's info that became known while recording."""
        self.info = replace(self.info, notes={**self.info.notes, name: text})

    def discard(self) -> None:
        """Leave no log: nothing came that is worth one. A log that it would replace stays."""
        with suppress(OSError):  # the bytes that it still holds are not wanted
            self._file.close()
        self.active_path.unlink(missing_ok=True)

    def close(self, ended: str = "", **counts: int) -> None:
        """Finish the log and give it its name. Safe to call twice.

        Args:
            ended: why the recording ended before its source did.
            counts: what the recorder counted, beside `written`.
        """
        if self._file.closed:
            return
        info = self.info.ended(ended, **counts, written=self.written)
        with self._guarded():
            self._writer.add_metadata(INFO_RECORD, info.to_strings())
            self._writer.finish()
            self._file.flush()
            os.fdatasync(self._file.fileno())
        self._file.close()
        self.active_path.replace(self.path)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if not self._failed:
            self.close()

    def _write(self, topic: str, type_name: str, stamp_ns: int, message: Any) -> None:
        with self._guarded():
            channel = self._channels.get(topic)
            if channel is None:
                channel = self._register(topic, type_name)
            self._sequences[topic] += 1
            self._writer.add_message(
                channel_id=channel,
                log_time=stamp_ns,
                publish_time=stamp_ns,
                sequence=self._sequences[topic],
                data=messages.encode(message, type_name),
            )
            if self._live and time.monotonic() - self._flushed_at > _FLUSH_SECONDS:
                self._flush()

    def _register(self, topic: str, type_name: str) -> int:
        if type_name not in self._schemas:
            text = messages.definition(type_name).encode()
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", text)
        self._sequences[topic] = 0
        self._channels[topic] = self._writer.register_channel(
            topic, "cdr", self._schemas[type_name]
        )
        return self._channels[topic]

    def _flush(self) -> None:
        self._writer.flush()
        self._flushed_at = time.monotonic()

    @contextmanager
    def _guarded(self) -> Iterator[None]:
        """Turn the first write error into a readable file and one clear message."""
        try:
            yield
        except OSError as error:
            self._failed = True
            with suppress(OSError):  # it may fail again, on the bytes that it still holds
                self._file.close()
            raise LogError(
                f"{self.path}: writing failed ({error.strerror}); what was written before is kept "
                f"in {self.active_path.name}; free some space and record again"
            ) from error
