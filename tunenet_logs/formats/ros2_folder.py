"""Folders of a ROS 2 bag: one recording in one file or several, in the order of their numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from tunenet_logs.errors import LogError
from tunenet_logs.formats.base import Container, Loss, Record
from tunenet_logs.formats.database import MAGIC as DB3_MAGIC
from tunenet_logs.formats.mcap_container import MAGIC as MCAP_MAGIC
from tunenet_logs.formats.mcap_container import read_mcap
from tunenet_logs.formats.ros2_db3 import read_db3

_READERS: dict[str, tuple[bytes, Container]] = {
    ".db3": (DB3_MAGIC, read_db3),
    ".mcap": (MCAP_MAGIC, read_mcap),
}
_PACKED = (".db3.zstd", ".mcap.zstd")
_INDEX = "metadata.yaml"
_NUMBERED = re.compile(r"(.+)_([0-9]{1,18})", re.DOTALL)


def read_folder(
    path: Path, losses: list[Loss], topics: Sequence[str] | None = None
) -> Iterator[Record]:
    """The records of a ROS 2 bag's files, one after the other; see `Container`.

    What its `metadata.yaml` says is not needed: a killed recording has none.
    """
    files = _files(path)
    if len(files) > 1 and not (path / _INDEX).is_file():
        what = f"no {_INDEX}; {files[0].name} to {files[-1].name} were read as one recording"
        losses.append(Loss(what, harmless=True))
    doubts: dict[str, list[str]] = {}
    troubles: list[str] = []
    for file in files:
        lost: list[Loss] = []
        magic, read = _READERS[file.suffix]
        try:
            _check_start(file, magic)
            yield from read(file, lost, topics)
        except LogError as error:
            trouble = str(error).removeprefix(f"{file}: ")
            troubles.append(f"{file.name} {trouble}")
            lost.append(Loss(trouble, size=file.stat().st_size))
        for one in lost:
            if one.harmless:
                doubts.setdefault(one.what, []).append(file.name)
            else:
                losses.append(replace(one, file=file.name))
    if len(troubles) == len(files):
        raise LogError(f"{path}: no file in it can be read; {troubles[0]}")
    for what, names in doubts.items():
        name = names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
        losses.append(Loss(what, file=name, harmless=True))


def _files(folder: Path) -> list[Path]:
    """The files of the recording, in its order.

    Raises:
        LogError: there are none, or they are of several recordings.
    """
    found = [one for one in folder.iterdir() if one.is_file() and not one.name.startswith(".")]
    packed = [one.name for one in found if one.name.endswith(_PACKED)]
    if packed:
        raise LogError(
            f"{folder}: {min(packed)} is compressed as a whole; "
            "unpack such files first with `zstd -d`"
        )
    files = [one for one in found if one.suffix in _READERS]
    if not files:
        raise LogError(
            f"{folder}: is a directory without the files of a ROS 2 bag (.db3, .mcap); "
            "name a log file"
        )
    if len(files) == 1:
        return files
    numbered = {one: match for one in files if (match := _NUMBERED.fullmatch(one.stem))}
    names = {(one.suffix, match[1]) for one, match in numbered.items()}
    if len(numbered) < len(files) or len(names) > 1:
        shown = " and ".join(sorted(one.name for one in files)[:2])
        raise LogError(f"{folder}: holds several recordings ({shown}, ...); name one of them")
    return sorted(files, key=lambda one: (int(numbered[one][2]), one.name))


def _check_start(file: Path, magic: bytes) -> None:
    with open(file, "rb") as stream:
        start = stream.read(len(magic))
    if not start:
        raise LogError(f"{file}: is empty")
    if start != magic:
        raise LogError(f"{file}: is no {file.suffix} file")
