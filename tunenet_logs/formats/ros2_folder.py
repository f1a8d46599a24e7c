"""Read folders of a ROS 2 bag: one recording in one or several files, in numeric order."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from tunenet_logs.errors import COPY_AGAIN, LogError
from tunenet_logs.formats.base import Loss, RawMetadata, Record
from tunenet_logs.formats.budget import Budget
from tunenet_logs.formats.compression import ZSTD_MAGIC
from tunenet_logs.formats.database import MAGIC as DB3_MAGIC
from tunenet_logs.formats.exports.arrays.lerobot import a_file_of, is_data_set
from tunenet_logs.formats.mcap_container import MAGIC as MCAP_MAGIC
from tunenet_logs.formats.mcap_container import read_mcap
from tunenet_logs.formats.message_files import MessageFile, read_packed
from tunenet_logs.formats.ros2_db3 import read_db3
from tunenet_logs.messages import INFO_RECORD
from tunenet_logs.regular_file import open_regular

# By ending: how such a file begins, and its reader. rosbag2 can compress files as a whole.
_READERS: dict[str, tuple[bytes, MessageFile]] = {
    ".db3": (DB3_MAGIC, read_db3),
    ".mcap": (MCAP_MAGIC, read_mcap),
    ".db3.zstd": (ZSTD_MAGIC, read_packed),
    ".mcap.zstd": (ZSTD_MAGIC, read_packed),
}

_PACKED = ".zstd"  # what rosbag2 puts behind the name of a file that it compresses
_INDEX = "metadata.yaml"  # what rosbag2 writes beside the files when a recording ends
# Numbers farther apart are no parts of one recording: none is looked for between them. Nor are more
# files.
_MAX_PARTS = 10_000

# NAME_NUMBER, without the suffix; as many digits as fit 64 bits.
_NUMBERED = re.compile(r"(.+)_([0-9]{1,18})", re.DOTALL)


def read_folder(
    path: Path, losses: list[Loss], topics: Sequence[str] | None = None
) -> Iterator[Record]:
    """Yield the records of a ROS 2 bag's files, one after the other; see `Container`.

    Its `metadata.yaml` is not needed: a killed recording has none.
    """
    files = _files(path)
    if len(files) > 1 and not (path / _INDEX).is_file():
        what = f"no {_INDEX}; {files[0].name} to {files[-1].name} were read as one recording"
        losses.append(Loss(what, harmless=True))
    losses += _missing_parts(files)
    troubles: list[str] = []
    described: set[Path] = set()
    begin = len(losses)
    budget = Budget(sum(file.stat().st_size for file in files))
    for file in files:
        lost: list[Loss] = []
        try:
            for record in _records(file, lost, topics, budget):
                if isinstance(record, RawMetadata) and record.name == INFO_RECORD:
                    described.add(file)
                yield record
            budget.files_bytes += file.stat().st_size
        except LogError as error:
            trouble = error.what.removeprefix(f"{file}: ")
            troubles.append(f"{file.name} {trouble}")
            lost.append(Loss(trouble, size=file.stat().st_size))
        losses += [replace(loss, file=file.name) for loss in lost]
        if len(described) > 1:  # our own recordings are one file each
            raise _several(path, files)
    if len(troubles) == len(files):
        raise LogError(f"{path}: no file in it can be read: {troubles[0]}", COPY_AGAIN)
    losses[begin:] = _without_repeats(losses[begin:])


def is_bag_folder(path: Path) -> bool:
    """Return whether a folder is one recording, and not a folder of several.

    Raises:
        OSError: it cannot be read.
    """
    if (path / _INDEX).is_file():
        return True
    try:
        files = _files(path)
    except LogError:
        return False
    others = [one for one in path.iterdir() if not one.name.startswith(".")]
    if len(files) == 1:
        return len(others) == 1 and _numbered(files[0]) is not None
    return not all(map(_is_ours, files[:2]))


def _is_ours(file: Path) -> bool:
    """Return whether a file is an intact recording of `tunenet-record`."""
    try:
        records = _records(file, [], (), Budget(file.stat().st_size))
        return any(isinstance(one, RawMetadata) and one.name == INFO_RECORD for one in records)
    except (LogError, OSError):
        return False


def _records(
    file: Path, losses: list[Loss], topics: Sequence[str] | None, budget: Budget
) -> Iterator[Record]:
    """Yield the records of one file; raise LogError where nothing of it can be read."""
    ending = _ending(file)
    magic, read = _READERS[ending]
    with open_regular(file) as stream:
        start = stream.read(len(magic))
    if not start:
        raise LogError(f"{file}: is empty", COPY_AGAIN)
    if start != magic:
        raise LogError(f"{file}: is no {ending} file", COPY_AGAIN)
    yield from read(file, losses, topics, budget)


def _without_repeats(losses: Sequence[Loss]) -> list[Loss]:
    """Merge equal doubts about several files into one, behind the losses."""
    doubts: dict[str, list[Loss]] = {}
    for loss in losses:
        if loss.harmless:
            doubts.setdefault(loss.what, []).append(loss)
    lost = [loss for loss in losses if not loss.harmless]
    for same in doubts.values():
        first, more = same[0], len(same) - 1
        lost.append(replace(first, file=f"{first.file} and {more} more") if more else first)
    return lost


def _files(folder: Path) -> list[Path]:
    """Return the recording's files in order; raise LogError for none, or for several recordings."""
    found = [file for file in folder.iterdir() if file.is_file() and not file.name.startswith(".")]
    names = {file.name for file in found}
    files = [
        file
        for file in found
        if _ending(file)
        and not (file.suffix == _PACKED and file.stem in names)  # `zstd -d` leaves both
    ]
    if not files:
        if is_data_set(folder):
            raise LogError(f"{folder}: is a LeRobot data set; name {a_file_of(folder)}")
        raise LogError(
            f"{folder}: is a directory without the files of a ROS 2 bag (.db3, .mcap) or numbered "
            "pictures; name a log file"
        )
    if len(files) == 1:
        return files
    if len(files) > _MAX_PARTS:
        raise LogError(
            f"{folder}: is a directory with over {_MAX_PARTS} files of messages",
            "name one of its files",
        )
    numbered = {file: match for file in files if (match := _numbered(file))}
    names = {(_ending(file), match[1]) for file, match in numbered.items()}
    if len(numbered) < len(files) or len(names) > 1:
        raise _several(folder, files)
    return sorted(files, key=lambda file: (int(numbered[file][2]), file.name))


def _ending(file: Path) -> str:
    """Return which of the supported endings a file has; "" for another."""
    return next((ending for ending in _READERS if file.name.endswith(ending)), "")


def _numbered(file: Path) -> re.Match[str] | None:
    return _NUMBERED.fullmatch(file.name.removesuffix(_ending(file)))


def _missing_parts(files: Sequence[Path]) -> list[Loss]:
    """Return a loss for the numbers missing between those of the files."""
    numbers = [int(match[2]) for file in files if (match := _numbered(file))]
    if len(numbers) < 2 or numbers[-1] - numbers[0] > _MAX_PARTS:
        return []
    present = set(numbers)
    absent = [number for number in range(numbers[0], numbers[-1]) if number not in present][:5]
    words = ", ".join(str(number) for number in absent)
    return [Loss(f"of its files, those with number {words} are missing")] if absent else []


def _several(folder: Path, files: Iterable[Path]) -> LogError:
    shown = ", ".join(sorted(file.name for file in files)[:2])
    return LogError(f"{folder}: is a directory with several recordings ({shown}); name one of them")
