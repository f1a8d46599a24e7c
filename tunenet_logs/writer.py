"""Write crash-safe MCAP with schemas: what was acknowledged stays readable."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import NoReturn, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tunenet_logs import __version__, messages
from tunenet_logs.clock import now_ns
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.messages import INFO_RECORD
from tunenet_logs.output.log_place import NO_SPACE, LogPlace, not_writable
from tunenet_logs.output.mcap_output import McapOutput
from tunenet_logs.output.whole_file import WholeFile

_CHUNK_SECONDS = 0.1  # what a killed live recording loses at most
_SYNC_SECONDS = 1.0  # what a power cut may cost; oftener, a slow disk would hold up a recording


class EpisodeWriter:
    """Writer of one episode to `path` (ROS 2 CDR in MCAP). For one thread.

    The file is named `NAME.mcap.active` until it is whole. Chunks are small and, for a live
    source, closed every 0.1 s, so a killed recorder loses the last moments at most; once a second
    the disk is asked to keep them. The first write error, or too little space, ends the recording:
    the log is cut to what is whole, ended so that every reader opens it, and LogError says so.

    Args:
        path: the finished log.
        info: written at once, and again with the final counts at the end.
        overwrite: replace an existing log (only with one that did not end in an error).
        live: whether the source is gone once it is missed. Then `log_time` is the receipt, and
            chunks are closed by the clock, for which `tick` is to be called when nothing comes;
            else by their size alone, so that the same episode gives the same bytes.
        min_free_bytes: what is to stay free on the disk; 0 for no such bound.
        is_import: made from a log that is still there: if anything breaks it off, nothing is left.

    Attributes:
        accepted: messages handed over.
        tally: asked when the recording ends: what the recorder counted (`captured`, ...), and
            takes no more. `dropped` follows. Left alone, what was accepted was captured.

    Raises:
        LogError: `path` exists, the folder cannot be written to, or its disk has too little space.
    """

    def __init__(
        self,
        path: Path,
        info: EpisodeInfo,
        *,
        overwrite: bool = False,
        live: bool = True,
        min_free_bytes: int = 0,
        is_import: bool = False,
    ) -> None:
        self._place = LogPlace(path, overwrite=overwrite, min_free_bytes=min_free_bytes)
        self.path = path
        self.active_path = self._place.active_path
        self.info = info
        self.accepted = 0
        self.tally: Callable[[], Mapping[str, int]] = dict
        self._live = live
        self._is_import = is_import
        self._channels: dict[str, _Channel] = {}
        self._schemas: dict[str, int] = {}
        now = time.monotonic()
        self._chunk_at, self._sync_at = now + _CHUNK_SECONDS, now + _SYNC_SECONDS
        self._due_at = self._chunk_at if live else self._sync_at
        self._file = WholeFile(self._place.claim.descriptor)
        try:
            self._output = McapOutput(self._file, "ros2", f"tunenet-logs {__version__}")
            self._output.add_metadata(INFO_RECORD, info.to_strings())
        except OSError as error:
            self.discard()
            raise not_writable(path, error) from error

    def write_pose(
        self,
        topic: str,
        stamp_ns: int,
        position_m: NDArray[np.float64],
        turn: ArrayLike = messages.NOT_TURNED,
        frame: str = "world",
    ) -> None:
        """Write a PoseStamped at `position_m`, shape (3,) [m], and a quaternion x, y, z, w."""
        data = messages.encode(messages.pose(stamp_ns, frame, position_m, turn), messages.POSE)
        self.write_message(topic, messages.POSE, stamp_ns, data)

    def write_frame(self, topic: str, frame: Frame, received_ns: int | None = None) -> None:
        """Write an image as it is: a CompressedImage, CompressedVideo, or Image of bare pixels."""
        type_name, data = messages.frame(frame)
        self.write_message(topic, type_name, frame.stamp_ns, data, received_ns)

    def write_sound(
        self,
        topic: str,
        stamp_ns: int,
        pcm: NDArray[np.int16],
        rate_hz: int,
        received_ns: int | None = None,
    ) -> None:
        """Write a RawAudio of samples, shape (N, channels), the first taken at `stamp_ns`."""
        data = messages.encode(messages.raw_audio(stamp_ns, pcm, rate_hz), messages.RAW_AUDIO)
        self.write_message(topic, messages.RAW_AUDIO, stamp_ns, data, received_ns)

    def write_joints(
        self,
        topic: str,
        stamp_ns: int,
        names: Sequence[str],
        position_rad: ArrayLike,
        velocity_rad_s: ArrayLike = (),
        effort_nm: ArrayLike = (),
    ) -> None:
        """Write a JointState, each quantity of shape (joints,) [rad, rad/s, N·m] or empty."""
        state = messages.joint_state(stamp_ns, names, position_rad, velocity_rad_s, effort_nm)
        data = messages.encode(state, messages.JOINT_STATE)
        self.write_message(topic, messages.JOINT_STATE, stamp_ns, data)

    def write_message(
        self, topic: str, type_name: str, stamp_ns: int, data: bytes, received_ns: int | None = None
    ) -> None:
        """Write a message that is already CDR.

        Args:
            topic: with one type only.
            type_name: such as "sensor_msgs/msg/JointState".
            stamp_ns: of the acquisition.
            data: the message with its four bytes of encapsulation.
            received_ns: when a live one came, on the clock of `clock.now_ns`; now if None.

        Raises:
            LogError: writing failed, or the disk is nearly full; the recording is over.
            ValueError: a type that is not known, or another than the topic's.
        """
        channel = self._channels.get(topic)
        if channel is None or channel.type_name != type_name:
            channel = self._register(topic, type_name)
        channel.sequence += 1
        self.accepted += 1
        published_ns = max(stamp_ns, 0)  # MCAP knows no time before 1970
        log_ns = published_ns
        if self._live:
            log_ns = now_ns() if received_ns is None else received_ns
        try:
            self._output.add_message(channel.id, channel.sequence, log_ns, published_ns, data)
        except OSError as error:
            self._break_off(error)
        if time.monotonic() >= self._due_at:
            self.tick()

    def tick(self) -> None:
        """Close chunks and sync the disk when due; to be called often while nothing comes.

        Raises:
            LogError: writing failed, or the disk is nearly full; the recording is over.
        """
        now = time.monotonic()
        if now < self._due_at:
            return
        try:
            if self._live and now >= self._chunk_at:
                self._output.close_chunk()
                self._chunk_at = now + _CHUNK_SECONDS
            if now >= self._sync_at:
                self._file.sync()
                self._sync_at = now + _SYNC_SECONDS
                self._look_after_the_file()
                self._spare_the_disk()
        except OSError as error:
            self._break_off(error)
        self._due_at = min(self._chunk_at, self._sync_at) if self._live else self._sync_at

    @property
    def written(self) -> int:
        """Number of messages that are in the file and would survive this process."""
        return self._output.message_count

    def note(self, name: str, text: str) -> None:
        """Add a note to the log's info that became known while recording."""
        self.info = replace(self.info, notes={**self.info.notes, name: text})

    def note_at_once(self, name: str, text: str) -> None:
        """Add a note and write the info so far, so that a killed recorder's log has it, too.

        Raises:
            LogError: writing failed; the recording is over.
        """
        self.note(name, text)
        try:
            self._output.add_metadata(INFO_RECORD, self.info.to_strings())
        except OSError as error:
            self._break_off(error)

    def discard(self) -> None:
        """Leave no log: nothing came that is worth one. A log that it would replace stays."""
        self._place.claim.remove()

    def close(self, ended: str = "") -> None:
        """Finish the log and give it its name. Safe to call twice.

        Args:
            ended: why the recording ended before its source did.

        Raises:
            LogError: writing failed.
        """
        if self._is_over:
            return
        try:
            self._output.close_chunk()
            self._output.end(INFO_RECORD, self._final_info(ended))
            self._file.sync()
        except OSError as error:
            self._break_off(error)
        self._look_after_the_file()
        kept = self._place.keep(is_whole=True, or_nothing=self._is_import)
        if kept != self.path:
            raise LogError(f"{self.path}: exists by now, or cannot be written; {self._left(kept)}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if not self._is_import:
            self.close("" if kind is None else f"broke off ({kind.__name__})")
            return
        try:
            if kind is None:
                self.close()
        finally:
            self.discard()  # nothing is there where it was closed well

    def _register(self, topic: str, type_name: str) -> _Channel:
        self._place.claim.is_kept = not self._is_import
        if topic in self._channels:
            known = self._channels[topic].type_name
            raise ValueError(f"{topic} holds {known}, so it cannot hold {type_name}")
        text = messages.definition(type_name)
        if type_name not in self._schemas:
            self._schemas[type_name] = self._output.add_schema(type_name, "ros2msg", text)
        number = self._output.add_channel(topic, "cdr", self._schemas[type_name])
        self._channels[topic] = _Channel(number, type_name)
        return self._channels[topic]

    def _final_info(self, ended: str) -> dict[str, str]:
        """Return the info record of the end: what is in the file now, and what is not."""
        counts = {"captured": self.accepted, **self.tally()}
        captured = counts.pop("captured")
        dropped = captured - self.written
        info = self.info.ended(
            ended, captured=captured, dropped=dropped, **counts, written=self.written
        )
        self.info = info
        return info.to_strings()

    def _spare_the_disk(self) -> None:
        if why := self._place.why_too_full(self._file.free_bytes()):
            self._output.close_chunk()
            self._end_early(f"stopped, {why}", "free some space, or lower --min-free")

    def _look_after_the_file(self) -> None:
        """End a log whose file somebody removed, moved or replaced: what follows would be lost."""
        if why := self._place.claim.why_lost():
            self._output.close_chunk()
            verb = "importing" if self._is_import else "recording"
            remedy = "leave that file where it is until the log has ended"
            self._end_early(f"{self.active_path.name} {why} while {verb}", remedy)
        if self._file.is_changed():
            self._place.keep(is_whole=False, or_nothing=self._is_import)
            left = f"save what is left of {self.written} messages with tunenet-logs recover"
            raise LogError(
                f"{self.active_path}: another program cut it or wrote to it meanwhile; "
                + (self._left(None) if self._is_import else left)
            )

    def _break_off(self, error: OSError) -> NoReturn:
        if self._is_over:
            raise LogError(f"{self.path}: the recording is over", "begin another") from error
        verb = "import" if self._is_import else "record"
        is_full = error.errno in NO_SPACE
        remedy = f"free some space and {verb} again" if is_full else f"{verb} to another disk"
        self._end_early(f"writing failed ({error.strerror})", remedy, error)

    def _end_early(self, why: str, remedy: str, cause: OSError | None = None) -> NoReturn:
        """End the log with what is in it, and say what is kept and where."""
        is_whole = not self._is_import and (
            self._output.is_ended or self._output.end_as_fits(INFO_RECORD, self._final_info(why))
        )
        kept = self._place.keep(is_whole=is_whole, is_cut=True, or_nothing=self._is_import)
        raise LogError(f"{self.path}: {why}; {self._left(kept)}; {remedy}") from cause

    def _left(self, kept: Path | None) -> str:
        """Say what is left of a log that did not get its name."""
        if self._is_import:
            return "nothing is left of the import"
        messages = f"{self.written} of {self.info.counts['captured']} messages"
        if kept is None:
            return f"{messages} are lost: no copy of them could be written"
        return f"{messages} are kept in {self._place.called(kept)}"

    @property
    def _is_over(self) -> bool:
        return self._place.claim.descriptor < 0


class _Channel:
    """Topic in the log."""

    __slots__ = ("id", "sequence", "type_name")

    def __init__(self, number: int, type_name: str) -> None:
        self.id = number
        self.type_name = type_name
        self.sequence = 0
