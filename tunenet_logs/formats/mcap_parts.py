"""Parse records of an MCAP file, bounded by their own bytes and in their number of parts.

The channels, as the file describes them and as its summary repeats them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import replace
from io import BytesIO
from typing import BinaryIO

from mcap import records as mcap_records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from tunenet_logs.formats.base import DAMAGED, RawChannel
from tunenet_logs.formats.budget import CHUNK_RECORDS, PART_RECORDS, Budget
from tunenet_logs.formats.compression import MAX_PART_BYTES, unpack
from tunenet_logs.formats.mcap_search import CHUNK, summary_records

# What parsing raises on damaged bytes, the mcap library's own errors too.
MCAP_DAMAGED = (*DAMAGED, McapError)

# Numbers and texts that one record is made of, twice as many as the words of its metadata.
_MAX_PARTS = 20_000


_MAX_REDEFINED = 10  # numbers given away twice that are named; each costs trust in all samples


class _Exact(BytesIO):
    """Byte stream that refuses reads beyond its end; the library would take what there is."""

    parts = 0

    def read(self, size: int | None = -1) -> bytes:
        """Read `size` bytes; raise ValueError if there are fewer, or after too many reads."""
        data = super().read(size)
        self.parts += 1
        if size is not None and len(data) < size:
            raise ValueError(f"a part of it claims {size} bytes")
        if self.parts > _MAX_PARTS:
            raise ValueError(f"it has over {_MAX_PARTS} parts")
        return data


def part_stream(body: memoryview, budget: Budget) -> ReadDataStream:
    """Open a record's body for the mcap library, charging the budget.

    Raises:
        OverBudgetError: it exceeds the budget.
    """
    budget.spend_records(PART_RECORDS)
    return ReadDataStream(_Exact(body))


def channels_of_summary(file: BinaryIO, size: int, budget: Budget) -> dict[int, RawChannel]:
    """Read the channels of an intact summary at the end of the file, by number.

    Empty where the summary is missing or damaged.

    Raises:
        OverBudgetError: it has more records than a log of that size.
    """
    found: dict[int, RawChannel] = {}
    schemas: dict[int, mcap_records.Schema] = {}
    try:
        for opcode, body in summary_records(file, size):
            budget.spend_records()
            if opcode == Opcode.SCHEMA:
                schema = mcap_records.Schema.read(part_stream(body, budget))
                schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = mcap_records.Channel.read(part_stream(body, budget))
                found[channel.id] = _with_schema(channel, schemas)
    except (*MCAP_DAMAGED, OSError):
        return {}
    return found


def unpacked_chunk(body: memoryview, budget: Budget) -> tuple[memoryview, bool]:
    """Decompress a chunk; return its records, and whether it carries their checksum.

    Raises:
        ValueError, struct.error: it is damaged.
        OverBudgetError: it exceeds the budget.
    """
    budget.spend_records(CHUNK_RECORDS)
    _, _, stated, crc, length = CHUNK.unpack_from(body)
    at = CHUNK.size + length
    compression = bytes(body[CHUNK.size : at]).decode("ascii", "replace")
    (packed,) = struct.unpack_from("<Q", body, at)
    if packed > len(body) - at - 8:
        raise ValueError(f"it claims {packed} bytes")
    if stated <= MAX_PART_BYTES:
        budget.spend(stated)
    plain = memoryview(unpack(body[at + 8 : at + 8 + packed], compression, stated))
    if crc and zlib.crc32(plain) != crc:
        raise ValueError("its checksum is wrong")
    return plain, crc != 0


class KnownChannels:
    """Channels of a file by number, as described in its data, else in its summary.

    Attributes:
        redefined: numbers used for two channels, in words: messages of these are ambiguous.

    Args:
        file: open for reading; its position is left as it was.
        size: of the file [bytes].
        budget: for channels, and records of the summary.
    """

    def __init__(self, file: BinaryIO, size: int, budget: Budget) -> None:
        self._file, self._size, self._budget = file, size, budget
        self._schemas: dict[int, mcap_records.Schema] = {}
        self._channels: dict[int, RawChannel] = {}
        self._summary: dict[int, RawChannel] | None = None
        self._told: dict[int, mcap_records.Channel] = {}
        self.redefined: list[str] = []
        self.get = self._channels.get

    def told(self, opcode: int, body: memoryview) -> tuple[int, RawChannel] | None:
        """Register a schema or channel; return number and channel where that is new.

        Raises:
            MCAP_DAMAGED: it is malformed.
            OverBudgetError: it exceeds the budget.
        """
        stream = part_stream(body, self._budget)
        if opcode == Opcode.SCHEMA:
            schema = mcap_records.Schema.read(stream)
            if schema.id not in self._schemas:
                self._budget.spend_definition(len(schema.data))
                self._schemas[schema.id] = schema
            elif schema != self._schemas[schema.id]:
                self._say_redefined(f"schema {schema.id}", schema.name)
            return None
        channel = mcap_records.Channel.read(stream)
        if channel.id in self._channels:
            first = self._told.get(channel.id, channel)
            if replace(channel, metadata={}) != replace(first, metadata={}):
                self._say_redefined(f"channel {channel.id}, {first.topic},", channel.topic)
            return None
        self._told[channel.id] = channel
        self._budget.spend_channel()
        found = self._channels[channel.id] = _with_schema(channel, self._schemas)
        return channel.id, found

    def _say_redefined(self, what: str, name: str) -> None:
        if len(self.redefined) < _MAX_REDEFINED:
            said = f"{what} is defined again as {name}: which messages are whose is not known"
            self.redefined.append(said)

    def forget(self, number: int) -> None:
        """Drop a channel whose description is damaged."""
        del self._channels[number]
        self._told.pop(number, None)

    def of_summary(self, number: int) -> RawChannel | None:
        """Look up an undescribed channel in the summary; None where it is absent there too.

        Raises:
            OverBudgetError: the summary has more records than a log of that size.
        """
        if self._summary is None:
            here = self._file.tell()
            self._summary = channels_of_summary(self._file, self._size, self._budget)
            self._file.seek(here)
        found = self._summary.get(number)
        if found is not None:
            self._channels[number] = found
        return found


def _with_schema(
    channel: mcap_records.Channel, schemas: Mapping[int, mcap_records.Schema]
) -> RawChannel:
    schema = schemas.get(channel.schema_id)
    return RawChannel(
        topic=channel.topic,
        type_name=schema.name if schema else "",
        encoding=channel.message_encoding,
        schema_encoding=schema.encoding if schema else "",
        schema=schema.data if schema else b"",
        metadata=channel.metadata,
    )
