"""read_episode: opens a log, however it was left, and says what was lost."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Set
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from mcap.records import Channel as McapChannel
from mcap.records import Message, Metadata, Schema

from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame, Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats import ros2_cdr
from tunenet_logs.formats.mcap_container import MAGIC, read_records
from tunenet_logs.formats.video import read_video
from tunenet_logs.messages import COMPRESSED_IMAGE
from tunenet_logs.stamps import order_samples, trusts_header
from tunenet_logs.writer import INFO_RECORD

_LAST_NS = 2**63 - 1
"""The last stamp that fits int64: in the year 2262."""


@dataclass
class _Gathered:
    """What one channel has delivered so far."""

    channel: McapChannel
    schema: Schema | None
    skipped: str | None
    messages: int = 0
    first_ns: int = 0
    last_ns: int = 0
    header_ns: list[int] = field(default_factory=list)
    log_ns: list[int] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)
    damaged: int = 0

    @property
    def type_name(self) -> str:
        return self.schema.name if self.schema else ""

    @property
    def is_pictures(self) -> bool:
        return self.skipped is None and self.type_name == COMPRESSED_IMAGE

    def add(self, message: Message) -> None:
        self.first_ns = min(self.first_ns, message.log_time) if self.messages else message.log_time
        self.last_ns = max(self.last_ns, message.log_time)
        self.messages += 1
        if message.log_time > _LAST_NS:
            self.damaged += 1
        elif self.skipped is None and self.type_name in ros2_cdr.LAYOUTS:
            try:
                stamp_ns, row = ros2_cdr.decode_row(message.data, self.type_name)
            except LogError:
                self.damaged += 1
                return
            self.header_ns.append(stamp_ns)
            self.log_ns.append(message.log_time)
            self.rows.append(row)
        elif self.is_pictures:
            try:
                self.header_ns.append(ros2_cdr.decode_image(message.data)[0])
            except LogError:
                self.damaged += 1


def read_episode(path: Path) -> Episode:
    """Read a log into memory, images aside: those are read when `frames()` is asked for them.

    Signals are named by their topic. What was lost, repaired or is doubtful is in `warnings`.

    Raises:
        LogError: `path` does not exist, is not a log, or holds nothing readable at all.
    """
    if _start_of(path) != MAGIC:
        return _read_foreign(path)
    losses: list[str] = []
    schemas: dict[int, Schema] = {}
    gathered: dict[int, _Gathered] = {}
    info: dict[str, str] = {}
    try:
        for record in read_records(path, losses):
            if isinstance(record, Schema):
                schemas.setdefault(record.id, record)
            elif isinstance(record, McapChannel) and record.id not in gathered:
                schema = schemas.get(record.schema_id)
                skipped = ros2_cdr.why_not(record, schema)
                gathered[record.id] = _Gathered(record, schema, skipped)
            elif isinstance(record, Message) and record.channel_id in gathered:
                gathered[record.channel_id].add(record)
            elif isinstance(record, Metadata) and record.name == INFO_RECORD:
                info = dict(record.metadata)
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    signals, notes = _signals(gathered.values())
    by_log = _untold(gathered.values(), notes)
    return Episode(
        info=EpisodeInfo.from_strings(info),
        signals=signals,
        channels=tuple(_summary(one) for one in gathered.values()),
        warnings=tuple(losses + notes),
        open_frames=partial(_frames, path, by_log),
    )


def _start_of(path: Path) -> bytes:
    """The first bytes of a file that may be a log."""
    try:
        if not path.exists():
            raise LogError(f"{path}: no such file")
        if path.is_dir():
            raise LogError(f"{path}: is a directory; name a log file (.mcap) inside it")
        if not path.is_file():
            raise LogError(f"{path}: is no regular file; record it to one first")
        with open(path, "rb") as file:
            start = file.read(len(MAGIC))
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    if not start:
        raise LogError(f"{path}: is empty; record it again")
    return start


def _read_foreign(path: Path) -> Episode:
    """A file that is no MCAP: a video, or nothing that is read here."""
    try:
        return read_video(path)
    except LogError as error:
        why = str(error).removeprefix(f"{path}: ")
        raise LogError(f"{path}: is not an MCAP log; {why}") from error


def _signals(channels: Iterable[_Gathered]) -> tuple[dict[str, Signal], list[str]]:
    signals: dict[str, Signal] = {}
    notes: list[str] = []
    for one in channels:
        topic = one.channel.topic
        if one.damaged:
            notes.append(f"{topic}: {one.damaged} damaged messages were left out")
        if not one.rows:
            continue
        layout = ros2_cdr.LAYOUTS[one.type_name]
        keep, stamps_ns, repairs = order_samples(
            np.array(one.header_ns, np.int64), np.array(one.log_ns, np.int64)
        )
        notes += [f"{topic}: {repair}" for repair in repairs]
        values = np.array(one.rows, np.float64)[keep]
        values[~np.isfinite(values)] = np.nan
        if topic in signals:
            notes.append(f"{topic}: a second channel of that name was left out")
            continue
        signals[topic] = Signal(topic, stamps_ns, values, layout.columns, layout.unit)
    return signals, notes


def _untold(channels: Iterable[_Gathered], notes: list[str]) -> set[str]:
    """Topics of pictures whose header stamps do not tell the time; reasons go into `notes`."""
    untold: set[str] = set()
    for one in channels:
        if one.is_pictures and one.header_ns:
            is_header, reasons = trusts_header(np.array(one.header_ns, np.int64))
            notes += [f"{one.channel.topic}: {reason}" for reason in reasons]
            if not is_header:
                untold.add(one.channel.topic)
    return untold


def _summary(one: _Gathered) -> Channel:
    return Channel(
        topic=one.channel.topic,
        type_name=one.type_name,
        encoding=one.channel.message_encoding,
        messages=one.messages,
        first_ns=one.first_ns,
        last_ns=one.last_ns,
        skipped=one.skipped,
        pictures=one.type_name == COMPRESSED_IMAGE,
    )


def _frames(path: Path, by_log: Set[str], topic: str) -> Iterator[Frame]:
    """The frames of one image channel, read afresh from the file.

    Args:
        path: the log.
        by_log: topics whose header stamps do not tell the time.
        topic: the channel.
    """
    schemas: dict[int, Schema] = {}
    chosen: int | None = None
    for record in read_records(path, []):
        if isinstance(record, Schema):
            schemas.setdefault(record.id, record)
        elif isinstance(record, McapChannel) and chosen is None and record.topic == topic:
            schema = schemas.get(record.schema_id)
            usable = ros2_cdr.why_not(record, schema) is None
            if usable and schema is not None and schema.name == COMPRESSED_IMAGE:
                chosen = record.id
        elif isinstance(record, Message) and record.channel_id == chosen:
            try:
                stamp_ns, encoding, data = ros2_cdr.decode_image(record.data)
            except LogError:
                continue
            is_told = stamp_ns != 0 and topic not in by_log
            yield Frame(stamp_ns if is_told else record.log_time, encoding, data)
