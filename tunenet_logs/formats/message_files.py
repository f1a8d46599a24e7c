"""Detect message files by their first bytes, also when compressed as a whole."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

from tunenet_logs.errors import LogError
from tunenet_logs.formats.base import Loss, Record
from tunenet_logs.formats.budget import Budget
from tunenet_logs.formats.database import MAGIC as DB3_MAGIC
from tunenet_logs.formats.mcap_container import MAGIC as MCAP_MAGIC
from tunenet_logs.formats.mcap_container import read_mcap
from tunenet_logs.formats.packed_file import compression_of, unpacked
from tunenet_logs.formats.ros1_bag import MAGIC as BAG_MAGIC
from tunenet_logs.formats.ros1_bag import read_bag
from tunenet_logs.formats.ros2_db3 import read_db3
from tunenet_logs.regular_file import open_regular

_START_BYTES = 16  # of a file, by which it is known


class MessageFile(Protocol):
    """Reader of one kind of message file: a `Container`."""

    def __call__(
        self,
        path: Path,
        losses: list[Loss],
        topics: Sequence[str] | None = None,
        budget: Budget | None = None,
    ) -> Iterator[Record]:
        """Yield the records as `Container` does.

        Args:
            path: the file.
            losses: filled while reading.
            topics: yield only messages of these; None for all.
            budget: remaining budget, where the file was itself unpacked from another, or is
                one of several.
        """
        ...


# By the first bytes.
_READERS: dict[bytes, MessageFile] = {
    MCAP_MAGIC: read_mcap,
    BAG_MAGIC: read_bag,
    DB3_MAGIC: read_db3,
}


def message_file(start: bytes) -> MessageFile | None:
    """Return the reader of message files that begin like this; None where there is none."""
    return next((read for magic, read in _READERS.items() if start.startswith(magic)), None)


def read_packed(
    path: Path,
    losses: list[Loss],
    topics: Sequence[str] | None = None,
    budget: Budget | None = None,
) -> Iterator[Record]:
    """Yield the records of a message file that was compressed as a whole; see `MessageFile`."""
    with open_regular(path) as file:
        compression = compression_of(file.read(_START_BYTES))
    if not compression:
        raise LogError(f"{path}: is not compressed in a way that is read", "unpack it first")
    budget = budget or Budget(path.stat().st_size)
    with unpacked(path, compression, losses, budget) as inside:
        with open_regular(inside) as file:
            read = message_file(file.read(_START_BYTES))
        if read is None:
            raise LogError(
                f"{path}: holds no MCAP log and no bag", "unpack it, and name what is in it"
            )
        try:
            yield from read(inside, losses, topics, budget)
        except LogError as error:
            raise error.renamed(inside, path) from error
