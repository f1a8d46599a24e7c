"""The work that one log may cost, in units: what an honest log of its size needs, and to spare.

A file of a megabyte can claim a hundred million records, or as many places of damage. What is over
the budget is left out, and a line says from where on.
"""

from __future__ import annotations

from dataclasses import dataclass

_FREE_BYTES = 1024 * 1024 * 1024
"""What any file may unpack to in all, however small it is."""

_MOST_RATIO = 256
"""Bytes unpacked for each byte of the file, beyond `_FREE_BYTES`: more than messages pack by."""

_FREE_RECORDS = 250_000
"""Of any file, however small it is."""

_BYTES_A_RECORD = 4
"""Of the file, for each record beyond those: a message has 31 before it is packed, and an entry of
16 in most indexes."""

MOST_CHANNELS = 10_000
"""Of a log; robots have hundreds."""

_MOST_DEFINITION_BYTES = 128 * 1024 * 1024
"""Of types, in a log; all that ROS has are a megabyte, and a bag repeats them for each topic."""

CHUNK_RECORDS = 10
"""What opening a chunk counts as."""

PART_RECORDS = 20
"""What a record counts as that is taken apart field by field, such as a channel or metadata."""

DAMAGE_RECORDS = 50
"""What a damaged place counts as: it is searched for its end, and kept to be told."""


class OverBudgetError(Exception):
    """Why no more of a log is read."""


@dataclass
class Budget:
    """What reading a whole log may cost.

    Attributes:
        file_bytes: size of the log.
        spent_bytes: what was unpacked of it so far.
        spent_records: records that were taken from it, or what costs as much.
        channels: that it described.
        definition_bytes: of their types.
        files_bytes: size of the files of the log that were read before.
    """

    file_bytes: int
    spent_bytes: int = 0
    spent_records: int = 0
    channels: int = 0
    definition_bytes: int = 0
    files_bytes: int = 0

    def share(self, read: int) -> float:
        """Which fraction of the log is read, with `read` bytes of this file."""
        return (self.files_bytes + read) / max(self.file_bytes, 1)

    @property
    def left_records(self) -> int:
        """Records that may yet be read; below zero where it was too many."""
        return _FREE_RECORDS + self.file_bytes // _BYTES_A_RECORD - self.spent_records

    def spend(self, count: int) -> None:
        """Count `count` bytes that are to be unpacked.

        Raises:
            OverBudgetError: with these the log unpacks to more than it may.
        """
        self.spent_bytes += count
        if self.spent_bytes > _FREE_BYTES + _MOST_RATIO * self.file_bytes:
            raise OverBudgetError(f"the log unpacks to more than {_MOST_RATIO} times its size")

    def spend_records(self, count: int = 1) -> None:
        """Count records, or what costs as much.

        Raises:
            OverBudgetError: there are more than a log of that size has.
        """
        self.spent_records += count
        if self.left_records < 0:
            raise OverBudgetError("it holds far more records than a log of its size")

    def spend_definition(self, count: int) -> None:
        """Count `count` bytes that define a type.

        Raises:
            OverBudgetError: there are more than any log has.
        """
        self.definition_bytes += count
        if self.definition_bytes > _MOST_DEFINITION_BYTES:
            raise OverBudgetError(f"it has over {_MOST_DEFINITION_BYTES} bytes of definitions")

    def spend_channel(self) -> None:
        """Count a channel.

        Raises:
            OverBudgetError: there are more than any log has.
        """
        self.channels += 1
        self.spend_records(PART_RECORDS)
        if self.channels > MOST_CHANNELS:
            raise OverBudgetError(f"it has over {MOST_CHANNELS} channels")
