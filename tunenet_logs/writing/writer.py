"""Write crash-safe MCAP with schemas: what was acknowledged stays readable.

`EpisodeWriter` puts messages into the chunks of an `McapOutput`, which counts what has reached the
file: so the log can be ended whole at any moment, even after a write that failed. `restamp` gives a
finished log other header stamps.
"""

from __future__ import annotations

import os
import struct
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, NoReturn, Self

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.stream_reader import StreamReader
from numpy.typing import ArrayLike, NDArray

from tunenet_logs import __version__, messages
from tunenet_logs.episode import EpisodeInfo, Frame
from tunenet_logs.errors import LogError
from tunenet_logs.files import open_regular
from tunenet_logs.messages import INFO_RECORD, SHOWS
from tunenet_logs.timing.arrivals import STAMPS_NOTE
from tunenet_logs.timing.stamps import now_ns
from tunenet_logs.writing.owned_path import (
    NO_SPACE,
    ClaimedName,
    LogPlace,
    WholeFile,
    free_bytes,
    not_writable,
)

MAGIC = b"\x89MCAP0\r\n"  # an MCAP file begins and ends with it


def bare_ending(data_crc32: int) -> bytes:
    """Encode the shortest end that readers take: no summary."""
    return bytes_of(DataEnd(data_crc32)) + bytes_of(Footer(0, 0, 0)) + MAGIC


def bytes_of(record: McapRecord) -> bytes:
    """Serialise a record."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


# ---- Chunks: the bytes of `mcap.writer.Writer`, counted when they have reached the file
# That writer counts what it is handed, so its end speaks of what a full disk never took. Chunks
# that cannot be packed are left so here, with less effort.

# A message's record up to its data: kind, length, channel, sequence number, two stamps [ns].
_MESSAGE = struct.Struct("<BQHIQQ")


class McapOutput:
    """MCAP file in the making: zstd chunks, CRCs of all; OSError leaves the file as it was."""

    def __init__(self, file: WholeFile, profile: str, library: str) -> None:
        self.is_ended = False
        self.message_count = 0  # in the file, those in the open chunk not counted
        self.drawn_count = 0  # those of them that only draw others for viewers
        self._file = file
        self._compressor = zstandard.ZstdCompressor()
        # It takes a fifth of the time, and leaves what does not pack as it is.
        self._quick_compressor = zstandard.ZstdCompressor(-1)
        # Counts and indexes of what has reached the file.
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._metadata_indexes: list[MetadataIndex] = []
        self._chunk_indexes = bytearray()  # as bytes: hours of recording make many
        self._chunk_count = 0
        self._counts: dict[int, int] = {}
        self._drawing: set[int] = set()  # channels that only draw others
        self._span_ns: tuple[int, int] | None = None
        self._open_chunk()
        file.append(MAGIC + bytes_of(Header(profile, library)))

    def _open_chunk(self) -> None:
        self._new: list[Schema | Channel] = []
        self._pieces: list[bytes] = []
        self._offset = 0
        self._entries: dict[int, list[int]] = {}

    def add_schema(self, name: str, encoding: str, text: str) -> int:
        """Announce a type of messages, and return its id."""
        number = self._next_id(Schema, self._schemas)
        self._announce(Schema(id=number, name=name, encoding=encoding, data=text.encode()))
        return number

    def add_channel(self, topic: str, encoding: str, schema_id: int, shows: str = "") -> int:
        """Announce a topic, and return its id; one that `shows` another is drawn, not read."""
        number = self._next_id(Channel, self._channels)
        if shows:
            self._drawing.add(number)
        self._announce(
            Channel(
                id=number,
                topic=topic,
                message_encoding=encoding,
                metadata={SHOWS: shows} if shows else {},
                schema_id=schema_id,
            )
        )
        return number

    def _next_id(self, kind: type[Schema | Channel], known: Sequence[object]) -> int:
        return 1 + len(known) + sum(isinstance(record, kind) for record in self._new)

    def add_message(
        self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, data: bytes
    ) -> None:
        """Add a message to the open chunk, and write that if it is full."""
        offset = self._offset
        entries = self._entries.get(channel_id)
        if entries is None:
            entries = self._entries[channel_id] = []
        entries += (log_ns, offset)
        length = _MESSAGE.size - 9 + len(data)  # which counts all but kind and length
        self._pieces += (_MESSAGE.pack(5, length, channel_id, sequence, log_ns, publish_ns), data)
        self._offset = offset = offset + 9 + length
        # Few enough that a killed recorder loses little, many enough to pack well.
        if offset > 64 * 1024:
            self.close_chunk()

    def close_chunk(self) -> None:
        """Write the open chunk, if it holds messages; one that does not fit is lost."""
        if not self._entries:
            return
        entries, new, data = self._entries, self._new, b"".join(self._pieces)
        self._open_chunk()
        compressed = self._packed(data)
        chunk = Chunk(
            compression="zstd",
            data=compressed,
            message_start_time=min(min(pairs[::2]) for pairs in entries.values()),
            message_end_time=max(max(pairs[::2]) for pairs in entries.values()),
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        start = self._file.size_bytes
        builder = RecordBuilder()
        chunk.write(builder)
        length = builder.count
        # The index of each channel's messages, behind the chunk.
        offsets: dict[int, int] = {}
        tail = b""
        for channel_id, pairs in entries.items():
            offsets[channel_id] = start + length + len(tail)
            size = 8 * len(pairs)
            # Kind, length, channel, size [bytes], and the entries.
            tail += struct.pack(f"<BQHI{len(pairs)}Q", 7, 6 + size, channel_id, size, *pairs)
        builder.write(tail)
        self._file.append(builder.end())
        # It is in the file: it counts.
        index = ChunkIndex(
            message_start_time=chunk.message_start_time,
            message_end_time=chunk.message_end_time,
            chunk_start_offset=start,
            chunk_length=length,
            message_index_offsets=offsets,
            message_index_length=len(tail),
            compression=chunk.compression,
            compressed_size=len(compressed),
            uncompressed_size=len(data),
        )
        self._chunk_indexes += bytes_of(index)
        self._chunk_count += 1
        self._schemas += (record for record in new if isinstance(record, Schema))
        self._channels += (record for record in new if isinstance(record, Channel))
        for channel_id, pairs in entries.items():
            self._counts[channel_id] = self._counts.get(channel_id, 0) + len(pairs) // 2
            self.message_count += len(pairs) // 2
            self.drawn_count += len(pairs) // 2 if channel_id in self._drawing else 0
        start_ns, end_ns = chunk.message_start_time, chunk.message_end_time
        first_ns, last_ns = self._span_ns or (start_ns, end_ns)
        self._span_ns = min(first_ns, start_ns), max(last_ns, end_ns)

    def _packed(self, data: bytes) -> bytes:
        # Four samples show whether it can be packed: films and pictures are packed already.
        step = len(data) // 4
        if step > 2048:
            sample = b"".join(data[at : at + 2048] for at in range(0, 4 * step, step))
            if len(self._compressor.compress(sample)) > 0.97 * len(sample):
                return self._quick_compressor.compress(data)
        return self._compressor.compress(data)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record at once."""
        record, index = self._metadata(name, values)
        self._file.append(record)
        self._metadata_indexes.append(index)

    def end(self, name: str, values: Mapping[str, str]) -> None:
        """Write a last metadata record and the end of the log. The open chunk is left out."""
        record, index = self._metadata(name, values)
        self._file.append(record + self._ending(record, index))
        self.is_ended = True

    def end_as_fits(self, name: str, values: Mapping[str, str]) -> bool:
        """End the log on a full disk with as much as fits; return False if nothing does.

        What is given up, in this order: the index of the chunks, so that readers go through the
        log from its beginning; the rest of the summary; the metadata record.
        """
        record, index = self._metadata(name, values)
        for piece in (
            record + self._ending(record, index),
            record + self._ending(record, index, has_chunk_index=False),
            record + bare_ending(zlib.crc32(record, self._file.crc32)),
            bare_ending(self._file.crc32),
        ):
            with suppress(OSError):
                self._file.append(piece)
                self.is_ended = True
                break
        return self.is_ended

    def _announce(self, record: Schema | Channel) -> None:
        self._new.append(record)
        piece = bytes_of(record)
        self._pieces.append(piece)
        self._offset += len(piece)

    def _metadata(self, name: str, values: Mapping[str, str]) -> tuple[bytes, MetadataIndex]:
        record = bytes_of(Metadata(name=name, metadata=dict(values)))
        return record, MetadataIndex(self._file.size_bytes, len(record), name)

    def _ending(self, record: bytes, last: MetadataIndex, *, has_chunk_index: bool = True) -> bytes:
        """Encode data end, summary and footer, which follow the `record` of the `last` metadata."""
        data_end = bytes_of(DataEnd(zlib.crc32(record, self._file.crc32)))
        start = self._file.size_bytes + len(record) + len(data_end)
        metadata_indexes = [*self._metadata_indexes, last]
        first_ns, last_ns = self._span_ns or (0, 0)
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=self._counts,
            chunk_count=self._chunk_count,
            message_count=self.message_count,
            metadata_count=len(metadata_indexes),
            message_start_time=first_ns,
            message_end_time=last_ns,
            schema_count=len(self._schemas),
        )
        summary, offsets = bytearray(), bytearray()
        for opcode, group in (
            (Opcode.SCHEMA, b"".join(map(bytes_of, self._schemas))),
            (Opcode.CHANNEL, b"".join(map(bytes_of, self._channels))),
            (Opcode.STATISTICS, bytes_of(statistics)),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_indexes) if has_chunk_index else b""),
            (Opcode.ATTACHMENT_INDEX, b""),
            (Opcode.METADATA_INDEX, b"".join(map(bytes_of, metadata_indexes))),
        ):
            offsets += bytes_of(SummaryOffset(opcode, start + len(summary), len(group)))
            summary += group
        offset_start = start + len(summary)
        summary += offsets
        head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
        crc32 = zlib.crc32(head, zlib.crc32(summary))
        return data_end + bytes(summary) + bytes_of(Footer(start, offset_start, crc32)) + MAGIC


# ---- Restamping: other header stamps for a finished log of ours, known only at its end
# The log is copied and then replaced at once, so that it is whole at every moment.

# A header's stamp in CDR: seconds and nanoseconds, behind four bytes of encapsulation.
_STAMP, _STAMP_AT = struct.Struct("<iI"), 4


def header_stamps_ns(path: Path, topic: str) -> list[int]:
    """Return the header stamps of a topic's messages, in the order of the file [ns]."""
    stamps: list[int] = []
    numbers: set[int] = set()
    try:
        with open_regular(path) as log:
            for record in StreamReader(log).records:
                if isinstance(record, Channel) and record.topic == topic:
                    numbers.add(record.id)
                elif isinstance(record, Message) and record.channel_id in numbers:
                    stamps.append(_stamp_ns(record.data))
    except (OSError, McapError, struct.error) as error:
        raise LogError(f"{path}: cannot be read again ({error})", "check its disk") from error
    return stamps


def restamp(path: Path, topic: str, stamps_ns: Mapping[int, int], note: str) -> None:
    """Replace the header stamps [ns], new by old, of a topic; their log stamps stay what they were.

    The log is whole and of `EpisodeWriter`, and stays as it was where it cannot be copied; `note`
    says in the info record whose clock that is.
    """
    try:
        name = path.with_name(f"{path.name}.{os.getpid()}.stamping")
        copy = ClaimedName(name, takes_over=False)
        try:
            with open_regular(path) as log:
                _copy(log, copy.descriptor, topic, stamps_ns, note)
                if not os.path.samestat(os.lstat(path), os.fstat(log.fileno())):
                    raise LogError(
                        f"{path}: was replaced while its stamps were written",
                        "leave it where it is, and do it again",
                    )
                copy.rename(path, replaces=True)
        finally:
            copy.remove()  # nothing is there where it was renamed
    except (OSError, McapError) as error:
        if isinstance(error, OSError):
            raise not_writable(path, error) from error
        raise LogError(f"{path}: cannot be read again ({error})", "check its disk") from error


def _copy(
    log: BinaryIO, descriptor: int, topic: str, stamps_ns: Mapping[int, int], note: str
) -> None:
    file = WholeFile(descriptor)
    output = McapOutput(file, "ros2", f"tunenet-logs {__version__}")
    types: dict[int, Schema] = {}
    schemas: dict[int, int] = {}
    channels: dict[int, Channel] = {}
    ids: dict[int, int] = {}
    last: Metadata | None = None
    for record in StreamReader(log).records:
        if isinstance(record, Schema):
            types[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Metadata):
            if last is not None:
                output.close_chunk()
                output.add_metadata(last.name, last.metadata)
            last = record
        elif isinstance(record, Message):
            channel = channels[record.channel_id]
            if channel.schema_id not in schemas:
                schema = types[channel.schema_id]
                schemas[schema.id] = output.add_schema(
                    schema.name, schema.encoding, schema.data.decode()
                )
            if channel.id not in ids:
                ids[channel.id] = output.add_channel(
                    channel.topic,
                    channel.message_encoding,
                    schemas[channel.schema_id],
                    channel.metadata.get(SHOWS, ""),
                )
            data, published_ns = record.data, record.publish_time
            if channel.topic == topic:
                published_ns = stamps_ns[_stamp_ns(data)]
                stamp = _STAMP.pack(*divmod(published_ns, 10**9))
                data = data[:_STAMP_AT] + stamp + data[_STAMP_AT + _STAMP.size :]
            output.add_message(
                ids[channel.id], record.sequence, record.log_time, max(published_ns, 0), data
            )
    output.close_chunk()
    name, values = (last.name, last.metadata) if last else (INFO_RECORD, {})
    output.end(name, {**values, f"notes.{STAMPS_NOTE}": note})
    file.sync()


def _stamp_ns(data: bytes) -> int:
    seconds, nanoseconds = _STAMP.unpack_from(data, _STAMP_AT)
    return seconds * 10**9 + nanoseconds


# ---- Episode

_CHUNK_SECONDS = 0.1  # what a killed live recording loses at most
_LAST_RECORD = f"{INFO_RECORD}/end"
_SYNC_SECONDS = 1.0  # what a power cut may cost; oftener, a slow disk would hold up a recording


class EpisodeWriter:
    """Writer of one episode to `path` (ROS 2 CDR in MCAP). For one thread.

    The file is named `NAME.mcap.active` until it is whole. Chunks are small and, for a live source,
    closed every 0.1 s; once a second the disk is asked to keep them. The first write error, or too
    little space, ends the recording: the log is cut to what is whole, ended so that every reader
    opens it, and LogError says so. An existing log may be overwritten only by one that did not end
    in an error; an import that breaks off leaves nothing.

    A live source is gone once it is missed: `log_time` is the receipt, and chunks are closed by the
    clock, for which `tick` is to be called when nothing comes. Else they are closed by their size
    alone, so that the same episode gives the same bytes. `min_free_bytes` stay free on the disk.
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
        self.accepted = 0  # messages handed over, those not counted that draw others
        # Asked when the recording ends: what the recorder counted (`captured`, ...), and takes no
        # more. `dropped` follows. Left alone, what was accepted was captured.
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
            self._told = info.to_strings()  # what the log says of the episode so far
            self._tellings = 0  # records of what was noted since
            self._output.add_metadata(INFO_RECORD, self._told)
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
        self._write(
            topic, messages.POSE, stamp_ns, messages.pose(stamp_ns, frame, position_m, turn)
        )

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
        audio = messages.raw_audio(stamp_ns, pcm, rate_hz)
        self._write(topic, messages.RAW_AUDIO, stamp_ns, audio, received_ns)

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
        self._write(topic, messages.JOINT_STATE, stamp_ns, state)

    def _write(
        self, topic: str, kind: str, stamp_ns: int, message: Any, received_ns: int | None = None
    ) -> None:
        self.write_message(topic, kind, stamp_ns, messages.encode(message, kind), received_ns)

    def write_message(
        self,
        topic: str,
        type_name: str,
        stamp_ns: int,
        data: bytes,
        received_ns: int | None = None,
        *,
        shows: str = "",
    ) -> None:
        """Write a message of a topic's one type, as CDR behind its four bytes of encapsulation.

        `stamp_ns` is that of the acquisition; `received_ns` tells when a live one came, on the
        clock of `now_ns`: now if None. One that only draws another topic for viewers `shows` that,
        and is not counted. After a LogError the recording is over.
        """
        channel = self._channels.get(topic)
        if channel is None or channel.type_name != type_name:
            # A topic's first message announces it; with one the log is kept.
            self._place.claim.is_kept = not self._is_import
            if channel is not None:
                held = channel.type_name
                raise ValueError(f"{topic} holds {held}, so it cannot hold {type_name}")
            text = messages.definition(type_name)
            if type_name not in self._schemas:
                self._schemas[type_name] = self._output.add_schema(type_name, "ros2msg", text)
            number = self._output.add_channel(topic, "cdr", self._schemas[type_name], shows)
            channel = self._channels[topic] = _Channel(number, type_name)
        channel.sequence += 1
        self.accepted += not shows
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
        """Close chunks and sync the disk when due; to be called often while nothing comes."""
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
                if why := self._place.why_too_full(free_bytes(self._place.claim.descriptor)):
                    self._output.close_chunk()
                    self._end_early(f"stopped, {why}", "free some space, or lower --min-free")
        except OSError as error:
            self._break_off(error)
        self._due_at = min(self._chunk_at, self._sync_at) if self._live else self._sync_at

    @property
    def written(self) -> int:
        """Number of messages that are in the file and would survive this process."""
        return self._output.message_count - self._output.drawn_count

    def note(self, name: str, text: str) -> None:
        """Add a note to the log's info that became known while recording."""
        self.info = replace(self.info, notes={**self.info.notes, name: text})

    def note_at_once(self, name: str, text: str) -> None:
        """Add a note and write the info so far, so that a killed recorder's log has it, too."""
        self.note(name, text)
        self._tellings += 1
        try:
            self._output.add_metadata(f"{INFO_RECORD}/{self._tellings}", self.info.news(self._told))
        except OSError as error:
            self._break_off(error)
        self._told = self.info.to_strings()

    def discard(self) -> None:
        """Leave no log: nothing came that is worth one. A log that it would replace stays."""
        self._place.claim.remove()

    def close(self, ended: str = "") -> None:
        """Finish the log, give it its name, and note why it `ended` early. Safe to call twice."""
        if self._is_over:
            return
        try:
            self._output.close_chunk()
            self._output.end(_LAST_RECORD, self._final_info(ended))
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

    def _final_info(self, ended: str) -> dict[str, str]:
        """Return the news of the end: what is in the file now, and what is not."""
        counts = {"captured": self.accepted, **self.tally()}
        captured = counts.pop("captured")
        dropped = captured - self.written
        info = self.info.ended(
            ended, captured=captured, dropped=dropped, **counts, written=self.written
        )
        self.info = info
        return info.news(self._told)

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
            self._output.is_ended or self._output.end_as_fits(_LAST_RECORD, self._final_info(why))
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


@dataclass(slots=True)
class _Channel:
    """Topic in the log."""

    id: int
    type_name: str
    sequence: int = 0
