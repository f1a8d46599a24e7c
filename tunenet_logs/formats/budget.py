"""Resource budget of reading one log, against decompression bombs and forged record counts.

A file of a megabyte can claim a hundred million records, or as many places of damage. What is over
the budget is left out, and a line says from where on.
"""

from __future__ import annotations

from dataclasses import dataclass

_FREE_BYTES = 1024 * 1024 * 1024  # what any file may unpack to in all, however small it is
# Bytes unpacked for each byte of the file, beyond `_FREE_BYTES`: more than messages pack by.
_MAX_RATIO = 256

_FREE_RECORDS = 250_000  # of any file, however small it is
# Of the file, for each record beyond those: a message has 31 before it is packed, and an entry of
# 16 in most indexes.
_BYTES_A_RECORD = 4

MAX_CHANNELS = 10_000  # of a log; robots have hundreds
# Of types, in a log; all that ROS has are a megabyte, and a bag repeats them for each topic.
_MAX_DEFINITION_BYTES = 128 * 1024 * 1024

CHUNK_RECORDS = 10  # what opening a chunk counts as
# What a record counts as that is taken apart field by field, such as a channel or metadata.
PART_RECORDS = 20

# What a damaged place counts as: it is searched for its end, and kept to be told.
DAMAGE_RECORDS = 50


class OverBudgetError(Exception):
    """Reading stopped because the log exceeds its budget."""


@dataclass
class Budget:
    """Resource budget of one log, proportional to its size.

    Attributes:
        file_bytes: size of the log.
        spent_bytes: bytes decompressed so far.
        spent_records: records read so far, or work of the same cost.
        channels: number of channels described so far.
        definition_bytes: size of their type definitions.
        files_bytes: size of the files of the log that were read before.
    """

    file_bytes: int
    spent_bytes: int = 0
    spent_records: int = 0
    channels: int = 0
    definition_bytes: int = 0
    files_bytes: int = 0

    def share(self, read: int) -> float:
        """Return the fraction of the log read, with `read` bytes of the current file."""
        return (self.files_bytes + read) / max(self.file_bytes, 1)

    @property
    def left_records(self) -> int:
        """Number of records that may still be read; negative once over budget."""
        return _FREE_RECORDS + self.file_bytes // _BYTES_A_RECORD - self.spent_records

    def spend(self, count: int) -> None:
        """Charge `count` bytes about to be decompressed.

        Raises:
            OverBudgetError: the log decompresses to more than the limit.
        """
        self.spent_bytes += count
        if self.spent_bytes > _FREE_BYTES + _MAX_RATIO * self.file_bytes:
            raise OverBudgetError(f"the log unpacks to more than {_MAX_RATIO} times its size")

    def spend_records(self, count: int = 1) -> None:
        """Charge records, or work of the same cost.

        Raises:
            OverBudgetError: they exceed the limit for the log's size.
        """
        self.spent_records += count
        if self.left_records < 0:
            raise OverBudgetError("it holds far more records than a log of its size")

    def spend_definition(self, count: int) -> None:
        """Charge `count` bytes of a type definition.

        Raises:
            OverBudgetError: all definitions exceed the limit.
        """
        self.definition_bytes += count
        if self.definition_bytes > _MAX_DEFINITION_BYTES:
            raise OverBudgetError(f"it has over {_MAX_DEFINITION_BYTES} bytes of definitions")

    def spend_channel(self) -> None:
        """Charge a channel.

        Raises:
            OverBudgetError: there are more than `MAX_CHANNELS`.
        """
        self.channels += 1
        self.spend_records(PART_RECORDS)
        if self.channels > MAX_CHANNELS:
            raise OverBudgetError(f"it has over {MAX_CHANNELS} channels")
